"""Routes of tables of instances and of queries: planned under their weights, or left out and counted."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError, SkippedRouteWarning
from jaxurban.studies.queries import check_alike
from tests.studies.routes_made import HIDDEN, cosine, small_maps

PLANNER = "astar-plus"
STUDY = ju.studies.Study(planners=PLANNER, weights=[HIDDEN], distance_only=(), seed=2)
routes_of = ju.fit.demonstrations


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
def test_instances_of_a_study_give_the_routes_of_its_exact_planner_at_their_costs(
    study, maps, tmp_path
):
    file = study.folder / "instances.parquet"
    shown = routes_of(file, study.folder.parent)
    names = [(int(each.query.name), each.query.cost_map.altitude_m) for each in shown]
    costs = study.rows.set_index(["instance", "altitude_m"]).cost.loc[names]
    np.testing.assert_allclose(costs_of(shown), costs, rtol=1e-9)
    low = routes_of(file, maps, 20.0, time_of_day="night", metrics=["gps", "risk"])
    assert len(low) == study.instances.instance.nunique()
    assert {(each.query.cost_map.altitude_m, each.query.cost_map.time_of_day) for each in low} == {
        (20.0, "night")
    }
    assert low[0].query.names == ("distance", "gps", "risk")


def test_rows_of_no_use_are_left_out_and_counted(study, maps):
    away = study.instances.copy()
    away.loc[3, "start_x_m"] = 0.0
    num = len(away)
    words = rf"^1 of {num} routes of the routes could not be used: instance 3 at 20 m: .*outside"
    with pytest.warns(SkippedRouteWarning, match=words):
        assert len(routes_of(away, maps)) == num - 1
    with pytest.raises(InputError, match="no route of the routes is of use: instance 3 at 20 m"):
        routes_of(away.loc[[3]], maps)


@pytest.mark.slow
def test_routes_by_day_and_by_night_of_a_study_under_one_w_give_that_w_back(study, maps):
    low = study.instances.query("altitude_m == 20").head(16)
    shown = routes_of(low, maps)
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
    cheapest = joined[["instance", "altitude_m"]].merge(study.rows).cost
    for given in (joined, tmp_path / "instances.csv", asked):
        np.testing.assert_allclose(costs_of(routes_of(given, maps)), cheapest, rtol=1e-9)
    np.testing.assert_allclose(costs_of(routes_of(places, maps, pilot=HIDDEN)), cheapest, rtol=1e-9)
    with pytest.raises(
        InputError, match="has no weights under which its routes are the cheapest: give a column"
    ):
        routes_of(places, maps)
    with pytest.raises(InputError, match=r"unknown columns \['a', 'b'\]"):
        routes_of(pd.DataFrame({"a": [1], "b": [2]}), maps)


def test_a_table_under_many_weights_is_refused_unless_one_pilot_flies_its_pairs(maps):
    drawn = ju.studies.sample_instances(maps, 4)
    joined = drawn[drawn.is_connected]
    with pytest.raises(
        InputError,
        match=r"under 4 different weights, and a fit finds one W: run the study under one",
    ):
        routes_of(drawn, maps)
    doubled = joined.assign(**{f"w_{name}": value for name, value in HIDDEN.to_dict().items()})
    doubled.loc[doubled.index[::2], doubled.columns.str.startswith("w_")] *= (
        2  # the same W: only ratios count
    )
    assert costs_of(routes_of(doubled, maps)) == costs_of(routes_of(joined, maps, pilot=HIDDEN))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"altitude_m": np.nan}, "altitude_m must be .*finite"),
        ({"altitude_m": 30.0}, "the instances ask for altitude_m 30"),
        ({"time_of_day": "noon"}, "the instances ask for time_of_day noon"),
        ({"metrics": ["gsp"]}, "got 'gsp'"),
    ],
)
def test_what_the_maps_do_not_hold_is_refused(study, maps, change, words):
    with pytest.raises(InputError, match=words):
        routes_of(study.instances, maps, **change)


def test_lines_need_no_pilot(maps, tmp_path):
    free = np.argwhere(maps.is_free(20.0))
    ends = [maps.grid.lonlat_of_cell(*free[at]) for at in (0, -1)]
    path = ju.plan(maps, *ends, altitude_m=20.0)
    for lines in (path, path.save(tmp_path / "path.geojson")):
        assert len(routes_of(lines, maps)) == 1
        with pytest.raises(InputError, match="are lines: leave the pilot out"):
            routes_of(lines, maps, pilot=HIDDEN)
