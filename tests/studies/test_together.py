"""Weights that act together: studies made so that the answer is known by hand, from routes that are planned."""

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.statistics.conclusions import Verdict
from jaxurban.studies.reports.sensitivity import sensitivity_report
from jaxurban.studies.weights.summary import act_together
from jaxurban.studies.weights.verdicts import WeightVerdict, together_verdicts
from jaxurban.typing import Sensitivity
from tests.made_maps import made_maps

NUM_STUDIES = 4  # of each kind; 20 of each were told as rightly
NUM_ROUTES, HALF = 16, 12  # routes of a study; columns of each of the two parts of a route
ALTITUDE_M = 60.0
WEIGHTS = {"distance": 0.1, "gps": 1.0, "lidar": 1.0, "population": 0.0, "risk": 1.0}
VARY = ("gps", "lidar")


def lanes(seed: int, acts_together: bool) -> tuple[MetricMaps, np.ndarray]:
    """Return a map of corridors, one a route, and ``[NUM_ROUTES, 2, 2, 3]`` gps, lidar and risk of each lane.

    A corridor has two parts, and in each two lanes of one length to choose from. Where weights act together, one lane
    of the first part costs gps and the other lidar. Else gps is paid in the first part alone and lidar in the second,
    and the other lanes cost risk, whose weight is known.
    """
    rng = np.random.default_rng([93, seed])
    costs = np.zeros((NUM_ROUTES, 2, 2, 3))
    paid = [(0, 0, 0), (0, 1, 1)] if acts_together else [(0, 0, 0), (1, 0, 1)]
    for part, lane, layer in paid:
        costs[:, part, lane, layer] = rng.uniform(0.2, 0.8, NUM_ROUTES)
    for part in range(2):
        if not acts_together:
            costs[:, part, 1, 2] = rng.uniform(0.2, 0.8, NUM_ROUTES)

    # Rows of a corridor: a lane, a wall that is open at both ends and in the middle, the other lane, a wall.
    maps = made_maps(4 * NUM_ROUTES, 2 * HALF + 1, (ALTITUDE_M,))
    layers = np.zeros((3, *maps.grid.shape))
    wall = np.zeros(maps.grid.shape, np.uint8)
    wall[1::2] = 1
    wall[1::4, ::HALF] = 0
    for route, part, lane in product(range(NUM_ROUTES), range(2), range(2)):
        columns = slice(part * HALF + 1, (part + 1) * HALF)
        layers[:, 4 * route + 2 * lane, columns] = costs[route, part, lane][:, None]
    gps, lidar, risk = layers.astype(np.float32)
    for name, values in {"gps": 1 - gps, "lidar": 1 - lidar, "risk": risk}.items():
        maps.ds[name][:] = values * (1 - wall)
    for name in ("obstacle", "roof", "roof_touched"):
        maps.ds[name][:] = wall * (1 if name == "obstacle" else 200.0)
    return maps, costs


def study(maps: MetricMaps) -> Sensitivity:
    rows = 4 * np.arange(NUM_ROUTES) + 1
    pairs = [[ju.XY(*maps.grid.xy_of_cell(row, col)) for col in (0, 2 * HALF)] for row in rows]
    chosen = ju.studies.SensitivitySettings(vary=VARY)
    return ju.studies.sensitivity(
        maps, routes=[(a, b) for a, b in pairs], weights=WEIGHTS, settings=chosen, progress=False
    )


def by_hand(costs: np.ndarray, cost: np.ndarray) -> float:
    """Return what both weights cost more that are wrong in opposite directions, in % of the cost, from all lanes.

    Args:
      costs: of the lanes.
      cost: ``[NUM_ROUTES]`` of the route under the true weights, way and all.
    """
    per_cost = (HALF - 1) * 10.0 / 5.0  # a lane's length, in reference lengths
    true = costs.sum(-1)
    change = 0.0
    for gps, lidar in product((0.5, 2.0), repeat=2):
        chosen = (costs @ np.array([gps, lidar, 1.0])).argmin(-1)[..., None]
        regret = np.take_along_axis(true, chosen, -1)[..., 0] - true.min(-1)
        percent = 100 * per_cost * regret.sum(-1) / cost
        change += percent.mean() / (2 if gps != lidar else -2)
    return change


@pytest.mark.slow
def test_weights_that_act_together_are_told_and_those_that_do_not_are_not():
    told = {True: 0, False: 0}
    for acts_together, seed in product(told, range(NUM_STUDIES)):
        maps, costs = lanes(seed, acts_together)
        result = study(maps)
        (row,) = result.tables["together"].itertuples()
        rows = result.rows.sort_values("instance")
        truth = by_hand(costs, rows.cost.to_numpy())
        assert row.size == pytest.approx(truth, abs=1e-4)  # float32 layers
        kinds = WeightVerdict.TOGETHER, WeightVerdict.TOGETHER_OPEN
        (said,) = (each for each in result.decided.verdicts if each.kind in kinds)
        is_told = said.is_decided
        told[acts_together] += is_told
        assert acts_together == (truth > 1)
        assert acts_together or said.needed == np.inf
        assert ("Sobol" in sensitivity_report(result).text) == is_told
    assert told == {True: NUM_STUDIES, False: 0}


def made_rows(seed: int, num: int, size: float) -> pd.DataFrame:
    """Return by how much pairs of weights act together on routes, differences of skewed numbers: gps and lidar do."""
    rng = np.random.default_rng([94, seed])
    rows = {"city": "a", "instance": np.arange(num)}
    for one, other in combinations(("gps", "lidar", "population", "risk"), 2):
        opposite, same = rng.exponential(0.01, (2, num))
        rows[f"together:{one},{other}"] = (
            opposite - same + size * ((one, other) == ("gps", "lidar"))
        )
    return pd.DataFrame(rows)


def said_of(rows: pd.DataFrame) -> list[Verdict]:
    return [*together_verdicts(act_together(rows), ju.studies.SensitivitySettings())]


def told_of(seed: int, size: float) -> set[tuple[str, ...]]:
    return {each.what for each in said_of(made_rows(seed, 30, size)) if each.is_decided}


@pytest.mark.slow
def test_of_scattered_regrets_a_pair_is_told_where_it_acts_together_and_hardly_ever_where_none_does():
    assert sum(told_of(seed, 0.02) == {("gps", "lidar")} for seed in range(20)) >= 18
    assert sum(told_of(seed, 0.0) != set() for seed in range(20)) <= 3


def test_few_routes_ask_for_more_and_one_route_or_one_weight_decides_nothing():
    (few,) = said_of(made_rows(0, 5, 0.02))
    assert few.needed == 8
    assert few.sentence.startswith("whether gps and lidar act together is open: both 2 times wrong")
    (single,) = said_of(made_rows(0, 1, 0.02))
    assert (single.n, np.isnan(single.needed)) == (1, True)
    (none,) = said_of(made_rows(0, 9, 0.0)[["city", "instance"]])
    assert none.sentence == "whether weights act together, which was not looked at"
    assert not any(each.is_decided for each in (few, single, none))
