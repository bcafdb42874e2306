"""Weights fitted to routes: hidden weights come back, and the fit says what it cannot know."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.paths.plan import cost_map
from jaxurban.studies.demonstrations import Demonstration, demonstration_from_line, optimal_demonstrations
from jaxurban.studies.route_pool import FitSettings
from jaxurban.studies.tuning.weight_fit import fit_weights
from tests.studies.routes_made import HIDDEN, cosine, made_queries, small_maps, thinned

VECTOR = np.array([HIDDEN.distance, HIDDEN.gps, HIDDEN.lidar, HIDDEN.population, HIDDEN.risk])
NUM = 16  # the same everywhere: other shapes are compiled anew


@pytest.fixture(scope="module")
def demonstrations():
    unit = cost_map(small_maps(), 20.0, cost_model="cell")
    return optimal_demonstrations(made_queries(unit, NUM), HIDDEN)


@pytest.fixture(scope="module")
def fit(demonstrations):
    return fit_weights(demonstrations, bootstrap=40)


def test_hidden_weights_come_back_from_optimal_routes(fit, demonstrations):
    assert cosine(fit, demonstrations, HIDDEN) > 0.999
    assert fit.regret.mean() < 1e-4
    assert fit.best_mean_regret <= fit.regret.mean() + 1e-12
    assert fit.unidentified == fit.warnings == ()
    assert sum(fit.vector) == pytest.approx(1)
    assert f"{fit}".splitlines()[2].split()[:2] == ["distance", f"{fit.vector[0]:.3g}"]


def test_intervals_hold_the_hidden_weights(fit):
    hidden = VECTOR / VECTOR.sum()
    low, high = fit.table[["low", "high"]].to_numpy().T
    assert np.all(low <= fit.vector)
    assert np.all(fit.vector <= high)
    assert np.sum((low <= hidden) & (hidden <= high)) >= 4  # of 5
    assert np.all(high - low < 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cell", "line"])
@pytest.mark.parametrize("seed", range(4))
def test_intervals_of_thinned_routes_contain_the_weights_that_they_were_planned_under(kind, seed):
    """Each sixth point alone is known: redrawn, such routes cost up to 4 % more than the ones that were meant."""
    maps, rng = small_maps(), np.random.default_rng(seed)
    unit = cost_map(maps, 20.0, cost_model=kind)
    hidden = ju.Weights(**dict(zip(unit.weight_names, VECTOR * np.exp(0.7 * rng.normal(size=5)), strict=True)))
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    shown = optimal_demonstrations(made_queries(unit, NUM, seed), hidden)
    fit = fit_weights(
        [demonstration_from_line(unit, thinned(each.points_m) + corner_m) for each in shown], bootstrap=20
    )
    truth = hidden.vector(unit.weight_names)
    low, high = fit.table[["low", "high"]].to_numpy().T
    assert np.all(low <= truth / truth.sum())
    assert np.all(truth / truth.sum() <= high)


def test_the_learning_curve_falls_and_ends_when_nothing_new_turns_up(fit):
    assert fit.curve["loss"].iloc[-1] < 0.2 * fit.curve["loss"].iloc[0]
    assert fit.curve["worst_gap"].iloc[-1] < fit.curve["worst_gap"].iloc[0]
    assert len(fit.curve) < 20
    assert fit.is_settled


def test_a_fit_that_stopped_ends_bit_for_bit_as_one_that_did_not(demonstrations, fit, tmp_path):
    class StoppedError(Exception):
        pass

    def stop(stage, done, total):
        if done == 3:
            raise StoppedError

    kept = FitSettings(state_file=tmp_path / "state.parquet", progress=stop)
    with pytest.raises(StoppedError):
        fit_weights(demonstrations, bootstrap=40, settings=kept)
    searched = []
    kept = dataclasses.replace(kept, progress=lambda stage, done, total: searched.append(done))
    resumed = fit_weights(demonstrations, bootstrap=40, settings=kept)
    assert searched == list(range(1, len(fit.curve) + 1))
    np.testing.assert_array_equal(resumed.vector, fit.vector)
    pd.testing.assert_frame_equal(resumed.table, fit.table)
    np.testing.assert_array_equal(resumed.regret, fit.regret)
    with pytest.raises(InputError, match=r"its fit of routes and maps is .* given now"):
        fit_weights(demonstrations[1:], settings=kept)


def test_detours_in_a_fifth_of_the_demonstrations_are_told_and_hardly_bend_the_fit(demonstrations):
    unit = demonstrations[0].query.cost_map
    spoilt = list(demonstrations)
    for k, via in zip(range(0, NUM, 5), ((2, 6), (3, 36), (33, 7), (32, 38)), strict=True):
        query = demonstrations[k].query
        assert unit.is_free[via]
        legs = [
            dataclasses.replace(query, goal=via).cheapest(VECTOR),
            dataclasses.replace(query, start=via).cheapest(VECTOR),
        ]
        points_m = np.concatenate([legs[0], legs[1][1:]])
        spoilt[k] = Demonstration(query, points_m)
    fit = fit_weights(spoilt, bootstrap=0)
    assert cosine(fit, spoilt, HIDDEN) > 0.98
    assert np.all(fit.trust[::5] < 0.2)
    assert np.median(np.delete(fit.trust, range(0, NUM, 5))) > 0.9
    assert any("not optimal under any weights" in warning for warning in fit.warnings)
    assert fit.table[["low", "high"]].isna().all(axis=None)


@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_the_weight_of_a_constant_layer_is_said_to_be_unknown_and_bends_no_other(cost_model):
    maps = small_maps()
    maps.ds["risk"][:] = 0.25
    unit = cost_map(maps, 20.0, cost_model=cost_model)
    demonstrations = optimal_demonstrations(made_queries(unit, NUM), HIDDEN)
    fit = fit_weights(demonstrations, bootstrap=0)
    assert [said for said in fit.unidentified if "risk" in said and "cannot be identified" in said]
    assert fit.regret.mean() < 1e-4
    assert fit.weights.gps / fit.weights.population == pytest.approx(HIDDEN.gps / HIDDEN.population, rel=0.1)
    if cost_model == "line":
        assert fit.weights.risk == 0


def test_two_layers_that_are_one_cannot_be_told_apart():
    maps = small_maps()
    maps.ds["risk"][:] = maps.ds["lidar"].values
    unit = cost_map(maps, 20.0)
    fit = fit_weights(
        optimal_demonstrations(made_queries(unit, NUM), HIDDEN), bootstrap=0, settings=FitSettings(max_rounds=3)
    )
    assert "The weights of lidar and risk cannot be told apart: competing routes trade them at one rate." in (
        fit.unidentified
    )


def test_several_altitudes_are_fitted_together():
    maps = small_maps()
    demonstrations = [
        each
        for altitude_m in (20.0, 60.0)
        for each in optimal_demonstrations(
            made_queries(cost_map(maps, altitude_m, cost_model="cell"), NUM // 2), HIDDEN
        )
    ]
    fit = fit_weights(demonstrations, bootstrap=0, scale="distance")
    assert fit.weights.distance == pytest.approx(1)
    assert cosine(fit, demonstrations, HIDDEN) > 0.999


def test_only_chosen_metrics_are_fitted():
    hidden = HIDDEN.replace(lidar=0.0)
    unit = cost_map(small_maps(), 20.0).only(("gps", "population", "risk"))
    demonstrations = optimal_demonstrations(made_queries(unit, NUM), hidden)
    fit = fit_weights(demonstrations, bootstrap=0)
    assert fit.names == ("distance", "gps", "population", "risk")
    assert fit.weights.lidar == 0
    assert cosine(fit, demonstrations, hidden) > 0.998


def test_weights_stay_finite_where_every_demonstration_avoids_a_cost_altogether():
    maps = small_maps()
    people = np.zeros(maps.ds["population"].shape, np.float32)
    people[:, 16:20, 18:22] = 1.0
    maps.ds["population"][:] = people
    unit = cost_map(maps, 60.0)
    demonstrations = optimal_demonstrations(made_queries(unit, NUM), HIDDEN.replace(population=50.0))
    assert max(each.features[3] for each in demonstrations) == 0
    fit = fit_weights(demonstrations, bootstrap=8, settings=FitSettings(max_rounds=4))
    assert np.isfinite(fit.vector).all()
    assert fit.regret.mean() < 0.01


def test_wrong_settings_are_refused(demonstrations):
    for wrong in ({"max_rounds": 0}, {"budget_s": 0}, {"seed": -1}):
        with pytest.raises(InputError):
            FitSettings(**wrong)
    for wrong in ({"scale": "length"}, {"bootstrap": -1}):
        with pytest.raises(InputError):
            fit_weights(demonstrations, **wrong)
    with pytest.raises(InputError, match="no routes"):
        fit_weights([])
