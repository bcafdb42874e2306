"""Maps, folders of them, routes and studies that the tests of this folder share; no test changes any."""

from pathlib import Path

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.studies.demonstrations import optimal_demonstrations
from jaxurban.studies.queries import RouteQuery
from jaxurban.typing import Sensitivity
from tests.made_maps import made_maps
from tests.studies.routes_made import HIDDEN, NUM, made_queries, run_study, small_maps, with_noise


@pytest.fixture(scope="session")
def alpha() -> ju.MetricMaps:
    return made_maps(60, 70)


@pytest.fixture(scope="session")
def folders(alpha, tmp_path_factory) -> list[Path]:
    """Return folders of two cities: beta has alpha's streets, a layer of noise and no people."""
    folder = tmp_path_factory.mktemp("maps")
    beta = with_noise(alpha, np.random.default_rng(4).random(alpha.grid.shape))
    alpha.save(folder / "alpha")
    ju.MetricMaps(beta.ds.drop_vars(["population", "density", "time_of_day"])).save(folder / "beta")
    return [folder / "alpha", folder / "beta"]


@pytest.fixture(scope="session")
def study(folders, tmp_path_factory):
    return run_study("study", folders, tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="session")
def weight_study(folders, tmp_path_factory) -> Sensitivity:
    return run_study("weight_study", folders, tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="session")
def noisy() -> ju.MetricMaps:
    """Return small maps with a layer of noise: a loud stripe that the straight way crosses, and a gap in it."""
    made = made_maps(30, 36)
    loud = np.zeros(made.grid.shape)
    loud[4:, 16:20] = 1.0
    return with_noise(made, loud)


@pytest.fixture(scope="session")
def crossed(noisy) -> ju.MetricMaps:
    return ju.MetricMaps(noisy.ds.drop_vars("noise"))


@pytest.fixture(scope="session")
def crossing(crossed) -> RouteQuery:
    return RouteQuery(ju.cost_map(crossed, 20.0, cost_model="line"), (4, 1), (28, 34))


@pytest.fixture(scope="session")
def ends(crossed, crossing) -> list[tuple[float, float]]:
    """Return longitude and latitude of the crossing's start and goal."""
    return [
        tuple(map(float, crossed.grid.lonlat_of_cell(*cell)))
        for cell in (crossing.start, crossing.goal)
    ]


@pytest.fixture(scope="session")
def small() -> ju.MetricMaps:
    return small_maps()


@pytest.fixture(scope="session")
def demonstrations(small):
    return optimal_demonstrations(
        made_queries(ju.cost_map(small, 20.0, cost_model="cell"), NUM), HIDDEN
    )
