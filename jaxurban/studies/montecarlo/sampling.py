"""Instances of a Monte Carlo benchmark: places by stratum and range, times of day and weights, all from one seed."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pandas as pd
import shapely
from scipy.ndimage import label, uniform_filter

from jaxurban.checks import at_least, one_of, typed
from jaxurban.errors import InputError
from jaxurban.io.burn import burn
from jaxurban.io.tables import read_table
from jaxurban.maps.levels import index_of
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import METRIC_WEIGHT, MOST_WEIGHT, Weights, weights_on
from jaxurban.paths.choices import RulesChoice
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.places import XY
from jaxurban.paths.plan import rules_on
from jaxurban.paths.queries import IN_METRES, WEIGHT_PREFIX, Query
from jaxurban.planners.cost import CostModel
from jaxurban.settings import iso_utc
from jaxurban.world.grid import Grid
from jaxurban.world.land_cover import LandCover

# Straight distance between start and goal, as shares of the region's diagonal.
RANGES = {"short": (0.05, 0.15), "middle": (0.15, 0.35), "long": (0.35, 0.8)}
STRATA = ("water", "park", "wide-open", "open", "low-rise", "high-rise")
NEAR_M = 125.0  # half the side of the square that makes a place built-up
FAR_M = 250.0  # half the side of the square without a roof that makes a place wide-open
BUILT_SHARE = 0.1  # of the square's cells
HIGH_RISE_M = 35.0  # roofs from here up are high-rise buildings (Emporis' definition)
NO_STRATUM = -1
DIRICHLET = "dirichlet"
MOST_WEIGHTS = 3  # of instances that a command names
NUM_DOUBLINGS = 5  # of the pairs drawn, until so many are joined as are wanted
# Starts, and goals for each, before a kind of instance is passed over.
NUM_TRIES, NUM_GOALS = 200, 256

KEY = ["instance", "altitude_m"]
TIMES = ("time", "time_of_day")
# None where a file holds none.
OPTIONAL = (*TIMES, "start_stratum", "goal_stratum", "range", "is_connected")
MOST_NUMBER = 2**53  # of an instance: as far as float64 counts


def weighed_metrics(columns: Iterable[Any]) -> tuple[str, ...]:
    """Return the metrics that instances of these columns hold weights of: the built-in ones, then a user's own."""
    weights = [name for name in map(str, columns) if name.startswith(WEIGHT_PREFIX)]
    weighed = dict.fromkeys([*METRICS, *(name.removeprefix(WEIGHT_PREFIX) for name in weights)])
    weighed.pop("distance", None)
    return tuple(weighed)


def weight_columns(metrics: Iterable[str]) -> tuple[str, ...]:
    """Return the columns of the weights of the distance and of these metrics, beside the built-in ones."""
    return tuple(WEIGHT_PREFIX + name for name in dict.fromkeys(("distance", *METRICS, *metrics)))


def as_columns(weights: Weights, metrics: Iterable[str]) -> dict[str, Any]:
    """Return weights as columns of instances on maps of these metrics."""
    return {name: weights[name.removeprefix(WEIGHT_PREFIX)] for name in weight_columns(metrics)}


def query_columns(columns: Iterable[Any]) -> list[str]:
    """Return the columns, of these of a table of instances, that planners depend on; all else describes them."""
    return ["crs", *IN_METRES, *weight_columns(weighed_metrics(columns)), *TIMES]


