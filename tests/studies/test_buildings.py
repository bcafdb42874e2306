"""What buildings cost a route: against finite differences of the soft cost, and against the exact model."""

import json
from dataclasses import replace

import jax
import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.io.files import write_json
from jaxurban.io.stored import RUN_FILE
from jaxurban.maps.differentiable import SoftParams, soften
from jaxurban.maps.run import run_scenario, tasks_of
from jaxurban.maps.scenario import Scenario
from jaxurban.report.buildings import write_buildings
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
    return ju.plan(maps, start_xy_m=start, goal_xy_m=goal, altitude_m=25.0, snap=True)


@pytest.fixture(scope="module")
def task():
    (task,) = tasks_of(Scenario.from_dict(SETTINGS))
    return task


@pytest.mark.slow
def test_the_table_agrees_with_finite_differences_of_the_soft_cost_and_is_written_with_its_picture(
    task, folder, route, tmp_path
):
    table = write_buildings(folder, route, tmp_path)
    params = SoftParams(25.0, 2.0, dict(task.params.sections))
    with jax.enable_x64(True):
        soft = soften(task, dtype=np.float64)

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
    pd.testing.assert_frame_equal(
        pd.read_csv(tmp_path / "buildings.csv", index_col="rank"), table, check_like=True
    )
    assert len(pd.read_parquet(tmp_path / "buildings.parquet")) == len(table)
    assert (tmp_path / "buildings.png").stat().st_size > 10_000
    lon, lat = route.lonlat[0]
    assert table.lon.between(lon - 0.02, lon + 0.02).all()
    assert table.lat.between(lat - 0.02, lat + 0.02).all()


@pytest.mark.slow
def test_other_sources_than_those_of_the_maps_are_refused(folder, route, tmp_path):
    record = json.loads((folder / RUN_FILE).read_text())
    record["inputs"]["orbits"] = {"path": "sky.tle", "sha256": "0"}
    record["settings"]["gps"]["orbits"] = ["sky.tle"]
    write_json(tmp_path / RUN_FILE, record)
    with pytest.raises(ju.InputError, match=r"nowhere.* were not made by `jaxurban maps`"):
        write_buildings(tmp_path / "nowhere", route, tmp_path)
    with pytest.raises(ju.InputError, match=r"no longer there .*'sky.tle'"):
        write_buildings(tmp_path, route, tmp_path)
    (tmp_path / "sky.tle").write_text("another sky")
    with pytest.raises(ju.InputError, match=r"no longer there .*'sky.tle'"):
        write_buildings(tmp_path, route, tmp_path)


@pytest.mark.slow
def test_other_routes_weights_and_altitudes_are_refused(folder, route, task, tmp_path):
    soft, params = soften(task), SoftParams(25.0, 2.0)
    nowhere = replace(route, status=type(route.status).NO_PATH)
    coarse = replace(route, settings={**route.settings, "resolution_m": 20.0})
    climbing = replace(route, z_m=route.z_m + np.arange(len(route.z_m)))
    high = replace(params, altitude_m=60.0)
    for sentence, call, given in (
        ("there is no route", write_buildings, (folder, nowhere, tmp_path)),
        ("20 m", write_buildings, (folder, coarse, tmp_path)),
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
