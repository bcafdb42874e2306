"""Rays over terrain, followed for the receivers of a part of a tile together.

A byte for each ray and receiver holds how many of its lowest beams the ground has ended, or `RETURNED`. At each look
the heights are compared with a few beams at once, those that receivers may have lost and the next ones, and give for
each receiver how many beams are not above the roof and how many are not above the ground. A beam still in the air
meets the roof where the first number is above the ray's byte; the second then raises the byte.

Legend: ``K`` azimuths, ``N`` steps, ``B`` beams, ``U`` looks, ``P`` phases, ``h, w`` cells around the tile, ``r, c``
receivers of the part, see `jaxurban.kernels.lidar.terrain_cpu`.
"""

from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled

PART_COLUMNS = 64  # of receivers taken together: the bytes of their rays fit a core's cache
MOST_BEAMS = 250  # that a byte can count, and a few
BEAMS_AT_ONCE = 4
RETURNED = np.uint8(255)
BLOCK = 8  # cells along each side of those whose highest is known


class Looks(NamedTuple):
    """The different looks of all rays: each a step and a cell, ``U`` of them, in order of steps.

    Attributes:
      start: ``[U, 3]`` int32 phase, row and column, as of `jaxurban.kernels.lidar.supersampled.phase_starts`.
      first_of_step: ``[N + 1]`` int32 where the looks of each step begin.
      ray: ``[K * N]`` int32 azimuths in order of their looks.
      first_ray: ``[U + 1]`` int32 where the azimuths of each look begin in ``ray``.
    """

    start: np.ndarray
    first_of_step: np.ndarray
    ray: np.ndarray
    first_ray: np.ndarray


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
            h = heights_m[n, low : low + BEAMS_AT_ONCE]
            if may_meet and may_land:
                _count_both(met, landed, own_m, ground_m[p], rise_m[p], at, h, low)
            elif may_meet:
                _count_met(met, own_m, ground_m[p], rise_m[p], at, h, low)
            elif may_land:
                _count_landed(landed, own_m, ground_m[p], at, h, low)
            if may_meet:
                most_met = _range(flat_met)[1]
                more = low + BEAMS_AT_ONCE
                while most_met == more and more <= high:
                    h = heights_m[n, more : more + BEAMS_AT_ONCE]
                    _count_met(spare, own_m, ground_m[p], rise_m[p], at, h, more)
                    _keep_higher(flat_met, flat_spare, more)
                    most_met = _range(flat_met)[1]
                    more += BEAMS_AT_ONCE
            if may_land:
                least_landed, most_landed = _range(flat_landed)
                more = low + BEAMS_AT_ONCE
                while most_landed == more:
                    h = heights_m[n, more : more + BEAMS_AT_ONCE]
                    _count_landed(spare, own_m, ground_m[p], at, h, more)
                    _keep_higher(flat_landed, flat_spare, more)
                    least_landed, most_landed = _range(flat_landed)
                    more += BEAMS_AT_ONCE
            for r in range(first_ray[u], first_ray[u + 1]):
                k = rays[r]
                if most_met > for_all[k]:
                    if most_landed > for_all[k]:
                        _meet_and_land(flat[k], flat_met, flat_landed)
                    else:
                        _meet(flat[k], flat_met)
                elif most_landed > for_all[k]:
                    _land(flat[k], flat_landed)
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
def _count_both(met, landed, own_m, ground_m, rise_m, at, heights_m, below):
    """Fill how many beams are not above the roof, and how many not above the ground, that each receiver looks at."""
    (row, col), (h0, h1, h2, h3) = at, (heights_m[0], heights_m[1], heights_m[2], heights_m[3])
    for i in range(met.shape[0]):
        own, of_met, of_landed = own_m[i], met[i], landed[i]
        grounds, rises = ground_m[row + i, col : col + len(own)], rise_m[row + i, col : col + len(own)]
        for j in range(len(own)):
            level_m = grounds[j] - own[j]
            of_landed[j] = _num_not_above(h0, h1, h2, h3, level_m, below)
            of_met[j] = _num_not_above(h0, h1, h2, h3, level_m + rises[j], below)


@compiled(nogil=True)
def _count_met(met, own_m, ground_m, rise_m, at, heights_m, below):
    """Fill how many beams are not above the roof that each receiver looks at."""
    (row, col), (h0, h1, h2, h3) = at, (heights_m[0], heights_m[1], heights_m[2], heights_m[3])
    for i in range(met.shape[0]):
        own, of_met = own_m[i], met[i]
        grounds, rises = ground_m[row + i, col : col + len(own)], rise_m[row + i, col : col + len(own)]
        for j in range(len(own)):
            of_met[j] = _num_not_above(h0, h1, h2, h3, (grounds[j] - own[j]) + rises[j], below)


@compiled(nogil=True)
def _count_landed(landed, own_m, ground_m, at, heights_m, below):
    """Fill how many beams are not above the ground that each receiver looks at."""
    (row, col), (h0, h1, h2, h3) = at, (heights_m[0], heights_m[1], heights_m[2], heights_m[3])
    for i in range(landed.shape[0]):
        own, of_landed = own_m[i], landed[i]
        grounds = ground_m[row + i, col : col + len(own)]
        for j in range(len(own)):
            of_landed[j] = _num_not_above(h0, h1, h2, h3, grounds[j] - own[j], below)


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
def _meet(state, met):
    """Let the rays of receivers return whose beams still in the air meet a roof."""
    for i in range(len(state)):
        state[i] = RETURNED if met[i] > state[i] else state[i]


@compiled(nogil=True)
def _meet_and_land(state, met, landed):
    """Let rays return, and the ground end the beams of the others."""
    for i in range(len(state)):
        before = state[i]
        after = landed[i] if landed[i] > before else before
        state[i] = RETURNED if met[i] > before else after


@compiled(nogil=True)
def _land(state, landed):
    """Let the ground end beams."""
    for i in range(len(state)):
        state[i] = landed[i] if landed[i] > state[i] else state[i]


@compiled(nogil=True)
def _raise(state, least):
    """End the lowest beams of all receivers."""
    for i in range(len(state)):
        state[i] = least if least > state[i] else state[i]