@typed
def sample_instances(
    maps: MapsLike,
    num: int = 200,
    *,
    altitudes_m: Sequence[float] | None = None,
    weights: str | Sequence[Weights] = DIRICHLET,
    cover: LandCover | None = None,
    seed: int = 0,
    **rules: Unpack[RulesChoice],
) -> pd.DataFrame:
    """Return the instances of a Monte Carlo benchmark, ``num`` at each altitude, as a table.

    Places, time and weights are the same at every altitude, so that altitudes can be compared pair by pair. Kinds
    (stratum of the start x stratum of the goal x range) take turns in a shuffled order, so that each comes
    equally often; a kind that the maps do not offer is passed over. Instance ``k`` depends on the seed and ``k``, not
    on ``num``. Starts and goals are centres of cells that are free at every altitude and time. Pairs that no path joins
    are kept and marked (``is_connected``).

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      num: instances at each altitude.
      altitudes_m: of the maps' altitudes; all if left out.
      weights: ``"dirichlet"``: uniform on the simplex of shares, distance counted per reference length and metrics as
        they are; or weights, which take turns.
      cost_model: its reference length is what the share of distance is divided by; its rule for diagonal steps
        decides which pairs are joined.
      constraints: no-fly zones, bounds and clearances that close cells to starts, goals and paths.
      preset: as in `jaxurban.cost_map`.
      cover: water and parks as outlines, which are then strata of their own.
      seed: of everything.

    Returns:
      A row per instance and altitude, which `jaxurban.studies.study` takes: ``instance``, ``altitude_m``, ``crs``,
      ``start_x_m``, ``start_y_m``, ``goal_x_m``, ``goal_y_m``, ``start_lon``, ``start_lat``, ``goal_lon``,
      ``goal_lat``, ``time``, ``time_of_day``, ``start_stratum``, ``goal_stratum``, ``range``, ``distance_m``
      (straight), ``is_connected``, ``w_distance`` (per metre), ``w_gps``, ``w_lidar``, ``w_population``, ``w_risk`` (0
      where the maps hold no such metric) and the like of a user's own layers.

    Raises:
      InputError: ``num`` below 1, an unknown altitude, none or one twice, no weights or one of a metric that the maps
        lack, or too few free cells for any pair of places.

    Examples:
      >>> instances = ju.studies.sample_instances(maps, 3, weights=[ju.Weights(risk=5.0)], seed=1)
      >>> instances[["instance", "altitude_m", "w_risk", "is_connected"]]
         instance  altitude_m  w_risk  is_connected
      0         0        20.0     5.0         False
      1         1        20.0     5.0          True
      2         2        20.0     5.0          True
      3         0        60.0     5.0          True
      4         1        60.0     5.0          True
      5         2        60.0     5.0          True
    """
    # The arguments.
    maps, model, constraints = rules_on(as_maps(maps), **rules)
    altitudes_m = tuple(map(float, maps.altitudes_m if altitudes_m is None else altitudes_m))
    listed = None if isinstance(weights, str) else [weights_on(maps, each) for each in weights]
    if not altitudes_m or len(set(altitudes_m)) != len(altitudes_m):
        names_m = ", ".join(f"{z_m:g}" for z_m in altitudes_m) or "none"
        raise InputError(
            f"altitudes_m must name at least one altitude and none twice, got {names_m}"
        )
    at_least("num", num, 1)
    if not listed and weights != DIRICHLET:
        raise InputError(
            f"weights must be {DIRICHLET!r} or a list of at least one Weights, got {weights!r}"
        )
    for altitude_m in altitudes_m:
        index_of("altitude", altitude_m, maps.altitudes_m)

    # A row per pair of places. Its generator draws place, times and weights in this order, so that no option changes
    # what the others draw.
    is_free = np.logical_and.reduce([_always_free(maps, z_m, constraints) for z_m in altitudes_m])
    draw_places = _places(maps, is_free, cover, at_least("seed", seed))
    names = ("distance", *maps.metrics)
    rows = []
    for number in range(num):
        rng = np.random.default_rng([seed, 1, number])
        row: dict[str, Any] = {"instance": number, "altitude_m": 0.0} | draw_places(rng)
        row["time"] = None if maps.default_time is None else str(rng.choice(maps.times))
        row["time_of_day"] = str(rng.choice(maps.times_of_day)) if maps.times_of_day else None
        shares = rng.dirichlet(np.ones(len(names)))
        shares[0] /= model.reference_length_m  # the weight of the distance is per metre
        if listed is None:
            drawn = dict(zip(names, shares.tolist(), strict=True))
            weights_of_row = Weights(**dict.fromkeys(METRICS, 0.0) | drawn)
        else:
            weights_of_row = listed[number % len(listed)]
        rows.append(row | as_columns(weights_of_row, maps.metrics))

    # The same pairs at every altitude.
    pairs = pd.DataFrame(rows).assign(crs=maps.grid.crs)
    at_altitudes = [pairs.assign(altitude_m=z_m) for z_m in altitudes_m]
    table = pd.concat(at_altitudes, ignore_index=True)
    table = with_connection(table, maps, model, constraints)
    return table.assign(is_connected=table.is_connected.astype(bool))


