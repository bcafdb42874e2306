"""build_maps: a city and a sky in, the metric maps of a region out; and all_maps, the same as one pure function.

`map_inputs` makes ready on the host what a city, a sky and settings say; `all_maps` then computes the maps of one time,
to be jitted, mapped over (`jax.vmap`) and exported. It defines what the maps are: `jaxurban.maps.recipe`, which makes
them layer by layer and on a CPU in threads, gives the same bits outside obstacles (population: but for float32's last
bit). Supersampled maps, spreads, statistics over time and own layers are the recipe's alone.
"""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Array, Float

from jaxurban.checks import positive, typed, values_given
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.read.orbits import look_angles, middle_epoch, read_orbits
from jaxurban.io.read.rasterise import bands_of
from jaxurban.kernels.engine import Engine, on_device_of, warn_of_jax
from jaxurban.knowledge import Guesses, GuessKind, guessed, guesses_to, warn_of
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.params import PAPER_ALTITUDES_M, MapParams
from jaxurban.maps.recipe import tile_maps
from jaxurban.maps.task import MapTask, empty_dataset, with_series
from jaxurban.maps.tile_scene import TileScene
from jaxurban.metrics.base import TIME_OF_DAY, Metric, Scene
from jaxurban.metrics.custom import Layer, check_layers
from jaxurban.metrics.gps import Dop, Gps
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.population import Population, check_has_people
from jaxurban.metrics.protection import Protection
from jaxurban.metrics.registry import ON_REQUEST, known_metrics
from jaxurban.metrics.risk import Risk
from jaxurban.metrics.visibility import SkyView, visible_words
from jaxurban.metrics.weights import Weights, WeightsLike
from jaxurban.progress import Progress, Stage, Stopwatch, reporting
from jaxurban.settings import SLABS, Heights
from jaxurban.world.grid import Grid, covering_grid
from jaxurban.world.sky import Sky
from jaxurban.world.surface import Surface, obstacle_mask

PAPER_TIME = "2020-04-27T16:00:00Z"


@typed
def build_maps(
    city: City,
    bounds: Sequence[float] | None = None,
    *,
    grid: Grid | None = None,
    resolution_m: float = 5.0,
    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M,
    oversample: int = 1,
    heights: Heights | None = None,
    layers: Mapping[str, Layer] | None = None,
    engine: Engine = "auto",
    progress: Progress = True,
    gps: Gps | None = None,
    lidar: Lidar | None = None,
    population: Population | None = None,
    risk: Risk | None = None,
    gps_horizontal: Dop | None = None,
    gps_vertical: Dop | None = None,
    protection: Protection | None = None,
) -> MetricMaps:
    """Return the metric maps of a city.

    Args:
      city: from `City.from_files`, `sample_city` or `demo_city`.
      bounds: west, south, east, north in degrees; left out, those of the city, else what its buildings cover.
      grid: the region's grid, instead of bounds and resolution.
      resolution_m: side of a cell.
      altitudes_m: flight altitudes above ground.
      oversample: n: occlusion and lidar on a surface n times finer (odd is best).
      heights: how roofs are rasterised, and how well their heights are known; left out, as the city's `Buildings` say.
      layers: further cost layers, by name: rasters, arrays on the cells of the maps, or functions.
      engine: ``"jax"``; ``"numba"``, where it has a form, and JAX on the host for the rest; or ``"auto"``: JAX, and
        Numba where its form is the quicker one. On a CPU the bits are the same.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).
      gps, lidar, population, risk: settings of the metrics, such as ``gps=Gps(times="2020-04-27T16:00:00Z")``; ``gps``
        and ``population`` left out are those that the city was read with.
      gps_horizontal, gps_vertical, protection: the same of metrics that are made on request, where they are given.

    Returns:
      The maps, in memory: one variable for each metric, m from 0 to 1, ``[altitude, y, x]`` with the time (``gps``) or
      the time of day (``population``) in front; see `MetricMaps`.

    Warns:
      GuessWarning: of each guess behind the maps (`MetricMaps.guesses`) that reading the city has not warned of.

    Raises:
      InputError: settings that do not fit the city, too few satellites, or too little memory.

    Examples:
      >>> made = ju.build_maps(city, resolution_m=20.0, altitudes_m=(30.0, 60.0), gps=ju.Gps(mask_deg=10.0))
      >>> made.ds["gps"].shape, made.ds["risk"].shape
      ((1, 2, 30, 30), (2, 30, 30))
    """
    positive("resolution_m", resolution_m)
    if grid is not None and bounds is not None:
        raise InputError("give either bounds or grid, and not both")
    layers = check_layers(layers)
    region = grid if grid is not None else region_of(city, bounds, resolution_m)
    sections = _sections(
        city,
        gps=gps,
        lidar=lidar,
        population=population,
        risk=risk,
        gps_horizontal=gps_horizontal,
        gps_vertical=gps_vertical,
        protection=protection,
    )
    heights = heights or city.heights or Heights()
    params = MapParams(altitudes_m, oversample, heights, sections, engine)
    check_region(city, region, is_own=grid is None and bounds is None)
    sky = view_sky(region, params.gps)
    task = MapTask(city, region, sky, params, layers, bands_of(layers, region, params.altitudes_m))
    check_fits(task)
    with reporting("build_maps", progress) as report:
        return compute_maps(task, stage=Stopwatch(on_stage=report).stage)


