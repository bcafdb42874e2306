"""The layers of metric maps: their parameters, the dataset that holds them, and how each is made from a surface."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import xarray as xr

from jaxurban.city import City
from jaxurban.errors import InputError
from jaxurban.grid import Grid
from jaxurban.io.rasterise import highest_top_m, surface_grid
from jaxurban.kernels.distance import window_cells
from jaxurban.kernels.lidar import num_steps
from jaxurban.metrics import lidar as lidar_metric
from jaxurban.metrics import risk as risk_metric
from jaxurban.metrics.availability import SCALE, STATISTICS, EpochTotals, series_statistics
from jaxurban.metrics.gps import Epoch, GpsParams, shadow_reach_m
from jaxurban.metrics.lidar import LidarParams, compute_lidar
from jaxurban.metrics.obstacle import obstacle_mask
from jaxurban.metrics.population import BlockLayers, PopulationParams, map_blocks
from jaxurban.metrics.risk import RiskParams, compute_risk
from jaxurban.sky import Sky
from jaxurban.surface import Surface
from jaxurban.uncertainty import SPREAD, HeightStd

PAPER_ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
DOP_VARIABLES = ("gdop", "pdop", "hdop", "vdop", "tdop", "num_visible")
FLOWN = ("altitude", "y", "x")
UNITS = {  # units and what a value of one means, by variable
    "obstacle": ("1", "a roof reaches this altitude"),
    "gps": ("1", "GDOP of 1, the best possible"),
    "gps_availability": ("1", "m_gps is above the threshold at every epoch"),
    "gps_median": ("1", "GDOP of 1, the best possible"),
    "gps_p05": ("1", "GDOP of 1, the best possible"),
    "gps_epoch_mean": ("1", "GDOP of 1, the best possible"),
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
    "roof_touched": ("m", ""),
    "terrain": ("m", ""),
}

Stage = Callable[[str], AbstractContextManager[None]]
Words = Callable[[int], jax.Array]  # visibility words [W, A, y, x] of an epoch


def untimed(name: str) -> AbstractContextManager[None]:
    """Return a context that does nothing with the stage it is told."""
    return nullcontext()


@dataclass(frozen=True)
class MapParams:
    """Everything that metric maps depend on besides city, sky and grid; `build_maps` says what each means."""

    altitudes_m: tuple[float, ...] = PAPER_ALTITUDES_M
    mask_deg: float = 5.0
    gps: GpsParams = field(default_factory=GpsParams)
    lidar: LidarParams = field(default_factory=LidarParams)
    risk: RiskParams = field(default_factory=RiskParams)
    population: PopulationParams = field(default_factory=PopulationParams)
    times_of_day: tuple[str, ...] = ("day", "night")
    all_touched: bool = False
    oversample: int = 1
    gps_bounds: bool = False
    height_std: HeightStd = field(default_factory=HeightStd)
    height_samples: int = 0
    height_seed: int = 0

    def __post_init__(self) -> None:
        if self.oversample < 1:
            raise InputError(f"oversample must be a whole number from 1 up, got {self.oversample}")
        if self.height_samples == 1:
            raise InputError("height_samples is 1: a spread needs at least 2 samples (0 makes none)")

    def satellites_at(self, sky: Sky, epoch: int) -> np.ndarray:
        """Return the numbers of the satellites at or above the mask at an epoch."""
        return np.flatnonzero(sky.elevation_rad[epoch] >= np.radians(self.mask_deg))


def margin_of(city: City, region: Grid, sky: Sky, params: MapParams) -> Grid:
    """Return the region's grid grown by the margin that its metrics need."""
    above = sky.elevation_rad >= np.radians(params.mask_deg)
    toward_m = shadow_reach_m(
        sky.azimuth_rad[above],
        sky.elevation_rad[above],
        highest_top_m(city),
        float(min(params.altitudes_m)),
        region.resolution_m,
    )
    always_m = max(lidar_metric.reach_m(params.lidar), risk_metric.reach_m(params.risk))
    return surface_grid(city, region, always_m, toward_m)


