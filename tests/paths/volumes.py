"""Paths between levels, for tests that give places in metres and altitudes apart."""

import jaxurban as ju

LEVELS = ("min_altitude_m", "max_altitude_m", "level_step_m", "climb_cost", "descent_cost")


def plan_volume(
    maps, *, start_xy_m, goal_xy_m, start_altitude_m=None, goal_altitude_m=None, **options
) -> ju.PlannedPath:
    """Return the path of `ju.plan` between levels; options are those of `ju.Levels` and of `ju.plan`."""
    levels = ju.Levels(**{name: options.pop(name) for name in LEVELS if name in options})
    ends = {"start_xy_m": (*start_xy_m, start_altitude_m), "goal_xy_m": (*goal_xy_m, goal_altitude_m)}
    return ju.plan(maps, altitude_m=levels, **ends, **options)
