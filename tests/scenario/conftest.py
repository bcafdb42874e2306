"""The town's maps, made once, and a copy of them for each test that asks for one."""

import shutil
import tomllib
from pathlib import Path

import pytest

from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from tests.cli_runs import TOWN


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    run_scenario(Scenario.from_dict(tomllib.loads(TOWN)), folder)
    return folder


@pytest.fixture
def job(finished, tmp_path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "job"))
