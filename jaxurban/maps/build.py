"""build_maps: a city and a sky in, the metric maps of a region out."""

import json
import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import DTypeLike

from jaxurban.errors import GuessWarning, InputError, positive, typed
from jaxurban.io.read.guesses import Guesses, nominal_guess, time_guess, warn_of
from jaxurban.io.read.orbits import look_angles, middle_epoch, read_orbits
from jaxurban.io.read.rasterise import bands_of, building_index
from jaxurban.kernels.engine import Engine, on_device_of
from jaxurban.maps.dataset import empty_dataset, with_series
from jaxurban.maps.differentiable import SoftCity, SoftParams
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.pipeline import MapInputs, inputs_of, skies_of
from jaxurban.maps.recipe import TileScene, tile_maps
from jaxurban.maps.task import PAPER_ALTITUDES_M, MapParams, MapTask
from jaxurban.metrics.custom import Layer, check_layers
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import BlockPopulation
from jaxurban.metrics.registry import checked_sections
from jaxurban.metrics.visibility import SkyView
from jaxurban.progress import Progress, Stage, Stopwatch, reporting
from jaxurban.settings import NOMINAL, Heights
from jaxurban.world.city import SLABS, TO_GROUND, City
from jaxurban.world.grid import Grid
from jaxurban.world.sky import Sky
from jaxurban.world.surface import Surface

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
    **metrics: Any,
) -> MetricMaps:
    """Return the metric maps of a city.

    Args:
      city: from `City.from_files` or `demo_city`.
      bounds: west, south, east, north in degrees; left out, those of the city, else what its buildings cover.
      grid: the region's grid, instead of bounds and resolution.
      resolution_m: side of a cell.
      altitudes_m: flight altitudes above ground.
      oversample: n: occlusion and lidar on a surface n times finer (odd is best).
      heights: how roofs are rasterised, and how well their heights are known.
      layers: cost layers of one's own, by name: rasters, arrays on the cells of the maps, or functions.
      engine: ``"numba"``, on the host; ``"jax"``, where JAX computes; or ``"auto"``: Numba where that is a CPU, else
        JAX. On a CPU the bits are the same.
      progress: as in `jaxurban.progress.reporting`.
      metrics: settings of metrics by name, such as ``gps=Gps(times="2020-04-27T16:00:00Z")``; those made on request
        are made if they are named, as ``protection=Protection()``.

    Warns:
      GuessWarning: of each guess behind the maps (`MetricMaps.guesses`) that reading the city has not warned of.

    Raises:
      InputError: settings that do not fit the city, too few satellites, or too little memory.
    """
    positive("resolution_m", resolution_m, "metres")
    if grid is not None and bounds is not None:
        raise InputError("give either bounds or grid, and not both")
    sections = checked_sections(metrics, build_maps)
    layers = check_layers(layers)
    region = grid if grid is not None else _region(city, bounds, resolution_m)
    params = MapParams(altitudes_m, oversample, heights or Heights(), sections, engine)
    _check_region(city, region, is_own=grid is None and bounds is None)
    sky = view_sky(region, params.gps)
    task = MapTask(city, region, sky, params, layers, bands_of(layers, region, params.altitudes_m))
    check_fits(task)
    with reporting("build_maps", progress) as report:
        return compute_maps(task, stage=Stopwatch(on_stage=report).stage)


def _check_region(city: City, region: Grid, is_own: bool = False) -> None:
    """Raise InputError unless a region is where the city is; the city's own was accepted when that was read."""
    if region.crs != city.crs:
        raise InputError(f"the grid is in {region.crs} and the city in {city.crs}: build the grid in the city's CRS")
    if not (is_own or shapely.intersects(shapely.box(*region.bounds_m), shapely.box(*city.known_extent_m))):
        raise InputError("the region and the city do not meet: check the bounds (west, south, east, north)")


def _region(city: City, bounds: Sequence[float] | None, resolution_m: float) -> Grid:
    bounds = bounds if bounds is not None else city.bounds
    if bounds is not None:
        return Grid.from_bounds(bounds, resolution_m, city.crs)
    first = np.floor(np.asarray(city.extent_m[:2]) / resolution_m + 1e-6).astype(int)
    end = np.ceil(np.asarray(city.extent_m[2:]) / resolution_m - 1e-6).astype(int)
    return Grid(city.crs, resolution_m, int(first[1]), int(first[0]), int(end[1] - first[1]), int(end[0] - first[0]))


def view_sky(region: Grid, gps: Gps) -> Sky:
    """Return the satellites at or above the mask at any time, seen from the reference point or the region's centre.

    Without times, elements from files stand at the middle of their own epochs, the nominal ones at the paper's time.

    Raises:
      InputError: unreadable or stale orbits, or no satellite above the mask at some time.
    """
    times = gps.utc_times
    lon_deg, lat_deg = gps.reference if gps.reference is not None else region.centre_lonlat
    satellites = read_orbits(gps.orbits)
    guesses: Guesses = {}
    is_papers = False
    if times is None and (own_time := middle_epoch(satellites)) is not None:
        times, guesses = (own_time,), time_guess(own_time)
    elif times is None:
        times, is_papers = (PAPER_TIME,), True
    if satellites.of(NOMINAL):
        guesses |= nominal_guess(times, is_papers)
    sky = look_angles(
        satellites,
        times,
        lon_deg,
        lat_deg,
        convergence_rad=region.convergence_rad(lon_deg, lat_deg),
        max_age_days=gps.max_age_days,
    ).under(gps.mask_deg)
    for t in np.flatnonzero(~sky.is_in_view.any(axis=1)):
        raise InputError(
            f"no satellite is above the elevation mask of {gps.mask_deg} degrees at {sky.times[t]}: "
            "lower [gps] mask_deg, choose another time, or check the orbits"
        )
    return replace(sky, guesses=guesses)


