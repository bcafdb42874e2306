"""PlannedPath: a path over metric maps with its cost, metrics and settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxurban.errors import InputError, typed
from jaxurban.io.read.zone import Zone
from jaxurban.paths.export.write import MISSION, write_path
from jaxurban.paths.ground import Ground
from jaxurban.planners.base import Path, Status
from jaxurban.world.show import Shown

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.cautions import Caution
    from jaxurban.paths.explain import RouteReport


@dataclass(frozen=True, repr=False)
class PlannedPath(Shown):
    """A path over metric maps with its cost and metrics. ``N`` points.

    Attributes:
      status: how the planner ended; `Status.has_path` tells whether there is a path.
      xy_m: ``[N, 2]`` easting, northing of the path's points in the maps' CRS; empty without a path.
      lonlat: ``[N, 2]`` longitude, latitude in degrees.
      z_m: ``[N]`` altitude above ground of each point.
      altitude_m: flight altitude above ground; of a path that climbs or descends, the one that it starts at.
      cost: weighted cost under ``cost_model``, whatever the objective was; inf without a path.
      cost_by_layer: parts of ``cost``: "distance" and each metric.
      length_m: length of the path.
      metrics: mean of each metric m along the path, weighted by length, by name.
      snap_distance_m: how far start and goal were moved to the centres of their cells (or, with
        ``snap``, of the nearest free cells; the message tells which of them).
      search: what the planner itself reported: bound, expansions, time, heuristic, backend, note.
      settings: planner, weights, cost model, objective and the like, for the record.
      crs: CRS of ``xy_m``.
      ground: the ground under the path; None without a path, or over maps without terrain.
      zones: the no-fly zones that it was planned around, for the geofence of a mission.
      maps: that it was planned on; None of a path made by hand.
    """

    status: Status
    xy_m: np.ndarray
    lonlat: np.ndarray
    z_m: np.ndarray
    altitude_m: float
    cost: float
    cost_by_layer: Mapping[str, float]
    length_m: float
    metrics: Mapping[str, float]
    snap_distance_m: tuple[float, float]
    search: Path
    settings: Mapping[str, Any]
    crs: str
    ground: Ground | None = None
    zones: tuple[Zone, ...] = ()
    maps: "MetricMaps | None" = field(default=None, compare=False)

    @cached_property
    def cautions(self) -> "list[Caution]":
        """What a pilot should know of it (`jaxurban.cautions`); empty without a path, or without its maps."""
        from jaxurban.paths.cautions import cautions

        return [] if self.maps is None or not self.status.has_path else cautions(self, self.maps)

    @property
    def facts(self) -> dict[str, str]:
        """How the planner ended, and the path's cost, length, altitudes and metrics."""
        search = self.search
        facts = {"status": self.status.value, "planner": f"{search.planner} ({search.heuristic}, {search.backend})"}
        if not self.status.has_path:
            return facts | {"message": self.search.sentence}
        low_m, high_m = self.z_m.min(), self.z_m.max()
        metrics = ", ".join(f"{name} {m:.2f}" for name, m in self.metrics.items())
        return facts | {
            "cost": f"{self.cost:,.2f}",
            "length": f"{self.length_m:,.0f} m in {len(self.xy_m):,} points",
            "altitude": f"{low_m:g} m" if low_m == high_m else f"{low_m:g} to {high_m:g} m",
            "mean metrics": metrics or "none",
        }

    @typed
    def save(
        self,
        file: str | FilePath,
        *more: str | FilePath,
        report: "RouteReport | None" = None,
        end: str | None = None,
    ) -> FilePath:
        """Write the path in the format that a file's suffix names, and return the (first) file.

        Args:
          file: ``.geojson``, ``.kml``, ``.gpx`` or ``.plan`` (see `jaxurban.paths.export.write.FORMATS`).
          more: further files, for further formats.
          report: from `jaxurban.explain`, to be written too.
          end: of a ``.plan``: ``"land"``, ``"return"`` or ``"none"`` (see `write_path`).

        Raises:
          InputError: there is no path, another suffix, an end that is none or without a ``.plan``, or a folder that
            does not exist or cannot be written to.
        """
        if not self.status.has_path:
            raise InputError(f"there is no path to save: {self.status.sentence}")
        files = [FilePath(each) for each in (file, *more)]
        missions = [each for each in files if each.suffix.lower() == MISSION] or files  # which refuse an end
        for each in files:
            write_path(self, each, report, end=end if each in missions else None)
        return FilePath(file)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the points' arrays as plain, JSON-ready values (None for no number)."""
        return {
            "status": self.status.value,
            "message": " ".join(filter(None, (self.search.sentence, self.search.note))),
            "cost": _number(self.cost),
            "cost_by_layer": {name: _number(value) for name, value in self.cost_by_layer.items()},
            "length_m": _number(self.length_m),
            "metrics": {name: _number(value) for name, value in self.metrics.items()},
            "altitude_m": self.altitude_m,
            "snap_distance_m": {"start": self.snap_distance_m[0], "goal": self.snap_distance_m[1]},
            "objective_cost": _number(self.search.cost),
            "lower_bound": _number(self.search.lower_bound),
            "gap": _number(self.search.gap),
            "graph": self.search.graph,
            "num_expanded": self.search.num_expanded,
            "elapsed_s": self.search.elapsed_s,
            "setup_s": self.search.setup_s,
            "planner": self.search.planner,
            "heuristic": self.search.heuristic,
            "backend": self.search.backend,
            "num_points": len(self.xy_m),
            "batches": [
                {"elapsed_s": seconds, "samples": samples, "cost": _number(cost)}
                for seconds, samples, cost in self.search.history
            ],
            "crs": self.crs,
            "settings": dict(self.settings),
        }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
