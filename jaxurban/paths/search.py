"""How a path is searched for: what does not change the map."""

from dataclasses import dataclass

import numpy as np

from jaxurban.errors import InputError
from jaxurban.planners.base import Planner
from jaxurban.planners.registry import check_seed, find_planner
from jaxurban.presets import BUDGET_S


@dataclass(frozen=True)
class PathSearch:
    """How a path is searched for: what does not change the map.

    Attributes:
      planner: ``"ptp"``, ``"astar-dist"``, ``"astar-plus"`` ...; left out, ``"astar-plus"``, and in a volume its own.
      heuristic: left out, the planner's own.
      budget_s: seconds that the search may take.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle or closed by a constraint to the nearest free cell instead of
        failing: True by at most 50 m, a number by at most so many metres. The path's message says how far.
      refine: move the waypoints of what the planner found downhill, off the grid (`planners.refine`); within what
        is left of the budget. It takes the ``line`` cost model, or the ``distance`` objective.
    """

    planner: str | None = None
    heuristic: str | None = None
    budget_s: float = BUDGET_S
    seed: int = 0
    snap: bool | float = False
    refine: bool = False

    def find(self, *, is_for_volumes: bool = False) -> Planner:
        """Return the planner.

        Raises:
          InputError: an unknown one, a heuristic that it does not take, a wrong seed or budget.
        """
        check_seed(self.seed)
        name = ("astar-volume" if is_for_volumes else "astar-plus") if self.planner is None else self.planner
        if not isinstance(name, str):
            raise InputError(f"planner must be a name such as 'astar-plus', got {name!r}")
        if not (isinstance(self.budget_s, int | float | np.number) and self.budget_s > 0):
            raise InputError(f"budget_s must be a positive number of seconds, got {self.budget_s!r}")
        if is_for_volumes and self.refine:
            raise InputError("refine moves waypoints on one altitude: leave it out of a path that climbs and descends")
        return find_planner(name, self.heuristic, is_for_volumes=is_for_volumes)
