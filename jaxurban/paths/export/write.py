"""Planned paths as files for other programs: the format is chosen by the file's suffix.

A further format is a file of its own, with a function such as `to_geojson`, and a line in `FORMATS`.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from jaxurban.errors import InputError, one_of
from jaxurban.io.files import write_whole
from jaxurban.paths.export.base import Encode
from jaxurban.paths.export.geojson import to_geojson
from jaxurban.paths.export.gpx_kml import to_gpx, to_kml
from jaxurban.paths.export.qgc_plan import ENDS, to_qgc_plan

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.path import PlannedPath

FORMATS: dict[str, Encode] = {".geojson": to_geojson, ".kml": to_kml, ".gpx": to_gpx, ".plan": to_qgc_plan}
WAYPOINTS = (".gpx", ".plan")  # of these, formats of waypoints to be flown one by one
MISSION = ".plan"  # the format that can say how a flight ends


def write_path(
    route: "PlannedPath | Sequence[PlannedPath | None]",
    file: str | Path,
    report: "RouteReport | None" = None,
    *,
    names: Sequence[str] | None = None,
    end: str | None = None,
) -> bool:
    """Write paths in the format that the file's suffix names; return False, writing nothing, if there is no path.

    `FORMATS` names the modules that say what each file holds. The file appears whole or not at all; an older one is
    replaced.

    Args:
      route: from `plan`, or several; of these, the ones that were found are written.
      file: where to; several formats are several calls.
      report: from `jaxurban.explain`; its speed becomes the cruise speed of a ``.plan``. Of one path only.
      names: of several paths; left out, their numbers from 1 up.
      end: of a ``.plan``: ``"land"`` at the goal, which is meant where it is left out, ``"return"`` to launch as the
        autopilot does it, or ``"none"``.

    Raises:
      InputError: another suffix, an end that is none or of a format without one, several paths in a format of one,
        names that are not one for each, or a folder that does not exist or cannot be written to.
    """
    file = Path(file)
    encode = encoder_of(file)
    if end is not None:
        if file.suffix.lower() != MISSION:
            raise InputError(f"only a {MISSION} says how the flight ends, and {str(file)!r} is none: leave end out")
        encode = partial(to_qgc_plan, end=one_of("end", end, ENDS))
    routes = list(route) if isinstance(route, Sequence) else [route]
    given = names or ([""] if not isinstance(route, Sequence) else [str(k + 1) for k in range(len(routes))])
    if len(given) != len(routes) or isinstance(given, str):
        raise InputError(f"names must be one for each of the {len(routes)} paths, got {given!r}")
    found = [(name, path) for name, path in zip(given, routes, strict=True) if path and path.status.has_path]
    if report is not None and len(found) > 1:
        raise InputError("a report is of one path: write several paths without it")
    if found:
        write_whole(file, encode(found, report))
    return bool(found)


def encoder_of(file: Path) -> Encode:
    """Return what `write_path` writes a file by; raise InputError where it cannot: call it before a long search."""
    encode = FORMATS.get(file.suffix.lower())
    if encode is None:
        raise InputError(f"cannot tell the format of {str(file)!r}: end its name in one of {', '.join(FORMATS)}")
    if not file.parent.is_dir():
        raise InputError(f"the folder of {str(file)!r} does not exist: make it first, or name another file")
    if file.is_dir():
        raise InputError(f"{str(file)!r} is a folder: name a file")
    return encode
