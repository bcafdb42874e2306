"""Demonstrations from files and from planned paths: taken as they are if they can be, refused in one sentence else."""

import json

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError, LeftOutWarning
from jaxurban.paths.export.write import write_path
from jaxurban.paths.plan import cost_map
from jaxurban.studies.demonstrations import demonstration_from_line, optimal_demonstrations
from jaxurban.studies.montecarlo.sampling import PLACES
from jaxurban.studies.queries import RouteQuery, check_alike
from jaxurban.studies.route_pool import RoutePool
from tests.studies.routes_made import HIDDEN, made_queries, small_maps, thinned, write_geojson


@pytest.fixture(scope="module")
def maps():
    return small_maps()


@pytest.fixture(scope="module")
def demonstrations(maps):
    return optimal_demonstrations(made_queries(cost_map(maps, 20.0), 4), HIDDEN)


def ends_of(maps, demonstrations):
    """Return start and goal of demonstrations in metres."""
    return [[maps.grid.xy_of_cell(*cell) for cell in (each.query.start, each.query.goal)] for each in demonstrations]


def test_routes_come_back_from_a_file_as_they_were(maps, demonstrations, tmp_path):
    read = ju.fit.read_demonstrations(write_geojson(tmp_path / "routes.geojson", demonstrations), maps)
    for one, other in zip(read, demonstrations, strict=True):
        np.testing.assert_array_equal(one.points_m, other.points_m)
        np.testing.assert_allclose(one.features, other.features, rtol=1e-12)
        assert one.note == ""
    assert len({id(each.query.cost_map) for each in read}) == 1


def test_planned_paths_are_demonstrations_of_zero_regret(maps, demonstrations, tmp_path):
    ends = ends_of(maps, demonstrations)
    paths = [ju.plan(maps, start_xy_m=a, goal_xy_m=b, altitude_m=20.0, weights=HIDDEN) for a, b in ends]
    taken = ju.fit.demonstrations_from_paths(paths, maps)
    cheapest = RoutePool([e.query for e in taken]).cheapest(np.tile(_vector(), (4, 1, 1)))[0, :, 0]
    for each, path, best in zip(taken, paths, cheapest, strict=True):
        assert each.features @ _vector() == pytest.approx(path.cost)
        assert best @ _vector() == pytest.approx(path.cost)
    write_path(paths[0], tmp_path / "path.geojson")
    (read,) = ju.fit.read_demonstrations(tmp_path / "path.geojson", maps)
    np.testing.assert_allclose(read.features, taken[0].features, rtol=1e-12)


def test_files_of_paths_bring_their_cost_model_and_their_features(maps, demonstrations, tmp_path):
    (start, goal), *_ = ends_of(maps, demonstrations)
    path = ju.plan(maps, start_xy_m=start, goal_xy_m=goal, altitude_m=20.0, weights=HIDDEN, cost_model="line")
    write_path(path, tmp_path / "path.geojson")
    (read,) = ju.fit.read_demonstrations(tmp_path / "path.geojson", maps)
    assert read.query.cost_map.cost_model.kind == "line"
    assert read.query.cost_map.altitude_m == path.altitude_m
    assert read.features @ HIDDEN.vector(read.query.names) == pytest.approx(path.cost, rel=1e-9)


def test_a_table_of_queries_is_planned_first_and_its_paths_are_taken_at_their_own_cost(maps, tmp_path):
    instances = ju.studies.sample_instances(maps, 6, weights=[HIDDEN], seed=2).query("is_connected")
    queries = instances[[*PLACES, "altitude_m"]]
    paths = ju.plan_many(maps, queries, weights=HIDDEN, cost_model="line", progress=False)
    paths.save(tmp_path / "paths.geojson")
    for read in (
        ju.fit.demonstrations_from_paths(paths, maps),
        ju.fit.read_demonstrations(tmp_path / "paths.geojson", maps),
    ):
        costs = [each.features @ HIDDEN.vector(each.query.names) for each in read]
        np.testing.assert_allclose(costs, [path.cost for path in paths], rtol=1e-9)
    paths.save(tmp_path / "paths.csv")
    with pytest.raises(InputError, match="is a table, which holds no lines: plan its queries first"):
        ju.fit.read_demonstrations(tmp_path / "paths.csv", maps)


