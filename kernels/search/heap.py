"""A 4-ary heap of open nodes or edges, lowest first, for compiled searches."""

from typing import NamedTuple, Self

import numpy as np

from jaxurban.kernels.compiled import compiled

FOUND, EXHAUSTED, PAUSED, FULL = range(4)  # how a chunk of search ended: FULL for want of room in the heap


class Heap(NamedTuple):
    """Entries by their key ``f``, room for ``Q``. Equal keys come in an order that only the pushes before decide.

    Attributes:
      f: ``[Q]`` float64.
      item: ``[Q]`` what is ordered: whole numbers, or records.
      size: ``[1]`` int64 entries in use.
    """

    f: np.ndarray
    item: np.ndarray
    size: np.ndarray

    @classmethod
    def empty(cls, num_entries: int, dtype: np.dtype | type = np.int32) -> Self:
        """Return a heap with room for that many entries of a type."""
        return cls(np.zeros(num_entries), np.zeros(num_entries, dtype), np.zeros(1, np.int64))

    def grown(self) -> Self:
        """Return the heap with room for twice as many entries."""
        f, item = (np.concatenate([values, np.zeros_like(values)]) for values in (self.f, self.item))
        return self._replace(f=f, item=item)


@compiled()
def place(heap, f):
    """Make a place in a heap that has room for an entry of key ``f``, and return it: its item is to be filled in."""
    i = heap.size[0]
    heap.size[0] = i + 1
    while i > 0:
        up = (i - 1) >> 2
        if heap.f[up] <= f:
            break
        heap.f[i] = heap.f[up]
        heap.item[i] = heap.item[up]
        i = up
    heap.f[i] = f
    return i


@compiled()
def push(heap, f, item):
    """Put an entry into a heap that has room."""
    heap.item[place(heap, f)] = item


# Inlined by force: handing it the arrays took as long as what it does.
@compiled(forceinline=True)
def drop_top(heap):
    """Remove the lowest entry of a heap that has one."""
    last = heap.size[0] - 1
    heap.size[0] = last
    f, item = heap.f[last], heap.item[last]
    i = 0
    while True:
        first = 4 * i + 1
        if first >= last:
            break
        low = first
        for j in range(first + 1, min(first + 4, last)):
            if heap.f[j] < heap.f[low]:
                low = j
        if heap.f[low] >= f:
            break
        heap.f[i] = heap.f[low]
        heap.item[i] = heap.item[low]
        i = low
    heap.f[i] = f
    heap.item[i] = item
