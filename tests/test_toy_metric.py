"""A metric defined here in whole, and a raster of one's own: each runs through everything, as built-in ones do."""

from dataclasses import dataclass
from unittest.mock import patch

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pandas as pd
import pytest
import rasterio
from jax.test_util import check_grads

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.differentiable import path_visits
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import ALTITUDE, Metric, Scale, Variable, low_is_bad
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.settings import differentiable
from jaxurban.planners.registry import PLANNERS
from jaxurban.plot import plot_metric, plot_overview, plot_paths
from jaxurban.typing import PlannedPath
from jaxurban.viewer.layers import layers_of
from tests import tiled_runs
from tests.made_maps import made_maps

REACH_M = 40.0  # two cells of the tiled job


@differentiable("scale_m")
@dataclass(frozen=True)
class ToyParams:
    """How many metres of roof above or near the flight altitude spoil the view."""

    scale_m: float = 30.0


def toy_of(surface, altitude_m, params):
    """Return how far the highest roof within `REACH_M` to the north is below the altitude, 1 where it is the scale."""
    halo = round(REACH_M / surface.grid.resolution_m)
    roof_m = surface.crop_with_halo(surface.roof_m, halo)
    rows, cols = surface.region.shape
    north_m = jnp.stack(
        [roof_m[halo + k : halo + k + rows, halo : halo + cols] for k in range(halo + 1)]
    ).max(axis=0)
    return jax.nn.sigmoid((altitude_m - north_m) / params.scale_m)


def toy_map(scene, params):
    m = jnp.where(scene.is_obstacle, 0.0, toy_of(scene.surface, scene.altitude_m, params)).astype(
        jnp.float32
    )
    return {"toy": m, "near_m": scene.surface.crop(scene.surface.roof_m)}


def soft_toy(scene, params):
    m = toy_of(scene.surface, scene.altitude_m, params)
    return m if scene.cells is None else m[scene.cells[:, 0], scene.cells[:, 1]]


TOY = Metric(
    name="toy",
    params=ToyParams,
    dims=(ALTITUDE,),
    compute=toy_map,
    soft=soft_toy,
    cost=low_is_bad,
    reach_m=lambda params: REACH_M,
    label="View to the north",
    one_means="nothing high to the north",
    colour="#123456",
    colour_map="cividis",
    also=(
        Variable(
            "near_m",
            "height of the roof below",
            "m",
            inside=np.nan,
            scale=Scale("magma", high=50.0),
        ),
    ),
)
WEIGHTS = {"distance": 0.1, "gps": 0.5, "toy": 2.0}
ALTITUDE_M = 20.0


@pytest.fixture(autouse=True)
def _toy(monkeypatch):
    monkeypatch.setitem(METRICS, "toy", TOY)


@pytest.fixture
def _only_quick(_toy):
    """Leave out the metrics that take seconds to compile."""
    with patch.dict(METRICS):  # which keeps their order
        for name in ("gps", "lidar", "risk"):
            del METRICS[name]
        yield


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    made = made_maps(20, 24)
    toy = np.random.default_rng(1).uniform(0.1, 1.0, made.ds["risk"].shape).astype(np.float32)
    given = {"toy": toy * (1 - made.ds["obstacle"].values), "near_m": 20 * toy}
    return ju.MetricMaps(
        made.ds.assign({name: (made.ds["risk"].dims, values) for name, values in given.items()})
    )


@pytest.fixture(scope="module")
def ends(maps):
    free = np.argwhere(maps.is_free(ALTITUDE_M))
    return tuple(tuple(map(float, maps.grid.lonlat_of_cell(*free[at]))) for at in (0, -1))


@pytest.fixture
def path(maps, ends) -> PlannedPath:
    return ju.plan(maps, *ends, altitude_m=ALTITUDE_M, weights=WEIGHTS)


@pytest.mark.slow
@pytest.mark.usefixtures("_only_quick")
def test_tiles_equal_the_whole_and_files_hold_it(tmp_path):
    city, params = tiled_runs.city(), MapParams(altitudes_m=(ALTITUDE_M,))
    task = MapTask(city, tiled_runs.region(city), tiled_runs.sky(), params)
    whole = ju.MetricMaps(tiled_runs.check_tiles(task, tmp_path / "tiled"))
    m = whole.m("toy", ALTITUDE_M)
    assert 0 < np.nanmin(m) < np.nanmax(m) < 1
    assert len(np.unique(m)) > 10
    folder = whole.save(tmp_path / "saved", layers=("near_m",))
    with rasterio.open(folder / "geotiff" / "toy_20m_20m.tif") as file:
        np.testing.assert_array_equal(file.read(1)[::-1], m)
        assert file.tags()["one_means"] == TOY.one_means
    with rasterio.open(folder / "geotiff" / "near_m_20m_20m.tif") as file:
        np.testing.assert_array_equal(
            np.isnan(file.read(1)[::-1]), whole.m("obstacle", ALTITUDE_M) != 0
        )
        assert (file.units, file.tags()["long_name"]) == (("m",), "height of the roof below")
    style = (folder / "geotiff" / "near_m_20m.qml").read_text()
    assert 'classificationMax="50.0"' in style
    assert matplotlib.colors.to_hex(matplotlib.colormaps["magma"](1.0)) in style
    assert list(ju.open_maps(folder).metrics) == ["population", "toy"]


