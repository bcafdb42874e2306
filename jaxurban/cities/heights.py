"""Heights as people write them: tags and columns to metres, with the origin of each height kept, and those of decks."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import Decimal
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban import settings
from jaxurban.io.issues import ReadIssue, ReadIssues, num_of
from jaxurban.io.tables import is_blank
from jaxurban.settings import MAX_HEIGHT_M
from jaxurban.world.footprints import Footprints, HeightOrigin

FOOT_M = 0.3048  # international foot, exact
INCH_M = 0.0254  # international inch, exact
# Over freeways the least clearance is 16 ft, 4.9 m (AASHTO, A Policy on Geometric Design of Highways and Streets). A
# layer of OSM orders what crosses and is no height: one more above the ground is taken as one more such clearance.
LAYER_CLEARANCE_M = 5.0
# Girder, slab and pavement of spans of some 25 m, at a depth of a 25th of the span.
DECK_DEPTH_M = 1.0
# Half a storey: levels that a height leaves less each, not even attics, contradict it.
LEAST_LEVEL_M = 1.5

# Thousands may stand apart: 1 230.
_NUMBER = r"((?:\d{1,3}(?:[ \u00a0\u2009\u202f]\d{3})+|\d+)(?:[.,]\d+)?|[.,]\d+)"
_ABOUT = r"~|≈|[<>]=?|[≤≥+]|about|around|circa|ca\.?|approx(?:\.|imately)?"
_TO = r"\s*(?:-|–|to)\s*"  # in a range
# What says that a length is a guess: ~30, about 30, 30-40.
ROUGH = re.compile(rf"(?:^|;)\s*(?:{_ABOUT})|\d{_TO}\d", re.IGNORECASE)
_METRE = r"m|\u043c|met(?:re|er)s?"  # also as in Russian
_FOOT = r"'|ft\.?|feet|foot"
# Inches follow feet alone, group 4.
_LENGTH = re.compile(
    rf"(?:{_ABOUT})?\s*(?:{_NUMBER}{_TO})?{_NUMBER}\s*(?:({_METRE})|({_FOOT}))?\.?\s*"
    rf"(?(4)(?:-?{_NUMBER}\s*(?:\"|in\.?|inch(?:es)?)?)?)"
)
_THOUSANDS = re.compile(r"(\d{1,3}),(\d{3})")  # of feet; of metres it is a decimal comma
_POSITIVE = re.compile(
    r"\s*(?![-\u2212]).*?(?:[1-9]|\binf)", re.IGNORECASE
)  # as far as one can see
_COUNT = re.compile(rf"(?:~|≈|ca\.?|approx\.?)?\s*{_NUMBER}")
_QUOTES = str.maketrans({"’": "'", "′": "'", "”": '"', "″": '"'})


def _number(text: str | None) -> float:
    """Return the number that a text spells, 0 without one."""
    return float("".join((text or "0").split()).replace(",", "."))


def _metres(text: str, unit_m: float) -> float:
    """Return the metres that one entry spells, in metres or in feet and inches, NaN where it is unreadable."""
    match = _LENGTH.fullmatch(text)
    if match is None:
        return math.nan
    low, high, metre, foot, inches = match.groups()
    if metre or foot:
        unit_m = FOOT_M if foot else 1.0
    if unit_m == FOOT_M:
        low, high = (_THOUSANDS.sub(r"\1\2", number or "") for number in (low, high))
    return max(_number(low), _number(high)) * unit_m + _number(inches) * INCH_M


def _count(text: str) -> float:
    """Return the number of levels in a text, NaN where it is no number."""
    match = _COUNT.fullmatch(text)
    return _number(match[1]) if match else math.nan


def _highest(text: str, parse_one: Callable[[str], float]) -> float:
    """Return the highest readable value of a list separated by semicolons, NaN without one.

    ``parse_one`` returns the value of one entry, in small letters and with plain quotes, NaN where it is unreadable.
    """
    entries = text.lower().translate(_QUOTES).replace("''", '"').split(";")
    values = [parse_one(entry.strip()) for entry in entries]
    return max((value for value in values if not math.isnan(value)), default=math.nan)


@lru_cache(maxsize=2**16)
def parse_length_m(text: str, unit_m: float = 1.0) -> float:
    """Return the length in metres that ``text`` spells, NaN where it cannot be read.

    Read are ``12``, ``12.5 m``, ``12,5`` (a decimal comma, but ``1,230 ft`` are thousands), ``1 230``, ``241m``, ``40
    ft``, ``12'6"``, ``12'``, typographic quotes, and lists such as ``3;5``, of which the **highest** readable value
    counts (an obstacle is better too high than too low). A rough figure is better than a default: ``~30``, ``ca.
    30``, ``about 30``, ``approx 30``, ``>30``, ``+30`` and ranges such as ``30-40``, of which the higher end counts.
    A minus sign or any other word makes a value unreadable.

    Args:
      text: one or several lengths.
      unit_m: length of the unit of numbers that name none.

    Source: https://wiki.openstreetmap.org/wiki/Key:height and .../Map_features/Units.
    """
    return _highest(text, lambda entry: _metres(entry, unit_m))


def parse_height_m(text: str) -> float:
    """Return the height in metres that ``text`` spells, inf where it seems positive but cannot be read, else NaN."""
    height_m = parse_length_m(text)
    is_lost = math.isnan(height_m) and _POSITIVE.match(text)
    return math.inf if is_lost else height_m


@lru_cache(maxsize=2**16)
def parse_count(text: str) -> float:
    """Return the number (of levels) that ``text`` spells, NaN where it cannot be read; lists as for lengths."""
    return _highest(text, _count)


def is_given(column: np.ndarray) -> np.ndarray:
    """Return where a column of numbers or objects holds something: not None, NaN or blank text."""
    given = ~pd.isna(column)
    if column.dtype == object:
        given[given] = [not is_blank(value) for value in column[given]]
    return given


def read_column(column: np.ndarray, parse: Callable[[str], float]) -> np.ndarray:
    """Return ``[N]`` float64 values of a column, NaN where it cannot be read.

    Args:
      column: ``[N]`` numbers, or objects: texts, numbers and None.
      parse: returns the number that a text spells.
    """

    def read(value: object) -> float:
        """Return one value as a number, NaN of any other kind."""
        if isinstance(value, str):
            return parse(value)
        return float(value) if isinstance(value, int | float | np.number | Decimal) else math.nan

    if column.dtype != object:
        return column.astype(float)
    values = np.full(len(column), math.nan)
    given = ~pd.isna(column)
    values[given] = [read(value) for value in column[given]]
    return values


def estimate_heights(
    tags: Mapping[str, np.ndarray],
    polygons: np.ndarray,
    is_part: np.ndarray,
    rules: settings.Buildings,
) -> tuple[Footprints, ReadIssues]:
    """Return every outline with its height, by its tag, else its levels, else the default, 0 without one; and issues.

    A value that cannot be read, or a height that is zero, negative or above `MAX_HEIGHT_M`, falls to the next
    origin and is counted; an unusable ``min_height`` falls to ``min_level``, then to 0. A height that leaves its levels
    less than `LEAST_LEVEL_M` each gives way to them and is counted.

    Args:
      tags: ``[N]`` arrays of numbers, or of objects (text, numbers or None), by name: ``height``, ``levels``,
        ``roof_levels`` (added to ``levels``; alone they say nothing), ``min_height``, ``min_level``,
        ``estimated_to_m``; a missing name is an empty column.
      polygons, is_part: ``[N]`` as of `Footprints`.
      rules: height of one level, and where nothing usable is given.

    Returns:
      ``N`` outlines, and how many values could not be used, by kind.
    """
    given = _Given(tags, len(polygons), rules.level_height_m)
    height_m = given.read("height", parse_height_m)
    facade_m = given.levels_m("levels")
    roof_m = given.levels_m("roof_levels")
    has_roof = _is_usable(roof_m)
    levels_m = facade_m + np.where(has_roof, roof_m, 0.0)
    has_levels = _is_usable(levels_m) & (levels_m > 0)
    has_height = _is_usable(height_m) & (height_m > 0)
    least_m = np.minimum(facade_m * LEAST_LEVEL_M / rules.level_height_m, levels_m)
    is_too_low = has_height & has_levels & (height_m < least_m)
    is_kept = has_height & ~is_too_low

    min_height_m = given.read("min_height", parse_length_m)
    min_level_m = given.levels_m("min_level")
    has_min, has_min_level = _is_usable(min_height_m), _is_usable(min_level_m)

    origins = {
        HeightOrigin.UNREADABLE: height_m > MAX_HEIGHT_M,
        HeightOrigin.ESTIMATED: is_kept & _is_estimated(given.column("estimated_to_m"), rules),
        HeightOrigin.ROUGH: is_kept & _is_rough(given.column("height")),
        HeightOrigin.HEIGHT: is_kept,
        HeightOrigin.LEVELS: has_levels,
    }
    origin = np.select(list(origins.values()), list(origins), HeightOrigin.DEFAULT)
    heights = Footprints(
        polygons,
        np.select([is_kept, has_levels], [height_m, levels_m], rules.default_height_m or 0.0),
        np.select([has_min, has_min_level], [min_height_m, min_level_m], 0.0),
        origin.astype(np.uint8),
        is_part,
    )
    issues = {
        ReadIssue.HEIGHTS_UNUSABLE: given.num_lost(height=has_height),
        ReadIssue.HEIGHTS_BELOW_LEVELS: num_of(is_too_low),
        ReadIssue.LEVELS_UNUSABLE: given.num_lost(levels=has_levels, roof_levels=has_roof),
        ReadIssue.MIN_HEIGHTS_UNUSABLE: given.num_lost(min_height=has_min, min_level=has_min_level),
    }
    return heights, issues


class _Given(NamedTuple):
    """What tags say of ``num`` outlines; a missing tag is an empty column."""

    tags: Mapping[str, np.ndarray]
    num: int
    level_m: float

    def column(self, name: str) -> np.ndarray:
        """Return ``[N]`` a tag."""
        return self.tags.get(name, np.full(self.num, None, object))

    def read(self, name: str, parse: Callable[[str], float]) -> np.ndarray:
        """Return ``[N]`` the numbers of a tag, NaN where it cannot be read."""
        return read_column(self.column(name), parse)

    def levels_m(self, name: str) -> np.ndarray:
        """Return ``[N]`` the height of the levels that a tag counts, NaN where it cannot be read."""
        return self.read(name, parse_count) * self.level_m

    def num_lost(self, **is_usable: np.ndarray) -> int:
        """Return how often tags hold something that is not usable, ``[N]`` bool by name."""
        lost = [is_given(self.column(name)) & ~usable for name, usable in is_usable.items()]
        return sum(map(num_of, lost))


def _is_usable(value_m: np.ndarray) -> np.ndarray:
    """Return whether heights can be those of something; NaN, of what could not be read, cannot."""
    return (value_m >= 0) & (value_m <= MAX_HEIGHT_M)


def _is_rough(column: np.ndarray) -> np.ndarray:
    """Return ``[N]`` whether a height is said to be a guess, such as ~30."""
    is_rough = np.zeros(len(column), bool)
    if column.dtype == object:  # numbers alone say nothing of it
        is_filled = ~pd.isna(column)
        is_rough[is_filled] = [ROUGH.search(str(value)) is not None for value in column[is_filled]]
    return is_rough


def _is_estimated(estimated_to_m: np.ndarray, rules: settings.Buildings) -> np.ndarray:
    """Return ``[N]`` whether heights are estimates, by the user's word, else by what the file says of each."""
    if rules.heights is None:
        return is_given(estimated_to_m)
    return np.full(len(estimated_to_m), rules.heights == "estimated")


