"""What computes, and the memory that a GPU has: told, refused and planned by."""

import logging
import os
import signal
import time
from types import SimpleNamespace

import jax
import pytest

from jaxurban.errors import InputError
from jaxurban.maps import device, executors, memory
from jaxurban.maps.device import Gpu
from jaxurban.maps.executors import Resources, cluster_client
from tests.cli_runs import assert_one_sentence, run
from tests.tiled_runs import city, task

needs_cpu = pytest.mark.skipif(jax.default_backend() != "cpu", reason="states what holds where JAX has no GPU")
GIB = 2**30


@pytest.fixture
def gpu(monkeypatch):
    """A made-up GPU of 4 GiB, of which 1 is in use."""
    stats = {"bytes_limit": 4 * GIB, "bytes_in_use": GIB}
    made = SimpleNamespace(device_kind="NVIDIA H200", memory_stats=lambda: stats)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(jax, "local_devices", lambda: [made])
    return stats


@needs_cpu
def test_the_cpu_is_told_and_a_gpu_that_is_not_there_refused(caplog):
    caplog.set_level(logging.INFO, "jaxurban")
    device.check_device("auto")
    assert caplog.messages == ["device: cpu (cpu)"]
    assert device.gpu_free_bytes() is None
    with pytest.raises(InputError, match=r"no GPU that JAX can use: install jaxurban\[cuda13\]"):
        device.check_device("gpu")
    with pytest.raises(InputError, match="device must be 'auto', 'cpu' or 'gpu', got 'tpu'"):
        device.check_device("tpu")


@pytest.mark.parametrize(("value", "taken"), [("false", "as needed"), ("true", "at once")])
def test_a_gpu_is_told_with_its_free_memory(gpu, value, taken, monkeypatch, caplog):
    monkeypatch.setenv(device.PREALLOCATE, value)
    caplog.set_level(logging.INFO, "jaxurban")
    device.check_device("gpu")
    assert caplog.messages == [f"device: NVIDIA H200 (gpu), 3 GiB of memory, taken {taken}"]


def test_as_many_tiles_as_a_gpu_holds_are_worked_on(gpu, monkeypatch):
    tasks = [task(city())]
    monkeypatch.setattr(memory, "tile_gpu_bytes", lambda task, tile: int(1.2 * GIB))
    monkeypatch.setattr(memory, "free_bytes", lambda: 200 * GIB)
    assert memory.plan_run(tasks, None, 8).num_workers == 2
    gpu["bytes_in_use"] = 3 * GIB
    with pytest.raises(InputError, match=r"about 1\.2 GiB of the GPU's memory and 1\.0 GiB are free"):
        memory.plan_run(tasks, None, 8)


@needs_cpu
def test_commands_refuse_a_gpu_that_is_not_there(tmp_path, capsys):
    code, _, err = run(capsys, "demo", "-o", tmp_path / "out", "--device", "gpu")
    assert code == 2
    assert_one_sentence(err, "there is no GPU that JAX can use")
    assert not (tmp_path / "out").exists()


UUIDS = "GPU-8932f937-d72c-4106-c12f-20bd9faed9f6, GPU-b6eb34d8-a2f8-4ac0-a1a0-6a1e0c1f6f8e"


@pytest.mark.parametrize("num_workers", [1, 2, 3, 8, 16])
@pytest.mark.parametrize("num_gpus", [1, 2, 8])
def test_every_worker_has_a_gpu_of_its_own_and_there_are_no_more_workers_than_gpus(monkeypatch, num_gpus, num_workers):
    gpus = [Gpu(str(n)) for n in range(num_gpus)]
    monkeypatch.setattr(device, "find_gpus", lambda: gpus)
    bound = device.bind_workers("gpu", num_workers)
    assert len(bound) == len(set(bound)) == min(num_gpus, num_workers)
    assert set(bound) <= set(gpus)


@pytest.mark.parametrize(
    ("places", "visible", "names"),
    [
        ([0, 1], None, ["0", "1"]),
        ([0, 1], "6,2", ["6", "2"]),
        ([1], "6, 2", ["2"]),  # JAX itself was told to take the second alone
        ([0], "3,-1,1", ["3"]),  # CUDA shows none behind one that is not there
        ([0, 1], UUIDS, UUIDS.split(", ")),
    ],
)
def test_a_worker_is_told_its_gpu_in_the_words_of_cuda_visible_devices(places, visible, names):
    assert device.visible_names(places, visible) == names


