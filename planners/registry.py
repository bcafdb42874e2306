"""The planners by name: those that stay on one altitude, and those that fly between levels."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from jaxurban.errors import InputError, nearest_name
from jaxurban.planners.any_angle import ptp, theta_star
from jaxurban.planners.astar import astar_dist, astar_plus, volume_astar
from jaxurban.planners.base import Path, Planner
from jaxurban.planners.bitstar.bounds import HEURISTICS as OFF_GRID_HEURISTICS
from jaxurban.planners.bitstar.planner import bitstar_dist, bitstar_plus
from jaxurban.planners.bounds import AUTO, HEURISTICS, VOLUME_HEURISTICS


@dataclass(frozen=True)
class PlannerEntry:
    """A planner and the heuristics that it takes.

    Attributes:
      run: the planner; takes ``heuristic=`` beside the contract's arguments if it has heuristics.
      summary: one line for help texts and tables.
      default_heuristic: ``"none"`` for a planner that uses none.
      heuristics: names it accepts as ``heuristic=``; empty for a planner that uses none.
    """

    run: Callable[..., Path]
    summary: str
    default_heuristic: str = "none"
    heuristics: tuple[str, ...] = ()


PLANNERS = {
    "ptp": PlannerEntry(ptp, "the straight segment from start to goal"),
    "astar-dist": PlannerEntry(astar_dist, "A* guided by the straight distance", "euclidean", (AUTO, *HEURISTICS)),
    "astar-plus": PlannerEntry(astar_plus, "A* guided by distance and map costs", AUTO, (AUTO, *HEURISTICS)),
    "bitstar-dist": PlannerEntry(
        bitstar_dist, "batch informed trees guided by the straight distance", "euclidean", OFF_GRID_HEURISTICS
    ),
    "bitstar-plus": PlannerEntry(
        bitstar_plus, "batch informed trees guided by distance and map costs", "plus", OFF_GRID_HEURISTICS
    ),
    "theta-star": PlannerEntry(
        theta_star, "any-angle search, for the line cost model only", "plus", OFF_GRID_HEURISTICS
    ),
}
VOLUME_PLANNERS = {
    "astar-volume": PlannerEntry(
        volume_astar, "A* between levels, for paths that climb and descend", "plus", VOLUME_HEURISTICS
    ),
}


def find_planner(name: str, heuristic: str | None = None, *, is_for_volumes: bool = False) -> Planner:
    """Return the planner of a name, with its own heuristic or the one given.

    Args:
      name: of `PLANNERS`, or of `VOLUME_PLANNERS`.
      heuristic: left out, the planner's own.
      is_for_volumes: it must fly between levels, else on one altitude.

    Raises:
      InputError: an unknown planner, or a heuristic that it does not take.
    """
    fitting = VOLUME_PLANNERS if is_for_volumes else PLANNERS
    if name not in fitting:
        where = "in a volume" if is_for_volumes else "on one altitude"
        is_known = name in PLANNERS or name in VOLUME_PLANNERS
        known = f"planner {name!r} does not fly {where}" if is_known else f"unknown planner {name!r}"
        raise InputError(f"{known}{nearest_name(name, fitting)}: choose one of {', '.join(fitting)}")
    entry = fitting[name]
    if heuristic is None:
        return entry.run
    if heuristic not in entry.heuristics:
        accepted = f"choose one of {', '.join(entry.heuristics)}" if entry.heuristics else "leave it out"
        raise InputError(
            f"planner {name!r} takes no heuristic {heuristic!r}{nearest_name(heuristic, entry.heuristics)}: {accepted}"
        )
    return partial(entry.run, heuristic=heuristic)
