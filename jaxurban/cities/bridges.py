"""Bridges: how high a deck is guessed to lie, what none of its kind exceeds, and how wide it is.

Over freeways the least clearance is 16 ft, 4.9 m (AASHTO, A Policy on Geometric Design of Highways and Streets). A
layer of OpenStreetMap orders what crosses and is no height; one more is taken as one more such clearance with its deck,
and as 12 m at most. Bounds are choices: 100 m for the kinds that lead over valleys or carry their load above the deck,
and 350 m for those that hang on towers (Millau: 343 m), or may, as they lead far over water. A height that a bridge
names bounds its deck alone.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban.cities.heights import parse_count, read_column
from jaxurban.cities.kinds import BRIDGE
from jaxurban.cities.outlines import Outlines

LAYER_LIMIT_M, ABOVE_LAYERS_M = 12.0, 10.0
HIGH_M, HANGING_M = 100.0, 350.0
# Words of kinds and structures.
HIGH = "aqueduct|arch|bascule|cantilever|draw|extradosed|lift|movable|swing|trestle|truss|viaduct"
HANGING = "suspension|cable"
LONG_M = 300.0  # the longest girders of beams span as far
JOINED_M = 1.0  # ways so near each other are one bridge
DECK = "bridge"  # of the tag man_made
# Half widths of ways whose width is not known: a lane is 3.75 m wide, and beside the lanes lie shoulders.
LANE_M, SHOULDERS_M = 3.75, 3.0
NARROW = ("footway", "cycleway", "path", "pedestrian", "steps", "bridleway", "corridor")
LANES = {"motorway": 4, "trunk": 4, **dict.fromkeys(NARROW, 1)}  # where the number is not known
NUM_LANES = 2  # of all others


class KindSizes(NamedTuple):
    """Sizes by kind, ``[N]`` each: the height (of a bridge its deck's), the bound, and half the width of a line."""

    height_m: np.ndarray
    limit_m: np.ndarray
    radius_m: np.ndarray


def bridges_of(outlines: Outlines, waters: np.ndarray) -> KindSizes:
    """Return the sizes of bridges.

    Args:
      outlines: ``N`` bridges in a projected CRS, with their tags.
      waters: shapes of what bridges may cross; without any, every bridge may cross some.
    """
    layers = np.fmax(read_column(outlines.column("layer"), parse_count), 1.0)
    texts = outlines.texts("bridge") + " " + outlines.texts("bridge_structure")
    words = pd.Series(texts, dtype=str).str
    is_movable = ~np.isin(outlines.texts("bridge_movable"), ("", "no"))
    leads_high = outlines.says("railway", ["monorail"]) | outlines.says("viaduct", ["yes"])
    is_area = outlines.says("man_made", [DECK])
    is_high = words.contains(HIGH) | is_movable | leads_high | is_area
    leads_far = _is_long(outlines.polygons) & _crosses(outlines.polygons, waters)
    is_hanging = words.contains(HANGING) | leads_far
    of_kind_m = np.select([is_hanging, is_high], [HANGING_M, HIGH_M], 0.0)
    of_layers_m = LAYER_LIMIT_M * layers + ABOVE_LAYERS_M

    said_lanes = read_column(outlines.column("lanes"), parse_count)
    usual_lanes = [LANES.get(text, NUM_LANES) for text in outlines.texts("highway")]
    lanes = np.where(said_lanes > 0, said_lanes, usual_lanes)
    return KindSizes(
        height_m=BRIDGE.height_m * layers,
        limit_m=np.maximum(of_layers_m, of_kind_m),
        radius_m=(LANE_M * lanes + SHOULDERS_M) / 2,
    )


def is_raised(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether something of traffic lies on a layer above the ground."""
    layer = read_column(outlines.column("layer"), parse_count)
    is_traffic = (outlines.texts("highway") != "") | (outlines.texts("railway") != "")
    return is_traffic & (layer > 0)


def _is_long(shapes: np.ndarray) -> np.ndarray:
    """Return ``[N]`` whether a bridge is longer than `LONG_M`, with all that join it."""
    one, other = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=JOINED_M)
    # Each has the number of the first that joins it; that of SciPy would take longer to load.
    bridge = np.arange(len(shapes))
    before = np.zeros(0, int)
    while not np.array_equal(bridge, before):
        before = bridge.copy()
        np.minimum.at(bridge, one, bridge[other])
        bridge = bridge[bridge]
    bounds_m = pd.DataFrame(shapely.bounds(shapes)).groupby(bridge)
    low_m, high_m = bounds_m[[0, 1]].transform("min"), bounds_m[[2, 3]].transform("max")
    return np.hypot(*(high_m.to_numpy() - low_m.to_numpy()).T) > LONG_M


def _crosses(shapes: np.ndarray, waters: np.ndarray) -> np.ndarray:
    """Return ``[N]`` whether a bridge crosses water, or may."""
    crosses = np.full(len(shapes), not len(waters))
    bridge, _ = shapely.STRtree(waters).query(shapes, predicate="intersects")
    crosses[bridge] = True
    return crosses
