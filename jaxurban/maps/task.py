"""MapTask: what the maps of a region are made of, whoever makes them, and the dataset that they are written into."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import xarray as xr
from xarray.indexes import PandasIndex

from jaxurban.errors import InputError
from jaxurban.io.city import City, joined_credits, seen_by
from jaxurban.io.rasterise import (
    build_surface,
    check_has_data,
    highest_top_m,
    surface_grid,
    unknown_plants_m,
)
from jaxurban.kernels.engine import uses_numba
from jaxurban.knowledge import Guesses
from jaxurban.maps.guesses import region_guesses
from jaxurban.maps.params import MapParams
from jaxurban.metrics import gps_floor
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, UNDERSIDE, Metric, Variable
from jaxurban.metrics.custom import Layer, metrics_of
from jaxurban.metrics.population import BlockLayers, block_layers
from jaxurban.metrics.variables import AUXILIARY_VARIABLES, CAVEAT, derived
from jaxurban.metrics.visibility import shadow_reach_m
from jaxurban.settings import SLABS
from jaxurban.world.footprints import BUILDING
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from jaxurban.world.sky import InView, Sky
from jaxurban.world.surface import Surface


@dataclass(frozen=True, eq=False)
class MapTask:
    """What the maps of a region depend on. Who makes them, in how many tiles and into which folder is not part of it.

    Attributes:
      city: what stands and who lives there.
      region: grid of the maps.
      sky: times and satellites.
      params: settings.
      layers: cost layers that a user adds, by name.
      bands: values of the layers that are not functions, by name: one band, or one for each of the layer's
        ``altitudes_m``; rasters, or arrays on the region's cells (see `jaxurban.io.rasterise.bands_of`).
      guesses: what the maps rest on that was guessed (see `jaxurban.knowledge`).

    Raises:
      InputError: bounds of GPS under several clocks, or a GPS floor in a city with slabs.
    """

    city: City
    region: Grid
    sky: Sky
    params: MapParams
    layers: Mapping[str, Layer] = field(default_factory=dict)
    bands: Mapping[str, tuple[Raster | np.ndarray, ...]] = field(default_factory=dict)
    guesses: Guesses = ()

    def __post_init__(self) -> None:
        """Check what city, sky and layers do not allow together; errors as of the class."""
        object.__setattr__(self, "city", seen_by(self.city, self.params.gps))
        if self.params.gps.bounds and self.in_view(0).clocks is not None:
            raise InputError(
                "bounds of m_gps hold for one clock: with several, a first satellite of the first system may raise "
                "GDOP. Set [gps] clocks = 'one', or give the orbits of one system"
            )
        if self.city.hanging == SLABS and self.has_floor:
            raise InputError(
                "the GPS floor knows no slabs, below and above which the sky differs: read the city with "
                'hanging = "to_ground", or leave gps_floor out'
            )

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """The metrics of the maps by name: the built-in metrics for which the city has data, then the user's own."""
        return metrics_of(
            self.params.sections, self.layers, has_people=self.city.blocks is not None
        )

    def settings_of(self, metric: Metric) -> Any:
        """Return the settings of a metric."""
        own_layer = self.layers.get(metric.name)
        return self.params.sections[metric.section] if own_layer is None else own_layer

    def has_series(self, metric: Metric) -> bool:
        """Return whether maps hold what is kept of a metric over all times."""
        is_several = self.num_times > 1 and not metric.is_cost
        return TIME in metric.dims and (is_several or not self.keeps_times)

    def has_bounds(self, metric: Metric) -> bool:
        """Return whether maps hold bounds of a metric."""
        return metric.is_bracketed and self.params.gps.bounds

    @property
    def spread_metrics(self) -> tuple[str, ...]:
        """Names of the metrics whose spread under uncertain heights is computed; empty if no spread is asked for.

        The spread is computed of the metrics that depend on buildings. These are all metrics with an altitude, except
        for layers that are rasters or arrays.
        """
        if not self.params.heights.height_samples:
            return ()
        return tuple(
            name
            for name, metric in self.metrics.items()
            if ALTITUDE in metric.dims and name not in self.bands
        )

    @property
    def reach_m(self) -> float:
        """The greatest distance, in metres, at which what surrounds a cell counts in any of its metrics."""
        return max(metric.reach_m(self.settings_of(metric)) for metric in self.metrics.values())

    @property
    def has_floor(self) -> bool:
        """Whether the GPS floor is made, which asks what is seen at every height from the ground on."""
        return gps_floor.METRIC.section in self.params.sections

    @property
    def lowest_m(self) -> float:
        """The lowest height above the ground at which satellites count."""
        return 0.0 if self.has_floor else min(self.params.altitudes_m)

    @property
    def sizes(self) -> dict[str, int]:
        """How many values each dimension of the metrics has, by name."""
        return {
            TIME: self.num_times,
            ALTITUDE: len(self.params.altitudes_m),
            TIME_OF_DAY: len(self.params.population.times_of_day),
        }

    @property
    def num_times(self) -> int:
        """How many times the sky has."""
        return len(self.sky.times)

    @property
    def keeps_times(self) -> bool:
        """Whether the GPS maps of every time are kept; otherwise statistics over the times are kept instead."""
        return self.params.gps.keeps_times(self.num_times)

    @property
    def has_terrain(self) -> bool:
        """Whether the ground is not flat."""
        return self.city.terrain is not None

    @property
    def by_numba(self) -> list[str]:
        """Names of what Numba computes because its form is faster or the only one; JAX computes all else."""
        names = []
        if self.has_terrain and uses_numba(self.params.engine):
            names += [
                f"{metric.name} over terrain"
                for metric in self.metrics.values()
                if metric.is_numba_over_terrain(self.params.sections.get(metric.section))
            ]
        if self.city.hanging == SLABS:
            names.append("shadows of slabs")
        return names

    @cached_property
    def population(self) -> BlockLayers | None:
        """The population of every block, normalised over the region; None without population data."""
        if self.city.blocks is None:
            return None
        return block_layers(self.city.blocks, self.params.population, self.region.bounds_m)

    @property
    def all_guesses(self) -> Guesses:
        """Every guess behind the maps, a sentence each by its short name."""
        return region_guesses(
            self.city,
            self.region,
            self.sky,
            self.lowest_m,
            self.bands,
            self.params.population,
            self.population,
        )

    @cached_property
    def has_guessed_roofs(self) -> bool:
        """Whether the height of anything that stands in the region is guessed. If so, the maps mark such roofs."""
        standing, plants = self.city.counted
        if plants is not None and unknown_plants_m(self.city, self.region).any():
            return True
        return standing is not None and standing.guessed_share(self.region.bounds_m) > 0

    @cached_property
    def has_kinds(self) -> bool:
        """Whether anything but a building stands in the region. If so, the maps say what stands."""
        standing = self.city.standing
        is_other = standing is not None and standing.inside(self.region.bounds_m).kinds != BUILDING
        return self.city.plants is not None or bool(np.any(is_other))

    def in_view(self, time_index: int) -> InView:
        """Return the satellites in view at a time, with one receiver clock or several as the settings of GPS say."""
        in_view = self.sky.in_view(time_index)
        return in_view._replace(clocks=None) if self.params.gps.clocks == "one" else in_view

    def with_margin(self, part: Grid | None = None, highest_m: float | None = None) -> Grid:
        """Return a grid grown by the margin that its metrics need: their reach, and all that can shadow the grid.

        Args:
          part: a part of the region; left out, the whole region.
          highest_m: how far the highest roof can stand above the lowest ground, in metres; left out, as in the city.
        """
        part = self.region if part is None else part
        highest_m = highest_top_m(self.city) if highest_m is None else highest_m
        sky = self.sky
        toward_m = shadow_reach_m(
            sky.azimuth_rad[sky.is_in_view],
            sky.elevation_rad[sky.is_in_view],
            highest_m,
            self.lowest_m,
            part.resolution_m,
        )
        return surface_grid(self.city, part, self.reach_m, toward_m)

    def with_halo(self, part: Grid) -> Grid:
        """Return a grid grown by the cells around it that count in its metrics; what shadows it can lie farther off."""
        halo = math.ceil(self.reach_m / part.resolution_m)
        return part.padded(halo, halo, halo, halo)

    def surface(self, part: Grid | None = None, around: Grid | None = None) -> Surface:
        """Return the city's rasters on the region and its margin.

        Args:
          part: a part of the region instead.
          around: the part with its margin.

        Raises:
          InputError: the terrain or the height raster covers nothing of the whole region.
        """
        surface = build_surface(
            self.city,
            part or self.region,
            around or self.with_margin(),
            has_guessed=self.has_guessed_roofs,
            has_kinds=self.has_kinds,
        )
        if part is None:
            check_has_data([surface.crop(surface.has_data)], self.city)
        return surface


