"""Protection levels in whole maps, files, paths and pictures: made where asked for, with what they leave out told."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import open_zarr
from jaxurban.maps.build import compute_maps, inputs_of, view_sky
from jaxurban.maps.differentiable import soften
from jaxurban.maps.run import Maker, make_zarr
from jaxurban.maps.scenario import Scenario
from jaxurban.maps.task import MapParams, MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.protection import CAVEAT, Protection
from jaxurban.metrics.registry import METRICS
from jaxurban.paths.constraints import Bound
from jaxurban.planners.base import Status
from jaxurban.progress import Report
from jaxurban.report.figures import plot_metric
from tests import tiled_runs
from tests.cli_runs import assert_one_sentence, run

ALTITUDE_M, TIMES = 20.0, [f"2020-04-27T{hour:02d}:30:00Z" for hour in (0, 6, 12)]
ASKED = {"protection": Protection()}
MINIMAL = {"region": {"bounds": [-74.02, 40.70, -73.98, 40.73]}, "buildings": {"source": "synthetic"}}
STATISTICS = ("protection_availability", "protection_median", "protection_p05")


def task_of(sections=ASKED, times=TIMES[:1]) -> MapTask:
    city = replace(ju.demo_city(600, 600), blocks=None)
    x_min, y_min, _, _ = city.extent_m
    region = ju.Grid(city.crs, 10.0, round(y_min / 10) + 15, round(x_min / 10) + 15, 24, 28)
    sky = view_sky(region, ju.Gps(times=times))
    return MapTask(city, region, sky, MapParams(altitudes_m=(ALTITUDE_M,), sections=sections))


@contextmanager
def only_quick():
    """Leave out the metrics that take seconds to compile."""
    known = dict(METRICS)
    for name in ("lidar", "risk"):
        del METRICS[name]
    yield
    METRICS.clear()
    METRICS.update(known)  # in their order


@pytest.fixture(scope="module")
def maps():
    with only_quick():
        return compute_maps(task_of())


def ends_of(maps, altitude_m):
    """Return the first and the last cell of the largest region within the horizontal alert limit."""
    parts, _ = label(maps.is_free(altitude_m) & (maps.m("hpl", altitude_m) <= 40))
    largest = np.argwhere(parts == np.bincount(parts[parts > 0]).argmax())
    return tuple(tuple(map(float, maps.grid.lonlat_of_cell(*largest[at]))) for at in (0, -1))


@pytest.fixture(scope="module")
def ends(maps):
    return ends_of(maps, ALTITUDE_M)


def test_maps_hold_it_where_somebody_asks(maps):
    assert [*maps.metrics] == ["gps", "protection"]
    assert "protection" not in task_of({}).metrics
    hpl_m, is_free = maps.m("hpl", ALTITUDE_M), maps.m("obstacle", ALTITUDE_M) == 0
    assert np.isinf(hpl_m[is_free & (maps.m("num_visible", ALTITUDE_M) < 4)]).all()
    np.testing.assert_allclose(maps.m("protection", ALTITUDE_M), 1 - np.minimum(hpl_m, 40) / 40, atol=1e-6)
    for name in ("protection", "hpl", "vpl", "within_limits"):
        assert maps.ds[name].attrs["comment"] == CAVEAT
    assert maps.ds["hpl"].attrs["units"] == maps.ds["vpl"].attrs["units"] == "m"
    assert "comment" not in maps.ds["gps"].attrs
    assert maps.ds.attrs["vertical_alert_limit_m"] == 35.0


def test_a_series_keeps_the_share_of_times_within_both_limits():
    with only_quick():
        each = compute_maps(task_of(times=TIMES))
        series = compute_maps(task_of({**ASKED, "gps": Gps(series="statistics")}, TIMES))
    assert {*STATISTICS} < {*series.ds}
    assert "hpl" not in series.ds
    shares = each.ds["within_limits"].mean("time").where(each.ds["obstacle"] == 0)
    np.testing.assert_allclose(series.ds["protection_availability"], shares, atol=1e-6)
    np.testing.assert_allclose(series.m("protection"), each.ds["protection"].median("time")[0], atol=1e-6)
    assert 0 < float(shares.mean()) < 1
    assert series.ds["protection_availability"].attrs["comment"] == CAVEAT
    for bound in ("hpl<=40", "hdop<=3"):
        with pytest.raises(InputError, match="on a map that these maps do not hold"):
            Bound.parse(bound).is_kept(series, ALTITUDE_M)
    with pytest.raises(InputError, match="hold Protection statistics over 3 epochs"):
        series.m("protection", time=TIMES[0])
    labels = [axes.get_ylabel() for axes in plot_metric(series, STATISTICS[0]).axes]
    assert "at every epoch" in " ".join(" ".join(labels).split())


@pytest.mark.slow
@pytest.mark.parametrize("series", ["epochs", "statistics"])
def test_tiles_equal_the_whole(tmp_path, series):
    made = tiled_runs.task(tiled_runs.city(), series)
    wide = Protection(1e4, 1e4, p_const_gps=0.0)  # of the few satellites of that sky
    task = replace(made, params=replace(made.params, sections={**made.params.sections, "protection": wide}))
    with only_quick():
        whole = compute_maps(task).ds
        make_zarr(Maker(task, tmp_path / "tiled", "key", 1, None), Report(), (16, 16))
    names = ("protection", "hpl", "vpl", "within_limits") if series == "epochs" else STATISTICS
    with open_zarr(tmp_path / "tiled", tiled_runs.RESOLUTION_M) as tiled:
        for name in names:
            np.testing.assert_array_equal(tiled[name], whole[name])
            assert len(np.unique(whole[name])) > 1


def test_files_tell_what_it_leaves_out(maps, tmp_path):
    folder = maps.save(tmp_path, layers=("hpl",))
    with rasterio.open(folder / "geotiff" / "hpl_20m_10m.tif") as file:
        assert file.units == ("m",)
        assert file.tags()["comment"] == CAVEAT
        is_obstacle = maps.m("obstacle", ALTITUDE_M)[::-1] == 1
        np.testing.assert_array_equal(np.isnan(file.read(1)), is_obstacle)
    again = ju.open_maps(folder)
    assert again.ds["vpl"].attrs["comment"] == CAVEAT
    assert [*again.metrics] == [*maps.metrics]
    assert (folder / "geotiff" / "protection_10m.qml").exists()


def test_a_path_keeps_a_bound_on_it_and_its_note_tells(maps, ends):
    limits = ju.Constraints.read(require="hpl<=40")
    path = ju.plan(maps, *ends, altitude_m=ALTITUDE_M, constraints=limits, weights={"protection": 0.0})
    assert path.status is Status.OPTIMAL
    assert CAVEAT in path.search.note
    first_m = maps.grid.x_min_m, maps.grid.y_min_m
    col, row = ((path.xy_m - first_m) // maps.grid.resolution_m).astype(int).T
    assert (maps.m("hpl", ALTITUDE_M)[row, col] <= 40).all()
    weighed = ju.plan(maps, *ends, altitude_m=ALTITUDE_M, weights={"protection": 2.0})
    assert CAVEAT in weighed.search.note
    assert weighed.cost_by_layer["protection"] > 0
    assert CAVEAT not in ju.plan(maps, *ends, altitude_m=ALTITUDE_M, weights={"protection": 0.0}).search.note


def test_maps_without_it_refuse_a_bound_on_it_and_say_that_its_weight_is_ignored(maps, ends):
    without = ju.MetricMaps(maps.ds.drop_vars(["protection", "hpl", "vpl", "within_limits"]))
    limits = ju.Constraints.read(require="hpl<=40")
    with pytest.raises(InputError, match="on a map that these maps do not hold"):
        ju.plan(without, *ends, altitude_m=ALTITUDE_M, constraints=limits)
    path = ju.plan(without, *ends, altitude_m=ALTITUDE_M, weights={"protection": 2.0})
    assert "These maps hold no lidar and no population and no risk and no protection" in path.search.note
    assert "protection" not in ju.plan(without, *ends, altitude_m=ALTITUDE_M).search.note


@pytest.mark.parametrize(
    ("name", "words"), [("hpl", "HPL in metres"), ("vpl", "35 m"), ("within_limits", "VPL up to 35")]
)
def test_pictures_have_units_limits_and_the_caveat(maps, name, words):
    figure = plot_metric(maps, name)
    entries = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert words in str([*entries, *(axes.get_ylabel() for axes in figure.axes)])
    assert "no integrity" in " ".join(" ".join(text.get_text() for text in figure.texts).split())
    assert any(hasattr(axes, "_colorbar") for axes in figure.axes) == (name != "within_limits")  # yes and no are a key


def test_a_section_or_a_weight_asks_for_it():
    assert Scenario.from_dict(MINIMAL).protection is None
    assert "protection" not in Scenario.from_dict(MINIMAL).model_dump()
    section = Scenario.from_dict(MINIMAL | {"protection": {"horizontal_alert_limit_m": 25}})
    assert section.protection == Protection(horizontal_alert_limit_m=25.0)
    weighed = Scenario.from_dict(MINIMAL | {"weights": {"protection": 1}})
    assert weighed.map_params.sections["protection"] == Protection()
    assert "[protection]" in weighed.to_toml()
    assert Scenario.from_dict(MINIMAL | {"weights": {"protection": 0}}).protection is None
    with pytest.raises(InputError, match=r"protection.*p_sat must be a probability"):
        Scenario.from_dict(MINIMAL | {"protection": {"p_sat": 2}})


def test_what_has_no_gradient_says_so():
    with pytest.raises(InputError, match="the maps as one function hold no protection"):
        inputs_of(task_of())
    soft = soften(task_of())
    assert "protection" not in soft.names
    with pytest.raises(InputError, match="protection"):
        soft.layer("protection", soft.height_m, ju.grad.SoftParams(altitude_m=ALTITUDE_M))


SCENARIO = """
[region]
bounds = [-74.0, 40.755, -73.99, 40.765]
resolution_m = 20
altitudes_m = [60]
[buildings]
source = "synthetic"
[lidar]
beams = 2
azimuths = 8
range_m = 40
[protection]
"""


@pytest.mark.slow
def test_the_commands_make_it_and_plan_under_a_bound_on_it(tmp_path, capsys):
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    code, _, err = run(capsys, "maps", tmp_path / "scenario.toml", "-o", tmp_path / "maps")
    assert code == 0, err
    start, goal = (f"{lon},{lat}" for lon, lat in ends_of(ju.open_maps(tmp_path / "maps"), 60.0))
    ends = ("--start", start, "--goal", goal, "--altitude", 60)
    code, out, err = run(capsys, "plan", tmp_path / "maps", *ends, "--require", "hpl<=40", "--require", "vpl<=1000")
    assert code == 0, err
    assert "no integrity" in " ".join((out + err).split())
    code, _, err = run(capsys, "plan", tmp_path / "maps", *ends, "--require", "hlp<=40")
    assert code == 2
    assert_one_sentence(err, "did you mean 'hpl'")
