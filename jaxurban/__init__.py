"""jaxurban: urban metric maps for small drones, as differentiable JAX, and planning on them."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxurban.answers import PlannedPaths as PlannedPaths
    from jaxurban.build import build_maps as build_maps
    from jaxurban.case_study import study as study
    from jaxurban.city import City as City
    from jaxurban.cost import Weights as Weights
    from jaxurban.demo import demo_city as demo_city
    from jaxurban.errors import InputError as InputError
    from jaxurban.errors import JaxurbanError as JaxurbanError
    from jaxurban.grid import Grid as Grid
    from jaxurban.limits import Limits as Limits
    from jaxurban.many import plan_many as plan_many
    from jaxurban.maps import MetricMaps as MetricMaps
    from jaxurban.maps import open_maps as open_maps
    from jaxurban.planned import PlannedPath as PlannedPath
    from jaxurban.planners.base import CostModel as CostModel
    from jaxurban.planning import plan as plan
    from jaxurban.route_cautions import cautions as cautions
    from jaxurban.route_report import RouteReport as RouteReport
    from jaxurban.route_report import explain as explain
    from jaxurban.scenario import Scenario as Scenario
    from jaxurban.sensitivity_report import save_sensitivity as save_sensitivity
    from jaxurban.studies.examples import Example as Example
    from jaxurban.studies.imitation import fit_weights as fit_weights
    from jaxurban.studies.queries import make_queries as make_queries
    from jaxurban.studies.queries import unit_map as unit_map
    from jaxurban.studies.reading import examples_from_paths as examples_from_paths
    from jaxurban.studies.reading import read_examples as read_examples
    from jaxurban.studies.sampling import sample_instances as sample_instances
    from jaxurban.studies.sensitivity import sensitivity as sensitivity
    from jaxurban.studies.targets import fit_targets as fit_targets
    from jaxurban.studies.wishes import Wish as Wish
    from jaxurban.volume import plan_volume as plan_volume
    from jaxurban.weighted import WeightedMap as WeightedMap
    from jaxurban.weighted import weigh as weigh

# Names are fetched when they are first used: JAX, Numba and the readers take seconds to import, and the command
# line must answer, to --help and to Ctrl-C, before that.
_HOMES = {
    "build_maps": "build",
    "study": "case_study",
    "City": "city",
    "Weights": "cost",
    "demo_city": "demo",
    "InputError": "errors",
    "JaxurbanError": "errors",
    "Grid": "grid",
    "Limits": "limits",
    "PlannedPaths": "answers",
    "plan_many": "many",
    "MetricMaps": "maps",
    "open_maps": "maps",
    "PlannedPath": "planned",
    "CostModel": "planners.base",
    "plan": "planning",
    "cautions": "route_cautions",
    "RouteReport": "route_report",
    "explain": "route_report",
    "Scenario": "scenario",
    "Wish": "studies.wishes",
    "Example": "studies.examples",
    "examples_from_paths": "studies.reading",
    "fit_targets": "studies.targets",
    "fit_weights": "studies.imitation",
    "make_queries": "studies.queries",
    "read_examples": "studies.reading",
    "unit_map": "studies.queries",
    "save_sensitivity": "sensitivity_report",
    "sensitivity": "studies.sensitivity",
    "sample_instances": "studies.sampling",
    "plan_volume": "volume",
    "WeightedMap": "weighted",
    "weigh": "weighted",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
