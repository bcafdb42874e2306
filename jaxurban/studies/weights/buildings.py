"""Which buildings cost a route most: the gradient of its cost by every building's height, as a ranked table."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import shapely

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.maps.differentiable import PathVisits, SoftCity, SoftParams, path_visits
from jaxurban.metrics.base import TIME_OF_DAY
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.weights import Weights, WeightsLike, check_held
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.cost import CostModel
from jaxurban.programs import kept_jit
from jaxurban.world.footprints import HeightOrigin


def _visits(soft: SoftCity, planned: PlannedPath, params: SoftParams) -> PathVisits:
    """Return which cells of a soft city's region the cost of a route counts, and how often.

    Args:
      soft: the soft city.
      planned: the route.
      params: give the altitude of the soft maps.

    Raises:
      InputError: there is no route, it climbs, or it was planned on another grid, altitude or time of day.
    """
    region = soft.surface.region
    if not planned.status.has_path:
        raise InputError(
            "there is no route, so no building costs it anything: plan one that reaches its goal"
        )
    if len(planned.z_m) and np.ptp(planned.z_m) > 0:
        raise InputError(
            "the route changes its altitude and a soft city has one: plan it at that altitude"
        )

    # Both must be of one grid and one altitude, which is compared to the millimetre.
    of_route = planned.crs, planned.settings["resolution_m"], round(planned.altitude_m, 3)
    of_soft = region.crs, region.resolution_m, round(float(np.asarray(params.altitude_m)), 3)
    if of_route != of_soft:
        raise InputError(
            "the route and the soft city must have one CRS, cell size and altitude, got "
            f"{', '.join(map(str, of_route))} m and {', '.join(map(str, of_soft))} m: make both from the same maps"
        )

    # People differ by time of day.
    time_of_day = planned.settings["time_of_day"]
    if soft.population is not None and time_of_day is not None and time_of_day != soft.time_of_day:
        raise InputError(
            f"the route was planned by {time_of_day} and the soft city is of {soft.time_of_day}: give soft_city "
            f"time_of_day={time_of_day!r}"
        )

    # The cells of the route, whose points are now in metres from the region's southwest corner.
    points_m = planned.xy_m - region.bounds_m[:2]
    model = CostModel.from_settings(planned.settings)
    return path_visits(points_m, region.shape, region.resolution_m, model)


@typed
def building_costs(
    city: City,
    soft: SoftCity,
    planned: PlannedPath,
    params: SoftParams,
    weights: WeightsLike = None,
) -> pd.DataFrame:
    """Return what one more metre of each building's height costs a route, the costliest building first.

    The route stays where it is: for an optimal route this is also the gradient of the optimal cost, as long as no other
    route becomes cheaper; for any other planner's route it is the gradient of that route's cost. Costs are those of the
    soft maps, whose softness says over how many metres a roof fades: the exact cost
    changes by jumps, when a shadow's edge or a lidar beam passes a cell of the route.

    Only buildings with any effect are listed; a negative one means that more height helps (walls are landmarks for the
    lidar). People do not depend on heights.

    Args:
      city: from which ``soft`` was made.
      soft: from `jaxurban.grad.soft_city`, at the route's resolution, time and time of day.
      planned: the route.
      params: altitude and softness, and the metrics' settings.
      weights: left out, the ones that the route was planned under.

    Returns:
      A table by ``rank`` of ``building`` (its number in the city), ``per_metre`` (cost per metre of height) and its
      parts ``gps``, ``lidar``, ``risk`` and a user's own soft layers; ``height_m``, ``origin`` of the height, ``lon``,
      ``lat`` of a point inside, ``distance_m`` from the route to its outline. ``attrs``: the route's ``cost`` on exact
      maps, its ``soft_cost``, ``softness_m``.

    Raises:
      InputError: there is no route, it lies on another grid, altitude or time of day, or it climbs.

    Examples:
      >>> params = ju.grad.SoftParams(altitude_m=60.0)
      >>> soft = ju.grad.soft_city(city, maps.grid, params)
      >>> table = ju.studies.building_costs(city, soft, path, params)
      >>> table[["building", "per_metre", "height_m", "origin"]].head(1).round(4)
            building  per_metre  height_m     origin
      rank
      1          101      0.084      96.9  generated
    """
    # [B] gradients of all buildings, by layer and in sum; the listed ones are numbers of buildings, in their order.
    assert city.buildings is not None
    visits = _visits(soft, planned, params)
    named = weights
    if named is None:  # those of the route; 0 for metrics that its maps did not hold
        weights = Weights(**dict.fromkeys(METRICS, 0.0) | planned.settings["weights"])
    else:
        weights = Weights.of(named).checked(soft.names)
    check_held(named, soft.names)
    slopes, soft_cost = _slopes(soft, params, weights, visits)
    parts = pd.DataFrame({name: np.asarray(slope, np.float64) for name, slope in slopes.items()})
    per_metre = np.sum([parts[name] for name in parts], axis=0)
    listed = np.flatnonzero((parts != 0).any(axis=1))
    listed = listed[np.argsort(-per_metre[listed], kind="stable")]

    # Where the listed buildings are; a route of one point is a line of no length.
    buildings = city.buildings.take(listed)
    inside = shapely.point_on_surface(buildings.polygons)
    lon, lat = soft.surface.region.lonlat_of_xy(shapely.get_x(inside), shapely.get_y(inside))
    points = planned.xy_m if len(planned.xy_m) > 1 else np.repeat(planned.xy_m, 2, axis=0)
    table = pd.DataFrame(
        {
            "building": listed,
            "per_metre": per_metre[listed],
            **{name: parts[name].to_numpy()[listed] for name in slopes},
            "height_m": buildings.height_m,
            "origin": [HeightOrigin(origin).name.lower() for origin in buildings.origin],
            "lon": lon,
            "lat": lat,
            "distance_m": shapely.distance(buildings.polygons, shapely.LineString(points)),
        },
        index=pd.RangeIndex(1, len(listed) + 1, name="rank"),
    )
    table.attrs = {
        "cost": planned.cost,
        "soft_cost": float(soft_cost),
        "softness_m": float(np.asarray(params.softness_m)),
    }
    return table


@kept_jit
def _slopes(
    soft: SoftCity, params: SoftParams, weights: Weights, visits: PathVisits
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Return by layer the gradient ``[B]`` of its part of the cost by the buildings' heights, and the whole soft cost.

    Layers that do not depend on heights have no gradient, and count in the cost only.

    Args:
      soft: the soft city, whose heights vary.
      params: altitude, softness and the metrics' settings.
      weights: of distance and layers.
      visits: cells of the route, how often each counts, and the route's length.
    """

    def part(name: str, height_m: jax.Array) -> jax.Array:
        """Return the part of the cost that a layer has, where buildings are ``[B]`` metres high."""
        return weights[name] * (soft.layer(name, height_m, params, visits.cells) @ visits.times)

    # Layers that vary with the time of day are of people, who do not depend on heights.
    by_height = [name for name, metric in soft.metrics.items() if TIME_OF_DAY not in metric.dims]
    parts = {name: jax.value_and_grad(partial(part, name))(soft.height_m) for name in by_height}
    cost = weights.distance * visits.length_m + sum(value for value, _ in parts.values())
    cost += sum(part(name, soft.height_m) for name in soft.names if name not in by_height)
    return {name: slope for name, (_, slope) in parts.items()}, jnp.asarray(cost)
