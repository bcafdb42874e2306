"""What of a file's features stands: one rule for every format, a building, another structure, or nothing and why."""

import re
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban.io.read.heights import is_given, parse_count, parse_length_m
from jaxurban.io.read.issues import LEFT_OUT, ReadIssue, ReadIssues
from jaxurban.io.read.kinds import HULL, KINDS, LOW_M, NOT_BUILT, OTHER, SITE, TURBINE
from jaxurban.io.read.outlines import Outlines
from jaxurban.world.footprints import BUILDING

DECK = "bridge"  # of the tag man_made
NO = ("no", "false", "0", "0.0")
LEVEL = re.compile(r"-?\d+")


class Standing(NamedTuple):
    """What stands of ``N`` features.

    Attributes:
      verdict: ``[N]`` objects: `BUILDING`, the `Kind` of another structure, or a `ReadIssue`, why nothing stands.
      is_part, is_deck: ``[N]`` bool, of buildings.
    """

    verdict: np.ndarray
    is_part: np.ndarray
    is_deck: np.ndarray


def what_stands(outlines: Outlines, has_decks: bool, issues: ReadIssues) -> Standing:
    """Return what stands of features, by their tags.

    Of files that do not say what is a building every area is one, unless the table of kinds has it. What is in the
    table and a building is a building. A building without an area (a line, a point) is a `HULL`.

    Args:
      outlines: with their tags.
      has_decks: whether areas of bridges that are no buildings are decks.
      issues: gets how many are left out, by reason.
    """
    is_areal = ~np.isin(shapely.get_dimensions(outlines.polygons), (0, 1))
    building = texts(outlines.column("building"))
    is_part = _says_yes(outlines, "part")
    verdict = _kinds(outlines, is_areal)
    is_building = is_areal & pd.isna(verdict)
    is_deck = has_decks & is_areal & (texts(outlines.column("man_made")) == DECK) & ~is_part
    if "building" in outlines.tags:
        is_building = _says_yes(outlines, "building") | is_part
        is_building &= ~np.isin(building.astype(str), list(NOT_BUILT))
        is_deck &= ~is_building
    is_building |= is_deck
    verdict[is_building] = HULL
    verdict[is_building & is_areal] = BUILDING

    # Why the others are left out.
    has_key = np.logical_or.reduce([texts(outlines.column(key)) != "" for key in KINDS])
    is_nothing = pd.isna(verdict)
    verdict[is_nothing] = ReadIssue.NOT_BUILDINGS
    verdict[is_nothing & has_key] = ReadIssue.NOT_IN_TABLE
    for reason in (ReadIssue.RAZED, ReadIssue.PLANNED):
        values = [value for value, why in NOT_BUILT.items() if why is reason]
        says_so = _says_yes(outlines, reason) | np.isin(building.astype(str), values)
        verdict[says_so & ~is_building] = reason
    is_something = ~np.isin(verdict, LEFT_OUT)
    verdict[is_something & _is_below(outlines)] = ReadIssue.UNDERGROUND
    issues |= {reason: int(np.sum(verdict == reason)) for reason in LEFT_OUT}
    return Standing(verdict, is_part, is_deck)


def texts(column: np.ndarray) -> np.ndarray:
    """Return a tag of every feature as text in small letters, ``[N]`` objects, empty where it is missing."""
    words = np.full(len(column), "", object)
    is_filled = is_given(column)
    words[is_filled] = [str(value).strip().lower() for value in column[is_filled]]
    return words


def _says_yes(outlines: Outlines, name: str) -> np.ndarray:
    """Return ``[N]`` whether a tag has any value but those that mean no."""
    text = texts(outlines.column(name))
    return (text != "") & ~np.isin(text.astype(str), NO)


def _kinds(outlines: Outlines, is_areal: np.ndarray) -> np.ndarray:
    """Return the `Kind` of each feature by its tags, or a `ReadIssue`, ``[N]`` objects, None where they say nothing.

    A height makes anything stand that no table knows, from `LOW_M` on. Trees are left out.

    Args:
      outlines: with their tags.
      is_areal: ``[N]`` bool.
    """
    kind = np.full(len(is_areal), None, object)
    height = outlines.column("height")
    is_said = is_areal  # areas are buildings, whatever their height
    if "building" in outlines.tags:
        is_said = texts(outlines.column("building")) != ""
    for index in np.flatnonzero(is_given(height) & ~is_said):
        is_high = parse_length_m(str(height[index])) >= LOW_M
        kind[index] = SITE if is_high else ReadIssue.NOT_STANDING
    kind[(texts(outlines.column("natural")) != "") & ~is_said] = ReadIssue.TREES
    for key, by_value in KINDS.items():
        values = texts(outlines.column(key))
        for index in np.flatnonzero(values != ""):
            unlisted = OTHER if is_areal[index] else None
            kind[index] = by_value.get(values[index], kind[index] or unlisted)
    kind[_says_yes(outlines, "rotor") | _says_yes(outlines, "hub")] = TURBINE
    return kind


def _is_below(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether features lie below the ground: a layer below 0 does not say it, which orders alone."""
    is_below = texts(outlines.column("location")) == ReadIssue.UNDERGROUND
    level = texts(outlines.column("level"))
    for index in np.flatnonzero(level != ""):
        numbers = LEVEL.findall(level[index])
        is_below[index] |= bool(numbers) and all(number.startswith("-") for number in numbers)

    # Levels below the ground and none above it; a height says that something stands there all the same.
    levels = np.array([parse_count(text) for text in texts(outlines.column("levels"))])
    is_below_only = (levels == 0) & (texts(outlines.column("levels_below")) != "")
    is_parking = texts(outlines.column("parking")) == ReadIssue.UNDERGROUND
    is_flat = ~is_given(outlines.column("height"))
    return is_below | is_flat & (is_below_only | is_parking & ~(levels > 0))
