"""Python's search for unused cycles of objects, and when it is not worth its time."""

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

MANY = 10_000  # objects


@contextmanager
def paused_collector() -> Iterator[None]:
    """Look for no cycles in the block: imports make objects by the hundred thousand, all of them to stay.

    Looking at them again and again takes a quarter of an import. After a block that has made many they count as old,
    so that the next look at what is new is not at all of them.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            if gc.get_count()[0] > MANY and not gc.get_freeze_count():
                gc.freeze()
                gc.unfreeze()  # what was frozen is in the oldest generation now, and nothing has been looked at
            gc.enable()


def collect_seldom() -> None:
    """Let this process look for cycles seldom, and not once more at its end: of millions of outlines it finds none.

    It takes a tenth of the time of a run otherwise.
    """
    gc.set_threshold(10_000, 10, 10)
    leave_cycles_at_exit()


@cache
def leave_cycles_at_exit() -> None:
    """Let this process end without a last look for cycles, of which its libraries alone hold a million objects.

    Taking these apart one by one takes a quarter of the time of a process that makes small maps; the system takes all
    memory back at once. Python promises no finaliser at its end either; handlers of `atexit` run as ever, and what is
    in no cycle, as an open file, is closed as ever.
    """
    atexit.register(gc.freeze)
