"""Rays that walk over the cells around a track: 50 times quicker than through outlines, for 100,000 rays and more.

Legend: ``R`` rays, ``Y, X`` cells.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import jax
import numpy as np

from jaxurban.io.city import City
from jaxurban.io.rasterise import rasterise, surface_grid
from jaxurban.kernels.shadows.rays import Walks, shadows_at, walks
from jaxurban.receivers.rule import FARTHEST_MARGIN_M
from jaxurban.settings import TO_GROUND
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays
from jaxurban.world.surface import stands_at

LEG_CELLS = 4_000_000  # of the box around a leg of the track


@dataclass(frozen=True, eq=False)
class LegSurface:
    """Roofs and terrain around a leg of a track. What hangs is taken to reach the ground.

    Attributes:
      grid: of the cells.
      roof_m: ``[Y, X]`` highest roof above the ground of its cell, 0 without one.
      terrain_m: ``[Y, X]`` elevation; None where the ground is flat.
      has_data: ``[Y, X]`` bool; None where all cells have.
      antenna_m: height of the receiver above the ground.
    """

    grid: Grid
    roof_m: np.ndarray
    terrain_m: np.ndarray | None
    has_data: np.ndarray | None
    antenna_m: float

    @classmethod
    def around(
        cls, city: City, box: Grid, around_m: float, reach_m: float, antenna_m: float
    ) -> "LegSurface":
        """Return the ground of places in and around a box, and of what can hide satellites from there.

        Args:
          city: its buildings and terrain; parts that hang, as bridges do, are taken to reach the ground.
          box: the cells that hold the track.
          around_m: how far around the box places may lie.
          reach_m: as far as a building can hide a satellite.
          antenna_m: height of the receiver above the ground.
        """
        whole = replace(city, blocks=None, hanging=TO_GROUND)
        toward_m = (around_m + reach_m,) * 4
        surface = rasterise(whole, surface_grid(city, box, around_m, toward_m)).of_hiding()
        on_host = surface.roof_m, surface.terrain_m, surface.has_data
        roof_m, terrain_m, has_data = jax.device_get(on_host)
        return cls(surface.grid, roof_m, terrain_m, has_data, antenna_m)

    @cached_property
    def _most_m(self) -> float:
        """How far a ray must rise to be `FARTHEST_MARGIN_M` above all."""
        climb_m = 0.0 if self.terrain_m is None else float(np.ptp(self.terrain_m))
        return float(self.roof_m.max(initial=0.0)) + climb_m + FARTHEST_MARGIN_M

    @cached_property
    def _tops_m(self) -> jax.Array:
        """Tops of roofs, -inf where none is: flat ground throws no shadow of its own."""
        bottom_m = 0.0 if self.terrain_m is None else self.terrain_m
        return jax.device_put(
            np.where(self.roof_m > 0, bottom_m + self.roof_m, -np.inf).astype(np.float32)
        )

    @cached_property
    def _hills_m(self) -> jax.Array:
        return jax.device_put(self.terrain_m)

    @cached_property
    def _gaps_m(self) -> jax.Array:
        """0 where no data are, -inf elsewhere."""
        assert self.has_data is not None
        return jax.device_put(np.where(self.has_data, -np.inf, 0.0).astype(np.float32))

    def is_inside(self, rays: Rays) -> np.ndarray:
        """Return ``[R]`` which places lie in a building."""
        return stands_at(self.roof_m[self.grid.cell_of_xy(rays.x_m, rays.y_m)], self.antenna_m)

    def margins_m(self, rays: Rays) -> np.ndarray:
        """Return ``[R]`` metres by which the antenna of each ray lies above the edge of the shadow of roofs and hills.

        Margins of `FARTHEST_MARGIN_M` or more are +inf. Terrain counts only where it hides: a ray that passes near over
        a hill keeps the margin of the roofs.

        Args:
          rays: from places in the box.
        """
        # [R] the height of the shadow's edge at each place, and of the antenna, both above the same level.
        row, col, lines = self._lines(rays)
        shadow_m = shadows_at(self._tops_m, row, col, lines, self._most_m)
        height_m = np.float32(self.antenna_m)
        if self.terrain_m is not None:
            height_m = self.terrain_m[row, col] + height_m

            # The shadow of the ground alone counts where it lies above the antenna.
            hill_m = shadows_at(self._hills_m, row, col, lines, self._most_m)
            shadow_m = np.maximum(shadow_m, np.where(hill_m >= height_m, hill_m, -np.inf))
        margin_m = height_m - shadow_m
        return np.where(margin_m < FARTHEST_MARGIN_M, margin_m, np.inf)

    def crosses_gap(self, rays: Rays, rise_m: float) -> np.ndarray:
        """Return ``[R]`` which rays begin over a cell without data, or cross one before they rise by ``rise_m``."""
        if self.has_data is None:
            return np.zeros(len(rays.x_m), bool)
        row, col, lines = self._lines(rays)
        gap_m = shadows_at(self._gaps_m, row, col, lines, max(rise_m, 0.0))
        return ~self.has_data[row, col] | (gap_m > -np.inf)

    def _lines(self, rays: Rays) -> tuple[np.ndarray, np.ndarray, Walks]:
        """Return rows and columns of the places, and the digital lines of the rays."""
        row, col = self.grid.cell_of_xy(rays.x_m, rays.y_m)
        start = row + self.grid.first_row, col + self.grid.first_col
        return row, col, walks(rays.azimuth_rad, rays.elevation_rad, self.grid.resolution_m, *start)
