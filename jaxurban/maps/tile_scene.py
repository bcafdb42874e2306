"""TileScene: a tile of a task, and what its metrics may use of it, place by place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxurban.io.city import City
from jaxurban.io.rasterise import build_surface, layer_values
from jaxurban.kernels.shadows.sweep import Ring
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY, Metric, Scene
from jaxurban.metrics.custom import LAYERS
from jaxurban.metrics.population import BlockLayers
from jaxurban.metrics.visibility import shadows_over, visibility
from jaxurban.world.sky import InView
from jaxurban.world.surface import Surface, obstacles_on


@dataclass(frozen=True, eq=False)
class TileScene:
    """A tile of a task, ready for its maps; the whole region is one too.

    Attributes:
      task: what the maps are made of.
      surface: roofs, terrain and blocks of the tile (``surface.region``) and of what its metrics look at around it.
      rings: the shadows that the tiles around hand on, by time and satellite; None where the surface itself holds all
        roofs that can shadow the tile.
      of_device: the metrics that a device has made; the host makes all others.
      made: their maps, as `jaxurban.maps.at_once.region_maps` gives them.
    """

    task: MapTask
    surface: Surface
    rings: Mapping[tuple[int, int], Ring] | None = None
    of_device: Sequence[Metric] = ()
    made: Mapping[str, np.ndarray] = field(default_factory=dict)
    _words: dict[int, np.ndarray] = field(default_factory=dict, init=False, repr=False)
    _surfaces: dict[float, tuple[Surface, Surface | None]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def is_obstacle(self) -> np.ndarray:
        """``[A, y, x]`` bool: a roof reaches the altitude, or it lies in a slab."""
        return obstacles_on(self.surface, self.task.params.altitudes_m)

    @cached_property
    def has_data(self) -> np.ndarray | None:
        """``[y, x]`` bool: something is known of the cell; None where it is of all."""
        has_data = self.surface.has_data
        return None if has_data is None else np.asarray(self.surface.crop(has_data))

    @cached_property
    def supersampled(self) -> Surface | None:
        """The surface ``oversample`` times finer that rays see; None where that is the tile's own."""
        return self.finer(self.task.city) if self.task.params.oversample > 1 else None

    def finer(self, city: City, all_touched: bool = False) -> Surface:
        """Return a city on the tile and all that can shadow it, rasterised ``oversample`` times finer.

        Args:
          city: usually the task's.
          all_touched: whether a roof covers every cell that it shares area with, not only those whose centre it covers.
        """
        n = self.task.params.oversample
        region = self.surface.region
        grid = self.task.with_margin(region)
        fine = build_surface(
            replace(city, blocks=None), region.refined(n), grid.refined(n), all_touched
        )
        return replace(fine, roof_touched_m=None)

    def surfaces_at(self, altitude_m: float) -> tuple[Surface, Surface | None]:
        """Return the surface at an altitude (`Surface.at_altitude`), and the supersampled one or, without one, None.

        The surfaces of the last altitude are kept, so that several metrics share them.
        """
        if altitude_m not in self._surfaces:
            fine = self.supersampled and self.supersampled.at_altitude(altitude_m)
            self._surfaces.clear()
            self._surfaces[altitude_m] = self.surface.at_altitude(altitude_m), fine
        return self._surfaces[altitude_m]

    def words(self, time_index: int) -> np.ndarray:
        """Return which satellites each cell sees at a time, ``[W, A, y, x]`` words as `visibility` makes them.

        The words of the last time are kept, so that several metrics share them.
        """
        if time_index not in self._words:
            in_view = self.task.in_view(time_index)
            params = self.task.params
            words = visibility(
                self.supersampled or self.surface,
                *in_view.angles,
                params.altitudes_m,
                self._rings_of(time_index, in_view),
                params.oversample,
            )
            self.keep(time_index, words)
        return self._words[time_index]

    def shadows(self, time_index: int) -> np.ndarray:
        """Return how high the shadows of the satellites of a time reach above the ground (`shadows_over`)."""
        in_view = self.task.in_view(time_index)
        return shadows_over(
            self.supersampled or self.surface,
            *in_view.angles,
            self._rings_of(time_index, in_view),
            self.task.params.oversample,
        )

    def _rings_of(self, time_index: int, in_view: InView) -> list[Ring] | None:
        """Return the rings of the satellites of a time; None where the surface holds all that shadows the tile."""
        if self.rings is None or self.supersampled is not None:
            return None
        return [self.rings[time_index, int(number)] for number in in_view.numbers]

    def keep(self, time_index: int, words: np.ndarray) -> None:
        """Keep visibility words for a time, which `words` then returns, and forget those of all other times."""
        self.forget()
        self._words[time_index] = words

    def forget(self) -> None:
        """Free the memory of the words that are kept."""
        self._words.clear()

    def at(self, metric: Metric, place: tuple[int, ...], only_m: bool = False) -> Scene:
        """Return what a metric may use at one place along its dims.

        Args:
          metric: the metric.
          place: index along each of its dims: of the time, of the altitude, of the time of day, as far as it has them.
          only_m: whether the metric need not make its further variables.
        """
        index = dict(zip(metric.dims, place, strict=True))
        task = self.task
        params = task.params
        scene = Scene(
            self.surface, oversample=params.oversample, only_m=only_m, engine=params.engine
        )

        # The people at the time of day.
        if TIME_OF_DAY in index:
            assert task.population is not None
            at_time = (values[index[TIME_OF_DAY]] for values in task.population)
            scene = replace(scene, population=BlockLayers(*at_time))

        # The surface at the altitude.
        a = index.get(ALTITUDE)
        if a is not None:
            surface, fine = self.surfaces_at(params.altitudes_m[a])
            scene = replace(
                scene,
                surface=surface,
                altitude_m=params.altitudes_m[a],
                is_obstacle=self.is_obstacle[a],
                supersampled=fine,
            )

        # The satellites at the time, and what a metric without an altitude sees of them.
        if TIME in index:
            t = index[TIME]
            shadows, words = (self.shadows(t), None) if a is None else (None, self.words(t)[:, a])
            scene = replace(scene, in_view=task.in_view(t), words=words, shadows=shadows)

        # The values of a user's raster or array.
        if metric.section == LAYERS and metric.name in task.bands:
            bands = task.bands[metric.name]
            values = layer_values(bands, self.surface.region, task.region, a)
            scene = replace(scene, rasters={metric.name: values})
        return scene
