"""Figure 2 of the paper: the region of the study, 10 x 20 km around Manhattan."""

import numpy as np
import osmium
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from figures.paper.common import (
    BOUNDS,
    CREDIT,
    OSM,
    Caption,
    add_polygons,
    manhattan_blocks,
    needs_island,
    new_york_districts,
    region_grid,
    save,
)
from jaxurban.draw.frame import MapPanel, draw_maps, joined
from jaxurban.draw.style import FAINT_INK, INK
from jaxurban.io.samples import SAMPLES
from jaxurban.world.grid import WGS84, Grid, transformer

WATER, LAND, FAR_LAND, PARK = "#dbe6ee", "#ffffff", "#ececec", "#b9d8a8"
BOX, EXTRACT, STUDY = "#111111", "#0072b2", "#d55e00"
BORDER = "#7a4b8c"
MANHATTAN_LABELS, CENTRAL_PARK = range(101, 113), 164
WIDTH_MM = 162.0  # as wide as a map of a page's height and its legend need
AROUND_M = (900, 900, 900, 2600)  # shown beyond the region: west, south, east, north
PAPER = (
    "The box L, 10 km wide and 20 km tall, centred in Manhattan, over a street map. Its corners are not given, and no "
    "other data are shown."
)


def shown_grid() -> Grid:
    """Return what the picture shows: the region and a little more."""
    grid = region_grid()
    return grid.padded(*(round(metres / grid.resolution_m) for metres in AROUND_M))


def box_of(bounds: tuple[float, float, float, float]) -> shapely.Polygon:
    """Return a box of longitudes and latitudes in the region's CRS; its sides bend with the projection."""
    edges = shapely.segmentize(shapely.box(*bounds), 0.005)
    return shapely.transform(
        edges, transformer(WGS84, region_grid().crs).transform, interleaved=False
    )


def extract_bounds() -> tuple[float, float, float, float]:
    """Return the box that the OSM extract says it holds."""
    with osmium.io.Reader(str(OSM), osmium.osm.NOTHING) as reader:
        box = reader.header().box()
    return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat


def begin(title: str, legend: dict[str, dict], credit: str = "") -> tuple[Figure, Axes]:
    """Return a picture and its panel, water drawn; ``legend``: entries, each with the look of its patch."""
    grid = region_grid()
    width_km, height_km = (grid.x_max_m - grid.x_min_m) / 1e3, (grid.y_max_m - grid.y_min_m) / 1e3
    note = joined(f"L: {width_km:.1f} x {height_km:.1f} km", grid.crs, credit)
    handles = [Patch(label=name, **look) for name, look in legend.items()]
    figure, (panel,) = draw_maps(
        shown_grid(),
        [MapPanel(title)],
        "The region of the study",
        note,
        legend=handles,
        width=WIDTH_MM,
    )
    panel.set_facecolor(WATER)
    corner = {"size": 13, "weight": "bold", "ha": "left", "va": "top", "color": INK, "zorder": 10}
    panel.text(
        grid.x_min_m + 250, grid.y_max_m - 200, "L", bbox={"facecolor": "white", "pad": 2}, **corner
    )
    return figure, panel


def outline(colour: str, width: float, style: str = "-", fill: str = "none") -> dict:
    """Return the look of what has a border."""
    return {"facecolor": fill, "edgecolor": colour, "linestyle": style, "linewidth": width}


def draw_manhattan() -> None:
    polygons, labels = new_york_districts()
    blocks, is_ours = manhattan_blocks(), np.isin(labels, [*MANHATTAN_LABELS, CENTRAL_PARK])
    boxes = {
        "region L": outline(BOX, 1.6, "--"),
        "OSM extract of\nthe sample": outline(EXTRACT, 1.2),
        "box of our\nLower Manhattan\nmaps": outline(STUDY, 2.2),
    }
    legend = {
        "district": outline(BORDER, 1.0, fill=LAND),
        "census block": outline("#9a9a9a", 0.4, fill=LAND),
        "Central Park": outline(FAINT_INK, 0.4, fill=PARK),
        "other boroughs": outline(FAINT_INK, 0.4, fill=FAR_LAND),
        "water, or land\nwithout data\n(New Jersey)": outline(FAINT_INK, 0.4, fill=WATER),
    }
    figure, panel = begin(
        "Manhattan: census blocks and districts", boxes | legend, CREDIT.split("; ", 1)[1]
    )
    region = shapely.box(*region_grid().bounds_m)
    seen = shapely.intersects(polygons, shapely.box(*shown_grid().bounds_m))
    flat = {"linewidth": 0, "rasterized": True}
    add_polygons(panel, polygons[seen & ~is_ours], facecolor=FAR_LAND, **flat)
    add_polygons(panel, polygons[is_ours], facecolor=LAND, **flat)
    add_polygons(panel, polygons[labels == CENTRAL_PARK], facecolor=PARK, **flat)
    ashore = blocks.polygons[
        shapely.intersects(blocks.polygons, shapely.union_all(polygons[is_ours]))
    ]
    add_polygons(
        panel, ashore, facecolor="none", edgecolor="#9a9a9a", linewidth=0.2, rasterized=True
    )
    add_polygons(panel, polygons[is_ours], facecolor="none", edgecolor=BORDER, linewidth=1.0)
    extract, study = (
        box_of(extract_bounds()),
        box_of(SAMPLES["lower-manhattan"]["region"]["bounds"]),
    )
    for polygon, look in zip((region, extract, study), boxes.values(), strict=True):
        add_polygons(panel, [polygon], zorder=9, **look)
    island = shapely.union_all(polygons[is_ours])
    land_km2 = {
        name: shapely.area(shapely.intersection(island, box)) / 1e6
        for name, box in (("L", region), ("study", study))
    }
    all_km2 = shapely.area(island) / 1e6
    centre = shapely.point_on_surface(blocks.polygons)
    people_in = (
        blocks.night_count[shapely.contains(region, centre)].sum() / blocks.night_count.sum()
    )
    north_m = shapely.bounds(island)[3] - region_grid().y_max_m
    south_m = (
        shapely.bounds(polygons[labels == MANHATTAN_LABELS[0]]).min(axis=0)[1]
        - region_grid().y_min_m
    )
    here = (
        f"L drawn to scale over the census and district data. It holds {100 * land_km2['L'] / all_km2:.0f} % of "
        f"Manhattan's {all_km2:.1f} km² of land and {100 * people_in:.0f} % of its residents; the northern "
        f"{north_m / 1e3:.1f} km stick out, while {south_m / 1e3:.1f} km lie free in the south. The sample city has "
        "the buildings of the blue box, and our maps of Lower Manhattan, the orange one, cover "
        f"{land_km2['study']:.1f} km² of the island."
    )
    why = (
        f"The paper gives no corners: L here is {BOUNDS[0]} to {BOUNDS[2]}° in longitude and {BOUNDS[1]} to "
        f"{BOUNDS[3]}° in latitude, snapped outward to whole cells. A box further north would hold all of Manhattan. "
        "The paper cut its buildings from OpenStreetMap's file of the whole planet; the package holds a part of it."
    )
    save(figure, "fig_02_region_manhattan", Caption(PAPER, here, why))


def main() -> None:
    if needs_island("Figure 2"):
        draw_manhattan()
