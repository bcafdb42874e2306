"""Fences of roofs: read back by MAVSDK they cover every roof that reaches the flight, and keep off the mission."""

import json

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.flights.export.roof_fences import MOST_VERTICES, roof_fences
from jaxurban.flights.export.write import write_path
from jaxurban.io.city import City
from jaxurban.io.zone import Zone, cell_boxes
from jaxurban.maps import sources
from jaxurban.world.footprints import Footprints, HeightOrigin
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.mavlink import EXCLUSION, mission_reader
from tests.volumes import made_path, options_of, with_roofs

Z_M, OVER_M = 20.0, 3.0


@pytest.fixture(scope="module")
def reader():
    with mission_reader() as reader:
        yield reader


def read_back(reader, file, grid) -> tuple[shapely.Geometry, shapely.Geometry, int]:
    """Return fences and flown line as MAVSDK reads them, in the maps' CRS, and the number of vertices."""
    assert reader.differences(file) == []
    _, items = reader.items(file)
    assert {item.command for item in items} <= {EXCLUSION}
    rings, at = [], 0
    while at < len(items):
        size = int(items[at].param1)
        lonlat = np.array([[item.y, item.x] for item in items[at : at + size]]) / 1e7
        rings.append(shapely.Polygon(np.column_stack(grid.xy_of_lonlat(*lonlat.T))))
        at += size
    assert all(ring.is_valid for ring in rings)
    _, places = reader.read(file)
    flown = shapely.LineString(np.column_stack(grid.xy_of_lonlat(*places[:, :2].T)))
    return shapely.union_all(rings), flown, len(items)


def box_city(seed: int, grid) -> City:
    """Return 30 boxes askew, 8 to 60 m high, every third height a guess, one with a courtyard."""
    rng = np.random.default_rng(seed)
    low, high = np.array(grid.bounds_m[:2]) + 40, np.array(grid.bounds_m[2:]) - 40
    boxes = []
    for number in range(30):
        x_m, y_m = rng.uniform(low, high)
        box = shapely.box(x_m, y_m, x_m + rng.uniform(8, 50), y_m + rng.uniform(8, 50))
        if number == 0:
            box = box.buffer(20).difference(box.buffer(12))
        boxes.append(shapely.affinity.rotate(box, rng.uniform(0, 90)))
    origin = np.where(np.arange(30) % 3, HeightOrigin.HEIGHT, HeightOrigin.DEFAULT)
    zero = np.zeros(30)
    return City(
        grid.crs,
        grid.bounds_m,
        Footprints(
            np.array(boxes), rng.uniform(8, 60, 30), zero, origin.astype(np.uint8), zero > 0
        ),
    )


def maps_of(city: City) -> ju.MetricMaps:
    """Return made maps with the roofs of a city, by touch."""
    maps = made_maps()
    at = np.argwhere(np.ones(maps.grid.shape, bool))
    cell, building = shapely.STRtree(city.buildings.polygons).query(
        cell_boxes(maps.grid, at, 1), predicate="intersects"
    )
    roof_m = np.zeros(len(at))
    np.maximum.at(roof_m, cell, city.buildings.height_m[building])
    return with_roofs(maps, roof_m.reshape(maps.grid.shape))


def routes_on(maps, seed: int, num: int = 3):
    """Yield planned routes and their simplified forms, at 20 m."""
    on, rng = ju.cost_map(maps, Z_M), np.random.default_rng(seed)
    for _ in range(num):
        start, goal = rng.choice(np.argwhere(on.free_space.to_ground(0)), 2)
        path = on.plan(*(maps.grid.lonlat_of_cell(*cell) for cell in (start, goal)))
        if path.status.has_path and path.length_m > 100:
            yield path
            yield ju.simplify(path, on, 5.0)


def fences_within_limits(path):
    """Return the fences of roofs within 30 m of a path; None where they take too many vertices."""
    try:
        return roof_fences(path, 30.0)
    except ju.InputError as error:
        if f"autopilots hold {MOST_VERTICES}" not in str(error):
            raise
    return None


