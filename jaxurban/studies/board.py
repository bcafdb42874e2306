"""The board, a benchmark of routes that planners of any kind can enter: its bundle, and the judge of routes."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.errors import InputError, readable, typed
from jaxurban.io.files import digest_of
from jaxurban.io.tables import read_table, records_of, write_table
from jaxurban.io.workspace import Workspace
from jaxurban.maps.build import build_maps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.cost_map import CostMap
from jaxurban.paths.plan import cost_map
from jaxurban.planners.any_angle import refine, theta_star
from jaxurban.planners.astar import astar_plus
from jaxurban.planners.base import Problem
from jaxurban.planners.cost import CostModel
from jaxurban.progress import Progress, reporting
from jaxurban.report.write import save
from jaxurban.samples.catalogue import SAMPLES
from jaxurban.samples.cities import sample_city
from jaxurban.world.synthetic import demo_city

QUERIES, DEMONSTRATIONS, CHECKSUMS = "queries.csv", "demonstrations.csv", "CHECKSUMS"
TEXTS = {"README.md": "report/templates/board.md", "CITATION.cff": "report/templates/board.cff"}
TEXTS |= {"NOTICE.md": "samples/NOTICE.md"}
ALTITUDE_M, RESOLUTION_M, DEMO_M = 20.0, 5.0, 2000.0
DECIMALS = 4  # of costs: what the files hold is the truth
LEAST_SHARE = 0.4  # of the map's shorter side, between the ends of a query
DISTANCES = (0.1, 0.02, 0.5)  # weights of the distance, by turns; every layer weighs 1
TRUTH = (0.1, 1.0, 0.3, 2.0, 0.6)  # weights of the demonstrations: of the distance, then of the layers
ENDS = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
ASKED, CLAIMED = ["track", "query", "route"], ["cost", "cpu_s"]
LINE = ["method", "bundle", "track", "city"]  # what names a line of the board
NEAR_M = 1e-3  # of ends, and on the grid of corners, to the centres of cells
VALID, MISSING = "valid", "missing"
STRETCH = 2 / np.sqrt(2 + np.sqrt(2))  # of the cheapest path along sides and diagonals of cells over the cheapest curve


@typed
def make_benchmark(
    folder: str | Path, num_queries: int = 30, maps: Mapping[str, CostMap] | None = None, progress: Progress = False
) -> Path:
    """Make the bundle of the board in a folder, the same bytes each time, and return its file of queries.

    Args:
      folder: where to; what an earlier call wrote there and nobody changed is replaced.
      num_queries: of each track in each city, and demonstrations of each city.
      maps: cost maps by city under the ``line`` model; left out, the two cities of the package and the synthetic one,
        which takes some minutes of one core.
      progress: a bar or lines in the log, or a function of stage, done and total.

    Raises:
      InputError: the folder cannot be written to, or holds other files of these names.

    Example:
      >>> import tempfile
      >>> import jaxurban as ju
      >>> maps = ju.build_maps(ju.demo_city(400, 400), resolution_m=20.0, altitudes_m=(20.0,))
      >>> queries = ju.studies.make_benchmark(tempfile.mkdtemp(), 2, {"synthetic": ju.cost_map(maps, 20.0)})
      >>> len(queries.read_text().splitlines())
      7
    """
    folder, outputs, queries, shown = Path(folder), dict[str, Any](), list[dict[str, Any]](), list[dict[str, Any]]()
    with reporting("score --make", progress) as report:
        for seed, (city, on) in enumerate((_cities() if maps is None else maps).items()):
            problem, names = on.problem.with_costs(np.round(on.costs, DECIMALS)), ("distance", *on.names)
            side_m, length_m = problem.resolution_m, problem.cost_model.reference_length_m
            facts: dict[str, Any] = {"layers": on.names, "crs": on.grid.crs, "west_south_m": on.grid.bounds_m[:2]}
            facts |= {"costs": problem.costs, "is_free": problem.is_free}
            outputs[f"{city}.npz"] = partial(_pack, facts | {"resolution_m": side_m, "reference_length_m": length_m})
            for turn, (start, goal) in enumerate(_drawn(problem.islands, 2 * num_queries, seed)):
                report(city, turn, 2 * num_queries)
                asked = problem.between(tuple(start), tuple(goal))
                route = astar_plus(asked.with_weights(np.array(TRUTH[: len(names)])))
                if turn >= num_queries:
                    shown.append({"city": city, "route": shapely.LineString(route.points_m).wkt})
                    continue
                weights = np.array([DISTANCES[turn % len(DISTANCES)], *np.ones(len(on.names))])
                weighed = asked.with_weights(weights)
                grid, any_angle = astar_plus(weighed).cost, refine(weighed, theta_star(weighed)).cost
                of_track = {"grid": (weights, grid, grid), "any-angle": (weights, corner_bound(weighed), any_angle)}
                of_track["weights"] = (np.array(TRUTH), route.cost, route.cost)
                for track, (under, bound, best) in of_track.items():
                    row = {"track": track, "query": f"{city}-{turn:02}", "city": city}
                    row |= dict(zip(ENDS, route.points_m[[0, -1]].ravel(), strict=True))
                    row |= {f"w_{name}": weight for name, weight in zip(names, under, strict=False)}
                    queries.append(row | {"bound": bound, "best": best})
    outputs |= {name: (files("jaxurban") / text).read_text(encoding="utf-8") for name, text in TEXTS.items()}
    outputs |= {QUERIES: pd.DataFrame(queries), DEMONSTRATIONS: pd.DataFrame(shown)}
    with Workspace.open(folder, "score --make", names=[*outputs, CHECKSUMS], is_shared=True):
        sums = "".join(f"{digest_of(file)}  {file.name}\n" for file in save(folder, outputs))
        save(folder, {CHECKSUMS: sums})
    return folder / QUERIES


def _cities() -> dict[str, CostMap]:
    """Return the cost maps of the cities in the package and of the synthetic one, by day."""
    cities = {name: sample_city(name) for name in SAMPLES} | {"synthetic": demo_city(DEMO_M, DEMO_M)}
    made = {
        name: build_maps(each, resolution_m=RESOLUTION_M, altitudes_m=[ALTITUDE_M]) for name, each in cities.items()
    }
    return {name: cost_map(maps, ALTITUDE_M, cost_model="line") for name, maps in made.items()}


def _pack(arrays: Mapping[str, Any], file: Path) -> None:
    """Write a compressed .npz, whose entries NumPy dates 1980: the same arrays give the same bytes."""
    with file.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def _drawn(islands: np.ndarray, num: int, seed: int) -> list[list[list[int]]]:
    """Return pairs of cells of the largest part that paths join, at least `LEAST_SHARE` from each other."""
    cells = np.argwhere(islands == 1 + np.argmax(np.bincount(islands.ravel())[1:]))
    pairs = cells[np.random.default_rng(seed).integers(len(cells), size=(20 * num, 2))]
    is_far = np.hypot(*(pairs[:, 1] - pairs[:, 0]).T) >= LEAST_SHARE * min(islands.shape)
    return pairs[is_far][:num].tolist()


def corner_bound(problem: Problem) -> float:
    """Return a lower bound of the cost of any curve between a problem's ends under the ``line`` model.

    A path along sides (at the cheaper of their two cells) and diagonals of free cells costs at most `STRETCH` times the
    cheapest curve (Bose, Esteban, Orden & Silveira 2024, square meshes). So the costs of such paths, over `STRETCH`,
    can be continued into each cell with a slope of at most its cost, from the four corners of the start's cell to those
    of the goal's; half a side at either end is added. Passing between two closed cells at a corner counts as allowed.

    Args:
      problem: on one altitude, its ends in two cells.

    Returns:
      The bound; inf where no such path joins the ends.
    """
    per_side = problem.resolution_m * (problem.distance_weight + problem.cost / problem.cost_model.reference_length_m)
    per_side = np.pad(np.where(problem.is_free, per_side, np.inf), 1, constant_values=np.inf)
    corner = np.arange((per_side.shape[0] - 1) * (per_side.shape[1] - 1)).reshape(np.array(per_side.shape) - 1)
    inner = per_side[1:-1, 1:-1]
    arcs = [
        (corner[:, :-1], corner[:, 1:], np.minimum(per_side[:-1, 1:-1], per_side[1:, 1:-1])),
        (corner[:-1], corner[1:], np.minimum(per_side[1:-1, :-1], per_side[1:-1, 1:])),
        (corner[:-1, :-1], corner[1:, 1:], np.sqrt(2) * inner),
        (corner[:-1, 1:], corner[1:, :-1], np.sqrt(2) * inner),
    ]
    begin, end, cost = (np.concatenate([part.ravel() for part in parts]) for parts in zip(*arcs, strict=True))
    kept = np.isfinite(cost)
    graph = coo_array((cost[kept], (begin[kept], end[kept])), shape=(corner.size, corner.size)).tocsr()
    start, goal = (corner[row : row + 2, col : col + 2].ravel() for row, col in (problem.start, problem.goal))
    between = dijkstra(graph, directed=False, indices=start, min_only=True)[goal].min()
    return float(between / STRETCH + (inner[problem.start] + inner[problem.goal]) / 2)


@typed
def score(
    folder: str | Path, submission: str | Path, board: str | Path | None = None, method: str = ""
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the board's lines of a submission, and what each route is worth; no cost but `Problem.features`' counts.

    Args:
      folder: of the bundle, from `make_benchmark`.
      submission: a .csv or .parquet file, a row a route: ``track``, ``query``, ``route`` (WKT LINESTRING in metres from
        the map's southwest corner); in the track ``weights`` a row a city, whose name is the ``query``, with weights
        such as ``distance=0.1,gps=1`` as ``route``. ``cost`` and ``cpu_s`` may be claimed.
      board: CSV file of the board, in which the lines replace those of the same method and bundle; none is written
        where it is left out.
      method: name on the board; left out, that of the file.

    Returns:
      A line a track and city: how many routes were asked, are valid, missing and refused and why, the median, 90 % and
      largest ``gap``, the median of ``over_best`` and of the CPU seconds claimed. And a row a route: ``outcome``,
      ``cost``, ``gap`` to the bound and ``over_best``, the best route known (0.01: 1 % costlier; inf of a route that
      is not valid). A track is entered by one row of it; then all its queries are asked, and what fails counts as inf.

    Raises:
      InputError: a bundle that was changed; a file that is no table, lacks a column, holds no row, answers what is not
        asked, or a query twice; weights that are none; a board that is none, or was changed.
    """
    folder, table, method = Path(folder), read_table(submission, "submission"), method or Path(submission).stem
    if lacking := [name for name in ASKED if name not in table]:
        raise InputError(f"{str(submission)!r} has no column {lacking[0]!r}: a submission has {', '.join(ASKED)}")
    sums = folder / CHECKSUMS
    with readable(sums, "checksums of a benchmark", f"make one by jaxurban score {folder} --make"):
        for digest, name in (line.split("  ") for line in sums.read_text().splitlines()):
            if not (folder / name).is_file() or digest_of(folder / name) != digest:
                raise InputError(f"{str(folder / name)!r} is missing or not as {CHECKSUMS} has it: make it again")
    asked = read_table(folder / QUERIES, "queries")
    asked["row"] = asked["city"].where(asked["track"] == "weights", asked["query"])  # of a submission
    given = table.set_index(["track", "query"]).index
    wrong = ~given.isin(asked.set_index(["track", "row"]).index) | given.duplicated()
    if table.empty or wrong.any():
        what = (
            f"answers {' '.join(map(str, given[wrong][0]))}, twice or not in {QUERIES}" if wrong.any() else "is empty"
        )
        raise InputError(f"{str(submission)!r} {what}: write one row for each query of a track")
    table = table.reindex(columns=[*ASKED, *CLAIMED]).rename(columns={"query": "row"})
    routes = asked[asked["track"].isin(table["track"])].merge(table, "left", ["track", "row"], indicator="outcome")
    cities = {city: _unpacked(folder / f"{city}.npz") for city in {*routes["city"]}}
    verdicts = [_judged(*cities[row["city"]], row) for row in records_of(routes)]
    claims = {f"claimed_{name}": pd.to_numeric(routes[name], errors="coerce") for name in CLAIMED}
    routes[["outcome", "cost"]] = verdicts
    routes = routes.assign(
        gap=routes["cost"] / routes["bound"] - 1, over_best=routes["cost"] / routes["best"] - 1, **claims
    )
    lines = pd.DataFrame(
        [
            dict(zip(LINE, (method, digest_of(sums)[:12], *of), strict=True)) | _summary(each)
            for of, each in routes.groupby(["track", "city"], sort=False)
        ]
    )
    if board is not None:
        _enter(lines, Path(board))
    return lines, routes[["track", "query", "city", "outcome", "cost", "gap", "over_best", *claims]]


