"""The map as planners off the grid see it."""

import numpy as np

from jaxurban.kernels.line.segment_cost import CostGrid
from jaxurban.planners.base import Problem


def reachable_cells(problem: Problem) -> np.ndarray | None:
    """Return ``[Y, X]`` bool the cells that paths off the grid may cross; None where none joins start and goal."""
    islands = problem.islands
    return islands == islands[problem.start] if islands[problem.start] == islands[problem.goal] else None


def cost_grid_of(problem: Problem, is_reachable: np.ndarray) -> CostGrid:
    """Return the map as segments see it, closed outside the cells ``[Y, X]`` that paths may cross."""
    is_line = problem.cost_model.kind == "line"
    per_side = problem.resolution_m / problem.cost_model.reference_length_m if is_line else 1.0
    return CostGrid(
        cell_cost=np.where(is_reachable, problem.cost * per_side, np.inf),
        per_side=float(problem.distance_weight * problem.resolution_m),
        is_line=is_line,
        passes_corners=problem.cost_model.passes_corners,
        margin=problem.leg_margin_m / problem.resolution_m,
    )
