"""Guesses of what a city's files do not say, each under a short name as one sentence (see `jaxurban.maps.guesses`)."""

import warnings
from collections.abc import Mapping
from pathlib import Path

import shapely

from jaxurban import settings
from jaxurban.errors import GuessWarning
from jaxurban.io.read.heights import LAYER_CLEARANCE_M
from jaxurban.metrics.population import Population
from jaxurban.world.city import GUESSED_BY, Blocks, Buildings, ReadIssue, ReadIssues
from jaxurban.world.grid import Bounds

Guesses = dict[str, str]

FLAT_GROUND = {
    "flat ground": "no terrain is given, so the ground is taken as flat: heights and shadows are wrong where it is "
    "not; name an elevation raster in [terrain] source"
}
TOLD_SHARE = 0.01  # of buildings, cells or visibility results: a box in degrees and its projection differ by less


def warn_of(guesses: Mapping[str, str], known: Mapping[str, str] | None = None) -> None:
    """Warn of each guess that is not known already."""
    for name, sentence in guesses.items():
        if name not in (known or {}):
            warnings.warn(sentence, GuessWarning, stacklevel=3)


def percent(share: float) -> str:
    """Return a share in whole percent, never 0 or 100 % where it is not."""
    return "< 1 %" if 0 < share < 0.01 else "> 99 %" if 0.99 < share < 1 else f"{100 * share:.0f} %"


def guessed_share(buildings: Buildings, bounds_m: Bounds) -> float:
    """Return the share of the buildings in a box whose height is guessed, 0 without a building."""
    is_guessed = buildings.is_guessed[shapely.intersects(buildings.polygons, shapely.box(*bounds_m))]
    return float(is_guessed.mean()) if is_guessed.size else 0.0


def height_guesses(buildings: Buildings | None, bounds_m: Bounds, file: settings.Buildings) -> Guesses:
    """Return what was supposed of the heights of the buildings in a box; nothing of a height raster."""
    if buildings is None or (share := guessed_share(buildings, bounds_m)) < TOLD_SHARE:
        return {}
    inside = buildings.take(shapely.intersects(buildings.polygons, shapely.box(*bounds_m)))
    numbers = vars(file) | {"layer_clearance_m": LAYER_CLEARANCE_M}
    counts = {words: int((inside.origin == origin).sum()) for origin, words in GUESSED_BY.items()}
    how = ", ".join(f"{num:,} {words.format(**numbers)}" for words, num in counts.items() if num)
    return {
        f"{percent(share)} of heights": (
            f"the heights of {percent(share)} of the {len(inside):,} buildings in the region are guessed ({how}): give "
            "a source with heights, or set [buildings] level_height_m and default_height_m"
        )
    }


def count_guesses(issues: ReadIssues, blocks: Blocks) -> Guesses:
    """Return what was supposed of the people in census blocks, by the issues of `read_blocks`."""
    if not blocks.night_count.any():
        return {"nobody": "all census counts in and around the region are 0: check [population] table and its count"}
    num_missing, num_unreadable = issues[ReadIssue.BLOCKS_WITHOUT_COUNT], issues[ReadIssue.COUNTS_UNREADABLE]
    if not num_missing:
        return {}
    return {
        f"{num_missing:,} blocks without a count": (
            f"{num_missing:,} of {len(blocks):,} census blocks in and around the region are read as 0 people (in "
            f"{num_unreadable:,} the count cannot be read, {num_missing - num_unreadable:,} have none): mend the "
            "counts, or write 0 where nobody lives"
        )
    }


def district_guesses(issues: ReadIssues, files: Population) -> Guesses:
    """Return what was supposed of the districts: that no district is commercial, as nobody says which.

    Args:
      issues: of `read_blocks`.
      files: that were read.
    """
    if files.districts is None:
        return {}
    name, field = Path(files.districts).name, files.district_field
    if files.commercial is None and not files.commercial_labels:
        found = f"nobody says which districts of {name!r} ({field}) are commercial, so all count as residential"
    elif files.commercial and issues[ReadIssue.COMMERCIAL_NOT_FOUND] == len(files.commercial):
        found = f"{name!r} has no district ({field}) of the [population] commercial list, so all count as residential"
    else:
        return {}
    return {
        "no commercial district": f"{found} and by day every block takes gamma_residential: list the labels in "
        "[population] commercial, or give [] for none"
    }
