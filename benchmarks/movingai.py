"""A study's instances as a public benchmark: MovingAI files for shortest paths, maps and Parquet for weighted ones.

``python -m benchmarks.movingai town.toml out/town -o out/public`` exports the study that ``jaxurban study town.toml -o
out/town`` made there, with the same ``--set``.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.draw.write import code, plain, save
from jaxurban.errors import InputError
from jaxurban.io.files import whole_file, write_whole
from jaxurban.io.stored import short_number
from jaxurban.io.tables import INSTANCES_FILE
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.scenario import Scenario
from jaxurban.paths.constraints import Constraints
from jaxurban.paths.rows import MapsFolder
from jaxurban.planners.base import Status
from jaxurban.planners.cost import CostModel
from jaxurban.studies.montecarlo.sampling import (
    KEY,
    read_instances,
    weighed_metrics,
    weight_columns,
)
from jaxurban.studies.montecarlo.study import study, without_sampling
from jaxurban.studies.montecarlo.trial import DISTANCE, WEIGHTED, Benchmark

PAGE = Path(__file__).with_name("movingai_page.md")

GRID_PLANNERS = "astar-dist", "astar-plus"  # optimal on the grid, where their status says so
# MovingAI's grid format: ``.map`` and ``.scen`` files (Sturtevant 2012, movingai.com/benchmarks/formats), whose first
# row is the northern one and whose y counts southward; here row 0 is in the south.
FREE, BLOCKED = ".", "@"
BUCKET = 4  # problems are sorted into buckets of so many cells of optimal length


def write_map(is_free: np.ndarray, file: Path) -> None:
    """Write which cells are free, ``[Y, X]`` bool with row 0 in the south, as a ``.map`` file, north first."""
    num_rows, num_cols = is_free.shape
    head = ["type octile", f"height {num_rows}", f"width {num_cols}", "map"]
    rows = ["".join(row) for row in np.where(is_free[::-1], FREE, BLOCKED)]
    write_whole(file, "\n".join([*head, *rows, ""]))


def write_scenarios(
    problems: pd.DataFrame, shape: tuple[int, int], map_name: str, file: Path
) -> None:
    """Write shortest-path queries on a map as a ``.scen`` file, the shortest path first.

    Args:
      problems: a row per query: ``start_row``, ``start_col``, ``goal_row`` and ``goal_col``, counted from the
        southwest, and the ``length`` of the shortest path in cell sides.
      shape: number of rows and of columns of the map.
      map_name: file name of the map.
      file: to write.
    """
    num_rows, num_cols = shape
    in_order = problems.sort_values("length", kind="stable")
    lines = pd.DataFrame(
        {
            "bucket": (in_order.length / BUCKET).astype(int),
            "map": map_name,
            "width": num_cols,
            "height": num_rows,
            "x0": in_order.start_col,
            "y0": num_rows - 1 - in_order.start_row,
            "x1": in_order.goal_col,
            "y1": num_rows - 1 - in_order.goal_row,
            "length": in_order.length.map("{:.8f}".format),
        }
    )
    write_whole(file, "version 1\n" + lines.to_csv(sep="\t", header=False, index=False))


def export_benchmark(
    maps: MetricMaps,
    instances: pd.DataFrame,
    rows: pd.DataFrame,
    folder: str | Path,
    settings: Benchmark,
    name: str,
) -> dict[str, int]:
    """Write a benchmark under ``folder`` and return how many problems it holds of each kind.

    ``movingai/NAME_20m.map`` and ``.scen``: the shortest paths, for pairs whose optimal length a distance-only A*
    proved. ``instances.parquet`` and ``.csv``: all instances with ``grid_optimum`` (the cheapest path over the grid,
    where an A* proved it), ``best_known`` and ``best_planner``, by the study's cost model.
    ``costs/NAME_20m_day.npz``: the costs c_j and the free cells. ``README.md``: the format.

    Args:
      maps: what the benchmark was made on.
      instances, rows: of a `BenchmarkResult`.
      folder: where to.
      settings: of the benchmark.
      name: of the city, for file names; letters, digits and hyphens.

    Raises:
      InputError: a name of other characters, a folder that cannot be written to, or what `check_exportable` refuses.
    """
    folder = Path(folder)
    model = CostModel.of(settings.cost_model)
    check_exportable(model, settings.constraints)
    if not name.replace("-", "").isalnum():
        raise InputError(
            f"the benchmark's name must be of letters, digits and hyphens, got {name!r}"
        )
    with Workspace.open(folder, "benchmarks.movingai", is_shared=True):
        # A grid for each altitude, a file of costs for each altitude and time, and the table of all instances.
        num_shortest = 0
        for altitude_m in sorted(instances.altitude_m.unique()):
            file = folder / "movingai" / f"{name}_{short_number(altitude_m)}m.map"
            num_shortest += _write_grid(
                maps, instances, rows, altitude_m, file, settings.constraints
            )
        for key, _ in instances.groupby(["altitude_m", "time", "time_of_day"], dropna=False):
            _write_costs(maps, folder, key, name, settings)

        # The best known cost of each instance, with its planner, and the proven optimum on the grid.
        weighted = rows[rows.cost.notna() & (rows.objective == WEIGHTED)]
        best = weighted.loc[weighted.groupby(KEY).cost.idxmin(), [*KEY, "cost", "planner"]]
        best = best.rename(columns={"cost": "best_known", "planner": "best_planner"})
        optimum = weighted[_is_optimum(weighted)].groupby(KEY).cost.min().rename("grid_optimum")
        table = instances.merge(best.merge(optimum, on=KEY, how="left"), on=KEY, how="left")
        save(folder, {"instances": table})
        counts = {
            "shortest": num_shortest,
            "weighted": len(table),
            "proven": int(table.grid_optimum.notna().sum()),
        }

        # The page that describes the format.
        cost_rule = "plus w_j c_j(Q) summed over j, Q the cell in which the step ends"
        if model.kind == "line":
            length = f"{model.reference_length_m:g} m"
            cost_rule = (
                f"plus the integral of w_j c_j along it over {length}, cut exactly at cell borders"
            )
        columns = weight_columns(weighed_metrics(instances.columns))
        page = PAGE.read_text(encoding="utf-8").format(
            name=name,
            grid=maps.grid,
            credit=plain(maps.attribution),
            counts=counts,
            model=model,
            cost_rule=cost_rule,
            weights=", ".join(map(code, columns)),
        )
        write_whole(folder / "README.md", page)
        return counts


def check_exportable(cost_model: CostModel, constraints: Constraints) -> None:
    """Raise InputError unless shortest paths are those of MovingAI's format."""
    if (cost_model.connectivity, cost_model.diagonal) != (8, "both-free"):
        raise InputError(
            "a benchmark's shortest paths have 8 neighbours and no diagonal steps past blocked cells: plan with "
            f"connectivity 8 and diagonal 'both-free', not {cost_model.connectivity} and {cost_model.diagonal!r}"
        )
    if constraints.bounds:
        raise InputError(
            "a benchmark holds one map of free cells an altitude, and bounds on maps close other cells at other times: "
            "study without --require"
        )


