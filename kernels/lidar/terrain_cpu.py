"""Lidar scan returns over terrain on a CPU: one comparison of bytes for each look and beam, the rest on bits of words.

A beam meets what a ray looks at where the receiver's own ground is not above some level of the cell looked at. The
grounds of a tile's receivers are divided into classes, a byte each, and the cell's level is given the class into which
it falls: that answers for all receivers whose ground is of another class, 32 of them an instruction. For the few of
the same class the heights themselves are compared, so that every answer is that of the heights.

The rays of a tile go on together, step by step, as long as the ground ends the same beams for all of its receivers:
over level ground to the end. Each look is then one comparison, shared by all azimuths that look there. Words hold
eight receivers: bit b of word i * C + j stands for receiver (i + b * band, j). From the first step at which the ground
may end a beam for some receivers only, rays are marched on with a byte for each receiver (`lidar.terrain_march`).

Legend: ``P`` phases, ``Y, X`` cells and their halo, ``y, x`` receivers, ``N`` steps, ``B`` beams, ``K`` azimuths, ``U``
looks, ``R, C`` receivers of a tile, ``W = R * C / 8`` words.
"""

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.lidar.byte_words import AZIMUTHS_AT_ONCE, WORD_BITS, add_up, side_of_tiles
from jaxurban.kernels.lidar.terrain_march import BEAMS_AT_ONCE, PART_COLUMNS, march

