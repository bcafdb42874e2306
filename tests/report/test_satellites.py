"""What a validation of a log with a row a satellite reports and draws: every number is one of its tables."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from jaxurban.report.receiver import validation_markdown, validation_outputs
from jaxurban.report.satellites import MARGINS_M, satellite_figures
from jaxurban.studies.receiver.agreement import PlaceSky, SatelliteAgreement
from jaxurban.studies.receiver.validate import ReceiverValidation
from tests.receiver_logs import found


def made() -> SatelliteAgreement:
    """Return an agreement with a known number in each field, along the first 60 epochs of the drive."""
    rng = np.random.default_rng(7)
    names = ["G01", "G02", "E03", "E04", "C05", "R06"]
    rows = pd.DataFrame({"epoch": np.repeat(np.arange(60), 6), "satellite": names * 60})
    rows["margin_m"] = rng.choice([-80.0, -7.0, -1.0, 1.0, 7.0, np.inf], len(rows))
    rows["cn0_dbhz"] = np.where(rng.random(len(rows)) < 0.3, 0.0, rng.uniform(18, 52, len(rows)))
    rows["azimuth_deg"], rows["elevation_deg"] = rng.uniform(0, 360, len(rows)), rng.uniform(10, 85, len(rows))
    rows = rows.assign(is_seen=rows.margin_m > 0, is_known=True, is_inside=rows.epoch < 3, is_strong=rows.cn0_dbhz > 36)
    rows = rows.assign(is_judged=~rows.is_inside, system=rows.satellite.str[0], block=rows.epoch // 5)
    kinds = ("all", "received", "G", "E", "C", "R", "unguarded")
    low, value, high = np.array([[0.811], [0.842], [0.873]]) + np.arange(len(kinds)) / 1000
    scores = pd.DataFrame({"which": kinds, "rows": 342, "share": 0.957, "auc": value, "auc_low": low, "auc_high": high})
    scores = scores.assign(within=value - 0.1, within_low=low - 0.1, within_high=high - 0.1, num_satellites=6)
    steps = np.arange(-4.0, 5.0, 2.0)
    field = pd.DataFrame([(x, y, 342, 0.8 - abs(x - 2) / 100 - abs(y) / 100) for x in steps for y in steps])
    displaced = pd.DataFrame({"east_m": 100.0, "north_m": 0.0, "rows": 342, "auc": np.linspace(0.511, 0.622, 9)})
    models = ("constant", "elevation", "street", "seen or hidden", "margin", "margin and elevation")
    rivals = pd.DataFrame({"model": models, "log_loss": 0.6 - np.arange(6) / 100, "gain": 0.0})
    scales = np.round(np.arange(0.8, 1.21, 0.02), 2)
    start = found().epochs.iloc[30]
    columns = ["satellite", "azimuth_deg", "elevation_deg", "cn0_dbhz", "is_seen", "is_judged", "is_strong"]
    there = rows[rows.epoch == 30][columns].reset_index(drop=True)
    place = start.lon_deg, start.lat_deg, start.utc.isoformat(), np.linspace(5, 60, 360), there
    return SatelliteAgreement(
        rows=rows,
        scores=scores,
        displaced=displaced.assign(within=displaced.auc - 0.1),
        field=field.set_axis(["east_m", "north_m", "rows", "auc"], axis="columns"),
        scales=pd.DataFrame({"scale": scales, "rows": 342, "auc": 0.8 - abs(scales - 1)}),
        peak={"east_m": 2.0, "north_m": 0.0, "within_95_m": 5.7, "scale": 1.0, "scale_low": 0.94, "scale_high": 1.06},
        rivals=rivals.assign(gain_low=-0.031, gain_high=0.047),
        skies=tuple(PlaceSky(name, *place) for name in ("least agreement", "most agreement")),
        strong_dbhz=36.5,
        verdict="Maps and receiver agree.",
        counts={
            "rows": 360,
            "judged": 342,
            "is_guarded": True,
            "unknown": 11,
            "inside": 18,
            "num_satellites": 6,
            "num_blocks": 12,
            "num_displaced": 9,
            "left_out": {"E18": "unhealthy"},
        },
    )


@pytest.fixture(scope="module")
def of_satellites() -> ReceiverValidation:
    return replace(found(), satellites=made())


def texts_of(figure: Figure) -> str:
    return " ".join(text.get_text() for text in figure.findobj(Text))


def test_the_report_leads_with_the_verdict_and_counts_come_second(of_satellites):
    report = validation_markdown(of_satellites)
    order = ["**Maps and receiver agree.**", "## Satellite by satellite", "## What agrees"]
    assert [report.index(part) for part in order] == sorted(report.index(part) for part in order)
    assert report.startswith(f"# A receiver beside the maps\n\n{order[0]}\n")
    assert "nan" not in report


def test_every_score_stands_in_the_report_with_its_interval(of_satellites):
    report = validation_markdown(of_satellites)
    assert "| all judged | 342 | 0.957 | 0.842 (0.811 to 0.873) | 0.742 (0.711 to 0.773) | 6 |" in report
    assert "| GLONASS | 342 | 0.957 | 0.847 (0.816 to 0.878) |" in report
    assert "| in its place | 0.842 | 0.742 |" in report
    assert "| most | 0.622 | 0.522 |" in report
    assert "| margin and elevation | 0.55 | 0 (-0.031 to 0.047) |" in report
    assert "2 m to the east and 0 m to the north" in report
    assert "1.00 times their height (0.94 to 1.06)" in report
    assert "11 rows are not judged: their rays leave" in report
    assert "E18 is left out: unhealthy." in report


def test_without_satellites_the_report_and_its_files_are_those_of_counts():
    outputs, _ = validation_outputs(found())
    assert [*outputs] == ["tables/pieces", "tables/scores", "tables/shifts", "figures/scatter.png", "report.md"]
    assert "atellite by satellite" not in outputs["report.md"]


def test_two_logs_of_the_same_epochs_are_different_runs(of_satellites):
    one, other = (
        replace(of_satellites, log=replace(found().log, satellites=made().rows.assign(cn0_dbhz=value)))
        for value in (40.0, 41.0)
    )
    assert validation_outputs(one)[1] != validation_outputs(other)[1]


def test_every_picture_of_the_report_is_drawn_and_every_drawn_one_is_in_it(of_satellites):
    outputs, _ = validation_outputs(of_satellites)
    pictures = [name for name in outputs if name.endswith(".png")]
    assert sorted(pictures) == sorted(name for name in pictures if f"]({name})" in outputs["report.md"])
    assert outputs["report.md"].count("](figures/") == len(pictures) == 5


def test_pictures_name_what_they_show_with_units(of_satellites):
    said = {name: texts_of(draw()) for name, draw in satellite_figures(of_satellites, made()).items()}
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
    for margin_m, x in ((-80.0, 0), (-1.0, edge - 0.5), (1.0, edge + 0.5), (np.inf, len(MARGINS_M))):
        rows = judged[judged.margin_m == margin_m]
        assert bars[x] == pytest.approx((rows.cn0_dbhz == 0).mean())
        assert f"{len(rows):,}" in texts_of(panel.figure)
