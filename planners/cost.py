"""How steps are costed, and what a path adds up, for every planner, fit, study and report.

cost(path) = weights . phi(path)        phi = (metres, cost of each layer[, metres climbed, metres descended])
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from jaxurban.checks import one_of, positive, typed
from jaxurban.errors import InputError
from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.line.segment_cost import are_clear
from jaxurban.kernels.line.traversal import Crossings, crossed_cells, is_free_way
from jaxurban.kernels.tolerances import SAME_LENGTH
from jaxurban.settings import CostKind, Diagonal, Rules

if TYPE_CHECKING:
    from jaxurban.planners.base import Problem

# (row, column) of the eight steps; bit k of a cell's moves stands for step k.
STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
Index = tuple[Any, ...]  # (row, col) of cells, or (level, row, col) of nodes in a volume


@typed
@dataclass(frozen=True)
class CostModel:
    """How steps are costed, and which steps the grid allows: one argument, so that none of it is lost on the way.

    Attributes:
      kind: ``"line"``, which does not depend on the resolution, or ``"cell"`` (the paper; see `Problem`).
      reference_length_m: ``l_0`` of the line model.
      connectivity: 4 or 8 neighbours, for grid planners.
      diagonal: ``"both-free"`` allows a diagonal step only where both orthogonal neighbours are free, and no path of
        any planner between two blocked cells that touch at a corner; ``"always"`` allows either.

    Raises:
      InputError: a value out of its range.

    Examples:
      >>> model = ju.CostModel(kind="cell", connectivity=4)
      >>> print(model)
      'cell' (reference length 5 m, 4 neighbours, diagonal steps 'both-free')
      >>> len(ju.plan(maps, start, goal, altitude_m=60.0, cost_model=model).xy_m)
      51
    """

    kind: CostKind = Rules.cost_model
    reference_length_m: float = 5.0
    connectivity: Literal[4, 8] = 8
    diagonal: Diagonal = "both-free"

    def __post_init__(self) -> None:
        """Keep the reference length as a float, and raise InputError if it is not positive."""
        length_m = positive("reference_length_m", self.reference_length_m, "metres")
        object.__setattr__(self, "reference_length_m", length_m)

    @classmethod
    def of(cls, given: "CostModel | CostKind | None") -> "CostModel":
        """Return the cost model that is given whole, by its kind alone, or not at all.

        Returns:
          `CostModel`: the one given; for a kind, that kind with the defaults of all else; for None, the default.

        Examples:
          >>> ju.CostModel.of("cell").kind, ju.CostModel.of(None) == ju.CostModel()
          ('cell', True)
        """
        return given if isinstance(given, CostModel) else cls(given or Rules.cost_model)

    @classmethod
    @typed
    def from_settings(cls, settings: Mapping[str, Any]) -> "CostModel":
        """Return the model that settings give, named as `CostModel.settings` names them in paths.

        Returns:
          `CostModel`; what the settings leave out is the default, and their other entries are ignored.

        Examples:
          >>> ju.CostModel.from_settings({"cost_model": "cell", "connectivity": 4}).connectivity
          4
          >>> ju.CostModel.from_settings(path.settings) == ju.CostModel()
          True
        """
        parts = {name: settings.get(name, default) for name, default in cls().settings.items()}
        kind = one_of("cost_model", parts.pop("cost_model"), get_args(CostKind))
        return cls(kind, **parts)

    @property
    def passes_corners(self) -> bool:
        """Whether a path may pass between two blocked cells that touch at a corner."""
        return self.diagonal == "always"

    @property
    def settings(self) -> dict[str, Any]:
        """The model under the names of its parts in files, ``kind`` as ``cost_model``."""
        parts = asdict(self)
        return {"cost_model": parts.pop("kind"), **parts}

    @property
    def joins_corners(self) -> bool:
        """Whether a step may pass between two blocked cells that touch at a corner."""
        return self.connectivity == 8 and self.diagonal == "always"

    def __str__(self) -> str:
        return (
            f"{self.kind!r} (reference length {self.reference_length_m:g} m, {self.connectivity} neighbours, "
            f"diagonal steps {self.diagonal!r})"
        )


def allowed_moves(is_free: np.ndarray, connectivity: int, needs_both_free: bool) -> np.ndarray:
    """Return ``[Y, X]`` uint8 whose bit k is set where step k of `STEPS` leads from a free cell to a free cell.

    Args:
      is_free: ``[Y, X]`` bool; all outside is taken as not free.
      connectivity: 4 (the first four steps) or 8.
      needs_both_free: a diagonal step also needs both orthogonal neighbours free.
    """
    moves = np.empty(is_free.shape, np.uint8)
    _find_moves(
        np.pad(is_free, 1).view(np.uint8),
        # Bits of the eight steps, or of the four straight ones.
        0xFF if connectivity == 8 else 0x0F,
        needs_both_free,
        moves,
    )
    return moves


@compiled()
def _find_moves(framed, steps, needs_both_free, moves):
    """Set the bits of the steps that are allowed from each cell (see `allowed_moves`).

    Bit k stands for step k of `STEPS`: north, south, east, west, then northeast, northwest, southeast, southwest.

    Args:
      framed: ``[Y + 2, X + 2]`` uint8 cells with a frame of closed ones, 1 for free and 0 for closed.
      steps: bits of the steps that the connectivity has.
      needs_both_free: a diagonal step also needs both orthogonal neighbours free.
      moves: ``[Y, X]`` uint8, filled in place.
    """
    for row in range(moves.shape[0]):
        # Bits, not branches, so that the processor takes many cells at once.
        here = framed[row + 1]
        north = framed[row + 2]
        south = framed[row]
        for col in range(1, moves.shape[1] + 1):
            up = north[col]
            down = south[col]
            east = here[col + 1]
            west = here[col - 1]
            diagonals = (
                north[col + 1] << 4
                | north[col - 1] << 5
                | south[col + 1] << 6
                | south[col - 1] << 7
            )
            if needs_both_free:
                diagonals &= (
                    (up & east) << 4 | (up & west) << 5 | (down & east) << 6 | (down & west) << 7
                )
            # Minus 1 is all bits: a closed cell, 0, has none.
            moves[row, col - 1] = (
                -here[col] & steps & (diagonals | up | down << 1 | east << 2 | west << 3)
            )


@dataclass(frozen=True, eq=False)
class PathFeatures:
    """What a path adds up, whatever the weights are. ``L`` layers.

    Attributes:
      phi: ``[W]`` float64 what the weights multiply: metres, then how much of each layer's cost counts, then in a
        volume metres climbed and descended; the layers are inf for a path that is not valid.
      is_valid: every crossed cell is on the map and free, and so is the way through corners (`is_free_way`), and legs
        keep the problem's margin; in a volume, every step is one that the search may take.
      counted: the cells whose costs count, in order of travel, and ``count`` how often each is.
      crossed: the cells that the path crosses, in order of travel, and ``length_m`` how far it runs in each (a node of
        a volume holds half-way to its neighbours).
      costs: of the problem.
    """

    phi: np.ndarray
    is_valid: bool
    counted: Index
    count: np.ndarray
    crossed: Index
    length_m: np.ndarray
    costs: np.ndarray

    def cost(self, weights: np.ndarray) -> float:
        """Return the path's cost under weights ``[W]``; inf for a path that is not valid."""
        if not self.is_valid:
            return np.inf
        return float(weights[0] * self.phi[0] + np.sum(weights[1:] * self.phi[1:]))

    @property
    def visits(self) -> np.ndarray:
        """``[Y, X]`` how often a valid path's cost counts each cell: its derivative by the cell's cost."""
        visits = np.zeros(self.costs.shape[1:])
        np.add.at(visits, self.counted, self.count)
        return visits

    @cached_property
    def mean_costs(self) -> np.ndarray:
        """``[L]`` the mean of each layer's cost along the path, weighted by length; without length, at its place."""
        length_m = self.length_m if self.length_m.sum() > 0 else np.ones(len(self.length_m))
        return (
            self.costs[(slice(None), *self.crossed)].astype(np.float64) @ length_m / length_m.sum()
        )


