"""Metric maps at the heights of a route, for what is told of it."""

from dataclasses import dataclass

import numpy as np

from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.route_pieces import nearest_level_m

TOUCHED, VISIBLE = "roof_touched", "num_visible"


@dataclass(frozen=True, eq=False)
class RouteLevels:
    """The maps at the levels of a path: its one altitude, or those that it climbs and descends between.

    Attributes:
      planned: the path.
      maps: that it was planned on.
    """

    planned: PlannedPath
    maps: MetricMaps

    @property
    def held_m(self) -> list[float]:
        """The levels."""
        return self.planned.settings.get("levels_m") or [self.planned.altitude_m]

    def of(self, z_m: np.ndarray) -> np.ndarray:
        """Return the level whose maps count at altitudes."""
        return nearest_level_m(z_m, self.held_m)

    def sample(self, name: str, level_m: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Return the values of a map at cells, float64, each at its own level."""
        values = np.empty(len(row))
        for z_m in np.unique(level_m):
            here = level_m == z_m
            values[here] = self._map(name, float(z_m), (row[here], col[here]))
        return values

    @property
    def roofs(self) -> str:
        """The variable of roofs: the highest that touches a cell where the maps hold it, else that at its middle."""
        return TOUCHED if TOUCHED in self.maps.ds else "roof"

    def is_obstacle(self, z_m: float) -> np.ndarray:
        """Return ``[Y, X]`` bool: a roof reaches a level."""
        if self.roofs == TOUCHED:
            return self.maps.m(TOUCHED) >= z_m
        return self.maps.m("obstacle", z_m) == 1 if z_m in self.maps.altitudes_m else self.maps.m("roof") >= z_m

    def _map(self, name: str, z_m: float, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return a map at cells of a level, linear between the altitudes around it; the upper's over a lower wall."""
        maps, settings = self.maps, self.planned.settings

        def at(altitude_m: float | None) -> np.ndarray:
            shown = maps.m(name, altitude_m, time=settings["time"], time_of_day=settings["time_of_day"])
            return shown[cells]

        if "altitude" not in maps.ds[maps.variable(name)].dims:
            return at(None)
        if z_m in maps.altitudes_m:
            return at(z_m)
        low_m = max(altitude_m for altitude_m in maps.altitudes_m if altitude_m < z_m)
        high_m = min(altitude_m for altitude_m in maps.altitudes_m if altitude_m > z_m)
        share = (z_m - low_m) / (high_m - low_m)
        # Satellites are whole; the lower map's are in view above it too.
        between = at(low_m) if name == VISIBLE else (1 - share) * at(low_m) + share * at(high_m)
        return np.where(maps.is_free(low_m, "centre")[cells], between, at(high_m))
