"""Every code block of README and docs does what it says; notebooks are stored as text (`make notebooks` runs them).

The blocks of a page run in order, in one folder and one Python namespace. The folder holds what pages take for
granted: a small `scenario.toml` of the synthetic city over Lower Manhattan's bounds, its maps in `out/manhattan`, and
files of zones, outlines, blocks and routes made here.
"""

import ast
import itertools
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import geopandas as gpd
import jupytext
import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.cli.main import app
from jaxurban.exit_codes import ExitCode
from jaxurban.maps.scenario import Scenario
from jaxurban.public import NAMESPACES, PICTURES, TYPES
from jaxurban.settings import Planning
from jaxurban.terminal.common import GIVEN, MAPS_PATH
from tests.cli_runs import run
from tests.io.test_ephemerides import yuma_of

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*.py"), key=lambda path: int(path.name.split("_")[0]))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^( *)```([\w-]*)[^\n]*\n(.*?)^\1```[ \t]*$", re.MULTILINE | re.DOTALL)

# What asks servers, serves until somebody ends it, takes several cities, machines, minutes or a log of the reader's, or
# has a test of its own.
ONLY_PARSED = re.compile(
    r"fetch (?!.*--dry-run)|view (?!.*--export)|demo\b|.*--cluster|sky .*--by-satellite"
)

SCENARIO = """
[region]
bounds = [-74.02, 40.70, -73.98, 40.73]
resolution_m = 25.0
altitudes_m = [20, 60, 122]
[buildings]
source = "synthetic"
[study]
instances = 2
planners = ["ptp", "astar-plus"]
budget_s = 0.5
"""


@dataclass(frozen=True)
class Block:
    """One fenced block: its language, its text without indent, and the line of the page on which the text begins."""

    language: str
    text: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    lines = [text.count("\n", 0, found.start(3)) + 1 for found in BLOCK.finditer(text)]
    return [
        Block(found[1], textwrap.dedent(found[2]), n)
        for found, n in zip(BLOCK.findall(text), lines, strict=True)
    ]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.fixture(scope="module")
