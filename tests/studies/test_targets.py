"""Targets for outcomes: met where weights can meet them, told where they conflict."""

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.paths.plan import cost_map
from jaxurban.studies.route_pool import FitSettings, RoutePool
from jaxurban.studies.tuning.target_fit import Target, fit_targets, outcome_values
from tests.studies.routes_made import made_queries, small_maps

NUM = 6


@pytest.fixture(scope="module")
def queries():
    return made_queries(cost_map(small_maps(), 20.0).only(("gps", "lidar")), NUM)


def targets(*texts: str) -> list[Target]:
    return [Target.parse(text) for text in texts]


def outcomes_under_many_weights(queries) -> np.ndarray:
    """Return mean_gps and mean_lidar ``[N, 2]`` of planned routes under a grid of weights (brute force)."""
    pool = RoutePool(queries)
    shortest = np.concatenate(pool.cheapest(np.tile([1.0, 0.0, 0.0], (NUM, 1, 1)))[:, :, 0], axis=-1)
    scale = [0.0, *np.logspace(-1, 2.5, 8)]
    weights = np.array([[1.0, a, b] for a in scale for b in scale])
    found = np.concatenate(pool.cheapest(weights), axis=-1)
    wanted = targets("mean_gps>=0", "mean_lidar>=0")
    return np.array(
        [np.asarray(outcome_values(sums, shortest, queries[0].names, wanted)) for sums in np.moveaxis(found, 1, 0)]
    )


def test_targets_are_met_where_brute_force_meets_them_and_conflict_where_it_does_not(queries, tmp_path):
    values = outcomes_under_many_weights(queries)
    most = values.max(axis=0)
    gps, lidar = values[np.argmax(np.min(values / most, axis=1))]
    reachable = targets(f"mean_gps>={gps:.4f}", f"mean_lidar>={lidar:.4f}")
    kept = FitSettings(state_file=tmp_path / "state.parquet")
    fit = fit_targets(queries, reachable, settings=kept)
    assert fit.is_met
    assert fit.outcomes["missed_by"].max() <= 0.02
    assert fit.sentence == "All targets are met."
    weights = np.array([[fit.weights[name] for name in fit.names]])
    planned = RoutePool(queries).cheapest(np.broadcast_to(weights, (NUM, 1, 3)))[1, :, 0]
    assert np.mean(planned[:, 2] / planned[:, 0]) == pytest.approx(fit.outcomes["reached"].iloc[1])
    again = fit_targets(queries, reachable, settings=kept)
    assert again.weights == fit.weights
    assert again.num_plans == fit.num_plans

    missed = np.maximum(1 - values / most, 0)
    assert missed.max(axis=1).min() > 0.03  # no weights of the grid meet both
    fit = fit_targets(queries, targets(f"mean_gps>={most[0]}", f"mean_lidar>={most[1]}"))
    assert not fit.is_met
    assert len(fit.conflicts) == 1
    assert fit.alone["is_met"].all()
    assert "conflict" in fit.sentence
    assert np.sum(fit.outcomes["missed_by"] ** 2) <= 1.02 * np.sum(missed**2, axis=1).min()


def test_a_target_beyond_all_routes_is_said_to_be_missed_alone(queries):
    fit = fit_targets(queries, targets("mean_gps>=0.1", "mean_lidar>=0.999"))
    assert not fit.is_met
    assert fit.conflicts == ()
    assert not fit.alone.is_met["mean_lidar >= 0.999"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mean_gps", "must read like"),
        ("detour<=x", "finite number"),
        ("gps>=0.8", "outcome must be 'mean_NAME of a metric', 'detour'"),
    ],
)
def test_a_target_that_cannot_be_read_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        Target.parse(text)


def test_a_target_for_a_metric_left_out_is_refused(queries):
    with pytest.raises(InputError, match=r"must be .* 'mean_lidar', got 'mean_risk'"):
        fit_targets(queries, targets("mean_risk>=0.5"))
    with pytest.raises(InputError, match="no targets"):
        fit_targets(queries, [])
    with pytest.raises(InputError, match="did you mean 'mean_gps'"):
        fit_targets(queries, ["mean_gsp>=0.5"])
    with pytest.raises(InputError, match="targets must be a sequence of Target or text"):
        fit_targets(queries, [5])


@pytest.mark.slow
def test_on_the_synthetic_city_a_reachable_pair_is_met_and_an_unreachable_one_told():
    maps = ju.build_maps(ju.demo_city(3000, 3000), resolution_m=10.0, altitudes_m=(60.0,))
    queries = made_queries(cost_map(maps, 60.0, cost_model="line"), 12, apart=60.0)
    reachable = fit_targets(queries, targets("mean_lidar>=0.07", "detour<=0.2"))
    assert reachable.is_met
    assert reachable.outcomes["missed_by"].max() <= 0.02
    unreachable = fit_targets(queries, targets("mean_lidar>=0.09", "detour<=0.001"))
    assert not unreachable.is_met
    assert unreachable.conflicts == (("mean_lidar >= 0.09", "detour <= 0.001"),)
    assert unreachable.outcomes["reached"].iloc[0] > 0.07  # the best trade-off found
