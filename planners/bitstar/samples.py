"""Samples of the informed set, the set's size, and the radius that joins samples."""

import numpy as np

from jaxurban.planners.bitstar.bounds import Bounds

OFF_BORDER = 1e-6  # in cell sides: samples keep off the borders, so that each lies in one cell
MAX_ROUNDS = 64  # of rejection, before a set too thin to sample is given up


class InformedSet:
    """The points of reachable cells through which a cheaper path may lead; it shrinks as paths get cheaper.

    Attributes:
      bounds: the lower bounds that say so.
      cells: ``[M]`` flat numbers of the cells that hold such points.
      incumbent: cost of the best path, inf without one.
      measure: area of the set, in cells: as many as have such a point at their centre.
    """

    def __init__(self, bounds: Bounds, is_reachable: np.ndarray) -> None:
        self.bounds = bounds
        self.is_reachable = is_reachable
        self.cells = np.flatnonzero(is_reachable)
        self.incumbent = np.inf
        self.measure = float(self.cells.size)
        self._through = np.empty(0)  # [M] lower bound of paths through the cells' centres, given an incumbent

    def shrink(self, incumbent: float) -> None:
        """Leave out what cannot hold a path cheaper than the incumbent."""
        if not incumbent < self.incumbent:
            return
        if self.incumbent == np.inf:
            self._through = self.bounds.through_cells(self.cells)
        self.incumbent = incumbent
        may_hold = self._through < incumbent + self.bounds.slack()
        if not may_hold.all():
            self.cells, self._through = self.cells[may_hold], self._through[may_hold]
        num_cells = float(np.count_nonzero(self._through < incumbent))
        self.measure = min(max(num_cells, 1.0), self._ellipse()[2])

    def _ellipse(self) -> tuple[float, float, float]:
        """Return half the two axes and the area of the ellipse of the distance bound, in cell sides."""
        if self.bounds.per_side == 0 or self.incumbent == np.inf:
            return np.inf, np.inf, np.inf
        major = 0.5 * self.incumbent / self.bounds.per_side
        focal = 0.5 * np.hypot(*(self.bounds.goal - self.bounds.start))
        minor = np.sqrt(max((major - focal) * (major + focal), 0.0))
        return major, minor, np.pi * major * minor

    def sample(self, num_samples: int, rng: np.random.Generator) -> np.ndarray:
        """Return ``[N, 2]`` points spread evenly over the set; fewer than wanted where it is too thin."""
        major, minor, area = self._ellipse()
        kept, num_kept = [np.empty((0, 2))], 0
        for _ in range(MAX_ROUNDS if self.cells.size else 0):
            if num_kept >= num_samples:
                break
            if area < self.cells.size:
                xy = self._in_ellipse(max(64, 2 * (num_samples - num_kept)), major, minor, rng)
            else:
                xy = self._in_cells(max(64, 2 * (num_samples - num_kept)), rng)
            if self.incumbent < np.inf and len(xy):
                xy = xy[np.add(*self.bounds.from_start_and_to_goal(xy)) < self.incumbent]
            kept.append(xy)
            num_kept += len(xy)
        return np.concatenate(kept)[:num_samples]

    def _in_cells(self, num_points: int, rng: np.random.Generator) -> np.ndarray:
        row, col = np.divmod(self.cells[rng.integers(self.cells.size, size=num_points)], self.is_reachable.shape[1])
        return np.stack([col, row], axis=1) + rng.uniform(OFF_BORDER, 1 - OFF_BORDER, (num_points, 2))

    def _in_ellipse(self, num_points: int, major: float, minor: float, rng: np.random.Generator) -> np.ndarray:
        radius, angle = np.sqrt(rng.random(num_points)), rng.uniform(0, 2 * np.pi, num_points)
        along, across = major * radius * np.cos(angle), minor * radius * np.sin(angle)
        start, goal = self.bounds.start, self.bounds.goal
        length = np.hypot(*(goal - start))
        unit = (goal - start) / length if length > 0 else np.array([1.0, 0.0])
        xy = 0.5 * (start + goal) + along[:, None] * unit + across[:, None] * np.array([-unit[1], unit[0]])
        cell = np.floor(xy)
        xy = cell + np.clip(xy - cell, OFF_BORDER, 1 - OFF_BORDER)
        col, row = cell.astype(np.int64).T
        is_inside = (row >= 0) & (row < self.is_reachable.shape[0]) & (col >= 0) & (col < self.is_reachable.shape[1])
        is_inside[is_inside] = self.is_reachable[row[is_inside], col[is_inside]]
        return xy[is_inside]


def graph_radius(num_nodes: int, measure: float, eta: float) -> float:
    """Return the radius of the random geometric graph, in cell sides (Gammell et al. 2015, eq. for r(q); 2-D).

    Above ``eta`` = 1 the graph holds paths that come ever nearer to the optimum as the nodes grow in number.
    """
    if num_nodes < 2:
        return np.inf
    return 2 * eta * np.sqrt(1.5 * measure / np.pi * np.log(num_nodes) / num_nodes)
