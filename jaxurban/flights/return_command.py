"""jaxurban return."""

from functools import partial
from pathlib import Path
from typing import Any

from jaxurban.terminal.common import (
    CEILING,
    FILES,
    FOLDER,
    JSON_FLAG,
    KEPT_CLEAR,
    PLACE,
    RESOLUTION,
    Settings,
    print_json,
    write_outputs,
)
from jaxurban.terminal.options import command


@command()
@FOLDER
@PLACE("--home", help="Home: longitude,latitude in degrees.")
@KEPT_CLEAR
@CEILING
@RESOLUTION
@FILES(
    help="File to write: .tif, or a picture (.png, .pdf, .svg); or a folder for Zarr and GeoTIFF; repeatable."
)
@JSON_FLAG
def return_command(
    folder: Path,
    resolution_m: float | None,
    rules: Settings,
    files: tuple[Path, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Say how high a straight flight home must be.

    Altitudes are in metres above the ground at home, for every cell that the flight may return from.
    """
    from jaxurban.flights.figures import plot_return
    from jaxurban.flights.return_altitude import return_altitude
    from jaxurban.maps.saving import open_maps

    home = return_altitude(open_maps(folder, resolution_m), **rules, **options)
    write_outputs(files, partial(plot_return, home), home.save, home.cautions)
    if as_json:
        print_json(home.figures)
    else:
        print("\n".join(f"{name}: {fact}" for name, fact in home.facts.items()))
