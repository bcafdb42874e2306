"""Which cells see the same satellites: every pattern of visibility words once, and its number for each cell."""

import numpy as np
from jaxtyping import Bool, Int32, UInt

from jaxurban.kernels.compiled import compiled

MOST_WORDS = 2  # of a pattern: 64 satellites
LEAST_SLOTS = 1 << 12  # of the table that finds a pattern's number; a power of two, as every larger one
# 2^64 over the golden ratio: high bits of products spread patterns over the slots.
MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
FREE = -1


def distinct_patterns(
    words: UInt[np.ndarray, "W N"], is_nothing: Bool[np.ndarray, " N"], most: int
) -> tuple[UInt[np.ndarray, "W P"], Int32[np.ndarray, " N"]] | None:
    """Return every pattern of the words once, in the order in which they come, and the number of each cell's.

    None where there are more patterns than ``most``, or more words than `MOST_WORDS`.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; ``N`` cells.
      is_nothing: cells that see no satellite, whatever the words say.
      most: how many patterns are worth it.
    """
    if len(words) > MOST_WORDS:
        return None
    patterns, number = np.empty(most, np.uint64), np.empty(words.shape[1], np.int32)
    slots, cell, num = np.full(LEAST_SLOTS, FREE, np.int32), 0, 0
    while cell < len(number):
        cell, num = _number_on(words, is_nothing, patterns, number, slots, cell, num)
        if cell < len(number):
            if num == most:
                return None
            slots = np.full(4 * len(slots), FREE, np.int32)
            _fill_slots(patterns[:num], slots)
    parts = [(patterns[:num] >> np.uint64(32 * w)).astype(np.uint32) for w in range(len(words))]
    return np.array(parts), number


@compiled(nogil=True)
def _number_on(words, is_nothing, patterns, number, slots, cell, num):
    """Number cells from one on with their patterns ``[P]``, of which ``num`` are known, as far as they and slots go.

    Return the first cell that has no number yet, and how many patterns are known. The table of slots is not made anew
    here: in a loop that does, Numba counts references at every cell, which takes four times as long as the work.
    """
    last, own = FREE, np.uint64(0)
    for at in range(cell, words.shape[1]):
        pattern = np.uint64(words[0, at])
        if len(words) > 1:
            pattern |= np.uint64(words[1, at]) << np.uint64(32)
        if is_nothing[at]:
            pattern = np.uint64(0)
        if last == FREE or pattern != own:  # not as the cell before
            own = pattern
            slot = _slot(pattern, patterns, slots)
            last = slots[slot]
            if last == FREE:
                if num == len(patterns) or 2 * num >= len(slots):
                    return at, num
                patterns[num], slots[slot], last = pattern, num, num
                num += 1
        number[at] = last
    return words.shape[1], num


@compiled(nogil=True)
def _fill_slots(patterns, slots):
    """Enter the numbers of patterns into free slots."""
    for number in range(len(patterns)):
        slots[_slot(patterns[number], patterns, slots)] = number


@compiled(nogil=True)
def _slot(pattern, patterns, slots):
    """Return the slot that holds a pattern's number, or the free one for it."""
    slot = np.int64((pattern * MULTIPLIER) >> np.uint64(32)) & (len(slots) - 1)
    while slots[slot] != FREE and patterns[slots[slot]] != pattern:
        slot = (slot + 1) & (len(slots) - 1)
    return slot


@compiled(nogil=True)
def look_up(table, number, found):
    """Fill ``found`` ``[V, N]`` with the row of a table ``[P, V]`` that each cell's number names."""
    for cell in range(len(number)):
        for v in range(len(found)):
            found[v, cell] = table[number[cell], v]
