"""Python's search for unused cycles of objects, and when it is not worth its time."""

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager

MANY = 10_000  # objects
FULL = 2  # the generation of a search through everything


class _Frozen:
    """How many objects `paused_collector` has left out of the search; 0: none, or no longer."""

    num = 0


@contextmanager
def paused_collector() -> Iterator[None]:
    """Look for no cycles in the block: imports make objects by the hundred thousand, all of them to stay.

    Looking at them again and again takes a quarter of an import. After a block that has made many, all that is there is
    left out of the search until Python looks through everything, as it does in a session that goes on; a short one ends
    without taking a million objects apart one by one. Does nothing where the user has frozen objects.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            if gc.get_count()[0] > MANY and gc.get_freeze_count() <= _Frozen.num:
                _freeze()
            gc.enable()


def _freeze() -> None:
    if _take_up not in gc.callbacks:
        gc.callbacks.append(_take_up)
        atexit.register(_leave)
    gc.freeze()
    _Frozen.num = gc.get_freeze_count()


def _leave() -> None:
    """Let the last search of a process go without what `_freeze` left out."""
    if _take_up in gc.callbacks:  # the user may have emptied the list
        gc.callbacks.remove(_take_up)


def _take_up(phase: str, info: dict[str, int]) -> None:
    """Search among what `_freeze` left out too, where everything is searched, unless the user has frozen more since."""
    if phase == "start" and info["generation"] == FULL and 0 < gc.get_freeze_count() <= _Frozen.num:
        _Frozen.num = 0
        gc.unfreeze()


def collect_seldom() -> None:
    """Let this process look for cycles seldom, and not once more at its end: of millions of outlines it finds none.

    It takes a tenth of the time of a run otherwise.
    """
    gc.set_threshold(10_000, 10, 10)
    atexit.register(gc.freeze)
