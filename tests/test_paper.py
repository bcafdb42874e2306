"""The paper has the form that JOSS asks for, and each of its numbers has a command that gives it."""

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest
import yaml

from jaxurban.cli.main import app
from tests.cli_runs import run

ROOT = Path(__file__).parents[1]
PAPER = ROOT / "paper"
_, HEADER, BODY = (PAPER / "paper.md").read_text(encoding="utf-8").split("---\n", 2)
SECTIONS = """Summary, Statement of need, State of the field, Software design, Research impact statement, Validation,
Limits, AI usage disclosure, Acknowledgements, References"""
TABLE = re.findall(r"^\|.+", (PAPER / "numbers.md").read_text(encoding="utf-8"), re.MULTILINE)
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")] for line in TABLE[2:]
]  # number, meaning, command, source


def test_the_header_and_the_sections_are_those_of_a_joss_paper():
    header = yaml.safe_load(HEADER)
    assert header.keys() >= {"title", "tags", "authors", "affiliations", "date", "bibliography"}
    known = {place["index"] for place in header["affiliations"]}
    assert {author["affiliation"] for author in header["authors"]} <= known
    assert re.findall(r"^# (.+)$", BODY, re.MULTILINE) == re.split(r",\s+", SECTIONS)


def test_the_body_has_at_most_1000_words():
    assert len(BODY.split()) <= 1000


def test_what_is_cited_has_an_entry_and_each_entry_is_cited():
    entries = re.findall(
        r"^@\w+\{(\w+),", (PAPER / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(entries) == len(set(entries))
    assert set(re.findall(r"@(\w+)", BODY)) == set(entries)


def test_each_entry_says_where_it_is():
    for entry in re.split(
        r"^@", (PAPER / "paper.bib").read_text(encoding="utf-8"), flags=re.MULTILINE
    )[1:]:
        assert re.search(r"^  (doi|url) = ", entry, re.MULTILINE), entry


def test_the_picture_is_there():
    (picture,) = re.findall(r"!\[[^]]+\]\(([^)]+)\)", BODY)
    assert (PAPER / picture).is_file()


def test_each_number_of_the_paper_has_a_row_and_each_row_is_in_the_paper():
    text = re.sub(r"@\w+|\]\([^)]*\)|^\d\. |`[^`]*`|pyastar2d", "", BODY, flags=re.MULTILINE)
    listed = [number for row in ROWS for number in re.findall(r"[\d.]+(?:e-?\d+)?", row[0])]
    assert set(re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", text)) == set(listed)


def test_each_row_has_a_command_and_each_command_names_what_exists():
    targets = re.findall(
        r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    for *_, cell, _ in ROWS:
        commands = re.findall(r"`([^`]+)`", cell)
        assert commands or cell == "the same"
        for command in commands:
            match command.split():
                case ["python", "-m", "pytest", file, *_]:
                    assert (ROOT / file).is_file()
                case ["python", "-m", "figures", part]:
                    assert [*(ROOT / "figures").rglob(f"{part}.py")]
                case ["python", "-m", module, *_]:
                    assert (ROOT / module.replace(".", "/")).with_suffix(".py").is_file()
                case ["jaxurban", name, *_]:
                    assert name in app.commands
                case _:
                    assert command.removeprefix("make ") in targets


@pytest.mark.slow
def test_the_command_of_the_receivers_numbers_gives_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (at,) = (k for k, row in enumerate(ROWS) if "jaxurban validate" in row[2])
    (command,) = re.findall(r"`jaxurban ([^`]+)`", ROWS[at][2])
    code, _, err = run(capsys, *shlex.split(command))
    assert code == 0, err
    scores = pd.read_csv(tmp_path / "out/sky/tables/scores.csv").set_index("which").loc["all"]
    for row, name in ((ROWS[at], "auc"), (ROWS[at + 1], "within")):
        given = [scores[f"{name}{end}"] for end in ("", "_low", "_high")]
        assert row[0] == ", ".join(f"{value:.2f}" for value in given)
