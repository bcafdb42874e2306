"""A later release adds a metric `noise`: whoever has a layer `noise` keeps it, in maps, weights, files and commands."""

import json
import pickle
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
import xarray as xr

import jaxurban as ju
from jaxurban.io.read.rasterise import bands_of
from jaxurban.maps import scenario as settings
from jaxurban.maps.build import compute_maps
from jaxurban.maps.differentiable import soften
from jaxurban.maps.params import MapParams
from jaxurban.maps.run import tasks_of
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import ALTITUDE, Metric, Variable, high_is_bad
from jaxurban.metrics.custom import (
    DERIVED,
    OF_RELEASE_1,
    RESERVED_NAMES,
    held_variables,
    known_beside,
)
from jaxurban.metrics.registry import METRICS, ON_REQUEST, known_metrics
from jaxurban.metrics.settings import differentiable
from jaxurban.metrics.variables import derived
from jaxurban.report.figures.paths import maps_figures
from jaxurban.settings import Heights
from jaxurban.studies.weights.changed_maps import parameters_of, with_parameter
from jaxurban.viewer.layers import layers_of
from tests import tiled_runs
from tests.cli_runs import ENDS, TOWN, run
from tests.maps.test_own_layers import write_layer

FLOWN_M = 60.0
OF_LAYER, OF_METRIC = 0.25, 0.5  # m everywhere
LONG = "metric_noise"


@differentiable("level_db")
@dataclass(frozen=True)
class Noise:
    """How loud a street is."""

    level_db: float = 50.0


def noise_maps(scene, params):
    level = np.full(scene.surface.region.shape, params.level_db, np.float32)
    return {"noise": level / 100, "noise_db": level}


def soft_noise(scene, params):
    level = jnp.full(scene.surface.region.shape, params.level_db / 100)
    return level if scene.cells is None else level[scene.cells[:, 0], scene.cells[:, 1]]


NOISE = Metric(
    name="noise",
    params=Noise,
    dims=(ALTITUDE,),
    compute=noise_maps,
    soft=soft_noise,
    cost=high_is_bad,
    label="Noise of streets",
    one_means="as loud as can be",
    colour="#123456",
    colour_map="cividis",
    also=(Variable("noise_db", "level of noise", "dB"),),
    recorded={"noise_level_db": "level_db"},
)


class NoisyScenario(ju.Scenario):
    """The scenario of the release that has the metric."""

    noise: Noise | None = None


@pytest.fixture(params=["METRICS", "ON_REQUEST"])
def registry(request, monkeypatch):
    """Release with the metric: made always, or on request."""
    monkeypatch.setattr(settings, "Scenario", NoisyScenario)
    return with_metric(monkeypatch, {"METRICS": METRICS, "ON_REQUEST": ON_REQUEST}[request.param])


def with_metric(monkeypatch, registry):
    """Put the metric into a registry, and into no other; return the registry."""
    for each in (METRICS, ON_REQUEST):
        monkeypatch.delitem(each, "noise", raising=False)
    monkeypatch.setitem(registry, "noise", NOISE)
    return registry


@pytest.fixture(scope="module")
def city():
    return tiled_runs.city()


def task_of(city, *names, heights=None, **sections):
    """Return a task with layers of some names, all of them 20 of 80 everywhere."""
    grid = tiled_runs.region(city)
    values = np.full(grid.shape, 80 * OF_LAYER)
    layers = {name: ju.Layer(values, "high-is-bad", (0.0, 80.0)) for name in names}
    params = MapParams((20.0, FLOWN_M), heights=heights or Heights(), sections=sections)
    sky = tiled_runs.sky()
    return MapTask(city, grid, sky, params, layers, bands_of(layers, grid, params.altitudes_m))


def check_both(maps):
    """Check that the short name means the layer in all of a dataset, and the long one the metric."""
    assert [*maps.metrics][-2:] == [LONG, "noise"]
    for name, m in (("noise", OF_LAYER), (LONG, OF_METRIC)):
        is_free = maps.is_free(FLOWN_M, "centre")
        np.testing.assert_allclose(maps.m(name, FLOWN_M)[is_free], m)
        np.testing.assert_allclose(maps.costs(FLOWN_M)[name][is_free], m)
    assert "layer" in maps.ds["noise"].attrs
    assert "layer" not in maps.ds[LONG].attrs
    assert maps.ds[LONG].attrs["long_name"] == "Noise of streets"
    assert np.nanmax(maps.m("noise_db", FLOWN_M)) == 50  # which no layer is called


