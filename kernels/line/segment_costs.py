"""What many straight segments cost over a map of cells at once, in JAX.

Segments are cut where they pass from cell to cell; all of them are walked along together, from cut to cut.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxurban.kernels.line.traversal import DIAGONAL_SIDES, TOUCH_CELLS


class _Segment(NamedTuple):
    """A segment of so many cell sides; ``[2]`` of x and y: its start, and that cell, and the cuts from there on.

    Attributes:
      length: in cell sides.
      start: in cell sides.
      along: cell sides along the segment per cell side of x and of y.
      cell: int32 column and row of the start.
      border: of its cell on the way, likewise.
      step: 1 or -1, from cell to cell.
      num_cuts: how many cells the end is away.
    """

    length: Array
    start: Array
    along: Array
    cell: Array
    border: Array
    step: Array
    num_cuts: Array

    def of(self, axis: int) -> "_Segment":
        """Return what is of x, or of y, alone."""
        return _Segment(self.length, *(of_both[axis] for of_both in self[1:]))

    def cut(self, k: Array) -> Array:
        """Return where the k-th cuts lie, in cell sides along the segment."""
        return (self.border + self.step * k - self.start) * self.along


class _Walk(NamedTuple):
    """A walk from cut to cut: how many of x and y are passed, cell sides behind, cost so far."""

    num_x: Array
    num_y: Array
    at: Array
    total: Array


@partial(jax.jit, static_argnames="is_line")
def segment_costs(
    cell_cost: Float[Array, "Y X"],
    start: Float[Array, "E 2"],
    end: Float[Array, "E 2"],
    per_side: float | Float[Array, ""],
    is_line: bool,
    passes_corners: bool | Bool[Array, ""],
) -> Float[Array, " E"]:
    """Return the cost of each of ``E`` segments, inf where it is not a free way, infinite costs being blocked cells.

    Segments are cut exactly at cell borders, as in `kernels.line.traversal`, and are free by the law of its
    `is_free_way`: a corner passed within ``TOUCH_CELLS`` counts as touched, so that the cells beside it are not
    crossed.
    ``line``: the cell's cost is integrated along the segment. ``cell``: every state costs that of the cell in which it
    lies; states stand one cell side apart, the end is one, the start is none, and a segment up to a diagonal long has
    no other. A segment of no length costs nothing.

    It takes as many rounds as the segment with most cells has cells. The precision is that of the coordinates: call it
    under ``jax.enable_x64(True)``, since float32 tells no corners apart.

    Args:
      cell_cost: cost of a cell per cell side crossed (`line`) or per state (`cell`); inf: no way through.
      start, end: x, y in cell sides, off the borders of their cells, finite.
      per_side: distance cost per cell side.
      is_line: which cost model.
      passes_corners: segments may pass between two blocked cells that touch at a corner.
    """
    segments = jax.vmap(_segment)(start, end)
    total = _by_walks(segments, per_side * segments.length, cell_cost, jnp.asarray(passes_corners), is_line=is_line)
    if not is_line:
        last = segments.cell + segments.step * segments.num_cuts
        total += _cost_at(cell_cost, last[:, 1], last[:, 0])
    return jnp.where(segments.length > 0, total, 0.0)


def _segment(start: Array, end: Array) -> _Segment:
    delta = end - start
    length = jnp.hypot(*delta)
    cell, last = (jnp.floor(point).astype(jnp.int32) for point in (start, end))
    border, step = cell + (delta > 0), jnp.where(delta > 0, 1, -1).astype(jnp.int32)
    along = length / jnp.where(delta == 0, 1.0, delta)
    return _Segment(length, start, along, cell, border, step, jnp.abs(last - cell))


def _cost_at(cell_cost: Array, row: Array, col: Array) -> Array:
    is_inside = (row >= 0) & (row < cell_cost.shape[0]) & (col >= 0) & (col < cell_cost.shape[1])
    return jnp.where(is_inside, cell_cost[row, col], jnp.inf)


def _cost_between(
    segment: _Segment,
    behind: Array,
    to: Array,
    num_passed: tuple[Array, Array],
    is_corner: Array,
    cell_cost: Array,
    passes_corners: Array,
    is_line: bool,
) -> Array:
    """Return what the part of a segment costs from one cut to the next, in the cell after so many cuts of x and y."""
    if is_line:
        share = to - behind
    else:
        # A state on a border belongs to the cell it came through.
        last_state = jnp.where(segment.length > DIAGONAL_SIDES, jnp.ceil(segment.length * (1 - TOUCH_CELLS)) - 1, 0.0)
        before, by_now = (jnp.clip(jnp.floor(sides + TOUCH_CELLS), 0, last_state) for sides in (behind, to))
        share = by_now - before
    col, row = (segment.cell[axis] + segment.step[axis] * num_passed[axis] for axis in (0, 1))
    here = _cost_at(cell_cost, row, col)
    cost = jnp.where(jnp.isinf(here), jnp.inf, share * jnp.where(jnp.isinf(here), 0.0, here))
    beside = jnp.minimum(
        _cost_at(cell_cost, row + segment.step[1], col), _cost_at(cell_cost, row, col + segment.step[0])
    )
    is_pinched = jnp.where(passes_corners, False, is_corner & jnp.isinf(beside))
    return jnp.where(is_pinched, jnp.inf, cost)


def _by_walks(
    segments: _Segment, distance_cost: Array, cell_cost: Array, passes_corners: Array, *, is_line: bool
) -> Array:
    """Return what the segments cost, ``[E]``."""

    def cost(segment: _Segment, distance_cost: Array) -> Array:
        x, y = segment.of(0), segment.of(1)

        def go_on(walk: _Walk) -> _Walk:
            next_x = jnp.where(walk.num_x < x.num_cuts, x.cut(walk.num_x), jnp.inf)
            next_y = jnp.where(walk.num_y < y.num_cuts, y.cut(walk.num_y), jnp.inf)
            to = jnp.minimum(jnp.minimum(next_x, next_y), segment.length)
            is_corner = jnp.abs(next_x - next_y) < TOUCH_CELLS
            num_passed = walk.num_x, walk.num_y
            part = _cost_between(segment, walk.at, to, num_passed, is_corner, cell_cost, passes_corners, is_line)
            num_x, num_y = walk.num_x + (is_corner | (next_x < next_y)), walk.num_y + (is_corner | (next_y < next_x))
            return _Walk(num_x, num_y, to, walk.total + part)

        def is_under_way(walk: _Walk) -> Array:
            return ((walk.num_x < x.num_cuts) | (walk.num_y < y.num_cuts)) & jnp.isfinite(walk.total)

        none = jnp.zeros_like(x.cell)
        start = _Walk(none, none, jnp.zeros_like(segment.length), distance_cost)
        return go_on(lax.while_loop(is_under_way, go_on, start)).total

    return jax.vmap(cost)(segments, distance_cost)
