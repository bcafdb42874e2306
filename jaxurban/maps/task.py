"""MapTask: what the maps of a region are made of, wherever and by whomever they are made."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from jaxurban.errors import InputError, at_least, one_of, typed
from jaxurban.io.read.guesses import Guesses, has_guessed_roofs, region_guesses
from jaxurban.io.read.rasterise import build_surface, highest_top_m, surface_grid
from jaxurban.kernels.engine import ENGINES, Engine
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, Metric
from jaxurban.metrics.custom import Layer, metrics_of
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import BlockLayers, Population, block_layers
from jaxurban.metrics.registry import METRICS, checked_sections, known_metrics
from jaxurban.metrics.variables import derived
from jaxurban.metrics.visibility import shadow_reach_m
from jaxurban.settings import Heights
from jaxurban.world.city import City, Raster
from jaxurban.world.grid import Grid
from jaxurban.world.sky import InView, Sky
from jaxurban.world.surface import Surface

PAPER_ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)


@typed
@dataclass(frozen=True)
class MapParams:
    """Everything that metric maps depend on besides city, sky and grid.

    Attributes:
      altitudes_m: flight altitudes above ground.
      oversample: n: occlusion and lidar on a surface n times finer (odd is best).
      heights: how roofs are rasterised, and how well their heights are known.
      sections: settings of metrics, by name; the others have their defaults. Of `ON_REQUEST` those named here are made.
      engine: which form of the kernels runs; it changes no bit of the maps on a CPU.

    Raises:
      InputError: altitudes or an oversample that are none, an unknown engine, sections of no metric, or bounds or
        spreads of a series that keeps no single time's maps.
    """

    altitudes_m: Sequence[float] = PAPER_ALTITUDES_M
    oversample: int = 1
    heights: Heights = field(default_factory=Heights)
    sections: Mapping[str, Any] = field(default_factory=dict)
    engine: Engine = "auto"

    def __post_init__(self) -> None:
        values = tuple(float(value) for value in self.altitudes_m)
        if not values or not all(0 < value < np.inf for value in values) or len(set(values)) != len(values):
            raise InputError(f"altitudes_m must be different positive numbers of metres above ground, got {[*values]}")
        object.__setattr__(self, "altitudes_m", values)
        at_least("oversample", self.oversample, 1)
        one_of("engine", self.engine, ENGINES)
        defaults = {name: metric.params() for name, metric in METRICS.items() if name not in self.sections}
        object.__setattr__(self, "sections", defaults | checked_sections(self.sections))
        gps = self.gps
        if (gps.bounds or self.heights.height_samples) and not gps.keeps_times(len(gps.utc_times or (None,))):
            raise InputError(
                "[gps] bounds and [buildings] height_samples need the maps of every time: give fewer times, or set "
                "[gps] series = 'epochs'"
            )
        if gps.bounds and self.oversample % 2 == 0:
            raise InputError(f"[gps] bounds need an odd oversample, got {self.oversample}: use 3 or 5")

    def of(self, name: str) -> Any:
        """Return the settings of a metric."""
        return self.sections[name] if name in self.sections else known_metrics()[name].params()

    @property
    def gps(self) -> Gps:
        """The settings of satellites."""
        return self.sections.get("gps") or Gps()

    @property
    def population(self) -> Population:
        """The settings of people."""
        return self.sections.get("population") or Population()


@dataclass(frozen=True, eq=False)
class MapTask:
    """What the maps of a region depend on, and nothing of who makes them, in how many tiles, or where they go.

    Attributes:
      city: what stands and who lives there.
      region: grid of the maps.
      sky: times and satellites.
      params: settings.
      layers: cost layers of one's own, by name.
      bands: values of the layers that are not functions, by name: one band, or one for each of the layer's
        ``altitudes_m``; rasters, or arrays on the region's cells (see `jaxurban.io.read.rasterise.bands_of`).
      guesses: behind the maps (see `jaxurban.io.read.guesses`), for those who look at them.

    Raises:
      InputError: bounds of GPS under several clocks, or layers whose names would be those of maps of the spread.
    """

    city: City
    region: Grid
    sky: Sky
    params: MapParams
    layers: Mapping[str, Layer] = field(default_factory=dict)
    bands: Mapping[str, tuple[Raster | np.ndarray, ...]] = field(default_factory=dict)
    guesses: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.params.gps.bounds and self.in_view(0).clocks is not None:
            raise InputError(
                "bounds of m_gps hold for one clock: with several, a first satellite of the first system may raise "
                "GDOP. Set [gps] clocks = 'one', or give the orbits of one system"
            )
        spreads = {each for name in self.spread_metrics for each in derived(self.metrics[name])["spread"]}
        if taken := spreads & {*self.layers}:
            raise InputError(f"a layer cannot be called {min(taken)!r}, a map of the spread: give it another name")

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """The metrics that the maps are of: the built-in ones that there are data for, then one's own by name."""
        made = metrics_of(self.params.sections, self.layers, has_people=self.city.blocks is not None)
        return {name: metric.under(self.settings_of(metric)) for name, metric in made.items()}

    def settings_of(self, metric: Metric) -> Any:
        """Return the settings of a metric."""
        return self.layers[metric.name] if metric.name in self.layers else self.params.of(metric.name)

    @property
    def spread_metrics(self) -> tuple[str, ...]:
        """Names of the metrics whose spread by uncertain heights is computed: those that buildings decide."""
        if not self.params.heights.height_samples:
            return ()
        return tuple(name for name, m in self.metrics.items() if ALTITUDE in m.dims and name not in self.bands)

    @property
    def reach_m(self) -> float:
        """How far beyond its own cell any metric looks sideways."""
        return max(metric.reach_m(self.settings_of(metric)) for metric in self.metrics.values())

    @property
    def sizes(self) -> dict[str, int]:
        """How many values each dim of the metrics has."""
        times_of_day = len(self.params.population.times_of_day)
        return {TIME: self.num_times, ALTITUDE: len(self.params.altitudes_m), TIME_OF_DAY: times_of_day}

    @property
    def num_times(self) -> int:
        """How many times the sky has."""
        return len(self.sky.times)

    @property
    def keeps_times(self) -> bool:
        """Whether the GPS maps of every time are kept, not statistics over them."""
        return self.params.gps.keeps_times(self.num_times)

    @property
    def has_terrain(self) -> bool:
        """Whether the ground is not flat."""
        return self.city.terrain is not None

    @cached_property
    def population(self) -> BlockLayers | None:
        """The population of every block, normalised over the region; None without population data."""
        if self.city.blocks is None:
            return None
        return block_layers(self.city.blocks, self.params.population, self.region.bounds_m)

    @property
    def all_guesses(self) -> Guesses:
        """Every guess behind the maps."""
        of_sky = self.city, self.region, self.sky, min(self.params.altitudes_m)
        return region_guesses(*of_sky, self.bands, self.params.population, self.population)

    @cached_property
    def has_guessed_roofs(self) -> bool:
        """Whether maps tell roofs of guessed height apart: the region has any."""
        return has_guessed_roofs(self.city, self.region)

    def in_view(self, time_index: int) -> InView:
        """Return the satellites in view at a time, and their receiver clocks as the settings of GPS have them."""
        in_view = self.sky.in_view(time_index)
        return in_view._replace(clocks=None) if self.params.gps.clocks == "one" else in_view

    def with_margin(self, part: Grid | None = None, highest_m: float | None = None) -> Grid:
        """Return a grid grown by the margin that its metrics need.

        Args:
          part: of the region; left out, all of it.
          highest_m: how far the highest roof can stand above the lowest ground; left out, the city's.
        """
        part = self.region if part is None else part
        toward_m = shadow_reach_m(
            self.sky.azimuth_rad[self.sky.is_in_view],
            self.sky.elevation_rad[self.sky.is_in_view],
            highest_top_m(self.city) if highest_m is None else highest_m,
            float(min(self.params.altitudes_m)),
            part.resolution_m,
        )
        return surface_grid(self.city, part, self.reach_m, toward_m)

    def with_halo(self, part: Grid) -> Grid:
        """Return a grid grown by the cells around it that metrics look at; shadows come from farther."""
        halo = math.ceil(self.reach_m / part.resolution_m)
        return part.padded(halo, halo, halo, halo)

    def surface(self) -> Surface:
        """Return the city's rasters on the region and its margin."""
        return build_surface(
            self.city, self.region, self.with_margin(), self.params.heights.all_touched, self.has_guessed_roofs
        )
