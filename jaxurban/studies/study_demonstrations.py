"""Demonstrations from studies of planners and tables of instances: routes planned again under their rows' weights.

A study keeps what each route costs, not its points. The same planner finds the same route again, of as many samples
where it draws any, and a route that costs otherwise than its row says is left out.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
import pandas as pd

from jaxurban.checks import finite, one_of, typed, values_given
from jaxurban.errors import InputError, SkippedRouteWarning, warn
from jaxurban.io.tables import INSTANCES_FILE, ROWS_FILE, Row, read_table, records_of
from jaxurban.io.workspace import Workspace
from jaxurban.kernels.tolerances import SAME_RECORDED_COST
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.maps.scenario import Study
from jaxurban.metrics.weights import Weights, weights_on
from jaxurban.paths.choices import RulesChoice
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.queries import WEIGHT_PREFIX, read_queries
from jaxurban.paths.rows import HAS_PATH
from jaxurban.planners.base import Status
from jaxurban.planners.cost import CostModel
from jaxurban.planners.registry import find_planner
from jaxurban.settings import iso_utc
from jaxurban.studies.demonstrations import MOST_REASONS, Demonstration, demonstration_from_line
from jaxurban.studies.montecarlo.sampling import (
    KEY,
    as_columns,
    check_instances,
    checked_instances,
    instances_of_queries,
    read_instances,
)
from jaxurban.studies.montecarlo.study import BenchmarkResult
from jaxurban.studies.montecarlo.trial import WEIGHTED, Benchmark, draws_samples, ends_and_weights

EXACT = "astar"  # plans the routes of tables
ALIKE = 1e-9  # relative: weights of rows, scaled to sum 1, that are one W
STARTS = {"start_lon", "start_x_m"}  # one of them is a column of every table of routes
OF_ROW = ("status", "cost", "num_samples")  # what a study says of a route
OF_STUDY = ("instance", "altitude_m", "planner", "objective", *OF_ROW)


class _Source(NamedTuple):
    """Instances whose routes are wanted, what their study was run under, and the planner of their routes.

    Attributes:
      name: of the folder or the file, for messages.
      table: a row per instance; for a study's folder also the columns `OF_ROW` of the planner's own row.
      settings: of the study, by name; empty for a table of instances.
      planner: plans the routes again.
    """

    name: str
    table: pd.DataFrame
    settings: Mapping[str, Any]
    planner: str


@typed
def demonstrations_from_study(
    study: BenchmarkResult | pd.DataFrame | str | Path,
    maps: MapsLike | None = None,
    altitude_m: float | None = None,
    time: str | None = None,
    time_of_day: str | None = None,
    *,
    planner: str | None = None,
    pilot: Weights | None = None,
    metrics: Sequence[str] | None = None,
    **rules: Unpack[RulesChoice],
) -> list[Demonstration]:
    """Return the routes of a Monte Carlo study, or of a table of instances, as demonstrations of one W.

    The routes are planned again, each under the weights of its row, and for a study by the planner of its row. Rows
    without a path are left out with a warning that counts them, and so are routes that now have another cost than their
    row says, as where a budget in seconds ended the search. Routes by day and by night go together, since one W planned
    them all.

    Args:
      study: what `jaxurban.studies.study` returned, or the folder that it or ``jaxurban study`` wrote; or instances
        (`jaxurban.studies.sample_instances`) or queries (`plan_many`), as a table or in a .csv or .parquet file.
      maps: the maps on which the study was run, from `build_maps` or `open_maps`, or their folder; may be left out for
        a result and for the folder of ``jaxurban study``, which hold them.
      altitude_m, time, time_of_day: take only the routes at this altitude and these times; left out, at all.
      planner: the planner of the study whose routes are taken; left out, the one that most often proved its route the
        cheapest.
      pilot: weights under which all routes are planned, by A*, instead of the weights of the rows.
      cost_model, constraints, preset: as in `plan`; left out, the study's own, but no-fly zones must be given again.
      metrics: the metrics whose weights are to be fitted; all if left out.

    Returns:
      A `Demonstration` per route, in the order of the rows, named by the number of its instance.

    Raises:
      InputError: no finished study, a damaged table, other maps or constraints than the study's, an unknown planner,
        rows under different weights (without a pilot), or no route that is of use.

    Examples:
      >>> chosen = ju.studies.Study(planners="astar-plus", weights=[ju.Weights(risk=5.0)], altitudes_m=[60.0])
      >>> run = ju.studies.study(maps, "one-w", 4, settings=chosen, progress=False)
      >>> routes = ju.fit.demonstrations_from_study(run)
      >>> [each.query.name for each in routes], routes[0].query.cost_map.altitude_m
      (['0', '1', '2', '3'], 60.0)
    """
    # The arguments. A result holds maps and constraints, which count where the arguments leave them out.
    if planner is not None and pilot is not None:
        raise InputError(
            f"a pilot's routes are planned by A*, so that those of planner {planner!r} are not taken: leave one of "
            "both out (--planner, --pilot)"
        )
    if altitude_m is not None:
        altitude_m = finite("altitude_m", altitude_m)
    given = values_given(rules)
    if isinstance(study, BenchmarkResult):
        maps = study.maps if maps is None else maps
        given.setdefault("constraints", study.settings.constraints)
        study = study.folder
    maps = as_maps(_maps_of(study) if maps is None else maps)

    # The instances, with the weights of the pilot if there is one, and the rules under which their routes are planned.
    pilot_columns = {} if pilot is None else as_columns(weights_on(maps, pilot), maps.metrics)
    source = _source(study, maps, planner, pilot_columns)
    if source.settings:
        given.setdefault("cost_model", CostModel.from_settings(source.settings))
    job = Benchmark(study=Study(seed=source.settings.get("seed", 0)), **given)
    maps, job = job.under(maps)
    for name, value in job.deciding(maps).items():
        before = source.settings.get(
            name, value
        )  # one that the study does not record counts as equal
        # The budget may differ: a route that it cut short is found by its cost.
        if name != "budget" and before != value:
            raise InputError(
                f"the study in {source.name!r} was run on other maps or settings than those given: its {name} is "
                f"{before}, here {value}: give its own (DIR, --resolution, --preset, --rules, --no-fly, "
                "--require; maps=, cost_model=, constraints=, preset=)"
            )
    check_instances(source.table, maps)

    # The rows at the altitude and times that are asked for.
    table = source.table
    if time is not None:
        time = one_of("time", iso_utc(time), maps.times)
    if time_of_day is not None:
        one_of("time_of_day", time_of_day, maps.times_of_day)
    wanted = {"altitude_m": altitude_m, "time": time, "time_of_day": time_of_day}
    for column, value in wanted.items():
        if value is not None:
            table = table[table[column] == value]
    _check_one_weights(source.name, table)

    return _planned_again(job, maps, source.name, table, source.planner, metrics)


def _planned_again(
    job: Benchmark,
    maps: MetricMaps,
    name: str,
    table: pd.DataFrame,
    planner: str,
    metrics: Sequence[str] | None,
) -> list[Demonstration]:
    """Return the routes of rows, planned again, as demonstrations; warns of those that are left out, by reason.

    Args:
      job: the rules that the routes are planned under.
      maps: on which they lie.
      name: of the study or table, for messages.
      table: a row per route, as of a `_Source`.
      planner: of the routes.
      metrics: whose weights are to be fitted; None: all.

    Raises:
      InputError: no route is of use.
    """
    # The cost maps by altitude, time and time of day: routes are planned on maps of all metrics, and fitted on maps of
    # the chosen ones. Each map is made once, since a fit takes two equal maps for different ones.
    planned_map = cache(partial(job.cost_map, maps))
    fitted_map = planned_map
    if metrics is not None:
        fitted_map = cache(lambda *place: planned_map(*place).only(metrics))

    # The route of each row, planned again; a row that is of no use is counted by the reason.
    demonstrations = []
    reasons: Counter[str] = Counter()
    for row in records_of(table):
        place = row["altitude_m"], row["time"], row["time_of_day"]
        cost_map = planned_map(*place)
        cost_map_of_fit = fitted_map(*place)
        try:
            points_m = _points(job, cost_map, row, planner)
            route = demonstration_from_line(cost_map_of_fit, points_m, f"{row['instance']}")
            demonstrations.append(replace(route, query=replace(route.query, is_planned=True)))
        except InputError as error:
            reasons[str(error)] += 1

    # What was left out, by reason.
    if not demonstrations:
        raise InputError(
            f"no route of {name!r} is of use: {_listed(reasons) or 'none is asked for'}"
        )
    if reasons:
        were = "was" if reasons.total() == 1 else "were"
        left_out = f"{reasons.total()} of {len(table)} routes of {name!r} {were} left out: {_listed(reasons)}"
        warn(left_out, SkippedRouteWarning)
    return demonstrations


def study_in(folder: Path) -> Path | None:
    """Return the folder of a Monte Carlo study: this one, or its ``study``; None where neither is one."""
    for study in (folder, folder / "study"):
        if (study / ROWS_FILE).is_file():
            return study
    return None


def _maps_of(study: pd.DataFrame | str | Path) -> Path:
    """Return the folder of the maps that a study was run on.

    This is the folder that holds the study's own folder, or the given folder itself where it holds no rows of a study.

    Raises:
      InputError: a table, a file, or a folder that does not exist.
    """
    name = "a table"
    if not isinstance(study, pd.DataFrame):
        name = repr(str(study))
        folder = Path(study)
        if (folder / ROWS_FILE).is_file():
            folder = folder.parent
        if folder.is_dir():
            return folder
    raise InputError(f"{name} does not hold the maps that its routes lie on: give them (maps=)")


def _source(
    study: pd.DataFrame | str | Path, maps: MetricMaps, planner: str | None, pilot_columns: Mapping
) -> _Source:
    """Return the instances whose routes are wanted, with all columns, and the planner that plans them.

    Args:
      study: a table of instances or of queries, the file of one, or the folder of a study.
      maps: the routes lie on them.
      planner: of a study, whose routes are taken (see `_of_folder`); must be None for a table.
      pilot_columns: a pilot's weights by column (``w_distance`` ...), which replace those of every row; empty: none do.

    Raises:
      InputError: a table or folder that cannot be used, a planner for a table, or routes without weights.
    """
    # A folder is a study; all else is a table.
    name = "the table"
    if isinstance(study, pd.DataFrame):
        table = study
    elif Path(study).is_dir():
        return _of_folder(study_in(Path(study)) or Path(study), planner, pilot_columns)
    else:
        name = str(study)
        table = read_table(study, "instances")
    if planner is not None:
        raise InputError(
            f"planner is one of a study's, and this is a table of instances: leave {planner!r} out"
        )

    # Without weights nothing says which routes are the cheapest.
    table = table.assign(**pilot_columns)
    has_weights = not table.filter(regex=f"^{WEIGHT_PREFIX}").empty
    if not has_weights and STARTS.intersection(table.columns):
        raise InputError(
            f"{name!r} has no weights under which its routes are the cheapest: give a column for each (w_distance, "
            "w_gps ...), or the weights of a pilot who flies all of them (--pilot, pilot=)"
        )

    # Instances have a number and a CRS of their own; queries are places in degrees.
    if "instance" in table or "crs" in table:
        instances = checked_instances(table, f"the instances file {name!r}")
    else:
        instances = instances_of_queries(maps, read_queries(table, metrics=maps.metrics))
    return _Source(name, instances, settings={}, planner=EXACT)


def _of_folder(folder: Path, planner: str | None, pilot_columns: Mapping) -> _Source:
    """Return the instances of a study in a folder, each with the status and cost of one planner's route.

    Args:
      folder: of the study.
      planner: whose weighted routes are taken; None: the one that most often proved its route the cheapest, of equals
        the one that found most routes.
      pilot_columns: a pilot's weights by column; unless empty, they replace those of the instances, `EXACT` plans all
        routes, and no planner's own results are added.

    Raises:
      InputError: no finished study, a damaged table, no weighted route, or a planner that the study does not have.
    """
    settings = Workspace.settings_of(folder, "study")
    if not settings or not all((folder / name).is_file() for name in (ROWS_FILE, INSTANCES_FILE)):
        raise InputError(
            f"{str(folder)!r} holds no study of planners: name the folder of one, after its maps where these lie "
            "elsewhere, or run `jaxurban study`"
        )
    table = read_instances(folder / INSTANCES_FILE)
    if pilot_columns:
        return _Source(str(folder), table.assign(**pilot_columns), settings, EXACT)

    # How the runs of each planner ended, by planner.
    rows = read_table(folder / ROWS_FILE, "rows")
    lost = [name for name in OF_STUDY if name not in rows]
    if lost:
        raise InputError(
            f"{str(folder / ROWS_FILE)!r} lacks the column {lost[0]!r}: run the study again"
        )
    rows = rows[rows.objective == WEIGHTED]
    ends = {
        "is_optimal": rows.status == Status.OPTIMAL.value,
        "has_path": rows.status.isin(HAS_PATH),
    }
    counts = rows.assign(**ends).groupby("planner", sort=False)[[*ends]].sum()
    if counts.empty:
        raise InputError(f"{str(folder)!r} holds no route under weights: run the study again")
    if planner is None:
        best_first = counts.sort_values([*ends], ascending=False, kind="stable")
        planner = str(best_first.index[0])

    # Each instance beside the row of the chosen planner.
    rows = rows[rows.planner == one_of("planner", planner, counts.index)]
    instances = table.merge(rows[[*KEY, *OF_ROW]], "left", KEY)
    return _Source(str(folder), instances, settings, planner)


def _check_one_weights(name: str, table: pd.DataFrame) -> None:
    """Raise InputError where the rows of a table are under weights of different ratios.

    Args:
      name: of the table, for the message.
      table: a row per instance, with a column per weight (``w_distance`` ...); an empty one passes.
    """
    weights = table.filter(regex=f"^{WEIGHT_PREFIX}").to_numpy(np.float64)
    sums = weights.sum(axis=1, keepdims=True)
    shares = weights / np.maximum(sums, np.finfo(float).tiny)
    if table.empty or np.ptp(shares, axis=0).max() <= ALIKE:
        return
    num_weights = len(np.unique(shares, axis=0))
    raise InputError(
        f"the routes of {name!r} were planned under {num_weights} different weights, and a fit finds one W: run the "
        "study under one ([study] weights = [{ gps = 1.0 }]), or name the weights of a pilot who flies all of its "
        "pairs (--pilot, pilot=)"
    )


def _points(job: Benchmark, cost_map: CostMap, row: Row, planner: str) -> np.ndarray:
    """Return ``[N, 2]`` the route of a row, eastings and northings in metres in the maps' CRS, planned again.

    Args:
      job: its seed is used for planners that draw samples.
      cost_map: at the row's altitude and times, with all metrics.
      row: of an instance; from a study also with the columns `OF_ROW`, which the new route must agree with.
      planner: finds the route, with as many samples as in the study and without a limit of time.

    Raises:
      InputError: the planner found no route, in the study or now, the new route has another cost than the row says, or
        an end of the route is not a free cell.
    """
    if "status" in row and row["status"] not in HAS_PATH:
        raise InputError(f"{planner} found no path")

    # The search of the study again: the same seed and as many samples, if the planner draws any.
    start, goal, weights = ends_and_weights(cost_map, row)
    options = {}
    if draws_samples(planner):
        options["max_samples"] = int(row["num_samples"])
    search = find_planner(planner)
    problem = cost_map.shortest.between(start, goal).with_weights(weights).alone()
    result = search(problem, budget_s=math.inf, seed=job.seed_of(row["instance"]), **options)
    if not result.status.has_path:
        raise InputError("no path joins their ends")

    # A route that costs otherwise than its row says is another one. A row that says no cost agrees with any.
    cost = cost_map.shortest.features(result.points_m, cost_map.cost_model.kind).cost(weights)
    if not math.isclose(cost, row.get("cost", cost), rel_tol=SAME_RECORDED_COST):
        raise InputError(
            "planned again they cost otherwise than their rows say, as where seconds ended the search"
        )
    return result.points_m + cost_map.grid.bounds_m[:2]


def _listed(reasons: Counter[str]) -> str:
    """Return why routes are left out, the most frequent reason first, each with the number of its routes."""
    listed = [f"{reason} ({num})" for reason, num in reasons.most_common(MOST_REASONS)]
    if len(reasons) > MOST_REASONS:
        listed.append(f"and {len(reasons) - MOST_REASONS} more reasons")
    return "; ".join(listed)
