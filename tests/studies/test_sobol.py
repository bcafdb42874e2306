"""Sobol indices by SALib's samples through `plan_many`, as the page on sensitivity has them, where they are known."""

import numpy as np
import pandas as pd
import pytest
from SALib.analyze import sobol
from SALib.sample import sobol as samples
from SALib.test_functions import Ishigami, linear_model_1

import jaxurban as ju
from tests.made_maps import made_maps

ALTITUDE_M, NUM = 60.0, 25
METRICS = ("gps", "lidar", "risk", "population")


def corridor() -> ju.MetricMaps:
    """Return maps of one way through the middle, over which every metric costs the same."""
    maps = made_maps(3, NUM, (ALTITUDE_M,))
    wall = np.ones(maps.grid.shape, np.uint8)
    wall[1] = 0
    for name in ("gps", "lidar"):
        maps.ds[name][:] = 0.5 * (1 - wall)
    for name in ("risk", "population"):
        maps.ds[name][:] = 0.5
    maps.ds["obstacle"][:] = wall
    for name in ("roof", "roof_touched"):
        maps.ds[name][:] = 200.0 * wall
    return maps


def costs_of(weights: pd.DataFrame) -> np.ndarray:
    """Return the cost of the way under each row of weights, planned at once."""
    maps = corridor()
    (x_m, y_m), (to_x_m, to_y_m) = (maps.grid.xy_of_cell(1, col) for col in (0, NUM - 1))
    places = {"start_x_m": x_m, "start_y_m": y_m, "goal_x_m": to_x_m, "goal_y_m": to_y_m}
    queries = weights.assign(**places)
    paths = ju.plan_many(maps, queries, altitude_m=ALTITUDE_M, progress=False)
    return paths.to_dataframe()["cost"].to_numpy()


def problem_of(num: int, low: float, high: float) -> dict:
    return {
        "num_vars": num,
        "names": [f"x{n}" for n in range(1, num + 1)],
        "bounds": [[low, high]] * num,
    }


def assert_known(indices: dict, **known) -> None:
    """Assert that indices are what is known of them, to one and a half of their 95 % intervals."""
    for name, values in known.items():
        away = np.abs(indices[name] - np.array(values))
        assert np.nanmax(away / indices[f"{name}_conf"]) < 1.5, name


@pytest.mark.slow
def test_the_cost_of_a_way_has_the_indices_of_salibs_linear_model():
    problem = problem_of(5, 0.1, 10.0)
    drawn = samples.sample(problem, 64, seed=1)
    # A metre of way costs as the metrics do: half a unit in a reference length of 5 m.
    weights = pd.DataFrame(drawn, columns=["w_distance", *(f"w_{name}" for name in METRICS)])
    costs = costs_of(weights.assign(w_distance=weights.w_distance / 10))
    np.testing.assert_allclose(costs / (NUM - 1), linear_model_1.evaluate(drawn), rtol=1e-6)
    indices = sobol.analyze(problem, costs, seed=1)
    assert_known(indices, S1=np.full(5, 0.2), ST=np.full(5, 0.2), S2=np.zeros((5, 5)))


@pytest.mark.slow
def test_weights_that_act_together_have_the_indices_of_salibs_ishigami_function():
    problem = problem_of(3, -np.pi, np.pi)
    drawn = samples.sample(problem, 128, seed=1)
    made = Ishigami.evaluate(drawn)
    nothing = dict.fromkeys(("w_distance", "w_lidar", "w_risk", "w_population"), 0.0)
    costs = costs_of(pd.DataFrame({"w_gps": made + 20.0}).assign(**nothing))
    np.testing.assert_allclose(costs / (NUM - 1), made + 20.0, rtol=1e-6)
    indices, wanted = (sobol.analyze(problem, each, seed=1) for each in (costs, made))
    np.testing.assert_allclose(indices["S2"], wanted["S2"], atol=1e-4)
    for name in ("S1", "ST"):
        np.testing.assert_allclose(indices[name], wanted[name], atol=1e-4)
    # Known in closed form (Ishigami and Homma, ISUMA 1990), for a = 7 and b = 0.1.
    assert_known(indices, S1=[0.3139, 0.4424, 0.0], ST=[0.5576, 0.4424, 0.2437])
    assert np.all(indices["ST"] - indices["S1"] > 0.15, where=[True, False, True])
