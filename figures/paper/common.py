"""What the paper's figures and tables share: two cities, captions in words, and files to look at and to print.

`TOWNS` are the sample cities of the package. Their maps are made once, under out/figures, with the real satellites of
their days where these elements are under ``JAXURBAN_DATA`` (default ``../shared/data``), else with the samples' nominal
ones. What is of all Manhattan needs its files there besides and is left out without them. With ``--small`` all is drawn
on coarser cells, under out/figures-small alone, to see that it can be.
"""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline

import jaxurban as ju
from jaxurban.cities.census import read_blocks, read_districts
from jaxurban.draw.write import framed, write_picture
from jaxurban.io.samples import SAMPLES
from jaxurban.maps.run import ScenarioRun, run_scenario
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.population import Population
from jaxurban.plot import plot_metric
from jaxurban.studies.montecarlo.sampling import STRATA, strata_of
from jaxurban.world.blocks import Blocks, Zoning
from jaxurban.world.grid import Bounds, Grid

ROOT = Path(__file__).parents[2]
IS_SMALL = "--small" in sys.argv  # of `python -m figures`
HERE, OUT = ROOT / "figures" / "paper", ROOT / "out" / ("figures-small" if IS_SMALL else "figures")
DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT.parent / "shared" / "data"))
MAP_M, PATH_M = (
    (10.0, 20.0) if IS_SMALL else (2.0, 5.0)
)  # the paper's cells: of its maps, of its paths
ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
GOOD = 0.5  # a sensor serves where its m is at least this
DRAWN_M = ALTITUDES_M[:3]  # of the paper's maps; at 600 m they are of one colour
BOUNDS = (-74.03, 40.68, -73.9107, 40.86)  # the paper's region: 10 x 20 km around Manhattan
CRS = "EPSG:32618"  # of all that is drawn of New York
OSM, ORBITS = DATA / "osm/lower-manhattan.osm.pbf", DATA / "gps/gps-ops_2020-04-27.tle"
TOKYO_ORBITS = DATA / "tokyo/gps_2018-12-19.tle", DATA / "tokyo/galileo_2018-12-19.tle"
CENSUS = {
    "blocks": DATA / "census/tl_2010_36061_tabblock10.shp",
    "table": DATA / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
    "districts": DATA / "districts/nyc_community_districts.geojson",
}
LOOK_DPI = 190  # of the pictures to look at
CREDIT = "buildings © OpenStreetMap contributors (ODbL); US Census Bureau; NYC Open Data"
HEADS = ("The paper", "Here", "Why they differ")


class Caption(NamedTuple):
    """What stands beneath a figure or table: what the paper shows, what is seen here, and why they differ."""

    paper: str
    here: str
    why: str


class Town(NamedTuple):
    """A city that the figures are drawn of: its name in files and in sentences, and its scenario."""

    name: str
    title: str
    scenario: dict

    def run(self) -> ScenarioRun:
        """Return the maps by resolution, made if they are not there yet, and the record of how."""
        return _run(self.name)

    def maps(self, resolution_m: float) -> ju.MetricMaps:
        """Return the maps of one resolution."""
        return self.run().maps[resolution_m]


def _town(name: str, title: str, sample: str, *orbits: Path) -> Town:
    region, rule = (
        {"resolution_m": [MAP_M, PATH_M], "altitudes_m": list(ALTITUDES_M)},
        {"obstacles": "centre"},
    )
    gps = dict(SAMPLES[sample]["gps"])
    if all(file.exists() for file in orbits):
        gps["orbits"] = [str(file) for file in orbits]
    buildings = {"source": f"sample:{sample}"}
    scenario = {"region": region, "buildings": buildings, "gps": gps, "planning": rule}
    return Town(name, title, scenario | {"obstacles": {"kinds": ["building"]}})


MANHATTAN = _town("manhattan", "Lower Manhattan", "lower-manhattan", ORBITS)
SHINJUKU = _town("shinjuku", "Shinjuku", "shinjuku", *TOKYO_ORBITS)
TOWNS = (MANHATTAN, SHINJUKU)
HAS_ISLAND = all(
    file.exists() for file in (OSM, *CENSUS.values())
)  # census and districts of all Manhattan


@cache
def _run(name: str) -> ScenarioRun:
    town = next(town for town in TOWNS if town.name == name)
    return run_scenario(
        Scenario.from_dict(town.scenario),
        OUT / name,
        overwrite=True,
    )


@cache
def manhattan_blocks() -> Blocks:
    """Return the census blocks of all Manhattan with their districts, in UTM 18N."""
    commercial = Scenario.from_dict(MANHATTAN.scenario).population.commercial
    blocks, _ = read_blocks(
        ju.Population(
            blocks=CENSUS["blocks"],
            table=CENSUS["table"],
            districts=CENSUS["districts"],
            commercial=commercial,
        ),
        CRS,
    )
    return blocks


