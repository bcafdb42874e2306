"""Compiled programs: kept for the user's later sessions, and the one line that says that something is compiled."""

import functools
import hashlib
import os
import pickle
import tempfile
from collections.abc import Callable, Hashable
from importlib.metadata import version
from pathlib import Path
from threading import RLock
from time import perf_counter
from typing import Any

import numpy as np

from jaxurban.kept_folders import cache_home, closed_folder, or_compile, read_kept, sweep_unused
from jaxurban.progress import BRIEF_S, LOG

# Its level is the switch: warnings are seen where nobody has set logging up.
COMPILING = LOG.getChild("compiling")
# On two cores the commands `maps` (four altitudes of Lower Manhattan by JAX) and `plan` took so much longer with empty
# caches than with full ones.
SENTENCE = (
    "jaxurban compiles what this machine runs for the first time: about 8 s for first maps, up to 5 s for the first "
    "route of a planner"
)
ON_HOST = np.ndarray, np.generic  # types of values
NUM_OWN = 2  # folders: jaxurban/programs
DIGEST_BYTES = hashlib.sha256().digest_size


def kept_jit(function: Callable[..., Any], **options: Any) -> Any:
    """Return `jax.jit` of a function whose compiled programs are kept on disk for the user's later sessions.

    What an earlier session has compiled is loaded, without tracing the function again. JAX's configuration stays as it
    is. A program is loaded only by the versions, source files and settings, on the kind of processor and device, and
    for the types, shapes and static arguments that it was compiled for. While JAX traces, for arrays that the user has
    put on another device than JAX's default, and where the user has given JAX a cache of its own
    (``JAX_COMPILATION_CACHE_DIR``), the function is that of `jax.jit`.

    Programs lie in ``$XDG_CACHE_HOME/jaxurban/programs`` (``~/.cache`` without an absolute one). As loading one can run
    code, only this user and root may be able to write to the file or to exchange it (`closed_folder`, `read_kept`), and
    the file must be as it was written. Otherwise the program is compiled.

    Args:
      function: of arrays and pytrees of them. It depends on nothing but its arguments and the package's source.
      options: of `jax.jit`; static arguments are given by keyword, and ``static_argnames`` is a tuple.
    """
    import jax

    config: Any = jax.config
    jitted = jax.jit(function, **options)
    static_names = options.get("static_argnames", ())
    programs: dict[Hashable, Callable] = {}
    lock = RLock()  # threads wait for a program that one of them compiles

    def kind_of(leaf: Any) -> Any:
        """Return what of an array or a number decides a program; None where JAX traces it, or somebody placed it."""
        if isinstance(leaf, ON_HOST):
            return leaf.shape, leaf.dtype, False
        if not isinstance(leaf, jax.Array):
            return type(leaf)
        if isinstance(leaf, jax.core.Tracer) or leaf.devices() != {jax.devices()[0]}:
            return None
        return leaf.shape, leaf.dtype, leaf.weak_type

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        """Return what the program for these arguments computes."""
        static = {name: kwargs.pop(name) for name in static_names if name in kwargs}
        leaves, tree = jax.tree.flatten((args, kwargs))
        is_chosen = config.jax_disable_jit or config.jax_default_device is not None
        # What JAX has loaded from its own cache lacks parts when it is written once more.
        is_chosen |= config.jax_compilation_cache_dir is not None
        kinds = [*map(kind_of, leaves)]
        if is_chosen or None in kinds:
            return jitted(*args, **kwargs, **static)

        own = config.jax_enable_x64, config.jax_default_matmul_precision
        signature = own, tree, *static.items(), *kinds
        with lock:
            program = programs.get(signature)
            if program is None:
                lower = functools.partial(jitted.lower, *args, **kwargs, **static)
                program = programs[signature] = _program(function, signature, lower)
        return program(*args, **kwargs)

    kept: Any = call  # with what tests and benchmarks ask of it
    kept.lower, kept.trace = jitted.lower, jitted.trace
    kept.programs = programs
    return kept


def _program(function: Callable, signature: Hashable, lower: Callable[[], Any]) -> Any:
    """Return the program of a function: the kept one, else one compiled now and kept.

    Args:
      function: it is part of the key by its name.
      signature: what decides the program besides the function, the package and the machine.
      lower: returns the traced function, to be compiled.
    """
    file = program = None
    with or_compile():
        file = _file_of(function.__module__, function.__qualname__, signature)
        program = _loaded(file)
    if program is None:
        start_s = perf_counter()
        program = lower().compile()
        if perf_counter() - start_s > BRIEF_S:
            say_compiling()
        with or_compile():
            if file is not None:
                _keep(program, file)
    return program


@functools.cache
def say_compiling() -> None:
    """Say in the log, once, that something is compiled."""
    COMPILING.warning(SENTENCE)


def _file_of(*key: Any) -> Path:
    """Return the file of a program with a key of its own in this session, which need not exist.

    Raises one of `UNUSABLE` where the user has no home, or the key cannot be packed.
    """
    packed = pickle.dumps((key, _session()))
    return cache_home() / "jaxurban" / "programs" / hashlib.sha256(packed).hexdigest()


@functools.cache
def _session() -> str:
    """Return what decides programs in all of this process: versions, sources, settings of JAX, device, processor."""
    import jax
    from llvmlite import binding

    root = Path(__file__).parent
    source = hashlib.sha256()
    for file in sorted([*root.glob("*.py"), *root.glob("*/**/*.py")]):
        source.update(file.read_bytes())
    device = jax.devices()[0]
    facts = [version("jax"), version("jaxlib"), source.hexdigest(), os.environ.get("XLA_FLAGS")]
    facts += [device.platform, device.device_kind]
    facts += [binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()]
    return repr((facts, sorted(jax.config.values.items())))


def _loaded(file: Path) -> Any:
    """Return the program in a file, marked as used now; None where it is not as it was written.

    Raises one of `UNUSABLE` where others may have written it, there is none, or it is none for this machine.
    """
    import jax
    from jax.experimental.serialize_executable import deserialize_and_load

    closed_folder(file.parent, NUM_OWN)
    content = read_kept(file)
    entry = content[DIGEST_BYTES:]
    if _digest(file, entry) != content[:DIGEST_BYTES]:
        return None
    payload, in_tree, out_tree = pickle.loads(entry)
    devices = jax.devices()[:1]
    return deserialize_and_load(payload, in_tree, out_tree, execution_devices=devices)


def _keep(program: Any, file: Path) -> None:
    """Write a program into its file, by way of another one beside it, and sweep the folder.

    Raises one of `UNUSABLE` where that cannot be done, or others may write to the folder.
    """
    from jax.experimental.serialize_executable import serialize

    entry = pickle.dumps(serialize(program))
    folder = closed_folder(file.parent, NUM_OWN)
    descriptor, beside = tempfile.mkstemp(dir=folder)  # others can neither read nor write it
    try:
        with open(descriptor, "wb") as stream:
            stream.write(_digest(file, entry) + entry)
        os.replace(beside, file)
    except OSError:
        os.remove(beside)
    sweep_unused(folder)


def _digest(file: Path, entry: bytes) -> bytes:
    """Return the hash that a program's entry follows in its file: of the key too, as files can change their names."""
    return hashlib.sha256(file.name.encode() + entry).digest()
