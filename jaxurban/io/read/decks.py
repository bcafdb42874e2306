"""Decks of bridges, mapped as areas: how high they hang where their tags do not say."""

from dataclasses import replace

import numpy as np

from jaxurban.io.read.heights import Heights
from jaxurban.world.city import HeightOrigin

# Over freeways the least clearance is 16 ft, 4.9 m (AASHTO, A Policy on Geometric Design of Highways and Streets). A
# layer of OSM orders what crosses and is no height: one more above the ground is taken as one more such clearance.
LAYER_CLEARANCE_M = 5.0
DECK_DEPTH_M = 1.0  # girder, slab and pavement of spans of some 25 m, at a depth of a 25th of the span


def with_decks(heights: Heights, is_deck: np.ndarray, layer: np.ndarray) -> Heights:
    """Return heights in which decks hang: from ``min_height`` to ``height`` where both are given.

    Without ``min_height`` a deck is `DECK_DEPTH_M` deep, below its ``height``; with neither it hangs at
    `LAYER_CLEARANCE_M` a layer (at least one), and its height is a guess.

    Args:
      heights: of ``N`` outlines, by their tags.
      is_deck: ``[N]`` bool.
      layer: ``[N]`` float64 of each outline, NaN where it has none.
    """
    is_given, floor_m = heights.origin == HeightOrigin.HEIGHT, heights.min_height_m
    by_layer_m = np.fmax(layer, 1.0) * LAYER_CLEARANCE_M
    below_top_m = np.where(is_given, np.maximum(heights.height_m - DECK_DEPTH_M, 0.0), by_layer_m)
    floor_m = np.where(floor_m > 0, floor_m, below_top_m)
    top_m = np.where(is_given & (heights.height_m > floor_m), heights.height_m, floor_m + DECK_DEPTH_M)
    is_guess = ~is_given & (heights.min_height_m == 0)
    origin = np.where(is_guess, HeightOrigin.LAYER, HeightOrigin.HEIGHT).astype(np.uint8)
    return replace(
        heights,
        height_m=np.where(is_deck, top_m, heights.height_m),
        min_height_m=np.where(is_deck, floor_m, heights.min_height_m),
        origin=np.where(is_deck, origin, heights.origin),
    )
