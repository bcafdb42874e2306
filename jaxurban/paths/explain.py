"""A planned route explained: what each layer and each segment costs, who is below, where GPS or room is scarce."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.checks import positive, typed, values_given
from jaxurban.errors import InputError
from jaxurban.kernels.line.traversal import Crossings
from jaxurban.maps.levels import Levels
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.gps import FIX
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.metrics.weights import Weights
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.export.base import numbers_or_none
from jaxurban.paths.ground_risk import OverflownDensity
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.plan import map_at
from jaxurban.paths.profile import (
    CLEARANCE,
    OUTSIDE,
    OVER_ROOF,
    VISIBLE,
    cautions,
    cut_evenly,
    cut_on,
    guessed_clearances,
    profile_of,
    without_fix,
)
from jaxurban.planners.cost import CostModel
from jaxurban.public import Caution, FactsRepr, caution_lines
from jaxurban.settings import Vehicle

SECONDS_PER_HOUR = 3600.0
COST_OF = "cost_of_"  # before the name of a layer, of its part of the cost
NO_FIX_IN_1_0 = "under_4_satellites_m"  # the name of ``no_fix_m`` in 1.0, which stays
DENSITY = "density_per_km2"
EXTRA_MAPS = {VISIBLE: VISIBLE, FIX: FIX, "density": DENSITY, "terrain": "terrain_m"}
SEGMENT_HEADS = {  # what a terminal has room for beside the costs; `RouteReport.segments` has more
    "min_gps": "min gps",
    "people_overflown": "people",
    "no_fix_m": "no fix m",
    CLEARANCE: "clear m",
    "time_s": "time s",
    "energy_wh": "Wh",
}


@dataclass(frozen=True, eq=False, repr=False)
class RouteReport(FactsRepr):
    """A route in numbers. Lengths are in the air; all is in still air, above ground.

    Attributes:
      totals: of the whole route: ``length_m``, ``cost`` and ``cost_of_*`` (distance and each metric),
        ``mean_*`` of each metric m (over the length), ``people_overflown`` (see `explain`),
        ``no_fix_m`` (length without a position fix: HDOP is infinite), the same as ``under_4_satellites_m`` (its name
        in 1.0), ``nearest_wall_m``, ``walls_outside_m`` (see
        `explain`), ``least_over_roofs_m`` (above the roofs beneath; NaN over none), ``time_s``, ``energy_wh``.
        What the maps or the arguments do not say is left out.
      segments: a row for each of a few parts of nearly equal length: the same, ``from_m`` and ``to_m`` along
        the route, and ``min_*`` and ``max_*`` of each metric. The sums of costs, lengths and people are the totals.
      profile: a row for each cell that a step of the route crosses, in order: ``from_m`` and ``to_m``, the
        middle's ``lon``, ``lat`` and ``z_m``, and the value of every map.
      lines: longitude and latitude ``[K, 2]`` of each segment.
      settings: ``swath_m``, ``speed_m_s`` and ``power_w`` as they were given.
      cautions: what a pilot should know of the route (`jaxurban.cautions`).
      density: people beneath its corridor, where it was asked for (`overflown_density`).

    Examples:
      >>> report = ju.explain(path, maps)
      >>> list(report.totals)[:4], len(report.segments)
      (['length_m', 'cost', 'cost_of_distance', 'cost_of_gps'], 10)
      >>> round(report.segments["cost"].sum()) == round(path.cost)
      True
    """

    totals: Mapping[str, float]
    segments: pd.DataFrame
    profile: pd.DataFrame
    lines: tuple[np.ndarray, ...]
    settings: Mapping[str, float | None]
    cautions: list[Caution]
    density: OverflownDensity | None = None

    @property
    def facts(self) -> dict[str, str]:
        """`why`, and the totals as texts, in the units that their names say."""
        notes = dict.fromkeys(guessed_clearances(self.profile), " (if guessed roofs are right)")
        notes["people_overflown"] = f" (strip of {self.settings['swath_m']:g} m)"
        texts = {
            name.replace("_", " "): f"{_short(value)}{notes.get(name, '')}"
            for name, value in self.totals.items()
            if name != NO_FIX_IN_1_0  # it stands under its new name
        }
        return {"why": self.why} | texts

    @property
    def why(self) -> str:
        """A sentence: which segment costs the most, and for which layer, beside its length; empty where none costs."""
        if not self.segments["cost"].sum() > 0:
            return ""
        place = int(self.segments["cost"].argmax())
        most = self.segments.iloc[place]
        share = most / self.segments.sum()
        sentence = (
            f"The most expensive stretch is segment {place + 1}, from {most['from_m']:.0f} to {most['to_m']:.0f} m: "
            f"{share['cost']:.0%} of the cost on {share['length_m']:.0%} of the length"
        )
        parts = most.filter(like=COST_OF).drop(f"{COST_OF}distance")
        if not parts.max() > 0:
            return f"{sentence}, all of it for its length."
        layer = str(parts.idxmax()).removeprefix(COST_OF)
        part = f"{_short(parts.max())} of {_short(most['cost'])}"
        return f"{sentence}; beside its length it pays most for {layer} ({part})."

    @property
    def known_cautions(self) -> list[Caution]:
        """Its ``cautions``, and those of its ``density``."""
        return self.cautions + ([] if self.density is None else self.density.cautions)

    def __repr__(self) -> str:
        return "\n".join(
            [f"{type(self).__name__}:", *caution_lines(self.cautions), "", self.table()]
        )

    def _repr_html_(self) -> str:
        return super()._repr_html_() + self._segments().to_html()

    def to_dict(self) -> dict[str, Any]:
        """Return totals, cautions and segments as plain, JSON-ready values.

        Returns:
          A dictionary of the settings and totals by name, ``why``, ``cautions`` (texts) and ``segments`` (a dictionary
          each); None stands for a number that is missing or not finite.

        Examples:
          >>> record = ju.explain(path, maps, num_segments=3).to_dict()
          >>> round(record["length_m"]), [each["segment"] for each in record["segments"]]
          (719, [1, 2, 3])
        """
        record: dict[str, Any] = {
            **numbers_or_none(self.settings),
            **numbers_or_none(self.totals),
            "why": self.why,
            "cautions": self.cautions,
            "segments": [
                {"segment": number, **numbers_or_none(row)}
                for number, row in self.segments.to_dict("index").items()
            ],
        }
        if self.density is not None:
            record["overflown_density"] = self.density.to_dict()
        return record

    def table(self) -> str:
        """Return the report for a terminal: totals, `why`, and segments.

        Returns:
          Text of a line for each total, and after an empty line each `why`, a line for each segment, and the density.

        Examples:
          >>> print(ju.explain(path, maps).table())
          length m                719
          cost                    223
          ...
          The most expensive stretch is segment ...% of the length; beside its length it pays most for lidar ...
          ...
        """
        totals = "\n".join(
            f"{name:<24}{fact}" for name, fact in self.facts.items() if name != "why"
        )
        segments = self._segments().to_string(col_space=8) if len(self.segments) else "segment"
        density = "" if self.density is None else self.density.table()
        return "\n\n".join(filter(None, [totals, self.why, segments, density]))

    def _segments(self) -> pd.DataFrame:
        """Return the columns of the segments that a terminal has room for, as texts under their heads."""
        heads = {"from_m": "from m", "length_m": "length m", "cost": "cost"}
        sign = "="
        for name in map(str, self.segments.filter(regex=f"^{COST_OF}")):
            heads[name] = sign + name.removeprefix(COST_OF)
            sign = "+"
        heads |= SEGMENT_HEADS
        shown = self.segments.filter(list(heads)).map(_short)
        return shown.rename(columns=heads).rename_axis(None).rename_axis("segment", axis="columns")


@typed
def explain(
    planned: PlannedPath,
    maps: MapsLike,
    *,
    speed_m_s: float | None = None,
    power_w: float | None = None,
    swath_m: float = 10.0,
    num_segments: int = 10,
    density: OverflownDensity | None = None,
) -> RouteReport:
    """Return what a planned route costs and meets, in whole and by segment.

    People overflown are those under a strip of width ``swath_m`` along the route: the integral of density x
    ``swath_m`` over the length on the ground, where the strip is taken to be as dense as the cell that the
    route crosses. Who lives under two passes counts twice. Time is length / speed, energy time x power: no wind,
    no acceleration, the same power in climb and descent. Clearance (``nearest_wall_m``) is the exact distance from the
    route to the square of the nearest cell with a roof at its altitude (see `clearance_m`); of the highest roof
    that touches a cell, where the maps hold it, so that 0 is contact. What stands outside the region they do not
    hold: ``walls_outside_m`` is how far at least the obstacles out there are, the distance to the border.
    Where a route climbs, each cell takes the maps of the level nearest to it, as the planner did; of satellites and
    obstacles that below, where there are fewer of the ones and more of the others.

    Args:
      planned: from `plan`; its settings say which weights, cost model, time and time of day.
      maps: the maps it was planned on, or their folder.
      speed_m_s: through the air; left out, that of the vehicle that it was planned for, or else no time. The vehicle's
        limits of climb and descent make it slower where the route is steep.
      power_w: mean electrical power in flight; left out, that of the vehicle, or else no energy.
      swath_m: width of the strip in which people are counted.
      num_segments: into how many segments of nearly equal length the table is cut, at most.
      density: of people beneath the corridor, from `overflown_density`, which the report then shows and files hold.

    Returns:
      `RouteReport`: totals of the route, a table of its segments and one of its cells, and cautions.

    Raises:
      InputError: there is no path, the maps are others, or a speed, power, width or number that cannot be.

    Examples:
      >>> report = ju.explain(path, maps, speed_m_s=10.0)
      >>> [round(report.totals[name]) for name in ("length_m", "time_s", "people_overflown")]
      [719, 72, 37]
      >>> report.segments[["from_m", "to_m"]].round().to_numpy().tolist()[:2]
      [[0.0, 77.0], [77.0, 133.0]]
    """
    maps = as_maps(maps)
    if num_segments < 1:
        raise InputError(f"num_segments must be at least 1, got {num_segments}")
    positive("swath_m", swath_m)
    cut = cut_on(planned, maps)
    names = tuple(maps.metrics)
    grid = maps.grid
    given = values_given({"speed_m_s": speed_m_s, "power_w": power_w})
    vehicle = replace(Vehicle.of(planned.settings), **given)
    profile = profile_of(planned, maps, cut, {name: name for name in names} | EXTRA_MAPS)
    route = _Route(cut, profile, _cost_map_of(planned, maps), vehicle, swath_m)

    num_steps = len(route.states) - 1
    whole = route.row(0, num_steps, names)
    segment = cut_evenly(cut.points_m, num_segments)
    starts = np.unique(segment, return_index=True)[1].tolist()
    parts = list(pairwise([*starts, num_steps]))
    segments = pd.DataFrame(
        [route.row(*part, names) for part in parts],
        pd.RangeIndex(1, len(parts) + 1, name="segment"),
        list(whole),
    )
    x_m, y_m = (route.states[:, :2] + grid.bounds_m[:2]).T
    lonlat = np.stack(grid.lonlat_of_xy(x_m, y_m), axis=-1)
    return RouteReport(
        totals={
            name: value
            for name, value in whole.items()
            if not name.startswith(("from_", "to_", "min_", "max_"))
        },
        segments=segments,
        profile=profile,
        lines=tuple(lonlat[first : last + 1] for first, last in parts),
        settings={
            "swath_m": swath_m,
            "speed_m_s": vehicle.speed_m_s,
            "power_w": vehicle.power_w,
        },
        cautions=cautions(planned, maps, profile),
        density=density,
    )


@dataclass(frozen=True)
class _Route:
    """A route over maps, whose parts are from one state to another.

    Attributes:
      cut: the route by cell.
      profile: its table of cells.
      cost_map: that it was planned on.
      vehicle: that flies it.
      swath_m: width of the strip in which people are counted.
    """

    cut: Crossings
    profile: pd.DataFrame
    cost_map: CostMap
    vehicle: Vehicle
    swath_m: float

    @property
    def states(self) -> np.ndarray:
        """Corners ``[N, 2 or 3]``, as the cost map takes them."""
        return self.cut.points_m[:, : 2 if self.cost_map.levels is None else 3]

    def row(self, first: int, last: int, names: Iterable[str]) -> dict[str, float]:
        """Return a part's place along the route, what it costs, and the extremes of the named maps."""
        segment = self.cut.segment
        is_part = (first <= segment) & (segment < max(last, 1))
        part = self.profile[is_part]
        row = {"from_m": part["from_m"].min(), "to_m": part["to_m"].max()}
        row |= self._sums(first, last, is_part)
        for end in ("min", "max"):
            row |= {f"{end}_{name}": getattr(part[name], end)() for name in names}
        return row

    def _sums(self, first: int, last: int, is_part: np.ndarray) -> dict[str, float]:
        """Return what a part costs and meets: sums, means, and the nearest obstacles."""
        part = self.profile[is_part]
        features = self.cost_map.shortest.features(self.states[first : last + 1])
        costs = (self.cost_map.weight_vector * features.phi).tolist()
        row = {"length_m": float((part["to_m"] - part["from_m"]).to_numpy().sum())}
        row["cost"] = sum(costs)
        for name, cost in zip(self.cost_map.weight_names, costs, strict=True):
            row[COST_OF + name] = cost
        for name, mean in self.cost_map.means(features).items():
            row[f"mean_{name}"] = mean
        east_m, north_m, rise_m = np.diff(self.cut.ends_m, axis=1)[is_part, 0].T
        if DENSITY in part:
            people_m = float(part[DENSITY] @ np.hypot(east_m, north_m))
            row["people_overflown"] = people_m * self.swath_m / M2_PER_KM2
        if FIX in part:
            no_fix_m = sum((to_m - from_m for from_m, to_m in without_fix(part)), 0.0)
            row["no_fix_m"] = row[NO_FIX_IN_1_0] = no_fix_m
        for name in (CLEARANCE, OUTSIDE, OVER_ROOF):
            row[name] = float(part[name].min())
        speed_m_s, power_w = self.vehicle.speed_m_s, self.vehicle.power_w
        if speed_m_s is not None:
            flight_s = self.vehicle.flight_s(self.cut.length_m[is_part], rise_m, speed_m_s)
            row["time_s"] = float(flight_s.sum())
            if power_w is not None:
                row["energy_wh"] = row["time_s"] * power_w / SECONDS_PER_HOUR
        return row


