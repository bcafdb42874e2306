"""Capped distance on a CPU: both passes over blocks that a core's cache holds, and no farther than it helps.

Distances are those of `jaxurban.kernels.distance.nearest.capped_distance` to the bit. A pass looks at offsets in
ascending order and ends where none of a row's cells can come nearer: in a city most have a source long before the cap.

Legend: ``Y, X`` cells and their halo, ``y, x`` cells that are asked for, ``H`` the halo.
"""

import numpy as np
from jaxtyping import Float

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.distance.nearest import window_cells

BLOCK = (
    512,
    192,
)  # cells together: their squared distances along the rows fit a core's second cache
AT_ONCE = 5  # offsets looked at in one go over a row


def distance_on_host(
    source_m2: Float[np.ndarray, "Y X"], halo: int, *, resolution_m: float, cap_m: float
) -> Float[np.ndarray, "y x"]:
    """Return the distance to the nearest source, at most ``cap_m``, in metres, of all cells but the halo's.

    Args:
      source_m2: what a source adds to the squared distance, inf without one, as for
        `jaxurban.kernels.distance.nearest.capped_distance`.
      halo: cells beyond those that are asked for, at each side.
      resolution_m, cap_m: as there.
    """
    source_m2 = np.ascontiguousarray(source_m2)
    window, dtype = -(-window_cells(cap_m, resolution_m) // AT_ONCE) * AT_ONCE, source_m2.dtype
    run_m2 = (np.arange(window + 1).astype(dtype) * dtype.type(resolution_m)) ** 2
    distance_m = np.empty(tuple(size - 2 * halo for size in source_m2.shape), dtype)
    _fill(distance_m, source_m2, run_m2, halo, dtype.type(cap_m), dtype.type(cap_m**2))
    return distance_m


@compiled(nogil=True)
def _fill(distance_m, source_m2, run_m2, halo, cap_m, cap_m2):
    """Fill distances, block by block.

    Args:
      distance_m: ``[y, x]``.
      source_m2: ``[Y, X]``.
      run_m2: squared distance of each offset, from 0 up to the window's end.
      halo: H.
      cap_m, cap_m2: the cap and its square.
    """
    window = len(run_m2) - 1
    padded = np.empty(BLOCK[1] + 2 * window, source_m2.dtype)
    along = np.empty(
        (BLOCK[0] + 2 * window, BLOCK[1]), source_m2.dtype
    )  # squared distances along the rows
    nearest = np.empty(BLOCK[1], source_m2.dtype)
    for row in range(0, distance_m.shape[0], BLOCK[0]):
        num_rows = min(BLOCK[0], distance_m.shape[0] - row)
        for col in range(0, distance_m.shape[1], BLOCK[1]):
            for i in range(num_rows + 2 * window):
                of_row = row + halo - window + i
                if of_row < 0 or of_row >= source_m2.shape[0]:
                    along[i] = cap_m2
                    continue
                first = col + halo - window
                if first >= 0 and first + len(padded) <= source_m2.shape[1]:
                    _along_row(
                        along[i], source_m2[of_row][first : first + len(padded)], run_m2, cap_m2
                    )
                else:
                    _pad(padded, source_m2[of_row], first)
                    _along_row(along[i], padded, run_m2, cap_m2)
            for i in range(num_rows):
                _along_columns(nearest, along[i:], run_m2)
                _root(distance_m[row + i][col : col + BLOCK[1]], nearest, cap_m, cap_m2)


@compiled(nogil=True)
def _pad(padded, row, first):
    """Fill ``padded`` with a row from a column on, which may lie before its begin; inf beyond the row."""
    before = min(max(-first, 0), len(padded))
    end = max(min(len(row) - first, len(padded)), before)
    padded[:before] = np.inf
    padded[before:end] = row[first + before : first + end]
    padded[end:] = np.inf


@compiled(nogil=True)
def _root(distance_m, squared_m2, cap_m, cap_m2):
    for j in range(len(distance_m)):
        root = np.sqrt(squared_m2[j])
        distance_m[j] = root if squared_m2[j] < cap_m2 else cap_m


@compiled(nogil=True)
def _is_any_farther(nearest, than):
    count = 0
    for j in range(len(nearest)):
        count += nearest[j] > than
    return count > 0


@compiled(nogil=True)
def _along_row(nearest, padded, run_m2, cap_m2):
    """Fill a row's least squared distances along its row, at most the cap's.

    Args:
      nearest: ``[X]``.
      padded: its cells, with a window before and behind.
      run_m2, cap_m2: as for `_fill`.
    """
    num, at = len(nearest), len(run_m2) - 1
    own = padded[at : at + num]
    for j in range(num):
        nearest[j] = own[j] if own[j] < cap_m2 else cap_m2
    for k in range(1, len(run_m2), AT_ONCE):
        if not _is_any_farther(nearest, run_m2[k]):
            break
        first, last = padded[at - k - 4 : at - k + num], padded[at + k : at + k + 4 + num]
        a, b, c, d, e = run_m2[k], run_m2[k + 1], run_m2[k + 2], run_m2[k + 3], run_m2[k + 4]
        for j in range(num):
            one = min(first[j + 4], last[j]) + a
            two = min(first[j + 3], last[j + 1]) + b
            three = min(first[j + 2], last[j + 2]) + c
            four = min(first[j + 1], last[j + 3]) + d
            five = min(first[j], last[j + 4]) + e
            nearest[j] = min(min(nearest[j], five), min(min(one, two), min(three, four)))


@compiled(nogil=True)
def _along_columns(nearest, along, run_m2):
    """Fill a row's least squared distances over the rows of a window.

    Args:
      nearest: ``[X]``.
      along: ``[2 * window + 1 ..., PIECE]`` those along the rows, of the piece's row the one after the window.
      run_m2: as for `_fill`.
    """
    num, at = len(nearest), len(run_m2) - 1
    nearest[:] = along[at]
    for k in range(1, len(run_m2), AT_ONCE):
        if not _is_any_farther(nearest, run_m2[k]):
            break
        up_1, up_2, up_3 = along[at + k], along[at + k + 1], along[at + k + 2]
        up_4, up_5 = along[at + k + 3], along[at + k + 4]
        down_1, down_2, down_3 = along[at - k], along[at - k - 1], along[at - k - 2]
        down_4, down_5 = along[at - k - 3], along[at - k - 4]
        a, b, c, d, e = run_m2[k], run_m2[k + 1], run_m2[k + 2], run_m2[k + 3], run_m2[k + 4]
        for j in range(num):
            one, two = min(down_1[j], up_1[j]) + a, min(down_2[j], up_2[j]) + b
            three, four = min(down_3[j], up_3[j]) + c, min(down_4[j], up_4[j]) + d
            five = min(down_5[j], up_5[j]) + e
            nearest[j] = min(min(nearest[j], five), min(min(one, two), min(three, four)))
