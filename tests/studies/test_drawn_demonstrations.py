"""Routes from tables, studies, missions and KML: found again as they were, or said not to be."""

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError, LeftOutWarning, OtherSettingsWarning
from jaxurban.paths.export.write import write_path
from jaxurban.studies.montecarlo.trial import BenchmarkSettings
from tests.studies.routes_made import HIDDEN, small_maps


@pytest.fixture(scope="module")
def maps():
    return small_maps()


@pytest.fixture(scope="module")
def instances(maps):
    drawn = ju.sample_instances(maps, 8, weights=[HIDDEN], seed=2)
    return drawn[drawn.is_connected]


@pytest.fixture(scope="module")
def planned(maps, instances):
    return [
        ju.plan(
            maps,
            start_xy_m=(row.start_x_m, row.start_y_m),
            goal_xy_m=(row.goal_x_m, row.goal_y_m),
            altitude_m=row.altitude_m,
            time=row.time,
            time_of_day=row.time_of_day,
            weights=HIDDEN,
            cost_model="line",
        )
        for row in instances.itertuples()
    ]


@pytest.fixture(scope="module")
def study(maps, instances, tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    settings = BenchmarkSettings(planners=("ptp", "astar-plus", "bitstar-plus"), budget_iterations=100)
    ju.study(maps, folder, instances, settings=settings, progress=False)
    return folder


@pytest.mark.parametrize("suffix", [".geojson", ".kml", ".plan"])
def test_files_of_paths_bring_their_cost_model_and_their_features(maps, planned, tmp_path, suffix):
    for number, path in enumerate(planned[:3]):
        write_path(path, tmp_path / f"{number}{suffix}")
        (read,) = ju.read_demonstrations(tmp_path / f"{number}{suffix}", maps)
        assert read.query.cost_map.cost_model.kind == "line"
        assert read.query.cost_map.altitude_m == path.altitude_m
        assert read.features @ HIDDEN.vector(read.query.names) == pytest.approx(path.cost, rel=1e-9)


def test_instances_are_routes_under_their_weights(maps, instances, planned, tmp_path):
    instances.to_csv(tmp_path / "instances.csv", index=False)
    for given in (instances, tmp_path / "instances.csv"):
        read = ju.read_demonstrations(given, maps, cost_model="line")
        costs = [each.features @ HIDDEN.vector(each.query.names) for each in read]
        np.testing.assert_allclose(costs, [path.cost for path in planned], rtol=1e-9)


def test_a_study_gives_the_paths_of_one_of_its_planners_at_their_own_cost(maps, instances, study):
    rows = pd.read_parquet(study / "rows.parquet").query("objective == 'weighted'")
    for planner in ("astar-plus", "bitstar-plus"):
        read = ju.read_demonstrations(study, maps, planner=planner)
        found = rows[(rows.planner == planner) & rows.cost.notna()]
        assert len(read) == len(found)
        costs = [each.features @ HIDDEN.vector(each.query.names) for each in read]
        # A path of BIT* is redrawn on the grid, at most 8.24 % longer, and beside it.
        np.testing.assert_allclose(sorted(costs), sorted(found.cost), rtol=1e-9 if planner == "astar-plus" else 0.15)
    chosen = ju.read_demonstrations(study, maps, metrics=["gps", "risk"])
    assert chosen[0].query.names == ("distance", "gps", "risk")
    np.testing.assert_array_equal(chosen[0].points_m, ju.read_demonstrations(study, maps)[0].points_m)
    with pytest.raises(InputError, match=r"planner must be one of the study's, .*astar-plus.*'thetastar'"):
        ju.read_demonstrations(study, maps, planner="thetastar")


def test_a_row_without_one_of_the_weights_is_refused_but_under_a_pilots(maps, instances):
    table = instances.assign(w_gps=[np.nan if number == 1 else 1.0 for number in range(len(instances))])
    with pytest.raises(InputError, match="row 2 of 'the table' has no w_gps: give a number in each row"):
        ju.read_demonstrations(table, maps, cost_model="line")
    assert ju.read_demonstrations(table, maps, cost_model="line", pilot=HIDDEN)


def test_rows_that_do_not_come_out_again_are_left_out_and_counted(maps, instances, planned, tmp_path):
    table = instances.assign(cost=[path.cost for path in planned])
    table.loc[table.index[0], "cost"] *= 1.5
    with pytest.warns(LeftOutWarning, match=f"1 of {len(table)} routes"):
        assert len(ju.read_demonstrations(table, maps, cost_model="line")) == len(table) - 1
    with pytest.raises(InputError, match="none is left: name the maps and the cost model"):
        ju.read_demonstrations(table, maps, cost_model="cell")


def test_routes_of_several_weights_are_warned_of_and_a_pilot_draws_them_anew(maps):
    mixed = ju.sample_instances(maps, 4, seed=2)
    mixed = mixed[mixed.is_connected]
    with pytest.warns(OtherSettingsWarning, match="under different weights, and a fit finds one W"):
        ju.read_demonstrations(mixed, maps, cost_model="line")
    for each in ju.read_demonstrations(mixed, maps, cost_model="line", pilot=HIDDEN):
        weights = HIDDEN.vector(each.query.names)
        cheapest = each.query.sums(each.query.cheapest(weights))[0]
        assert each.features @ weights == pytest.approx(cheapest @ weights, rel=1e-12)


def test_wrong_tables_and_missions_are_one_sentence(maps, instances, tmp_path):
    (tmp_path / "broken.plan").write_text('{"mission": {"items": []}}')
    with pytest.raises(InputError, match="no mission of two waypoints"):
        ju.read_demonstrations(tmp_path / "broken.plan", maps)
    (tmp_path / "broken.plan").write_text("[]")
    with pytest.raises(InputError, match="cannot be read as a mission"):
        ju.read_demonstrations(tmp_path / "broken.plan", maps)
    with pytest.raises(InputError, match=r"no finished study, since it holds no study\.json"):
        ju.read_demonstrations(tmp_path, maps)
    with pytest.raises(InputError, match="are in EPSG:1, the maps in"):
        ju.read_demonstrations(instances.assign(crs="EPSG:1"), maps)
    with pytest.raises(InputError, match="row 1 of 'the table': start"):
        ju.read_demonstrations(instances.assign(start_x_m=0.0), maps)
    with pytest.raises(InputError, match="leave planner out"):
        ju.read_demonstrations(instances, maps, planner="astar-plus")
