"""Table 5 of the paper: the people of Manhattan by day and night, and what the census gives under the paper's rule."""

from dataclasses import replace

import numpy as np
import pandas as pd

from figures.paper.common import Caption, manhattan_blocks, needs_island, save_table
from jaxurban.metrics.population import Population, block_people, day_share
from jaxurban.world.blocks import Blocks

MOSS = {
    "weekday-12": 3.94,
    "weekend-12": 2.90,
    "weekday-00": 2.05,
}  # millions in 2010: the paper's Table 5
HEADS = {"weekday-12": "Working day, noon", "weekend-12": "Weekend, noon", "weekday-00": "Night"}
PAPER = (
    "Moss and Qing's estimates for 2010, in millions: 3.94 on a working day, 2.90 on a weekend day, 2.05 at night. "
    "The paper scales the census instead, by 3.0 in commercial and 0.5 in residential districts by day."
)


def millions(blocks: Blocks, params: Population) -> dict[str, float]:
    """Return the people of all blocks in millions, by hour of the week."""
    gammas = params.gamma_commercial, params.gamma_residential
    return {
        hour: float(
            np.sum(
                block_people(blocks.night_count, blocks.zoning, day_share(hour), *gammas),
                dtype=float,
            )
        )
        / 1e6
        for hour in MOSS
    }


def main() -> None:
    if not needs_island("Table 5"):
        return
    params = Population()
    rule = f"factors {params.gamma_commercial:g} and {params.gamma_residential:g}"
    blocks = manhattan_blocks()
    none, one = (
        millions(blocks, replace(params, gamma_commercial=each))["weekday-12"]
        for each in (0.0, 1.0)
    )
    gamma = (MOSS["weekday-12"] - none) / (one - none)  # people are linear in it
    census = millions(blocks, params)
    rows = {
        "Moss and Qing, as the paper quotes them": MOSS,
        f"Manhattan, 2010 census, {rule}": census,
        f"Manhattan, 2010 census, factors {gamma:.2f} and {params.gamma_residential:g}": millions(
            blocks, replace(params, gamma_commercial=gamma)
        ),
    }
    table = pd.DataFrame(
        [
            {"Millions of people": name}
            | {HEADS[hour]: f"{value:.2f}" for hour, value in by.items()}
            for name, by in rows.items()
        ]
    )
    night, day = census["weekday-00"], census["weekday-12"]
    here = (
        f"The 2010 census counts {night:.3f} million in Manhattan, {100 * (1 - night / MOSS['weekday-00']):.0f} % "
        f"below the night of Moss and Qing; the paper's factors make {day:.2f} million of them by day, "
        f"{100 * (1 - day / MOSS['weekday-12']):.0f} % below. Their {MOSS['weekday-12']:.2f} million needs a "
        f"commercial factor of {gamma:.2f} beside the residential {params.gamma_residential:g}."
    )
    why = (
        "A census counts residents: visitors in hotels and commuters who work at night are not in it. The factors "
        f"change the day alone, so that no choice of them reaches {MOSS['weekday-00']:.2f} million at night. The "
        "weekend follows Moss and Qing by design: its share of the way from night to working day is taken from them."
    )
    save_table(
        table,
        "table_5_people_by_time",
        "Table 5. People by day and night",
        Caption(PAPER, here, why),
    )
