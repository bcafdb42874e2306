"""Lidar scan returns over flat ground on a CPU: rows of bitmaps joined for eight steps at once, azimuth by azimuth.

The counts are those of `jaxurban.kernels.lidar.hard`, whose thresholds and looks these are. A roof has a rank, a byte:
how many of the different thresholds it reaches, so that a step's bitmap around a tile of receivers is a comparison of
bytes. Words hold eight receivers: bit b of word ``i * C + j`` stands for receiver ``(i + b * band, j)`` of a tile of
``R = 8 * band`` rows and ``C`` columns, so that a look from all of a tile's receivers reads whole rows of what it looks
at. Neighbouring azimuths look at nearly the same rows, so they are taken one after the other for a row of words: what
they read stays in the nearest cache. The first steps, which an azimuth has in common with the one before, are not
joined again, and steps at which no roof in sight is high enough are left out.

Legend: ``P`` phases, ``Y, X`` cells and their halo, ``y, x`` receivers, ``N`` steps, ``K`` azimuths, ``W`` words.
"""

import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.kernels.compiled import compiled, on_host

TILE = (128, 512)  # most receivers taken together; rows a multiple of 8
COLUMNS = 64  # that a tile's are a multiple of
BITMAP_BYTES = 2**20  # of the bitmaps of some steps, which a core's cache holds
STEPS_AT_ONCE = 8  # bitmaps joined in one pass over a row
NEVER = 2**16  # a rank that no roof has
WORD_BITS = 8
AZIMUTHS_AT_ONCE = 8  # added up by carry-save adders before they are carried into the counts


def count_on_host(
    roof_m: Float[Array | np.ndarray, "P Y+2H X+2H"],
    thresholds_m: Float[Array | np.ndarray, "A N"],
    starts: Int[np.ndarray, "K N 3"],
    halo: int,
) -> Int[np.ndarray, "A Y X"]:
    """Return how many of K scan positions meet a building, over flat ground, ``[A, Y, X]`` int32.

    Args:
      roof_m: roof heights, 0 without a building, as `jaxurban.kernels.lidar.hard.phases`.
      thresholds_m: from `jaxurban.kernels.lidar.hard.flat_thresholds`, rounded up to the type of ``roof_m``.
      starts: from `jaxurban.kernels.lidar.hard.phase_starts`.
      halo: H, cells beyond the receivers.

    Altitudes that no roof reaches cost nothing.
    """
    roofs, thresholds = on_host(roof_m), on_host(thresholds_m)
    looks, parted, window = (
        np.ascontiguousarray(starts, np.int32),
        steps_in_common(starts),
        windows(starts),
    )
    counts = np.zeros((len(thresholds), *(size - 2 * halo for size in roofs.shape[1:])), np.int32)
    highest_m = np.fmax.reduce(roofs, axis=None)
    for threshold_m, found in zip(thresholds, counts, strict=True):
        is_live = threshold_m <= highest_m
        if not is_live.any():
            continue
        levels_m = np.unique(threshold_m[is_live])
        kind = np.uint8 if len(levels_m) <= np.iinfo(np.uint8).max else np.uint16
        least_rank = np.where(is_live, np.searchsorted(levels_m, threshold_m) + 1, NEVER)
        _count(roofs, levels_m, least_rank, np.empty(0, kind), looks, parted, window, halo, found)
    return counts


def steps_in_common(starts: Int[np.ndarray, "K N 3"]) -> Int[np.ndarray, " K"]:
    """Return how many of its first steps each azimuth has in common with the one before it, 0 the first."""
    differs = (starts[1:] != starts[:-1]).any(axis=2)
    parted = np.where(differs.any(axis=1), differs.argmax(axis=1), starts.shape[1])
    return np.append(0, parted)


def windows(starts: Int[np.ndarray, "K N 3"]) -> Int[np.ndarray, "N 4"]:
    """Return the first and last row, and the first and last column, at which the southwest receiver looks at each step.

    In NumPy: Numba's minimum and maximum of an array bring SciPy with them when they are loaded, 0.1 s.
    """
    rows, cols = starts[..., 1], starts[..., 2]
    return np.stack(
        [rows.min(axis=0), rows.max(axis=0), cols.min(axis=0), cols.max(axis=0)], axis=1
    ).astype(np.int64)


