"""Clearance as a hard limit: what it closes, that every planner, climb and file keeps it, and what is said of it."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

import jaxurban as ju
from benchmarks.random_routes import READERS
from jaxurban.cli.main import app
from jaxurban.draw.frame import rules_said
from jaxurban.io.zone import cell_boxes, touched_cells
from jaxurban.kernels.tolerances import FILE_MARGIN_M
from jaxurban.paths.clearance import closing_step_m, distance_to_obstacles_m, kept_m
from jaxurban.planners.base import Status
from jaxurban.planners.registry import PLANNERS
from tests.made_maps import made_maps
from tests.volumes import ends_at, plan_volume, with_roofs

SIDE_M, ALTITUDE_M = 5.0, 20.0
KEPT = {"clearance_m": 7.0, "vertical_clearance_m": 4.0}
WIDER = KEPT | {"clearance_m": KEPT["clearance_m"] + 0.5}
LEVELS_M = (20.0, 35.0, 60.0)


def scattered(seed: int) -> ju.MetricMaps:
    """Maps of 200 m x 250 m with lone roofs of 12 to 80 m, one cell each."""
    rng, maps = np.random.default_rng(seed), made_maps(40, 50, resolution_m=SIDE_M)
    is_built = rng.random(maps.grid.shape) < 0.02
    return with_roofs(
        maps, np.where(is_built, rng.choice([12.0, 18.0, 30.0, 80.0], maps.grid.shape), 0.0)
    )


def boxes_of(maps: ju.MetricMaps) -> tuple[np.ndarray, np.ndarray]:
    """The squares of cells with a roof, and the roofs' heights."""
    cells = np.argwhere(maps.m("roof_touched") > 0)
    return cell_boxes(maps.grid, cells, 1), maps.m("roof_touched")[tuple(cells.T)].astype(float)


@settings(deadline=None)
@given(asked_m=st.floats(1e-6, 60.0), side_m=st.sampled_from([1.0, 2.0, 2.5, 5.0, 10.0]))
def test_step_and_margin_of_legs_come_to_what_is_asked_and_files_may_take(asked_m, side_m):
    step_m, margin_m = closing_step_m(asked_m, side_m)
    assert step_m + margin_m >= asked_m + FILE_MARGIN_M - 1e-9
    assert 0 <= margin_m < side_m / 2
    below_m = distance_to_obstacles_m(np.pad(np.ones((1, 1), bool), 70), 1.0) * side_m
    below_m = below_m[below_m < step_m * (1 - 1e-9)].max(initial=-side_m)
    assert (
        below_m + side_m / 2 < asked_m + FILE_MARGIN_M + 0.02 * side_m
    )  # no lower step does with half a cell
    assert asked_m <= kept_m(asked_m, side_m) <= asked_m + side_m


def assert_keeps_clear(maps, xyz_m, clearance_m, vertical_clearance_m) -> None:
    """Check every leg, at the lower ends of 20 parts of it, against the squares of the roofs."""
    boxes, roof_m = boxes_of(maps)
    if np.ptp(xyz_m[:, 2]):
        at = np.linspace(0, len(xyz_m) - 1, 20 * (len(xyz_m) - 1) + 1)
        xyz_m = np.column_stack(
            [np.interp(at, np.arange(len(xyz_m)), values) for values in xyz_m.T]
        )
    xyz_m = xyz_m if len(xyz_m) > 1 else np.repeat(xyz_m, 2, axis=0)
    legs = shapely.linestrings(np.stack([xyz_m[:-1, :2], xyz_m[1:, :2]], axis=1))
    over_m = np.minimum(xyz_m[:-1, 2], xyz_m[1:, 2]) - roof_m[:, None]
    away_m = shapely.distance(boxes[:, None], legs)
    assert away_m.min(where=over_m <= vertical_clearance_m, initial=np.inf) >= clearance_m
    assert over_m.min(where=away_m == 0, initial=np.inf) > vertical_clearance_m


