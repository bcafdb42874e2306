"""The paper's classes of GDOP."""

from enum import IntEnum

import numpy as np

RATING_UPPER_GDOP = (1.0, 4.0, 6.0, 8.0, 20.0)  # the paper's table of DOP ratings, Poor above the last


class Rating(IntEnum):
    """The paper's classes of GDOP."""

    IDEAL = 0  # 1 and less
    EXCELLENT = 1  # above 1, up to 4
    GOOD = 2  # up to 6
    MODERATE = 3  # up to 8
    FAIR = 4  # up to 20
    POOR = 5  # above 20, or undetermined


def rating(gdop: np.ndarray) -> np.ndarray:
    """Return the `Rating` of each GDOP as uint8, in the shape given; upper limits count in."""
    return np.searchsorted(RATING_UPPER_GDOP, gdop, side="left").astype(np.uint8)
