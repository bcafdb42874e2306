"""Figure 3 of the paper: districts by type, and the census blocks."""

from typing import NamedTuple

import numpy as np
import shapely
from matplotlib.colors import LogNorm
from matplotlib.patheffects import withStroke

from figures.paper.common import (
    CREDIT,
    Caption,
    add_polygons,
    manhattan_blocks,
    needs_island,
    new_york_districts,
    region_grid,
    save,
)
from jaxurban.draw.frame import MapPanel, draw_maps, joined
from jaxurban.draw.style import INK, Colours
from jaxurban.metrics.population import Population, block_layers
from jaxurban.world.blocks import Blocks
from jaxurban.world.grid import Grid

COMMERCIAL, RESIDENTIAL, PARK = (
    "#b2182b",
    "#f4c27a",
    "#4d9221",
)  # dark, light and between them without colour too
OTHER_LAND, WATER, NOBODY = "#ececec", "#dbe6ee", "#ffffff"
NUM_COMMERCIAL, NUM_DISTRICTS = 6, 12  # districts 1 to 6 are commercial
MANHATTAN_LABEL, CENTRAL_PARK = 100, 164
DENSITY, SCALE_PER_KM2, MARGIN_M = "magma_r", (1e3, 2e5), 500.0
SHORE_M = 2.0  # bridges the slivers between blocks when they are joined to a district
PAPER = (
    "Manhattan's twelve districts, commercial ones red, residential ones blue, Central Park green; and the census "
    "blocks as polygons, without a scale."
)


class Ground(NamedTuple):
    """What a city's picture is drawn from: districts by number, the park, land around, and blocks cut at the shore."""

    name: str
    title: str
    credit: str
    grid: Grid
    districts: dict[int, shapely.Geometry]
    park: shapely.Geometry
    around: np.ndarray
    blocks: Blocks
    outlines: np.ndarray


def manhattan() -> Ground:
    """Return all Manhattan, by the census."""
    polygons, labels = new_york_districts()
    numbers = range(1, NUM_DISTRICTS + 1)
    districts = {
        number: shapely.union_all(polygons[labels == MANHATTAN_LABEL + number])
        for number in numbers
    }
    park = shapely.union_all(polygons[labels == CENTRAL_PARK])
    blocks, land = manhattan_blocks(), shapely.union_all(polygons)
    shapely.prepare(land)
    outlines = blocks.polygons.copy()
    wet = ~shapely.contains_properly(land, outlines)
    outlines[wet] = shapely.intersection(outlines[wet], land)
    ours = shapely.bounds(shapely.union_all([*districts.values(), park]))
    resolution_m = region_grid().resolution_m
    low, high = (
        (np.array(ours[:2]) - MARGIN_M) / resolution_m,
        (np.array(ours[2:]) + MARGIN_M) / resolution_m,
    )
    (first_col, first_row), (end_col, end_row) = (
        np.floor(low).astype(int),
        np.ceil(high).astype(int),
    )
    grid = Grid(
        region_grid().crs,
        resolution_m,
        int(first_row),
        int(first_col),
        int(end_row - first_row),
        int(end_col - first_col),
    )
    is_other = (labels // 100 != 1) & shapely.intersects(polygons, shapely.box(*grid.bounds_m))
    credit = CREDIT.split("; ", 1)[1]
    return Ground(
        "manhattan",
        "Manhattan",
        credit,
        grid,
        districts,
        park,
        polygons[is_other],
        blocks,
        outlines,
    )


def draw(ground: Ground) -> None:
    """Write a city's picture."""
    norm = LogNorm(*SCALE_PER_KM2)
    legend = [
        (f"commercial,\ndistricts 1 to {NUM_COMMERCIAL}", COMMERCIAL),
        (f"residential,\ndistricts {NUM_COMMERCIAL + 1} to {NUM_DISTRICTS}", RESIDENTIAL),
        ("park", PARK),
        ("other land", OTHER_LAND),
        ("water, or land\nwithout data", WATER),
        ("(b) nobody", NOBODY),
    ]
    colours = Colours(DENSITY, norm, "(b) people per km²", extend="both", ticks=(1e3, 1e4, 1e5))
    panels = [MapPanel("districts by type"), MapPanel("residents by census block, at night")]
    heading, note = (
        f"Districts and census blocks of {ground.title}",
        joined(ground.grid.crs, ground.credit),
    )
    figure, axes = draw_maps(ground.grid, panels, heading, note, legend=legend, colours=colours)
    flat = {"linewidth": 0, "rasterized": True}
    for panel in axes:
        panel.set_facecolor(WATER)
        add_polygons(panel, ground.around, facecolor=OTHER_LAND, **flat)
    left, right = axes
    border = {"edgecolor": INK, "linewidth": 0.6}
    for number, polygon in ground.districts.items():
        is_commercial = number <= NUM_COMMERCIAL
        add_polygons(
            left, [polygon], facecolor=COMMERCIAL if is_commercial else RESIDENTIAL, **border
        )
        middle = shapely.get_point(shapely.maximum_inscribed_circle(polygon, tolerance=20.0), 0)
        left.text(
            middle.x,
            middle.y,
            str(number),
            ha="center",
            va="center",
            size=10,
            weight="bold",
            color=INK,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
        )
    add_polygons(left, [ground.park], facecolor=PARK, **border)
    density = np.asarray(
        block_layers(ground.blocks, Population(time_of_day="night")).density_per_km2[0]
    )
    is_home = (density > 0) & ~shapely.is_empty(ground.outlines)
    is_empty = (density == 0) & ~shapely.is_empty(ground.outlines)
    thin = {"edgecolor": "#808080", "linewidth": 0.15, "rasterized": True}
    add_polygons(right, ground.outlines[is_empty], facecolor=NOBODY, **thin)
    add_polygons(
        right, ground.outlines[is_home], array=density[is_home], cmap=DENSITY, norm=norm, **thin
    )
    save(figure, f"fig_03_districts_{ground.name}", caption(ground, density))


def caption(ground: Ground, density: np.ndarray) -> Caption:
    """Return the caption of a city's picture."""
    blocks, is_home = ground.blocks, density > 0
    densest = int(density.argmax())
    here = (
        f"The same types, with a scale: {len(blocks):,} blocks, {int(is_home.sum()):,} of them inhabited. The median "
        f"inhabited block has {np.median(density[is_home]):,.0f} people per km², the densest {density[densest]:,.0f} "
        f"on {blocks.area_m2[densest]:,.0f} m² ({blocks.night_count[densest]:,.0f} people, district "
        f"{blocks.district[densest] % 100})."
    )
    why = (
        "The same sources, so the same picture. Densities are people over the whole block, as the maps take them; "
        "blocks that reach into the river are cut at the shore in the picture only. The paper's maps divide by the "
        f"densest block, so that a median one gets m = {np.median(density[is_home]) / density[densest]:.2f}."
    )
    return Caption(PAPER, here, why)


def main() -> None:
    if needs_island("Figure 3"):
        draw(manhattan())
