"""Lidar scan returns over terrain on a CPU: tile by tile, so that what its rays look at lies in a core's cache.

The stepping rule of `jaxurban.kernels.lidar.hard`, the ground ending beams as well: what a receiver sees depends on its
own ground, and a beam ends where its lowest height over a segment is not above the terrain of the cell looked at.

A byte for each ray and receiver holds how many of its lowest beams the ground has ended, or `RETURNED`. At each look
it is counted for each receiver of the tile how many beams are not above the roof, and how many not above the ground. A
beam still in the air meets the roof where the first number is above the ray's byte; the second then raises the byte.

Legend: ``K`` azimuths, ``N`` steps, ``B`` beams, ``U`` looks, ``P`` phases, ``Y, X`` cells and their halo, ``y, x``
receivers, ``h, w`` cells around a tile, ``r, c`` receivers of it.
"""

import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.lidar.hard import MOST_BEAMS

TILE = (32, 64)  # receivers taken together: the bytes of their rays fit a core's cache
RETURNED = np.uint8(255)
AT_ONCE = 4  # beams compared in one pass
BLOCK = 8  # cells along each side of those whose highest is known: looks at lower ones are left out


def count_on_terrain_on_host(
    roof_m: Float[Array | np.ndarray, "P Y X"],
    terrain_m: Float[Array | np.ndarray, "P Y X"],
    lowest_m: Float[Array | np.ndarray, "A N B"],
    starts: Int[np.ndarray, "K N 3"],
    halo: int,
    receiver_phase: int = 0,
) -> Int[np.ndarray, "A y x"]:
    """Return how many of K scan positions meet a building before the terrain, ``[A, y, x]`` int32.

    Receivers stand at their altitude above the terrain of their own cell, roofs at ``roof_m`` above the terrain of
    theirs. Over constant terrain these are the counts over flat ground.

    Args:
      roof_m: roof heights above their ground, 0 without a building, as `jaxurban.kernels.lidar.hard.phases`.
      terrain_m: ground elevation, likewise.
      lowest_m: from `jaxurban.kernels.lidar.hard.lowest_heights`, rounded up to the type of ``roof_m``; B is at most
        `MOST_BEAMS`.
      starts: from `jaxurban.kernels.lidar.hard.phase_starts`.
      halo: cells beyond the receivers.
      receiver_phase: the phase in which receivers stand.
    """
    # Rays that look at the same cell by the same step share one look: (step, phase, row, column).
    num_azimuths, num_steps = starts.shape[:2]
    steps = np.broadcast_to(np.arange(num_steps)[:, None], (num_azimuths, num_steps, 1))
    every_look = np.concatenate([steps, starts], axis=-1).reshape(-1, 4)
    looks, look_of_ray, num_rays = np.unique(
        every_look, axis=0, return_inverse=True, return_counts=True
    )
    rays = np.argsort(look_of_ray.ravel(), kind="stable") // num_steps
    first_ray = np.append(0, np.cumsum(num_rays))
    roofs_m, grounds_m = np.asarray(roof_m), np.asarray(terrain_m)
    # Beams of height inf meet nothing: they fill the last group of `AT_ONCE` up.
    beams_m = np.pad(np.asarray(lowest_m), ((0, 0), (0, 0), (0, AT_ONCE)), constant_values=np.inf)
    counts = np.zeros((len(beams_m), *(size - 2 * halo for size in roofs_m.shape[1:])), np.int32)
    num_rows, num_cols = counts.shape[1:]

    for row in range(0, num_rows, TILE[0]):
        for col in range(0, num_cols, TILE[1]):
            tile = counts[:, row : row + TILE[0], col : col + TILE[1]]
            rows, cols = tile.shape[1:]
            row_end, col_end = row + rows + 2 * halo, col + cols + 2 * halo
            around = np.s_[:, row:row_end, col:col_end]
            ground_m, rise_m = grounds_m[around].copy(), roofs_m[around].copy()
            rise_m[~(rise_m > 0)] = -np.inf
            own_m = ground_m[receiver_phase, halo : halo + rows, halo : halo + cols].copy()

            # The highest ground and roof of each block of cells; fmin and fmax leave NaN out.
            level_m = ground_m - np.fmin.reduce(own_m, axis=None)
            highest_m = np.fmax([level_m, level_m + rise_m], -np.inf)
            for axis in (2, 3):
                begins = range(0, highest_m.shape[axis], BLOCK)
                highest_m = np.maximum.reduceat(highest_m, begins, axis)

            around_m = ground_m, rise_m, own_m, highest_m
            for count, heights_m in zip(tile, beams_m, strict=True):
                count[:] = _count(*around_m, heights_m, looks, first_ray, rays, num_azimuths)
    return counts