@pytest.mark.slow
@pytest.mark.parametrize("is_again", [True, False])
def test_fences_cover_the_roofs_that_reach_the_flight_and_keep_off_it(
    is_again, reader, monkeypatch, tmp_path
):
    file, num_tried, num_refused = tmp_path / "a.plan", 0, 0
    for seed in range(6):
        city = box_city(seed, made_maps().grid)
        maps = maps_of(city)
        if is_again:
            monkeypatch.setattr(sources, "city_of", lambda maps, place, city=city: city)
        for path in routes_on(maps, seed):
            fences = fences_within_limits(path)
            if fences is None:
                num_refused += 1
                continue
            write_path(path, file, roofs=fences)
            num_tried += 1
            fences, flown, num_vertices = read_back(reader, file, maps.grid)
            assert num_vertices <= MOST_VERTICES
            ends = shapely.MultiPoint([flown.coords[0], flown.coords[-1]])
            route = shapely.LineString(path.xy_m)
            for way in (flown, ends, route):
                assert fences.is_empty or fences.distance(way) > 0.02
            buildings = city.buildings
            is_near = shapely.dwithin(buildings.polygons, route, 30.0)
            is_near &= buildings.height_m >= Z_M - OVER_M
            note = json.loads(file.read_text())["note"]
            if is_again:
                assert shapely.covers(fences, buildings.polygons[is_near]).all()
                num_guessed = int(buildings.is_guessed[is_near].sum())
                assert f"that reach the flight: {is_near.sum()} (exact outlines)" in note
                assert (f", {num_guessed} of guessed height" in note) == bool(num_guessed)
            else:
                near = shapely.intersection(
                    shapely.union_all(buildings.polygons[is_near]), route.buffer(29.9)
                )
                assert near.is_empty or fences.covers(near)
                assert "(by cells that roofs touch, because maps that were made in memory" in note
    assert num_tried >= 12
    assert num_refused < num_tried


def test_a_fence_grows_only_as_far_as_the_vertices_need_and_keeps_three_metres_if_it_can():
    maps = with_roofs(made_maps(), np.zeros((80, 100)))
    grid = maps.grid
    west, south = grid.x_min_m, grid.y_min_m
    roof_m = np.zeros(grid.shape)
    roof_m[40:44, 50:54] = 30.0
    maps = with_roofs(maps, roof_m)
    x_m = west + np.array([100.0, 900.0])
    path = made_path(grid, np.column_stack([x_m, [south + 390.0] * 2]), Z_M, maps=maps)
    fences = roof_fences(path, 30.0)
    (ring,) = fences.rings
    corners = np.column_stack(grid.xy_of_lonlat(*ring.T))
    edges_m = np.concatenate([corners.min(axis=0), corners.max(axis=0)]) - [west, south] * 2
    np.testing.assert_allclose(
        edges_m, [499.75, 399.75, 540.25, 430.25], atol=0.02
    )  # cells within 30 m
    assert "in 4 vertices; the nearest is 9.8 m from the route." in fences.note
    low = roof_fences(made_path(grid, path.xy_m, 40.0, maps=maps), 30.0)
    assert (low.rings, "flight: 0 (by cells" in low.note) == ([], True)
    beside = np.column_stack([x_m, [south + 399.9] * 2])
    close = roof_fences(made_path(grid, beside, Z_M, maps=maps), 30.0)
    y_m = grid.xy_of_lonlat(*np.concatenate(close.rings).T)[1] - south
    assert 399.95 < y_m.min() < 399.99  # rounded outward alone
    assert "the nearest is 0.1 m from the route" in close.note


def test_a_climb_is_fenced_by_the_height_of_each_leg():
    roof_m = np.zeros((80, 100))
    roof_m[42, 20] = roof_m[42, 70] = 30.0
    maps = with_roofs(made_maps(), roof_m)
    grid = maps.grid
    x_m = grid.x_min_m + np.array([100.0, 400.0, 900.0])
    path = made_path(
        grid,
        np.column_stack([x_m, [grid.y_min_m + 400.0] * 3]),
        np.array([20.0, 60, 60]),
        maps=maps,
    )
    (ring,) = roof_fences(path, 50.0).rings
    middle_m = grid.xy_of_lonlat(*ring.T)[0].mean() - grid.x_min_m
    assert middle_m == pytest.approx(205.0, abs=0.1)


