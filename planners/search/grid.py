"""The compiled A* search: a heap behind buckets, run in bounded chunks that the caller resumes."""

import time
from typing import NamedTuple

import numpy as np

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import EXHAUSTED, FOUND, FULL, PAUSED, Heap, drop_top, push
from jaxurban.kernels.search.prefetch import prefetch
from jaxurban.kernels.search.tiles import tile_estimate
from jaxurban.planners.base import Cell
from jaxurban.planners.graph import Graph, Heuristic
from jaxurban.planners.moves import STEPS, steps_back

UNREACHED = 0  # a node's state as long as no way to it is known: its g is not written yet
PARENT_STEP = 0x0F  # bits of the state after that: the step by which it was reached ...
NO_PARENT = 0x08  # ... or this, at the start
CLOSED = 0x10
REACHED = 0x40
MAX_STEPS = 8
NOWHERE = -1  # a goal that is never met
CHUNK = 200_000  # expansions between two looks at the clock: some 50 ms
FIRST_ENTRIES = 4096  # of a queue; doubled when full
NUM_BUCKETS = 2048
BUCKETS_PER_STEP = 512  # in the cost of a typical step: some five entries a bucket on city maps
NUM_FAR, FREE_SLOT, BUCKET = 0, 1, 2  # places in a queue's ``tally``
NO_SLOT = -1
ROUNDING = 1 - 1e-12  # a closed node is not worth expanding again for a gain that rounding explains


class Queue(NamedTuple):
    """Open nodes by f: a 4-ary heap of the lowest, and buckets of equal width for the rest. ``Q`` entries.

    A heap of all open nodes took two thirds of a search, most of it in mispredicted branches on the way
    down. Here an entry waits unsorted in its bucket until all of lower buckets are taken, and the heap
    stays a dozen entries high. The order is that of one heap, but among equal f.

    Attributes:
      near: heap of the nodes, int32, of the buckets up to the current one.
      far_f, far_node, far_next: ``[Q]`` slots of the linked lists of later buckets; the next slot, int32.
      first: ``[B + 1]`` int32 first slot of each bucket, and of what lies beyond them. Once they are empty
        they begin again at the lowest f beyond.
      tally: ``[3]`` int64 entries in the lists, first free slot, current bucket.
      scale: ``[2]`` f where the buckets begin, and buckets per cost; 0: all is in the heap.
    """

    near: Heap
    far_f: np.ndarray
    far_node: np.ndarray
    far_next: np.ndarray
    first: np.ndarray
    tally: np.ndarray
    scale: np.ndarray


def empty_queue(graph: Graph, num_entries: int) -> Queue:
    """Return a queue with room for that many entries, its buckets fitted to the graph's costs (the order never is)."""
    cost = float(graph.sample.mean()) if graph.sample.size else 0.0
    step = float(np.mean(graph.step_cost + (graph.from_share + graph.to_share) * cost))
    return Queue(
        near=Heap.empty(num_entries),
        far_f=np.empty(num_entries),
        far_node=np.empty(num_entries, np.int32),
        far_next=np.arange(1, num_entries + 1, dtype=np.int32),
        first=np.full(NUM_BUCKETS + 1, NO_SLOT, np.int32),
        tally=np.zeros(3, np.int64),
        scale=np.array([0.0, BUCKETS_PER_STEP / step if step > 0 else 0.0]),
    )


def grown(queue: Queue) -> Queue:
    """Return the queue with room for twice as many entries."""
    size = queue.far_next.size
    return queue._replace(
        near=queue.near.grown(),
        far_f=np.resize(queue.far_f, 2 * size),
        far_node=np.resize(queue.far_node, 2 * size),
        # The last free slot leads to the first new one.
        far_next=np.concatenate([queue.far_next, np.arange(size + 1, 2 * size + 1, dtype=np.int32)]),
    )


class GridNodes(NamedTuple):
    """What is known of each node, and those that are open. ``M`` nodes.

    Attributes:
      g: ``[M]`` float64 cost of the cheapest way found to each node; anything where it is `UNREACHED`.
      state: ``[M]`` uint8 (see `UNREACHED` and the names after it).
      queue: the open nodes.
    """

    g: np.ndarray
    state: np.ndarray
    queue: Queue


@compiled(forceinline=True)
def insert(queue, f, node):
    """Put a node into a queue that has room."""
    tally = queue.tally
    bucket = (f - queue.scale[0]) * queue.scale[1]
    if not bucket >= tally[BUCKET] + 1:  # NaN, of an infinite f, comes here too
        push(queue.near, f, node)
        return
    place = int(min(bucket, NUM_BUCKETS))
    slot = tally[FREE_SLOT]
    tally[FREE_SLOT] = queue.far_next[slot]
    queue.far_f[slot] = f
    queue.far_node[slot] = node
    queue.far_next[slot] = queue.first[place]
    queue.first[place] = slot
    tally[NUM_FAR] += 1


