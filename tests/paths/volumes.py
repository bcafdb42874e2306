"""Scenes and calls that tests of paths share: maps with other roofs, places in metres, options of a command."""

import numpy as np

import jaxurban as ju

LEVELS = ("min_altitude_m", "max_altitude_m", "level_step_m", "climb_cost", "descent_cost")


def plan_volume(
    maps, *, start_xy_m, goal_xy_m, start_altitude_m=None, goal_altitude_m=None, **options
) -> ju.PlannedPath:
    """Return the path of `ju.plan` between levels; options are those of `ju.Levels` and of `ju.plan`."""
    levels = ju.Levels(**{name: options.pop(name) for name in LEVELS if name in options})
    ends = {"start_xy_m": (*start_xy_m, start_altitude_m), "goal_xy_m": (*goal_xy_m, goal_altitude_m)}
    return ju.plan(maps, altitude_m=levels, **ends, **options)


def ends_at(maps, start, goal) -> dict:
    """Return the middles of two cells as arguments of `ju.plan`."""
    return {"start_xy_m": maps.grid.xy_of_cell(*start), "goal_xy_m": maps.grid.xy_of_cell(*goal)}


def options_of(maps, start_xy_m, goal_xy_m, altitude_m=20) -> tuple:
    """Return the options by which a command plans between two places."""
    start, goal = ("{:.9f},{:.9f}".format(*maps.grid.lonlat_of_xy(*xy_m)) for xy_m in (start_xy_m, goal_xy_m))
    return ("--start", start, "--goal", goal, "--altitude", altitude_m)


def with_roofs(maps, roof_m, **more) -> ju.MetricMaps:
    """Return maps with other roofs, ``[rows, cols]`` in metres, the obstacles that they are, and other layers."""
    obstacle = np.stack([roof_m >= z_m for z_m in maps.altitudes_m]).astype(np.uint8)
    roofs = dict.fromkeys(("roof", "roof_touched"), (("y", "x"), roof_m.astype(np.float32)))
    return ju.MetricMaps(maps.ds.assign(obstacle=(("altitude", "y", "x"), obstacle), **roofs, **more))
