"""Instances of a study: starts and goals by stratum and range, times of day and weights, all from one seed."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.ndimage import label

from jaxurban.city import LandCover
from jaxurban.cost import METRICS, MOST_WEIGHT, Weights
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.tables import read_table
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planners.base import CostKind, CostModel
from jaxurban.studies.strata import STRATA, strata_of

# Straight distance between start and goal, as shares of the region's diagonal.
RANGES = {"short": (0.05, 0.15), "middle": (0.15, 0.35), "long": (0.35, 0.8)}
DIRICHLET = "dirichlet"
NUM_TRIES, NUM_GOALS = 200, 256  # starts, and goals for each, before a kind of instance is passed over

PLACES = ("start_x_m", "start_y_m", "goal_x_m", "goal_y_m")
WEIGHTS = ("w_distance", *(f"w_{name}" for name in METRICS))
NEEDED = ("instance", "altitude_m", "crs", *PLACES, *WEIGHTS)
TOLD = ("time", "time_of_day", "start_stratum", "goal_stratum", "range", "is_connected")  # None where a file holds none
KEY = ("instance", "altitude_m")
TIMES = ("time", "time_of_day")
QUESTION = ("crs", *PLACES, *WEIGHTS, "time", "time_of_day")  # what planners are asked; all else is told of it
TRUTHS = {"true": True, "false": False}
MOST_NUMBER = 2**53  # of an instance: as far as float64 counts


def sample_instances(
    maps: MetricMaps,
    num: int = 200,
    *,
    altitudes_m: Sequence[float] | None = None,
    weights: str | Sequence[Weights] = DIRICHLET,
    cost_model: CostModel | CostKind = "line",
    limits: Limits | None = None,
    cover: LandCover | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Return the instances of a study, ``num`` at each altitude, as a table.

    The same places, time and weights are asked at every altitude, so that altitudes can be compared pair by pair. Kinds
    (stratum of the start x stratum of the goal x range) take turns in a shuffled order, so that each is asked about
    equally often; a kind that the maps do not offer is passed over. Instance ``k`` depends on the seed and ``k``, not
    on ``num``. Starts and goals are centres of cells that are free at every altitude and time. Pairs that no path joins
    are kept and marked (``is_connected``).

    Columns: ``instance``, ``altitude_m``, ``crs``, ``start_x_m``, ``start_y_m``, ``goal_x_m``, ``goal_y_m``,
    ``start_lon``, ``start_lat``, ``goal_lon``, ``goal_lat``, ``time``, ``time_of_day``, ``start_stratum``,
    ``goal_stratum``, ``range``, ``distance_m`` (straight), ``is_connected``, ``w_distance`` (per metre), ``w_gps``,
    ``w_lidar``, ``w_population``, ``w_risk`` (0 where the maps hold no such metric).

    Args:
      maps: from `build_maps` or `open_maps`.
      num: instances at each altitude.
      altitudes_m: of the maps' altitudes; all if left out.
      weights: ``"dirichlet"``: uniform on the simplex of shares, distance counted per reference length and metrics as
        they are; or weights, which take turns.
      cost_model: its reference length is what the share of distance is divided by; its rule for diagonal steps
        tells which pairs are joined.
      limits: no-fly zones and bounds that close cells to starts, goals and paths.
      cover: water and parks, which are strata of their own then (`demo.demo_cover`, `io.landcover.read_land_cover`).
      seed: of everything.

    Raises:
      InputError: ``num`` below 1, an unknown altitude, none or one twice, no weights, or too few free cells for any
        pair of places.
    """
    altitudes_m = maps.altitudes_m if altitudes_m is None else tuple(float(z) for z in altitudes_m)
    listed = None if isinstance(weights, str) else [each.checked() for each in weights]
    if not altitudes_m or len(set(altitudes_m)) != len(altitudes_m):
        listing = ", ".join(f"{z:g}" for z in altitudes_m) or "none"
        raise InputError(f"altitudes_m must name at least one altitude and none twice, got {listing}")
    if num < 1:
        raise InputError(f"a study needs at least 1 instance, got {num}")
    if listed is None and weights != DIRICHLET:
        raise InputError(f"weights must be {DIRICHLET!r} or a list of Weights, got {weights!r}")
    if listed is not None and not listed:
        raise InputError(f"weights is an empty list: give at least one, or {DIRICHLET!r}")
    for altitude_m in altitudes_m:
        maps.check_altitude(altitude_m)
    model, limits = CostModel.of(cost_model), limits or Limits()
    places = _Places(maps, np.logical_and.reduce([_always_free(maps, z, limits) for z in altitudes_m]), cover)
    names = ("distance", *maps.metrics)
    kinds = _kinds(places, seed)
    rows = []
    for k in range(num):
        rng = np.random.default_rng([seed, 1, k])
        rows.append({"instance": k, **places.draw(kinds, rng)})
        rows[-1]["time"] = None if maps.default_time is None else str(rng.choice(maps.times))
        rows[-1]["time_of_day"] = str(rng.choice(maps.times_of_day)) if maps.times_of_day else None
        shares = rng.dirichlet(np.ones(len(names)))
        shares[0] /= model.reference_length_m
        asked = Weights(**dict.fromkeys(METRICS, 0.0) | dict(zip(names, shares.tolist(), strict=True)))
        if listed is not None:
            asked = listed[k % len(listed)]
        rows[-1] |= {f"w_{name}": getattr(asked, name) for name in ("distance", *METRICS)}
    table = pd.concat([_at_altitude(pd.DataFrame(rows), maps, z, model, limits) for z in altitudes_m])
    return table.reset_index(drop=True)


