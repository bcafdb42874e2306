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

from jaxurban.io.city import City
from jaxurban.io.read.rasterise import UNKNOWN_GROUND_M, highest_top_m
from jaxurban.io.read.sampling import values_at
from jaxurban.world.grid import WGS84, transformer
from jaxurban.world.known import Rays
from jaxurban.world.outline_rays import FARTHEST_MARGIN_M, Outlines

GROUND_STEP_M, ROOF_STEP_M = 5.0, 1.0  # between samples of terrain, and of a raster of roofs
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
        """Its buildings; None where a raster holds its roofs."""
        city = self.city
        if city.buildings is None:
            return None
        if city.terrain is None:
            return Outlines(city.buildings, city.hanging)
        highest_m = float(np.nanmax(city.terrain.values))
        return Outlines(city.buildings, city.hanging, self.known_ground_at, highest_m)

    def ground_at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the elevation of the ground at places; NaN where it is not known."""
        if self.city.terrain is None:
            return np.zeros(np.shape(x_m))
        return values_at(self.city.terrain, x_m, y_m, self.city.crs, "bilinear")

    def known_ground_at(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        """Return the elevation of the ground, far down where it is not known: what stands there hides nothing."""
        return np.nan_to_num(self.ground_at(x_m, y_m), nan=UNKNOWN_GROUND_M)

    def rise_m(self, altitude_m: np.ndarray) -> np.ndarray:
        """Return how far rays from so high above the ground rise until they are above all roofs."""
        return highest_top_m(self.city) - altitude_m

    def samples(self, rays: Rays, rise_m: np.ndarray) -> Iterator[Samples]:
        """Yield what rasters hold under rays until these have risen so far; nothing where the city has none."""
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
            yield Samples(ray, float(along_m), self.ground_at(*places), roof_m)

    def behind(self, rays: Rays, altitude_m: np.ndarray) -> pd.DataFrame:
        """Return, a row a ray, whether it is known, and the roof that hides it.

        Columns: ``is_known``, from place and direction alone: what the ray meets changes nothing. ``margin_m``, how far
        it is above the roof or hill, or below the floor, that it clears by least, 0 or below where it is hidden, inf
        where nothing comes within 30 m, NaN of rays that are not known. Of hidden ones `ROOF`: the height of the
        roof above its ground (NaN: the ground hides it), the distance along the ground to where the ray enters its
        outline, longitude and latitude of that place, and whether the height is guessed; NaN and False of others.

        Args:
          rays: with elevations above 0.
          altitude_m: ``[R]`` of their places above the ground.
        """
        rise_m = self.rise_m(altitude_m)
        inside = np.flatnonzero(rays.stays_within(self.city.known_ground, rise_m))
        inner = rays.take(inside)
        height_m = self.known_ground_at(inner.x_m, inner.y_m) + altitude_m[inside]
        num = len(inside)
        margin_m = np.full(num, np.inf)
        distance_m, roof_m = np.full((2, num), np.nan)
        is_guessed, is_gap = np.zeros((2, num), bool)
        if self.outlines is not None:
            buildings = self.outlines.buildings
            margin_m, building, distance_m = self.outlines.clearances(inner, height_m)
            roof_m = np.append(buildings.height_m, np.nan)[building]  # the last is of `NO_HIT`
            is_guessed = np.append(buildings.is_guessed, False)[building]
        for ray, along_m, ground_m, here_m in self.samples(inner, rise_m[inside]):
            is_gap[ray] |= np.isnan(ground_m + here_m)
            above_m = height_m[ray] + along_m * np.tan(inner.elevation_rad[ray]) - ground_m
            counts = (here_m > 0) | (above_m < 0)  # the ground where it hides
            clears_m = np.where(counts, above_m - here_m, np.inf)
            is_less = clears_m < np.minimum(margin_m[ray], FARTHEST_MARGIN_M)
            less = ray[is_less]
            margin_m[less] = clears_m[is_less]
            distance_m[less] = along_m
            is_guessed[less] = False
            roof_m[less] = np.where(here_m > 0, here_m, np.nan)[is_less]
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

        At least ``lowest_deg``. NaN where a ray along it leaves what is known. What is below a slab counts as filled.

        Args:
          x_m, y_m: of the place.
          altitude_m: above the ground there.
          azimuth_rad: ``[K]`` clockwise from grid north.
          lowest_deg: above 0.
        """
        num = len(azimuth_rad)
        lowest_rad = np.full(num, np.radians(lowest_deg))
        rays = Rays(np.full(num, x_m), np.full(num, y_m), azimuth_rad, lowest_rad)
        rise_m = self.rise_m(np.full(num, altitude_m))
        height_m = self.known_ground_at(rays.x_m, rays.y_m) + altitude_m
        slope = np.tan(lowest_rad)
        gap_m = np.full(num, np.inf)
        if self.outlines is not None:
            over = self.outlines.stretches(rays, height_m, 0.0)
            for along_m in (over.from_m, over.to_m):
                top_m = self.outlines.buildings.height_m[over.building]
                above_m = self.outlines.elevations_m(rays, over.ray, along_m) + top_m
                np.maximum.at(slope, over.ray, _slope(above_m - height_m[over.ray], along_m))
        for ray, distance_m, ground_m, roof_m in self.samples(rays, rise_m):
            above_m = ground_m + roof_m - height_m[ray]
            slope[ray] = np.fmax(slope[ray], _slope(above_m, np.full(len(ray), distance_m)))
            gap_m[ray] = np.fmin(gap_m[ray], np.where(np.isnan(above_m), distance_m, np.inf))
        along = replace(rays, elevation_rad=np.arctan(slope))
        is_known = along.stays_within(self.city.known_ground, rise_m) & (gap_m * slope > rise_m)
        return np.where(is_known, np.degrees(along.elevation_rad), np.nan)


def _slope(above_m: np.ndarray, along_m: np.ndarray) -> np.ndarray:
    """Return tangents of elevations, inf upright."""
    return np.divide(above_m, along_m, out=np.where(above_m > 0, np.inf, 0.0), where=along_m > 0)
