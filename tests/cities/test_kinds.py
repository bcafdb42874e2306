"""One table of kinds: the page of docs and the counts of extracts say what the code holds."""

import math
import re
from dataclasses import replace

import pandas as pd
import pytest

from benchmarks.common import ROOT
from jaxurban.cities.kinds import UNLISTED, Kind
from jaxurban.cities.rules import BY_VALUE, KINDS, LAMP, RULES, VALUES
from tests.cities.generator.extracts import COUNTS
from tests.renew_kinds import PAGE, renewed, table

TABLE = {
    key: {value: RULES[name] for value, name in rules.items()}
    for key, rules in (KINDS | BY_VALUE).items()
}
# Bridges and rides have a row for any value; what has a number for each layer is held by its own tests.
ANY_VALUE = {"tower:type", "bridge", "bridge:support", "roller_coaster"}


def row_of(key: str, value: str, text: str) -> str:
    """Return the row of a table in which a value stands behind its key, "*" for any other value."""
    tag, of, shape = key.partition(" of ")
    value = "any other value" if value == "*" else value
    keys = re.escape(f"`{tag}`{of}{shape}")
    behind = rf"{keys}(?:, `[^`]+`[^:;|`]*)*: (?:[^;|]*, )?{re.escape(value)}(?:[,;]| \|)"
    (row,) = (line for line in text.splitlines() if re.search(behind, line))
    return row


def test_the_page_holds_the_tables_that_the_rules_give():
    page = PAGE.read_text(encoding="utf-8")
    assert page.count("<!-- from the rules: ") == 2
    assert renewed(page) == page, "python -m tests.renew_kinds writes them"


def test_every_value_of_the_rules_stands_once_in_one_of_the_tables():
    text = table("kinds") + "\n" + table("nothing")
    pairs = [(key, value) for key, rules in VALUES.items() for value in rules]
    assert len(pairs) > 250
    for key, value in pairs:
        row_of(key, value, text)
    in_words = [name for name in RULES if ": " not in name]
    assert all(re.search(rf"(?<=[|;] ){name}(?= \||;)", text) for name in in_words)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("natural", "tree", "| tree | 7 | 35 | 1,219 trees"),
        ("man_made", "chimney", "| chimney | 30 | none |"),
        ("power", "line", "| wire | 30 | 100 | chosen; none where a span exceeds 600 m |"),
        ("attraction", "*", "| unknown |  | 200 |"),
        ("location of points", "overhead", "| unknown |  | 15 |"),
        ("location of ways", "overhead", "| unknown |  | 30 |"),
        ("power", "plant", "| structure | its own height;"),
        ("barrier", "kerb", "| ends below 6 m |"),
        ("man_made", "pier", "| is part of the ground,"),
        ("power", "cable", "| lies below the ground |"),
    ],
)
def test_a_row_says_what_a_value_is_taken_for(key, value, said):
    assert said in row_of(key, value, table("kinds") + "\n" + table("nothing"))


def test_a_rule_of_any_form_gets_its_row():
    pavilion = Kind("structure", 6.0, 40.0, source="a survey of ten")
    rules = {
        **RULES,
        "amenity: shelter bandstand": pavilion,
        "leisure of areas: stadium": pavilion,
        "hangar door": replace(UNLISTED, limit_m=math.inf),
    }
    text = table("kinds", rules)
    cells = "| structure | 6 | 40 | a survey of ten |"
    assert f"| `amenity`: shelter, bandstand; `leisure` of areas: stadium {cells}" in text
    assert "; hangar door | unknown |  | none |" in text
    assert table("nothing", rules) == table("nothing")


def test_the_counts_of_extracts_have_the_bounds_of_the_table():
    rows = pd.read_csv(ROOT / "tests/cities/generator/extracts.csv", comment="#")
    assert len(rows) > 100
    assert {*rows["key"]} <= {*COUNTS["key"]}
    for row in rows.itertuples():
        if row.key not in TABLE or row.key in ANY_VALUE:
            continue
        by_value = TABLE[row.key]
        kind = by_value.get(row.value, by_value.get("*"))
        bound_m = kind.limit_m if isinstance(kind, Kind) and kind.name != "structure" else 0.0
        bounds_m = {bound_m, LAMP.limit_m} if row.key == "location" else {bound_m}  # of points
        assert row.bound_m in bounds_m, (row.key, row.value)
