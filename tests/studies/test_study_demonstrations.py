"""Routes of Monte Carlo studies and of tables of instances: planned again as they were, or left out and counted."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError, SkippedRouteWarning
from jaxurban.paths.rows import HAS_PATH
from jaxurban.studies.queries import check_alike
from tests.studies.routes_made import HIDDEN, cosine, small_maps

PLANNERS = "ptp", "astar-plus", "bitstar-plus"
STUDY = ju.studies.Study(
    planners=PLANNERS, weights=[HIDDEN], distance_only=(), budget_iterations=100, seed=2
)
routes_of = ju.fit.demonstrations_from_study


@pytest.fixture(scope="module")
def maps():
    """Return maps by day and by night whose population is divided by other numbers."""
    return ju.MetricMaps(small_maps().ds.assign_attrs(pop_norm_per_km2=[1e4, 3e4]))


@pytest.fixture(scope="module")
def study(maps, tmp_path_factory):
    """Return a study under one W, whose pairs are all joined."""
    folder = tmp_path_factory.mktemp("studied")
    maps.save(folder)
    return ju.studies.study(folder, folder / "study", 24, settings=STUDY, progress=False)


def costs_of(shown):
    return [each.features @ HIDDEN.vector(each.query.names) for each in shown]


@pytest.mark.slow
def test_a_study_gives_the_routes_of_its_planners_at_their_own_costs(study):
    for planner, most, mean in (
        ("astar-plus", 1e-9, 1e-9),
        ("bitstar-plus", 0.25, 0.07),
    ):  # off the grid they are redrawn on it
        rows = study.rows[(study.rows.planner == planner) & study.rows.status.isin(HAS_PATH)]
        shown = routes_of(study, planner=planner)
        keys = [(int(each.query.name), each.query.cost_map.altitude_m) for each in shown]
        rows = rows.set_index(["instance", "altitude_m"]).loc[keys]
        excess = costs_of(shown) / rows.cost - 1
        assert np.abs(excess).max() <= most
        assert np.abs(excess).mean() <= mean
    for given in (study.folder, study.folder.parent):
        assert costs_of(routes_of(given)) == costs_of(routes_of(study, planner="astar-plus"))
    low = routes_of(study, altitude_m=20.0, time_of_day="night", metrics=["gps", "risk"])
    assert {(each.query.cost_map.altitude_m, each.query.cost_map.time_of_day) for each in low} == {
        (20.0, "night")
    }
    assert low[0].query.names == ("distance", "gps", "risk")


def test_rows_without_a_path_and_routes_of_other_costs_are_left_out_and_counted(
    study, maps, tmp_path
):
    num, num_lost = len(study.instances), int((study.rows.status == "blocked").sum())
    words = (
        rf"^{num_lost} of {num} routes of .*study' were left out: ptp found no path \({num_lost}\)$"
    )
    with pytest.warns(SkippedRouteWarning, match=words):
        assert len(routes_of(study, planner="ptp")) == num - num_lost > 0
    for each in study.folder.iterdir():
        (tmp_path / each.name).write_bytes(each.read_bytes())
    other = study.rows.assign(
        cost=np.where(study.rows.instance == 5, 2 * study.rows.cost, study.rows.cost)
    )
    other.to_parquet(tmp_path / "rows.parquet")
    with pytest.warns(
        SkippedRouteWarning, match=r"cost otherwise than their rows say, as where seconds .* \(2\)"
    ):
        assert len(routes_of(tmp_path, maps)) == num - 2
    with pytest.warns(SkippedRouteWarning, match=r"^1 of \d+ routes of .* was left out: "):
        routes_of(tmp_path, maps, altitude_m=20.0)


@pytest.mark.slow
def test_straight_routes_are_said_to_follow_distance_alone(study):
    with pytest.warns(SkippedRouteWarning):
        straight = routes_of(study, planner="ptp")
    fit = ju.fit.fit_weights(straight, bootstrap=0, settings=ju.fit.FitSettings(max_rounds=15))
    assert fit.sentence.startswith(
        "These routes follow distance alone and none of these metrics: at best they cost 0"
    )


@pytest.mark.slow
def test_routes_by_day_and_by_night_of_a_study_under_one_w_give_that_w_back(study):
    shown = [each for each in routes_of(study) if each.query.cost_map.altitude_m == 20.0][:16]
    assert {each.query.cost_map.time_of_day for each in shown} == {"day", "night"}
    fit = ju.fit.fit_weights(shown, bootstrap=0, settings=ju.fit.FitSettings(max_rounds=15))
    assert cosine(fit, shown, HIDDEN) > 0.99
    assert fit.regret.mean() < 1e-3
    flown = [replace(each.query, is_planned=False) for each in shown]
    with pytest.raises(InputError, match="different numbers by which population is normalised"):
        check_alike(flown)


def test_a_table_of_instances_or_queries_gives_the_cheapest_routes_under_its_weights(
    study, maps, tmp_path
):
    joined = study.instances
    joined.to_csv(tmp_path / "instances.csv", index=False)
    columns = ["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m", "time_of_day"]
    places = joined[columns]
    asked = places.assign(**{f"w_{name}": value for name, value in HIDDEN.to_dict().items()})
    cheapest = (
        joined[["instance", "altitude_m"]]
        .merge(study.rows[study.rows.planner == "astar-plus"])
        .cost
    )
    for given in (joined, tmp_path / "instances.csv", asked):
        np.testing.assert_allclose(costs_of(routes_of(given, maps)), cheapest, rtol=1e-9)
    np.testing.assert_allclose(costs_of(routes_of(places, maps, pilot=HIDDEN)), cheapest, rtol=1e-9)
    with pytest.raises(
        InputError, match="has no weights under which its routes are the cheapest: give a column"
    ):
        routes_of(places, maps)
    with pytest.raises(InputError, match=r"unknown columns \['a', 'b'\]"):
        routes_of(pd.DataFrame({"a": [1], "b": [2]}), maps)


def test_a_study_under_many_weights_is_refused_unless_one_pilot_flies_its_pairs(
    maps, study, tmp_path
):
    many = replace(STUDY, planners="astar-plus", weights="dirichlet")
    drawn = ju.studies.study(maps, tmp_path, 4, settings=many, progress=False)
    with pytest.raises(
        InputError,
        match=r"under 4 different weights, and a fit finds one W: run the study under one",
    ):
        routes_of(drawn)
    joined = drawn.instances[drawn.instances.is_connected]
    doubled = joined.assign(**{f"w_{name}": value for name, value in HIDDEN.to_dict().items()})
    doubled.loc[doubled.index[::2], doubled.columns.str.startswith("w_")] *= (
        2  # the same W: only ratios count
    )
    assert costs_of(routes_of(doubled, maps)) == costs_of(routes_of(joined, maps, pilot=HIDDEN))


def without(name):
    return lambda folder, file="rows": pd.read_parquet(folder / f"{file}.parquet").drop(
        columns=name
    )


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("rows", without("status"), "rows.parquet' lacks the column 'status': run the study again"),
        (
            "instances",
            lambda folder: without("w_gps")(folder, "instances"),
            "lacks the column 'w_gps'",
        ),
        ("rows", None, "rows file .* cannot be read"),
        ("checksums", None, "checksums.json"),
    ],
)
def test_a_damaged_study_is_refused_in_one_sentence(study, maps, tmp_path, file, change, words):
    for each in study.folder.iterdir():
        (tmp_path / each.name).write_bytes(each.read_bytes())
    if change is None:
        next(tmp_path.glob(f"{file}.*")).write_bytes(b"nothing")
    else:
        change(tmp_path).to_parquet(tmp_path / f"{file}.parquet")
    with pytest.raises(InputError, match=words):
        routes_of(tmp_path, maps)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"planner": "thetastar"}, "planner must be 'astar-plus', .* got 'thetastar'"),
        (
            {"cost_model": "cell"},
            "other maps or settings than those given: its cost_model is line, here cell",
        ),
        (
            {"constraints": ju.Constraints(clearance_m=20.0)},
            "its set of constraints is vertical clearance of 3 m, here clearance of 20 m, ",
        ),
        (
            {"maps": ju.MetricMaps(small_maps().ds.assign_attrs(run_key="b"))},
            "its run_key is None, here b",
        ),
        ({"altitude_m": np.nan}, "altitude_m must be .*finite"),
        (
            {"planner": "ptp", "pilot": HIDDEN},
            "a pilot's routes are planned by A.*: leave one of both out",
        ),
        ({"altitude_m": 30.0}, "no route of .* is of use: none is asked for"),
    ],
)
def test_other_settings_than_the_studys_are_refused(study, change, words):
    with pytest.raises(InputError, match=words):
        routes_of(study, **change)


def test_maps_that_are_not_known_are_asked_for(study, maps, tmp_path):
    with pytest.raises(InputError, match="a table does not hold the maps"):
        routes_of(study.instances)
    with pytest.raises(InputError, match="leave 'ptp' out"):
        routes_of(study.instances, maps, planner="ptp")
    with pytest.raises(InputError, match="holds no study of planners"):
        routes_of(tmp_path, maps)