def test_names_of_release_1_stay_reserved_and_no_other_metric_s_are():
    known = known_metrics()
    assert {name for metric in OF_RELEASE_1 for name in known[metric].variables} <= RESERVED_NAMES
    made = {name for kind in derived(METRICS["gps"]).values() for name in kind}
    assert made == {f"gps_{what}" for what in DERIVED} <= RESERVED_NAMES
    assert not {name for name in RESERVED_NAMES if "noise" in name}


def test_a_layer_keeps_the_short_name_and_the_metric_has_a_long_one_only_beside_it(registry, city):
    of_layer = compute_maps(task_of(city, "noise"))
    assert "noise" in of_layer.metrics
    np.testing.assert_allclose(of_layer.m("noise"), OF_LAYER)
    assert (LONG in of_layer.ds) is (registry is METRICS)
    of_metric = compute_maps(task_of(city, noise=Noise()))
    assert [*of_metric.metrics][-1] == "noise"
    assert LONG not in of_metric.ds
    assert np.nanmax(of_metric.m("noise", FLOWN_M)) == OF_METRIC
    check_both(compute_maps(task_of(city, "noise", noise=Noise())))


def test_any_name_of_a_map_of_the_metric_is_left_to_a_layer(registry, city):
    heights = Heights(height_samples=2)
    for name, long_names in (
        ("noise_db", {"noise", "metric_noise_db"}),
        ("noise_mean", {LONG, "metric_noise_mean", "noise_db"}),
    ):
        maps = compute_maps(task_of(city, name, heights=heights, noise=Noise()))
        assert long_names <= {*map(str, maps.ds.data_vars)}
        np.testing.assert_allclose(maps.m(name), OF_LAYER)
    names = [metric.name for metric in known_beside(["noise", LONG])]
    assert "metric_metric_noise" in names
    assert not {"noise", LONG} & {*names}


def test_it_goes_through_routes_files_and_workers(registry, city, tmp_path):
    maps = compute_maps(task_of(city, "noise", noise=Noise()))
    ends = [maps.grid.lonlat_of_cell(*cell) for cell in ((2, 2), (40, 30))]
    rules = {"altitude_m": FLOWN_M, "snap": True}
    path = ju.plan(maps, *ends, weights={"noise": 2, LONG: 3}, **rules)
    assert path.metrics["noise"] == pytest.approx(OF_LAYER)
    assert path.metrics[LONG] == pytest.approx(OF_METRIC)
    assert path.cost_by_layer[LONG] == pytest.approx(3 * path.cost_by_layer["noise"])
    report = ju.explain(path, maps)
    assert report.totals["cost_of_noise"] == pytest.approx(path.cost_by_layer["noise"])
    assert {"+noise", f"+{LONG}"} <= {*report.table().split()}
    table = ju.plan_many(maps, [ends], weights={"noise": 2}, progress=False, **rules).to_dataframe()
    assert table[f"cost_{LONG}"].item() == pytest.approx(table.cost_noise.item())
    folder = maps.save(tmp_path / "saved", layers=("all",))
    check_both(ju.open_maps(folder))
    assert xr.open_zarr(folder / "maps.zarr", group="20m").attrs["jaxurban_layout"] == 2
    for file, m in (("noise_20m.tif", OF_LAYER), (f"{LONG}_60m_20m.tif", OF_METRIC)):
        with rasterio.open(folder / "geotiff" / file) as tif:
            assert np.nanmax(tif.read(1)) == m
    shown = layers_of(maps)
    assert (
        shown[LONG].colours(maps.m(LONG, FLOWN_M)).label.startswith("$m_\\mathrm{metric\\_noise}$")
    )
    assert {"noise", f"cost:{LONG}"} <= {*shown}
    figures = maps_figures(maps, [path])
    assert {"noise", LONG} <= {*figures}
    assert ("noise_db" in figures) is (registry is ON_REQUEST)
    assert maps.metrics["noise"].colour != maps.metrics[LONG].colour
    made = pickle.loads(pickle.dumps(maps.metrics[LONG].compute))  # for workers
    assert made.args[1] == {"noise": LONG, "noise_db": "noise_db"}