@compiled()
def _count(ground_m, rise_m, own_m, highest_m, heights_m, looks, first_ray, rays, num_azimuths):
    """Return how many scan positions return to the receivers of a tile at one altitude, ``[r, c]`` int32.

    A ray's state is the number of its lowest beams that have ended, or `RETURNED`. Looks are in order of steps, so each
    ray looks at its cells from near to far.

    Args:
      ground_m: ``[P, h, w]`` ground elevation around the tile.
      rise_m: ``[P, h, w]`` how far roofs rise above it, -inf where there is none.
      own_m: ``[r, c]`` the receivers' own ground.
      highest_m: ``[2, P, ...]`` how far the highest ground, and roof, of each block of cells lies above the
        lowest of the receivers' own: no receiver looks at anything higher.
      heights_m: ``[N, B]`` each beam's lowest height over each step's segment, ascending with B.
      looks: ``[U, 4]`` step, phase, row and column of all different looks, in order of steps.
      first_ray: ``[U + 1]`` where the azimuths of each look begin in ``rays``.
      rays: ``[K * N]`` azimuths in order of their looks.
      num_azimuths: K.
    """
    states = np.zeros((num_azimuths, own_m.size), np.uint8)
    least_ended = np.zeros(num_azimuths, np.int64)
    most_ended = np.zeros(num_azimuths, np.int64)
    num_met = np.empty(own_m.shape, np.uint8)
    num_landed = np.empty(own_m.shape, np.uint8)

    for u in range(len(looks)):
        n, p, row, col = looks[u]  # step, phase, and the cell that the southwest receiver looks at

        # The fewest and the most beams that have ended, over the rays of this look and the receivers.
        num_ended = 0
        while heights_m[n, num_ended] == -np.inf:  # out of range
            num_ended += 1
        least, most = MOST_BEAMS, num_ended
        for r in range(first_ray[u], first_ray[u + 1]):
            least = min(least, least_ended[rays[r]])
            most = max(most, most_ended[rays[r]])
        least = max(least, num_ended)

        # Nothing happens where the lowest beam still in the air is above all ground and roofs that are looked at.
        ground, top = _highest(highest_m[:, p], row, col, own_m.shape)
        if not heights_m[n, least] <= max(ground, top):
            continue

        # How many beams are not above the roof, and not above the ground, for each receiver: beams ascend, so the
        # first group that is above both ends the loop. A roof's number decides no more once it is above ``most``.
        num_met.fill(np.uint8(least))
        num_landed.fill(np.uint8(least))
        for b in range(least, heights_m.shape[1] - AT_ONCE, AT_ONCE):
            meets = b <= most and heights_m[n, b] <= top
            lands = heights_m[n, b] <= ground
            if not (meets or lands):
                break
            _add_not_above(
                num_met,
                num_landed,
                own_m,
                ground_m[p],
                rise_m[p],
                (row, col),
                heights_m[n, b:],
                meets,
                lands,
            )
        _, most_met = _range(num_met.reshape(-1))
        least_landed, most_landed = _range(num_landed.reshape(-1))

        # Update the states of each ray for which something may have changed.
        for r in range(first_ray[u], first_ray[u + 1]):
            k = rays[r]
            if most_met > least_ended[k] or most_landed > least_ended[k]:
                _end(states[k], num_met.reshape(-1), num_landed.reshape(-1), np.uint8(num_ended))
            least_ended[k] = max(least_ended[k], least_landed)
            most_ended[k] = max(most_ended[k], most_landed)

    # Count without branches, so that the processor takes many receivers at once.
    returned = np.zeros(own_m.size, np.int32)
    for k in range(num_azimuths):
        state = states[k]
        for i in range(len(state)):
            returned[i] += np.int32(1) if state[i] == RETURNED else np.int32(0)
    return returned.reshape(own_m.shape)