def sample_joined(maps: MapsLike, num: int, **options: Any) -> pd.DataFrame:
    """Return the first ``num`` instances of `sample_instances` that a path joins at every altitude.

    They keep their numbers, which are not consecutive where a pair between them is not joined.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      num: instances at each altitude.
      options: further arguments of `sample_instances`.

    Raises:
      InputError: as there, or no path joins most pairs.
    """
    # Twice as many are drawn each time, until enough of them are joined. More draws leave the first ones as they were.
    num_drawn = num
    for _ in range(NUM_DOUBLINGS):
        table = sample_instances(maps, num_drawn, **options)
        is_joined = table.groupby("instance").is_connected.all()  # by number of the instance
        numbers = is_joined.index[is_joined]
        if len(numbers) >= num:
            return table[table.instance.isin(numbers[:num])].reset_index(drop=True)
        num_drawn *= 2
    raise InputError(
        f"of {len(is_joined)} pairs of places drawn on these maps a path joins {len(numbers)} at every altitude, and "
        f"{num} are wanted: ask for fewer, leave out the lowest altitude, or loosen the constraints"
    )


def instances_of_queries(maps: MapsLike, queries: Sequence[Query]) -> pd.DataFrame:
    """Return queries, as `jaxurban.plan_many` takes them, as instances, numbered from 0.

    They have no strata and no range; a query without a time takes the first one of the maps.

    Args:
      maps: from `build_maps` or `open_maps`, or the folder of one resolution's maps.
      queries: from `read_queries`.

    Raises:
      InputError: a query that cannot be read, or a place in degrees outside the maps (names its row).
    """
    maps = as_maps(maps)
    grid = maps.grid
    rows = []
    for number, query in enumerate(queries):
        row: dict[str, Any] = {"instance": number, "altitude_m": query.altitude_m, "crs": grid.crs}

        # Both ends; a place that is not in metres is longitude and latitude.
        try:
            if query.error:
                raise InputError(query.error)
            for end, place in (("start", query.start), ("goal", query.goal)):
                xy_m: Any = place[:2]
                if not isinstance(place, XY):
                    lonlat, xy_m = xy_m, grid.xy_of_lonlat(*xy_m)
                    if not grid.contains_xy(*xy_m):
                        raise InputError(f"{end}: {grid.outside_said(*lonlat)}")
                row |= _end_facts(grid, end, *xy_m)
        except InputError as error:
            raise InputError(f"query {number + 1}: {error}") from error

        # Its times and its weights.
        row["time"] = maps.default_time
        if query.time is not None and maps.default_time is not None:
            row["time"] = iso_utc(query.time)
        row["time_of_day"] = query.time_of_day or next(iter(maps.times_of_day), None)
        rows.append(row | as_columns(query.weights, maps.metrics))
    return checked_instances(pd.DataFrame(rows), "the queries")


def _end_facts(grid: Grid, end: str, x_m: float, y_m: float) -> dict[str, object]:
    """Return the columns of one end of an instance: its place in metres and in degrees.

    Args:
      grid: of the maps, in whose CRS the metres are.
      end: ``"start"`` or ``"goal"``, with which the names of the columns begin.
      x_m, y_m: easting and northing of the end.
    """
    lon, lat = grid.lonlat_of_xy(x_m, y_m)
    return {
        f"{end}_x_m": float(x_m),
        f"{end}_y_m": float(y_m),
        f"{end}_lon": float(lon),
        f"{end}_lat": float(lat),
    }


def _diagonal_m(grid: Grid) -> float:
    return float(np.hypot(*grid.shape)) * grid.resolution_m


