"""Constraints: cells that no path may enter, whatever it would save: no-fly zones, bounds on any map, clearances.

A clearance is kept between the squares of cells, so that no point of a free cell is nearer to the outline of a
building, which lies within the cells that it touches. These distances come in steps: 0, 1, 1.41, 2, 2.24 ... cells.
What is asked beyond a step, up to half a cell, the legs of routes keep from closed cells; more closes the next step.
A straight line from a leg to an obstacle runs through closed cells last: so it is as long as both together, or longer.
"""

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, minimum_filter

from jaxurban.checks import nearest_name, typed
from jaxurban.errors import IgnoredZoneWarning, InputError, warn
from jaxurban.io.read.airspace import read_zones
from jaxurban.io.read.zone import Zone, cell_boxes, touched_cells
from jaxurban.kernels.tolerances import SAME_LENGTH
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.registry import known_metrics
from jaxurban.planners.base import Cell
from jaxurban.public import listed
from jaxurban.settings import CLEARANCES, Planning, Rules, Vehicle, not_negative, parse_time

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
    "vehicle_radius_m": "vehicle's radius",
    "vertical_clearance_m": "vertical clearance",
}
Altitudes = float | Sequence[float]
# What a file may take from a clearance: 8 mm by the seventh decimal of a degree, and up to 35 mm where a program draws
# a leg of 1 km straight in degrees instead of in the maps' CRS (length^2 / 8 R x tan of a latitude up to 60 degrees).
FILE_MARGIN_M = 0.05
MOST_LEG_MARGIN = (
    0.49  # cell sides: steps between the centres of cells keep half a side from closed cells
)


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
        if self.comparison not in OPERATORS:
            raise InputError(
                f"the bound {self} has the comparison {self.comparison!r}: use {', '.join(OPERATORS)}"
            )
        if not math.isfinite(self.value):
            raise InputError(f"the bound {self} needs a finite number, as in gps>=0.3")
        if self.variable in known_metrics() and not 0 <= self.value <= 1:
            raise InputError(
                f"the bound {self} asks what no cell or every cell has: m_{self.variable} lies in 0 to 1"
            )

    def __str__(self) -> str:
        return f"{self.variable}{self.comparison}{self.value:g}"

    @classmethod
    def parse(cls, text: str) -> "Bound":
        """Return the bound in ``"gps>=0.3"``.

        Raises:
          InputError: text that does not read name, comparison, number.
        """
        if (parts := BOUND.fullmatch(text)) is None:
            raise InputError(
                f"the bound {text!r} must read name, one of {', '.join(OPERATORS)}, number, as in gps>=0.3 or "
                "num_visible>=4"
            )
        return cls(parts[1], parts[2], float(parts[3]))

    def is_kept(
        self,
        maps: MetricMaps,
        altitude_m: float,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return ``[Y, X]`` bool: the bound holds. Nothing holds where there are no data; a DOP may be inf.

        Between two altitudes of the maps it must hold at both, or at the upper one over a wall of the lower.

        Raises:
          InputError: no such map, or an altitude beyond the range of the maps.
        """
        variable = maps.variable(self.variable)
        if variable not in maps.ds or maps.ds[variable].dims[-2:] != ("y", "x"):
            names = sorted(
                str(name)
                for name, array in maps.ds.data_vars.items()
                if array.dims[-2:] == ("y", "x")
            )
            raise InputError(
                f"the bound {self} is on a map that these maps do not hold{nearest_name(self.variable, names)}: choose "
                f"one of {', '.join(names)}, or make maps that hold it"
            )
        is_kept = maps.ds["has_data"].values.copy()
        for z_m in maps.around(altitude_m):
            values = maps.m(self.variable, z_m, time=time, time_of_day=time_of_day)
            # A Python float compares in the map's own float32, so that gps>=0.7 holds where the map says 0.7.
            holds = OPERATORS[self.comparison](values, self.value)
            is_kept &= holds | (maps.m("obstacle", z_m) == 1) if z_m < altitude_m else holds
        return is_kept


@typed
@dataclass(frozen=True)
class Constraints:
    """No-fly zones, bounds and clearances. Cells that one of them closes are closed to every planner.

    Closed are cells that a zone touches, where a bound is not kept, or that lie nearer to an obstacle than the
    clearance (`closed_by_clearance`). A horizontal one is measured from the roofs that touch a cell under every rule of
    obstacles, a vertical one alone from those that the maps' rule counts.

    Attributes:
      zones: from `jaxurban.io.read.airspace`; with times of their own they are closed until `at` knows better.
      bounds: what must hold at every cell of a path.
      clearance_m: horizontal distance that paths keep from buildings as high as they fly, and from the maps' border.
      vertical_clearance_m: height that paths keep over roofs; a roof nearer below counts as one as high as they fly.
      vehicle: what flies; its radius is kept beside ``clearance_m``.

    What of the last three is left out is as the maps' scenario has it, or else the preset (`under`): 0 m, 3 m over
    roofs (0 under ``"paper"``), and a point that any route suits.

    Raises:
      InputError: a clearance that is not a number of metres from 0 up.

    Examples:
      >>> limits = ju.Constraints(clearance_m=20.0, vehicle=ju.Vehicle(radius_m=0.5))
      >>> limits.horizontal_m, limits.vertical_m
      (20.5, 3.0)
      >>> apart = ju.plan(maps, start, goal, altitude_m=20.0, constraints=limits)
      >>> apart.status.value, round(apart.length_m), round(ju.plan(maps, start, goal, altitude_m=20.0).length_m)
      ('optimal', 864, 813)
    """

    zones: tuple[Zone, ...] = ()
    bounds: tuple[Bound, ...] = ()
    clearance_m: float | None = None
    vertical_clearance_m: float | None = None
    vehicle: Vehicle | None = None

    def __post_init__(self) -> None:
        for name in CLEARANCES:
            if (value := getattr(self, name)) is not None:
                not_negative(name, value)

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
    ) -> "Constraints":
        """Return the constraints in files, texts and numbers.

        Args:
          no_fly: a file of polygons or several (GeoJSON, KML ...; `read_zones` says what is read).
          require: ``"gps>=0.3"``, or a list of such.
          clearance_m, vertical_clearance_m, vehicle: the attributes.

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
        files = [no_fly] if isinstance(no_fly, (str, Path)) else no_fly
        bounds = [
            Bound.parse(text) for text in ([require] if isinstance(require, str) else require)
        ]
        zones = tuple(zone for file in files for zone in read_zones(file))
        return cls(zones, tuple(bounds), clearance_m, vertical_clearance_m, vehicle)

    def __str__(self) -> str:
        return describe_constraints(self.to_dict())

    @property
    def keeps_clear(self) -> bool:
        """Whether paths keep a distance from obstacles."""
        return self.horizontal_m > 0 or self.vertical_m > 0

    @property
    def horizontal_m(self) -> float:
        """The clearance and the vehicle's radius."""
        return self._clearances_m["clearance_m"] + (self.vehicle or Vehicle()).radius_m

    @property
    def vertical_m(self) -> float:
        """The vertical clearance."""
        return self._clearances_m["vertical_clearance_m"]

    @property
    def _clearances_m(self) -> dict[str, float]:
        return {
            name: getattr(self if getattr(self, name) is not None else Rules(), name)
            for name in CLEARANCES
        }

    def under(self, planning: Planning, vehicle: Vehicle) -> "Constraints":
        """Return the constraints, what they leave out taken from a ``[planning]`` and a vehicle.

        Returns:
          `Constraints` whose clearances, in metres, and vehicle are all there; this one stays as it is.

        Examples:
          >>> limits = ju.Constraints(clearance_m=5.0).under(maps.planning, ju.Vehicle(radius_m=0.5))
          >>> limits.clearance_m, limits.vertical_clearance_m, limits.vehicle.radius_m
          (5.0, 3.0, 0.5)
        """
        rest = {**{name: getattr(planning.rules, name) for name in CLEARANCES}, "vehicle": vehicle}
        return replace(
            self, **{name: value for name, value in rest.items() if getattr(self, name) is None}
        )

    def leg_margin_m(self, resolution_m: float) -> float:
        """Return what straight legs keep from closed cells of that side, for the clearance (`closing_step_m`).

        Returns:
          Metres, less than half a cell; 0 where no horizontal clearance is asked, or closed cells alone keep it.

        Examples:
          >>> limits = ju.Constraints(clearance_m=10.0)
          >>> [round(limits.leg_margin_m(side_m), 2) for side_m in (5.0, 20.0)]
          [0.05, 0.0]
        """
        return closing_step_m(self.horizontal_m, resolution_m)[1]

    def to_dict(self) -> dict[str, Any]:
        """Return the constraints as plain, JSON-ready values.

        Returns:
          ``no_fly`` (a dictionary for each zone, its floor and ceiling in metres or None where it has none) and
          ``require`` (bounds as texts). Clearances in metres and what the vehicle is follow where they are not 0.

        Examples:
          >>> ju.Constraints.read(require="gps>=0.5", clearance_m=5.0).to_dict()
          {'no_fly': [], 'require': ['gps>=0.5'], 'clearance_m': 5.0, 'vertical_clearance_m': 3.0}
        """
        return {
            "no_fly": [
                {
                    "name": zone.name,
                    "file": zone.source,
                    "floor_m": zone.floor_m if math.isfinite(zone.floor_m) else None,
                    "ceiling_m": zone.ceiling_m if math.isfinite(zone.ceiling_m) else None,
                    "outline": zone.outline,
                }
                for zone in self.zones
            ],
            "require": [str(bound) for bound in self.bounds],
            **{name: float(metres) for name, metres in self._clearances_m.items() if metres},
            **(self.vehicle or Vehicle()).to_dict(),
        }

    def at(self, time: str | None) -> "Constraints":
        """Return the constraints without the zones that are not in force at a time of flight, which a warning names.

        A zone counts where it is in force at the time or within an hour after it (`zone.FLIGHT`).

        Returns:
          `Constraints` with the zones that count; itself where no time is named or no zone has times.

        Examples:
          >>> limits = ju.Constraints(clearance_m=5.0)
          >>> limits.at("2020-04-27T16:00:00Z") == limits
          True
        """
        if time is None or not any(zone.start or zone.end for zone in self.zones):
            return self
        flight = parse_time(time)
        is_on = [zone.is_in_force(flight) for zone in self.zones]
        if off := [zone.label for zone, on in zip(self.zones, is_on, strict=True) if not on]:
            sentence = (
                f"zones not in force at {time} nor within an hour, which close nothing: {len(off)}"
            )
            warn(f"{sentence} ({listed(off)})", IgnoredZoneWarning)
        return replace(
            self, zones=tuple(zone for zone, on in zip(self.zones, is_on, strict=True) if on)
        )

    def is_free(
        self,
        maps: MetricMaps,
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
          ((2, 30, 30), [490, 726])
        """
        is_free = np.stack([maps.is_free(z_m) for z_m in np.atleast_1d(altitude_m).tolist()])
        closed = self.closed(maps, altitude_m, time=time, time_of_day=time_of_day)
        return is_free.reshape(closed.shape) & ~closed

    def closed(
        self,
        maps: MetricMaps,
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
          ``[Y, X]`` bool; ``[K, Y, X]`` of levels. Obstacles are closed too where a clearance is kept from them.

        Raises:
          InputError: a bound on a map that is not there, or an unknown altitude, time or time of day.

        Examples:
          >>> limits = ju.Constraints(clearance_m=10.0)
          >>> limits.closed(maps, 20.0).shape, limits.closed(maps, [20.0, 60.0]).shape
          ((30, 30), (2, 30, 30))
          >>> limits.closed(maps, [20.0, 60.0]).sum(axis=(1, 2)).tolist()
          [410, 174]
        """
        levels_m = np.atleast_1d(np.asarray(altitude_m, float)).tolist()
        grid = maps.grid
        closed = np.zeros((len(levels_m), *grid.shape), bool)
        levels, next_m = np.asarray(levels_m, float), np.append(levels_m[1:], levels_m[-1])
        is_near = False
        for zone in self.zones:
            part = zone.on(grid)
            is_near |= not part.is_empty
            is_at = (zone.floor_m <= levels) & (levels <= zone.ceiling_m)
            is_between = (levels < zone.floor_m) & (zone.ceiling_m < next_m)
            if np.any(is_at | is_between):
                closed[is_at | is_between] |= touched_cells(part, grid)
        if self.zones and not is_near:
            files = ", ".join(sorted({repr(zone.source) for zone in self.zones}))
            sentence = f"no zone of {files} lies in the maps' region, so that nothing is closed: check the file"
            warn(sentence, IgnoredZoneWarning)
        for level_closed, z_m in zip(closed, levels_m, strict=True):
            for bound in self.bounds:
                level_closed |= ~bound.is_kept(maps, z_m, time, time_of_day)
            if self.keeps_clear:
                level_closed |= closed_by_clearance(maps, z_m, self)
        return closed if np.ndim(altitude_m) else closed[0]

    def reasons(
        self,
        maps: MetricMaps,
        altitude_m: float,
        cell: Cell,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> list[str]:
        """Return why a cell is closed, a phrase for each constraint that closes it.

        Returns:
          Texts for people, zones first, then bounds and clearances; empty where no constraint closes the cell.

        Examples:
          >>> ju.Constraints.read(require="gps>=0.999").reasons(maps, 60.0, (2, 2))
          ['the bound gps>=0.999']
          >>> ju.Constraints().reasons(maps, 60.0, (2, 2))
          []
        """
        (box,) = cell_boxes(maps.grid, np.array([cell]), 1)
        zones = [
            f"the no-fly zone {zone.label} ({zone.heights})"
            for zone in self.zones
            if zone.floor_m <= altitude_m <= zone.ceiling_m and zone.on(maps.grid).intersects(box)
        ]
        bounds = [
            f"the bound {bound}"
            for bound in self.bounds
            if not bound.is_kept(maps, altitude_m, time, time_of_day)[cell]
        ]
        is_near = self.keeps_clear and closed_by_clearance(maps, altitude_m, self)[cell]
        kept = f"the {' and the '.join(describe_clearances(self.to_dict()))} that is kept from obstacles and the border"
        return [*zones, *bounds, *([kept] if is_near else [])]


def describe_constraints(record: Mapping[str, Any]) -> str:
    """Return constraints as `Constraints.to_dict` holds them, for a person to read; empty where there are none."""
    num = len(record.get("no_fly", ()))
    zones = [f"{num} no-fly zone" + "s" * (num > 1)] if num else []
    return ", ".join([*zones, *record.get("require", ()), *describe_clearances(record)])


def describe_clearances(record: Mapping[str, Any]) -> list[str]:
    """Return a phrase for each distance that constraints, as `Constraints.to_dict` holds them, keep from obstacles."""
    phrases = KEPT_CLEAR.items()
    return [f"{phrase} of {record[name]:g} m" for name, phrase in phrases if record.get(name)]


def describe_kept(record: Mapping[str, Any], resolution_m: float) -> str:
    """Return the horizontal distance that is really kept, a phrase; empty where that is what such constraints ask."""
    asked_m = record.get("clearance_m", 0.0) + record.get("vehicle_radius_m", 0.0)
    kept = kept_m(asked_m, resolution_m)
    return (
        f"at least {kept:g} m kept on cells of {resolution_m:g} m"
        if kept > asked_m + FILE_MARGIN_M
        else ""
    )


def obstacles_within(
    maps: MetricMaps, altitude_m: float, horizontal_m: float, vertical_m: float
) -> np.ndarray:
    """Return ``[Y, X]`` bool: a roof that touches the cell reaches an altitude, or ends less than ``vertical_m`` below.

    Roofs count where the maps' rule of obstacles has them, and where a distance is kept in every cell that they touch.
    Cells without data and roofs of unknown height count, bare ground does not. Over terrain a roof is as high as it is
    over the lowest ground within ``horizontal_m``, from which a path may pass it. No file is lower than planned.

    Raises:
      InputError: maps that hold no touched roofs.
    """
    name = "roof_touched" if horizontal_m or maps.obstacles == "touched" else "roof"
    if name not in maps.ds:
        raise InputError(
            "these maps hold no 'roof_touched', from which a clearance is measured: make them again, or keep none "
            "(clearance_m and vertical_clearance_m 0, no radius of the vehicle)"
        )
    roof_m = maps.m(name)
    reached_m = np.float32(altitude_m - vertical_m)
    over_m = roof_m + _over_lowest_ground_m(maps, horizontal_m) if "terrain" in maps.ds else roof_m
    is_obstacle = (
        (over_m >= reached_m) & (roof_m > 0) | np.isnan(roof_m) | ~maps.ds["has_data"].values
    )
    if altitude_m in maps.altitudes_m:
        is_obstacle |= maps.m("obstacle", altitude_m) != 0
    return is_obstacle


def _over_lowest_ground_m(maps: MetricMaps, reach_m: float) -> np.ndarray:
    """Return ``[Y, X]`` how much higher each cell's ground is than the lowest known within a reach (and more) of it."""
    ground_m = np.where(maps.ds["has_data"].values, maps.m("terrain"), np.inf)
    cells = min(
        math.ceil(reach_m / maps.grid.resolution_m) + 1, max(ground_m.shape)
    )  # squares, not centres, so near
    lowest_m = minimum_filter(ground_m, 2 * cells + 1, mode="nearest")
    return np.subtract(ground_m, lowest_m, out=np.zeros_like(ground_m), where=np.isfinite(ground_m))


def distance_to_obstacles_m(is_obstacle: np.ndarray, resolution_m: float) -> np.ndarray:
    """Return ``[Y, X]`` exact distance from each cell's square to the nearest obstacle's, or to the maps' border.

    Squares of ``[Y, X]`` obstacles that touch, by a side or a corner, are 0 apart. What stands beyond the border is not
    known, so that it counts as an obstacle.
    """
    # From a cell's centre to the obstacles grown by one cell all around it is as far as from square to square.
    grown = binary_dilation(np.pad(is_obstacle, 1, constant_values=True), np.ones((3, 3), bool))
    return distance_transform_edt(~grown)[1:-1, 1:-1] * resolution_m


def closing_step_m(horizontal_m: float, resolution_m: float) -> tuple[float, float]:
    """Return a clearance as the distance between squares below which cells are closed, and what legs keep beside it."""
    if horizontal_m == 0:  # closes the cells of obstacles alone
        return 0.0, 0.0
    sides = (horizontal_m + FILE_MARGIN_M) / resolution_m
    whole = np.arange(math.ceil(sides) + 1)
    steps = np.unique(np.hypot(whole, whole[:, None]))
    step = float(steps[np.searchsorted(steps, sides - MOST_LEG_MARGIN)])
    return step * resolution_m, max(0.0, sides - step) * resolution_m


def kept_m(horizontal_m: float, resolution_m: float) -> float:
    """Return what routes keep at least of obstacles under a clearance that is asked, in their files too."""
    if horizontal_m == 0:
        return 0.0
    step_m, _ = closing_step_m(horizontal_m, resolution_m)
    return max(horizontal_m, step_m - FILE_MARGIN_M)


def closed_by_clearance(
    maps: MetricMaps, altitude_m: float, constraints: Constraints
) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that the clearances of constraints close at an altitude above the ground.

    The horizontal one is kept from obstacles and the maps' border, beside `FILE_MARGIN_M`, by legs that keep the margin
    of `closing_step_m`; roofs less than the vertical one below the altitude are obstacles too.
    """
    is_obstacle = obstacles_within(
        maps, altitude_m, constraints.horizontal_m, constraints.vertical_m
    )
    step_m, _ = closing_step_m(constraints.horizontal_m, maps.grid.resolution_m)
    if step_m == 0:
        return is_obstacle
    return distance_to_obstacles_m(is_obstacle, maps.grid.resolution_m) < step_m * (1 - SAME_LENGTH)
