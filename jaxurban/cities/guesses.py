"""Guesses of what reads a city: on heights, on what else stands, and on people in census blocks."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxurban import settings
from jaxurban.cities.heights import LAYER_CLEARANCE_M
from jaxurban.io.issues import ReadIssue, ReadIssues, listed_counts, num_of
from jaxurban.io.learned import CLASSES, PART_CLASSES, Learned
from jaxurban.knowledge import HIGHEST_M, Guesses, GuessKind, guessed
from jaxurban.world.blocks import Blocks
from jaxurban.world.extent import lonlat_boxes
from jaxurban.world.footprints import GUESSED_BY, Footprints, HeightOrigin
from jaxurban.world.grid import Bounds

if TYPE_CHECKING:
    from jaxurban.metrics.population import Population


def height_guesses(
    buildings: Footprints | None,
    learned: Mapping[str, Learned],
    crs: str,
    bounds_m: Bounds,
    file: settings.Buildings,
) -> Guesses:
    """Return the guesses on the heights of the buildings in a box: on those that are guessed, and on impossible ones.

    There is none if few are guessed and none is above `HIGHEST_M`.

    Args:
      buildings: of a file; None of a height raster, of which nothing is guessed.
      learned: what is guessed by class of footprint.
      crs: projected CRS of the city.
      bounds_m: x_min, y_min, x_max, y_max of the box in it.
      file: the rules by which heights were guessed.
    """
    if buildings is None:
        return ()
    inside = buildings.inside(bounds_m)
    counts = {words: num_of(inside.origin == origin) for origin, words in GUESSED_BY.items()}
    num_estimated = counts.pop(GUESSED_BY[HeightOrigin.ESTIMATED])
    numbers = vars(file) | {
        "layer_clearance_m": LAYER_CLEARANCE_M,
        "default": _default_said(file),
    }
    kinds = ", ".join(f"{num:,} {words.format(**numbers)}" for words, num in counts.items() if num)
    medians = ""
    if counts[GUESSED_BY[HeightOrigin.DEFAULT]] and file.default_height_m is None:
        medians = _medians_said(learned)
    num = max(len(inside), 1)
    guesses = guessed(
        GuessKind.ESTIMATES, num_estimated / num, number=num_estimated, of=len(inside), least=0.0
    )
    guesses += guessed(
        GuessKind.HEIGHTS,
        sum(counts.values()) / num,
        number=len(inside),
        kinds=kinds,
        medians=medians,
    )
    if file.highest_m is not None:
        guesses += guessed(GuessKind.HIGHEST_SAID, highest_m=str(file.highest_m))
    return guesses + _high_roofs(inside.take(inside.height_m > HIGHEST_M), crs)


def _default_said(file: settings.Buildings) -> str:
    """Return by what a height is guessed of which a file says nothing, in words."""
    if file.default_height_m is not None:
        return f"by the default of {file.default_height_m:g} m"
    return "by the median of their class"


def _medians_said(learned: Mapping[str, Learned]) -> str:
    """Return the median of each class after a colon."""
    names = [*CLASSES, *PART_CLASSES]
    return ": " + "; ".join(f"{name} {learned[name]}" for name in names if name in learned)


def _high_roofs(high: Footprints, crs: str) -> Guesses:
    """Return the guess on buildings above `HIGHEST_M`, with the place of the first, empty without any."""
    if not len(high):
        return ()
    lon, lat = lonlat_boxes(high.polygons, crs)[0, :2].tolist()
    height_m = float(high.height_m[0])
    return guessed(GuessKind.HIGH_ROOFS, number=len(high), place=(lon, lat), height_m=height_m)


def structure_guesses(structures: Footprints | None, bounds_m: Bounds) -> Guesses:
    """Return the guess on structures in a box whose height or extent is not known.

    Args:
      structures: None of a raster.
      bounds_m: x_min, y_min, x_max, y_max of the box in the structures' CRS.
    """
    if structures is None:
        return ()
    unknown = structures.take(structures.touches(bounds_m) & structures.is_guessed)
    if not len(unknown):
        return ()
    kinds = listed_counts(Counter(unknown.named))
    return guessed(GuessKind.STRUCTURES, number=len(unknown), kinds=kinds)


def census_guesses(issues: ReadIssues, blocks: Blocks, files: "Population") -> Guesses:
    """Return the guesses on the people in census blocks and on their districts, empty without any.

    Args:
      issues: of `read_blocks`.
      blocks: that were read.
      files: that they were read from.
    """
    guesses: Guesses = ()
    num_missing = issues[ReadIssue.BLOCKS_WITHOUT_COUNT]
    num_unreadable = issues[ReadIssue.COUNTS_UNREADABLE]
    if not (blocks.night_count.any() or np.any(blocks.day_count)):
        guesses += guessed(GuessKind.NOBODY)
    elif num_missing:
        guesses += guessed(
            GuessKind.UNCOUNTED_BLOCKS,
            number=num_missing,
            of=len(blocks),
            unreadable=num_unreadable,
            missing=num_missing - num_unreadable,
        )

    # Districts: an empty list of commercial ones is no guess.
    listed = files.commercial or files.commercial_labels
    is_known = bool(listed) and issues[ReadIssue.COMMERCIAL_NOT_FOUND] < len(listed)
    means_none = files.commercial is not None and not files.commercial
    if files.districts is not None and not (is_known or means_none):
        file = repr(Path(files.districts).name)
        guesses += guessed(GuessKind.NO_COMMERCIAL, file=file, field=files.district_field)
    return guesses
