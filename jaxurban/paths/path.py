"""PlannedPath: a path over metric maps, its cost, metrics, settings and the ground under it, and what is said of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path as FilePath
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.tables import number_or_none, numbers_or_none
from jaxurban.io.zone import Zone
from jaxurban.knowledge import Caution, sentences_of
from jaxurban.maps.metric_maps import MapsLike, MetricMaps
from jaxurban.paths.ground import Ground
from jaxurban.paths.route_report import RouteReport
from jaxurban.pictures import MapForm
from jaxurban.planners.base import Path, Status
from jaxurban.public import FactsRepr
from jaxurban.settings import FlownBy, MissionEnd

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OF_SEARCH = ("graph", "num_expanded", "elapsed_s", "setup_s", "planner", "heuristic", "backend")


@dataclass(frozen=True, repr=False)
class PlannedPath(FactsRepr):
    """A path over metric maps with its cost and metrics. ``N`` points.

    Attributes:
      status: how the planner ended; `Status.has_path` says whether there is a path.
      xy_m: ``[N, 2]`` easting, northing of the path's points in the maps' CRS; empty without a path.
      lonlat: ``[N, 2]`` longitude, latitude in degrees.
      z_m: ``[N]`` altitude above ground of each point.
      altitude_m: flight altitude above ground; of a path that climbs or descends, the one that it starts at.
      cost: weighted cost under ``cost_model``, whatever the objective was; inf without a path.
      cost_by_layer: parts of ``cost``: "distance" and each metric.
      length_m: length of the path.
      metrics: mean of each metric m along the path, weighted by length, by name.
      snap_distance_m: how far start and goal were moved to the centres of their cells (or, with
        ``snap``, of the nearest free cells; the message says which of them).
      search: what the planner itself reported: bound, expansions, time, heuristic, backend, note.
      settings: planner, weights, cost model, objective and the like, for the record.
      crs: CRS of ``xy_m``.
      ground: the ground under the path; None without a path, or over maps without terrain.
      zones: the no-fly zones that it was planned around, for the geofence of a mission.
      exposure_by_layer: (1 / l0) x integral of each metric's cost c along the path, not weighted, by name, l0 the cost
        model's reference length.
      maps: that it was planned on; None of a path made by hand.

    Examples:
      >>> path
      PlannedPath(status: optimal; ...; length: 848 m in 38 points; altitude: 60 m; mean metrics: gps 0.88, ...)
        note: Buildings: the nearest that reaches the flight height is 30.0 m away, 486 m along the route.
        ...
      >>> {name: round(cost) for name, cost in path.cost_by_layer.items()}
      {'distance': 85, 'gps': 20, 'lidar': 166, 'population': 12, 'risk': 0}
      >>> path.xy_m.shape, path.lonlat[0].round(4).tolist()
      ((38, 2), [-73.9732, 40.7774])
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
    exposure_by_layer: Mapping[str, float] = field(default_factory=dict)
    maps: MetricMaps | None = field(default=None, compare=False)

    @cached_property
    def cautions(self) -> list[Caution]:
        """What a pilot should know of it (`jaxurban.cautions`); without a path or its maps, what its message notes."""
        if self.maps is None or not self.status.has_path:
            return list(map(Caution, sentences_of(self.search.note)))
        return resolve_name("jaxurban.paths.profile:cautions")(self, self.maps)

    @property
    def message(self) -> str:
        """What happened, and what else a reader of the path must know: sentences."""
        return " ".join(filter(None, (self.search.sentence, self.search.note)))

    @property
    def facts(self) -> dict[str, str]:
        """How the planner ended, and the path's cost, length, altitudes and metrics."""
        search = self.search
        facts = {
            "status": self.status.value,
            "planner": f"{search.planner} ({search.heuristic}, {search.backend})",
        }
        if not self.status.has_path:
            return facts | {"message": self.search.sentence}
        low_m, high_m = self.z_m.min(), self.z_m.max()
        altitude = f"{low_m:g} m" if low_m == high_m else f"{low_m:g} to {high_m:g} m"
        metrics = ", ".join(f"{name} {m:.2f}" for name, m in self.metrics.items())
        return facts | {
            "cost": f"{self.cost:,.2f}",
            "length": f"{self.length_m:,.0f} m in {len(self.xy_m):,} point"
            + "s" * (len(self.xy_m) > 1),
            "altitude": altitude,
            "mean metrics": metrics or "none",
        }

    @typed
    def save(
        self,
        file: str | FilePath,
        *more: str | FilePath,
        report: RouteReport | None = None,
        end: MissionEnd | None = None,
        autopilot: FlownBy | None = None,
    ) -> FilePath:
        """Write the path in the format that a file's suffix names, and return the (first) file.

        Args:
          file: ``.geojson``, ``.kml``, ``.gpx`` or ``.plan`` (see `jaxurban.flights.export.write.FORMATS`).
          more: further files, for further formats.
          report: from `jaxurban.explain`, to be written too.
          end: how a mission in a ``.plan`` ends: ``"land"``, ``"return"`` or ``"none"`` (see `write_path`).
          autopilot: which one a ``.plan`` is for: ``"px4"`` if left out, or ``"ardupilot"``.

        Returns:
          The first file as a `pathlib.Path`.

        Raises:
          InputError: there is no path, another suffix, an unknown end or autopilot, one without a ``.plan``, a
            ``.plan`` that takes off or lands through a roof or meets anything else (the other files are written), or a
            folder that does not exist or cannot be written to.

        Examples:
          >>> path.save("route.geojson", "route.kml").name
          'route.geojson'
          >>> flight = ju.plan(maps, start, goal, altitude_m=60.0, snap=True, on_ground=True)
          >>> flight.save("mission.plan", report=ju.explain(flight, maps), end="land").exists()
          True
        """
        if not self.status.has_path:
            raise InputError(f"there is no path to save: {self.status.sentence}")
        files = [FilePath(path) for path in (file, *more)]
        write = resolve_name("jaxurban.flights.export.write:write_files")
        write(self, files, report, end=end, autopilot=autopilot)
        return files[0]

    def explain(self, maps: MapsLike | None = None, **options: Any) -> RouteReport:
        """Return what the path costs and meets, in whole and by segment.

        Args:
          maps: that it was planned on, or their folder; left out, those that it names.
          options: further arguments of `jaxurban.explain`, such as ``speed_m_s``.

        Returns:
          `RouteReport`, as from `jaxurban.explain`.

        Raises:
          InputError: as of `jaxurban.explain`.

        Examples:
          >>> round(path.explain().totals["people_overflown"])
          69
        """
        explain = resolve_name("jaxurban.paths.explain:explain")
        return explain(self, maps, **options)

    @typed
    def plot(self, **form: Unpack[MapForm]) -> "Figure":
        """Return a picture of the path over the cost of the maps that it was planned on; `jaxurban.plot` draws several.

        Args:
          form: width, ax, title and cmap, as in `MetricMaps.plot`.

        Returns:
          A Matplotlib figure, which a notebook shows.

        Raises:
          InputError: a path made by hand, which names no maps.

        Examples:
          >>> path.plot().savefig("path.png")
        """
        from jaxurban import plot  # imported here: it brings Matplotlib

        if self.maps is None:
            raise InputError(
                "the path names no maps to be drawn over: give them, as in ju.plot.plot_paths(maps, [path])"
            )
        return plot.plot_paths(self.maps, [self], **form)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the points' arrays as plain, JSON-ready values.

        Returns:
          A dictionary of the path's status, message, costs, lengths, metrics, search and settings; None stands for a
          number that is not finite.

        Examples:
          >>> record = path.to_dict()
          >>> record["status"], record["num_points"], record["settings"]["cost_model"]
          ('optimal', 38, 'line')
        """
        search = self.search
        return {
            "status": self.status.value,
            "message": self.message,
            "cost": number_or_none(self.cost),
            "cost_by_layer": numbers_or_none(self.cost_by_layer),
            "exposure_by_layer": numbers_or_none(self.exposure_by_layer),
            "length_m": number_or_none(self.length_m),
            "metrics": numbers_or_none(self.metrics),
            "altitude_m": self.altitude_m,
            "snap_distance_m": dict(zip(("start", "goal"), self.snap_distance_m, strict=True)),
            "objective_cost": number_or_none(search.cost),
            "lower_bound": number_or_none(search.lower_bound),
            "gap": number_or_none(search.gap),
            **{name: getattr(search, name) for name in OF_SEARCH},
            "num_points": len(self.xy_m),
            "batches": [
                {"elapsed_s": elapsed_s, "samples": samples, "cost": number_or_none(cost)}
                for elapsed_s, samples, cost in search.history
            ],
            "crs": self.crs,
            "settings": dict(self.settings),
        }
