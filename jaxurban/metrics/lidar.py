"""Lidar visibility: the share of a spinning lidar's scan positions that see a building."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from operator import attrgetter
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.kernels.blocks import rounded_up
from jaxurban.kernels.engine import Engine, runs_numba
from jaxurban.kernels.lidar import hard as kernel
from jaxurban.kernels.lidar import soft as soft_kernel
from jaxurban.kernels.lidar.hard import MOST_BEAMS
from jaxurban.metrics.base import ALTITUDE, AnyArray, Metric, Scene, low_is_bad, on_scene
from jaxurban.metrics.settings import (
    check_fields,
    check_softness,
    differentiable,
    is_positive,
    reach_of,
)
from jaxurban.programs import kept_jit
from jaxurban.world.grid import Grid
from jaxurban.world.surface import (
    Cut,
    Surface,
    in_type,
    obstacle_mask,
    obstacles_on,
    over_blocks,
    soft_obstacle,
)

# On a GPU, as compiled for one (benchmarks/cuda_compile.json).
TERRAIN_GPU_BYTES = 400  # of a tile's own cell: the rays over terrain
MOST_BEAMS_OF_A_BYTE = 126  # with more, each ray over terrain takes four bytes
MAX_COUNT = 100_000  # beams, and scan positions: of a mistyped number no table of them is made
STEPS_MULTIPLE = 8  # of a ray: ranges that differ by less share programs


@differentiable("range_m")
@typed
@dataclass(frozen=True)
class Lidar:
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

    Examples:
      >>> lidar = ju.Lidar(beams=3, range_m=50.0)
      >>> np.degrees(lidar.elevations_rad).round().tolist()
      [-15.0, 0.0, 15.0]
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), lidar=lidar)
      >>> bool(np.nanmean(made.m("lidar")) < np.nanmean(maps.m("lidar", 60.0)))  # it sees less
      True
    """

    beams: int = 16
    field_of_view_deg: tuple[float, float] = (-15.0, 15.0)
    azimuths: int = 360
    range_m: float = 100.0

    def __post_init__(self) -> None:
        """Check the settings; errors as of the class."""
        for name in ("beams", "azimuths"):
            value = getattr(self, name)
            if not (isinstance(value, int) and 1 <= value <= MAX_COUNT):
                raise InputError(
                    f"{name} must be a whole number from 1 to {MAX_COUNT:,}, got {value!r}"
                )
        field: Any = self.field_of_view_deg
        lowest, highest = field if len(field) == 2 else (1, -1)  # of another count: not ascending
        if not -90 < lowest <= highest < 90:
            raise InputError(
                "field_of_view_deg must be the lowest and the highest beam's elevation, ascending and "
                f"within -90 and 90 degrees, such as (-15.0, 15.0), got {self.field_of_view_deg}"
            )
        check_fields(self, ["range_m"], "a positive number of metres", is_positive)

    @property
    def elevations_rad(self) -> np.ndarray:
        """Elevation of each beam above the horizon, ascending, ``[B]``."""
        low, high = np.deg2rad(self.field_of_view_deg)
        if self.beams == 1:
            return np.array([(low + high) / 2])
        return np.linspace(low, high, self.beams)


def halo_cells(params: Lidar, resolution_m: float, oversample: int = 1) -> int:
    """Return how many map cells around a region the program for its scans is given.

    They are at least as many as the scans reach, and a multiple of 16, so that similar ranges share programs.

    Args:
      params: the lidar.
      resolution_m: side of a map's cell.
      oversample: n, where rays go through a surface whose cells are n times smaller than the map's.
    """
    reach = kernel.ray_halo_cells(_num_steps(params, resolution_m / oversample), oversample)
    return rounded_up(reach)


def _num_steps(params: Lidar, resolution_m: float) -> int:
    """Return how many steps of a ray the tables hold: those within the range, up to a multiple of `STEPS_MULTIPLE`.

    The last steps may be beyond the range; similar ranges so share programs. ``resolution_m`` is that of the surface.
    """
    return rounded_up(kernel.num_steps(resolution_m, params.range_m), STEPS_MULTIPLE)


