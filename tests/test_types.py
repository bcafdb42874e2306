"""What type checkers report of users' scripts: no error in a right one, and the mistakes of wrong_calls.py."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mypy import api

from tests.test_docs import NOTEBOOKS, PAGES, blocks_of, name_of

HERE = Path(__file__).parent
WRONG = HERE / "wrong_calls.py"
NUM_WRONG, LEAST_FOUND = 36, 35
RELAXED = "\n# mypy: allow-untyped-defs, allow-untyped-calls\n"  # a reader's functions have no annotations
Errors = dict[tuple[str, int], str]  # messages by the name of the script and the line

pytestmark = pytest.mark.slow


def script_of(page: Path) -> str:
    """Return the Python blocks of a page as one script, each at the lines where the page has it."""
    script = ""
    for block in blocks_of(page):
        if block.language == "python":
            script += "\n" * (block.line - 1 - script.count("\n")) + block.text
    return script


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder of scripts: of pages, of notebooks, a stranger's, and the wrong calls."""
    folder = tmp_path_factory.mktemp("scripts")
    for page in PAGES:
        if script := script_of(page):
            name = name_of(page).removesuffix(".md").replace("/", "_")
            (folder / f"{name}.py").write_text(script + RELAXED, encoding="utf-8")
    for path in NOTEBOOKS:
        script = path.read_text(encoding="utf-8")
        (folder / f"notebook_{path.name}").write_text(script + RELAXED, encoding="utf-8")
    for path in (HERE / "typed_user.py", WRONG):
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def errors_of_mypy(folder: Path) -> Errors:
    cache = folder.with_name("mypy_cache")
    options = ["--strict", "--ignore-missing-imports", "--config-file", "", "--output", "json"]
    output, fault, _ = api.run([*options, "--cache-dir", str(cache), str(folder)])
    assert not fault
    reports = [json.loads(line) for line in output.splitlines()]
    return {
        (Path(report["file"]).name, report["line"]): report["message"]
        for report in reports
        if report["severity"] == "error"
    }


def errors_of_basedpyright(folder: Path) -> Errors:
    """Return the errors of its mode "standard", which reports types, and no style as its default does."""
    config = folder.with_name("pyrightconfig.json")
    config.write_text(json.dumps({"include": [str(folder)], "typeCheckingMode": "standard"}))
    command = [sys.executable, "-m", "basedpyright", "--project", str(config), "--outputjson"]
    ran = subprocess.run(
        [*command, "--pythonpath", sys.executable],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.stdout, ran.stderr
    output = json.loads(ran.stdout)
    assert output["summary"]["filesAnalyzed"] == len([*folder.iterdir()])
    return {
        (Path(report["file"]).name, report["range"]["start"]["line"] + 1): report["message"]
        for report in output["generalDiagnostics"]
        if report["severity"] == "error"
    }


@pytest.fixture(scope="module", params=[errors_of_mypy, errors_of_basedpyright])
def errors(request, folder) -> Errors:
    return request.param(folder)


def test_wrong_calls_are_reported_at_their_lines(errors):
    lines = WRONG.read_text(encoding="utf-8").splitlines()
    wrong = {number for number, line in enumerate(lines, 1) if "  # wrong: " in line}
    found = {line for name, line in errors if name == WRONG.name}
    assert len(wrong) == NUM_WRONG
    assert found <= wrong
    missed = [lines[number - 1] for number in sorted(wrong - found)]
    assert len(missed) <= NUM_WRONG - LEAST_FOUND, missed


def test_what_pages_and_notebooks_show_has_the_types_that_we_ask_for(errors, folder):
    names = {path.name for path in folder.iterdir()}
    assert {"README.py", "docs_tutorial.py", "docs_guides_plan.py", "typed_user.py"} <= names
    assert not {place: errors[place] for place in errors if place[0] != WRONG.name}
