"""What is known of a city, and which rays toward satellites stay within it: unknown is not open."""

from dataclasses import dataclass, replace

import numpy as np
import shapely


def stays_within(
    known: shapely.Geometry,
    start_m: np.ndarray,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    rise_m: float | np.ndarray,
) -> np.ndarray:
    """Return which rays stay above known ground until they have risen so far that no roof can meet them.

    This follows from places and directions alone: what a ray meets on its way changes nothing.

    Args:
      known: the area of known ground, in the CRS of the places.
      start_m: ``[..., 2]`` easting and northing where the rays begin.
      azimuth_rad: ``[...]`` clockwise from grid north; its shape and that of the places are broadcast.
      elevation_rad: ``[...]`` above the horizon, above 0.
      rise_m: height from the receivers to the highest roof, one for each ray or for all; below 0 it counts as 0.

    Returns:
      ``[...]`` bool; False too for a ray that begins outside the known area.
    """
    run_m = np.maximum(rise_m, 0.0) / np.tan(elevation_rad)
    east_m = run_m * np.sin(azimuth_rad)
    north_m = run_m * np.cos(azimuth_rad)
    end_m = start_m + np.stack([east_m, north_m], axis=-1)
    rays = np.stack(np.broadcast_arrays(start_m, end_m), axis=-2)  # [..., 2 ends, 2]

    # A ray whose ends are both in one rectangle stays in it: no geometry need be made of it.
    stays = np.zeros(rays.shape[:-2], bool)
    for part in shapely.get_parts(known):
        box = shapely.box(*part.bounds)
        if shapely.equals(part, box):
            stays |= ((rays >= box.bounds[:2]) & (rays <= box.bounds[2:])).all(axis=(-2, -1))

    shapely.prepare(known)
    stays[~stays] = shapely.covers(known, shapely.linestrings(rays[~stays]))
    return stays


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays from places toward satellites. ``R`` rays.

    Attributes:
      x_m, y_m: ``[R]`` float64 places in the CRS of the city.
      azimuth_rad: ``[R]`` float64 clockwise from grid north.
      elevation_rad: ``[R]`` float64 above the horizon.
    """

    x_m: np.ndarray
    y_m: np.ndarray
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray

    def take(self, rows: np.ndarray) -> "Rays":
        """Return the rays at ``rows`` (integers or a mask)."""
        return Rays(*(values[rows] for values in vars(self).values()))

    def moved(self, east_m: float, north_m: float) -> "Rays":
        """Return the rays from places moved east and north by some metres, in the same directions."""
        return replace(self, x_m=self.x_m + east_m, y_m=self.y_m + north_m)

    def stays_within(self, known: shapely.Geometry, rise_m: float | np.ndarray) -> np.ndarray:
        """Return ``[R]`` which rays stay above known ground (`stays_within`)."""
        start_m = np.column_stack([self.x_m, self.y_m])
        return stays_within(known, start_m, self.azimuth_rad, self.elevation_rad, rise_m)

    def places_m(self, ray: np.ndarray, along_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x_m and y_m, ``[..., P]`` each, where rays are after a distance along the ground.

        Args:
          ray: ``[P]`` numbers of the rays.
          along_m: ``[..., P]`` distance from each ray's own place.
        """
        azimuth_rad = self.azimuth_rad[ray]
        x_m = self.x_m[ray] + along_m * np.sin(azimuth_rad)
        y_m = self.y_m[ray] + along_m * np.cos(azimuth_rad)
        return x_m, y_m
