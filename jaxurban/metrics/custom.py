"""Cost layers that a user adds: a raster, an array or a function of the surface as one more metric."""

import json
import keyword
import math
import re
import zlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.checks import finite, typed
from jaxurban.errors import InputError
from jaxurban.metrics.base import (
    ALTITUDE,
    COSTS,
    TIME,
    TIME_OF_DAY,
    Metric,
    Scale,
    Scene,
    SoftScene,
    Variable,
)
from jaxurban.metrics.registry import METRICS, known_metrics
from jaxurban.metrics.variables import AUXILIARY_VARIABLES, STORED_AS, derived, stored_name
from jaxurban.settings import not_negative
from jaxurban.world.surface import Surface

if TYPE_CHECKING:
    import xarray as xr

COLOURS = ("#56b4e9", "#d55e00", "#7f3c8d", "#80604d")  # of lines, none a built-in metric's
_OF_ROUTES = ("distance", "climb", "descent", "self", "lon", "lat")
_OF_MAPS = (ALTITUDE, TIME, TIME_OF_DAY, "y", "x", "spatial_ref", *AUXILIARY_VARIABLES)
LAYERS = "layers"  # section of a scenario
MOST_BEYOND = 0.01  # of a layer's values at one number beyond its scale
FAR = 10.0
# What the name of a file, or of a map of the spread, holds behind that of its variable.
_OF_A_FILE = re.compile(r"\w+_(\d+m|day|night|\d{8}T\d{6}Z|mean|std|p05|p95)")


@typed
@dataclass(frozen=True, eq=False)
class Layer:
    """Settings of a cost layer that a user adds, a ``[layers.NAME]`` section of a scenario.

    Attributes:
      source: path of a raster, which is resampled to the maps' cells; in Python also an array ``[y, x]`` (with
        ``altitudes_m``: ``[A, y, x]``) on the maps' cells, rows south to north, or a function of a
        `jaxurban.world.surface.Surface` and ``altitude_m`` that returns the values on the cells of its region.
      cost: ``"high-is-bad"`` or ``"low-is-bad"``.
      scale: the values whose m is 0 and 1, in the source's own unit; fixed, so that a cost means the same on every
        map. Values beyond are cut.
      altitudes_m: flight altitudes of the bands, in order; left out, one band or the function serves all altitudes.
      nan: what cells without a value are: ``"closed"`` to every path, or an ``"error"``.
      reach_m: how far beyond its own cell a function looks sideways; the surface holds that margin, and its
        `crop_with_halo` refuses more. What a function reads of ``surface.roof_m`` beyond it differs from tile to tile.
      soft: function of a surface, ``altitude_m`` and ``softness_m`` as ``source``, with gradients.
      credit: what the licence of the source asks for.

    Raises:
      InputError: a value out of its range.

    Examples:
      >>> noise = ju.Layer(np.full(maps.grid.shape, 20.0), cost="high-is-bad", scale=(0.0, 80.0))
      >>> made = ju.build_maps(city, grid=maps.grid, altitudes_m=(60.0,), layers={"noise": noise})
      >>> list(made.metrics), float(made.costs(60.0)["noise"][2, 2])
      (['gps', 'lidar', 'population', 'risk', 'noise'], 0.25)
    """

    source: Any
    cost: Literal["high-is-bad", "low-is-bad"]
    scale: tuple[float, float]
    altitudes_m: tuple[float, ...] | None = None
    nan: Literal["closed", "error"] = "closed"
    reach_m: float = 0.0
    soft: Callable | None = None
    credit: str = ""

    def __post_init__(self) -> None:
        """Check the settings and write a path as text; errors as of the class."""
        if isinstance(self.source, Path):
            object.__setattr__(self, "source", str(self.source))
        if not (callable(self.source) or isinstance(self.source, str | np.ndarray | jax.Array)):
            raise InputError(
                "source must be the path of a raster, an array or a function of (surface, altitude_m), got "
                f"{type(self.source).__name__}"
            )
        scale = [finite("scale", value) for value in self.scale]
        if not (len(scale) == 2 and scale[0] < scale[1]):
            raise InputError(f"scale must be two ascending numbers such as [0, 80], got {scale}")
        heights = [finite("altitudes_m", value) for value in self.altitudes_m or ()]
        if len(set(heights)) < len(heights):
            raise InputError(
                f"altitudes_m must name different altitudes, one for each band, got {heights}"
            )
        not_negative("reach_m", self.reach_m)
        if self.reach_m and not callable(self.source):
            raise InputError(
                "reach_m says how far a function looks: leave it out for a raster or an array"
            )

    @property
    def record(self) -> dict[str, Any]:
        """The settings as JSON can hold them; the source is a path, the name of a function, or ``"array"``."""
        source = self.source
        if not isinstance(source, str):
            source = getattr(source, "__qualname__", "array")
        record = {"source": source, "cost": self.cost, "scale": [*self.scale], "nan": self.nan}
        if self.altitudes_m is not None:
            record["altitudes_m"] = [*self.altitudes_m]
        if self.credit:
            record["credit"] = self.credit
        return record

    def scaled(self, values: Any) -> jax.Array:
        """Return m in [0, 1] of values in the source's unit; NaN stays. The gradient is 0 beyond the scale.

        Returns:
          m in the shape of the values.

        Examples:
          >>> ju.Layer("noise.tif", cost="high-is-bad", scale=(0.0, 80.0)).scaled([20.0, 100.0]).tolist()
          [0.25, 1.0]
        """
        low, high = self.scale
        return jnp.clip((jnp.asarray(values) - low) / (high - low), 0, 1)