def _sections(city: City, **metrics: Any) -> dict[str, Any]:
    """Return the settings of metrics by section, without those that are None.

    ``gps`` and ``population`` are those of the city where none are given, if it was read with any.

    Raises:
      InputError: settings of people for a city without any.
    """
    check_has_people(metrics["population"], city.blocks is not None)
    own = {"gps": city.gps, "population": city.population}
    return values_given(own) | values_given(metrics)


def check_region(city: City, region: Grid, is_own: bool = False) -> None:
    """Check that a region can be mapped.

    Args:
      city: what is mapped.
      region: grid of the maps.
      is_own: whether the region is the city's own, which was accepted when the city was read.

    Raises:
      InputError: the region has another CRS than the city, or lies wholly beside it.
    """
    if region.crs != city.crs:
        raise InputError(
            f"the grid is in {region.crs} and the city in {city.crs}: build the grid in the city's CRS"
        )
    box = shapely.box(*region.bounds_m)
    if not is_own and not shapely.intersects(box, shapely.box(*city.known_extent_m)):
        raise InputError(
            "the region and the city do not meet: check the bounds (west, south, east, north)"
        )


def region_of(city: City, bounds: Sequence[float] | None, resolution_m: float) -> Grid:
    """Return the grid of maps of a city, in its CRS.

    Args:
      city: what is mapped.
      bounds: west, south, east, north in degrees; None for the city's own or, where it has none, what its buildings
        cover.
      resolution_m: side of a cell.
    """
    bounds = city.bounds if bounds is None else bounds
    if bounds is not None:
        return Grid.from_bounds(bounds, resolution_m, city.crs)
    return covering_grid(city.extent_m, resolution_m, city.crs)


