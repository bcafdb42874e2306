"""The cost from every cell of a grid to a goal, by row sweeps in JAX."""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

ROUNDING = 1 - 1e-12  # a gain that rounding explains is none
Steps = tuple[tuple[int, int], ...]


@partial(jax.jit, static_argnames="steps")
def cost_to_go(
    field: Array,
    cost: Array,
    moves: Array,
    step_cost: Array,
    from_share: Array,
    to_share: Array,
    steps: Steps,
    max_rounds: Array,
) -> tuple[Array, Array]:
    """Return ``[G, Y, X]`` lower costs to go, and whether they are final: no cell can be lowered any more.

    A round goes over all rows northward and then southward. Each row takes the best step from the row
    before it and is then closed exactly: for the best way along the row, every cell is a map
    x -> min(b, a + x) of its neighbour's value, and these compose associatively, so the whole row is one
    scan. Another round is needed where a best way turns back south or north; some ten do for a city, and
    the number is never fixed: begin with inf everywhere but 0 at the goals, and go on until it is final.

    ``G`` goals, ``Y`` rows, ``X`` columns, ``K`` steps. Step k from P to Q costs
    ``step_cost[k] + from_share[k] * cost[P] + to_share[k] * cost[Q]``.

    Args:
      field: ``[G, Y, X]`` costs to go known so far: 0 at the goal, inf where not known.
      cost: ``[Y, X]`` map cost, >= 0 where steps lead; anything elsewhere.
      moves: ``[Y, X]`` uint8, bit k: step k is allowed.
      step_cost, from_share, to_share: ``[K]``.
      steps: rows and columns of each step, one of the eight neighbours each.
      max_rounds: rounds after which to return in any case.
    """
    num_cols = cost.shape[1]
    eastward, westward = steps.index((0, 1)), steps.index((0, -1))

    def step_to(k: int, moves_row: Array, cost_row: Array, to_cost: Array) -> Array:
        edge = step_cost[k] + from_share[k] * cost_row + to_share[k] * to_cost
        return jnp.where((moves_row >> k) & 1 == 1, edge, jnp.inf)

    def ahead(row: Array, cols: int) -> Array:
        """Return, at each column, the value ``cols`` columns further east; what lies outside is never used."""
        return row if cols == 0 else jnp.roll(row, -cols, axis=-1)

    def compose(before: tuple[Array, Array], here: tuple[Array, Array]) -> tuple[Array, Array]:
        a, b = before
        a_here, b_here = here
        return a_here + a, jnp.minimum(b_here, a_here + b)

    def close(row: Array, moves_row: Array, cost_row: Array) -> Array:
        closed = row
        for k, cols, is_reversed in ((eastward, 1, True), (westward, -1, False)):
            edge = jnp.broadcast_to(step_to(k, moves_row, cost_row, ahead(cost_row, cols)), row.shape)
            _, values = jax.lax.associative_scan(compose, (edge, row), reverse=is_reversed, axis=1)
            closed = jnp.minimum(closed, values)
        return closed

    def sweep(field: Array, rows_ahead: int) -> Array:
        """Return the field after every row has looked at the row ``rows_ahead`` of it, that one done already."""
        leading = [(k, cols) for k, (rows, cols) in enumerate(steps) if rows == rows_ahead]

        def one_row(before: tuple[Array, Array], here: tuple[Array, Array, Array]) -> tuple:
            field_before, cost_before = before
            field_row, moves_row, cost_row = here
            for k, cols in leading:
                edge = step_to(k, moves_row, cost_row, ahead(cost_before, cols))
                field_row = jnp.minimum(field_row, edge + ahead(field_before, cols))
            field_row = close(field_row, moves_row, cost_row)
            return (field_row, cost_row), field_row

        outside = (jnp.full((field.shape[0], num_cols), jnp.inf), jnp.zeros(num_cols))
        rows = (field.swapaxes(0, 1), moves, cost)
        swept: Array
        _, swept = jax.lax.scan(one_row, outside, rows, reverse=rows_ahead == 1)
        return swept.swapaxes(0, 1)

    def go_on(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        field, _, num_rounds = carry
        swept = sweep(sweep(field, -1), 1)
        return swept, jnp.all(swept >= field * ROUNDING), num_rounds + 1

    def may_go_on(carry: tuple[Array, Array, Array]) -> Array:
        _, is_final, num_rounds = carry
        return ~is_final & (num_rounds < max_rounds)

    field, is_final, _ = jax.lax.while_loop(may_go_on, go_on, (field, jnp.array(False), jnp.int32(0)))
    return field, is_final