@compiled()
def _highest(highest_m, row, col, shape):
    """Return the heights of the highest ground and of the highest roof over the blocks that a window touches, metres.

    Args:
      highest_m: ``[2, I, J]`` highest ground, and roof, of each block of `BLOCK` cells a side.
      row, col: southwest cell of the window.
      shape: rows and columns of the window.
    """
    ground_m = highest_m[0, row // BLOCK, col // BLOCK]
    top_m = highest_m[1, row // BLOCK, col // BLOCK]
    for i in range(row // BLOCK, (row + shape[0] - 1) // BLOCK + 1):
        for j in range(col // BLOCK, (col + shape[1] - 1) // BLOCK + 1):
            ground_m = max(ground_m, highest_m[0, i, j])
            top_m = max(top_m, highest_m[1, i, j])
    return ground_m, top_m


@compiled()
def _add_not_above(num_met, num_landed, own_m, ground_m, rise_m, at, heights_m, meets, lands):
    """Add to each receiver's numbers how many of the next `AT_ONCE` beams are not above what it looks at, in place.

    Args:
      num_met: ``[r, c]`` uint8 beams not above the roof; raised if ``meets``.
      num_landed: ``[r, c]`` uint8 beams not above the ground; raised if ``lands``.
      own_m: ``[r, c]`` the receivers' own ground.
      ground_m, rise_m: ``[h, w]`` ground of one phase, and how far roofs rise above it, -inf without a roof.
      at: row and column that the southwest receiver looks at.
      heights_m: lowest heights of the beams, of which the first `AT_ONCE` count.
      meets, lands: whether any of these beams can be that low; else the comparison is left out.
    """
    # Four numbers, not an array: so the loop over receivers is vectorised.
    (row, col), (h0, h1, h2, h3) = at, (heights_m[0], heights_m[1], heights_m[2], heights_m[3])
    for i in range(len(own_m)):
        own, met, landed = own_m[i], num_met[i], num_landed[i]
        grounds = ground_m[row + i, col : col + len(own)]
        rises = rise_m[row + i, col : col + len(own)]
        for j in range(len(own)):
            level_m = grounds[j] - own[j]
            if lands:
                landed[j] = _plus_not_above(landed[j], h0, h1, h2, h3, level_m)
            if meets:
                met[j] = _plus_not_above(met[j], h0, h1, h2, h3, level_m + rises[j])


@compiled()
def _plus_not_above(num, h0, h1, h2, h3, level_m):
    """Return ``num`` plus how many of four heights are not above a level, uint8; added in int32, which vectorises."""
    more = (
        np.int32(h0 <= level_m)
        + np.int32(h1 <= level_m)
        + np.int32(h2 <= level_m)
        + np.int32(h3 <= level_m)
    )
    return np.uint8(np.int32(num) + more)


@compiled()
def _range(values):
    """Return the least and the highest of bytes."""
    least, most = np.uint8(255), np.uint8(0)
    for i in range(len(values)):
        least, most = min(least, values[i]), max(most, values[i])
    return np.int64(least), np.int64(most)


@compiled()
def _end(state, num_met, num_landed, out_of_range):
    """Let the rays of receivers return whose beams still in the air meet a roof; the ground ends others' beams."""
    for i in range(len(state)):
        before = max(state[i], out_of_range)
        state[i] = RETURNED if num_met[i] > before else max(before, num_landed[i])
