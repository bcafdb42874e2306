"""Draw docs/sky.png and docs/sky_*.png: what the sample log of a receiver in Tokyo says of the maps, one at a look."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

import jaxurban as ju
from jaxurban.report.figures.style import INK, chart, dress, letter_all, styled
from jaxurban.report.satellites import CLASSES, SEEN, draw_cities, draw_horizon, satellite_figures
from jaxurban.report.write import write_picture
from jaxurban.studies.receiver.agreement import SatelliteAgreement

NAMES = ("sky", "sky_track", "sky_margin", "sky_displacement", "sky_skies")
DOCS = Path(__file__).parents[1] / "docs"
LEAST_DBHZ = {
    "not\nreceived": 0,
    "below\n25": 1,
    "25 to\n30": 25,
    "30 to\n35": 30,
    "35 to\n40": 35,
    "40 to\n45": 40,
}
LEAST_DBHZ["45 and\nmore"] = 45


@styled
def plot_sky(of: SatelliteAgreement, credit: str) -> Figure:
    """Return the sky of one place, how strongly hidden and visible satellites are heard, and displaced cities."""
    heading = "Where the maps say that a building hides a satellite, the receiver mostly hears it weakly or not at all"
    figure = chart(2.8, heading, credit)
    grid = figure.add_gridspec(1, 3, width_ratios=(1.1, 1.2, 1.0))
    place = figure.add_subplot(grid[0], projection="polar")
    strengths, cities = figure.add_subplot(grid[1]), figure.add_subplot(grid[2])
    sky, judged = of.skies[-1], of.rows[of.rows.is_judged]
    draw_horizon(place, sky.horizon_deg)
    place.set_title(f"the sky at the place of {sky.name}")
    for is_seen, name, marker, colour in CLASSES:
        rows = sky.satellites[sky.satellites.is_seen == is_seen]
        heard = rows.cn0_dbhz > 0
        x, y = np.radians(rows.azimuth_deg), 90 - rows.elevation_deg
        size = 15 + 1.8 * (rows.cn0_dbhz - 20).clip(lower=0)
        look = {"marker": marker, "linewidths": 0.6}
        place.scatter(x[heard], y[heard], s=size[heard], color=colour, edgecolors=INK, **look)
        place.scatter(x[~heard], y[~heard], s=20, facecolors="white", edgecolors=colour, **look)
        rows = judged[judged.is_seen == is_seen]
        number = np.digitize(rows.cn0_dbhz, [*LEAST_DBHZ.values()]) - 1
        shares = np.bincount(number, minlength=len(LEAST_DBHZ)) / len(rows)
        strengths.bar(
            np.arange(len(shares)) + 0.4 * is_seen - 0.2,
            shares,
            width=0.4,
            color=colour,
            label=name,
        )
    place.set_xlabel("grey: buildings  ·  large: heard strongly  ·  hollow: not at all")
    strengths.legend(loc="upper center")
    strengths.set_xticks(range(len(LEAST_DBHZ)), [*LEAST_DBHZ])
    strengths.set(
        xlabel="C/N0 at the receiver (dBHz)", ylabel="share of each kind", title="at all places"
    )
    strengths.yaxis.set_major_formatter(PercentFormatter(1.0))
    draw_cities(cities, of, {"auc": SEEN})
    cities.set_title(f"the city moved by 80 to 450 m, {len(of.displaced)} times")
    cities.set_xlabel("agreement (AUC; 0.5 by chance, 1 at best)")
    for panel in (strengths, cities):
        dress(panel)
    letter_all([place, strengths, cities])
    return figure


def main() -> None:
    found = ju.studies.validate(ju.Scenario.from_toml("sample:nihonbashi"), progress=False)
    assert found.satellites is not None
    figures = {
        "sky": partial(
            plot_sky, found.satellites, f"Data: {found.attribution}; log: Taro Suzuki (MIT)"
        )
    }
    figures |= {
        f"sky_{name}": draw for name, draw in satellite_figures(found, found.satellites).items()
    }
    for name in NAMES:
        write_picture(figures[name](), DOCS / f"{name}.png")


if __name__ == "__main__":
    main()
