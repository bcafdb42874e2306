"""What is open in compiled searches, lowest first: a 4-ary heap, and for grids buckets of about equal f."""

from typing import NamedTuple, Self

import numpy as np

from jaxurban.kernels.compiled import compiled

# How a chunk of search ended: FULL for want of room in the heap.
FOUND, EXHAUSTED, PAUSED, FULL = range(4)
UNREACHED = 0  # a node's state as long as no way to it is known: its g is not written yet
PARENT_STEP = 0x1F  # bits of the state after that: the step by which it was reached ...
NO_STEP = 0x1F  # ... or this, at the start
CLOSED = 0x20
REACHED = 0x40
NUM_BUCKETS = 2048
BUCKETS_PER_STEP = 32  # in the cost of a typical step: wider ones hold more to expand again
NUM_FAR, FREE_SLOT, BUCKET, IS_HEAP = range(4)  # places in a queue's ``tally``
NO_SLOT = -1
AS_STACK, AS_HEAP = np.int64(0), np.int64(1)  # how entries are kept: what ``IS_HEAP`` may be
NO_PARENT = -1  # of a node of a tree: it is the start, or outside


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
        f, item = (
            np.concatenate([values, np.zeros_like(values)]) for values in (self.f, self.item)
        )
        return self._replace(f=f, item=item)


# Inlined by force, both: handing them the arrays took as long as what they do.
@compiled(forceinline=True)
def place(heap, f, is_heap):
    """Make a place for an entry of key ``f`` in a heap that has room, and return its index.

    The heap's size and keys are altered; the caller must fill in ``heap.item`` at the index. Parents with larger keys
    move down until the place is right. With `AS_STACK` for ``is_heap`` instead of `AS_HEAP` the place is the last.
    """
    i = heap.size[0]
    heap.size[0] = i + 1
    while is_heap and i > 0:
        up = (i - 1) >> 2  # the parent, as every entry has up to four children
        if heap.f[up] <= f:
            break
        heap.f[i] = heap.f[up]
        heap.item[i] = heap.item[up]
        i = up
    heap.f[i] = f
    return i


@compiled(forceinline=True)
def drop_top(heap):
    """Remove the lowest entry of a heap that has one, in place.

    The last entry takes its place, and goes down past smaller children until none of its own is smaller.
    """
    last = heap.size[0] - 1
    heap.size[0] = last
    f, item = heap.f[last], heap.item[last]
    i = 0
    while True:
        first = 4 * i + 1
        if first >= last:
            break
        low = first  # the lowest child
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


class Queue(NamedTuple):
    """Open nodes by f: those of the lowest bucket, and lists of those of later buckets of equal width. ``Q`` entries.

    An entry waits unsorted in its bucket until all of lower buckets are taken. Within one the newest comes first, so
    that a cheaper way to a node may turn up after it was expanded; it is then expanded again. Where that happens often,
    as where costs spread over many decades, the lowest bucket becomes a 4-ary heap for the rest of the search.

    Attributes:
      near: the nodes, int32, of the buckets up to the current one: a stack, or a heap.
      far_f, far_node, far_next: ``[Q]`` slots of the linked lists of later buckets; the next slot, int32.
      first: ``[B + 1]`` int32 first slot of each bucket, and of what lies beyond them. Once they are empty
        they begin again at the lowest f beyond.
      tally: ``[4]`` int64 entries in the lists, first free slot, current bucket, and whether ``near`` is a heap.
      scale: ``[2]`` f where the buckets begin, and buckets per cost; 0: all is in the lowest bucket.
    """

    near: Heap
    far_f: np.ndarray
    far_node: np.ndarray
    far_next: np.ndarray
    first: np.ndarray
    tally: np.ndarray
    scale: np.ndarray


def empty_queue(num_entries: int, step: float) -> Queue:
    """Return an empty queue.

    Args:
      num_entries: entries that it has room for.
      step: cost of a typical step, which sets the width of the buckets; 0: all entries go into the heap. The order of
        entries does not depend on it, but for entries of equal f.
    """
    return Queue(
        near=Heap.empty(num_entries),
        far_f=np.empty(num_entries),
        far_node=np.empty(num_entries, np.int32),
        far_next=np.arange(1, num_entries + 1, dtype=np.int32),
        first=np.full(NUM_BUCKETS + 1, NO_SLOT, np.int32),
        tally=np.zeros(4, np.int64),
        scale=np.array([0.0, BUCKETS_PER_STEP / step if step > 0 else 0.0]),
    )


def grown(queue: Queue) -> Queue:
    """Return the queue with room for twice as many entries; what stands in the new slots has no meaning yet."""
    size = queue.far_next.size
    return queue._replace(
        near=queue.near.grown(),
        far_f=np.resize(queue.far_f, 2 * size),
        far_node=np.resize(queue.far_node, 2 * size),
        # The last free slot leads to the first new one.
        far_next=np.concatenate(
            [queue.far_next, np.arange(size + 1, 2 * size + 1, dtype=np.int32)]
        ),
    )


@compiled(forceinline=True)
def insert(queue, f, node):
    """Put a node into a queue that has room: into its heap, or first in the list of a later bucket."""
    tally = queue.tally
    bucket = (f - queue.scale[0]) * queue.scale[1]
    if not bucket >= tally[BUCKET] + 1:  # NaN, of an infinite f, comes here too
        queue.near.item[place(queue.near, f, tally[IS_HEAP])] = node
        return

    # Take a free slot, and put it before the bucket's first one; beyond the buckets there is one list for all.
    index = int(min(bucket, float(NUM_BUCKETS)))
    slot = tally[FREE_SLOT]
    tally[FREE_SLOT] = queue.far_next[slot]
    queue.far_f[slot] = f
    queue.far_node[slot] = node
    queue.far_next[slot] = queue.first[index]
    queue.first[index] = slot
    tally[NUM_FAR] += 1


@compiled(forceinline=True)
def refill(queue, state):
    """Bring the next bucket's entries into the heap if it is empty; it stays empty where no bucket is left.

    A node that was closed meanwhile, at a lower f, is left out.

    Args:
      queue: altered.
      state: ``[M]`` of the search, by node (see `planners.grid_search.advance`).
    """
    tally = queue.tally
    while queue.near.size[0] == 0 and tally[NUM_FAR] > 0:
        index = tally[BUCKET] + 1
        tally[BUCKET] = index

        # Behind the last bucket: begin with the first one again, at the lowest f of what lies beyond, which is all that
        # is left. Where most of it would lie beyond again, buckets become wider.
        if index == NUM_BUCKETS:
            tally[BUCKET] = 0
            lowest_f, total = np.inf, 0.0
            slot = queue.first[index]
            while slot != NO_SLOT:
                lowest_f = min(lowest_f, queue.far_f[slot])
                total += queue.far_f[slot]
                slot = queue.far_next[slot]
            queue.scale[0] = lowest_f
            if (total / tally[NUM_FAR] - lowest_f) * queue.scale[1] > NUM_BUCKETS:
                queue.scale[1] *= 0.5

        # Empty the list: slots become free, and nodes go into the heap, or into later buckets.
        slot = queue.first[index]
        queue.first[index] = NO_SLOT
        while slot != NO_SLOT:
            next_slot = queue.far_next[slot]
            queue.far_next[slot] = tally[FREE_SLOT]
            tally[FREE_SLOT] = slot
            tally[NUM_FAR] -= 1
            node = np.int64(queue.far_node[slot])
            if not state[np.uint64(node)] & CLOSED:
                insert(queue, queue.far_f[slot], node)
            slot = next_slot