def ends_in(maps, is_free) -> list[dict[str, tuple[float, float]]]:
    """Two queries between cells of the largest island of free ones."""
    islands, _ = label(is_free)
    cells = np.argwhere(islands == np.argmax(np.bincount(islands[is_free])))
    return [
        ends_at(maps, *cells[[first, last]])
        for first, last in ((0, -1), (len(cells) // 3, -len(cells) // 5))
    ]


def lonlatz_of(path, folder) -> list[np.ndarray]:
    """Write a path in every format and return what is read."""
    return [read(path.save(folder / f"route{suffix}")) for suffix, read in READERS.items()]


def assert_it_and_its_files_keep_clear(maps, path, folder, **kept) -> None:
    assert_keeps_clear(maps, np.column_stack([path.xy_m, path.z_m]), **kept)
    for lonlatz in lonlatz_of(path, folder):
        assert_keeps_clear(
            maps,
            np.column_stack([*maps.grid.xy_of_lonlat(*lonlatz[:, :2].T), lonlatz[:, 2]]),
            **kept,
        )


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.0, 0.01, 0.05, 0.5]),
    side_m=st.sampled_from([1.0, 2.0, 2.5, 7.0]),
    shape=st.tuples(st.integers(1, 14), st.integers(1, 14)),
)
def test_the_distance_is_that_between_squares_and_to_the_border(seed, share, side_m, shape):
    is_obstacle = np.random.default_rng(seed).random(shape) < share
    found = distance_to_obstacles_m(is_obstacle, side_m)
    rows, cols = shape
    beyond = shapely.difference(
        shapely.box(-99, -99, 99 + cols, 99 + rows), shapely.box(0, 0, cols, rows)
    )
    squares = [
        beyond,
        *(shapely.box(col, row, col + 1, row + 1) for row, col in np.argwhere(is_obstacle)),
    ]
    for row, col in np.ndindex(shape):
        by_hand = shapely.distance(shapely.box(col, row, col + 1, row + 1), squares).min() * side_m
        assert found[row, col] == pytest.approx(by_hand, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("rule", ["touched", "centre"])
@pytest.mark.parametrize("altitude_m", [20.0, 33.0, 60.0])
def test_closed_is_what_lies_nearer_to_a_roof_than_the_step_of_the_clearance_under_either_rule(
    rule, altitude_m
):
    maps = scattered(1)
    own, (boxes, roof_m) = (
        cell_boxes(maps.grid, np.argwhere(np.ones(maps.grid.shape)), 1),
        boxes_of(maps),
    )
    high = shapely.union_all(boxes[roof_m + 4.0 >= altitude_m])
    by_hand = shapely.dwithin(own, high, 4.99).reshape(
        maps.grid.shape
    )  # legs keep the other 2.05 m
    by_hand[[0, -1]] = by_hand[:, [0, -1]] = True  # 0 m from the border
    constraints = ju.Constraints.read(**KEPT)
    assert np.array_equal(constraints.closed(maps.with_obstacles(rule), altitude_m), by_hand)
    assert 0.1 < by_hand.mean() < 0.9


def test_a_vertical_clearance_alone_closes_roofs_that_end_too_near_below_and_no_border():
    maps = scattered(2)
    for least_m, lowest_m in ((8.0, 12.0), (7.5, 12.5), (100.0, 1e-9)):  # bare ground is no roof
        closed = ju.Constraints(vertical_clearance_m=least_m).closed(maps, ALTITUDE_M)
        assert np.array_equal(closed, maps.m("roof_touched") >= lowest_m)


def test_unknown_roofs_and_cells_without_data_are_kept_clear_of():
    maps = scattered(3)
    roof_m, has_data = np.zeros(maps.grid.shape), np.ones(maps.grid.shape, bool)
    roof_m[10, 10], has_data[20, 30] = np.nan, False
    unknown = with_roofs(maps, roof_m, has_data=(("y", "x"), has_data))
    closed = ju.Constraints(clearance_m=3.0, vertical_clearance_m=0.0).closed(unknown, ALTITUDE_M)
    by_hand = np.zeros(maps.grid.shape, bool)
    by_hand[9:12, 9:12] = by_hand[19:22, 29:32] = True
    by_hand[[0, -1]] = by_hand[:, [0, -1]] = True
    assert np.array_equal(closed, by_hand)


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize(("seed", "clearance_m"), [(6, 2.0), (4, 7.0), (5, 5.0)])
@pytest.mark.slow
def test_every_planner_keeps_it_and_every_file_too(planner, seed, clearance_m, tmp_path):
    """Legs keep 2.05, 0.05 and 2.05 m from closed cells, beside 5, 5 and 0 m between squares."""
    kept = KEPT | {"clearance_m": clearance_m}
    maps, constraints = scattered(seed), ju.Constraints.read(**kept)
    num_found = 0
    for altitude_m, refine in ((20.0, False), (33.0, True)):
        on = ju.cost_map(maps, altitude_m, cost_model="line", constraints=constraints)
        for ends in ends_in(maps, on.free_space.to_ground(0)):
            start, goal = (ju.XY(*xy_m) for xy_m in ends.values())
            path = on.plan(start, goal, planner=planner, budget_s=0.3, refine=refine)
            if not path.status.has_path:
                continue
            num_found += 1
            assert sum(path.cost_by_layer.values()) == pytest.approx(path.cost)
            for route in (path, ju.simplify(path, on, 2.5)):
                assert_it_and_its_files_keep_clear(maps, route, tmp_path, **kept)
    assert num_found == 4 or planner == "ptp"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_no_leg_comes_nearer_to_random_outlines_than_is_asked(seed, tmp_path):
    """Whatever is asked, at any angle: theta* and A*, refined and simplified, against the outlines by Shapely."""
    rng, maps = np.random.default_rng(seed), made_maps(40, 50, resolution_m=SIDE_M)
    west, south, east, north = maps.grid.bounds_m
    corners_m = rng.uniform([west, south], [east, north], (14, 1, 2)) + rng.normal(0, 9, (14, 5, 2))
    outlines = shapely.convex_hull(shapely.multipoints(corners_m))
    maps = with_roofs(
        maps, np.where(touched_cells(shapely.union_all(outlines), maps.grid), 60.0, 0.0)
    )
    constraints = ju.Constraints(
        clearance_m=float(rng.choice([0.5, 2.0, 3.0, 4.9, 5.0, 7.0, 7.3, 10.0]))
    )
    on = ju.cost_map(maps, ALTITUDE_M, cost_model="line", constraints=constraints)
    for ends in ends_in(maps, on.is_free):
        start, goal = (ju.XY(*xy_m) for xy_m in ends.values())
        for planner, refine in (("astar-plus", True), ("theta-star", False), ("theta-star", True)):
            path = on.plan(start, goal, planner=planner, refine=refine, budget_s=1.0)
            for route in (path, ju.simplify(path, on, 5.0)):
                file = route.save(tmp_path / "route.geojson")
                x_m, y_m = maps.grid.xy_of_lonlat(*READERS[".geojson"](file)[:, :2].T)
                legs = shapely.LineString(np.column_stack([x_m, y_m]))
                assert shapely.distance(outlines, legs).min() >= constraints.clearance_m
                assert (
                    legs.distance(shapely.box(west, south, east, north).exterior)
                    >= constraints.clearance_m
                )


def test_five_metres_on_cells_of_five_close_what_less_does_and_the_message_names_what_is_really_kept():
    maps = scattered(4)
    closed = {
        asked_m: ju.Constraints(clearance_m=asked_m).closed(maps, ALTITUDE_M)
        for asked_m in (3.0, 5.0, 7.0, 9.6)
    }
    assert np.array_equal(closed[5.0], closed[3.0])
    assert np.array_equal(closed[7.0], closed[3.0])
    assert closed[9.6].sum() > 1.5 * closed[5.0].sum()
    ends = ends_in(maps, ju.Constraints(clearance_m=3.0).is_free(maps, ALTITUDE_M))[0]
    for asked_m, is_said in ((3.0, True), (5.0, False)):
        path = ju.plan(
            maps, **ends, altitude_m=ALTITUDE_M, constraints=ju.Constraints(clearance_m=asked_m)
        )
        for said in (path.to_dict()["message"], rules_said(path.settings)):
            assert ("at least 4.95 m kept on cells of 5 m" in said) == is_said
        assert ("3 m asked" in path.to_dict()["message"]) == is_said


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, 7, 8])
def test_paths_that_climb_keep_it_and_their_files_too(seed, tmp_path):
    maps, constraints = scattered(seed), ju.Constraints.read(**KEPT)
    for ends in ends_in(maps, constraints.is_free_to_ground(maps, LEVELS_M[-1])):
        climbs = {
            "start_altitude_m": 20.0,
            "goal_altitude_m": 60.0,
            "level_step_m": 15.0,
            "climb_cost": 0.0,
        }
        path = plan_volume(maps, **ends, **climbs, constraints=constraints)
        assert path.status is Status.OPTIMAL
        assert np.ptp(path.z_m) == 40
        assert_it_and_its_files_keep_clear(maps, path, tmp_path, **KEPT)


