"""Soft lidar visibility: the share of scan positions that meet a building, smooth in roofs, altitude and range."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxurban.kernels import lidar as steps_of
from jaxurban.kernels import soft_lidar as kernel
from jaxurban.metrics.lidar import LidarParams
from jaxurban.soft.checks import check_softness, reach_of
from jaxurban.soft.obstacle import soft_obstacle
from jaxurban.surface import Surface


def soft_lidar(
    surface: Surface,
    altitude_m: Float[Array, ""] | float,
    params: LidarParams,
    softness_m: Float[Array, ""] | float,
    *,
    cells: Int[Array, "P 2"] | None = None,
    reach_m: float | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return soft m_lidar at one altitude, on the region ``[y, x]`` or at chosen cells ``[P]``.

    m = (1 - `soft_obstacle`) x the mean over azimuths of sigmoid(clearance / softness): see
    `jaxurban.kernels.soft_lidar`. At softness 0 it is `compute_lidar`'s map.
    Computed in the type of the roofs. Differentiable in ``surface.roof_m`` (and terrain), ``altitude_m``,
    ``params.range_m`` and ``softness_m``, all of which may be traced; batch by `jax.vmap`. The gradient is 0 in roofs
    where there is no building, and where a roof is not the one that decided a scan position. In the range it is
    spread over a softness around the steps' borders: a softness of about a cell makes it smooth.
    Docs: gradients/lidar.md.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground; with ``cells`` also one for each.
      params: the lidar.
      softness_m: of all margins in metres; 0 is exact.
      cells: row and column in the region; left out, the whole region, which takes seconds and 5 bytes a step for each
        cell over flat ground, and over terrain minutes.
      reach_m: how far rays are followed, never less than the range; left out, the range. Needed when that is traced.

    Raises:
      InputError: a negative softness, or a traced range without ``reach_m``.
    """
    check_softness(softness_m)
    dtype, resolution_m = surface.roof_m.dtype, surface.grid.resolution_m
    steps = steps_of.num_steps(resolution_m, reach_of(params.range_m, reach_m, "lidar range_m"))
    offsets = jnp.asarray(steps_of.ray_offsets(params.num_azimuths, steps))
    altitude, range_m, softness = (jnp.asarray(value, dtype) for value in (altitude_m, params.range_m, softness_m))
    roof_m = surface.crop_with_halo(surface.roof_m, steps - 1)
    terrain_m = None if surface.terrain_m is None else surface.crop_with_halo(surface.terrain_m, steps - 1)
    own_roof_m = surface.crop(surface.roof_m)
    if cells is not None:
        own_roof_m = own_roof_m[cells[:, 0], cells[:, 1]]
    if cells is None and terrain_m is None:
        scan = kernel.scan_of(altitude, range_m, params.elevations_rad, resolution_m)
        share = kernel.soft_returns(roof_m, scan, offsets, softness)
    else:
        chosen = jnp.indices(own_roof_m.shape).reshape(2, -1).T if cells is None else cells
        scan = kernel.scan_of(jnp.zeros_like(range_m), range_m, params.elevations_rad, resolution_m)
        heights_m = jnp.broadcast_to(altitude, len(chosen))
        share = kernel.soft_returns_at(roof_m, terrain_m, heights_m, scan, offsets, softness, chosen)
        share = share.reshape(own_roof_m.shape)
    return (1 - soft_obstacle(own_roof_m, altitude, softness)) * share
