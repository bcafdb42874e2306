"""What a validation of a log with a row a satellite reports and draws: every number is one of its tables."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from figures import sky
from jaxurban.report.receiver import validation_markdown, validation_outputs
from jaxurban.report.satellites import MARGINS_M, satellite_figures
from jaxurban.studies.receiver.validate import ReceiverValidation
from tests.made_agreement import made
from tests.receiver_logs import found

pytestmark = pytest.mark.usefixtures("without_layout")


@pytest.fixture(scope="module")
def of_satellites() -> ReceiverValidation:
    return replace(found(), satellites=made())


def texts_of(figure: Figure) -> str:
    return " ".join(text.get_text() for text in figure.findobj(Text))


@pytest.mark.slow
def test_the_report_leads_with_the_verdict_and_counts_come_second(of_satellites):
    report = validation_markdown(of_satellites)
    order = ["**Maps and receiver agree.**", "## Satellite by satellite", "## What agrees"]
    assert [report.index(part) for part in order] == sorted(report.index(part) for part in order)
    assert report.startswith(f"# A receiver's log, compared with the maps\n\n{order[0]}\n")
    assert "nan" not in report


@pytest.mark.slow
def test_every_score_stands_in_the_report_with_its_interval(of_satellites):
    report = validation_markdown(of_satellites)
    assert (
        "| all judged | 342 | 0.957 | 0.842 (0.811 to 0.873) | 0.742 (0.711 to 0.773) | 6 |"
        in report
    )
    assert "| GLONASS | 342 | 0.957 | 0.847 (0.816 to 0.878) |" in report
    assert "| in its place | 0.842 | 0.742 |" in report
    assert "| most | 0.622 | 0.522 |" in report
    assert "| margin and elevation | 0.550 | 0.000 (-0.031 to 0.047) |" in report
    assert "| 2 | 0 | 5.7 | 1 (0.94 to 1.06) |" in report
    assert "11 rows are not judged: their rays leave" in report
    assert "E18 is left out: unhealthy." in report


@pytest.mark.slow
def test_what_is_unknown_is_no_number_of_the_report_and_is_drawn(of_satellites):
    unknown = {"auc": np.nan, "auc_low": np.nan, "auc_high": np.nan}
    parts = {
        name: getattr(made(), name).assign(auc=np.nan) for name in ("displaced", "field", "scales")
    }
    parts |= {"scores": made().scores.assign(**unknown), "peak": dict.fromkeys(made().peak, np.nan)}
    all_seen = replace(made(), rows=made().rows.assign(is_seen=True, margin_m=np.inf), **parts)
    assert "nan" not in validation_markdown(replace(of_satellites, satellites=all_seen))
    for draw in satellite_figures(of_satellites, all_seen).values():
        assert draw().axes


def test_the_report_says_how_this_log_was_judged(of_satellites):
    common = validation_markdown(of_satellites)
    assert "at 36.5 dBHz or more, this log's median, each" in common
    assert "Which rays are unknown is decided from place and direction alone" in common
    assert "one of 3 epochs" not in common
    assert "| 9 of 9 displaced ones that could be scored, median | 0.567 | 0.467 |" in common
    assert "| 100 | 6 | 0.010 (-0.030 to 0.050) |" in common
    assert "| 200 | 3 | 0.010 |" in common
    counts = made().counts | {"is_guarded": False, "is_median": False, "every": 3, "num_asked": 12}
    rivals = made().rivals.assign(gain=-0.0001)
    other = replace(made(), counts=counts, rivals=rivals, peak=dict.fromkeys(made().peak, np.nan))
    report = validation_markdown(replace(of_satellites, satellites=other))
    assert "11 rows are judged as if nothing stood beyond: their rays leave" in report
    assert "decided from place" not in report
    assert "at 36.5 dBHz or more, the weakest that was received" in report
    assert "take one of 3 epochs of this long log" in report
    assert "| 9 of 12 displaced ones that could be scored, median |" in report
    assert "| 0.000 (-0.031 to 0.047) |" in report
    assert "-0.000" not in report
    assert "None: that takes 8 blocks of track" in report


def test_satellites_whose_places_the_log_says_rest_on_no_orbits(of_satellites):
    logged = replace(
        found().log,
        epochs=found().log.epochs[["utc", "lon_deg", "lat_deg"]],
        satellites=made().rows,
    )
    report = validation_markdown(replace(of_satellites, log=logged))
    assert "Where satellites stand is what the log says" in report
    assert "satellites in view, mean (of rows that are judged)" in report
    assert "[gps] orbits only" not in report
    assert "[gps] orbits only" in validation_markdown(found())


def test_without_satellites_the_report_and_its_files_are_those_of_counts():
    outputs, _ = validation_outputs(found())
    assert [*outputs] == [
        "tables/pieces",
        "tables/scores",
        "tables/shifts",
        "figures/scatter.png",
        "report.md",
    ]
    assert "atellite by satellite" not in outputs["report.md"]


def test_two_logs_of_the_same_epochs_are_different_runs(of_satellites):
    one, other = (
        replace(
            of_satellites, log=replace(found().log, satellites=made().rows.assign(cn0_dbhz=value))
        )
        for value in (40.0, 41.0)
    )
    assert validation_outputs(one)[1] != validation_outputs(other)[1]


def test_every_picture_of_the_report_is_drawn_and_every_drawn_one_is_in_it(of_satellites):
    outputs, _ = validation_outputs(of_satellites)
    pictures = [name for name in outputs if name.endswith(".png")]
    assert sorted(pictures) == sorted(
        name for name in pictures if f"]({name})" in outputs["report.md"]
    )
    assert outputs["report.md"].count("](figures/") == len(pictures) == 5


@pytest.mark.usefixtures("laid_out")
def test_pictures_name_what_they_show_with_units(of_satellites):
    said = {
        name: texts_of(draw()) for name, draw in satellite_figures(of_satellites, made()).items()
    }
    for name, labels in {
        "track": ("east (m)", "north (m)", "share of satellites", "36.5 dBHz", "least agreement"),
        "margin": ("C/N0 (dBHz)", "not received", "(m)"),
        "displacement": ("city moved east (m)", "AUC", "the city in its place: 0.84", "9 cities"),
        "skies": ("buildings", "hidden by a building", "in view", "E03", "most agreement"),
    }.items():
        assert [label for label in labels if label not in said[name]] == []


def test_boxes_stand_on_the_side_of_the_edge_that_the_map_says(of_satellites):
    judged = made().rows[made().rows.is_judged]
    panel, below = satellite_figures(of_satellites, made())["margin"]().axes
    (edge,) = (line.get_xdata()[0] for line in below.lines)
    bars = {bar.get_x() + bar.get_width() / 2: bar.get_height() for bar in below.patches}
    assert MARGINS_M[int(edge - 0.5)] == 0
    for margin_m, x in (
        (-80.0, 0),
        (-1.0, edge - 0.5),
        (1.0, edge + 0.5),
        (np.inf, len(MARGINS_M)),
    ):
        rows = judged[judged.margin_m == margin_m]
        assert bars[x] == pytest.approx((rows.cn0_dbhz == 0).mean())
        assert f"{len(rows):,}" in texts_of(panel.figure)


def test_the_picture_of_the_first_screen_shows_shares_of_each_kind():
    _, strengths, cities, _ = sky.plot_sky(made(), "Data: a credit").axes
    heights = np.array([bar.get_height() for bar in strengths.patches]).reshape(2, -1)
    np.testing.assert_allclose(heights.sum(axis=1), 1)
    judged = made().rows[made().rows.is_judged & made().rows.is_seen]
    assert heights[1, 0] == pytest.approx((judged.cn0_dbhz == 0).mean())
    assert cities.lines[0].get_xdata()[0] == pytest.approx(0.842)


def test_pictures_of_the_sample_log_are_small():
    drawn = [sky.DOCS / f"{name}.png" for name in sky.NAMES]
    assert [file.name for file in drawn if not file.stat().st_size < 300_000] == []
