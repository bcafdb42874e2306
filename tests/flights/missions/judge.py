"""What ways through a world meet, point by point, and the law that a check of them must keep."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from tests.flights.missions.flights import Flown
from tests.flights.missions.verdicts import Verdict
from tests.flights.missions.worlds import World

SURE_M = 0.3  # so deep a contact is one, whatever files round and rasters smooth
SHARPER = 3.0  # places in files are so much sharper than heights: a wall of 0.5 m counts
NEAR_M = 0.7  # farther from all contacts a way is clear; in between it is too near to call
APART_M = 1.0  # a finding is no farther from a true contact
WALL_M = 0.1  # so far inside an outline a corner is cut through it
BURIED_M = 0.05  # below the ground
CORNER_PARTS = np.array(
    [(a, b) for a in np.linspace(0, 1, 15) for b in np.linspace(0, 1, 15) if a + b <= 1]
)


class Truth(NamedTuple):
    """What the ways of a mission meet.

    Attributes:
      points_m: ``[N, 3]`` x, y and height above the ground.
      building_m: ``[N]`` how much farther than asked each point is from buildings; negative: a contact.
      terrain_m: ``[N]`` the same above the ground.
      cut_m: ``[K, 3]`` points inside buildings that lie within the corners that may be cut.
      unknown: why it is never clean; empty where all is known.
    """

    points_m: np.ndarray
    building_m: np.ndarray
    terrain_m: np.ndarray
    cut_m: np.ndarray
    unknown: tuple[str, ...]

    @property
    def margin_m(self) -> np.ndarray:
        """``[N]`` the lesser of the two margins."""
        return np.minimum(self.building_m, self.terrain_m)

    @property
    def has_contact(self) -> bool:
        """Whether the mission surely meets something."""
        return bool((self.margin_m < -SURE_M).any())

    @property
    def is_near(self) -> bool:
        """Whether it is too near to call: not surely a contact, and yet near a building."""
        is_near = self.building_m < NEAR_M
        return not self.has_contact and bool(is_near.any())


def truth_of(world: World, flown: Flown, clearance_m: float, vertical_m: float) -> Truth:
    """Return the truth of ways over a world, with the clearances beside and over buildings that are asked for."""
    points_m = flown.points_m
    margin_m = np.full(len(points_m), np.inf)
    reach_m = clearance_m + 2 * NEAR_M
    if len(points_m):
        dots = shapely.points(points_m[:, :2])
        building, near = shapely.STRtree(dots).query(
            world.outlines, predicate="dwithin", distance=reach_m
        )
        gaps_m = _margins_m(world, points_m[near], building, clearance_m, vertical_m)
        np.minimum.at(margin_m, near, gaps_m)
    return Truth(
        points_m,
        margin_m,
        points_m[:, 2] + BURIED_M,
        _cut_corners_m(world, flown.corners),
        tuple(flown.unknown),
    )


def _margins_m(
    world: World, points_m: np.ndarray, building: np.ndarray, clearance_m: float, vertical_m: float
) -> np.ndarray:
    """Return ``[P]`` how much farther than asked points are from buildings, each from one of them.

    A building has its height above the ground at each of its points: beside it that of its nearest point counts.
    """
    outlines, dots = world.outlines[building], shapely.points(points_m[:, :2])
    outside_m = shapely.distance(dots, outlines)
    apart_m = np.where(
        outside_m > 0, outside_m, -shapely.distance(dots, shapely.boundary(outlines))
    )
    foot_m = shapely.get_coordinates(shapely.shortest_line(outlines, dots))[::2]
    above_m = points_m[:, 2]
    from_foot_m = above_m + world.ground_m(*points_m[:, :2].T) - world.ground_m(*foot_m.T)
    top_m, floor_m = world.top_m[building], world.floor_m[building]

    over_m = np.maximum(above_m - top_m, floor_m - above_m) - vertical_m
    margin_m = np.maximum(_sharpened(apart_m), over_m)
    if clearance_m:
        beside_m = np.maximum(from_foot_m - top_m, floor_m - from_foot_m) - vertical_m
        margin_m = np.minimum(margin_m, np.maximum(_sharpened(apart_m - clearance_m), beside_m))
    return margin_m


def _sharpened(apart_m: np.ndarray) -> np.ndarray:
    """Return distances in plan, those inside as large as heights that are as sure."""
    return np.where(apart_m < 0, SHARPER * apart_m, apart_m)


def _cut_corners_m(world: World, corners: Sequence[np.ndarray]) -> np.ndarray:
    """Return ``[K, 3]`` points of corners that lie inside buildings: x, y and height above the ground."""
    inner = shapely.buffer(world.outlines, -WALL_M)
    cuts_m = [np.zeros((0, 3))]
    for corner_m in corners:
        points_m = corner_m[0] + CORNER_PARTS @ (corner_m[1:] - corner_m[0])
        points_m[:, 2] -= world.ground_m(*points_m[:, :2].T)
        building, near = shapely.STRtree(shapely.points(points_m[:, :2])).query(
            inner, predicate="intersects"
        )
        z_m = points_m[near, 2]
        is_in = (z_m < world.top_m[building] - SURE_M) & (z_m > world.floor_m[building] + SURE_M)
        cuts_m.append(points_m[near[is_in]])
    return np.concatenate(cuts_m)


class Ruling(NamedTuple):
    """The law over one verdict: why it is a false Clean (empty: it is none), and the findings that are invented."""

    false_clean: str
    invented: tuple[str, ...]


def ruling(world: World, truth: Truth, verdict: Verdict, is_damaged: bool = False) -> Ruling:
    """Return the law over a verdict.

    Findings of buildings that are cells, of things that are guessed, and of damaged files, whose places nobody knows,
    are not looked at.
    """
    why = ""
    if verdict.state == "clean":
        if truth.has_contact:
            kind = "building" if (truth.building_m < -SURE_M).any() else "ground"
            why = f"{kind}, {-truth.margin_m.min():.1f} m deep"
        elif len(truth.cut_m):
            why = "a corner that is cut"
        elif truth.unknown:
            why = truth.unknown[0]
    if is_damaged or not world.has_files or world.things:
        return Ruling(why, ())

    invented = []
    margins_m = {"building": truth.building_m, "terrain": truth.terrain_m}
    for kind, (lon, lat, height_m) in zip(verdict.kinds, verdict.places, strict=True):
        if kind not in margins_m:
            invented.append(f"{kind}, which there is none of")
            continue
        contacts_m = truth.points_m[margins_m[kind] < NEAR_M]
        if kind == "building":
            contacts_m = np.concatenate([contacts_m, truth.cut_m])
        place_m = [*world.xy_m(lon, lat), height_m]
        away_m = cKDTree(contacts_m).query(place_m)[0] if len(contacts_m) else np.inf
        if away_m > APART_M:
            invented.append(f"{kind}, {away_m:.1f} m from a contact")
    return Ruling(why, tuple(invented))
