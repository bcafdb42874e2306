"""Height uncertainty: how much the metric maps spread when building heights are drawn as well as they are known.

Every sample draws one error for each building (never one for each cell: a roof moves as a whole), rasterises the city
anew and makes its maps. Errors are normal, independent between buildings, with a standard deviation by where the
height came from; heights never fall below 0.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import jax.numpy as jnp
import numpy as np
import scipy.ndimage
import xarray as xr

from jaxurban.city import City, HeightOrigin
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.rasterise import build_surface, highest_top_m, surface_grid
from jaxurban.metrics import lidar as lidar_metric
from jaxurban.metrics import risk as risk_metric
from jaxurban.metrics.gps import GpsParams, compute_gps, gps_of_words, shadow_reach_m
from jaxurban.metrics.lidar import LidarParams, compute_lidar
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.risk import RiskParams, compute_risk
from jaxurban.oversample import build_fine_surface, lidar_at_centres, plain_bands, visibility_at_centres
from jaxurban.sky import Sky

SPREAD = ("mean", "std", "p05", "p95")  # what is kept of each metric
TAIL = 0.05  # the percentiles reported are the 5th and the 95th


@dataclass(frozen=True)
class HeightStd:
    """Standard deviation of a building's height by its origin, metres; 0: known exactly.

    The defaults are rules of thumb for low and middle heights; give your source's own where it states them. Among OSM
    buildings that carry both, height minus 3 m x levels varies by 4.5 m (robust; mean +6.6 m) in Lower Manhattan, by
    7.4 m (+3.2 m) up to 8 levels there and by 5.6 m (+4.8 m) in Boston, most of it from towers and from counts that
    leave parts out. Offsets are no matter of this class: change ``level_height_m`` and ``default_height_m`` instead.

    Attributes:
      height: a tag or column: values are rounded to a metre and leave open whether a parapet or a machine room counts.
      levels: number of levels x level height: a storey more or less (ground floors and roofs differ).
      default: nothing known but that a building stands: half the default height of 10 m; more among towers.
      raster: a height raster, where a component of touching pixels above 0 counts as one building.

    Raises:
      InputError: a value that is negative or not finite.
    """

    height: float = 1.0
    levels: float = 3.0
    default: float = 5.0
    raster: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"height_std_m {item.name} must be a number of metres >= 0, got {value}")

    def of(self, origin: np.ndarray) -> np.ndarray:
        """Return the standard deviation of buildings by their `HeightOrigin`, 0 for generated ones."""
        by_origin = {item.name: getattr(self, item.name) for item in fields(self)}
        return np.array([by_origin.get(o.name.lower(), 0.0) for o in HeightOrigin])[origin]


def perturbed_cities(city: City, height_std: HeightStd, num_samples: int, seed: int) -> Iterator[City]:
    """Yield the city with heights drawn anew, once a sample; the same seed gives the same cities."""
    if city.roofs is not None:
        labels, num_buildings = scipy.ndimage.label(np.nan_to_num(city.roofs.values) > 0, structure=np.ones((3, 3)))
    for sample in range(num_samples):
        rng = np.random.default_rng([seed, sample])
        if city.buildings is not None:
            errors_m = rng.standard_normal(len(city.buildings)) * height_std.of(city.buildings.origin)
            height_m = np.maximum(city.buildings.height_m + errors_m, 0.0)
            yield replace(city, buildings=replace(city.buildings, height_m=height_m))
        else:
            assert city.roofs is not None
            errors_m = np.append(0.0, rng.standard_normal(num_buildings) * height_std.raster)[labels]
            values = np.where(labels > 0, np.maximum(city.roofs.values + errors_m, 0.0), city.roofs.values)
            yield replace(city, roofs=replace(city.roofs, values=values.astype(np.float32)))


class Spread:
    """Mean, standard deviation and the two tail percentiles of arrays that come one by one.

    Mean and deviation after Welford (1962). For the percentiles only the lowest and the highest few arrays are kept:
    of 32 samples three each.
    """

    def __init__(self, num_samples: int):
        self.num_samples, self.count = num_samples, 0
        position = TAIL * (num_samples - 1)
        self.below = math.floor(position)
        self.share = position - self.below
        self.kept = min(self.below + 2, num_samples)

    def add(self, values: np.ndarray) -> None:
        """Take in one more array, of the shape of all others."""
        values = np.asarray(values, np.float32)
        if self.count == 0:
            self.mean, self.squares = np.zeros_like(values), np.zeros_like(values)
            self.lowest = self.highest = np.empty((0, *values.shape), np.float32)
        self.count += 1
        from_old = values - self.mean
        self.mean += from_old / self.count
        self.squares += from_old * (values - self.mean)
        self.lowest = np.sort(np.concatenate([self.lowest, values[None]]), axis=0)[: self.kept]
        self.highest = np.sort(np.concatenate([self.highest, values[None]]), axis=0)[-self.kept :]

    def results(self) -> dict[str, np.ndarray]:
        """Return ``mean``, ``std`` (of the sample, n - 1), ``p05`` and ``p95`` (linear between samples)."""
        last = self.kept - 1
        low, low_next = self.lowest[self.below], self.lowest[min(self.below + 1, last)]
        high, high_next = self.highest[last - self.below], self.highest[max(last - self.below - 1, 0)]
        return {
            "mean": self.mean,
            "std": np.sqrt(self.squares / max(self.count - 1, 1)),
            "p05": low + self.share * (low_next - low),
            "p95": high + self.share * (high_next - high),
        }


def metric_spread(
    city: City,
    region: Grid,
    sky: Sky,
    altitudes_m: Sequence[float],
    *,
    height_std: HeightStd | None = None,
    mask_deg: float = 5.0,
    gps: GpsParams | None = None,
    lidar: LidarParams | None = None,
    risk: RiskParams | None = None,
    all_touched: bool = False,
    oversample: int = 1,
    num_samples: int = 32,
    seed: int = 0,
) -> xr.Dataset:
    """Return the spread of the metrics over cities whose building heights are drawn.

    Variables: ``{gps, lidar, risk}_{mean, std, p05, p95}`` with the dimensions of the metric's own map, and
    ``obstacle_share`` [altitude, y, x], the share of samples with an obstacle; in those m is 0. Time and memory:
    those of the plain maps ``num_samples`` times, and about ten arrays of a metric's size.

    Args:
      city: outlines or a height raster.
      region: the grid of the maps, or a tile of it: a tile's spread is the crop of the whole's.
      sky: satellites, from `jaxurban.build.view_sky`.
      altitudes_m: ``[A]`` above ground.
      height_std: standard deviation by origin of height.
      mask_deg: lower satellites are left out.
      gps, lidar, risk: parameters of each metric.
      all_touched, oversample: as for `jaxurban.build.build_maps`.
      num_samples: at least 2; 5th and 95th percentiles of fewer than 20 are close to the extremes.
      seed: of the draws.

    Raises:
      InputError: fewer than two samples.
    """
    if num_samples < 2:
        raise InputError(f"num_samples must be at least 2 for a spread, got {num_samples}")
    height_std = height_std or HeightStd()
    gps, lidar, risk = gps or GpsParams(), lidar or LidarParams(), risk or RiskParams()
    above = sky.elevation_rad >= np.radians(mask_deg)
    highest_m = max(highest_top_m(sample) for sample in perturbed_cities(city, height_std, num_samples, seed))
    toward_m = shadow_reach_m(
        sky.azimuth_rad[above], sky.elevation_rad[above], highest_m, float(min(altitudes_m)), region.resolution_m
    )
    always_m = max(lidar_metric.reach_m(lidar), risk_metric.reach_m(risk))
    grid = surface_grid(city, region, always_m, toward_m)
    bare = replace(city, blocks=None)
    spreads = {name: Spread(num_samples) for name in ("gps", "lidar", "risk", "obstacle")}
    for sample in perturbed_cities(bare, height_std, num_samples, seed):
        maps = _maps_of(sample, region, grid, sky, above, altitudes_m, gps, lidar, risk, all_touched, oversample)
        for name, spread in spreads.items():
            spread.add(maps[name])
    return _dataset(spreads, region, sky, altitudes_m)


def _maps_of(
    city: City,
    region: Grid,
    grid: Grid,
    sky: Sky,
    above: np.ndarray,
    altitudes_m: Sequence[float],
    gps: GpsParams,
    lidar: LidarParams,
    risk: RiskParams,
    all_touched: bool,
    oversample: int,
) -> dict[str, np.ndarray]:
    """Return the maps of one sample; GPS with a leading axis of epochs."""
    surface = build_surface(city, region, grid, all_touched)
    z_m = jnp.asarray(altitudes_m, jnp.float32)
    is_obstacle = obstacle_mask(surface.crop(surface.roof_m), z_m)
    epochs = [(a[up], e[up]) for a, e, up in zip(sky.azimuth_rad, sky.elevation_rad, above, strict=True)]
    if oversample == 1:
        seen = [compute_gps(surface, *angles, z_m, gps).m for angles in epochs]
        scanned = compute_lidar(surface, z_m, lidar)
    else:
        fine = build_fine_surface(city, region, grid, oversample, all_touched)
        bands = plain_bands(fine, oversample)
        words = (visibility_at_centres(bands, *angles, z_m) for angles in epochs)
        seen = [gps_of_words(w, is_obstacle, *angles, gps).m for w, angles in zip(words, epochs, strict=True)]
        scanned = lidar_at_centres(fine, oversample, is_obstacle, z_m, lidar)
    return {
        "gps": np.stack([np.asarray(m) for m in seen]),
        "lidar": np.asarray(scanned),
        "risk": np.asarray(compute_risk(surface, z_m, risk)),
        "obstacle": np.asarray(is_obstacle),
    }


def _dataset(spreads: Mapping[str, Spread], region: Grid, sky: Sky, altitudes_m: Sequence[float]) -> xr.Dataset:
    flown = ("altitude", "y", "x")
    data = {
        f"{name}_{what}": (("time", *flown) if name == "gps" else flown, values)
        for name, spread in spreads.items()
        if name != "obstacle"
        for what, values in spread.results().items()
    }
    data["obstacle_share"] = (flown, spreads["obstacle"].mean)
    coords = {
        "y": region.y_m,
        "x": region.x_m,
        "altitude": np.asarray(altitudes_m, float),
        "time": np.array([time.removesuffix("Z") for time in sky.times], "datetime64[ns]"),
    }
    return xr.Dataset(data, coords)
