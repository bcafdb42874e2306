"""Rays through a city: what hides them, by its exact outlines, its terrain and its raster of roofs.

Outlines are met exactly. Terrain is sampled every 5 m along a ray, bilinear between its pixels; a raster of roofs every
metre, by the pixel.

Legend: ``R`` rays, ``P`` stretches of a ray over an outline.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.burn import UNKNOWN_GROUND_M
from jaxurban.io.city import City
from jaxurban.io.rasterise import highest_top_m
from jaxurban.io.sampling import raster_values
from jaxurban.progress import LOG
from jaxurban.receivers.rule import FARTHEST_MARGIN_M, HIDDEN, LOWEST_HORIZON_DEG, states_of
from jaxurban.settings import SLABS, Hanging
from jaxurban.world.footprints import Footprints
from jaxurban.world.grid import WGS84, Grid, transformer
from jaxurban.world.known import Rays

NO_HIT = -1  # in an array of numbers of buildings
CLASSES_M = (6.0, 12.0, 24.0, 48.0, 96.0, 192.0)  # heights of roofs between the classes
AXES = np.array([1, 1j])  # make complex numbers of coordinates
GROUND_STEP_M, ROOF_STEP_M = 5.0, 1.0  # between samples of terrain, and of a raster of roofs
MOST_RAYS, MOST_AT_ONCE = 5_000_000, 50_000
ROOF = ("roof_height_m", "roof_distance_m", "roof_lon", "roof_lat", "roof_is_guessed")
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
class BuildingTrees:
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
        # Pairs of a ray and a building, and how far the ray is followed, class by class. Empty arrays come first, for a
        # city without buildings.
        start_m = np.column_stack([rays.x_m, rays.y_m])
        toward = np.column_stack([np.sin(rays.azimuth_rad), np.cos(rays.azimuth_rad)])
        parts = [(np.empty(0, int), np.empty(0, int), np.empty(0))]
        for members, tree in self._classes:
            top_m = self.highest_ground_m + float(self.buildings.height_m[members].max()) + above_m
            run_m = (top_m - height_m) / np.tan(rays.elevation_rad)
            below = np.flatnonzero(run_m >= 0)  # numbers of the rays that begin below that height
            end_m = start_m[below] + run_m[below, None] * toward[below]
            lines = shapely.linestrings(np.stack([start_m[below], end_m], axis=1))
            line, member = tree.query(lines, predicate="intersects")  # pairs, by indices in both
            parts.append((below[line], members[member], run_m[below[line]]))
        ray, building, run_m = (np.concatenate(values) for values in zip(*parts, strict=True))

        # The corners of the outlines as complex numbers: metres along the ray and, imaginary, to its left.
        polygons, pair = shapely.get_parts(self.buildings.polygons[building], return_index=True)
        rings, polygon = shapely.get_rings(polygons, return_index=True)
        corners_m, ring = shapely.get_coordinates(rings, return_index=True)
        pair = pair[polygon[ring]]
        corners_m = (corners_m - start_m[ray[pair]]) @ AXES
        corners_m *= (toward @ AXES.conj())[ray[pair]]

        # A ring crosses the whole line of a ray an even number of times: in turns it begins and ends to be over the
        # outline. A side that lies on the line counts as to its right.
        is_left = corners_m.imag > 0
        side = np.flatnonzero((is_left[1:] != is_left[:-1]) & (ring[1:] == ring[:-1]))
        near_m, far_m = corners_m[side], corners_m[side + 1]
        share = near_m.imag / (near_m.imag - far_m.imag)
        along_m = near_m.real + share * (far_m.real - near_m.real)
        order = np.lexsort([along_m, pair[side]])
        from_m, to_m = along_m[order].reshape(-1, 2).T
        pair = pair[side[order[::2]]]

        # What lies ahead, as far as the ray is followed.
        from_m = np.maximum(from_m, 0.0)
        to_m = np.minimum(to_m, run_m[pair])
        is_ahead = from_m <= to_m
        pair = pair[is_ahead]
        return Stretches(ray[pair], building[pair], from_m[is_ahead], to_m[is_ahead])

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


class RaySamples(NamedTuple):
    """What lies under rays, one distance after the other.

    Attributes:
      ray: numbers of the rays that are not above all roofs yet.
      along_m: distance from their places.
      ground_m: elevation there, NaN where it is not known.
      roof_m: of a raster of roofs, above the ground, NaN where it is not known; else 0.
    """

    ray: np.ndarray
    along_m: float
    ground_m: np.ndarray
    roof_m: np.ndarray


@dataclass(frozen=True, eq=False)
class Hiding:
    """What of a city hides rays.

    Attributes:
      city: what stands.
      known: where that and the ground are known, in the city's CRS.
    """

    city: City
    known: shapely.Geometry

    @cached_property
    def outlines(self) -> BuildingTrees | None:
        """The outlines of all that hides satellites and has a height, for rays; None where a raster holds the roofs.

        Over terrain they stand on the ground, whose greatest height they are given too.
        """
        city = self.city
        hiding = city.hides.outlines
        if hiding is None:
            return None
        standing = hiding.take(hiding.height_m > 0)
        if city.terrain is None:
            return BuildingTrees(standing, city.hanging)
        highest_m = float(np.nanmax(city.terrain.values))
        return BuildingTrees(standing, city.hanging, self.known_ground_at, highest_m)

    def ground_at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the ground's elevation at places in the city's CRS: NaN where it is not known, 0 without terrain."""
        if self.city.terrain is None:
            return np.zeros(np.shape(x_m))
        return raster_values(self.city.terrain, x_m, y_m, self.city.crs, "bilinear")

    def known_ground_at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the elevation of the ground, far down where it is not known: what stands there hides nothing."""
        return np.nan_to_num(self.ground_at(x_m, y_m), nan=UNKNOWN_GROUND_M)

    def rise_m(self, altitude_m: np.ndarray) -> np.ndarray:
        """Return ``[R]`` how many metres a ray rises until it is above all roofs and hills of the city.

        Args:
          altitude_m: ``[R]`` of the places where the rays begin, above the ground.
        """
        return highest_top_m(self.city) - altitude_m

    def samples(self, rays: Rays, rise_m: np.ndarray) -> Iterator[RaySamples]:
        """Yield what terrain and roofs or plants of a raster are under rays, at one distance after the other.

        Yields nothing where the city has neither.

        Args:
          rays: ``R`` of them.
          rise_m: ``[R]`` how far each rises before it is above all roofs; samples end there.
        """
        rasters = [
            roofs for roofs in (self.city.roofs, self.city.hides.plants) if roofs is not None
        ]
        if self.city.terrain is None and not rasters:
            return
        step_m = ROOF_STEP_M if rasters else GROUND_STEP_M
        run_m = np.maximum(rise_m, 0.0) / np.tan(rays.elevation_rad)
        for along_m in np.arange(0.0, run_m.max(initial=0.0) + step_m, step_m):
            ray = np.flatnonzero(run_m >= along_m)
            places = rays.places_m(ray, along_m)
            roof_m = np.zeros(len(ray))
            for roofs in rasters:
                above_m = raster_values(roofs, *places, self.city.crs, "nearest")
                if roofs is not self.city.roofs:  # where plants have no data, none grow
                    above_m = np.nan_to_num(above_m)
                roof_m = np.maximum(roof_m, above_m)
            yield RaySamples(ray, along_m, self.ground_at(*places), roof_m)

    def behind(self, rays: Rays, altitude_m: np.ndarray) -> pd.DataFrame:
        """Return a row for each ray: its state by the rule, the margin, and the roof that hides it.

        Columns: ``state``. ``margin_m``, how far the ray is above the roof or hill, or below the floor, that it clears
        by least; inf where nothing comes within `FARTHEST_MARGIN_M`, NaN of rays that are not known. Of hidden rays
        also `ROOF`: the height of the roof above its ground (NaN: the ground hides the ray), the distance along the
        ground to where the ray enters its outline, longitude and latitude of that place, and whether the height is
        guessed. Of other rays these are NaN, and the last False.

        Args:
          rays: ``R`` of them, with elevations above 0, of which `MOST_AT_ONCE` are followed at once.
          altitude_m: ``[R]`` of their places above the ground.

        Raises:
          InputError: more than `MOST_RAYS` rays.
        """
        num = len(rays.x_m)
        if num > MOST_RAYS:
            raise InputError(
                f"{num:,} rays to satellites are too many, {MOST_RAYS:,} are followed at most: give fewer rows, such "
                "as one of ten, or parts of the track one after the other"
            )
        if num > MOST_AT_ONCE:
            LOG.info(f"following {num:,} rays to satellites, about 5,000 a second")
        pieces = np.array_split(np.arange(num), num // MOST_AT_ONCE + 1)
        tables = [self._behind(rays.take(piece), altitude_m[piece]) for piece in pieces]
        return pd.concat(tables, ignore_index=True)

    def _behind(self, rays: Rays, altitude_m: np.ndarray) -> pd.DataFrame:
        """Return what `behind` does, of rays that are followed at once."""
        # Rays that stay within what is known; all arrays below are of these `inner` ones.
        rise_m = self.rise_m(altitude_m)
        inside = np.flatnonzero(rays.stays_within(self.known, rise_m))
        inner = rays.take(inside)
        height_m = self.known_ground_at(inner.x_m, inner.y_m) + altitude_m[inside]
        num = len(inside)
        margin_m = np.full(num, np.inf)
        distance_m, roof_m = np.full((2, num), np.nan)
        is_guessed, is_gap = np.zeros((2, num), bool)

        # What outlines hide.
        if self.outlines is not None:
            buildings = self.outlines.buildings
            margin_m, building, distance_m = self.outlines.clearances(inner, height_m)
            roof_m = np.append(buildings.height_m, np.nan)[building]  # the last is of `NO_HIT`
            is_guessed = np.append(buildings.is_guessed, False)[building]

        # What terrain and a raster of roofs hide, where a ray clears it by less than what it cleared so far. The ground
        # itself counts only where it hides. A ray over a place whose ground or roof is not known has a gap.
        for ray, along_m, ground_m, raster_roof_m in self.samples(inner, rise_m[inside]):
            is_gap[ray] |= np.isnan(ground_m + raster_roof_m)
            above_ground_m = height_m[ray] + along_m * np.tan(inner.elevation_rad[ray]) - ground_m
            counts = (raster_roof_m > 0) | (above_ground_m <= 0)
            clears_m = np.where(counts, above_ground_m - raster_roof_m, np.inf)
            is_less = clears_m < np.minimum(margin_m[ray], FARTHEST_MARGIN_M)
            less = ray[is_less]
            margin_m[less] = clears_m[is_less]
            distance_m[less] = along_m
            is_guessed[less] = False
            roof_m[less] = np.where(raster_roof_m > 0, raster_roof_m, np.nan)[is_less]

        # The table of all rays. Rays that leave what is known have NaN in it, and False in columns of bool.
        margin_m[is_gap] = np.nan
        hides = states_of(margin_m) == HIDDEN
        places = inner.places_m(np.arange(num), distance_m)
        lon, lat = transformer(self.city.crs, WGS84).transform(*places)
        columns = {"margin_m": margin_m}
        for name, values in zip(ROOF, (roof_m, distance_m, lon, lat, is_guessed), strict=True):
            columns[name] = np.where(hides, values, np.nan)
        table = pd.DataFrame(columns, inside).reindex(range(len(rays.x_m)))
        table["roof_is_guessed"] = table["roof_is_guessed"].eq(True)
        table.insert(0, "state", states_of(table["margin_m"].to_numpy()))
        return table

    def horizon_deg(
        self, grid: Grid, lonlat: tuple[float, float], altitude_m: float, mask_deg: float
    ) -> np.ndarray:
        """Return ``[360]`` the elevation in degrees up to which buildings and hills fill the sky over a place.

        At each whole degree of azimuth, clockwise from true north; at least the elevation mask, or `LOWEST_HORIZON_DEG`
        where that is lower. NaN where a ray along the horizon leaves what is known. The sky seen below a slab counts as
        filled.

        Args:
          grid: in the city's CRS.
          lonlat: longitude, latitude of the place in degrees.
          altitude_m: of the place above the ground.
          mask_deg: the elevation mask.
        """
        # A ray a direction, at the lowest elevation; `slope` is the tangent of the horizon so far.
        azimuth_rad = np.radians(np.arange(360.0)) - grid.convergence_rad(*lonlat)
        num = len(azimuth_rad)
        x_m, y_m = grid.xy_of_lonlat(*lonlat)
        lowest_rad = np.full(num, np.radians(max(mask_deg, LOWEST_HORIZON_DEG)))
        rays = Rays(np.full(num, x_m), np.full(num, y_m), azimuth_rad, lowest_rad)
        rise_m = self.rise_m(np.full(num, altitude_m))
        height_m = self.known_ground_at(rays.x_m, rays.y_m) + altitude_m
        slope = np.tan(lowest_rad)
        gap_m = np.full(num, np.inf)  # distance to the nearest place without data

        # Buildings by their outlines: the horizon is where rays enter and leave them.
        if self.outlines is not None:
            over = self.outlines.stretches(rays, height_m, 0.0)
            roof_m = self.outlines.buildings.height_m[over.building]
            for along_m in (over.from_m, over.to_m):
                top_m = self.outlines.elevations_m(rays, over.ray, along_m) + roof_m
                np.maximum.at(slope, over.ray, _slope(top_m - height_m[over.ray], along_m))

        # Terrain, and roofs of a raster.
        for ray, distance_m, ground_m, roof_m in self.samples(rays, rise_m):
            above_m = ground_m + roof_m - height_m[ray]
            slope[ray] = np.fmax(slope[ray], _slope(above_m, distance_m))
            gap_m[ray] = np.fmin(gap_m[ray], np.where(np.isnan(above_m), distance_m, np.inf))

        # The horizon is known where its ray is above all roofs before it comes to the end of what is known.
        horizon = replace(rays, elevation_rad=np.arctan(slope))
        is_known = horizon.stays_within(self.known, rise_m) & (gap_m * slope > rise_m)
        return np.where(is_known, np.degrees(horizon.elevation_rad), np.nan)


def _slope(above_m: np.ndarray, along_m: np.ndarray | float) -> np.ndarray:
    """Return tangents of elevations: height over distance, at distance 0 inf for what is above and 0 for the rest."""
    return np.divide(above_m, along_m, out=np.where(above_m > 0, np.inf, 0.0), where=along_m > 0)
