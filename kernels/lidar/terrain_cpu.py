"""Lidar scan returns over terrain on a CPU: tile by tile, so that what its rays look at lies in a core's cache.

The stepping rule of `jaxurban.kernels.lidar.hard`, the ground ending beams as well: what a receiver sees depends on its
own ground, and a beam ends where its lowest height over a segment is not above the terrain of the cell looked at.

Rays are followed for the receivers of a part of a tile together, as far as some beam can meet what is highest around
the tile. A byte for each ray and receiver holds how many of its lowest beams the ground has ended, or `RETURNED`. At
each look the heights are compared with a few beams at once, those that receivers may have lost and the next ones, and
give for each receiver how many beams are not above the roof and how many are not above the ground. A beam still in the
air meets the roof where the first number is above the ray's byte; the second then raises the byte.

Legend: ``K`` azimuths, ``N`` steps, ``B`` beams, ``U`` looks, ``P`` phases, ``Y, X`` cells and their halo, ``y, x``
receivers, ``h, w`` cells around a tile, ``r, c`` receivers of a part of it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.kernels.compiled import compiled, on_host
from jaxurban.kernels.lidar.flat_cpu import side_of_tiles

TILE = (32, 256)  # receivers taken together
PART_COLUMNS = 64  # of receivers taken together: the bytes of their rays fit a core's cache
MOST_BEAMS = 250  # that a byte can count, and a few
BEAMS_AT_ONCE = 4
RETURNED = np.uint8(255)
BLOCK = 8  # cells along each side of those whose highest is known


class Looks(NamedTuple):
    """The different looks of all rays: each a step and a cell, ``U`` of them, in order of steps.

    Attributes:
      start: ``[U, 3]`` int32 phase, row and column, as of `jaxurban.kernels.lidar.hard.phase_starts`.
      first_of_step: ``[N + 1]`` int32 where the looks of each step begin.
      ray: ``[K * N]`` int32 azimuths in order of their looks.
      first_ray: ``[U + 1]`` int32 where the azimuths of each look begin in ``ray``.
    """

    start: np.ndarray
    first_of_step: np.ndarray
    ray: np.ndarray
    first_ray: np.ndarray


def distinct_looks(starts: Int[np.ndarray, "K N 3"]) -> Looks:
    """Return the looks of rays, those that several rays share once."""
    num_steps = starts.shape[1]
    sides = (num_steps, *(starts.max(axis=(0, 1)) + 1))
    steps = np.broadcast_to(np.arange(num_steps), starts.shape[:2])
    of_ray = np.ravel_multi_index((steps, *np.moveaxis(starts, -1, 0)), sides).ravel()
    order = np.argsort(of_ray, kind="stable")
    look, first = np.unique(of_ray[order], return_index=True)
    step, *start = np.unravel_index(look, sides)
    first_of_step = np.searchsorted(step, np.arange(num_steps + 1))
    parts = np.stack(start, axis=-1), first_of_step, order // num_steps, np.append(first, of_ray.size)
    return Looks(*(np.ascontiguousarray(part, np.int32) for part in parts))


def count_on_terrain_on_host(
    roof_m: Float[Array | np.ndarray, "P Y X"],
    terrain_m: Float[Array | np.ndarray, "P Y X"],
    lowest_m: Float[Array | np.ndarray, "A N B"],
    starts: Int[np.ndarray, "K N 3"],
    halo: int,
    receiver_phase: int = 0,
) -> Int[np.ndarray, "A y x"]:
    """Return how many of K scan positions meet a building before the terrain, ``[A, y, x]`` int32.

    Receivers stand ``altitude`` above their own cell's terrain, roofs ``roof_m`` above theirs. Over constant terrain
    these are the counts over flat ground.

    Args:
      roof_m: roof heights above their ground, 0 without a building, as `jaxurban.kernels.lidar.hard.phases`.
      terrain_m: ground elevation, likewise.
      lowest_m: from `jaxurban.kernels.lidar.hard.lowest_heights`, rounded up to the type of ``roof_m``; of `MOST_BEAMS`
        at most.
      starts: from `jaxurban.kernels.lidar.hard.phase_starts`.
      halo: cells beyond the receivers.
      receiver_phase: the phase in which receivers stand.
    """
    looks = distinct_looks(starts)
    roofs, grounds, beams = (on_host(values) for values in (roof_m, terrain_m, lowest_m))
    counts = np.zeros((len(beams), *(size - 2 * halo for size in roofs.shape[1:])), np.int32)
    for k in range(len(beams)):
        count_on_terrain(roofs, grounds, beams[k], looks, len(starts), halo, receiver_phase, counts[k])
    return counts


@compiled(nogil=True)
def count_on_terrain(roof_m, terrain_m, lowest_m, looks, num_azimuths, halo, phase, counts):
    """Fill ``counts`` ``[y, x]`` int32 at one altitude; 0 in it before.

    Args:
      roof_m: ``[P, Y, X]`` roof heights above their ground, 0 without a building.
      terrain_m: ``[P, Y, X]`` ground elevation, of the same type.
      lowest_m: ``[N, B]`` each beam's lowest height over each step's segment, of the same type, ascending with B.
      looks: of all rays.
      num_azimuths: K.
      halo: cells beyond the receivers.
      phase: the one in which receivers stand.
      counts: the result.
    """
    kind = roof_m.dtype.type
    num_rows, num_cols = counts.shape
    rows, cols = side_of_tiles(num_rows, TILE[0], 1), side_of_tiles(num_cols, TILE[1], PART_COLUMNS)
    num_steps, num_beams = lowest_m.shape
    around = (len(roof_m), rows + 2 * halo, cols + 2 * halo)
    ground_m, rise_m = np.empty(around, kind), np.empty(around, kind)
    own_m = np.empty((rows, cols), kind)
    states = np.empty((num_azimuths, rows, PART_COLUMNS), np.uint8)
    out_of_range = np.zeros(num_steps, np.int64)
    lowest_flown_m = np.full(num_steps, np.inf)
    heights_m = np.full((num_steps, num_beams + 2 * BEAMS_AT_ONCE), np.inf).astype(kind)
    heights_m[:, :num_beams] = lowest_m
    for n in range(num_steps):
        for height_m in lowest_m[n]:
            out_of_range[n] += height_m == -np.inf
            if abs(height_m) < np.inf:
                lowest_flown_m[n] = min(lowest_flown_m[n], height_m)

    for row in range(0, num_rows, rows):
        for col in range(0, num_cols, cols):
            _cut(ground_m, rise_m, terrain_m, roof_m, row, col)
            for i in range(rows):
                for j in range(cols):
                    own_m[i, j] = ground_m[phase, halo + min(i, num_rows - row - 1), halo + min(j, num_cols - col - 1)]
            top_m = highest_of_blocks(ground_m, rise_m, np.nanmin(own_m))[1].max()
            end = num_steps
            while end > 0 and not lowest_flown_m[end - 1] <= top_m:
                end -= 1
            found = counts[row : row + rows, col : col + cols]
            for part in range(0, found.shape[1] if end > 0 else 0, PART_COLUMNS):
                part_m = own_m[:, part : part + PART_COLUMNS].copy()
                counted = found[:, part : part + PART_COLUMNS]
                march(counted, states, ground_m, rise_m, part_m, part, looks, heights_m, out_of_range, end)


@compiled(nogil=True)
def _cut(ground_m, rise_m, terrain_m, roof_m, row, col):
    """Fill the heights around a tile; where there is no roof it rises by -inf, and beyond the raster the ground too."""
    none = -roof_m.dtype.type(np.inf)
    high, wide = min(ground_m.shape[1], roof_m.shape[1] - row), min(ground_m.shape[2], roof_m.shape[2] - col)
    ground_m[:, high:], rise_m[:, high:] = none, none
    ground_m[:, :, wide:], rise_m[:, :, wide:] = none, none
    for p in range(len(ground_m)):
        for i in range(high):
            ground_m[p, i, :wide] = terrain_m[p, row + i, col : col + wide]
            roofs, rises = roof_m[p, row + i, col : col + wide], rise_m[p, i]
            for j in range(wide):
                rises[j] = roofs[j] if roofs[j] > 0 else none


@compiled(nogil=True)
def march(counts, states, ground_m, rise_m, own_m, column, looks, heights_m, out_of_range, end):
    """Fill ``counts`` of the receivers of a part, int32, some of which may lie beyond its last row and column.

    Args:
      counts: the result.
      states: ``[K, r, c]`` uint8, overwritten.
      ground_m: ``[P, h, w]`` ground elevation around the tile, -inf beyond the raster.
      rise_m: ``[P, h, w]`` how far roofs rise above it, -inf where there is none.
      own_m: ``[r, c]`` the receivers' own ground.
      column: first column of the part in the tile.
      looks: of all rays.
      heights_m: ``[N, B + 2 * BEAMS_AT_ONCE]`` each beam's lowest height over each step's segment, then inf.
      out_of_range: ``[N]`` lowest beams whose range has ended.
      end: step before which they are followed.
    """
    start, first_look, rays, first_ray = looks
    num_azimuths, (rows, wide) = len(states), own_m.shape
    states[:] = np.uint8(out_of_range[0])
    flat = states.reshape(num_azimuths, rows * wide)
    for_all = np.full(num_azimuths, out_of_range[0])
    for_any = for_all.copy()
    base_m = np.nanmin(own_m)
    highest_m, top_m = highest_of_blocks(ground_m, rise_m, base_m)
    met, landed = np.empty((rows, wide), np.uint8), np.empty((rows, wide), np.uint8)
    spare = np.empty((rows, wide), np.uint8)
    flat_met, flat_landed, flat_spare = met.reshape(-1), landed.reshape(-1), spare.reshape(-1)
    for n in range(end):
        if n > 0 and out_of_range[n] > out_of_range[n - 1]:
            for k in range(num_azimuths):
                if for_all[k] < out_of_range[n]:
                    for_all[k] = out_of_range[n]
                    for_any[k] = max(for_any[k], out_of_range[n])
                    _raise(flat[k], np.uint8(out_of_range[n]))
        for u in range(first_look[n], first_look[n + 1]):
            p, row, col = start[u, 0], start[u, 1], start[u, 2] + column
            at = row, col
            low, high = MOST_BEAMS, 0
            for r in range(first_ray[u], first_ray[u + 1]):
                low, high = min(low, for_all[rays[r]]), max(high, for_any[rays[r]])
            most_met, least_landed, most_landed = low, low, low
            may_meet = heights_m[n, low] <= _highest_in(top_m[p], row, col, rows, wide)
            may_land = heights_m[n, low] <= _highest_in(highest_m[p], row, col, rows, wide)
            if may_meet or may_land:
                h = heights_m[n, low : low + BEAMS_AT_ONCE]
                _count(met, landed, own_m, ground_m[p], rise_m[p], at, h, low, may_meet, may_land)
            more = low + BEAMS_AT_ONCE
            if may_meet:
                most_met = _range(flat_met)[1]
                while most_met == more and more <= high:
                    h = heights_m[n, more : more + BEAMS_AT_ONCE]
                    _count(spare, spare, own_m, ground_m[p], rise_m[p], at, h, more, True, False)
                    _keep_higher(flat_met, flat_spare, more)
                    most_met = _range(flat_met)[1]
                    more += BEAMS_AT_ONCE
            more = low + BEAMS_AT_ONCE
            if may_land:
                least_landed, most_landed = _range(flat_landed)
                while most_landed == more:
                    h = heights_m[n, more : more + BEAMS_AT_ONCE]
                    _count(spare, spare, own_m, ground_m[p], rise_m[p], at, h, more, False, True)
                    _keep_higher(flat_landed, flat_spare, more)
                    least_landed, most_landed = _range(flat_landed)
                    more += BEAMS_AT_ONCE
            for r in range(first_ray[u], first_ray[u + 1]):
                k = rays[r]
                if most_met > for_all[k] or most_landed > for_all[k]:
                    _end(flat[k], flat_met, flat_landed, most_met > for_all[k], most_landed > for_all[k])
                for_all[k], for_any[k] = max(for_all[k], least_landed), max(for_any[k], most_landed)
    found = np.zeros(rows * wide, np.int32)
    for k in range(num_azimuths):
        _tally(found, flat[k])
    counts[:] = found.reshape(rows, wide)[: counts.shape[0], : counts.shape[1]]


@compiled(nogil=True)
def _tally(found, state):
    """Add one to the receivers that a ray returns to."""
    for i in range(len(state)):
        found[i] += np.int32(1) if state[i] == RETURNED else np.int32(0)


@compiled(nogil=True)
def highest_of_blocks(ground_m, rise_m, base_m):
    """Return how far any ground, and any roof, of each block of cells lies above a level; exact bounds."""
    kind = ground_m.dtype.type
    shape = (len(ground_m), ground_m.shape[1] // BLOCK + 1, ground_m.shape[2] // BLOCK + 1)
    highest_m, top_m = np.full(shape, -np.inf).astype(kind), np.full(shape, -np.inf).astype(kind)
    for p in range(len(ground_m)):
        for i in range(ground_m.shape[1]):
            of_ground, of_top = highest_m[p, i // BLOCK], top_m[p, i // BLOCK]
            grounds, rises = ground_m[p, i], rise_m[p, i]
            for j in range(len(grounds)):
                ground = grounds[j] - base_m
                top = ground + rises[j]
                of_ground[j // BLOCK] = ground if ground > of_ground[j // BLOCK] else of_ground[j // BLOCK]
                of_top[j // BLOCK] = top if top > of_top[j // BLOCK] else of_top[j // BLOCK]
    return highest_m, top_m


@compiled(nogil=True)
def _highest_in(of_blocks, row, col, rows, cols):
    """Return the highest of the blocks that a window touches."""
    highest = of_blocks[row // BLOCK, col // BLOCK]
    for i in range(row // BLOCK, (row + rows - 1) // BLOCK + 1):
        for j in range(col // BLOCK, (col + cols - 1) // BLOCK + 1):
            highest = of_blocks[i, j] if of_blocks[i, j] > highest else highest
    return highest


@compiled(nogil=True)
def _count(met, landed, own_m, ground_m, rise_m, at, heights_m, below, meets, lands):
    """Fill how many beams are not above the roof, and how many not above the ground, that each receiver looks at."""
    (row, col), (h0, h1, h2, h3) = at, (heights_m[0], heights_m[1], heights_m[2], heights_m[3])
    for i in range(met.shape[0]):
        own, of_met, of_landed = own_m[i], met[i], landed[i]
        grounds, rises = ground_m[row + i, col : col + len(own)], rise_m[row + i, col : col + len(own)]
        for j in range(len(own)):
            level_m = grounds[j] - own[j]
            if lands:
                of_landed[j] = _num_not_above(h0, h1, h2, h3, level_m, below)
            if meets:
                of_met[j] = _num_not_above(h0, h1, h2, h3, level_m + rises[j], below)


@compiled(nogil=True)
def _num_not_above(h0, h1, h2, h3, level_m, below):
    """Return how many beams are not above a level, those below and four more."""
    more = np.int32(h0 <= level_m) + np.int32(h1 <= level_m) + np.int32(h2 <= level_m) + np.int32(h3 <= level_m)
    return np.uint8(np.int32(below) + more)


@compiled(nogil=True)
def _keep_higher(values, others, least):
    """Take the others' values where they are above a least one."""
    for i in range(len(values)):
        values[i] = others[i] if others[i] > least else values[i]


@compiled(nogil=True)
def _range(values):
    """Return the least and the highest of bytes."""
    least, most = np.uint8(255), np.uint8(0)
    for i in range(len(values)):
        least = values[i] if values[i] < least else least
        most = values[i] if values[i] > most else most
    return np.int64(least), np.int64(most)


@compiled(nogil=True)
def _end(state, met, landed, meets, lands):
    """Let the rays of receivers return whose beams still in the air meet a roof; the ground ends others' beams."""
    for i in range(len(state)):
        before = state[i]
        after = landed[i] if lands and landed[i] > before else before
        state[i] = RETURNED if meets and met[i] > before else after


@compiled(nogil=True)
def _raise(state, least):
    """End the lowest beams of all receivers."""
    for i in range(len(state)):
        state[i] = least if least > state[i] else state[i]