def test_a_path_through_the_corners_of_free_cells_keeps_it_after_rounding(tmp_path):
    maps, kept = (
        scattered(9),
        {"clearance_m": 4.95, "vertical_clearance_m": 2.0},
    )  # and 5 cm more: just one cell
    constraints = ju.Constraints.read(**kept)
    is_free = constraints.is_free(maps, ALTITUDE_M)
    path = ju.plan(
        maps, **ends_in(maps, is_free)[0], altitude_m=ALTITUDE_M, constraints=constraints
    )
    boxes, roof_m = boxes_of(maps)
    high = shapely.union_all(boxes[roof_m + 2.0 >= ALTITUDE_M])
    corners_m = shapely.get_coordinates(cell_boxes(maps.grid, np.argwhere(is_free), 1))
    nearest_m = corners_m[np.argsort(shapely.distance(shapely.points(corners_m), high))[:50]]
    for xy_m in np.stack([nearest_m, nearest_m], axis=1):
        lonlat = np.stack(maps.grid.lonlat_of_xy(*xy_m.T), axis=-1)
        there = replace(path, xy_m=xy_m, lonlat=lonlat, z_m=np.full(2, ALTITUDE_M))
        read_m = maps.grid.xy_of_lonlat(
            *READERS[".geojson"](there.save(tmp_path / "corner.geojson"))[0, :2]
        )
        assert high.distance(shapely.Point(read_m)) >= 4.95


