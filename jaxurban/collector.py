"""Python's search for unused cycles of objects, and when it is not worth its time."""

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def paused_collector() -> Iterator[None]:
    """Look for no cycles in the block: imports make objects by the hundred thousand, all of them to stay.

    Looking at them again and again takes a quarter of an import.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def collect_seldom() -> None:
    """Let this process look for cycles seldom, and not once more at its end: of millions of outlines it finds none.

    It takes a tenth of the time of a run otherwise.
    """
    gc.set_threshold(10_000, 10, 10)
    atexit.register(gc.freeze)
