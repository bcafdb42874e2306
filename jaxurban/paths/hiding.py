"""Hiding: what of a city hides rays from places, by its exact outlines, its terrain and its raster of roofs.

Outlines are met exactly (`jaxurban.world.outline_rays`). Terrain is sampled every 5 m along a ray, bilinear between
its pixels; a raster of roofs every metre, by the pixel.

Legend: ``R`` rays.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.read.rasterise import UNKNOWN_GROUND_M, highest_top_m
from jaxurban.io.read.sampling import values_at
from jaxurban.progress import LOG
from jaxurban.world.grid import WGS84, transformer
from jaxurban.world.known import Rays
from jaxurban.world.outline_rays import FARTHEST_MARGIN_M, Outlines

GROUND_STEP_M, ROOF_STEP_M = 5.0, 1.0  # between samples of terrain, and of a raster of roofs
MOST_RAYS, MOST_AT_ONCE = 5_000_000, 50_000
ROOF = ("roof_height_m", "roof_distance_m", "roof_lon", "roof_lat", "roof_is_guessed")


class Samples(NamedTuple):
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
    """What of a city hides rays."""

    city: City

    @cached_property
    def outlines(self) -> Outlines | None:
        """The outlines of all that stands with a height, for rays to meet; None where a raster holds the city's roofs.

        Over terrain they stand on the ground, whose greatest height they are given too.
        """
        city = self.city
        if city.standing is None:
            return None
        standing = city.standing.take(city.standing.height_m > 0)
        if city.terrain is None:
            return Outlines(standing, city.hanging)
        highest_m = float(np.nanmax(city.terrain.values))
        return Outlines(standing, city.hanging, self.known_ground_at, highest_m)

    def ground_at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the ground's elevation at places in the city's CRS: NaN where it is not known, 0 without terrain."""
        if self.city.terrain is None:
            return np.zeros(np.shape(x_m))
        return values_at(self.city.terrain, x_m, y_m, self.city.crs, "bilinear")

    def known_ground_at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the elevation of the ground, far down where it is not known: what stands there hides nothing."""
        return np.nan_to_num(self.ground_at(x_m, y_m), nan=UNKNOWN_GROUND_M)

    def rise_m(self, altitude_m: np.ndarray) -> np.ndarray:
        """Return ``[R]`` how many metres a ray rises until it is above all roofs and hills of the city.

        Args:
          altitude_m: ``[R]`` of the places where the rays begin, above the ground.
        """
        return highest_top_m(self.city) - altitude_m

    def samples(self, rays: Rays, rise_m: np.ndarray) -> Iterator[Samples]:
        """Yield what terrain and roofs of a raster are under rays, at one distance after the other.

        Yields nothing where the city has neither.

        Args:
          rays: ``R`` of them.
          rise_m: ``[R]`` how far each rises before it is above all roofs; samples end there.
        """
        if self.city.terrain is None and self.city.roofs is None:
            return
        step_m = GROUND_STEP_M if self.city.roofs is None else ROOF_STEP_M
        run_m = np.maximum(rise_m, 0.0) / np.tan(rays.elevation_rad)
        for along_m in np.arange(0.0, run_m.max(initial=0.0) + step_m, step_m):
            ray = np.flatnonzero(run_m >= along_m)
            places = rays.places_m(ray, along_m)
            roof_m = np.zeros(len(ray))
            if self.city.roofs is not None:
                roof_m = values_at(self.city.roofs, *places, self.city.crs, "nearest")
            yield Samples(ray, along_m, self.ground_at(*places), roof_m)

    def behind(self, rays: Rays, altitude_m: np.ndarray) -> pd.DataFrame:
        """Return a row for each ray: whether it is known, and the roof that hides it.

        Columns: ``is_known``, which depends on place and direction alone, not on what the ray meets. ``margin_m``, how
        far the ray is above the roof or hill, or below the floor, that it clears by least: 0 or below where it is
        hidden, inf where nothing comes within 30 m, NaN of rays that are not known. Of hidden rays also `ROOF`: the
        height of the roof above its ground (NaN: the ground hides the ray), the distance along the ground to where the
        ray enters its outline, longitude and latitude of that place, and whether the height is guessed. Of other rays
        these are NaN, and the last False.

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
        inside = np.flatnonzero(rays.stays_within(self.city.known_ground, rise_m))
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
            counts = (raster_roof_m > 0) | (above_ground_m < 0)
            clears_m = np.where(counts, above_ground_m - raster_roof_m, np.inf)
            is_less = clears_m < np.minimum(margin_m[ray], FARTHEST_MARGIN_M)
            less = ray[is_less]
            margin_m[less] = clears_m[is_less]
            distance_m[less] = along_m
            is_guessed[less] = False
            roof_m[less] = np.where(raster_roof_m > 0, raster_roof_m, np.nan)[is_less]

        # The table of all rays. Rays that leave what is known have NaN in it, and False in columns of bool.
        hides = (margin_m <= 0) & ~is_gap
        places = inner.places_m(np.arange(num), distance_m)
        lon, lat = transformer(self.city.crs, WGS84).transform(*places)
        columns = {"is_known": ~is_gap, "margin_m": np.where(is_gap, np.nan, margin_m)}
        for name, values in zip(ROOF, (roof_m, distance_m, lon, lat, is_guessed), strict=True):
            columns[name] = np.where(hides, values, np.nan)
        table = pd.DataFrame(columns, inside).reindex(range(len(rays.x_m)))
        for name in ("is_known", "roof_is_guessed"):
            table[name] = table[name].eq(True)
        return table

    def horizon_deg(
        self, x_m: float, y_m: float, altitude_m: float, azimuth_rad: np.ndarray, lowest_deg: float
    ) -> np.ndarray:
        """Return ``[K]`` the elevation in degrees up to which buildings and hills fill the sky over a place.

        It is ``lowest_deg`` or more, and NaN where a ray along the horizon leaves what is known. The sky seen below a
        slab counts as filled.

        Args:
          x_m, y_m: of the place, in the city's CRS.
          altitude_m: of the place above the ground.
          azimuth_rad: ``[K]`` directions, clockwise from grid north.
          lowest_deg: the least elevation that is looked at, above 0.
        """
        # A ray a direction, at the lowest elevation; `slope` is the tangent of the horizon so far.
        num = len(azimuth_rad)
        lowest_rad = np.full(num, np.radians(lowest_deg))
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
        is_known = horizon.stays_within(self.city.known_ground, rise_m) & (gap_m * slope > rise_m)
        return np.where(is_known, np.degrees(horizon.elevation_rad), np.nan)


def _slope(above_m: np.ndarray, along_m: np.ndarray | float) -> np.ndarray:
    """Return tangents of elevations: height over distance, at distance 0 inf for what is above and 0 for the rest."""
    return np.divide(above_m, along_m, out=np.where(above_m > 0, np.inf, 0.0), where=along_m > 0)
