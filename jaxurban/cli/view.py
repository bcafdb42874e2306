"""jaxurban view."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import OBSTACLES, PATH, PRESET, RESOLUTION, tell

if TYPE_CHECKING:
    from jaxurban.viewer.viewer import Viewer


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@RESOLUTION
@OBSTACLES
@PRESET
@click.option("--export", type=PATH, metavar="PAGE.html", help="Write one file to look at, and end.")
@click.option(
    "--size", "size_mib", type=click.FloatRange(min=1), default=25, show_default=True, help="MiB of --export at most."
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="To listen at.  [default: any that is free]")
@click.option("--no-browser", is_flag=True, help="Open no browser; the address is told.")
def view(folder: Path, export: Path | None, size_mib: float, port: int, no_browser: bool, **given: Any) -> int:
    """Look at the maps in DIR and plan on them, in a browser on this machine; Ctrl-C ends it."""
    opened = partial(_viewer, folder, **given)
    viewer = opened()
    if export is not None:
        from jaxurban.viewer.html import write_page

        num_bytes = write_page(viewer, export, int(size_mib * 2**20))
        tell(f"wrote {export} ({num_bytes / 2**20:.1f} MiB): open it in a browser")
        return 0
    from jaxurban.viewer.server import ViewerServer

    with ViewerServer(viewer, port, again=opened) as server:
        tell(f"look at {server.url} (Ctrl-C ends it)")
        if not no_browser:
            import webbrowser

            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            tell("the viewer has ended")
    return 0


def _viewer(folder: Path, resolution_m: float | None, obstacles: str | None, preset: str | None) -> "Viewer":
    """Return the viewer of maps in a folder, which plans as the maps were made to be planned on."""
    from jaxurban.maps.metric_maps import open_maps
    from jaxurban.viewer.viewer import Viewer

    maps = open_maps(folder, resolution_m, obstacles=obstacles)  # type: ignore[arg-type]
    return Viewer(maps, name=folder.resolve().name, folder=str(folder), preset=preset or "")
