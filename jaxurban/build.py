"""build_maps: a city and a sky in, the metric maps of a region out."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pyproj
import xarray as xr

from jaxurban.city import City
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.orbits import look_angles, read_orbits
from jaxurban.io.rasterise import build_surface, highest_top_m, surface_grid
from jaxurban.maps import MetricMaps
from jaxurban.metrics import lidar as lidar_metric
from jaxurban.metrics import risk as risk_metric
from jaxurban.metrics.gps import GpsParams, compute_gps, gps_of_words, shadow_reach_m
from jaxurban.metrics.lidar import LidarParams, compute_lidar
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.population import PopulationParams, population_maps
from jaxurban.metrics.risk import RiskParams, compute_risk
from jaxurban.oversample import (
    build_fine_surface,
    compute_gps_bounds,
    lidar_at_centres,
    plain_bands,
    visibility_at_centres,
)
from jaxurban.sky import Sky
from jaxurban.surface import Surface
from jaxurban.uncertainty import HeightStd, metric_spread

PAPER_ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
PAPER_TIME = "2020-04-27T16:00:00Z"
DOP_VARIABLES = ("gdop", "pdop", "hdop", "vdop", "tdop", "num_visible")
UNITS = {  # units and what a value of one means, by variable
    "obstacle": ("1", "a roof reaches this altitude"),
    "gps": ("1", "GDOP of 1, the best possible"),
    "lidar": ("1", "every scan position returns"),
    "population": ("1", "as many people per area as the norm (pop_norm_per_km2)"),
    "risk": ("1", "no obstacle within the threshold"),
    "gdop": ("1", ""),
    "pdop": ("1", ""),
    "hdop": ("1", ""),
    "vdop": ("1", ""),
    "tdop": ("1", ""),
    "num_visible": ("1", ""),
    "density": ("km-2", ""),
    "roof": ("m", ""),
    "terrain": ("m", ""),
}

Stage = Callable[[str], AbstractContextManager[None]]


def untimed(name: str) -> AbstractContextManager[None]:
    """Return a context that does nothing with the stage it is told."""
    return nullcontext()


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
      bounds: west, south, east, north in degrees; left out, what the buildings cover.
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
      InputError: settings that do not fit the city, or too few satellites.
    """
    region = grid if grid is not None else _region(city, bounds, resolution_m)
    sky = view_sky(region, orbits, times, mask_deg=mask_deg, reference=reference, max_age_days=max_age_days)
    surface = make_surface(
        city, region, sky, altitudes_m, mask_deg=mask_deg, lidar=lidar, risk=risk, all_touched=all_touched
    )
    return compute_maps(
        city,
        surface,
        sky,
        altitudes_m,
        mask_deg=mask_deg,
        gps=gps,
        lidar=lidar,
        risk=risk,
        population=population,
        times_of_day=times_of_day,
        all_touched=all_touched,
        oversample=oversample,
        gps_bounds=gps_bounds,
        height_std=height_std,
        height_samples=height_samples,
        height_seed=height_seed,
        stage=stage,
    )


def _region(city: City, bounds: Sequence[float] | None, resolution_m: float) -> Grid:
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


def make_surface(
    city: City,
    region: Grid,
    sky: Sky,
    altitudes_m: Sequence[float],
    *,
    mask_deg: float,
    lidar: LidarParams | None = None,
    risk: RiskParams | None = None,
    all_touched: bool = False,
) -> Surface:
    """Return the city's rasters on the region and the margin that its metrics need."""
    above = sky.elevation_rad >= np.radians(mask_deg)
    toward_m = shadow_reach_m(
        sky.azimuth_rad[above],
        sky.elevation_rad[above],
        highest_top_m(city),
        float(min(altitudes_m)),
        region.resolution_m,
    )
    always_m = max(lidar_metric.reach_m(lidar or LidarParams()), risk_metric.reach_m(risk or RiskParams()))
    return build_surface(city, region, surface_grid(city, region, always_m, toward_m), all_touched)


