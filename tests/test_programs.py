"""Programs that JAX keeps: where, for which processor, what becomes of damaged ones, and what is said of compiling.

What is compiled and what is loaded is counted by `jax.monitoring` in processes of their own.
"""

import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

import jaxurban as ju
from jaxurban import programs
from tests.cli_runs import TOWN
from tests.logs import logged

FOLDER = "JAX_COMPILATION_CACHE_DIR"
PRELUDE = """
import collections, sys
import jax
import jaxurban as ju
from jaxurban import programs
programs.BRIEF_S = 0.0
events = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: events.update([event.rpartition("/")[2]]))
folder = ju.keep_programs()
"""
COMPUTE = """
import jax.numpy as jnp
x = jnp.arange(900.0).reshape(30, 30)
parts = jax.jit(lambda x: jnp.sort(jnp.sin(x) @ x))(x), jax.jit(jnp.linalg.norm)(x)
print(*(float(part.sum()) for part in parts))
print(events["cache_hits"], events["cache_misses"])
"""
CUT_THEN_COMPUTE = f"for file in folder.glob('*-cache'): file.write_bytes(b'')\n{COMPUTE}"
DAMAGES = (
    lambda whole: b"",
    lambda whole: whole[: len(whole) // 2],
    lambda whole: bytes(255 - byte for byte in whole),
    lambda whole: whole[:-30] + bytes(30),
)


def run(code: str, **environment: object) -> tuple[list[str], str]:
    """Return the lines that a process prints, in which warnings are errors, and what it says on stderr."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        env=inherited | {name: str(value) for name, value in environment.items()},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(), done.stderr


def counted(code: str, **environment: object) -> tuple[str, int, int, str]:
    """Return the result of a process, how many programs it loaded and compiled, and what it said."""
    (result, counts), said = run(PRELUDE + code, **environment)
    loaded, compiled = map(int, counts.split())
    return result, loaded, compiled, said


@pytest.mark.slow
def test_damaged_programs_are_compiled_anew_and_written_again_without_a_word(tmp_path):
    line, cache = f"{programs.SENTENCE}\n", {"XDG_CACHE_HOME": tmp_path}
    result, loaded, num, said = counted(COMPUTE, **cache)
    assert (loaded, said) == (0, line)
    assert num >= len(DAMAGES)
    assert counted(COMPUTE, **cache) == (result, num, 0, "")
    files = sorted(tmp_path.glob("jaxurban/xla-*/*-cache"))
    for at, file in enumerate(files):
        file.write_bytes(DAMAGES[at % len(DAMAGES)](file.read_bytes()))
    assert counted(COMPUTE, **cache) == (result, 0, num, line)
    assert counted(COMPUTE, **cache) == (result, num, 0, "")
    assert counted(CUT_THEN_COMPUTE, **cache) == (result, 0, num, line)


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="x86 alone has these instructions")
def test_programs_of_other_instructions_are_not_loaded(tmp_path):
    flags = [{}, {"XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2"}]
    for environment in flags:
        _, loaded, compiled, _ = counted(COMPUTE, XDG_CACHE_HOME=tmp_path, **environment)
        assert loaded == 0 < compiled
    assert len({file.parent for file in tmp_path.glob("jaxurban/xla-*/*")}) == 1


def settings(code: str = "", **environment: object) -> list[str]:
    """Return the folder before the call, what the call returns, the folder after it, and the least compile time."""
    lines, said = run(
        f"""
import jax, jaxurban
print(folder := jax.config.values["jax_compilation_cache_dir"])
{code}
print(jaxurban.keep_programs())
print(jax.config.values["jax_compilation_cache_dir"])
print(jax.config.values["jax_persistent_cache_min_compile_time_secs"])
""",
        **environment,
    )
    assert said == ""
    return lines


@pytest.mark.slow
def test_the_call_keeps_programs_where_nothing_else_is_chosen(tmp_path):
    cache, other = {"XDG_CACHE_HOME": tmp_path}, str(tmp_path / "other")
    chosen = {FOLDER: other, programs.LEAST_S: 3}
    assert settings(**cache, **chosen) == [other, other, other, "3.0"]
    choose = f"jax.config.update('jax_compilation_cache_dir', {other!r})"
    assert settings(choose, **cache) == ["None", other, other, "0.0"]
    assert not (tmp_path / "jaxurban").exists()
    before, *folders, least_s = settings(**cache)
    assert (before, least_s) == ("None", "0.0")
    assert len(set(folders)) == 1
    assert re.fullmatch(r"xla-[0-9a-f]{16}", Path(folders[0]).name)
    assert Path(folders[0]).parent == tmp_path / "jaxurban"
    assert Path(folders[0]).stat().st_mode & 0o77 == 0


@pytest.mark.slow
def test_where_no_folder_can_be_made_every_process_compiles(tmp_path):
    (tmp_path / "file").write_text("letters")
    for cache in (tmp_path / "file", "/proc/nowhere"):
        assert settings(XDG_CACHE_HOME=cache) == ["None", "None", "None", "0.0"]


CPUINFO = """processor\t: 0
model\t\t: 2
cpu MHz\t\t: 2596.124
flags\t\t: fpu sse sse2 avx

processor\t: 1
model\t\t: 2
cpu MHz\t\t: 3100.000
flags\t\t: fpu sse sse2 avx
"""
ARM = "processor\t: 0\nFeatures\t: fp asimd sve\nCPU part\t: 0xd40\n"


def test_each_processor_and_jaxlib_has_a_folder_of_its_own(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(programs, "CPUINFO", tmp_path / "cpuinfo")

    def folder(cpuinfo: str) -> Path | None:
        (tmp_path / "cpuinfo").write_text(cpuinfo)
        return programs._own_folder()

    mine = folder(CPUINFO)
    assert folder(CPUINFO.replace("3100.000", "1200.000")) == mine
    others = [CPUINFO.replace(" avx", " avx avx512f"), CPUINFO.replace(": 2", ": 17"), ARM]
    others += [ARM.replace(" sve", ""), ARM.replace("0xd40", "0xd41")]
    folders = {mine, *map(folder, others)}
    monkeypatch.setattr(programs, "version", lambda name: "0.0.1")
    folders.add(folder(CPUINFO))
    (tmp_path / "cpuinfo").unlink()
    for machine in ("arm64", "AMD64"):
        monkeypatch.setattr(platform, "machine", lambda machine=machine: machine)
        folders.add(programs._own_folder())
    assert len(folders - {None}) == 9


def test_a_program_by_zstandard_is_whole_only_to_its_end():
    """JAX takes it where Python has it, and zlib elsewhere."""
    from numcodecs.zstd import Zstd

    whole = Zstd().encode(bytes(range(256)) * 40)
    assert programs._is_whole(whole)
    assert not programs._is_whole(whole[:-1])


def test_a_program_is_read_at_the_check_after_it_changed_and_for_an_hour(monkeypatch, tmp_path):
    read: list[bytes] = []
    monkeypatch.setattr(programs, "_is_whole", lambda program: read.append(program) or True)
    ages_s = {"old": 2 * programs.SETTLED_S, "new": 0.0}

    def checked() -> list[bytes]:
        read.clear()
        programs._drop_damaged(tmp_path)
        return sorted(read)

    for name, age_s in ages_s.items():
        file = tmp_path / f"{name}-cache"
        file.write_bytes(name.encode())
        os.utime(file, (time.time() - age_s,) * 2)
    assert checked() == [b"new", b"old"]
    assert checked() == [b"new"]
    (tmp_path / "old-cache").write_bytes(b"cut")
    assert checked() == [b"cut", b"new"]


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
            [*command, "--workers", "2", "--set", 'region.engine="jax"'],
            env=inherited | caches | {"PYTHONPATH": str(Path(ju.__file__).parents[1])},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 0, ended.stderr
        lines.append(ended.stderr.count(programs.SENTENCE))
        files.append({*tmp_path.glob("jaxurban/xla-*/*")})
    assert 1 <= lines[0] <= 2  # the command's own process, and one worker for all
    assert lines[1] == 0
    assert len({file.parent for file in files[0]}) == 1
    assert files[0] == files[1]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
def test_a_folder_that_others_may_write_to_is_not_used_and_that_is_said_once(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches" / "mine"))
    folder = programs._own_folder()
    assert programs._is_writable(folder)
    for made in (folder, *folder.parents[:3]):
        assert made.stat().st_mode & 0o77 == 0
    for mode, is_ours in {0o755: True, 0o777: False, 0o770: False, 0o702: False}.items():
        folder.chmod(mode)
        programs._is_ours.cache_clear()
        with logged() as lines:
            assert [programs._is_ours(folder), programs._is_ours(folder)] == [is_ours] * 2
        assert ["chmod 700" in line for line in lines] == [True] * (not is_ours)
