"""What the paper's figures and tables share: two cities, the caption beneath, and files to look at and to print.

`TOWNS` are the synthetic city, over the paper's 10 x 20 km, and Lower Manhattan, where the data files are at hand
(``JAXURBAN_DATA``, default ``../shared/data``). Their maps are made once, under out/figures.
"""

import os
import re
import textwrap
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
from jaxurban.io.read.census import CensusFiles, read_blocks, read_districts
from jaxurban.report.figures import plot_metric
from jaxurban.report.figures.frame import KEY
from jaxurban.report.figures.style import FAINT_INK, INK, SMALL_PT
from jaxurban.report.write import framed, write_png
from jaxurban.scenario.run import ScenarioRun, load_city, run_scenario
from jaxurban.scenario.settings import Scenario
from jaxurban.studies.montecarlo.strata import STRATA, strata_of
from jaxurban.world.city import Blocks, City
from jaxurban.world.grid import Grid

ROOT = Path(__file__).parents[2]
HERE, OUT = ROOT / "figures" / "paper", ROOT / "out" / "figures"
DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT.parent / "shared" / "data"))
MAP_M, PATH_M = 2.0, 5.0  # the paper's cells: of its maps, of its paths
ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
BOUNDS = (-74.03, 40.68, -73.9107, 40.86)  # the paper's region: 10 x 20 km around Manhattan
EPOCH = "2020-04-27T16:00:00Z"
OSM, ORBITS = DATA / "osm/lower-manhattan.osm.pbf", DATA / "gps/gps-ops_2020-04-27.tle"
CENSUS = {
    "blocks": DATA / "census/tl_2010_36061_tabblock10.shp",
    "table": DATA / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
    "districts": DATA / "districts/nyc_community_districts.geojson",
}
CREDIT = "buildings © OpenStreetMap contributors (ODbL); US Census Bureau; NYC Open Data"
UNIT = re.compile(r"(?<=\d) (?=(m|km|s|km²)\b|%)|(?<=\d) (?=x \d)|(?<=\d x) (?=\d)|(?<=\b1) (?=- m)|(?<=\b1 -) (?=m)")
HEADS = ("The paper", "Here", "Why they differ")
CAPTION_COLUMN_IN, LINE_IN, LETTERS_PER_IN = 1.25, 0.148, 15.0


class Caption(NamedTuple):
    """What stands beneath a figure or table: what the paper shows, what is seen here, and why they differ."""

    paper: str
    here: str
    why: str


class Town(NamedTuple):
    """A city that the figures are drawn of: its name in files and in sentences, its scenario, the altitudes drawn."""

    name: str
    title: str
    scenario: dict
    drawn_m: tuple[float, ...]

    def run(self) -> ScenarioRun:
        """Return the maps by resolution, made if they are not there yet, and the record of how."""
        return _run(self.name)

    def maps(self, resolution_m: float) -> ju.MetricMaps:
        """Return the maps of one resolution."""
        return self.run().maps[resolution_m]


_REGION = {"resolution_m": [MAP_M, PATH_M], "altitudes_m": list(ALTITUDES_M)}
_PLANNING = {"obstacles": "centre"}  # the paper's rule
SYNTHETIC = Town(
    "synthetic",
    "the synthetic city",
    {
        "region": {"bounds": BOUNDS, **_REGION},
        "buildings": {"source": "synthetic"},
        "gps": {"times": [EPOCH]},
        "planning": _PLANNING,
    },
    (20.0, 60.0, 122.0),
)
MANHATTAN = Town(
    "manhattan",
    "Lower Manhattan",
    {
        "region": {"bounds": (-74.02, 40.70, -73.98, 40.73), **_REGION},
        "buildings": {"source": str(OSM)},
        "gps": {"orbits": str(ORBITS), "times": [EPOCH]},
        "population": {name: str(file) for name, file in CENSUS.items()},
        "planning": _PLANNING,
    },
    ALTITUDES_M,
)
HAS_CENSUS = all(file.exists() for file in CENSUS.values())
TOWNS = (SYNTHETIC, MANHATTAN) if HAS_CENSUS and OSM.exists() and ORBITS.exists() else (SYNTHETIC,)


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
    commercial = Scenario.from_dict(SYNTHETIC.scenario).population.commercial
    blocks, _ = read_blocks(
        CensusFiles(CENSUS["blocks"], CENSUS["table"], districts=CENSUS["districts"], commercial=commercial),
        "EPSG:32618",
    )
    return blocks


@cache
def new_york_districts() -> tuple[np.ndarray, np.ndarray]:
    """Return the community districts of all New York, cut at the shore, in UTM 18N, and their labels."""
    polygons, labels, _ = read_districts(CENSUS["districts"], "EPSG:32618")
    return polygons, labels


