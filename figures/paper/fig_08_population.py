"""Figure 8 of the paper: population maps by day and by night."""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from figures.paper.common import (
    BOUNDS,
    Caption,
    manhattan_blocks,
    needs_island,
    population_totals,
    save,
)
from jaxurban.draw.frame import NO_DATA_COLOUR, MapPanel, draw_maps
from jaxurban.draw.metrics import EMPTY_COLOUR, colours_of, layers_above_zero
from jaxurban.io.burn import burn
from jaxurban.io.rasterise import NO_BLOCK
from jaxurban.metrics.population import DENSITY, block_layers, map_blocks
from jaxurban.world.grid import Grid

PAPER = (
    "Two maps of m_pop at 2 m without a number. By day the southern, commercial districts (factor 3.0) are the "
    "densest, by night the northern, residential ones (by day factor 0.5): people go to work in the morning and home "
    "in the evening."
)
CELL_M = 10.0  # of all Manhattan


class Island(NamedTuple):
    """What the census says of an island: people per km2 by day and by night ``[2, Y, X]``, NaN outside."""

    grid: Grid
    density: np.ndarray


def island() -> Island:
    blocks = manhattan_blocks()
    grid = Grid.from_bounds(BOUNDS, CELL_M)
    index = burn(blocks.polygons, np.arange(len(blocks)), grid, NO_BLOCK, "int32")[0]
    return Island(
        grid,
        np.where(
            index == NO_BLOCK, np.nan, map_blocks(index, block_layers(blocks).density_per_km2)
        ),
    )


def draw_island(found: Island) -> Figure:
    colours = colours_of(DENSITY, lambda: found.density, DENSITY.heading)
    cells_km2 = CELL_M**2 / 1e6
    panels = []
    for name, density in zip(("day", "night"), found.density, strict=True):
        title = f"{name}  ·  {np.nansum(density) * cells_km2 / 1e6:.2f} million people"
        panels.append(MapPanel(title, layers_above_zero(density, colours)))
    note = f"Manhattan, 2010 census blocks (US Census Bureau)  ·  {CELL_M:g} m cells  ·  {found.grid.crs}"
    legend = [("nobody, or water", EMPTY_COLOUR), ("no census", NO_DATA_COLOUR)]
    return draw_maps(
        found.grid, panels, "Population density", note, legend=legend, colours=colours
    )[0]


def norm_text(density: np.ndarray) -> str:
    """Return how far the densest block stands above the median one."""
    lived_in = density[density > 0]  # NaN is not
    return (
        f"the densest block has {np.nanmax(density):,.0f} per km2, the median cell that is lived in "
        f"{np.median(lived_in):,.0f}"
    )


def main() -> None:
    if not needs_island("Figure 8"):
        return
    totals, found = population_totals(manhattan_blocks()), island()
    save(
        draw_island(found),
        "fig_08_population_manhattan",
        Caption(
            PAPER,
            f"The same swing from the same census: commercial {totals['night']['commercial'] / 1e6:.2f} million "
            f"people by night and {totals['day']['commercial'] / 1e6:.2f} by day, residential "
            f"{totals['night']['residential'] / 1e6:.2f} and {totals['day']['residential'] / 1e6:.2f} (all of "
            "Manhattan; the titles count what lies in the region).",
            "Drawn is density on a logarithmic scale: m is density over the largest one, and at night "
            f"{norm_text(found.density[1])}. The paper's region holds the Bronx, Queens and New Jersey too; the "
            "census file is of New York County alone. Commercial numbers differ: Table 7.",
        ),
    )