def check_values(name: str, layer: Layer, values: np.ndarray) -> None:
    """Raise InputError if one number far beyond the good end of a layer's scale stands for no value in it.

    It alone lies beyond that end, in more than `MOST_BEYOND` of the values, and is negative though the scale is not, or
    `FAR` times larger than its ends. Cut to the scale it would count as the best. Values of many kinds beyond the scale
    pass: to cut these is what a scale is for.

    Args:
      name: of the layer.
      layer: its settings.
      values: of one band, NaN without one.
    """
    low, high = layer.scale
    beyond = values[values < low] if layer.cost == "high-is-bad" else values[values > high]
    share = beyond.size / values.size
    if share <= MOST_BEYOND or np.ptp(beyond):
        return
    value = float(beyond[0])
    if value < 0 <= low or abs(value) > FAR * np.abs(layer.scale).max():
        raise InputError(
            f"layer {name!r} holds {value:g} in {share:.0%} of its values, beyond its scale {[low, high]}, where it "
            f"would count as the best: declare it as nodata with `gdal_edit.py -a_nodata {value:g}` (in an array: NaN),"
            " or cut the values to the scale yourself if it is one"
        )


def check_layers(layers: Any) -> Mapping[str, Layer]:
    """Return the cost layers that a user adds, by name, once they are checked; none of None.

    Raises:
      InputError: they are not layers by name, or their names could be those of other maps or files.
    """
    by_name = {} if layers is None else layers
    if not (
        isinstance(by_name, Mapping) and all(isinstance(layer, Layer) for layer in by_name.values())
    ):
        raise InputError(
            'layers must be Layers by name, such as {"noise": Layer("noise.tif", "high-is-bad", (0, 80))}'
        )
    reserved = reserved_names()
    for name in by_name:
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
            raise InputError(
                f"a layer's name must be letters, digits and _ such as noise_2024, got {name!r}"
            )
        # Also names that end as those of the maps' files, or of maps of the spread, do.
        if name in reserved or _OF_A_FILE.fullmatch(name):
            raise InputError(
                f"a layer cannot be called {name!r}: maps, their files or weights use such names: give another name"
            )
    return by_name


def reserved_names() -> set[str]:
    """Return the names that no layer has, as those of metrics, of their maps and of columns of tables."""
    names = {*_OF_ROUTES, *_OF_MAPS}
    for metric in known_metrics().values():
        stored = [f"{metric.name}_{suffix}" for suffix in STORED_AS]
        names.update(metric.variables, *derived(metric).values(), stored)
    return names


def own_metric(name: str, layer: Layer) -> Metric:
    """Return a user's layer as a metric, which has altitudes where its source has several bands or is a function.

    Args:
      name: of the layer, one that `check_layers` accepts.
      layer: its settings.
    """
    has_altitudes = layer.altitudes_m is not None or callable(layer.source)
    _, high = layer.scale
    return Metric(
        name=name,
        params=Layer,
        dims=(ALTITUDE,) if has_altitudes else (),
        compute=partial(_map, name),
        soft=None if layer.soft is None else _soft,
        cost=COSTS[layer.cost],
        reach_m=attrgetter("reach_m"),
        label=name,
        one_means=f"{name} of {high:g} or more",
        colour=colour_of(name),
        colour_map="cividis",
        inside=None,
        section=LAYERS,
    )


def metrics_of(
    requested: Collection[str], layers: Mapping[str, Layer], has_people: bool
) -> dict[str, Metric]:
    """Return the metrics of maps by name: those of every cost, those made on request, then a user's own by name.

    Args:
      requested: names or sections of the metrics on request that are made; other names of metrics change nothing.
      layers: the user's, by name.
      has_people: whether there are census blocks, which metrics with a time of day need; these are left out otherwise.
    """
    wanted = {*METRICS, *requested}
    built_in = [
        metric for metric in known_metrics().values() if wanted & {metric.section, metric.name}
    ]
    own = [own_metric(name, layer) for name, layer in sorted(layers.items())]
    return {
        metric.name: metric
        for metric in (*built_in, *own)
        if has_people or TIME_OF_DAY not in metric.dims
    }