def _kinds(places: "_Places", seed: int) -> Iterator[tuple[int, int, str]]:
    """Yield kinds (stratum of start and goal, range) for ever, shuffled anew each time all were dealt."""
    kinds = list(itertools.product(places.present, places.present, RANGES))
    for turn in itertools.count():
        for number in np.random.default_rng([seed, 0, turn]).permutation(len(kinds)):
            yield kinds[number]


class _Places:
    """Free cells by stratum, from which pairs are drawn."""

    def __init__(self, maps: MetricMaps, is_free: np.ndarray, cover: LandCover | None) -> None:
        self.grid = maps.grid
        strata = np.where(is_free, strata_of(maps, cover), -1).ravel()
        self.cells = [np.flatnonzero(strata == number) for number in range(len(STRATA))]
        self.present = [number for number, cells in enumerate(self.cells) if len(cells)]
        if sum(map(len, self.cells)) < 2:
            raise InputError(
                "fewer than two cells are free at every altitude of the study: leave out the lowest one, or loosen the "
                "limits"
            )
        rows, cols = self.grid.shape
        self.diagonal_m = float(np.hypot(rows, cols)) * self.grid.resolution_m
        self.num_kinds = len(self.present) ** 2 * len(RANGES)

    def draw(self, kinds: Iterator[tuple[int, int, str]], rng: np.random.Generator) -> dict[str, object]:
        """Return a pair of places of the next kind that the maps offer."""
        for _ in range(self.num_kinds):
            first, second, name = next(kinds)
            pair = self._pair(first, second, RANGES[name], rng)
            if pair is not None:
                facts = {"start_stratum": STRATA[first], "goal_stratum": STRATA[second], "range": name}
                return self._facts(*pair) | facts
        raise InputError("no two free cells of these maps lie far enough apart for a study: use a larger region")

    def _pair(
        self, first: int, second: int, limits: tuple[float, float], rng: np.random.Generator
    ) -> tuple[tuple[int, int], tuple[int, int]] | None:
        low_m, high_m = (share * self.diagonal_m for share in limits)
        for _ in range(NUM_TRIES):
            row, col = divmod(int(rng.choice(self.cells[first])), self.grid.num_cols)
            rows, cols = np.divmod(rng.choice(self.cells[second], NUM_GOALS), self.grid.num_cols)
            away_m = np.hypot(rows - row, cols - col) * self.grid.resolution_m
            fits = np.flatnonzero((away_m >= low_m) & (away_m < high_m))
            if len(fits):
                return (row, col), (int(rows[fits[0]]), int(cols[fits[0]]))
        return None

    def _facts(self, start: tuple[int, int], goal: tuple[int, int]) -> dict[str, object]:
        facts: dict[str, object] = {}
        for name, cell in (("start", start), ("goal", goal)):
            x_m, y_m = self.grid.xy_of_cell(*cell)
            lon, lat = self.grid.lonlat_of_xy(x_m, y_m)
            facts |= {f"{name}_x_m": float(x_m), f"{name}_y_m": float(y_m)}
            facts |= {f"{name}_lon": float(lon), f"{name}_lat": float(lat)}
        away = np.hypot(start[0] - goal[0], start[1] - goal[1])
        return facts | {"distance_m": float(away) * self.grid.resolution_m}


