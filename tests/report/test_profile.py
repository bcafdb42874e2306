"""The profile plot shows what the report says, where it says it."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.patches import StepPatch

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.report.figures import plot_profile, save_profile
from jaxurban.report.figures.frame import GUESSED_COLOUR
from jaxurban.report.figures.profile import NO_FIX_COLOUR
from tests.made_maps import made_maps
from tests.paths.volumes import ends_at


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return made_maps()


@pytest.fixture(scope="module")
def planned(maps) -> ju.PlannedPath:
    ends = ends_at(maps, *np.argwhere(maps.is_free(20.0))[[10, -10]])
    return ju.plan(maps, **ends, altitude_m=20.0, weights=ju.Weights(risk=5.0))


@pytest.fixture(scope="module")
def report(planned, maps) -> ju.RouteReport:
    return ju.explain(planned, maps)


def steps(panel) -> dict[str, StepPatch]:
    return {patch.get_label(): patch for patch in panel.patches if isinstance(patch, StepPatch)}


def test_the_curves_are_the_values_of_the_report_by_distance_under_altitude_and_time_of_day(maps, planned, report):
    figure = plot_profile(planned, maps, report)
    heights, metrics, walls = figure.axes
    heading = f", 20 m above ground, {planned.settings['time_of_day']}, cost "
    assert any(heading in text.get_text() for text in figure.texts)
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


def test_roofs_of_guessed_height_are_told_apart(maps, planned, report):
    profile = report.profile.assign(roof_m=12.0, roof_guessed=report.profile.index < 5)
    heights = plot_profile(planned, maps, replace(report, profile=profile)).axes[0]
    guessed = steps(heights)["of guessed height"]
    assert to_hex(guessed.get_facecolor()) == GUESSED_COLOUR
    np.testing.assert_array_equal(guessed.get_data().values, np.where(profile.index < 5, 12.0, 0.0))
    assert "of guessed height" not in steps(plot_profile(planned, maps, report).axes[0])


def test_stretches_without_a_fix_are_shaded_over_their_whole_length(maps, planned, report):
    figure = plot_profile(planned, maps, report)
    widths = [p.get_width() for p in figure.axes[1].patches if p.get_facecolor()[:3] == to_rgb(NO_FIX_COLOUR)]
    assert sum(widths) * 1000 == pytest.approx(report.totals["under_4_satellites_m"])
    assert widths[0] > 0
    assert "under 4 satellites" in [text.get_text() for text in figure.axes[1].get_legend().get_texts()]


def test_a_profile_without_walls_or_of_one_place_is_drawn(maps, planned, tmp_path):
    high = ju.MetricMaps(maps.ds.assign(obstacle=maps.ds["obstacle"] * 0))
    save_profile(planned, high, tmp_path / "a.png")
    here = {"start_xy_m": planned.xy_m[0], "goal_xy_m": planned.xy_m[0]}
    save_profile(ju.plan(maps, **here, altitude_m=20.0), maps, tmp_path / "b.png")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.png", "b.png"]
    with pytest.raises(InputError, match=r"end its name in \.png"):
        save_profile(planned, maps, tmp_path / "a.pdf")


def test_clearance_has_gaps_only_where_a_route_is_above_every_obstacle(maps, planned, report):
    clear_m = report.profile["nearest_wall_m"].where(report.profile.index > 3, np.inf)
    profile = report.profile.assign(nearest_wall_m=clear_m)
    walls = plot_profile(planned, maps, replace(report, profile=profile)).axes[2]
    drawn = steps(walls)["clearance"].get_data().values
    assert np.isnan(drawn[:4]).all()
    np.testing.assert_array_equal(drawn[4:], profile["nearest_wall_m"][4:])
    assert "gaps: above every\nobstacle" in [text.get_text() for text in walls.get_legend().get_texts()]
    assert not walls.texts
