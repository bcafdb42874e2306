"""Draw docs/overview.png and docs/profile.png: maps of the sample city Lower Manhattan and two routes through it."""

from pathlib import Path

import jaxurban as ju
from jaxurban.draw.write import write_picture
from jaxurban.plot import plot_overview, save_profile

DOCS = Path(__file__).parents[1] / "docs"
SCREEN_DPI = 140  # dots an inch of a page's width
ALTITUDE_M, RESOLUTION_M = 40.0, 5.0
START, GOAL = (-74.0172, 40.7130), (-73.9815, 40.7265)  # Battery Park City, East Village


def main() -> None:
    maps = ju.build_maps(
        ju.sample_city("lower-manhattan"), resolution_m=RESOLUTION_M, altitudes_m=(ALTITUDE_M,)
    )
    wide = ju.Constraints.read(clearance_m=5.0, vertical_clearance_m=5.0)
    query = {
        "start": START,
        "goal": GOAL,
        "altitude_m": ALTITUDE_M,
        "constraints": wide,
        "snap": True,
    }
    routes = {
        name: ju.plan(maps, objective=objective, **query)
        for name, objective in (("cheapest route", "weighted"), ("shortest route", "distance"))
    }
    figure = plot_overview(maps, [*routes.values()], names=[*routes])
    write_picture(figure, DOCS / "overview.png", dpi=SCREEN_DPI)
    save_profile(routes["cheapest route"], maps, DOCS / "profile.png")


if __name__ == "__main__":
    main()