def compute_lidar(
    surface: Surface,
    altitudes_m: Sequence[float] | Array,
    params: Lidar,
    engine: Engine = "auto",
    oversample: int = 1,
    is_obstacle: Bool[AnyArray, "A y x"] | None = None,
) -> Float[AnyArray, "A y x"]:
    """Return m_lidar, the share of scan positions that return, on the region, ``[A, y, x]`` float32 in [0, 1].

    A scan position returns when any of its beams meets a building within range before the ground,
    which is not a landmark. With terrain, receivers and roofs stand on it and it ends beams too.
    m is 0 inside obstacles. What stands more than the range beyond the region changes nothing; beyond the
    surface nothing stands. The gradient is zero.

    Paper: section Lidar Visibility, scan(j) and m_lidar = s / k. Departures: the ground ends beams, and rays follow the
    stepping rule of `jaxurban.kernels.lidar.hard`. Slabs with their floor at or below the altitude count as reaching
    the ground, so beams that pass under such a floor return too; rays pass through higher slabs, so a ceiling gives no
    return.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitudes_m: ``[A]`` heights above ground.
      params: the lidar.
      engine: which form counts over terrain, see `jaxurban.kernels.engine`; Numba's is for at most `MOST_BEAMS` beams.
        Over flat ground it is JAX's.
      oversample: n, where the surface is n times finer than the map: receivers stand at the centres of the map's cells,
        and slabs are left out (`Surface.at_altitude`).
      is_obstacle: where nobody flies, and m is 0; left out, where the surface's roofs reach the altitude.
    """
    # With slabs, each altitude has roofs of its own, as a supersampled surface has already.
    if surface.slabs is not None and oversample == 1:
        maps = []
        for z_m in np.asarray(altitudes_m):
            at_altitude = replace(surface.at_altitude(float(z_m)), slabs=None)
            maps.append(compute_lidar(at_altitude, [z_m], params, engine))
        return np.concatenate(maps)
    heights_m = beam_heights(altitudes_m, params, surface)
    altitudes = in_type(altitudes_m, surface.roof_m.dtype)
    return lidar_of_beams(surface, altitudes, heights_m, params, engine, oversample, is_obstacle)


def beam_heights(
    altitudes_m: Sequence[float] | ArrayLike, params: Lidar, surface: Surface
) -> np.ndarray:
    """Return the heights above the ground, in metres, that decide each step of a ray, made in float64 on the host.

    ``[A, N]`` over flat ground (`jaxurban.kernels.lidar.hard.flat_thresholds`), ``[A, N, B]`` over terrain
    (`lowest_heights`), rounded up to the type of the roofs. N is a multiple of 8: the last steps are beyond the range.

    Args:
      altitudes_m: ``[A]`` heights above ground.
      params: the lidar.
      surface: whose cells and type of roofs count, and whether there is terrain.
    """
    resolution_m = surface.grid.resolution_m
    range_m = params.range_m
    steps = _num_steps(params, resolution_m)
    heights_m = kernel.lowest_heights(
        np.asarray(altitudes_m, float), params.elevations_rad, resolution_m, range_m, steps
    )
    if surface.terrain_m is None:
        heights_m = kernel.flat_thresholds(heights_m)
    return kernel.round_up(heights_m, np.dtype(surface.roof_m.dtype))


def lidar_of_beams(
    surface: Surface,
    altitudes_m: Float[AnyArray, " A"],
    heights_m: Float[AnyArray, "A N ..."],
    params: Lidar,
    engine: Engine = "jax",
    oversample: int = 1,
    is_obstacle: Bool[AnyArray, "A y x"] | None = None,
) -> Float[AnyArray, "A y x"]:
    """Return m_lidar as `compute_lidar`, from beams made ready by `beam_heights`.

    Args:
      surface: without slabs; may be traced, as altitudes and heights.
      altitudes_m: heights above ground.
      heights_m: of the beams at each step.
      params: the lidar.
      engine, oversample, is_obstacle: as for `compute_lidar`.
    """
    if _runs_numba(engine, surface, altitudes_m, heights_m):
        if is_obstacle is None:
            is_obstacle = obstacles_on(surface, np.asarray(altitudes_m))
        return _by_numba(surface, heights_m, params, oversample, is_obstacle)
    share = _by_jax(surface, altitudes_m, heights_m, params, oversample)
    if is_obstacle is None:
        if surface.returning_m is None:
            return share
        is_obstacle = obstacle_mask(surface.crop(surface.roof_m), altitudes_m)
    return share * ~is_obstacle