PLANE = ("y", "x")
NORTHING, EASTING = "projection_y_coordinate", "projection_x_coordinate"


def variables(task: MapTask) -> dict[str, Variable]:
    """Return every variable that the maps of a task hold, by name: obstacles, metrics, then auxiliary rasters."""
    by_name = {"obstacle": AUXILIARY_VARIABLES["obstacle"]}
    for name, metric in task.metrics.items():
        if TIME not in metric.dims or task.keeps_times:
            by_name |= metric.variables
        if task.has_series(metric):
            by_name |= derived(metric)["series"]
        if task.has_bounds(metric):
            by_name |= derived(metric)["bounds"]
        if name in task.spread_metrics:
            by_name |= derived(metric)["spread"]

    # Auxiliary variables that only some maps have; all others are in every map.
    is_needed = {
        "obstacle_share": task.params.heights.height_samples,
        "roof_guessed": task.has_guessed_roofs,
        "roof_limit": task.has_guessed_roofs,
        "roof_likely": task.has_guessed_roofs,
        "roof_kind": task.has_kinds,
        UNDERSIDE: task.city.hanging == SLABS and task.city.buildings is not None,
        "terrain": task.has_terrain,
    }
    for name, variable in AUXILIARY_VARIABLES.items():
        if is_needed.get(name, True):
            by_name[name] = variable
    return by_name


