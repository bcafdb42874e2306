"""What buildings cost a route over a folder of maps: the sources read again, a table and a map written."""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
import pandas as pd

from jaxurban.build import soft_city
from jaxurban.errors import InputError
from jaxurban.io.seal import read_json
from jaxurban.io.store import RUN_FILE, whole_file
from jaxurban.io.tables import write_tables
from jaxurban.pipeline import grids_of, load_city, map_params, sky_of
from jaxurban.planned import PlannedPath
from jaxurban.plotting.buildings import plot_building_costs
from jaxurban.plotting.files import write_png
from jaxurban.record import hash_inputs
from jaxurban.scenario import Scenario
from jaxurban.soft.engine import SoftParams
from jaxurban.studies.buildings import building_costs


def scenario_of(folder: Path, scenario: Path | None = None) -> Scenario:
    """Return the scenario that a folder of maps was made from, its sources unchanged.

    The record of a run names sources as the scenario did. Relative names are looked for from the scenario's own file
    if it is given, else from the current folder, the maps' folder and the one that holds it.

    Raises:
      InputError: no record, a source that is not found, or one that is not the one the maps were made from.
    """
    file = Path(folder) / RUN_FILE
    try:
        record = read_json(file)
    except OSError as error:
        raise InputError(
            f"cannot read {str(file)!r} ({error.strerror or error}): gradients by building need the record of the "
            "run, as `jaxurban maps` writes it"
        ) from error
    except ValueError as error:
        raise InputError(
            f"{str(file)!r} is no record of a run ({error}): run the same `jaxurban maps` command again"
        ) from error
    tried = (scenario.parent,) if scenario is not None else (Path(), folder, folder.parent)
    return _with_sources(record, [path.resolve() for path in tried], str(file))


def _with_sources(record: dict, folders: Sequence[Path], name: str) -> Scenario:
    for folder in folders:
        found = Scenario.from_dict(record["settings"], name=name, folder=folder)
        if not all(found.path_of(source["path"]).exists() for source in record["inputs"].values()):
            continue
        for role, source in hash_inputs(found).items():
            if source["sha256"] != record["inputs"][role]["sha256"]:
                raise InputError(
                    f"{source['path']!r} is not the file that the maps were made from: put it back, or "
                    "make the maps again"
                )
        return found
    names = ", ".join(repr(source["path"]) for source in record["inputs"].values())
    raise InputError(
        f"the sources of these maps ({names}) were not found from {', '.join(map(str, folders))}: name the scenario's "
        "file, or run where it lies"
    )


def write_buildings(
    folder: str | Path,
    planned: PlannedPath,
    out: str | Path,
    *,
    scenario: str | Path | None = None,
    softness_m: float = 2.0,
) -> pd.DataFrame:
    """Write what every building costs a route: ``buildings.csv``, ``buildings.parquet`` and ``buildings.png``.

    Soft maps are made on the maps' own cells, also where the exact ones were made on finer ones (``oversample``).

    Args:
      folder: of the maps, with their run.json, which names the sources of the city.
      planned: a route over these maps.
      out: where the files go; made if it is not there.
      scenario: file that the maps were made from, where sources have relative names.
      softness_m: see `jaxurban.studies.buildings.building_costs`.

    Returns:
      The table of `jaxurban.studies.buildings.building_costs`.

    Raises:
      InputError: there is no route, sources that are not found or changed, buildings from a height raster, or a route
        over statistics of many epochs.
    """
    settings = scenario_of(Path(folder), None if scenario is None else Path(scenario))
    if not softness_m > 0:
        raise InputError(f"softness_m must be a positive number of metres such as 2, got {softness_m}")
    grids = {grid.resolution_m: grid for grid in grids_of(settings)}
    if planned.settings["resolution_m"] not in grids:
        raise InputError(
            f"the route lies on cells of {planned.settings['resolution_m']:g} m, which these maps do not hold"
        )
    grid = grids[planned.settings["resolution_m"]]
    sky = sky_of(settings, grid)
    if planned.settings["time"] not in sky.times:
        raise InputError(
            "the route was planned on GPS statistics over many epochs, which have no gradient by building: make maps "
            "of one epoch, and plan on them"
        )
    maps, city = map_params(settings), load_city(settings)
    params = SoftParams(planned.altitude_m, softness_m, maps.gps, maps.lidar, maps.risk, maps.population)
    epoch, time_of_day = sky.times.index(planned.settings["time"]), planned.settings["time_of_day"] or "day"
    with jax.enable_x64(True):
        soft = soft_city(city, grid, sky, maps, epoch=epoch, time_of_day=time_of_day, dtype=np.float64)
        table = building_costs(city, soft, planned, params)
    write_tables({"buildings": table}, Path(out))
    with whole_file(Path(out) / "buildings.png") as scratch:
        write_png(plot_building_costs(city, planned, table, grid), scratch)
    return table
