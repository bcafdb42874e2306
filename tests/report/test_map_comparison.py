"""What a comparison writes: files that others open, figures on one scale around zero, and a folder of its own."""

import numpy as np
import pandas as pd
import pytest
import rasterio
from matplotlib.colors import Normalize
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.report.map_comparison import comparison_figures, comparison_markdown, difference_colours, plot_difference
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.studies.test_map_comparison import changed_from


@pytest.fixture(scope="module")
def found():
    a = made_maps()
    a.ds["roof"].attrs["units"] = "m"
    return ju.studies.compare(a, changed_from(a), progress=False)


@pytest.mark.slow
def test_the_folder_holds_report_tables_maps_and_figures(found, tmp_path):
    found.save(tmp_path / "ab")
    report = (tmp_path / "ab/report.md").read_text(encoding="utf-8")
    for name in comparison_figures(found):
        assert f"figures/{name}.png" in report
        assert (tmp_path / f"ab/figures/{name}.png").stat().st_size > 5000
    table = pd.read_csv(tmp_path / "ab/tables/layers.csv")
    assert len(table) == len(pd.read_parquet(tmp_path / "ab/tables/layers.parquet")) == len(found.table)
    for row in found.table.query("layer == 'obstacle'").itertuples():
        assert f"| {row.gained} | {row.lost} |" in report
    with pytest.raises(ju.InputError, match="holds another run") as refused:
        ju.studies.compare(found.b, found.a, progress=False).save(tmp_path / "ab")
    assert len(str(refused.value)) < 600
    assert report.count("© a made city") == 1
    assert "population is divided by" not in report
    b = ju.MetricMaps(found.b.ds.assign_attrs(pop_norm_per_km2=[123.0, 4e4]))
    a = ju.MetricMaps(found.a.ds.assign_attrs(pop_norm_per_km2=[5e4, 4e4]))
    ju.studies.compare(a, b, progress=False).save(tmp_path / "norms")
    report = (tmp_path / "norms/report.md").read_text(encoding="utf-8")
    assert f"| population is divided by, {a.times_of_day[0]} | `50,000` | `123` |" in report


def test_difference_maps_open_elsewhere_north_up_with_band_names(found, tmp_path):
    found.save(tmp_path)
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
    colours = difference_colours(np.array([0.02, 0.1, np.inf]), "label")
    assert colours.norm.vmax == pytest.approx(np.quantile([0.02, 0.1], 0.99))
    assert colours.extend == "both"
    assert isinstance(colours.norm, Normalize)
    assert colours.norm.vmin == -colours.norm.vmax
    assert colours.norm(0.0) == 0.5
    figure = plot_difference(found, "roof")
    labels = [" ".join(axes.get_ylabel().split()) for axes in figure.axes]
    assert "roof [m], B - A (red: B is higher)" in labels
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
    code, _, err = run(capsys, "compare", "a", "b", "-o", "ab")
    assert code == 0, err
    report = (tmp_path / "ab/report.md").read_text(encoding="utf-8")
    assert "| `lidar.range_m` | `100.0` | `60.0` |" in report
    assert "The same in both: obstacle, closed, gps, population" in report
    table = pd.read_csv(tmp_path / "ab/tables/layers.csv").set_index("layer")
    assert table.rms["lidar"] > 0
    assert table.rms.drop("lidar").max() == 0


def test_a_report_of_the_same_maps_says_why_it_shows_no_picture(found):
    same = ju.studies.compare(found.a, found.a, progress=False)
    assert "## Figures\n\nNone: a layer is drawn where it differs." in comparison_markdown(same, [])


def test_the_legend_names_what_is_blocked_where(found):
    for layer, words in (("closed", "blocked in A and B"), ("gps", "blocked in A or B")):
        assert words in {text.get_text() for text in plot_difference(found, layer).findobj(Text)}


def test_a_figure_names_the_time_of_both(found):
    a, b = (
        ju.MetricMaps(maps.ds.assign_coords(time=np.array([time], "datetime64[ns]")))
        for maps, time in ((found.a, "2020-04-27T19:00:00"), (found.b, "2020-04-27T20:00:00"))
    )
    both = ju.studies.compare(a, b, progress=False)
    shown = "\n".join(text.get_text() for text in plot_difference(both, "gps").findobj(Text))
    assert "2020-04-27 19:00 UTC" in shown
    assert "2020-04-27 20:00 UTC" in shown
    assert "gps" in comparison_figures(both)
