"""Protection levels in whole maps, files, paths and pictures: made where asked for, with what they leave out told."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.maps.build import compute_maps, inputs_of, view_sky
from jaxurban.maps.differentiable import soften
from jaxurban.maps.params import MapParams
from jaxurban.maps.provenance import settings_of
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.protection import CAVEAT, IntegritySupport, Protection
from jaxurban.paths.constraints import Bound
from jaxurban.planners.base import Status
from jaxurban.plot import plot_metric
from tests.cli_runs import TOWN, assert_one_sentence, run

ALTITUDE_M, TIMES = 20.0, [f"2020-04-27T{hour:02d}:30:00Z" for hour in (0, 6, 12)]
ASKED = {"protection": Protection()}
STATISTICS = ("protection_availability", "protection_median", "protection_p05")


def task_of(sections=ASKED, times=TIMES[:1]) -> MapTask:
    city = replace(ju.demo_city(600, 600), blocks=None)
    x_min, y_min, _, _ = city.extent_m
    region = ju.Grid(city.crs, 10.0, round(y_min / 10) + 15, round(x_min / 10) + 15, 24, 28)
    sky = view_sky(region, ju.Gps(times=times))
    return MapTask(city, region, sky, MapParams(altitudes_m=(ALTITUDE_M,), sections=sections))


@pytest.fixture(scope="module")
def maps():
    return compute_maps(task_of())


def ends_of(maps, altitude_m):
    """Return the first and the last cell of the largest region within the horizontal alert limit."""
    parts, _ = label(maps.is_free(altitude_m) & (maps.m("hpl", altitude_m) <= 40))
    largest = np.argwhere(parts == np.bincount(parts[parts > 0]).argmax())
    return tuple(tuple(map(float, maps.grid.lonlat_of_cell(*largest[at]))) for at in (0, -1))


def test_maps_hold_it_where_somebody_asks(maps):
    assert [*maps.metrics] == ["gps", "lidar", "risk", "protection"]
    assert "protection" not in task_of({}).metrics
    hpl_m, is_free = maps.m("hpl", ALTITUDE_M), maps.m("obstacle", ALTITUDE_M) == 0
    assert np.isinf(hpl_m[is_free & (maps.m("num_visible", ALTITUDE_M) < 4)]).all()
    np.testing.assert_allclose(
        maps.m("protection", ALTITUDE_M), 1 - np.minimum(hpl_m, 40) / 40, atol=1e-6
    )
    for name in ("protection", "hpl", "vpl", "within_limits"):
        assert maps.ds[name].attrs["comment"] == CAVEAT
    assert maps.ds["hpl"].attrs["units"] == maps.ds["vpl"].attrs["units"] == "m"
    assert "comment" not in maps.ds["gps"].attrs
    assert maps.ds.attrs["vertical_alert_limit_m"] == 35.0


def test_a_series_keeps_the_share_of_times_within_both_limits():
    each = compute_maps(task_of(times=TIMES))
    series = compute_maps(task_of({**ASKED, "gps": Gps(series="statistics")}, TIMES))
    assert {*STATISTICS} < {*series.ds}
    assert "hpl" not in series.ds
    shares = each.ds["within_limits"].mean("time").where(each.ds["obstacle"] == 0)
    np.testing.assert_allclose(series.ds["protection_availability"], shares, atol=1e-6)
    np.testing.assert_allclose(
        series.m("protection"), each.ds["protection"].median("time")[0], atol=1e-6
    )
    assert 0 < float(shares.mean()) < 1
    assert series.ds["protection_availability"].attrs["comment"] == CAVEAT
    for bound in ("hpl<=40", "hdop<=3"):
        with pytest.raises(InputError, match="on a map that these maps do not hold"):
            Bound.parse(bound).is_kept(series, ALTITUDE_M)
    with pytest.raises(InputError, match="hold Protection statistics over 3 epochs"):
        series.m("protection", time=TIMES[0])
    assert "at every epoch" in texts_of(plot_metric(series, STATISTICS[0]))


def test_files_tell_what_it_leaves_out(maps, tmp_path):
    folder = maps.save(tmp_path, layers=("hpl",))
    with rasterio.open(folder / "geotiff" / "hpl_20m_10m.tif") as file:
        assert (file.units, file.tags()["comment"]) == (("m",), CAVEAT)


def test_a_path_keeps_a_bound_on_it_and_its_note_tells(maps):
    ends, limits = ends_of(maps, ALTITUDE_M), ju.Constraints.read(require="hpl<=40")
    path = ju.plan(
        maps, *ends, altitude_m=ALTITUDE_M, constraints=limits, weights={"protection": 0.0}
    )
    assert path.status is Status.OPTIMAL
    assert CAVEAT in path.search.note
    col, row = ((path.xy_m - maps.grid.bounds_m[:2]) // maps.grid.resolution_m).astype(int).T
    assert (maps.m("hpl", ALTITUDE_M)[row, col] <= 40).all()
    weighed = ju.plan(maps, *ends, altitude_m=ALTITUDE_M, weights={"protection": 2.0})
    assert CAVEAT in weighed.search.note
    assert weighed.cost_by_layer["protection"] > 0
    assert (
        CAVEAT
        not in ju.plan(maps, *ends, altitude_m=ALTITUDE_M, weights={"protection": 0.0}).search.note
    )


def test_maps_without_it_refuse_its_weight(maps):
    ends = ends_of(maps, ALTITUDE_M)
    without = ju.MetricMaps(maps.ds.drop_vars(["protection", "hpl", "vpl", "within_limits"]))
    with pytest.raises(ju.InputError, match="weights name protection, of which these maps hold no"):
        ju.plan(without, *ends, altitude_m=ALTITUDE_M, weights={"protection": 2.0})
    assert "protection" not in ju.plan(without, *ends, altitude_m=ALTITUDE_M).search.note


def texts_of(figure: Figure) -> str:
    """Return all texts of a picture, those of colour bars and keys too, in one line."""
    return " ".join(" ".join(text.get_text() for text in figure.findobj(Text)).split())


@pytest.mark.parametrize(
    ("name", "words"),
    [("hpl", "HPL in metres"), ("vpl", "35 m"), ("within_limits", "VPL up to 35")],
)
def test_pictures_have_units_limits_and_the_caveat(maps, name, words):
    figure = plot_metric(maps, name)
    assert words in texts_of(figure)
    assert "no integrity" in texts_of(figure)
    # Yes and no are a key.
    assert any(hasattr(axes, "_colorbar") for axes in figure.findobj(Axes)) == (
        name != "within_limits"
    )


def test_what_has_no_gradient_says_so():
    with pytest.raises(InputError, match="the maps as one function hold no protection"):
        inputs_of(task_of())
    soft = soften(task_of())
    assert "protection" not in soft.names
    with pytest.raises(InputError, match="protection"):
        soft.layer("protection", soft.height_m, ju.grad.SoftParams(altitude_m=ALTITUDE_M))


def test_a_file_of_integrity_support_is_read_beside_the_scenario_and_kept_as_values(tmp_path):
    isd = IntegritySupport(sigma_ura_m=2.4, tolerance_m=(0.1, 0.01))
    lines = [f"{name} = {value}" for name, value in vars(isd).items() if name != "tolerance_m"]
    (tmp_path / "isd.toml").write_text("\n".join([*lines, "tolerance_m = [0.1, 0.01]"]))
    (tmp_path / "scenario.toml").write_text(TOWN + "[protection]\nisd = 'isd.toml'")
    scenario = ju.Scenario.from_toml(tmp_path / "scenario.toml")
    assert scenario.protection == Protection(isd=tmp_path / "isd.toml") == Protection(isd=isd)
    assert settings_of(scenario)["protection"]["isd"]["sigma_ura_m"] == 2.4
    (tmp_path / "again.toml").write_text(scenario.to_toml())
    assert ju.Scenario.from_toml(tmp_path / "again.toml").protection.isd == isd

    text = "\n".join(lines)
    for wrong, words in (
        (text, "lacks tolerance_m"),
        (f"{text}\np_satt = 1e-5", "did you mean 'p_sat'"),
        ("p_sat = ", "cannot be read as integrity support data in TOML"),
        (None, "does not exist"),
    ):
        (tmp_path / "isd.toml").unlink()
        if wrong is not None:
            (tmp_path / "isd.toml").write_text(wrong)
        with pytest.raises(InputError, match=words):
            ju.Scenario.from_toml(tmp_path / "scenario.toml")
        (tmp_path / "isd.toml").touch()


@pytest.mark.slow
def test_the_commands_make_it_and_plan_under_a_bound_on_it(tmp_path, capsys):
    (tmp_path / "scenario.toml").write_text(TOWN + "[protection]")
    code, _, err = run(capsys, "maps", tmp_path / "scenario.toml", "-o", tmp_path / "maps")
    assert code == 0, err
    start, goal = (f"{lon},{lat}" for lon, lat in ends_of(ju.open_maps(tmp_path / "maps"), 60.0))
    command = (
        "plan",
        tmp_path / "maps",
        "--start",
        start,
        "--goal",
        goal,
        "--altitude",
        60,
        "--require",
    )
    code, out, err = run(capsys, *command, "hpl<=40", "--require", "vpl<=1000")
    assert code == 0, err
    assert "no integrity" in " ".join((out + err).split())
    code, _, err = run(capsys, *command, "hlp<=40")
    assert code == 2
    assert_one_sentence(err, "did you mean 'hpl'")
