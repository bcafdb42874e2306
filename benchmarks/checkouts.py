"""Runs a script on the jaxurban of another checkout, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

from benchmarks.common import ROOT

SCRIPTS = ROOT / "benchmarks"
XLA_CACHE = ROOT / "out" / "compiled"  # of all checkouts: JAX finds programs in it by what they compute


def environment_of(checkout: Path, caches: Path) -> dict[str, str]:
    """Return the environment in which a process takes a checkout's jaxurban; what is compiled is kept in ``caches``."""
    caches = caches.resolve()
    caches.mkdir(parents=True, exist_ok=True)
    # Else every process would compile all libraries to bytecode again: the prefix hides what lies beside them.
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return inherited | {
        "PYTHONPATH": str(checkout.resolve()),
        "PYTHONPYCACHEPREFIX": str(caches / "python"),
        "NUMBA_CACHE_DIR": str(caches / "numba"),
        "JAX_COMPILATION_CACHE_DIR": str(XLA_CACHE),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }


def start(checkout: Path, script: str, *words: object, caches: Path) -> subprocess.Popen[str]:
    """Return a started process that runs a script of this folder on a checkout's jaxurban, by this interpreter.

    What Numba and Python compile is kept in ``caches``, not in the checkout, which stays as it is. Give each checkout,
    and each state of its files, a folder of its own: Numba does not see a change in another file than that of a
    compiled function.

    Args:
      checkout: the folder that holds the package.
      script: file name; it imports nothing of this folder.
      words: its arguments.
      caches: made where it is not there.
    """
    environment = environment_of(checkout, caches)
    # -P: names of this folder's files must not hide installed modules.
    command = [sys.executable, "-P", str(SCRIPTS / script), str(checkout.resolve()), *map(str, words)]
    return subprocess.Popen(command, cwd=caches.resolve(), env=environment, stdout=subprocess.PIPE, text=True)


def output_of(process: subprocess.Popen[str]) -> str:
    """Return what a started process prints.

    Raises:
      SystemExit: it failed.
    """
    printed, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"failed with code {process.returncode}: {' '.join(map(str, process.args))}")
    return printed