def empty_dataset(
    task: MapTask, make: Callable[[tuple[int, ...], np.dtype], object] = np.zeros
) -> xr.Dataset:
    """Return the dataset into which the maps of a task are written; it has coordinates and attributes already.

    Args:
      task: what the maps are made of.
      make: returns an array of a shape and a type, for the values of a variable; left out, zeros in memory.
    """
    region = task.region
    params = task.params
    population = task.population
    coords = _coordinates(task)

    # Attributes of the whole dataset, first those that all maps have.
    attrs: dict[str, object] = {
        "Conventions": "CF-1.11",
        "crs": region.crs,
        "resolution_m": region.resolution_m,
        "first_row": region.first_row,
        "first_col": region.first_col,
        "satellites": ", ".join(task.sky.names),
        "constellations": ", ".join(sorted(set(task.sky.systems))),
    }
    for metric in task.metrics.values():
        settings = task.settings_of(metric)
        for name, setting in metric.recorded.items():
            attrs[name] = getattr(settings, setting)
    if len(set(task.sky.systems)) > 1:
        attrs["gps_clocks"] = params.gps.clocks
    credits = [layer.credit for layer in task.layers.values()]
    attribution = joined_credits(task.city.attribution, *credits)
    if attribution:
        attrs["attribution"] = attribution
    attrs["known_bounds_m"] = task.city.known_area.bounds
    if population is not None:
        per = "block" if params.population.quantity == "count" else "km2"
        attrs[f"pop_norm_per_{per}"] = [float(value) for value in population.norm_per_km2]
    if not task.keeps_times:
        attrs["gps_availability_threshold"] = params.gps.availability_threshold

    # The arrays.
    sizes = {name: coord.size for name, coord in coords.items()}
    by_name = variables(task)
    data = {}
    for name, variable in by_name.items():
        dims = (*variable.dims, *PLANE)
        shape = tuple(sizes[dim] for dim in dims)
        data[name] = _held(dims, make(shape, np.dtype(variable.dtype)))
    ds = xr.Dataset(data, _indexed(coords), attrs)

    # Attributes of each variable, then those that a metric's settings and a user's layer add.
    for name, variable in by_name.items():
        ds[name].attrs |= _attributes(variable)
    for name, metric in task.metrics.items():
        if name in ds:
            ds[name].attrs |= metric.attributes(task.settings_of(metric))
    for name, layer in task.layers.items():
        ds[name].attrs["layer"] = json.dumps(layer.record)
    return ds


