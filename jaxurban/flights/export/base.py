"""What formats of paths share: waypoints, rounded positions, and the facts of a path and of its report.

Waypoints lie where a path bends in plan or in height, over terrain also where the ground does. Points that a straight
line misses by no more than a centimetre in x, y and height are left out, so that a grid path is not a mission of
thousands. No straight line between waypoints is lower than planned: these are raised by as much as a line would be.
Over maps with terrain points are added until no line is more than `GROUND_TOLERANCE_M` higher.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxurban.errors import InputError
from jaxurban.io.zone import unknown_cautions
from jaxurban.kernels.tolerances import GROUND_TOLERANCE_M, MOST_BULGE_M
from jaxurban.knowledge import sentences_of
from jaxurban.paths.lines import along_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.profile import guess_cautions
from jaxurban.paths.route_report import RouteReport
from jaxurban.settings import Vehicle

DECIMALS = 7  # of a degree: about a centimetre
Z_DECIMALS = 2  # of a metre
FAR_DECIMALS = 6  # of a centimetre: a height that is so near to a whole centimetre counts as one
HEIGHT_REFERENCE = (
    "altitude_m and z_m are metres above the ground below each point, not above sea level"
)
STRAIGHT_M = 0.01  # a waypoint that straight lines miss by no more, in x, y and height, is left out
# By how much a straight line may miss the ground: a line that is raised by as much is twice as far above it elsewhere.
# The rest of the tolerance is for the ground's cover and for rounding up.
MISSED_M = GROUND_TOLERANCE_M / 2 - MOST_BULGE_M

Named = Sequence[tuple[str, PlannedPath]]  # paths with their names, "" for a path without one
# The bytes of a file from paths by name and, if there is one, the report of the one path.
Encode = Callable[[Named, RouteReport | None], bytes]


class Format(NamedTuple):
    """A format of paths.

    Attributes:
      encode: returns the bytes of a file of this format.
      label: label of the format's button in the viewer.
      is_of_waypoints: the points of a file are flown one by one, so `jaxurban plan` and the viewer simplify the path
        first.
    """

    encode: Encode
    label: str
    is_of_waypoints: bool = False


def positions(points: np.ndarray) -> list[list[float]]:
    """Return rounded coordinates as lists. A single point is in them twice, since a line needs two positions."""
    listed = np.round(points, DECIMALS).tolist()
    return listed * 2 if len(listed) == 1 else listed


def upward(height_m: np.ndarray) -> np.ndarray:
    """Return heights as files write them: rounded up, so that no file is lower than the path."""
    centimetres = np.asarray(height_m, float) * 10**Z_DECIMALS
    return np.ceil(np.round(centimetres, FAR_DECIMALS)) / 10**Z_DECIMALS


def facts_of(
    routes: Named, report: RouteReport | None, *, is_flown: bool = True
) -> Iterator[tuple[str, PlannedPath, dict[str, Any]]]:
    """Yield paths with their names, and the facts of each by name, its ``cautions`` among them.

    With other paths only what the maps guess is a caution, since all other cautions take some hundredths of a second
    for each path.

    Args:
      routes: the paths with their names.
      report: the report of the one path, whose totals, settings and ``segments`` are added.
      is_flown: whether autopilots or their ground stations read the file, as long as nobody knows better.

    Raises:
      InputError: a path that is flown, and of whose zones it is not known what they close.
    """
    for name, route in routes:
        for said in unknown_cautions(route.zones) if is_flown else ():
            raise InputError(f"no mission is written (a .geojson is), as {said[:-1]}")
        report_facts = {} if report is None else report.to_dict()
        facts = report_facts | route.to_dict()
        vehicle = Vehicle.of(route.settings)
        if vehicle.speed_m_s is not None:
            facts.setdefault("speed_m_s", vehicle.speed_m_s)
        facts["cautions"] = route.cautions if len(routes) == 1 else guess_cautions(route.maps)
        yield name, route, facts | {"height_reference": HEIGHT_REFERENCE}


def description_of(facts: dict[str, Any], *more: str) -> str:
    """Return as one text the cautions of a path, further sentences, and those of its message that are not said yet."""
    sentences = [*facts["cautions"], *more, *sentences_of(facts["message"])]
    return " ".join(filter(None, dict.fromkeys(sentences)))


class Waypoints(NamedTuple):
    """The ``W`` waypoints of a path.

    Attributes:
      lonlat: ``[W, 2]`` longitude, latitude in degrees, rounded as files write them.
      z_m: ``[W]`` height above ground, which is the planned height or more.
      ground_m: ``[W]`` the ground's elevation above the zero of the terrain file; None over maps without terrain.
    """

    lonlat: np.ndarray
    z_m: np.ndarray
    ground_m: np.ndarray | None

    @property
    def above_home_m(self) -> np.ndarray:
        """``[W]`` height above the ground at the first waypoint; level ground is assumed where it is not known."""
        if self.ground_m is None:
            return self.z_m
        return self.z_m + self.ground_m - self.ground_m[0]


def waypoints(route: PlannedPath) -> Waypoints:
    """Return the waypoints of a path; a straight line from one to the next is nowhere lower than the path.

    Waypoints lie where the path bends in plan or in height and, over terrain, also where the ground bends.
    """
    # The points of the path, over terrain all places at which the path knows its ground. A straight line is straight in
    # heights above one level, and so heights are above the zero of the terrain, over flat ground above the ground.
    ground, lonlat = route.ground, route.lonlat
    xyz_m = np.column_stack([route.xy_m, route.z_m])
    height_m = xyz_m[:, 2]
    height_tolerance_m = np.inf
    if ground is not None:
        lonlat = ground.lonlat
        number = np.arange(len(xyz_m))
        xyz_m = np.column_stack([np.interp(ground.at, number, values) for values in xyz_m.T])
        height_m = xyz_m[:, 2] + ground.cover_m
        height_tolerance_m = MISSED_M

    along_m = along_of(xyz_m)
    tolerances_m = np.array([STRAIGHT_M, STRAIGHT_M, STRAIGHT_M, height_tolerance_m])
    kept = _bends(along_m, np.column_stack([xyz_m, height_m]), tolerances_m)
    z_m = height_m[kept] + _raise_m(along_m, height_m, kept)
    elevation_m = None
    if ground is not None:
        elevation_m = ground.elevation_m[kept]
        z_m = z_m - elevation_m
    return Waypoints(np.round(lonlat[kept], DECIMALS), z_m, elevation_m)


def _raise_m(along_m: np.ndarray, height_m: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return ``[W]`` by how much waypoints are raised so that no line between two of them is lower than planned.

    Args:
      along_m: ``[G]`` length flown at each point of the path.
      height_m: ``[G]`` planned height of each point.
      kept: ``[W]`` indices of the points that are waypoints; the first and the last point are among them.
    """
    too_low_m = height_m - np.interp(along_m, along_m[kept], height_m[kept])
    # By how much the line of each leg is too low, with a 0 before the first leg and one behind the last.
    legs_m = np.pad(np.maximum.reduceat(too_low_m, kept[:-1]), 1)
    # Both ends of a leg are raised; a waypoint between two legs by the greater of both.
    return np.maximum(legs_m[:-1], legs_m[1:]).clip(0.0)


