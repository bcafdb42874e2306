"""Programs that are kept: for which key, under which guards, and what is said of compiling.

What is compiled is counted by `jax.monitoring`; nothing but a compilation ends in the event `COMPILED`. The oldest JAX
cannot forget who listens, so that one function listens for as long as these tests run.
"""

import ast
import hashlib
import os
import pickle
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache
from llvmlite import binding

import jaxurban as ju
from jaxurban import kept_folders, programs
from jaxurban.programs import kept_jit
from tests.cli_runs import TOWN
from tests.faulty_disk import counted
from tests.kept_attacks import OTHER, as_root
from tests.logs import logged

COMPILED = "/jax/core/compile/backend_compile_duration"
X = np.arange(12, dtype=np.float32)
COMPILATIONS: list[float] = []  # their seconds
on_posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")


def on_duration(event: str, seconds: float, **_: object) -> None:
    if event == COMPILED:
        COMPILATIONS.append(seconds)


jax.monitoring.register_event_duration_secs_listener(on_duration)


def doubled(x, *, times=2):
    return jnp.sin(x) * times


def make() -> Callable:
    """Return the function as a new session has it: with nothing compiled or loaded yet."""
    return kept_jit(doubled, static_argnames=("times",))


@pytest.fixture
def cache(monkeypatch, tmp_path) -> Iterator[Path]:
    """An empty cache folder of the user; JAX's own cache is off, so that what is compiled is counted."""
    folder = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    fresh()
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", folder)
    compilation_cache.reset_cache()
    fresh()


def fresh() -> None:
    """Forget what this process knows of its folder and settings, as a new one would."""
    for known in (programs._session, kept_folders._warn, kept_folders.sweep_unused):
        known.cache_clear()


def num_compiled(function: Callable, *args: object, **static: object) -> int:
    """Return how many programs a call compiles; its result must be right."""
    num_before = len(COMPILATIONS)
    jax.clear_caches()
    result = function(*args, **static)
    expected = np.sin(np.asarray(args[0])) * static.get("times", 2)
    np.testing.assert_allclose(result, expected, rtol=1e-6)
    return len(COMPILATIONS) - num_before


def entries(cache: Path) -> list[Path]:
    return sorted(cache.glob("jaxurban/programs/*"))


@pytest.mark.slow
def test_a_later_session_compiles_nothing_and_other_shapes_types_and_static_values_do(cache):
    first = make()
    assert [num_compiled(first, X), num_compiled(first, X)] == [1, 0]
    later = make()
    assert [num_compiled(later, X), num_compiled(later, jnp.asarray(X))] == [0, 0]
    for x, static in ((X[1:], {}), (X.astype(np.int32), {}), (X, {"times": 3}), (3.0, {})):
        assert num_compiled(later, x, **static) == 1
        assert num_compiled(make(), x, **static) == 0
    with jax.enable_x64(True):
        assert num_compiled(later, X.astype(float)) == 1
    assert len(entries(cache)) == 6


def test_jax_traces_through_it_and_its_settings_stay(cache):
    before = dict(jax.config.values)
    function = make()
    slopes = jax.vmap(jax.grad(function))(X)
    np.testing.assert_allclose(slopes, 2 * np.cos(X), rtol=1e-5)
    with jax.disable_jit():
        np.testing.assert_allclose(function(X), 2 * np.sin(X), rtol=1e-6)
    assert not function.programs
    function(X)
    assert dict(jax.config.values) == before


def harmful(file: Path) -> bytes:
    """Return an entry whose loading leaves a mark beside the cache, with the digest that belongs to it."""

    class Mark:
        def __reduce__(self):
            return os.mkdir, (str(file.parents[2] / "mark"),)

    entry = pickle.dumps(Mark())
    return hashlib.sha256(file.name.encode() + entry).digest() + entry


def attacked(cache: Path) -> Path:
    """Return the file of a program, filled with what leaves a mark when it is loaded."""
    make()(X)
    (file,) = entries(cache)
    file.write_bytes(harmful(file))
    return file


