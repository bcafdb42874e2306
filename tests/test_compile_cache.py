"""Compiled programs are kept for users who have chosen nothing, and where these have chosen nothing is touched."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from jaxurban.compile_cache import has_programs

FOLDER, LEAST_S = "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
MAPS = """
import logging, sys
import jax
{before}
import jaxurban as ju

untouched = jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs
logging.basicConfig(stream=sys.stdout, format="%(message)s")
logging.getLogger("jaxurban").setLevel(logging.INFO)
city = ju.demo_city(400, 400)
assert untouched == (jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs)
for _ in range(2):
    ju.build_maps(city, resolution_m=20.0, altitudes_m=[60.0], progress=False)
print(jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs)
"""


def session(cache: Path, before: str = "", **environment: str) -> list[str]:
    """Return what a session prints whose user's cache folder is ``cache``: what the log tells, then JAX's settings."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    warnings = ["-W", "error::UserWarning", "-W", "ignore::jaxurban.errors.GuessWarning"]
    done = subprocess.run(
        [sys.executable, *warnings, "-c", MAPS.format(before=before)],
        capture_output=True,
        text=True,
        check=False,
        env=inherited | {"XDG_CACHE_HOME": str(cache)} | environment,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_first_maps_of_a_session_keep_their_programs_and_tell_it_once(tmp_path):
    folder = tmp_path / "jaxurban" / "jax"
    used_before = "jax.numpy.zeros(3) + 1"  # JAX has compiled something before
    told, settings = session(tmp_path, used_before)
    assert str(folder) in told
    assert FOLDER in told
    assert settings == f"{folder} 0.0"
    kept = {path.name for path in folder.iterdir()}
    assert any(name.startswith("jit__roofs_and_obstacles") for name in kept)
    session(tmp_path)
    programs = {name for name in kept if name.endswith("-cache")}
    assert programs == {path.name for path in folder.iterdir() if path.name.endswith("-cache")}  # all were found


def test_programs_are_at_hand_once_a_session_has_kept_some(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "jax")
    monkeypatch.delenv(FOLDER, raising=False)
    assert not has_programs()
    monkeypatch.setenv(FOLDER, str(tmp_path / "jax"))
    assert not has_programs()
    (tmp_path / "jax").mkdir()
    assert not has_programs()
    (tmp_path / "jax" / "jit_f-0123-cache").touch()
    assert has_programs()


@pytest.mark.slow
def test_a_users_own_folder_stays_and_so_does_what_is_kept_there(tmp_path):
    own = str(tmp_path / "own")
    assert session(tmp_path, **{FOLDER: own}) == [f"{own} 1.0"]
    assert session(tmp_path, f"jax.config.update('jax_compilation_cache_dir', {own!r})") == [f"{own} 1.0"]
    assert not (tmp_path / "jaxurban").exists()


@pytest.mark.slow
def test_a_user_who_wants_no_cache_gets_none(tmp_path):
    assert session(tmp_path, JAX_ENABLE_COMPILATION_CACHE="false") == ["None 1.0"]


@pytest.mark.slow
@pytest.mark.parametrize("is_there", [True, False])
def test_where_the_folder_cannot_be_made_maps_are_made_without(tmp_path, is_there):
    in_the_way = tmp_path / "file"
    if is_there:
        in_the_way.write_text("letters")
    cache = in_the_way if is_there else Path("/proc/nowhere")
    assert session(cache) == ["None 1.0"]


def test_commands_keep_programs_where_maps_of_python_do_without_importing_jax(tmp_path):
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
    assert settings() == [f"{folder} 0.0", f"{folder} 0.0"]
    own = tmp_path / "own"
    assert settings(**{FOLDER: str(own)}) == [f"{own} 0", f"{own} 0.0"]
    assert settings(**{FOLDER: str(own), LEAST_S: "3"}) == [f"{own} 3", f"{own} 3.0"]
