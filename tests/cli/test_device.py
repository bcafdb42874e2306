"""What computes: told, refused, and chosen for a command's own process alone."""

import os

import jax
import pytest

from jaxurban.cli.common import use_device
from tests.cli_runs import assert_one_sentence, run

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="states what holds where JAX has no GPU")


def test_the_device_is_told(caplog):
    caplog.set_level("INFO", "jaxurban")
    use_device(None)
    use_device("auto")
    assert caplog.messages == ["device: cpu (cpu)"]


def test_commands_refuse_a_gpu_that_is_not_there(tmp_path, capsys):
    code, _, err = run(capsys, "demo", "-o", tmp_path / "out", "--device", "gpu")
    assert code == 2
    assert_one_sentence(err, "there is no GPU that JAX can use")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options", [["--device", "cpu"], ["--workers", "2"]])
def test_the_cpu_is_for_a_command_and_for_its_workers(monkeypatch, tmp_path, capsys, options):
    set_up = {}
    monkeypatch.setattr(jax.config, "update", set_up.__setitem__)
    monkeypatch.setenv("JAX_PLATFORMS", "")
    code, _, _ = run(capsys, "maps", tmp_path / "none.toml", "-o", tmp_path, *options)
    assert (code, set_up, os.environ["JAX_PLATFORMS"]) == (2, {"jax_platforms": "cpu"}, "cpu")


def test_workers_and_a_gpu_or_a_cluster_are_refused(tmp_path, capsys):
    for options, remedy in (
        (["--device", "gpu"], "start a `dask worker` on each"),
        (["--cluster", "tcp://host:1"], "give either --workers"),
    ):
        code, _, err = run(capsys, "maps", tmp_path / "none.toml", "-o", tmp_path, "--workers", "2", *options)
        assert code == 2
        assert_one_sentence(err, remedy)
