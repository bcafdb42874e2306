"""Every test is run by something: by `make test`, by `make test-slow`, or on a machine with a GPU."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
OPTIONS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]


def pytest_arguments(target: str) -> str:
    """Return what a target of the Makefile passes to pytest."""
    recipe = re.search(rf"^{target}:[^\n]*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe
    return recipe[1].replace("\\\n", " ").split("-m pytest", 1)[1].strip()


def test_the_marker_slow_alone_parts_the_tests_that_make_test_runs_from_those_of_make_test_slow():
    assert "-m 'not slow and not gpu'" in OPTIONS["addopts"]
    assert {marker.split(":")[0] for marker in OPTIONS["markers"]} == {"slow", "gpu", "data"}
    assert pytest_arguments("test") == "-n 2 --dist loadfile"
    assert pytest_arguments("test-newest") == "-n 2 --dist loadfile; fi"
    assert pytest_arguments("test-slow") == "-n 2 --dist loadfile -m slow"


def test_the_checks_before_a_landing_run_both():
    called = re.findall(r"^make (\S+)$", (ROOT / ".ci/run").read_text(), re.MULTILINE)
    assert {"test", "test-slow"} <= set(called)


def test_no_test_is_where_pytest_does_not_look():
    known = ("tests", "build", "out")
    others = [path for path in ROOT.iterdir() if not path.match(".venv*") and path.name not in known]
    assert OPTIONS["testpaths"] == ["tests"]
    assert [file for path in others for file in (path, *path.rglob("*")) if file.match("test_*.py")] == []
    names = [path for path in (ROOT / "tests").rglob("*.py") if "\ndef test_" in path.read_text(encoding="utf-8")]
    assert [path.name for path in names if not path.name.startswith("test_")] == []
