"""The city behind maps: read again from the files that the run which made them recorded."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from jaxurban.errors import GuessWarning, InputError
from jaxurban.io.city import City
from jaxurban.io.files import read_json
from jaxurban.io.stored import RUN_FILE, stored_maps, stored_settings
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.provenance import hash_inputs, unsized
from jaxurban.maps.scenario import Scenario
from jaxurban.world.kinds import ALL_KINDS, Obstacles

CityLike = City | MetricMaps | str | Path
EXACT = "exact outlines"
BY_CELLS = "by cells that roofs touch"
STANDING = (
    "buildings",
    "structures",
    "terrain",
    "vegetation",
)  # roles of the files that say what stands, and on which ground
NOT_LOOKED_AT = "Kinds of obstacles that were not looked at: {}."


class ChangedSourcesError(InputError):
    """A file that says what stands is there, and maps were made of another one."""


def scenario_of(folder: Path, sources: str | Path | None = None) -> Scenario:
    """Return the scenario of the run that made the maps in a folder, with relative paths from where its files lie.

    The record may come from another machine, so files count only if their sizes and SHA-256 are those that the run
    recorded.

    Args:
      folder: of the maps.
      sources: where relative paths begin; left out, the current folder, that of the maps, or the one above it.

    Raises:
      ChangedSourcesError: a file of buildings or terrain is there, and not as it was.
      InputError: maps that no scenario made, a damaged record, or files that are gone.
    """
    settings = stored_settings(folder)
    if "bounds" not in settings.get("region", {}):
        raise InputError(
            f"the maps in {str(folder)!r} were not made by `jaxurban maps`, so what they are of is not on record: make "
            "them by that command, or give the City itself where it is taken"
        )

    # The first place where all files are those of the record; otherwise the files that differ at the last place where
    # any of them are.
    inputs = read_json(folder / RUN_FILE).get("inputs", {})
    if not (isinstance(inputs, dict) and all(isinstance(file, dict) for file in inputs.values())):
        raise InputError(
            f"the inputs in {str(folder / RUN_FILE)!r} are not as a run records them: make the maps again"
        )
    recorded = unsized(inputs)
    places = [folder, folder.parent, Path()] if sources is None else [Path(sources)]
    lost = list(inputs.values())
    kind: type[InputError] = InputError
    for place in places:
        scenario = Scenario.from_dict(settings, str(folder / RUN_FILE), place)
        with suppress(InputError):  # raised where one of the files cannot be read
            files = unsized(hash_inputs(scenario, inputs))
            if files == recorded:
                return scenario
            altered = [role for role in files if recorded.get(role) != files[role]]
            if files:
                gone = recorded.keys() - files.keys()
                lost = [(inputs | files)[role] for role in (*altered, *gone)]
            if not {*STANDING}.isdisjoint(altered):
                kind = ChangedSourcesError
    names = ", ".join(repr(file.get("path")) for file in lost)
    raise kind(
        f"what the maps in {str(folder)!r} were made of is no longer there as it was ({names}): "
        "name the folder of these files (sources, --sources) or the scenario in it (scenario, --scenario), or make the "
        "maps again"
    )


def city_of(given: CityLike, sources: str | Path | None = None) -> City:
    """Return a city unchanged, or the one that maps were made of, read again from its files (`scenario_of`).

    Args:
      given: a city, maps that were opened from a folder, or that folder.
      sources: where relative paths of the files begin, as for `scenario_of`.

    Raises:
      InputError: maps that were made in memory, or files that are gone.
    """
    from jaxurban.maps.run import load_city  # imported here: it brings what makes maps

    return given if isinstance(given, City) else load_city(scenario_of(folder_of(given), sources))


class Standing(NamedTuple):
    """What is known of what stands on maps.

    Attributes:
      city: of the maps; None if it is gone, or its files have changed.
      reason: why the buildings are known by cells alone; empty where their exact outlines are.
      has_changed: its files are there, and not as they were.
    """

    city: City | None
    reason: str = ""
    has_changed: bool = False

    @property
    def outlines(self) -> str:
        """How the buildings are known."""
        return f"{BY_CELLS}, because {self.reason}" if self.reason else EXACT


def standing_on(maps: MetricMaps, sources: City | str | Path | None = None) -> Standing:
    """Return what stands on maps: the outlines of their city, or else the cells of the maps that roofs touch.

    It is the cells if the city's files are gone, or the city is a raster of heights without outlines.

    Args:
      maps: the maps, whose record names the city's files.
      sources: the city itself, or the folder at which the files' paths begin; None for the paths of the record.

    Raises:
      InputError: sources that are named and do not hold the city of these maps.
    """
    if isinstance(sources, str | Path) and maps.folder is None:
        raise InputError(
            f"sources must be the City that maps in memory were made of, got {str(sources)!r}"
        )
    try:
        with warnings.catch_warnings(action="ignore", category=GuessWarning):  # maps hold it
            city = sources if isinstance(sources, City) else city_of(maps, sources)
    except InputError as error:
        # Files that the caller has named must be there; those of the record may be gone.
        if sources is not None:
            raise
        return Standing(None, str(error), isinstance(error, ChangedSourcesError))
    if city.buildings is None:
        return Standing(city, "the city is a raster of heights")
    return Standing(city)


def left_out(maps: MetricMaps, city: City | None) -> str:
    """Return a sentence on the kinds of what stands that do not count on maps, as far as is known; else ``""``.

    Args:
      maps: the maps.
      city: that they are of; None for what their record says.
    """
    counted: Sequence[str] = ALL_KINDS
    if city is not None:
        counted = city.kinds
    elif maps.folder is not None:
        settings = stored_settings(maps.folder)
        obstacles = Obstacles(**settings.get("obstacles", {}))
        counted = obstacles.under(maps.planning.preset)
    kinds = [kind for kind in ALL_KINDS if kind not in counted]
    return NOT_LOOKED_AT.format(", ".join(kinds)) if kinds else ""


def folder_of(maps: MetricMaps | str | Path) -> Path:
    """Return the folder that maps were opened from, or a folder as it is.

    Raises:
      InputError: maps that were made in memory, or a folder without maps and without the record of any.
    """
    if not isinstance(maps, MetricMaps):
        folder = Path(maps)
        if not (folder / RUN_FILE).exists():
            stored_maps(folder)  # which refuses a folder without maps
        return folder
    if maps.folder is None:
        raise InputError(
            "maps that were made in memory do not hold their city: give the City that they were made of"
        )
    return maps.folder
