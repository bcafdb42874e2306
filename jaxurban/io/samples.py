"""Which cities the package holds, and how ``sample:CITY`` and ``sample:CITY/FILE`` name their files.

Such names stand where a setting takes the path of a file: they mean the same on every machine.
"""

from collections.abc import Collection, Mapping
from pathlib import Path, PurePath
from typing import Any

from jaxurban.checks import nearest_name
from jaxurban.errors import InputError

PREFIX = "sample:"
HOME = Path(__file__).parents[1] / "samples"  # a folder per city
BUILDINGS_FILE = "buildings.parquet"
STRUCTURES_FILE = "structures.parquet"
BASE_MAP_FILE = "basemap.parquet"
LOG_FILE = "log.csv.gz"
SAMPLES: dict[
    str, dict[str, dict[str, Any]]
] = {  # what a scenario of each takes where it says nothing
    "lower-manhattan": {
        "region": {"bounds": [-74.02, 40.70, -73.98, 40.73]},
        "population": {
            "blocks": "sample:lower-manhattan/blocks.parquet",
            "districts": "sample:lower-manhattan/districts.parquet",
            "credit": "US Census Bureau; NYC Open Data",
        },
        "gps": {
            "orbits": ["sample:lower-manhattan/gps.tle"],
            "times": ["2020-04-27T16:00:00Z"],
        },  # the paper's day
    },
    "shinjuku": {
        "region": {
            "bounds": [139.6890, 35.6806, 139.7111, 35.6986]
        },  # 2 x 2 km, the station in the middle
        "gps": {
            "orbits": ["sample:shinjuku/gps.tle", "sample:shinjuku/galileo.tle"],
            "times": ["2018-12-19T03:00:00Z"],  # noon in Tokyo
        },
    },
    "nihonbashi": {
        "region": {  # the drive of its log and 60 m around
            "bounds": [139.7628, 35.6725, 139.7704, 35.6840],
            "resolution_m": 2.0,
        },
        "gps": {
            "orbits": ["sample:nihonbashi/gps.tle", "sample:nihonbashi/galileo.tle"],
            "times": ["2023-06-22T01:10:00Z"],  # of the drive, 10:10 in Tokyo
            "mask_deg": 10.0,
        },
    },
}


def is_sample(name: Any) -> bool:
    """Return whether a name is that of a file of a sample city, or of the city."""
    return isinstance(name, str | Path) and str(name).startswith(PREFIX)


def sample_name(source: Any) -> str | None:
    """Return the city that ``sample:CITY`` names, None for what is no such name.

    Raises:
      InputError: there is no such city.
    """
    if not is_sample(source):
        return None
    name = str(source).removeprefix(PREFIX)
    if "/" in name:
        return None
    check_sample(name)
    return name


def log_of(source: Any) -> str | None:
    """Return the name of the receiver's log that the sample city ``sample:CITY`` has, None where there is none.

    Raises:
      InputError: there is no such city.
    """
    return _file_of(source, LOG_FILE)


def structures_of(source: Any, kinds: Collection[str]) -> str | None:
    """Return the name of the file of what stands beside the buildings of ``sample:CITY``, None where there is none.

    Args:
      source: of the buildings.
      kinds: that count; without any but buildings the file is left out.

    Raises:
      InputError: there is no such city.
    """
    return _file_of(source, STRUCTURES_FILE) if any(kind != "building" for kind in kinds) else None


def _file_of(source: Any, file: str) -> str | None:
    """Return the name of a file of the sample city ``sample:CITY``, None where there is none."""
    name = sample_name(source)
    has_file = name is not None and (HOME / name / file).is_file()
    return f"{PREFIX}{name}/{file}" if has_file else None


def check_sample(name: str) -> None:
    """Raise InputError, which names the nearest one, unless the package holds a city of this name."""
    if name not in SAMPLES:
        hint = nearest_name(name, list(SAMPLES)) or f"; there are {', '.join(SAMPLES)}"
        raise InputError(f"there is no sample city {name!r}{hint}")


def located(name: str | Path) -> Path:
    """Return the path of a file by its name, a path or ``sample:CITY/FILE``; all readers open files by this.

    ``sample:CITY`` alone is the city's file of buildings. Only of sample cities it is checked that the file is there.

    Raises:
      InputError: no such sample city, or no such file of it.
    """
    if not is_sample(name):
        return Path(name)
    city, _, file = PurePath(name).as_posix().removeprefix(PREFIX).partition("/")
    check_sample(city)
    home = HOME / city
    files = sorted(path.name for path in home.iterdir())
    if (file or BUILDINGS_FILE) not in files:
        hint = nearest_name(file, files) or f"; it has {', '.join(files)}"
        raise InputError(f"the sample city {city!r} has no file {file!r}{hint}")
    return home / (file or BUILDINGS_FILE)


def sample_of(settings: Mapping[str, Any]) -> str | None:
    """Return the sample city that the buildings of a scenario's settings are from, or None; errors as `sample_name`."""
    buildings = settings.get("buildings")
    return sample_name(buildings.get("source")) if isinstance(buildings, Mapping) else None


def filled(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings of a scenario, filled up with those of the sample city that its buildings are from.

    The scenario's own settings win. Blocks of other files keep away all of the sample's population, other orbits all of
    its satellites.

    Args:
      settings: by section and name; returned as they stand where the buildings are from no sample city.

    Raises:
      InputError: there is no such sample city.
    """
    name = sample_of(settings)
    if name is None:
        return settings
    merged = dict(settings)
    for section, values in SAMPLES[name].items():
        own = settings.get(section, {})
        if not isinstance(own, Mapping):
            continue  # which the scenario refuses
        if section == "population" and {"blocks", "blocks_day", "blocks_night"} & own.keys():
            values = {}
        if section == "gps" and "orbits" in own:
            values = {}
        merged[section] = {**values, **own}
    return merged
