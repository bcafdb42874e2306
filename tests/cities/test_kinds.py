"""One table of kinds: the page of docs and the counts of extracts say what the code holds."""

import math
import re

import pandas as pd
import pytest

from benchmarks.common import ROOT
from jaxurban.cities.kinds import Kind, Nothing
from jaxurban.cities.rules import BY_VALUE, KINDS, LAMP, THINGS
from tests.cities.generator.extracts import COUNTS

PAGE = ROOT / "docs/model/kinds.md"
TABLE = {
    key: {value: THINGS[name] for value, name in rules.items()}
    for key, rules in (KINDS | BY_VALUE).items()
}
# `power`, `man_made`: pole, portal; points have other rows.
OF_KEYS = re.compile(r"(?<!a point with )((?:`[\w:]+`(?:, )?)+): ([^`;]+)")
OTHERS = re.compile(r"any other ((?:`[\w:]+`(?:, )?)+)")
NUMBER = re.compile(r"[\d.]+")
# Bridges and rides have a row for any value; what has a number for each layer is held by its own tests.
SITE = (0.0, math.inf)  # guess and bound of what stands only with a height of its own
ANY_VALUE = {"tower:type", "bridge", "bridge:support", "roller_coaster"}


def rows_of_page() -> list[tuple[str, str, str, str, str]]:
    """Return key, value, kind, guess and bound of each value in the table of the page; "*" is any other value."""
    rows = []
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    for line in lines:
        first, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        pairs = [(keys, values.split(", ")) for keys, values in OF_KEYS.findall(first)]
        pairs += [(keys, ["*"]) for keys in OTHERS.findall(first)]
        for keys, values in pairs:
            for key in re.findall(r"`([\w:]+)`", keys):
                rows += [(key, value.strip(), *cells[:3]) for value in values]
    return [row for row in rows if row[0] in TABLE and row[1] in TABLE[row[0]]]


def said(kind: Kind | Nothing) -> tuple[str, float, float]:
    """Return what the page says of a kind: its name, guess and bound, NaN of nothing."""
    if isinstance(kind, Kind):
        return kind.name, kind.height_m, kind.limit_m
    return "nothing", math.nan, math.nan


def test_the_page_has_every_kind_of_the_table_and_no_value_twice():
    rows = [row[:2] for row in rows_of_page()]
    assert len(rows) == len({*rows}) > 50
    kinds = {said(kind) for key in TABLE.keys() - ANY_VALUE for kind in TABLE[key].values()}
    wanted = {kind for kind in kinds if kind[0] not in ("nothing", "bridge") and kind[1:] != SITE}
    assert wanted <= {said(TABLE[key][value]) for key, value in rows}


@pytest.mark.parametrize(("key", "value", "kind", "guess", "bound"), rows_of_page())
def test_the_page_agrees_with_the_table(key, value, kind, guess, bound):
    name, height_m, limit_m = said(TABLE[key][value])
    if name == "nothing":
        assert kind.startswith("nothing")
        assert not guess
        assert not bound
    elif name == "structure" and not height_m:
        assert kind.startswith("nothing: the ground of a site")
    else:
        assert kind.startswith(name) or kind == "the same"
        guesses = [float(number) for number in NUMBER.findall(guess)]
        assert (guesses or [0.0])[0] == height_m
        bounds = [float(number) for number in NUMBER.findall(bound.split(";")[0])]
        assert (bounds or [math.inf])[0] == limit_m


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
