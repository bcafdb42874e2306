"""The scenario that a command names by its file, or by a folder of maps."""

from collections.abc import Sequence
from pathlib import Path

from jaxurban.io.stored import RUN_FILE, stored_settings
from jaxurban.maps.scenario import Scenario, changed


def read_scenario(path: Path, changes: Sequence[str] = ()) -> Scenario:
    """Return the scenario in a file (`Scenario.from_toml`), or that of the run that made the maps in a folder.

    Raises:
      InputError: as of either of the two.
    """
    if not path.is_dir():
        return Scenario.from_toml(path, changes)
    from jaxurban.maps.sources import folder_of, scenario_of  # here: they bring what reads cities

    settings = changed(stored_settings(folder_of(path)), changes)
    return Scenario.from_dict(settings, str(path / RUN_FILE), scenario_of(path).path_of(""))
