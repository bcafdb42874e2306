"""build_maps: a city and a sky in, the metric maps of a region out."""

import json
import warnings
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import DTypeLike

from jaxurban.errors import GuessWarning, InputError, one_of, typed
from jaxurban.io.layers import bands_of
from jaxurban.io.read.guesses import warn_of
from jaxurban.io.read.orbits import NOMINAL, iso_utc, look_angles, middle_epoch, parse_time, read_orbits
from jaxurban.io.read.rasterise import building_index
from jaxurban.kernels.engine import Engine, on_device_of
from jaxurban.maps.dataset import empty_dataset, with_series
from jaxurban.maps.differentiable import SoftCity, SoftParams
from jaxurban.maps.guesses import Guesses, map_guesses, nominal_guess, time_guess
from jaxurban.maps.height_uncertainty import HeightStd
from jaxurban.maps.memory import check_fits
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.pipeline import MapInputs, inputs_of, skies_of
from jaxurban.maps.recipe import TileScene, tile_maps
from jaxurban.maps.task import PAPER_ALTITUDES_M, MapParams, MapTask
from jaxurban.metrics.custom import Layer, check_layers, check_name
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.lidar import Lidar
from jaxurban.metrics.population import BlockPopulation, Population
from jaxurban.metrics.registry import known_metrics
from jaxurban.metrics.risk import Risk
from jaxurban.metrics.visibility import SkyView
from jaxurban.progress import Progress, Stage, Stopwatch, reporting
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
    orbits: str | Path | Sequence[str | Path] = "nominal",
    times: str | Sequence[str] | None = None,
    mask_deg: float = 5.0,
    reference: tuple[float, float] | None = None,
    max_age_days: float = 90.0,
    gps: Gps | None = None,
    lidar: Lidar | None = None,
    risk: Risk | None = None,
    population: Population | None = None,
    times_of_day: Sequence[str] = ("day", "night"),
    all_touched: bool = False,
    oversample: int = 1,
    gps_bounds: bool = False,
    height_std: HeightStd | None = None,
    height_samples: int = 0,
    height_seed: int = 0,
    layers: Mapping[str, Layer] | None = None,
    others: Mapping[str, Any] | None = None,
    engine: Engine = "auto",
    progress: Progress = True,
) -> MetricMaps:
    """Return the metric maps of a city.

    Args:
      city: from `City.from_files` or `demo_city`.
      bounds: west, south, east, north in degrees; left out, those of the city, else what its buildings cover.
      grid: the region's grid, instead of bounds and resolution.
      resolution_m: side of a cell.
      altitudes_m: flight altitudes above ground.
      orbits: ``"nominal"``, a TLE or OMM file, or several of these (other constellations).
      times: UTC times, ISO 8601; left out, see `view_sky`.
      mask_deg: elevation mask; lower satellites are not used.
      reference: longitude, latitude where look angles are taken; left out, the region's centre.
      max_age_days: older element sets are refused.
      gps, lidar, risk, population: parameters of each metric.
      times_of_day: for population.
      all_touched: let a roof cover every cell it touches.
      oversample: n: occlusion and lidar on a surface n times finer (odd is best).
      gps_bounds: also make ``gps_lower`` and ``gps_upper``, which bracket the true m (n odd).
      height_std: how well heights are known; left out, `HeightStd`'s defaults.
      height_samples: also make the spread of the metrics over this many draws of heights; 0: not.
      height_seed: of the draws.
      layers: cost layers of one's own, by name: rasters, arrays on the cells of the maps, or functions.
      others: parameters of further metrics of the registry, by name; those on request are made if they are named, as
        ``{"protection": Protection()}``.
      engine: ``"numba"``, on the host; ``"jax"``, where JAX computes; or ``"auto"``: Numba where that is a CPU, else
        JAX. On a CPU the bits are the same.
      progress: as in `jaxurban.progress.reporting`.

    Warns:
      GuessWarning: of each guess behind the maps (`MetricMaps.guesses`) that reading the city has not warned of.

    Raises:
      InputError: settings that do not fit the city, too few satellites, or too little memory.
    """
    if not resolution_m > 0:
        raise InputError(f"resolution_m must be a positive number of metres, got {resolution_m}")
    if grid is not None and bounds is not None:
        raise InputError("give either bounds or grid, and not both")
    for name in others or {}:
        one_of("each name in others", name, known_metrics())
    for name in layers or {}:
        check_name(name)
    region = grid if grid is not None else _region(city, bounds, resolution_m)
    times = _checked_times(times)
    params = MapParams(
        altitudes_m=tuple(altitudes_m),
        mask_deg=mask_deg,
        gps=gps or Gps(),
        lidar=lidar or Lidar(),
        risk=risk or Risk(),
        population=population or Population(),
        times_of_day=_as_names(times_of_day),
        all_touched=all_touched,
        oversample=oversample,
        gps_bounds=gps_bounds,
        height_std=height_std or HeightStd(),
        height_samples=height_samples,
        height_seed=height_seed,
        others=others or {},
        engine=engine,
    )
    _check_region(city, region, is_own=grid is None and bounds is None)
    sky = view_sky(region, orbits, times, mask_deg=mask_deg, reference=reference, max_age_days=max_age_days)
    layers = check_layers(layers)
    task = MapTask(city, region, sky, params, layers, bands_of(layers, region, params.altitudes_m))
    check_fits(task)
    with reporting("build_maps", progress) as report:
        return compute_maps(task, stage=Stopwatch(on_stage=report).stage)


