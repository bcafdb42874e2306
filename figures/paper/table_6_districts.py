"""Table 6 of the paper: the districts with their type, and who lives and works there."""

from functools import cache

import numpy as np
import pandas as pd
import pyogrio

from figures.paper.common import (
    CENSUS,
    Caption,
    manhattan_blocks,
    needs_island,
    save_table,
)
from jaxurban.metrics.population import Population, block_people, day_share
from jaxurban.world.blocks import Blocks, Zoning

NEIGHBOURHOODS = {  # the paper's names
    1: "Financial District, Civic Center",
    2: "West Village, Greenwich Village, Soho",
    3: "Chinatown, East Village, Noho",
    4: "Chelsea, Clinton, Hell's Kitchen",
    5: "Union Square, Madison Square, Times Square",
    6: "Gramercy, Murray Hill, Turtle Bay",
    7: "Lincoln Square, Upper West Side, Manhattan Valley",
    8: "Lenox Hill, Upper East Side, Yorkville",
    9: "Morningside Heights, Hamilton Heights",
    10: "Central Harlem",
    11: "East Harlem",
    12: "Inwood, Washington Heights",
}
PAPER = (
    "Twelve districts by number, names and type: 1 to 6 commercial, 7 to 12 residential. "
    "No figure is given for any."
)
MANHATTAN_LABEL, CENTRAL_PARK = (
    100,
    164,
)  # Manhattan's districts are 101 to 112 in the city's file; the park's label


@cache
def manhattan_land_m2() -> np.ndarray:
    """Return the land of each of Manhattan's census blocks, without water: TIGER's own figure, in the blocks' order."""
    fields = pyogrio.read_dataframe(
        CENSUS["blocks"], columns=["GEOID10", "ALAND10"], read_geometry=False
    )
    return fields.set_index("GEOID10").ALAND10.loc[manhattan_blocks().block_id].to_numpy(float)


def groups_of(blocks: Blocks) -> dict[str, np.ndarray]:
    """Return which blocks each row counts: the twelve districts, what is in none of them, all."""
    groups = {
        f"{number:02d}": blocks.district == MANHATTAN_LABEL + number for number in NEIGHBOURHOODS
    }
    rest = ~np.any(list(groups.values()), axis=0)
    park = blocks.district == CENTRAL_PARK
    return groups | {"Central Park": park, "other": rest & ~park, "all": np.ones(len(blocks), bool)}


def numbers_of(blocks: Blocks, land_m2: np.ndarray) -> pd.DataFrame:
    """Return blocks, people by night and day, land in km2 and type of each group."""
    params = Population()
    gammas = params.gamma_commercial, params.gamma_residential
    day = np.asarray(
        block_people(blocks.night_count, blocks.zoning, day_share("day"), *gammas), float
    )
    rows = {}
    for name, mask in groups_of(blocks).items():
        kinds = {Zoning(kind).name.lower() for kind in blocks.zoning[mask]}
        people = blocks.night_count[mask].sum(), day[mask].sum()
        rows[name] = (
            mask.sum(),
            *people,
            land_m2[mask].sum() / 1e6,
            kinds.pop() if len(kinds) == 1 else "",
        )
    return pd.DataFrame.from_dict(
        rows, orient="index", columns=["blocks", "night", "day", "land_km2", "type"]
    )


def shown(found: pd.DataFrame) -> pd.DataFrame:
    """Return the numbers as the table shows them."""
    return pd.DataFrame(
        {
            "District": found.index,
            "Neighbourhoods": [
                NEIGHBOURHOODS[int(name)] if name.isdigit() else "" for name in found.index
            ],
            "Type": found["type"],
            "Blocks": found.blocks.map("{:,}".format),
            "People at night": found.night.map("{:,.0f}".format),
            "People by day": found.day.map("{:,.0f}".format),
            "Land (km²)": found.land_km2.map("{:.2f}".format),
            "Night per km²": (found.night / found.land_km2).map("{:,.0f}".format),
            "Day per km²": (found.day / found.land_km2).map("{:,.0f}".format),
        }
    )


def main() -> None:
    if not needs_island("Table 6"):
        return
    params = Population()
    found = numbers_of(manhattan_blocks(), manhattan_land_m2())
    twelve = found.iloc[: len(NEIGHBOURHOODS)]
    density = {time: twelve[time] / twelve.land_km2 for time in ("night", "day")}
    ends = "; ".join(
        f"by {time} from {by.min():,.0f} (district {by.idxmin()}) to {by.max():,.0f} (district {by.idxmax()}) per "
        "km² of land"
        for time, by in density.items()
    )
    here = (
        f"Manhattan has {found.night['all']:,.0f} people on {found.land_km2['all']:.1f} km² of land at night and "
        f"{found.day['all']:,.0f} by day (factors {params.gamma_commercial:g} and {params.gamma_residential:g}). "
        f"Districts differ: {ends}."
    )
    why = (
        "The paper names, this table counts. A block goes to the district of largest overlap. *Other* is Marble "
        "Hill, which the city counts to a Bronx district, and water that other boroughs' districts reach; the "
        "paper would have them residential, so their people are halved by day. The maps divide by the whole "
        "block, water included: on the shore their densities are lower than these."
    )
    name, heading = "table_6_districts_manhattan", "Table 6. Districts of Manhattan"
    save_table(shown(found), name, heading, Caption(PAPER, here, why))