@compiled(forceinline=True)
def refill(queue, graph, g, state):
    """Bring the next bucket's entries into an empty heap; it stays empty where no bucket is left.

    They will soon be expanded, so what is known of them and of their neighbours is asked for now. Those that have been
    by now, from a lower f, are left out.
    """
    tally = queue.tally
    while queue.near.size[0] == 0 and tally[NUM_FAR] > 0:
        place = tally[BUCKET] + 1
        tally[BUCKET] = place
        if place == NUM_BUCKETS:
            tally[BUCKET] = 0
            queue.scale[0] = np.inf
            slot = queue.first[place]
            while slot != NO_SLOT:
                queue.scale[0] = min(queue.scale[0], queue.far_f[slot])
                slot = queue.far_next[slot]
        slot = queue.first[place]
        queue.first[place] = NO_SLOT
        while slot != NO_SLOT:
            next_slot = queue.far_next[slot]
            queue.far_next[slot] = tally[FREE_SLOT]
            tally[FREE_SLOT] = slot
            tally[NUM_FAR] -= 1
            node = np.int64(queue.far_node[slot])
            if not state[np.uint64(node)] & CLOSED:
                insert(queue, queue.far_f[slot], node)
                prefetch(graph.moves, node)
                for beside in (node - graph.num_cols, node, node + graph.num_cols):
                    prefetch(g, beside)
                    prefetch(state, beside)
                    prefetch(graph.cost, beside)
            slot = next_slot


# Inlined by force: LLVM would not, and counting references to the arrays took four fifths of the time.
@compiled(forceinline=True)
def _raised(value, landmarks, tiles, row, col):
    """Return the larger of a bound and of what landmarks or tiles prove, where there are any."""
    if tiles is not None:  # decided when it is compiled
        return max(value, tile_estimate(tiles, row, col))
    if landmarks is None:  # likewise
        return value
    apart = 0.0
    for k in range(landmarks.at_goal.size):
        # A landmark that reaches only one of the two proves that there is no way (inf); one that reaches
        # neither says nothing (inf - inf is NaN, and greater than nothing).
        difference = abs(landmarks.costs[row, col, k] - landmarks.at_goal[k])
        if difference > apart:
            apart = difference
    return max(value, apart + landmarks.goal_term - landmarks.cost_share * landmarks.cost[row, col])


@compiled(forceinline=True)
def estimate(heuristic, row, col, goal_row, goal_col):
    """Return ``h`` at a cell (see `Heuristic`)."""
    dr, dc = abs(row - goal_row), abs(col - goal_col)
    value = heuristic.straight * max(dr, dc) + heuristic.diagonal * min(dr, dc)
    if heuristic.euclidean > 0.0:
        value += heuristic.euclidean * np.sqrt(float(dr * dr + dc * dc))
    if heuristic.field.size:
        return value + heuristic.field[row, col]
    return _raised(value, heuristic.landmarks, heuristic.tiles, row, col)


@compiled(nogil=True)
def advance(graph, heuristic, goal, reopen, nodes, max_expanded):
    """Expand nodes in order of f until the goal is met, none is open, or ``max_expanded`` are done.

    ``f = g + h``. The queue holds outdated entries, which are skipped: a node's newest entry is
    its lowest. Equal f come in an order that only the problem decides, so runs repeat. With ``reopen`` a cheaper way to
    a closed node opens it again.

    All neighbours are looked at before any is changed, without branches, which would go the wrong way half of the time.

    Returns: how the chunk ended, and the nodes expanded.
    """
    goal_row, goal_col = goal // graph.num_cols, goal % graph.num_cols
    offsets = graph.steps[:, 0] * graph.num_cols + graph.steps[:, 1]
    g, state, queue = nodes.g, nodes.state, nodes.queue
    near = queue.near
    # A way to a node is cheaper where it costs less than this times the way known; a closed node that is kept has none.
    if_closed = ROUNDING if reopen else -1.0
    cheaper_steps, cheaper_gs = np.empty(MAX_STEPS, np.uint64), np.empty(MAX_STEPS)
    num_expanded = 0
    while True:
        if near.size[0] == 0:
            refill(queue, graph, g, state)
        if near.size[0] == 0 or near.f[0] == np.inf:
            return EXHAUSTED, num_expanded
        if num_expanded >= max_expanded:
            return PAUSED, num_expanded
        if near.size[0] + queue.tally[NUM_FAR] + MAX_STEPS > queue.far_f.size:
            return FULL, num_expanded
        node = np.uint64(near.item[0])  # unsigned: else Numba asks each time whether it counts from the end
        if state[node] & CLOSED:
            drop_top(near)
            continue
        row, col = np.uint32(node) // np.uint32(graph.num_cols), np.uint32(node) % np.uint32(graph.num_cols)
        drop_top(near)
        state[node] |= CLOSED
        if node == goal:
            return FOUND, num_expanded
        num_expanded += 1
        moves, node_g, node_cost = graph.moves[node], g[node], graph.cost[node]
        num_cheaper = 0
        for k in range(MAX_STEPS):
            is_allowed = (moves >> k) & 1
            to = np.uint64(np.int64(node) + offsets[k] * is_allowed)
            to_g = node_g + (graph.step_cost[k] + graph.from_share[k] * node_cost + graph.to_share[k] * graph.cost[to])
            known_g, to_state = g[to], state[to]
            limit = known_g * (if_closed if to_state & CLOSED else 1.0)
            limit = np.inf if to_state == UNREACHED else limit
            cheaper_steps[num_cheaper], cheaper_gs[num_cheaper] = k, to_g
            num_cheaper += is_allowed & (to_g < limit)
        for i in range(num_cheaper):
            k, to_g = cheaper_steps[i], cheaper_gs[i]
            to = np.uint64(np.int64(node) + offsets[k])
            g[to] = to_g
            state[to] = k | REACHED
            to_row, to_col = np.int64(row) + graph.steps[k, 0], np.int64(col) + graph.steps[k, 1]
            to_h = estimate(heuristic, to_row, to_col, goal_row, goal_col)
            insert(queue, to_g + to_h, to)


