"""Smooth curves through points that go up and down only where the points do."""

import numpy as np
from jaxtyping import Float


def monotone_curve(
    x: Float[np.ndarray, " N"], y: Float[np.ndarray, " N"], at: Float[np.ndarray, " M"]
) -> Float[np.ndarray, " M"]:
    """Return the value at some places of the piecewise cubic through points (PCHIP; Fritsch and Butland 1984).

    To the bit what `scipy.interpolate.PchipInterpolator` gives, whose import takes longer than the rest of the
    synthetic city.

    Args:
      x: ascending, three at least.
      y: values there.
      at: within ``x``.
    """
    step = np.diff(x)
    slope = np.diff(y) / step
    before, after = slope[:-1], slope[1:]
    turns = np.sign(before) * np.sign(after) <= 0
    weight_before, weight_after = 2 * step[1:] + step[:-1], step[1:] + 2 * step[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = (weight_before / before + weight_after / after) / (weight_before + weight_after)
    inner = np.where(turns, 0.0, 1 / np.where(turns, 1.0, inverse))
    ends = (_end_derivative(*step[:2], *slope[:2]), _end_derivative(*step[:-3:-1], *slope[:-3:-1]))
    derivative = np.r_[ends[0], inner, ends[1]]
    bend = (derivative[:-1] + derivative[1:] - 2 * slope) / step
    piece = np.clip(np.searchsorted(x, at, "right") - 1, 0, len(step) - 1)
    run = at - x[piece]
    square = ((slope - derivative[:-1]) / step - bend)[piece]
    value = y[piece] + derivative[piece] * run
    return value + square * (run * run) + (bend / step)[piece] * (run * run * run)


def _end_derivative(near_step: float, next_step: float, near_slope: float, next_slope: float) -> float:
    """Return the derivative at an end, by three points, kept from overshooting."""
    found = ((2 * near_step + next_step) * near_slope - near_step * next_slope) / (near_step + next_step)
    if np.sign(found) != np.sign(near_slope):
        return 0.0
    if np.sign(near_slope) != np.sign(next_slope) and abs(found) > 3 * abs(near_slope):
        return 3 * near_slope
    return found
