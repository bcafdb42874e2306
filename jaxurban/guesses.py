"""Guesses: what maps rest on that their files do not say, each under a short name (for pictures) as one sentence.

They are written down where they are made: on the `City` by what reads it, on the `Sky` by what sets it up, and by
`guesses_of` what a region's maps add. The maps hold all of them (``ds.attrs["guesses"]``), and each is warned of once.
"""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import shapely

from jaxurban.city import Blocks, Buildings, City, HeightOrigin
from jaxurban.errors import GuessWarning
from jaxurban.grid import Bounds, Grid
from jaxurban.io.knownarea import rays_leaving
from jaxurban.io.rasterise import building_index, highest_top_m
from jaxurban.metrics.population import BlockLayers, PopulationParams, region_blocks
from jaxurban.sky import Sky
from jaxurban.surface import NO_BUILDING

Guesses = dict[str, str]

TOLD_SHARE = 0.01  # of buildings, cells or answers: a box in degrees and its projection differ by less
DRAWN_SHARE = 0.10  # of buildings: from here on the picture of heights tells guessed ones apart
EMPTY_SHARE = 0.10  # of the region without a census block: rivers and the sea often have none
SCALE_M, SCALE_SHARE = 1 / 3, 0.01  # no more than this share of inhabited blocks above this m: few set the scale
NOMINAL_SKY = "nominal satellites"


def warn_of(guesses: Mapping[str, str], told: Mapping[str, str] | None = None) -> None:
    """Warn of each guess that has not been told already."""
    for name, sentence in guesses.items():
        if name not in (told or {}):
            warnings.warn(sentence, GuessWarning, stacklevel=3)


def percent(share: float) -> str:
    """Return a share in whole percent, never 0 or 100 % where it is not."""
    return "< 1 %" if 0 < share < 0.01 else "> 99 %" if 0.99 < share < 1 else f"{100 * share:.0f} %"


def guessed_share(buildings: Buildings, bounds_m: Bounds) -> float:
    """Return the share of the buildings in a box whose height is guessed, 0 without a building."""
    is_guessed = buildings.is_guessed[shapely.intersects(buildings.polygons, shapely.box(*bounds_m))]
    return float(is_guessed.mean()) if is_guessed.size else 0.0


def draws_guesses(city: City, region: Grid) -> bool:
    """Return whether so many of a region's heights are guessed that pictures tell them apart."""
    return city.buildings is not None and guessed_share(city.buildings, region.bounds_m) >= DRAWN_SHARE


def guessed_roofs(city: City, region: Grid, grid: Grid, all_touched: bool) -> np.ndarray | None:
    """Return ``[Y, X]`` bool: whether the highest roof of each cell of ``grid`` has a guessed height.

    None where fewer than `DRAWN_SHARE` of the region's buildings have one: the maps then say nothing of single roofs.
    """
    if not draws_guesses(city, region):
        return None
    assert city.buildings is not None
    building = building_index(city, grid, all_touched)
    return (building != NO_BUILDING) & city.buildings.is_guessed[building]


def height_guesses(
    buildings: Buildings | None, bounds_m: Bounds, default_height_m: float, level_height_m: float
) -> Guesses:
    """Return what was supposed of the heights of the buildings in a box; nothing of a height raster."""
    if buildings is None or (share := guessed_share(buildings, bounds_m)) < TOLD_SHARE:
        return {}
    inside = buildings.take(shapely.intersects(buildings.polygons, shapely.box(*bounds_m)))
    num_levels, num_default = (int((inside.origin == o).sum()) for o in (HeightOrigin.LEVELS, HeightOrigin.DEFAULT))
    return {
        f"{percent(share)} of heights": (
            f"the heights of {percent(share)} of the {len(inside):,} buildings in the region are guessed "
            f"({num_levels:,} by {level_height_m:g} m a level, {num_default:,} the default of {default_height_m:g} m): "
            "give a source with heights, or set [buildings] level_height_m and default_height_m"
        )
    }


def count_guesses(faults: Mapping[str, int], blocks: Blocks) -> Guesses:
    """Return what was supposed of the people in census blocks, by the faults of `jaxurban.io.census.read_blocks`."""
    if not blocks.night_count.any():
        return {"nobody": "all census counts in and around the region are 0: check [population] table and its count"}
    num_missing, num_unreadable = faults["blocks_without_count"], faults["counts_unreadable"]
    if not num_missing:
        return {}
    return {
        f"{num_missing:,} blocks without a count": (
            f"{num_missing:,} of {len(blocks):,} census blocks in and around the region are read as 0 people (in "
            f"{num_unreadable:,} the count is no number, {num_missing - num_unreadable:,} have none): mend the counts, "
            "or write 0 where nobody lives"
        )
    }


def district_guesses(
    faults: Mapping[str, int], source: str | Path, field: str, commercial: Sequence[int] | None, known: Sequence[int]
) -> Guesses:
    """Return what was supposed of the districts: that none is commercial, as nobody says which.

    Args:
      faults: of `jaxurban.io.census.read_blocks`.
      source, field: of the districts.
      commercial: labels as they were asked for; None where nobody did.
      known: those that are taken instead.
    """
    if commercial is None and not known:
        found = f"nobody says which districts of {Path(source).name!r} ({field}) are commercial, so none is"
    elif commercial and faults["commercial_not_found"] == len(commercial):
        found = f"{Path(source).name!r} has no district ({field}) of the [population] commercial list, so none is"
    else:
        return {}
    return {
        "no commercial district": f"{found} and by day every block takes gamma_residential: list the labels in "
        "[population] commercial, or give [] for none"
    }


