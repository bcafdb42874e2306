"""PTP: the straight segment from start to goal."""

import time

import numpy as np

from jaxurban.planners.base import Path, Problem, Status, cell_centre_m
from jaxurban.planners.compiled_first import compiled_first
from jaxurban.planners.cost import sample_segment


@compiled_first()
def ptp(problem: Problem, *, budget_s: float = np.inf, seed: int = 0) -> Path:
    """Return the straight path, sampled every resolution step, or BLOCKED where that is not a free way (`is_free_way`).

    Neither the budget nor the seed plays a part. The status is FEASIBLE, never OPTIMAL: nothing else was
    tried. The lower bound is the distance alone and holds for any path.
    """
    begin_s = time.perf_counter()
    start_m, goal_m = (np.array(cell_centre_m(cell, problem.resolution_m)) for cell in (problem.start, problem.goal))
    points_m = sample_segment(start_m, goal_m, problem.resolution_m)
    is_valid = problem.features(points_m).is_valid
    return Path.of(
        problem,
        points_m if is_valid else np.empty(0),
        Status.FEASIBLE if is_valid else Status.BLOCKED,
        problem.distance_weight * float(np.hypot(*(goal_m - start_m))),
        begin_s,
        num_expanded=len(points_m) - 1,
        planner="ptp",
        backend="numpy",
        graph="",
    )