def _always_free(maps: MetricMaps, altitude_m: float, limits: Limits) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that are free at every time of the maps."""
    times: Sequence[str | None] = maps.times if limits.bounds and maps.default_time is not None else (None,)
    times_of_day: Sequence[str | None] = (limits.bounds and maps.times_of_day) or (None,)
    free = [
        limits.is_free(maps, altitude_m, time=time, time_of_day=time_of_day)
        for time, time_of_day in itertools.product(times, times_of_day)
    ]
    return np.logical_and.reduce(free)


def _at_altitude(
    pairs: pd.DataFrame, maps: MetricMaps, altitude_m: float, model: CostModel, limits: Limits
) -> pd.DataFrame:
    """Return the instances at one altitude."""
    table = pairs.assign(crs=maps.grid.crs)
    table.insert(1, "altitude_m", float(altitude_m))
    table = with_connection(table, maps, model, limits)
    return table.assign(is_connected=table.is_connected.astype(bool))


def _connection(pairs: pd.DataFrame, grid: Grid, is_free: np.ndarray, model: CostModel) -> np.ndarray:
    """Return whether the grid joins each pair: True, False, or None where a place is not a free cell of the maps."""
    # Where a diagonal step needs both orthogonal neighbours free, the islands of orthogonal steps are what is joined.
    islands, _ = label(is_free, np.ones((3, 3)) if model.joins_corners else None)
    start, goal = np.zeros((2, len(pairs)), islands.dtype)  # 0: the island of what is not free
    for end, on in (("start", start), ("goal", goal)):
        x_m, y_m = (pairs[f"{end}_{axis}_m"].to_numpy() for axis in "xy")
        inside = grid.contains_xy(x_m, y_m)
        on[inside] = islands[grid.cell_of_xy(x_m[inside], y_m[inside])]
    joined = (start == goal).astype(object)
    joined[(start == 0) | (goal == 0)] = None
    return joined


def with_connection(instances: pd.DataFrame, maps: MetricMaps, model: CostModel, limits: Limits) -> pd.DataFrame:
    """Return instances with ``is_connected`` as these maps have it, None where a place is not a free cell of them."""
    told = pd.Series(None, index=instances.index, dtype=object)
    # Only bounds close other cells at other times.
    for _, at in instances.groupby(["altitude_m", *(TIMES if limits.bounds else ())], dropna=False):
        first = at.iloc[0]
        when = {name: None if pd.isna(first[name]) else str(first[name]) for name in TIMES}
        is_free = limits.is_free(maps, float(first.altitude_m), **when)
        told[at.index] = _connection(at, maps.grid, is_free, model)
    return instances.assign(is_connected=told.infer_objects())


def read_instances(file: str | Path) -> pd.DataFrame:
    """Return the instances in a Parquet or CSV file (`checked_instances`).

    Raises:
      InputError: the file cannot be read, or its table is wrong.
    """
    return checked_instances(read_table(file, "instances"), f"the instances file {str(file)!r}")


def checked_instances(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return a table of instances (columns: see `sample_instances`) with all columns and their types.

    ``instance``, ``altitude_m``, ``crs``, the places in metres and the weights must be there; times default to the
    maps' first.

    Args:
      table: from a person.
      name: of the table, for messages.

    Raises:
      InputError: it lacks a column, holds no row, a value that is none of its column's, or an instance twice.
    """
    table = table.reset_index(drop=True)
    if lost := [column for column in NEEDED if column not in table]:
        raise InputError(f"{name} lacks the column {lost[0]!r}: it needs {', '.join(NEEDED)}")
    if table.empty:
        raise InputError(f"{name} holds no row: give at least one instance")
    for column in ("instance", "altitude_m", *PLACES, *WEIGHTS):
        values = pd.to_numeric(table[column], errors="coerce").to_numpy(np.float64)
        wrong, kind = ~np.isfinite(values), "a number"
        if column in WEIGHTS:
            wrong, kind = ~((values >= 0) & (values <= MOST_WEIGHT)), f"a number >= 0, at most {MOST_WEIGHT:g}"
        elif column == "instance":
            wrong = ~((values >= 0) & (values <= MOST_NUMBER) & (values == np.floor(values)))
            kind = "a whole number >= 0"
        _refuse(wrong, table[column], kind, name)
        table[column] = values.astype(np.int64) if column == "instance" else values
    twice = table.duplicated(list(KEY))
    if twice.any():
        number, altitude_m = table.loc[twice, list(KEY)].to_numpy()[0]
        raise InputError(f"{name} holds instance {number:g} at {altitude_m:g} m twice: number them anew")
    for column in TOLD:
        table[column] = table[column].astype(object).where(table[column].notna(), None) if column in table else None
    truths = table["is_connected"].map(lambda value: TRUTHS.get(str(value).lower()))
    _refuse((truths.isna() & table["is_connected"].notna()).to_numpy(), table["is_connected"], "true or false", name)
    table["is_connected"] = truths.astype(object).where(truths.notna(), None)
    if "distance_m" not in table:
        table["distance_m"] = np.hypot(table.goal_x_m - table.start_x_m, table.goal_y_m - table.start_y_m)
    return table


def _refuse(wrong: np.ndarray, column: pd.Series, kind: str, name: str) -> None:
    """Raise InputError for the first wrong value ``[N]`` of a column, if there is any."""
    if wrong.any():
        row = int(np.argmax(wrong))
        value = column.iloc[row]
        plain = value.item() if isinstance(value, np.generic) else value
        raise InputError(f"{name}, row {row + 1}: {column.name} must be {kind}, got {plain!r}")
