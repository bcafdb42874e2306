"""A study's instances as a public benchmark: MovingAI files for shortest paths, maps and Parquet for weighted ones."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.movingai import GridProblem, write_map, write_scenarios
from jaxurban.io.store import short_number, whole_file
from jaxurban.io.tables import write_table
from jaxurban.limits import Limits
from jaxurban.maps import MetricMaps
from jaxurban.planners.base import CostModel, Status
from jaxurban.studies.analysis import each
from jaxurban.studies.sampling import KEY
from jaxurban.studies.trial import DISTANCE, WEIGHTED, Ground, Settings

INSTANCES_FILE, COSTS_FOLDER, GRID_FOLDER, PAGE_FILE = "instances.parquet", "costs", "movingai", "README.md"
GRID_PLANNERS = ("astar-dist", "astar-plus")  # what is optimal on the grid, where their status says so


def export_benchmark(
    maps: MetricMaps, instances: pd.DataFrame, rows: pd.DataFrame, folder: str | Path, settings: Settings, name: str
) -> dict[str, int]:
    """Write a benchmark under ``folder`` and return how many problems it holds of each kind.

    ``movingai/NAME_20m.map`` and ``.scen``: the shortest paths, for pairs whose optimal length a distance-only A*
    proved. ``instances.parquet`` and ``.csv``: all instances with ``grid_optimum`` (the cheapest path over the grid,
    where an A* proved it), ``best_known`` and ``best_planner``, by the study's cost model.
    ``costs/NAME_20m_day.npz``: the costs c_j and the free cells. ``README.md``: the format.

    Args:
      maps: what the study was made on.
      instances, rows: of a `StudyResult`.
      folder: where to.
      settings: of the study.
      name: of the city, for file names; letters, digits and hyphens.

    Raises:
      InputError: a name of other characters, a folder that cannot be written to, or what `check_exportable` refuses.
    """
    folder = Path(folder)
    check_exportable(settings.cost_model, settings.limits)
    if not name.replace("-", "").isalnum():
        raise InputError(f"the benchmark's name must be of letters, digits and hyphens, got {name!r}")
    num_shortest = 0
    for altitude_m in sorted(instances.altitude_m.unique()):
        stem = f"{name}_{short_number(altitude_m)}m"
        num_shortest += _write_grid(maps, instances, rows, folder, altitude_m, stem, settings.limits)
    for key, _ in instances.groupby(["altitude_m", "time", "time_of_day"], dropna=False):
        _write_costs(maps, folder, key, name, settings)
    told = instances.merge(_references(rows), on=list(KEY), how="left")
    for suffix in (".parquet", ".csv"):
        write_table(told, (folder / INSTANCES_FILE).with_suffix(suffix))
    counts = {"shortest": num_shortest, "weighted": len(told), "proven": int(told.grid_optimum.notna().sum())}
    with whole_file(folder / PAGE_FILE) as scratch:
        scratch.write_text(_page(maps, name, settings, counts), encoding="utf-8")
    return counts


def check_exportable(model: CostModel, limits: Limits) -> None:
    """Raise InputError unless the shortest paths of a study are those of MovingAI's format: call it before a study."""
    if (model.connectivity, model.diagonal) != (8, "both-free"):
        raise InputError(
            "a benchmark's shortest paths have 8 neighbours and no diagonal steps past blocked cells: plan with "
            f"connectivity 8 and diagonal 'both-free', not {model.connectivity} and {model.diagonal!r}, or leave "
            "--benchmark out"
        )
    if limits.bounds:
        raise InputError(
            "a benchmark holds one map of free cells an altitude, and bounds on maps close other cells at other times: "
            "leave --require or --benchmark out"
        )


def _write_grid(
    maps: MetricMaps,
    instances: pd.DataFrame,
    rows: pd.DataFrame,
    folder: Path,
    altitude_m: float,
    stem: str,
    limits: Limits,
) -> int:
    """Write the ``.map`` and ``.scen`` of one altitude and return the number of problems."""
    is_free, grid = limits.is_free(maps, altitude_m), maps.grid
    proven = rows[
        (rows.objective == DISTANCE) & (rows.status == Status.OPTIMAL.value) & rows.planner.isin(GRID_PLANNERS)
    ]
    proven = proven[proven.altitude_m == altitude_m].drop_duplicates("instance")
    lengths = dict(zip(proven.instance, proven.length_m, strict=True))
    problems = []
    for pair in each(instances[instances.altitude_m == altitude_m]):
        if pair.instance in lengths:
            start, goal = (
                tuple(int(number) for number in grid.cell_of_xy(x_m, y_m))
                for x_m, y_m in ((pair.start_x_m, pair.start_y_m), (pair.goal_x_m, pair.goal_y_m))
            )
            length = lengths[pair.instance] / grid.resolution_m
            problems.append(GridProblem((start[0], start[1]), (goal[0], goal[1]), length))
    write_map(is_free, folder / GRID_FOLDER / f"{stem}.map")
    write_scenarios(problems, is_free.shape, f"{stem}.map", folder / GRID_FOLDER / f"{stem}.map.scen")
    return len(problems)