def _bends(along_m: np.ndarray, values_m: np.ndarray, tolerances_m: np.ndarray) -> np.ndarray:
    """Return ``[W]`` indices of points between which straight lines miss no value by more than its tolerance.

    The first and the last point are among them; the others follow from halving at the point that is missed by most
    (Douglas and Peucker's way). A value is compared with the line's at the same share of the length flown.

    Args:
      along_m: ``[G]`` length flown at each point.
      values_m: ``[G, V]`` x, y and what else runs straight along a line.
      tolerances_m: ``[V]`` by how much a line may miss each.
    """
    whole = 0, len(along_m) - 1
    kept = {*whole}
    spans = [whole]  # from one kept point to the next, still to be looked at
    while spans:
        first, last = spans.pop()
        length_m = max(along_m[last] - along_m[first], np.finfo(float).tiny)
        share = (along_m[first:last] - along_m[first]) / length_m
        line_m = values_m[first] + share[:, None] * (values_m[last] - values_m[first])
        missed = np.max(np.abs(values_m[first:last] - line_m) / tolerances_m, axis=1)
        if missed.max(initial=0.0) > 1:  # in tolerances
            worst = first + int(np.argmax(missed))
            kept.add(worst)
            spans += [(first, worst), (worst, last)]
    return np.array(sorted(kept))
