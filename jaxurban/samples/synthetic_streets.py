"""The plan of the synthetic city: where land, park, clusters and districts lie in a box."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely

from jaxurban.world.blocks import OTHER_DISTRICT

Box = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max, metres
Cluster = tuple[float, float, float, float]  # centre s, q and radii in s, q of a cluster of towers

# Manhattan's plan of 1811: avenues run 29 degrees clockwise from north, streets every 80 m, avenues every 270 m.
AVENUE_BEARING_RAD = math.radians(29.0)
AVENUE_PITCH_M = 274.0
STREET_PITCH_M = 80.0
# The suburbs have streets of their own.
WEST_BEARING_RAD = math.radians(12.0)
EAST_BEARING_RAD = math.radians(48.0)
SUBURB_PITCH_M = (95.0, 230.0)

# The plan in fractions: s along the island's axis (-1 southern tip, 1 northern tip), q across it (east positive).
# Columns: s, west shore, east shore (distances from the axis).
SHORES = np.array(
    [
        (-1.00, 0.00, 0.00),
        (-0.98, 0.08, 0.08),
        (-0.90, 0.15, 0.16),
        (-0.80, 0.20, 0.27),
        (-0.70, 0.25, 0.35),
        (-0.60, 0.28, 0.34),
        (-0.40, 0.30, 0.30),
        (-0.20, 0.30, 0.28),
        (0.10, 0.29, 0.29),
        (0.35, 0.28, 0.25),
        (0.55, 0.25, 0.17),
        (0.75, 0.20, 0.12),
        (0.90, 0.16, 0.10),
        (0.98, 0.09, 0.06),
        (1.00, 0.00, 0.00),
    ]
)
# Columns: s, far bank of the eastern river (q). North of the island it runs west to the wide river's bank.
EAST_BANK = np.array(
    [
        (-3.0, 0.75),
        (-1.1, 0.56),
        (-0.7, 0.46),
        (-0.4, 0.41),
        (0.1, 0.39),
        (0.45, 0.32),
        (0.75, 0.21),
        (0.95, 0.14),
        (1.05, 0.02),
        (1.15, -0.16),
        (1.3, -0.22),
        (3.0, -0.22),
    ]
)
WEST_BANK_Q = -0.52
# The island's width, and its least length in street blocks.
ISLAND_Q = 0.6
MIN_ROWS = 14
# The park's ends, and its width as a share of the island's.
PARK_S = (-0.26, 0.13)
PARK_SHARE = 0.24
# (s, q) of the street that ignores the grid.
BROADWAY = ((-0.95, 0.06), (-0.26, -0.10), (0.5, -0.28))
BROADWAY_M = 26.0
MIDTOWN = (-0.38, 0.0, 0.11, 0.15)
DOWNTOWN = (-0.88, 0.0, 0.075, 0.12)

# Districts by band of s from south to north (the park's ends bound the fourth), and by third: west, middle, east.
BANDS_S = (-0.78, -0.55, 0.52)
DISTRICTS = np.array(
    [(1, 1, 1), (2, 2, 3), (4, 5, 6), (7, OTHER_DISTRICT, 8), (9, 10, 11), (12, 12, 12)]
)


@dataclass(frozen=True)
class StreetFrame:
    """A turned frame in metres: ``along`` points to the bearing, ``across`` 90 degrees clockwise of it.

    Attributes:
      x_m, y_m: its origin in the CRS.
      bearing_rad: clockwise from grid north.
    """

    x_m: float
    y_m: float
    bearing_rad: float

    def xy(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return coordinates ``[..., 2]`` in the CRS of points ``[...]`` in this frame, metres."""
        sin = math.sin(self.bearing_rad)
        cos = math.cos(self.bearing_rad)
        return np.stack(
            [self.x_m + along * sin + across * cos, self.y_m + along * cos - across * sin], axis=-1
        )

    def local(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return along and across, each ``[...]`` in metres, of coordinates ``[..., 2]`` in the CRS."""
        sin = math.sin(self.bearing_rad)
        cos = math.cos(self.bearing_rad)
        x = xy[..., 0] - self.x_m
        y = xy[..., 1] - self.y_m
        return x * sin + y * cos, x * cos - y * sin

    def rectangles(self, along_0: Any, across_0: Any, along_1: Any, across_1: Any) -> np.ndarray:
        """Return the corners ``[..., 4, 2]`` in the CRS of rectangles given by two opposite corners in this frame."""
        along = np.stack([along_0, along_0, along_1, along_1], axis=-1)
        return self.xy(along, np.stack([across_0, across_1, across_1, across_0], axis=-1))


@dataclass(frozen=True)
class Land:
    """An area of land with one street grid; land may reach beyond the box.

    Attributes:
      is_island: whether it is the island, or else a suburb.
      land: out to the shore.
      frame: of its streets.
      pitch_m: from street to street and from avenue to avenue.
    """

    is_island: bool
    land: shapely.Polygon
    frame: StreetFrame
    pitch_m: tuple[float, float]

    @property
    def street_m(self) -> tuple[float, float]:
        """Width of streets and of avenues."""
        street_m = np.clip(0.225 * self.pitch_m[0], 8.0, 18.0)
        avenue_m = np.clip(0.11 * self.pitch_m[1], 14.0, 30.0)
        return street_m, avenue_m


class CityPlan:
    """The macro layout, scaled to a box; see `Land` for what each area of land gets."""

    def __init__(self, extent_m: Box) -> None:
        """Scale the plan to a box: the island's axis runs through its middle, turned by the avenues' bearing."""
        # The island's frame, half its length and the width that its shores are measured by.
        x_min, y_min, x_max, y_max = extent_m
        self.box = shapely.box(*extent_m)
        self.frame = StreetFrame((x_min + x_max) / 2, (y_min + y_max) / 2, AVENUE_BEARING_RAD)
        half_x = (x_max - x_min) / 2
        half_y = (y_max - y_min) / 2
        sin = math.sin(AVENUE_BEARING_RAD)
        cos = math.cos(AVENUE_BEARING_RAD)
        ray_m = min(half_x / sin, half_y / cos)  # from the middle to the box along the avenues
        self.length_m = 0.93 * ray_m  # s = 1
        self.width_m = min(half_x / cos, half_y / sin, 0.75 * ray_m)  # q = 1
        # Promenade between shore and buildings.
        self.margin_m = np.clip(0.02 * self.width_m, 5.0, 25.0)

        # Its streets. Odd numbers of columns, of all blocks and of the park's, so that the park is in the middle.
        island_m = ISLAND_Q * self.width_m
        num_columns = max(3, 2 * round((island_m / AVENUE_PITCH_M - 1) / 2) + 1)
        num_park_columns = max(1, 2 * round((PARK_SHARE * num_columns - 1) / 2) + 1)
        self.avenue_pitch_m = island_m / num_columns
        self.street_pitch_m = min(STREET_PITCH_M, 2 * self.length_m / MIN_ROWS)

        # The park, from one street to another (at least the next), and to both sides of the axis.
        south, north = (round(s * self.length_m / self.street_pitch_m) for s in PARK_S)
        north = max(north, south + 1)
        self.park_along_m = south * self.street_pitch_m, north * self.street_pitch_m
        self.park_across_m = num_park_columns * self.avenue_pitch_m / 2

    def parts(self) -> list[Land]:
        """Return the island and, where the box reaches them, the suburbs beyond its two rivers."""
        from scipy.interpolate import PchipInterpolator

        # The island: up along its western shore and back along the eastern one.
        shore_s = np.linspace(-1.0, 1.0, 161)
        western_q, eastern_q = PchipInterpolator(SHORES[:, 0], SHORES[:, 1:])(shore_s).T
        island = self._polygon(np.r_[shore_s, shore_s[::-1]], np.r_[-western_q, eastern_q[::-1]])

        # The suburbs, which reach beyond any box: behind the eastern river's far bank, and a straight western one.
        far_s = 4.0 + self.box.length / self.length_m
        far_q = 4.0 + self.box.length / self.width_m
        # Beyond its ends the bank runs on straight.
        bank_ends = EAST_BANK[0, 0], EAST_BANK[-1, 0]
        bank_s = np.r_[-far_s, np.linspace(*bank_ends, 401), far_s]
        bank_q = PchipInterpolator(EAST_BANK[:, 0], EAST_BANK[:, 1])(np.clip(bank_s, *bank_ends))
        east_side = self._polygon(np.r_[bank_s, far_s, -far_s], np.r_[bank_q, far_q, far_q])
        west_side = self._polygon(
            np.array([-far_s, far_s, far_s, -far_s]), np.repeat([WEST_BANK_Q, -far_q], 2)
        )
        east_frame = replace(self.frame, bearing_rad=EAST_BEARING_RAD)
        west_frame = replace(self.frame, bearing_rad=WEST_BEARING_RAD)

        island_pitch_m = self.street_pitch_m, self.avenue_pitch_m
        parts = [
            Land(is_island=True, land=island, frame=self.frame, pitch_m=island_pitch_m),
            Land(is_island=False, land=west_side, frame=west_frame, pitch_m=SUBURB_PITCH_M),
            Land(is_island=False, land=east_side, frame=east_frame, pitch_m=SUBURB_PITCH_M),
        ]
        return [part for part in parts if shapely.intersection(part.land, self.box).area > 0]

    def park(self) -> shapely.Polygon:
        """Return the central park."""
        (south, north), across = self.park_along_m, self.park_across_m
        return shapely.Polygon(self.frame.rectangles(south, -across, north, across))

    def broadway(self) -> shapely.Polygon:
        """Return the diagonal street, which cuts the blocks and buildings that it meets."""
        s, q = np.transpose(BROADWAY)
        line = shapely.LineString(self.frame.xy(s * self.length_m, q * self.width_m))
        return line.buffer(min(self.margin_m, BROADWAY_M / 2), cap_style="flat")

    def district(self, xy: np.ndarray) -> np.ndarray:
        """Return the district of points of the island, int32 ``[...]``.

        Args:
          xy: ``[..., 2]`` in the CRS.
        """
        along, across = self.frame.local(xy)
        # The borders of bands from south to north: two, the ends of the park, and one more.
        first_m, second_m, last_m = (s * self.length_m for s in BANDS_S)
        band = np.searchsorted([first_m, second_m, *self.park_along_m, last_m], along)
        # West of the park, between its sides, and east of it: as many of these borders lie west of a point.
        third = np.searchsorted([-self.park_across_m, self.park_across_m], across)
        return DISTRICTS[band, third].astype(np.int32)

    def depth_in(self, cluster: Cluster, xy: np.ndarray) -> np.ndarray:
        """Return ``[...]`` how deep in a cluster of towers points lie: 1 in its middle, falling to 0 (a Gaussian).

        Args:
          cluster: its centre and radii.
          xy: ``[..., 2]`` in the CRS.
        """
        along, across = self.frame.local(xy)
        centre_s, centre_q, radius_s, radius_q = cluster
        s = along / self.length_m
        q = across / self.width_m
        return np.exp(-(((s - centre_s) / radius_s) ** 2) - ((q - centre_q) / radius_q) ** 2)

    def _polygon(self, s: np.ndarray, q: np.ndarray) -> shapely.Polygon:
        """Return the polygon of corners in fractions of the plan: s along the island's axis, q across it."""
        return shapely.Polygon(self.frame.xy(s * self.length_m, q * self.width_m))
