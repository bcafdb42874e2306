"""Lidar scan returns, softly: by how many metres a scan position meets a building, or misses all of them.

Legend: ``B`` beams, ``K`` azimuths, ``N`` steps along a ray, ``Y, X`` cells that get a result, ``H = N - 1`` cells of
halo around them, ``P`` chosen cells. Stepping rule and frame are those of `jaxurban.kernels.lidar.hard`.

There a scan position returns when at some step some beam enters the step's segment in the air and in range, and its
lowest height over the segment is not above the roof. Each of the three conditions is a margin in metres: height above
the ground where the beam enters, range left there, roof minus lowest height. A beam meets a building by the least of
the three, a scan position by the largest over beams and steps: its *clearance*, not negative exactly where the scan
position returns. The soft return is sigmoid(clearance / softness).

Least and largest keep one condition, one beam and one step each, so the gradient of a scan position runs to one roof.
The margin that decides is chosen outside the gradient; that margin alone is differentiated.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.soft_step import soft_step
from jaxurban.programs import kept_jit

NO_BUILDING_M = -1e9  # clearance of bare ground: finite, so that gradients are too
STEPS_PER_PASS = 7  # steps compared per pass over the cells
CELLS_AT_ONCE = 2**11  # chosen cells taken together: what they need stays in a core's cache
# On a GPU, which otherwise starts kernels for each; a CPU takes one at a time.
MOST_AZIMUTHS_AT_ONCE = 40


class Scan(NamedTuple):
    """A scan position, as its margins need it. Scalars may be traced.

    Attributes:
      altitude_m: height of the receiver above its ground.
      range_m: slant range along a beam.
      resolution_m: side of a cell, a step's length.
      slope: ``[B]`` tangent of each beam's elevation, ascending.
      cosine: ``[B]`` cosine of each beam's elevation.
    """

    altitude_m: Array
    range_m: Array
    resolution_m: Array
    slope: Array
    cosine: Array


class Margins(NamedTuple):
    """What a beam does at a step; all in metres.

    Attributes:
      lowest_m: lowest height over the segment (cut where the range ends), above the receiver's ground.
      in_air_m: height above level ground where the beam enters the segment, at most the receiver's.
      in_range_m: horizontal range left there; negative beyond the range.
    """

    lowest_m: Array
    in_air_m: Array
    in_range_m: Array


def scan_of(
    altitude_m: Float[Array, ""],
    range_m: Float[Array, ""],
    elevations_rad: Float[np.ndarray, " B"],
    resolution_m: float,
) -> Scan:
    """Return a scan position in the type of ``altitude_m``.

    Args:
      altitude_m: height of the receiver above its ground; may be traced.
      range_m: slant range along a beam; may be traced.
      elevations_rad: of the beams above the horizon, ascending.
      resolution_m: side of a cell.
    """
    dtype = jnp.result_type(altitude_m)
    fixed = resolution_m, np.tan(elevations_rad), np.cos(elevations_rad)
    return Scan(altitude_m, range_m, *(jnp.asarray(value, dtype) for value in fixed))


def margins_at(scan: Scan, n: Int[Array, "*s"], b: Int[Array, "*s"]) -> Margins:
    """Return the margins of beams at steps, in the shape of ``n`` and ``b``; differentiable in altitude and range.

    Args:
      scan: the scan position.
      n: numbers of the steps.
      b: numbers of the beams.
    """
    slope, cosine = scan.slope[b], scan.cosine[b]
    step = jnp.asarray(n, slope.dtype)
    near_m = jnp.maximum(step - 0.5, 0.0) * scan.resolution_m
    far_m = (step + 0.5) * scan.resolution_m
    reach_m = scan.range_m * cosine
    falls = slope < 0
    # Over a segment a falling beam is lowest at the far end, or where its range ends, and highest at the near end.
    lowest_m = scan.altitude_m + jnp.where(falls, jnp.minimum(far_m, reach_m), near_m) * slope
    in_air_m = scan.altitude_m + jnp.where(falls, jnp.minimum(near_m, reach_m) * slope, 0.0)
    return Margins(lowest_m, in_air_m, reach_m - near_m)


def all_margins(scan: Scan, steps: int) -> Margins:
    """Return what each beam does at each step, ``[N, B]``."""
    return margins_at(scan, *jnp.indices((steps, len(scan.slope))))


def _least(roof_m: Array, at: Margins) -> Array:
    """Return by how many metres a beam meets a roof; where there is none it misses by far."""
    margin_m = jnp.minimum(roof_m - at.lowest_m, jnp.minimum(at.in_air_m, at.in_range_m))
    return jnp.where(roof_m > 0, margin_m, NO_BUILDING_M)


def _best_looks(roof_m: Array, scan: Scan, steps: int) -> tuple[Array, Array]:
    """Return for each step and cell the clearance of a scan that looks at the cell, and the beam that has it.

    Args:
      roof_m: ``[*shape]`` roof heights, 0 without a building.
      scan: the scan position.
      steps: N.

    Returns:
      ``[N, *shape]`` the largest clearance over the beams, in metres, and ``[N, *shape]`` int8 the number of its beam.
    """
    table = all_margins(scan, steps)

    def look(n):
        """Return the clearance and the beam of every cell at step n."""
        best_m = jnp.full(roof_m.shape, -jnp.inf, roof_m.dtype)
        beam = jnp.zeros(roof_m.shape, jnp.int8)
        for b in range(len(scan.slope)):
            clearance_m = _least(roof_m, Margins(*(value[n, b] for value in table)))
            beam = jnp.where(clearance_m > best_m, jnp.int8(b), beam)
            best_m = jnp.maximum(clearance_m, best_m)
        return best_m, beam

    return lax.map(look, jnp.arange(steps))


class _Deciding(NamedTuple):
    """Who decided each scan position of an azimuth: step, beam, cell looked at, and the clearance found, ``[Y, X]``."""

    n: Array
    b: Array
    row: Array
    col: Array
    clearance_m: Array


@jax.custom_jvp
def _clearance(roof_m: Array, scan: Scan, deciding: _Deciding) -> Array:
    """Return the clearance that was found; its derivative is that of the margin that decided."""
    return deciding.clearance_m


@_clearance.defjvp
def _clearance_jvp(primals, tangents):
    """Return the clearance, and the derivative of the one margin that decided it, by roofs and by the scan."""
    (roof_m, scan, deciding), (d_roof_m, d_scan, _) = primals, tangents

    def decide(roof_m, scan):
        return _least(roof_m[deciding.row, deciding.col], margins_at(scan, deciding.n, deciding.b))

    return deciding.clearance_m, jax.jvp(decide, (roof_m, scan), (d_roof_m, d_scan))[1]


@kept_jit
def soft_returns(
    roof_m: Float[Array, "Y+2H X+2H"],
    scan: Scan,
    offsets: Int[Array, "K N 2"],
    softness_m: Float[Array, ""],
) -> Float[Array, "Y X"]:
    """Return the share of scan positions that return softly, over level ground, for every cell.

    It takes 5 bytes of memory for each step and cell (float32), and no more for the gradient on a CPU; on a GPU the
    gradient takes some 1.5 kB for each cell. Both forms differ only by the order in which azimuths are added.

    Args:
      roof_m: roof heights with their halo, 0 without a building.
      scan: from `scan_of`.
      offsets: from `jaxurban.kernels.lidar.hard.ray_offsets`.
      softness_m: scale over which the margins are smoothed; 0 gives the exact result.
    """
    return lax.platform_dependent(
        roof_m, scan, offsets, softness_m, cpu=one_by_one, default=together
    )


def together(roof_m: Array, scan: Scan, offsets: Array, softness_m: Array) -> Array:
    """Return `soft_returns`, by the form for a GPU."""
    num_azimuths, steps, _ = offsets.shape
    return _returns(
        roof_m, scan, offsets, softness_m, at_once=azimuths_at_once(num_azimuths), unroll=steps
    )


def azimuths_at_once(num_azimuths: int) -> int:
    """Return how many azimuths a GPU takes together, in the last group fewer."""
    num_groups = -(-num_azimuths // MOST_AZIMUTHS_AT_ONCE)
    return -(-num_azimuths // num_groups)


def _total_of_groups(of_azimuth: Callable, rays: Array, none: Array, at_once: int) -> Array:
    """Return the sum of what a function gives for each azimuth; a gradient computes it again and keeps none of it.

    Args:
      of_azimuth: takes one azimuth's ray ``[...]`` and returns an array like ``none``.
      rays: ``[K, ...]`` rays of all azimuths.
      none: zeros, to which the results are added in the order of azimuths.
      at_once: how many azimuths are taken together.
    """

    @jax.checkpoint
    def add_azimuths(total, rays):
        """Add the results of one group's rays to the total; a group of one needs no vmap."""
        if at_once == 1:
            return total + of_azimuth(rays[0]), None
        return total + jnp.sum(jax.vmap(of_azimuth)(rays), axis=0), None

    # Azimuths in full groups; the last, smaller group comes after them.
    whole = len(rays) // at_once * at_once
    total, _ = lax.scan(add_azimuths, none, rays[:whole].reshape(-1, at_once, *rays.shape[1:]))
    return total if whole == len(rays) else add_azimuths(total, rays[whole:])[0]


