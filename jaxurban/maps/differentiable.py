"""SoftCity: a city's cost layers, and a path's cost, as one differentiable function of heights and parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float, Int

from jaxurban.checks import one_of, typed
from jaxurban.errors import GuessWarning, InputError, warn
from jaxurban.io.city import City
from jaxurban.io.rasterise import building_index
from jaxurban.maps.build import check_region, view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.base import Metric, SoftScene
from jaxurban.metrics.custom import Layer, check_layers, metrics_of
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.population import BlockPopulation
from jaxurban.metrics.reception import ReceptionCurve
from jaxurban.metrics.registry import METRICS, checked_sections
from jaxurban.metrics.visibility import SkyView
from jaxurban.metrics.weights import Weights
from jaxurban.planners.base import Problem
from jaxurban.planners.cost import CostModel
from jaxurban.progress import reporting
from jaxurban.public import FactsRepr
from jaxurban.settings import SLABS, TO_GROUND, Heights
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface

# Visited cells are filled up to a multiple of it, so that programs meet few shapes.
CELLS_STEP = 256


@jax.tree_util.register_dataclass
@typed
@dataclass(frozen=True)
class SoftParams:
    """What soft layers depend on besides the city. A pytree; every leaf can be traced and differentiated by.

    Attributes:
      altitude_m: of flight, above ground.
      softness_m: of all metrics (see `jaxurban.maps.differentiable`); above 0 for gradients by heights and altitude.
      reception: measured chance that a receiver hears a satellite, by which the layers of GPS weight satellites near a
        roof's edge instead of by the softness, such as `ReceptionCurve.measured_in_tokyo`. Left out, the softness.
      sections: settings of metrics, by name; the others have their defaults, and of those made on request the named
        ones are there. Their leaves are the GDOP threshold, the lidar's range, d_thresh, both gammas ...

    Raises:
      InputError: sections of no metric.

    Examples:
      >>> params = ju.grad.SoftParams(altitude_m=60.0, sections={"risk": ju.Risk(threshold_m=30.0)})
      >>> params.softness_m, params.sections["risk"].threshold_m
      (2.0, 30.0)
    """

    altitude_m: Float[Array, ""] | float
    softness_m: Float[Array, ""] | float = 2.0
    sections: dict[str, Any] = field(default_factory=dict)
    reception: ReceptionCurve | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "sections", checked_sections(self.sections))

    def settings_of(self, metric: Metric) -> Any:
        """Return the settings of a metric.

        Returns:
          The section of that metric, its defaults where ``sections`` name none.

        Examples:
          >>> params = ju.grad.SoftParams(altitude_m=60.0, sections={"risk": ju.Risk(threshold_m=30.0)})
          >>> params.settings_of(maps.metrics["risk"])
          Risk(threshold_m=30.0, distance='slice')
        """
        return self.sections.get(metric.section) or metric.params()


class PathVisits(NamedTuple):
    """How often a fixed path visits each cell. ``P`` cells, the last of them visited 0 times to round P up.

    Attributes:
      cells: ``[P, 2]`` row and column.
      times: ``[P]`` how often each cell's cost counts (`jaxurban.planners.cost.PathFeatures.visits`).
      length_m: of the path.
    """

    cells: Int[Array, "P 2"]
    times: Float[Array, " P"]
    length_m: Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, repr=False)
class SoftCity(FactsRepr):
    """A city and a sky, made ready on the host by `soft_city`; a pytree: one program serves all of the same shapes.

    Attributes:
      surface: roofs, terrain and blocks; the type of its roofs is that of the layers (float64 under
        ``jax.enable_x64(True)``).
      building: ``[Y, X]`` the highest building over each cell (`jaxurban.io.rasterise.building_index`); cells that
        a structure or a plant tops do not change with its height.
      height_m: ``[B]`` the buildings' own heights.
      view: the satellites.
      population: of the census blocks; None without population.
      time_of_day: of the population.
      reach_m: how far each metric looks at most, by name: the largest range and threshold of the parameters. Left
        out, those of the default settings.
      own: cost layers that a user added, name and settings.
      built_m: ``[B]`` heights of which the surface was made, where others than buildings stand; else None.

    Examples:
      >>> params = ju.grad.SoftParams(altitude_m=60.0)
      >>> soft = ju.grad.soft_city(city, maps.grid, params)
      >>> soft.names, soft.height_m.shape
      (('gps', 'lidar', 'population', 'risk'), (117,))
    """

    surface: Surface
    building: Int[Array, "Y X"]
    height_m: Float[Array, " B"]
    view: SkyView
    population: BlockPopulation | None = None
    time_of_day: str = field(default="day", metadata={"static": True})
    reach_m: tuple[tuple[str, float], ...] = field(
        default=tuple((name, metric.reach_m(metric.params())) for name, metric in METRICS.items()),
        metadata={"static": True},
    )
    own: tuple[tuple[str, Layer], ...] = field(default=(), metadata={"static": True})
    built_m: Float[Array, " B"] | None = None

    @property
    def facts(self) -> dict[str, str]:
        """How many cells and buildings there are, and the layers."""
        what = f"{self.building.shape} cells, {len(self.height_m):,} buildings"
        return {"city": what, "layers": ", ".join(self.names)}

    @property
    def metrics(self) -> dict[str, Metric]:
        """The metrics that have a soft form, by name, in the order of the layers: as in maps, a user's own last."""
        own = dict(self.own)
        built_in = [name for name, _ in self.reach_m if name not in own]
        made = metrics_of(built_in, own, has_people=self.population is not None)
        return {name: metric for name, metric in made.items() if metric.soft is not None}

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the `metrics`."""
        return tuple(self.metrics)

    def layer(
        self,
        name: str,
        height_m: Float[Array, " B"],
        params: SoftParams,
        cells: Int[Array, "P 2"] | None = None,
    ) -> Float[Array, "y x"] | Float[Array, " P"]:
        """Return one of the `layers`, by the name of its metric.

        Args:
          name: of the metric.
          height_m, params, cells: as for `layers`.

        Returns:
          The layer's cost c, 0 to 1: ``[y, x]``, or ``[P]`` where cells are chosen.

        Raises:
          InputError: a metric that this city does not hold.

        Examples:
          >>> params = ju.grad.SoftParams(altitude_m=60.0)
          >>> soft = ju.grad.soft_city(city, maps.grid, params)
          >>> cells = np.array([[2, 2], [17, 15]])  # row, column
          >>> soft.layer("risk", soft.height_m, params, cells).shape
          (2,)
        """
        metric = self.metrics[one_of("the metric of a soft layer", name, self.names)]
        assert metric.soft is not None
        settings = dict(self.own).get(name) or params.settings_of(metric)
        scene = SoftScene(
            surface=self.surface.with_heights(height_m, self.building, self.built_m),
            altitude_m=params.altitude_m,
            softness_m=params.softness_m,
            cells=cells,
            reach_m=dict(self.reach_m)[name],
            view=self.view,
            population=self.population,
            time_of_day=self.time_of_day,
            reception=params.reception,
        )
        m = metric.soft(scene, settings)
        return jnp.asarray(metric.cost(m), height_m.dtype)

    def layers(
        self,
        height_m: Float[Array, " B"],
        params: SoftParams,
        cells: Int[Array, "P 2"] | None = None,
    ) -> Float[Array, "L y x"] | Float[Array, "L P"]:
        """Return the soft cost layers c_j, not weighted, on the region ``[L, y, x]`` or at chosen cells ``[L, P]``.

        Differentiable in ``height_m`` and every leaf of ``params``. Runs under `jax.jit` and `jax.vmap`, with no new
        program for other values. The layers do not say where nobody may fly: obstacles are a constraint of the
        planner, not a cost.

        Args:
          height_m: ``[B]`` building heights, such as `height_m` of this city.
          params: parameters of the metrics.
          cells: ``[P, 2]`` row and column in the region; left out, the whole region. For the cost of a path its own
            cells suffice, which is cheaper by far.

        Returns:
          The layers in the order of `names`, each 0 to 1.

        Raises:
          InputError: a value known to be wrong, such as a negative softness.

        Examples:
          >>> params = ju.grad.SoftParams(altitude_m=60.0)
          >>> soft = ju.grad.soft_city(city, maps.grid, params)
          >>> cells = np.array([[2, 2], [17, 15]])  # row, column
          >>> soft.layers(soft.height_m, params, cells).shape
          (4, 2)
        """
        with reporting("soft") as report:
            names = report.over("layers", self.names)
            layers = [self.layer(name, height_m, params, cells) for name in names]
        return jnp.stack(layers)

    def layer_weights(self, weights: Weights) -> Float[Array, " L"]:
        """Return the weight of each layer.

        Returns:
          The weights, ``[L]``, in the order of `names` and in the type of ``height_m``; the distance is not among them.

        Examples:
          >>> params = ju.grad.SoftParams(altitude_m=60.0)
          >>> soft = ju.grad.soft_city(city, maps.grid, params)
          >>> soft.layer_weights(ju.Weights(risk=5.0)).tolist()
          [1.0, 1.0, 1.0, 5.0]
        """
        return jnp.stack([jnp.asarray(weights[name], self.height_m.dtype) for name in self.names])

    def cost_by_layer(
        self, height_m: Float[Array, " B"], params: SoftParams, weights: Weights, visits: PathVisits
    ) -> Float[Array, " L"]:
        """Return the cost of a fixed path by layer, weights included; differentiable in all but the path.

        Args:
          height_m, params: as for `layers`.
          weights: of the layers.
          visits: from `path_visits`.

        Returns:
          The costs, ``[L]``, in the order of `names`; that of the distance is not among them.

        Examples:
          >>> from jaxurban.maps.differentiable import path_visits
          >>> params = ju.grad.SoftParams(altitude_m=60.0)
          >>> soft = ju.grad.soft_city(city, maps.grid, params)
          >>> points_m = path.xy_m - np.array(maps.grid.bounds_m[:2])
          >>> visits = path_visits(points_m, maps.grid.shape, maps.grid.resolution_m, ju.CostModel())
          >>> by_layer = soft.cost_by_layer(soft.height_m, params, ju.Weights(), visits)
          >>> dict(zip(soft.names, by_layer.round().tolist()))
          {'gps': 20.0, 'lidar': 166.0, 'population': 12.0, 'risk': 0.0}
        """
        layers = self.layers(height_m, params, visits.cells)
        return self.layer_weights(weights) * (layers @ visits.times)

    def path_cost(
        self, height_m: Float[Array, " B"], params: SoftParams, weights: Weights, visits: PathVisits
    ) -> Float[Array, ""]:
        """Return the cost of a fixed path on the soft layers; only its own cells are computed.

        Its gradient by heights, parameters and weights is that of this path's cost. Where the path is the only optimal
        one on these layers, it is that of **the optimal cost** too (the envelope theorem, see
        `jaxurban.planners.envelope.planned_cost`).

        Args:
          height_m, params, weights, visits: as for `cost_by_layer`.

        Returns:
          The cost, a scalar, that of the distance included.

        Examples:
          >>> from jaxurban.maps.differentiable import path_visits
          >>> params = ju.grad.SoftParams(altitude_m=60.0)
          >>> soft = ju.grad.soft_city(city, maps.grid, params)
          >>> points_m = path.xy_m - np.array(maps.grid.bounds_m[:2])
          >>> visits = path_visits(points_m, maps.grid.shape, maps.grid.resolution_m, ju.CostModel())
          >>> round(float(soft.path_cost(soft.height_m, params, ju.Weights(), visits)))
          283
        """
        by_layer = self.cost_by_layer(height_m, params, weights, visits)
        return weights.distance * visits.length_m + by_layer.sum()


def path_visits(
    points_m: np.ndarray,
    shape: tuple[int, int],
    resolution_m: float,
    cost_model: CostModel,
) -> PathVisits:
    """Return how often a path visits each cell, computed on the host.

    The cells are as many as a multiple of `CELLS_STEP`: the last one is repeated with 0 visits.

    Args:
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner, on the map.
      shape: rows and columns of the map.
      resolution_m: side of a cell.
      cost_model: decides how a cell's visits count, see `jaxurban.planners.base.Problem`.

    Raises:
      InputError: points that are not a path.
    """
    # A query without layers, on free cells: of its start, goal and altitude nothing is used.
    query = Problem(
        np.zeros((0, *shape)), np.ones(shape, bool), (0, 0), (0, 0), resolution_m, 0.0, cost_model
    )
    counts = query.features(points_m).visits
    cells = np.argwhere(counts > 0)
    times = counts[tuple(cells.T)]
    padding = 0, -len(cells) % CELLS_STEP
    times = np.pad(times, padding)
    if len(cells):
        cells = np.pad(cells, (padding, (0, 0)), mode="edge")
    length_m = np.hypot(*np.diff(points_m, axis=0).T).sum()
    return PathVisits(jnp.asarray(cells, jnp.int32), jnp.asarray(times), jnp.asarray(length_m))


@typed
def soft_city(
    city: City, grid: Grid, params: SoftParams, *, layers: Mapping[str, Layer] | None = None
) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers on the cells of a grid.

    The layers are float32, or float64 under ``jax.enable_x64(True)``.

    Args:
      city: with outlines.
      grid: of the layers, such as that of maps.
      params: as the maps will have them; of several times and times of day the first ones count. Where they name no
        satellites, those are in view that the city was read with. Their ranges and thresholds, their altitude and the
        city's highest roof limit how far the layers look: parameters that are given to the layers later may not exceed
        them.
      layers: further cost layers, by name; those that are functions with a soft form take part.

    Returns:
      The soft city, whose ``layers`` and ``path_cost`` JAX can differentiate.

    Raises:
      InputError: a grid that does not fit the city, a city whose roofs are a height raster, or unreadable or stale
        orbits.

    Examples:
      >>> params = ju.grad.SoftParams(altitude_m=60.0)
      >>> soft = ju.grad.soft_city(city, maps.grid, params)
      >>> soft.names
      ('gps', 'lidar', 'population', 'risk')
    """
    check_region(city, grid)
    heights = replace(city.heights or Heights(), height_samples=0)
    sections = dict(params.sections)
    gps = sections.get("gps")
    if gps and city.gps and replace(gps, gdop_threshold=Gps.gdop_threshold) == Gps():
        sections["gps"] = replace(city.gps, gdop_threshold=gps.gdop_threshold)
    settings = MapParams((float(params.altitude_m),), heights=heights, sections=sections)
    task = MapTask(city, grid, view_sky(grid, settings.gps), settings, check_layers(layers))
    return soften(task, dtype=jax.dtypes.canonicalize_dtype(np.float64))


