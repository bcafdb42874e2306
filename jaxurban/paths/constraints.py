"""Constraints: cells that no path may enter, whatever it would save: no-fly zones, bounds on any map, clearances."""

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxurban import wings
from jaxurban.checks import nearest_name, typed
from jaxurban.errors import IgnoredZoneWarning, InputError, warn
from jaxurban.io.zone import Zone, cell_boxes, check_reach, touched_cells
from jaxurban.kernels.tolerances import FILE_MARGIN_M
from jaxurban.maps.levels import around
from jaxurban.paths.clearance import (
    closed_by_clearance,
    closing_step_m,
    kept_m,
    limit_near_m,
    reach_said,
)
from jaxurban.public import listed
from jaxurban.settings import (
    CLEARANCES,
    DEFAULTS,
    Planning,
    Preset,
    UnknownHeights,
    Vehicle,
    as_tuple,
    not_negative,
    parse_time,
)
from jaxurban.world.grid import Grid

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.planners.base import Cell

OPERATORS: dict[str, Callable] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}
BOUND = re.compile(
    r"\s*(\w+)\s*([<>=!]+)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?inf|nan)\s*",
    re.IGNORECASE,
)
KEPT_CLEAR = {  # entries of `Constraints.to_dict`, as messages call them
    "clearance_m": "clearance",
    "vertical_clearance_m": "vertical clearance",
}
GPS_FLOOR = "gps_floor"  # the metric
Altitudes = float | Sequence[float]


