"""Shared fixtures: where the real data lie."""

import logging
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

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

# Scenes that tests of several folders share.
pytest_plugins = ["tests.scenes"]

DATA = Path(os.environ.get("JAXURBAN_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real data files; the test is skipped where it is missing."""
    if not DATA.is_dir():
        pytest.skip(f"real data not found at {DATA}: set JAXURBAN_DATA")
    return DATA


@pytest.fixture(scope="module")
def blank_pictures() -> Iterator[None]:
    """Reports have a small blank figure in the place of each picture: for tests of files, not of pictures."""
    from matplotlib.figure import Figure

    from jaxurban.draw import write

    save = write.save

    def save_blank(folder: str | Path, outputs: write.Outputs) -> list[Path]:
        blank = {
            name: (lambda: Figure((1.0, 1.0))) if name.endswith(write.PICTURES) else output
            for name, output in outputs.items()
        }
        return save(folder, blank)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(write, "save", save_blank)
        yield


@pytest.fixture
def laid_out() -> None:
    """What a quick test asks for that looks where the parts of a picture stand, beside `without_layout`."""


@pytest.fixture
def without_layout(request: pytest.FixtureRequest) -> Iterator[None]:
    """Pictures are not laid out, which is most of their time; in slow tests, and in those with `laid_out`, they are."""
    if "laid_out" in request.fixturenames or request.node.get_closest_marker("slow"):
        yield
    else:
        with patch("matplotlib.layout_engine.ConstrainedLayoutEngine.execute"):
            yield


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--every", type=int, default=1, help="run one test in so many of each file")


@pytest.hookimpl(trylast=True)  # after those of other marks are left out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep one test in so many of each file, its first among them, where ``--every`` says so."""
    num_before: Counter[Path] = Counter()
    kept, left_out = [], []
    for item in items:
        is_kept = num_before[item.path] % config.option.every == 0
        (kept if is_kept else left_out).append(item)
        num_before[item.path] += 1
    if left_out:
        items[:] = kept
        config.hook.pytest_deselected(items=left_out)


def pytest_configure(config: pytest.Config) -> None:
    """Compile what most tests run before the workers of a first run start."""
    if getattr(config.option, "numprocesses", None) and not PROGRAMS.is_dir():
        command = [sys.executable, "-m", "tests.compile_first"]
        for each in [
            subprocess.Popen([*command, part], cwd=PROGRAMS.parents[1])
            for part in ("maps", "paths")
        ]:
            each.wait()
