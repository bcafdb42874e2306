"""What buildings cost a route: against finite differences of the soft cost, and against the exact model."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxurban as ju
from jaxurban.maps.differentiable import SoftParams, soften
from jaxurban.maps.run import run_scenario, tasks_of
from jaxurban.maps.scenario import Scenario
from jaxurban.studies.weights.buildings import building_costs

SETTINGS = {
    "region": {
        "bounds": (-74.0, 40.75, -73.993, 40.756),
        "resolution_m": 10.0,
        "altitudes_m": [25.0],
    },
    "buildings": {"source": "synthetic"},
    "lidar": {"beams": 3, "azimuths": 24, "range_m": 60.0},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    run_scenario(Scenario.from_dict(SETTINGS), folder)
    return folder


@pytest.fixture(scope="module")
def route(folder):
    maps = ju.open_maps(folder)
    x_m, y_m = (np.quantile(along, (0.1, 0.9)) for along in (maps.grid.x_m, maps.grid.y_m))
    start, goal = zip(x_m.tolist(), y_m.tolist(), strict=True)
    return ju.plan(maps, ju.XY(*start), ju.XY(*goal), altitude_m=25.0, snap=True)


@pytest.fixture(scope="module")
def task():
    (task,) = tasks_of(Scenario.from_dict(SETTINGS))
    return task


@pytest.mark.slow
def test_the_table_agrees_with_finite_differences_of_the_soft_cost(task, route):
    params = SoftParams(25.0, 2.0, dict(task.params.sections))
    with jax.enable_x64(True):
        soft = soften(task, dtype=np.float64)
        table = building_costs(task.city, soft, route, params)

        def cost(height_m):
            return building_costs(task.city, replace(soft, height_m=height_m), route, params).attrs[
                "soft_cost"
            ]

        np.testing.assert_allclose(cost(soft.height_m), table.attrs["soft_cost"], rtol=1e-12)
        assert len(table) > 12
        assert table.per_metre.is_monotonic_decreasing
        np.testing.assert_allclose(table.per_metre, table.gps + table.lidar + table.risk)
        for row in (
            table.reindex(table.per_metre.abs().sort_values(ascending=False).index)
            .head(12)
            .itertuples()
        ):
            step = 1e-5 * np.eye(len(soft.height_m))[row.building]
            slope = (cost(soft.height_m + step) - cost(soft.height_m - step)) / 2e-5
            np.testing.assert_allclose(row.per_metre, slope, rtol=1e-4, atol=1e-6)
    lon, lat = route.lonlat[0]
    assert table.lon.between(lon - 0.02, lon + 0.02).all()
    assert table.lat.between(lat - 0.02, lat + 0.02).all()


@pytest.mark.slow
def test_other_routes_weights_and_altitudes_are_refused(route, task):
    soft, params = soften(task), SoftParams(25.0, 2.0)
    nowhere = replace(route, status=type(route.status).NO_PATH)
    coarse = replace(route, settings={**route.settings, "resolution_m": 20.0})
    climbing = replace(route, z_m=route.z_m + np.arange(len(route.z_m)))
    high = replace(params, altitude_m=60.0)
    for sentence, call, given in (
        ("there is no route", building_costs, (task.city, soft, nowhere, params)),
        ("20.0, .* m and", building_costs, (task.city, soft, coarse, params)),
        (
            "one CRS, cell size and altitude, got .* 25.0 m and .* 60.0",
            building_costs,
            (task.city, soft, route, high),
        ),
        ("unknown weight 'rsk'", building_costs, (task.city, soft, route, params, {"rsk": 5})),
        ("the route changes its altitude", building_costs, (task.city, soft, climbing, params)),
    ):
        with pytest.raises(ju.InputError, match=sentence):
            call(*given)
