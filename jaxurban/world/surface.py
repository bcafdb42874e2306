"""Surface: a city as rasters on one grid, the region plus the margin that shadows and endangers it; its obstacles."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, DTypeLike, Float, Int, UInt8

from jaxurban.checks import values_given
from jaxurban.errors import InputError
from jaxurban.kernels.blocks import blocks_of, part_of
from jaxurban.programs import kept_jit
from jaxurban.world.grid import Grid

AnyArray = Array | np.ndarray
NO_BUILDING = -1  # in a raster of building indices
# Subcells of a cell along a side, odd, so that one has the cell's centre. Against Embree, under a deck 18 m wide and
# 12 m up, at 2 m cells (tests/metrics/test_embree.py): 1 makes 93.6 % of the answers right at worst, 3 97.7 %, 5
# 98.4 %, in twice the time of 3.
PER_CELL = 5
RASTERS = (
    "roof_m",
    "terrain_m",
    "has_data",
    "block",
    "roof_touched_m",
    "roof_guessed",
    "roof_limit_m",
    "roof_likely_m",
    "slabs",
    "roof_kind",
    "hiding_m",
    "returning_m",
)

OF_REGION = ("roof_touched_m", "roof_guessed", "roof_limit_m", "roof_likely_m", "roof_kind")
ROOFS = ("roof_m", "hiding_m", "returning_m")  # of all that stands, and of what counts for rays


class Slabs(NamedTuple):
    """What hangs over the ground, from floor to top. ``H`` slabs, each over one subcell; several may hang over one.

    Nothing that rests on a roof is one: it is a part of that roof.

    Attributes:
      row, col: ``[H]`` int64 subcell of each, counted from the CRS's origin in sides of `PER_CELL` to a cell.
      floor_m: ``[H]`` float32 height of the underside above the ground of its cell, above the cell's roof.
      top_m: ``[H]`` float32 height of the top above the ground of its cell.
      ground_m: ``[H]`` float32 elevation of that ground; 0 where the ground is flat.
      is_of_cell: ``[H]`` bool: it hangs over the whole cell for all but shadows, by the rule of roofs.
    """

    row: np.ndarray
    col: np.ndarray
    floor_m: np.ndarray
    top_m: np.ndarray
    ground_m: np.ndarray
    is_of_cell: np.ndarray

    @classmethod
    def joined(cls, parts: list["Slabs"]) -> "Slabs":
        """Return the slabs of several grids that share no cell."""
        return cls(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def take(self, index: np.ndarray) -> "Slabs":
        """Return the slabs at ``index`` (integers or a mask)."""
        return Slabs(*(values[index] for values in self))

    def over_cells(self, grid: Grid) -> tuple["Slabs", tuple[np.ndarray, np.ndarray]]:
        """Return the slabs that hang over whole cells of a grid, and the rows and columns of these cells in it."""
        row = self.row // PER_CELL - grid.first_row
        col = self.col // PER_CELL - grid.first_col
        is_in_rows = (row >= 0) & (row < grid.num_rows)
        is_in_cols = (col >= 0) & (col < grid.num_cols)
        is_over = self.is_of_cell & is_in_rows & is_in_cols
        return self.take(is_over), (row[is_over], col[is_over])

    def lowest_floors(self, grid: Grid) -> np.ndarray:
        """Return how high the lowest underside over each cell of a grid is above the ground, ``[Y, X]`` float32 metres.

        It is 0 where nothing hangs.
        """
        slabs, cells = self.over_cells(grid)
        floors_m = np.full(grid.shape, np.inf, np.float32)
        np.minimum.at(floors_m, cells, slabs.floor_m)
        return np.where(np.isinf(floors_m), np.float32(0), floors_m)

    def raised(self, roof_m: np.ndarray, grid: Grid) -> np.ndarray:
        """Return the roofs of a grid's cells, ``[Y, X]``, with these slabs as if they reached the ground."""
        slabs, cells = self.over_cells(grid)
        raised_m = np.array(roof_m)
        np.maximum.at(raised_m, cells, slabs.top_m.astype(raised_m.dtype))
        return raised_m


