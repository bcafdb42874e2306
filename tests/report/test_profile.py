"""The profile plot shows what the report says, where it says it."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import StepPatch

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.report.figures import plot_profile, save_profile
from jaxurban.report.figures.frame import GUESSED_COLOUR
from jaxurban.report.figures.profile import NO_FIX_COLOUR
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made_maps()


@pytest.fixture(scope="module")
def planned(maps) -> ju.PlannedPath:
    free = np.argwhere(maps.is_free(20.0))
    ends = {"start_xy_m": maps.grid.xy_of_cell(*free[10]), "goal_xy_m": maps.grid.xy_of_cell(*free[-10])}
    return ju.plan(maps, **ends, altitude_m=20.0, weights=ju.Weights(risk=5.0))


def steps(panel) -> dict[str, StepPatch]:
    return {patch.get_label(): patch for patch in panel.patches if isinstance(patch, StepPatch)}


def test_the_curves_are_the_values_of_the_report_by_distance(maps, planned):
    report = ju.explain(planned, maps)
    heights, metrics, walls = plot_profile(planned, maps, report).axes
    edges_km = np.append(report.profile["from_m"], report.profile["to_m"].iloc[-1]) / 1000
    for panel, label, name in (
        (heights, "roofs beneath", "roof_m"),
        (metrics, "GPS quality", "gps"),
        (metrics, "Population (1: worst)", "population"),
        (walls, "clearance", "nearest_wall_m"),
    ):
        drawn = steps(panel)[label].get_data()
        np.testing.assert_array_equal(drawn.values, report.profile[name])
        np.testing.assert_array_equal(drawn.edges, edges_km)
    assert heights.get_ylim()[1] > 20.0
    units = [panel.get_ylabel() for panel in (heights, metrics, walls)]
    assert units == ["height above ground (m)", "metric m (1)", "clearance (m)"]
    assert walls.get_xlabel() == "distance flown (km)"
    assert all(panel.get_legend() for panel in (heights, metrics, walls))


def test_roofs_of_guessed_height_are_told_apart(maps, planned):
    report = ju.explain(planned, maps)
    profile = report.profile.assign(roof_m=12.0, roof_guessed=report.profile.index < 5)
    heights = plot_profile(planned, maps, replace(report, profile=profile)).axes[0]
    guessed = steps(heights)["of guessed height"]
    assert to_hex(guessed.get_facecolor()) == GUESSED_COLOUR
    np.testing.assert_array_equal(guessed.get_data().values, np.where(profile.index < 5, 12.0, 0.0))
    assert "of guessed height" not in steps(plot_profile(planned, maps, report).axes[0])


def test_stretches_without_a_fix_are_shaded_over_their_whole_length(maps, planned):
    report = ju.explain(planned, maps)
    figure = plot_profile(planned, maps, report)
    (shade, *_) = shaded = [p for p in figure.axes[1].patches if p.get_facecolor()[:3] == rgb(NO_FIX_COLOUR)]
    assert sum(patch.get_width() for patch in shaded) * 1000 == pytest.approx(report.totals["under_4_satellites_m"])
    assert shade.get_width() > 0
    assert "under 4 satellites" in [text.get_text() for text in figure.axes[1].get_legend().get_texts()]


def rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))


def test_a_profile_without_walls_or_of_one_place_is_drawn(maps, planned, tmp_path):
    high = ju.MetricMaps(maps.ds.assign(obstacle=maps.ds["obstacle"] * 0))
    save_profile(planned, high, tmp_path / "a.png")
    here = {"start_xy_m": planned.xy_m[0], "goal_xy_m": planned.xy_m[0]}
    save_profile(ju.plan(maps, **here, altitude_m=20.0), maps, tmp_path / "b.png")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.png", "b.png"]
    with pytest.raises(InputError, match=r"end its name in \.png"):
        save_profile(planned, maps, tmp_path / "a.pdf")


def test_the_profile_names_its_altitude_and_time_of_day(maps, planned):
    told = [text.get_text() for text in plot_profile(planned, maps).texts]
    assert any(f", 20 m above ground, {planned.settings['time_of_day']}, cost " in line for line in told)


def test_clearance_has_gaps_only_where_a_route_is_above_every_obstacle(maps, planned):
    report = ju.explain(planned, maps)
    profile = report.profile.assign(
        nearest_wall_m=report.profile["nearest_wall_m"].where(report.profile.index > 3, np.inf)
    )
    walls = plot_profile(planned, maps, replace(report, profile=profile)).axes[2]
    drawn = steps(walls)["clearance"].get_data().values
    assert np.isnan(drawn[:4]).all()
    np.testing.assert_array_equal(drawn[4:], profile["nearest_wall_m"][4:])
    assert "gaps: above every\nobstacle" in [text.get_text() for text in walls.get_legend().get_texts()]
    assert not walls.texts
