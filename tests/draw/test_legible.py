"""Pictures of skies and tracks whose texts can be read: none cut, none over another or over a mark of another."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib import __version_info__ as version_info
from matplotlib.figure import Figure

import jaxurban as ju
from benchmarks.receiver.pictures import plot_displacement
from figures import sky as first_screen
from jaxurban.draw.style import chart, label_apart, styled
from jaxurban.receivers.along import SkyAt
from jaxurban.receivers.figures import plot_sky, sky_places
from jaxurban.receivers.report import satellite_figures
from tests.benchmarks.made_evidence import made_evidence
from tests.made_agreement import made
from tests.pictures import assert_legible

SYSTEMS = ("gps", "galileo", "beidou", "glonass", "qzss", "navic")
STATES = ("seen", "hidden", "unknown")


def crowded(num: int, name: str) -> pd.DataFrame:
    """Return satellites of all systems and states all over the sky, a row each, with names of some length."""
    rng = np.random.default_rng(5)
    rows = pd.DataFrame({"azimuth_deg": rng.uniform(0, 360, num)})
    rows["elevation_deg"] = np.degrees(np.arcsin(rng.uniform(0.05, 1, num)))
    rows["satellite"] = [name.format(number) for number in range(num)]
    rows["system"], rows["state"] = np.resize(SYSTEMS, num), np.resize(np.repeat(STATES, 6), num)
    rows["cn0_dbhz"] = rng.choice([0.0, 30.0, 48.0], num)
    return rows.assign(is_seen=rows.state == "seen", is_judged=rows.cn0_dbhz < 40, is_strong=True)


def agreement(num: int, name: str):
    """Return an agreement whose two places, the second at the track's end, have so many satellites in their skies."""
    last = made().epochs.iloc[-1]
    skies = [replace(sky, satellites=crowded(num, name)) for sky in made().skies]
    skies[1] = replace(skies[1], lon_deg=last.lon_deg, lat_deg=last.lat_deg)
    return replace(made(), skies=tuple(skies))


def covered(panel, boxes, marks: np.ndarray) -> list[str]:
    """Return the texts that lie over the middle of a mark of a panel."""
    middles = panel.transData.transform(marks)
    return [name for name, box in boxes if box.count_contains(middles)]


@pytest.mark.slow
@pytest.mark.skipif(
    version_info < (3, 11), reason="Matplotlib before 3.11 lets a polar panel's title meet its N"
)
@pytest.mark.parametrize(("num", "name"), [(45, "G{:02}"), (45, "STARLINK-{:04}")])
def test_pictures_beside_a_receiver_can_be_read(num, name):
    of = agreement(num, name)
    pictures = {key: draw() for key, draw in satellite_figures(of).items()}
    evidence = replace(made_evidence(), of=of)
    pictures["displacement"] = plot_displacement(evidence)
    pictures["first"] = first_screen.plot_sky(
        evidence, "Data: a credit of a city; log: somebody (MIT)"
    )
    for figure in pictures.values():
        assert_legible(figure)


@pytest.fixture(scope="module")
def here() -> SkyAt:
    gps = ju.Gps(times=["2020-04-27T16:00:00Z"])
    return ju.sky(ju.demo_city(400, 400), (-73.97, 40.78), 20.0, gps=gps)


@pytest.mark.parametrize("width", ["page", "column"])
@pytest.mark.parametrize(
    ("num", "name"),
    [(9, "GPS slot A{}"), pytest.param(72, "GPS BIIF-9 (PRN {:02})", marks=pytest.mark.slow)],
)
def test_the_sky_over_a_place_can_be_read(here, width, num, name):
    rows = crowded(num, name).assign(time=here.times[0])
    figure = plot_sky(replace(here, table=rows), width=width)
    (panel,) = figure.axes
    assert "rings: 60°, 30°" in panel.get_legend_handles_labels()[1]
    assert covered(panel, assert_legible(figure), sky_places(rows)) == []
    assert panel.get_window_extent().width > 0.5 * figure.bbox.width
    assert width == "column" or len({text.get_text() for text in panel.texts} - {""}) == num


@styled
def named(marks: list[tuple[float, float]]) -> Figure:
    """Return a panel of one by one with marks whose names are their numbers."""
    figure = chart(2.0, "Marks")
    panel = figure.subplots()
    panel.set(xlim=(0, 1), ylim=(0, 1))
    label_apart(panel, [str(number) for number in range(len(marks))], np.array(marks))
    return figure


def test_a_name_stands_above_to_the_right_of_a_lone_mark_and_turns_at_the_panels_corner():
    lone, corner = (named([place]).axes[0].texts[0].xyann for place in ((0.5, 0.5), (1.0, 1.0)))
    assert lone == (5, 5)
    assert corner == (-5, -5)


def test_only_a_name_with_another_mark_as_near_has_a_line_to_its_own():
    apart = named([(0.2, 0.5), (0.8, 0.5)]).axes[0].texts
    assert [text.get_text() for text in apart] == ["0", "1"]
    near = named([(0.5, 0.5), (0.5, 0.5)]).axes[0].texts
    assert [text.get_text() for text in near] == ["0", "", "1", ""]


def test_a_name_without_a_place_is_left_out():
    around = np.linspace(0.3, 0.7, 20)
    marks = np.stack(np.meshgrid(around, np.linspace(0, 1, 30)), axis=-1).reshape(-1, 2)
    middle = np.abs(marks - 0.5).sum(axis=1).argmin()
    figure = named([tuple(marks[middle])])
    assert len(figure.axes[0].texts) == 1
    label_apart(figure.axes[0], ["hidden"], np.vstack([marks[middle], marks]))
    assert [text.get_text() for text in figure.axes[0].texts] == ["0"]


def test_a_cut_text_and_two_that_overlap_are_noticed():
    for places in ([(0.97, 0.5, "leaves the figure")], [(0.5, 0.5, "one"), (0.5, 0.5, "two")]):
        figure = chart(2.0, "")
        for text in places:
            figure.text(*text)
        with pytest.raises(AssertionError):
            assert_legible(figure)
