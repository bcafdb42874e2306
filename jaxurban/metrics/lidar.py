"""Lidar visibility: the share of a spinning lidar's scan positions that see a building."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxurban.errors import InputError, typed
from jaxurban.kernels.host import is_on_host
from jaxurban.kernels.lidar import flat as kernel
from jaxurban.kernels.lidar import soft as soft_kernel
from jaxurban.kernels.lidar.flat_cpu import count_on_host
from jaxurban.kernels.lidar.supersampled import count_returns_at_centres, halo_cells, phase_starts, phases
from jaxurban.kernels.lidar.terrain import count_returns_on_terrain
from jaxurban.metrics.base import ALTITUDE, AnyArray, Metric, Scene, in_type, low_is_bad, on_scene
from jaxurban.metrics.obstacle import obstacle_mask, soft_obstacle
from jaxurban.metrics.settings import check_softness, check_value, differentiable, reach_of
from jaxurban.world.surface import Part, Surface

MAX_COUNT = 100_000  # beams, and scan positions: of a mistyped number no table of them is made


@differentiable("range_m")
@typed
@dataclass(frozen=True)
class LidarParams:
    """A puck lidar that turns about the vertical. A pytree whose leaf is the range.

    Attributes:
      beams: beams of a scan position, b.
      field_of_view_deg: elevation of the lowest and of the highest beam above the horizon; the
        beams lie at equal steps between them, a single one in the middle.
      azimuths: scan positions of a turn, k, equally spaced from grid north.
      range_m: slant range along a beam, r.

    Raises:
      InputError: a count below 1 or above 100,000, a field of view out of order or not within -90 to 90 degrees,
        or a range that is not a positive number.
    """

    beams: int = 16
    field_of_view_deg: tuple[float, float] = (-15.0, 15.0)
    azimuths: int = 360
    range_m: float = 100.0

    def __post_init__(self) -> None:
        for name in ("beams", "azimuths"):
            value = getattr(self, name)
            if not (isinstance(value, int) and 1 <= value <= MAX_COUNT):
                raise InputError(f"{name} must be a whole number from 1 to {MAX_COUNT:,}, got {value!r}")
        low, high = self.field_of_view_deg if len(self.field_of_view_deg) == 2 else (1, -1)
        if not -90 < low <= high < 90:
            raise InputError(
                "field_of_view_deg must be the lowest and the highest beam's elevation, ascending and "
                f"within -90 and 90 degrees, such as (-15.0, 15.0), got {self.field_of_view_deg}"
            )
        check_value("range_m", self.range_m, "a positive number of metres", lambda range_m: range_m > 0)

    @property
    def elevations_rad(self) -> np.ndarray:
        """Elevation of each beam above the horizon, ascending, ``[B]``."""
        low, high = np.deg2rad(self.field_of_view_deg)
        return np.linspace(low, high, self.beams) if self.beams > 1 else np.array([(low + high) / 2])


def reach_m(params: LidarParams) -> float:
    """Return how far beyond a cell its metric looks, rounded up to whole cells by the caller."""
    return params.range_m


def compute_lidar(
    surface: Surface, altitudes_m: Sequence[float] | jax.Array, params: LidarParams
) -> Float[Array, "A y x"]:
    """Return m_lidar, the share of scan positions that return, on the region, ``[A, y, x]`` float32 in [0, 1].

    A scan position returns when any of its beams meets a building within range before the ground,
    which is not a landmark. With terrain, receivers and roofs stand on it and it ends beams too.
    0 inside obstacles. What stands more than the range beyond the region changes nothing; beyond the
    surface nothing stands. Paper: section Lidar Visibility, scan(j) and m_lidar = s / k.
    Departures: the ground ends beams, and rays follow the stepping rule of `jaxurban.kernels.lidar.flat`. Slabs with
    their floor at or below the altitude reach the ground, and higher ones are not met: a lidar is trusted with no
    ceiling, and beams that pass under a floor below it are counted as returns. The gradient is zero.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitudes_m: ``[A]`` heights above ground.
      params: the lidar.
    """
    if surface.slabs is not None:
        met = [(replace(surface.at_altitude(float(z_m)), slabs=None), [z_m]) for z_m in np.asarray(altitudes_m)]
        return jnp.concatenate([compute_lidar(at, altitude_m, params) for at, altitude_m in met])
    heights_m = beam_heights(altitudes_m, params, surface)
    return lidar_of_beams(surface, in_type(altitudes_m, surface.roof_m.dtype), heights_m, params)


def beam_heights(altitudes_m: Sequence[float] | ArrayLike, params: LidarParams, surface: Surface) -> np.ndarray:
    """Return the heights that decide each step of a ray, made in float64 on the host.

    ``[A, N]`` over flat ground (`jaxurban.kernels.lidar.flat.flat_thresholds`), ``[A, N, B]`` over terrain
    (`lowest_heights`), rounded up to the type of the roofs.

    Args:
      altitudes_m: ``[A]`` heights above ground.
      params: the lidar.
      surface: whose cells and type of roofs count, and whether there is terrain.
    """
    resolution_m, range_m = surface.grid.resolution_m, params.range_m
    steps = kernel.num_steps(resolution_m, range_m)
    heights_m = kernel.lowest_heights(
        np.asarray(altitudes_m, float), params.elevations_rad, resolution_m, range_m, steps
    )
    if surface.terrain_m is None:
        heights_m = kernel.flat_thresholds(heights_m)
    return kernel.round_up(heights_m, np.dtype(surface.roof_m.dtype))


def lidar_of_beams(
    surface: Surface, altitudes_m: Float[AnyArray, " A"], heights_m: Float[AnyArray, "A N ..."], params: LidarParams
) -> Float[Array, "A y x"]:
    """Return `compute_lidar` of beams made ready by `beam_heights`; surface, altitudes and heights may be traced."""
    steps = heights_m.shape[1]
    offsets = kernel.ray_offsets(params.azimuths, steps)
    if surface.terrain_m is None:
        roof = surface.part(surface.roof_m, steps - 1)
        if not is_on_host(surface.roof_m, altitudes_m, heights_m):
            return _flat_share(roof, altitudes_m, heights_m, offsets)
        counts = count_on_host(roof.cut_on_host()[None], heights_m, phase_starts(offsets, 1), steps - 1)
        own_m = surface.part(surface.roof_m).cut_on_host()
        return _share(counts, own_m, altitudes_m, num_azimuths=params.azimuths)
    roof_m, terrain_m = (surface.crop_with_halo(values, steps - 1) for values in (surface.roof_m, surface.terrain_m))
    starts = phase_starts(offsets, 1)
    returns = count_returns_on_terrain(roof_m[None], terrain_m[None], heights_m, starts, halo=steps - 1)
    return _share(returns, surface.crop(surface.roof_m), altitudes_m, num_azimuths=params.azimuths)


@jax.jit
def _flat_share(roof: Part, altitudes_m: Array, thresholds_m: Array, offsets: Array) -> Array:
    """Return the share of scan positions that return over flat ground, of roofs with their halo."""
    roof_m, halo = roof.cut(), thresholds_m.shape[1] - 1
    returns = kernel.count_returns(roof_m, thresholds_m, offsets)
    rows, cols = (slice(halo, size - halo) for size in roof_m.shape)
    return _share(returns, roof_m[rows, cols], altitudes_m, num_azimuths=len(offsets))


@partial(jax.jit, static_argnames="num_azimuths")
def _share(returns: Array, roof_m: Array, altitudes_m: Array, *, num_azimuths: int) -> Array:
    """Return the share of scan positions that return, 0 inside obstacles."""
    share = returns.astype(roof_m.dtype) / num_azimuths
    return jnp.where(obstacle_mask(roof_m, altitudes_m), 0.0, share)


def lidar_at_centres(
    supersampled: Surface,
    oversample: int,
    is_obstacle: Bool[Array, "A y x"],
    altitudes_m: ArrayLike,
    params: LidarParams,
) -> Float[Array, "A y x"]:
    """Return m_lidar at the map's cells with rays through the supersampled surface: `compute_lidar`, supersampled.

    Args:
      supersampled: from `jaxurban.maps.supersampling.build_supersampled_surface`.
      oversample: n.
      is_obstacle: where nobody flies: m is 0 there.
      altitudes_m: ``[A]`` heights above ground.
      params: the lidar.
    """
    n, resolution_m = oversample, supersampled.grid.resolution_m
    steps = kernel.num_steps(resolution_m, params.range_m)
    halo = halo_cells(steps, n)
    starts = phase_starts(kernel.ray_offsets(params.azimuths, steps), n)
    lowest_m = kernel.lowest_heights(
        np.asarray(altitudes_m, float), params.elevations_rad, resolution_m, params.range_m, steps
    )
    roof_m = phases(supersampled.crop_with_halo(supersampled.roof_m, halo * n), n)
    if supersampled.terrain_m is None:
        thresholds_m = kernel.round_up(kernel.flat_thresholds(lowest_m), roof_m.dtype)
        returns = count_returns_at_centres(roof_m, jnp.asarray(thresholds_m), starts, halo)
    else:
        terrain_m = phases(supersampled.crop_with_halo(supersampled.terrain_m, halo * n), n)
        beams_m = jnp.asarray(kernel.round_up(lowest_m, roof_m.dtype))
        returns = count_returns_on_terrain(
            roof_m, terrain_m, beams_m, starts, halo=halo, receiver_phase=(n // 2) * (n + 1)
        )
    return jnp.where(is_obstacle, 0.0, returns.astype(roof_m.dtype) / params.azimuths)


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
    `jaxurban.kernels.lidar.soft`. At softness 0 it is `compute_lidar`'s map.
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
    steps = kernel.num_steps(resolution_m, reach_of(params.range_m, reach_m, "lidar range_m"))
    offsets = jnp.asarray(kernel.ray_offsets(params.azimuths, steps))
    altitude, range_m, softness = (jnp.asarray(value, dtype) for value in (altitude_m, params.range_m, softness_m))
    roof_m = surface.crop_with_halo(surface.roof_m, steps - 1)
    terrain_m = None if surface.terrain_m is None else surface.crop_with_halo(surface.terrain_m, steps - 1)
    own_roof_m = surface.crop(surface.roof_m)
    if cells is not None:
        own_roof_m = own_roof_m[cells[:, 0], cells[:, 1]]
    if cells is None and terrain_m is None:
        scan = soft_kernel.scan_of(altitude, range_m, params.elevations_rad, resolution_m)
        share = soft_kernel.soft_returns(roof_m, scan, offsets, softness)
    else:
        chosen = jnp.indices(own_roof_m.shape).reshape(2, -1).T if cells is None else cells
        scan = soft_kernel.scan_of(jnp.zeros_like(range_m), range_m, params.elevations_rad, resolution_m)
        heights_m = jnp.broadcast_to(altitude, len(chosen))
        at = soft_kernel.ScansAt(roof_m, terrain_m, heights_m, scan, offsets, softness, chosen)
        share = soft_kernel.soft_returns_at(at)
        share = share.reshape(own_roof_m.shape)
    return (1 - soft_obstacle(own_roof_m, altitude, softness)) * share


def _map(scene: Scene, params: LidarParams) -> dict[str, AnyArray]:
    assert scene.altitude_m is not None
    assert scene.is_obstacle is not None
    if scene.supersampled is None:
        return {"lidar": np.asarray(compute_lidar(scene.surface, [scene.altitude_m], params))[0]}
    altitudes_m = np.array([scene.altitude_m])
    return {
        "lidar": lidar_at_centres(scene.supersampled, scene.oversample, scene.is_obstacle[None], altitudes_m, params)[0]
    }


METRIC = Metric(
    name="lidar",
    params=LidarParams,
    dims=(ALTITUDE,),
    compute=_map,
    soft=partial(on_scene, soft_lidar),
    cost=low_is_bad,
    reach_m=reach_m,
    label="Lidar quality",
    one_means="every scan position returns",
    colour="#e69f00",
    colour_map="plasma",
    cell_bytes=24,  # counts and shares; bitmaps, and a block of terrain
)
