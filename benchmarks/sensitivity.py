"""Route switches against brute force on a grid of weights, and Sobol indices of the weights.

``python -m benchmarks.sensitivity MAPS --resolution 20 --altitude 20`` takes a folder that ``jaxurban maps`` wrote.
Prints JSON. The brute force is one search for each of ``side`` x ``side`` weights: some 40,000 at 200.
"""

import argparse
import json
import sys
import time

import numpy as np
from scipy.ndimage import label
from tqdm import tqdm

from jaxurban.maps.metric_maps import open_maps
from jaxurban.metrics.weights import Weights
from jaxurban.paths.plan import cost_map
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import EXACT, find_breakpoints
from jaxurban.studies.weights.sobol import sobol_of_weights

SHARED = ("gps", "population", "risk")


def triangle_grid(side: int) -> np.ndarray:
    """Return ``[side, side, 3]`` shares that cover a triangle evenly; each row of the grid is a line in it."""
    u, v = (np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side
    root = np.sqrt(u)[:, None]
    return np.stack(np.broadcast_arrays(1 - root, root * (1 - v), root * v), axis=-1)


def compare(query: RouteQuery, weights: np.ndarray, side: int) -> dict[str, float]:
    """Return how far the triangle of `SHARED` and the lines of its grid agree with a search at every place."""
    at = [query.names.index(name) for name in SHARED]
    corners = np.tile(weights, (3, 1))
    corners[:, at] = np.eye(3) * weights[at].sum()
    begin_s = time.perf_counter()
    exact = find_breakpoints(RoutePool([query]), corners)
    exact_s = time.perf_counter() - begin_s
    shares = triangle_grid(side)
    begin_s = time.perf_counter()
    searched = RoutePool([query])
    rows = [searched.cheapest((row @ corners)[None])[0, 0] for row in tqdm(shares, file=sys.stderr)]
    brute_s = time.perf_counter() - begin_s
    features = np.array(rows)  # [side, side, K]
    asked = shares @ corners
    cost = np.sum(asked * features, axis=-1)
    off = np.abs(exact.cost_at(shares) / cost - 1)
    same = np.all(np.isclose(exact.features[exact.route_at(shares)], features, rtol=1e-9, atol=1e-9), axis=-1)
    line_off, line_same, line_plans = np.zeros_like(cost), np.zeros_like(same), 0
    for row, (ends, mine) in enumerate(zip(_line_ends(shares), features, strict=True)):
        line = find_breakpoints(RoutePool([query]), ends @ corners)
        along = _along(shares[row], ends)
        line_off[row] = np.abs(line.cost_at(along) / cost[row] - 1)
        line_same[row] = np.all(np.isclose(line.features[line.route_at(along)], mine, rtol=1e-9, atol=1e-9), axis=-1)
        line_plans += line.num_plans
    return {
        "routes": len(exact.cells),
        "searches": exact.num_plans,
        "seconds": exact_s,
        "area_of_cells_less_1": float(exact.sizes.sum() - 1),
        "brute_searches": cost.size,
        "brute_seconds": brute_s,
        "brute_routes": searched.num_routes,
        "triangle_cost_agrees": float(np.mean(off <= EXACT)),
        "triangle_worst_cost": float(off.max()),
        "triangle_same_route": float(np.mean(same)),
        "triangle_other_route_of_equal_cost": float(np.mean(~same & (off <= EXACT))),
        "line_searches": line_plans,
        "line_cost_agrees": float(np.mean(line_off <= EXACT)),
        "line_worst_cost": float(line_off.max()),
        "line_same_route": float(np.mean(line_same)),
    }


def _line_ends(shares: np.ndarray) -> np.ndarray:
    """Return ``[side, 2, 3]`` the ends, on the triangle's sides, of the line that each row of the grid lies on."""
    root = 1 - shares[:, 0, 0]
    zero = np.zeros_like(root)
    return np.stack([np.stack([1 - root, root, zero], -1), np.stack([1 - root, zero, root], -1)], axis=1)


def _along(places: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return ``[N, 2]`` the shares of a line's ends at places on it."""
    second = places[:, 2] / ends[1, 2]
    return np.stack([1 - second, second], axis=-1)


def queries_of(folder: str, resolution_m, altitude_m: float, cost_model, num: int, seed: int) -> list[RouteQuery]:
    """Return random queries of at least 1.5 km between cells that are joined."""
    unit = cost_map(open_maps(folder, resolution_m), altitude_m, cost_model=cost_model)
    parts, _ = label(unit.is_free)
    cells = np.argwhere(parts == np.bincount(parts[parts > 0]).argmax())
    rng = np.random.default_rng(seed)
    queries: list[RouteQuery] = []
    while len(queries) < num:
        start, goal = cells[rng.integers(len(cells), size=2)]
        if np.hypot(*(start - goal)) * unit.grid.resolution_m >= 1500:
            queries.append(RouteQuery(unit, tuple(map(int, start)), tuple(map(int, goal))))
    return queries


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maps")
    parser.add_argument("--resolution", type=float)
    parser.add_argument("--altitude", type=float, default=20.0)
    parser.add_argument("--cost-model", default="line")
    parser.add_argument("--side", type=int, default=200, help="of the grid of weights")
    parser.add_argument("--queries", type=int, default=1, help="compared with brute force")
    parser.add_argument("--sobol-queries", type=int, default=8, help="averaged in the Sobol indices")
    parser.add_argument("--samples", type=int, default=256, help="N of the Sobol indices")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    given = Weights().checked()
    where = (options.maps, options.resolution, options.altitude, options.cost_model)
    queries = queries_of(*where, max(options.queries, options.sobol_queries), options.seed)
    weights = np.array([float(getattr(given, name)) for name in queries[0].names])
    report: dict[str, object] = {}
    begin_s = time.perf_counter()
    pool = RoutePool(queries[: options.sobol_queries])
    found = sobol_of_weights(pool, weights, queries[0].names[1:], num_samples=options.samples, seed=options.seed)
    table = found.table.reset_index().round(4).to_dict("records")
    report["sobol"] = {"seconds": time.perf_counter() - begin_s, "plans": pool.num_plans, "table": table}
    report["switches"] = [compare(query, weights, options.side) for query in queries[: options.queries]]
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
