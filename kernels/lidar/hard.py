"""Lidar scan returns: how many azimuths of a spinning lidar meet a building, for every cell of a raster.

Legend: ``A`` altitudes, ``B`` beams, ``K`` azimuths, ``N`` steps along a ray, ``Y, X`` cells that
get a result, ``H = N - 1`` cells of halo around them. Row 0 is the southernmost, azimuths run
clockwise from grid north.

Stepping rule. A ray starts at a cell's centre. Step n stands for the segment of the ray from
(n - 1/2) to (n + 1/2) cells of horizontal distance (step 0: from 0 to 1/2), and looks at one cell,
the one that holds the middle of the segment. A beam meets the building there if it enters the
segment in range and in the air, and its lowest height over the segment (cut where the range ends)
is not above the roof; within a segment it meets a wall before the ground. The rule knows only the
resolution, so a map of a sub-box equals the crop of a larger one. Against Embree through exact
outlines (Lower Manhattan, 5 m, 20 m up) its mean error of m is 0.0085, its bias below 0.001; looking at
every cell that the ray crosses gives 0.0104 and +0.007, because stair-cased outlines are wider than
the true ones; testing the height only in the middle of a segment gives 0.0148 and -0.011.

Roofs are columns from the ground, so over flat ground only the lowest beam still in the air and in
range matters: each step has one threshold, and the step's result for all receivers is a bitmap,
``roof >= threshold``. A scan position is then an OR of shifted bitmaps. Bit b of a word holds the
cell b bands of rows further north, so that shifting by any number of rows and columns only changes
the address.

On a raster n times finer than the map the receivers lie n subcells apart, so a ray's step looks at the same place among
n x n for all of them. It is kept as n x n rasters of the map's size (`phases`), and a step is a shift of one of them: a
map's cell costs n times the steps of a plain map, not n^3 times.

The forms by steps are shaped for a GPU: the rays of all azimuths and cells together, a few steps a turn, in loops of a
known number of turns, so that nothing waits for a result and a GPU starts a few kernels a turn. What the rays have met
stays in memory between turns: over flat ground a bit for each cell and azimuth, over terrain a byte. A CPU is many
times slower with them than with its own forms, of which the counts are the same, bit for bit.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import sequential_vmap
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, UInt

from jaxurban.programs import kept_jit

WORD_BITS = 32
# Of rays, in one turn of the loop by steps: what they have met is read and written once.
STEPS_AT_ONCE = 4
MOST_BEAMS = 250  # of Numba's form over terrain: that a byte can count, and a few
BYTE_BITS = 8  # of the words by azimuths, which are made the quicker the smaller they are
STEPS_PER_PASS = 11  # by azimuths: 11, 21 and 51 steps, of 100 m at 10, 5 and 2 m, fill whole passes or nearly so
BLOCK = (256, 512)  # most receivers taken together by azimuths, rows and columns: caches hold them
TINY_M = float(np.finfo(np.float32).tiny)  # below every roof, above the ground


def num_steps(resolution_m: float, range_m: float) -> int:
    """Return N, the number of steps whose segment begins within ``range_m``, step 0 included."""
    return math.floor(range_m / resolution_m + 0.5 + 1e-9) + 1


def ray_offsets(num_azimuths: int, steps: int) -> np.ndarray:
    """Return the cell that each step of each ray looks at, ``[K, N, 2]`` int32 rows north, columns east.

    Azimuths are equally spaced from grid north, clockwise. A point on a border between cells counts
    to the outer one (within 1e-9 of a cell, for rounding), so the offsets have the symmetry of the grid.
    """
    azimuth_rad = 2 * np.pi * np.arange(num_azimuths) / num_azimuths
    direction = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=-1)
    point = direction[:, None, :] * np.arange(steps)[None, :, None]
    return (np.sign(point) * np.floor(np.abs(point) + 0.5 + 1e-9)).astype(np.int32)


def ray_halo_cells(steps: int, per_cell: int) -> int:
    """Return how many map cells beyond a receiver's own its rays reach, for N steps of a subcell."""
    return (steps - 1 + per_cell // 2) // per_cell


def phases(supersampled: Float[Array, "nY nX"], per_cell: int) -> Float[Array, "P Y X"]:
    """Return the ``n * n`` rasters of every n-th cell; raster p begins at cell (p // n, p % n)."""
    rows, cols = (size // per_cell for size in supersampled.shape)
    split = supersampled.reshape(rows, per_cell, cols, per_cell).transpose(1, 3, 0, 2)
    return split.reshape(per_cell**2, rows, cols)


def phase_starts(
    offsets: Int[np.ndarray, "K N 2"], per_cell: int, halo: int | None = None
) -> Int[np.ndarray, "K N 3"]:
    """Return the phase, row and column that the southwest receiver looks at by each step of each ray, int32.

    Any other receiver looks at the same phase, as many rows and columns further on as it stands from that receiver.

    Args:
      offsets: from `ray_offsets`, in subcells from a receiver, which stands in the subcell (n // 2, n // 2) of its map
        cell.
      per_cell: n, subcells along a side of a map cell.
      halo: map cells that the phases reach beyond the receivers; rows and columns count from the halo's corner. Left
        out, `ray_halo_cells`.
    """
    halo = ray_halo_cells(offsets.shape[1], per_cell) if halo is None else halo
    cell, phase = np.divmod(offsets + per_cell // 2, per_cell)  # both [K, N, 2]: rows, columns
    starts = [phase[..., 0] * per_cell + phase[..., 1], cell[..., 0] + halo, cell[..., 1] + halo]
    return np.stack(starts, axis=-1).astype(np.int32)


def lowest_heights(
    altitudes_m: np.ndarray,
    elevations_rad: np.ndarray,
    resolution_m: float,
    range_m: float,
    steps: int,
) -> np.ndarray:
    """Return each beam's lowest height over each step's segment, ``[A, N, B]`` float64, above the receiver's ground.

    Args:
      altitudes_m: ``[A]`` receiver heights above its ground.
      elevations_rad: ``[B]`` beam elevations above the horizon, ascending.
      resolution_m: side of a cell.
      range_m: slant range along the beam.
      steps: N.

    A beam whose range ends before the segment begins has inf if it points up and -inf if it points
    down (the horizontal one: inf), which keeps the heights ascending from beam to beam.
    """
    step = np.arange(steps)[:, None]
    near_m = np.maximum(step - 0.5, 0.0) * resolution_m
    far_m = (step + 0.5) * resolution_m
    slope = np.tan(elevations_rad)
    reach_m = range_m * np.cos(elevations_rad)
    # A falling beam is lowest at the segment's far end, or where its range ends; a rising one at the near end.
    lowest_m = np.where(slope < 0, np.minimum(far_m, reach_m), near_m) * slope
    lowest_m = np.where(near_m <= reach_m, lowest_m, np.where(slope < 0, -np.inf, np.inf))
    return np.asarray(altitudes_m, float)[:, None, None] + lowest_m


def flat_thresholds(lowest_m: np.ndarray) -> np.ndarray:
    """Return the height of the lowest roof that returns the scan at each step over flat ground, ``[A, N]`` metres.

    It is inf where no beam is left in the air and in range, and never below `TINY_M`, so that bare ground returns
    nothing.

    Args:
      lowest_m: ``[A, N, B]`` float64 from `lowest_heights`.
    """
    landed = np.zeros_like(lowest_m, dtype=bool)
    # A beam has landed before a step if it was not above the ground at the step before: a falling beam only falls.
    landed[:, 1:] = (lowest_m <= 0)[:, :-1]
    out_of_range = np.isinf(lowest_m)
    return np.where(landed | out_of_range, np.inf, np.maximum(lowest_m, TINY_M)).min(axis=-1)


def round_up(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Return the least numbers of ``dtype`` that are not below float64 ``values``.

    For x of that type ``x >= value`` and ``x >= round_up(value)`` are the same question.
    """
    rounded = values.astype(dtype)
    return np.where(rounded < values, np.nextafter(rounded, np.asarray(np.inf, dtype)), rounded)


@partial(kept_jit, static_argnames=("halo",))
def count_returns(
    roof_m: Float[Array, "P Y+2H X+2H"],
    thresholds_m: Float[Array, "A N"],
    starts: Int[Array, "K N 3"],
    *,
    halo: int,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building, over flat ground, ``[A, Y, X]`` int32, by JAX.

    Args:
      roof_m: `phases` of roof heights with their halo, 0 without a building.
      thresholds_m: ``[A, N]`` from `flat_thresholds`, rounded up to the type of ``roof_m``.
      starts: ``[K, N, 3]`` from `phase_starts`.
      halo: H, from `ray_halo_cells`.

    Cells inside buildings get a number too (K, mostly). The form for a CPU takes no time for altitudes that no roof
    reaches. The gradient is zero.
    """
    by_steps = partial(count_returns_by_steps, halo=halo)
    by_azimuths = partial(count_returns_by_azimuths, halo=halo)
    fixed = lax.stop_gradient((roof_m, thresholds_m))
    # Under vmap the CPU takes one map after the other, since its conditions would run both of their branches.
    return lax.platform_dependent(
        *fixed, starts, cpu=sequential_vmap(by_azimuths), default=by_steps
    )


def count_returns_by_azimuths(
    roof_m: Array, thresholds_m: Array, starts: Array, *, halo: int
) -> Array:
    """Return `count_returns`, by the form for a CPU: altitude by altitude, block by block, azimuth by azimuth.

    Arguments and result are those of `count_returns`. Blocks are equal, at most `BLOCK` receivers, and their rows a
    multiple of `BYTE_BITS`; they may reach beyond the receivers in the north and the east, where roofs are 0.
    """
    shape = [size - 2 * halo for size in roof_m.shape[1:]]
    # How many blocks along each axis, then the rows and columns of receivers in a block; -(-a // b) rounds up.
    num_blocks = [-(-size // most) for size, most in zip(shape, BLOCK, strict=True)]
    rows, cols = (-(-size // num) for size, num in zip(shape, num_blocks, strict=True))
    rows = -(-rows // BYTE_BITS) * BYTE_BITS

    # Roofs padded to whole blocks, and where each block begins: phase 0, row and column.
    beyond = num_blocks[0] * rows - shape[0], num_blocks[1] * cols - shape[1]
    padded_m = jnp.pad(roof_m, ((0, 0), (0, beyond[0]), (0, beyond[1])))
    blocks = np.array([(0, *block) for block in np.ndindex(*num_blocks)], np.int32)
    corners = blocks * np.array([1, rows, cols], np.int32)

    def count_block(threshold_m: Array, corner: Array) -> Array:
        """Return the counts ``[rows, cols]`` of the block at one corner, zeros where no roof is high enough."""
        around = len(padded_m), rows + 2 * halo, cols + 2 * halo
        around_m = lax.dynamic_slice(padded_m, corner, around)
        # A step is live if a roof around the block returns the scan at it.
        highest_m = jnp.max(around_m, initial=0, where=around_m > 0)
        is_live = threshold_m <= highest_m
        return lax.cond(
            jnp.any(is_live),
            lambda: _count_block(around_m, threshold_m, is_live, starts, halo),
            lambda: jnp.zeros((rows, cols), jnp.int32),
        )

    def count_at(threshold_m: Array) -> Array:
        """Return the counts ``[Y, X]`` at one altitude, whose blocks are put side by side."""
        counts = lax.map(partial(count_block, threshold_m), corners)
        whole = counts.reshape(*num_blocks, rows, cols).swapaxes(1, 2)
        return whole.reshape(num_blocks[0] * rows, -1)[: shape[0], : shape[1]]

    return lax.map(count_at, thresholds_m)


def _count_block(
    roof_m: Array, threshold_m: Array, is_live: Array, starts: Array, halo: int
) -> Array:
    """Return how many azimuths return the scan to each receiver of a block at one altitude, ``[8 * band, x]`` int32.

    One bit for each receiver and azimuth says whether the scan has returned. A few steps at a time are made into
    bitmaps, which fit a core's cache; each azimuth then joins (ORs) the cells that it looks at in them.

    Args:
      roof_m: ``[P, Y, X]`` `phases` of the roofs over the block and its halo.
      threshold_m: ``[N]`` lowest roof that returns the scan at each step.
      is_live: ``[N]`` whether any roof is as high as that; steps before the first and after the last such step are left
        out.
      starts: ``[K, N, 3]`` from `phase_starts`.
      halo: cells beyond the block on each side.
    """
    num_azimuths, steps = starts.shape[:2]
    at_once = min(STEPS_PER_PASS, steps)
    rows, cols = (size - 2 * halo for size in roof_m.shape[1:])
    band = rows // BYTE_BITS  # rows of words: bit b of a word is the receiver b bands further north
    cut = partial(lax.dynamic_slice, allow_negative_indices=False)  # compiles sooner

    # Steps at either end that no roof is high enough for are left out, and the rest is taken a few at a time.
    first, after_last = (lax.argmax(live, 0, jnp.int32) for live in (is_live, is_live[::-1]))
    num_passes = -(-(steps - after_last - first) // at_once)  # rounded up

    def look(i: Array, returned: Array) -> Array:
        """Join what all azimuths look at in the next few steps."""
        n = jnp.minimum(first + i * at_once, steps - at_once)  # some again at the end: no harm
        bitmaps = _bitmaps(roof_m, lax.dynamic_slice_in_dim(threshold_m, n, at_once), band)
        corners = lax.dynamic_slice_in_dim(starts, n, at_once, axis=1)

        def look_along(k: Array, returned: Array) -> Array:
            """Join what azimuth k looks at: a shift by rows and columns is another corner of the same bitmap."""
            words = lax.dynamic_index_in_dim(returned, k, keepdims=False)
            for bitmap, corner in zip(bitmaps, corners[k], strict=True):
                words |= cut(bitmap, corner, (1, band, cols))[0]
            return lax.dynamic_update_index_in_dim(returned, words, k, 0)

        return lax.fori_loop(0, num_azimuths, look_along, returned)

    nothing = jnp.zeros((num_azimuths, band, cols), jnp.uint8)
    return _sum_bits(lax.fori_loop(0, num_passes, look, nothing)).reshape(rows, cols)


def _bitmaps(roof_m: Array, least_m: Array, band: int) -> Array:
    """Return bitmaps of the roofs that reach each of n heights, ``[n, P, y, X]`` bytes packed as by `pack`.

    A roof reaches a height exactly if its rank (how many of the n heights it reaches) is not below the height's rank
    (how many of the heights are not above it). So each cell's heights are compared once, and bytes are packed; the
    loop keeps XLA from finding this itself.

    Args:
      roof_m: ``[P, Y, X]`` roof heights.
      least_m: ``[n]`` heights, in any order.
      band: rows from one bit of a word to the next.
    """
    rank = sum((roof_m >= height_m).astype(jnp.uint8) for height_m in least_m)
    least_rank = jnp.sum(least_m[None] <= least_m[:, None], axis=1, dtype=jnp.uint8)
    return lax.map(lambda least: pack(rank, least, band, jnp.uint8), least_rank)


def _sum_bits(words: UInt[Array, "K y x"]) -> Int[Array, "8 y x"]:
    """Return how many of the K bytes of a word have each bit set, ``[8, y, x]`` int32; axis 0 numbers the bits.

    Bytes are added three at a time: every other bit is masked out, which leaves two bits for each sum of 0 to 3, and
    the four sums in a byte are then added to counters of 16 or 32 bits.
    """
    threes = jnp.pad(words, ((0, -len(words) % 3), (0, 0), (0, 0))).reshape(-1, 3, *words.shape[1:])
    dtype = jnp.uint16 if len(words) < 2**16 else jnp.uint32
    # The lower bit of each of the four sums in a byte.
    places = jnp.arange(0, BYTE_BITS, 2, dtype=jnp.uint8)[:, None, None]
    none = jnp.zeros((len(places), *words.shape[1:]), dtype)

    def sum_every_other(first: int) -> Array:
        """Return the counts ``[4, y, x]`` of bits ``first``, ``first + 2`` and so on."""
        one, two, three = ((threes[:, i] >> first) & 0b01010101 for i in range(3))
        total, _ = lax.scan(
            lambda total, pairs: (total + ((pairs[None] >> places) & 0b11).astype(dtype), None),
            none,
            one + two + three,
        )
        return total

    total = jnp.stack([sum_every_other(0), sum_every_other(1)], axis=1)
    return total.astype(jnp.int32).reshape(BYTE_BITS, *words.shape[1:])


def pack(
    heights_m: Float[Array, "*n Y X"],
    least_m: Float[Array, "..."],
    band: int,
    dtype: DTypeLike = jnp.uint32,
) -> UInt[Array, "*n y X"]:
    """Return ``heights_m >= least_m`` as words: bit b of word (i, j) stands for cell (i + b * band, j), b bands north.

    A word begins in each row but the last ones, from which there is no cell for every bit.

    Args:
      heights_m: ``[*n, Y, X]`` heights; also ranks of heights will do.
      least_m: what they are compared with, of a shape that broadcasts.
      band: rows from one bit to the next.
      dtype: unsigned type of the words.

    Returns:
      ``[*n, y, X]`` words, y being Y less ``band`` rows for every bit but the first.
    """
    num_bits = 8 * jnp.dtype(dtype).itemsize
    num_words = heights_m.shape[-2] - (num_bits - 1) * band
    words = jnp.zeros((*heights_m.shape[:-2], num_words, heights_m.shape[-1]), dtype)
    for bit in range(num_bits):
        rows = heights_m[..., bit * band : bit * band + num_words, :]
        words = words | ((rows >= least_m).astype(dtype) << bit)
    return words


@partial(kept_jit, static_argnames=("halo",))
def count_returns_by_steps(
    roof_m: Float[Array, "P Y+2H X+2H"],
    thresholds_m: Float[Array, "A N"],
    starts: Int[Array, "K N 3"],
    *,
    halo: int,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building, over flat ground, ``[A, Y, X]`` int32.

    Args:
      roof_m: roof heights, 0 without a building, as `phases`.
      thresholds_m: from `flat_thresholds`, rounded up to the type of ``roof_m``.
      starts: from `phase_starts`.
      halo: H, cells beyond the receivers.
    """
    rows, cols = (size - 2 * halo for size in roof_m.shape[1:])
    band = -(-rows // WORD_BITS)
    padded_m = jnp.pad(roof_m, ((0, 0), (0, WORD_BITS * band - rows), (0, 0)))

    def count_at(threshold_m: Array) -> Array:
        """Return the counts ``[Y, X]`` at one altitude, of which ``threshold_m`` ``[N]`` gives the steps' roofs."""

        def step(returned, of_step):
            """Join what all azimuths look at by one step to the bits ``[K, band, X]`` of the steps before."""
            threshold, start = of_step
            return returned | _looks(pack(padded_m, threshold, band), start, (band, cols)), None

        none = jnp.zeros((len(starts), band, cols), jnp.uint32)
        returned, _ = lax.scan(
            step, none, (threshold_m, starts.swapaxes(0, 1)), unroll=STEPS_AT_ONCE
        )
        bits = jnp.arange(WORD_BITS, dtype=jnp.uint32)[None, :, None, None]
        return jnp.sum((returned[:, None] >> bits) & 1, axis=0, dtype=jnp.int32).reshape(-1, cols)[
            :rows
        ]

    return lax.map(count_at, thresholds_m)


@partial(kept_jit, static_argnames=("halo", "receiver_phase"))
def count_returns_on_terrain_by_steps(
    roof_m: Float[Array, "P Y+2H X+2H"],
    terrain_m: Float[Array, "P Y+2H X+2H"],
    lowest_m: Float[Array, "A N B"],
    starts: Int[Array, "K N 3"],
    *,
    halo: int,
    receiver_phase: int = 0,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building before the terrain, ``[A, Y, X]`` int32.

    Args:
      roof_m: roof heights above their ground, 0 without a building, as `phases`.
      terrain_m: ground elevation, likewise.
      lowest_m: from `lowest_heights`, rounded up to the type of ``roof_m``.
      starts: from `phase_starts`.
      halo: H, cells beyond the receivers.
      receiver_phase: number of the phase whose cells hold the receivers.
    """
    shape = roof_m.shape[1] - 2 * halo, roof_m.shape[2] - 2 * halo
    own_m = terrain_m[receiver_phase, halo : halo + shape[0], halo : halo + shape[1]]
    rise_m = jnp.where(roof_m > 0, roof_m, -jnp.inf)
    num_beams = lowest_m.shape[-1]
    # A number for each ray counts how many of its lowest beams have ended; this one stands for "has returned".
    has_returned = num_beams + 1
    dtype = jnp.int8 if has_returned <= np.iinfo(np.int8).max else jnp.int32

    def count_at(beams_m: Array) -> Array:
        """Return the counts ``[Y, X]`` at one altitude, of which ``beams_m`` ``[N, B]`` gives the lowest heights."""

        def step(ended, of_step):
            """Let the rays ``[K, Y, X]`` that meet a roof by one step return, and end beams that meet the ground."""
            heights_m, start = of_step
            ground_m = _looks(terrain_m, start, shape) - own_m[None]
            top_m = ground_m + _looks(rise_m, start, shape)
            num_met = _num_not_above(heights_m, top_m, dtype)
            num_landed = _num_not_above(heights_m, ground_m, dtype)
            # Beams of height -inf are out of range: those that fall most, so the lowest ones.
            ended = jnp.maximum(ended, jnp.sum(heights_m == -jnp.inf, dtype=dtype))
            is_met = (num_met > ended) & (top_m > -jnp.inf)
            ended = jnp.maximum(ended, num_landed)
            return jnp.where(is_met, jnp.asarray(has_returned, dtype), ended), None

        none = jnp.zeros((len(starts), *shape), dtype)
        ended, _ = lax.scan(step, none, (beams_m, starts.swapaxes(0, 1)), unroll=STEPS_AT_ONCE)
        return jnp.sum(ended == has_returned, axis=0, dtype=jnp.int32)

    return lax.map(count_at, lowest_m)


def _looks(rasters: Array, start: Array, shape: tuple[int, int]) -> Array:
    """Return the values of ``[P, Y, X]`` rasters at the cells that receivers look at by one step, ``[K, *shape]``."""

    def look(corner: Array) -> Array:
        return lax.dynamic_slice(rasters, tuple(corner), (1, *shape))[0]

    return jax.vmap(look)(start)


def _num_not_above(heights_m: Array, level_m: Array, dtype: jnp.dtype) -> Array:
    """Return how many beams, ``[B]``, are not above a level."""
    count = jnp.zeros(level_m.shape, dtype)
    for height_m in heights_m:
        count = count + (height_m <= level_m).astype(dtype)
    return count
