"""Weights fitted to routes: hidden weights come back, and the fit says what it cannot know."""

import dataclasses

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.studies.examples import Example, optimal_examples
from jaxurban.studies.imitation import fit_weights
from jaxurban.studies.pool import cheapest_route
from jaxurban.studies.queries import route_facts, unit_map
from tests.studies.routes_made import HIDDEN, cosine, made_queries, small_maps

VECTOR = np.array([HIDDEN.distance, HIDDEN.gps, HIDDEN.lidar, HIDDEN.population, HIDDEN.risk])
NUM = 16  # the same everywhere: other shapes are compiled anew


@pytest.fixture(scope="module")
def examples():
    unit = unit_map(small_maps(), 20.0)
    return optimal_examples(made_queries(unit, NUM), HIDDEN)


@pytest.fixture(scope="module")
def fit(examples):
    return fit_weights(examples, bootstrap=40)


def test_hidden_weights_come_back_from_optimal_routes(fit, examples):
    assert cosine(fit, examples, HIDDEN) > 0.999
    assert fit.regret.mean() < 1e-4
    assert fit.best_mean_regret <= fit.regret.mean() + 1e-12
    assert fit.unidentified == fit.warnings == ()
    assert sum(fit.vector) == pytest.approx(1)


def test_intervals_hold_the_hidden_weights(fit):
    hidden = VECTOR / VECTOR.sum()
    low, high = fit.interval
    assert np.all(low <= fit.vector)
    assert np.all(fit.vector <= high)
    assert np.sum((low <= hidden) & (hidden <= high)) >= 4  # of 5
    assert np.all(high - low < 0.5)


def test_the_learning_curve_falls_and_ends_when_nothing_new_turns_up(fit):
    assert fit.curve["loss"].iloc[-1] < 0.2 * fit.curve["loss"].iloc[0]
    assert fit.curve["worst_gap"].iloc[-1] < fit.curve["worst_gap"].iloc[0]
    assert len(fit.curve) < 20
    assert fit.is_settled
    held_out = fit.by_examples["held_out_regret"]
    assert held_out.iloc[-1] < held_out.max() < 0.01


def test_a_fit_that_stopped_ends_bit_for_bit_as_one_that_did_not(examples, fit, tmp_path):
    class StoppedError(Exception):
        pass

    def stop(curve):
        if len(curve) == 3:
            raise StoppedError

    with pytest.raises(StoppedError):
        fit_weights(examples, bootstrap=40, state_file=tmp_path / "state.npz", on_round=stop)
    searched = []
    resumed = fit_weights(
        examples, bootstrap=40, state_file=tmp_path / "state.npz", on_round=lambda curve: searched.append(len(curve))
    )
    assert searched == list(range(1, len(fit.curve) + 1))
    np.testing.assert_array_equal(resumed.vector, fit.vector)
    np.testing.assert_array_equal(resumed.interval, fit.interval)
    np.testing.assert_array_equal(resumed.regret, fit.regret)
    with pytest.raises(InputError, match="belongs to a fit of other routes"):
        fit_weights(examples[1:], state_file=tmp_path / "state.npz")


def test_detours_in_a_fifth_of_the_examples_are_told_and_hardly_bend_the_fit(examples):
    unit = examples[0].query.unit
    spoilt = list(examples)
    for k, via in zip(range(0, NUM, 5), ((2, 6), (3, 36), (33, 7), (32, 38)), strict=True):
        query = examples[k].query
        assert unit.is_free[via]
        legs = [
            cheapest_route(dataclasses.replace(query, goal=via), VECTOR),
            cheapest_route(dataclasses.replace(query, start=via), VECTOR),
        ]
        points_m = np.concatenate([legs[0], legs[1][1:]])
        spoilt[k] = Example(query, route_facts(unit, points_m), points_m)
    fit = fit_weights(spoilt, bootstrap=0)
    assert cosine(fit, spoilt, HIDDEN) > 0.98
    assert np.all(fit.trust[::5] < 0.2)
    assert np.median(np.delete(fit.trust, range(0, NUM, 5))) > 0.9
    assert any("not optimal under any weights" in warning for warning in fit.warnings)
    assert np.isnan(fit.interval).all()


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_the_weight_of_a_constant_layer_is_said_to_be_unknown_and_bends_no_other(cost_model):
    maps = small_maps()
    maps.ds["risk"][:] = 0.25
    unit = unit_map(maps, 20.0, cost_model=cost_model)
    examples = optimal_examples(made_queries(unit, NUM), HIDDEN)
    fit = fit_weights(examples, bootstrap=0)
    assert [said for said in fit.unidentified if "risk" in said and "cannot be identified" in said]
    assert fit.regret.mean() < 1e-4
    assert fit.weights.gps / fit.weights.population == pytest.approx(HIDDEN.gps / HIDDEN.population, rel=0.1)
    if cost_model == "line":
        assert fit.weights.risk == 0


def test_two_layers_that_are_one_cannot_be_told_apart():
    maps = small_maps()
    maps.ds["risk"][:] = maps.ds["lidar"].values
    unit = unit_map(maps, 20.0)
    fit = fit_weights(optimal_examples(made_queries(unit, NUM), HIDDEN), bootstrap=0, max_rounds=3)
    assert "The weights of lidar and risk cannot be told apart: competing routes trade them at one rate." in (
        fit.unidentified
    )


def test_several_altitudes_are_fitted_together():
    maps = small_maps()
    examples = [
        example
        for altitude_m in (20.0, 60.0)
        for example in optimal_examples(made_queries(unit_map(maps, altitude_m), NUM // 2), HIDDEN)
    ]
    fit = fit_weights(examples, bootstrap=0, scale="distance")
    assert fit.weights.distance == pytest.approx(1)
    assert cosine(fit, examples, HIDDEN) > 0.999


def test_only_chosen_metrics_are_fitted():
    hidden = dataclasses.replace(HIDDEN, lidar=0.0)
    unit = unit_map(small_maps(), 20.0, metrics=("gps", "population", "risk"))
    examples = optimal_examples(made_queries(unit, NUM), hidden)
    fit = fit_weights(examples, bootstrap=0)
    assert fit.names == ("distance", "gps", "population", "risk")
    assert fit.weights.lidar == 0
    assert cosine(fit, examples, hidden) > 0.998


def test_weights_stay_finite_where_every_example_avoids_a_cost_altogether():
    maps = small_maps()
    people = np.zeros(maps.ds["population"].shape, np.float32)
    people[:, 16:20, 18:22] = 1.0
    maps.ds["population"][:] = people
    unit = unit_map(maps, 60.0)
    examples = optimal_examples(made_queries(unit, NUM), dataclasses.replace(HIDDEN, population=50.0))
    assert max(example.route.features[3] for example in examples) == 0
    fit = fit_weights(examples, bootstrap=8, max_rounds=4)
    assert np.isfinite(fit.vector).all()
    assert fit.regret.mean() < 0.01


def test_wrong_settings_are_refused(examples):
    for wrong in ({"scale": "length"}, {"max_rounds": 0}, {"bootstrap": -1}, {"budget_s": 0}, {"seed": -1}):
        with pytest.raises(InputError):
            fit_weights(examples, **wrong)
    with pytest.raises(InputError, match="no routes"):
        fit_weights([])