def test_files_round_an_altitude_up_so_that_what_is_just_free_stays_so(tmp_path):
    maps, constraints = scattered(10), ju.Constraints(vertical_clearance_m=8.0)
    assert not constraints.closed(maps, 20.004)[
        maps.m("roof_touched") == 12
    ].any()  # 4 mm more than 8 m over 12 m
    is_free = constraints.is_free(maps, 20.004)
    path = ju.plan(maps, **ends_in(maps, is_free)[0], altitude_m=20.004, constraints=constraints)
    assert all(np.all(lonlatz[:, 2] == 20.01) for lonlatz in lonlatz_of(path, tmp_path))


def test_a_start_too_near_is_told_by_what_and_moved_on_request():
    maps, constraints = scattered(11), ju.Constraints.read(**WIDER)
    is_free, high = constraints.is_free(maps, ALTITUDE_M), maps.m("roof_touched") >= 20
    ends = ends_in(maps, is_free)[0]
    inner = np.argwhere(high[4:36, 4:46] & (maps.m("roof_touched")[4:36, 5:47] == 0))
    row, col = inner[0] + 4
    low = np.argwhere(maps.m("roof_touched") == 18)[0]
    words = "the clearance of 7.5 m and the vertical clearance of 4 m that is kept"
    for cell in ((row, col + 1), low, (1, 1)):  # beside a roof, over one, and near the border
        at = ends | {"start": ju.XY(*maps.grid.xy_of_cell(*cell)), "altitude_m": ALTITUDE_M}
        with pytest.raises(ju.InputError, match=f"start is closed by.*{words}"):
            ju.plan(maps, **at, constraints=constraints)
        assert ju.plan(maps, **at, constraints=constraints, snap=True).status is Status.OPTIMAL