def halo_cells(resolution_m: float, params: MapParams) -> int:
    """Return how many cells around a tile its lidar and risk maps look at."""
    steps = num_steps(resolution_m, params.lidar.range_m)
    return max(steps - 1, window_cells(params.risk.threshold_m, resolution_m))


class Detail(Protocol):
    """What `jaxurban.detail` adds to the layers of a region."""

    def lidar(self, is_obstacle: jax.Array, altitude_m: float) -> jax.Array:
        """Return m_lidar on the finer surface, ``[1, y, x]``."""

    def layers(self, is_obstacle: jax.Array, stage: Stage) -> Iterator[tuple[str, tuple[int, ...], np.ndarray]]:
        """Yield bounds and spreads, place by place."""


class Layer(NamedTuple):
    """One map: variable, place along the variable's axes before y and x, values ``[y, x]``."""

    name: str
    place: tuple[int, ...]
    values: np.ndarray


def variables(
    params: MapParams, num_epochs: int, has_people: bool, has_terrain: bool
) -> dict[str, tuple[tuple[str, ...], np.dtype]]:
    """Return dims and type of every variable that maps hold."""
    names: dict[str, tuple[tuple[str, ...], type]] = {"obstacle": (FLOWN, np.uint8)}
    if params.gps.keeps_epochs(num_epochs):
        names |= {name: (("time", *FLOWN), np.float32) for name in ("gps", *DOP_VARIABLES)}
        names["num_visible"] = (("time", *FLOWN), np.uint8)
    else:
        names |= dict.fromkeys(STATISTICS, (FLOWN, np.float32))
    names |= {"lidar": (FLOWN, np.float32), "risk": (FLOWN, np.float32)}
    if (params.gps_bounds or params.height_samples) and not params.gps.keeps_epochs(num_epochs):
        raise InputError(
            "bounds and height_samples need the maps of every epoch: ask for fewer, or set [gps] series = 'epochs'"
        )
    if params.gps_bounds:
        names |= dict.fromkeys(("gps_lower", "gps_upper"), (("time", *FLOWN), np.float32))
    if params.height_samples:
        for metric, dims in (("gps", ("time", *FLOWN)), ("lidar", FLOWN), ("risk", FLOWN)):
            names |= dict.fromkeys((f"{metric}_{what}" for what in SPREAD), (dims, np.float32))
        names["obstacle_share"] = (FLOWN, np.float32)
    if has_people:
        names |= dict.fromkeys(("population", "density"), (("time_of_day", "y", "x"), np.float32))
    names |= dict.fromkeys(("roof", "roof_touched"), (("y", "x"), np.float32))
    if has_terrain:
        names["terrain"] = (("y", "x"), np.float32)
    names["has_data"] = (("y", "x"), np.bool_)
    return {name: (dims, np.dtype(kind)) for name, (dims, kind) in names.items()}