TILE = (32, 256)  # receivers taken together: the bits of their rays fit a core's cache; rows a multiple of 8
LAST_CLASS = 255  # of cells; receivers have lower ones
LEAST_CLASS = 1e-5  # height of a class as a share of the largest heights compared: far above their rounding
DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)  # its six highest bits, shifted by b, are another number for each b
PLACE_OF = np.zeros(64, np.uint8)  # b by that number
PLACE_OF[[((int(DE_BRUIJN) << bit) % 2**64) >> 58 for bit in range(64)]] = np.arange(64)


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
    start, first_look, rays, first_ray = looks
    kind = roof_m.dtype.type
    num_rows, num_cols = counts.shape
    rows, cols = side_of_tiles(num_rows, TILE[0], WORD_BITS), side_of_tiles(num_cols, TILE[1], PART_COLUMNS)
    num_steps, num_beams = lowest_m.shape
    num_words = rows // WORD_BITS * cols
    around = (len(roof_m), rows + 2 * halo, cols + 2 * halo)
    ground_m, rise_m = np.empty(around, kind), np.empty(around, kind)
    classes = np.zeros(around, np.uint8)
    own_m, own_class = np.empty((rows, cols), kind), np.empty((rows, cols), np.uint8)
    groups = (num_azimuths + AZIMUTHS_AT_ONCE - 1) // AZIMUTHS_AT_ONCE
    returned = np.empty((groups * AZIMUTHS_AT_ONCE, num_words), np.uint8)
    words, tied = np.empty(num_words, np.uint8), np.empty(num_words, np.uint8)
    states = np.empty((num_azimuths, rows, PART_COLUMNS), np.uint8)
    ended = np.empty(num_azimuths, np.int64)  # lowest beams, the same for all receivers
    window = _windows(start, first_look)
    out_of_range = np.zeros(num_steps, np.int64)
    lowest_flown_m = np.full(num_steps, np.inf)
    heights_m = np.full((num_steps, num_beams + 2 * BEAMS_AT_ONCE), np.inf).astype(kind)
    heights_m[:, :num_beams] = lowest_m
    largest_m = 0.0
    for n in range(num_steps):
        for height_m in lowest_m[n]:
            out_of_range[n] += height_m == -np.inf
            if abs(height_m) < np.inf:
                largest_m = max(largest_m, abs(height_m))
                lowest_flown_m[n] = min(lowest_flown_m[n], height_m)

    for row in range(0, num_rows, rows):
        for col in range(0, num_cols, cols):
            _cut(ground_m, rise_m, terrain_m, roof_m, row, col)
            for i in range(rows):
                for j in range(cols):
                    own_m[i, j] = ground_m[phase, halo + min(i, num_rows - row - 1), halo + min(j, num_cols - col - 1)]
            base_m, most_m = np.nanmin(own_m), np.nanmax(own_m)
            highest_m, top_m = _highest(ground_m, rise_m, base_m)
            level_m = _lowest(terrain_m[:, row : row + around[1], col : col + around[2]], most_m)
            end = num_steps
            while end > 0 and not lowest_flown_m[end - 1] <= top_m:
                end -= 1
            if end == 0:
                continue
            size_m = max(largest_m, abs(base_m), abs(base_m) + abs(highest_m), abs(top_m))
            class_m = kind(max((most_m - base_m) / (LAST_CLASS - 3), LEAST_CLASS * size_m))
            _classify(own_class, own_m, base_m, class_m)
            returned[:] = 0
            ended[:] = 0
            parting = 0
            while parting < end:
                n = parting
                for k in range(num_azimuths):
                    ended[k] = max(ended[k], out_of_range[n])
                lowest = ended.min()
                landing = lowest
                while heights_m[n, landing] <= level_m:
                    landing += 1
                if heights_m[n, landing] <= highest_m:
                    break  # the ground may end a beam for some receivers only
                for beam in range(lowest, min(ended.max() + 1, num_beams)):
                    height_m = heights_m[n, beam]
                    if not height_m <= top_m:
                        break
                    _fill(classes, ground_m, rise_m, height_m, (base_m, class_m), window[n], (rows, cols))
                    for u in range(first_look[n], first_look[n + 1]):
                        is_wanted = False
                        for r in range(first_ray[u], first_ray[u + 1]):
                            is_wanted |= ended[rays[r]] == beam
                        if not is_wanted:
                            continue
                        p, from_row, from_col = start[u]
                        _compare(words, tied, own_class, classes[p], from_row, from_col)
                        _resolve(words, tied, own_m, ground_m[p], rise_m[p], from_row, from_col, height_m)
                        for r in range(first_ray[u], first_ray[u + 1]):
                            if ended[rays[r]] == beam:
                                _join(returned[rays[r]], words)
                for k in range(num_azimuths):
                    ended[k] = max(ended[k], landing)
                parting += 1
            found = counts[row : row + rows, col : col + cols]
            if parting == end:
                add_up(returned, found, rows // WORD_BITS, cols)
                continue
            for part in range(0, found.shape[1], PART_COLUMNS):
                march(
                    found[:, part : part + PART_COLUMNS],
                    states,
                    ground_m,
                    rise_m,
                    own_m[:, part : part + PART_COLUMNS].copy(),
                    returned,
                    ended,
                    part,
                    cols,
                    looks,
                    heights_m,
                    out_of_range,
                    parting,
                    end,
                )


@compiled(nogil=True)
def _windows(start, first_look):
    """Return the first and last row and column ``[N, 4]`` at which the southwest receiver looks at each step."""
    window = np.empty((len(first_look) - 1, 4), np.int64)
    for n in range(len(window)):
        for side in range(2):
            window[n, 2 * side : 2 * side + 2] = start[first_look[n], side + 1]
            for u in range(first_look[n], first_look[n + 1]):
                window[n, 2 * side] = min(window[n, 2 * side], start[u, side + 1])
                window[n, 2 * side + 1] = max(window[n, 2 * side + 1], start[u, side + 1])
    return window


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
def _highest(ground_m, rise_m, base_m):
    """Return how far any ground, and any roof, lies above a level; exact bounds of what is compared."""
    kind = ground_m.dtype.type
    highest_m = np.full(ground_m.shape[2], -np.inf).astype(kind)
    top_m = highest_m.copy()
    for p in range(len(ground_m)):
        for i in range(ground_m.shape[1]):
            grounds, rises = ground_m[p, i], rise_m[p, i]
            for j in range(len(grounds)):
                ground = grounds[j] - base_m
                top = ground + rises[j]
                highest_m[j] = ground if ground > highest_m[j] else highest_m[j]
                top_m[j] = top if top > top_m[j] else top_m[j]
    return highest_m.max(), top_m.max()


@compiled(nogil=True)
def _lowest(terrain_m, level_m):
    """Return how far all ground lies above a level, -inf where some is unknown."""
    none = terrain_m.dtype.type(np.inf)
    least_m = none
    for ground_m in terrain_m.flat:
        if not ground_m >= least_m:
            if ground_m != ground_m:
                return -none
            least_m = ground_m
    return least_m - level_m


@compiled(nogil=True)
def _classify(own_class, own_m, base_m, class_m):
    """Fill the class of each receiver's ground: the highest that does not begin above it."""
    one = own_m.dtype.type(1)
    for i in range(own_m.shape[0]):
        for j in range(own_m.shape[1]):
            number = np.floor((own_m[i, j] - base_m) / class_m) + one
            if base_m + (number - one) * class_m > own_m[i, j]:
                number -= one
            elif base_m + number * class_m <= own_m[i, j]:
                number += one
            own_class[i, j] = np.uint8(number) if number < LAST_CLASS else np.uint8(LAST_CLASS)


@compiled(nogil=True)
def _fill(classes, ground_m, rise_m, height_m, scale, window, shape):
    """Fill the class of each cell that a step looks at: the highest at whose beginning a receiver meets it, else 0."""
    (base_m, class_m), (rows, cols) = scale, shape
    kind = ground_m.dtype.type
    zero, one, last = kind(0), kind(1), kind(LAST_CLASS)
    per_m = one / class_m
    for p in range(len(ground_m)):
        for i in range(window[0], window[1] + rows):
            grounds, rises = ground_m[p, i, window[2] : window[3] + cols], rise_m[p, i, window[2] : window[3] + cols]
            of_row = classes[p, i, window[2] : window[3] + cols]
            for j in range(len(of_row)):
                ground, rise = grounds[j], rises[j]
                number = np.floor(((ground - height_m) + rise - base_m) * per_m) + one
                number = number if number > zero else zero
                number = number if number < last else last
                holds = height_m <= (ground - (base_m + (number - one) * class_m)) + rise
                holds_above = height_m <= (ground - (base_m + number * class_m)) + rise
                number = number + (one if holds_above else zero) - (zero if holds else one)
                number = number if number > zero else zero
                number = number if number < last else last
                of_row[j] = np.uint8(number)


@compiled(nogil=True)
def _compare(words, tied, own_class, classes, row, col):
    """Fill the bits of receivers whose ground is of a lower class than the cell that they look at, and of the same."""
    band, cols = own_class.shape[0] // WORD_BITS, own_class.shape[1]
    zero = np.uint8(0)
    for i in range(band):
        own = own_class[i::band]
        a0, a1, a2, a3, a4, a5, a6, a7 = own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7]
        other = classes[row + i : row + i + 8 * band : band, col : col + cols]
        b0, b1, b2, b3, b4, b5, b6, b7 = other[0], other[1], other[2], other[3], other[4], other[5], other[6], other[7]
        of_words, of_tied = words[i * cols : (i + 1) * cols], tied[i * cols : (i + 1) * cols]
        for j in range(cols):
            word = np.uint8(1) if a0[j] < b0[j] else zero
            word = np.uint8(word | (np.uint8(2) if a1[j] < b1[j] else zero))
            word = np.uint8(word | (np.uint8(4) if a2[j] < b2[j] else zero))
            word = np.uint8(word | (np.uint8(8) if a3[j] < b3[j] else zero))
            word = np.uint8(word | (np.uint8(16) if a4[j] < b4[j] else zero))
            word = np.uint8(word | (np.uint8(32) if a5[j] < b5[j] else zero))
            word = np.uint8(word | (np.uint8(64) if a6[j] < b6[j] else zero))
            of_words[j] = np.uint8(word | (np.uint8(128) if a7[j] < b7[j] else zero))
            tie = np.uint8(1) if a0[j] == b0[j] else zero
            tie = np.uint8(tie | (np.uint8(2) if a1[j] == b1[j] else zero))
            tie = np.uint8(tie | (np.uint8(4) if a2[j] == b2[j] else zero))
            tie = np.uint8(tie | (np.uint8(8) if a3[j] == b3[j] else zero))
            tie = np.uint8(tie | (np.uint8(16) if a4[j] == b4[j] else zero))
            tie = np.uint8(tie | (np.uint8(32) if a5[j] == b5[j] else zero))
            tie = np.uint8(tie | (np.uint8(64) if a6[j] == b6[j] else zero))
            of_tied[j] = np.uint8(tie | (np.uint8(128) if a7[j] == b7[j] else zero))


@compiled(nogil=True)
def _resolve(words, tied, own_m, ground_m, rise_m, row, col, height_m):
    """Fill the bits of receivers whose class is the cell's by the heights themselves."""
    band, cols = own_m.shape[0] // WORD_BITS, own_m.shape[1]
    all_words, all_tied = words.view(np.uint64), tied.view(np.uint64)
    at = 0
    for i in range(band):
        for first in range(0, cols, 8):
            left = all_tied[at]
            met = np.uint64(0)
            while left:
                bit = left & (~left + np.uint64(1))
                left ^= bit
                place = PLACE_OF[(bit * DE_BRUIJN) >> np.uint64(58)]
                r, c = i + (place & 7) * band, first + (place >> 3)
                if height_m <= (ground_m[row + r, col + c] - own_m[r, c]) + rise_m[row + r, col + c]:
                    met |= bit
            all_words[at] |= met
            at += 1


@compiled(nogil=True)
def _join(words, others):
    """Set the bits that others have."""
    for i in range(len(words)):
        words[i] |= others[i]
