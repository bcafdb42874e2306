"""Exact prisms of buildings as an Embree scene: the outside witness of occlusion and lidar."""

from typing import Self

import numpy as np
import shapely
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from jaxurban.kernels.dop import unit_vectors
from jaxurban.metrics.lidar import Lidar


def wall_triangles(
    polygons: np.ndarray, height_m: np.ndarray, floor_m: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return ``[N, 3, 3]`` float64 triangles of the walls, from each floor (left out, the ground) to each roof."""
    parts, part_owner = shapely.get_parts(polygons, return_index=True)
    rings, ring_owner = shapely.get_rings(parts, return_index=True)
    owner = part_owner[ring_owner]
    points, point_ring = shapely.get_coordinates(rings, return_index=True)
    first = np.flatnonzero(
        point_ring[:-1] == point_ring[1:]
    )  # an edge joins two points of one ring
    top, floor = (
        np.broadcast_to(z_m, len(polygons))[owner[point_ring[first]]] for z_m in (height_m, floor_m)
    )
    a, b = points[first], points[first + 1]
    low_a, low_b = (np.column_stack([p, floor]) for p in (a, b))
    high_a, high_b = (np.column_stack([p, top]) for p in (a, b))
    return np.concatenate(
        [np.stack([low_a, low_b, high_b], 1), np.stack([low_a, high_b, high_a], 1)]
    )


def roof_triangles(polygons: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Return ``[N, 3, 3]`` float64 triangles of the flat roofs."""
    parts, owner = shapely.get_parts(polygons, return_index=True)
    faces, face_part = shapely.get_parts(
        shapely.constrained_delaunay_triangles(parts), return_index=True
    )
    corners = shapely.get_coordinates(faces).reshape(-1, 4, 2)[:, :3]
    top = np.broadcast_to(height_m[owner[face_part], None, None], (*corners.shape[:2], 1))
    return np.concatenate([corners, top], axis=2)


class CityScene:
    """Buildings extruded from floors (left out, the ground) to roofs, for ray queries in the polygons' CRS."""

    def __init__(
        self, polygons: np.ndarray, height_m: np.ndarray, floor_m: np.ndarray | float = 0.0
    ):
        areal = np.isin(shapely.get_type_id(polygons), (3, 6))  # Polygon, MultiPolygon
        height_m, floor_m = (
            np.broadcast_to(z_m, len(polygons))[areal].astype(float) for z_m in (height_m, floor_m)
        )
        polygons = polygons[areal]
        hangs = floor_m > 0
        faces = [
            wall_triangles(polygons, height_m, floor_m),
            roof_triangles(polygons, height_m),
            roof_triangles(polygons[hangs], floor_m[hangs]),  # the undersides
        ]
        triangles = np.concatenate(faces)
        # Local coordinates first: in float32 an easting of 600 km has steps of 6 cm.
        self.origin_m = np.append(np.round(triangles.reshape(-1, 3).mean(axis=0))[:2], 0.0)
        self.scene = EmbreeScene(robust=True)
        self.mesh = TriangleMesh(self.scene, (triangles - self.origin_m).astype(np.float32))

    def distance_m(self, start_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return how far rays run to the first wall or roof, inf where they meet none.

        Args:
          start_m: ``[N, 3]`` x, y in the CRS and z above the ground.
          direction: ``[N, 3]`` unit vectors east, north, up.
        """
        start = (np.asarray(start_m, float) - self.origin_m).astype(np.float32)
        hit = self.scene.run(start, np.asarray(direction, np.float32), query="DISTANCE")
        return np.where(hit < 1e30, hit, np.inf)

    def sees(self, start_m: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return which of ``[S, 3]`` directions are free from ``[N, 3]`` points, ``[S, N]`` bool."""
        return np.array(
            [np.isinf(self.distance_m(start_m, np.tile(d, (len(start_m), 1)))) for d in directions]
        )

    def scan(self, start_m: np.ndarray, lidar: Lidar, ground: Self | None = None) -> np.ndarray:
        """Return the share of scan positions that return from a wall at each point, every beam a ray, ``[N]``."""
        azimuth_rad = 2 * np.pi * np.arange(lidar.azimuths) / lidar.azimuths
        returned = np.zeros((len(start_m), lidar.azimuths), bool)
        for elevation_rad in sorted(
            lidar.elevations_rad, key=abs
        ):  # the likeliest beams first, to save rays
            point, k = np.nonzero(~returned)
            ray = start_m[point], unit_vectors(azimuth_rad[k], np.full(len(k), elevation_rad))
            wall_m, ground_m = (
                self.distance_m(*ray),
                np.inf if ground is None else ground.distance_m(*ray),
            )
            returned[point, k] = (wall_m <= lidar.range_m) & (wall_m <= ground_m)
        return returned.mean(axis=1)
