"""Every picture as it is drawn: none of its texts is cut, covered or too small, and nothing is too pale to see."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.receiver.pictures import plot_displacement
from figures import sky
from jaxurban.draw.style import WIDTHS_MM, chart
from tests.benchmarks.made_evidence import made_evidence
from tests.draw.test_legible import agreement
from tests.drawn import PICTURES, Case, draw, functions
from tests.pictures import faults

SLOW = (
    "plot_epochs",
    "plot_overview",
)


def cases() -> list:
    """Return a case for each picture at each width that it has; the easy ones are slow, and so are some others."""
    both = []
    for name in PICTURES:
        has_width = "width" in inspect.signature(functions()[name]).parameters
        for width in WIDTHS_MM if has_width else ("page",):
            for is_hard in (True, False):
                marks = [] if is_hard and name not in SLOW else [pytest.mark.slow]
                label = f"{name}-{width}-{'hard' if is_hard else 'easy'}"
                both.append(pytest.param(name, Case(is_hard, width), id=label, marks=marks))
    return both


def test_every_function_that_draws_is_looked_at():
    assert sorted(PICTURES) == sorted(functions())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "case"), cases())
def test_nothing_of_a_picture_is_cut_covered_small_or_pale(name, case):
    figure = draw(name, case)
    assert figure.get_figwidth() * 25.4 <= WIDTHS_MM[case.width] + 0.1
    assert faults(figure, WIDTHS_MM[case.width]) == []


def test_the_picture_of_the_first_screen_has_no_fault():
    evidence = replace(made_evidence(), of=agreement(45, "G{:02}"))
    assert faults(sky.plot_sky(evidence, "Data: a credit; log: somebody")) == []


@pytest.mark.slow
def test_the_picture_of_displaced_cities_has_no_fault():
    assert faults(plot_displacement(made_evidence())) == []


def blank() -> Figure:
    figure = chart(2.0, "")
    figure.set_layout_engine("none")
    return figure


@pytest.mark.parametrize(
    ("texts", "fault"),
    [
        ([(0.97, 0.5, "leaves the figure", {})], "'leaves the figure' is cut"),
        ([(0.5, 0.5, "one", {}), (0.5, 0.5, "two", {})], "'one' and 'two' overlap"),
        ([(0.5, 0.5, "tiny", {"size": 5})], "'tiny' has 5.0 points at 182 mm"),
        ([(0.5, 0.5, "pale", {"color": "#e0e0e0"})], "'pale' has a contrast of 1.32"),
        # Two slanting lines beside each other, whose upright boxes overlap.
        ([(0.2, 0.1, 20 * "a", {"rotation": 45}), (0.3, 0.1, 20 * "b", {"rotation": 45})], ""),
        ([(0.5, 0.5, "edged", {"color": "#e0e0e0", "bbox": {"facecolor": "black"}})], ""),
    ],
)
def test_each_fault_is_found_and_named(texts, fault):
    figure = blank()
    for x, y, text, look in texts:
        figure.text(x, y, text, **look)
    assert faults(figure, 182.0) == [fault] * bool(fault)


def test_a_figure_that_is_printed_smaller_has_smaller_letters():
    figure = blank()
    figure.text(0.5, 0.5, "seven points", size=7)
    assert faults(figure, 182.0) == []
    assert faults(figure, 88.9) == ["'seven points' has 3.4 points at 89 mm"]


def test_pale_lines_and_dots_are_found_by_what_lies_below_them():
    for below, fault in (("white", True), ("black", False)):
        figure = blank()
        panel = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        panel.set_axis_off()
        panel.axhspan(0, 1, color=below)
        panel.plot([0, 1], [0.2, 0.8], color="#f0f0f0", label="line")
        panel.scatter(np.linspace(0, 1, 5), np.full(5, 0.5), color="#f0f0f0", label="dots")
        expected = ["Line2D 'line'", "PathCollection 'dots'"] if fault else []
        assert sorted(each.partition(" has")[0] for each in faults(figure)) == expected
