"""When Python looks for unused cycles of objects."""

import gc
from contextlib import suppress

import pytest

import jaxurban as ju
from jaxurban.collector import paused_collector


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


def test_names_of_the_package_leave_it_on():
    assert ju.build_maps is not None
    with pytest.raises(AttributeError):
        _ = ju.no_such_name
    assert gc.isenabled()
