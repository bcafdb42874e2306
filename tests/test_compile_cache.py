"""Commands let JAX keep compiled programs, where users have chosen nothing."""

import os
import subprocess
import sys

import pytest

FOLDER, LEAST_S = "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"


def test_commands_let_jax_keep_programs_without_importing_it(tmp_path):
    command = (
        "import os, sys; from jaxurban.cli import main as cli\n"
        "cli._set_up_libraries(); assert 'jax' not in sys.modules\n"
        f"print(os.environ.get({FOLDER!r}), os.environ.get({LEAST_S!r}))\n"
        "import jax; print(jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs)"
    )
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}

    def settings(**environment: str) -> list[str]:
        environment = inherited | {"XDG_CACHE_HOME": str(tmp_path)} | environment
        done = subprocess.run(
            [sys.executable, "-c", command], capture_output=True, text=True, check=True, env=environment
        )
        return done.stdout.splitlines()

    folder = tmp_path / "jaxurban" / "jax"
    assert settings() == [f"{folder} 0", f"{folder} 0.0"]
    own = tmp_path / "own"
    assert settings(**{FOLDER: str(own)}) == [f"{own} 0", f"{own} 0.0"]
    assert settings(**{FOLDER: str(own), LEAST_S: "3"}) == [f"{own} 3", f"{own} 3.0"]


@pytest.mark.parametrize("is_there", [True, False])
def test_where_the_folder_cannot_be_made_commands_work_without(tmp_path, is_there):
    in_the_way = tmp_path / "file"
    if is_there:
        in_the_way.write_text("letters")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import os; from jaxurban.cli import main as cli; cli._set_up_libraries()\n"
            f"assert {FOLDER!r} not in os.environ",
        ],
        env=environment | {"XDG_CACHE_HOME": str(in_the_way if is_there else "/proc/nowhere")},
        check=False,
    )
    assert done.returncode == 0
