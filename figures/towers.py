"""Draw docs/towers.png, the picture of README: the two routes of its example over the quality of GPS."""

from pathlib import Path

import numpy as np
from matplotlib.patheffects import withStroke

import jaxurban as ju
from jaxurban.draw import frame
from jaxurban.draw.write import write_picture
from jaxurban.plot import plot_metric

DOCS = Path(__file__).parents[1] / "docs"
SCREEN_DPI = 140  # dots an inch of a page's width
ENDS = (-74.0120, 40.7015), (-74.0110, 40.7170)  # longitude, latitude: the Battery and Tribeca
QUERY = {"altitude_m": 40.0, "snap": True}
CASED = {"path_effects": [withStroke(linewidth=4.0, foreground="black")]}
MARGIN_M = 200.0  # of the city around the routes, three times above them


def main() -> None:
    city = ju.sample_city("lower-manhattan")
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(40.0,))
    shortest = ju.plan(maps, *ENDS, objective="distance", **QUERY)
    round_towers = ju.plan(maps, *ENDS, weights={"gps": 20}, **QUERY)
    figure = plot_metric(maps, "gps", width=130.0)
    axes = figure.axes[0]
    lines = []
    for path, name, colour in (
        (shortest, "shortest route", "tab:red"),
        (round_towers, "route that avoids poor GPS", "white"),
    ):
        no_fix_m = ju.explain(path, maps).totals["no_fix_m"]
        label = f"{name}: {path.length_m:,.0f} m, {no_fix_m:.0f} m without a position fix"
        lines += axes.plot(*path.xy_m.T, color=colour, linewidth=2.5, label=label, **CASED)
    x_m, y_m = np.concatenate([shortest.xy_m, round_towers.xy_m]).T
    side_m = np.ptp(y_m) + 4 * MARGIN_M
    west_m = max(x_m.min() - MARGIN_M, maps.grid.x_min_m)
    axes.set_xlim(west_m, west_m + side_m)
    axes.set_ylim(max(y_m.min() - MARGIN_M, maps.grid.y_min_m), y_m.max() + 3 * MARGIN_M)
    frame.mark_ends(axes, *shortest.xy_m[[0, -1]])
    # Above the routes and beside the arrow to the north.
    look = {"loc": "upper left", "frameon": True, "facecolor": "white", "framealpha": 1.0}
    axes.legend(handles=[*lines, *frame.ENDS], fontsize=8.0, **look)
    write_picture(figure, DOCS / "towers.png", dpi=SCREEN_DPI)


if __name__ == "__main__":
    main()