def roofs_of(height_m: Float[Array, " B"], building: Int[Array, "Y X"]) -> Float[Array, "Y X"]:
    """Return the roof of each cell, 0 without a building, in the type of ``height_m``.

    With the heights of the city the roofs are the surface's own, exactly. They are linear in the heights, so the
    gradient is exact as long as the order of overlapping buildings stays: a building that grows above another one in
    the same cell is not seen there until the buildings are rasterised again. Of buildings of equal height in a cell,
    the last one has the gradient.

    Args:
      height_m: ``[B]`` height of each building.
      building: ``[Y, X]`` from `jaxurban.io.rasterise.building_index`.
    """
    # NO_BUILDING, -1, takes the last entry: the 0 that is appended here.
    return jnp.append(height_m, jnp.zeros(1, height_m.dtype))[building]


class Frame(NamedTuple):
    """What of a surface's grids decides a program: all but where they lie.

    Attributes:
      resolution_m: side of a cell.
      shape: rows and columns of the grid.
      first_cell: row and column of the region's southwest cell in it.
      region_shape: rows and columns of the region.
      most_halo: see `Surface`.
    """

    resolution_m: float
    shape: tuple[int, int]
    first_cell: tuple[int, int]
    region_shape: tuple[int, int]
    most_halo: int | None


