"""Constraints: cells that no path may enter, whatever it would save: no-fly zones, bounds on any map, clearances."""

import math
import operator
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxurban.errors import IgnoredZoneWarning, InputError, nearest_name, typed
from jaxurban.io.read.airspace import read_zones
from jaxurban.io.read.zone import Zone, cell_boxes, touched_cells
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import WEIGHTED_DOPS
from jaxurban.metrics.registry import METRICS, ON_REQUEST, known_metrics
from jaxurban.paths.clearance import FILE_MARGIN_M, closed_by_clearance, closing_step_m, kept_m, nearest_said
from jaxurban.settings import CLEARANCES, DEFAULTS, Planning, Vehicle, not_negative, parse_time

OPERATORS: dict[str, Callable] = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}
BOUND = re.compile(r"\s*(\w+)\s*([<>=!]+)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?inf|nan)\s*", re.IGNORECASE)
MOST_NAMED = 3  # zones, in a warning
KEPT_CLEAR = {  # entries of `Constraints.to_dict`, as messages call them
    "clearance_m": "clearance",
    "vehicle_radius_m": "vehicle's radius",
    "vertical_clearance_m": "vertical clearance",
}
Cell = tuple[int, ...]
Altitudes = float | Sequence[float]
Require = str | Mapping[str, tuple[str, float]] | Iterable[str]


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
            raise InputError(f"the bound {self} has the comparison {self.comparison!r}: use {', '.join(OPERATORS)}")
        if not math.isfinite(self.value):
            raise InputError(f"the bound {self} needs a finite number, as in gps>=0.3")
        if self.variable in known_metrics() and not 0 <= self.value <= 1:
            raise InputError(f"the bound {self} asks what no cell or every cell has: m_{self.variable} lies in 0 to 1")

    def __str__(self) -> str:
        return f"{self.variable}{self.comparison}{self.value:g}"

    @classmethod
    def parse(cls, text: str) -> "Bound":
        """Return the bound in ``"gps>=0.3"``.

        Raises:
          InputError: text that does not read name, comparison, number.
        """
        if (found := BOUND.fullmatch(text)) is None:
            raise InputError(
                f"the bound {text!r} must read name, one of {', '.join(OPERATORS)}, number, as in gps>=0.3 or "
                "num_visible>=4"
            )
        return cls(found[1], found[2], float(found[3]))

    def is_kept(
        self, maps: MetricMaps, altitude_m: float, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return ``[Y, X]`` bool: the bound holds. Nothing holds where there are no data; a DOP may be inf.

        Between two altitudes of the maps it must hold at both, or at the upper one over a wall of the lower.

        Raises:
          InputError: no such map, or an altitude beyond the range of the maps.
        """
        variable = maps.variable(self.variable)
        if variable not in maps.ds or maps.ds[variable].dims[-2:] != ("y", "x"):
            held = sorted(str(name) for name, array in maps.ds.data_vars.items() if array.dims[-2:] == ("y", "x"))
            made_by = _made_by(variable, held)
            meant = "" if made_by else nearest_name(self.variable, held)
            raise InputError(
                f"the bound {self} is on a map that these maps do not hold{meant}: they hold {', '.join(held)}{made_by}"
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

    What of these three is left out is as the maps' scenario has it, or else the preset (`under`): 0 m, 3 m over roofs
    (0 under ``"paper"``), and a point that any route suits.

    Raises:
      InputError: a clearance that is not a number of metres from 0 up.
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
        require: Require = (),
        *,
        clearance_m: float | None = None,
        vertical_clearance_m: float | None = None,
        vehicle: Vehicle | None = None,
    ) -> "Constraints":
        """Return the constraints in files, texts and numbers.

        Args:
          no_fly: a file of polygons or several (GeoJSON, KML ...; `read_zones` says what is read).
          require: ``"gps>=0.3"``, a list of such, or ``{"gps": (">=", 0.3)}``.
          clearance_m: least horizontal distance to buildings as high as a path.
          vertical_clearance_m: least height over roofs.
          vehicle: what flies.

        Raises:
          InputError: a file or a bound that cannot be read, or a clearance below 0.
        """
        files = [no_fly] if isinstance(no_fly, (str, Path)) else no_fly
        if isinstance(require, Mapping):
            bounds = [_bound(name, given) for name, given in require.items()]
        else:
            bounds = [Bound.parse(text) for text in ([require] if isinstance(require, str) else require)]
        zones = tuple(zone for file in files for zone in read_zones(file))
        return cls(zones, tuple(bounds), clearance_m, vertical_clearance_m, vehicle)

    def __str__(self) -> str:
        return constraints_said(self.to_dict())

    @property
    def keeps_clear(self) -> bool:
        """Whether paths keep a distance from obstacles."""
        return bool(self.horizontal_m or self._vertical_m)

    @property
    def horizontal_m(self) -> float:
        """The clearance and the vehicle's radius."""
        return self._clearances_m[CLEARANCES[0]] + (self.vehicle or Vehicle()).radius_m

    @property
    def _vertical_m(self) -> float:
        return self._clearances_m[CLEARANCES[1]]

    @property
    def _clearances_m(self) -> dict[str, float]:
        asked = {name: getattr(self, name) for name in CLEARANCES}
        return {name: getattr(DEFAULTS, name) if value is None else value for name, value in asked.items()}

    def under(self, planning: Planning, vehicle: Vehicle) -> "Constraints":
        """Return the constraints, what they leave out taken from a ``[planning]`` and a vehicle."""
        rest = {**{name: getattr(planning, name) for name in CLEARANCES}, "vehicle": vehicle}
        return replace(self, **{name: value for name, value in rest.items() if getattr(self, name) is None})

    def leg_margin_m(self, resolution_m: float) -> float:
        """Return what straight legs keep from closed cells of that side, for the clearance (`closing_step_m`)."""
        return closing_step_m(self.horizontal_m, resolution_m)[1]

    def to_dict(self) -> dict[str, Any]:
        """Return the constraints as plain, JSON-ready values; floors and ceilings are None where there are none.

        Clearances and the vehicle are left out where they limit and tell nothing.
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

        Where no time is named, all stay. A zone counts as in force until an hour after the time too (`zone.FLIGHT`).
        """
        if time is None or not any(zone.start or zone.end for zone in self.zones):
            return self
        flight = parse_time(time)
        is_on = [zone.is_in_force(flight) for zone in self.zones]
        if off := [zone.label for zone, on in zip(self.zones, is_on, strict=True) if not on]:
            shown = ", ".join(off[:MOST_NAMED]) + ", ..." * (len(off) > MOST_NAMED)
            sentence = f"zones not in force at {time} nor within an hour, which close nothing: {len(off)} ({shown})"
            warnings.warn(sentence, IgnoredZoneWarning, stacklevel=3)
        return replace(self, zones=tuple(zone for zone, on in zip(self.zones, is_on, strict=True) if on))

    def is_free(
        self, maps: MetricMaps, altitude_m: Altitudes, *, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return bool: where a path may fly: no obstacle, data there, closed by none of these constraints.

        Shapes, arguments and errors are those of `closed`.
        """
        is_free = np.stack([maps.is_free(z_m) for z_m in np.atleast_1d(altitude_m).tolist()])
        closed = self.closed(maps, altitude_m, time=time, time_of_day=time_of_day)
        return is_free.reshape(closed.shape) & ~closed

    def closed(
        self, maps: MetricMaps, altitude_m: Altitudes, *, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return ``[Y, X]`` bool: cells that these constraints close; of levels ``[K, Y, X]``.

        Of levels between which a path may climb a zone that lies wholly between two closes the lower one too, so that
        no climb or descent passes it. A step from level to level needs its cells free on both; the lower one, with all
        obstacles of the upper and more, keeps the clearance in between.

        Args:
          maps: the metric maps.
          altitude_m: above ground, or ``[K]`` ascending levels; with bounds, within the range of the maps' altitudes.
          time: UTC time of the GPS map; the first if left out.
          time_of_day: of the population map; the first if left out.

        Raises:
          InputError: a bound on a map that is not there, or an unknown altitude, time or time of day.
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
            warnings.warn(sentence, IgnoredZoneWarning, stacklevel=2)
        for level_closed, z_m in zip(closed, levels_m, strict=True):
            for bound in self.bounds:
                level_closed |= ~bound.is_kept(maps, z_m, time, time_of_day)
            if self.keeps_clear:
                level_closed |= closed_by_clearance(maps, z_m, self.horizontal_m, self._vertical_m)
        return closed if np.ndim(altitude_m) else closed[0]

    def reasons(
        self, maps: MetricMaps, altitude_m: float, cell: Cell, time: str | None = None, time_of_day: str | None = None
    ) -> list[str]:
        """Return a phrase for each constraint that closes a cell, empty where none does."""
        (box,) = cell_boxes(maps.grid, np.array([cell]), 1)
        zones = [
            f"the no-fly zone {zone.label} ({zone.heights})"
            for zone in self.zones
            if zone.floor_m <= altitude_m <= zone.ceiling_m and zone.on(maps.grid).intersects(box)
        ]
        bounds = []
        for bound in self.bounds:
            if not bound.is_kept(maps, altitude_m, time, time_of_day)[cell]:
                around_m = maps.around(altitude_m)
                values = [maps.m(bound.variable, z_m, time=time, time_of_day=time_of_day)[cell] for z_m in around_m]
                # Between two altitudes the nearer map's, over an obstacle of the lower one the upper's.
                at = min(range(len(values)), key=lambda k: (np.isnan(values[k]), abs(around_m[k] - altitude_m)))
                where = "there" if around_m[at] == altitude_m else f"there at {around_m[at]:g} m"
                bounds.append(f"the bound {bound} (it is {values[at]:g} {where})")
        clear_m = self.horizontal_m, self._vertical_m
        if self.keeps_clear and closed_by_clearance(maps, altitude_m, *clear_m)[cell]:
            phrase, is_over = nearest_said(maps, altitude_m, *clear_m, cell)
            said = clearances_said(self.to_dict())
            kept = said[-1:] if is_over else said[: len(said) - bool(self._vertical_m)]
            return [*zones, *bounds, f"the {' and the '.join(kept)} ({phrase})"]
        return zones + bounds


def constraints_said(record: Mapping[str, Any]) -> str:
    """Return constraints as `Constraints.to_dict` holds them, for a person to read; empty where there are none."""
    num = len(record.get("no_fly", ()))
    zones = [f"{num} no-fly zone" + "s" * (num > 1)] if num else []
    return ", ".join([*zones, *record.get("require", ()), *clearances_said(record)])


def clearances_said(record: Mapping[str, Any]) -> list[str]:
    """Return a phrase for each distance that constraints, as `Constraints.to_dict` holds them, keep from obstacles."""
    return [f"{said} of {record[name]:g} m" for name, said in KEPT_CLEAR.items() if record.get(name)]


def kept_said(record: Mapping[str, Any], resolution_m: float) -> str:
    """Return the horizontal distance that is really kept, a phrase; empty where that is what such constraints ask."""
    asked_m = record.get("clearance_m", 0.0) + record.get("vehicle_radius_m", 0.0)
    kept = kept_m(asked_m, resolution_m)
    return f"at least {kept:g} m kept on cells of {resolution_m:g} m" if kept > asked_m + FILE_MARGIN_M else ""


def _made_by(variable: str, held: Collection[str]) -> str:
    """Return what makes a variable that not all maps hold, as settings of a scenario; empty for others."""
    made_of = {name: (f"[{name}]", (*metric.variables,)) for name, metric in ON_REQUEST.items()}
    made_of["gps"] = '[gps] weighting = "elevation"', WEIGHTED_DOPS
    for name, (setting, variables) in made_of.items():
        is_series = f"{name}_availability" in held
        if variable in variables or (is_series and name == "gps" and variable in METRICS["gps"].variables):
            told = '[gps] series = "epochs" instead of statistics' if is_series else setting
            return f" (a scenario with {told} makes it)"
    return ""


def _bound(name: str, given: object) -> Bound:
    """Return the bound that a mapping gives as ``{name: (comparison, value)}``."""
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise InputError(f"the bound on {name!r} must be a comparison and a number, as in ('>=', 0.3), got {given!r}")
    return Bound.parse(f"{name}{given[0]}{given[1]}")