def _runs_numba(engine: Engine, surface: Surface, *values: Any) -> bool:
    """Return whether Numba's form runs, which is for terrain and for at most `MOST_BEAMS` beams.

    Args:
      engine: as for `compute_lidar`.
      surface: roofs, and terrain where there is any.
      *values: further arrays that the form would get, which JAX must not trace; the last are the beams' heights.
    """
    fits = surface.terrain_m is not None and values[-1].shape[-1] <= MOST_BEAMS
    return fits and runs_numba(engine, (surface.roof_m, surface.terrain_m), values)


def _by_numba(
    surface: Surface,
    heights_m: Float[AnyArray, "A N B"],
    params: Lidar,
    oversample: int,
    is_obstacle: Bool[AnyArray, "A y x"],
) -> Float[AnyArray, "A y x"]:
    """Return m_lidar over terrain, from every ``oversample``-th cell of the region both ways; 0 inside obstacles.

    Args:
      surface: with terrain, ``oversample`` times finer than the map.
      heights_m: from `beam_heights`.
      params: the lidar.
      oversample: n.
      is_obstacle: on the map's cells.
    """
    # Imported here: it brings Numba.
    from jaxurban.kernels.lidar.terrain_cpu import count_on_terrain_on_host

    surface = surface.of_returning()
    n = oversample
    steps = kernel.num_steps(surface.grid.resolution_m, params.range_m)
    halo = kernel.ray_halo_cells(steps, n)  # in cells of the map

    def phases(values: AnyArray | None) -> Any:
        """Return a raster with its halo as the kernel takes it: apart by place within a cell of the map."""
        return kernel.phases(surface.part(np.asarray(values), halo * n), n)

    roof_m = phases(surface.roof_m)
    terrain_m = phases(surface.terrain_m)
    starts = _starts(params.azimuths, steps, n, halo)
    beams_m = np.asarray(heights_m)[:, :steps]
    counts = count_on_terrain_on_host(roof_m, terrain_m, beams_m, starts, halo, _receiver_phase(n))
    number = roof_m.dtype.type
    share = counts * (number(1) / number(params.azimuths))  # a product, as XLA makes of a division
    return np.where(is_obstacle, number(0), share)


def _by_jax(
    surface: Surface,
    altitudes_m: Float[AnyArray, " A"],
    heights_m: Float[AnyArray, "A N ..."],
    params: Lidar,
    oversample: int,
) -> Float[AnyArray, "A y x"]:
    """Return m_lidar ``[A, y, x]`` from every ``oversample``-th cell of the region both ways.

    It is 0 inside obstacles where ``oversample`` is 1; otherwise the caller sees to these.

    Args:
      surface: ``oversample`` times finer than the map.
      altitudes_m: ``[A]`` heights above ground, in the type of the roofs.
      heights_m: of the beams at each step, from `beam_heights`.
      params: the lidar.
      oversample: n.
    """
    surface = surface.of_returning()
    resolution_m = surface.grid.resolution_m
    n = oversample
    halo = halo_cells(params, resolution_m * n, n)
    reach = kernel.ray_halo_cells(kernel.num_steps(resolution_m, params.range_m), n)
    starts = _starts(params.azimuths, heights_m.shape[1], n, halo)

    def of_part(cut: Cut) -> Array:
        """Return m_lidar of a part of the region; ``cut`` returns the part of a raster with its halo."""
        roof_m = cut(surface.roof_m)
        terrain_m = None if surface.terrain_m is None else cut(surface.terrain_m)
        return _lidar(roof_m, terrain_m, altitudes_m, heights_m, starts, halo=halo, oversample=n)

    if surface.is_on_host:
        return over_blocks(surface, halo, reach * n, of_part, len(heights_m), n)
    return of_part(lambda values: surface.part(values, halo * n, reach * n))


