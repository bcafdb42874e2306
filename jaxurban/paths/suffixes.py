"""Files that routes go to, checked by their names before a long search, and before what writes them is imported."""

from pathlib import Path

from jaxurban.errors import InputError

MISSION = ".plan"  # the format that can say how a flight ends
ROUTES = (
    ".geojson",
    ".kml",
    ".gpx",
    MISSION,
)  # `jaxurban.flights.export.write.FORMATS` writes them
FLOWN = (".kml", ".gpx", MISSION)  # files that autopilots and their ground stations read
PICTURES = (".png", ".pdf", ".svg")


def check_route_file(file: Path) -> None:
    """Check the name of a file that a route is to be written to.

    Raises:
      InputError: another suffix, a folder that does not exist, or a file that is a folder.
    """
    if file.suffix.lower() not in ROUTES:
        raise InputError(
            f"cannot determine the format of {str(file)!r}: end its name in one of {', '.join(ROUTES)}"
        )
    if not file.parent.is_dir():
        raise InputError(
            f"the folder of {str(file)!r} does not exist: make it first, or name another file"
        )
    if file.is_dir():
        raise InputError(f"{str(file)!r} is a folder: name a file")


def check_picture(file: str | Path) -> None:
    """Raise InputError unless a picture can be written to this file."""
    file = Path(file)
    if file.suffix.lower() not in PICTURES:
        raise InputError(f"cannot draw {str(file)!r}: end its name in {' or '.join(PICTURES)}")
    if not file.parent.is_dir() or file.is_dir():
        raise InputError(f"cannot write {str(file)!r}: name a file in a folder that is there")
