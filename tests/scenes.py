"""Scenes that tests of paths share: made maps with two far places, and the demo city."""

import numpy as np
import pytest

import jaxurban as ju
from tests.made_maps import made_maps
from tests.volumes import ends_at


@pytest.fixture(scope="session")
def maps() -> ju.MetricMaps:
    return made_maps()


@pytest.fixture(scope="session")
def ends(maps) -> dict:
    """Two places that are free at 20 m."""
    return ends_at(maps, *np.argwhere(maps.is_free(20.0))[[10, -10]])


@pytest.fixture(scope="session")
def folder(maps, tmp_path_factory):
    """The maps in a folder."""
    return maps.save(tmp_path_factory.mktemp("made") / "maps")


@pytest.fixture(scope="session")
def town() -> ju.MetricMaps:
    return ju.build_maps(ju.demo_city(1_000, 1_000), resolution_m=10.0, altitudes_m=(20.0, 600.0))


@pytest.fixture(scope="session")
def town_ends(town) -> dict:
    return ends_at(town, *np.argwhere(town.is_free(20.0))[[10, -10]])
