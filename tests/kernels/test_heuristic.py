"""Map-cost bounds, against reductions over boxes written out."""

import numpy as np
import pytest

from jaxurban.kernels.search.bounds import printed_plus_field


def box_reduction(layers, goal, first_index):
    """The printed s_k, node by node, straight from the equations."""
    _, num_rows, num_cols = layers.shape
    values = np.zeros((num_rows, num_cols))
    for row in range(num_rows):
        for col in range(num_cols):
            (south, north), (west, east) = sorted((row, goal[0])), sorted((col, goal[1]))
            box = layers[:, south : north + 1, west : east + 1]
            dx, dy = east - west, north - south
            columns = box.min(axis=1)[:, first_index : first_index + dx].sum(axis=1)
            rows = box.min(axis=2)[:, first_index : first_index + dy].sum(axis=1)
            values[row, col] = np.maximum(columns, rows).sum()
    return values


@pytest.mark.parametrize("first_index", [1, 0])
def test_the_printed_field_equals_a_box_reduction_at_every_node(first_index):
    rng = np.random.default_rng(5)
    for shape in [(1, 1), (1, 7), (6, 1), (2, 2), (9, 12), (13, 8)]:
        layers = rng.random((3, *shape))
        for _ in range(4):
            goal = (int(rng.integers(shape[0])), int(rng.integers(shape[1])))
            expected = box_reduction(layers, goal, first_index)
            np.testing.assert_allclose(printed_plus_field(layers, goal, first_index), expected, atol=1e-12)


def test_the_printed_field_counts_the_nodes_own_column_where_the_goal_lies_west():
    layers = np.array([[[1.0, 0.0, 5.0]]])  # goal, free ground, node
    assert printed_plus_field(layers, (0, 0), 1)[0, 2] == 5.0  # the true map cost of going west is 0 + 1
    assert printed_plus_field(layers[..., ::-1], (0, 2), 1)[0, 0] == 1.0  # mirrored it is right
