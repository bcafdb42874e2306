"""Rays through exact outlines: which prism of a city hides a direction, by how much, and where a ray enters it.

Legend: ``R`` rays, ``P`` stretches of a ray over an outline.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely

from jaxurban.settings import SLABS, Hanging
from jaxurban.world.footprints import Footprints
from jaxurban.world.known import Rays

NO_HIT = -1  # in an array of numbers of buildings
# A ray is followed until it is so far above every roof of a class: higher ones have a margin of inf.
FARTHEST_MARGIN_M = 30.0
CLASSES_M = (6.0, 12.0, 24.0, 48.0, 96.0, 192.0)  # heights of roofs between the classes
ElevationAt = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of the ground at places x_m, y_m


class Stretches(NamedTuple):
    """Where rays run over outlines.

    Attributes:
      ray, building: ``[P]`` numbers.
      from_m, to_m: ``[P]`` distance along the ground from the ray's place to both ends.
    """

    ray: np.ndarray
    building: np.ndarray
    from_m: np.ndarray
    to_m: np.ndarray


class Clearances(NamedTuple):
    """What rays come nearest to hiding behind.

    Attributes:
      margin_m: ``[R]`` how far the ray is above the roof, or under the floor of what hangs, that it clears by least;
        below 0 it is hidden, by so many metres: how deep it lies, where it is deepest, below the roof, or in what hangs
        below the roof or above the floor, whichever is nearer; inf where nothing comes within `FARTHEST_MARGIN_M`.
      building: ``[R]`` number of that building, `NO_HIT` where there is none.
      distance_m: ``[R]`` along the ground to where the ray enters its outline, NaN where there is none.
    """

    margin_m: np.ndarray
    building: np.ndarray
    distance_m: np.ndarray


@dataclass(frozen=True, eq=False)
class Outlines:
    """The buildings of a city, in classes of height with a tree each: low ones are looked for near a place alone.

    Attributes:
      buildings: prisms with flat roofs; where the ground is not flat, roofs follow it.
      hanging: what buildings with an underside do, as of a `City`.
      ground_at: elevation at places; None where the ground is flat, at 0.
      highest_ground_m: of all places.
    """

    buildings: Footprints
    hanging: Hanging
    ground_at: ElevationAt | None = None
    highest_ground_m: float = 0.0

    @cached_property
    def _classes(self) -> list[tuple[np.ndarray, shapely.STRtree]]:
        """The numbers of the buildings in each class of height that has any, and a tree of their outlines."""
        number = np.digitize(self.buildings.height_m, CLASSES_M)
        classes = []
        for k in np.unique(number):
            members = np.flatnonzero(number == k)
            classes.append((members, shapely.STRtree(self.buildings.polygons[members])))
        return classes

    def stretches(self, rays: Rays, height_m: np.ndarray, above_m: float) -> Stretches:
        """Return where rays run over buildings, until they are ``above_m`` above all roofs of a building's class.

        Classes of height end the rays early over low buildings, which are many.

        Args:
          rays: ``R`` of them, with elevations above 0.
          height_m: ``[R]`` heights at which they begin, from the same zero as the ground's elevation.
          above_m: how far above the highest roof of a class, if it stood on the highest ground, rays are followed.
        """
        # Pairs of a ray and a building, and the part of the ray over the building's outline, class by class. Empty
        # arrays come first, for a city without buildings.
        start_m = np.column_stack([rays.x_m, rays.y_m])
        toward = np.column_stack([np.sin(rays.azimuth_rad), np.cos(rays.azimuth_rad)])
        parts = [(np.empty(0, int), np.empty(0, int), np.empty(0, object))]
        for members, tree in self._classes:
            top_m = self.highest_ground_m + float(self.buildings.height_m[members].max()) + above_m
            run_m = (top_m - height_m) / np.tan(rays.elevation_rad)
            below = np.flatnonzero(run_m >= 0)  # numbers of the rays that begin below that height
            end_m = start_m[below] + run_m[below, None] * toward[below]
            lines = shapely.linestrings(np.stack([start_m[below], end_m], axis=1))
            line, member = tree.query(lines, predicate="intersects")  # pairs, by indices in both
            crossed = shapely.intersection(lines[line], self.buildings.polygons[members[member]])
            parts.append((below[line], members[member], crossed))
        ray, building, crossed = (np.concatenate(values) for values in zip(*parts, strict=True))

        # A part falls into pieces where an outline has gaps; a piece runs from its nearest to its farthest point.
        pieces, pair = shapely.get_parts(crossed, return_index=True)
        places, piece = shapely.get_coordinates(pieces, return_index=True)
        along_m = np.hypot(*(places - start_m[ray[pair[piece]]]).T)
        from_m = np.full(len(pieces), np.inf)
        to_m = np.zeros(len(pieces))
        np.minimum.at(from_m, piece, along_m)
        np.maximum.at(to_m, piece, along_m)
        return Stretches(ray[pair], building[pair], from_m, to_m)

    def clearances(self, rays: Rays, height_m: np.ndarray) -> Clearances:
        """Return which building each ray clears by the least margin, or is hidden by most.

        Over each outline the ground is taken to rise evenly between the ends of a ray's stretch.

        Args:
          rays, height_m: as for `stretches`.
        """
        # The margin over each stretch, [P], from the height above the ground at both of its ends, [2, P].
        over = self.stretches(rays, height_m, FARTHEST_MARGIN_M)
        ends_m = np.stack([over.from_m, over.to_m])
        above_m = height_m[over.ray] + ends_m * np.tan(rays.elevation_rad[over.ray])
        above_m -= self.elevations_m(rays, over.ray, ends_m)

        # At the height at which a ray is deepest in a slab; what stands on the ground has no floor.
        roof_m = self.buildings.height_m[over.building]
        floor_m = self.buildings.min_height_m[over.building]
        floor_m = np.where((self.hanging == SLABS) & (floor_m > 0), floor_m, -np.inf)
        deepest_m = np.clip((floor_m + roof_m) / 2, above_m.min(axis=0), above_m.max(axis=0))
        clears_m = np.maximum(deepest_m - roof_m, floor_m - deepest_m)

        # The stretch of least margin of each ray; of equal margins, the nearest.
        order = np.lexsort([over.from_m, clears_m, over.ray])
        order = order[clears_m[order] < FARTHEST_MARGIN_M]
        near_rays, first = np.unique(over.ray[order], return_index=True)
        least = order[first]

        num = len(rays.x_m)
        margin_m = np.full(num, np.inf)
        distance_m = np.full(num, np.nan)
        building = np.full(num, NO_HIT)
        margin_m[near_rays] = clears_m[least]
        building[near_rays] = over.building[least]
        distance_m[near_rays] = over.from_m[least]
        return Clearances(margin_m, building, distance_m)

    def elevations_m(self, rays: Rays, ray: np.ndarray, along_m: np.ndarray) -> np.ndarray:
        """Return ``[..., P]`` the elevation of the ground under rays, by their numbers ``[P]``, at distances."""
        if self.ground_at is None:
            return np.zeros(along_m.shape)
        return self.ground_at(*rays.places_m(ray, along_m))
