"""The notebooks as they are stored: text, without output, one question each (`make notebooks` runs them)."""

import re
from pathlib import Path

import jupytext
import pytest

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*.py"))


def test_notebooks_are_numbered_and_listed_in_their_order():
    assert [int(path.name.split("_")[0]) for path in NOTEBOOKS] == list(range(1, 10))
    assert re.findall(r"\((\d\w+\.py)\)", (FOLDER / "README.md").read_text()) == [path.name for path in NOTEBOOKS]
    assert not list(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_paired_text_and_asks_one_question_first(path):
    notebook = jupytext.read(path)
    assert notebook.metadata["jupytext"]["formats"] == "ipynb,py:percent"
    title, question = (line for line in notebook.cells[0].source.splitlines()[:3] if line)
    assert title.startswith(f"# {path.name[0]}. ")
    assert re.fullmatch(r"\*\*.+\?\*\*", question)
    assert question.strip("*") in (FOLDER / "README.md").read_text()
    asked = [cell.source for cell in notebook.cells if cell.source.startswith("## A question to try\n")]
    assert asked == [notebook.cells[-1].source]
    assert "?" in asked[0]
