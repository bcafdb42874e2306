"""When Python looks for unused cycles of objects."""

import gc
import subprocess
import sys
import weakref
from contextlib import suppress

import pytest

import jaxurban as ju
from jaxurban.collector import MANY, paused_collector


def test_the_collector_is_off_in_the_block_and_as_before_after_it():
    assert gc.isenabled()
    with suppress(KeyError), paused_collector():
        assert not gc.isenabled()
        raise KeyError
    assert gc.isenabled()
    gc.disable()
    try:
        with paused_collector():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.fixture
def made():
    """Objects in great number, made in a block that pauses the collector."""
    assert gc.get_freeze_count() == 0
    with paused_collector():
        found: list[list] = [[] for _ in range(2 * MANY)]
    yield found
    gc.collect()
    gc.unfreeze()


def test_what_a_block_makes_in_great_number_is_left_out_of_the_search_until_all_is_looked_at(made):
    assert gc.get_freeze_count() >= len(made)
    gc.collect(1)
    assert gc.get_freeze_count() >= len(made)
    gc.collect()
    assert gc.get_freeze_count() == 0


def test_what_a_block_makes_in_small_number_is_not_left_out():
    with paused_collector():
        few = [[] for _ in range(10)]
    assert few
    assert gc.get_freeze_count() == 0


def test_cycles_from_before_and_in_a_block_are_found_once_everything_is_looked_at():
    class Node:
        pass

    nodes = [Node(), Node()]
    for node in nodes:
        node.itself = node  # type: ignore[attr-defined]
    seen = [weakref.ref(node) for node in nodes]
    with paused_collector():
        made: list[list] = [[] for _ in range(2 * MANY)]
    del node, nodes
    assert made
    assert None not in [each() for each in seen]
    gc.collect()
    assert [each() for each in seen] == [None, None]


def test_what_the_user_froze_stays_frozen(made):
    gc.freeze()  # more, after the block
    gc.collect()
    assert gc.get_freeze_count() > 0
    gc.unfreeze()
    gc.freeze()
    frozen = gc.get_freeze_count()
    with paused_collector():
        more: list[list] = [[] for _ in range(2 * MANY)]
    assert more
    assert made
    assert gc.get_freeze_count() <= frozen


def test_a_session_that_made_maps_ends_as_ever_what_its_user_made(tmp_path):
    """Handlers run, and a file in a cycle of objects is closed: its last words are on the disk."""
    script = """
import atexit, sys
import jaxurban as ju

class Log:
    pass

assert ju.build_maps  # imports enough to be left out of the search
log = Log()
log.itself, log.file = log, open(sys.argv[1], "w")
log.file.write("all of it")
atexit.register(print, "handler")
"""
    end = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "file")], capture_output=True, text=True, check=True
    )
    assert end.stdout.strip() == "handler"
    assert (tmp_path / "file").read_text() == "all of it"


def test_names_of_the_package_leave_it_on():
    assert ju.build_maps is not None
    with pytest.raises(AttributeError):
        _ = ju.no_such_name
    assert gc.isenabled()
