"""The town's maps, made by one command, for all tests of the command line."""

from pathlib import Path

import pytest

from jaxurban.cli import main as cli
from tests.cli_runs import TOWN


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """Return a folder of maps; beside it lies the scenario that they are of."""
    folder = tmp_path_factory.mktemp("town")
    (folder / "town.toml").write_text(TOWN, encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        cli.main(["maps", str(folder / "town.toml"), "-o", str(folder / "maps")])
    assert ended.value.code == 0
    return folder / "maps"
