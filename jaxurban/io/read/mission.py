"""Missions that other tools made, by the suffix of their files."""

from pathlib import Path

from jaxurban.errors import readable
from jaxurban.io.read.mission_items import read_plan
from jaxurban.io.read.mission_parts import DATUMS as DATUMS
from jaxurban.io.read.mission_parts import Datum as Datum
from jaxurban.io.read.mission_parts import Leg as Leg
from jaxurban.io.read.mission_parts import Mission as Mission
from jaxurban.io.read.mission_parts import Place as Place

ITEM_SUFFIXES = (".plan", ".waypoints", ".txt")


def read_mission(
    path: str | Path,
    *,
    heights: Datum | None = None,
    home: tuple[float, float] | None = None,
    return_altitude_m: float | None = None,
) -> Mission:
    """Return a mission of a file."""
    path = Path(path)
    with readable(path, "a mission", "save it again", AttributeError):
        text = path.read_text(encoding="utf-8-sig")
        return read_plan(text, path, home, return_altitude_m)