def test_what_jax_has_is_asked_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=3")
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert device.ask_jax() == [{"platform": "cpu", "kind": "cpu", "place": n, "memory": None} for n in range(3)]
    monkeypatch.setenv("JAX_PLATFORMS", "abacus")
    with pytest.raises(InputError, match=r"JAX does not start .*abacus.* take --device cpu"):
        device.ask_jax()


@pytest.fixture
def two_gpus(monkeypatch):
    """What JAX would tell of two GPUs of 4 and 3 GiB, the second and third of those of the machine."""
    told = [
        {"platform": "gpu", "kind": "NVIDIA H200", "place": n, "memory": {"bytes_limit": (4 - n) * GIB}} for n in (0, 1)
    ]
    monkeypatch.setattr(device, "entry_points", lambda group: ["xla_cuda13"])
    monkeypatch.setattr(device, "ask_jax", lambda: told)
    monkeypatch.setenv(device.VISIBLE, "1,2")
    monkeypatch.setenv(device.PREALLOCATE, "false")
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    before = jax.config.values["jax_platforms"]
    yield told
    jax.config.update("jax_platforms", before)


def test_more_workers_than_gpus_are_told_in_one_sentence_and_this_process_stays_as_it_is(two_gpus, caplog):
    caplog.set_level(logging.INFO, "jaxurban")
    before = jax.config.values["jax_platforms"]
    resources = Resources(num_processes=5).on_device(None)
    assert [(gpu.name, gpu.limit_bytes) for gpu in resources.gpus] == [("1", 4 * GIB), ("2", 3 * GIB)]
    assert (resources.num_processes, resources.backend) == (2, "gpu")
    assert caplog.messages == [
        "device: 2 of 5 worker processes, as each has a GPU of its own (NVIDIA H200), 3 GiB of memory, taken as needed"
    ]
    assert (jax.config.values["jax_platforms"], os.environ.get("JAX_PLATFORMS")) == (before, None)
    caplog.clear()
    assert [gpu.name for gpu in Resources(num_processes=1).on_device("gpu").gpus] == ["1"]
    assert caplog.messages == [
        "device: 1 of 1 worker processes, as each has a GPU of its own (NVIDIA H200), 4 GiB of memory, taken as needed"
    ]


@pytest.mark.parametrize(("options", "inherited"), [(["--device", "cpu"], "cpu"), ([], None)])
def test_a_command_keeps_its_own_process_off_the_workers_gpus(
    two_gpus, monkeypatch, tmp_path, capsys, options, inherited
):
    set_up = {}
    monkeypatch.setattr(jax.config, "update", set_up.__setitem__)
    monkeypatch.setenv("JAX_PLATFORMS", "")
    monkeypatch.delenv("JAX_PLATFORMS")
    code, _, _ = run(capsys, "maps", tmp_path / "none.toml", "-o", tmp_path, "--workers", "2", *options)
    assert (code, set_up) == (2, {"jax_platforms": "cpu"})
    assert os.environ.get("JAX_PLATFORMS") == inherited


def test_workers_on_the_cpu_are_as_many_as_were_asked_for(two_gpus, monkeypatch):
    assert Resources(num_processes=5).on_device("cpu") == Resources(num_processes=5)
    assert "JAX_PLATFORMS" not in os.environ
    monkeypatch.setattr(device, "entry_points", lambda group: [])
    assert Resources(num_processes=5).on_device("auto") == Resources(num_processes=5)
    with pytest.raises(InputError, match="no GPU that JAX can use"):
        Resources(num_processes=5).on_device("gpu")