def _returns(
    roof_m: Array,
    scan: Scan,
    offsets: Array,
    softness_m: Array,
    *,
    at_once: int,
    unroll: int,
) -> Array:
    """Return `soft_returns`, ``[Y, X]``, with ``at_once`` azimuths together and ``unroll`` steps a turn of the loop.

    Arguments are otherwise those of `soft_returns`.
    """
    num_azimuths, steps, _ = offsets.shape
    halo = steps - 1
    rows, cols = (size - 2 * halo for size in roof_m.shape)
    # Outside the gradient: the clearance and the beam of each step and cell looked at.
    clearance_m, beam = _best_looks(lax.stop_gradient(roof_m), lax.stop_gradient(scan), steps)
    row, col = jnp.indices((rows, cols), jnp.int32, sparse=True)

    def of_azimuth(start):
        """Return the soft returns ``[Y, X]`` of one azimuth, each from 0 to 1.

        Args:
          start: ``[N, 2]`` row and column, with the halo, of the cell at which step n looks from the first receiver.
        """

        def look(state, n):
            """Keep the larger clearance of step n and of the steps before, and the number of its step."""
            best_m, best_n = state
            corner = n, start[n, 0], start[n, 1]
            step_m = lax.dynamic_slice(clearance_m, corner, (1, rows, cols))[0]
            return (jnp.maximum(step_m, best_m), jnp.where(step_m > best_m, n, best_n)), None

        # The step with the largest clearance decides.
        nothing = jnp.full((rows, cols), -jnp.inf, roof_m.dtype), jnp.zeros((rows, cols), jnp.int32)
        (best_m, n), _ = lax.scan(look, nothing, jnp.arange(steps, dtype=jnp.int32), unroll=unroll)

        # Its clearance again, with a gradient.
        cell = row + start[n, 0], col + start[n, 1]  # that the deciding step looked at
        deciding = _Deciding(n, beam[(n, *cell)], *cell, best_m)
        return soft_step(_clearance(roof_m, scan, deciding), softness_m)

    return (
        _total_of_groups(of_azimuth, offsets + halo, jnp.zeros((rows, cols), roof_m.dtype), at_once)
        / num_azimuths
    )