def path_features(problem: "Problem", points_m: np.ndarray) -> PathFeatures:
    """Return the features of a path on a problem's map (`Problem.features`): what the weights multiply in its cost.

    Under ``cell`` (the paper's transition cost) each step between states costs the layers of the cell in which it
    ends, whatever its length; states are the path's points, and samples every resolution step of segments longer than
    a diagonal step. A step that ends on a border ends in the cell that it came through. Under ``line`` the layers are
    integrated along the path, cut exactly at cell borders, per reference length. A path of one point, or of no length,
    costs nothing.

    Args:
      problem: whose costs, free cells and cost model count.
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner, ``N >= 1``; in a volume ``[N, 3]`` x, y,
        altitude: straight legs on a level, and steps between neighbouring nodes where the level changes.

    Raises:
      InputError: points that are not finite metres of these shapes.
    """
    # The path cut at borders of cells.
    cut = crossed_cells(points_m, problem.resolution_m)
    points_m = cut.points_m
    if points_m.shape[1] != problem.is_free.ndim:
        raise InputError(
            f"a path must be [N, {problem.is_free.ndim}] here, got shape {points_m.shape}: mend the path"
        )
    crossed = _nodes_in(problem, cut)

    # Metres, in a volume also climbed and descended; and whether the path is valid.
    legs_m = np.diff(points_m, axis=0).T
    length_m = np.hypot(*legs_m[:2])
    if problem.levels_m is not None:
        rise_m = legs_m[2]
        length_m = np.hypot(length_m, rise_m)
        metres = [length_m.sum(), np.maximum(rise_m, 0).sum(), np.maximum(-rise_m, 0).sum()]
        is_valid = _is_allowed(problem, points_m)
    else:
        metres = [length_m.sum()]
        is_valid = _is_way(problem, problem.is_free, cut)

    # The cells whose costs count, and how often: by length under `line`; under `cell`, of each state once. A state lies
    # in the last cell of its step, and a step of no length at the end is none.
    if problem.cost_model.kind == "line":
        counted = crossed
        count = cut.length_m / problem.cost_model.reference_length_m
    else:
        states = crossed_cells(path_states(points_m, problem.resolution_m), problem.resolution_m)
        is_last = np.append(states.segment[1:] != states.segment[:-1], states.length_m[-1] > 0)
        counted = tuple(index[is_last] for index in _nodes_in(problem, states))
        count = np.ones(int(is_last.sum()))

    layers = np.full(len(problem.costs), np.inf)
    if is_valid:
        layers = problem.costs[(slice(None), *counted)].astype(np.float64) @ count
    phi = np.concatenate([metres[:1], layers, metres[1:]])
    return PathFeatures(phi, is_valid, counted, count, crossed, cut.length_m, problem.costs)