def test_a_drawn_line_is_followed_on_the_grid_around_obstacles(maps):
    unit = cost_map(maps, 20.0)
    grid = unit.grid
    free = np.argwhere(unit.is_free)
    a, b = (np.array(grid.xy_of_cell(*map(int, free[k]))) for k in (0, -1))
    drawn = demonstration_from_line(unit, np.array([a, (a + b) / 2 + 3.0, b]), "drawn")
    assert unit.problem.features(drawn.points_m).is_valid
    steps = np.abs(np.diff(drawn.points_m, axis=0)).max(axis=1)
    np.testing.assert_allclose(steps, grid.resolution_m)
    straight_m = np.hypot(*(b - a))
    assert straight_m <= drawn.sums[1, 0] < 1.5 * straight_m


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"altitude_m": None}, "has no altitude"),
        ({"altitude_m": 13.0}, "from 20 to 60 m"),
        ({"altitude_m": "high"}, "number of metres"),
        ({"time_of_day": "noon"}, "day, night"),
    ],
)
def test_routes_on_no_map_are_refused(maps, demonstrations, tmp_path, change, words):
    file = write_geojson(tmp_path / "routes.geojson", demonstrations, **change)
    with pytest.raises(InputError, match=words):
        ju.fit.read_demonstrations(file, maps)
    if change == {"altitude_m": None}:
        assert len(ju.fit.read_demonstrations(file, maps, altitude_m=60.0)) == 4