def _cost_map_of(planned: PlannedPath, maps: MetricMaps) -> CostMap:
    """Return the map that a path was planned on, from its settings; of a volume the levels that the path comes to.

    Every cell is free, as paths do not keep what closed cells.

    Raises:
      InputError: the maps lack a metric that the path was planned on.
    """
    settings = planned.settings
    levels = None
    altitudes_m = np.array([planned.altitude_m])
    if "levels_m" in settings:
        levels = Levels(
            climb_cost=settings.get("climb_cost"), descent_cost=settings.get("descent_cost", 0.0)
        )
        levels_m = np.asarray(settings["levels_m"], float)
        altitudes_m = levels_m[(levels_m >= planned.z_m.min()) & (levels_m <= planned.z_m.max())]
    cost_map = map_at(
        maps.with_obstacles("centre"),
        altitudes_m,
        levels,
        **{name: settings[name] for name in ("time", "time_of_day", "objective")},
        weights=Weights.of(settings["weights"]),
        cost_model=CostModel.from_settings(settings),
        constraints=Constraints((), (), 0.0, 0.0),
    )
    names = [name for name in settings["weights"] if name != "distance"]
    return replace(cost_map, is_free=np.ones_like(cost_map.is_free)).only(names)


def _short(value: float) -> str:
    if not math.isfinite(value):
        return "none"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
