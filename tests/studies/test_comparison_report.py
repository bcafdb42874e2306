"""What a comparison writes: files that others open, figures on one scale around zero, and a folder of its own."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.draw.style import difference_colours
from jaxurban.studies.reports.map_comparison import comparison_report, plot_difference
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.studies.test_map_comparison import changed_from

pytestmark = pytest.mark.usefixtures("without_layout")


@pytest.fixture(scope="module")
def found():
    a = made_maps()
    a.ds["roof"].attrs["units"] = "m"
    return ju.studies.compare(a, changed_from(a), progress=False)


def figures_of(result) -> list[str]:
    return [f"figures/{name}.png" for name in comparison_report(result).figures]


@pytest.fixture(scope="module")
def saved(found, tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared") / "ab"
    found.save(folder)
    return folder


@pytest.mark.slow
def test_the_folder_holds_report_tables_maps_and_figures(found, saved):
    report = (saved / "report.md").read_text(encoding="utf-8")
    for name in figures_of(found):
        assert name in report
        assert (saved / name).stat().st_size > 5000
    table = pd.read_csv(saved / "tables/layers.csv")
    assert len(table) == len(pd.read_parquet(saved / "tables/layers.parquet")) == len(found.table)
    for row in found.table.query("layer == 'obstacle'").itertuples():
        assert f"| {row.higher} | {row.lower} | 0 | 0 |" in report
    first, second, third = report.split("\n\n")[1].splitlines()
    assert first.startswith("- **Decided**: B ")
    assert second.startswith("- **Not decided**: whether routes change")
    assert third == "- **Next**: `ju.studies.compare(A, B, routes=40)`"
    assert "e-0" not in report
    with pytest.raises(ju.InputError, match="holds another run") as refused:
        ju.studies.compare(found.b, found.a, progress=False).save(saved)
    assert len(str(refused.value)) < 600
    assert report.count("© a made city") == 1


def test_one_scale_is_centred_at_zero_and_says_its_unit(found):
    colours = difference_colours(np.array([0.02, 0.1, np.inf]), "label")
    assert colours.norm.vmax == pytest.approx(np.quantile([0.02, 0.1], 0.99), rel=0.05)  # round
    assert colours.extend == "both"
    assert colours.norm.vmin == -colours.norm.vmax
    assert colours.norm(0.0) == 0.5
    figure = plot_difference(found, "roof")
    labels = [" ".join(axes.get_xlabel().split()) for axes in figure.axes]
    assert "roof [m], B - A (red: B is higher)" in labels
    panels = [axes for axes in plot_difference(found, "gps").axes if axes.get_title(loc="left")]
    assert len(panels) == 2
    with pytest.raises(ju.InputError, match="gps"):
        plot_difference(found, "gsp")


@pytest.mark.slow
def test_the_command_compares_folders_and_names_the_settings_that_differ(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    text = "[region]\nbounds = [-74.02, 40.70, -74.0, 40.715]\nresolution_m = 25.0\naltitudes_m = [60]\n"
    text += '[buildings]\nsource = "synthetic"\n[population]\ntime_of_day = ["day"]\n'
    for name, range_m in (("a", 100.0), ("b", 60.0)):
        (tmp_path / f"{name}.toml").write_text(
            f"{text}[lidar]\nrange_m = {range_m}\n", encoding="utf-8"
        )
        assert run(capsys, "maps", f"{name}.toml", "-o", name)[0] == 0
    code, _, err = run(capsys, "compare", "a", "b", "-o", "ab")
    assert code == 0, err
    report = (tmp_path / "ab/report.md").read_text(encoding="utf-8")
    assert "- lidar.range_m: 100.0 in A, 60.0 in B" in report
    assert "lidar.range_m 60.0 instead of 100.0 changes m_lidar by -" in report
    table = pd.read_csv(tmp_path / "ab/tables/layers.csv").set_index("layer")
    assert table.rms["lidar"] > 0
    assert table.rms.drop("lidar").max() == 0


def test_a_report_of_the_same_maps_says_why_it_shows_no_picture(found):
    same = ju.studies.compare(found.a, found.a, progress=False)
    assert "## Figures\n\nNone: no layer differs." in comparison_report(same).text


def said_in(figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def test_the_legend_names_what_is_blocked(found):
    for layer in ("obstacle", "gps"):
        assert "blocked in A or B" in said_in(plot_difference(found, layer)).splitlines()


def test_a_figure_names_the_time_of_both(found):
    hours = {f"2020-04-27T{hour}:00": maps for hour, maps in ((19, found.a), (20, found.b))}
    a, b = (
        ju.MetricMaps(maps.ds.assign_coords(time=np.array([time], "datetime64[ns]")))
        for time, maps in hours.items()
    )
    both = ju.studies.compare(a, b, progress=False)
    shown = said_in(plot_difference(both, "gps"))
    assert all(f"2020-04-27 {hour}:00 UTC" in shown for hour in (19, 20))
    assert "figures/gps.png" in figures_of(both)