def test_routes_outside_the_maps_or_nowhere_are_refused(maps, tmp_path):
    def file(*lonlat):
        feature = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": lonlat}}
        (tmp_path / "line.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
        return tmp_path / "line.geojson"

    with pytest.raises(InputError, match="leaves the maps"):
        ju.fit.read_demonstrations(file((-10.0, 40.0), (-10.1, 40.0)), maps, 60.0)
    row, col = np.argwhere(cost_map(maps, 60.0).is_free)[0]
    x_m, y_m = maps.grid.xy_of_cell(int(row), int(col))
    ends = [maps.grid.lonlat_of_xy(x_m + shift, y_m) for shift in (0.0, 2.0)]
    with pytest.raises(InputError, match="one cell"):
        ju.fit.read_demonstrations(file(*[tuple(map(float, end)) for end in ends]), maps, 60.0)
    with pytest.raises(InputError, match=r"metric must be 'gps', .* got 'gsp'"):
        ju.fit.read_demonstrations(file((-10.0, 40.0), (-10.1, 40.0)), maps, 60.0, metrics=["gsp"])


def write_lines(file, maps, *lines_m):
    """Write lines of eastings and northings; return the file."""
    features = [
        {
            "type": "Feature",
            "properties": {},
            "geometry": {
                "type": "LineString",
                "coordinates": np.stack(maps.grid.lonlat_of_xy(*line_m), axis=1).tolist(),
            },
        }
        for line_m in (np.transpose(line) for line in lines_m)
    ]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return file


def test_drawn_lines_start_in_free_cells_near_their_ends_and_those_of_no_use_are_listed(maps, tmp_path):
    unit = cost_map(maps, 20.0)
    walls, (query,) = np.argwhere(~unit.is_free), made_queries(unit, 1)
    inside, start, goal = (maps.grid.xy_of_cell(*map(int, cell)) for cell in (walls[0], query.start, query.goal))
    away = (start[0] - 1e5, start[1])
    file = write_lines(tmp_path / "lines.geojson", maps, (inside, goal), (away, goal), (start, goal))
    left_out = r"1 of 3 lines of '.*' were left out: line 2 \('2', from -7\d\.\d+, 40\.\d+\): it leaves the maps"
    with pytest.warns(LeftOutWarning, match=left_out):
        first, third = ju.fit.read_demonstrations(file, maps, altitude_m=20.0)
    assert unit.is_free[first.query.start]
    assert "The start was not free: it was moved " in first.note
    assert (first.query.name, third.query.name) == ("1", "3")
    assert "not free" not in third.note
    assert min(first.drawn_cells, third.drawn_cells) >= 3.0


def test_a_line_that_starts_far_inside_an_obstacle_names_its_place_and_asks_for_no_altitude(tmp_path):
    maps = small_maps()
    for name in ("roof", "roof_touched"):
        maps.ds[name][5:25, 5:25] = 99.0
    maps.ds["obstacle"][:, 5:25, 5:25] = 1
    inside, goal = (maps.grid.xy_of_cell(*cell) for cell in ((15, 15), (33, 30)))
    file = write_lines(tmp_path / "lines.geojson", maps, (inside, goal))
    with pytest.raises(InputError, match=r"line 1 \('1', from .*\): it starts or ends inside an obstacle") as caught:
        ju.fit.read_demonstrations(file, maps, altitude_m=20.0)
    assert "no free cell is within 50 m of it" in str(caught.value)
    assert "give" not in str(caught.value)


def test_no_route_near_a_line_adds_up_less_than_its_least_features(maps):
    unit = cost_map(maps, 20.0, cost_model="line")
    (shown,) = optimal_demonstrations(made_queries(unit, 1), HIDDEN)
    corner_m = np.array([maps.grid.x_min_m, maps.grid.y_min_m])
    drawn = demonstration_from_line(unit, thinned(shown.points_m) + corner_m)
    assert np.all(drawn.least_features <= np.minimum(drawn.features, shown.features) + 1e-9)
    assert drawn.least_features[0] > 0.9 * shown.features[0]
    np.testing.assert_array_equal(shown.least_features, shown.features)


def test_maps_with_other_units_of_population_are_not_mixed():
    cities = [small_maps(), small_maps()]
    for norm, maps in zip((1e4, 2e4), cities, strict=True):
        maps.ds.attrs["pop_norm_per_km2"] = [norm, norm]
    queries = [query for maps in cities for query in made_queries(cost_map(maps, 20.0), 2)]
    with pytest.raises(InputError, match="normalise"):
        check_alike(queries)
    chosen = [query for maps in cities for query in made_queries(cost_map(maps, 20.0).only(["gps"]), 2)]
    assert check_alike(chosen) == ("distance", "gps")


def test_day_and_night_of_one_city_that_are_normalised_differently_name_the_remedy_of_one_time_of_day():
    maps = small_maps()
    maps.ds.attrs["pop_norm_per_km2"] = [2e4, 3e4]
    days = [cost_map(maps, 20.0, time_of_day=each) for each in maps.times_of_day]
    queries = [RouteQuery(on, (1, 1), (20, 20)) for on in days]
    with pytest.raises(InputError, match="take one time of day"):
        check_alike(queries)
    assert "population" in check_alike(queries[:1])


def test_queries_between_places_name_the_pair_that_is_wrong(maps):
    unit = cost_map(maps, 20.0)
    (query,) = made_queries(unit, 1)
    start, goal = (maps.grid.lonlat_of_cell(*cell) for cell in (query.start, query.goal))
    (made,) = ju.studies.make_queries(unit, [(start, goal)])
    assert (made.start, made.goal) == (query.start, query.goal)
    with pytest.raises(InputError, match="pair 2"):
        ju.studies.make_queries(unit, [(start, goal), (start, (0.0, 0.0))])


def _vector() -> np.ndarray:
    return np.array([HIDDEN.distance, HIDDEN.gps, HIDDEN.lidar, HIDDEN.population, HIDDEN.risk])