def _unpacked(file: Path) -> tuple[Problem, list[str]]:
    """Return a city's map, from its first free cell to itself, and its weights' names."""
    with np.load(file) as city:
        free = tuple(np.argwhere(city["is_free"])[0].tolist())
        model = CostModel("line", reference_length_m=float(city["reference_length_m"]))
        problem = Problem(city["costs"], city["is_free"], free, free, float(city["resolution_m"]), 1.0, model)
        return problem, ["distance", *city["layers"].tolist()]


def _judged(problem: Problem, names: list[str], row: Mapping[str, Any]) -> tuple[str, float]:
    """Return the outcome of a query, and the cost of its route, inf where that is not valid."""
    if row["outcome"] == "left_only":
        return MISSING, np.inf
    side_m, ends_m = problem.resolution_m, np.reshape([row[end] for end in ENDS], (2, 2))
    start, goal = (ends_m[:, ::-1] // side_m).astype(int).tolist()
    problem = problem.between(tuple(start), tuple(goal)).with_weights(np.array([row[f"w_{name}"] for name in names]))
    if row["track"] == "weights":
        weights = Weights.parse(str(row["route"]), Weights(**dict.fromkeys(names, 0.0))).vector(names)
        return VALID, problem.cost_of(astar_plus(problem.with_weights(weights)).points_m)
    with np.errstate(invalid="ignore"):  # of NaN
        line = shapely.from_wkt(str(row["route"]), on_invalid="ignore")
    points_m = shapely.get_coordinates(line)
    if not isinstance(line, shapely.LineString) or not len(points_m) or not np.isfinite(points_m).all():
        return "no line", np.inf
    if np.abs(points_m[[0, -1]] - ends_m).max() > NEAR_M:
        return "wrong ends", np.inf
    points_m[[0, -1]] = ends_m
    if row["track"] != "any-angle":
        cells = points_m // side_m
        centres_m, legs = (cells + 0.5) * side_m, np.abs(np.diff(cells, axis=0))
        is_straight = (legs.min(axis=1) == 0) | (legs[:, 0] == legs[:, 1])
        if np.abs(points_m - centres_m).max() > NEAR_M or not is_straight.all():
            return "off the grid", np.inf
        points_m, problem = centres_m, replace(problem, leg_margin_m=NEAR_M * side_m)  # keeps diagonals from corners
    cost = problem.cost_of(points_m)
    return VALID if np.isfinite(cost) else "not free", cost


def _summary(routes: pd.DataFrame) -> dict[str, Any]:
    """Return the counts and gaps of a track in a city; each quantile is a route's own value."""
    num, gap = routes["outcome"].value_counts(), routes["gap"]
    refused = num.drop([VALID, MISSING], errors="ignore")
    counts = {
        "asked": len(routes),
        "valid": num.get(VALID, 0),
        "missing": num.get(MISSING, 0),
        "refused": refused.sum(),
    }
    return counts | {
        "reasons": "; ".join(f"{count} {reason}" for reason, count in refused.items()),
        **{f"gap_{name}": gap.quantile(q, "higher") for name, q in (("median", 0.5), ("90", 0.9), ("worst", 1.0))},
        "over_best_median": routes["over_best"].quantile(0.5, "higher"),
        "cpu_s_median": routes["claimed_cpu_s"].median(),
    }


def _enter(lines: pd.DataFrame, file: Path) -> None:
    """Write lines into a board, in place of those of the same method and bundle."""
    with Workspace.open(file.parent, "score", names=[file.name], is_shared=True):
        if file.exists():
            board = read_table(file, "board")
            is_other = (board["method"] != lines["method"][0]) | (board["bundle"] != lines["bundle"][0])
            lines = pd.concat([board.loc[is_other], lines])
        write_table(lines.sort_values(LINE), file)
