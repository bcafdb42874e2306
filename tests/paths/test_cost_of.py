"""What a line costs on a cost map: equal to the cost of a path, and to a sum of our own over the cells of a mission."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.paths.closed import CAUSES
from jaxurban.typing import CostMap
from tests.made_maps import made_maps

MAPS = made_maps(36, 40)
WEIGHTS = {"distance": 0.2, "gps": 1.0, "lidar": 2.0, "population": 0.5, "risk": 3.0}


def a_map(**given) -> CostMap:
    return ju.cost_map(MAPS, 20.0, weights=WEIGHTS, **given)


def places(num: int, seed: int) -> np.ndarray:
    """Return ``[num, 2]`` random eastings and northings within the maps."""
    west, south, east, north = MAPS.grid.bounds_m
    rng = np.random.default_rng(seed)
    return rng.uniform((west + 1, south + 1), (east - 1, north - 1), (num, 2))


def waypoints_file(file: Path, xy_m: np.ndarray) -> Path:
    """Write a mission of waypoints 30 m above home, which is the first of them."""
    rows = [(0, 16, 0.0), *((3, 16, 30.0) for _ in xy_m)]
    lines = ["QGC WPL 110"]
    lonlat = MAPS.grid.lonlat_at(np.vstack([xy_m[:1], xy_m]))
    for number, ((frame, command, z_m), (lon, lat)) in enumerate(zip(rows, lonlat, strict=True)):
        head = f"{number}\t{int(number == 0)}\t{frame}\t{command}\t0\t0\t0\t0"
        lines.append(f"{head}\t{lat:.13f}\t{lon:.13f}\t{z_m}\t1")
    file.write_text("\n".join(lines) + "\n")
    return file


def own_sum(cost_map: CostMap, xy_m: np.ndarray) -> tuple[float, float]:
    """Return the cost of a line and its metres in closed cells, by the square of every cell that Shapely cuts it by."""
    grid = cost_map.grid
    rows, cols = np.indices(grid.shape)
    x_m = grid.x_min_m + cols * grid.resolution_m
    y_m = grid.y_min_m + rows * grid.resolution_m
    squares = shapely.box(x_m, y_m, x_m + grid.resolution_m, y_m + grid.resolution_m)
    lines = [shapely.LineString(pair) for pair in pairwise(xy_m)]
    inside_m = sum(shapely.length(shapely.intersection(squares, line)) for line in lines)
    per_metre = np.full(grid.shape, WEIGHTS["distance"])
    for name, costs in zip(cost_map.names, cost_map.costs, strict=True):
        per_metre += WEIGHTS[name] * costs / cost_map.cost_model.reference_length_m
    return float((inside_m * per_metre).sum()), float(inside_m[~cost_map.is_free].sum())


@pytest.mark.slow
@pytest.mark.parametrize("cost_model", ["line", "cell"])
def test_a_path_costs_what_its_planner_says(cost_model):
    cost_map = a_map(cost_model=cost_model)
    ends = [(ju.XY(*a), ju.XY(*b)) for a, b in places(200, 1).reshape(-1, 2, 2)]
    planners = ("astar", "theta-star") if cost_model == "line" else ("astar",)
    found = 0
    for planner in planners:
        for start, goal in ends:
            path = cost_map.plan(start, goal, planner=planner, snap=200.0)
            if path.status.has_path:
                found += 1
                line = cost_map.cost_of(path)
                assert line.cost == pytest.approx(path.cost, rel=1e-12)
                assert line.cost_by_layer == pytest.approx(path.cost_by_layer)
                assert line.metrics == pytest.approx(path.metrics)
                assert line.is_free
                assert not any(line.closed_m.values())
    assert found == 100 * len(planners)


@pytest.mark.slow
def test_a_mission_costs_what_we_add_up_cell_by_cell_over_closed_ones_too(tmp_path):
    cost_map = a_map()
    num_closed = 0
    for seed in range(50):
        xy_m = places(6, 100 + seed)
        line = cost_map.cost_of(waypoints_file(tmp_path / "a.waypoints", xy_m))
        cost, closed_m = own_sum(cost_map, xy_m)
        assert line.cost == pytest.approx(cost, rel=1e-6)
        assert sum(line.closed_m.values()) == pytest.approx(closed_m, abs=1e-3)
        assert line.is_free == (closed_m == 0)
        num_closed += closed_m > 0
    assert num_closed > 25


def test_what_closes_a_line_is_named_and_a_line_beside_a_wall_keeps_no_clearance():
    is_roof = np.argwhere(~MAPS.is_free(20.0, "centre"))
    row, col = is_roof[len(is_roof) // 2]
    across = [MAPS.grid.lonlat_of_cell(row, c) for c in (col - 2, col)]
    line = a_map().cost_of(across)
    assert line.closed_m["obstacle"] > 0
    assert not line.is_free
    near = a_map(constraints=ju.Constraints(clearance_m=12.0)).cost_of(across)
    assert near.cost == line.cost
    assert sum(near.closed_m.values()) > sum(line.closed_m.values())
    assert [*line.closed_m] == [*CAUSES[1:]]


def test_lines_that_have_no_cost_say_so(tmp_path):
    cost_map = a_map()
    west, south, east, north = MAPS.grid.bounds_m
    away = MAPS.grid.lonlat_at(np.array([[west, south], [east + 500, north]]))
    with pytest.raises(ju.InputError, match="is outside the region"):
        cost_map.cost_of(away)
    with pytest.raises(ju.InputError, match="does not exist"):
        cost_map.cost_of(tmp_path / "none.plan")
    lonlat = MAPS.grid.lonlat_at(places(3, 1))
    way = [(*place, 30.0) for place in lonlat.tolist()]
    line = {"type": "LineString", "coordinates": way}
    file = tmp_path / "way.geojson"
    file.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": line}))
    found = cost_map.cost_of(file)  # not asked what its heights are above
    assert found.cost == pytest.approx(cost_map.cost_of(lonlat).cost, rel=1e-9)
    assert "the climb from home is not judged" in found.notes[0]
    with pytest.raises(ju.InputError, match=r"a path must be \[N, 3\] here"):
        ju.cost_map(MAPS, ju.Levels()).cost_of(lonlat)
