"""build_maps: a city and a sky in, the metric maps of a region out."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import DTypeLike

from jaxurban.city import City
from jaxurban.detail import RegionDetail
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.orbits import look_angles, read_orbits
from jaxurban.io.rasterise import build_surface, building_index
from jaxurban.layers import (
    PAPER_ALTITUDES_M,
    MapParams,
    Stage,
    empty_dataset,
    make_layers,
    margin_of,
    untimed,
    with_series,
)
from jaxurban.maps import MetricMaps
from jaxurban.memory import check_fits
from jaxurban.metrics.availability import EpochTotals
from jaxurban.metrics.gps import GpsParams, visibility
from jaxurban.metrics.lidar import LidarParams
from jaxurban.metrics.population import BlockLayers, PopulationParams, block_layers
from jaxurban.metrics.risk import RiskParams
from jaxurban.sky import Sky
from jaxurban.soft.engine import SoftCity
from jaxurban.soft.gps import GpsView
from jaxurban.soft.population import People
from jaxurban.surface import Surface
from jaxurban.uncertainty import HeightStd

PAPER_TIME = "2020-04-27T16:00:00Z"


def build_maps(
    city: City,
    bounds: Sequence[float] | None = None,
    *,
    grid: Grid | None = None,
    resolution_m: float = 5.0,
    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M,
    orbits: str | Path | Sequence[str | Path] = "nominal",
    times: Sequence[str] = (PAPER_TIME,),
    mask_deg: float = 5.0,
    reference: tuple[float, float] | None = None,
    max_age_days: float = 90.0,
    gps: GpsParams | None = None,
    lidar: LidarParams | None = None,
    risk: RiskParams | None = None,
    population: PopulationParams | None = None,
    times_of_day: Sequence[str] = ("day", "night"),
    all_touched: bool = False,
    oversample: int = 1,
    gps_bounds: bool = False,
    height_std: HeightStd | None = None,
    height_samples: int = 0,
    height_seed: int = 0,
    stage: Stage = untimed,
) -> MetricMaps:
    """Return the metric maps of a city.

    Args:
      city: from `City.from_files` or `demo_city`.
      bounds: west, south, east, north in degrees; left out, those of the city, else what its buildings cover.
      grid: the region's grid, instead of bounds and resolution.
      resolution_m: side of a cell.
      altitudes_m: flight altitudes above ground.
      orbits: ``"nominal"``, a TLE or OMM file, or several of these (other constellations).
      times: UTC epochs, ISO 8601.
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
      stage: called with each stage's name, gives the context that the stage runs in (timing, progress).

    Raises:
      InputError: settings that do not fit the city, too few satellites, or too little memory.
    """
    if not resolution_m > 0:
        raise InputError(f"resolution_m must be a positive number of metres, got {resolution_m}")
    if grid is not None and bounds is not None:
        raise InputError("give either bounds or grid, and not both")
    region = grid if grid is not None else _region(city, bounds, resolution_m)
    check_altitudes(altitudes_m)
    times, times_of_day = _as_names(times), _as_names(times_of_day)
    if region.crs != city.crs:
        raise InputError(f"the grid is in {region.crs} and the city in {city.crs}: build the grid in the city's CRS")
    is_own = grid is None and bounds is None  # accepted when the city was read
    if not (is_own or shapely.intersects(shapely.box(*region.bounds_m), shapely.box(*city.known_extent_m))):
        raise InputError("the region and the city do not meet: check the bounds (west, south, east, north)")
    if not times or len(set(times)) != len(times):
        raise InputError(f"times must be different UTC times such as 2020-04-27T16:00:00Z, got {list(times)}")
    if not times_of_day or len(set(times_of_day)) != len(times_of_day):
        raise InputError(f"times_of_day must be different names such as day and night, got {list(times_of_day)}")
    if not 0 <= mask_deg < 90:
        raise InputError(f"mask_deg must lie in 0 to 90 degrees, got {mask_deg}")
    sky = view_sky(region, orbits, times, mask_deg=mask_deg, reference=reference, max_age_days=max_age_days)
    params = MapParams(
        altitudes_m=tuple(altitudes_m),
        mask_deg=mask_deg,
        gps=gps or GpsParams(),
        lidar=lidar or LidarParams(),
        risk=risk or RiskParams(),
        population=population or PopulationParams(),
        times_of_day=tuple(times_of_day),
        all_touched=all_touched,
        oversample=oversample,
        gps_bounds=gps_bounds,
        height_std=height_std or HeightStd(),
        height_samples=height_samples,
        height_seed=height_seed,
    )
    check_fits(city, region, sky, params)
    return compute_maps(city, make_surface(city, region, sky, params), sky, params, stage)


def _as_names(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def check_altitudes(altitudes_m: Sequence[float]) -> None:
    """Raise InputError unless the altitudes are finite, above the ground and each named once."""
    values = [float(value) for value in altitudes_m]
    if not values or not all(0 < value < np.inf for value in values) or len(set(values)) != len(values):
        raise InputError(f"altitudes_m must be different positive numbers of metres above ground, got {values}")


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
    times: Sequence[str],
    *,
    mask_deg: float,
    reference: tuple[float, float] | None,
    max_age_days: float,
) -> Sky:
    """Return the satellites at or above the mask at any epoch, seen from the reference point.

    Raises:
      InputError: unreadable or stale orbits, or no satellite above the mask at some epoch.
    """
    lon_deg, lat_deg = reference if reference is not None else region.centre_lonlat
    sky = look_angles(
        read_orbits(orbits),
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
    return sky


def make_surface(city: City, region: Grid, sky: Sky, params: MapParams) -> Surface:
    """Return the city's rasters on the region and the margin that its metrics need."""
    return build_surface(city, region, margin_of(city, region, sky, params), params.all_touched)