def test_tiles_of_worker_processes_are_planned_by_the_least_of_their_gpus(monkeypatch):
    tasks, gpus = [task(city())], [Gpu("0", limit_bytes=9 * GIB), Gpu("1", limit_bytes=6 * GIB)]
    for name in ("tile_bytes", "tile_gpu_bytes"):
        monkeypatch.setattr(memory, name, lambda task, tile: 2 * GIB)
    monkeypatch.setattr(memory, "free_bytes", lambda: 200 * GIB)
    assert memory.plan_run(tasks, None, 16, 2, gpus).num_workers == 6
    monkeypatch.setattr(memory, "free_bytes", lambda: 26 * GIB)  # 13 for the run: too few for six tiles
    assert memory.plan_run(tasks, None, 16, 2, gpus).num_workers == 4
    monkeypatch.setattr(memory, "tile_gpu_bytes", lambda task, tile: 7 * GIB)
    with pytest.raises(InputError, match=r"about 7\.0 GiB of the GPU's memory and 6\.0 GiB are free"):
        memory.plan_run(tasks, None, 2, 2, gpus)


def test_a_worker_process_on_a_gpu_has_its_share_of_the_cores_as_threads(monkeypatch):
    monkeypatch.setattr(executors, "num_cores", lambda: 9)
    assert Resources(num_processes=2).num_workers == 2
    assert Resources(num_processes=2, gpus=[Gpu("0"), Gpu("1")]).num_workers == 8
    assert Resources(num_processes=16, gpus=[Gpu(str(n)) for n in range(16)]).num_workers == 16


def environment() -> dict[str, str | None]:
    return {name: os.environ.get(name) for name in Gpu("").environment}


@pytest.mark.slow
def test_worker_processes_find_their_gpu_in_their_environment_and_keep_it_when_killed(monkeypatch):
    pytest.importorskip("distributed", reason="needs the cluster extra")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5,6,7")
    monkeypatch.setenv(device.PREALLOCATE, "true")
    names = ["5", UUIDS.split(", ")[0]]
    with cluster_client(None, 2, [Gpu(name) for name in names], num_threads=2) as client:
        found = client.run(environment).values()
        assert sorted(each["CUDA_VISIBLE_DEVICES"] for each in found) == names
        assert {each["JAX_CUDA_VISIBLE_DEVICES"] for each in found} == {"all"}
        assert {each[device.PREALLOCATE] for each in found} == {"true"}
        assert set(client.nthreads().values()) == {2}
        before = client.run(os.getpid)
        os.kill(next(iter(before.values())), signal.SIGKILL)
        while len(now := client.scheduler_info()["workers"].keys()) < 2 or now == before.keys():
            time.sleep(0.05)
        assert sorted(each["CUDA_VISIBLE_DEVICES"] for each in client.run(environment).values()) == names


@needs_cpu
def test_a_worker_whose_gpu_does_not_start_is_an_error_and_no_slow_run():
    pytest.importorskip("distributed", reason="needs the cluster extra")
    resources = Resources(num_processes=1, gpus=[Gpu("99")])
    with pytest.raises(InputError, match="JAX does not start on the GPU of a worker"), resources.client(num_tiles=1):
        pass


def test_the_command_plans_its_workers_by_the_memory_of_their_gpus(two_gpus, tmp_path, capsys):
    two_gpus[1]["memory"]["bytes_limit"] = 1000
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        '[region]\nbounds = [-73.985, 40.755, -73.979, 40.759]\nresolution_m = 20\n[buildings]\nsource = "synthetic"\n'
    )
    code, _, err = run(capsys, "maps", scenario, "-o", tmp_path / "out", "--workers", 3)
    told, *_, error = err.strip().splitlines()
    assert code == 2
    assert "2 of 3 worker processes, as each has a GPU of its own" in told
    assert "of the GPU's memory and less than 1 MiB are free" in error


def own_device() -> tuple[str, int]:
    return jax.default_backend(), jax.local_device_count()


@pytest.mark.gpu
@pytest.mark.skipif(jax.default_backend() == "cpu", reason="JAX has no GPU here")
def test_each_worker_computes_on_one_gpu_of_those_that_jax_has():
    pytest.importorskip("distributed", reason="needs the cluster extra")
    gpus = tuple(device.find_gpus())
    assert [gpu.kind for gpu in gpus] == [each.device_kind for each in jax.local_devices()]
    with Resources(num_processes=len(gpus), gpus=gpus).client(num_tiles=len(gpus)) as client:
        assert set(client.run(own_device).values()) == {("gpu", 1)}
