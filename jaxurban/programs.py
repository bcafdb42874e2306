"""Compiled programs: where JAX keeps them between processes, and the one line that says that something is compiled."""

import functools
import hashlib
import os
import platform
import stat
import warnings
import zlib
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from jaxurban.progress import BRIEF_S, LOG

# Its level is the switch: warnings are seen where nobody has set logging up.
COMPILING = LOG.getChild("compiling")
# On two cores the commands `maps` (four altitudes of Lower Manhattan by JAX) and `plan` took so much longer with empty
# caches than with full ones.
SENTENCE = (
    "jaxurban compiles what this machine runs for the first time: about 8 s for first maps, up to 5 s for the first "
    "route of a planner"
)
LEAST_S = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"  # of a program that is kept
# Events of `jax.monitoring`. The second one ends both what was compiled and what was loaded.
LOADED = "/jax/compilation_cache/cache_hits"
ENDED = "/jax/core/compile/backend_compile_duration"
UNREADABLE = "Error (reading|writing) persistent compilation cache entry"  # JAX then compiles
CPUINFO = Path("/proc/cpuinfo")  # of Linux alone
ZSTANDARD = b"\x28\xb5\x2f\xfd"  # how files begin that JAX compresses by it; others are zlib's
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
CHECKED = "checked"  # a file as old as the last check of the programs
SETTLED_S = 3600.0  # by then what was written is on the disk, or lost with the power
FEATURES = {  # in /proc/cpuinfo: what the choice of instructions depends on
    "vendor_id",
    "cpu family",
    "model",
    "flags",
    "CPU implementer",
    "CPU part",
    "Features",
    "isa",
}


def keep_programs() -> Path | None:
    """Keep what JAX compiles in the user's cache folder and load it from there, as commands do.

    Call it once, before the first maps. It turns on JAX's persistent compilation cache in this process, for programs
    of any compile time, in ``$XDG_CACHE_HOME/jaxurban/xla-HASH`` (``~/.cache`` where the variable is not set). Homes
    are shared between machines and machine code is not: the hash is of jaxlib's version and the processor's features.
    A folder that ``JAX_COMPILATION_CACHE_DIR`` or `jax.config` names is used instead. Worker processes that this one
    starts keep their programs likewise. Files of our own folder that are damaged are removed without a word. The log
    says once when JAX compiles, as it does in any case when Numba does.

    Returns:
      The folder in use; None where none can be written, so that every process compiles.

    Examples:
      >>> folder = ju.keep_programs()  # at the top of a notebook
      >>> maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,))
    """
    import jax

    _listen()

    # Our own folder, unless the user has named one; programs of any compile time, unless the user has said from which.
    own = _own_folder()
    if own and not _folder_in_use() and _is_writable(own) and _is_ours(own):
        jax.config.update("jax_compilation_cache_dir", str(own))
    if LEAST_S not in os.environ:
        jax.config.update(LEAST_S.lower(), 0.0)

    if own and own == _folder_in_use():
        pass_over_unreadable()
        _drop_damaged(own)
    return _folder_in_use()


def keeps_programs() -> bool:
    """Return whether JAX keeps what it compiles in this process."""
    return _folder_in_use() is not None


def pass_over_unreadable() -> None:
    """Hide warnings on files of our own folder that JAX cannot read or write: it works without them."""
    if keeps_programs() and _folder_in_use() == _own_folder():
        warnings.filterwarnings("ignore", UNREADABLE, UserWarning)


def _folder_in_use() -> Path | None:
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    return Path(folder) if folder else None


@functools.cache
def say_compiling() -> None:
    """Say in the log, once, that something is compiled."""
    COMPILING.warning(SENTENCE)


def _own_folder() -> Path | None:
    """Return the folder for programs of this processor, which need not exist yet; None where the user has no home."""
    try:
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:
        return None
    machine = f"{version('jaxlib')} {_processor()}".encode()
    return caches / "jaxurban" / f"xla-{hashlib.sha256(machine).hexdigest()[:16]}"


def _is_writable(folder: Path) -> bool:
    """Return whether files can be written into a folder, which is made where it is missing."""
    with suppress(OSError):
        for place in (*reversed(folder.parents), folder):
            place.mkdir(mode=0o700, exist_ok=True)  # who writes there runs code here
    return os.access(folder, os.W_OK | os.X_OK)


@functools.cache
def _is_ours(folder: Path) -> bool:
    """Return whether nobody else may write into a folder, and so put programs there; else the log says so, once."""
    status = folder.stat()
    is_ours = os.name == "nt" or (
        status.st_uid == os.getuid() and not status.st_mode & OTHERS_WRITE
    )
    if not is_ours:
        LOG.warning(
            f"programs are not kept in {str(folder)!r}, where others may write and so run code here: remove it, or "
            "take their right to write (chmod 700)"
        )
    return is_ours


def _processor() -> str:
    """Return a text that is the same for all processors with the same instructions, and differs for others.

    Linux lists the instructions; elsewhere the name of the processor has to do.
    """
    try:
        lines = CPUINFO.read_text(encoding="utf-8").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"

    # One line for each feature, however many cores list it.
    features = {line for line in lines if line.partition("\t")[0] in FEATURES}
    return "\n".join([platform.machine(), *sorted(features)])


def _drop_damaged(folder: Path) -> None:
    """Remove programs that were not written to their end, or changed since: JAX would never write them again.

    Only programs that were written since the last check, or shortly before it, are read: reading 1,600 of them takes
    0.2 s, and more where homes are on a network. The time of the empty file `CHECKED` is that of the last check.
    """
    # The time of the last check, in seconds since 1970, as times of files are; 0 where there was none.
    mark = folder / CHECKED
    since_s = 0.0
    with suppress(OSError):  # there was no check yet, or the disk is full
        since_s = mark.stat().st_mtime - SETTLED_S
    with suppress(OSError):
        mark.touch()  # before the check, so that the next one reads what is written meanwhile

    # The programs since then.
    for file in folder.glob("*-cache"):
        with suppress(OSError):  # another process has removed the file
            if file.stat().st_mtime >= since_s and not _is_whole(file.read_bytes()):
                file.unlink()


def _is_whole(program: bytes) -> bool:
    """Return whether a compressed program can be unpacked to its end; zlib's files have a checksum too."""
    try:
        if program.startswith(ZSTANDARD):
            from numcodecs.zstd import Zstd

            Zstd().decode(program)
        else:
            zlib.decompress(program)
    except (zlib.error, RuntimeError):
        return False
    return True


@functools.cache
def _listen() -> None:
    """Listen to JAX from now on, and say in the log once it has compiled for longer than `BRIEF_S` in all.

    JAX reports the end of a program alike, whether it compiled or loaded the program. Before the end of a loaded one it
    also reports the loading, so the next end after a loading does not count.
    """
    from jax import monitoring

    num_loaded = 0  # programs whose end is still to be reported
    compiled_s = 0.0

    def on_event(event: str, **_: str | int) -> None:
        """Count a program that JAX loaded."""
        nonlocal num_loaded
        if event == LOADED:
            num_loaded += 1

    def on_duration(event: str, duration_secs: float, **_: str | int) -> None:
        """Add the seconds of a program that JAX compiled, and say so once they are more than `BRIEF_S` in all."""
        nonlocal num_loaded, compiled_s
        if event != ENDED:
            return
        if num_loaded:
            num_loaded -= 1
            return
        compiled_s += duration_secs
        if compiled_s > BRIEF_S:
            say_compiling()

    monitoring.register_event_listener(on_event)
    monitoring.register_event_duration_secs_listener(on_duration)
