"""Progress: a function, a bar on a terminal, else lines in the log."""

import io
import logging
import re
import sys

import jax
import pytest

import jaxurban as ju
from jaxurban import progress
from jaxurban.progress import Report, interrupted, reporting


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def work(told) -> None:
    with reporting("maps", told) as report:
        report("read")
        for done in range(4):
            report("tiles", done, 3, crashed=done // 3)


def test_a_function_is_told_stage_done_and_total():
    calls = []
    work(lambda *told: calls.append(told))
    assert calls == [("read", 0, 0), *(("tiles", done, 3) for done in range(4))]


def test_soft_layers_that_last_show_a_bar_and_short_ones_none(monkeypatch):
    city = ju.demo_city(400, 400)
    grid = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), progress=False).grid
    soft = ju.grad.soft_city(city, grid, ju.grad.SoftParams(altitude_m=60.0))
    shown = []
    for brief_s in (0.0, 600.0):
        monkeypatch.setattr(progress, "BRIEF_S", brief_s)
        monkeypatch.setattr(sys, "stderr", Terminal())
        jax.grad(lambda params: soft.layers(soft.height_m, params).sum())(
            ju.grad.SoftParams(altitude_m=60.0)
        )
        shown.append(sys.stderr.getvalue())
    assert f"{len(soft.names)}/{len(soft.names)}" in shown[0]
    assert shown[1] == ""


def test_over_items_as_many_are_done_as_were_used_and_no_items_are_no_stage():
    calls: list[tuple] = []
    report = Report(lambda *call: calls.append(call))
    calls.extend((item,) for item in report.over("maps", "ab"))
    assert calls == [("maps", 0, 2), ("a",), ("maps", 1, 2), ("b",), ("maps", 2, 2)]
    assert [*report.over("none", ())] == []
    assert len(calls) == 5


@pytest.mark.parametrize("told", [True, False])
def test_without_a_terminal_short_stages_are_no_lines_of_the_log(told, caplog, capsys):
    caplog.set_level(logging.INFO, "jaxurban")
    work(told)
    assert not caplog.messages
    assert capsys.readouterr().err == ""


def test_on_the_way_total_and_time_left_are_logged(monkeypatch, caplog):
    caplog.set_level(logging.INFO, "jaxurban")
    monkeypatch.setattr(progress, "EVERY_S", 0.0)
    work(True)
    lines = [line for line in caplog.messages if line.startswith("maps: tiles:")]
    assert any("33% 1/3 [00:00<" in line for line in lines)
    assert "100% 3/3" in lines[-1]
    assert "crashed=1" in lines[-1]


def test_the_first_forecast_is_not_of_what_was_compiled(monkeypatch, caplog):
    caplog.set_level(logging.INFO, "jaxurban")
    now_s = 0.0
    monkeypatch.setattr("tqdm.std.time", lambda: now_s)
    total, compile_s, row_s = 1400, 10.0, 0.25
    forecasts = []
    with reporting("study", True) as report:
        report("runs", 0, total)
        for done in range(1, total + 1):
            now_s += compile_s if done <= 3 else row_s
            report("runs", done, total)
            if caplog.messages and (left := re.search(r"<(\d+):(\d+)", caplog.messages[-1])):
                minutes, seconds = map(int, left.groups())
                forecasts.append((60 * minutes + seconds, (total - done) * row_s))
            caplog.clear()
    assert len(forecasts) > 20
    for forecast_s, left_s in forecasts:
        assert forecast_s <= 2 * left_s + 10


def test_on_a_terminal_a_bar_shows_the_stage(monkeypatch, caplog):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(progress, "BRIEF_S", 0.0)
    work(True)
    assert "maps: tiles: 100%" in sys.stderr.getvalue()
    assert not caplog.messages


def test_ctrl_c_that_a_callback_swallowed_is_raised_at_the_next_report():
    interrupted.set()
    try:
        with pytest.raises(KeyboardInterrupt):
            work(False)
    finally:
        interrupted.clear()
