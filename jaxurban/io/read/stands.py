"""What of a file's features stands: one rule for every format, a building, another structure, or nothing and why."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import shapely

from jaxurban.io.read.heights import is_given, parse_count, parse_height_m, read_column
from jaxurban.io.read.issues import LEFT_OUT, ReadIssue, ReadIssues
from jaxurban.io.read.kinds import (
    CONIFER,
    FALLS,
    FENCE,
    GARAGES,
    GROWN,
    HULL,
    IN_WORDS,
    KINDS,
    LOW_M,
    NOT_BUILT,
    NOTHING,
    OTHER,
    SITE,
    TOWER,
    TREE,
    TURBINE,
    WIND,
    Kind,
)
from jaxurban.io.read.outlines import Outlines
from jaxurban.settings import MAX_HEIGHT_M
from jaxurban.world.footprints import BUILDING

DECK = "bridge"  # of the tag man_made
NO = ("", "no", "false", "none", "null", "nan")
FLAGS = {"0", "0.0", "1", "1.0"}  # of a column of yes and no; other numbers are names
WEAK = (NOTHING, SITE, None)  # what gives way to a kind that something else says
LEVEL = re.compile(r"(?<!\d)-?\d+")  # also of a range: -1-3


def what_stands(outlines: Outlines, has_decks: bool, issues: ReadIssues) -> Outlines:
    """Return those features that stand by their tags, ``N``, with what they are beside their tags.

    Of files that do not say what is a building every area is one, unless the table of kinds has it. What is in the
    table and a building is a building. A building without an area (a line, a point) is a `HULL`.

    Args:
      outlines: with their tags.
      has_decks: whether areas of bridges that are no buildings are decks.
      issues: gets how many are left out, by reason.

    Returns:
      Tags more: ``verdict``, ``[N]`` objects, `BUILDING` or the `Kind` of another structure; ``is_part`` and
      ``is_deck``, ``[N]`` bool, of buildings.
    """
    is_areal = ~np.isin(shapely.get_dimensions(outlines.polygons), (0, 1))
    is_part = _says_yes(outlines, "part")
    verdict = _kinds(outlines, is_areal)
    is_building = is_areal & pd.isna(verdict)
    is_deck = has_decks & is_areal & (outlines.texts("man_made") == DECK) & ~is_part
    if "building" in outlines.tags:
        is_building = _says_yes(outlines, "building") | is_part
        is_building &= ~np.isin(outlines.texts("building"), list(NOT_BUILT))
        is_deck &= ~is_building
    is_building |= is_deck
    verdict[is_building] = HULL
    verdict[is_building & is_areal] = BUILDING

    # Why the others are left out.
    has_key = np.logical_or.reduce([outlines.texts(key) != "" for key in KINDS])
    is_nothing = pd.isna(verdict)
    verdict[is_nothing] = ReadIssue.NOT_BUILDINGS
    verdict[is_nothing & has_key] = ReadIssue.NOT_IN_TABLE
    is_something = ~np.isin(verdict, LEFT_OUT)
    verdict[is_something & _is_below(outlines)] = ReadIssue.UNDERGROUND
    issues |= {reason: int(np.sum(verdict == reason)) for reason in LEFT_OUT}
    more = {"verdict": verdict, "is_part": is_part, "is_deck": is_deck}
    return replace(outlines, tags={**outlines.tags, **more}).take(~np.isin(verdict, LEFT_OUT))


def _says_yes(outlines: Outlines, name: str) -> np.ndarray:
    """Return ``[N]`` whether a tag has any value but those that mean no."""
    text = outlines.texts(name)
    is_number = {value for value in {*text} if value[:1].isdigit()}
    no = NO if is_number - FLAGS else (*NO, "0", "0.0")
    return ~np.isin(text, no)


def _kinds(outlines: Outlines, is_areal: np.ndarray) -> np.ndarray:
    """Return the `Kind` of each feature by its tags, or a `ReadIssue`, ``[N]`` objects, None where they say nothing.

    A height makes anything stand that no table knows, or that does not stand by its kind, from `LOW_M` on; one that
    cannot be read makes it unknown. What is of nature and not in `GROWN` (peaks, cliffs, water) does not stand; what is
    razed or planned is left out unless its other tags name a kind.

    Args:
      outlines: with their tags.
      is_areal: ``[N]`` bool.
    """
    kind = np.full(len(is_areal), None, object)
    building = outlines.texts("building")
    is_said = building != "" if "building" in outlines.tags else is_areal
    height = outlines.column("height")
    barrier = outlines.texts("barrier")
    for index in np.flatnonzero(is_given(height) & ~is_said):
        height_m = parse_height_m(str(height[index]))
        standing = FENCE if barrier[index] else SITE
        kind[index] = standing if height_m >= LOW_M else NOTHING
        if height_m > MAX_HEIGHT_M:
            kind[index] = OTHER
    nature = outlines.texts("natural")
    kind[(nature != "") & ~np.isin(nature, list(GROWN["natural"])) & ~is_said] = NOTHING
    for column in (nature, outlines.texts("waterway")):
        kind[np.isin(column, FALLS)] = NOTHING
    kind[_says_yes(outlines, "tower_type")] = TOWER
    is_wind = np.isin(outlines.texts("wind"), WIND)
    kind[_says_yes(outlines, "rotor") | _says_yes(outlines, "hub") | is_wind] = TURBINE
    for reason in (ReadIssue.RAZED, ReadIssue.PLANNED):
        values = [value for value, why in NOT_BUILT.items() if why is reason]
        kind[_says_yes(outlines, reason) | np.isin(building, values)] = reason

    for key, by_value in (GROWN | IN_WORDS | KINDS).items():
        texts = outlines.texts(key)
        found_by_text = {}
        for text in {*texts}:
            parts = [word.strip() for word in text.split(";")]
            listed = [by_value.get(word) for word in parts if word[:1].isalpha() and word not in NO]
            if listed:
                found_by_text[text] = min(listed, key=WEAK.__contains__)
        for index in np.flatnonzero([text in found_by_text for text in texts]):
            found = found_by_text[texts[index]]
            if found in WEAK and isinstance(kind[index], Kind):
                continue
            unlisted = OTHER if is_areal[index] and key in KINDS else None
            kind[index] = found or kind[index] or unlisted
    kind[(kind == TREE) & (outlines.texts("leaf") == "needleleaved")] = CONIFER
    return kind


def _is_below(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether features lie below the ground: a layer below 0 does not say it, which orders alone."""
    is_below = outlines.texts("location") == ReadIssue.UNDERGROUND
    level = outlines.texts("level")
    for index in np.flatnonzero(level != ""):
        numbers = LEVEL.findall(level[index])
        is_below[index] |= bool(numbers) and all(number.startswith("-") for number in numbers)

    # Levels below the ground and none above it; a height says that something stands there all the same.
    levels, roof_levels = (
        read_column(outlines.column(name), parse_count) for name in ("levels", "roof_levels")
    )
    is_below_only = (levels == 0) & (outlines.texts("levels_below") != "")
    is_below_only &= ~(roof_levels > 0)
    is_parking = outlines.texts("parking") == ReadIssue.UNDERGROUND
    is_parking &= np.isin(outlines.texts("building"), GARAGES)
    is_flat = ~is_given(outlines.column("height"))
    return is_below | is_flat & (is_below_only | is_parking & ~(levels > 0))