def view_sky(region: Grid, gps: Gps) -> Sky:
    """Return the sky of a region: the satellites at or above the mask at any time.

    Args:
      region: the sky is seen from its centre, unless the settings name a reference point.
      gps: the settings. Without times, element sets from files are taken at the middle of their own epochs, and the
        nominal constellation at the paper's time.

    Returns:
      The sky, with what was guessed of its time and its satellites.

    Raises:
      InputError: unreadable or stale orbits, or no satellite above the mask at some time.
    """
    satellites = read_orbits(gps.orbits)

    # The times, and what is guessed where the settings name none.
    times = gps.utc_times
    own_time = middle_epoch(satellites) if times is None else None
    is_papers = times is None and own_time is None
    times = times or (own_time or PAPER_TIME,)
    guesses: Guesses = ()
    if own_time is not None:
        guesses += guessed(GuessKind.ELEMENTS_TIME, time=own_time)
    if satellites.nominal_systems:
        more = " and later" if len(times) > 1 else ""
        systems = " and ".join(system.upper() for system in satellites.nominal_systems)
        time = times[0] + (", the paper's time" if is_papers else more)
        guesses += guessed(GuessKind.NOMINAL_SKY, systems=systems, time=time)

    lon_deg, lat_deg = gps.reference or region.centre_lonlat
    sky = look_angles(
        satellites,
        times,
        lon_deg,
        lat_deg,
        convergence_rad=region.convergence_rad(lon_deg, lat_deg),
        max_age_days=gps.max_age_days,
    )
    lost = np.array(sky.names)[np.isnan(sky.elevation_rad).any(axis=0)]
    if lost.size:
        guesses += guessed(GuessKind.WITHOUT_PLACE, satellites=", ".join(lost))
    sky = sky.under(gps.mask_deg)

    num_in_view = sky.is_in_view.sum(axis=1)
    if not num_in_view.all():
        time = sky.times[np.argmin(num_in_view)]
        raise InputError(
            f"no satellite is above the elevation mask of {gps.mask_deg} degrees at {time}: "
            "lower [gps] mask_deg, choose another time, or check the orbits"
        )
    return replace(sky, guesses=guesses)


def compute_maps(
    task: MapTask, surface: Surface | None = None, stage: Stage = nullcontext
) -> MetricMaps:
    """Return the maps of a task, made in memory as one tile, and warn of the guesses behind them.

    Args:
      task: city, grid, sky and settings.
      surface: the task's, where it is made already; left out, it is made here.
      stage: gives the context that the work on each stage runs in.
    """
    tile = TileScene(task, surface or task.surface())
    guesses = task.all_guesses
    warn_of(guesses, known=task.city.guesses)
    warn_of_jax(task.params.engine)
    ds = empty_dataset(task).assign_attrs(guesses=guesses_to(guesses))
    with on_device_of(task.params.engine):
        for name, place, values in tile_maps(tile, stage):
            ds[name].values[place] = values
    base = task.city.sources.get("buildings")
    return MetricMaps(ds if task.keeps_times else with_series(ds, task, tile.totals), base=base)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MapInputs:
    """What the maps of a region depend on besides the sky. ``A`` altitudes; may be traced.

    Attributes:
      surface: roofs, terrain and census blocks on the region and its margin.
      altitudes_m: ``[A]`` above the ground.
      ready: what metrics have made of these on the host, by name (`Metric.ready`): the lidar's beams go with the
        altitudes.
      settings: of the metrics by name; their leaves may be traced.
      fixed: the same of metrics that look beyond a cell: how far decides shapes, so these are plain numbers.
    """

    surface: Surface
    altitudes_m: Float[Array, " A"]
    ready: dict[str, Any]
    settings: dict[str, Any]
    fixed: tuple[tuple[str, Any], ...] = field(metadata={"static": True})

    @property
    def metrics(self) -> dict[str, tuple[Metric, Any]]:
        """The metrics with their settings, by name, in the order of the cost."""
        settings = self.settings | dict(self.fixed)
        return {
            name: (metric, settings[name])
            for name, metric in known_metrics().items()
            if name in settings
        }