def compute_maps(city: City, surface: Surface, sky: Sky, params: MapParams, stage: Stage = untimed) -> MetricMaps:
    """Return the metric maps of a surface under a sky; `build_maps` makes both from a city."""
    people = block_layers_of(city, surface.region, params)

    detail = RegionDetail.wanted(city, surface.region, surface.grid, sky, params)

    def words(epoch: int) -> jax.Array:
        if detail is not None and params.oversample > 1:
            return detail.words(epoch)
        seen = params.satellites_at(sky, epoch)
        return visibility(surface, sky.azimuth_rad[epoch, seen], sky.elevation_rad[epoch, seen], params.altitudes_m)

    ds = empty_dataset(surface.region, sky, params, people, surface.terrain_m is not None, city.attribution)
    totals = EpochTotals.zero(len(sky.times), len(params.altitudes_m))
    for name, index, values in make_layers(surface, sky, params, people, words, totals, stage, detail):
        ds[name].values[index] = values
    return MetricMaps(ds if "gps" in ds else with_series(ds, totals))


def block_layers_of(city: City, region: Grid, params: MapParams) -> BlockLayers | None:
    """Return the population of every block, normalised over a region; None without population data."""
    if city.blocks is None:
        return None
    return block_layers(city.blocks, params.times_of_day, params.population, region.bounds_m)


def soft_city(
    city: City,
    region: Grid,
    sky: Sky,
    params: MapParams,
    *,
    epoch: int = 0,
    time_of_day: str = "day",
    dtype: DTypeLike = np.float32,
) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers (on cells of the region, never oversampled).

    Args:
      city: from `City.from_files` or `demo_city`, with outlines.
      region: the grid of the layers.
      sky: from `view_sky`.
      params: settings of the maps. Their lidar range and d_thresh, their lowest altitude and the city's highest roof
        are as far as is looked: parameters may not go beyond.
      epoch: which of the sky's.
      time_of_day: of the population.
      dtype: float32, or float64 under ``jax.enable_x64(True)``.

    Raises:
      InputError: a city whose roofs are a height raster, or no such epoch.
    """
    if not 0 <= epoch < len(sky.times):
        raise InputError(f"epoch must be 0 to {len(sky.times) - 1}, one of the sky's times, got {epoch}")
    grid = margin_of(city, region, sky, params)
    building = building_index(city, grid, params.all_touched)
    assert city.buildings is not None
    surface = build_surface(city, region, grid, params.all_touched)
    terrain_m = None if surface.terrain_m is None else jnp.asarray(surface.terrain_m, dtype)
    surface = replace(surface, roof_m=jnp.asarray(surface.roof_m, dtype), terrain_m=terrain_m)
    seen = params.satellites_at(sky, epoch)
    return SoftCity(
        surface=surface,
        building=jnp.asarray(building),
        height_m=jnp.asarray(city.buildings.height_m, dtype),
        view=GpsView.of(surface, sky.azimuth_rad[epoch, seen], sky.elevation_rad[epoch, seen]),
        people=None if city.blocks is None else People.of(city.blocks, region.bounds_m, dtype),
        time_of_day=time_of_day,
        lidar_reach_m=float(params.lidar.range_m),
        risk_reach_m=float(params.risk.threshold_m),
    )
