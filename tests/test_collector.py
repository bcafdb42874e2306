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


def test_what_a_block_makes_in_great_number_counts_as_old():
    with paused_collector():
        made: list[list] = [[] for _ in range(2 * MANY)]
    assert gc.get_count()[0] < MANY
    young = {id(each) for generation in (0, 1) for each in gc.get_objects(generation)}
    assert not young & {id(each) for each in made}
    assert gc.get_freeze_count() == 0


def test_cycles_of_a_block_are_found_once_everything_is_looked_at():
    class Node:
        pass

    with paused_collector():
        made: list[list] = [[] for _ in range(2 * MANY)]
        node = Node()
        node.itself = node  # type: ignore[attr-defined]
        seen = weakref.ref(node)
        del node
    assert seen() is not None
    gc.collect()
    assert seen() is None
    assert made


def test_what_the_user_froze_stays_frozen():
    gc.freeze()
    try:
        with paused_collector():
            made: list[list] = [[] for _ in range(2 * MANY)]
        assert gc.get_freeze_count() > 0
        assert made
    finally:
        gc.unfreeze()


def test_a_process_that_leaves_cycles_closes_files_and_runs_handlers_at_its_end(tmp_path):
    script = """
import atexit, sys
from jaxurban.collector import leave_cycles_at_exit
atexit.register(lambda: print("handler"))
leave_cycles_at_exit()
file = open(sys.argv[1], "w")
file.write("all of it")
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
