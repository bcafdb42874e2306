"""Steps: short straight parts of a flight over the maps, cut at the borders of their cells."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import crossed_cells
from jaxurban.paths.elevation import Elevation

STEP_M, MOST_STEPS = 0.5, 1_000_000  # steps of very long missions are longer,
MOST_STEP_M = 5.0  # and no longer than this
DOT_M = 1e-6  # length that what leads straight up or down has in plan


class Steps(NamedTuple):
    """Short straight parts of a flight over the maps, in order of travel. ``P`` of them.

    Attributes:
      ends_m: ``[P, 2, 2]`` x, y of begin and end in the maps' CRS.
      z_m: ``[P, 2]`` height above the ground; NaN where the ground is not known.
      ground_m: ``[P, 2]`` elevation of the ground; 0 over maps without terrain.
      along_m: ``[P, 2]`` metres flown.
      leg: ``[P]`` number of the leg, from 0.
      cell: ``[P, 2]`` row and column of the cell that it lies in.
    """

    ends_m: np.ndarray
    z_m: np.ndarray
    ground_m: np.ndarray
    along_m: np.ndarray
    leg: np.ndarray
    cell: np.ndarray

    def take(self, chosen: np.ndarray) -> "Steps":
        """Return some of the steps."""
        return Steps(*(values[chosen] for values in self))

    def table(self, step: np.ndarray, **columns: np.ndarray) -> pd.DataFrame:
        """Return a row for each of some steps, given by their numbers: where it begins and ends, and more columns."""
        from_m, to_m = self.along_m[step].T
        return pd.DataFrame({"step": step, "from_m": from_m, "to_m": to_m, **columns})

    @property
    def over_m(self) -> np.ndarray:
        """``[P]`` length on the ground."""
        return np.linalg.norm(self.ends_m[:, 1] - self.ends_m[:, 0], axis=1)

    @property
    def length_m(self) -> np.ndarray:
        """``[P]`` length in the air."""
        return self.along_m[:, 1] - self.along_m[:, 0]


def steps_of(
    states: np.ndarray,
    leg: np.ndarray,
    follows_ground: np.ndarray,
    ground: Elevation,
    step_m: float = STEP_M,
) -> Steps:
    """Return the steps of ``S`` straight segments within the maps: cut at borders of cells, and evenly between these.

    Args:
      states: ``[S, 2, 4]`` x, y, height and metres flown at begin and end.
      leg: ``[S]`` number of its leg.
      follows_ground: ``[S]`` whether its heights are above the ground, or else above the zero of the terrain.
      ground: of the maps.
      step_m: how long steps may be, unless more than `MOST_STEPS` would be made. None rises or falls by over `STEP_M`.

    Raises:
      InputError: more than `MOST_STEPS` steps of `MOST_STEP_M`.
    """
    grid = ground.maps.grid
    total_m = (states[:, 1, 3] - states[:, 0, 3]).sum()
    if total_m > MOST_STEPS * MOST_STEP_M:
        raise InputError(
            f"mission flies {total_m / 1000:,.0f} km over the maps, too far to be looked at: split the file"
        )
    step_m = max(step_m, total_m / MOST_STEPS)

    # The parts within cells. One line runs through all segments, from a place apart: every second part of it is one.
    lines_m = states[..., :2] - grid.bounds_m[:2]
    lines_m[(lines_m[:, 0] == lines_m[:, 1]).all(axis=1), 1, 0] += DOT_M
    cut = crossed_cells(np.vstack([[[0.0, 0.0]], lines_m.reshape(-1, 2)]), grid.resolution_m)
    segment, is_part = np.divmod(cut.segment, 2)

    # The steps: the segment of each, and the shares of it at which it begins and ends.
    part = np.flatnonzero(is_part)
    moved_m = np.diff(between(states[segment[part]], cut.shares[part]), axis=1)
    rise_m, length_m = np.abs(moved_m[:, 0, 2:]).T
    num_steps = np.ceil(np.maximum(rise_m / STEP_M, length_m / step_m)).clip(1).astype(int)
    number = np.arange(num_steps.sum()) - np.repeat(np.cumsum(num_steps) - num_steps, num_steps)
    evenly = (number[:, None] + [0, 1]) / np.repeat(num_steps, num_steps)[:, None]
    part = np.repeat(part, num_steps)
    segment = segment[part]
    shares = between(cut.shares[part].clip(0, 1), evenly)  # rounding may leave them

    # Place, height over the ground and cell of each step.
    step_states = between(states[segment], shares)
    places_m = step_states[..., :2]
    height_m, along_m = np.moveaxis(step_states[..., 2:], -1, 0)
    ground_m = ground.at(places_m)
    z_m = height_m - np.where(follows_ground[segment, None], 0.0, ground_m)
    cell = np.column_stack([cut.row, cut.col])[part].clip(0, np.array(grid.shape) - 1)
    return Steps(places_m, z_m, ground_m, along_m, leg[segment], cell)


def between(ends: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return ``[S, K, ...]`` values on the straight line between ends ``[S, 2, ...]``, at shares ``[S, K]`` of it.

    A share of 0 is the first end, 1 the second.
    """
    share = share.reshape(*share.shape, *[1] * (ends.ndim - 2))
    return ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])