def assert_compiled_anew(cache: Path, num: int = 1) -> None:
    """Check that a session compiles, runs nothing of the file, and is right."""
    fresh()
    assert num_compiled(make(), X) == num
    assert not (cache / "mark").exists()


def test_the_attack_runs_where_no_guard_stands_in_its_way(cache):
    """So the tests below say something."""
    attacked(cache)
    fresh()
    assert num_compiled(make(), X) == 1  # what was loaded is no program
    assert (cache / "mark").exists()


@on_posix
@pytest.mark.parametrize("mode", [0o666, 0o620, 0o602])
def test_a_file_that_others_may_write_to_is_not_read_but_written_anew(cache, mode):
    file = attacked(cache)
    file.chmod(mode)
    assert_compiled_anew(cache)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert_compiled_anew(cache, 0)


@as_root
@pytest.mark.parametrize("part", ["", "programs", "programs/.."])
def test_what_another_user_owns_is_not_read_and_that_is_said_once(cache, part):
    file = attacked(cache)
    of_another = cache / "jaxurban" / part if part else file
    os.chown(of_another, OTHER, OTHER)
    with logged() as lines:
        assert_compiled_anew(cache)
        make()(X)
    assert ["chmod go-w" in line for line in lines] == [True]
    # In a folder of our own the file is replaced, and nothing is written into another's.
    assert (file.read_bytes() == harmful(file)) == bool(part)
    assert entries(cache) == [file]


@on_posix
def test_neither_a_link_to_a_file_nor_one_to_a_folder_is_followed(cache):
    file = attacked(cache)
    aside = file.rename(cache / "aside")
    file.symlink_to(aside)
    assert_compiled_anew(cache)
    assert not file.is_symlink()
    folder = attacked(cache).parent
    moved = folder.rename(cache / "folder")
    folder.symlink_to(moved)
    assert_compiled_anew(cache)


@on_posix
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_folder_that_others_may_write_to_is_not_used_and_that_is_said_once(cache, mode):
    attacked(cache).parent.chmod(mode)
    with logged() as lines:
        assert_compiled_anew(cache)
        make()(X)
    assert ["chmod go-w" in line for line in lines] == [True]


