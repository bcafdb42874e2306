"""What is known of a city, and which rays toward satellites stay within it: unknown is not open."""

import numpy as np
import shapely

from jaxurban.world.city import City


def known_ground(city: City) -> shapely.Geometry:
    """Return where a city's buildings and, where it has any, its terrain are known, in the city's CRS."""
    if city.terrain_extent_m is None:
        return city.known_area
    return shapely.intersection(city.known_area, shapely.box(*city.terrain_extent_m))


def stays_within(
    known: shapely.Geometry,
    start_m: np.ndarray,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    rise_m: float,
) -> np.ndarray:
    """Return which rays stay above known ground until they have risen so far that no roof can meet them.

    This follows from places and directions alone: what a ray meets on its way changes nothing.

    Args:
      known: in the CRS of the places.
      start_m: ``[..., 2]`` easting and northing where the rays begin.
      azimuth_rad: ``[...]`` clockwise from grid north; its shape and that of the places are broadcast.
      elevation_rad: ``[...]`` above 0.
      rise_m: from the receivers to the highest roof; below 0 it counts as 0.

    Returns:
      ``[...]`` bool; False too of a ray that begins elsewhere.
    """
    run_m = max(rise_m, 0.0) / np.tan(elevation_rad)
    end_m = start_m + np.stack([run_m * np.sin(azimuth_rad), run_m * np.cos(azimuth_rad)], axis=-1)
    rays = np.stack(np.broadcast_arrays(start_m, end_m), axis=-2)
    stays = np.zeros(rays.shape[:-2], bool)
    for part in shapely.get_parts(known):
        box = shapely.box(*part.bounds)
        if shapely.equals(part, box):  # convex: the ends decide, without a geometry a ray
            stays |= ((rays >= box.bounds[:2]) & (rays <= box.bounds[2:])).all(axis=(-2, -1))
    shapely.prepare(known)
    stays[~stays] = shapely.covers(known, shapely.linestrings(rays[~stays]))
    return stays
