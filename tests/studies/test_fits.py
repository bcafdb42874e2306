"""Weights fitted to routes and to targets: hidden weights come back, fits are tested, and what cannot be is said."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.fit import FitSettings, Target, fit_targets, fit_weights
from jaxurban.statistics.conclusions import SharedVerdict
from jaxurban.studies.demonstrations import (
    Demonstration,
    demonstration_from_line,
    optimal_demonstrations,
)
from jaxurban.studies.queries import weights_option
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.tuning.confidence import draw_counts, without_dust
from jaxurban.studies.tuning.target_fit import outcome_values
from jaxurban.studies.tuning.tested import FEWEST_GROUPS, FitCommands, split, wish_verdicts
from jaxurban.studies.tuning.tested import tested_outcomes as outcomes_of
from tests.studies.routes_made import HIDDEN, NUM, cosine, made_queries, thinned

VECTOR = HIDDEN.vector(("distance", "gps", "lidar", "population", "risk"))
FEW = 6  # queries for targets


@pytest.fixture(scope="module")
def fit(demonstrations):
    return fit_weights(demonstrations, bootstrap=40)


@pytest.mark.slow
def test_hidden_weights_come_back_from_optimal_routes_and_their_intervals_hold_them(
    fit, demonstrations
):
    assert cosine(fit, demonstrations, HIDDEN) > 0.999
    assert fit.regret.mean() < 1e-4
    assert fit.best_mean_regret <= fit.regret.mean() + 1e-12
    assert fit.unidentified == fit.warnings == ()
    assert sum(fit.vector) == pytest.approx(1)
    assert fit.sentence.startswith("These routes follow these metrics: at best they cost 0")
    lines = f"{fit}".splitlines()
    assert [line.partition(":")[0] for line in lines[:3]] == ["decided", "not decided", "next"]
    assert lines[3] == f"fit: {fit.sentence}"
    assert lines[6].split()[:2] == ["distance", f"{fit.vector[0]:.3g}"]
    hidden = VECTOR / VECTOR.sum()
    low, high = fit.table[["low", "high"]].to_numpy().T
    assert np.all(low <= fit.vector)
    assert np.all(fit.vector <= high)
    assert np.sum((low <= hidden) & (hidden <= high)) >= 4  # of 5
    assert np.all(high - low < 0.5)
    first, last = fit.curve.iloc[0], fit.curve.iloc[-1]
    assert last.loss < 0.2 * first.loss
    assert last.worst_gap < first.worst_gap
    assert len(fit.curve) < 20
    assert fit.is_settled


@pytest.mark.slow
def test_draws_of_cities_depend_on_their_order_and_not_on_where_their_maps_lie_in_memory(
    small, demonstrations
):
    twins = sorted((ju.MetricMaps(small.ds) for _ in range(2)), key=id)

    def drawn(*cities):
        units = [ju.cost_map(maps, 20.0, cost_model="cell") for maps in cities]
        queries = [
            replace(each.query, cost_map=units[k >= 5]) for k, each in enumerate(demonstrations)
        ]
        shown = [
            replace(each, query=query) for each, query in zip(demonstrations, queries, strict=True)
        ]
        return fit_weights(shown, bootstrap=4, settings=FitSettings(max_rounds=1)).draws

    np.testing.assert_array_equal(drawn(*twins), drawn(*twins[::-1]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["cell", "line"])
@pytest.mark.parametrize("seed", range(4))
def test_intervals_of_thinned_routes_contain_the_weights_that_they_were_planned_under(
    small, kind, seed
):
    """Each sixth point alone is known: redrawn, such routes cost up to 4 % more than the ones that were meant."""
    unit, rng = ju.cost_map(small, 20.0, cost_model=kind), np.random.default_rng(seed)
    hidden = ju.Weights(
        **dict(zip(unit.weight_names, VECTOR * np.exp(0.7 * rng.normal(size=5)), strict=True))
    )
    corner_m = np.array([small.grid.x_min_m, small.grid.y_min_m])
    shown = optimal_demonstrations(made_queries(unit, NUM, seed), hidden)
    drawn = [demonstration_from_line(unit, thinned(each.points_m) + corner_m) for each in shown]
    truth = hidden.vector(unit.weight_names)
    low, high = fit_weights(drawn, bootstrap=20).table[["low", "high"]].to_numpy().T
    assert np.all(low <= truth / truth.sum())
    assert np.all(truth / truth.sum() <= high)


def fitted(maps, hidden=HIDDEN, cost_model="line", altitude_m=20.0, max_rounds=20, **how):
    """Return routes planned under hidden weights on maps, and their fit."""
    unit = ju.cost_map(maps, altitude_m, cost_model=cost_model)
    shown = optimal_demonstrations(made_queries(unit, NUM), hidden)
    return shown, fit_weights(
        shown, settings=FitSettings(max_rounds=max_rounds), **{"bootstrap": 0} | how
    )


@pytest.mark.slow
@pytest.mark.parametrize("cost_model", ["cell", "line"])
def test_the_weight_of_a_constant_layer_is_said_to_be_unknown_and_bends_no_other(small, cost_model):
    maps = ju.MetricMaps(small.ds.assign(risk=xr.full_like(small.ds["risk"], 0.25)))
    _, fit = fitted(maps, cost_model=cost_model)
    assert [said for said in fit.unidentified if "risk" in said and "cannot be identified" in said]
    assert fit.regret.mean() < 1e-4
    assert fit.weights.gps / fit.weights.population == pytest.approx(
        HIDDEN.gps / HIDDEN.population, rel=0.1
    )
    if cost_model == "line":
        assert fit.weights.risk == 0


@pytest.mark.slow
def test_two_layers_that_are_one_cannot_be_told_apart(small):
    _, fit = fitted(ju.MetricMaps(small.ds.assign(risk=small.ds["lidar"])), max_rounds=3)
    sentence = "the weights of lidar and risk cannot be distinguished: competing routes trade them at one rate."
    assert sentence in fit.unidentified


@pytest.mark.slow
def test_several_altitudes_are_fitted_together(small):
    units = [ju.cost_map(small, altitude_m, cost_model="cell") for altitude_m in (20.0, 60.0)]
    shown = [
        each
        for unit in units
        for each in optimal_demonstrations(made_queries(unit, NUM // 2), HIDDEN)
    ]
    fit = fit_weights(shown, bootstrap=0)
    assert cosine(fit, shown, HIDDEN) > 0.999


@pytest.mark.slow
def test_weights_stay_finite_where_every_demonstration_avoids_a_cost_altogether(small):
    people = xr.zeros_like(small.ds["population"])
    people[:, 16:20, 18:22] = 1.0
    maps, hidden = (
        ju.MetricMaps(small.ds.assign(population=people)),
        HIDDEN.replace(population=50.0),
    )
    shown, fit = fitted(maps, hidden, altitude_m=60.0, max_rounds=4, bootstrap=8)
    assert max(each.features[3] for each in shown) == 0
    assert np.isfinite(fit.vector).all()
    assert fit.regret.mean() < 0.01


def detour(query, rng):
    """Return the cheapest route by way of a random cell that makes it at most 1.6 times as far."""
    free = np.argwhere(query.cost_map.is_free)
    far = sum(np.hypot(*(free - np.array(end)).T) for end in (query.start, query.goal))
    near = free[far <= 1.6 * np.hypot(*np.subtract(query.start, query.goal))]
    via = tuple(near[rng.integers(len(near))].tolist())
    there, on = (replace(query, **end).cheapest(VECTOR) for end in ({"goal": via}, {"start": via}))
    return Demonstration(query, np.concatenate([there, on[1:]]))


@pytest.fixture(scope="module")
def spoilt(demonstrations):
    """Return routes of two cities, whose maps are alike, a fifth of which go by way of a random place."""
    rng, unit = np.random.default_rng(0), demonstrations[0].query.cost_map
    other = replace(unit, maps=ju.MetricMaps(unit.maps.ds))
    made = [*demonstrations, *optimal_demonstrations(made_queries(other, NUM, seed=1), HIDDEN)]
    for k in (*range(0, NUM, 5), *range(NUM, 2 * NUM, 5)):
        made[k] = detour(made[k].query, rng)
    return made


@pytest.fixture(scope="module")
def found(spoilt):
    return fit_weights(spoilt, hold_out=None, bootstrap=20)


@pytest.mark.slow
def test_a_fit_of_routes_that_turn_one_corner_says_first_that_they_do_not_follow_the_metrics(small):
    unit = ju.cost_map(small, 60.0)
    corners = [((k, 1), (k, 30), (33, 30)) for k in range(1, 17)]
    shown = [
        demonstration_from_line(unit, np.array([small.grid.xy_of_cell(*cell) for cell in c]))
        for c in corners
    ]
    fit = fit_weights(shown, bootstrap=0, settings=FitSettings(max_rounds=2))
    best = f"at best they cost {100 * fit.best_mean_regret:.3g} % more than the cheapest ones"
    assert fit.best_mean_regret > 0.05
    lines = f"{fit}".splitlines()[3:]
    assert lines[0].startswith(f"fit: These routes do not follow these metrics: {best}")
    assert sum(best in line for line in lines) == 1
    assert lines.index(fit.cautions[-1]) < next(
        k for k, line in enumerate(lines) if line.lstrip().startswith("distance ")
    )


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"planner": "theta-star"}, {"refine": True}])
def test_lines_at_any_angle_follow_the_metrics_that_they_are_optimal_under_and_no_others(
    small, how
):
    """Redrawn on the grid such lines cost 2 % more; lines of pilots who care for other metrics follow no one W."""
    metrics = ("gps", "lidar", "population", "risk")
    mixed = [{metrics[k % 4]: 50.0} for k in range(NUM)]

    def fit_of(pilots):
        queries = made_queries(ju.cost_map(small, 20.0), NUM)
        ends = [[ju.XY(*small.grid.xy_of_cell(*c)) for c in (q.start, q.goal)] for q in queries]
        paths = [
            ju.plan(small, *pair, altitude_m=20.0, weights=weights, **how)
            for pair, weights in zip(ends, pilots, strict=True)
        ]
        return fit_weights(ju.fit.demonstrations(paths, small), bootstrap=0)

    fit = fit_of([HIDDEN] * NUM)
    assert fit.best_mean_regret > 0.01
    assert fit.sentence.startswith("These routes follow these metrics: at best they cost")
    assert "of which redrawing them on the grid adds" in fit.sentence
    fit = fit_of(mixed)
    assert fit.sentence.startswith("These routes do not follow these metrics")


def regret_of(shown, weights) -> np.ndarray:
    """Return by which share each route costs more than the cheapest, by a search of its own."""
    best = [each.query.sums(each.query.cheapest(weights))[0] @ weights for each in shown]
    return np.array([each.features @ weights for each in shown]) / best - 1


@pytest.mark.slow
def test_a_fit_finds_the_pilot_among_detours(found, spoilt):
    fitted = [each for each, is_out in zip(spoilt, found.is_held_out, strict=True) if not is_out]
    assert cosine(found, fitted, HIDDEN) > 0.999
    assert found.tested.value < 1e-3
    is_bad = regret_of(fitted, VECTOR) > 0.02
    assert is_bad.sum() >= 4
    assert np.all(found.trust[is_bad] < 0.2)
    assert np.median(found.trust[~is_bad]) > 0.9
    assert found.sentence.startswith(
        f"Most of these routes, {np.sum(found.trust >= 0.1)} of {len(fitted)}, follow"
    )


@pytest.mark.slow
def test_a_fit_is_tested_on_held_out_routes_without_bad_ones_by_a_search_of_ones_own(found, spoilt):
    is_detour = regret_of(spoilt, VECTOR) > 0.02
    assert found.is_held_out[is_detour].any()
    assert [*found.is_held_out.reshape(2, NUM).sum(axis=1)] == [NUM // 4] * 2
    good = found.is_held_out & ~is_detour
    assert found.num_tested == good.sum()
    regret = regret_of(spoilt, found.vector)[good].mean()
    assert found.tested.value == pytest.approx(regret, abs=1e-12)


def test_groups_stay_together_and_every_city_keeps_its_share():
    city, group = np.repeat(["a", "b"], [40, 20]), np.arange(60) // 2
    is_held_out = split(city, group, 0.25, seed=3)
    assert [is_held_out[city == name].sum() for name in "ab"] == [10, 4]
    assert np.all(is_held_out[::2] == is_held_out[1::2])
    assert np.any(is_held_out != split(city, group, 0.25, seed=4))
    assert not split(city, group, 0.0, seed=3).any()


def test_draws_of_several_cities_take_whole_cities_and_of_one_its_members():
    rng = np.random.default_rng(0)
    counts = draw_counts(np.repeat([0, 1, 2], [5, 3, 4]), 400, rng)
    by_city = np.add.reduceat(counts, [0, 5, 8], axis=1) / [5, 3, 4]
    assert np.all(by_city == np.round(by_city))
    assert np.all(by_city.sum(axis=1) == 3)
    np.testing.assert_allclose(counts.mean(axis=0), 1, atol=0.3)
    assert np.all(draw_counts(np.zeros(7, int), 50, rng).sum(axis=1) == 7)


@pytest.fixture(scope="module")
def queries(small):
    return made_queries(ju.cost_map(small, 20.0).only(("gps", "lidar")), FEW)


def outcomes_under_many_weights(queries) -> np.ndarray:
    """Return mean_gps and mean_lidar ``[N, 2]`` of planned routes under a grid of weights (brute force)."""
    pool = RoutePool(queries)
    shortest = np.concatenate(
        pool.cheapest(np.tile([1.0, 0.0, 0.0], (FEW, 1, 1)))[:, :, 0], axis=-1
    )
    scale = [0.0, *np.logspace(-1, 2.5, 8)]
    weights = np.array([[1.0, a, b] for a in scale for b in scale])
    found = np.concatenate(pool.cheapest(weights), axis=-1)
    wanted, names = [Target.parse(f"mean_{name}>=0") for name in ("gps", "lidar")], queries[0].names
    return np.array(
        [outcome_values(sums, shortest, names, wanted) for sums in np.moveaxis(found, 1, 0)]
    )


@pytest.mark.slow
def test_targets_are_met_where_brute_force_meets_them_and_missed_where_it_does_not(queries):
    values = outcomes_under_many_weights(queries)
    most = values.max(axis=0)
    gps, lidar = values[np.argmax(np.min(values / most, axis=1))]
    reachable = [f"mean_gps>={gps:.4f}", f"mean_lidar>={lidar:.4f}"]
    fit = fit_targets(queries, reachable)
    assert fit.is_met
    assert fit.outcomes["missed_by"].max() <= 0.02
    assert fit.sentence == (
        "All targets are met on the average of the routes that the weights were fitted to."
    )
    assert not fit.is_kept
    assert not fit.is_held_out.any()  # of so few
    assert not any(verdict.is_decided for verdict in fit.decided.verdicts)
    weights = np.array([[fit.weights[name] for name in fit.names]])
    planned = RoutePool(queries).cheapest(np.broadcast_to(weights, (FEW, 1, 3)))[1, :, 0]
    assert np.mean(planned[:, 2] / planned[:, 0]) == pytest.approx(fit.outcomes["reached"].iloc[1])
    again = fit_targets(queries, reachable)
    assert again.weights == fit.weights
    assert again.num_plans == fit.num_plans

    missed = np.maximum(1 - values / most, 0)
    assert missed.max(axis=1).min() > 0.03  # no weights of the grid meet both
    fit = fit_targets(queries, [f"mean_gps>={most[0]}", f"mean_lidar>={most[1]}"])
    assert not fit.is_met
    assert not fit.outcomes["is_met"].all()
    assert all(fit_targets(queries, [target]).is_met for target in fit.targets)  # they conflict
    assert np.sum(fit.outcomes["missed_by"] ** 2) <= 1.02 * np.sum(missed**2, axis=1).min()


def test_a_wish_that_the_weights_meet_leaves_them_and_is_tested_on_all_routes(small):
    """Of 8 pairs of ends there is an interval, as nothing was fitted to any of them."""
    queries = made_queries(ju.cost_map(small, 20.0), 8)
    before = ju.Weights(distance=0.1, gps=2.0, lidar=1.0, population=0.0, risk=1.0)
    fit = fit_targets(queries, ["mean_gps>=0.05", "mean_population<=0.9"], before=before)
    assert fit.is_kept
    assert fit.weights == before
    assert fit.sentence == "All targets are met without the wish: keep the weights as they are."
    assert fit.is_held_out.all()
    assert (fit.tested.change == 0).all()
    first, second, border = fit.decided.verdicts
    assert border.kind is SharedVerdict.BORDER
    assert first.sentence.startswith("mean_gps >= 0.05 is met without the wish already: 0.")
    assert first.is_decided
    assert second.is_decided
    assert f"--weights {weights_option(before)}" in fit.decided.next_command


def test_a_wish_asks_for_more_routes_at_once_or_to_hold_out_more_of_them(small):
    queries = made_queries(ju.cost_map(small, 20.0), 20)
    targets = [Target.parse("mean_gps>=0.99"), Target.parse("mean_population<=0.2")]
    tested = outcomes_of(queries, targets, np.tile(VECTOR, (2, 1)))
    assert (tested.filter(like="with_wish_low") >= 0).all(axis=None)
    how = {"is_tested": True, "is_kept": False}
    for frame, is_tested, num in ((tested, False, FEWEST_GROUPS), (tested[:2], True, 0)):
        verdicts, needed = wish_verdicts(
            frame, targets, [True, True], **how | {"is_tested": is_tested}
        )
        assert len(verdicts) == 2
        assert needed == num
        assert verdicts[0].is_decided == is_tested
    commands = FitCommands("hold out {share}", "draw {needed}", sample=24)
    assert commands.holding_out(6, 12, 0.25) == "hold out 0.5"
    # A quarter of them, of which 11 of 26 are joined, somewhat fewer than the 12 of 24.
    assert commands.holding_out(8, 12, 0.0) == "draw 76"
    assert commands.holding_out(30, 12, share=1.0) == "draw 71"
    assert commands._replace(sample=12).holding_out(8, 12, 0.0) == "draw 32"
    assert FitCommands("hold out {share}").holding_out(8, 12, 0.0) == ""


def test_a_fit_says_what_an_interval_takes_and_how_more_routes_are_held_out(demonstrations):
    quick = {"bootstrap": 0, "settings": FitSettings(max_rounds=1)}
    for num, share in ((12, ""), (16, "0.5")):
        fit = fit_weights(demonstrations[:num], **quick)
        assert (
            f"on {num} routes; an interval takes 8 pairs of ends"
            in fit.decided.facts["not decided"]
        )
        assert (f"hold_out={share})" in fit.decided.next_command) == bool(share)
    assert "jaxurban sensitivity" in fit_weights(demonstrations[:12], **quick).decided.next_command


def test_no_weight_that_counts_for_nothing_is_left_as_dust(queries):
    pool = RoutePool(queries)
    features = pool.cheapest(np.eye(3) + 0.1)[0, 0, 0]
    weights = without_dust(np.array([1.0, 1e-9 / features[1], 0.3]), pool)
    assert weights[1] == 0
    assert weights.sum() == pytest.approx(1)
    assert weights[0] / weights[2] == pytest.approx(1 / 0.3)
    counting = without_dust(np.array([1e-8, 0.0, 0.0]), pool)
    assert counting.tolist() == [1, 0, 0]


@pytest.mark.slow
def test_a_target_beyond_all_routes_is_missed_and_one_of_the_detour_is_met_beside_a_metric_s(
    queries,
):
    fit = fit_targets(queries, ["mean_gps>=0.1", "mean_lidar>=0.999"])
    assert fit.outcomes.is_met.tolist() == [True, False]
    assert fit_targets(queries, ["mean_lidar>=0.57", "detour<=0.2"]).is_met
    assert not fit_targets(queries, ["mean_lidar>=0.57", "detour<=0.001"]).is_met


def test_a_route_of_the_same_features_is_kept_once_in_the_memory_of_one(queries):
    pool = RoutePool(queries[:1])
    *others, route = np.random.default_rng(0).uniform(1, 100, (2_001, 2, len(pool.names)))
    for other in others:
        pool._add(0, other)
    for shift in (0.0, 1e-14, 1e-3):
        pool._add(0, route * (1 + shift))
    assert pool.num_routes == 2_002
    assert pool.routes[:, 0, 2_000].tolist() == route.tolist()
    tracemalloc.start()
    pool._add(0, route)  # known by now: nothing is copied
    assert (
        tracemalloc.get_traced_memory()[1] < pool.routes.nbytes / 50
    )  # twice what it takes beside 20 of them
    tracemalloc.stop()