def with_decks(buildings: Footprints, is_deck: np.ndarray, layer: np.ndarray) -> Footprints:
    """Return buildings with decks that hang: from ``min_height`` to ``height`` where both are given.

    Without ``min_height`` a deck reaches `DECK_DEPTH_M` down from its ``height``. Without both its floor is
    `LAYER_CLEARANCE_M` above the ground for each layer (at least one), and its height is a guess.

    Args:
      buildings: ``N`` outlines with heights by their tags.
      is_deck: ``[N]`` bool.
      layer: ``[N]`` float64 of each outline, NaN where it has none.
    """
    has_height = buildings.origin == HeightOrigin.HEIGHT
    height_m = buildings.height_m
    min_height_m = buildings.min_height_m
    by_layer_m = np.fmax(layer, 1.0) * LAYER_CLEARANCE_M
    below_top_m = np.where(has_height, np.maximum(height_m - DECK_DEPTH_M, 0.0), by_layer_m)
    floor_m = np.where(min_height_m > 0, min_height_m, below_top_m)
    top_m = np.where(has_height & (height_m > floor_m), height_m, floor_m + DECK_DEPTH_M)
    is_guess = ~has_height & (min_height_m == 0)
    origin = np.where(is_guess, HeightOrigin.LAYER, HeightOrigin.HEIGHT).astype(np.uint8)
    return replace(
        buildings,
        height_m=np.where(is_deck, top_m, height_m),
        min_height_m=np.where(is_deck, floor_m, min_height_m),
        origin=np.where(is_deck, origin, buildings.origin),
    )
