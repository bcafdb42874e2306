"""What computes, and the memory that a GPU has: told, refused and planned by."""

import logging
from types import SimpleNamespace

import jax
import pytest

from jaxurban.errors import InputError
from jaxurban.maps import device, memory
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
    device.use_device("auto")
    assert caplog.messages == ["device: cpu (cpu)"]
    assert device.gpu_free_bytes() is None
    with pytest.raises(InputError, match=r"no GPU that JAX can use: install jaxurban\[cuda13\]"):
        device.use_device("gpu")
    with pytest.raises(InputError, match="device must be 'auto', 'cpu' or 'gpu', got 'tpu'"):
        device.use_device("tpu")


@pytest.mark.parametrize(("value", "taken"), [("false", "as needed"), ("true", "at once")])
def test_a_gpu_is_told_with_its_free_memory(gpu, value, taken, monkeypatch, caplog):
    monkeypatch.setenv(device.PREALLOCATE, value)
    caplog.set_level(logging.INFO, "jaxurban")
    device.use_device("gpu")
    assert caplog.messages == [f"device: NVIDIA H200 (gpu), 3 GiB of memory, taken {taken}"]


def test_as_many_tiles_as_a_gpu_holds_are_worked_on(gpu, tmp_path, monkeypatch):
    tasks = [task(city())]
    monkeypatch.setattr(memory, "tile_bytes", lambda task, tile: int(1.2 * GIB))
    monkeypatch.setattr(memory, "free_bytes", lambda: 200 * GIB)
    assert memory.plan_run(tasks, tmp_path, None, 8, False).num_workers == 2
    gpu["bytes_in_use"] = 3 * GIB
    with pytest.raises(InputError, match=r"about 1\.2 GiB of the GPU's memory and 1\.0 GiB are free"):
        memory.plan_run(tasks, tmp_path, None, 8, False)


@needs_cpu
def test_commands_refuse_a_gpu_that_is_not_there(tmp_path, capsys):
    code, _, err = run(capsys, "demo", "-o", tmp_path / "out", "--device", "gpu")
    assert code == 2
    assert_one_sentence(err, "there is no GPU that JAX can use")
    assert not (tmp_path / "out").exists()
