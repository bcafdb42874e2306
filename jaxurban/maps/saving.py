"""Maps in folders: `MetricMaps.save` writes them, `open_maps` opens them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxurban.checks import typed
from jaxurban.errors import InputError, warn
from jaxurban.io.files import sweep_scraps
from jaxurban.io.geoparquet import write_geoparquet
from jaxurban.io.geotiff import RUN_KEY, geotiff_paths, missing_geotiffs, write_geotiffs
from jaxurban.io.samples import BASE_MAP_FILE
from jaxurban.io.store import OPENED, open_zarr, write_zarr
from jaxurban.io.stored import GEOTIFF_FOLDER, RUN_FILE, are_of_a_run, root_files, stored_settings
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.variables import NEEDED
from jaxurban.settings import ObstacleRule

if TYPE_CHECKING:
    import geopandas as gpd


NO_FOLDERS = (".png", ".pdf", ".svg", ".nc", ".tif", ".tiff")


def save_maps(maps: MetricMaps, folder: Path, layers: Sequence[str]) -> None:
    """Write maps under a folder; arguments and errors as of `MetricMaps.save`."""
    # All errors of the arguments are raised before anything is written, also the one of a layer that the maps lack.
    if folder.suffix.lower() in NO_FOLDERS:
        raise InputError(
            f"maps are written into a folder, and {str(folder)!r} is the name of a file: leave {folder.suffix} out "
            "(maps.plot().savefig writes a picture, maps.ds.to_netcdf a NetCDF)"
        )
    _check_can_be_opened(maps)
    geotiffs = geotiff_paths(maps.ds, folder, layers)
    with Workspace.open(folder, "maps", is_shared=True, is_mended=True) as workspace:
        workspace.check_way(geotiffs)
        base_files = [] if maps.base_map is None else [folder / BASE_MAP_FILE]
        workspace.check_way([*base_files, *root_files(folder)], is_mended=True)

        # The folder of the run that made the maps has the run's settings in its record. Any other folder gets the
        # settings with the maps and no key, as it has no record.
        ds = maps.ds.copy()
        key = ds.attrs.get(RUN_KEY)
        is_run_of_folder = key is not None and key == workspace.settings.get(RUN_KEY)
        if is_run_of_folder and (folder / RUN_FILE).is_file():
            ds.attrs.pop("settings", None)
        else:
            ds.attrs.pop(RUN_KEY, None)
            workspace.settings.clear()

        write_zarr(ds, folder)
        if maps.folder is not None and maps.folder.resolve() == folder.resolve():
            # The files that these maps are read from are replaced: from now on they are read from the new ones.
            ds = open_zarr(folder.resolve(), maps.grid.resolution_m)
            maps.ds.update(ds)
            maps.ds.encoding[OPENED] = ds.encoding[OPENED]
        write_geotiffs(ds, folder, layers=layers)
        save_base_map(maps.base_map, workspace)
        sweep_scraps(folder / GEOTIFF_FOLDER)  # of GDAL, from a run that was killed
        if not are_of_a_run(folder):
            workspace.remove([RUN_FILE])


def save_base_map(frame: "gpd.GeoDataFrame | None", workspace: Workspace) -> None:
    """Write a base map into a folder of maps; without one, remove what this command wrote there before."""
    if frame is None:
        workspace.remove([BASE_MAP_FILE])
    else:
        write_geoparquet(workspace.folder / BASE_MAP_FILE, frame, frame.attrs)


def _check_can_be_opened(maps: MetricMaps) -> None:
    """Raise InputError for maps that `open_maps` could not read back: without obstacles, or with a path as a name."""
    lost = [name for name in NEEDED if name not in maps.ds]
    if lost:
        raise InputError(
            f"these maps lack {', '.join(lost)}, without which nothing can open them: put it back"
        )
    for name in map(str, maps.ds.variables):
        if "/" in name:
            raise InputError(
                f"a variable called {name!r} cannot be written: give it a name without /"
            )


@typed
def open_maps(
    folder: str | Path, resolution_m: float | None = None, *, obstacles: ObstacleRule | None = None
) -> MetricMaps:
    """Return the maps that ``MetricMaps.save`` or ``jaxurban maps`` wrote under ``folder``.

    The files of the maps must all exist; they are read, and compared with their checksums, when values are needed.
    A missing GeoTIFF of ``jaxurban maps`` is only a warning, as nothing here reads it.

    Args:
      folder: the output folder.
      resolution_m: which of them; may be left out when there is one.
      obstacles: where planners may fly (see `MetricMaps`); left out, as the scenario has it.

    Returns:
      The maps; each is read when it is first needed.

    Raises:
      InputError: no maps there, or several and none chosen, or an unknown rule of obstacles; damaged ones (later too,
        when values are read), or a run's without its settings (``run.json``).

    Examples:
      >>> folder = maps.save("out")
      >>> again = ju.open_maps(folder)
      >>> bool(np.array_equal(again.m("risk", 60.0), maps.m("risk", 60.0), equal_nan=True))
      True
    """
    folder = Path(folder)
    ds = open_zarr(folder, resolution_m)
    lost = missing_geotiffs(ds, folder) if RUN_KEY in ds.attrs else []
    if lost:
        others = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
        warn(
            f"{str(lost[0])!r}{others} is missing or empty: the same `jaxurban maps` command writes it again"
        )
    base = folder.resolve() / BASE_MAP_FILE
    maps = MetricMaps(ds, obstacles, base if base.is_file() else None)
    settings = stored_settings(folder)
    return maps.with_recorded(settings) if settings else maps
