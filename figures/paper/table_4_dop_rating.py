"""Table 4 of the paper: ratings of the dilution of precision, and how much of each town falls under each."""

from collections import Counter

import numpy as np
import pandas as pd

from figures.paper.common import ALTITUDES_M, MAP_M, TOWNS, Caption, Town, by_altitude, save_table
from jaxurban.maps.build import view_sky
from jaxurban.maps.run import gps_of
from jaxurban.maps.scenario import Scenario
from jaxurban.metrics.gps import RATING_UPPER_GDOP, Rating, rating

NAMES = {"gps": "GPS", "galileo": "Galileo"}
PAPER = (
    "Six ratings of the dilution of precision (DOP), from 1, ideal, to above 20, poor. "
    "No share of the city is given."
)


def shares(town: Town) -> dict[float, np.ndarray]:
    """Return the percentages of the free cells in each rating, and last of those without any fix, by altitude."""
    maps, found = town.maps(MAP_M), {}
    for z in ALTITUDES_M:
        gdop = maps.m("gdop", z)[maps.is_free(z, "centre")]
        count = np.bincount(rating(gdop), minlength=len(Rating))
        found[z] = 100 * np.append(count, np.isinf(gdop).sum()) / gdop.size
        assert np.isclose(found[z][:-1].sum(), 100), "the ratings leave cells out"
    return found


def main() -> None:
    found = {town.title: shares(town) for town in TOWNS}
    lows = ("", *(f"above {high:g} " for high in RATING_UPPER_GDOP))
    highs = (*(f"to {high:g}" for high in RATING_UPPER_GDOP), "")
    ranges = [
        f"{low}{high}".replace(" to", ", to").strip().strip(",")
        for low, high in zip(lows, highs, strict=True)
    ]
    table = pd.DataFrame(
        {
            "GDOP": [*ranges, "unknown"],
            "Rating": [*(item.name.capitalize() for item in Rating), "of these without a fix"],
        }
        | {
            f"{title}, {z:g} m (%)": [f"{value:.2f}" for value in percent]
            for title, by in found.items()
            for z, percent in by.items()
        }
    )
    parts, skies = [], []
    for town, by in zip(TOWNS, found.values(), strict=True):
        good = {z: percent[: Rating.GOOD + 1].sum() for z, percent in by.items()}
        parts.append(f"{town.title} {by_altitude(good, '.1f')}")
        maps = town.maps(MAP_M)
        best = float(np.nanmin(maps.m("gdop", ALTITUDES_M[-1])))
        sky = view_sky(maps.grid, gps_of(Scenario.from_dict(town.scenario)))
        counts = Counter(sorted(sky.in_view(0).systems))
        systems = " and ".join(f"{num} of {NAMES[system]}" for system, num in counts.items())
        skies.append(f"{town.title} {systems} and a GDOP of {best:.2f} at best")
    here = (
        f"Good or better, percent of the free cells, {MAP_M:g} m a cell: {'; '.join(parts)}. A GDOP of 1 or less "
        "needs many more satellites than were up. A cell without a fix sees fewer satellites than three and one for "
        "the clock of each system seen, or satellites that leave the position undetermined; it counts as poor."
    )
    why = (
        "The paper rates but does not count. The shares hold for one moment each "
        f"({', '.join(town.maps(MAP_M).times[0] for town in TOWNS)}) and satellites above 5 degrees. Under an open sky "
        f"there are in {'; in '.join(skies)}. The paper's mask is the horizon and its moment unknown."
    )
    save_table(
        table,
        "table_4_dop_rating",
        "Table 4. Rating of the dilution of precision",
        Caption(PAPER, here, why),
    )
