"""The rule of what is seen, one for both engines: rays through outlines, and walks over cells.

A satellite is *unknown* where its ray leaves the known buildings or terrain before it is above all roofs, which follows
from place and direction alone. Others have a margin, in metres, by which the ray clears what it clears by least: *seen*
above 0, else *hidden*. A ray that touches a roof is hidden, which is the safe side, as a roof at the altitude of a
drone is an obstacle. The maps' sweep (`jaxurban.kernels.shadows.sweep`) differs only where a ray touches.
"""

import numpy as np

STATES = SEEN, HIDDEN, UNKNOWN = "seen", "hidden", "unknown"
# Margins from here on are inf. `ReceptionCurve.measured_in_tokyo`, the evidence of what a margin says, ends here.
FARTHEST_MARGIN_M = 60.0
LOWEST_HORIZON_DEG = 1.0  # of a horizon, where the elevation mask is lower


def is_seen(margin_m: np.ndarray) -> np.ndarray:
    """Return which rays are seen by their margins; one whose margin is not known (NaN) is not."""
    return margin_m > 0


def states_of(margin_m: np.ndarray) -> np.ndarray:
    """Return `SEEN` or `HIDDEN` for each margin, `UNKNOWN` for NaN."""
    return np.select([np.isnan(margin_m), is_seen(margin_m)], [UNKNOWN, SEEN], HIDDEN)
