"""Which cells are closed to routes at an altitude, and the first cause that closes each of them."""

from dataclasses import replace

import numpy as np

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.constraints import Bound, Constraints
from jaxurban.paths.path import PlannedPath
from jaxurban.settings import CLEARANCES, Vehicle

# By number, 0 for free cells: a cell has the first of the others that closes it. So what is closed by an unknown height
# would be free if that height were its guess, and what is closed by a clearance would be free without any.
CAUSES = (
    "free",
    "obstacle",
    "no data",
    "touched by an obstacle",
    "vertical clearance",
    "clearance beside",
    "unknown height",
    "zone or bound",
)
OBSTACLE = 1
MUCH = 0.2  # of the cells, closed: routes make detours or find no way


def obstacles_at(maps: MetricMaps, altitude_m: float) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells with an obstacle over their centre at any altitude, by its known or guessed height.

    Examples:
      >>> from jaxurban.paths.closed import obstacles_at
      >>> round(float(obstacles_at(maps, 20.0).mean()), 3)
      0.063
    """
    if altitude_m in maps.altitudes_m:
        is_obstacle = maps.m("obstacle", altitude_m) != 0
    else:
        is_obstacle = ~maps.is_free(altitude_m, "centre")
    return is_obstacle & maps.ds["has_data"].values


def causes_at(
    maps: MetricMaps,
    constraints: Constraints,
    altitude_m: float,
    time: str | None = None,
    time_of_day: str | None = None,
) -> np.ndarray:
    """Return ``[Y, X]`` the cause that closes each cell to routes, as its number in `CAUSES`; 0 where it is free.

    Args:
      maps: the metric maps, under the rule of obstacles of the routes.
      constraints: of the routes; clearances that are left out are as without a scenario.
      altitude_m: of flight, above the ground; with bounds, within the range of the maps.
      time, time_of_day: of the GPS and the population map, for bounds; the first if left out.

    Raises:
      InputError: as for `Constraints.is_free`.

    Examples:
      >>> from jaxurban.paths.closed import CAUSES, causes_at
      >>> CAUSES[causes_at(maps, ju.Constraints(), 20.0)[1, 6]]
      'touched by an obstacle'
    """
    over = Constraints(
        clearance_m=0.0, vertical_clearance_m=constraints.vertical_m, unknown_heights="guess"
    )
    beside = replace(over, clearance_m=constraints.horizontal_m)
    is_free = [  # in the order of `CAUSES`
        np.ones(maps.grid.shape, bool),
        ~obstacles_at(maps, altitude_m),
        maps.is_free(altitude_m, "centre"),
        maps.is_free(altitude_m),
        over.is_free(maps, altitude_m),
        beside.is_free(maps, altitude_m),
        replace(beside, unknown_heights=constraints.of_unknown).is_free(maps, altitude_m),
        constraints.is_free(maps, altitude_m, time=time, time_of_day=time_of_day),
    ]
    return np.argmin(is_free, axis=0)


def constraints_of(path: PlannedPath) -> Constraints:
    """Return the constraints that a path was planned under; its settings leave out a clearance of 0.

    Examples:
      >>> from jaxurban.paths.closed import constraints_of
      >>> print(constraints_of(path))
      vertical clearance of 3 m
    """
    record = path.settings.get("limits", {})
    return Constraints(
        zones=path.zones,
        bounds=tuple(map(Bound.parse, record.get("require", ()))),
        vehicle=Vehicle.of(path.settings),
        unknown_heights=record.get("unknown_heights"),
        above_gps_floor=record.get("above_gps_floor", False),
        **{name: record.get(name, 0.0) for name in CLEARANCES},
    )


def shares_of(causes: np.ndarray) -> dict[str, float]:
    """Return the share of the cells that are free, and that each cause of `causes_at` closes, by name.

    Examples:
      >>> from jaxurban.paths.closed import causes_at, shares_of
      >>> shares = shares_of(causes_at(maps, ju.Constraints(clearance_m=5.0), 20.0))
      >>> {name: round(share, 3) for name, share in shares.items() if share}
      {'free': 0.812, 'obstacle': 0.063, 'touched by an obstacle': 0.099, 'vertical clearance': 0.026}
    """
    shares = np.bincount(causes.ravel(), minlength=len(CAUSES)) / causes.size
    return dict(zip(CAUSES, shares.tolist(), strict=True))


def closed_facts(causes: np.ndarray) -> dict[str, str]:
    """Return which shares of the cells hold an obstacle, are closed, by cause, and are free, in words.

    Examples:
      >>> from jaxurban.paths.closed import causes_at, closed_facts
      >>> closed_facts(causes_at(maps, ju.Constraints(), 20.0))["closed"]
      '18.8% of the cells (obstacle 6.3%, touched by an obstacle 9.9%, vertical clearance 2.6%)'
    """
    shares = shares_of(causes)
    free = shares.pop("free")
    listed = ", ".join(f"{name} {share:.1%}" for name, share in shares.items() if share)
    return {
        "obstacle": f"{shares['obstacle']:.1%} of the cells",
        "closed": f"{1 - free:.1%} of the cells" + f" ({listed})" * bool(listed),
        "free": f"{free:.1%} of the cells",
    }


def closed_note(
    maps: MetricMaps, constraints: Constraints, altitude_m: float, **when: str | None
) -> str:
    """Return which share of the cells is closed to routes and why, if it is more than `MUCH`, and what opens them.

    Args:
      maps, constraints, altitude_m: as for `causes_at`.
      **when: its time and time of day.

    Returns:
      Sentences, ``""`` where less is closed.

    Examples:
      >>> from jaxurban.paths.closed import closed_note
      >>> closed_note(maps, ju.Constraints(), 60.0)
      ''
    """
    causes = causes_at(maps, constraints, altitude_m, **when)
    if np.mean(causes > 0) <= MUCH:
        return ""
    note = f"At {altitude_m:g} m {closed_facts(causes)['closed']} are closed to routes"
    for higher_m in sorted(maps.altitudes_m):
        if higher_m > altitude_m:
            share = 1 - constraints.is_free(maps, higher_m, **when).mean()
            note += f"; at {higher_m:g} m {share:.1%}"
            if share <= MUCH:
                break
    if (causes == CAUSES.index("unknown height")).any():
        note += (
            ". Known heights would open cells: give a table of heights, a surface model or lidar, or set [buildings] "
            "highest_m"
        )
    return f"{note}."