def _unplaced(resolution_m: float, first: tuple[int, int], shape: tuple[int, int]) -> Grid:
    """Return a grid without a CRS, for a program of JAX, which serves every place on the Earth.

    `Grid` itself would refuse an empty CRS, so its checks are passed over.

    Args:
      resolution_m: side of a cell.
      first: row and column of the southwest cell.
      shape: rows and columns.
    """
    # Any valid CRS would let a program use a place that is not the surface's; an empty one fails wherever it is used.
    grid = object.__new__(Grid)
    values = ("", resolution_m, *first, *shape)
    for name, value in zip(Grid.__dataclass_fields__, values, strict=True):
        object.__setattr__(grid, name, value)
    return grid


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True)
class Surface:
    """Rasters of a city. ``Y, X`` cells of ``grid`` (region and margin), ``y, x`` cells of ``region``.

    Row 0 is the southernmost row. A pytree of its rasters; where its grids lie is left out of it, so one program serves
    all cities of one shape, and they can be stacked and mapped over.

    Attributes:
      roof_m: height of the highest roof in each cell above the ground there, 0 without a building, float32; with
        ``slabs``, of what stands on the ground: see `at_altitude`.
      terrain_m: ground elevation, float32; None for flat ground.
      has_data: where the building (or terrain) source knows anything; None where it does everywhere.
      block: index of the census block under each cell of the region, or under samples of it, -1 without one; None
        without blocks.
      grid: grid of ``roof_m``, ``terrain_m`` and ``has_data``.
      region: the part of ``grid`` that maps report, grid of ``block`` and of all below but ``slabs``.
      roof_touched_m: height of the highest roof that shares area with each cell of the region, what planners keep
        clear of; None where nobody plans (on supersampled surfaces, and those made by hand).
      roof_guessed: whether the height of a cell's roof in the region, by its centre or by touch, is guessed; None where
        no height is.
      roof_limit_m: height above the ground up to which a roof of guessed height that touches a cell of the region may
        reach, the highest of these bounds, inf where one has none, 0 without such a roof; None where ``roof_guessed``
        is.
      roof_likely_m: as ``roof_limit_m``, what it likely does not exceed.
      most_halo: cells beyond the region that `crop_with_halo` gives at most; None for any number.
      slabs: what hangs over the grid, and beyond it whatever can shadow the region; None where everything reaches the
        ground, as ``roof_m`` then says.
      roof_kind: what has the highest roof that touches a cell of the region, a place in `jaxurban.world.kinds.EFFECTS`
        from 1 on, 0 for nothing; None where nothing but buildings stands.
      hiding_m, returning_m: as ``roof_m``, of what hides satellites, and of what returns a lidar's beam; None where
        that is all that stands.
    """

    roof_m: Float[Array, "Y X"]
    terrain_m: Float[Array, "Y X"] | None
    has_data: Bool[Array, "Y X"] | None
    block: Int[Array, "y x *samples"] | None
    grid: Grid
    region: Grid
    roof_touched_m: Float[Array, "y x"] | None = None
    roof_guessed: Bool[Array, "y x"] | None = None
    roof_limit_m: Float[Array, "y x"] | None = None
    roof_likely_m: Float[Array, "y x"] | None = None
    most_halo: int | None = None
    slabs: Slabs | None = None
    roof_kind: UInt8[Array, "y x"] | None = None
    hiding_m: Float[Array, "Y X"] | None = None
    returning_m: Float[Array, "Y X"] | None = None

    def tree_flatten(self) -> tuple[tuple, Frame]:
        """Return the rasters, which JAX may trace, and what decides a program."""
        rows, cols = self.window
        frame = Frame(
            self.grid.resolution_m,
            self.grid.shape,
            first_cell=(rows.start, cols.start),
            region_shape=self.region.shape,
            most_halo=self.most_halo,
        )
        return tuple(getattr(self, name) for name in RASTERS), frame

    @classmethod
    def tree_unflatten(cls, frame: Frame, rasters: Sequence[Any]) -> "Surface":
        """Return the surface of rasters, in the order of `RASTERS`, on grids whose place is left out."""
        grid = _unplaced(frame.resolution_m, (0, 0), frame.shape)
        region = _unplaced(frame.resolution_m, frame.first_cell, frame.region_shape)
        by_name = dict(zip(RASTERS, rasters, strict=True))
        return cls(**by_name, grid=grid, region=region, most_halo=frame.most_halo)

    def of_jax(self) -> "Surface":
        """Return this surface with its rasters as arrays of JAX, which nobody can alter; slabs stay on the host."""
        rasters = {name: getattr(self, name) for name in RASTERS if name != "slabs"}
        return replace(self, **jax.tree.map(jnp.asarray, rasters))

    @property
    def is_on_host(self) -> bool:
        """Whether its rasters are NumPy's, for maps made in blocks; JAX's are for one program over all of them."""
        return isinstance(self.roof_m, np.ndarray)

    @property
    def top_m(self) -> Float[Array, "Y X"]:
        """Absolute height of roofs and bare ground: terrain plus roof."""
        return self.roof_m if self.terrain_m is None else self.terrain_m + self.roof_m

    @property
    def roofs(self) -> dict[str, Any]:
        """The rasters of `ROOFS` that there are, by name."""
        return values_given({name: getattr(self, name) for name in ROOFS})

    def of_hiding(self) -> "Surface":
        """Return the surface of what hides satellites."""
        return self if self.hiding_m is None else replace(self, roof_m=self.hiding_m)

    def of_returning(self) -> "Surface":
        """Return the surface of what returns a lidar's beam."""
        return self if self.returning_m is None else replace(self, roof_m=self.returning_m)

    def with_heights(
        self,
        height_m: Float[Array, " B"],
        building: Int[Array, "Y X"],
        built_m: Float[Array, " B"] | None = None,
    ) -> "Surface":
        """Return this surface with other heights of its buildings, and nothing that hangs.

        Cells that a structure or a plant tops stay as they are.

        Args:
          height_m, building: as for `roofs_of`.
          built_m: ``[B]`` the heights of which the surface was made; None where nothing but buildings stands.
        """
        new_m = roofs_of(height_m, building)
        roofs: dict[str, Any] = {"roof_m": new_m}
        if built_m is not None:
            before_m = roofs_of(built_m, building).astype(np.float32)
            roofs = {
                name: jnp.where(before_m >= roof_m.astype(np.float32), new_m, roof_m)
                for name, roof_m in self.roofs.items()
            }
        unknown: dict[str, Any] = dict.fromkeys((*OF_REGION, "slabs"))
        return replace(self, **roofs, **unknown)

    def at_altitude(self, altitude_m: float) -> "Surface":
        """Return the surface as it counts at an altitude: slabs with their floor at or below it become roofs.

        Such a slab then reaches the ground, as what lies under its floor does not matter at the altitude; higher slabs
        are left. A cell is an obstacle where its roof reaches the altitude. At an altitude of inf every slab is a roof.

        Args:
          altitude_m: above the ground.
        """
        if self.slabs is None:
            return self
        is_below = self.slabs.floor_m <= np.float32(altitude_m)
        below = self.slabs.take(is_below)
        roofs: dict[str, Any] = {
            name: below.raised(np.asarray(roof_m), self.grid) for name, roof_m in self.roofs.items()
        }
        return replace(self, **roofs, slabs=self.slabs.take(~is_below))

    @property
    def window(self) -> tuple[slice, slice]:
        """Slices that cut the region out of arrays on ``grid``."""
        return self.region.window_in(self.grid)

    @property
    def window_ends(self) -> tuple[int, int, int, int]:
        """First and end row, first and end column of the region in arrays on ``grid``."""
        rows, cols = self.window
        return rows.start, rows.stop, cols.start, cols.stop

    def crop(self, values: Any) -> Any:
        """Return the region's part of an array whose last two axes are on ``grid``; None of None."""
        return self.part(values)

    def crop_with_halo(self, values: Any, halo: int) -> Any:
        """Return the region's part of an array on ``grid`` with ``halo`` more cells on each side (see `part`)."""
        return self.part(values, halo)

    def check_reach(self, cells: int) -> None:
        """Raise InputError where more cells beyond the region matter than ``most_halo``."""
        if self.most_halo is not None and cells > self.most_halo:
            reach_m = cells * self.grid.resolution_m
            raise InputError(
                f"a layer looks {reach_m:g} m sideways, beyond its reach_m: raise reach_m to that"
            )

    def part(self, values: Any, halo: int = 0, reach: int | None = None) -> Any:
        """Return the region's part of an array with more cells around it, 0 where the surface ends; None of None.

        Beyond the surface nothing stands. An array of NumPy gives one of NumPy, for which nothing is compiled.

        Args:
          values: the last two axes are on ``grid``.
          halo: how many cells more, on each side.
          reach: how many of the halo's cells matter; left out, all of them.

        Raises:
          InputError: more cells than ``most_halo`` matter.
        """
        self.check_reach(halo if reach is None else reach)
        if values is None:
            return None

        # Along each axis of the grid: the cells that the surface has, and how many 0 must stand before and after them.
        slices = []
        pads = []
        for inside, size in zip(self.window, self.grid.shape, strict=True):
            first, end = inside.start - halo, inside.stop + halo
            slices.append(slice(max(first, 0), min(end, size)))
            pads.append((max(-first, 0), max(end - size, 0)))
        cut = values[..., *slices]
        if not np.any(pads):
            return cut
        xp: Any = np if isinstance(values, np.ndarray) else jnp
        other_axes = [(0, 0)] * (cut.ndim - 2)
        return xp.pad(cut, other_axes + pads)


