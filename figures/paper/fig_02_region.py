"""Figure 2 of the paper: the region of the study, 10 x 20 km around Manhattan."""

import numpy as np
import osmium
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from figures.paper.common import (
    BOUNDS,
    CREDIT,
    MANHATTAN,
    OSM,
    TOWNS,
    Caption,
    add_polygons,
    manhattan_blocks,
    new_york_districts,
    region_grid,
    save,
    synthetic_city,
)
from jaxurban.report.figures.frame import MapPanel, draw_maps, joined
from jaxurban.report.figures.style import FAINT_INK, INK, Colours
from jaxurban.world.city import OTHER_DISTRICT
from jaxurban.world.grid import WGS84, Grid, transformer
from jaxurban.world.synthetic_streets import CityPlan

WATER, LAND, FAR_LAND, PARK = "#dbe6ee", "#ffffff", "#ececec", "#b9d8a8"
BOX, EXTRACT, STUDY = "#111111", "#0072b2", "#d55e00"
BORDER, ROOFS = "#7a4b8c", "cividis_r"  # dark towers over pale houses
MANHATTAN_LABELS, CENTRAL_PARK = range(101, 113), 164
AROUND_M = (900, 900, 900, 2600)  # shown beyond the region: west, south, east, north
PAPER = (
    "The box L, 10 km wide and 20 km tall, centred in Manhattan, over a street map. Its corners are not given, and no "
    "other data are shown."
)


def shown_grid() -> Grid:
    """Return what both towns' pictures show: the region and a little more."""
    grid = region_grid()
    return grid.padded(*(round(metres / grid.resolution_m) for metres in AROUND_M))


def box_of(bounds: tuple[float, float, float, float]) -> shapely.Polygon:
    """Return a box of longitudes and latitudes in the region's CRS; its sides bend with the projection."""
    edges = shapely.segmentize(shapely.box(*bounds), 0.005)
    return shapely.transform(edges, transformer(WGS84, region_grid().crs).transform, interleaved=False)


def extract_bounds() -> tuple[float, float, float, float]:
    """Return the box that the OSM extract says it holds."""
    with osmium.io.Reader(str(OSM), osmium.osm.NOTHING) as reader:
        box = reader.header().box()
    return box.bottom_left.lon, box.bottom_left.lat, box.top_right.lon, box.top_right.lat


def begin(title: str, legend: dict[str, dict], credit: str = "", colours: Colours | None = None) -> tuple[Figure, Axes]:
    """Return a picture and its panel, water drawn; ``legend``: entries, each with the look of its patch."""
    grid = region_grid()
    width_km, height_km = (grid.x_max_m - grid.x_min_m) / 1e3, (grid.y_max_m - grid.y_min_m) / 1e3
    note = joined(f"L: {width_km:.1f} x {height_km:.1f} km", grid.crs, credit)
    handles = [Patch(label=name, **look) for name, look in legend.items()]
    look = {"legend": handles, "colours": colours}
    figure, (panel,) = draw_maps(shown_grid(), [MapPanel(title)], "The region of the study", note, **look)
    panel.set_facecolor(WATER)
    corner = {"size": 13, "weight": "bold", "ha": "left", "va": "top", "color": INK, "zorder": 10}
    panel.text(grid.x_min_m + 250, grid.y_max_m - 200, "L", bbox={"facecolor": "white", "pad": 2}, **corner)
    return figure, panel


def outline(colour: str, width: float, style: str = "-", fill: str = "none") -> dict:
    """Return the look of what has a border."""
    return {"facecolor": fill, "edgecolor": colour, "linestyle": style, "linewidth": width}