def compute_maps(task: MapTask, surface: Surface | None = None, stage: Stage = nullcontext) -> MetricMaps:
    """Return the maps of a task, made in memory as one tile.

    Args:
      task: city, grid, sky and settings.
      surface: the task's, where it is at hand.
      stage: as for `build_maps`.
    """
    tile = TileScene(task, surface or task.surface())
    guesses = task.all_guesses
    warn_of(guesses, known=task.city.guesses)
    ds = empty_dataset(task).assign_attrs(guesses=json.dumps(guesses))
    with on_device_of(task.params.engine):
        for name, place, values in tile_maps(tile, stage):
            ds[name].values[place] = values
    return MetricMaps(ds if task.keeps_times else with_series(ds, task, tile.totals))


@typed
def map_inputs(
    city: City, grid: Grid, *, altitudes_m: Sequence[float] = PAPER_ALTITUDES_M, **metrics: Any
) -> tuple[MapInputs, SkyView]:
    """Return a city and its skies made ready for `all_maps`; the skies of all times are stacked along them.

    Args:
      city: what is mapped.
      grid: of the maps, such as that of maps.
      altitudes_m, metrics: as for `build_maps`.

    Raises:
      InputError: a grid off the city, unreadable or stale orbits, or settings that `all_maps` does not know.
    """
    params = MapParams(altitudes_m, sections=checked_sections(metrics, map_inputs))
    _check_region(city, grid)
    task = MapTask(city, grid, view_sky(grid, params.gps), params)
    inputs = inputs_of(task)
    return inputs, skies_of(task, inputs.surface)


@typed
def soft_city(city: City, grid: Grid, params: SoftParams, *, layers: Mapping[str, Layer] | None = None) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers on the cells of a grid.

    They are float32, or float64 under ``jax.enable_x64(True)``.

    Args:
      city: with outlines.
      grid: of the layers, such as that of maps.
      params: as the maps will have them; of several times and times of day the first ones. Their ranges and
        thresholds, their altitude and the city's highest roof are as far as is looked: parameters may not go beyond.
      layers: cost layers of one's own, by name; those that are functions with a soft form take part.

    Raises:
      InputError: a grid that does not fit the city, a city whose roofs are a height raster, or unreadable or stale
        orbits.
    """
    _check_region(city, grid)
    settings = MapParams((float(params.altitude_m),), sections=params.sections)
    task = MapTask(city, grid, view_sky(grid, settings.gps), settings, check_layers(layers))
    return soften(task, dtype=jax.dtypes.canonicalize_dtype(np.float64))


def soften(
    task: MapTask, *, time_index: int = 0, time_of_day: str | None = None, dtype: DTypeLike = np.float32
) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers (on cells of the region, never supersampled).

    What hangs reaches the ground in them; of a city with slabs that is warned of.

    Args:
      task: a city with outlines, the grid of the layers, the sky, and settings. Their lidar range and d_thresh, their
        lowest altitude and the city's highest roof are as far as is looked: parameters may not go beyond.
      time_index: which of the sky's times.
      time_of_day: of the population; left out, the first of the settings.
      dtype: float32, or float64 under ``jax.enable_x64(True)``.

    Raises:
      InputError: a city whose roofs are a height raster, or no such time.
    """
    if task.city.hanging == SLABS:
        warnings.warn(
            "soft layers know no slabs: in them, and in their gradients, everything that hangs reaches the ground",
            GuessWarning,
            stacklevel=3,
        )
        task = replace(task, city=replace(task.city, hanging=TO_GROUND))
    if not 0 <= time_index < task.num_times:
        raise InputError(f"time_index must be 0 to {task.num_times - 1}, one of the sky's times, got {time_index}")
    city, params, in_view = task.city, task.params, task.in_view(time_index)
    building = building_index(city, task.with_margin(), params.heights.all_touched)
    assert city.buildings is not None
    surface = task.surface()
    terrain_m = None if surface.terrain_m is None else jnp.asarray(surface.terrain_m, dtype)
    surface = replace(surface, roof_m=jnp.asarray(surface.roof_m, dtype), terrain_m=terrain_m)
    return SoftCity(
        surface=surface,
        building=jnp.asarray(building),
        height_m=jnp.asarray(city.buildings.height_m, dtype),
        view=SkyView.of(surface, *in_view.angles, clocks=in_view.clocks),
        population=None if city.blocks is None else BlockPopulation.of(city.blocks, task.region.bounds_m, dtype),
        time_of_day=time_of_day or params.population.times_of_day[0],
        reach_m=tuple((name, float(metric.reach_m(task.settings_of(metric)))) for name, metric in task.metrics.items()),
        own=tuple(task.layers.items()),
    )
