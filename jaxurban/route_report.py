"""A planned route explained: what each layer and each stretch costs, who is below, where GPS or room is scarce."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.cost import metric_cost
from jaxurban.errors import InputError
from jaxurban.maps import MetricMaps
from jaxurban.metrics.population import M2_PER_KM2
from jaxurban.planned import PlannedPath
from jaxurban.planners.base import CostModel
from jaxurban.route_levels import VISIBLE, RouteLevels
from jaxurban.route_pieces import Pieces, cut_evenly, cut_route, level_below_m, nearest_wall_m

FEWEST_SATELLITES = 4  # below, no position fix
SECONDS_PER_HOUR = 3600.0
EXTRA_MAPS = {VISIBLE: VISIBLE, "density": "density_per_km2", "terrain": "terrain_m"}
WALL, OUTSIDE, OVER_ROOF = "nearest_wall_m", "walls_outside_m", "least_over_roofs_m"
UNITS = {"_m": "m", "_s": "s", "_wh": "Wh"}  # by the end of a name
SEGMENT_HEADS = {  # what a terminal has room for; `RouteReport.segments` has more
    "from_m": "from m",
    "length_m": "length m",
    "cost": "cost",
    "cost_of_distance": "=distance",
    "cost_of_gps": "+gps",
    "cost_of_lidar": "+lidar",
    "cost_of_population": "+popul.",
    "cost_of_risk": "+risk",
    "cost_of_climb": "+climb",
    "cost_of_descent": "+descent",
    "min_gps": "min gps",
    "people_overflown": "people",
    "under_4_satellites_m": "<4 sat m",
    WALL: "wall m",
    "time_s": "time s",
    "energy_wh": "Wh",
}


@dataclass(frozen=True, eq=False)
class RouteReport:
    """A route in numbers. Lengths are in the air; all is in still air, above ground.

    Attributes:
      totals: of the whole route: ``length_m``, ``cost`` and ``cost_of_*`` (distance and each metric),
        ``mean_*`` of each metric m (over the length), ``people_overflown`` (see `explain`),
        ``under_4_satellites_m`` (length with no position fix), ``nearest_wall_m``, ``walls_outside_m`` (see
        `explain`), ``least_over_roofs_m`` (above the roofs beneath; NaN over none), ``time_s``, ``energy_wh``.
        What the maps or the arguments do not tell is left out.
      segments: a row for each of a few stretches of nearly equal length: the same, ``from_m`` and ``to_m`` along
        the route, and ``min_*`` and ``max_*`` of each metric. The sums of costs, lengths and people are the totals.
      extremes: a row for each metric, the satellites in view, people per km2 and the nearest wall: ``mean`` over
        the length (of the satellites, a whole number, the ``median`` instead), ``min`` and ``max``, and where along
        the route (``*_at_m``) and on the map (``*_lon``, ``*_lat``) they are.
      profile: a row for each piece of the route within one cell, in order: ``from_m`` and ``to_m``, the
        middle's ``lon``, ``lat`` and ``z_m``, and the value of every map.
      lines: longitude and latitude ``[K, 2]`` of each segment.
      settings: ``swath_m``, ``speed_m_s`` and ``power_w`` as they were given.
    """

    totals: Mapping[str, float]
    segments: pd.DataFrame
    extremes: pd.DataFrame
    profile: pd.DataFrame
    lines: tuple[np.ndarray, ...]
    settings: Mapping[str, float | None]

    def to_dict(self) -> dict[str, Any]:
        """Return totals, extremes and segments as plain, JSON-ready values (None for no number)."""
        return {
            **_plain(self.settings),
            **_plain(self.totals),
            "extremes": {
                str(name): _plain_extremes(str(name), row) for name, row in self.extremes.to_dict("index").items()
            },
            "segments": [{"segment": number, **_plain(row)} for number, row in self.segments.to_dict("index").items()],
        }

    def table(self) -> str:
        """Return the report for a terminal: totals, extremes, segments."""
        return "\n\n".join("\n".join(lines) for lines in (self._totals(), self._extremes(), self._segments()))

    def _totals(self) -> Iterator[str]:
        for name, value in self.totals.items():
            label, unit = next(
                ((name.removesuffix(end), unit) for end, unit in UNITS.items() if name.endswith(end)), (name, "")
            )
            unit = f"(strip of {self.settings['swath_m']:g} m)" if name == "people_overflown" else unit
            yield f"{label.replace('_', ' '):<22}{_short(value)} {unit}".rstrip()

    def _extremes(self) -> Iterator[str]:
        yield f"{'along the route':<18}{'mean':>10}{'min':>10}{'at m':>9}{'max':>10}{'at m':>9}"
        for name, row in self.extremes.iterrows():
            ends = "".join(f"{_short(row[end]):>10}{row[f'{end}_at_m']:>9,.0f}" for end in ("min", "max"))
            middle = f"median {row['median']:.0f}" if name == VISIBLE else _short(row["mean"])
            yield f"{name!s:<18}{middle:>10}{ends}"

    def _segments(self) -> Iterator[str]:
        shown = {name: head for name, head in SEGMENT_HEADS.items() if name in self.segments}
        yield "segment" + "".join(f"{head:>10}" for head in shown.values())
        for number, row in self.segments.iterrows():
            yield f"{number!s:>7}" + "".join(f"{_short(row[name]):>10}" for name in shown)


def explain(
    planned: PlannedPath,
    maps: MetricMaps,
    *,
    speed_m_s: float | None = None,
    power_w: float | None = None,
    swath_m: float = 10.0,
    num_segments: int = 10,
) -> RouteReport:
    """Return what a planned route costs and meets, in whole and by segment.

    People overflown are those under a strip of width ``swath_m`` along the route: the integral of density x
    ``swath_m`` over the length on the ground, where the strip is taken to be as dense as the cell that the
    route crosses. Who lives under two passes counts twice. Time is length / speed, energy time x power: no wind,
    no acceleration, the same power in climb and descent. The nearest wall is the exact distance from the route
    to the square of the nearest cell with a roof at the route's altitude (see `nearest_wall_m`); of the highest roof
    that touches a cell, where the maps hold it, so that 0 is contact. What stands outside the region they do not
    hold, but risk was made with it: ``walls_outside_m`` is how far at least the walls out there are. Where a
    route climbs, each piece takes the maps of the level nearest to it, as the planner did; of satellites and walls,
    that below, where there are fewer of the ones and more of the others.

    Args:
      planned: from `plan`; its settings tell weights, cost model, epoch and time of day.
      maps: the maps it was planned on.
      speed_m_s: through the air; left out, no time.
      power_w: mean electrical power in flight; left out, no energy.
      swath_m: width of the strip in which people are counted.
      num_segments: into how many stretches of nearly equal length the table is cut, at most.

    Raises:
      InputError: there is no path, the maps are others, or a speed, power, width or number that cannot be.
    """
    check_flight(speed_m_s, power_w, swath_m)
    _check_path(planned, maps, num_segments)
    grid = maps.grid
    pieces = cut_route(planned.xy_m - [grid.x_min_m, grid.y_min_m], planned.z_m, grid.resolution_m)
    levels = RouteLevels(planned, maps)
    profile = _profile(levels, maps, pieces, {name: name for name in maps.metrics} | EXTRA_MAPS)
    step_costs = _step_costs(levels, maps, pieces)
    segment = cut_evenly(pieces.states, num_segments)
    rows = _Rows(profile, pieces.ground_m, maps.metrics, speed_m_s, power_w, swath_m)
    of_piece = segment[pieces.step] if len(segment) else np.full(len(profile), -1)
    table = [
        rows.sums(of_piece == number, {name: values[segment == number] for name, values in step_costs.items()})
        | rows.ranges(of_piece == number)
        for number in range(int(segment.max(initial=-1)) + 1)
    ]
    columns = None if table else [*rows.sums(of_piece == 0, step_costs), *rows.ranges(of_piece == 0)]
    lonlat = np.stack(grid.lonlat_of_xy(pieces.states[:, 0] + grid.x_min_m, pieces.states[:, 1] + grid.y_min_m), -1)
    lines = [
        lonlat[np.append(segment == number, False) | np.append(False, segment == number)]
        for number in range(len(table))
    ]
    totals = rows.sums(np.ones(len(profile), bool), step_costs)
    return RouteReport(
        totals={name: value for name, value in totals.items() if name not in ("from_m", "to_m")},
        segments=pd.DataFrame(table, pd.RangeIndex(1, len(table) + 1, name="segment"), columns),
        extremes=_extremes(profile, maps.metrics),
        profile=profile,
        lines=tuple(lines),
        settings={"swath_m": swath_m, "speed_m_s": speed_m_s, "power_w": power_w},
    )


def cautious_profile(planned: PlannedPath, maps: MetricMaps) -> pd.DataFrame:
    """Return the profile of a report without metrics and people: satellites, roofs, walls (errors as in `explain`)."""
    _check_path(planned, maps, 1)
    grid = maps.grid
    pieces = cut_route(planned.xy_m - [grid.x_min_m, grid.y_min_m], planned.z_m, grid.resolution_m)
    return _profile(RouteLevels(planned, maps), maps, pieces, {VISIBLE: VISIBLE})


def without_fix(profile: pd.DataFrame) -> list[tuple[float, float]]:
    """Return begin and end along the route of each stretch with too few satellites for a fix, metres."""
    if VISIBLE not in profile:
        return []
    is_short = np.concatenate([[False], profile[VISIBLE] < FEWEST_SATELLITES, [False]])
    changes = np.flatnonzero(is_short[1:] != is_short[:-1]).reshape(-1, 2)
    return [(float(profile["from_m"].iloc[a]), float(profile["to_m"].iloc[b - 1])) for a, b in changes]


def check_flight(speed_m_s: float | None = None, power_w: float | None = None, swath_m: float = 10.0) -> None:
    """Raise InputError unless `explain` takes these values: call it before a long search."""
    for name, value in (("speed_m_s", speed_m_s), ("power_w", power_w), ("swath_m", swath_m)):
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{name} must be a finite number above 0, got {value}")
    if power_w is not None and speed_m_s is None:
        raise InputError("power_w tells an energy only over a time: give the speed (speed_m_s, --speed) too")


def _check_path(planned: PlannedPath, maps: MetricMaps, num_segments: int) -> None:
    if not planned.status.has_path:
        raise InputError(f"there is no path to explain: {planned.status.sentence}")
    if (planned.crs, planned.settings["resolution_m"]) != (maps.grid.crs, maps.grid.resolution_m):
        raise InputError(
            f"the path was planned at {planned.settings['resolution_m']:g} m in {planned.crs}, and these maps are "
            f"{maps.grid.resolution_m:g} m in {maps.grid.crs}: give the maps that it was planned on"
        )
    if num_segments < 1:
        raise InputError(f"num_segments must be at least 1, got {num_segments}")


def _profile(levels: RouteLevels, maps: MetricMaps, pieces: Pieces, shown: Mapping[str, str]) -> pd.DataFrame:
    grid, middle = maps.grid, pieces.middle
    lon, lat = grid.lonlat_of_xy(middle[:, 0] + grid.x_min_m, middle[:, 1] + grid.y_min_m)
    to_m = np.cumsum(pieces.length_m)
    columns = {"from_m": to_m - pieces.length_m, "to_m": to_m, "lon": lon, "lat": lat, "z_m": middle[:, 2]}
    level_m = levels.of(middle[:, 2])
    for name, column in {**shown, levels.roofs: "roof_m"}.items():
        if maps.variable(name) in maps.ds:
            columns[column] = levels.sample(name, level_m, pieces.row, pieces.col)
    if VISIBLE in columns:
        columns[VISIBLE] = columns[VISIBLE].astype(int)
    is_over = columns["roof_m"] > 0
    columns[OVER_ROOF] = np.where(is_over, pieces.ends[:, :, 2].min(axis=1) - columns["roof_m"], np.nan)
    below_m = level_below_m(pieces.ends[:, :, 2].min(axis=1), levels.held_m)
    columns[OUTSIDE] = _walls_outside_m(levels, maps, pieces, level_below_m(below_m, maps.altitudes_m))
    columns[WALL] = np.empty(len(below_m))
    for z_m in np.unique(below_m):
        lines = pieces.ends[below_m == z_m, :, :2]
        columns[WALL][below_m == z_m] = nearest_wall_m(lines, levels.is_obstacle(float(z_m)), grid.resolution_m)
    return pd.DataFrame(columns)


def _walls_outside_m(levels: RouteLevels, maps: MetricMaps, pieces: Pieces, below_m: np.ndarray) -> np.ndarray:
    """Return ``[M]`` how far at least each piece is from the walls outside the region.

    They stand beyond its border; and, since the risk metric counts them up to its threshold and measures between
    the middles of cells, at least its distance less two half diagonals away; ``below_m`` names the maps below each.
    """
    grid = maps.grid
    side_m = np.array([grid.num_cols, grid.num_rows]) * grid.resolution_m
    border_m = np.minimum(pieces.ends[:, :, :2], side_m - pieces.ends[:, :, :2]).min(axis=(1, 2))
    if "risk_threshold_m" not in maps.ds.attrs or "risk" not in maps.ds:
        return border_m
    risk = levels.sample("risk", below_m, pieces.row, pieces.col)  # between two maps, the lower one has all walls
    return np.maximum(border_m, risk * maps.ds.attrs["risk_threshold_m"] - math.sqrt(2) * grid.resolution_m)


def _step_costs(levels: RouteLevels, maps: MetricMaps, pieces: Pieces) -> dict[str, np.ndarray]:
    """Return ``[S]`` what distance, each metric and climbing charge for every step, as the planners do."""
    settings, num_steps = levels.planned.settings, len(pieces.states) - 1
    moved_m = np.diff(pieces.states, axis=0)
    costs = {"distance": settings["weights"]["distance"] * np.linalg.norm(moved_m, axis=1)}
    model = CostModel.from_settings(settings)
    if model.kind == "line":
        charged = np.full(len(pieces.step), num_steps > 0)
        z_m, share = pieces.middle[charged, 2], pieces.length_m[charged] / model.reference_length_m
    else:
        charged = np.append(pieces.step[1:] != pieces.step[:-1], num_steps > 0)  # the cell in which a step ends
        z_m, share = pieces.states[1:, 2][pieces.step[charged]], np.ones(charged.sum())
    level_m = levels.of(z_m)
    for name in maps.metrics:
        m = levels.sample(name, level_m, pieces.row[charged], pieces.col[charged])
        cost = metric_cost(name, m.astype(np.float32)).astype(float)  # in the maps' own precision
        costs[name] = np.bincount(pieces.step[charged], settings["weights"][name] * cost * share, num_steps)
    for name, height_m in (("climb", moved_m[:, 2]), ("descent", -moved_m[:, 2])):
        if f"{name}_cost" in settings:
            costs[name] = settings[f"{name}_cost"] * np.maximum(height_m, 0.0)
    return costs


@dataclass(frozen=True)
class _Rows:
    """What a row of the tables says of some of the pieces."""

    profile: pd.DataFrame
    ground_m: np.ndarray
    metrics: tuple[str, ...]
    speed_m_s: float | None
    power_w: float | None
    swath_m: float

    def sums(self, chosen: np.ndarray, step_costs: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Return what adds up, means, and the nearest wall."""
        part, ground_m = self.profile[chosen], self.ground_m[chosen]
        length_m = (part["to_m"] - part["from_m"]).to_numpy()
        total_m = float(length_m.sum())
        charged = {name: float(values.sum()) for name, values in step_costs.items()}
        row = {"from_m": part["from_m"].min(), "to_m": part["to_m"].max(), "length_m": total_m}
        row |= {"cost": sum(charged.values())} | {f"cost_of_{name}": value for name, value in charged.items()}
        row |= {f"mean_{name}": mean_along(part[name].to_numpy(), length_m) for name in self.metrics}
        if "density_per_km2" in part:
            row["people_overflown"] = float(part["density_per_km2"].to_numpy() @ ground_m) * self.swath_m / M2_PER_KM2
        if VISIBLE in part:
            row["under_4_satellites_m"] = float(length_m[part[VISIBLE] < FEWEST_SATELLITES].sum())
        row |= {name: float(part[name].min()) for name in (WALL, OUTSIDE, OVER_ROOF)}
        if self.speed_m_s is not None:
            row["time_s"] = total_m / self.speed_m_s
            if self.power_w is not None:
                row["energy_wh"] = row["time_s"] * self.power_w / SECONDS_PER_HOUR
        return row

    def ranges(self, chosen: np.ndarray) -> dict[str, float]:
        """Return least and greatest value of each metric."""
        part = self.profile.loc[chosen, list(self.metrics)]
        return {f"min_{name}": part[name].min() for name in part} | {f"max_{name}": part[name].max() for name in part}


