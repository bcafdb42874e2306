"""What a route costs in what a user pays: metres, people, metres without a fix; and the border of the maps."""

from collections.abc import Callable
from functools import cache, partial

import numpy as np

from jaxurban.maps.levels import values_at
from jaxurban.metrics.gps import FIX, has_no_fix
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.paths.cost_map import CostMap
from jaxurban.studies.decided import edge_band, is_at_edge

SWATH_M = 10.0  # width of the strip in which people are counted, as in `jaxurban.explain`
AMOUNTS = ("length_m", "people_below", "no_fix_m")
PAID = (*AMOUNTS, "at_edge")
Paid = dict[str, float]


def paid_on(cost_map: CostMap) -> Callable[[np.ndarray], Paid]:
    """Return a function of a route on a cost map of one altitude that returns what it costs, by the names `PAID`.

    ``people_below`` are those under a strip of `SWATH_M`, ``no_fix_m`` metres without a position fix (`has_no_fix`);
    both are missing where the maps do not know them. ``at_edge`` is 1 for a route along the border of the maps' data
    (`is_at_edge`), else 0. A route is ``[N, 2]``, metres from the maps' southwest corner.
    """
    maps = cost_map.maps
    layers = {}
    if "density" in maps.ds:
        per_km2 = maps.m("density", time_of_day=cost_map.time_of_day)
        layers["people_below"] = per_km2 * SWATH_M / M2_PER_KM2
    if FIX in maps.ds:
        read = partial(maps.m, FIX, time=cost_map.time)
        under_sky = cache(maps.is_under_sky)
        hdop = values_at(cost_map.altitude_m, sorted(maps.altitudes_m), read, under_sky)
        layers["no_fix_m"] = has_no_fix(hdop).astype(float)
    band = edge_band(maps)

    def paid(points_m: np.ndarray) -> Paid:
        """Return what a route costs."""
        features = cost_map.problem.features(points_m)
        amounts = {
            name: float(features.length_m @ layer[features.crossed])
            for name, layer in layers.items()
        }
        at_edge = float(is_at_edge(points_m, cost_map.grid, band))
        return {"length_m": float(features.phi[0]), **amounts, "at_edge": at_edge}

    return paid
