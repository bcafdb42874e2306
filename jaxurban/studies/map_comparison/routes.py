"""Routes on two sets of maps: where they go on each, and what the one costs on the other's map."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, at_least, positive
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.batch import plan_many
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.queries import COLUMNS, LONLAT, WEIGHT_PREFIX, Point, Query
from jaxurban.paths.queries import XY as XY_COLUMNS
from jaxurban.paths.results import PlannedPaths
from jaxurban.paths.snapping import snap_limit_m
from jaxurban.planners.cost_model import CostModel
from jaxurban.progress import Report
from jaxurban.studies.map_comparison.shared_part import SharedPart
from jaxurban.studies.montecarlo.sampling import sample_instances
from jaxurban.studies.montecarlo.strata import NO_STRATUM, STRATA
from jaxurban.world.city import LandCover

GivenRoutes = int | pd.DataFrame | Sequence[tuple[Point, Point]]
DEARER = 1e-3  # regret from which a route is worth being planned again


@dataclass(frozen=True)
class RouteSettings:
    """How routes are planned on both maps: arguments of `plan_many`, and the seed of sampled ones."""

    weights: Weights
    cost_model: CostModel
    constraints: Constraints
    snap: bool | float
    budget_s: float
    seed: int

    def __post_init__(self) -> None:
        self.weights.check_some()
        snap_limit_m(self.snap)
        positive("budget_s", self.budget_s, "seconds")
        at_least("seed", self.seed)


@dataclass(frozen=True, eq=False)
class ComparedRoutes:
    """The cheapest routes of the same queries on maps A and on maps B.

    Attributes:
      a, b: the routes.
      table: a row a query, with its columns and: ``start_stratum``, ``goal_stratum`` (of A); ``status_a``,
        ``status_b``; ``cost_a``, ``cost_b``, ``length_a_m``, ``length_b_m`` of each on its own map, and the means of
        the metrics along each (``gps_a``, ``gps_b`` ...); ``overlap``, the share of A's route, by length, in cells
        that B's route crosses too; ``is_changed``, whether they cross other cells; ``is_blocked``, whether A's route
        cannot be flown on B, and ``blocked_m``, how far it runs through cells that are closed there;
        ``cost_of_a_on_b``, inf where it is blocked; ``regret``, by what share of B's route A's costs more than it on B;
        ``note``.
      settings: how they were planned.
    """

    a: PlannedPaths
    b: PlannedPaths
    table: pd.DataFrame
    settings: RouteSettings

    @property
    def both(self) -> pd.DataFrame:
        """The rows of queries that have a route on both maps."""
        return self.table[self.table.overlap.notna()]

    @property
    def sentence(self) -> str:
        """How many routes change, and how much that matters."""
        both = self.both
        is_blocked = both.is_blocked.astype(bool)
        return (
            f"{len(self.table)} queries, {len(both)} with a route on both maps: {int(both.is_changed.sum())} take "
            f"other cells on B, {int(is_blocked.sum())} of A's routes are blocked there, and "
            f"{int((both.regret[~is_blocked] > DEARER).sum())} cost more than {DEARER:.1%} above B's own"
        )


def compare_routes(
    part: SharedPart,
    given: GivenRoutes,
    settings: RouteSettings,
    strata: np.ndarray,
    cover: LandCover | None,
    report: Report,
) -> ComparedRoutes | None:
    """Return the routes of queries on both maps, None where none are asked for.

    Args:
      part: the maps.
      given: how many to sample at each altitude, or queries.
      settings: how they are planned.
      strata: ``[Y, X]`` of A's cells.
      cover: for sampling.
      report: of progress.

    Raises:
      InputError: fewer than 0 routes, a table that cannot be read, or too few cells that are free in both.
    """
    if isinstance(given, int | np.integer):
        if isinstance(given, bool) or given < 0:
            raise InputError(f"routes must be 0 or more to sample at each altitude, or queries, got {given}")
        if given == 0:
            return None
        settings.weights.checked(part.a.metrics)
        given = sample_instances(
            free_in_both(part),
            int(given),
            weights=[settings.weights],
            cost_model=settings.cost_model,
            constraints=settings.constraints,
            cover=cover,
            seed=settings.seed,
        )
    queries = _queries(given, part)
    how: dict[str, Any] = {
        "weights": settings.weights,
        "cost_model": settings.cost_model,
        "constraints": settings.constraints,
        "snap": settings.snap,
        "budget_s": settings.budget_s,
        "planner": "astar-plus",
        "objective": "weighted",
        "seed": settings.seed,
        "progress": report,
    }
    a, b = (plan_many(maps, queries, **how) for maps in (part.a, part.b))
    on = cache(partial(_cost_map, part.b, settings))
    rows = []
    for number, (query, *found) in enumerate(zip(a.queries, a.results, b.results, strict=True)):
        row = {"query": number, **query.to_dict(), **_strata(part.a, query, strata)}
        row |= {f"status_{which}": each.status for which, each in zip("ab", found, strict=True)}
        of_a, of_b = (None if each.path is None or not each.path.status.has_path else each.path for each in found)
        for which, path in (("a", of_a), ("b", of_b)):
            row |= {f"cost_{which}": np.nan, f"length_{which}_m": np.nan} if path is None else _measures(path, which)
        row |= dict.fromkeys(("overlap", "blocked_m", "cost_of_a_on_b", "regret"), np.nan)
        row |= {"is_changed": None, "is_blocked": None, "note": ""}
        if of_a is not None and of_b is not None:
            row |= _beside(of_a, of_b, on(query.altitude_m, query.time, query.time_of_day, query.weights))
        else:
            said = (f"{which}: {each.message}" for which, each in zip("AB", found, strict=True) if each.message)
            row["note"] = " ".join(said)
        rows.append(row)
    return ComparedRoutes(a, b, pd.DataFrame(rows), settings)


def free_in_both(part: SharedPart) -> MetricMaps:
    """Return A's maps with B's obstacles and roofs added to A's own, and data only where both have them."""
    ds, other = part.a.ds, part.b.ds
    higher = {name: np.fmax(ds[name], other[name]) for name in ("obstacle", "roof", "roof_touched") if name in ds}
    return MetricMaps(ds.assign(higher | {"has_data": ds["has_data"] & other["has_data"]}), part.a.obstacles)