def _coordinates(task: MapTask) -> dict[str, xr.Variable]:
    """Return the coordinates of a task's maps by name: y, x, altitude, time, the CRS and, with people, time of day."""
    region = task.region
    utc_times = [time.removesuffix("Z") for time in task.sky.times]
    times = np.array(utc_times, "datetime64[ns]")
    altitudes_m = np.asarray(task.params.altitudes_m, float)
    heights = {"units": "m", "positive": "up", "reference": "ground below (AGL)"}
    coords = {
        "y": _axis("y", region.y_m, "Y", NORTHING, "northing of the cell's centre", units="m"),
        "x": _axis("x", region.x_m, "X", EASTING, "easting of the cell's centre", units="m"),
        "altitude": _axis("altitude", altitudes_m, "Z", "height", "above ground", **heights),
        "time": _axis("time", times, "T", "time", "UTC"),
        "spatial_ref": _held((), np.asarray(0), pyproj.CRS(region.crs).to_cf()),
    }
    if task.population is not None:
        names = np.asarray(task.params.population.times_of_day, np.dtypes.StringDType())
        coords["time_of_day"] = _held(("time_of_day",), names, {"long_name": "time of day"})
    return coords


def _held(
    dims: tuple[str, ...], values: Any, attrs: Mapping[str, Any] | None = None
) -> xr.Variable:
    """Return an xarray variable that holds an array unchanged.

    xarray's usual way imports Dask, which takes 0.3 s, to see whether the array is one of Dask's.
    """
    return xr.Variable(dims, values, attrs, fastpath=True)


def _indexed(coords: Mapping[str, xr.Variable]) -> xr.Coordinates:
    """Return coordinates with an index for each that is an axis, which are all except the CRS.

    The indexes are made here, as xarray's usual way imports Dask for them too (`_held`).
    """
    indexes = {
        name: PandasIndex(pd.Index(coord.values), name, coord_dtype=coord.dtype)
        for name, coord in coords.items()
        if coord.dims
    }
    axes = {name: index.create_variables(coords)[name] for name, index in indexes.items()}
    return xr.Coordinates({**coords, **axes}, indexes)


def _axis(
    name: str, values: np.ndarray, axis: str, standard_name: str, long_name: str, **more: str
) -> xr.Variable:
    """Return the coordinate along an axis, with the attributes of the CF conventions and ``more`` attributes."""
    attrs = {"standard_name": standard_name, "long_name": long_name, "axis": axis, **more}
    return _held((name,), values, attrs)


def _attributes(variable: Variable) -> dict[str, str]:
    """Return the attributes that files hold of a map, without those that are empty."""
    has_flags = len(variable.classes) > 2
    texts = {
        "long_name": variable.long_name,
        CAVEAT: variable.caveat,
        "standard_name": variable.standard_name,
        "units": variable.unit,
        "one_means": variable.one_means,
        "flag_meanings": " ".join(name for name, _ in variable.classes) if has_flags else "",
        "grid_mapping": "spatial_ref",
    }
    return {key: value for key, value in texts.items() if value}