def draw_manhattan() -> None:
    polygons, labels = new_york_districts()
    blocks, is_ours = manhattan_blocks(), np.isin(labels, [*MANHATTAN_LABELS, CENTRAL_PARK])
    boxes = {
        "region L": outline(BOX, 1.6, "--"),
        "OSM extract\nat hand": outline(EXTRACT, 1.2),
        "box of our\nLower Manhattan\nmaps": outline(STUDY, 2.2),
    }
    legend = {
        "district": outline(BORDER, 1.0, fill=LAND),
        "census block": outline("#9a9a9a", 0.4, fill=LAND),
        "Central Park": outline(FAINT_INK, 0.4, fill=PARK),
        "other boroughs": outline(FAINT_INK, 0.4, fill=FAR_LAND),
        "water, or land\nwithout data\n(New Jersey)": outline(FAINT_INK, 0.4, fill=WATER),
    }
    figure, panel = begin("Manhattan: census blocks and districts", boxes | legend, CREDIT.split("; ", 1)[1])
    region = shapely.box(*region_grid().bounds_m)
    seen = shapely.intersects(polygons, shapely.box(*shown_grid().bounds_m))
    flat = {"linewidth": 0, "rasterized": True}
    add_polygons(panel, polygons[seen & ~is_ours], facecolor=FAR_LAND, **flat)
    add_polygons(panel, polygons[is_ours], facecolor=LAND, **flat)
    add_polygons(panel, polygons[labels == CENTRAL_PARK], facecolor=PARK, **flat)
    ashore = blocks.polygons[shapely.intersects(blocks.polygons, shapely.union_all(polygons[is_ours]))]
    add_polygons(panel, ashore, facecolor="none", edgecolor="#9a9a9a", linewidth=0.2, rasterized=True)
    add_polygons(panel, polygons[is_ours], facecolor="none", edgecolor=BORDER, linewidth=1.0)
    extract, study = box_of(extract_bounds()), box_of(MANHATTAN.scenario["region"]["bounds"])
    for polygon, look in zip((region, extract, study), boxes.values(), strict=True):
        add_polygons(panel, [polygon], zorder=9, **look)
    island = shapely.union_all(polygons[is_ours])
    land_km2 = {
        name: shapely.area(shapely.intersection(island, box)) / 1e6 for name, box in (("L", region), ("study", study))
    }
    all_km2 = shapely.area(island) / 1e6
    centre = shapely.point_on_surface(blocks.polygons)
    people_in = blocks.night_count[shapely.contains(region, centre)].sum() / blocks.night_count.sum()
    north_m = shapely.bounds(island)[3] - region_grid().y_max_m
    south_m = shapely.bounds(polygons[labels == MANHATTAN_LABELS[0]]).min(axis=0)[1] - region_grid().y_min_m
    here = (
        f"L drawn to scale over the census and district data. It holds {100 * land_km2['L'] / all_km2:.0f} % of "
        f"Manhattan's {all_km2:.1f} km² of land and {100 * people_in:.0f} % of its residents; the northern "
        f"{north_m / 1e3:.1f} km stick out, while {south_m / 1e3:.1f} km lie free in the south. Buildings are at hand "
        f"for the blue box alone, and our maps of Lower Manhattan, the orange one, cover {land_km2['study']:.1f} km² "
        "of its land."
    )
    why = (
        f"The paper gives no corners: L here is {BOUNDS[0]} to {BOUNDS[2]}° in longitude and {BOUNDS[1]} to "
        f"{BOUNDS[3]}° in latitude, snapped outward to whole cells. A box further north would hold all of Manhattan. "
        "OpenStreetMap's file of the whole planet, which the paper cut, is not at hand, so the whole of L is tried "
        "on the synthetic city only."
    )
    save(figure, "fig_02_region_manhattan", Caption(PAPER, here, why))


def draw_synthetic() -> None:
    city, region = synthetic_city(), shapely.box(*region_grid().bounds_m)
    plan = CityPlan(city.extent_m)
    buildings = city.buildings.take(shapely.intersects(city.buildings.polygons, region))
    blocks, parts = city.blocks, plan.parts()
    norm = PowerNorm(0.5, 0, float(buildings.height_m.max()))
    legend = {
        "region L, all of\nit mapped": outline(BOX, 1.6, "--"),
        "district 1 to 12": outline(BORDER, 1.2, fill=LAND),
        "park": outline(FAINT_INK, 0.4, fill=PARK),
        "suburb": outline(FAINT_INK, 0.4, fill=FAR_LAND),
        "water": outline(FAINT_INK, 0.4, fill=WATER),
    }
    ticks = [tick for tick in (0, 5, 20, 50, 100, 200, 400, 800) if tick <= buildings.height_m.max()]
    roofs = Colours(ROOFS, norm, "roof above ground (m)", ticks=ticks)
    figure, panel = begin("The synthetic city: land, park, districts and roofs", legend, colours=roofs)
    flat = {"linewidth": 0, "rasterized": True}
    for part in parts:
        land = shapely.intersection(part.land, plan.box)
        add_polygons(panel, [land], facecolor=LAND if part.is_island else FAR_LAND, **flat)
    add_polygons(panel, [plan.park()], facecolor=PARK, **flat)
    order = np.argsort(buildings.height_m, kind="stable")
    heights = {"array": buildings.height_m[order], "cmap": ROOFS, "norm": norm}
    add_polygons(panel, buildings.polygons[order], **heights, **flat)
    numbers = [number for number in np.unique(blocks.district) if number != OTHER_DISTRICT]
    districts = [shapely.union_all(blocks.polygons[blocks.district == number].copy()).buffer(2) for number in numbers]
    add_polygons(panel, districts, facecolor="none", edgecolor=BORDER, linewidth=1.2, zorder=5)
    add_polygons(panel, [region], zorder=9, **outline(BOX, 1.6, "--"))
    island_km2 = sum(shapely.area(part.land) for part in parts if part.is_island) / 1e6
    land_km2 = sum(shapely.area(shapely.intersection(part.land, plan.box)) for part in parts) / 1e6
    num_towers = int((buildings.height_m > 122).sum())
    here = (
        f"The same box holds a synthetic city: {len(buildings):,} buildings on {land_km2:.0f} km² of land. An island "
        f"of {island_km2:.0f} km² carries a park, twelve districts and two clusters of towers; {num_towers} roofs "
        f"are above 122 m, the highest at {buildings.height_m.max():.0f} m."
    )
    why = (
        "It is no map of New York. It stands in for the buildings of the whole region, which are not at hand, and "
        "comes with the package, so that every figure of the full 10 x 20 km can be drawn by anyone. Nothing is "
        "built beyond the box."
    )
    save(figure, "fig_02_region_synthetic", Caption(PAPER, here, why))


def main() -> None:
    draw_synthetic()
    if MANHATTAN in TOWNS:
        draw_manhattan()
