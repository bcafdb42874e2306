"""Proximity risk: how far the nearest building is."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.checks import typed
from jaxurban.kernels.blocks import rounded_up
from jaxurban.kernels.distance import nearest as kernel
from jaxurban.metrics.base import ALTITUDE, AnyArray, Metric, Scene, low_is_bad, on_scene
from jaxurban.metrics.settings import (
    check_fields,
    check_softness,
    differentiable,
    is_positive,
    reach_of,
)
from jaxurban.programs import kept_jit
from jaxurban.world.surface import Cut, Surface, in_type, over_blocks


@differentiable("threshold_m")
@typed
@dataclass(frozen=True)
class Risk:
    """What counts as close. A pytree whose leaf is the threshold.

    Attributes:
      threshold_m: distance from which there is no risk, d_thresh.
      distance: ``"slice"``: to the nearest obstacle of the slice at the height of flight;
        ``"solid"``: to the nearest point of a building in 3-D, roofs below included.

    Raises:
      InputError: a threshold that is not a positive number, or an unknown distance.

    Examples:
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), risk=ju.Risk(threshold_m=100.0))
      >>> round(float(np.nanmean(made.m("risk"))), 2), round(float(np.nanmean(maps.m("risk", 60.0))), 2)
      (0.88, 0.96)
    """

    threshold_m: float = 50.0
    distance: Literal["slice", "solid"] = "slice"

    def __post_init__(self) -> None:
        check_fields(self, ["threshold_m"], "a positive number of metres", is_positive)


def compute_risk(
    surface: Surface,
    altitudes_m: Sequence[float] | Array,
    params: Risk,
    reach_m: float | None = None,
) -> Float[AnyArray, "A y x"]:
    """Return m_risk = min(d / d_thresh, 1) on the region, ``[A, y, x]`` float32; 0 inside obstacles.

    d is the exact Euclidean distance between cell centres to the nearest obstacle cell of the slice
    at the altitude, which follows the terrain as the altitudes do. ``"solid"`` adds the roofs below:
    each cell with a building is a column up to its roof, and d runs from the receiver to the nearest
    column; with terrain, receivers and columns stand on it. Bare ground is not an obstacle in either form.
    What stands more than the threshold beyond the region changes nothing; beyond the surface nothing
    stands. Slabs are obstacles of the slices between floor and top; to ``"solid"`` those above the altitude are as
    near as their floor and what is over it, others as what is below their top. Paper: eq. proximity_risk.
    Gradients: see `jaxurban.kernels.distance.nearest`; ``"slice"`` has none
    in heights.

    A surface of NumPy's arrays is computed in blocks, so all of them share two programs, whatever the resolution, the
    threshold and the altitudes.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitudes_m: ``[A]`` heights above ground.
      params: the risk; its threshold may be traced.
      reach_m: how far obstacles are looked for, never less than the threshold; left out, the threshold. Needed when
        that is traced.

    Raises:
      InputError: a traced threshold without ``reach_m``.
    """
    # With slabs, each altitude has roofs of its own.
    if surface.slabs is not None:
        levels_m = np.asarray(altitudes_m)
        if len(levels_m) > 1:
            maps = [compute_risk(surface, [z_m], params, reach_m) for z_m in levels_m]
            return np.concatenate(maps)
        surface = surface.at_altitude(float(levels_m[0]))

    resolution_m = surface.grid.resolution_m
    dtype = surface.roof_m.dtype
    reach_m = reach_of(params.threshold_m, reach_m, "risk threshold_m")
    reach = kernel.window_cells(reach_m, resolution_m)
    halo = rounded_up(reach)

    # What only the solid looks at: terrain with the cells around each, and undersides of what hangs above.
    is_solid = params.distance == "solid"
    terrain_m = ceiling_m = around = None
    if is_solid and surface.terrain_m is not None:
        terrain_m = surface.terrain_m
        around = kernel.disc(reach_m, resolution_m, dtype)
    if is_solid and surface.slabs is not None and len(surface.slabs.row):
        ceiling_m = surface.slabs.lowest_floors(surface.grid)

    rasters = surface.roof_m, terrain_m, ceiling_m
    settings = (
        in_type(altitudes_m, dtype),
        in_type(params.threshold_m, dtype),
        np.asarray(is_solid, dtype),
        kernel.squared_runs(halo, resolution_m, dtype),
        around,
    )

    def of_part(cut: Cut) -> Array:
        """Return the risk map of a part of the region; ``cut`` returns the part of a raster with its halo."""
        return _risk(*jax.tree.map(cut, rasters), *settings)

    if surface.is_on_host:
        return over_blocks(surface, halo, reach, of_part, num=len(altitudes_m))
    return of_part(lambda values: surface.part(values, halo, reach))


@kept_jit
def _risk(
    roof_m: Float[Array, "y+2H x+2H"],
    terrain_m: Float[Array, "y+2H x+2H"] | None,
    ceiling_m: Float[Array, "y+2H x+2H"] | None,
    altitudes_m: Float[Array, " A"],
    threshold_m: Float[Array, ""],
    scale_m: Float[Array, ""],
    run_m2: Float[Array, " H+1"],
    around: kernel.Disc | None,
) -> Float[Array, "A y x"]:
    """Return `compute_risk` of rasters on the region and its halo of ``H`` cells.

    Args:
      roof_m: heights of roofs above the ground, 0 without a building.
      terrain_m: elevation of the ground, for ``"solid"``; None for the slice, and where the ground is flat.
      ceiling_m: height above the ground of the lowest underside of what hangs above the altitude, 0 where nothing
        does; None where nothing hangs.
      altitudes_m: heights above ground.
      threshold_m: distance at and above which m is 1.
      scale_m: how much of the height between a receiver and a roof below it counts: 0 for the slice, 1 for the solid.
      run_m2: squared distance of 0 to H cells.
      around: the cells within reach of a cell, over terrain alone.
    """
    halo = len(run_m2) - 1
    region = tuple(slice(halo, size - halo) for size in roof_m.shape)

    def over_terrain(ground_m: Array, altitude_m: Array, above_m: Array, is_there: Array) -> Array:
        """Return the distance, ``[y, x]`` metres, to columns up to ``above_m`` over the ground where they are there."""
        receiver_m = (ground_m + altitude_m)[region]
        top_m = ground_m + above_m
        return kernel.capped_distance_over_terrain(receiver_m, top_m, is_there, around, threshold_m)

    def distance_at(altitude_m: Array) -> Array:
        """Return the distance to what stands and hangs at one altitude, ``[y, x]`` metres, at most the threshold."""
        if terrain_m is not None:
            distance_m = over_terrain(terrain_m, altitude_m, roof_m, roof_m > 0)
            if ceiling_m is None:
                return distance_m
            # What hangs is a column too, with heights turned upside down.
            hanging_m = over_terrain(-terrain_m, -altitude_m, -ceiling_m, ceiling_m > 0)
            return jnp.minimum(distance_m, hanging_m)

        # Over flat ground: the squared vertical distance to each column, from which the kernel adds the horizontal one.
        drop_m2 = kernel.squared_drop(altitude_m - roof_m, scale_m)
        source_m2 = jnp.where(roof_m > 0, drop_m2, jnp.inf)
        if ceiling_m is not None:
            rise_m2 = jnp.where(ceiling_m > 0, (ceiling_m - altitude_m) ** 2, jnp.inf)
            source_m2 = jnp.minimum(source_m2, rise_m2)
        return kernel.capped_distance(source_m2, run_m2, threshold_m)

    return lax.map(distance_at, altitudes_m) * (1 / threshold_m)


def soft_risk(
    surface: Surface,
    altitude_m: Float[Array, ""] | float,
    params: Risk,
    softness_m: Float[Array, ""] | float,
    *,
    cells: Int[Array, "P 2"] | None = None,
    reach_m: float | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return soft m_risk at one altitude, on the region ``[y, x]`` or at chosen cells ``[P]``.

    m = min(1, min over cells with a building of sqrt((d / d_thresh)^2 + (max(0, altitude - roof) / softness)^2)): a
    roof at or above the altitude counts as a full obstacle, and one that lies a softness or more below it does not
    count. At softness 0 this is the exact map of ``distance="slice"``, at softness d_thresh that of
    ``distance="solid"``, which has no softness of its own and ignores ``softness_m``. The map has the type of the
    roofs.

    The map is differentiable in ``surface.roof_m``, ``altitude_m``, ``params.threshold_m`` and ``softness_m`` (and in
    the terrain, under ``solid``), all of which may be traced; batch it by `jax.vmap`. The gradient is that of the
    nearest cell: exact where one cell is nearest, and that of one of them where several tie. It is 0 in roofs above the
    altitude, where m is 0 and where m is 1. Docs: algorithms/gradients.md.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground; with ``cells`` also one for each.
      params: the risk.
      softness_m: how far below the altitude roofs still count; 0 gives the exact map.
      cells: row and column in the region; left out, the whole region.
      reach_m: how far buildings are looked for, never less than the threshold; left out, the threshold. Needed where
        the threshold is traced, as it decides shapes.

    Raises:
      InputError: a negative softness, or a traced threshold without ``reach_m``.
    """
    check_softness(softness_m)
    dtype = surface.roof_m.dtype
    resolution_m = surface.grid.resolution_m
    reach_m = reach_of(params.threshold_m, reach_m, "risk threshold_m")
    halo = rounded_up(kernel.window_cells(reach_m, resolution_m))
    altitude = jnp.asarray(altitude_m, dtype)
    threshold = jnp.asarray(params.threshold_m, dtype)
    softness = jnp.asarray(softness_m, dtype)
    is_solid = params.distance == "solid"
    vertical = threshold if is_solid else softness  # the scale of vertical distances

    # Rasters on the region and its halo; only `solid` measures heights from the terrain.
    roof_m = surface.crop_with_halo(surface.roof_m, halo)
    terrain_m = surface.crop_with_halo(surface.terrain_m, halo) if is_solid else None

    # The whole region over flat ground has a kernel of its own; otherwise cells are searched around one by one.
    if cells is None and terrain_m is None:
        run_m2 = kernel.squared_runs(halo, resolution_m, dtype)
        return kernel.nearest_column(roof_m, altitude, threshold, vertical, run_m2)
    shape = surface.region.shape if cells is None else (len(cells),)
    chosen = jnp.indices(shape).reshape(2, -1).T if cells is None else cells
    heights_m = jnp.broadcast_to(altitude, len(chosen))
    around = kernel.disc(reach_m, resolution_m, dtype)
    m = kernel.nearest_column_at(
        roof_m, terrain_m, heights_m, threshold, vertical, chosen, around, halo=halo
    )
    return m.reshape(shape)


def _map(scene: Scene, params: Risk) -> dict[str, AnyArray]:
    """Return the map of risk at one altitude (`Metric.compute`)."""
    return {"risk": np.asarray(compute_risk(scene.surface, [scene.altitude_m], params))[0]}


def _traced(scene: Scene, params: Risk) -> dict[str, Array]:
    """Return the maps of risk at all altitudes of a traced scene (`Metric.traced`)."""
    return {"risk": jnp.asarray(compute_risk(scene.surface, scene.altitude_m, params))}


METRIC = Metric(
    name="risk",
    params=Risk,
    dims=(ALTITUDE,),
    compute=_map,
    traced=_traced,
    soft=partial(on_scene, soft_risk),
    cost=low_is_bad,
    reach_m=attrgetter("threshold_m"),
    label="Distance to obstacles",
    cost_label="Nearness to obstacles",
    one_means="no obstacle within the threshold",
    colour="#009e73",
    colour_map="inferno",
    recorded={"risk_threshold_m": "threshold_m", "risk_distance": "distance"},
    cell_bytes=64,  # squared distances and what a pass over them holds
)
