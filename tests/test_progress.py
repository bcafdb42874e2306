"""Progress: a function, a bar on a terminal, else lines in the log."""

import io
import logging
import sys

import pytest

from jaxurban import progress
from jaxurban.progress import interrupted, reporting


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


@pytest.mark.parametrize("told", [True, False])
def test_without_a_terminal_short_stages_are_no_lines_of_the_log(told, caplog, capsys):
    caplog.set_level(logging.INFO, "jaxurban")
    work(told)
    assert not caplog.messages
    assert capsys.readouterr().err == ""


def test_on_the_way_total_and_time_left_are_told_now_and_then(monkeypatch, caplog):
    caplog.set_level(logging.INFO, "jaxurban")
    clock = iter([0.0, 1.0, 5.0, 16.0, 17.0, 18.0, 19.0])
    monkeypatch.setattr(progress.time, "perf_counter", lambda: next(clock))
    work(True)
    assert caplog.messages == [
        "maps: tiles, 1 of 3, crashed 0, 11 s, about 22 s left",
        "maps: tiles, 3 of 3, crashed 1: done in 14.0 s",
    ]


def test_on_a_terminal_a_bar_shows_the_stage(monkeypatch, caplog):
    monkeypatch.setattr(sys, "stderr", Terminal())
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
