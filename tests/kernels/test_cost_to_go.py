"""Fields by active tiles: against SciPy's Dijkstra on graphs written out step by step."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from jaxurban.kernels.search.cost_to_go import CostFields, FieldMaps, advance, begin

STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
SHAPE = (23, 37)
OPTIONS = {"tile": 8, "num_passes": 5, "num_together": 7}


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def random_maps(seed, num_maps=3, num_steps=8, shape=SHAPE, free_share=0.75):
    """Maps with walls, free cells, NaN in walls, and one-way steps: every one a map of its own."""
    rng = np.random.default_rng(seed)
    is_free = rng.random((num_maps, *shape)) < free_share
    cost = np.where(is_free, rng.random((num_maps, *shape)) ** 3, np.nan)
    cost[is_free & (rng.random(cost.shape) < 0.2)] = 0.0
    framed = np.pad(is_free, ((0, 0), (1, 1), (1, 1)))
    moves = np.zeros(cost.shape, np.uint8)
    for k, (rows, cols) in enumerate(STEPS[:num_steps]):
        to = framed[:, 1 + rows : 1 + rows + shape[0], 1 + cols : 1 + cols + shape[1]]
        moves |= (is_free & to & (rng.random(cost.shape) < 0.9)).astype(np.uint8) << k
    shares = (rng.random((num_maps, len(STEPS))) for _ in range(3))
    return FieldMaps(cost, moves, *shares, rng.random(num_maps) * 3)


def random_goals(maps, num, seed=0):
    rng = np.random.default_rng(seed)
    map_index = rng.integers(len(maps.cost), size=num)
    free = [np.argwhere(np.isfinite(cost)) for cost in maps.cost]
    return np.array([rng.choice(free[k]) for k in map_index], np.int32), map_index.astype(np.int32)


def by_dijkstra(maps, goal, index):
    """Cost from every cell to the goal, by SciPy; blocked cells keep inf."""
    cost, moves = maps.cost[index], maps.moves[index]
    num_cols = cost.shape[1]
    here, there, weight = [], [], []
    for row, col in np.ndindex(cost.shape):
        for k, (rows, cols) in enumerate(STEPS):
            if moves[row, col] >> k & 1:
                to = row + rows, col + cols
                step = maps.step_cost[index, k] + maps.from_share[index, k] * cost[row, col]
                here.append(row * num_cols + col)
                there.append(to[0] * num_cols + to[1])
                weight.append(step + maps.to_share[index, k] * cost[to])
    # SciPy takes an edge of cost 0 for none.
    graph = csr_array((np.maximum(weight, 1e-300), (there, here)), shape=(cost.size, cost.size))
    return dijkstra(graph, indices=goal[0] * num_cols + goal[1]).reshape(cost.shape)


def fields_of(maps, goals, map_index, steps=STEPS, max_rounds=10**6, **options) -> CostFields:
    options = OPTIONS | options
    shape = maps.cost.shape[1:]
    return advance(begin(goals, map_index, shape, options["tile"]), maps, max_rounds, steps=steps, **options)


def costs(fields, shape=SHAPE):
    return fields.cost[..., 1 : 1 + shape[0], 1 : 1 + shape[1]]


@pytest.mark.parametrize("num_steps", [4, 8])
def test_fields_of_many_goals_and_maps_equal_dijkstras(num_steps):
    for seed in range(3):
        maps = random_maps(seed, num_steps=num_steps, free_share=(0.95, 0.85, 0.75)[seed])
        goals, map_index = random_goals(maps, 6, seed)
        fields = fields_of(maps, goals, map_index, STEPS[:num_steps])
        assert fields.cost.dtype == np.float64
        expected = [by_dijkstra(maps, *at) for at in zip(goals, map_index, strict=True)]
        assert np.isinf(expected).any()  # blocked cells and parts without a way
        assert np.isfinite(expected).sum() > 600
        np.testing.assert_allclose(costs(fields), expected, rtol=1e-12, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed",
    [
        {"tile": 4, "num_passes": 2, "num_together": 1},
        {"tile": 64, "num_passes": 6, "num_together": 1000},  # one tile, larger than the map
        {"band": 0.0},
        {"band": np.inf},
    ],
)
def test_tiles_passes_and_bands_change_the_work_and_not_the_costs(changed):
    maps = random_maps(4)
    goals, map_index = random_goals(maps, 6)
    plain = fields_of(maps, goals, map_index)
    changed = dict(changed)
    other = fields_of(maps._replace(band=np.full(3, changed.pop("band", 1.0))), goals, map_index, **changed)
    np.testing.assert_allclose(costs(other), costs(plain), rtol=1e-14)
    assert int(other.num_rounds) != int(plain.num_rounds)


def test_goals_and_costs_may_come_by_vmap_too():
    maps = random_maps(5)
    goals, map_index = random_goals(maps, 6)

    def one_field(goal, *of_map):
        one_map = FieldMaps(*(values[None] for values in of_map))
        return costs(fields_of(one_map, goal[None], jnp.zeros(1, jnp.int32)))[0]

    of_each = FieldMaps(*(jnp.asarray(values)[map_index] for values in maps))
    found = jax.jit(jax.vmap(one_field))(jnp.asarray(goals), *of_each)
    np.testing.assert_allclose(found, costs(fields_of(maps, goals, map_index)), rtol=1e-14)


def test_a_field_that_was_stopped_goes_on_to_the_same_costs():
    maps = random_maps(6)
    goals, map_index = random_goals(maps, 6)
    whole = fields_of(maps, goals, map_index)
    fields = begin(goals, map_index, SHAPE, OPTIONS["tile"])
    num_calls = 0
    while np.isfinite(fields.pending).any():
        before = np.asarray(fields.cost).copy()
        fields = advance(fields, maps, 2, steps=STEPS, **OPTIONS)
        assert np.all(np.asarray(fields.cost) <= before)
        assert np.all(np.asarray(costs(fields)) >= np.asarray(costs(whole)))  # never below the truth
        num_calls += 1
    assert num_calls > 3
    assert int(fields.num_rounds) == int(whole.num_rounds)
    np.testing.assert_array_equal(fields.cost, whole.cost)
    np.testing.assert_array_equal(fields.num_visits, whole.num_visits)


def test_a_goal_at_the_corner_of_its_tile_is_reached_from_the_tiles_beside_it():
    """From the goal's own tile no way leads to it, so nothing falls there but the goal itself."""
    moves = np.zeros((3, *SHAPE), np.uint8)
    moves[0, 8, 8] = 1 << STEPS.index((-1, -1))
    ones = np.ones((3, len(STEPS)))
    maps = FieldMaps(np.ones((3, *SHAPE)), moves, ones, ones, ones, np.ones(3))
    fields = costs(fields_of(maps, np.full((6, 2), 7, np.int32), np.zeros(6, np.int32)))
    np.testing.assert_array_equal(fields[:, 8, 8], 3.0)
    assert np.isfinite(fields).sum() == 6 * 2


