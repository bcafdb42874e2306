"""Soft proximity risk: distance to the nearest obstacle, smooth in roofs, altitude and threshold."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxurban.kernels import soft_distance as kernel
from jaxurban.kernels.distance import window_cells
from jaxurban.metrics.risk import RiskParams
from jaxurban.soft.checks import check_softness, reach_of
from jaxurban.surface import Surface


def soft_risk(
    surface: Surface,
    altitude_m: Float[Array, ""] | float,
    params: RiskParams,
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
    Docs: gradients/risk.md.

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
    halo = window_cells(reach_m, resolution_m)
    altitude, threshold, softness = (jnp.asarray(v, dtype) for v in (altitude_m, params.threshold_m, softness_m))
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
    return kernel.nearest_column_at(roof_m, terrain_m, heights_m, *scales, chosen, **sizes).reshape(shape)
