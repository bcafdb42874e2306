"""Lidar scan returns over terrain: the stepping rule of `lidar.flat`, the ground ending beams as well.

The thresholds of a step depend on the receiver's own ground, so they are compared cell by cell, and a receiver may
lose its lowest beams to the ground. Receivers are taken tile by tile. As long as no receiver of a tile has lost a
beam, the result of a step depends on the cell looked at alone: it is made once for all azimuths that look there (at
5 m and a range of 100 m, 21 x 360 steps look at about 1,300 cells) and kept as bits. Only beyond the first step at
which the ground ends a beam are rays marched, and then no more beams compared than any receiver can have lost.
Steps at which no roof and no ground around the tile comes up to the lowest beam are left out.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

WORD_BITS = 32
TILE = (32, 128)  # receivers taken together: what they need fits a core's cache; rows a multiple of 32
BEAMS_AT_ONCE = 4  # programs are made for 4, 8, 12 ... beams compared


class Looks(NamedTuple):
    """The different looks of all rays: each a step and a cell, ``U`` of them, in order of steps.

    Attributes:
      step: ``[U]`` int32.
      start: ``[U, 3]`` int32 phase, row and column, as of `jaxurban.kernels.lidar.supersampled.phase_starts`.
      of_ray: ``[K, N]`` int32 look of each step of each ray.
    """

    step: np.ndarray
    start: np.ndarray
    of_ray: np.ndarray


def distinct_looks(starts: Int[np.ndarray, "K N 3"]) -> Looks:
    """Return the looks of rays, those that several rays share once."""
    steps = np.broadcast_to(np.arange(starts.shape[1])[None, :, None], (*starts.shape[:2], 1))
    rows, of_ray = np.unique(np.concatenate([steps, starts], -1).reshape(-1, 4), axis=0, return_inverse=True)
    rows = rows.astype(np.int32)
    return Looks(rows[:, 0], rows[:, 1:], of_ray.reshape(starts.shape[:2]).astype(np.int32))


@partial(jax.jit, static_argnames=("halo", "receiver_phase"))
def count_returns_on_terrain(
    roof_m: Float[Array, "P Y+2H X+2H"],
    terrain_m: Float[Array, "P Y+2H X+2H"],
    lowest_m: Float[Array, "A N B"],
    looks: Looks,
    *,
    halo: int,
    receiver_phase: int = 0,
) -> Int[Array, "A Y X"]:
    """Return how many of K scan positions meet a building before the terrain, ``[A, Y, X]`` int32.

    Receivers stand ``altitude`` above their own cell's terrain, roofs ``roof_m`` above theirs. A beam
    ends where its lowest height over a segment is not above the terrain of the cell looked at. Equals
    `jaxurban.kernels.lidar.flat.count_returns` over constant terrain. The gradient is zero.

    Args:
      roof_m: roof heights above their ground, 0 without a building, as `jaxurban.kernels.lidar.supersampled.phases`.
      terrain_m: ground elevation, likewise.
      lowest_m: ``[A, N, B]`` from `jaxurban.kernels.lidar.flat.lowest_heights`, rounded up to the type of ``roof_m``.
      looks: from `distinct_looks`.
      halo: H, cells beyond the receivers.
      receiver_phase: the phase in which receivers stand.
    """
    rows, cols = (size - 2 * halo for size in roof_m.shape[1:])
    tile = TILE[0], min(TILE[1], cols)
    short = max(0, tile[0] - rows)  # a low map is filled up to a tile
    roof_m, terrain_m = (jnp.pad(raster, ((0, 0), (0, short), (0, 0)), mode="edge") for raster in (roof_m, terrain_m))
    shape = rows + short, cols
    tiles = [-(-size // side) for side, size in zip(tile, shape, strict=True)]

    def count_at(beams_m: jax.Array) -> jax.Array:
        def fill(i, counts):
            # The last tiles lap over the ones before.
            corner = [
                jnp.minimum(at * side, size - side)
                for at, side, size in zip((i // tiles[1], i % tiles[1]), tile, shape, strict=True)
            ]
            around = (len(roof_m), *(side + 2 * halo for side in tile))
            roof, terrain = (lax.dynamic_slice(raster, (0, *corner), around) for raster in (roof_m, terrain_m))
            own_m = terrain[receiver_phase, halo : halo + tile[0], halo : halo + tile[1]]
            found = _count_tile(roof, terrain, own_m, beams_m, looks)
            return lax.dynamic_update_slice(counts, found, tuple(corner))

        return lax.fori_loop(0, tiles[0] * tiles[1], fill, jnp.zeros(shape, jnp.int32))

    return lax.map(count_at, lowest_m)[:, :rows]


def _pack(met: jax.Array) -> jax.Array:
    """Return bits as words: bit b of word (i, j) is that of (i + b * band, j)."""
    band = met.shape[0] // WORD_BITS
    words = [met[b * band : (b + 1) * band].astype(jnp.uint32) << b for b in range(WORD_BITS)]
    return sum(words, jnp.zeros((), jnp.uint32))


def _unpack(words: jax.Array) -> jax.Array:
    """Return the bits of words, 0 or 1 as int32."""
    bits = (words[None] >> jnp.arange(WORD_BITS, dtype=jnp.uint32)[:, None, None]) & 1
    return bits.reshape(-1, words.shape[1]).astype(jnp.int32)


def _num_not_above(heights_m: jax.Array, level_m: jax.Array, most: int) -> jax.Array:
    """Return how many of the lowest ``most`` beams are not above a level."""
    count = jnp.zeros(level_m.shape, jnp.int32)
    for beam in range(most):
        count = count + (heights_m[beam] <= level_m)
    return count


def _count_tile(
    roof_m: jax.Array, terrain_m: jax.Array, own_m: jax.Array, beams_m: jax.Array, looks: Looks
) -> jax.Array:
    """Return the counts of one tile of receivers, given the rasters around it."""
    (num_steps, num_beams), tile = beams_m.shape, own_m.shape
    look_step, look_start, look_of_ray = (jnp.asarray(part) for part in looks)
    top_m = terrain_m + roof_m
    rise_m = jnp.min(jnp.where(jnp.isinf(beams_m), jnp.inf, beams_m), axis=1) + jnp.min(own_m)
    meets_any = rise_m <= jnp.max(top_m)
    meets_roof = rise_m <= jnp.max(jnp.where(roof_m > 0, top_m, -jnp.inf))
    first = lax.argmax(meets_any, 0, jnp.int32)
    end = jnp.where(meets_roof.any(), num_steps - lax.argmax(meets_roof[::-1], 0, jnp.int32), 0)
    num_out_of_range = jnp.sum(beams_m == -jnp.inf, axis=1, dtype=jnp.int32)  # never falls from step to step
    past_last_m = jnp.concatenate([beams_m, jnp.full((num_steps, 1), jnp.inf, beams_m.dtype)], axis=1)
    lowest_m = jnp.take_along_axis(past_last_m, num_out_of_range[:, None], axis=1)[:, 0]

    def cells_at(start):
        roof, ground = (lax.dynamic_slice(raster, tuple(start), (1, *tile))[0] for raster in (roof_m, terrain_m))
        return roof, ground - own_m

    def look(u, state):
        words, num_ended = state
        roof, ground = cells_at(look_start[u])
        n = look_step[u]
        met = _pack((roof > 0) & (ground + roof >= lowest_m[n]))
        ended = _num_not_above(beams_m[n], jnp.max(ground), num_beams)
        return words.at[u].set(met), num_ended.at[u].set(ended)

    num_looks = len(look_step)
    first_look, end_look = (jnp.searchsorted(look_step, n).astype(jnp.int32) for n in (first, end))
    words, num_ended = lax.fori_loop(
        first_look,
        end_look,
        look,
        (
            jnp.zeros((num_looks, tile[0] // WORD_BITS, tile[1]), jnp.uint32),
            jnp.zeros(num_looks, jnp.int32),  # most beams that the ground has ended in the cell looked at
        ),
    )
    steps = jnp.arange(num_steps)
    is_ending = (num_ended[look_of_ray] > num_out_of_range) & (steps >= first)  # [K, N]
    first_ending = jnp.minimum(jnp.where(is_ending.any(1), jnp.argmax(is_ending, axis=1), num_steps), end)

    def march(most: int):
        def look_on(n, ended, roof, ground):
            ended = jnp.maximum(ended, num_out_of_range[n])
            met = (roof > 0) & (_num_not_above(beams_m[n], ground + roof, most) > ended)
            return _pack(met), jnp.maximum(ended, _num_not_above(beams_m[n], ground, most))

        return look_on

    marches = [march(min(b + BEAMS_AT_ONCE, num_beams)) for b in range(0, num_beams, BEAMS_AT_ONCE)]

    def add_azimuth(k, count):
        def add_look(n, returned):
            return returned | words[look_of_ray[k, n]]

        def step(n, state):
            returned, ended, most = state
            u = look_of_ray[k, n]
            most = jnp.maximum(jnp.maximum(most, num_ended[u]), num_out_of_range[n])
            # Beams compared: those that a receiver may have lost, and one more.
            which = jnp.minimum(most // BEAMS_AT_ONCE, len(marches) - 1)
            met, ended = lax.switch(which, marches, n, ended, *cells_at(look_start[u]))
            return returned | met, ended, most

        returned = lax.fori_loop(first, first_ending[k], add_look, jnp.zeros(words.shape[1:], jnp.uint32))
        start = returned, jnp.zeros(tile, jnp.int32), jnp.int32(0)
        return count + _unpack(lax.fori_loop(first_ending[k], end, step, start)[0])

    return lax.fori_loop(0, len(look_of_ray), add_azimuth, jnp.zeros(tile, jnp.int32))