@cache
def synthetic_city() -> City:
    """Return the synthetic city over the paper's region, in UTM 18N."""
    return load_city(Scenario.from_dict(SYNTHETIC.scenario))


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
        outlines.append(Outline.make_compound_path(*(Outline(np.asarray(ring.coords), closed=True) for ring in rings)))
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
    return by_altitude({z: float(is_so(z)[maps.is_free(z, "centre")].mean()) for z in ALTITUDES_M}, ".1%")


def in_strata(maps: ju.MetricMaps, metric: str, altitude_m: float) -> str:
    """Return the mean of a metric over the free cells of each stratum (`studies.strata`), ``high-rise 0.93, ...``."""
    strata, is_free, m = strata_of(maps), maps.is_free(altitude_m, "centre"), maps.m(metric, altitude_m)
    chosen = {name: is_free & (strata == number) for number, name in enumerate(STRATA)}
    found = {name: float(m[cells].mean(dtype=float)) for name, cells in chosen.items() if cells.any()}
    return ", ".join(f"{name} {value:.2f}" for name, value in reversed(found.items()))


def draw_metric(number: int, metric: str, caption: Callable[[Town, ju.MetricMaps], Caption]) -> None:
    """Draw the maps of a metric for every town, with the caption that they get."""
    for town in TOWNS:
        maps = town.maps(MAP_M)
        figure = plot_metric(maps, metric, altitudes_m=town.drawn_m)
        save(figure, f"fig_{number:02}_{metric}_{town.name}", caption(town, maps))


def save(figure: Figure, name: str, caption: Caption) -> None:
    """Write a figure with its caption beneath: figures/paper/NAME.png to look at, out/figures/NAME.pdf to print."""
    write_beneath(figure, caption)
    OUT.mkdir(parents=True, exist_ok=True)
    write_png(figure, kept(name) / f"{name}.png")
    figure.savefig(OUT / f"{name}.pdf", dpi=300, metadata={"CreationDate": None})
    print(f"  {name}.png", flush=True)


def kept(name: str) -> Path:
    """Return where a picture or table is kept: not beside the scripts if it lacks the other city's part."""
    return HERE if len(TOWNS) > 1 or name.endswith(f"_{SYNTHETIC.name}") else OUT


def write_beneath(figure: Figure, caption: Caption) -> None:
    """Make the figure taller at its foot and write the caption there."""
    width_in, height_in = figure.get_size_inches()
    letters = int((width_in - CAPTION_COLUMN_IN - 0.3) * LETTERS_PER_IN)
    paragraphs = [textwrap.fill(UNIT.sub("\u00a0", text), letters) for text in caption]  # no line begins with a unit
    room_in = sum(LINE_IN * (text.count("\n") + 1) + 0.07 for text in paragraphs) + 0.16
    total_in = height_in + room_in
    figure.set_size_inches(width_in, total_in)

    def lifted(y: float) -> float:
        return (y * height_in + room_in) / total_in

    if (layout := figure.get_layout_engine()) is not None:
        x0, y0, width, height = layout.get()["rect"]
        layout.set(rect=(x0, lifted(y0), width, height * height_in / total_in))
    for axes in figure.axes:
        if layout is None or axes.get_gid() == KEY:
            box = axes.get_position(original=True)
            axes.set_position((box.x0, lifted(box.y0), box.width, box.height * height_in / total_in))
    for text in figure.texts:
        text.set_y(lifted(text.get_position()[1]))
    for legend in figure.legends if layout is None else ():  # at the foot
        legend.set_bbox_to_anchor((0, room_in / total_in, 1, 1 - room_in / total_in))
    y_in = room_in - 0.08
    for head, text in zip(HEADS, paragraphs, strict=True):
        look = {"va": "top", "size": SMALL_PT + 0.5, "in_layout": False, "linespacing": 1.2}
        figure.text(0.15 / width_in, y_in / total_in, head, weight="bold", color=INK, **look)
        figure.text(CAPTION_COLUMN_IN / width_in, y_in / total_in, text, color=FAINT_INK, **look)
        y_in -= LINE_IN * (text.count("\n") + 1) + 0.07


def save_table(table: pd.DataFrame, name: str, title: str, caption: Caption) -> None:
    """Write a table with its caption beneath as figures/paper/NAME.md."""
    beneath = [f"**{head}.** {text}" for head, text in zip(HEADS, caption, strict=True)]
    OUT.mkdir(parents=True, exist_ok=True)
    (kept(name) / f"{name}.md").write_text(
        "\n\n".join([f"### {title}", framed(table), *beneath]) + "\n", encoding="utf-8"
    )
    print(f"  {name}.md", flush=True)
