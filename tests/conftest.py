"""Shared fixtures: where the real data lie."""

import logging
import os
from pathlib import Path

import pytest
from hypothesis import settings

# What JAX compiles is kept between runs, and one worker has what another one compiled: three quarters of the time.
PROGRAMS = Path(__file__).parents[1] / ".pytest_cache" / "programs"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(PROGRAMS))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# A warning of deprecation fails in the commands and workers that tests start, too.
DEPRECATIONS = ("DeprecationWarning", "PendingDeprecationWarning", "FutureWarning")
os.environ.setdefault("PYTHONWARNINGS", ",".join(f"error::{kind}" for kind in DEPRECATIONS))

# Which test compiles first on a fresh machine says nothing of what it tests.
logging.getLogger("jaxurban.compiling").disabled = True

settings.register_profile("shared-machine", deadline=None)  # a busy machine is no failure
settings.load_profile("shared-machine")

DATA = Path(os.environ.get("JAXURBAN_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real data files; the test is skipped where it is missing."""
    if not DATA.is_dir():
        pytest.skip(f"real data not found at {DATA}: set JAXURBAN_DATA")
    return DATA
