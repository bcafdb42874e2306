"""What landmarks and anytime A* save on random queries, at the default weights and over random ones.

``python -m benchmarks.landmarks MAPS --altitude 20`` takes a folder that ``jaxurban maps`` wrote; without
one, a synthetic city of blocks and streets is used. Prints Markdown tables.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from benchmarks.printed_heuristic import made_up_problem, problem_of_maps, random_pairs
from jaxurban.planners.anytime import astar_anytime, first_inflation
from jaxurban.planners.astar import astar
from jaxurban.planners.base import Cell, Path, Problem
from jaxurban.planners.landmarks import make_landmarks

LEAST_WEIGHT = 0.01  # of the random weights, which sum to 1
ROUNDING = 1e-9


@dataclass(frozen=True)
class Query:
    """One query by every search."""

    octile: Path
    plus: Path
    landmarks: Path
    one_off: Path  # anytime on `plus`
    anytime: Path  # anytime on landmarks


def run_query(problem: Problem, pair: tuple[Cell, Cell]) -> Query:
    """Return a query's paths, each search checked against the plain one."""
    query = problem.between(*pair)
    exact = [astar(query, heuristic=name) for name in ("octile", "plus", "landmarks")]
    found = Query(*exact, *(astar_anytime(query, heuristic=name) for name in ("plus", "landmarks")))
    best = found.octile.cost
    for path in (found.plus, found.landmarks, found.one_off, found.anytime):
        assert abs(path.cost / best - 1) < ROUNDING
        assert path.gap == 0
        assert all(bound <= best * (1 + ROUNDING) for bound in path.bounds)
        assert list(path.bounds) == sorted(path.bounds)
    return found


def random_weights(num: int, seed: int) -> np.ndarray:
    """Return ``[num, 5]`` weights (distance a metre, then the layers a step), Dirichlet above a floor."""
    return LEAST_WEIGHT + (1 - 5 * LEAST_WEIGHT) * np.random.default_rng(seed).dirichlet(np.ones(5), num)


def share(queries: list[Query], name: str, is_first: bool = False) -> np.ndarray:
    """Return ``[Q]`` expansions over octile's, of the whole search or until its first path."""
    paths = [getattr(query, name) for query in queries]
    num = [path.history[0][1] if is_first else path.num_expanded for path in paths]
    return np.array(num) / [query.octile.num_expanded for query in queries]