def _queries(given: pd.DataFrame | Sequence[tuple[Point, Point]], part: SharedPart) -> pd.DataFrame:
    """Return a table of queries as `plan_many` takes it, at every altitude where it names none."""
    if not isinstance(given, pd.DataFrame):
        try:
            given = pd.DataFrame([(*start, *goal) for start, goal in given], columns=list(LONLAT))
        except (TypeError, ValueError) as error:
            raise InputError("routes must be a number, a table, or pairs of (lon, lat)") from error
    table = given
    if "instance" in table:  # of `sample_instances`: places in metres, and facts beside the query
        known = (*COLUMNS, *(WEIGHT_PREFIX + name for name in part.a.metrics))
        if "crs" in table and (others := set(table.crs) - {part.a.grid.crs}):
            raise InputError(f"the routes' places are in {others.pop()}, the maps in {part.a.grid.crs}: use their CRS")
        table = table[[name for name in table if name in known and name not in LONLAT]]
        table = table if set(XY_COLUMNS) <= set(table) else given
    if not len(table):
        raise InputError("there are no routes to compare: give at least one query, or how many to sample")
    if "altitude_m" in table:
        return table
    return pd.concat([table.assign(altitude_m=z_m) for z_m in part.a.altitudes_m], ignore_index=True)


def _cost_map(
    maps: MetricMaps,
    settings: RouteSettings,
    altitude_m: float,
    time: str | None,
    time_of_day: str | None,
    weights: Weights,
) -> CostMap:
    how: dict[str, Any] = {"cost_model": settings.cost_model, "constraints": settings.constraints}
    return cost_map(maps, altitude_m, weights=weights, time=time, time_of_day=time_of_day, **how)


def _strata(maps: MetricMaps, query: Query, strata: np.ndarray) -> dict[str, str | None]:
    """Return the strata of a query's ends, None outside the maps."""
    grid, found = maps.grid, {}
    for end, lonlat, xy_m in (("start", query.start, query.start_xy_m), ("goal", query.goal, query.goal_xy_m)):
        x_m, y_m = xy_m if xy_m is not None else grid.xy_of_lonlat(*(lonlat or (np.nan, np.nan)))
        number = int(strata[tuple(grid.cell_of_xy(x_m, y_m))]) if grid.contains_xy(x_m, y_m) else NO_STRATUM
        found[f"{end}_stratum"] = None if number == NO_STRATUM else STRATA[number]
    return found


def _measures(path: PlannedPath, which: str) -> dict[str, float]:
    means = {f"{name}_{which}": m for name, m in path.metrics.items()}
    return {f"cost_{which}": path.cost, f"length_{which}_m": path.length_m} | means


def _beside(a: PlannedPath, b: PlannedPath, on: CostMap) -> dict[str, Any]:
    """Return what A's route is on the cost map of B, beside B's own."""
    corner_m = np.array([on.grid.x_min_m, on.grid.y_min_m])
    of_a, of_b = (on.problem.features(path.xy_m - corner_m) for path in (a, b))
    cells_a, cells_b = (np.ravel_multi_index(of.crossed, on.grid.shape).ravel() for of in (of_a, of_b))
    length_m = of_a.length_m if of_a.length_m.sum() > 0 else np.ones(len(of_a.length_m))
    is_shared = np.isin(cells_a, cells_b)
    row: dict[str, Any] = {
        "overlap": float(length_m[is_shared].sum() / length_m.sum()),
        "is_changed": not is_shared.all() or not np.isin(cells_b, cells_a).all(),
        "is_blocked": not of_a.is_valid,
        "blocked_m": float(of_a.length_m[~on.is_free[of_a.crossed]].sum()),
    }
    if not (cells_a[0] == cells_b[0] and cells_a[-1] == cells_b[-1]):
        return row | {"note": "Start or goal was snapped to another cell, so that the costs are not of one query."}
    cost_a, cost_b = (of.cost(on.weight_vector) for of in (of_a, of_b))
    return row | {
        "cost_of_a_on_b": cost_a,
        "regret": 0.0 if cost_a == cost_b else cost_a / cost_b - 1 if cost_b else np.inf,
    }