one_by_one = partial(_returns, at_once=1, unroll=STEPS_PER_PASS)


class ScansAt(NamedTuple):
    """Scan positions at chosen cells, and what stands around them. Scalars may be traced.

    Attributes:
      roof_m: ``[Y + 2 H, X + 2 H]`` roof heights with their halo, 0 without a building.
      terrain_m: ground elevation, likewise; None for level ground.
      altitude_m: ``[P]`` height of each cell's receiver above its ground.
      scan: from `scan_of`, for the altitude 0.
      offsets: ``[K, N, 2]``, from `jaxurban.kernels.lidar.hard.ray_offsets`.
      softness_m: of the margins; 0 gives the exact result.
      cells: ``[P, 2]`` row and column of each cell, of those without the halo.
    """

    roof_m: Array
    terrain_m: Array | None
    altitude_m: Array
    scan: Scan
    offsets: Array
    softness_m: Array
    cells: Array


def _returns_of_cell(at: ScansAt, receiver: tuple[Array, Array], at_once: int) -> Array:
    """Return the share of azimuths that return softly to one receiver, a number from 0 to 1.

    Args:
      at: the scan positions, of which roofs, terrain, scan and rays count.
      receiver: the altitude and the cell ``[2]`` of the receiver.
      at_once: how many azimuths are taken together.
    """
    (altitude_m, cell), steps = receiver, at.offsets.shape[1]
    level_margins = all_margins(at.scan._replace(altitude_m=altitude_m), steps)

    def of_azimuth(offset):
        """Return the soft return of one azimuth, from 0 to 1, whose N steps look at offsets ``[N, 2]`` from the cell.

        The fields of margins are ``[N, B]``, by step and beam, and heights in them are above the ground below the step.
        """
        # Rows and columns of the cells that the steps look at, in arrays with a halo of steps - 1 cells.
        row, col = (cell[None] + offset + steps - 1).T
        margins = level_margins
        if at.terrain_m is not None:
            # Above ground that rises from step 0 on, beams are lower by as much.
            rise_m = at.terrain_m[row, col] - at.terrain_m[row[0], col[0]]
            above_m = level_margins.lowest_m - rise_m[:, None]
            behind_m = jnp.full_like(above_m[:1], altitude_m)
            # The least height above the cells of the steps before; at step 0 the receiver's own.
            passed_m = jnp.concatenate([behind_m, lax.cummin(above_m)[:-1]])
            margins = level_margins._replace(
                lowest_m=above_m, in_air_m=jnp.minimum(altitude_m, passed_m)
            )
        # The best of all steps and beams returns.
        return soft_step(_least(at.roof_m[row, col][:, None], margins).max(), at.softness_m)

    nothing = jnp.zeros((), at.roof_m.dtype)
    return _total_of_groups(of_azimuth, at.offsets, nothing, at_once) / len(at.offsets)


@kept_jit
def soft_returns_at(at: ScansAt) -> Float[Array, " P"]:
    """Return the share of scan positions that return softly, at chosen cells alone.

    Over terrain receivers and roofs stand on it, and a beam's height where it enters a segment is the least that it
    has had above the ground of the cells before.
    """
    alone = partial(in_batches, at_once=1)
    beside = partial(in_batches, at_once=azimuths_at_once(len(at.offsets)))
    return lax.platform_dependent(at, cpu=alone, default=beside)


def in_batches(at: ScansAt, *, at_once: int) -> Array:
    """Return `soft_returns_at`, with `CELLS_AT_ONCE` cells and ``at_once`` azimuths together."""
    of_cell = jax.checkpoint(partial(_returns_of_cell, at, at_once=at_once))
    return lax.map(of_cell, (at.altitude_m, at.cells), batch_size=CELLS_AT_ONCE)