def mean_along(values: np.ndarray, length_m: np.ndarray) -> float:
    """Return the mean over the length; of a route without length, of its one place."""
    weights = length_m if length_m.sum() > 0 else np.ones(len(length_m))
    return float(values @ weights / weights.sum()) if len(values) else math.nan


def _median_along(values: np.ndarray, length_m: np.ndarray) -> float:
    """Return the value that at least half of the length does not exceed; one of the values."""
    order = np.argsort(values)
    done_m = np.cumsum(length_m[order])
    return values[order][np.searchsorted(done_m, done_m[-1] / 2)]


def _extremes(profile: pd.DataFrame, metrics: tuple[str, ...]) -> pd.DataFrame:
    names = [name for name in (*metrics, VISIBLE, "density_per_km2", WALL) if name in profile]
    length_m = (profile["to_m"] - profile["from_m"]).to_numpy()
    rows = {}
    for name in names:
        values = profile[name].to_numpy()
        is_count = name == VISIBLE
        rows[name] = {"mean": math.nan if is_count else mean_along(values, length_m)}
        rows[name] |= {"median": float(_median_along(values, length_m)) if is_count else math.nan}
        for end, place in (("min", np.argmin(values)), ("max", np.argmax(values))):
            at = profile.iloc[place]
            rows[name] |= {end: values[place], f"{end}_at_m": (at["from_m"] + at["to_m"]) / 2}
            rows[name] |= {f"{end}_lon": at["lon"], f"{end}_lat": at["lat"]}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("quantity")


def _plain(values: Mapping[Any, Any]) -> dict[str, float | None]:
    """Return numbers as JSON takes them: None for none, and for no number."""
    return {str(key): None if v is None or not math.isfinite(v) else float(v) for key, v in values.items()}


def _plain_extremes(name: str, row: Mapping[Any, Any]) -> dict[str, float | None]:
    """Return a row of extremes: satellites as whole numbers with their median, all else with its mean."""
    plain = _plain({key: value for key, value in row.items() if key != ("mean" if name == VISIBLE else "median")})
    return plain | ({key: int(row[key]) for key in ("median", "min", "max")} if name == VISIBLE else {})


def _short(value: float) -> str:
    return "none" if not math.isfinite(value) else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
