"""A Dask cluster of somebody else's without workers, and one of our own."""

import json
import signal
import subprocess
import sys
import time
from threading import Thread

import psutil
import pytest

from jaxurban.errors import InputError
from jaxurban.maps.executors import cluster_client

pytest.importorskip("distributed", reason="needs the cluster extra")
from distributed import Client
from distributed.security import Security


@pytest.mark.slow
def test_a_cluster_without_workers_is_warned_of(tmp_path, caplog):
    file = tmp_path / "scheduler.json"
    options = ["--port", "0", "--dashboard-address", "127.0.0.1:0", "--host", "127.0.0.1"]
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", *options, "--scheduler-file", str(file)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as scheduler:
        try:
            while not file.exists():
                time.sleep(0.1)
            address = json.loads(file.read_text())["address"]
            with cluster_client(address):
                pass
        finally:
            scheduler.kill()
    assert f"the cluster {address} has no worker yet: waiting for one" in caplog.text


def end_first_child(code: int) -> None:
    """End the first worker process that this process starts, as soon as it is there."""
    while not (
        children := [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]
    ):
        time.sleep(0.01)
    children[0].send_signal(code)


@pytest.mark.slow
def test_who_holds_no_certificate_of_the_run_does_not_reach_its_workers():
    with cluster_client(1) as client:
        address = client.scheduler_info()["address"]
        assert address.startswith("tls://127.0.0.1")
        with pytest.raises(OSError, match=r"127\.0\.0\.1"):
            Client(address.replace("tls", "tcp"), timeout=2)
        with pytest.raises(OSError, match="TLS certificate does not match"):
            Client(address, security=Security.temporary(), timeout=2)


@pytest.mark.slow
def test_a_worker_killed_while_it_starts_is_one_sentence():
    Thread(target=end_first_child, args=(signal.SIGKILL,), daemon=True).start()
    with pytest.raises(InputError, match="a worker process ended while it started"), cluster_client(1):
        pass