class GridSearch:
    """A search in progress: what is known of each node, and the queue of open ones. ``M`` nodes.

    Attributes:
      graph, heuristic: what is searched, by which bound.
      start, goal: nodes; the goal `NOWHERE` is never met.
      num_expanded: nodes expanded so far.
    """

    def __init__(self, graph: Graph, heuristic: Heuristic, start: Cell, goal: Cell | None) -> None:
        self.graph, self.heuristic = graph, heuristic
        self.start = start[0] * graph.num_cols + start[1]
        self.goal = NOWHERE if goal is None else goal[0] * graph.num_cols + goal[1]
        self.num_expanded = 0
        num_nodes = graph.cost.size
        queue = empty_queue(graph, FIRST_ENTRIES)
        # Memory that is not written to is not taken: what the search does not come to costs nothing.
        self._nodes = GridNodes(np.empty(num_nodes), np.zeros(num_nodes, np.uint8), queue)
        self._nodes.g[self.start], self._nodes.state[self.start] = 0.0, NO_PARENT | REACHED
        insert(queue, 0.0 if goal is None else estimate(heuristic, *start, *goal), self.start)

    def cost_to(self, node: int) -> float:
        """Return the cost of the cheapest way found to a node, inf without one."""
        return np.inf if self._nodes.state[node] == UNREACHED else float(self._nodes.g[node])

    def costs_from_start(self) -> np.ndarray:
        """Return ``[M]`` float64 the cost of the cheapest way found to each node, inf without one."""
        np.copyto(self._nodes.g, np.inf, where=self._nodes.state == UNREACHED)
        return self._nodes.g

    @property
    def low_f(self) -> float:
        """The least f in the queue, inf where it is empty."""
        near = self._nodes.queue.near
        if not near.size[0]:
            refill(self._nodes.queue, self.graph, self._nodes.g, self._nodes.state)
        return float(near.f[0]) if near.size[0] else np.inf

    def run(self, *, reopen: bool = False, end_s: float = np.inf) -> int:
        """Search on and return FOUND (the goal was met), EXHAUSTED (no node is open) or PAUSED.

        Args:
          reopen: expand a closed node again where a cheaper way to it turns up.
          end_s: time of `time.perf_counter` at which to pause; heeded within some 50 ms.
        """
        while True:
            ended, num_done = advance(self.graph, self.heuristic, self.goal, reopen, self._nodes, CHUNK)
            self.num_expanded += num_done
            if ended in (FOUND, EXHAUSTED):
                return int(ended)
            if ended == FULL:
                self._nodes = self._nodes._replace(queue=grown(self._nodes.queue))
            if time.perf_counter() >= end_s:
                return PAUSED

    def points_m(self, resolution_m: float) -> np.ndarray:
        """Return ``[N, 2]`` the cell centres from start to goal, by the steps that led to each cell."""
        state = self._nodes.state.reshape(-1, self.graph.num_cols)
        start, goal = (divmod(node, self.graph.num_cols) for node in (self.start, self.goal))
        cells = steps_back(start, goal, lambda row, col: STEPS[state[row, col] & PARENT_STEP])
        return (cells[:, ::-1] + 0.5) * resolution_m
