"""Routes on maps made anew, with heights drawn as well as they are known, or other parameters of the metrics."""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxurban.errors import GuessWarning, InputError, at_least, positive, typed
from jaxurban.maps.build import compute_maps
from jaxurban.maps.height_uncertainty import perturbed_cities
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.task import MapTask
from jaxurban.planners.astar import astar
from jaxurban.studies.demonstrations import cells_of
from jaxurban.studies.montecarlo.trial import BAD_INPUT
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.sensitivity.routes import ROUTE_KEY, SensitivityStudySettings, query_of, row_of

HEIGHTS = "heights"
REMADE_KEY = ("changed", "at", *ROUTE_KEY)
SAME_SUMS = 1e-9  # relative: routes whose sums differ by less are one route


@typed
@dataclass(frozen=True)
class RemadeSettings:
    """Which maps are made anew.

    Attributes:
      num_heights: draws of all heights (see `jaxurban.maps.height_uncertainty`); 0: none.
      has_parameters: change each parameter of the metrics that is a number (thresholds, range, gammas).
      factors: times which each parameter is set.

    Raises:
      InputError: a negative count, or factors that are not positive or 1.
    """

    num_heights: int = 0
    has_parameters: bool = False
    factors: tuple[float, ...] = (0.5, 2.0)

    def __post_init__(self) -> None:
        at_least("num_heights", self.num_heights)
        for factor in self.factors:
            if positive("factors", factor) == 1:
                raise InputError("factors of parameters must not be 1, which changes nothing: give some such as 0.5, 2")
        if self.has_parameters and not self.factors:
            raise InputError("factors is empty: name at least one such as 2, or leave out the parameters")

    def __bool__(self) -> bool:
        return bool(self.num_heights or self.has_parameters)


@dataclass(frozen=True, eq=False)
class Remade:
    """What is changed in maps that are made anew.

    Attributes:
      changed: ``"heights"``, or a parameter as ``"lidar.range_m"``.
      at: number of the draw, or the factor of the parameter.
      task: what the maps are made of.
    """

    changed: str
    at: float
    task: MapTask

    def maps(self) -> MetricMaps:
        """Return the maps, made in memory."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GuessWarning)  # told when the nominal maps were made
            return compute_maps(self.task)


def parameters_of(task: MapTask) -> dict[str, float]:
    """Return every parameter of the metrics that is a number to differentiate by, as ``{"lidar.range_m": 100.0}``."""
    found: dict[str, float] = {}
    for name, metric in task.metrics.items():
        settings = task.settings_of(metric)
        if name not in task.layers and is_dataclass(settings):
            leaves, _ = jax.tree_util.tree_flatten_with_path(settings)
            found |= {f"{name}.{path[0].name}": float(value) for path, value in leaves if len(path) == 1}
    return found


def with_parameter(task: MapTask, parameter: str, value: float) -> MapTask:
    """Return a task with one parameter of its metrics (see `parameters_of`) set."""
    name, _, field = parameter.partition(".")
    settings: Any = replace(task.settings_of(task.metrics[name]), **{field: value})
    params = task.params
    is_held = name in {item.name for item in fields(params)}
    other = {name: settings} if is_held else {"others": {**params.others, name: settings}}
    return replace(task, params=replace(params, **other))


def remade_of(task: MapTask, settings: RemadeSettings, seed: int = 0) -> Iterator[Remade]:
    """Yield what is made anew of the maps of a task; the seed is that of the heights."""
    plain = replace(task, params=replace(task.params, height_samples=0, gps_bounds=False))
    cities = perturbed_cities(task.city, task.params.height_std, settings.num_heights, seed)
    for number, city in enumerate(cities):
        yield Remade(HEIGHTS, float(number), replace(plain, city=city))
    if settings.has_parameters:
        for parameter, value in parameters_of(plain).items():
            for factor in settings.factors:
                yield Remade(parameter, factor, with_parameter(plain, parameter, value * factor))


def num_remade(task: MapTask, settings: RemadeSettings) -> int:
    """Return how many `remade_of` yields."""
    num_parameters = len(parameters_of(task)) if settings.has_parameters else 0
    return settings.num_heights + num_parameters * len(settings.factors)


def remade_rows(
    nominal: MetricMaps, other: MetricMaps, instances: Sequence[Mapping[str, Any]], settings: SensitivityStudySettings
) -> Iterator[dict[str, Any]]:
    """Yield, for each route, how the cheapest one on other maps differs from that on the nominal maps.

    ``status``, both routes'; ``is_other``, whether they add up to something else on the nominal maps; ``overlap``, the
    share of the nominal route's cells that the other one shares; ``is_closed``, whether the other one crosses
    what is closed on the nominal maps, else ``regret``, how much dearer it is on them than the nominal route;
    ``nominal_is_closed`` and ``nominal_regret`` the same of the nominal route on the other maps.

    Args:
      nominal: the maps of the study.
      other: the same made anew.
      instances: on maps of one altitude and time each; neighbours share them.
      settings: of the study.
    """
    key, ons = None, []
    for instance in instances:
        now = instance["altitude_m"], instance["time"], instance["time_of_day"]
        if now != key:
            key, ons = now, [settings.cost_map(maps, *now) for maps in (nominal, other)]
        try:
            (one, weights), (two, _) = (query_of(on, instance) for on in ons)
        except InputError as error:
            yield row_of(instance, status=BAD_INPUT, note=str(error))
            continue
        yield row_of(instance, **_compared(one, two, weights))


def _compared(nominal: RouteQuery, other: RouteQuery, weights: np.ndarray) -> dict[str, Any]:
    paths = [astar(query.problem(weights)) for query in (nominal, other)]
    for path in paths:
        if not path.status.has_path:
            return {"status": path.status.value, "note": path.status.sentence}
    here, there = (path.points_m for path in paths)
    found: dict[str, Any] = {"status": paths[0].status.value}
    features = {}
    for name, query in (("nominal", nominal), ("other", other)):
        features[name] = [query.cost_map.problem.features(points_m) for points_m in (here, there)]
    (own, new), (kept, best) = features["nominal"], features["other"]
    found["is_other"] = float(not (new.is_valid and np.allclose(new.phi, own.phi, rtol=SAME_SUMS, atol=SAME_SUMS)))
    cells = [cells_of(points_m, nominal.cost_map.grid.resolution_m) for points_m in (here, there)]
    found["overlap"] = len(cells[0] & cells[1]) / len(cells[0])
    found["is_closed"], found["nominal_is_closed"] = float(not new.is_valid), float(not kept.is_valid)
    found["regret"] = _dearer(new.cost(weights), own.cost(weights))
    found["nominal_regret"] = _dearer(kept.cost(weights), best.cost(weights))
    return found


def _dearer(cost: float, best: float) -> float:
    """Return by which share a cost is above the best; NaN for a path that is closed."""
    return max(cost / best - 1, 0.0) if math.isfinite(cost) and best > 0 else math.nan