def test_a_roof_that_the_route_meets_is_named_and_not_fenced(tmp_path):
    roof_m = np.zeros((80, 100))
    roof_m[40, 50] = roof_m[44, 60] = 30.0
    maps = with_roofs(made_maps(), roof_m)
    y_m = maps.grid.y_min_m + 405.0
    xy_m = np.column_stack([maps.grid.x_min_m + np.array([100.0, 900.0]), [y_m, y_m]])
    settings = {"resolution_m": 10.0, "time": None, "time_of_day": None}
    path = made_path(maps.grid, xy_m, Z_M, maps=maps, settings=settings)
    (ring,), note = roof_fences(path, 50.0)
    fence_m = np.column_stack(maps.grid.xy_of_lonlat(*ring.T))
    assert shapely.Polygon(fence_m).distance(shapely.LineString(xy_m)) > 10
    assert "that reach the flight: 1 (by cells" in note
    assert "1 that the route itself meets are left out" in note
    with pytest.raises(ju.InputError, match="own check"):
        path.save(tmp_path / "a.plan", fence_roofs_m=50.0)


def test_vertices_of_zones_count_and_too_many_are_refused_with_a_remedy():
    roof_m = np.zeros((80, 100))
    roof_m[42:78:4, 2:98:4] = 30.0  # apart from each other by 30 m
    maps = with_roofs(made_maps(), roof_m)
    grid = maps.grid
    y_m = grid.y_min_m + 400.0
    xy_m = np.column_stack([grid.x_min_m + np.array([10.0, 990.0]), [y_m, y_m]])
    path = made_path(grid, xy_m, Z_M, maps=maps)
    assert sum(map(len, roof_fences(path, 25.0).rings)) <= MOST_VERTICES
    round_zone = shapely.Point(grid.x_min_m + 500, grid.y_min_m + 100).buffer(50)
    zoned = made_path(grid, xy_m, Z_M, maps=maps, zones=(Zone("round", round_zone, grid.crs),))
    with pytest.raises(ju.InputError, match=r"roofs within 25 m.*hold 63.*smaller distance"):
        roof_fences(zoned, 25.0)


@pytest.mark.parametrize("near_m", [0.0, -5.0, float("nan")])
def test_a_distance_that_cannot_be_is_refused(near_m, maps):
    path = made_path(maps.grid, np.array(maps.grid.bounds_m).reshape(2, 2), Z_M, maps=maps)
    with pytest.raises(ju.InputError, match="fence_roofs_m"):
        roof_fences(path, near_m)


def test_fences_are_of_missions_and_of_paths_with_maps_alone(maps, tmp_path):
    path = made_path(maps.grid, np.array(maps.grid.bounds_m).reshape(2, 2), Z_M, maps=maps)
    with pytest.raises(ju.InputError, match="leave end and fence_roofs_m out"):
        path.save(tmp_path / "a.kml", fence_roofs_m=5.0)
    with pytest.raises(ju.InputError, match="needs the maps of the path"):
        made_path(maps.grid, path.xy_m).save(tmp_path / "a.plan", fence_roofs_m=5.0)


def test_the_command_writes_fences_and_says_so(maps, folder, ends, capsys, tmp_path):
    route = ("plan", folder, *options_of(maps, *ends.values()), "--mission", "fence_roofs_m=12")
    code, _, err = run(capsys, *route, "-o", tmp_path / "a.plan")
    assert code == 0, err
    assert "The geofence keeps out of" in err
    assert json.loads((tmp_path / "a.plan").read_text())["geoFence"]["polygons"]
    code, _, err = run(capsys, *route, "-o", tmp_path / "a.kml")
    assert (code, "--mission is of a mission" in err) == (2, True)
