"""Lidar scan returns, softly: by how many metres a scan position meets a building, or misses all of them.

Legend: ``B`` beams, ``K`` azimuths, ``N`` steps along a ray, ``Y, X`` cells that get a result, ``H = N - 1`` cells of
halo around them, ``P`` chosen cells. Stepping rule and frame are those of `jaxurban.kernels.lidar.flat`.

There a scan position returns when at some step some beam enters the step's segment in the air and in range, and its
lowest height over the segment is not above the roof. Each of the three conditions is a margin in metres: height above
the ground where the beam enters, range left there, roof minus lowest height. A beam meets a building by the least of
the three, a scan position by the largest over beams and steps: its *clearance*, not negative exactly where the scan
position returns. The soft return is sigmoid(clearance / softness).

Least and largest keep one condition, one beam and one step each, so the gradient of a scan position runs to one roof.
Who that is, is found outside the gradient; what is differentiated is the one margin that decided.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.kernels.soft_step import soft_step

NO_BUILDING_M = -1e9  # clearance of bare ground: finite, so that gradients are too
STEPS_PER_PASS = 7  # steps compared per pass over the cells
CELLS_AT_ONCE = 2**11  # chosen cells taken together: what they need stays in a core's cache


class Scan(NamedTuple):
    """A scan position, as its margins need it. Scalars may be traced.

    Attributes:
      altitude_m: height of the receiver above its ground.
      range_m: slant range along a beam.
      resolution_m: side of a cell, a step's length.
      slope: ``[B]`` tangent of each beam's elevation, ascending.
      cosine: ``[B]`` cosine of each beam's elevation.
    """

    altitude_m: jax.Array
    range_m: jax.Array
    resolution_m: jax.Array
    slope: jax.Array
    cosine: jax.Array


class Margins(NamedTuple):
    """What a beam does at a step; all in metres.

    Attributes:
      lowest_m: lowest height over the segment (cut where the range ends), above the receiver's ground.
      in_air_m: height above level ground where the beam enters the segment, at most the receiver's.
      in_range_m: horizontal range left there; negative beyond the range.
    """

    lowest_m: jax.Array
    in_air_m: jax.Array
    in_range_m: jax.Array


def scan_of(
    altitude_m: Float[Array, ""],
    range_m: Float[Array, ""],
    elevations_rad: Float[np.ndarray, " B"],
    resolution_m: float,
) -> Scan:
    """Return a scan position in the type of ``altitude_m``."""
    dtype = jnp.result_type(altitude_m)
    fixed = resolution_m, np.tan(elevations_rad), np.cos(elevations_rad)
    return Scan(altitude_m, range_m, *(jnp.asarray(value, dtype) for value in fixed))


def margins_at(scan: Scan, n: Int[Array, "*s"], b: Int[Array, "*s"]) -> Margins:
    """Return what beams ``b`` do at steps ``n``; differentiable in altitude and range."""
    slope, cosine = scan.slope[b], scan.cosine[b]
    near_m = jnp.maximum(n - 0.5, 0.0).astype(slope.dtype) * scan.resolution_m
    far_m = (n + 0.5).astype(slope.dtype) * scan.resolution_m
    reach_m = scan.range_m * cosine
    falls = slope < 0
    lowest_m = scan.altitude_m + jnp.where(falls, jnp.minimum(far_m, reach_m), near_m) * slope
    in_air_m = scan.altitude_m + jnp.where(falls, jnp.minimum(near_m, reach_m) * slope, 0.0)
    return Margins(lowest_m, in_air_m, reach_m - near_m)


def all_margins(scan: Scan, steps: int) -> Margins:
    """Return what each beam does at each step, ``[N, B]``."""
    return margins_at(scan, jnp.arange(steps)[:, None], jnp.arange(len(scan.slope)))


def _least(roof_m: jax.Array, at: Margins) -> jax.Array:
    """Return by how many metres a beam meets a roof; where there is none it misses by far."""
    margin_m = jnp.minimum(roof_m - at.lowest_m, jnp.minimum(at.in_air_m, at.in_range_m))
    return jnp.where(roof_m > 0, margin_m, NO_BUILDING_M)


def _best_looks(roof_m: jax.Array, scan: Scan, steps: int) -> tuple[jax.Array, jax.Array]:
    """Return the clearance ``[N, *shape]`` of each step that looks at a cell, and the int8 beam that has it."""
    table = all_margins(scan, steps)

    def look(n):
        best = jnp.full(roof_m.shape, -jnp.inf, roof_m.dtype)
        beam = jnp.zeros(roof_m.shape, jnp.int8)
        for b in range(len(scan.slope)):
            found = _least(roof_m, Margins(*(value[n, b] for value in table)))
            beam = jnp.where(found > best, jnp.int8(b), beam)
            best = jnp.maximum(found, best)
        return best, beam

    return lax.map(look, jnp.arange(steps))


class _Deciding(NamedTuple):
    """Who decided each scan position of an azimuth: step, beam, cell looked at, and the clearance found, ``[Y, X]``."""

    n: jax.Array
    b: jax.Array
    row: jax.Array
    col: jax.Array
    clearance_m: jax.Array


@jax.custom_jvp
def _clearance(roof_m: jax.Array, scan: Scan, deciding: _Deciding) -> jax.Array:
    """Return the clearance that was found; its derivative is that of the margin that decided."""
    return deciding.clearance_m


@_clearance.defjvp
def _clearance_jvp(primals, tangents):
    (roof_m, scan, deciding), (d_roof_m, d_scan, _) = primals, tangents

    def decide(roof_m, scan):
        return _least(roof_m[deciding.row, deciding.col], margins_at(scan, deciding.n, deciding.b))

    return deciding.clearance_m, jax.jvp(decide, (roof_m, scan), (d_roof_m, d_scan))[1]


@jax.jit
def soft_returns(
    roof_m: Float[Array, "Y+2H X+2H"],
    scan: Scan,
    offsets: Int[Array, "K N 2"],
    softness_m: Float[Array, ""],
) -> Float[Array, "Y X"]:
    """Return the share of scan positions that return softly, over level ground, for every cell.

    Takes 5 bytes a step for each cell (float32), and no more for the gradient.

    Args:
      roof_m: roof heights with their halo, 0 without a building.
      scan: from `scan_of`.
      offsets: from `jaxurban.kernels.lidar.flat.ray_offsets`.
      softness_m: of the margins; 0 gives the exact result.
    """
    steps, halo = offsets.shape[1], offsets.shape[1] - 1
    rows, cols = (size - 2 * halo for size in roof_m.shape)
    clearance_m, beam = _best_looks(lax.stop_gradient(roof_m), lax.stop_gradient(scan), steps)
    row, col = jnp.indices((rows, cols), jnp.int32, sparse=True)

    @jax.checkpoint
    def add_azimuth(total, start):
        def look(state, n):
            best, which = state
            found = lax.dynamic_slice(clearance_m, (n, start[n, 0], start[n, 1]), (1, rows, cols))[0]
            return (jnp.maximum(found, best), jnp.where(found > best, n, which)), None

        nothing = jnp.full((rows, cols), -jnp.inf, roof_m.dtype), jnp.zeros((rows, cols), jnp.int32)
        (best, n), _ = lax.scan(look, nothing, jnp.arange(steps, dtype=jnp.int32), unroll=STEPS_PER_PASS)
        at = row + start[n, 0], col + start[n, 1]
        deciding = _Deciding(n, beam[(n, *at)], *at, best)
        return total + soft_step(_clearance(roof_m, scan, deciding), softness_m), None

    total, _ = lax.scan(add_azimuth, jnp.zeros((rows, cols), roof_m.dtype), offsets + halo)
    return total / len(offsets)


def _returns_at(
    roof_m: jax.Array,
    terrain_m: jax.Array | None,
    altitude_m: jax.Array,
    scan: Scan,
    offsets: jax.Array,
    softness_m: jax.Array,
    cells: jax.Array,
) -> jax.Array:
    """Return `soft_returns_at` of a few cells."""
    altitude_m = altitude_m[:, None, None]  # [P, N, B]
    level = all_margins(scan, offsets.shape[1])
    lowest_m, in_air_m = altitude_m + level.lowest_m, altitude_m + level.in_air_m

    @jax.checkpoint
    def add_azimuth(total, offset):
        row, col = (cells[:, None, axis] + offset[:, axis] + offsets.shape[1] - 1 for axis in (0, 1))  # [P, N]
        roof = roof_m[row, col][..., None]
        if terrain_m is None:
            at = Margins(lowest_m, in_air_m, level.in_range_m)
        else:
            rise_m = (terrain_m[row, col] - terrain_m[row[:, :1], col[:, :1]])[..., None]
            above_m = lowest_m - rise_m
            behind_m = jnp.broadcast_to(altitude_m, above_m[:, :1].shape)
            passed_m = jnp.concatenate([behind_m, lax.cummin(above_m, axis=1)[:, :-1]], axis=1)
            at = Margins(above_m, jnp.minimum(altitude_m, passed_m), level.in_range_m)
        best = _least(roof, at).max(axis=(1, 2))
        return total + soft_step(best, softness_m), None

    total, _ = lax.scan(add_azimuth, jnp.zeros(len(cells), roof_m.dtype), offsets)
    return total / len(offsets)


@jax.jit
def soft_returns_at(
    roof_m: Float[Array, "Y+2H X+2H"],
    terrain_m: Float[Array, "Y+2H X+2H"] | None,
    altitude_m: Float[Array, " P"],
    scan: Scan,
    offsets: Int[Array, "K N 2"],
    softness_m: Float[Array, ""],
    cells: Int[Array, "P 2"],
) -> Float[Array, " P"]:
    """Return the share of scan positions that return softly, at chosen cells alone.

    Over terrain receivers and roofs stand on it, and a beam's height where it enters a segment is the least that it
    has had above the ground of the cells before.

    Args:
      roof_m: roof heights with their halo, 0 without a building.
      terrain_m: ground elevation, likewise; None for level ground.
      altitude_m: height of each cell's receiver above its ground.
      scan: from `scan_of`, for the altitude 0.
      offsets: from `jaxurban.kernels.lidar.flat.ray_offsets`.
      softness_m: of the margins; 0 gives the exact result.
      cells: row and column of each cell, of those without the halo.
    """
    num = len(cells)
    some = jax.checkpoint(lambda part: _returns_at(roof_m, terrain_m, part[0], scan, offsets, softness_m, part[1]))
    batches = -(-num // CELLS_AT_ONCE)
    if batches <= 1:
        return some((altitude_m, cells))
    # The last cell stands in for the missing ones of the last batch.
    of_batch = jnp.minimum(jnp.arange(batches * CELLS_AT_ONCE), num - 1).reshape(batches, CELLS_AT_ONCE)
    return lax.map(some, (altitude_m[of_batch], cells[of_batch])).reshape(-1)[:num]