@pytest.mark.slow
@pytest.mark.parametrize("at", [0, 31, 32, 300, -1])
def test_a_changed_byte_is_seen_before_anything_is_unpacked(cache, at):
    make()(X)
    (file,) = entries(cache)
    content = bytearray(file.read_bytes())
    whole = bytes(content)
    content[at] ^= 1
    file.write_bytes(content)
    assert programs._loaded(file) is None
    assert_compiled_anew(cache)
    assert_compiled_anew(cache, 0)
    for length in (0, 20, 32, len(whole) // 2):
        file.write_bytes(whole[:length])
        assert_compiled_anew(cache)


@pytest.mark.slow
def test_an_entry_of_another_processor_is_not_loaded_even_under_this_ones_name(cache, monkeypatch):
    """Nor that of another program, version or flag."""
    changes = [
        (binding, "get_host_cpu_name", lambda: "another"),
        (binding, "get_host_cpu_features", lambda: binding.FeatureMap(another=True)),
        (programs, "version", lambda name: "0.0.1"),
        (os, "environ", os.environ | {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} "}),
    ]
    make()(X)
    (own,) = entries(cache)
    for change in changes:
        with monkeypatch.context() as patch:
            patch.setattr(*change)
            assert_compiled_anew(cache)
            assert_compiled_anew(cache, 0)
    make()(X[1:])
    others = {*entries(cache)} - {own}
    assert len(others) == len(changes) + 1
    for other in others:
        own.write_bytes(other.read_bytes())
        assert_compiled_anew(cache)


def test_a_changed_source_file_has_programs_of_its_own(cache, monkeypatch, tmp_path_factory):
    package = tmp_path_factory.mktemp("package")
    (package / "inner" / "deep").mkdir(parents=True)
    sources = [package / "a.py", package / "inner" / "b.py", package / "inner" / "deep" / "c.py"]
    for source in sources:
        source.write_text("X = 1")
    monkeypatch.setattr(programs, "__file__", str(sources[0]))
    assert_compiled_anew(cache)
    assert_compiled_anew(cache, 0)
    for source in sources:
        source.write_text("X = 2")
        assert_compiled_anew(cache)
    package_files = {*Path(ju.__file__).parent.glob("*/**/*.py")}
    for folder in ("kernels", "planners", "io"):  # some are links in a checkout
        assert any(folder in file.parts for file in package_files)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["full", "failed"])
def test_a_full_disk_keeps_nothing_half_written_and_the_result_is_there(cache, way):
    with counted(cache, way=way) as steps:
        assert num_compiled(make(), X) == 1
    (file,) = entries(cache)
    for at in range(1, steps.num + 1):
        shutil.rmtree(cache / "jaxurban")
        with counted(cache, at, way) as failing:
            assert_compiled_anew(cache)
        assert failing.is_over
        kept = entries(cache)
        # One is there where a step failed before that did not have to come off.
        assert kept in ([], [file])
        (cache / "jaxurban").mkdir(exist_ok=True)
    assert_compiled_anew(cache, 1 - len(kept))
    assert entries(cache) == [file]


TWO = """
import sys
import numpy as np
from tests.test_programs import make
go = sys.stdin.readline()
print(float(make()(np.arange(12, dtype=np.float32)).sum()))
"""


@pytest.mark.slow
def test_two_processes_at_once_leave_one_whole_program(cache):
    root = Path(__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": str(root)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    running = [
        subprocess.Popen(
            [sys.executable, "-c", TWO],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for _ in range(2)
    ]
    said = {process.communicate("go\n")[0] for process in running}
    assert len(said) == 1
    (file,) = entries(cache)
    assert programs._loaded(file) is not None


def test_without_a_folder_or_with_a_key_that_is_no_data_each_session_compiles(cache, monkeypatch):
    (cache / "file").write_text("letters")
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache / "file"))
    assert [num_compiled(make(), X) for _ in range(2)] == [1, 1]
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    local = kept_jit(lambda x, *, scale: jnp.sin(x) * scale(2), static_argnames=("scale",))
    local(X, scale=lambda n: n)
    assert entries(cache) == []


def test_static_arguments_of_the_package_are_given_by_keyword_alone():
    """Given by position, one would be taken for a number, of which programs know the type alone."""
    num = 0
    for file in Path(ju.__file__).parent.glob("*/**/*.py"):
        source = file.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if "(kept_jit" in source else ():
            if not isinstance(node, ast.FunctionDef):
                continue
            for decorator in node.decorator_list:
                if "kept_jit" not in ast.dump(decorator) or not isinstance(decorator, ast.Call):
                    continue
                options = {option.arg: option.value for option in decorator.keywords}
                names = ast.literal_eval(options["static_argnames"])
                assert isinstance(names, tuple)
                assert set(names) <= {argument.arg for argument in node.args.kwonlyargs}
                num += 1
    assert num >= 10


COMMAND = """
import sys
from jaxurban.cli.main import main
from jaxurban.maps import run
run.shape_of_tiles = lambda task: (16, 16)
if __name__ == "__main__":
    main(sys.argv[1:])
"""


@pytest.mark.slow
def test_a_command_and_its_workers_compile_once_a_machine_and_say_so(tmp_path):
    pytest.importorskip("distributed", reason="needs the cluster extra")
    (tmp_path / "town.toml").write_text(TOWN)
    (tmp_path / "command.py").write_text(COMMAND)
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    caches = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    lines, files = [], []
    for out in ("first", "second"):
        command = [sys.executable, "command.py", "maps", "town.toml", "-o", out]
        ended = subprocess.run(
            [*command, "--workers", "2"],
            env=inherited | caches | {"PYTHONPATH": str(Path(ju.__file__).parents[1])},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 0, ended.stderr
        lines.append(ended.stderr.count(programs.SENTENCE))
        files.append({*tmp_path.glob("jaxurban/programs/*")})
    assert 1 <= lines[0] <= 2  # the command's own process, and one worker for all
    assert lines[1] == 0
    assert len({file.parent for file in files[0]}) == 1
    assert files[0] == files[1]