@lru_cache(maxsize=4)
def _starts(num_azimuths: int, steps: int, oversample: int, halo: int) -> Int[np.ndarray, "K N 3"]:
    """Return where in the phases each step of each ray begins, `jaxurban.kernels.lidar.hard.phase_starts`; read-only.

    Args:
      num_azimuths: K scan positions.
      steps: N steps of a ray.
      oversample: n, of a surface n times finer than the map.
      halo: map cells around the region.
    """
    starts = kernel.phase_starts(kernel.ray_offsets(num_azimuths, steps), oversample, halo)
    starts.flags.writeable = False
    return starts


@partial(kept_jit, static_argnames=("halo", "oversample"))
def _lidar(
    roof_m: Array,
    terrain_m: Array | None,
    altitudes_m: Array,
    heights_m: Array,
    starts: Array,
    *,
    halo: int,
    oversample: int,
) -> Array:
    """Return m_lidar ``[A, y, x]`` of rasters with their halo, by JAX's form for the platform that runs it.

    It is 0 inside obstacles where ``oversample`` is 1.

    Args:
      roof_m: ``[Y, X]`` of the region and its halo.
      terrain_m: the same; None over flat ground.
      altitudes_m: ``[A]`` heights above ground.
      heights_m: from `beam_heights`.
      starts: ``[K, N, 3]`` from `_starts`.
      halo: map cells around the region.
      oversample: n, of rasters n times finer than the map.
    """
    roofs_m = kernel.phases(roof_m, oversample)
    if terrain_m is None:
        counts = kernel.count_returns(roofs_m, heights_m, starts, halo=halo)
    else:
        counts = kernel.count_returns_on_terrain_by_steps(
            roofs_m,
            kernel.phases(terrain_m, oversample),
            heights_m,
            starts,
            halo=halo,
            receiver_phase=_receiver_phase(oversample),
        )
    share = counts.astype(roof_m.dtype) / len(starts)
    if oversample > 1:
        return share
    rows, cols = counts.shape[1:]
    own_m = roof_m[halo : halo + rows, halo : halo + cols]
    return jnp.where(obstacle_mask(own_m, altitudes_m), jnp.zeros_like(share), share)


