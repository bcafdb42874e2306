"""Lidar scan returns over terrain on a CPU: tile by tile, so that what its rays look at lies in a core's cache.

The rays are followed by `jaxurban.kernels.lidar.terrain_march`, a byte for each receiver, as far as some beam can meet
what is highest around the tile.

Legend: ``P`` phases, ``Y, X`` cells and their halo, ``y, x`` receivers, ``N`` steps, ``B`` beams, ``K`` azimuths.
"""

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.lidar.byte_words import side_of_tiles
from jaxurban.kernels.lidar.terrain_march import BEAMS_AT_ONCE, PART_COLUMNS, highest_of_blocks, march

TILE = (32, 256)  # receivers taken together


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
