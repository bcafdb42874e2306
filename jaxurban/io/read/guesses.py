"""Guesses: what maps rest on that their files do not say, each under a short name (for pictures) as one sentence.

They are written down where they are made: on the `City` by what reads it, on the `Sky` by what sets it up, and by
`jaxurban.maps.guesses` what a region's maps add. The maps hold all (`MetricMaps.guesses`), and each is warned of once.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxurban import settings
from jaxurban.errors import GuessWarning, warn
from jaxurban.io.read.heights import LAYER_CLEARANCE_M
from jaxurban.io.read.issues import ReadIssue, ReadIssues, listed_counts
from jaxurban.world.blocks import Blocks
from jaxurban.world.extent import lonlat_boxes
from jaxurban.world.footprints import GUESSED_BY, Footprints
from jaxurban.world.grid import Bounds

if TYPE_CHECKING:
    from jaxurban.metrics.population import Population

Guesses = dict[str, str]

FLAT_GROUND = {
    "flat ground": "no terrain is given, so the ground is taken as flat: heights and shadows are wrong where it is "
    "not; name an elevation raster in [terrain] source"
}
NOMINAL_SKY = "nominal satellites"
ELEMENTS_TIME = "time of the elements"
BEYOND_DATA = "lines of sight to satellites leave the data"
WITHOUT_DATA = "the region without data"  # of which the share is said
HIGHEST_M = 828.0  # Burj Khalifa, the highest building of the world
LEAST_SHARE = 0.01  # of buildings, cells or visibility results: a box in degrees and its projection differ by less


def warn_of(guesses: Mapping[str, str], known: Mapping[str, str] | None = None) -> None:
    """Warn of each guess that is not known already."""
    for name, sentence in guesses.items():
        if name not in (known or {}):
            warn(sentence, GuessWarning)


def percent(share: float) -> str:
    """Return a share in whole percent, never 0 or 100 % where it is not."""
    if 0 < share < 0.01:
        return "< 1 %"
    return "> 99 %" if 0.99 < share < 1 else f"{100 * share:.0f} %"


def share_guess(share: float, name: str, sentence: str, least: float = LEAST_SHARE) -> Guesses:
    """Return the guess on a share of something: the share begins its name and its sentence.

    Args:
      share: 0 to 1.
      name: of the guess, after "5 % of".
      sentence: on it, after the same.
      least: up to this share there is no guess, and the result is empty.
    """
    if share <= least:
        return {}
    return {f"{percent(share)} of {name}": f"{percent(share)} of {sentence}"}


def guessed_share(buildings: Footprints, bounds_m: Bounds) -> float:
    """Return the share of the buildings in a box whose height is guessed, 0 without a building."""
    is_guessed = buildings.inside(bounds_m).is_guessed
    return float(is_guessed.mean()) if is_guessed.size else 0.0


def height_guesses(
    buildings: Footprints | None, bounds_m: Bounds, file: settings.Buildings, crs: str
) -> Guesses:
    """Return the guesses on the heights of the buildings in a box: on those that are guessed, and on impossible ones.

    There is none if few are guessed and none is above `HIGHEST_M`.

    Args:
      buildings: None of a height raster, of which nothing is guessed.
      bounds_m: x_min, y_min, x_max, y_max of the box in the buildings' CRS.
      file: the rules by which heights were guessed.
      crs: of the buildings.
    """
    if buildings is None:
        return {}
    inside = buildings.inside(bounds_m)
    numbers = vars(file) | {"layer_clearance_m": LAYER_CLEARANCE_M}
    counts = {words: int((inside.origin == origin).sum()) for origin, words in GUESSED_BY.items()}
    kinds = ", ".join(f"{num:,} {words.format(**numbers)}" for words, num in counts.items() if num)
    guesses = share_guess(
        guessed_share(buildings, bounds_m),
        "heights",
        f"the heights of the {len(inside):,} buildings in the region are guessed ({kinds}): give a source with "
        "heights, or set [buildings] level_height_m and default_height_m",
    )
    high = inside.take(inside.height_m > HIGHEST_M)
    if len(high):
        lon, lat = lonlat_boxes(high.polygons, crs)[0, :2]
        guesses[f"{len(high):,} roofs above {HIGHEST_M:g} m"] = (
            f"{len(high):,} buildings are above {HIGHEST_M:g} m, the highest of the world, such as that of "
            f"{high.height_m[0]:g} m at {lon:.5f}, {lat:.5f} (lon, lat): mend their heights"
        )
    return guesses


def structure_guesses(
    structures: Footprints | None, issues: ReadIssues, bounds_m: Bounds
) -> Guesses:
    """Return the guess on structures in a box whose height or extent is not known, and on what is not read.

    Args:
      structures: None of a raster.
      issues: of what reads them.
      bounds_m: x_min, y_min, x_max, y_max of the box in the structures' CRS.
    """
    if structures is None:
        return {}
    unknown = structures.take(structures.touches(bounds_m) & structures.is_guessed)
    kinds = listed_counts(Counter(unknown.kinds))
    reason = ReadIssue.NOT_IN_TABLE  # what may stand all the same
    not_read = listed_counts({reason: issues.get(reason, 0)})
    guesses = {}
    if kinds:
        guesses[f"{len(unknown):,} structures of unknown height"] = (
            f"the height or the extent of {len(unknown):,} structures in the region is not known ({kinds}): paths keep "
            "away from them and checks do not judge what flies near them, up to what their kind may reach; give them "
            "heights, or a file in which they are whole"
        )
    if not_read:
        guesses["what is not read"] = (
            f"what the file of buildings has of these is not read, so that nothing keeps away from it: {not_read}"
        )
    return guesses


def census_guesses(issues: ReadIssues, blocks: Blocks, files: "Population") -> Guesses:
    """Return the guesses on the people in census blocks and on their districts, empty without any.

    Args:
      issues: of `read_blocks`.
      blocks: that were read.
      files: that they were read from.
    """
    guesses = {}
    num_missing = issues[ReadIssue.BLOCKS_WITHOUT_COUNT]
    num_unreadable = issues[ReadIssue.COUNTS_UNREADABLE]
    if not (blocks.night_count.any() or np.any(blocks.day_count)):
        guesses["nobody"] = (
            "all census counts in and around the region are 0: check [population] table and its count"
        )
    elif num_missing:
        guesses[f"{num_missing:,} blocks without a count"] = (
            f"{num_missing:,} of {len(blocks):,} census blocks in and around the region are read as 0 people (in "
            f"{num_unreadable:,} the count cannot be read, {num_missing - num_unreadable:,} have none): mend the "
            "counts, or write 0 where nobody lives"
        )

    # Districts: an empty list of commercial ones is no guess.
    listed = files.commercial or files.commercial_labels
    is_known = bool(listed) and issues[ReadIssue.COMMERCIAL_NOT_FOUND] < len(listed)
    means_none = files.commercial is not None and not files.commercial
    if files.districts is not None and not (is_known or means_none):
        guesses["no commercial district"] = (
            f"[population] commercial lists no district of {Path(files.districts).name!r} ({files.district_field}), so "
            "all count as residential and by day every block takes gamma_residential: list the labels, or give [] for "
            "none"
        )
    return guesses


def is_of_sky(name: str) -> bool:
    """Return whether a guess of this name is one of satellites, which only GPS maps rest on."""
    return name in (NOMINAL_SKY, ELEMENTS_TIME) or name.endswith(BEYOND_DATA)


def is_of_people(name: str) -> bool:
    """Return whether a guess of this name is one of how many people are where."""
    words = (
        "nobody",
        "without a count",
        "no commercial district",
        "people by factors",
        "without census",
    )
    return name.endswith(words)


def time_guess(time: str) -> Guesses:
    """Return the guess that a sky stands at its elements' own time, as no time is given."""
    return {
        ELEMENTS_TIME: f"no times are given: satellites stand as at {time}, the middle of their elements' "
        "epochs; set [gps] times for another"
    }


def nominal_guess(systems: Sequence[str], times: Sequence[str], is_papers: bool) -> Guesses:
    """Return the guess that the satellites of some systems are nominal.

    Args:
      systems: names of constellations.
      times: at which they stand; the guess names the first.
      is_papers: the time is the paper's, as no other is given.
    """
    when = times[0]
    if is_papers:
        when += ", the paper's time"
    elif len(times) > 1:
        when += " and later"
    names = " and ".join(system.upper() for system in systems)
    return {
        NOMINAL_SKY: f"the {names} satellites are nominal ones at {when}, not the real ones: name a file of elements "
        "in [gps] orbits"
    }