def _receiver_phase(oversample: int) -> int:
    """Return the number of the phase that holds receivers: row and column ``oversample // 2`` within a map's cell.

    Phases are numbered row by row, ``oversample`` to a row.
    """
    return (oversample // 2) * (oversample + 1)


def soft_lidar(
    surface: Surface,
    altitude_m: Float[Array, ""] | float,
    params: Lidar,
    softness_m: Float[Array, ""] | float,
    *,
    cells: Int[Array, "P 2"] | None = None,
    reach_m: float | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return soft m_lidar at one altitude, on the region ``[y, x]`` or at chosen cells ``[P]``.

    m = (1 - `soft_obstacle`) x the mean over azimuths of sigmoid(clearance / softness): see
    `jaxurban.kernels.lidar.soft`. At softness 0 the map is that of `compute_lidar`. It has the type of the roofs.

    The map is differentiable in ``surface.roof_m`` (and terrain), ``altitude_m``, ``params.range_m`` and
    ``softness_m``, all of which may be traced; batch it by `jax.vmap`. The gradient by a roof is 0 where there is no
    building, and where another roof decided each scan position. The gradient by the range is spread over a softness
    around the borders of the rays' steps: a softness of about a cell makes it smooth.
    Docs: algorithms/gradients.md.

    Args:
      surface: roofs, and terrain where there is any, on the region and its margin.
      altitude_m: height above ground; with ``cells`` also one for each.
      params: the lidar.
      softness_m: scale of all margins, metres; 0 gives the exact map.
      cells: row and column in the region; left out, the whole region. It takes seconds, and 5 bytes for each cell and
        step of a ray, over flat ground, and minutes over terrain.
      reach_m: how far rays are followed, never less than the range; left out, the range. Needed where the range is
        traced, as it decides shapes.

    Raises:
      InputError: a negative softness, or a traced range without ``reach_m``.
    """
    check_softness(softness_m)
    dtype = surface.roof_m.dtype
    resolution_m = surface.grid.resolution_m
    reach_m = reach_of(params.range_m, reach_m, "lidar range_m")
    steps = kernel.num_steps(resolution_m, reach_m)
    offsets = jnp.asarray(kernel.ray_offsets(params.azimuths, steps))
    altitude = jnp.asarray(altitude_m, dtype)
    range_m = jnp.asarray(params.range_m, dtype)
    softness = jnp.asarray(softness_m, dtype)

    # Rasters with all that rays can reach, and the roofs of the receivers' own cells.
    roof_m = surface.crop_with_halo(surface.of_returning().roof_m, steps - 1)
    terrain_m = surface.crop_with_halo(surface.terrain_m, steps - 1)
    own_roof_m = surface.crop(surface.roof_m)
    if cells is not None:
        own_roof_m = own_roof_m[cells[:, 0], cells[:, 1]]

    # The whole region over flat ground has a kernel of its own; otherwise cells are scanned one by one, for which the
    # heights of beams count from the receiver and not from the ground.
    if cells is None and terrain_m is None:
        scan = soft_kernel.scan_of(altitude, range_m, params.elevations_rad, resolution_m)
        share = soft_kernel.soft_returns(roof_m, scan, offsets, softness)
    else:
        chosen = jnp.indices(own_roof_m.shape).reshape(2, -1).T if cells is None else cells
        scan = soft_kernel.scan_of(
            jnp.zeros_like(range_m), range_m, params.elevations_rad, resolution_m
        )
        heights_m = jnp.broadcast_to(altitude, len(chosen))
        scans = soft_kernel.ScansAt(roof_m, terrain_m, heights_m, scan, offsets, softness, chosen)
        share = soft_kernel.soft_returns_at(scans).reshape(own_roof_m.shape)
    return (1 - soft_obstacle(own_roof_m, altitude, softness)) * share


def _map(scene: Scene, params: Lidar) -> dict[str, AnyArray]:
    """Return the lidar's map at one altitude (`Metric.compute`), by rays through the finer surface if there is one."""
    arguments = [scene.altitude_m], params, scene.engine
    if scene.supersampled is None:
        maps = compute_lidar(scene.surface, *arguments)
    else:
        is_obstacle = scene.is_obstacle[None]
        maps = compute_lidar(scene.supersampled, *arguments, scene.oversample, is_obstacle)
    return {"lidar": np.asarray(maps)[0]}


def _ready(surface: Surface, altitudes_m: Sequence[float], params: Lidar, *_: Any) -> Array:
    """Return the heights of beams (`Metric.ready`)."""
    return jnp.asarray(beam_heights(altitudes_m, params, surface))


def _traced(scene: Scene, params: Lidar) -> dict[str, Array]:
    """Return the maps of all altitudes, of arrays that JAX may trace (`Metric.traced`)."""
    m = lidar_of_beams(scene.surface, scene.altitude_m, scene.ready, params)
    return {"lidar": jnp.asarray(m)}


def _terrain_bytes(params: Lidar, tile: Grid) -> float:
    """Return about how many bytes JAX's form over terrain takes beside the maps of a tile (`Metric.terrain_bytes`)."""
    ray_bytes = 1 if params.beams <= MOST_BEAMS_OF_A_BYTE else 4
    return TERRAIN_GPU_BYTES * ray_bytes * tile.num_rows * tile.num_cols


METRIC = Metric(
    name="lidar",
    params=Lidar,
    dims=(ALTITUDE,),
    compute=_map,
    traced=_traced,
    ready=_ready,
    soft=partial(on_scene, soft_lidar),
    cost=low_is_bad,
    reach_m=attrgetter("range_m"),
    label="Lidar quality",
    cost_label="Poor lidar",
    one_means="every scan position returns",
    colour="#e69f00",
    colour_map="plasma",
    is_numba_over_terrain=lambda lidar: lidar.beams <= MOST_BEAMS,
    terrain_bytes=_terrain_bytes,
    cell_bytes=40,  # counts and shares; what has returned, and bitmaps; a block of terrain
)
