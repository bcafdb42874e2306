"""Draw docs/sky.png and docs/sky_*.png: what the sample log of a receiver in Tokyo says of the maps, one at a look."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

import jaxurban as ju
from benchmarks.receiver.evidence import Evidence, evidence_of
from benchmarks.receiver.pictures import draw_cities, plot_displacement
from jaxurban.draw.style import INK, chart, dress, letter_all, styled
from jaxurban.draw.write import write_picture
from jaxurban.receivers.figures import draw_horizon, sky_places
from jaxurban.receivers.report import HIDDEN, SEEN, satellite_figures

NAMES = ("sky", "sky_track", "sky_margin", "sky_displacement")
CLASSES = ((False, "hidden by a building", "^", HIDDEN), (True, "in view", "o", SEEN))
DOCS = Path(__file__).parents[1] / "docs"
WIDTH_MM = 120.0  # that of a column of README, where letters are as large as its text
EDGES_DBHZ = (25, 30, 35, 40, 45)  # between the classes of received satellites


@styled
def plot_sky(evidence: Evidence, credit: str) -> Figure:
    """Return the sky of one place, how strongly hidden and visible satellites are heard, and displaced cities."""
    heading = "Satellites that the maps call hidden are mostly heard weakly or not at all"
    figure = chart(3.6, heading, credit, width=WIDTH_MM)
    grid = figure.add_gridspec(3, 2, height_ratios=(1, 1, 0.01))  # the last row holds the legend
    place = figure.add_subplot(grid[:2, 0], projection="polar")
    strengths, cities = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    of = evidence.of
    sky, judged = of.skies[-1], of.rows[of.rows.is_judged]
    draw_horizon(place, sky.horizon_deg)
    place.set_title(f"place of {sky.name}")
    for is_seen, name, marker, colour in CLASSES:
        rows = sky.satellites[sky.satellites.is_seen == is_seen]
        heard = rows.cn0_dbhz > 0
        x, y = sky_places(rows).T
        size = 15 + 1.8 * (rows.cn0_dbhz - 20).clip(lower=0)
        look = {"marker": marker, "linewidths": 0.6, "zorder": 5}
        place.scatter(
            x[heard], y[heard], s=size[heard], color=colour, edgecolors=INK, label=name, **look
        )
        place.scatter(x[~heard], y[~heard], s=20, facecolors="white", edgecolors=colour, **look)
        rows = judged[judged.is_seen == is_seen]
        number = np.digitize(rows.cn0_dbhz, [1, *EDGES_DBHZ])
        shares = np.bincount(number, minlength=len(EDGES_DBHZ) + 2) / len(rows)
        strengths.bar(np.arange(len(shares)) + 0.4 * is_seen - 0.2, shares, width=0.4, color=colour)
    place.set_anchor("N")
    place.set_xlabel("large: heard strongly\nhollow: not at all", labelpad=8)
    holder = figure.add_subplot(grid[2, :])
    holder.set_axis_off()
    holder.legend(*place.get_legend_handles_labels(), loc="center", ncols=2, borderaxespad=0)
    strengths.set_xticks([0, *np.arange(len(EDGES_DBHZ)) + 1.5], ["none", *EDGES_DBHZ])
    strengths.set(
        xlabel="C/N0 at the receiver (dBHz)", ylabel="share of each kind", title="all places"
    )
    strengths.yaxis.set_major_formatter(PercentFormatter(1.0))
    draw_cities(cities, evidence, {"auc": INK})
    cities.get_legend().remove()
    cities.set_title("city moved 80 to 450 m")
    in_place = cities.lines[0].get_xdata()[0]
    cities.text(in_place, cities.get_ylim()[1], "in its place ", ha="right", va="top")
    for panel in (strengths, cities):
        dress(panel)
    letter_all([place, strengths, cities])
    strengths.set_title(
        strengths.get_title("left"), pad=18
    )  # as high as that beside it, above the N
    return figure


def main() -> None:
    evidence = evidence_of(ju.Scenario.from_toml("sample:nihonbashi"))
    of = evidence.of
    figures = {
        "sky": partial(plot_sky, evidence, f"Data: {of.attribution}; log: Taro Suzuki (MIT)"),
        "sky_displacement": partial(plot_displacement, evidence),
    }
    figures |= {f"sky_{name}": draw for name, draw in satellite_figures(of).items()}
    for name in NAMES:
        write_picture(figures[name](), DOCS / f"{name}.png")


if __name__ == "__main__":
    main()