def _write_grid(
    maps: MetricMaps,
    instances: pd.DataFrame,
    rows: pd.DataFrame,
    altitude_m: float,
    file: Path,
    constraints: Constraints,
) -> int:
    """Write the ``.map`` and ``.scen`` of one altitude and return the number of problems.

    A problem is an instance whose shortest path on the grid a planner has proven.

    Args:
      maps: what the benchmark was made on.
      instances, rows: of a `BenchmarkResult`.
      altitude_m: of the problems.
      file: the ``.map``; the ``.scen`` lies beside it.
      constraints: that close cells.
    """
    # The instances whose shortest path is proven, with the rows and columns of their ends.
    is_proven = (rows.objective == DISTANCE) & _is_optimum(rows)
    proven = rows[is_proven & (rows.altitude_m == altitude_m)].drop_duplicates("instance")
    pairs = instances[instances.altitude_m == altitude_m].merge(
        proven[["instance", "length_m"]], on="instance"
    )
    problems = pd.DataFrame({"length": pairs.length_m / maps.grid.resolution_m})
    for end in ("start", "goal"):
        x_m = pairs[f"{end}_x_m"].to_numpy()
        y_m = pairs[f"{end}_y_m"].to_numpy()
        problems[f"{end}_row"], problems[f"{end}_col"] = maps.grid.cell_of_xy(x_m, y_m)
    write_map(constraints.is_free(maps, altitude_m), file)
    write_scenarios(problems, maps.grid.shape, file.name, file.with_name(f"{file.name}.scen"))
    return len(problems)


def _write_costs(
    maps: MetricMaps, folder: Path, key: tuple[Any, ...], name: str, settings: Benchmark
) -> None:
    """Write costs and free cells of one altitude, time and time of day as a compressed NumPy file.

    Args:
      maps: what the benchmark was made on.
      folder: of the benchmark.
      key: altitude in metres, time and time of day; NaN where the instances have none.
      name: of the benchmark, with which the file's name begins.
      settings: of the benchmark.
    """
    altitude_m = float(key[0])
    time, time_of_day = (None if pd.isna(part) else str(part) for part in key[1:])
    cost_map = settings.cost_map(maps, altitude_m, time, time_of_day)
    parts = [name, f"{short_number(altitude_m)}m"]
    if time_of_day:
        parts.append(time_of_day)
    if len(maps.times) > 1 and time is not None:
        parts.append(time.replace("-", "").replace(":", ""))
    file = folder / "costs" / f"{'_'.join(parts)}.npz"
    with whole_file(file) as scratch, scratch.open("wb") as stream:
        np.savez_compressed(
            stream,
            names=np.array(cost_map.names),
            costs=cost_map.costs,
            is_free=cost_map.is_free,
            resolution_m=cost_map.grid.resolution_m,
            x_min_m=cost_map.grid.x_min_m,
            y_min_m=cost_map.grid.y_min_m,
        )


def _is_optimum(rows: pd.DataFrame) -> pd.Series:
    """Return which rows hold a path that is proven to be the best on the grid."""
    return (rows.status == Status.OPTIMAL.value) & rows.planner.isin(GRID_PLANNERS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Export the study in a folder, and return the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.movingai", description=__doc__)
    parser.add_argument("scenario", type=Path, help="of the study")
    parser.add_argument("folder", type=Path, help="of its maps and the study")
    parser.add_argument("-o", dest="output", type=Path, required=True, help="folder of the export")
    parser.add_argument(
        "--set", dest="changes", action="append", default=[], help="as of the study"
    )
    options = parser.parse_args(arguments)
    try:
        # The study is in its folder, so that it is read, not run, unless some rows are missing.
        scenario = Scenario.from_toml(options.scenario, options.changes)
        result = study(
            MapsFolder(options.folder, scenario.region.resolution_m[0]),
            options.folder / "study",
            read_instances(options.folder / "study" / INSTANCES_FILE),
            settings=without_sampling(scenario.study),
            cost_model=CostModel(scenario.planning.rules.cost_model),
            constraints=Constraints().under(scenario.planning, scenario.vehicle),
        )
        counts = export_benchmark(
            result.maps,
            result.instances,
            result.rows,
            options.output,
            result.settings,
            options.scenario.stem,
        )
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{counts['shortest']} shortest and {counts['weighted']} weighted: {options.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
