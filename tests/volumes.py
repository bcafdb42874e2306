"""Scenes and calls that tests of paths share: maps with other roofs, paths by hand, places, options of a command."""

import numpy as np

import jaxurban as ju
from jaxurban.planners.base import Path, Status
from jaxurban.typing import PlannedPath

REGION = {
    "region": {"bounds": (-74.02, 40.70, -73.98, 40.73)},
    "buildings": {"source": "synthetic"},
}
WEIGHTS = ju.Weights(distance=0.2, gps=0.5, lidar=2.0, population=3.0, risk=1.5)
LEVELS = ("min_altitude_m", "max_altitude_m", "level_step_m", "climb_cost", "descent_cost")


def plan_volume(
    maps, *, start, goal, start_altitude_m=None, goal_altitude_m=None, **options
) -> PlannedPath:
    """Return the path of `ju.plan` between levels; options are those of `ju.Levels` and of `ju.plan`."""
    levels = ju.Levels(**{name: options.pop(name) for name in LEVELS if name in options})
    ends = start._replace(altitude_m=start_altitude_m), goal._replace(altitude_m=goal_altitude_m)
    return ju.plan(maps, *ends, altitude_m=levels, **options)


def ends_at(maps, start, goal) -> dict:
    """Return the middles of two cells as arguments of `ju.plan`."""
    middles = {"start": maps.grid.xy_of_cell(*start), "goal": maps.grid.xy_of_cell(*goal)}
    return {name: ju.XY(*xy_m) for name, xy_m in middles.items()}


def options_of(maps, start, goal, altitude_m=20) -> tuple:
    """Return the options by which a command plans between two places."""
    start, goal = (
        "{:.9f},{:.9f}".format(*maps.grid.lonlat_of_xy(*xy_m[:2])) for xy_m in (start, goal)
    )
    return ("--start", start, "--goal", goal, "--altitude", altitude_m)


def with_roofs(maps, roof_m, **more) -> ju.MetricMaps:
    """Return maps with other roofs, ``[rows, cols]`` in metres, the obstacles that they are, and other layers."""
    obstacle = np.stack([roof_m >= z_m for z_m in maps.altitudes_m]).astype(np.uint8)
    roofs = dict.fromkeys(("roof", "roof_touched"), (("y", "x"), roof_m.astype(np.float32)))
    return ju.MetricMaps(
        maps.ds.assign(obstacle=(("altitude", "y", "x"), obstacle), **roofs, **more)
    )


def made_path(
    grid, xy_m, altitude_m=60.0, status=Status.OPTIMAL, planner="astar-plus", note="", **changed
) -> PlannedPath:
    """Return a path that nobody planned, whose altitudes are one or ``[N]``; without one it has no points."""
    xy_m = np.asarray(xy_m, float) if status.has_path else np.empty((0, 2))
    z_m = np.array(np.broadcast_to(altitude_m, len(xy_m)), float)
    sums = (
        {"cost": 1234.56, "length_m": 5678.0}
        if status.has_path
        else {"cost": np.inf, "length_m": np.inf}
    )
    made = {
        "cost_by_layer": {"distance": 234.56, "gps": 1000.0},
        "metrics": {"gps": 0.75, "risk": 0.5},
        "settings": {},
    }
    made |= {
        "lonlat": np.stack(grid.lonlat_of_xy(*xy_m.T), axis=-1),
        "snap_distance_m": (0.0, 0.0),
        "crs": grid.crs,
    }
    made["search"] = Path(status, xy_m, 1.0, -np.inf, 1, 0.1, planner, note=note)
    first_m = float(np.ravel(altitude_m)[0])
    return PlannedPath(
        status=status, xy_m=xy_m, z_m=z_m, altitude_m=first_m, **(sums | made | changed)
    )