def inputs_of(task: MapTask) -> MapInputs:
    """Return a task's surface and settings, made ready for `all_maps`.

    Raises:
      InputError: the task needs what `all_maps` cannot do: slabs, finer cells for rays, bounds, spreads, own layers, or
        a metric on request without a traced form.
    """
    params = task.params
    if task.city.hanging == SLABS:
        raise InputError(
            'the maps as one function know no slabs: read the city with hanging = "to_ground", or make the maps with '
            "build_maps"
        )
    if params.oversample > 1 or params.gps.bounds or params.heights.height_samples or task.layers:
        raise InputError(
            "the maps as one function know no oversample, bounds, height_samples or own layers: leave them out, or "
            "make the maps with build_maps"
        )
    traced = {name: metric for name, metric in task.metrics.items() if metric.traced is not None}
    untraced = [name for name in task.metrics if name in ON_REQUEST and name not in traced]
    if untraced:
        raise InputError(
            f"the maps as one function hold no {' and no '.join(untraced)}: leave it out, or make the maps with "
            "build_maps"
        )

    surface = task.surface().of_jax()
    blocks = task.city.blocks
    ready = {}
    settings = {}
    fixed = {}
    for name, metric in traced.items():
        # Settings that say where data are from get their defaults, as a program would be compiled for each of them.
        default = metric.params()
        unread = {source: getattr(default, source) for source in metric.sources}
        own = replace(task.settings_of(metric), **unread)
        if metric.reach_m(own):
            fixed[name] = own
        else:
            settings[name] = own
        if metric.ready is not None:
            ready[name] = metric.ready(surface, params.altitudes_m, own, blocks)
    altitudes_m = jnp.asarray(params.altitudes_m, surface.roof_m.dtype)
    return MapInputs(surface, altitudes_m, ready, settings, tuple(fixed.items()))


def skies_of(task: MapTask, surface: Surface) -> SkyView:
    """Return the skies of all times of a task over its surface, every field stacked along the times ``[T, ...]``.

    The sky of one time is ``jax.tree.map(lambda values: values[t], views)``; ``jax.vmap(all_maps, (None, 0))`` maps
    over all of them. Times with fewer satellites in view than others get satellites without effect.

    Args:
      task: whose sky and clocks count.
      surface: the task's, from `inputs_of`.
    """
    skies = [task.in_view(t) for t in range(task.num_times)]
    most = max(1, *(len(in_view.numbers) for in_view in skies))  # satellites at a time
    views = [SkyView.of(surface, *in_view.angles, most, in_view.clocks) for in_view in skies]
    return jax.tree.map(lambda *values: jnp.asarray(np.stack(values)), *views)


@typed
def map_inputs(
    city: City,
    grid: Grid,
    *,
    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M,
    gps: Gps | None = None,
    lidar: Lidar | None = None,
    population: Population | None = None,
    risk: Risk | None = None,
    gps_horizontal: Dop | None = None,
    gps_vertical: Dop | None = None,
    protection: Protection | None = None,
) -> tuple[MapInputs, SkyView]:
    """Return a city and its skies made ready for `all_maps`; the skies of all times are stacked along them.

    Args:
      city: what is mapped.
      grid: of the maps, such as that of maps.
      altitudes_m, gps, lidar, population, risk, gps_horizontal, gps_vertical, protection: as for `build_maps`.

    Returns:
      The inputs, a pytree of the city's surface and the settings, and the skies, a pytree whose leaves have the times
      first, ``[T, ...]``.

    Raises:
      InputError: a grid off the city, unreadable or stale orbits, or settings that `all_maps` does not know.

    Examples:
      >>> inputs, skies = ju.grad.map_inputs(city, maps.grid, altitudes_m=(60.0,))
      >>> list(inputs.metrics), skies.num.shape
      (['gps', 'lidar', 'population', 'risk'], (1,))
    """
    sections = _sections(
        city,
        gps=gps,
        lidar=lidar,
        population=population,
        risk=risk,
        gps_horizontal=gps_horizontal,
        gps_vertical=gps_vertical,
        protection=protection,
    )
    params = MapParams(altitudes_m, heights=city.heights or Heights(), sections=sections)
    check_region(city, grid)
    task = MapTask(city, grid, view_sky(grid, params.gps), params)
    inputs = inputs_of(task)
    return inputs, skies_of(task, inputs.surface)


