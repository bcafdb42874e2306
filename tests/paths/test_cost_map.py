"""Maps weighed once answer many queries as `plan` answers each."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxurban as ju
from jaxurban import progress
from jaxurban.errors import InputError
from tests.paths.volumes import ends_at


def test_maps_weighed_once_give_the_paths_of_separate_plans(town):
    weighted = ju.cost_map(town, 20.0, weights=ju.Weights(gps=3.0), cost_model="line")
    for pair in np.random.default_rng(0).choice(np.argwhere(weighted.is_free), (3, 2)):
        ends = ends_at(town, *pair)
        once = weighted.plan(*(ju.XY(*xy_m) for xy_m in ends.values()))
        anew = ju.plan(town, altitude_m=20.0, weights=ju.Weights(gps=3.0), cost_model="line", **ends)
        assert (once.cost, once.metrics, once.settings) == (anew.cost, anew.metrics, anew.settings)
    assert weighted.problem is weighted.problem


def test_the_metrics_of_a_path_are_the_means_over_the_length_in_each_cell(town):
    weighted = ju.cost_map(town, 20.0, cost_model=ju.CostModel("line", 1.0), weights=ju.Weights(0))
    cells = np.argwhere(weighted.is_free)[[0, -1]]
    planned = weighted.plan(*(ju.XY(*town.grid.xy_of_cell(*cell)) for cell in cells))
    for name, mean in planned.metrics.items():
        mean_cost = mean if name == "population" else 1 - mean
        assert planned.cost_by_layer[name] == pytest.approx(mean_cost * planned.length_m, rel=1e-6)


def test_rounding_takes_no_mean_out_of_0_to_1(town):
    rounded = SimpleNamespace(mean_costs=np.full(4, np.nextafter(1.0, 2.0)))
    means = ju.cost_map(town, 600.0).means(rounded)
    assert means == {"gps": 0.0, "lidar": 0.0, "population": 1.0, "risk": 0.0}


@pytest.fixture(scope="module")
def shortest(town) -> ju.CostMap:
    """Many routes are as short as the shortest."""
    return ju.cost_map(town, 20.0, objective="distance")


@pytest.fixture(scope="module")
def pairs(shortest) -> list:
    free = np.random.default_rng(2).choice(np.argwhere(shortest.is_free), (4, 2))
    return [[ju.XY(*shortest.grid.xy_of_cell(*cell)) for cell in pair] for pair in free]


def test_equal_plans_are_one_route(town, shortest, pairs):
    for start, goal in pairs:
        alone = ju.plan(town, start, goal, altitude_m=20.0, objective="distance")
        for _ in range(20):
            path = shortest.plan(start, goal)
            assert path.search.heuristic == alone.search.heuristic == "tiles"
            np.testing.assert_array_equal(path.xy_m, alone.xy_m)


def test_a_prepared_map_plans_by_landmarks_at_the_same_cost_and_leaves_the_other_as_it_was(town, shortest, pairs):
    before = [shortest.plan(*pair) for pair in pairs]
    prepared = shortest.prepare()
    for pair, path in zip(pairs, before, strict=True):
        guided, after = prepared.plan(*pair), shortest.plan(*pair)
        assert (guided.search.heuristic, after.search.heuristic) == ("landmarks", "tiles")
        assert guided.search.cost == pytest.approx(path.search.cost, rel=1e-9)
        np.testing.assert_array_equal(after.xy_m, path.xy_m)
    assert prepared.plan(*pairs[0], heuristic="octile").search.heuristic == "octile"
    assert prepared.plan(*pairs[0], planner="astar-dist").search.heuristic == "euclidean"
    assert prepared.with_weights({"gps": 2}).plan(*pairs[0]).search.heuristic == "tiles"
    assert prepared.only(["gps"]).plan(*pairs[0]).search.heuristic == "tiles"


def test_a_search_that_lasts_says_so_and_for_how_long(town, shortest, pairs, monkeypatch, caplog):
    monkeypatch.setattr(progress, "SILENT_S", 0.01)
    ju.cost_map(town, 20.0).plan(*pairs[1], planner="bitstar-dist", budget_s=0.5)
    assert "bitstar-dist is at work: its search may take up to 0.5 s (budget_s)" in caplog.text
    caplog.clear()
    monkeypatch.setattr(progress, "SILENT_S", 5.0)
    shortest.plan(*pairs[0])
    assert not caplog.records


def test_a_map_without_a_free_cell_is_refused(town):
    closed = town.ds.assign(obstacle=town.ds["obstacle"] * 0 + 1)
    weighted = ju.cost_map(ju.MetricMaps(closed), 20.0)
    with pytest.raises(InputError, match="no cell is free at 20 m"):
        weighted.problem.between((0, 0), (1, 1))