def _write_costs(maps: MetricMaps, folder: Path, key: tuple[Any, ...], name: str, settings: Settings) -> None:
    altitude_m = float(key[0])
    time, time_of_day = (None if pd.isna(part) else str(part) for part in key[1:])
    ground = Ground(maps, altitude_m, time, time_of_day, settings)
    parts = [name, f"{short_number(altitude_m)}m", *filter(None, [time_of_day])]
    if len(maps.times) > 1 and time is not None:
        parts.append(time.translate({45: None, 58: None}))
    with whole_file(folder / COSTS_FOLDER / f"{'_'.join(parts)}.npz") as scratch, scratch.open("wb") as file:
        np.savez_compressed(
            file,
            names=np.array(ground.names),
            costs=ground.costs,
            is_free=ground.is_free,
            resolution_m=ground.grid.resolution_m,
            x_min_m=ground.grid.x_min_m,
            y_min_m=ground.grid.y_min_m,
        )


def _references(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the reference costs of each instance: the grid's optimum, and the cheapest path known."""
    found = rows[rows.cost.notna() & (rows.objective == WEIGHTED)]
    best = found.loc[found.groupby(list(KEY)).cost.idxmin(), [*KEY, "cost", "planner"]]
    best = best.rename(columns={"cost": "best_known", "planner": "best_planner"})
    proven = found[(found.status == Status.OPTIMAL.value) & found.planner.isin(GRID_PLANNERS)]
    optimum = proven.groupby(list(KEY)).cost.min().rename("grid_optimum").reset_index()
    return best.merge(optimum, on=list(KEY), how="left")


def _page(maps: MetricMaps, name: str, settings: Settings, counts: dict[str, int]) -> str:
    grid = maps.grid
    credit = maps.ds.attrs.get("attribution", "")
    cell = "plus w_j c_j(Q) summed over j, Q the cell in which the step ends"
    model = settings.cost_model
    line = f"plus the integral of w_j c_j along it over {model.reference_length_m:g} m, cut exactly at cell borders"
    return f"""# {name}: planning over an urban metric map

{grid.num_cols} x {grid.num_rows} cells of {grid.resolution_m:g} m, {grid.crs}; southwest corner {grid.x_min_m:.1f},
{grid.y_min_m:.1f} (east, north). {counts["weighted"]} weighted problems ({counts["proven"]} with a proven optimum over
the grid) and {counts["shortest"]} shortest-path problems with optimal lengths. {credit}

## Shortest paths: `movingai/`

`{name}_20m.map` and `.map.scen` at each altitude above ground, in the format of Sturtevant (2012),
movingai.com/benchmarks/formats: `.` is free, `@` an obstacle or closed by a no-fly zone; the first row is the northern
one; a problem is a line of bucket, map, width, height, start x, start y, goal x, goal y and optimal length in cell
sides. Diagonal steps cost the square root of 2 and need both orthogonal neighbours free. Pairs without a proven length
are left out.

## Weighted paths: `instances.parquet` (and `.csv`), `costs/`

One row a problem: `instance`, `altitude_m`, `time`, `time_of_day`; `start_x_m`, `start_y_m`, `goal_x_m`, `goal_y_m`
(centres of cells) in the CRS above and the same as longitude and latitude; `start_stratum`, `goal_stratum`, `range`,
`distance_m` (straight), `is_connected`; the weights `w_distance` (per metre), `w_gps`, `w_lidar`, `w_population`,
`w_risk`.

`costs/{name}_20m_day.npz` of NumPy: `costs` [metric, row, column] float32 in [0, 1], `names` of the metrics, `is_free`
[row, column], `resolution_m`, `x_min_m`, `y_min_m`. Row 0 is the southern one.

A step of length d from cell P to cell Q costs w_distance x d
{cell if model.kind == "cell" else line} (`{model.kind}` model).
A path is valid if every cell that it crosses is free.

- `grid_optimum`: cost of the cheapest {model.connectivity}-connected path (diagonal steps: {model.diagonal});
  empty where not proven in the study's budget. Paths that leave the grid may be cheaper.
- `best_known`, `best_planner`: the cheapest path found by any planner of the study; beat it.
"""