def compute_maps(
    city: City,
    surface: Surface,
    sky: Sky,
    altitudes_m: Sequence[float],
    *,
    mask_deg: float = 5.0,
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
    """Return the metric maps of a surface under a sky; `build_maps` makes both from a city."""
    region = surface.region
    z_m = jnp.asarray(altitudes_m, jnp.float32)
    has_data = np.ones(region.shape, bool) if surface.has_data is None else np.asarray(surface.crop(surface.has_data))
    data: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    flown = ("altitude", "y", "x")

    roof_m = surface.crop(surface.roof_m)
    with stage("obstacle"):
        is_obstacle = obstacle_mask(roof_m, z_m)
        data["obstacle"] = (flown, np.asarray(is_obstacle).astype(np.uint8))
    if oversample > 1:
        with stage("surface"):
            fine = build_fine_surface(city, region, surface.grid, oversample, all_touched)
    with stage("gps"):
        bands = plain_bands(fine, oversample) if oversample > 1 else None
        epochs = []
        for azimuth_rad, elevation_rad in epochs_above(sky, mask_deg):
            if bands is None:
                epochs.append(compute_gps(surface, azimuth_rad, elevation_rad, z_m, gps))
            else:
                words = visibility_at_centres(bands, azimuth_rad, elevation_rad, z_m)
                epochs.append(gps_of_words(words, is_obstacle, azimuth_rad, elevation_rad, gps))
        for name, field in (("gps", "m"), *((name, name) for name in DOP_VARIABLES)):
            data[name] = (("time", *flown), np.stack([np.asarray(getattr(maps, field)) for maps in epochs]))
    if gps_bounds:
        with stage("gps_bounds"):
            bounds = compute_gps_bounds(
                city, region, surface.grid, oversample, is_obstacle, epochs_above(sky, mask_deg), z_m, gps
            )
            data |= {name: (("time", *flown), values) for name, values in bounds.items()}
    with stage("lidar"):
        params = lidar or LidarParams()
        if oversample > 1:
            scanned = lidar_at_centres(fine, oversample, is_obstacle, z_m, params)
        else:
            scanned = compute_lidar(surface, z_m, params)
        data["lidar"] = (flown, np.asarray(scanned))
    with stage("risk"):
        data["risk"] = (flown, np.asarray(compute_risk(surface, z_m, risk or RiskParams())))
    attrs: dict[str, object] = {}
    if city.blocks is not None and surface.block is not None:
        with stage("population"):
            people = population_maps(surface.block, city.blocks, times_of_day, population, region.bounds_m)
            data["population"] = (("time_of_day", "y", "x"), np.asarray(people.m))
            data["density"] = (("time_of_day", "y", "x"), np.asarray(people.density_per_km2))
        attrs["pop_norm_per_km2"] = [float(value) for value in people.norm_per_km2]
    if height_samples:
        with stage("height_spread"):
            spread = metric_spread(
                city,
                region,
                sky,
                altitudes_m,
                height_std=height_std,
                mask_deg=mask_deg,
                gps=gps,
                lidar=lidar,
                risk=risk,
                all_touched=all_touched,
                oversample=oversample,
                num_samples=height_samples,
                seed=height_seed,
            )
            data |= {str(name): (tuple(map(str, array.dims)), array.values) for name, array in spread.items()}
    data["roof"] = (("y", "x"), np.asarray(roof_m))
    if surface.terrain_m is not None:
        data["terrain"] = (("y", "x"), np.asarray(surface.crop(surface.terrain_m)))
    data = {name: (dims, _without_data(name, values, has_data)) for name, (dims, values) in data.items()}
    data["has_data"] = (("y", "x"), has_data)
    ds = xr.Dataset(
        data,
        coords={
            "y": ("y", region.y_m, {"units": "m", "standard_name": "projection_y_coordinate"}),
            "x": ("x", region.x_m, {"units": "m", "standard_name": "projection_x_coordinate"}),
            "altitude": ("altitude", np.asarray(altitudes_m, float), {"units": "m", "long_name": "above ground"}),
            "time": ("time", np.array([time.removesuffix("Z") for time in sky.times], "datetime64[ns]")),
            "spatial_ref": ((), 0, pyproj.CRS(region.crs).to_cf()),
            **(
                {"time_of_day": ("time_of_day", np.asarray(times_of_day, np.dtypes.StringDType()))}
                if "population" in data
                else {}
            ),
        },
        attrs={
            "crs": region.crs,
            "resolution_m": region.resolution_m,
            "first_row": region.first_row,
            "first_col": region.first_col,
            "satellites": list(sky.names),
            **({"attribution": city.attribution} if city.attribution else {}),
            **attrs,
        },
    )
    for variable in ds.data_vars:
        if variable != "has_data":
            units, one_means = UNITS.get(str(variable), ("1", ""))
            ds[variable].attrs.update(
                {"units": units, "grid_mapping": "spatial_ref", **({"one_means": one_means} if one_means else {})}
            )
    return MetricMaps(ds)


def epochs_above(sky: Sky, mask_deg: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return azimuths and elevations of the satellites at or above the mask, by epoch."""
    above = sky.elevation_rad >= np.radians(mask_deg)
    return [(a[up], e[up]) for a, e, up in zip(sky.azimuth_rad, sky.elevation_rad, above, strict=True)]


def _without_data(name: str, values: np.ndarray, has_data: np.ndarray) -> np.ndarray:
    """Return ``values`` with NaN where nothing is known (integers keep 0)."""
    if has_data.all() or not np.issubdtype(values.dtype, np.floating):
        return values
    return np.where(has_data, values, np.nan).astype(values.dtype)