def first_gaps(queries: list[Query], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return ``[Q]`` the true and the certified gap of the first path."""
    paths = [getattr(query, name) for query in queries]
    costs = np.array([path.history[0][2] for path in paths])
    return costs / [query.octile.cost for query in queries] - 1, costs / [path.bounds[0] for path in paths] - 1


def percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def default_tables(queries: list[Query]) -> Iterator[str]:
    """Yield the tables at the default weights."""
    octile = np.array([query.octile.num_expanded for query in queries])
    yield "| search | expansions over octile's: mean of ratios | ratio of means | largest ratio | costlier paths |"
    yield "|---|---|---|---|---|"
    for name in ("plus", "landmarks", "one_off", "anytime"):
        ratios = share(queries, name)
        num_costlier = sum(getattr(q, name).cost > q.octile.cost * (1 + ROUNDING) for q in queries)
        of_means = np.mean(ratios * octile) / octile.mean()
        yield f"| {name} | {percent(ratios.mean())} | {percent(of_means)} | {percent(ratios.max())} | {num_costlier} |"
    for name in ("one_off", "anytime"):
        paths = [getattr(query, name) for query in queries]
        yield f"\n| {name}: round | expansions so far over octile's | true gap, mean (largest) | certified gap, mean |"
        yield "|---|---|---|---|"
        for k in range(max(len(path.history) for path in paths)):
            # A search that has ended stays where it is.
            num = np.array([path.history[min(k, len(path.history) - 1)][1] for path in paths])
            cost = np.array([path.history[min(k, len(path.history) - 1)][2] for path in paths])
            bound = np.array([path.bounds[min(k, len(path.bounds) - 1)] for path in paths])
            true = np.maximum(cost / [query.octile.cost for query in queries] - 1, 0)
            yield (
                f"| {k + 1} | {percent((num / octile).mean())} | {100 * true.mean():.2f} % ({percent(true.max())}) "
                f"| {100 * (cost / bound - 1).mean():.2f} % |"
            )


def weights_table(problem: Problem, pairs: list[tuple[Cell, Cell]], num: int, seed: int) -> str:
    """Return the table over random weights."""
    lines = [
        "| distance a metre, gps, lidar, population, risk | landmarks | anytime, landmarks: first path "
        "| mean excess | certified | anytime, one-off: inflation | first path | mean excess | certified |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    columns = []
    for weights in tqdm(random_weights(num, seed), desc="weights", file=sys.stderr):
        other = problem.with_weights(weights)
        queries = [run_query(other, pair) for pair in pairs]
        values = [share(queries, "landmarks").mean()]
        for name in ("anytime", "one_off"):
            values += [share(queries, name, True).mean(), *(gaps.mean() for gaps in first_gaps(queries, name))]
        columns.append(values)
        cells = [percent(value) for value in values]
        cells.insert(4, f"{first_inflation('plus', other):.2f}")
        lines.append(f"| {', '.join(f'{w:.2f}' for w in weights)} | {' | '.join(cells)} |")
    for label, values in (("mean", np.mean(columns, axis=0)), ("largest", np.max(columns, axis=0))):
        cells = [f"**{percent(value)}**" for value in values]
        cells.insert(4, "")
        lines.append(f"| **{label}** | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Run the study that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps", nargs="?", help="folder of maps; left out: a synthetic city")
    parser.add_argument("--resolution", type=float, help="metres, where the folder holds several")
    parser.add_argument("--altitude", type=float, default=20.0, help="metres")
    parser.add_argument("--time-of-day", help="day or night")
    parser.add_argument("--cost-model", choices=["cell", "line"], default="cell")
    parser.add_argument("--queries", type=int, default=200)
    parser.add_argument("--weights", type=int, default=20, help="random weight vectors")
    parser.add_argument("--weights-queries", type=int, default=100, help="queries with each of them")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.maps is None:
        problem = made_up_problem(options.cost_model, options.seed)
    else:
        problem = problem_of_maps(
            options.maps, options.resolution, options.altitude, options.time_of_day, options.cost_model
        )
    size = " x ".join(map(str, problem.is_free.shape))
    pairs = random_pairs(problem, options.queries, options.seed)
    print(f"{size} cells, {len(pairs)} queries, seed {options.seed}, cost model {options.cost_model}\n")
    run_query(problem.between(*pairs[0]), pairs[0])  # compiles
    built = make_landmarks(problem)
    queries = [run_query(problem, pair) for pair in tqdm(pairs, desc="queries", file=sys.stderr)]
    print("\n".join(default_tables(queries)))
    seconds = {name: np.mean([getattr(q, name).elapsed_s for q in queries]) for name in ("octile", "plus", "landmarks")}
    saved_s = seconds["plus"] - seconds["landmarks"]
    print(f"\nInflation of the one-off search: {first_inflation('plus', problem):.2f}.")
    print(f"{len(built.cells)} landmarks: {built.elapsed_s:.2f} s, {built.costs.nbytes / 1e6:.0f} MB.")
    print("Seconds a query: " + ", ".join(f"{name} {value:.4f}" for name, value in seconds.items()) + ".")
    print(f"Building costs what {built.elapsed_s / saved_s:.0f} queries with landmarks save over plus.\n")
    if options.weights:
        print(weights_table(problem, pairs[: options.weights_queries], options.weights, options.seed))


if __name__ == "__main__":
    main()
