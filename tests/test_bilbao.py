"""Bilbao: a building raster and a terrain raster that do not align, end to end."""

import json

import numpy as np
import pytest
from scipy.ndimage import label

import jaxurban as ju
from benchmarks.random_routes import read_plan
from jaxurban.cities.raster import read_raster
from jaxurban.cli.main import app
from jaxurban.flights.export.write import write_path
from jaxurban.kernels.tolerances import GROUND_TOLERANCE_M
from jaxurban.paths.ground import elevation_at
from jaxurban.paths.places import XY
from jaxurban.paths.plan import cost_map

pytestmark = pytest.mark.data

SCENARIO = """
[region]
bounds = [-2.992, 43.308, -2.982, 43.314]
crs = "EPSG:25830"
resolution_m = 10
altitudes_m = [20, 60, 122]
[buildings]
source = "{folder}/bilbao_building_heights.tif"
[terrain]
source = "{folder}/bilbao_dem.tif"
[lidar]
azimuths = 60
"""


@pytest.fixture(scope="module")
def folder(data_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bilbao")
    (folder / "bilbao.toml").write_text(SCENARIO.format(folder=(data_dir / "raster").resolve()))
    app.main(
        ["maps", str(folder / "bilbao.toml"), "-o", str(folder / "out")], standalone_mode=False
    )
    return folder / "out"


@pytest.mark.slow
def test_rasters_that_do_not_align_become_maps(folder, data_dir):
    maps = ju.open_maps(folder)
    for kind, extremes_m in (("building_heights", (0, 52)), ("dem", (-2, 103))):  # as published
        values = read_raster(data_dir / "raster" / f"bilbao_{kind}.tif", "EPSG:25830").values
        assert (values.min(), values.max()) == extremes_m
    assert maps.ds["has_data"].all()
    for name in ("gps", "lidar", "risk"):
        values = maps.ds[name].values
        assert np.array_equal(
            np.isnan(values), np.broadcast_to(maps.ds["obstacle"].values == 1, values.shape)
        )
        assert 0 <= np.nanmin(values) < np.nanmax(values) <= 1
    means = [float(np.nanmean(maps.m("gps", z))) for z in maps.altitudes_m]
    assert means == sorted(means)
    assert 0 < maps.m("roof").max() <= 52
    assert -2 <= maps.m("terrain").min() < maps.m("terrain").max() <= 103
    assert np.nanmean(maps.m("lidar", 122.0)) < 0.05 < np.nanmean(maps.m("lidar", 20.0))
    # Up the hill the horizon is open: over bare ground, the highest tenth sees no fewer satellites than the lowest.
    seen, ground, bare = maps.m("num_visible", 20.0), maps.m("terrain"), maps.m("roof") == 0
    low, high = np.quantile(ground, [0.1, 0.9])
    assert seen[bare & (ground >= high)].mean() >= seen[bare & (ground <= low)].mean()
    record = json.loads((folder / "run.json").read_text())
    assert set(record["inputs"]) == {"buildings", "terrain"}


@pytest.mark.slow
@pytest.mark.parametrize("vertical_m", [0.0, 3.0])
def test_forty_simplified_missions_keep_the_clearance_over_every_roof_that_a_leg_crosses(
    folder, tmp_path, monkeypatch, vertical_m
):
    """At an altitude 5 cm more than the clearance over roofs of 22 m; each leg sampled every 10 cm.

    The missions' own check is left out: it would refuse to land on these roofs, and ends are drawn everywhere here.
    """
    monkeypatch.setattr("jaxurban.flights.export.qgc_plan.check_own", lambda *_: "")
    maps, altitude_m, file = ju.open_maps(folder), 22.05 + vertical_m, tmp_path / "path.plan"
    constraints = ju.Constraints(vertical_clearance_m=vertical_m)
    on = cost_map(
        maps, altitude_m, weights={"distance": 1.0}, cost_model="line", constraints=constraints
    )
    islands, _ = label(on.is_free)
    cells = np.random.default_rng(0).permutation(
        np.argwhere(islands == np.argmax(np.bincount(islands[on.is_free])))
    )
    grid, roof_m, terrain_m = maps.grid, maps.m("roof_touched"), maps.m("terrain")
    least_m, num_over = [], 0
    for start, goal in cells[:80].reshape(40, 2, 2):
        ends = (XY(*grid.xy_of_cell(*cell)) for cell in (start, goal))
        write_path(ju.simplify(on.plan(*ends, planner="theta-star"), on, 5.0), file)
        lon, lat, z_m = read_plan(file).T
        x_m, y_m = grid.xy_of_lonlat(lon, lat)
        z_m += json.loads(file.read_text())["mission"]["plannedHomePosition"][2]
        along_m = np.append(0.0, np.cumsum(np.hypot(np.diff(x_m), np.diff(y_m))))
        at_m = np.arange(0.0, along_m[-1], 0.1)
        x_m, y_m, z_m = (np.interp(at_m, along_m, values) for values in (x_m, y_m, z_m))
        above_m = z_m - elevation_at(
            x_m - grid.x_min_m, y_m - grid.y_min_m, terrain_m, grid.resolution_m
        )
        assert altitude_m - 0.02 < above_m.min() <= above_m.max() < altitude_m + GROUND_TOLERANCE_M
        beneath_m = roof_m[grid.cell_of_xy(x_m, y_m)]
        if beneath_m.any():
            least_m.append((above_m - beneath_m)[beneath_m > 0].min())
            num_over += bool((beneath_m == 22.0).any())
    assert len(least_m) > 30
    assert num_over > 3
    assert min(least_m) > vertical_m