def _as_names(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _checked_times(times: str | Sequence[str] | None) -> tuple[str, ...] | None:
    """Return times, which are different; None where none are given."""
    names = None if times is None else _as_names(times)
    if names is not None and (not names or len(set(names)) != len(names)):
        raise InputError(f"times must be different UTC times such as 2020-04-27T16:00:00Z, got {list(names)}")
    return names


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


def view_sky(
    region: Grid,
    orbits: str | Path | Sequence[str | Path],
    times: Sequence[str] | None,
    *,
    mask_deg: float,
    reference: tuple[float, float] | None,
    max_age_days: float,
) -> Sky:
    """Return the satellites at or above the mask at any time, seen from the reference point.

    Without times, elements from files stand at the middle of their own epochs, the nominal ones at the paper's time.

    Raises:
      InputError: unreadable or stale orbits, or no satellite above the mask at some time.
    """
    if times is not None:
        times = [iso_utc(parse_time(time)) for time in times]
    lon_deg, lat_deg = reference if reference is not None else region.centre_lonlat
    satellites = read_orbits(orbits)
    guesses: Guesses = {}
    is_papers = False
    if times is None and (own_time := middle_epoch(satellites)) is not None:
        times, guesses = [own_time], time_guess(own_time)
    elif times is None:
        times, is_papers = [PAPER_TIME], True
    if satellites.of(NOMINAL):
        guesses |= nominal_guess(times, is_papers)
    sky = look_angles(
        satellites,
        times,
        lon_deg,
        lat_deg,
        convergence_rad=region.convergence_rad(lon_deg, lat_deg),
        max_age_days=max_age_days,
    ).above(np.radians(mask_deg))
    num_above = (sky.elevation_rad >= np.radians(mask_deg)).sum(axis=1)
    for time, number in zip(sky.times, num_above, strict=True):
        if number == 0:
            raise InputError(
                f"no satellite is above the elevation mask of {mask_deg} degrees at {time}: "
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
    guesses = map_guesses(task)
    warn_of(guesses, known=task.city.guesses)
    ds = empty_dataset(task).assign_attrs(guesses=json.dumps(guesses))
    with on_device_of(task.params.engine):
        for name, place, values in tile_maps(tile, stage):
            ds[name].values[place] = values
    return MetricMaps(ds if task.keeps_times else with_series(ds, task, tile.totals))


@typed
def map_inputs(
    city: City,
    grid: Grid,
    *,
    orbits: str | Path | Sequence[str | Path] = "nominal",
    times: str | Sequence[str] | None = None,
    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M,
    params: MapParams | None = None,
) -> tuple[MapInputs, SkyView]:
    """Return a city and its skies made ready for `all_maps`; the skies of all times are stacked along them.

    Args:
      city: what is mapped.
      grid: of the maps, such as that of maps.
      orbits, times, altitudes_m: as for `build_maps`.
      params: all other settings; their altitudes are not looked at.

    Raises:
      InputError: a grid off the city, unreadable or stale orbits, or settings that `all_maps` does not know.
    """
    settings = replace(params or MapParams(), altitudes_m=tuple(altitudes_m))
    _check_region(city, grid)
    sky = view_sky(grid, orbits, _checked_times(times), mask_deg=settings.mask_deg, reference=None, max_age_days=90.0)
    task = MapTask(city, grid, sky, settings)
    inputs = inputs_of(task)
    return inputs, skies_of(task, inputs.surface)


@typed
def soft_city(
    city: City,
    grid: Grid,
    params: SoftParams,
    *,
    orbits: str | Path | Sequence[str | Path] = "nominal",
    time: str | None = None,
    mask_deg: float = 5.0,
    time_of_day: str = "day",
    layers: Mapping[str, Layer] | None = None,
) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers on the cells of a grid.

    They are float32, or float64 under ``jax.enable_x64(True)``.

    Args:
      city: with outlines.
      grid: of the layers, such as that of maps.
      params: as the maps will have them. Their ranges and thresholds, their altitude and the city's highest roof are as
        far as is looked: parameters may not go beyond.
      orbits, time, mask_deg: as for `build_maps`, of one time.
      time_of_day: of the population.
      layers: cost layers of one's own, by name; those that are functions with a soft form take part.

    Raises:
      InputError: a grid that does not fit the city, a city whose roofs are a height raster, or unreadable or stale
        orbits.
    """
    _check_region(city, grid)
    times = None if time is None else [time]
    sky = view_sky(grid, orbits, times, mask_deg=mask_deg, reference=None, max_age_days=90.0)
    settings = MapParams(
        altitudes_m=(float(params.altitude_m),),
        mask_deg=mask_deg,
        gps=params.gps,
        lidar=params.lidar,
        risk=params.risk,
        population=params.population,
        times_of_day=(time_of_day,),
        others=params.others,
    )
    dtype = jax.dtypes.canonicalize_dtype(np.float64)
    return soften(MapTask(city, grid, sky, settings, check_layers(layers)), time_of_day=time_of_day, dtype=dtype)


def soften(task: MapTask, *, time_index: int = 0, time_of_day: str = "day", dtype: DTypeLike = np.float32) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers (on cells of the region, never supersampled).

    What hangs reaches the ground in them; of a city with slabs that is warned of.

    Args:
      task: a city with outlines, the grid of the layers, the sky, and settings. Their lidar range and d_thresh, their
        lowest altitude and the city's highest roof are as far as is looked: parameters may not go beyond.
      time_index: which of the sky's times.
      time_of_day: of the population.
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
    city, params = task.city, task.params
    building = building_index(city, task.with_margin(), params.all_touched)
    assert city.buildings is not None
    surface = task.surface()
    terrain_m = None if surface.terrain_m is None else jnp.asarray(surface.terrain_m, dtype)
    surface = replace(surface, roof_m=jnp.asarray(surface.roof_m, dtype), terrain_m=terrain_m)
    return SoftCity(
        surface=surface,
        building=jnp.asarray(building),
        height_m=jnp.asarray(city.buildings.height_m, dtype),
        view=SkyView.of(surface, *task.angles(time_index), clocks=task.clocks(time_index)),
        population=None if city.blocks is None else BlockPopulation.of(city.blocks, task.region.bounds_m, dtype),
        time_of_day=time_of_day,
        reach_m=tuple((name, float(metric.reach_m(task.settings_of(metric)))) for name, metric in task.metrics.items()),
        own=tuple(task.layers.items()),
    )