def empty_dataset(
    region: Grid,
    sky: Sky,
    params: MapParams,
    people: BlockLayers | None,
    has_terrain: bool,
    attribution: str = "",
    make: Callable[[tuple[int, ...], np.dtype], object] = np.zeros,
) -> xr.Dataset:
    """Return the dataset that the layers of a region go into, with coordinates and attributes, all values zero.

    Args:
      region: grid of the maps.
      sky: its epochs.
      params: settings.
      people: from `block_layers`; None without population data.
      has_terrain: whether the ground is not flat.
      attribution: credit of the sources.
      make: gives the array of a shape and a type.
    """
    coords: dict[str, Any] = {
        "y": ("y", region.y_m, {"units": "m", "standard_name": "projection_y_coordinate"}),
        "x": ("x", region.x_m, {"units": "m", "standard_name": "projection_x_coordinate"}),
        "altitude": ("altitude", np.asarray(params.altitudes_m, float), {"units": "m", "long_name": "above ground"}),
        "time": ("time", np.array([time.removesuffix("Z") for time in sky.times], "datetime64[ns]")),
        "spatial_ref": ((), 0, pyproj.CRS(region.crs).to_cf()),
    }
    attrs: dict[str, object] = {
        "crs": region.crs,
        "resolution_m": region.resolution_m,
        "first_row": region.first_row,
        "first_col": region.first_col,
        "satellites": list(sky.names),
        "risk_threshold_m": params.risk.threshold_m,
        "risk_distance": params.risk.distance,
    }
    if attribution:
        attrs["attribution"] = attribution
    if people is not None:
        coords["time_of_day"] = ("time_of_day", np.asarray(params.times_of_day, np.dtypes.StringDType()))
        is_count = params.population.quantity == "count"
        norm_name = "pop_norm_per_block" if is_count else "pop_norm_per_km2"
        attrs[norm_name] = [float(value) for value in people.norm_per_km2]
    held = variables(params, len(sky.times), people is not None, has_terrain)
    if "gps" not in held:
        attrs["gps_availability_threshold"] = params.gps.availability_threshold
    sizes = {
        "y": region.num_rows,
        "x": region.num_cols,
        **{name: len(coord[1]) for name, coord in coords.items() if coord[0]},
    }
    data = {name: (dims, make(tuple(sizes[dim] for dim in dims), kind)) for name, (dims, kind) in held.items()}
    return _described(xr.Dataset(data, coords, attrs))


def with_series(ds: xr.Dataset, totals: EpochTotals) -> xr.Dataset:
    """Return a dataset of statistics over time with what only the whole region tells: mean and worst epoch."""
    return _described(
        ds.assign(
            gps_epoch_mean=(("time", "altitude"), totals.mean),
            gps_worst_time=("altitude", ds["time"].values[totals.worst]),
        )
    )


def _described(ds: xr.Dataset) -> xr.Dataset:
    for name in (str(variable) for variable in ds.data_vars):
        units, one_means = UNITS.get(name, ("1", ""))
        if name != "has_data" and ds[name].dtype.kind != "M":  # times have units of their own
            ds[name].attrs["units"] = units
            if {"y", "x"} <= set(ds[name].dims):
                ds[name].attrs["grid_mapping"] = "spatial_ref"
            if one_means:
                ds[name].attrs["one_means"] = one_means
    if "pop_norm_per_block" in ds.attrs:
        ds["population"].attrs["one_means"] = "as many people in the block as the norm (pop_norm_per_block)"
    return ds


def make_layers(
    surface: Surface,
    sky: Sky,
    params: MapParams,
    people: BlockLayers | None,
    words: Words,
    totals: EpochTotals,
    stage: Stage = untimed,
    detail: Detail | None = None,
) -> Iterator[Layer]:
    """Yield every layer of a surface's region, one at a time, so that few of them need be in memory.

    Args:
      surface: roofs, terrain and blocks of the region and its margin.
      sky: its epochs and satellites.
      params: settings.
      people: from `block_layers`; None without population data.
      words: which satellites each cell sees at an epoch.
      totals: takes up the region's sums over free cells, where statistics over time are kept.
      stage: gives the context that the work on each stage runs in.
      detail: finer answers and uncertainty, where they are asked for.
    """
    has_data = None if surface.has_data is None else np.asarray(surface.crop(surface.has_data))
    roof_m = surface.crop(surface.roof_m)

    def layer(name: str, index: Sequence[int], values: jax.Array | np.ndarray) -> Layer:
        """Return a layer with NaN where nothing is known (integers keep 0)."""
        values = np.asarray(values)
        if has_data is not None and np.issubdtype(values.dtype, np.floating):
            values = np.where(has_data, values, np.float32(np.nan))
        return Layer(name, tuple(index), values)

    with stage("obstacle"):
        is_obstacle = obstacle_mask(roof_m, params.altitudes_m)
    for a in range(len(params.altitudes_m)):
        yield layer("obstacle", [a], np.asarray(is_obstacle[a]).astype(np.uint8))
    gps_layers = _epoch_layers if params.gps.keeps_epochs(len(sky.times)) else _series_layers
    for name, index, values in gps_layers(sky, params, is_obstacle, has_data, words, totals, stage):
        yield layer(name, index, values)
    for a, altitude_m in enumerate(params.altitudes_m):
        with stage("lidar"):
            if detail is not None and params.oversample > 1:
                m = np.asarray(detail.lidar(is_obstacle[a : a + 1], altitude_m))[0]
            else:
                m = np.asarray(compute_lidar(surface, [altitude_m], params.lidar))[0]
        yield layer("lidar", [a], m)
        with stage("risk"):
            m = np.asarray(compute_risk(surface, [altitude_m], params.risk))[0]
        yield layer("risk", [a], m)
    if detail is not None:
        for name, index, values in detail.layers(is_obstacle, stage):
            yield layer(name, index, values)
    if people is not None:
        assert surface.block is not None
        for t in range(len(params.times_of_day)):
            for name, values in (("population", people.m), ("density", people.density_per_km2)):
                with stage("population"):
                    m = np.asarray(map_blocks(surface.block, values[t]))
                yield layer(name, [t], m)
    yield layer("roof", [], roof_m)
    assert surface.roof_touched_m is not None
    yield layer("roof_touched", [], surface.roof_touched_m)
    if surface.terrain_m is not None:
        yield layer("terrain", [], surface.crop(surface.terrain_m))
    yield Layer("has_data", (), np.ones(surface.region.shape, bool) if has_data is None else has_data)


