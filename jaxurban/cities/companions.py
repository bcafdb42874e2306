"""Companions of a file, which GDAL opens with it: found by their names, and looked at before."""

import html
import os
from contextlib import suppress
from pathlib import Path

from jaxurban.errors import check_file
from jaxurban.world.grid import OPENS_FILE

REFERS = "it, or its CRS, refers to other files or servers, which are never opened; a code as EPSG:25832 refers to none"
MOST_BYTES = 2**24  # that are looked at


def companions(path: Path, *names: str) -> list[Path]:
    """Return the files beside another that GDAL takes for its companions, by name in small or capital letters."""
    # In a folder that it cannot list GDAL tries these; otherwise any letters may be capital ones.
    present = [*names, *map(str.upper, names)]
    with suppress(PermissionError):
        wanted = {name.lower() for name in names}
        present = [name for name in os.listdir(path.parent) if name.lower() in wanted]
    return [file for file in map(path.with_name, present) if os.path.lexists(file)]


def check_companions(path: Path) -> None:
    """Raise ValueError where a CRS beside a file names another file, which GDAL would open; OSError of a pipe there."""
    for companion in companions(path, f"{path.stem}.prj", f"{path.name}.aux.xml"):
        check_file(companion)
        with companion.open("rb") as file:
            text = file.read(MOST_BYTES).decode("latin-1")
        if OPENS_FILE.search(html.unescape(text)):
            raise ValueError(REFERS)
