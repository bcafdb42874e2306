"""Where JAX keeps compiled programs between sessions, for users who have chosen nothing themselves."""

import os
import sys
from pathlib import Path

from jaxurban.progress import LOG

FOLDER = "jax_compilation_cache_dir"
LEAST_COMPILE_S = "jax_persistent_cache_min_compile_time_secs"


def keep_programs(quiet: bool = False) -> Path | None:
    """Let JAX keep every compiled program in the user's cache folder, and return the folder; the log tells of it.

    None, and nothing is set, where the user has chosen (a folder, in ``jax.config`` or the environment, or no cache at
    all), where this was done before, and where that folder cannot be written. Does not import JAX: where that is not
    there yet, and in processes that this one starts, the environment says the same.

    Args:
      quiet: tell nothing.
    """
    folder = None if _has_chosen() else _writable_folder()
    if folder is None:
        return None
    settings = {FOLDER: str(folder), LEAST_COMPILE_S: 0.0}  # of the maps' programs most compile within JAX's second
    for name, value in settings.items():
        if "jax" in sys.modules:
            sys.modules["jax"].config.update(name, value)
        else:
            os.environ[name.upper()] = str(value)
    if not quiet:
        LOG.info("compiled programs are kept in %s, for later sessions; %s chooses another", folder, FOLDER.upper())
    return folder


def has_programs() -> bool:
    """Return whether compiled programs of earlier sessions are at hand."""
    folder = sys.modules["jax"].config.jax_compilation_cache_dir if "jax" in sys.modules else _folder_named()
    return folder is not None and any(Path(folder).glob("*-cache"))


def _folder_named() -> str | None:
    return os.environ.get(FOLDER.upper())


def _has_chosen() -> bool:
    if _folder_named():
        return True
    config = sys.modules["jax"].config if "jax" in sys.modules else None
    return config is not None and bool(config.jax_compilation_cache_dir or not config.jax_enable_compilation_cache)


def _writable_folder() -> Path | None:
    """Return the folder under the user's cache folder, made; None without a home, or where it cannot be written."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxurban" / "jax"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None
