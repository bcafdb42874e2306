"""What a comparison writes: files that others open, figures on one scale around zero, and a folder of its own."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray as xr
from matplotlib.colors import Normalize
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.report.figures.map_comparison import _colours, comparison_figures, plot_changed_routes, plot_difference
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps
from tests.studies.test_map_comparison import changed_from


@pytest.fixture(scope="module")
def found():
    a = made_maps()
    a.ds["roof"].attrs["units"] = "m"
    return ju.compare(a, changed_from(a), routes=8, progress=False)


@pytest.mark.slow
def test_the_folder_holds_report_tables_maps_and_figures(found, tmp_path):
    ju.save_comparison(found, tmp_path / "ab")
    report = (tmp_path / "ab/report.md").read_text(encoding="utf-8")
    for name in comparison_figures(found):
        assert f"figures/{name}.png" in report
        assert (tmp_path / f"ab/figures/{name}.png").stat().st_size > 5000
    table = pd.read_csv(tmp_path / "ab/tables/layers.csv")
    assert len(table) == len(pd.read_parquet(tmp_path / "ab/tables/layers.parquet")) == len(found.table)
    routes = pd.read_parquet(tmp_path / "ab/tables/routes.parquet")
    np.testing.assert_array_equal(routes.regret, found.routes.table.regret)
    for row in found.table.query("layer == 'obstacle' and stratum == 'all'").itertuples():
        assert f"| {row.gained:,} | {row.lost:,} |" in report
    with pytest.raises(ju.InputError, match="holds another run") as refused:
        ju.save_comparison(ju.compare(found.b, found.a, routes=3, progress=False), tmp_path / "ab")
    assert len(str(refused.value)) < 600
    assert "normalised by different numbers" not in report
    b = ju.MetricMaps(found.b.ds.assign_attrs(pop_norm_per_km2=[123.0, 4e4]))
    a = ju.MetricMaps(found.a.ds.assign_attrs(pop_norm_per_km2=[5e4, 4e4]))
    ju.save_comparison(ju.compare(a, b, progress=False), tmp_path / "norms")
    report = (tmp_path / "norms/report.md").read_text(encoding="utf-8")
    assert f"normalised by different numbers, in A and B 50,000 and 123 at {a.times_of_day[0]}**" in report


def test_difference_maps_open_elsewhere_north_up_with_band_names(found, tmp_path):
    ju.save_comparison(found, tmp_path)
    with rasterio.open(tmp_path / "difference/risk_10m.tif") as file:
        assert file.descriptions == ("20 m", "60 m")
        assert file.crs.to_epsg() == 32618
        assert file.tags()["difference"] == "B - A"
        np.testing.assert_array_equal(file.read(2)[::-1], found.of("risk", 60.0))
        x_m, y_m = file.xy(0, 0)
        assert (x_m, y_m) == (found.grid.x_m[0], found.grid.y_m[-1])
    with rasterio.open(tmp_path / "difference/population_10m.tif") as file:
        assert file.descriptions == ("day", "night")


def test_one_scale_is_centred_at_zero_and_says_its_unit(found):
    maps = [found.of("risk", z) for z in found.a.altitudes_m]
    colours = _colours(found, "risk", maps)
    assert isinstance(colours.norm, Normalize)
    assert colours.norm.vmin == -colours.norm.vmax
    assert colours.norm(0.0) == 0.5
    figure = plot_difference(found, "roof")
    labels = [" ".join(axes.get_ylabel().split()) for axes in figure.axes]
    assert "m, B - A (red: B is higher)" in labels
    panels = [axes for axes in plot_difference(found, "gps").axes if axes.get_title(loc="left")]
    assert len(panels) == 2
    with pytest.raises(ju.InputError, match="gps"):
        plot_difference(found, "gsp")


@pytest.mark.slow
def test_the_command_compares_folders_and_names_the_settings_that_differ(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "[region]\nbounds = [-74.02, 40.70, -74.0, 40.715]\nresolution_m = 25.0\naltitudes_m = [60]\n"
    text += '[buildings]\nsource = "synthetic"\n[population]\ntime_of_day = ["day"]\n'
    for name, range_m in (("a", 100.0), ("b", 60.0)):
        (tmp_path / f"{name}.toml").write_text(f"{text}[lidar]\nrange_m = {range_m}\n", encoding="utf-8")
        assert run(capsys, "maps", f"{name}.toml", "-o", name)[0] == 0
    code, _, err = run(capsys, "compare", "a", "b", "-o", "ab", "--routes", "3", "--cost-model", "line")
    assert code == 0, err
    report = (tmp_path / "ab/report.md").read_text(encoding="utf-8")
    assert "| `lidar.range_m` | `100.0` | `60.0` |" in report
    assert "The same in both: gps, population" in report
    table = pd.read_csv(tmp_path / "ab/tables/layers.csv").query("stratum == 'all'").set_index("layer")
    assert table.rms["lidar"] > 0
    assert table.rms.drop("lidar").max() == 0
    code, _, err = run(capsys, "compare", "a", "b", "-o", "ab2", "--routes", "-1")
    assert code == 2
    assert_one_sentence(err, "--routes '-1' must be how many to sample")
    code, _, err = run(capsys, "compare", "a", "b", "-o", "ab2", "--time", "2020")
    assert code == 2
    assert_one_sentence(err, "--time")


def test_maps_without_times_in_common_are_drawn(found):
    timeless = replace(found, part=replace(found.part, times={}))
    assert "A: A" in "\n".join(text.get_text() for text in plot_changed_routes(timeless).findobj(Text))


def test_legends_name_both_ends_of_a_route_and_what_is_blocked_where(found):
    names = {text.get_text() for text in plot_changed_routes(found).findobj(Text)}
    assert {"route on A", "route on B", "start", "goal", "blocked only in A", "blocked only in B"} <= names


def test_every_epoch_of_a_comparison_has_a_panel_and_times_of_b_are_told(found):
    times = np.array(["2020-04-27T16:00:00", "2020-04-27T19:00:00"], "datetime64[ns]")

    def at_both(maps, which):
        parts = [maps.ds.assign_coords(time=[time]) for time in which]
        return ju.MetricMaps(
            xr.concat(parts, "time", data_vars="minimal", coords="minimal", compat="override", join="outer")
        )

    later = times + np.timedelta64(1, "h")
    of_a, of_b = (np.datetime_as_string(each, "s") for each in (times, later))
    pairs = {f"{a}Z": f"{b}Z" for a, b in zip(of_a, of_b, strict=True)}
    both = ju.compare(at_both(found.a, times), at_both(found.b, later), times=pairs, routes=0, progress=False)
    figures = comparison_figures(both)
    assert "gps_epochs" in figures
    figure = figures["gps_epochs"]()
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.images]
    assert [title.split("  ·  ")[0] for title in titles] == [
        "04-27 16:00",
        "04-27 19:00",
    ]
    told = "\n".join(text.get_text() for text in figure.findobj(Text))
    assert "B's beside them: 2020-04-27 17:00 UTC, 2020-04-27 20:00 UTC" in told
    told = "\n".join(text.get_text() for text in figures["gps"]().findobj(Text))
    assert "2020-04-27 16:00 UTC (epoch 1 of 2)" in told
    assert "2020-04-27 17:00 UTC (epoch 1 of 2)" in told
