"""The board, a benchmark of routes that planners of any kind can enter: its bundle, and the judge of routes.

``python -m benchmarks.score BENCH --make`` makes the bundle in the folder BENCH: maps, queries, bounds, rules. ``python
-m benchmarks.score BENCH SUBMISSION -o board.csv`` scores a CSV file of routes on it. Every route is checked and its
cost computed again; the gap is to a proven lower bound. A route that fails counts as an infinite gap, and the exit code
stays 0; it is 2 where the file is no submission.
"""

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pandas as pd
import shapely

from benchmarks.common import exit_code
from jaxurban.cities.samples import sample_city
from jaxurban.cities.synthetic import demo_city
from jaxurban.errors import InputError, readable
from jaxurban.io.files import digest_of, whole_file, write_whole
from jaxurban.io.tables import read_table, records_of, write_table
from jaxurban.io.workspace import Workspace
from jaxurban.kernels.tolerances import SAME_RECORDED_COST
from jaxurban.maps.build import build_maps
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.plan import cost_map
from jaxurban.planners.any_angle import theta_star
from jaxurban.planners.astar import astar_plus
from jaxurban.planners.base import Problem
from jaxurban.planners.corners import corner_bound
from jaxurban.planners.cost import CostModel
from jaxurban.planners.exposure import within_budgets
from jaxurban.planners.refine import refine
from jaxurban.progress import Progress, reporting
from jaxurban.settings import SampleName
from jaxurban.studies.montecarlo.sampling import sample_joined

QUERIES, DEMONSTRATIONS, CHECKSUMS = "queries.csv", "demonstrations.csv", "CHECKSUMS"
TEXTS = {
    "README.md": Path(__file__).with_name("board_page.md"),
    "CITATION.cff": Path(__file__).with_name("board.cff"),
    "NOTICE.md": files("jaxurban") / "samples/NOTICE.md",
}
# Names of cities.
SAMPLED: tuple[SampleName, ...] = ("lower-manhattan", "shinjuku")
SYNTHETIC = "synthetic"
DECIMALS = 4  # of costs: what the files hold is the truth
DEMO_M = 2000.0  # side of the synthetic city
# Weights of demonstrations.
TRUTH = {"w_distance": 0.1, "w_gps": 1.0, "w_lidar": 0.3, "w_population": 2.0, "w_risk": 0.6}
ENDS = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
KEYS, CLAIMED = ["track", "query", "route"], ["cost", "cpu_s"]  # columns of a submission
LINE = ["method", "bundle", "track", "city"]  # what names a line of the board
NEAR_M = 1e-3  # of ends, and on the grid of corners, to the centres of cells
# Relative: an exposure that much above its budget keeps it.
SAME = 1e-9
VALID, MISSING = "valid", "missing"