def soften(
    task: MapTask,
    *,
    time_index: int = 0,
    time_of_day: str | None = None,
    dtype: DTypeLike = np.float32,
) -> SoftCity:
    """Return a city made ready for soft, differentiable cost layers on the cells of its region, never supersampled.

    In the layers everything that hangs reaches the ground; for a city with slabs a warning says so.

    Args:
      task: a city with outlines, the grid of the layers, the sky, and settings. Their lidar range and risk threshold,
        their lowest altitude and the city's highest roof limit how far the layers look: parameters that are given to
        the layers later may not exceed them.
      time_index: which of the sky's times.
      time_of_day: of the population; left out, the first of the settings.
      dtype: float32, or float64 under ``jax.enable_x64(True)``.

    Raises:
      InputError: a city whose roofs are a height raster, or no such time.
    """
    if task.city.hanging == SLABS:
        warn(
            "soft layers know no slabs: in them, and in their gradients, everything that hangs reaches the ground",
            GuessWarning,
        )
        task = replace(task, city=replace(task.city, hanging=TO_GROUND))
    if not 0 <= time_index < task.num_times:
        raise InputError(
            f"time_index must be 0 to {task.num_times - 1}, one of the sky's times, got {time_index}"
        )

    # What has the roof of each cell.
    city = task.city
    params = task.params
    in_view = task.in_view(time_index)
    building = building_index(city, task.with_margin())
    assert city.buildings is not None

    # The rasters and the people in the type of the layers, and how far each metric looks.
    surface = task.surface().of_jax()
    rasters = {**surface.roofs, "terrain_m": surface.terrain_m}
    in_dtype = jax.tree.map(lambda values: jnp.asarray(values, dtype), rasters)
    surface = replace(surface, **in_dtype)
    population = None
    if city.blocks is not None:
        population = BlockPopulation.of(city.blocks, task.region.bounds_m, dtype)
    reach_m = {
        name: metric.reach_m(task.settings_of(metric)) for name, metric in task.metrics.items()
    }
    height_m = jnp.asarray(city.buildings.height_m, dtype)
    has_others = city.structures is not None or city.plants is not None
    return SoftCity(
        surface=surface,
        building=jnp.asarray(building),
        height_m=height_m,
        built_m=height_m if has_others else None,
        view=SkyView.of(surface, *in_view.angles, clocks=in_view.clocks),
        population=population,
        time_of_day=time_of_day or params.population.times_of_day[0],
        reach_m=tuple(reach_m.items()),
        own=tuple(task.layers.items()),
    )