@compiled(nogil=True)
def _count(roof_m, levels_m, least_rank, no_ranks, starts, parted, window, halo, counts):
    """Fill ``counts`` ``[y, x]`` int32 at one altitude; 0 in it before.

    Args:
      roof_m: ``[P, Y, X]`` roof heights, 0 without a building.
      levels_m: the different thresholds that some roof reaches, ascending.
      least_rank: ``[N]`` rank of the roofs that return a ray at each step.
      no_ranks: an array of the type that ranks have.
      starts: ``[K, N, 3]`` looks of the southwest receiver.
      parted: ``[K]`` from `steps_in_common`.
      window: ``[N, 4]`` from `windows`.
      halo: cells beyond the receivers.
      counts: the result.
    """
    num_azimuths, num_steps = starts.shape[:2]
    rows, cols = (
        side_of_tiles(counts.shape[0], TILE[0], WORD_BITS),
        side_of_tiles(counts.shape[1], TILE[1], COLUMNS),
    )
    band, wide = rows // WORD_BITS, cols + 2 * halo
    tiles = (counts.shape[0] + rows - 1) // rows, (counts.shape[1] + cols - 1) // cols
    ranks = np.zeros(
        (len(roof_m), tiles[0] * rows + 2 * halo, tiles[1] * cols + 2 * halo), no_ranks.dtype
    )
    _rank(ranks, roof_m, levels_m)
    groups = (num_azimuths + AZIMUTHS_AT_ONCE - 1) // AZIMUTHS_AT_ONCE
    returned = np.empty((groups * AZIMUTHS_AT_ONCE, band * cols), np.uint8)
    largest = len(roof_m) * (band + 2 * halo) * wide
    bitmaps = np.empty(max(BITMAP_BYTES, largest), np.uint8)
    first_bit, is_set = (
        np.empty(num_steps, np.int64),
        np.empty((num_steps, len(roof_m), band + 2 * halo + 1), np.int32),
    )
    at = np.empty((num_azimuths, num_steps + STEPS_AT_ONCE), np.int64)
    num_at, num_same = np.empty(num_azimuths, np.int64), np.empty(num_azimuths, np.int64)
    joined = np.zeros((num_steps // STEPS_AT_ONCE + 2) * cols, np.uint8)
    for row in range(0, counts.shape[0], rows):
        for col in range(0, counts.shape[1], cols):
            around = ranks[:, row : row + rows + 2 * halo, col : col + wide]
            highest = _highest(around)
            returned[:] = 0
            n, has_any = 0, False
            while n < num_steps:
                first, used = n, 0
                while n < num_steps:
                    first_bit[n] = -1
                    if least_rank[n] <= highest:
                        size = len(roof_m) * (band + window[n, 1] - window[n, 0]) * wide
                        if used + size > len(bitmaps):
                            break
                        first_bit[n] = used
                        shape = len(roof_m), band + window[n, 1] - window[n, 0], wide
                        bitmap = bitmaps[used : used + size].reshape(shape)
                        _pack(bitmap, is_set[n], around, least_rank[n], window[n], band, cols)
                        used += size
                    n += 1
                if used:
                    has_any = True
                    _list(
                        at,
                        num_at,
                        num_same,
                        starts,
                        parted,
                        (first, n),
                        first_bit,
                        is_set,
                        window,
                        (band, wide),
                    )
                    _join(
                        returned.reshape(-1),
                        joined,
                        bitmaps,
                        at,
                        num_at,
                        num_same,
                        (band, cols, wide),
                    )
            if has_any:
                add_up(returned, counts[row : row + rows, col : col + cols], band, cols)


@compiled(nogil=True)
def _rank(ranks, roof_m, levels_m):
    """Fill how many of ascending levels each roof reaches."""
    one = ranks.dtype.type(1)
    zero = ranks.dtype.type(0)
    for p in range(len(roof_m)):
        for i in range(roof_m.shape[1]):
            roofs, of_row = roof_m[p, i], ranks[p, i]
            for level_m in levels_m:
                for j in range(len(roofs)):
                    of_row[j] += one if roofs[j] >= level_m else zero


@compiled(nogil=True)
def _highest(ranks):
    """Return the highest rank."""
    highest = ranks[0, 0, 0]
    for p in range(len(ranks)):
        for i in range(ranks.shape[1]):
            of_row = ranks[p, i]
            for j in range(len(of_row)):
                highest = of_row[j] if of_row[j] > highest else highest
    return np.int64(highest)


@compiled(nogil=True)
def _pack(bitmap, num_set, ranks, least_rank, window, band, cols):
    """Fill the bits of cells whose rank is not below a least one, and how many rows before each have any."""
    zero, least = np.uint8(0), ranks.dtype.type(least_rank)
    first, end = window[2], window[3] + cols
    for p in range(len(bitmap)):
        num_set[p, 0] = 0
        for i in range(bitmap.shape[1]):
            row = window[0] + i
            r0, r1 = ranks[p, row, first:end], ranks[p, row + band, first:end]
            r2, r3 = ranks[p, row + 2 * band, first:end], ranks[p, row + 3 * band, first:end]
            r4, r5 = ranks[p, row + 4 * band, first:end], ranks[p, row + 5 * band, first:end]
            r6, r7 = ranks[p, row + 6 * band, first:end], ranks[p, row + 7 * band, first:end]
            words, any_set = bitmap[p, i, first:end], zero
            for j in range(len(words)):
                word = np.uint8(1) if r0[j] >= least else zero
                word = np.uint8(word | (np.uint8(2) if r1[j] >= least else zero))
                word = np.uint8(word | (np.uint8(4) if r2[j] >= least else zero))
                word = np.uint8(word | (np.uint8(8) if r3[j] >= least else zero))
                word = np.uint8(word | (np.uint8(16) if r4[j] >= least else zero))
                word = np.uint8(word | (np.uint8(32) if r5[j] >= least else zero))
                word = np.uint8(word | (np.uint8(64) if r6[j] >= least else zero))
                word = np.uint8(word | (np.uint8(128) if r7[j] >= least else zero))
                words[j] = word
                any_set = np.uint8(any_set | word)
            num_set[p, i + 1] = num_set[p, i] + (any_set != zero)


@compiled(nogil=True)
def _list(at, num_at, num_same, starts, parted, steps, first_bit, num_set, window, shape):
    """Fill where in the bitmaps of some steps each azimuth looks, looks at nothing left out.

    Args:
      at: ``[K, N + 8]`` where the first row of words looks, the last one repeated to a multiple of 8.
      num_at: ``[K]`` how many looks there are.
      num_same: ``[K]`` how many of the first ones are those of the azimuth before.
      starts, parted: as of `_count`.
      steps: the first one, and that after the last.
      first_bit: ``[N]`` where the bitmap of each step begins, -1 where there is none.
      num_set: ``[N, P, rows + 1]`` from `_pack`.
      window: ``[N, 4]`` of the bitmaps.
      shape: rows of words, and columns of the bitmaps.
    """
    band, wide = shape
    before = np.zeros(steps[1] + 1, np.int64)  # looks before each step, of the last azimuth
    for k in range(len(starts)):
        same = max(steps[0], min(parted[k], steps[1])) if k > 0 else steps[0]
        num = before[same]
        at[k, :num] = at[k - 1, :num]
        num_same[k] = num
        for n in range(same, steps[1]):
            before[n] = num
            if first_bit[n] >= 0:
                p, row, col = starts[k, n, 0], starts[k, n, 1] - window[n, 0], starts[k, n, 2]
                if num_set[n, p, row + band] > num_set[n, p, row]:
                    high = band + window[n, 1] - window[n, 0]
                    at[k, num] = first_bit[n] + (p * high + row) * wide + col
                    num += 1
        before[steps[1]] = num
        num_at[k] = num
        if num > 0:
            at[k, num : num + STEPS_AT_ONCE] = at[k, num - 1]


@compiled(nogil=True)
def _join(returned, joined, bitmaps, at, num_at, num_same, shape):
    """Join what each azimuth looks at to what has returned.

    Places are unsigned and arrays whole: a slice of each look would cost as much as reading it.

    Args:
      returned: ``[K * W]`` words, altered.
      joined: words of a row after each group of looks of an azimuth, the first of them none.
      bitmaps: of the steps.
      at, num_at, num_same: from `_list`.
      shape: rows of words, their columns, and those of the bitmaps.
    """
    band, cols, wide = shape
    for i in range(band):
        for k in range(len(num_at)):
            num_groups = (num_at[k] + STEPS_AT_ONCE - 1) // STEPS_AT_ONCE
            for group in range(num_same[k] // STEPS_AT_ONCE, num_groups):
                first = group * STEPS_AT_ONCE
                a, b = np.uint64(at[k, first] + i * wide), np.uint64(at[k, first + 1] + i * wide)
                c, d = (
                    np.uint64(at[k, first + 2] + i * wide),
                    np.uint64(at[k, first + 3] + i * wide),
                )
                e, f = (
                    np.uint64(at[k, first + 4] + i * wide),
                    np.uint64(at[k, first + 5] + i * wide),
                )
                g, h = (
                    np.uint64(at[k, first + 6] + i * wide),
                    np.uint64(at[k, first + 7] + i * wide),
                )
                before, after = np.uint64(group * cols), np.uint64((group + 1) * cols)
                for column in range(cols):
                    j = np.uint64(column)
                    four = bitmaps[a + j] | bitmaps[b + j] | bitmaps[c + j] | bitmaps[d + j]
                    more = bitmaps[e + j] | bitmaps[f + j] | bitmaps[g + j] | bitmaps[h + j]
                    joined[after + j] = joined[before + j] | four | more
            if num_groups > 0:
                before, after = np.uint64(num_groups * cols), np.uint64((k * band + i) * cols)
                for column in range(cols):
                    j = np.uint64(column)
                    returned[after + j] |= joined[before + j]


@compiled(nogil=True)
def side_of_tiles(size, most, multiple):
    """Return the side of tiles of about the same size, none above ``most``, a multiple of something."""
    num_tiles = (size + most - 1) // most
    return ((size + num_tiles - 1) // num_tiles + multiple - 1) // multiple * multiple


@compiled(nogil=True)
def _sums(a, b, c):
    """Return the sum and the carry of three bits in each place of words."""
    either = a ^ b
    return either ^ c, (a & b) | (either & c)


@compiled(nogil=True)
def add_up(returned, counts, band, cols):
    """Fill how many of the rows of words ``[K, W]``, K a multiple of 8, have each receiver's bit set; 0 before."""
    num_slices = 3
    while (1 << num_slices) <= len(returned):
        num_slices += 1
    slices = np.zeros((num_slices, returned.shape[1]), np.uint8)
    words, places = returned.view(np.uint64), slices.view(np.uint64)
    ones, twos, fours = places[0], places[1], places[2]
    carry = np.empty_like(ones)
    for k in range(0, len(words), AZIMUTHS_AT_ONCE):
        a, b, c, d = words[k], words[k + 1], words[k + 2], words[k + 3]
        e, f, g, h = words[k + 4], words[k + 5], words[k + 6], words[k + 7]
        for i in range(len(carry)):
            one, two_a = _sums(ones[i], a[i], b[i])
            one, two_b = _sums(one, c[i], d[i])
            one, two_c = _sums(one, e[i], f[i])
            ones[i], two_d = _sums(one, g[i], h[i])
            two, four_a = _sums(twos[i], two_a, two_b)
            twos[i], four_b = _sums(two, two_c, two_d)
            fours[i], carry[i] = _sums(fours[i], four_a, four_b)
        for s in range(3, num_slices):
            place = places[s]
            for i in range(len(carry)):
                place[i], carry[i] = place[i] ^ carry[i], place[i] & carry[i]
    for b in range(WORD_BITS):
        for i in range(max(0, min(band, counts.shape[0] - b * band))):
            of_row = counts[b * band + i]
            for s in range(num_slices):
                bits = slices[s, i * cols : (i + 1) * cols]
                for j in range(len(of_row)):
                    of_row[j] |= np.int32((bits[j] >> b) & 1) << s