@typed
def all_maps(inputs: MapInputs, sky: SkyView, weights: WeightsLike = None) -> dict[str, Array]:
    """Return every map of a region at one time, by its variable. Pure: jit it, map over it, export it.

    ``jax.vmap`` over any leaf: skies or times, roofs, altitudes with their beams, the GDOP threshold,
    gammas, weights. Gradients are those of the hard maps: of the threshold, the gammas and the weights.

    Args:
      inputs: from `map_inputs`, which gives the skies too.
      sky: of one time.
      weights: give ``cost`` too, the weighted sum of the metrics' costs, ``[A, y, x]`` or, with population,
        ``[A, D, y, x]``: what a step into a cell costs beside its length.

    Returns:
      ``obstacle`` uint8 ``[A, y, x]`` and all maps of each metric with a traced form: ``gps``, its DOPs and
      ``num_visible``, ``lidar`` and ``risk`` ``[A, y, x]``, and with census blocks ``population`` and ``density``
      ``[D, y, x]``. Inside obstacles, where `build_maps` has NaN, they are finite or, as DOPs, inf, so that gradients
      stay finite; NaN where the surface has no data, but integers keep what they are there.

    Raises:
      InputError: skies of several times, or invalid weights.

    Examples:
      >>> import jax
      >>> inputs, skies = ju.grad.map_inputs(city, maps.grid, altitudes_m=(60.0,))
      >>> made = jax.jit(jax.vmap(ju.grad.all_maps, (None, 0)))(inputs, skies)  # all times
      >>> made["gps"].shape, made["population"].shape
      ((1, 1, 30, 30), (1, 2, 30, 30))
    """
    if np.ndim(sky.num):
        raise InputError(
            f"sky must be of one time, got {len(sky.num)}: take jax.vmap(all_maps, (None, 0)), or one by "
            "jax.tree.map(lambda values: values[0], skies)"
        )
    surface = inputs.surface
    altitudes_m = inputs.altitudes_m
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), altitudes_m)
    maps = {"obstacle": is_obstacle.astype(jnp.uint8)}

    # Which satellites each cell sees, none inside obstacles; then the metrics.
    words = jnp.where(is_obstacle, jnp.uint32(0), visible_words(surface, altitudes_m, sky))
    scene = Scene(surface, altitudes_m, words=words, satellites=sky.satellites, engine="jax")
    for name, (metric, settings) in inputs.metrics.items():
        assert metric.traced is not None
        maps |= metric.traced(replace(scene, ready=inputs.ready.get(name)), settings)

    if weights is not None:
        maps["cost"] = _weighted(inputs, maps, Weights.of(weights))
    if surface.has_data is not None:  # after the cost, so that its derivatives stay finite
        has_data = surface.crop(surface.has_data)
        for name, values in maps.items():
            if jnp.issubdtype(values.dtype, jnp.floating):
                maps[name] = jnp.where(has_data, values, jnp.nan)
    return maps


def _weighted(inputs: MapInputs, maps: dict[str, Array], weights: Weights) -> Array:
    """Return the sum of the metrics' costs times their weights, ``[A, y, x]`` or, with times of day, ``[A, D, y, x]``.

    Args:
      inputs: name the metrics.
      maps: of each metric, ``[A, y, x]`` or, with times of day, ``[D, y, x]``.
      weights: by metric.
    """
    metrics = [metric for metric, _ in inputs.metrics.values()]
    has_times = any(TIME_OF_DAY in metric.dims for metric in metrics)
    total = jnp.zeros(())
    for metric in metrics:
        m = maps[metric.name]
        if has_times:  # to the axes [A, D, y, x]
            m = m[None] if TIME_OF_DAY in metric.dims else m[:, None]
        total = total + jnp.asarray(weights[metric.name]) * metric.cost(m)
    return total
