"""A Dask cluster of somebody else's: one without workers, and one whose scheduler goes."""

import json
import subprocess
import sys
import time

import pytest

from jaxurban.errors import InputError
from jaxurban.maps.executors import cluster_client, each_on_cluster

pytest.importorskip("distributed", reason="needs the cluster extra")


def work_without_scheduler(address: str, scheduler: subprocess.Popen) -> None:
    with cluster_client(address, None) as client:
        scheduler.kill()
        each_on_cluster(client, abs, [1])


@pytest.mark.slow
def test_a_cluster_without_workers_is_told_and_a_scheduler_that_goes_is_one_sentence(tmp_path, caplog):
    file = tmp_path / "scheduler.json"
    options = ["--port", "0", "--dashboard-address", "127.0.0.1:0", "--host", "127.0.0.1"]
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", *options, "--scheduler-file", str(file)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as scheduler:
        try:
            while not file.exists():
                time.sleep(0.1)
            address = json.loads(file.read_text())["address"]
            with pytest.raises(InputError, match="is gone: start it"):
                work_without_scheduler(address, scheduler)
        finally:
            scheduler.kill()
    assert f"the cluster {address} has no worker yet: waiting for one" in caplog.text
