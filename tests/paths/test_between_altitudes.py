"""Any altitude between those of the maps: metrics linear between them, obstacles exact, told, and refused beyond."""

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.report.figures.metrics import obstacle_layer

LOW_M, Z_M, HIGH_M = 20.0, 35.0, 60.0


def test_metrics_run_linearly_between_two_maps_and_obstacles_are_the_roofs(maps):
    on = ju.cost_map(maps, Z_M, time_of_day="night")
    share = (Z_M - LOW_M) / (HIGH_M - LOW_M)
    assert np.array_equal(on.is_free, maps.m("roof_touched") < Z_M)
    for rule, name in (("centre", "roof"), ("touched", "roof_touched")):
        for z_m in (Z_M, HIGH_M):
            assert np.array_equal(maps.is_free(z_m, rule), maps.m(name) < z_m)
    over_roof = maps.m("obstacle", LOW_M) == 1
    for name, layer in zip(on.names, on.costs, strict=True):
        low, high = (maps.m(name, z_m, time_of_day="night") for z_m in (LOW_M, HIGH_M))
        by_hand = 1 - np.where(over_roof, high, (1 - share) * low + share * high)
        by_hand = maps.m(name, time_of_day="night") if name == "population" else by_hand
        np.testing.assert_allclose(layer[on.is_free], by_hand[on.is_free], atol=1e-6)
    volume = ju.cost_map(maps, ju.Levels(Z_M, Z_M, 10.0), time_of_day="night")  # of one level
    assert np.array_equal(on.costs, volume.costs[:, 0])
    assert np.array_equal(on.is_free, volume.is_free[0])
    drawn = obstacle_layer(maps, Z_M).values
    assert np.array_equal(drawn == 0, maps.m("roof") >= Z_M)  # -1: not drawn


@pytest.mark.parametrize("z_m", [LOW_M, HIGH_M])
def test_an_altitude_of_the_maps_takes_their_bits(maps, z_m):
    on = ju.cost_map(maps, z_m)
    assert np.array_equal(on.is_free, maps.is_free(z_m))
    assert np.array_equal(on.costs, [*maps.costs(z_m).values()])


@pytest.mark.parametrize("planner", ["astar-plus", "theta-star", "bitstar-plus"])
def test_a_path_flies_there_and_says_what_its_metrics_are(maps, ends, planner, tmp_path):
    path = ju.plan(maps, **ends, altitude_m=Z_M, planner=planner, cost_model="line", budget_s=0.3)
    assert path.status.has_path
    assert set(path.z_m) == {Z_M}
    assert "Metrics at 35 m are interpolated between the maps of 20 and 60 m." in path.to_dict()["message"]
    assert path.settings["metrics_between_m"] == [LOW_M, HIGH_M]
    report = ju.explain(path, maps)
    assert report.totals["cost"] == pytest.approx(path.cost, rel=1e-9)
    assert report.totals["mean_gps"] == pytest.approx(path.metrics["gps"], rel=1e-9)
    (again,) = ju.fit.read_demonstrations(path.save(tmp_path / "route.geojson"), maps)
    assert again.query.cost_map.altitude_m == Z_M
    held = ju.plan(maps, **ends, altitude_m=HIGH_M)
    assert "metrics_between_m" not in held.settings
    assert "interpolated" not in held.to_dict()["message"]


def test_a_batch_takes_any_altitude(maps, ends):
    xy = pd.DataFrame([np.ravel([*ends.values()])], columns=["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"])
    (of_row,) = ju.plan_many(maps, xy.assign(altitude_m=Z_M), progress=False)
    (of_all,) = ju.plan_many(maps, xy, altitude_m=Z_M, progress=False)
    assert of_row.cost == of_all.cost == ju.plan(maps, **ends, altitude_m=Z_M).cost