def population_totals(
    blocks: Blocks,
    params: Population | None = None,
    bounds_m: Bounds | None = None,
    is_cut: bool = False,
) -> dict[str, dict[str, float]]:
    """Return the people of the blocks by time of day and zoning.

    Keys are ``night`` and ``day``, under each ``commercial``, ``residential``, ``other`` and ``total``.

    Args:
      blocks: the census blocks.
      params: settings whose gammas make the people by day, where the blocks do not hold these; left out, the paper's.
      bounds_m: x_min, y_min, x_max, y_max: only the blocks that touch this box count; left out, all.
      is_cut: whether a block that reaches beyond the box counts only with the people inside, spread evenly over its
        area; otherwise it counts whole.
    """
    params = params or Population()
    share = np.ones(len(blocks)) if bounds_m is None else blocks.touches(bounds_m)
    if is_cut and bounds_m is not None:
        inside_m2 = shapely.area(shapely.intersection(blocks.polygons, shapely.box(*bounds_m)))
        share = share * inside_m2 / np.where(blocks.area_m2 > 0, blocks.area_m2, 1.0)

    def by_zoning(count: np.ndarray) -> dict[str, float]:
        """Return the sum of the counts ``[N]`` of the blocks, each times its share, by zoning."""
        people = count * share
        return {
            zone.name.lower(): float(people[blocks.zoning == zone].sum())
            for zone in reversed(Zoning)
        }

    night = by_zoning(blocks.night_count)
    if blocks.day_count is None:
        day = {name: count * params.gamma_residential for name, count in night.items()}
        day["commercial"] = night["commercial"] * params.gamma_commercial
    else:
        day = by_zoning(blocks.day_count)
    for counts in (night, day):
        counts["total"] = sum(counts.values())
    return {"night": night, "day": day}


@cache
def new_york_districts() -> tuple[np.ndarray, np.ndarray]:
    """Return the community districts of all New York, cut at the shore, in UTM 18N, and their labels."""
    polygons, labels, _ = read_districts(CENSUS["districts"], CRS)
    return polygons, labels


@cache
def region_grid(resolution_m: float = 10.0) -> Grid:
    """Return the grid of the paper's region, all of it, whatever a town's data cover."""
    return Grid.from_bounds(BOUNDS, resolution_m)


def add_polygons(panel: Axes, polygons: Iterable[shapely.Geometry], **look) -> PathCollection:
    """Draw polygons with their holes into a panel and return them; ``look`` as for matplotlib's collections."""
    outlines = []
    for polygon in polygons:
        parts = [shapely.orient_polygons(part) for part in shapely.get_parts(polygon)]
        rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
        outlines.append(
            Outline.make_compound_path(
                *(Outline(np.asarray(ring.coords), closed=True) for ring in rings)
            )
        )
    drawn = PathCollection(outlines, **look)
    panel.add_collection(drawn, autolim=False)
    return drawn


def by_altitude(values: Mapping[float, float], form: str = ".2f") -> str:
    """Return ``0.84 / 0.88 / 0.89 at 20 / 60 / 122 m``."""
    shown = " / ".join(format(value, form).replace("%", " %") for value in values.values())
    return f"{shown} at {' / '.join(f'{altitude_m:g}' for altitude_m in values)} m"


def means(maps: ju.MetricMaps, metric: str) -> str:
    """Return the mean of a metric over the free cells, by altitude."""
    free = {z: maps.m(metric, z)[maps.is_free(z, "centre")] for z in ALTITUDES_M}
    return by_altitude({z: float(values.mean(dtype=float)) for z, values in free.items()})


def shares(maps: ju.MetricMaps, is_so: Callable[[float], np.ndarray]) -> str:
    """Return the share of the free cells of which something is so, by altitude."""
    return by_altitude(
        {z: float(is_so(z)[maps.is_free(z, "centre")].mean()) for z in ALTITUDES_M}, ".1%"
    )


def in_strata(maps: ju.MetricMaps, metric: str, altitude_m: float) -> str:
    """Return the mean of a metric over the free cells of each stratum (`studies.strata`), ``high-rise 0.93, ...``."""
    strata, is_free, m = (
        strata_of(maps),
        maps.is_free(altitude_m, "centre"),
        maps.m(metric, altitude_m),
    )
    chosen = {name: is_free & (strata == number) for number, name in enumerate(STRATA)}
    found = {
        name: float(m[cells].mean(dtype=float)) for name, cells in chosen.items() if cells.any()
    }
    return ", ".join(f"{name} {value:.2f}" for name, value in reversed(found.items()))


def draw_metric(
    number: int, metric: str, caption: Callable[[Town, ju.MetricMaps], Caption]
) -> None:
    """Draw the maps of a metric for every town, with the caption that they get."""
    for town in TOWNS:
        maps = town.maps(MAP_M)
        figure = plot_metric(maps, metric, altitude_m=DRAWN_M)
        save(figure, f"fig_{number:02}_{metric}_{town.name}", caption(town, maps))


def save(figure: Figure, name: str, caption: Caption) -> None:
    """Write a figure: figures/paper/NAME.png to look at, its caption in NAME.md, out/figures/NAME.pdf to print."""
    write_text(name, caption)
    write_picture(figure, folder() / f"{name}.png", dpi=LOOK_DPI)
    write_picture(figure, OUT / f"{name}.pdf")


def folder() -> Path:
    """Return where pictures and tables are kept: beside the scripts, but for the small ones."""
    return OUT if IS_SMALL else HERE


def needs_island(name: str) -> bool:
    """Return whether the files of all Manhattan are there, and print what is not drawn where they are not."""
    if not HAS_ISLAND:
        print(
            f"  {name} is of all Manhattan: not drawn, its census is not under JAXURBAN_DATA ({DATA})",
            flush=True,
        )
    return HAS_ISLAND


def save_table(table: pd.DataFrame, name: str, title: str, caption: Caption) -> None:
    """Write a table with its caption beneath as figures/paper/NAME.md."""
    write_text(name, caption, f"### {title}", framed(table))


def write_text(name: str, caption: Caption, *above: str) -> None:
    """Write figures/paper/NAME.md: a caption, and what stands above it."""
    beneath = [f"**{head}.** {text}" for head, text in zip(HEADS, caption, strict=True)]
    OUT.mkdir(parents=True, exist_ok=True)
    (folder() / f"{name}.md").write_text("\n\n".join([*above, *beneath]) + "\n", encoding="utf-8")
    print(f"  {name}", flush=True)
