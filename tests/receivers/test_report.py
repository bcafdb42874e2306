"""What a validation of a log with a row a satellite reports and draws: every number is one of its tables."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import jaxurban as ju
from figures import sky
from jaxurban.receivers.report import MARGINS_M, satellite_figures
from jaxurban.receivers.validation.report import validation_report
from tests.benchmarks.made_evidence import made_evidence
from tests.made_agreement import made

pytestmark = pytest.mark.usefixtures("without_layout")


def texts_of(figure: Figure) -> str:
    return " ".join(text.get_text() for text in figure.findobj(Text))


def test_every_score_stands_in_the_report_with_its_interval():
    report = validation_report(made()).text
    assert report.startswith("# A receiver's log, compared with the maps\n")
    assert (
        "| all judged | 342 | 0.957 | 0.842 (0.811 to 0.873) | 0.742 (0.711 to 0.773) | 6 |"
        in report
    )
    assert "| GLONASS | 342 | 0.957 | 0.847 (0.816 to 0.878) |" in report
    assert "11 rows are not judged: their rays leave" in report
    assert "18 rows are not judged: their places lie in buildings" in report
    assert "E18 is left out: unhealthy." in report
    assert "| rows judged | 342 of 360 |" in report
    assert "nan" not in report


def test_what_is_unknown_is_no_number_of_the_report_and_is_drawn():
    unknown = {"auc": np.nan, "auc_low": np.nan, "auc_high": np.nan}
    rows = made().rows.assign(is_seen=True, margin_m=np.inf)
    all_seen = replace(made(), rows=rows, scores=made().scores.assign(**unknown))
    assert "nan" not in validation_report(all_seen).text
    assert "there is nothing to compare" in all_seen.facts["not decided"]
    for draw in satellite_figures(all_seen).values():
        assert draw().axes


def test_rays_that_count_everywhere_and_a_short_track_are_named():
    everywhere = replace(made(), settings=ju.studies.ReceiverSettings(known="all"))
    assert "11 rows are judged as if nothing stood beyond" in validation_report(everywhere).text
    short = replace(made(), summary=made().summary | {"num_blocks": 7})
    assert "7 blocks of 50 m, and an interval takes 8" in validation_report(short).text
    assert "an interval takes 8" not in validation_report(made()).text


def test_the_table_of_satellites_says_when_and_where_each_is_seen_and_how_strongly_it_is_heard():
    table = validation_report(made()).tables["satellites.parquet"]
    assert list(table)[:7] == [
        "utc",
        "lon_deg",
        "lat_deg",
        "satellite",
        "state",
        "margin_m",
        "cn0_dbhz",
    ]
    assert len(table) == len(made().rows)
    assert table.utc.iloc[6] == made().epochs.utc.iloc[1].isoformat()


def test_two_logs_of_the_same_epochs_are_different_runs():
    log = made().log
    louder = replace(log, satellites=log.satellites.assign(cn0_dbhz=41.0))
    assert validation_report(made()).key != validation_report(replace(made(), log=louder)).key


def test_every_picture_of_the_report_is_drawn_and_every_drawn_one_is_in_it():
    outputs = validation_report(made()).outputs
    pictures = [name for name in outputs if name.endswith(".png")]
    assert sorted(pictures) == sorted(
        name for name in pictures if f"]({name})" in outputs["report.md"]
    )
    assert outputs["report.md"].count("](figures/") == len(pictures) == 2


@pytest.mark.usefixtures("laid_out")
def test_pictures_name_what_they_show_with_units():
    said = {name: texts_of(draw()) for name, draw in satellite_figures(made()).items()}
    for name, labels in {
        "track": ("east (m)", "north (m)", "share of satellites", "36.5 dBHz", "least agreement"),
        "margin": ("C/N0 (dBHz)", "not received", "(m)"),
    }.items():
        assert [label for label in labels if label not in said[name]] == []


def test_boxes_stand_on_the_side_of_the_edge_that_the_map_says():
    judged = made().rows[made().rows.is_judged]
    panel, below = satellite_figures(made())["margin"]().axes
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
    _, strengths, cities, _ = sky.plot_sky(made_evidence(), "Data: a credit").axes
    heights = np.array([bar.get_height() for bar in strengths.patches]).reshape(2, -1)
    np.testing.assert_allclose(heights.sum(axis=1), 1)
    judged = made().rows[made().rows.is_judged & made().rows.is_seen]
    assert heights[1, 0] == pytest.approx((judged.cn0_dbhz == 0).mean())
    assert cities.lines[0].get_xdata()[0] == pytest.approx(0.842)


def test_pictures_of_the_sample_log_are_small():
    drawn = [sky.DOCS / f"{name}.png" for name in sky.NAMES]
    assert [file.name for file in drawn if not file.stat().st_size < 300_000] == []