@pytest.mark.slow
@pytest.mark.parametrize("planner", [*PLANNERS, "astar-volume"])
def test_every_planner_pays_for_it(maps, ends, planner):
    settings = {
        "altitude_m": ju.Levels() if planner == "astar-volume" else ALTITUDE_M,
        "planner": planner,
    }
    if planner == "ptp":  # over open ground
        maps = ju.MetricMaps(
            maps.ds.assign({name: maps.ds[name] * 0 for name in ("obstacle", "roof_touched")})
        )
    path = ju.plan(maps, *ends, weights=WEIGHTS, cost_model="line", budget_s=0.2, **settings)
    assert path.status.has_path
    assert path.cost_by_layer["toy"] > 0
    assert 0 < path.metrics["toy"] < 1
    report = ju.explain(path, maps)
    assert report.totals["cost_of_toy"] == pytest.approx(path.cost_by_layer["toy"], rel=1e-9)
    assert "+toy" in report.table()


def test_a_batch_takes_its_weight_from_a_column(maps, ends, path):
    table = pd.DataFrame(
        [dict(zip(("start_lon", "start_lat", "goal_lon", "goal_lat"), np.ravel(ends), strict=True))]
    )
    table = table.assign(**{f"w_{name}": value for name, value in WEIGHTS.items()})
    batch = ju.plan_many(maps, table, altitude_m=ALTITUDE_M, progress=False)
    assert batch[0].cost == pytest.approx(path.cost, rel=1e-9)
    assert batch.to_dataframe().cost_toy.item() == pytest.approx(path.cost_by_layer["toy"])


@pytest.mark.slow
def test_pictures_show_it(maps, path, tmp_path):
    assert "View to the north" in plot_metric(maps, "toy").texts[0].get_text()
    assert any(
        "View to the north" in axes.get_title("left") for axes in plot_overview(maps, path).axes
    )
    assert plot_paths(maps, path).axes
    assert "Height of the roof below" in plot_metric(maps, "near_m").texts[0].get_text()
    shown = layers_of(maps)["near_m"].colours(maps.m("near_m"))
    assert (shown.cmap, shown.norm.vmax, shown.label) == (
        "magma",
        50.0,
        "height of the roof below in metres",
    )


@pytest.mark.slow
@pytest.mark.usefixtures("_only_quick")
def test_the_planned_cost_has_its_gradient_by_heights_and_its_own_parameters():
    city = ju.demo_city(width_m=400, height_m=400)
    grid = ju.Grid(
        city.crs, 20.0, *(int(np.ceil(v / 20.0)) + 2 for v in city.extent_m[1::-1]), 12, 12
    )
    with jax.enable_x64(True):
        soft = ju.grad.soft_city(
            city, grid, ju.grad.SoftParams(ALTITUDE_M, sections={"toy": ToyParams(30.0)})
        )
        assert soft.names == ("population", "toy")
        visits = path_visits(
            np.array([[30.0, 30.0], [210.0, 170.0]]), grid.shape, 20.0, ju.CostModel("line")
        )

        @jax.jit
        def cost(higher_m, scale_m):
            params = ju.grad.SoftParams(ALTITUDE_M, sections={"toy": ToyParams(scale_m)})
            return soft.path_cost(
                soft.height_m + higher_m, params, ju.Weights(population=0.0, toy=2.0), visits
            )

        check_grads(cost, (0.0, 30.0), order=1, modes=["rev"], rtol=1e-5, eps=1e-4)
        assert jax.grad(cost)(0.0, 30.0) > 0


def test_a_scenario_has_its_section():
    class WithToy(ju.Scenario):
        toy: ToyParams = ToyParams()

    places = {
        "region": {"bounds": [-74.0, 40.75, -73.99, 40.76]},
        "buildings": {"source": "synthetic"},
    }
    scenario = WithToy.from_dict(places | {"toy": {"scale_m": 5.0}})
    assert scenario.map_params.sections["toy"] == ToyParams(5.0)
    assert WithToy.from_dict(places).weights.toy == 1.0
    with pytest.raises(InputError, match=r"unknown key 'toy.scale' .*'scale_m'"):
        WithToy.from_dict(places | {"toy": {"scale": 5.0}})


def test_weights_name_every_metric_of_the_registry():
    assert ju.Weights(toy=2.0).to_dict() == {
        "distance": 0.1,
        **dict.fromkeys(METRICS, 1.0),
        "toy": 2.0,
    }
    assert [*ju.Weights(shade=1.0).to_dict()] == ["distance", *METRICS, "shade"]
