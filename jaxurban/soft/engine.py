"""SoftCity: a city's cost layers, and a path's cost, as one differentiable function of heights and parameters."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxurban.cost import METRICS, Weights, metric_cost
from jaxurban.metrics.gps import GpsParams
from jaxurban.metrics.lidar import LidarParams
from jaxurban.metrics.population import PopulationParams
from jaxurban.metrics.risk import RiskParams
from jaxurban.planners.base import CostModel, Problem
from jaxurban.planners.evaluate import charge_map
from jaxurban.soft.gps import GpsView, soft_gps
from jaxurban.soft.lidar import soft_lidar
from jaxurban.soft.population import People, soft_population
from jaxurban.soft.risk import soft_risk
from jaxurban.surface import Surface

CELLS_STEP = 256  # charged cells are filled up to a multiple of it, so that programs meet few shapes


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SoftParams:
    """What soft layers depend on besides the city. A pytree; every leaf can be traced and differentiated by.

    Attributes:
      altitude_m: of flight, above ground.
      softness_m: of all metrics (see `jaxurban.soft`); above 0 for gradients by heights and altitude.
      gps, lidar, risk, population: settings of each metric; their leaves are the GDOP threshold, the lidar's range,
        d_thresh, and both gammas.
    """

    altitude_m: Float[Array, ""] | float
    softness_m: Float[Array, ""] | float = 2.0
    gps: GpsParams = field(default_factory=GpsParams)
    lidar: LidarParams = field(default_factory=LidarParams)
    risk: RiskParams = field(default_factory=RiskParams)
    population: PopulationParams = field(default_factory=PopulationParams)


class PathCharges(NamedTuple):
    """What a fixed path is charged. ``P`` cells; those that fill up are charged 0 times.

    Attributes:
      cells: ``[P, 2]`` row and column.
      times: ``[P]`` how often each cell's cost is paid (see `jaxurban.planners.evaluate.charge_map`).
      length_m: of the path.
    """

    cells: Int[Array, "P 2"]
    times: Float[Array, " P"]
    length_m: Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SoftCity:
    """A city and a sky, made ready on the host; a pytree, so that one program serves all of the same shapes.

    Attributes:
      surface: roofs, terrain and blocks; the type of its roofs is that of the layers (float64 under
        ``jax.enable_x64(True)``).
      building: ``[Y, X]`` which building has the roof of each cell (`jaxurban.io.rasterise.building_index`).
      height_m: ``[B]`` the buildings' own heights.
      view: the satellites.
      people: of the census blocks; None without population.
      time_of_day: of the population.
      lidar_reach_m, risk_reach_m: how far is looked: the largest range and threshold that may be asked for.
    """

    surface: Surface
    building: Int[Array, "Y X"]
    height_m: Float[Array, " B"]
    view: GpsView
    people: People | None = None
    time_of_day: str = field(default="day", metadata={"static": True})
    lidar_reach_m: float = field(default=100.0, metadata={"static": True})
    risk_reach_m: float = field(default=50.0, metadata={"static": True})

    @property
    def names(self) -> tuple[str, ...]:
        """The metrics of the layers, in the paper's order."""
        return tuple(name for name in METRICS if name != "population" or self.people is not None)

    def layer(
        self, name: str, height_m: Float[Array, " B"], params: SoftParams, cells: Int[Array, "P 2"] | None = None
    ) -> Float[Array, "y x"] | Float[Array, " P"]:
        """Return one of the `layers`, by its metric's name."""
        surface = self.surface.with_heights(height_m, self.building)
        height, softness = params.altitude_m, params.softness_m
        if name == "gps":
            m = soft_gps(surface, height, params.gps, softness, self.view, cells=cells)
        elif name == "lidar":
            m = soft_lidar(surface, height, params.lidar, softness, cells=cells, reach_m=self.lidar_reach_m)
        elif name == "risk":
            m = soft_risk(surface, height, params.risk, softness, cells=cells, reach_m=self.risk_reach_m)
        else:
            assert self.people is not None
            assert surface.block is not None
            m = soft_population(surface.block, self.people, self.time_of_day, params.population, cells=cells)
        return jnp.asarray(metric_cost(name, m), height_m.dtype)

    def layers(
        self, height_m: Float[Array, " B"], params: SoftParams, cells: Int[Array, "P 2"] | None = None
    ) -> Float[Array, "L y x"] | Float[Array, "L P"]:
        """Return the soft cost layers c_j, not weighted, on the region ``[L, y, x]`` or at chosen cells ``[L, P]``.

        Differentiable in ``height_m`` and every leaf of ``params``, as each metric's page in docs/gradients says. Runs
        under `jax.jit` and `jax.vmap`, with no new program for other values. Where nobody may fly is not asked:
        obstacles are a constraint of the planner, not a cost.

        Args:
          height_m: ``[B]`` building heights, such as `height_m` of this city.
          params: parameters of the metrics.
          cells: row and column in the region; a path needs only its own, which is cheaper by far.

        Raises:
          InputError: a value known to be wrong, such as a negative softness.
        """
        return jnp.stack([self.layer(name, height_m, params, cells) for name in self.names])

    def layer_weights(self, weights: Weights) -> Float[Array, " L"]:
        """Return the weight of each layer."""
        return jnp.stack([jnp.asarray(getattr(weights, name), self.height_m.dtype) for name in self.names])

    def cost_by_layer(
        self, height_m: Float[Array, " B"], params: SoftParams, weights: Weights, charges: PathCharges
    ) -> Float[Array, " L"]:
        """Return what each layer charges a fixed path, weights included; differentiable in all but the path."""
        return self.layer_weights(weights) * (self.layers(height_m, params, charges.cells) @ charges.times)

    def path_cost(
        self, height_m: Float[Array, " B"], params: SoftParams, weights: Weights, charges: PathCharges
    ) -> Float[Array, ""]:
        """Return the cost of a fixed path on the soft layers; only its own cells are computed.

        Its gradient by heights, parameters and weights is that of **the optimal cost** where the path is the only
        optimal one on these layers (the envelope theorem, see `jaxurban.planners.envelope.planned_cost`), and of this
        path's cost anyhow.
        """
        by_layer = self.cost_by_layer(height_m, params, weights, charges)
        return weights.distance * charges.length_m + by_layer.sum()


def path_charges(
    points_m: np.ndarray,
    shape: tuple[int, int],
    resolution_m: float,
    cost_model: CostModel,
) -> PathCharges:
    """Return what a path is charged, on the host.

    Args:
      points_m: ``[N, 2]`` x, y in metres from the map's southwest corner, on the map.
      shape: rows and columns of the map.
      resolution_m: side of a cell.
      cost_model: see `jaxurban.planners.base.Problem`.

    Raises:
      InputError: points that are no path.
    """
    asked = Problem(np.zeros((1, *shape)), np.ones(shape, bool), (0, 0), (0, 0), resolution_m, 0.0, cost_model)
    charged = charge_map(asked, points_m)
    cells = np.argwhere(charged > 0)
    times = charged[tuple(cells.T)]
    padding = -len(cells) % CELLS_STEP
    return PathCharges(
        jnp.asarray(np.pad(cells, ((0, padding), (0, 0)), mode="edge" if len(cells) else "constant"), jnp.int32),
        jnp.asarray(np.pad(times, (0, padding))),
        jnp.asarray(np.hypot(*np.diff(points_m, axis=0).T).sum()),
    )
