"""What every format of paths writes: rounded positions and the facts of a path and of its report."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxurban.settings import Vehicle

if TYPE_CHECKING:
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.path import PlannedPath

DECIMALS = 7  # of a degree: about a centimetre
Z_DECIMALS = 2  # of a metre
FAR_DECIMALS = 6  # of a centimetre: what is so near to a whole one is that
HEIGHT_REFERENCE = "altitude_m and z_m are metres above the ground below each point, not above sea level"

# What a format is: the bytes of a file from paths by name and, if there is one, the report of the one path.
Encode = Callable[["Named", "RouteReport | None"], bytes]
Named = Sequence[tuple[str, "PlannedPath"]]  # "" for a path without a name


def positions(points: np.ndarray) -> list[list[float]]:
    """Return rounded coordinates; a lone point twice, since a line needs two positions."""
    listed = np.round(points, DECIMALS).tolist()
    return listed * 2 if len(listed) == 1 else listed


def upward(height_m: np.ndarray) -> np.ndarray:
    """Return heights as files write them: rounded up, so that no file is lower than the path."""
    centimetres = np.asarray(height_m, float) * 10**Z_DECIMALS
    return np.ceil(np.round(centimetres, FAR_DECIMALS)) / 10**Z_DECIMALS


def facts_of(
    route: "PlannedPath", report: "RouteReport | None", *, is_alone: bool = True
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what is known of the whole path, its ``cautions`` included, and of each segment.

    ``is_alone``: of one of several paths in a file the cautions are only what its maps guess, since all else takes some
    hundredths of a second a path.
    """
    from jaxurban.paths.cautions import guess_cautions

    known = {} if report is None else report.to_dict()
    segments = known.pop("segments", [])
    facts = known | route.to_dict()
    vehicle = Vehicle.of(facts.get("settings", {}))
    if vehicle.speed_m_s is not None:
        facts.setdefault("speed_m_s", vehicle.speed_m_s)
    facts["cautions"] = route.cautions if is_alone else guess_cautions(route.maps)
    return facts | {"height_reference": HEIGHT_REFERENCE}, segments


def description_of(facts: dict[str, Any], *more: str) -> str:
    """Return the cautions of a path, more sentences on a file, and the planner's message as one text."""
    return " ".join(filter(None, (*facts["cautions"], *more, facts["message"])))
