"""One rule of what is seen: its sign and its cut, and the two engines and the maps' sweep that follow it."""

from dataclasses import replace
from functools import cache

import numpy as np

import jaxurban as ju
from benchmarks.receiver.counts import seen_along
from jaxurban.maps.build import region_of
from jaxurban.metrics.reception import ReceptionCurve
from jaxurban.receivers.rule import FARTHEST_MARGIN_M, is_seen, states_of
from jaxurban.receivers.sight import Sight
from jaxurban.receivers.track import Track
from jaxurban.receivers.walk import LegSurface
from jaxurban.world.known import Rays
from jaxurban.world.raster import Raster
from tests.made_maps import city_of_boxes

CORNER_M, SIDE_M, ALTITUDE_M = (583_000.0, 4_507_000.0), 3000.0, 2.0
GPS = ju.Gps(times=("2020-04-27T16:00:00Z", "2020-04-27T19:00:00Z"), mask_deg=10.0)
NUM_PLACES, HIGHEST_M = 400, 90.0
EDGE_M = 1e-3  # two sums in float32 differ by less


def test_a_ray_that_touches_is_hidden_and_one_without_a_margin_is_unknown():
    margin_m = np.array([-np.inf, -1e-9, 0.0, 1e-9, np.inf, np.nan])
    assert states_of(margin_m).tolist() == [*["hidden"] * 3, *["seen"] * 2, "unknown"]
    np.testing.assert_array_equal(is_seen(margin_m), states_of(margin_m) == "seen")


def test_margins_are_told_as_far_as_the_curve_of_a_receiver_tells_them_apart():
    assert ReceptionCurve.measured_in_tokyo().cut_m == FARTHEST_MARGIN_M


@cache
def town(resolution_m: float) -> Sight:
    """Return the sight of a town of boxes on whole cells, in the middle of what is known, from a grid of cells."""
    rng = np.random.default_rng(3)
    corner = 1250.0 + 20.0 * rng.integers(0, 25, (60, 2))
    boxes = np.column_stack([corner, corner + 20.0 * rng.integers(1, 3, (60, 2))])
    city = city_of_boxes(boxes, rng.choice([12.5, 31.5, HIGHEST_M], 60), SIDE_M, CORNER_M)
    of = Sight.of(city, GPS, None)
    return replace(of, region=region_of(city, None, resolution_m))


def seen_by_all(sight: Sight) -> tuple[np.ndarray, ...]:
    """Return of rays from random centres of cells outdoors what the sweep sees, margins of a walk, and of outlines."""
    task = sight.task(None, ALTITUDE_M, None)
    cells = np.random.default_rng(0).integers(
        0, int(500 / sight.region.resolution_m), (2, NUM_PLACES)
    )
    row, col = cells + int(1250 / sight.region.resolution_m)
    x_m, y_m = sight.region.xy_of_cell(row, col)
    track = Track(x_m, y_m, np.arange(NUM_PLACES) // (NUM_PLACES // 2), task.sky.times)
    swept, is_outdoors = seen_along(task, track, lambda *_: None)

    epoch, satellite = np.nonzero(task.sky.is_in_view[track.sky] & is_outdoors[:, None])
    angles = (
        of[track.sky[epoch], satellite] for of in (task.sky.azimuth_rad, task.sky.elevation_rad)
    )
    rays = Rays(x_m[epoch], y_m[epoch], *angles)
    box = track.box(sight.region, np.arange(NUM_PLACES))
    ground = LegSurface.around(sight.city, box, 0.0, 1000.0, ALTITUDE_M)
    table = sight.hiding.behind(rays, np.full(len(epoch), ALTITUDE_M))
    return swept[epoch, satellite], ground.margins_m(rays), table["margin_m"].to_numpy()


def test_the_walk_sees_what_the_sweep_of_the_maps_sees():
    swept, walked_m, _ = seen_by_all(town(5.0))
    differs = swept != is_seen(walked_m)
    assert 0.1 < swept.mean() < 0.9
    assert np.abs(walked_m[differs]).max(initial=0.0) < EDGE_M


def test_over_hills_too_the_walk_sees_what_the_sweep_of_the_maps_sees():
    """Hills of 60 m, 400 m apart, which hide satellites too."""
    x_m, y_m = np.meshgrid(np.arange(0, SIDE_M, 10.0), np.arange(SIDE_M, 0, -10.0))
    hills_m = 30.0 * (np.sin(x_m / 64.0) + np.cos(y_m / 64.0)).astype(np.float32)
    terrain = Raster(
        hills_m, (10.0, 0.0, CORNER_M[0], 0.0, -10.0, CORNER_M[1] + SIDE_M), "EPSG:32618"
    )
    flat = town(5.0)
    city = replace(flat.city, terrain=terrain, terrain_extent_m=flat.city.extent_m)
    swept, walked_m, _ = seen_by_all(replace(flat, city=city))
    differs = swept != is_seen(walked_m)
    assert swept.mean() < seen_by_all(flat)[0].mean() - 0.02
    assert np.abs(walked_m[differs]).max(initial=0.0) < EDGE_M


def test_the_walk_over_small_cells_agrees_with_the_outlines():
    """A ray enters a cell of 1 m up to a cell from the exact side, which is a metre of height at 45 degrees."""
    _, walked_m, exact_m = seen_by_all(town(1.0))
    is_known = ~np.isnan(exact_m)
    assert (is_seen(walked_m) == is_seen(exact_m))[is_known].mean() > 0.98
    both = is_known & np.isfinite(walked_m) & np.isfinite(exact_m)
    assert both.sum() > 500
    assert np.median(np.abs(walked_m[both] - exact_m[both])) < 0.5
