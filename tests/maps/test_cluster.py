"""Dask clusters, of somebody else's and of our own: without workers, without certificates, with processes killed."""

import itertools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Thread
from urllib.error import HTTPError
from urllib.request import urlopen

import psutil
import pytest

from jaxurban.errors import InputError
from jaxurban.maps import run as pipeline
from jaxurban.maps.executors import cluster_client
from jaxurban.maps.scenario import Scenario
from tests.cli_runs import TOWN
from tests.tiled_runs import files_of

pytest.importorskip("distributed", reason="needs the cluster extra")
from distributed import Client
from distributed.security import Security

pytestmark = pytest.mark.slow
SCENARIO = TOWN.replace("-73.993, 40.761", "-73.995, 40.759").replace("[20, 60]", "[20]")
MANY_TILES = """
import sys
from jaxurban.cli.main import main
from jaxurban.maps import run
run.shape_of_tiles = lambda task: (8, 8)
main(sys.argv[1:])
"""


@contextmanager
def process(*words: object, **how: object) -> Iterator[subprocess.Popen]:
    """Run Python; it is ended with the block."""
    with subprocess.Popen(
        [sys.executable, *map(str, words)], stderr=subprocess.PIPE, text=True, **how
    ) as started:
        try:
            yield started
        finally:
            started.kill()


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory) -> Iterator[tuple[str, subprocess.Popen]]:
    """The address of a scheduler, and its process."""
    file = tmp_path_factory.mktemp("cluster") / "scheduler.json"
    options = [
        "--port",
        "0",
        "--dashboard-address",
        "127.0.0.1:0",
        "--host",
        "127.0.0.1",
        "--scheduler-file",
        file,
    ]
    with process("-m", "distributed.cli.dask_scheduler", *options) as started:
        while not file.exists():
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"], started


def test_a_cluster_of_ones_own_shows_no_page():
    with cluster_client(1) as client:
        workers = client.scheduler_info()["workers"].values()
        ports = [
            client.cluster.scheduler.http_server.port,
            *(each["services"]["dashboard"] for each in workers),
        ]
        for port, page in itertools.product(
            ports, ("status", "health", "metrics", "info/main/workers.html")
        ):
            with pytest.raises(HTTPError, match="404"):
                urlopen(f"http://127.0.0.1:{port}/{page}", timeout=10)


def test_a_cluster_without_workers_is_warned_of(scheduler, caplog):
    address, _ = scheduler
    with cluster_client(address):
        pass
    assert f"the cluster {address} has no worker yet: waiting for one" in caplog.text


def test_each_process_of_a_cluster_is_killed_in_turn_and_no_map_is_lost(
    scheduler, tmp_path, monkeypatch
):
    def again(folder: Path, workers: str | None = None) -> dict[str, bytes]:
        pipeline.run_scenario(
            Scenario.from_toml(tmp_path / "town.toml"), folder, progress=False, workers=workers
        )
        return {
            name: data
            for name, data in files_of(folder).items()
            if name not in ("run.json", "checksums.json")
        }

    def worker() -> subprocess.Popen:
        return stack.enter_context(
            process("-m", "distributed.cli.dask_worker", address, "--no-nanny")
        )

    (address, of_scheduler), stack = scheduler, ExitStack()
    (tmp_path / "town.toml").write_text(SCENARIO)
    monkeypatch.setattr(pipeline, "shape_of_tiles", lambda task: (8, 8))
    whole = again(tmp_path / "whole")
    with stack:
        workers = [worker(), worker()]
        for victim in ("one", "two", "client", "scheduler"):
            out = tmp_path / victim
            with process(
                "-c",
                MANY_TILES,
                "maps",
                "town.toml",
                "-o",
                victim,
                "--cluster",
                address,
                cwd=tmp_path,
            ) as run:
                while len(list(out.glob("maps.zarr/.20m*/done/*.json"))) < 3:
                    assert run.poll() is None, run.stderr.read()
                    time.sleep(0.01)
                ({"client": run, "scheduler": of_scheduler}.get(victim) or workers.pop(0)).kill()
                *_, told = ["", *run.stderr.read().splitlines()]
                code = run.wait()
            assert code == {"client": -signal.SIGKILL, "scheduler": 2}.get(victim, 0), told
            assert ("was lost: start it again" in told) == (victim == "scheduler")
            if code == 0:
                workers.append(worker())
            assert again(out, address if victim == "client" else None) == whole


def end_first_child(code: int) -> None:
    """End the first worker process that this process starts, as soon as it is there."""
    while True:
        for child in psutil.Process().children():
            with suppress(psutil.Error):  # one of an earlier test that has ended
                if "spawn_main" in " ".join(child.cmdline()):
                    child.send_signal(code)
                    return
        time.sleep(0.01)


def test_who_holds_no_certificate_of_the_run_does_not_reach_its_workers():
    with cluster_client(1) as client:
        address = client.scheduler_info()["address"]
        assert address.startswith("tls://127.0.0.1")
        with pytest.raises(OSError, match=r"127\.0\.0\.1"):
            Client(address.replace("tls", "tcp"), timeout=2)
        with pytest.raises(OSError, match="TLS certificate does not match"):
            Client(address, security=Security.temporary(), timeout=30)


def test_a_worker_killed_while_it_starts_is_one_sentence():
    Thread(target=end_first_child, args=(signal.SIGKILL,), daemon=True).start()
    with (
        pytest.raises(InputError, match="a worker process ended while it started"),
        cluster_client(1),
    ):
        pass