def _places(
    maps: MetricMaps, is_free: np.ndarray, cover: LandCover | None, seed: int
) -> Callable[[np.random.Generator], dict[str, object]]:
    """Return a function that draws a pair of places of the next kind that the maps offer, from a generator.

    It returns the pair's columns: ends, distance, strata and range, and raises InputError if no kind offers a pair.

    Args:
      maps: their roofs decide the strata.
      is_free: ``[Y, X]`` bool.
      cover: water and parks, as in `strata_of`.
      seed: of the order in which kinds of pairs take turns.

    Raises:
      InputError: fewer than two free cells.
    """
    grid = maps.grid
    strata = np.where(is_free, strata_of(maps, cover), NO_STRATUM).ravel()

    # Flat numbers of the free cells of each stratum, and the strata that have any.
    cells = [np.flatnonzero(strata == number) for number in range(len(STRATA))]
    present = [number for number, of_stratum in enumerate(cells) if len(of_stratum)]

    # Each kind is the stratum of the start, that of the goal and a range.
    kinds = list(itertools.product(present, present, RANGES))
    dealt = itertools.count()  # numbers the kinds that are drawn
    if sum(map(len, cells)) < 2:
        raise InputError(
            "fewer than two cells are free at every altitude of the benchmark: leave out the lowest one, or loosen "
            "the constraints"
        )

    def draw(rng: np.random.Generator) -> dict[str, object]:
        """Return the columns of the next pair."""
        for _ in kinds:
            # The next kind: they are shuffled again each time all of them were drawn.
            turn, place = divmod(next(dealt), len(kinds))
            order = np.random.default_rng([seed, 0, turn]).permutation(len(kinds))
            start_stratum, goal_stratum, name = kinds[order[place]]
            low_m, high_m = np.multiply(RANGES[name], _diagonal_m(grid))

            # Each try draws one start and many goals, and takes the first goal that is as far away as is wanted. Cells
            # are flat numbers: row times the number of columns, plus column.
            for _ in range(NUM_TRIES):
                row, col = np.divmod(rng.choice(cells[start_stratum]), grid.num_cols)
                rows, cols = np.divmod(rng.choice(cells[goal_stratum], NUM_GOALS), grid.num_cols)
                away_m = np.hypot(rows - row, cols - col) * grid.resolution_m
                fits = np.flatnonzero((away_m >= low_m) & (away_m < high_m))
                if len(fits):
                    first = fits[0]
                    return {
                        **_end_facts(grid, "start", *grid.xy_of_cell(row, col)),
                        **_end_facts(grid, "goal", *grid.xy_of_cell(rows[first], cols[first])),
                        "distance_m": float(away_m[first]),
                        "start_stratum": STRATA[start_stratum],
                        "goal_stratum": STRATA[goal_stratum],
                        "range": name,
                    }
        raise InputError(
            "no two free cells of these maps lie far enough apart for a benchmark: use a larger region"
        )

    return draw


def _always_free(maps: MetricMaps, altitude_m: float, constraints: Constraints) -> np.ndarray:
    """Return ``[Y, X]`` bool: cells that are free at an altitude at every time, and time of day, of the maps."""
    if not constraints.bounds:  # which alone close other cells at other times
        return constraints.is_free(maps, altitude_m)
    times = (None,) if maps.default_time is None else maps.times
    places = itertools.product([altitude_m], times, maps.times_of_day or (None,))
    free = [constraints.is_free(maps, z_m, time=time, time_of_day=day) for z_m, time, day in places]
    return np.logical_and.reduce(free)


def with_connection(
    instances: pd.DataFrame, maps: MetricMaps, model: CostModel, constraints: Constraints
) -> pd.DataFrame:
    """Return instances with a new column ``is_connected``: whether a path joins start and goal on these maps.

    It is None where the start or the goal is not a free cell of the maps.

    Args:
      instances: with the columns of `checked_instances`.
      maps, constraints: decide which cells are free.
      model: decides whether a diagonal step may pass between two closed cells.
    """
    # Instances with the same free cells go together: those of one altitude, and with bounds of one time too, since only
    # bounds close other cells at other times.
    joined = pd.Series(None, index=instances.index, dtype=object)
    keys = ["altitude_m"]
    if constraints.bounds:
        keys += TIMES
    for _, part in instances.groupby(keys, dropna=False):
        # The free cells at the altitude and times that the part shares.
        first = part.iloc[0]
        times = {name: None if pd.isna(first[name]) else str(first[name]) for name in TIMES}
        is_free = constraints.is_free(maps, float(first.altitude_m), **times)

        # Islands of free cells, numbered from 1: a path joins two cells if they are in one. Where a diagonal step needs
        # both orthogonal neighbours free, it leads nowhere that orthogonal steps do not.
        islands, _ = label(is_free, np.ones((3, 3)) if model.joins_corners else None)

        # The island of each end, 0 outside the maps and in cells that are not free.
        island = {}
        for end in ("start", "goal"):
            x_m, y_m = part[[f"{end}_x_m", f"{end}_y_m"]].to_numpy().T
            is_inside = maps.grid.contains_xy(x_m, y_m)
            cells = maps.grid.cell_of_xy(x_m[is_inside], y_m[is_inside])
            island[end] = np.zeros(len(part), islands.dtype)
            island[end][is_inside] = islands[cells]
        is_closed = (island["start"] == 0) | (island["goal"] == 0)
        joined[part.index] = np.where(is_closed, None, island["start"] == island["goal"])
    return instances.assign(is_connected=joined.infer_objects())