def prepared(tmp_path_factory) -> Path:
    """The folder that pages start from."""
    folder = tmp_path_factory.mktemp("docs")
    (folder / "town").mkdir()
    for name in ("scenario.toml", "town/scenario.toml"):
        (folder / name).write_text(SCENARIO, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        app.main(["maps", "scenario.toml", "-o", "out/manhattan"], standalone_mode=False)
    write(
        folder / "heliports.kml", [shapely.Point(-74.009, 40.701).buffer(0.0005)], Name=["Heliport"]
    )
    write(
        folder / "parks.geojson", [shapely.box(-73.999, 40.712, -73.997, 40.714)], ceiling_m=[50.0]
    )
    houses = [
        shapely.box(x, y, x + 0.0008, y + 0.0006)
        for x in (-74.013, -74.010)
        for y in (40.706, 40.709)
    ]
    write(folder / "buildings.geojson", houses, height=[12.0, 30.0, 55.0, 90.0])
    ids = ["360610001001000", "360610001001001"]
    blocks = [shapely.box(x, 40.704, x + 0.005, 40.712) for x in (-74.016, -74.011)]
    write(folder / "blocks.geojson", blocks, GEOID10=ids)
    pd.DataFrame({"GEOID10": ids, "P001001": [400, 1200]}).to_csv(
        folder / "population.csv", index=False
    )
    (folder / "current.alm").write_text(yuma_of(5))
    ends = [
        -74.016,
        40.704,
        -73.99,
        40.729,
        -74.01,
        40.705,
        -73.985,
        40.725,
        -74,
        40.71,
        -74.01,
        40.725,
    ]
    pairs = np.reshape(ends, (3, 2, 2)).tolist()
    ju.plan_many(folder / "out/manhattan", pairs, altitude_m=60.0, snap=True).save(
        folder / "routes.geojson"
    )
    return folder


def write(file: Path, shapes: list, **columns: list) -> None:
    gpd.GeoDataFrame(columns, geometry=shapes, crs="EPSG:4326").to_file(
        file, driver={".kml": "KML"}.get(file.suffix)
    )


@pytest.fixture
def folder(prepared, tmp_path, monkeypatch) -> Path:
    shutil.copytree(prepared, tmp_path / "page")
    monkeypatch.chdir(tmp_path / "page")
    return tmp_path / "page"


def keep_toml(block: Block) -> None:
    """Check settings, and save them where their first line names a file."""
    settings = tomllib.loads(block.text)
    if "region" not in settings:
        settings |= {
            "region": {"bounds": (0.0, 0.0, 0.1, 0.1)},
            "buildings": {"source": "synthetic"},
        }
    Scenario.from_dict(settings)
    if named := re.match(r"# (\w+\.toml)\n", block.text):
        Path(named[1]).write_text(block.text, encoding="utf-8")


def run_alone(*arguments: str) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of one command, in a process of its own."""
    ended = subprocess.run(
        [sys.executable, "-m", "jaxurban", *arguments], capture_output=True, text=True
    )
    return ended.returncode, ended.stdout, ended.stderr


def run_shell(block: Block, page: Path, capsys) -> str:
    """Run the commands of a block and return all that they print."""
    said = ""
    for words in commands_of(block):
        match words:
            case ["jaxurban", *arguments]:
                if ONLY_PARSED.match(" ".join(arguments)):
                    with patch.object(GIVEN, "check", None), patch.object(MAPS_PATH, "check", None):
                        assert app.commands[arguments[0]].make_context(arguments[0], arguments[1:])
                else:
                    # What this process holds counts toward a ceiling, and depends on the tests before.
                    by = run_alone if "--memory" in arguments else partial(run, capsys)
                    code, out, err = by(*arguments)
                    assert code == 0, f"{name_of(page)}:{block.line}: {shlex.join(words)}\n{err}"
                    said += out + err
            case ["make", *targets]:
                made = re.findall(
                    r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
                )
                assert targets
                assert set(targets) <= set(made)
            case ["python", "-m", module, *_] if module.startswith("benchmarks."):
                assert (ROOT / module.replace(".", "/")).with_suffix(".py").is_file()
            case ["python", "-m", "figures", *parts]:
                drawn = [*(ROOT / "figures").rglob("*.py")]
                assert all(any(part in file.stem for file in drawn) for part in parts)
            case ["python", "-m", "pip", "install", "."]:
                pass
            case ["python", "-m", "pip", "install", *_, target]:
                extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
                    "project"
                ]
                assert target.strip(".[]") in extras["optional-dependencies"]
            case _:
                assert words == [".", ".venv/bin/activate"], (
                    f"{name_of(page)}: not known here: {shlex.join(words)}"
                )
    return said


def is_shown(line: str, said: str) -> bool:
    """Return whether a line is the end of one that was printed; ``...`` stands for any text."""
    wanted = ".*".join(re.escape(part) for part in line.strip().split("..."))
    return re.search(rf"^.*{wanted}$", said, re.MULTILINE) is not None


def assert_shown(block: Block, said: str, page: Path) -> None:
    """Assert that each line shown below a block is one that it printed (`tests/renew_outputs.py` rewrites them)."""
    for line in block.text.splitlines():
        assert is_shown(line, said), (
            f"{name_of(page)}:{block.line} shows {line!r}, but what was printed is:\n{said}"
        )


def commands_of(block: Block) -> Iterator[list[str]]:
    for line in block.text.replace("\\\n", " ").splitlines():
        if words := shlex.split(line, comments=True):
            yield words


RUN = {"python", "toml", "sh"}
NOT_RUN = {"text", "math"}  # diagrams, and formulas, which `make docs` turns into MathML or fails


# README's own commands make the maps that the guides take for granted, so that it is the first page.
COMMANDS_WITH_OUTPUT = [
    (page, block, shown)
    for page in PAGES
    if page.stem != "tutorial"  # which has maps of its own
    for block, shown in itertools.pairwise(blocks_of(page))
    if (block.language, shown.language) == ("sh", "text")
]


def with_code() -> Iterator[Any]:
    """Yield the pages that have blocks to run."""
    for page in PAGES:
        if {block.language for block in blocks_of(page)} & RUN:
            yield pytest.param(page, id=name_of(page))


@pytest.mark.slow
@pytest.mark.parametrize("page", [*with_code()])
def test_the_blocks_of_a_page_run_in_their_order(page, folder, capsys):
    namespace: dict[str, Any] = {"__name__": "__main__"}
    said = ""
    lines, last = page.read_text(encoding="utf-8").splitlines(), 0
    for block in blocks_of(page):
        if any(line.startswith("#") for line in lines[last : block.line - 2]):
            said = ""  # what stands below another heading is no output
        last = block.line + block.text.count("\n")
        match block.language:
            case "text" if said:
                assert_shown(block, said, page)
                said = ""
            case "python":
                source = (
                    "\n" * (block.line - 1) + block.text
                )  # so that a traceback names the page's own line
                exec(compile(source, str(page), "exec"), namespace)
                said = capsys.readouterr().out
            case "toml":
                keep_toml(block)
            case "sh":
                said = run_shell(block, page, capsys)
                if page.parent.name == "guides":
                    said = ""  # these show what is printed over other maps: see the next test

    # What a page writes as a mission passes its check: wholly, or but for what other maps do not hold.
    maps = "out/first" if page.stem == "tutorial" else "out/manhattan"
    for mission in folder.rglob("*.plan"):
        code, out, _ = run(capsys, "check", maps, mission)
        is_first = page.stem in ("README", "tutorial")
        assert code == ExitCode.DONE or (code == ExitCode.NOT_JUDGED and not is_first), out


@pytest.mark.slow
def test_readme_and_guides_show_what_is_printed_over_the_maps_of_readmes_scenario(folder, capsys):
    shutil.rmtree("out")
    (scenario,) = (block for block in blocks_of(PAGES[0]) if block.language == "toml")
    Path("scenario.toml").write_text(scenario.text, encoding="utf-8")
    for page, block, shown in COMMANDS_WITH_OUTPUT:
        assert_shown(shown, run_shell(block, page, capsys), page)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_says_what_it_is_and_is_known_here(page):
    text = page.read_text(encoding="utf-8")
    blocks = blocks_of(page)
    assert text.count("```") == 2 * len(blocks), "a fence is not closed, or stands within a line"
    for block in blocks:
        assert block.language in RUN | NOT_RUN, (
            f"{name_of(page)}:{block.line}: language {block.language!r}"
        )
        is_hidden_code = block.language in NOT_RUN and re.search(
            r"\b(jaxurban |ju\.|import )", block.text
        )
        assert not is_hidden_code, f"{name_of(page)}:{block.line} holds code that no test runs"


def test_the_scenario_page_names_every_setting_with_its_default():
    block, *_ = (
        block
        for block in blocks_of(ROOT / "docs/reference/scenario.md")
        if block.language == "toml"
    )
    shown = tomllib.loads(block.text)
    columns = {"height_column", "ground_column", "levels_column", "unit"}
    columns |= {"crs", "highest_m", "default_height_m", "heights"}
    left_out = {"region": {"bounds", "crs"}, "buildings": {"source", *columns}}
    left_out |= {"terrain": {"source"}, "vegetation": {"source"}, "obstacles": {"kinds"}}
    left_out |= {"gps": {"times", "reference"}}
    left_out |= {
        "population": {"blocks", "table", "column", "districts", "commercial"}
    }  # without a default: examples are shown
    left_out |= {"vehicle": set(shown["vehicle"])}
    whole = Scenario.from_dict(shown).model_dump(mode="python")
    bare = {"region": {"bounds": shown["region"]["bounds"]}, "buildings": {"source": "x.geojson"}}
    defaults = Scenario.from_dict(bare).model_dump(mode="python")
    defaults["planning"] |= vars(Planning().rules)
    for section, settings in defaults.items():
        if section == "study":
            continue
        wanted = settings.keys() - {
            "step_s",
            "weekday",
            "weekend",
            "blocks_day",
            "blocks_night",
        }
        assert set(shown[section]) == wanted, section
        for key in wanted - left_out.get(section, set()):
            assert whole[section][key] == settings[key], f"[{section}] {key}"


def test_the_python_page_names_every_public_name():
    page = (ROOT / "docs/reference/api.md").read_text(encoding="utf-8")
    table = [line for line in page.splitlines() if line.startswith("|")]
    modules = (*NAMESPACES, PICTURES, TYPES)
    spaces = {name: import_module(f"jaxurban.{name}") for name in modules}
    names = [
        *ju.__all__,
        *(f"{space}.{name}" for space, module in spaces.items() for name in module.__all__),
    ]
    assert sorted(re.findall(r"`([\w.]+)`", "\n".join(table))) == sorted({*names} - {*spaces})


def test_the_page_of_commands_names_every_command():
    page = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    table = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    assert set(re.findall(r"`([a-z-]+)`", "\n".join(table))) == app.commands.keys()


def test_notebooks_are_numbered_and_listed_in_their_order():
    assert [int(path.name.split("_")[0]) for path in NOTEBOOKS] == list(range(1, 12))
    assert re.findall(r"\((\d\w+\.py)\)", (FOLDER / "README.md").read_text()) == [
        path.name for path in NOTEBOOKS
    ]
    assert not list(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_paired_text_and_asks_one_question_first(path):
    notebook = jupytext.read(path)
    assert notebook.metadata["jupytext"]["formats"] == "ipynb,py:percent"
    title, question = (line for line in notebook.cells[0].source.splitlines()[:3] if line)
    assert title.startswith(f"# {path.name.split('_')[0]}. ")
    assert re.fullmatch(r"\*\*.+\?\*\*", question)
    assert question.strip("*") in (FOLDER / "README.md").read_text()
    asked = [
        cell.source for cell in notebook.cells if cell.source.startswith("## A question to try\n")
    ]
    assert asked == [notebook.cells[-1].source]
    assert "?" in asked[0]


@pytest.mark.parametrize("page", ["stability", "commands"])
def test_pages_name_every_exit_code(page):
    text = (ROOT / f"docs/reference/{page}.md").read_text(encoding="utf-8")
    listed = re.search(r"exit codes[ |:]+(.*?)(?: \||\.)", text, re.IGNORECASE | re.DOTALL)
    assert listed is not None
    assert {int(code) for code in re.findall(r"\b(\d+) (?=[a-z])", listed[1])} == set(ExitCode)


def messages_of_the_code() -> list[str]:
    """Return every text of the code but its docstrings, with ``...`` where a value is put in."""
    texts = []
    files = [file for folder in ("jaxurban", "planners") for file in (ROOT / folder).rglob("*.py")]
    for node in (node for file in files for node in ast.walk(ast.parse(file.read_bytes()))):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = None
        elif isinstance(node, ast.JoinedStr):
            constants = [part.value for part in node.values if isinstance(part, ast.Constant)]
            texts.append("...".join(constants))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            texts.append(node.value)
    return texts


@pytest.mark.slow
def test_the_sentences_of_the_page_on_faults_stand_in_the_code():
    page = (ROOT / "docs/guides/trouble.md").read_text(encoding="utf-8")
    quoted = re.findall(r"^\| `([^`]+)` \|", page, re.MULTILINE)
    assert len(quoted) > 25
    texts = messages_of_the_code()
    for sentence in quoted:
        parts = map(re.escape, filter(None, (part.strip() for part in sentence.split("..."))))
        pattern = re.compile(".*".join(parts), re.DOTALL)
        assert any(pattern.search(text) for text in texts), sentence