def test_maps_made_before_the_metric_keep_their_layer(city, tmp_path, monkeypatch):
    with monkeypatch.context() as earlier:
        for registry in (METRICS, ON_REQUEST):
            earlier.delitem(registry, "noise", raising=False)
        folder = compute_maps(task_of(city, "noise")).save(tmp_path / "old")
    for registry in (METRICS, ON_REQUEST):
        with monkeypatch.context() as later:
            with_metric(later, registry)
            maps = ju.open_maps(folder)
            assert [*maps.metrics] == ["gps", "lidar", "population", "risk", "noise"]
            assert LONG not in maps.ds
            assert held_variables(maps.ds)["noise"].long_name == "noise"
            np.testing.assert_allclose(maps.costs(FLOWN_M)["noise"], OF_LAYER)


def test_settings_and_gradients_are_those_of_the_one_and_the_other(registry, city):
    task = task_of(city, "noise", noise=Noise(60.0))
    assert parameters_of(task)[f"{LONG}.level_db"] == 60.0
    twice = with_parameter(task, f"{LONG}.level_db", 1.5)
    assert twice.params.sections["noise"] == Noise(90.0)
    soft = soften(task)
    assert [name for name in soft.names if "noise" in name] == [LONG]

    def loudness(level_db):
        params = ju.grad.SoftParams(FLOWN_M, sections={"noise": Noise(level_db)})
        return soft.layer(LONG, soft.height_m, params, jnp.array([[3, 3]])).sum()

    assert jax.grad(loudness)(60.0) == pytest.approx(0.01)
    of_layer = soften(task_of(city, "noise"))
    assert (LONG in of_layer.names) is (registry is METRICS)


@pytest.mark.slow
def test_a_scenario_and_commands_name_both(registry, tmp_path, capsys):
    layer = '[layers.noise]\nsource = "noise.tif"\ncost = "high-is-bad"\nscale = [0, 80]\n'
    file, out = tmp_path / "town.toml", tmp_path / "out"
    file.write_text(TOWN + layer + "[weights]\nnoise = 2.0\n")
    of_layer = NoisyScenario.from_toml(file)
    assert of_layer.noise is None  # the weight is the layer's
    grid = ju.Grid.from_bounds(of_layer.region.bounds, 20.0, None)
    write_layer(tmp_path / "noise.tif", grid, np.full((40, 40), 80 * OF_LAYER))
    assert (LONG in tasks_of(of_layer)[0].metrics) is (registry is METRICS)
    file.write_text(file.read_text() + f"{LONG} = 3.0\n")
    assert NoisyScenario.from_toml(file).map_params.sections["noise"] == Noise()
    file.write_text(file.read_text() + "[noise]\nlevel_db = 50.0\n")
    assert run(capsys, "maps", file, "-o", out)[0] == 0
    maps = ju.open_maps(out)
    check_both(maps)
    assert maps.recorded["weights"] | {"noise": 2.0, LONG: 3.0} == maps.recorded["weights"]
    zarr = xr.open_zarr(out / "maps.zarr", group="20m")
    assert {"noise", LONG, "noise_db"} <= {*zarr.data_vars}
    asked = "--altitude", FLOWN_M, "--snap", "--weights", "noise=5", "--json"
    code, said, err = run(capsys, "plan", out, *ENDS, *asked, "--require", f"{LONG}<=0.9")
    assert code == 0, err
    costs = json.loads(said)["cost_by_layer"]
    assert costs[LONG] / costs["noise"] == pytest.approx(3 * OF_METRIC / (5 * OF_LAYER))


def test_a_layer_named_like_a_statistic_leaves_the_maps_of_release_1_their_names():
    layers = ["hdop_p95", "num_visible_std", "density_mean"]
    of_release_1 = [known_metrics()[name] for name in OF_RELEASE_1]
    beside = {metric.name: metric for metric in known_beside(layers)}
    assert [beside[metric.name] for metric in of_release_1] == of_release_1