def colour_of(name: str) -> str:
    """Return the colour of a metric's lines in figures, built-in or a user's, by its name alone."""
    known = known_metrics()
    if name in known:
        return known[name].colour
    return COLOURS[zlib.crc32(name.encode()) % len(COLOURS)]


def held_metrics(ds: "xr.Dataset", costs_only: bool = True) -> dict[str, Metric]:
    """Return the metrics that a dataset of maps holds, by name: the built-in ones, then a user's own.

    A metric counts as held where what a long series keeps in its place is (`stored_name`). The variable of a user's
    layer has its settings in the attribute ``layer`` (`Layer.record`).

    Args:
      ds: the maps.
      costs_only: whether metrics that no path pays for are left out.
    """
    variables = ds.variables
    records = {
        str(name): json.loads(variable.attrs["layer"])
        for name, variable in variables.items()
        if "layer" in variable.attrs
    }
    metrics = {
        metric.name: metric
        for metric in known_metrics().values()
        if (metric.is_cost or not costs_only) and stored_name(metric.name, variables) in variables
    }
    for name, record in sorted(records.items()):
        metrics[name] = own_metric(name, Layer(**record))
    return metrics


def is_of_sky(ds: "xr.Dataset", variable: Variable) -> bool:
    """Return whether a variable of maps says something of the satellites of a time."""
    metric = held_metrics(ds, costs_only=False).get(variable.of)
    return metric is not None and TIME in metric.dims


def held_variables(ds: "xr.Dataset") -> dict[str, Variable]:
    """Return the variable of every map ``[..., y, x]`` of a dataset by its name.

    A map that neither jaxurban nor a metric of the dataset makes gets a variable from its attributes.
    """
    known = dict(AUXILIARY_VARIABLES)
    for name, metric in held_metrics(ds, costs_only=False).items():
        from_metric = derived(metric)
        known |= metric.variables | from_metric["spread"]
        if name not in ds or not metric.is_cost:
            known |= from_metric["series"]

    # The maps of the dataset, and variables for the unknown ones among them.
    maps = {
        str(name): array for name, array in ds.data_vars.items() if array.dims[-2:] == ("y", "x")
    }
    for name, array in maps.items():
        variable = Variable(
            name,
            str(array.attrs.get("long_name", name)),
            str(array.attrs.get("units", "1")),
            dtype=array.dtype.type,
            scale=Scale("viridis", low=None, high=None),
            dims=tuple(map(str, array.dims[:-2])),
        )
        known.setdefault(name, variable)
    return {name: known[name] for name in maps}


def _map(name: str, scene: Scene, layer: Layer) -> dict[str, jax.Array]:
    """Return the map of a user's layer on one tile, m ``[y, x]`` float32 by its name; NaN in cells without a value.

    Args:
      name: of the layer.
      scene: what it may look at.
      layer: its settings.

    Raises:
      InputError: values of another shape than the tile's, or cells without a value where that is an error.
    """
    # The values, from the user's raster or function.
    surface = _reaching(scene.surface, layer).of_jax()
    values: Any = scene.rasters.get(name)
    if callable(layer.source):
        values = layer.source(surface, scene.altitude_m)
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float32), np.nan)
    if np.shape(values) != surface.region.shape:
        raise InputError(
            f"layer {name!r} gives values of shape {np.shape(values)} for cells of shape {surface.region.shape}: "
            "return one value for each cell of surface.region"
        )
    finite_values = jnp.where(jnp.isfinite(jnp.asarray(values)), values, jnp.nan)
    m = layer.scaled(finite_values).astype(jnp.float32)

    # Cells of which nothing is known need no value.
    is_missing = jnp.isnan(m)
    if surface.has_data is not None:
        is_missing &= surface.crop(surface.has_data)
    if layer.nan == "error" and is_missing.any():
        raise InputError(
            f'layer {name!r} has no value in {is_missing.sum():,} cells: fill them, or set nan = "closed"'
        )
    return {name: m}


def _reaching(surface: Surface, layer: Layer) -> Surface:
    """Return a surface that refuses to be cut farther beyond its region than a layer's reach.

    What lies farther differs between tiles and the whole region.
    """
    return replace(surface, most_halo=math.ceil(layer.reach_m / surface.grid.resolution_m))


def _soft(scene: SoftScene, layer: Layer) -> jax.Array:
    """Return soft m of a user's layer on a scene's cells (`Metric.soft`): ``[y, x]`` or ``[P]``."""
    assert layer.soft is not None
    surface = _reaching(scene.surface, layer)
    m = layer.scaled(layer.soft(surface, scene.altitude_m, scene.softness_m))
    return m if scene.cells is None else m[scene.cells[:, 0], scene.cells[:, 1]]