Cut = Callable[[Any], Any]


def over_blocks(
    surface: Surface,
    halo: int,
    reach: int,
    compute: Callable[[Cut], Any],
    num: int = 1,
    per_cell: int = 1,
) -> Float[np.ndarray, "A y x"]:
    """Return the values that a function computes for each map cell of a region, ``[A, y, x]`` float32.

    They are computed in square blocks of few sizes, so that few programs are compiled.

    Args:
      surface: ``per_cell`` times finer than the map.
      halo: map cells around a block that the function is given.
      reach: how many of the surface's cells around the region matter.
      compute: returns the values ``[A, T, T]`` of a block. It gets a function that cuts the block and its halo out of
        an array on the surface's grid, with 0 beyond it.
      num: A, such as the number of altitudes.
      per_cell: how many of the surface's cells lie along a side of a map's cell.
    """
    surface.check_reach(reach)
    shape = surface.region.num_rows // per_cell, surface.region.num_cols // per_cell
    rows, cols = surface.window
    values = np.empty((num, *shape), np.float32)
    for row, col, side in blocks_of(shape):
        # The block with its halo in the surface's cells; the last blocks may stick out of the region.
        corner = rows.start + (row - halo) * per_cell, cols.start + (col - halo) * per_cell
        size = (side + 2 * halo) * per_cell
        cut = partial(part_of, corner=corner, shape=(size, size), fill=0)
        block = values[:, row : row + side, col : col + side]
        block[:] = np.asarray(compute(cut))[:, : block.shape[1], : block.shape[2]]
    return values


