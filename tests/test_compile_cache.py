"""Commands let JAX keep compiled programs, where users have chosen nothing."""

import os
import subprocess
import sys

FOLDER, LEAST_S = "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"


COMMAND = f"""import os, sys; from jaxurban.cli import main as cli
cli._set_up_libraries(); assert 'jax' not in sys.modules
print(os.environ.get({FOLDER!r}), os.environ.get({LEAST_S!r}))
import jax; print(jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs)"""


def settings(**environment: object) -> list[str]:
    """Return what commands set for JAX, and what JAX takes from it."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    environment = inherited | {name: str(value) for name, value in environment.items()}
    done = subprocess.run([sys.executable, "-c", COMMAND], capture_output=True, text=True, check=True, env=environment)
    return done.stdout.splitlines()


def test_commands_let_jax_keep_programs_without_importing_it(tmp_path):
    folder, own, cache = tmp_path / "jaxurban" / "jax", tmp_path / "own", {"XDG_CACHE_HOME": tmp_path}
    assert settings(**cache) == [f"{folder} 0", f"{folder} 0.0"]
    assert settings(**cache, **{FOLDER: own}) == [f"{own} 0", f"{own} 0.0"]
    assert settings(**cache, **{FOLDER: own, LEAST_S: 3}) == [f"{own} 3", f"{own} 3.0"]


def test_where_the_folder_cannot_be_made_commands_work_without(tmp_path):
    (tmp_path / "file").write_text("letters")
    for cache in (tmp_path / "file", "/proc/nowhere"):
        assert settings(XDG_CACHE_HOME=cache)[0].startswith("None ")