def strata_of(maps: MetricMaps, cover: LandCover | None = None) -> np.ndarray:
    """Return ``[Y, X]`` int8, the number of each cell's stratum in `STRATA`, `NO_STRATUM` where there are no data.

    **water** and **park** are cells whose centre lies in water or in a park of the land cover; water goes first.
    Elsewhere the square of 250 m around a cell decides: **high-rise** if at least a tenth of its cells carry a roof of
    35 m or more, else **low-rise** if at least a tenth carry any roof, else **open** (squares, shores, yards).
    **wide-open** is an open cell with no roof in the square of 500 m around it; without a land cover, wide water and
    the middle of a large park are wide-open too. At the maps' edges only the part of a square inside counts.

    Args:
      maps: their roofs count.
      cover: water and parks in the maps' CRS; left out, neither is known.
    """
    # Half the sides of the two squares, in cells, and what the roofs in them say of each cell.
    roof_m = maps.m("roof")
    near = max(1, round(NEAR_M / maps.grid.resolution_m))
    far = max(1, round(FAR_M / maps.grid.resolution_m))
    is_high = share_around(roof_m >= HIGH_RISE_M, near) >= BUILT_SHARE
    is_built = share_around(roof_m > 0, near) >= BUILT_SHARE
    is_wide = share_around(roof_m > 0, far) == 0

    # The first of these strata whose condition holds, and the land cover over them, parks first.
    numbers = [STRATA.index(name) for name in ("high-rise", "low-rise", "wide-open")]
    strata = np.select([is_high, is_built, is_wide], numbers, STRATA.index("open")).astype(np.int8)
    if cover is not None:
        for name, shape in (("park", cover.park), ("water", cover.water)):
            parts = shapely.get_parts(shape)

            # 1 inside the parts, else 0.
            covered, _ = burn(parts, np.ones(len(parts)), maps.grid, 0, "int32")
            strata[covered == 1] = STRATA.index(name)
    strata[~maps.ds["has_data"].values] = NO_STRATUM
    return strata


def share_around(mask: np.ndarray, half: int) -> np.ndarray:
    """Return ``[Y, X]`` the share of set cells of a mask in the square around each cell.

    At the edges only the part of a square inside the mask counts.

    Args:
      mask: ``[Y, X]`` bool.
      half: a square reaches so many cells to each side.
    """
    side = 2 * half + 1

    def num_around(cells: np.ndarray) -> np.ndarray:
        """Return ``[Y, X]`` how many set cells the square around each cell holds, outside none."""
        means = uniform_filter(cells.astype(np.float64), side, mode="constant")
        return np.rint(means * side**2)

    return num_around(mask) / num_around(np.ones_like(mask))


def read_instances(file: str | Path) -> pd.DataFrame:
    """Return the instances in a Parquet or CSV file (`checked_instances`).

    Raises:
      InputError: the file cannot be read, or its table is wrong.
    """
    return checked_instances(read_table(file, "instances"), f"the instances file {str(file)!r}")


