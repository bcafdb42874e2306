"""Smooth curves through points that never overshoot them: piecewise cubic Hermite interpolation (PCHIP)."""

import numpy as np


def pchip(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the values ``[N]`` of the monotone cubic curve through points.

    Between two points it rises or falls as they do, and no further than they. As `scipy.interpolate.PchipInterpolator`,
    in the same order of operations, without the 0.4 s that importing SciPy's interpolation takes.

    Args:
      x: ``[K]``, three points or more, rising.
      y: ``[K]`` values there.
      at: ``[N]`` where values are wanted, from the first point to the last.

    References:
      Fritsch and Butland, SIAM J. Sci. Comput. 5(2), 1984 (slopes as weighted harmonic means); Moler, Numerical
      Computing with MATLAB, 2004, section 3.6 (slopes at both ends).
    """
    wide = np.diff(x)
    secant = np.diff(y) / wide
    slope = _slopes(wide, secant)
    bend = (slope[:-1] + slope[1:] - 2 * secant) / wide
    square, cube = (secant - slope[:-1]) / wide - bend, bend / wide
    index = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(wide) - 1)
    s = at - x[index]
    return y[index] + slope[index] * s + square[index] * (s * s) + cube[index] * (s * s * s)


def _slopes(wide: np.ndarray, secant: np.ndarray) -> np.ndarray:
    """Return the curve's slopes ``[K]`` at the points, by the width and the slope ``[K - 1]`` of each secant."""
    left, right = 2 * wide[1:] + wide[:-1], wide[1:] + 2 * wide[:-1]
    turns = secant[1:] * secant[:-1] <= 0
    before, after = (np.where(turns, 1.0, each) for each in (secant[:-1], secant[1:]))
    inner = np.where(turns, 0.0, 1.0 / ((left / before + right / after) / (left + right)))
    first = _end_slope(wide[0], wide[1], secant[0], secant[1])
    last = _end_slope(wide[-1], wide[-2], secant[-1], secant[-2])
    return np.r_[first, inner, last]


def _end_slope(wide: float, next_wide: float, secant: float, next_secant: float) -> float:
    """Return the slope at an end, of the parabola through the three points there as far as the curve stays monotone."""
    slope = ((2 * wide + next_wide) * secant - wide * next_secant) / (wide + next_wide)
    if slope * secant <= 0:
        return 0.0
    return 3.0 * secant if secant * next_secant <= 0 and abs(slope) > 3.0 * abs(secant) else slope
