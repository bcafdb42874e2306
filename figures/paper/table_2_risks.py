"""Table 2 of the paper: common risks of small UAS, and which of them the maps measure."""

import numpy as np
import pandas as pd

from figures.paper.common import MAP_M, TOWNS, Caption, Town, save_table
from jaxurban.maps.build import view_sky
from jaxurban.maps.guesses import leaving_share
from jaxurban.maps.run import gps_of, load_city
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.gps import Rating, rating

ALTITUDE_M, MIN_SATELLITES = 20.0, 4
PAPER = (
    "Five kinds of risk with examples. The paper models the environment's, since vehicle and weather do not stay in "
    "place."
)
NOT_MAPPED = "no"


def measured(town: Town) -> dict[str, str]:
    """Return what the maps of a town say of each risk, by the name of its row."""
    maps = town.maps(MAP_M)
    is_free, settings = maps.is_free(ALTITUDE_M, "centre"), Scenario.from_dict(town.scenario)

    def percent(is_so: np.ndarray) -> str:
        return f"{100 * is_so[is_free].mean():.1f} %"

    is_poor = np.asarray(rating(maps.m("gdop", ALTITUDE_M))) == Rating.POOR
    over = {time: maps.m("density", time_of_day=time)[is_free] for time in maps.times_of_day}
    people = "no census"
    if over:
        densities = ", ".join(
            f"{np.mean(density, dtype=float):,.0f} per km² by {time}"
            for time, density in over.items()
        )
        share = percent(maps.m("density", time_of_day="night") > 0)
        people = f"{share} lie over blocks with people; on average {densities}"
    scenario = Scenario.from_dict(town.scenario)
    city = load_city(scenario)
    buildings = city.buildings.inside(maps.grid.bounds_m)
    guessed = buildings.origin_counts().get("default", 0)
    beyond = leaving_share(city, maps.grid, view_sky(maps.grid, gps_of(scenario)), ALTITUDE_M)
    return {
        "canyon": f"{percent(maps.m('num_visible', ALTITUDE_M) < MIN_SATELLITES)} see fewer than {MIN_SATELLITES}; "
        f"GDOP is above {settings.gps.gdop_threshold:g} or unknown in {percent(is_poor)}",
        "view": f"{percent(maps.m('lidar', ALTITUDE_M) == 0)} get no return at all",
        "near": f"{percent(maps.m('risk', ALTITUDE_M) < 1)} are closer than {settings.risk.threshold_m:g} m",
        "people": people,
        "unmapped": f"{100 * (~maps.ds['has_data'].values).mean():.1f} % without data; "
        f"{100 * guessed / len(buildings):.1f} % of {len(buildings):,} buildings "
        f"have a guessed height; {100 * beyond:.0f} % of the rays to satellites leave the known buildings",
    }


def common_and_rare(by: dict[str, str]) -> str:
    """Return the commonest and the rarest of a town's risks."""
    return f"{by['near']}, {by['canyon'].split(';')[0]}"


def main() -> None:
    found = {town.title: measured(town) for town in TOWNS}
    settings = Scenario.from_dict(TOWNS[0].scenario)
    risks = (
        ("System", "deadlock, overheating, short circuit, software", NOT_MAPPED, None),
        ("Actuators", "shaft, relay, pneumatic or hydraulic failure", NOT_MAPPED, None),
        (
            "Sensors",
            "urban canyon: satellites hidden by buildings",
            f"`gps`, satellites above {settings.gps.mask_deg:g}°",
            "canyon",
        ),
        (
            "Sensors",
            "no landmark in view of the lidar",
            f"`lidar`, range {settings.lidar.range_m:g} m",
            "view",
        ),
        ("Sensors", "faulty or drifting sensors", NOT_MAPPED, None),
        ("Weather", "cold batteries, poor visibility, ice, gusts", NOT_MAPPED, None),
        (
            "Environment",
            "close to buildings",
            f"`risk`, threshold {settings.risk.threshold_m:g} m",
            "near",
        ),
        ("Environment", "over people", "`population`, by day and night", "people"),
        ("Environment", "unmapped areas", "partly: `has_data` and `run.json`", "unmapped"),
    )
    table = pd.DataFrame(
        [
            {"Type": kind, "Risk": risk, "In our maps": how}
            | {title: "" if key is None else by[key] for title, by in found.items()}
            for kind, risk, how, key in risks
        ]
    )
    num_measured = sum(how != NOT_MAPPED for _, _, how, _ in risks)
    parts = [f"in {title} {common_and_rare(by)}" for title, by in found.items()]
    here = (
        f"{num_measured} of {len(risks)} risks have a number for every place, the others none. Shares are of the free "
        f"cells {ALTITUDE_M:g} m above ground, {MAP_M:g} m a cell, one epoch of the satellites. A wall near by is "
        f"common, a lack of satellites rare: {'; '.join(parts)}."
    )
    why = (
        "Failures of system and actuators belong to an aircraft and weather to an hour: neither has a place on a "
        "map, as the paper says itself. Poor visibility could be had as a shorter `[lidar] range_m`. Receivers' "
        "noise and reflected signals are left out of `gps`, which knows geometry alone. The paper gives no number to "
        "compare with."
    )
    save_table(
        table, "table_2_risks", "Table 2. Common risks of small UAS", Caption(PAPER, here, why)
    )