def _is_way(problem: "Problem", is_free: np.ndarray, cut: Crossings) -> bool:
    """Return whether a path on one level is a free way that keeps the problem's margin, but for rounding."""
    margin = problem.leg_margin_m / problem.resolution_m
    return is_free_way(cut, is_free, problem.cost_model.passes_corners) and (
        margin == 0
        or bool(are_clear(is_free, cut.points_m / problem.resolution_m, margin - SAME_LENGTH).all())
    )


def _nodes_in(problem: "Problem", cut: Crossings) -> Index:
    """Return row and column (in a volume level first) of each part; of a step between levels half lies on either."""
    if problem.levels_m is None:
        return cut.row, cut.col
    is_late = cut.shares.sum(axis=1) > 1  # beyond the middle of its segment
    nearer = np.minimum(cut.segment + is_late, len(cut.points_m) - 1)
    return np.searchsorted(problem.levels_m, cut.points_m[nearer, 2]), cut.row, cut.col


def _is_allowed(problem: "Problem", points_m: np.ndarray) -> bool:
    """Return whether a path through a volume is valid; one that leaves the map is not.

    Each leg on one level must be a free way there. Each step that changes the level must be one that the search may
    take: it leads from a free cell to a neighbour that is free, and its horizontal part is allowed on both levels.

    Args:
      problem: a query in a volume.
      points_m: ``[N, 3]`` x, y, altitude, which is one of the levels.
    """
    # Level, row and column of the points.
    cells = np.floor(points_m[:, 1::-1] / problem.resolution_m).astype(np.int64)
    nodes = np.column_stack([np.searchsorted(problem.levels_m, points_m[:, 2]), cells])
    if (nodes < 0).any() or (nodes >= problem.is_free.shape).any():
        return False

    # Legs on one level.
    steps = np.diff(nodes, axis=0)
    is_climb = np.diff(points_m[:, 2]) != 0
    for level, first, last in level_parts(problem, points_m):
        way = crossed_cells(points_m[first : last + 1, :2], problem.resolution_m)
        if level is not None and not _is_way(problem, problem.is_free[level], way):
            return False

    # Ends of steps that change the level (a path of one point counts as one) are neighbours, and free.
    begins_climb = np.append(is_climb, len(nodes) == 1)
    ends_climb = np.append(False, is_climb)
    is_free = problem.is_free[tuple(nodes[begins_climb | ends_climb].T)]
    if np.abs(steps[is_climb]).max(initial=0) > 1 or not is_free.all():
        return False

    # The bit of the horizontal part of each such step, 0 straight up or down, is set on both levels.
    is_step = (steps[is_climb, None, 1:] == np.array(STEPS)).all(axis=2)
    bit = is_step @ (1 << np.arange(len(STEPS)))
    level, row, col = nodes[:-1][is_climb].T
    to_level = nodes[1:, 0][is_climb]
    moves = problem.moves[level, row, col] & problem.moves[to_level, row, col]
    return bool(np.all(moves & bit == bit))


