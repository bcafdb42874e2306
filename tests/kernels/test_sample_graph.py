"""Sample graphs searched in bulk: against SciPy's Dijkstra over edges written out pair by pair."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from jaxurban.kernels.line.segment_cost import CostGrid, segment_cost
from jaxurban.kernels.search.heap import NO_PARENT
from jaxurban.kernels.search.sample_graph import NO_QUERY, Samples, Sizes, search_samples

SHAPE = (20, 26)
NUM_NODES = 256
SIZES = Sizes(
    candidates=128, edges=32, nodes_together=64, edges_together=128
)  # more than one turn of each
RADII = (6.0, np.inf, 0.4)  # of three queries with so many nodes:
COUNTS = (100, 40, 30)
PER_SIDE = 0.3


def a_map(seed):
    rng = np.random.default_rng(seed)
    return np.where(rng.random(SHAPE) < 0.9, rng.random(SHAPE), np.inf)


def samples_of(seed, cell_cost, **given):
    """Three queries, the first node of each its start; bounds that say nothing."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(np.isfinite(cell_cost))
    fields = {name: np.zeros(NUM_NODES) for name in Samples._fields}
    cells = free[rng.choice(len(free), NUM_NODES)][:, ::-1]
    fields["xy"] = cells + rng.uniform(0.01, 0.99, (NUM_NODES, 2))
    counts = [*COUNTS, NUM_NODES - sum(COUNTS)]
    fields["query"] = np.repeat(np.array([0, 1, 2, NO_QUERY], np.int32), counts)
    fields["radius"] = np.repeat([*RADII, 1.0], counts)
    fields["incumbent"] = np.full(NUM_NODES, np.inf)
    fields["g"] = np.full(NUM_NODES, np.inf)
    fields["g"][[0, COUNTS[0], COUNTS[0] + COUNTS[1]]] = 0.0
    fields["parent"] = np.full(NUM_NODES, NO_PARENT, np.int32)
    return Samples(**fields | given)


def search(samples, cell_cost, is_line=True, per_side=PER_SIDE, sizes=SIZES):
    with jax.enable_x64(True):
        samples = Samples(*(jnp.asarray(values) for values in samples))
        trees = search_samples(samples, cell_cost, per_side, False, is_line=is_line, sizes=sizes)
        return trees._replace(
            **{name: np.asarray(value) for name, value in trees._asdict().items()}
        )


def by_dijkstra(samples, cell_cost, is_line=True, tree=()):
    """Return the least costs from every query's start, and how many edges the radius makes."""
    cost_grid = CostGrid(cell_cost, PER_SIDE, is_line, False)
    distance = np.hypot(*(samples.xy[:, None] - samples.xy).transpose(2, 0, 1))
    is_edge = (
        (distance <= samples.radius)
        & (samples.query[:, None] == samples.query)
        & (samples.query != NO_QUERY)
    )
    np.fill_diagonal(is_edge, False)
    graph = np.full(is_edge.shape, np.inf)
    for a, b in [*np.argwhere(is_edge), *tree]:
        graph[a, b] = segment_cost(cost_grid, *samples.xy[a], *samples.xy[b], np.inf)
    return dijkstra(graph, indices=np.flatnonzero(samples.g == 0), min_only=True), is_edge


@pytest.mark.slow
@pytest.mark.parametrize("is_line", [True, False])
def test_costs_are_dijkstras_at_every_node_of_every_query(is_line):
    for seed in range(2):
        cell_cost = a_map(seed)
        samples = samples_of(seed, cell_cost)
        expected, is_edge = by_dijkstra(samples, cell_cost, is_line)
        trees = search(samples, cell_cost, is_line)
        np.testing.assert_allclose(trees.g, expected, rtol=1e-12)
        assert 110 < np.isfinite(expected).sum() < sum(COUNTS)
        # All edges but those to the starts, which nothing can improve.
        np.testing.assert_array_equal(
            trees.num_costed, np.where(samples.g == 0, 0, is_edge.sum(axis=0))
        )
        assert trees.num_edges == trees.num_costed.sum()
        has_parent = trees.parent != NO_PARENT
        np.testing.assert_array_equal(has_parent, np.isfinite(trees.g) & (samples.g > 0))
        parent = trees.parent[has_parent]
        np.testing.assert_allclose(
            trees.g[has_parent], trees.g[parent] + trees.edge_cost[has_parent], rtol=1e-12
        )


@pytest.mark.slow
def test_edges_of_the_tree_given_count_where_they_are_longer_than_the_radius():
    cell_cost = np.full(SHAPE, 0.5)
    samples = samples_of(3, cell_cost)
    first = COUNTS[0] + COUNTS[1]  # the third query's nodes lie too far apart to be joined
    tree = [(first, first + 1), (first + 1, first + 2), (first, first + 3), (first + 3, first + 4)]
    cost_grid = CostGrid(cell_cost, PER_SIDE, True, False)
    g, parent, edge_cost = samples.g.copy(), samples.parent.copy(), samples.edge_cost.copy()
    for a, b in tree:
        edge_cost[b] = segment_cost(cost_grid, *samples.xy[a], *samples.xy[b], np.inf)
        g[b], parent[b] = g[a] + edge_cost[b], a
    grown = samples._replace(g=g, parent=parent, edge_cost=edge_cost)
    trees = search(grown, cell_cost)
    np.testing.assert_allclose(trees.g, by_dijkstra(samples, cell_cost, True, tree)[0], rtol=1e-12)
    assert np.isfinite(trees.g[first + 4])
    # With bounds that are tight no edge promises more than what is known, but for rounding.
    bounds = {"from_start": trees.g, "least_per_side": np.full(NUM_NODES, PER_SIDE + 0.5)}
    known = {"g": trees.g, "parent": trees.parent, "edge_cost": trees.edge_cost}
    again = search(samples._replace(**bounds, **known), cell_cost)
    assert again.num_edges < trees.num_edges / 4
    np.testing.assert_array_equal(again.g, trees.g)
    np.testing.assert_array_equal(again.parent, trees.parent)


@pytest.mark.slow
def test_parents_lead_back_to_the_start_where_edges_cost_nothing():
    parent = search(samples_of(4, np.zeros(SHAPE)), np.zeros(SHAPE), per_side=0.0).parent
    for node in range(COUNTS[0]):
        num_steps = 0
        while parent[node] != NO_PARENT:
            node, num_steps = parent[node], num_steps + 1
            assert num_steps <= COUNTS[0]
        assert node == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "together", [{}, {"nodes_together": NUM_NODES, "edges_together": NUM_NODES}]
)
def test_too_little_room_is_told_and_nothing_is_searched(together):
    cell_cost = a_map(0)
    samples = samples_of(0, cell_cost)
    trees = search(samples, cell_cost, sizes=SIZES._replace(candidates=16, edges=1, **together))
    np.testing.assert_array_equal(trees.g, samples.g)
    assert trees.most_candidates == search(samples, cell_cost).most_candidates > 16
    assert trees.num_costed.sum() == 0
