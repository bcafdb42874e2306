"""PathSearch: how a path is searched for, and which budgets of exposure it keeps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from jaxurban.checks import at_least, finite, typed, values_given
from jaxurban.errors import InputError
from jaxurban.paths.places import snap_limit_m
from jaxurban.planners.registry import (
    EXACT_PLANNERS,
    SAMPLING_PLANNERS,
    VOLUME_PLANNERS,
    find_planner,
)
from jaxurban.settings import DEFAULTS, Backend, HeuristicName, OnGround, PlannerName, Planning


@dataclass(frozen=True)
class PathSearch:
    """How a path is searched for: what does not change the map.

    Attributes:
      planner: ``"ptp"``, ``"astar"``, ``"theta-star"`` ...
      heuristic: None: the planner's own.
      budget_s: seconds that the search may take; inf where samples alone end it.
      max_samples: of a planner that draws samples: it ends after so many, so that the same call gives the same path on
        any machine; None: no limit.
      seed: for sampling planners.
      snap: move a start or goal inside an obstacle or closed by a constraint to the nearest free cell (of its level)
        that is joined to the other end, instead of failing: True by at most 50 m, a number by at most so many metres.
        The path's message says how far.
      on_ground: the ends of a mission: a start and a goal are free only where the air is, from the ground up to the
        flight, so that it may take off and land there (`Constraints.is_free_to_ground`); ``"goal"`` asks it of the goal
        alone, for a flight that starts from a roof.
      backend: what searches (`planners.registry.solve_many`): ``"auto"`` takes Numba for a single path.
      exposure: most of (1 / l0) x integral of c ds to each layer by its name, in the cost model's units; the cheapest
        path of the grid that keeps them is searched for, with a lower bound (`planners.exposure`).
      refine: move the waypoints of what the planner found downhill, off the grid (`planners.refine`); within what
        is left of the budget. It takes the ``line`` cost model, or the ``distance`` objective.
    """

    planner: PlannerName
    heuristic: HeuristicName | None
    budget_s: float
    max_samples: int | None
    seed: int
    snap: bool | float
    refine: bool
    exposure: Mapping[str, float]
    on_ground: OnGround
    backend: Backend

    @classmethod
    @typed
    def of(
        cls,
        planning: Planning = DEFAULTS,
        is_for_volumes: bool = False,
        *,
        planner: PlannerName | None = None,
        heuristic: HeuristicName | None = None,
        budget_s: float | None = None,
        max_samples: int | None = None,
        seed: int | None = None,
        snap: bool | float = False,
        on_ground: OnGround = False,
        refine: bool = False,
        exposure: Mapping[str, float] | None = None,
        backend: Backend = "auto",
    ) -> "PathSearch":
        """Return a checked search; what is left out is as the maps' scenario says it.

        Args:
          planning: of the maps' scenario, with its planner, budget and seed; left out, the defaults.
          is_for_volumes: whether the path may climb; then the scenario gives only the budget.
          planner: left out and not in the scenario, ``"astar"``, between levels ``"astar-volume"``.
          heuristic, budget_s, max_samples, seed, snap, on_ground, refine, exposure, backend: the attributes; None: left
            out. With ``max_samples`` alone the search has no limit of seconds.

        Raises:
          InputError: an unknown planner, a heuristic that it does not take, a wrong seed, budget or distance of
            snapping, samples of a planner that draws none, refinement of a path that may climb, or budgets of exposure
            that are no numbers, of a planner off the grid or with refinement.
        """
        # Planner, budget and seed: the arguments, else the scenario, else the defaults.
        if is_for_volumes:
            planning = replace(DEFAULTS, planner="astar-volume", budget_s=planning.budget_s)
        if max_samples is not None:
            at_least("max_samples", max_samples, 1)
            budget_s = math.inf if budget_s is None else budget_s
        arguments = {"planner": planner, "budget_s": budget_s, "seed": seed}
        planning = replace(planning, **values_given(arguments))
        if max_samples is not None and planning.planner not in SAMPLING_PLANNERS:
            raise InputError(
                f"max_samples is of the planners {' and '.join(SAMPLING_PLANNERS)}, and {planning.planner} draws no "
                "samples: leave it out, or name one of them"
            )

        budgets = {}
        for name, most in (exposure or {}).items():
            budgets[name] = finite(f"the budget of exposure to {name}", most)
            if budgets[name] < 0:
                raise InputError(
                    f"the budget of exposure to {name} must be 0 or a positive number, got {most:g}: raise it"
                )

        # What does not go together. The calls of `snap_limit_m` and `find_planner` raise InputError themselves.
        snap_limit_m(snap)
        if is_for_volumes and refine:
            raise InputError(
                "refine moves waypoints on one altitude: leave it out of a path that climbs and descends"
            )
        find_planner(planning.planner, heuristic, is_for_volumes=is_for_volumes, backend=backend)
        is_on_grid = planning.planner in (*EXACT_PLANNERS, *VOLUME_PLANNERS)
        if budgets and (refine or not is_on_grid):
            raise InputError(
                "budgets of exposure are of paths on the grid: leave out refine, and take the planner "
                f"{' or '.join(EXACT_PLANNERS)}"
            )
        return cls(
            planning.planner,
            heuristic,
            planning.budget_s,
            max_samples,
            planning.seed,
            snap,
            refine,
            budgets,
            on_ground,
            backend,
        )

    @property
    def limits(self) -> dict[str, Any]:
        """What ends the search, and its seed, by the names that planners and `solve_many` have for them."""
        samples = values_given({"max_samples": self.max_samples})
        return {"budget_s": self.budget_s, "seed": self.seed, **samples}
