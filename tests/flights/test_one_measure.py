"""One flight, one measure: a route by its report, the viewer and `check`, and a mission against places every 5 cm."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.flights.missions.parts import Leg, Mission, Place
from jaxurban.io.zone import cell_boxes
from jaxurban.paths.route_report import short
from jaxurban.viewer.requests import Plan, parse
from jaxurban.viewer.viewer import TOTALS, Viewer
from tests.made_maps import made_maps
from tests.volumes import ends_at

FINE_M = 0.05
NUM_ROUTES = 10


@pytest.fixture(scope="module")
def hills() -> ju.MetricMaps:
    """Maps over hills of 30 m."""
    maps = made_maps(altitudes_m=(20.0, 60.0, 120.0))
    y, x = np.indices(maps.grid.shape) * maps.grid.resolution_m
    ground_m = 15.0 * (np.sin(x / 90.0) * np.cos(y / 120.0) + 1.0)
    terrain = (("y", "x"), ground_m.astype(np.float32))
    return replace(maps, ds=maps.ds.assign(terrain=terrain))


def routes_on(maps, num: int):
    """Yield random routes, at altitudes of the maps and between them."""
    rng = np.random.default_rng(5)
    for turn in range(num):
        altitude_m = (20.0, 60.0, 43.0)[turn % 3]
        free = np.argwhere(maps.is_free(altitude_m))
        ends = ends_at(maps, *rng.choice(free, 2, replace=False))
        path = ju.plan(maps, altitude_m=altitude_m, **ends)
        if path.status.has_path:
            yield path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["town", "hills"])
def test_a_route_is_as_long_as_near_and_as_risky_by_whatever_door(name, request, tmp_path):
    maps = request.getfixturevalue(name)
    num_without_fix = num = 0
    for path in routes_on(maps, NUM_ROUTES):
        totals = ju.explain(path, maps).totals
        path.save(tmp_path / "x.kml")
        for mission in (path, tmp_path / "x.kml"):
            figures = ju.check(maps, mission).figures
            for figure in ("length_m", "people_overflown", "no_fix_m", "nearest_wall_m"):
                assert figures[figure] == pytest.approx(totals[figure], abs=1.0), figure
            over_m = figures.get("least_over_roofs_m", np.nan)
            assert over_m == pytest.approx(totals["least_over_roofs_m"], abs=1.0, nan_ok=True)
        num_without_fix += totals["no_fix_m"] > 1
        num += 1
    assert num >= NUM_ROUTES - 2
    assert num_without_fix or name == "town"


def test_the_viewers_panel_holds_the_numbers_of_the_check(hills):
    path = next(routes_on(hills, 1))
    viewer = Viewer(hills)
    start, goal = path.lonlat[[0, -1]].tolist()
    weights = {"distance": 1.0, "gps": 1.0, "lidar": 1.0, "population": 1.0, "risk": 1.0}
    query = {"start": start, "goal": goal, "at": [0, 0, 0], "weights": weights}
    panel = json.loads(viewer.answer("report", query).body)["totals"]
    request = parse(Plan, query)
    planned = viewer.plans.route(request, viewer.flight(request))
    figures = ju.check(hills, planned).figures
    labels = {name: name.replace("_", " ") for name in figures}
    shown = {name: label for name, label in labels.items() if label in TOTALS}
    for name, label in shown.items():
        assert f"<td>{label}</td><td>{short(figures[name])}" in panel
    assert {"no_fix_m", "people_overflown", "nearest_wall_m"} <= {*shown}


class Fine:
    """Points every 5 cm along a mission over level ground: what they meet, one by one."""

    def __init__(self, maps, corners_m):
        self.maps = maps
        rows = []
        for begin, end in pairwise(np.asarray(corners_m, float)):
            num = max(int(np.ceil(np.linalg.norm(end - begin) / FINE_M)), 1)
            share = (np.arange(num) + 0.5)[:, None] / num
            part_m = np.linalg.norm(end - begin) / num
            over_m = np.linalg.norm((end - begin)[:2]) / num
            rows.append(np.column_stack([begin + share * (end - begin), [[part_m, over_m]] * num]))
        self.x_m, self.y_m, self.z_m, self.part_m, self.over_m = np.concatenate(rows).T
        self.row, self.col = (
            (places // maps.grid.resolution_m).astype(int) for places in (self.y_m, self.x_m)
        )

    def has_fix(self) -> np.ndarray:
        """Return, point by point, 1 with a fix, 0 without one, NaN where it is not known."""
        levels_m, seen = self.maps.altitudes_m, []
        hdops = {level_m: self.maps.m("hdop", level_m) for level_m in levels_m}
        roof_m = self.maps.m("roof")
        for row, col, z_m in zip(self.row, self.col, self.z_m, strict=True):
            near = [level_m for level_m in levels_m if abs(level_m - z_m) <= 1.0]
            around = near or [
                max((level_m for level_m in levels_m if level_m < z_m), default=None),
                min((level_m for level_m in levels_m if level_m > z_m), default=None),
            ]
            if None in around:
                seen.append(np.nan)
                continue
            if len(around) == 2 and roof_m[row, col] >= around[0] > 0:
                around = around[1:]
            hdop = [hdops[level_m][row, col] for level_m in around]
            seen.append(float(np.isfinite(hdop).all()))
        return np.array(seen)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_figures_are_those_of_places_every_five_centimetres(seed):
    maps = made_maps(altitudes_m=(20.0, 60.0, 120.0))
    rng = np.random.default_rng(seed)
    corners_m = rng.uniform((5, 5, 15), (995, 795, 130), (7, 3)).round(1)
    corners_m[1:4, 2] = (20.0, 60.0, 60.0)  # level, too
    corner_m = maps.grid.bounds_m[:2]
    lonlat = maps.grid.lonlat_at(corners_m[:, :2] + corner_m)
    places = [
        Place(lon, lat, z_m, "ground")
        for (lon, lat), z_m in zip(lonlat, corners_m[:, 2], strict=True)
    ]
    legs = tuple(Leg(*pair, "leg", number) for number, pair in enumerate(pairwise(places), 1))
    figures = ju.check(maps, Mission("made", legs, None, None, (), None)).figures

    fine = Fine(maps, corners_m)
    assert figures["length_m"] == pytest.approx(fine.part_m.sum(), abs=0.01)
    density = maps.m("density")[fine.row, fine.col].astype(float)
    people = (density * fine.over_m).sum() * 10.0 / 1e6
    assert figures["people_overflown"] == pytest.approx(people, abs=0.05)
    has_fix = fine.has_fix()
    # Heights are those of the middles of steps of half a metre.
    assert figures["no_fix_m"] == pytest.approx(fine.part_m[has_fix == 0].sum(), abs=1.0)
    assert figures["fix_unknown_m"] == pytest.approx(fine.part_m[np.isnan(has_fix)].sum(), abs=1.0)

    roof_m = maps.m("roof_touched")[fine.row, fine.col]
    over_m = (fine.z_m - roof_m)[roof_m > 0].min()
    assert figures["least_over_roofs_m"] == pytest.approx(over_m, abs=0.5)
    roofs = np.argwhere(maps.m("roof_touched") > 0)
    boxes = cell_boxes(maps.grid, roofs, 1)
    height_m = maps.m("roof_touched")[tuple(roofs.T)]
    nearest_m = np.inf
    points = shapely.points(fine.x_m + corner_m[0], fine.y_m + corner_m[1])
    for level_m in np.unique(height_m):
        low = fine.z_m <= level_m
        walls = shapely.union_all(boxes[height_m == level_m])
        shapely.prepare(walls)
        nearest_m = min(nearest_m, shapely.distance(points[low], walls).min(initial=np.inf))
    # It may be that of a height less than the flight's, where there are many heights.
    assert figures["nearest_wall_m"] <= nearest_m + 0.1