def time_guess(time: str) -> Guesses:
    """Return that a sky stands at its elements' own time."""
    return {
        "time of the elements": f"no times are given: satellites stand as at {time}, the middle of their elements' "
        "epochs; set [gps] times for another"
    }


def nominal_guess(times: Sequence[str], is_papers: bool) -> Guesses:
    """Return that GPS satellites are nominal; ``is_papers``: at the paper's time, as no other is given."""
    when = times[0] + (", the paper's time" if is_papers else " and later" if len(times) > 1 else "")
    return {
        NOMINAL_SKY: f"the GPS satellites are nominal ones at {when}, not the real ones: name a file of elements in "
        "[gps] orbits"
    }


def guesses_of(
    city: City,
    region: Grid,
    sky: Sky,
    *,
    altitudes_m: Sequence[float],
    mask_deg: float,
    people: BlockLayers | None,
    population: PopulationParams,
) -> Guesses:
    """Return every guess behind a region's maps.

    Args:
      city: what is mapped. One that is from no files (the embedded city) has no real sky and nothing beyond its edge.
      region: the maps' grid.
      sky: their satellites.
      altitudes_m: flight altitudes.
      mask_deg: elevation mask.
      people: of the city's blocks, None without them.
      population: its settings.
    """
    guesses = {**city.guesses, **sky.guesses}
    if city.sources:
        guesses |= _answer_guesses(city, region, sky, min(altitudes_m), mask_deg)
    else:
        guesses.pop(NOMINAL_SKY, None)
    guesses |= _coverage_guesses(city, region)
    if city.blocks is not None and people is not None:
        guesses |= _scale_guesses(city.blocks, region.bounds_m, people, population)
    return guesses


def outside_share(city: City, region: Grid) -> float:
    """Return the share of the region that lies beyond what the building source covers."""
    whole = shapely.box(*region.bounds_m)
    return 1.0 - float(shapely.intersection(whole, city.known_area).area) / float(whole.area)


def _coverage_guesses(city: City, region: Grid) -> Guesses:
    """Return how much of the region is taken as free of buildings, or of people, as nothing is known there."""
    guesses, box = {}, shapely.box(*region.bounds_m)
    if (outside := outside_share(city, region)) > TOLD_SHARE:
        guesses[f"{percent(outside)} of the region without data"] = (
            f"{percent(outside)} of the region lies beyond what the building source covers and is taken as free of "
            "buildings: give a source that covers it, or a smaller region"
        )
    if city.blocks is not None and city.sources:
        empty = 1.0 - float(shapely.area(shapely.intersection(city.blocks.polygons, box)).sum()) / float(box.area)
        if empty > EMPTY_SHARE:
            guesses[f"{percent(empty)} of the region without census"] = (
                f"{percent(empty)} of the region lies in no census block and is taken as without people: give blocks "
                "that cover it, unless it is water"
            )
    return guesses


def leaving_shares(city: City, region: Grid, sky: Sky, altitude_m: float, mask_deg: float) -> tuple[float, float]:
    """Return the shares of cells and of answers whose rays leave the data while a roof could still block them.

    Of cells: those with any such ray. Of answers: a cell, a satellite, an epoch each.
    """
    leaves = rays_leaving(city, region, *_runs_m(city, sky, altitude_m, mask_deg))
    return float(leaves.any(axis=1).mean()), float(leaves.mean())


def _runs_m(city: City, sky: Sky, altitude_m: float, mask_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return how far east and north each ray above the mask runs until it is above the highest roof."""
    above = sky.elevation_rad >= np.radians(mask_deg)
    run_m = max(highest_top_m(city) - altitude_m, 0.0) / np.tan(sky.elevation_rad[above])
    return run_m * np.sin(sky.azimuth_rad[above]), run_m * np.cos(sky.azimuth_rad[above])


def _answer_guesses(city: City, region: Grid, sky: Sky, altitude_m: float, mask_deg: float) -> Guesses:
    _, share = leaving_shares(city, region, sky, altitude_m, mask_deg)
    if share < TOLD_SHARE:
        return {}
    return {
        f"{percent(share)} of satellite answers beyond the data": (
            f"{percent(share)} of the satellite answers at {altitude_m:g} m are of rays that leave the data below the "
            "highest roof, so GPS may look better than it is: give buildings farther around"
        )
    }


def _scale_guesses(blocks: Blocks, bounds_m: Bounds, people: BlockLayers, params: PopulationParams) -> Guesses:
    """Return that one block sets the population's scale, at the first time of day where one does."""
    if params.normalise != "max":
        return {}
    in_region = region_blocks(blocks, bounds_m)
    for m, norm in zip(np.asarray(people.m, float)[:, in_region], people.norm_per_km2, strict=True):
        inhabited = m[m > 0]
        if len(inhabited) < 3 or (inhabited > SCALE_M).sum() > max(1, SCALE_SHARE * len(inhabited)):
            continue
        top = in_region[m.argmax()]
        unit = "people" if params.quantity == "count" else "people per km2"
        usual = float(f"{float(norm) * np.percentile(inhabited, 99):.1g}")
        return {
            "one block sets the population scale": (
                f"census block {blocks.block_id[top]} ({blocks.area_m2[top]:,.0f} m2) with {float(norm):,.0f} {unit} "
                f"sets the population scale alone: the median inhabited block gets {np.median(inhabited):.2f}; set "
                f'[population] normalise to a percentile such as "p99" or to a number of {unit} such as {usual:.0f}'
            )
        }
    return {}
