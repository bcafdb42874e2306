"""A straight wall at nine angles, judged by Shapely: no planner enters it, and under the paper's rule planners do."""

from collections.abc import Iterator

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.rasterise import rasterise
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.registry import PLANNERS
from jaxurban.settings import ObstacleRule
from jaxurban.world.footprints import Footprints
from tests.made_maps import made_maps

SIDE = 40  # cells of the region
AWAY = 11  # cells from the wall's middle to start and to goal, on its two sides
HALF_LENGTHS = {"with a way round": 8, "across all": 60}  # cells from the wall's middle to its ends
ALTITUDE_M, HEIGHT_M, ABOVE_M = 20.0, 50.0, 60.0
ANGLES_DEG = np.linspace(0, 90, 9).tolist()
BUDGET_S = 0.1  # of BIT* and of refinement
COMPLETE = {"astar", "astar-dist", "astar-plus", "theta-star"}  # they find a path if there is one


class Wall:
    """A wall of 50 m across the middle of a square region with costs made up, and start and goal on its two sides."""

    def __init__(
        self, angle_deg: float, thickness_m: float, resolution_m: float, half_length: int
    ) -> None:
        maps = made_maps(SIDE, SIDE, (ALTITUDE_M, ABOVE_M), resolution_m)
        grid = maps.grid
        offset = np.random.default_rng([round(10 * angle_deg), round(10 * thickness_m)]).uniform(
            0, 1, 2
        )
        middle_m = np.array([grid.x_min_m, grid.y_min_m]) + (SIDE / 2 + offset) * resolution_m
        along_m = resolution_m * np.array(
            [np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))]
        )
        axis = shapely.LineString(
            [middle_m - half_length * along_m, middle_m + half_length * along_m]
        )
        self.outline = shapely.buffer(axis, thickness_m / 2, cap_style="flat")
        zero = np.zeros(1)
        buildings = Footprints(
            np.array([self.outline]), zero + HEIGHT_M, zero, zero.astype(np.uint8), zero > 0
        )
        roofs = rasterise(ju.City(grid.crs, grid.bounds_m, buildings), grid)
        obstacle = np.stack([roofs.roof_m >= z_m for z_m in maps.altitudes_m]).astype(np.uint8)
        layers = {"roof": roofs.roof_m, "roof_touched": roofs.roof_touched_m, "obstacle": obstacle}
        self.maps = ju.MetricMaps(
            maps.ds.assign({name: (maps.ds[name].dims, m) for name, m in layers.items()})
        )
        across_m = np.array([-along_m[1], along_m[0]])
        self.ends = ju.XY(*(middle_m - AWAY * across_m)), ju.XY(*(middle_m + AWAY * across_m))

    def inside_m(self, path: PlannedPath) -> float:
        """Return the length of a path inside the outline, below the roof; a climb is taken at its lower end."""
        is_low = np.minimum(path.z_m[:-1], path.z_m[1:]) <= HEIGHT_M
        segments = shapely.linestrings(np.stack([path.xy_m[:-1], path.xy_m[1:]], axis=1)[is_low])
        return float(shapely.length(shapely.intersection(segments, self.outline)).sum())

    def flat_paths(self, obstacles: ObstacleRule) -> Iterator[tuple[str, PlannedPath]]:
        """Yield the paths of every planner, as it is and refined, where there are any."""
        flat = ju.cost_map(self.maps.with_obstacles(obstacles), ALTITUDE_M, cost_model="line")
        for planner in PLANNERS:
            for refine in (False, True):
                budget_s = 10.0 if planner in COMPLETE and not refine else BUDGET_S
                path = flat.plan(*self.ends, planner=planner, budget_s=budget_s, refine=refine)
                if path.status.has_path:
                    yield planner, path

    def volume_path(self, top_m: float) -> PlannedPath:
        """Return the path through the volume up to an altitude."""
        volume = ju.cost_map(self.maps, ju.Levels(max_altitude_m=top_m), cost_model="line")
        return volume.plan(*(place._replace(altitude_m=ALTITUDE_M) for place in self.ends))


def check_no_planner_enters(wall: Wall, is_open: bool) -> None:
    found = list(wall.flat_paths("touched"))
    inside_m = {planner: wall.inside_m(path) for planner, path in found}
    assert max(inside_m.values(), default=0.0) <= 1e-6, inside_m
    assert inside_m.keys() >= COMPLETE if is_open else not inside_m
    around, over = wall.volume_path(ALTITUDE_M), wall.volume_path(ABOVE_M)
    assert around.status.has_path is is_open
    assert over.status.has_path
    assert is_open or max(over.z_m) == ABOVE_M
    for path in (around, over):
        assert not path.status.has_path or wall.inside_m(path) <= 1e-6


@pytest.mark.parametrize(("angle_deg", "kind"), [(22.5, "with a way round"), (67.5, "across all")])
def test_no_planner_enters_a_wall(angle_deg, kind):
    check_no_planner_enters(
        Wall(angle_deg, 4.5, 5.0, HALF_LENGTHS[kind]), kind == "with a way round"
    )


@pytest.mark.slow
@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_no_planner_enters_a_wall_of_any_angle_and_thickness(angle_deg, turn):
    thickness_m = (4.5, 6.5, 8.0)[
        (turn + ANGLES_DEG.index(angle_deg)) % 3
    ]  # each with every size of cells in turn
    for kind, half_length in HALF_LENGTHS.items():
        wall = Wall(angle_deg, thickness_m, (2.0, 5.0, 10.0)[turn], half_length)
        check_no_planner_enters(wall, kind == "with a way round")


def test_by_centres_of_cells_planners_cut_a_wall_at_45_degrees():
    wall = Wall(45.0, 4.5, 5.0, HALF_LENGTHS["with a way round"])
    through = {planner for planner, path in wall.flat_paths("centre") if wall.inside_m(path) > 1.0}
    assert through >= COMPLETE