def _epoch(sky: Sky, params: MapParams, t: int) -> Epoch:
    seen = params.satellites_at(sky, t)
    return Epoch.of(sky.azimuth_rad[t, seen], sky.elevation_rad[t, seen], params.gps)


def _epoch_layers(
    sky: Sky,
    params: MapParams,
    is_obstacle: jax.Array,
    has_data: np.ndarray | None,
    words: Words,
    totals: EpochTotals,
    stage: Stage,
) -> Iterator[tuple[str, tuple[int, ...], jax.Array]]:
    """Yield the GPS maps of every epoch."""
    for t in range(len(sky.times)):
        with stage("gps"):
            epoch, seen = _epoch(sky, params, t), jax.block_until_ready(words(t))
        for a in range(len(params.altitudes_m)):
            with stage("gps"):
                maps = jax.block_until_ready(epoch.maps(seen[:, a], is_obstacle[a]))
            for name, values in (("gps", maps.m), *((name, getattr(maps, name)) for name in DOP_VARIABLES)):
                yield name, (t, a), values


def _series_layers(
    sky: Sky,
    params: MapParams,
    is_obstacle: jax.Array,
    has_data: np.ndarray | None,
    words: Words,
    totals: EpochTotals,
    stage: Stage,
) -> Iterator[tuple[str, tuple[int, ...], np.ndarray]]:
    """Yield statistics over the epochs, and add the region's sums to ``totals``."""
    num_epochs = len(sky.times)
    with stage("gps"):
        is_counted = ~np.asarray(is_obstacle) if has_data is None else ~np.asarray(is_obstacle) & has_data
        counted = jnp.asarray(is_counted)
        totals.num_free += is_counted.sum(axis=(1, 2))
        m = np.empty((num_epochs, *is_obstacle.shape), np.float32)
        for t in range(num_epochs):
            m_now = _epoch(sky, params, t).m(words(t), is_obstacle)
            m[t] = m_now
            totals.m_sum[t] += np.asarray(_row_sums(m_now, counted)).sum(axis=1, dtype=np.int64)
    for a in range(len(params.altitudes_m)):
        with stage("gps"):
            found = series_statistics(m[:, a], params.gps.availability_threshold)
        for name, values in found.items():
            yield name, (a,), values


@jax.jit
def _row_sums(m: jax.Array, is_counted: jax.Array) -> jax.Array:
    """Return the sum of round(m x SCALE) over the counted cells of each row, int32 ``[A, y]``."""
    return jnp.sum(jnp.where(is_counted, jnp.rint(m * SCALE).astype(jnp.int32), 0), axis=2)