def make_benchmark(
    folder: str | Path,
    num_queries: int = 30,
    maps: Mapping[str, MetricMaps] | None = None,
    progress: Progress = False,
) -> Path:
    """Make the bundle of the board in a folder, the same bytes each time, and return its file of queries.

    Args:
      folder: where to; what an earlier call wrote there and nobody changed is replaced.
      num_queries: of each track in each city, and demonstrations of each city.
      maps: of the cities, whose lowest altitude counts; left out, `SAMPLED` and the synthetic one, which takes
        some minutes of one core.
      progress: a bar or lines in the log, or a function of stage, done and total.

    Raises:
      InputError: the folder cannot be written to, or holds other files of these names.
    """
    # The files are claimed before the maps are made, which takes minutes.
    folder = Path(folder)
    cities = [*SAMPLED, SYNTHETIC] if maps is None else [*maps]
    names = [QUERIES, DEMONSTRATIONS, CHECKSUMS, *TEXTS, *(f"{city}.npz" for city in cities)]
    queries: list[dict[str, Any]] = []
    demonstrations = []
    with (
        Workspace.open(folder, "score --make", names=names, is_shared=True),
        reporting("score --make", progress) as report,
    ):
        maps = city_maps() if maps is None else maps
        written = []
        for seed, (city, city_map) in enumerate(maps.items()):
            # Costs are rounded before anything is planned, so that the files hold what routes were judged by.
            costs = cost_map(city_map, city_map.altitudes_m[0], cost_model="line")
            problem = costs.problem.with_costs(np.round(costs.costs, DECIMALS))
            file = folder / f"{city}.npz"
            written.append(file)

            # The same map gives the same bytes, since NumPy dates the parts of such files 1980.
            with whole_file(file) as scratch, scratch.open("wb") as stream:
                np.savez_compressed(
                    stream,
                    layers=costs.names,
                    crs=costs.grid.crs,
                    west_south_m=costs.grid.bounds_m[:2],
                    resolution_m=problem.resolution_m,
                    reference_length_m=costs.cost_model.reference_length_m,
                    costs=problem.costs,
                    is_free=problem.is_free,
                )

            # Pairs of ends, in metres from the map's southwest corner: first those of queries, then of demonstrations.
            instances = sample_joined(
                city_map,
                2 * num_queries,
                altitudes_m=city_map.altitudes_m[:1],
                cost_model="line",
                seed=seed,
            )
            instances[ENDS] -= np.tile(costs.grid.bounds_m[:2], 2)
            columns = [*ENDS, *(f"w_{name}" for name in costs.weight_names)]
            for number, instance in enumerate(records_of(instances[columns])):
                report(city, number, len(instances))
                row = {"city": city, "query": f"{city}-{number:02}"} | instance
                if number < num_queries:
                    layer = costs.names[number % len(costs.names)]  # layers take turns
                    queries += _queries_of_tracks(problem, costs.weight_names, row, layer)
                else:
                    query = problem_of(problem, costs.weight_names, row | TRUTH)
                    route = shapely.LineString(astar_plus(query).points_m)
                    demonstrations.append({"city": city, "route": route.wkt})

        # Texts, tables, and last the checksums of all files.
        for name, text in TEXTS.items():
            write_whole(folder / name, text.read_text(encoding="utf-8"))
            written.append(folder / name)
        written.append(write_table(pd.DataFrame(queries), folder / QUERIES))
        written.append(write_table(pd.DataFrame(demonstrations), folder / DEMONSTRATIONS))
        sums = "".join(f"{digest_of(file)}  {file.name}\n" for file in written)
        write_whole(folder / CHECKSUMS, sums)
    return folder / QUERIES


def city_maps() -> dict[str, MetricMaps]:
    """Return by name the maps, 20 m up and in cells of 5 m, of buildings: of `SAMPLED` and of the synthetic city."""
    cities = {name: sample_city(name, kinds=["building"]) for name in SAMPLED} | {
        SYNTHETIC: demo_city(DEMO_M, DEMO_M)
    }
    return {
        name: build_maps(city, resolution_m=5.0, altitudes_m=(20.0,))
        for name, city in cities.items()
    }


