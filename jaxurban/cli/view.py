"""jaxurban view."""

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jaxurban.checks import finite
from jaxurban.progress import LOG
from jaxurban.terminal.common import (
    FLAG,
    FOLDER,
    PATH,
    PRESET,
    RESOLUTION,
    SHOWN,
    SOURCES,
)
from jaxurban.terminal.options import NumberRange, WholeNumber, command

if TYPE_CHECKING:
    from jaxurban.settings import Preset


@command()
@FOLDER
@RESOLUTION
@PRESET
@SOURCES
@click.option(
    "--export", type=PATH, metavar="PAGE.html", help="Write one page that shows the maps, and end."
)
@SHOWN(
    "--size",
    "size_mib",
    type=NumberRange(min=1),
    callback=lambda ctx, param, mib: finite("size_mib", mib),
    default=25,
    help="Largest size of --export, MiB.",
)
@click.option(
    "--port",
    type=WholeNumber(0, 65535),
    default=0,
    help="Port to listen at.  [default: any that is free]",
)
@FLAG("--no-browser", help="Do not open a browser; the address is printed.")
def view_command(
    folder: Path,
    resolution_m: float | None,
    preset: "Preset",
    sources: Path | None,
    export: Path | None,
    size_mib: float,
    port: int,
    no_browser: bool,
) -> None:
    """Look at the maps in DIR and plan on them.

    The page is for a browser on this machine; Ctrl-C ends it.
    """
    from jaxurban.maps.saving import open_maps
    from jaxurban.viewer.html import write_page
    from jaxurban.viewer.server import ViewerServer
    from jaxurban.viewer.viewer import Viewer

    def open_viewer() -> Viewer:
        """Return the viewer of the maps, read again each time: the server calls it where their files have changed."""
        return Viewer(
            open_maps(folder, resolution_m),
            name=folder.resolve().name,
            folder=str(folder),
            preset=preset,
            sources=sources,
        )

    # One page as a file, or a server until Ctrl-C.
    viewer = open_viewer()
    if export is not None:
        num_bytes = write_page(viewer, export, int(size_mib * 2**20))
        LOG.info(f"wrote {export} ({num_bytes / 2**20:.1f} MiB): open it in a browser")
        return
    with ViewerServer(viewer, port, again=open_viewer) as server:
        LOG.info(f"look at {server.url} (Ctrl-C ends it)")
        if not no_browser:
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            LOG.info("the viewer has ended")