def test_a_field_without_a_goal_stays_empty_and_costs_no_round():
    maps = random_maps(7)
    goals, map_index = random_goals(maps, 6)
    goals[2:] = goals[0]
    alone = fields_of(maps, goals, np.where(np.arange(6) < 2, map_index, map_index[0]))
    goals[2:] = -1
    fields = fields_of(maps, goals, map_index)
    assert np.isinf(fields.cost[2:]).all()
    np.testing.assert_array_equal(fields.num_visits[2:], 0)
    np.testing.assert_array_equal(costs(fields)[:2], costs(alone)[:2])
    goals[:] = -1
    assert int(fields_of(maps, goals, map_index).num_rounds) == 0


def test_the_program_is_one_for_any_number_of_goals_and_exports_for_cuda():
    maps = random_maps(8)
    some_rounds = jax.jit(partial(advance, steps=STEPS, **OPTIONS))
    num_lines = []
    for num in (1, 16):
        fields = begin(*random_goals(maps, num), SHAPE, OPTIONS["tile"])
        num_lines.append(str(jax.make_jaxpr(some_rounds)(fields, maps, 10)).count("\n"))
    assert num_lines[0] == num_lines[1]
    exported = jax.export.export(some_rounds, platforms=["cuda"])(fields, maps, 10)
    assert exported.platforms == ("cuda",)