def problem_of(problem: Problem, names: Sequence[str], row: Mapping[str, Any]) -> Problem:
    """Return the planners' view of a query on its city's map.

    Args:
      problem: of the city's map, between any ends and under any weights.
      names: ``[K]`` the map's weights, ``"distance"`` first.
      row: of the query: `ENDS` in metres from the map's southwest corner, and a weight ``w_NAME`` for each name.
    """
    start_col, start_row, goal_col, goal_row = (
        int(row[end] // problem.resolution_m) for end in ENDS
    )
    weights = np.array([row[f"w_{name}"] for name in names])
    return problem.between((start_row, start_col), (goal_row, goal_col)).with_weights(weights)


def _queries_of_tracks(
    problem: Problem, names: Sequence[str], row: dict[str, Any], layer: str
) -> Iterator[dict[str, Any]]:
    """Yield a query of each track between the same ends, with a lower bound and the cost of the best route known.

    Args:
      problem, names, row: as in `problem_of`.
      layer: whose exposure the track ``budget`` bounds: halfway between the exposure of the cheapest route and the
        least exposure of any route.
    """
    # Track "grid": the planner is exact, so its cost is bound and best at once.
    query = problem_of(problem, names, row)
    cheapest = astar_plus(query)
    yield row | {"track": "grid", "bound": cheapest.cost, "best": cheapest.cost}

    # Track "any-angle": no exact planner, so bound and best differ.
    any_angle = refine(query, theta_star(query)).cost
    yield row | {"track": "any-angle", "bound": corner_bound(query), "best": any_angle}

    # Track "budget".
    column = names.index(layer)
    least_exposed = astar_plus(query.with_weights(np.eye(len(names))[column]))
    exposures = [query.features(path.points_m).phi[column] for path in (cheapest, least_exposed)]
    budget = float(np.mean(exposures))
    within = within_budgets(query, astar_plus, {layer: budget}, names[1:], budget_s=np.inf, seed=0)
    bounds = {"track": "budget", "bound": within.lower_bound, "best": within.cost}
    yield row | bounds | {"layer": layer, "budget": budget}

    # Track "weights": the exact planner under the weights that a submission has to find.
    cost = astar_plus(problem_of(problem, names, row | TRUTH)).cost
    true_weights = {name: TRUTH[name] for name in TRUTH if name in row}
    yield row | true_weights | {"track": "weights", "bound": cost, "best": cost}


def score(
    folder: str | Path, submission: str | Path, board: str | Path | None = None, method: str = ""
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the board's lines of a submission, and a row per route with its outcome.

    Costs are counted by `Problem.features` alone; a cost that the submission claims is only compared.

    Args:
      folder: of the bundle, from `make_benchmark`.
      submission: a .csv or .parquet file, a row per route: ``track``, ``query``, ``route`` (WKT LINESTRING in metres
        from the map's southwest corner); in the track ``weights`` a row per city, whose name is the ``query``, with
        weights such as ``distance=0.1,gps=1`` as ``route``. ``cost`` and ``cpu_s`` may be claimed.
      board: CSV file of the board, in which the lines replace those of the same method, bundle and track; none is
        written where it is left out.
      method: name on the board; left out, that of the file.

    Returns:
      First a line per track and city: how many routes were asked, are valid, failed and why, and claim another cost
      than they have; the median, 90 % quantile and largest ``gap``; the medians of ``over_best`` and of the claimed CPU
      seconds. Second a row per route: ``outcome``; ``cost``; ``gap``, the share by which it costs more than the bound;
      and ``over_best``, the same above the best route known (0.01: 1 % costlier). These three are inf for a route that
      is not valid. One row enters a submission in its track, of which all queries are then asked.

    Raises:
      InputError: a bundle that was changed; a file that is no table, lacks a column, holds no row, answers what is not
        asked, or a query twice; invalid weights; a folder that holds no board, or was changed.
    """
    # The submission.
    folder = Path(folder)
    method = method or Path(submission).stem
    table = read_table(submission, "submission")
    for name in KEYS:
        if name not in table:
            raise InputError(
                f"{str(submission)!r} has no column {name!r}: a submission has {', '.join(KEYS)}"
            )

    # The bundle's checksums, by file name, and its queries, which must be as it was made. In the track "weights" a
    # submission names a city instead of a query.
    sums = folder / CHECKSUMS
    with readable(
        sums, "checksums of a benchmark", f"make one by python -m benchmarks.score {folder} --make"
    ):
        listed = [line.split("  ") for line in sums.read_text().splitlines()]
        digests = {name: digest for digest, name in listed}
    _check_files(folder, [QUERIES, *digests], digests)
    queries = read_table(folder / QUERIES, "queries")
    is_weights = queries["track"] == "weights"
    queries["row"] = queries["city"].where(is_weights, queries["query"])
    _check_answers(submission, table, queries)

    # Every query of the tracks that are entered, beside its answer if there is one.
    table = table.reindex(columns=[*KEYS, *CLAIMED]).rename(columns={"query": "row"})
    queries = queries[queries["track"].isin(table["track"])]
    routes = queries.merge(table, "left", ["track", "row"], indicator="outcome")

    # The outcome and the cost of each route, judged on its city's map, beside what the submission claims.
    cities = {city: f"{city}.npz" for city in routes["city"].unique()}
    _check_files(folder, cities.values(), digests)
    city_problems = {city: unpacked(folder / name) for city, name in cities.items()}
    claims = {f"claimed_{name}": _claims(submission, routes[name]) for name in CLAIMED}
    verdicts = [_judged(*city_problems[row["city"]], row) for row in records_of(routes)]
    routes[["outcome", "cost"]] = pd.DataFrame(verdicts, routes.index)
    routes["gap"] = routes["cost"] / routes["bound"] - 1
    routes["over_best"] = routes["cost"] / routes["best"] - 1
    routes = routes.assign(**claims)

    # A line for each track and city; the bundle is named by the beginning of a hash of its checksums.
    bundle = digest_of(sums)[:12]
    lines = pd.DataFrame(
        {"method": method, "bundle": bundle, "track": track, "city": city} | _summary(part)
        for (track, city), part in routes.groupby(["track", "city"], sort=False)
    )
    if board is not None:
        # They replace lines of the same method, bundle, track and city.
        board = Path(board)
        with Workspace.open(board.parent, "score", names=[board.name], is_shared=True):
            table = lines.set_index(LINE)
            if board.exists():
                former = read_table(board, "board").set_index(LINE)
                table = pd.concat([former.drop(table.index, errors="ignore"), table])
            write_table(table.sort_index().reset_index(), board)
    return lines, routes[["track", "query", "city", "outcome", "cost", "gap", "over_best", *claims]]


def _check_answers(submission: str | Path, table: pd.DataFrame, queries: pd.DataFrame) -> None:
    """Raise InputError where a submission has no row, a row for a query that is not asked, or two for one query.

    Args:
      submission: its file, for the message.
      table: the submission's rows, with ``track`` and ``query``.
      queries: the bundle's, with ``track`` and ``row``, the name that the ``query`` of a submission must have.
    """
    # Pairs of a track and a query: those that are answered, and those that are asked.
    answers = pd.MultiIndex.from_frame(table[["track", "query"]])
    asked = pd.MultiIndex.from_frame(queries[["track", "row"]])
    wrong = answers[~answers.isin(asked) | answers.duplicated()]
    fault = ""
    if table.empty:
        fault = "is empty"
    elif len(wrong):
        track, query = wrong[0]
        fault = f"answers {track} {query}, not asked or twice"
    if fault:
        raise InputError(
            f"{str(submission)!r} {fault}: write one row for each query of a track in {QUERIES}"
        )


def _claims(submission: str | Path, claimed: pd.Series) -> pd.Series:
    """Return the numbers that a submission claims in a column, NaN where it claims none.

    Args:
      submission: its file, for the message.
      claimed: the column, as numbers or texts; missing where the submission claims nothing.

    Raises:
      InputError: a claim that is no number.
    """
    numbers = pd.to_numeric(claimed, errors="coerce")
    texts = claimed[claimed.notna() & numbers.isna()]  # what is there but is no number
    if len(texts):
        raise InputError(
            f"{str(submission)!r} claims the {claimed.name} {texts.iloc[0]!r}: give a number, or leave it out"
        )
    return numbers


def _check_files(folder: Path, names: Iterable[str], digests: Mapping[str, str]) -> None:
    """Raise InputError unless files of a bundle are there and have the digests that its checksums list.

    Args:
      folder: of the bundle.
      names: of the files that are needed; a name that the checksums do not list, or that is a path, is refused too.
      digests: by name of file, as read from `CHECKSUMS`.
    """
    for name in names:
        file = folder / name
        is_listed = name in digests and Path(name).name == name
        if not is_listed or not file.is_file() or digest_of(file) != digests[name]:
            raise InputError(
                f"{str(file)!r} is missing or not as {CHECKSUMS} has it: make it again"
            )


def unpacked(file: Path) -> tuple[Problem, list[str]]:
    """Return a city's map as a problem of planners, and the names ``[K]`` of its weights, ``"distance"`` first.

    The problem still lacks a query (see `problem_of`): it starts and ends in the first free cell, under weights 1.

    Raises:
      InputError: the file cannot be read, or is no city's map.
    """
    faults = KeyError, IndexError, TypeError, BadZipFile
    with (
        readable(file, "a city's map", "make the benchmark again", *faults),
        np.load(file) as city,
    ):
        first_free = tuple(np.argwhere(city["is_free"])[0].tolist())
        problem = Problem(
            city["costs"],
            city["is_free"],
            start=first_free,
            goal=first_free,
            resolution_m=float(city["resolution_m"]),
            weights=1.0,
            cost_model=CostModel("line", reference_length_m=float(city["reference_length_m"])),
        )
        return problem, ["distance", *city["layers"].tolist()]


def _judged(problem: Problem, names: list[str], row: Mapping[str, Any]) -> tuple[str, float]:
    """Return the outcome of a query and the cost of its route.

    The outcome is `VALID`, `MISSING`, or a few words on the first fault of the route; with a fault the cost is inf.

    Args:
      problem: the city's map, without a query (`unpacked`).
      names: ``[K]`` the map's weights.
      row: the query; the ``route`` that answers it, a text; and ``outcome``, the indicator of `DataFrame.merge`, which
        is ``"left_only"`` where nothing answers it.

    Raises:
      InputError: invalid weights, in the track ``weights``.
    """
    if row["outcome"] == "left_only":
        return MISSING, np.inf
    problem = problem_of(problem, names, row)

    # Submitted weights are judged by the true cost of the route that is the cheapest under them.
    if row["track"] == "weights":
        no_weights = Weights(**dict.fromkeys(names, 0.0))
        weights = Weights.parse(str(row["route"]), no_weights).checked(names)
        route = astar_plus(problem.with_weights(weights.vector(names)))
        return VALID, problem.cost_of(route.points_m)

    # Whether the route is a line: its points [N, 2] are in metres from the map's southwest corner.
    side_m = problem.resolution_m
    ends_m = np.array([row[end] for end in ENDS]).reshape(2, 2)
    with np.errstate(invalid="ignore"):  # a route may hold NaN
        line = shapely.from_wkt(str(row["route"]), on_invalid="ignore")
    points_m = shapely.get_coordinates(line)
    is_line = isinstance(line, shapely.LineString) and len(points_m)
    if not is_line or not np.isfinite(points_m).all():
        return "no line", np.inf

    # Whether it joins the ends of the query and stays on the map.
    if np.abs(points_m[[0, -1]] - ends_m).max() > NEAR_M:
        return "wrong ends", np.inf
    points_m[[0, -1]] = ends_m
    size_m = np.array(problem.is_free.shape[::-1]) * side_m
    if (points_m < 0).any() or (points_m > size_m).any():
        return "leaves the map", np.inf

    # In all tracks but "any-angle" a line runs straight or diagonally from centre to centre of cells. Its points are
    # moved to the very centres, which undoes their rounding.
    if row["track"] != "any-angle":
        cells = points_m // side_m
        centres_m = (cells + 0.5) * side_m
        legs = np.abs(np.diff(cells, axis=0))
        is_straight = (legs.min(axis=1) == 0) | (legs[:, 0] == legs[:, 1])
        if np.abs(points_m - centres_m).max() > NEAR_M or not is_straight.all():
            return "off the grid", np.inf
        points_m = centres_m

        # The margin keeps diagonals from passing between two closed cells that touch at a corner.
        problem = replace(problem, leg_margin_m=NEAR_M * side_m)

    # Whether it keeps free cells and its budget, and what it costs, as the planners themselves count it.
    sums = problem.features(points_m)
    if not sums.is_valid:
        return "not free", sums.cost(problem.weights)
    if row["track"] == "budget":
        exposure = sums.phi[names.index(row["layer"])]
        if exposure > row["budget"] * (1 + SAME):
            return "over budget", np.inf
    return VALID, sums.cost(problem.weights)


def _summary(routes: pd.DataFrame) -> dict[str, Any]:
    """Return a line of the board for the routes of a track in a city, but for its `LINE`.

    The counts are of routes; ``failed`` counts them by outcome, in a text. Quantiles of the gaps are values of single
    routes, the higher of two, and inf where the route is not valid. ``cpu_s_median`` is NaN where none is claimed.

    Args:
      routes: a row per query, as `score` returns them.
    """
    is_valid = routes["outcome"] == VALID
    failed = routes.loc[~is_valid, "outcome"].value_counts()
    gap = routes["gap"]
    claims = routes["claimed_cost"]
    is_true = np.isclose(claims, routes["cost"], rtol=SAME_RECORDED_COST, atol=0)
    return {
        "asked": len(routes),
        "valid": is_valid.sum(),
        "failed": "; ".join(f"{count} {reason}" for reason, count in failed.items()),
        "false_claims": (is_valid & claims.notna() & ~is_true).sum(),
        "gap_median": gap.quantile(0.5, "higher"),
        "gap_90": gap.quantile(0.9, "higher"),
        "gap_worst": gap.quantile(1.0, "higher"),
        "over_best_median": routes["over_best"].quantile(0.5, "higher"),
        "cpu_s_median": routes["claimed_cpu_s"].quantile(0.5),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the bundle, or score a submission on it, and return the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.score", description=__doc__)
    parser.add_argument("bench", type=Path, metavar="BENCH", help="folder of the benchmark")
    parser.add_argument("submission", type=Path, nargs="?", help="CSV file of routes")
    parser.add_argument("--make", action="store_true", help="make the benchmark in BENCH")
    parser.add_argument("-o", dest="board", type=Path, help="CSV file of the board")
    parser.add_argument("--method", default="", help="name on the board; left out: the file's name")
    options = parser.parse_args(arguments)
    if options.make == (options.submission is not None):
        parser.error("give either a submission, a file of routes, or --make")

    def answer() -> None:
        """Print where the benchmark is, or the line of the submission."""
        if options.make:
            print(f"the queries are in {make_benchmark(options.bench, progress=True)}")
        else:
            lines, _ = score(options.bench, options.submission, options.board, options.method)
            print(lines.drop(columns=["bundle"]).to_string(index=False, na_rep=""))

    return exit_code(answer)


if __name__ == "__main__":
    sys.exit(main())
