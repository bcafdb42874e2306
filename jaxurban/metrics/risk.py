"""Proximity risk: how far the nearest building is."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxurban.checks import typed
from jaxurban.kernels.distance import nearest as kernel
from jaxurban.kernels.distance.nearest_cpu import distance_on_host
from jaxurban.kernels.engine import Engine, runs_numba
from jaxurban.metrics.base import ALTITUDE, AnyArray, Metric, Scene, low_is_bad, on_scene
from jaxurban.metrics.settings import check_softness, check_value, differentiable, reach_of
from jaxurban.world.surface import Part, Surface, in_type, stands_at


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
      (0.93, 0.98)
    """

    threshold_m: float = 50.0
    distance: Literal["slice", "solid"] = "slice"

    def __post_init__(self) -> None:
        check_value(
            "threshold_m",
            self.threshold_m,
            "a positive number of metres",
            lambda reach_m: reach_m > 0,
        )


def compute_risk(
    surface: Surface,
    altitudes_m: Sequence[float] | jax.Array,
    params: Risk,
    engine: Engine = "auto",
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

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitudes_m: ``[A]`` heights above ground.
      params: the risk.
      engine: which form runs, see `jaxurban.kernels.engine`; to ``"solid"`` over terrain JAX's alone.
    """
    if surface.slabs is not None and len(altitudes_m) > 1:
        return np.concatenate(
            [compute_risk(surface, [z_m], params, engine) for z_m in np.asarray(altitudes_m)]
        )
    surface = (
        surface.at_altitude(float(np.asarray(altitudes_m)[0]))
        if surface.slabs is not None
        else surface
    )
    halo = kernel.window_cells(params.threshold_m, surface.grid.resolution_m)
    is_solid = params.distance == "solid"
    terrain = ceiling = None
    if is_solid and surface.terrain_m is not None:
        terrain = surface.part(surface.terrain_m, halo)
    if is_solid and surface.slabs is not None and len(surface.slabs.row):
        ceiling = surface.part(surface.slabs.lowest_floors(surface.grid), halo)
    sizes = {"resolution_m": surface.grid.resolution_m, "cap_m": params.threshold_m}
    altitudes = in_type(altitudes_m, surface.roof_m.dtype)
    if terrain is None and runs_numba(engine, surface.roof_m, altitudes):
        roof_m = surface.part(np.asarray(surface.roof_m), halo).cut()
        ceiling_m = None if ceiling is None else ceiling.cut()
        sources = (
            _sources(np, roof_m, ceiling_m, altitude_m, is_solid)
            for altitude_m in np.asarray(altitudes)
        )
        nearest = [distance_on_host(source_m2, halo=halo, **sizes) for source_m2 in sources]
        return _share(np.stack(nearest), params.threshold_m)
    roof = surface.part(surface.roof_m, halo)
    return _risk(roof, terrain, ceiling, altitudes, halo=halo, is_solid=is_solid, **sizes)


def _sources(xp: Any, roof_m: Any, ceiling_m: Any, altitude_m: Any, is_solid: bool) -> Any:
    """Return what each cell adds to the squared distance, inf where nothing stands or hangs; ``xp`` is NumPy or JAX."""
    if not is_solid:
        return xp.where(stands_at(roof_m, altitude_m), *roof_m.dtype.type([0, np.inf]))
    source_m2 = xp.where(roof_m > 0, xp.maximum(altitude_m - roof_m, 0.0) ** 2, xp.inf)
    if ceiling_m is None:
        return source_m2
    return xp.minimum(source_m2, xp.where(ceiling_m > 0, (ceiling_m - altitude_m) ** 2, xp.inf))


def _share(distance_m: Any, cap_m: float) -> Any:
    """Return distances as shares of the cap, by a product: XLA makes one of a division, and the bits must agree."""
    one = distance_m.dtype.type(1)
    return distance_m * (one / one.dtype.type(cap_m))


@partial(jax.jit, static_argnames=("resolution_m", "cap_m", "halo", "is_solid"))
def _risk(
    roof: Part,
    terrain: Part | None,
    ceiling: Part | None,
    altitudes_m: jax.Array,
    *,
    resolution_m: float,
    cap_m: float,
    halo: int,
    is_solid: bool,
) -> jax.Array:
    """Return `compute_risk` of roofs (and, for ``"solid"``, terrain) on the region and ``halo`` cells around it.

    A ceiling is the lowest underside of what hangs above the altitude, 0 where nothing does. Over terrain it is as near
    as a roof, with everything upside down.
    """
    roof_m, terrain_m = roof.cut(), None if terrain is None else terrain.cut()
    ceiling_m = None if ceiling is None else ceiling.cut()

    def distance_at(altitude_m: jax.Array) -> jax.Array:
        if terrain_m is not None:
            nearest = partial(
                kernel.capped_distance_over_terrain, resolution_m=resolution_m, cap_m=cap_m
            )
            distance_m = nearest(terrain_m + altitude_m, terrain_m + roof_m, roof_m > 0)
            if ceiling_m is None:
                return distance_m
            under_m = nearest(-terrain_m - altitude_m, -terrain_m - ceiling_m, ceiling_m > 0)
            return jnp.minimum(distance_m, under_m)
        source_m2 = _sources(jnp, roof_m, ceiling_m, altitude_m, is_solid)
        return kernel.capped_distance(source_m2, resolution_m=resolution_m, cap_m=cap_m)

    rows, cols = (slice(halo, size - halo) for size in roof_m.shape)
    return _share(lax.map(distance_at, altitudes_m)[:, rows, cols], cap_m)


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
    roof at or above the altitude counts as the obstacle it is, one that lies the softness below it no more. At softness
    0 it is the slice's exact map, at softness d_thresh that of ``distance="solid"``, which has no softness of its own:
    there ``softness_m`` is not looked at. Computed in the type of the roofs.

    Differentiable in ``surface.roof_m``, ``altitude_m``, ``params.threshold_m`` and ``softness_m`` (and in the terrain,
    under ``solid``), all of which may be traced; batch by `jax.vmap`. The gradient is that of the nearest cell: exact
    where one is nearest, one of them where several tie; 0 in roofs above the altitude, where m is 0 and where it is 1.
    Docs: algorithms/gradients.md.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground; with ``cells`` also one for each.
      params: the risk.
      softness_m: how far below the altitude roofs still count; 0 is exact.
      cells: row and column in the region; left out, the whole region.
      reach_m: how far buildings are looked for, never less than the threshold; left out, the threshold. Needed when
        that is traced.

    Raises:
      InputError: a negative softness, or a traced threshold without ``reach_m``.
    """
    check_softness(softness_m)
    dtype, resolution_m = surface.roof_m.dtype, surface.grid.resolution_m
    reach_m = reach_of(params.threshold_m, reach_m, "risk threshold_m")
    halo = kernel.window_cells(reach_m, resolution_m)
    altitude, threshold, softness = (
        jnp.asarray(v, dtype) for v in (altitude_m, params.threshold_m, softness_m)
    )
    is_solid = params.distance == "solid"
    scales = threshold, threshold if is_solid else softness
    sizes = {"resolution_m": resolution_m, "halo": halo}
    roof_m = surface.crop_with_halo(surface.roof_m, halo)
    terrain_m = None
    if is_solid and surface.terrain_m is not None:
        terrain_m = surface.crop_with_halo(surface.terrain_m, halo)
    if cells is None and terrain_m is None:
        return kernel.nearest_column(roof_m, altitude, *scales, **sizes)
    shape = surface.region.shape if cells is None else (len(cells),)
    chosen = jnp.indices(shape).reshape(2, -1).T if cells is None else cells
    heights_m = jnp.broadcast_to(altitude, len(chosen))
    return kernel.nearest_column_at(roof_m, terrain_m, heights_m, *scales, chosen, **sizes).reshape(
        shape
    )


def _map(scene: Scene, params: Risk) -> dict[str, AnyArray]:
    return {
        "risk": np.asarray(compute_risk(scene.surface, [scene.altitude_m], params, scene.engine))[0]
    }


def _traced(scene: Scene, params: Risk) -> dict[str, Array]:
    return {"risk": jnp.asarray(compute_risk(scene.surface, scene.altitude_m, params, "jax"))}


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
    one_means="no obstacle within the threshold",
    colour="#009e73",
    colour_map="inferno",
    recorded={"risk_threshold_m": "threshold_m", "risk_distance": "distance"},
    cell_bytes=64,  # squared distances and what a pass over them holds
)
