"""Answers of eight receivers in a byte: tiles of receivers, and adding up bits.

Bit b of word ``i * C + j`` stands for receiver ``(i + b * band, j)`` of a tile of ``R = 8 * band`` rows and ``C``
columns, so that a look from all of a tile's receivers reads whole rows of what it looks at.
"""

import numpy as np

from jaxurban.kernels.compiled import compiled

WORD_BITS = 8
AZIMUTHS_AT_ONCE = 8  # added up by carry-save adders before they are carried into the counts


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