def test_no_path_names_constraints_among_what_may_join():
    maps = scattered(12)
    roof_m = np.zeros(maps.grid.shape)
    roof_m[:, 25] = 80.0
    roof_m[20:22, 25] = 0.0  # a gap of 10 m
    walled, ends = with_roofs(maps, roof_m), ends_at(maps, (20, 5), (20, 44))
    constraints = ju.Constraints.read(clearance_m=6.0)
    message = ju.plan(walled, **ends, altitude_m=ALTITUDE_M, constraints=constraints).to_dict()[
        "message"
    ]
    assert "Constraints were on (clearance of 6 m, vertical clearance of 3 m)" in message
    assert (
        "not joined at a greater altitude of these maps. Looser constraints, finer maps or known heights may join them"
        in message
    )
    between = plan_volume(walled, **ends, constraints=constraints).to_dict()["message"]
    assert "Looser constraints, finer maps or known heights may join them" in between
    assert ju.plan(walled, **ends, altitude_m=ALTITUDE_M).status is Status.OPTIMAL


def test_without_a_clearance_nothing_is_kept_or_closed_and_paths_come_nearer():
    maps = scattered(4)
    none = ju.Constraints(vertical_clearance_m=0.0)
    assert none.to_dict() == {"no_fly": [], "require": [], "unknown_heights": "likely"}
    assert np.array_equal(none.is_free(maps, 20.0), maps.is_free(20.0))
    kept = ju.Constraints.read(**WIDER)
    assert kept.to_dict() == {
        "no_fly": [],
        "require": [],
        **WIDER,
        "unknown_heights": "likely",
    }
    path = ju.plan(maps, **ends_in(maps, kept.is_free(maps, ALTITUDE_M))[0], altitude_m=ALTITUDE_M)
    with pytest.raises(AssertionError):
        assert_keeps_clear(maps, np.column_stack([path.xy_m, path.z_m]), **KEPT)


def test_every_command_that_plans_takes_the_options():
    for name in ("plan", "sensitivity", "tune"):
        command = app.commands[name]
        rules = next(param.type.names for param in command.params if "--rules" in param.opts)
        assert {"clearance_m", "vertical_clearance_m"} <= {*rules}


def test_over_terrain_what_stands_higher_up_the_slope_is_as_high_as_a_path():
    """Heights are compared over the sea, roof by roof: a slope of 30 % with bumps of 2 m."""
    flat, rng = scattered(5), np.random.default_rng(5)
    terrain_m = (0.3 * flat.grid.x_m + rng.uniform(0.0, 2.0, flat.grid.shape)).astype(np.float32)
    maps = ju.MetricMaps(flat.ds.assign(terrain=(("y", "x"), terrain_m)))
    kept = {"clearance_m": 14.0, "vertical_clearance_m": 4.0}
    closed = ju.Constraints.read(**kept).closed(maps, ALTITUDE_M)
    boxes, roof_m = boxes_of(maps)
    top_m = roof_m + terrain_m[maps.m("roof_touched") > 0]
    cells = cell_boxes(maps.grid, np.indices(maps.grid.shape).reshape(2, -1).T, 1)
    flown_m = terrain_m.ravel() + ALTITUDE_M
    is_as_high = top_m[:, None] + kept["vertical_clearance_m"] >= flown_m
    is_near = shapely.distance(boxes[:, None], cells) < kept["clearance_m"]
    must = (is_as_high & is_near).any(axis=0).reshape(maps.grid.shape)
    assert (
        must.sum() > ju.Constraints.read(**kept).closed(flat, ALTITUDE_M)[must].sum()
    )  # flat ground says less
    assert np.all(closed[must])


def test_the_step_of_a_clearance_is_that_among_all_steps_in_little_memory():
    offsets = np.arange(80)
    steps = np.unique(np.hypot(offsets, offsets[:, None]))
    for asked_m in (
        1e-6,
        0.4,
        0.44,
        0.45,
        1.0,
        7.0,
        35.3,
        *np.random.default_rng(0).random(300) * 70,
    ):
        sides = asked_m + FILE_MARGIN_M
        step = float(steps[np.searchsorted(steps, sides - 0.49)])
        assert closing_step_m(asked_m, 1.0) == (step, max(0.0, sides - step))
    tracemalloc.start()
    for asked_m in (3e4, 1e5, 1e8):
        step_m, margin_m = closing_step_m(asked_m, 5.0)
        assert asked_m <= step_m + margin_m <= asked_m + 5.1
    assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    tracemalloc.stop()


def test_a_clearance_beyond_the_maps_closes_them():
    assert ju.Constraints(clearance_m=1e8).closed(scattered(0), ALTITUDE_M).all()
