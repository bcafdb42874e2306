"""Demonstrations from files and from planned paths: taken as they are where possible, drawn on the grid else."""

import json

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.errors import SkippedRouteWarning
from jaxurban.flights.export.write import write_path
from jaxurban.io.routes import read_routes
from jaxurban.paths.queries import IN_METRES
from jaxurban.studies.demonstrations import demonstration_from_line, optimal_demonstrations
from jaxurban.studies.queries import check_alike
from jaxurban.studies.route_pool import RoutePool
from tests.studies.routes_made import HIDDEN, made_queries, thinned, write_geojson, write_lines


@pytest.fixture(scope="module")
def unit(small):
    return ju.cost_map(small, 20.0)


@pytest.fixture(scope="module")
def shown(unit):
    return optimal_demonstrations(made_queries(unit, 4), HIDDEN)


def cost_of(each) -> float:
    return each.features @ HIDDEN.vector(each.query.names)


def test_routes_come_back_from_a_file_as_they_were(small, shown, tmp_path):
    read = ju.fit.demonstrations(write_geojson(tmp_path / "routes.geojson", shown), small)
    for one, other in zip(read, shown, strict=True):
        np.testing.assert_array_equal(one.points_m, other.points_m)
        np.testing.assert_allclose(one.features, other.features, rtol=1e-12)
        assert one.note == ""
    assert len({id(each.query.cost_map) for each in read}) == 1
    file = write_geojson(tmp_path / "routes.geojson", shown, altitude_m=None)
    assert len(ju.fit.demonstrations(file, small, altitude_m=60.0)) == 4


def test_planned_paths_are_demonstrations_of_zero_regret_and_their_files_bring_cost_model_and_features(
    small, tmp_path
):
    instances = ju.studies.sample_instances(small, 6, weights=[HIDDEN], seed=2).query(
        "is_connected"
    )
    queries = instances[[*IN_METRES, "altitude_m"]]
    paths = ju.plan_many(small, queries, weights=HIDDEN, cost_model="line", progress=False)
    costs, taken = [path.cost for path in paths], ju.fit.demonstrations(paths, small)
    weights = HIDDEN.vector(taken[0].query.names)
    cheapest = RoutePool([each.query for each in taken]).cheapest(
        np.tile(weights, (len(taken), 1, 1))
    )[0, :, 0]
    np.testing.assert_allclose(cheapest @ weights, costs, rtol=1e-6)
    read = ju.fit.demonstrations(paths.save(tmp_path / "paths.geojson"), small)
    for demonstrations in (taken, read):
        np.testing.assert_allclose([cost_of(each) for each in demonstrations], costs, rtol=1e-9)
    write_path(paths[0], tmp_path / "path.geojson")
    (read,) = ju.fit.demonstrations(tmp_path / "path.geojson", small)
    np.testing.assert_allclose(read.features, taken[0].features, rtol=1e-12)
    assert (read.query.cost_map.cost_model.kind, read.query.cost_map.altitude_m) == (
        "line",
        paths[0].altitude_m,
    )


def test_a_drawn_line_is_followed_on_the_grid_around_obstacles_in_the_narrowest_corridor(unit):
    free = np.argwhere(unit.is_free)
    a, b = (np.array(unit.grid.xy_of_cell(*map(int, free[k]))) for k in (0, -1))
    line_m, corner_m = (
        np.array([a, (a + b) / 2 + 3.0, b]),
        np.array([unit.grid.x_min_m, unit.grid.y_min_m]),
    )
    drawn = demonstration_from_line(unit, line_m, "drawn")
    assert unit.problem.features(drawn.points_m).is_valid
    np.testing.assert_allclose(
        np.abs(np.diff(drawn.points_m, axis=0)).max(axis=1), unit.grid.resolution_m
    )
    straight_m = np.hypot(*(b - a))
    assert straight_m <= drawn.sums[1, 0] < 1.5 * straight_m
    assert (
        15.0
        < shapely.distance(
            shapely.points(drawn.points_m + corner_m), shapely.LineString(line_m)
        ).max()
        <= 30.0
    )
    assert drawn.note.startswith("followed within 30 m")  # corridors are of 15, 30 and 60 m


def test_features_without_a_shape_are_no_routes_whatever_their_properties(tmp_path):
    line = {"type": "LineString", "coordinates": [[-74.0, 40.7], [-74.0, 40.71]]}
    features = [
        {"type": "Feature", "properties": properties, "geometry": shape}
        for shape in (line, None)
        for properties in ({}, {"note": {"a": 0}}, {"number": 1.5})
    ]
    file = tmp_path / "routes.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    with pytest.warns(SkippedRouteWarning, match="3 of the features of .* are not lines"):
        assert [route.name for route in read_routes(file)] == ["1", "2", "3"]


def test_drawn_lines_start_in_free_cells_near_their_ends_and_those_of_no_use_are_listed(
    small, unit, tmp_path
):
    walls, (query,) = np.argwhere(~unit.is_free), made_queries(unit, 1)
    inside, start, goal = (
        small.grid.xy_of_cell(*map(int, cell)) for cell in (walls[0], query.start, query.goal)
    )
    away = (start[0] - 1e5, start[1])
    file = write_lines(
        tmp_path / "lines.geojson", small, (inside, goal), (away, goal), (start, goal)
    )
    left_out = r"1 of 3 routes of '.*' could not be used: line 2 \('2', from -7\d\.\d+, 40\.\d+\): it leaves the maps"
    with pytest.warns(SkippedRouteWarning, match=left_out):
        first, third = ju.fit.demonstrations(file, small, altitude_m=20.0)
    assert unit.is_free[first.query.start]
    assert "The start was not free: it was moved " in first.note
    assert (first.query.name, third.query.name) == ("1", "3")
    assert "not free" not in third.note
    assert min(first.drawn_cells, third.drawn_cells) >= 3.0


def test_no_route_near_a_line_adds_up_less_than_its_least_features(small):
    unit = ju.cost_map(small, 20.0, cost_model="line")
    (shown,) = optimal_demonstrations(made_queries(unit, 1), HIDDEN)
    corner_m = np.array([small.grid.x_min_m, small.grid.y_min_m])
    drawn = demonstration_from_line(unit, thinned(shown.points_m) + corner_m)
    assert np.all(drawn.least_features <= np.minimum(drawn.features, shown.features) + 1e-9)
    assert drawn.least_features[0] > 0.9 * shown.features[0]
    np.testing.assert_array_equal(shown.least_features, shown.features)


def test_queries_lie_between_places_and_go_together_where_no_population_is_weighed(unit):
    (query,) = made_queries(unit, 1)
    places = [unit.grid.lonlat_of_cell(*cell) for cell in (query.start, query.goal)]
    (made,) = ju.studies.make_queries(unit, [tuple(places)])
    assert (made.start, made.goal) == (query.start, query.goal)
    assert "population" in check_alike([query])
    doubled = ju.MetricMaps(unit.maps.ds.assign_attrs(pop_norm_per_km2=[2e4, 2e4]))
    chosen = [
        made_queries(ju.cost_map(maps, 20.0).only(["gps"]), 1)[0] for maps in (unit.maps, doubled)
    ]
    assert check_alike(chosen) == ("distance", "gps")