def in_type(values: Any, dtype: DTypeLike) -> Array | np.ndarray:
    """Return numbers as an array of a type: JAX's if any of them is JAX's, else NumPy's, which compiles nothing."""
    is_held = any(isinstance(value, Array) for value in jax.tree.leaves(values))
    return jnp.asarray(values, dtype) if is_held else np.asarray(values, dtype)


def obstacle_mask(
    roof_m: Float[Array, "Y X"], altitudes_m: Sequence[float] | ArrayLike
) -> Bool[Array, "A Y X"]:
    """Return H_obs: True where the highest roof of a cell is at or above the altitude, ``[A, Y, X]``.

    Receiver and roof are both measured from the ground of their own cell, so terrain changes nothing. A cell without a
    building is free at every altitude. There is no gradient. Paper: section Obstacle Maps.

    Args:
      roof_m: ``[Y, X]`` roof heights above the ground of their cell, 0 without a building.
      altitudes_m: ``[A]`` heights above ground.
    """
    return stands_at(roof_m[None], in_type(altitudes_m, roof_m.dtype)[:, None, None])


def stands_at(roof_m: Any, altitude_m: Any) -> Any:
    """Return where a roof is at or above the altitude: the rule itself, of arrays of NumPy or JAX."""
    return (roof_m >= altitude_m) & (roof_m > 0)


def region_roofs(surface: Surface, altitude_m: float) -> Float[np.ndarray, "y x"]:
    """Return the roofs of a surface's region on the host, in metres above the ground, with slabs as roofs.

    A slab counts if its floor is at or below the altitude; at an altitude of inf all slabs do.
    """
    return surface.part(np.asarray(surface.at_altitude(altitude_m).roof_m))


def obstacles_on(surface: Surface, altitudes_m: Iterable[float]) -> Bool[np.ndarray, "A y x"]:
    """Return `obstacle_mask` of a surface's region on the host, where slabs are obstacles from floor to top."""
    altitudes = np.asarray(altitudes_m, surface.roof_m.dtype)
    return np.stack([stands_at(region_roofs(surface, float(z_m)), z_m) for z_m in altitudes])


@kept_jit
def soft_obstacle(
    roof_m: Float[Array, "*C"], z_m: ArrayLike, softness_m: ArrayLike
) -> Float[Array, "*C"]:
    """Return how much of an obstacle each cell is, 1 up to the roof, falling to 0 one softness above it.

    This is ``1 - q((z - roof) / softness)`` with ``q(t) = t^3 (10 - 15 t + 6 t^2)`` for t from 0 to 1, which is twice
    differentiable. It is never less than `obstacle_mask`. It equals that at and below the roof, from one softness above
    it, at softness 0, and everywhere in cells without a building (roof 0). The step does not lie around the roof, as
    roofs and altitudes of whole metres are often equal, where it would then not tend to the exact rule.

    Derivatives: smoothed between the roof and one softness above it, 0 elsewhere and at softness 0, undefined at roof
    0, where a building appears.

    Args:
      roof_m: roof heights above the ground of their cell, 0 without a building.
      z_m: altitude above the ground, a number or one for each cell.
      softness_m: >= 0.
    """
    roof = jnp.asarray(roof_m)
    softness = jnp.asarray(softness_m, roof.dtype)
    clearance_m = jnp.asarray(z_m, roof.dtype) - roof
    t = jnp.clip(clearance_m / jnp.where(softness > 0, softness, 1), 0, 1)
    soft_step = t**3 * (10 - 15 * t + 6 * t**2)
    hard_step = (clearance_m > 0).astype(roof.dtype)
    return jnp.where(roof > 0, 1 - jnp.where(softness > 0, soft_step, hard_step), 0)