@dataclass(frozen=True)
class Bound:
    """A bound that a map must keep at every cell of a path.

    Attributes:
      variable: a metric (``"gps"``, its m in [0, 1]) or any other map (``"num_visible"``, ``"hdop"``, ``"density"``).
      comparison: one of `OPERATORS`.
      value: in the variable's unit.

    Raises:
      InputError: another comparison, or a value that is not finite, or beyond [0, 1] for a metric.
    """

    variable: str
    comparison: str
    value: float

    def __post_init__(self) -> None:
        """Refuse a bound that cannot be meant (the errors of the class)."""
        from jaxurban.metrics.registry import known_metrics  # imported here: it brings JAX

        if self.comparison not in OPERATORS:
            raise InputError(
                f"the bound {self} has the comparison {self.comparison!r}: use {', '.join(OPERATORS)}"
            )
        if not math.isfinite(self.value):
            raise InputError(f"the bound {self} needs a finite number, as in gps>=0.3")
        metric = known_metrics().get(self.variable)
        if metric is not None and metric.is_cost and not 0 <= self.value <= 1:
            raise InputError(
                f"the bound {self} asks what no cell or every cell has: m_{self.variable} lies in 0 to 1"
            )

    def __str__(self) -> str:
        return f"{self.variable}{self.comparison}{self.value:g}"

    @classmethod
    def parse(cls, text: str) -> "Bound":
        """Return the bound that a text such as ``"gps>=0.3"`` says.

        Raises:
          InputError: a text that does not read name, comparison, number; or a bound that cannot be meant.
        """
        parts = BOUND.fullmatch(text)  # groups: name, comparison, number
        if parts is None:
            raise InputError(
                f"the bound {text!r} must read name, one of {', '.join(OPERATORS)}, number, as in gps>=0.3 or "
                "num_visible>=4"
            )
        return cls(parts[1], parts[2], float(parts[3]))

    def is_kept(
        self,
        maps: "MetricMaps",
        altitude_m: float,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return ``[Y, X]`` bool: whether the bound holds in each cell. Without data it holds nowhere.

        Between two altitudes of the maps it must hold at both. Where the lower one has an obstacle, the upper one
        alone counts.

        Args:
          maps: that hold the variable. A DOP may be inf, which is compared like any number.
          altitude_m: above ground.
          time, time_of_day: of the GPS and the population map; the first if left out.

        Raises:
          InputError: no such map, or an altitude beyond the range of the maps.
        """
        variable = maps.variable(self.variable)
        names = sorted(str(name) for name in maps.ds if maps.ds[name].dims[-2:] == ("y", "x"))
        if variable not in names:
            raise InputError(
                f"the bound {self} is on a map that these maps do not hold{nearest_name(self.variable, names)}: choose "
                f"one of {', '.join(names)}, or make maps that hold it"
            )
        is_kept = maps.ds["has_data"].values.copy()
        for z_m in around(altitude_m, maps.altitudes_m):
            values = maps.m(self.variable, z_m, time=time, time_of_day=time_of_day)
            # A Python float compares in the map's own float32, so that gps>=0.7 holds where the map says 0.7.
            holds = OPERATORS[self.comparison](values, self.value)
            if z_m < altitude_m:
                holds = holds | (maps.m("obstacle", z_m) == 1)
            is_kept &= holds
        return is_kept


def gps_floor_m(maps: "MetricMaps", time: str | None = None) -> np.ndarray:
    """Return ``[Y, X]`` the heights above the ground from which GPS is good, inf where none suffices.

    Args:
      maps: that hold the GPS floor; of a long series, the highest over its times.
      time: of the map; the first if left out.

    Raises:
      InputError: maps without it, or an unknown time.
    """
    from jaxurban.metrics.variables import stored_name  # imported here: it brings JAX

    name = stored_name(GPS_FLOOR, maps.ds)
    if name not in maps.ds:
        raise InputError(
            "these maps hold no GPS floor: make them with [gps_floor] dop_threshold, or leave above_gps_floor "
            "(--require gps_floor) out"
        )
    return maps.m(name, time=time)


@typed
@dataclass(frozen=True)
class Constraints:
    """No-fly zones, bounds and clearances. Cells that one of them closes are closed to every planner.

    Closed are cells that a zone touches, where a bound is not kept, or that lie nearer to an obstacle than the
    clearance (`closed_by_clearance`). A horizontal one is measured from the roofs that touch a cell under every rule of
    obstacles, a vertical one alone from those that the maps' rule counts. A roof of guessed height counts in every cell
    that it touches, up to what it may reach (``unknown_heights``), over which no more is kept.

    Attributes:
      zones: from `jaxurban.flights.airspace`; with times of their own they are closed until `at` knows better.
      bounds: what must hold at every cell of a path.
      clearance_m: horizontal distance that paths keep from buildings as high as they fly, and from the maps' border.
      vertical_clearance_m: height that paths keep over roofs; a roof nearer below counts as one as high as they fly.
      vehicle: what flies.
      unknown_heights: how high roofs of unknown height count: ``"highest"``, their bound; ``"likely"``, what 99 % of
        their kind keep below; ``"guess"``, no more than the maps show.
      above_gps_floor: whether paths stay at or above the maps' GPS floor; missions then take off only where it is 0.

    What of clearances, vehicle and unknown heights is left out is as the maps' scenario has it, or else the preset
    (`under`): 0 m, 3 m over roofs (0 under ``"paper"``), a point that any route suits, and ``"likely"`` (``"guess"``
    under ``"paper"``).

    Raises:
      InputError: a clearance that is not a number of metres from 0 up.

    Examples:
      >>> limits = ju.Constraints(clearance_m=40.5)
      >>> limits.horizontal_m, limits.vertical_m
      (40.5, 3.0)
      >>> apart = ju.plan(maps, start, goal, altitude_m=60.0, objective="distance", constraints=limits)
      >>> shortest = ju.plan(maps, start, goal, altitude_m=60.0, objective="distance")
      >>> apart.status.value, round(apart.length_m), round(shortest.length_m)
      ('optimal', 836, 766)
    """

    zones: tuple[Zone, ...] = ()
    bounds: tuple[Bound, ...] = ()
    clearance_m: float | None = None
    vertical_clearance_m: float | None = None
    vehicle: Vehicle | None = None
    unknown_heights: UnknownHeights | None = None
    above_gps_floor: bool = False

    def __post_init__(self) -> None:
        """Refuse a clearance below 0; one that is None comes from the scenario or the preset."""
        for name in CLEARANCES:
            metres = getattr(self, name)
            if metres is not None:
                not_negative(name, metres)

    @classmethod
    @typed
    def read(
        cls,
        no_fly: str | Path | Iterable[str | Path] = (),
        require: str | Iterable[str] = (),
        *,
        clearance_m: float | None = None,
        vertical_clearance_m: float | None = None,
        vehicle: Vehicle | None = None,
        unknown_heights: UnknownHeights | None = None,
    ) -> "Constraints":
        """Return the constraints in files, texts and numbers.

        Args:
          no_fly: a file of polygons or several (GeoJSON, KML ...; `read_zones` says what is read).
          require: ``"gps>=0.3"``, or a list of such; ``"gps_floor"`` alone is ``above_gps_floor``.
          clearance_m, vertical_clearance_m, vehicle, unknown_heights: the attributes.

        Returns:
          `Constraints` with every zone of the files and every bound, in their order.

        Raises:
          InputError: a file or a bound that cannot be read, or a clearance below 0.

        Examples:
          >>> import geopandas, shapely
          >>> park = geopandas.GeoSeries([shapely.box(-73.972, 40.779, -73.970, 40.780)], crs="EPSG:4326")
          >>> park.to_file("park.geojson")
          >>> limits = ju.Constraints.read("park.geojson", require=["gps>=0.5", "num_visible>=4"], clearance_m=5.0)
          >>> print(limits)
          1 no-fly zone, gps>=0.5, num_visible>=4, clearance of 5 m, vertical clearance of 3 m
        """
        zones: list[Zone] = []
        for file in as_tuple(no_fly):
            zones.extend(wings.read_zones(file))
        texts = [str(text).strip() for text in as_tuple(require)]
        bounds = [Bound.parse(text) for text in texts if text != GPS_FLOOR]
        kept = clearance_m, vertical_clearance_m, vehicle, unknown_heights, GPS_FLOOR in texts
        return cls(tuple(zones), tuple(bounds), *kept)

    def __str__(self) -> str:
        return describe_constraints(self.to_dict())

    @property
    def keeps_clear(self) -> bool:
        """Whether paths keep a distance above 0 from obstacles, horizontally or vertically."""
        return self.horizontal_m > 0 or self.vertical_m > 0

    @property
    def horizontal_m(self) -> float:
        """The horizontal clearance."""
        return self._whole.clearance_m

    @property
    def vertical_m(self) -> float:
        """The vertical clearance."""
        return self._whole.vertical_clearance_m

    @property
    def of_unknown(self) -> UnknownHeights:
        """``unknown_heights``, as without any scenario where it is left out."""
        return self._whole.unknown_heights

    @property
    def _whole(self) -> Any:
        """The constraints with what is left out as without any scenario."""
        return self.under(DEFAULTS, Vehicle())

    def under(self, planning: Planning, vehicle: Vehicle) -> "Constraints":
        """Return the constraints with what they leave out taken from a ``[planning]`` and a vehicle.

        Args:
          planning: whose preset and settings give the clearances and the rule that are None here.
          vehicle: what flies, if that is None here.

        Returns:
          `Constraints` whose clearances, in metres, vehicle and rule are all there; this one stays as it is.

        Examples:
          >>> limits = ju.Constraints(clearance_m=5.0).under(maps.planning, ju.Vehicle(speed_m_s=9.0))
          >>> limits.clearance_m, limits.vertical_clearance_m, limits.vehicle.speed_m_s
          (5.0, 3.0, 9.0)
        """
        defaults = {**vars(planning.rules), "vehicle": vehicle}
        names = *CLEARANCES, "vehicle", "unknown_heights"
        left_out = [name for name in names if getattr(self, name) is None]
        return replace(self, **{name: defaults[name] for name in left_out})

    def for_flight(self, planning: Planning, preset: Preset) -> "Constraints":
        """Return the constraints of a route to be flown: above all that roofs of unknown height may reach.

        Args:
          planning: of the maps; where it, or these constraints, or a preset say how high such roofs count, that holds.
          preset: of the call.

        Returns:
          `Constraints`, themselves where they are the same.

        Examples:
          >>> ju.Constraints().for_flight(maps.planning, "").unknown_heights
          'highest'
        """
        is_said = self.unknown_heights or planning.unknown_heights or preset or planning.preset
        return self if is_said else replace(self, unknown_heights="highest")

    def leg_margin_m(self, resolution_m: float) -> float:
        """Return how far straight legs stay from closed cells, beside which cells are closed (`closing_step_m`).

        Args:
          resolution_m: side of a cell.

        Returns:
          Metres, less than half a cell; 0 where no horizontal clearance is asked, or closed cells alone keep it.

        Examples:
          >>> limits = ju.Constraints(clearance_m=10.0)
          >>> [round(limits.leg_margin_m(side_m), 2) for side_m in (5.0, 20.0)]
          [0.05, 0.0]
        """
        _, margin_m = closing_step_m(self.horizontal_m, resolution_m)
        return margin_m

    def to_dict(self) -> dict[str, Any]:
        """Return the constraints as plain, JSON-ready values.

        Returns:
          ``no_fly`` (a dictionary for each zone, closed or not: its state and remarks, its first corner in degrees, its
          floor and ceiling in metres or None where it has none) and ``require`` (bounds as texts). Clearances in metres
          and what the vehicle is follow where they are not 0, and ``unknown_heights``; and ``above_gps_floor`` where it
          is asked.

        Examples:
          >>> record = ju.Constraints.read(require="gps>=0.5", clearance_m=5.0).to_dict()
          >>> record["require"], record["clearance_m"], record["vertical_clearance_m"], record["unknown_heights"]
          (['gps>=0.5'], 5.0, 3.0, 'likely')
        """
        from jaxurban.io.tables import number_or_none  # here: it brings pandas

        zones = [
            {
                "name": zone.name,
                "file": zone.source,
                "state": zone.state,
                "remarks": list(zone.remarks),
                "place": zone.place,
                "floor_m": number_or_none(zone.floor_m),  # None where it is open downward
                "ceiling_m": number_or_none(zone.ceiling_m),
                "outline": zone.outline,
            }
            for zone in self.zones
        ]
        kept_m = {name: float(getattr(self._whole, name)) for name in CLEARANCES}
        clearances_m = {name: metres for name, metres in kept_m.items() if metres}
        return {
            "no_fly": zones,
            "require": [str(bound) for bound in self.bounds],
            **clearances_m,
            **self._whole.vehicle.to_dict(),
            "unknown_heights": self.of_unknown,
            **({"above_gps_floor": True} if self.above_gps_floor else {}),
        }

    def at(self, time: str | None) -> "Constraints":
        """Return the constraints with the zones open that are not in force at a time of flight, which a warning names.

        A zone counts where it is in force at the time or within an hour after it (`zone.FLIGHT`).

        Returns:
          `Constraints` with the same zones; the same where no time is named or no zone has times.

        Examples:
          >>> limits = ju.Constraints(clearance_m=5.0)
          >>> limits.at("2020-04-27T16:00:00Z") == limits
          True
        """
        if time is None:
            return self
        flight = parse_time(time)
        zones = [zone.at([flight]) for zone in self.zones]
        off = [zone.label for zone in self.zones if not zone.is_in_force(flight)]
        if off:
            sentence = (
                f"zones not in force at {time} nor within an hour, which close nothing: {len(off)}"
            )
            warn(f"{sentence} ({listed(off)})", IgnoredZoneWarning)
        return replace(self, zones=tuple(zones))

    def is_free(
        self,
        maps: "MetricMaps",
        altitude_m: Altitudes,
        *,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return where a path may fly: no obstacle, data there, closed by none of these constraints.

        Arguments and errors are those of `closed`.

        Returns:
          ``[Y, X]`` bool; ``[K, Y, X]`` of levels.

        Examples:
          >>> is_free = ju.Constraints(clearance_m=10.0).is_free(maps, [20.0, 60.0])
          >>> is_free.shape, is_free.sum(axis=(1, 2)).tolist()
          ((2, 30, 30), [463, 652])
        """
        is_free = np.stack([maps.is_free(z_m) for z_m in np.atleast_1d(altitude_m).tolist()])
        closed = self.closed(maps, altitude_m, time=time, time_of_day=time_of_day)
        return is_free.reshape(closed.shape) & ~closed

    def closed(
        self,
        maps: "MetricMaps",
        altitude_m: Altitudes,
        *,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return the cells that these constraints close, at one altitude or on levels.

        A path may climb between levels. A zone that lies wholly between two of them closes the lower one too, so that
        no climb or descent passes through it. A step from level to level needs its cells free on both. The lower level
        has all obstacles of the upper one and more, so that it keeps the clearance in between.

        Args:
          maps: the metric maps.
          altitude_m: above ground, or ``[K]`` ascending levels; with bounds, within the range of the maps' altitudes.
          time, time_of_day: of the GPS and the population map; the first if left out.

        Returns:
          ``[Y, X]`` bool; ``[K, Y, X]`` of levels. Obstacles are closed too where a clearance is kept from them, or
          where heights of roofs are guessed.

        Raises:
          InputError: a bound on a map that is not there, a GPS floor that is not, or an unknown altitude, time or time
            of day.

        Examples:
          >>> limits = ju.Constraints(clearance_m=10.0)
          >>> limits.closed(maps, 20.0).shape, limits.closed(maps, [20.0, 60.0]).shape
          ((30, 30), (2, 30, 30))
          >>> limits.closed(maps, [20.0, 60.0]).sum(axis=(1, 2)).tolist()
          [437, 248]
        """
        levels_m = np.atleast_1d(np.asarray(altitude_m, float))
        closed = self._closed_by_zones(maps.grid, levels_m)
        floor_m = gps_floor_m(maps, time) if self.above_gps_floor else np.float32(0)
        # Each `level_closed` is a view of `closed`, so that what is added to it is added there.
        for level_closed, z_m in zip(closed, levels_m.tolist(), strict=True):
            for bound in self.bounds:
                level_closed |= ~bound.is_kept(maps, z_m, time, time_of_day)
            level_closed |= ~(floor_m <= z_m)
            if self.keeps_clear or "roof_guessed" in maps.ds:
                level_closed |= closed_by_clearance(maps, z_m, self)
        return closed if np.ndim(altitude_m) else closed[0]

    def is_free_to_ground(
        self,
        maps: "MetricMaps",
        altitude_m: float,
        *,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return where a mission may take off and land: at an altitude, and straight below it down to the ground.

        A cell that a roof touches is not free, however high the roof is, nor one nearer to a roof than the clearance.
        Zones and the GPS floor count from the ground up, and bounds at each of the maps' altitudes below it.

        Args:
          maps, altitude_m, time, time_of_day: as for `closed`.

        Returns:
          ``[Y, X]`` bool.

        Raises:
          InputError: as for `closed`.

        Examples:
          >>> limits = ju.Constraints()
          >>> int(limits.is_free(maps, 60.0).sum()), int(limits.is_free_to_ground(maps, 60.0).sum())
          (852, 501)
        """
        levels_m = [z_m for z_m in sorted(maps.altitudes_m) if z_m < altitude_m]
        is_free = self.is_free(maps, altitude_m, time=time, time_of_day=time_of_day)
        touched = maps.with_obstacles("touched")
        is_free &= ~closed_by_clearance(touched, 0.0, self)
        is_free &= ~self._closed_by_zones(maps.grid, np.array([0.0, altitude_m])).any(axis=0)
        for bound in self.bounds:
            for z_m in levels_m:
                is_free &= bound.is_kept(maps, z_m, time, time_of_day)
        if self.above_gps_floor:
            is_free &= gps_floor_m(maps, time) <= 0
        return is_free

    def _closed_by_zones(self, grid: Grid, levels_m: np.ndarray) -> np.ndarray:
        """Return ``[K, Y, X]`` bool: the cells that zones close on each of ``[K]`` ascending levels (see `closed`).

        Warns and raises as `check_reach`.
        """
        next_level_m = np.append(levels_m[1:], levels_m[-1])  # none lies above the last
        closed = np.zeros((len(levels_m), *grid.shape), bool)
        reaches_grid = False
        for zone in self.zones:
            zone_m = zone.on(grid)  # its outline in the grid's CRS
            if zone_m.is_empty:
                continue
            reaches_grid = True
            holds_level = (zone.floor_m <= levels_m) & (levels_m <= zone.ceiling_m)
            # A zone between a level and the next closes the lower of the two.
            lies_above_level = (levels_m < zone.floor_m) & (zone.ceiling_m < next_level_m)
            is_closed_level = holds_level | lies_above_level
            if is_closed_level.any():
                closed[is_closed_level] |= touched_cells(zone_m, grid)
        if not reaches_grid:
            check_reach(self.zones, grid)
        return closed

    def reasons(
        self,
        maps: "MetricMaps",
        altitude_m: float,
        cell: "Cell",
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> list[str]:
        """Return why a cell is closed, a phrase for each constraint that closes it.

        Args:
          maps: on which the constraints are.
          altitude_m: above ground, within the range of the maps.
          cell: row and column.
          time, time_of_day: of the GPS and the population map; the first if left out.

        Returns:
          Texts for people, zones first, then bounds, the GPS floor, and a guessed height or else the clearances; empty
          where no constraint closes the cell.

        Examples:
          >>> ju.Constraints.read(require="gps>=0.999").reasons(maps, 60.0, (2, 2))
          ['the bound gps>=0.999']
          >>> ju.Constraints().reasons(maps, 60.0, (2, 2))
          []
        """
        reasons = []
        (cell_square,) = cell_boxes(maps.grid, np.array([cell]), 1)
        for zone in self.zones:
            is_at_height = zone.floor_m <= altitude_m <= zone.ceiling_m
            if is_at_height and zone.on(maps.grid).intersects(cell_square):
                reasons.append(f"the no-fly zone {zone.label} ({zone.heights})")

        for bound in self.bounds:
            is_kept = bound.is_kept(maps, altitude_m, time, time_of_day)
            if not is_kept[cell]:
                reasons.append(f"the bound {bound}")

        if self.above_gps_floor:
            floor_m = gps_floor_m(maps, time)[cell]
            if not floor_m <= altitude_m:
                floor = f"of {floor_m:.1f} m" if np.isfinite(floor_m) else "that no height reaches"
                reasons.append(f"the GPS floor {floor} there")

        limit_m = limit_near_m(maps, cell, self.horizontal_m, self.of_unknown)
        if limit_m > 0 and limit_m >= altitude_m:
            reasons.append(f"a roof of guessed height that {reach_said(limit_m)}")
        elif self.keeps_clear and closed_by_clearance(maps, altitude_m, self)[cell]:
            clearances = " and the ".join(describe_clearances(self.to_dict()))
            reasons.append(f"the {clearances} that is kept from obstacles and the border")
        return reasons


def describe_constraints(record: Mapping[str, Any]) -> str:
    """Return constraints for a person to read, from a record of `Constraints.to_dict`; empty where there are none."""
    num_zones = sum(zone["state"] == "closed" for zone in record.get("no_fly", ()))
    zones = {0: "", 1: "1 no-fly zone"}.get(num_zones, f"{num_zones} no-fly zones")
    floor = "at or above the GPS floor" if record.get("above_gps_floor") else ""
    phrases = [zones, *record.get("require", ()), floor, *describe_clearances(record)]
    return ", ".join(filter(None, phrases))


def describe_clearances(record: Mapping[str, Any]) -> list[str]:
    """Return a phrase for each distance kept from obstacles, from a record of `Constraints.to_dict`."""
    return [
        f"{phrase} of {record[name]:g} m" for name, phrase in KEPT_CLEAR.items() if record.get(name)
    ]


def describe_kept(record: Mapping[str, Any], resolution_m: float) -> str:
    """Return a phrase on the horizontal distance that routes keep, where it is more than was asked; else ``""``.

    Args:
      record: of `Constraints.to_dict`.
      resolution_m: side of a cell; distances come in steps of cells, so that more may be kept.
    """
    asked_m = record.get("clearance_m", 0.0)
    least_m = kept_m(asked_m, resolution_m)
    if least_m <= asked_m + FILE_MARGIN_M:
        return ""
    return f"at least {least_m:g} m kept on cells of {resolution_m:g} m"
