"""What a validation writes: a report of its numbers, JSON without NaN, figures; the command and its errors."""

import json

import pandas as pd
import pytest
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.report.receiver import plot_scatter, validation_markdown, with_interval
from tests.cli_runs import assert_one_sentence, run
from tests.receiver_logs import SCENARIO, found, scenario, true_log


def test_the_report_holds_the_numbers_of_the_scores():
    report = validation_markdown(found())
    for row in found().main.to_dict("records"):
        assert with_interval(row, "within") in report
    assert report.index("rank correlation within blocks") < report.index("over the whole track")
    assert "95 % of shifts below" in report
    assert "line of sight only" in report
    assert "nan" not in report


def test_the_figure_names_what_it_shows_and_counts_in_whole_numbers():
    figure = plot_scatter(found())
    texts = " ".join(text.get_text() for text in figure.findobj(Text))
    assert "maps: satellites in view" in texts
    assert "receiver: horizontal error (m)" in texts
    for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis):
        assert all(float(value).is_integer() for value in axis.get_majorticklocs())


def test_a_short_still_log_has_no_interval_and_is_drawn():
    log = true_log()[:60].assign(num_tracked=[5, 8] * 30)
    settings = ju.studies.ReceiverSettings(sky_step_s=240.0, block_m=100.0)
    of = ju.studies.validate(scenario(), log, settings, progress=False)
    assert of.scores.within_low.isna().all()
    assert "nan" not in validation_markdown(of)
    assert plot_scatter(of).axes


def test_a_log_of_errors_alone_is_drawn_too():
    log = true_log()[["utc", "lon_deg", "lat_deg", "error_2d_m"]]
    of = ju.studies.validate(
        scenario(), log, ju.studies.ReceiverSettings(sky_step_s=240.0), progress=False
    )
    assert plot_scatter(of).axes[0].get_ylabel() == "receiver: horizontal error (m)"
    assert "satellites tracked" not in validation_markdown(of)


@pytest.mark.slow
def test_the_command_writes_a_folder_of_its_own(tmp_path, capsys):
    toml = tmp_path / "town.toml"
    toml.write_text(scenario().to_toml())
    true_log().to_csv(tmp_path / "log.csv", index=False)
    out = tmp_path / "out"
    code, told, err = run(
        capsys, "validate", toml, tmp_path / "log.csv", "-o", out, "--sky-step", "240", "--json"
    )
    assert code == 0, err
    scores = json.loads(told, parse_constant=pytest.fail)["scores"]
    assert [row["within"] for row in scores] == pd.read_parquet(
        out / "tables/scores.parquet"
    ).within.tolist()
    assert len(pd.read_csv(out / "tables/pieces.csv")) == len(
        pd.read_parquet(out / "tables/pieces.parquet")
    )
    assert "figures/scatter.png" in (out / "report.md").read_text()
    assert (out / "figures/scatter.png").stat().st_size > 5000
    again = (
        "validate",
        toml,
        tmp_path / "log.csv",
        "-o",
        out,
        "--sky-step",
        "240",
        "--antenna-height",
        "3",
    )
    code, _, err = run(capsys, *again)
    assert code == 2
    assert_one_sentence(err, "holds another run", "--overwrite")
    assert run(capsys, *again, "--overwrite")[0] == 0


def test_a_log_that_cannot_be_used_ends_the_command_with_one_sentence(tmp_path, capsys):
    toml, log = tmp_path / "town.toml", tmp_path / "log.csv"
    toml.write_text(ju.Scenario.from_dict(SCENARIO).to_toml())
    log.write_text("utc,lon_deg,lat_deg\n2020-04-27T16:00:00Z,-73.9,40.7\n")
    code, out, err = run(capsys, "validate", toml, log, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert_one_sentence(err, "num_tracked")
    assert not (tmp_path / "out" / "report.md").exists()
