"""Breakpoints along lines and over triangles of weights, against SciPy's Dijkstra at every place of a grid."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.paths.plan import cost_map
from jaxurban.planners.cost import STEPS
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import find_breakpoints, nearest_breakpoints, pareto_front
from tests.made_maps import made_maps

GIVEN = np.array([0.1, 1.0, 1.0, 1.0, 1.0])
SIDE = 12


@pytest.fixture(scope="module")
def query() -> RouteQuery:
    unit = cost_map(made_maps(30, 36), 20.0, cost_model="line")
    return RouteQuery(unit, (4, 1), (28, 34))


def dijkstra_cost(query: RouteQuery, weights: np.ndarray) -> float:
    """Return the cheapest cost by SciPy, over edges that are made here."""
    unit, (num_rows, num_cols) = query.cost_map, query.cost_map.is_free.shape
    cell_cost = np.tensordot(weights[1:], unit.costs, 1)
    tails, heads, costs = [], [], []
    row, col = np.nonzero(unit.is_free)
    for rows, cols in STEPS:
        to_row, to_col = row + rows, col + cols
        on_map = (to_row >= 0) & (to_row < num_rows) & (to_col >= 0) & (to_col < num_cols)
        r, c, a, b = row[on_map], col[on_map], to_row[on_map], to_col[on_map]
        is_free = unit.is_free[a, b] & unit.is_free[a, c] & unit.is_free[r, b]
        r, c, a, b = r[is_free], c[is_free], a[is_free], b[is_free]
        length_m = np.hypot(rows, cols) * unit.grid.resolution_m
        tails.append(r * num_cols + c)
        heads.append(a * num_cols + b)
        costs.append(
            length_m * (weights[0] + (cell_cost[r, c] + cell_cost[a, b]) / (2 * unit.cost_model.reference_length_m))
        )
    size = num_rows * num_cols
    edges = coo_matrix((np.concatenate(costs), (np.concatenate(tails), np.concatenate(heads))), (size, size)).tocsr()
    start, goal = (r * num_cols + c for r, c in (query.start, query.goal))
    return float(dijkstra(edges, indices=start)[goal])


def line_of(name: str, query: RouteQuery) -> np.ndarray:
    ends = np.tile(GIVEN, (2, 1))
    ends[:, query.names.index(name)] *= (0.1, 10.0)
    return ends


def triangle_of(query: RouteQuery) -> np.ndarray:
    at = [query.names.index(name) for name in ("gps", "population", "risk")]
    corners = np.tile(GIVEN, (3, 1))
    corners[:, at] = 3 * np.eye(3)
    return corners


def test_cheapest_costs_over_a_triangle_equal_dijkstra_at_every_place_of_a_grid(query):
    found = find_breakpoints(RoutePool([query]), triangle_of(query))
    u, v = np.meshgrid(*2 * [(np.arange(SIDE) + 0.5) / SIDE])
    shares = np.stack([1 - np.sqrt(u), np.sqrt(u) * (1 - v), np.sqrt(u) * v], -1).reshape(-1, 3)
    truth = [dijkstra_cost(query, weights) for weights in found.weights_at(shares)]
    np.testing.assert_allclose(found.cost_at(shares), truth, rtol=1e-9)
    assert found.is_complete
    assert len(found.cells) > 10, "a grid of many routes is what tells"


def test_cells_cover_the_triangle_once_and_hold_their_own_route(query):
    found = find_breakpoints(RoutePool([query]), triangle_of(query))
    assert found.sizes.sum() == pytest.approx(1, abs=1e-9)
    assert np.all(np.diff(found.sizes) <= 0)
    np.testing.assert_array_equal(found.route_at(found.middles), np.arange(len(found.cells)))


@pytest.mark.parametrize("name", ["risk", "population"])
def test_along_a_line_the_route_changes_at_the_cuts_and_nowhere_else(query, name):
    found = find_breakpoints(RoutePool([query]), line_of(name, query))
    ends = np.concatenate([[0.0], found.breakpoints, [1.0]])
    assert np.all(np.diff(ends) > 0)
    assert len(found.cells) >= 3
    for route, (begin, end) in enumerate(pairwise(ends)):
        inside = np.linspace(begin, end, 5)[1:-1]
        shares = np.stack([1 - inside, inside], -1)
        truth = [dijkstra_cost(query, weights) for weights in found.weights_at(shares)]
        np.testing.assert_allclose(found.weights_at(shares) @ found.features[route], truth, rtol=1e-9)


def test_along_a_rising_weight_the_route_has_ever_less_of_it(query):
    found = find_breakpoints(RoutePool([query]), line_of("risk", query))
    assert np.all(np.diff(found.features[:, query.names.index("risk")]) < 0)


def test_a_tolerance_leaves_out_routes_but_costs_stay_within_it(query):
    exact = find_breakpoints(RoutePool([query]), triangle_of(query))
    rough = find_breakpoints(RoutePool([query]), triangle_of(query), tolerance=0.01)
    shares = np.random.default_rng(0).dirichlet(np.ones(3), 500)
    assert len(rough.cells) < len(exact.cells)
    assert rough.num_plans < exact.num_plans
    assert np.all(rough.cost_at(shares) <= exact.cost_at(shares) * 1.01)


def test_a_limit_of_searches_is_told(query):
    assert not find_breakpoints(RoutePool([query]), triangle_of(query), max_plans=5).is_complete


def test_a_line_on_which_nothing_changes_has_one_cell(query):
    found = find_breakpoints(RoutePool([query]), np.stack([GIVEN, 3 * GIVEN]))
    assert len(found.cells) == 1
    assert found.breakpoints.size == 0


@pytest.mark.parametrize("objectives", [("distance", "risk"), ("distance", "population", "risk")])
def test_no_route_under_any_weights_is_below_the_hull_of_the_front(query, objectives):
    front = pareto_front(RoutePool([query]), objectives)
    points = front.points[list(objectives)].to_numpy()
    for one in points:
        assert not np.any(np.all(points <= one, axis=1) & np.any(points < one, axis=1)), "dominated"
    rng = np.random.default_rng(1)
    for shares in rng.dirichlet(np.ones(len(objectives)), 20):
        weights = np.zeros(len(query.names))
        weights[[query.names.index(name) for name in objectives]] = shares
        assert np.min(points @ shares) == pytest.approx(dijkstra_cost(query, weights), rel=1e-9)


def test_with_a_tolerance_no_point_of_the_front_is_dominated_either(query):
    exact, rough = (
        pareto_front(RoutePool([query]), ("distance", "population", "risk"), tolerance=tolerance).points.to_numpy()[
            :, :3
        ]
        for tolerance in (1e-9, 0.05)
    )
    assert len(rough) < len(exact)
    for one in rough:
        assert not np.any(np.all(exact <= one * (1 + 1e-9), axis=1) & np.any(exact < one * (1 - 1e-9), axis=1))


@pytest.mark.parametrize("wrong", [{"objectives": ("risk",)}, {"tolerance": 0.0}, {"max_plans": 0}])
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        ju.studies.SensitivitySettings(**wrong)


def test_nearest_breakpoints_are_where_dijkstra_first_finds_a_cheaper_route(query):
    pool = RoutePool([query])
    found = nearest_breakpoints(pool, GIVEN, range(1, 5), (0.1, 10.0))
    given = pool.cheapest(GIVEN[None])[0, 0, 0]
    assert np.isfinite(found).sum() > 4, "a grid of many routes is what tells"
    for column, ends in zip(range(1, 5), found, strict=True):
        for nearest, end in zip(ends, (0.1, 10.0), strict=True):
            step = np.sign(end - 1) * 1e-4
            inside, outside = (end, None) if np.isnan(nearest) else (nearest * (1 - step), nearest * (1 + step))
            for factor in filter(None, (inside, outside)):
                weights = GIVEN.copy()
                weights[column] *= factor
                saved = 1 - dijkstra_cost(query, weights) / (weights @ given)
                assert (saved > 1e-12) == (factor == outside), (column, factor, saved)


def test_nearest_breakpoints_are_the_first_of_all_along_the_line(query):
    found = nearest_breakpoints(RoutePool([query]), GIVEN, range(1, 5), (0.1, 10.0))
    for row, name in enumerate(query.names[1:]):
        line = find_breakpoints(RoutePool([query]), line_of(name, query))
        factors = 0.1 + line.breakpoints * 9.9
        below, above = factors[factors < 1], factors[factors > 1]
        ends = [below.max() if below.size else np.nan, above.min() if above.size else np.nan]
        np.testing.assert_allclose(found[row], ends, rtol=1e-6)


def test_a_weight_of_zero_has_no_nearest_breakpoint(query):
    weights = GIVEN * [1, 0, 1, 1, 1]
    assert np.isnan(nearest_breakpoints(RoutePool([query]), weights, [1], (0.1, 10.0))).all()
