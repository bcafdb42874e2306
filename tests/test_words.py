"""Messages speak the words of the door that was used: arguments in Python, keys and options elsewhere."""

import ast
from dataclasses import fields
from pathlib import Path

import pytest

import jaxurban as ju
from jaxurban.errors import KEY, MAKERS, SECTIONS, in_words, speaking
from jaxurban.knowledge import GuessKind, guessed
from jaxurban.maps.scenario import Scenario, fields_of, model_in
from jaxurban.public import find_public
from tests.cli_runs import TOWN, run

KEYS = {
    name: {item.name for item in fields(model_in(annotation))}
    for name, annotation in fields_of(Scenario).items()
}


def texts_in(file: Path) -> list[str]:
    """Every text of a module that is no docstring; what an f-string fills in is a brace."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    docstrings = {
        ast.get_docstring(node, clean=False)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    }
    texts = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = (part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
            texts.append("".join(parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            texts.append(node.value)
    return [text for text in texts if text not in docstrings]


def test_a_section_before_a_word_is_always_before_one_of_its_keys():
    package = Path(ju.__file__).parent
    found = 0
    for file in package.rglob("*.py"):
        for text in texts_in(file):
            for named in KEY.finditer(text):
                if named[1] in SECTIONS:
                    found += 1
                    assert named[2] in KEYS[named[1]], f"{file.name}: {text}"
    assert found > 30


@pytest.mark.parametrize("section", SECTIONS.split("|"))
def test_what_messages_call_in_python_takes_the_keys_of_the_section(section):
    maker = find_public(MAKERS.get(section, section.capitalize()).rpartition(".")[2])
    assert {item.name for item in fields(maker)} == KEYS[section]


@pytest.mark.parametrize(
    ("sentence", "in_python", "in_scenario"),
    [
        ("name [gps] orbits", "name ju.Gps(orbits=...)", "name [gps] orbits"),
        ('[buildings] crs = "x".', 'ju.Buildings(crs="x").', '[buildings] crs = "x".'),
        ("move [region] bounds", "move bounds", "move [region] bounds"),
        ("resolution_m (--resolution)", "resolution_m", "resolution_m (--resolution)"),
        ("name it (--pilot, pilot=)", "name it (pilot=)", "name it (--pilot)"),
        ("move it (--snap 8, snap=8)", "move it (snap=8)", "move it (--snap 8)"),
        ("none [here] of them (as it is)",) * 3,
    ],
)
def test_a_sentence_has_the_words_of_the_door(sentence, in_python, in_scenario):
    assert in_words(in_words(sentence)) == in_python
    with speaking("scenario"):
        assert in_words(sentence) == in_scenario


def test_errors_and_guesses_speak_python_in_python_and_keys_from_scenarios(tmp_path, capsys):
    (guess,) = guessed(GuessKind.HANGING, number=2)
    assert 'ju.Buildings(hanging="to_ground")' in guess.sentence
    with speaking("scenario"):
        assert '[buildings] hanging = "to_ground"' in guess.sentence
    nowhere = (0.0, 0.0, 0.01, 0.01)
    with pytest.raises(ju.InputError, match=r"move bounds there, set ju\.Buildings\(crs=\.\.\.\)"):
        ju.City.from_files("sample:nihonbashi", bounds=nowhere)
    town = TOWN.replace("synthetic", "sample:nihonbashi")
    (tmp_path / "town.toml").write_text(
        town.replace("-74.0, 40.755, -73.993, 40.761", "0, 0, 0.01, 0.01")
    )
    code, _, err = run(capsys, "maps", tmp_path / "town.toml", "-o", tmp_path / "out")
    assert code == 2
    assert "move [region] bounds there, set [buildings] crs" in err
