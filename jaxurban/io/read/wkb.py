"""Boxes of geometries in well-known binary (OGC 06-103r4, section 8), which is not decoded."""

import numpy as np

from jaxurban.kernels.compiled import compiled

_POINT, _LINE, _POLYGON, _FIRST_OF_MANY, _LAST_OF_MANY = 1, 2, 3, 4, 7
_EWKB_Z, _EWKB_M, _EWKB_SRID = 0x80000000, 0x40000000, 0x20000000  # PostGIS's flags; ISO adds 1000, 2000 or 3000


@compiled(nogil=True)
def wkb_boxes(data, start):
    """Return x_min, y_min, x_max, y_max of each geometry, ``[N, 4]`` float64.

    NaN where there is no corner: an empty geometry, or no bytes; infinite where they cannot be read: big-endian ones,
    or of another kind.

    Args:
      data: ``[B]`` uint8, the geometries one after the other.
      start: ``[N + 1]`` int64 where each begins in ``data``, and the end.
    """
    boxes = np.empty((len(start) - 1, 4))
    for at in range(len(boxes)):
        box = boxes[at]
        box[:2], box[2:] = np.inf, -np.inf
        if not _grow(data[start[at] : start[at + 1]], box):
            box[:2], box[2:] = -np.inf, np.inf
        elif box[0] > box[2]:
            box[:] = np.nan
    return boxes


@compiled(nogil=True)
def _grow(data, box):
    """Take the corners of a geometry into a box; returns whether it could be read."""
    place, num_left = 0, 1 if len(data) else 0
    while num_left:
        if place + 9 > len(data) or data[place] != 1:
            return False
        kind = _uint32(data, place + 1)
        place += 9 if kind & _EWKB_SRID else 5
        num_numbers = 2
        if kind & (_EWKB_Z | _EWKB_M):
            num_numbers += (kind & _EWKB_Z != 0) + (kind & _EWKB_M != 0)
        kind &= 0x1FFFFFFF
        num_numbers += (0, 1, 1, 2)[kind // 1000 % 4]
        kind %= 1000
        num_left -= 1
        if kind == _POINT:
            num_runs = 1
        elif _LINE <= kind <= _LAST_OF_MANY:
            if place + 4 > len(data):
                return False
            num_runs = _uint32(data, place) if kind != _LINE else 1
            place += 4 if kind != _LINE else 0
        else:
            return False
        if kind >= _FIRST_OF_MANY:
            num_left += num_runs
            continue
        for _ in range(num_runs):
            num_corners = 1
            if kind != _POINT:
                if place + 4 > len(data):
                    return False
                num_corners = _uint32(data, place)
                place += 4
            if place + 8 * num_numbers * num_corners > len(data):
                return False
            for _ in range(num_corners):
                x, y = _float64(data, place), _float64(data, place + 8)
                box[0], box[1], box[2], box[3] = min(box[0], x), min(box[1], y), max(box[2], x), max(box[3], y)
                place += 8 * num_numbers
    return True


@compiled(nogil=True)
def _uint32(data, place):
    low, high = np.int64(data[place]) | np.int64(data[place + 1]) << 8, data[place + 2] | np.int64(data[place + 3]) << 8
    return low | high << 16


@compiled(nogil=True)
def _float64(data, place):
    low, high = _uint32(data, place), _uint32(data, place + 4)
    return np.int64(low | high << 32).view(np.float64)