def checked_instances(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return a table of instances (columns: see `sample_instances`) with all columns and their types.

    ``instance``, ``altitude_m``, ``crs``, the places in metres and the weights must be there. A missing column of
    `OPTIONAL` is filled with None, and ``distance_m`` is computed. The table itself is left as it was.

    Args:
      table: instances that a user made or changed.
      name: what messages call the table, such as its file.

    Raises:
      InputError: the table lacks a column, holds no row, a value that its column cannot have, or an instance twice.
    """
    # The columns that a table must have.
    table = table.reset_index(drop=True)
    weights = weight_columns(weighed_metrics(table.columns))
    needed = ("instance", "altitude_m", "crs", *IN_METRES, *weights)
    lost = [column for column in needed if column not in table]
    if lost:
        raise InputError(f"{name} lacks the column {lost[0]!r}: it needs {', '.join(needed)}")
    if table.empty:
        raise InputError(f"{name} holds no row: give at least one instance")

    # The numbers in them, of which texts are parsed. What is no number becomes NaN, which no column accepts.
    for column in ("instance", "altitude_m", *IN_METRES, *weights):
        values = pd.to_numeric(table[column], errors="coerce").to_numpy(np.float64)
        is_valid = np.isfinite(values)
        kind = "a number"
        if column in weights:
            is_valid = (values >= 0) & (values <= MOST_WEIGHT)
            kind = f"a number >= 0, at most {MOST_WEIGHT:.0e}"
        elif column == "instance":
            is_valid = (values >= 0) & (values <= MOST_NUMBER) & (values == np.floor(values))
            kind = "a whole number >= 0"
        if not is_valid.all():
            row = int(np.argmin(is_valid))
            value = table[column].tolist()[row]  # a list's numbers are Python's
            raise InputError(f"{name}, row {row + 1}: {column} must be {kind}, got {value!r}")
        table[column] = values.astype(np.int64) if column == "instance" else values

    # No instance twice at one altitude.
    twice = table.duplicated(KEY)
    if twice.any():
        number, altitude_m = table.loc[twice, KEY].to_numpy()[0]
        raise InputError(
            f"{name} holds instance {number:g} at {altitude_m:g} m twice: renumber them"
        )

    # Columns that may be missing: texts, with None where there is none, and the straight distance.
    for column in OPTIONAL:
        texts = table.get(column, pd.Series(index=table.index)).astype(object)
        table[column] = texts.where(texts.notna(), None)
    if "distance_m" not in table:
        table["distance_m"] = np.hypot(
            table.goal_x_m - table.start_x_m, table.goal_y_m - table.start_y_m
        )
    return table


def check_instances(instances: pd.DataFrame, maps: MetricMaps) -> None:
    """Raise InputError unless instances fit maps: the CRS, altitudes, times and metrics.

    Args:
      instances: with the columns of `checked_instances`; a missing time stands for any.
      maps: need every altitude and time of the instances; the instances need a weight for every metric of the maps.
    """
    crs = set(instances.crs) - {maps.grid.crs}
    if crs:
        raise InputError(
            f"the instances' places are in {crs.pop()}, the maps in {maps.grid.crs}: use maps in that CRS"
        )

    # Altitudes and times that the maps do not hold.
    of_maps: dict[str, Sequence[Any]] = {
        "altitude_m": maps.altitudes_m,
        "time": () if maps.default_time is None else maps.times,
        "time_of_day": maps.times_of_day,
    }
    for name, values in of_maps.items():
        lost = [value for value in instances[name].dropna().unique() if value not in values]
        if lost:
            texts = [f"{value:g}" if isinstance(value, float) else value for value in values]
            raise InputError(
                f"the instances ask for {name} {lost[0]}, and these maps hold {', '.join(texts) or 'none'}"
            )

    # Weights of unknown metrics, and metrics without a weight.
    for name in weighed_metrics(instances.columns):
        one_of("a weight of the instances", name, dict.fromkeys((*METRICS, *maps.metrics)))
    lost = [column for column in weight_columns(maps.metrics) if column not in instances]
    if lost:
        raise InputError(
            f"the instances have no weight {lost[0]!r} for a metric of these maps: add it, 0 for none"
        )

    # Weights of metrics that these maps lack, but for those that nobody named.
    for name in weighed_metrics(instances.columns):
        usual = 0.0, METRIC_WEIGHT, maps.recorded.get("weights", {}).get(name)
        if name not in maps.metrics and not instances[WEIGHT_PREFIX + name].isin(usual).all():
            raise InputError(
                f"the instances have a weight of {name}, of which these maps hold no layer: set {WEIGHT_PREFIX}{name} "
                "to 0, or use maps with the layer"
            )


def weights_setting(instances: pd.DataFrame) -> str:
    """Return the weights of instances as ``--set`` takes those that further ones are drawn with.

    Empty where there are more than `MOST_WEIGHTS`, as drawn ones are.
    """
    columns = instances.filter(regex=f"^{WEIGHT_PREFIX}").drop_duplicates()
    if len(columns) > MOST_WEIGHTS or columns.empty:
        return ""
    columns.columns = columns.columns.str.removeprefix(WEIGHT_PREFIX)
    tables = []
    for weights in columns.to_dict("records"):
        values = ", ".join(f"{name} = {value:.6g}" for name, value in weights.items())
        tables.append(f"{{{values}}}")
    return f"study.weights=[{', '.join(tables)}]"