def level_parts(problem: "Problem", points_m: np.ndarray) -> list[tuple[int | None, int, int]]:
    """Return the parts of a path in order, each as its level, the number of its first point and that of its last.

    A part is as many legs on one level as follow each other, or as many that climb or descend, whose level is None. It
    begins at the point where the part before ends. On one altitude the path is one part of level 0; a path of one
    point in a volume has no part.

    Args:
      problem: the query.
      points_m: ``[N, 2]``, in a volume ``[N, 3]`` with the altitude, which is one of the levels.
    """
    last_point = len(points_m) - 1
    if problem.levels_m is None:
        return [(0, 0, last_point)]
    if not last_point:
        return []

    # Cut where legs on a level and legs that climb or descend follow each other.
    is_level = np.diff(points_m[:, 2]) == 0  # of each leg
    changes = np.flatnonzero(is_level[1:] != is_level[:-1]) + 1
    levels = np.searchsorted(problem.levels_m, points_m[:, 2]).tolist()
    parts = []
    for first, last in pairwise([0, *changes.tolist(), last_point]):
        # A part's first leg says whether all of them lie on a level.
        level = levels[first] if is_level[first] else None
        parts.append((level, first, last))
    return parts


def sample_segment(start_m: np.ndarray, end_m: np.ndarray, step_m: float) -> np.ndarray:
    """Return ``[N, 2]`` points on a segment every ``step_m`` from its start, its end included; ``[N, 3]`` on a level.

    This is the paper's straight path (eq. for alpha, with y's component corrected): the last step is the shorter
    one. A segment of no length is one point.

    Args:
      start_m, end_m: ``[2]`` or ``[3]`` ends of the segment.
      step_m: distance between points.
    """
    length_m = float(np.hypot(*(end_m - start_m)[:2]))
    if length_m == 0:
        return np.array([start_m], np.float64)
    num_steps = max(1, int(np.ceil(length_m / step_m * (1 - SAME_LENGTH))))
    along = np.arange(num_steps + 1)[:, None] * (step_m / length_m)
    points = start_m + along * (end_m - start_m)
    points[-1] = end_m
    return points


def path_states(points_m: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[M, 2]`` the states whose cells the ``cell`` model counts: the points, and samples of long segments.

    A segment longer than a diagonal step is sampled every resolution step; a shorter one is one step.

    Args:
      points_m: ``[N, 2]`` points of a path; with altitudes ``[N, 3]``, and so are the states.
      resolution_m: side of a cell.
    """
    points = np.asarray(points_m, np.float64)
    diagonal_m = np.sqrt(2) * resolution_m * (1 + SAME_LENGTH)
    is_long = np.hypot(*np.diff(points[:, :2], axis=0).T) > diagonal_m
    if not is_long.any():
        return points
    segments = [points[:1]]
    for i, long in enumerate(is_long):
        segments.append(
            sample_segment(points[i], points[i + 1], resolution_m)[1:]
            if long
            else points[i + 1 : i + 2]
        )
    return np.concatenate(segments)
