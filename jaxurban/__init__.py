"""jaxurban: urban metric maps for small drones, and planning on them.

On a CPU the heavy kernels are compiled by Numba; under ``jax.jit``, ``jax.vmap``, on export and on a GPU maps are JAX.
Gradients come from soft forms of the metrics.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING

if _TYPE_CHECKING:
    from jaxurban.errors import InputError as InputError
    from jaxurban.errors import JaxurbanError as JaxurbanError
    from jaxurban.maps.build import build_maps as build_maps
    from jaxurban.maps.build import map_inputs as map_inputs
    from jaxurban.maps.build import soft_city as soft_city
    from jaxurban.maps.differentiable import SoftCity as SoftCity
    from jaxurban.maps.differentiable import SoftParams as SoftParams
    from jaxurban.maps.levels import Levels as Levels
    from jaxurban.maps.metric_maps import MetricMaps as MetricMaps
    from jaxurban.maps.metric_maps import open_maps as open_maps
    from jaxurban.maps.pipeline import all_maps as all_maps
    from jaxurban.metrics.custom import Layer as Layer
    from jaxurban.metrics.gps import DopParams as DopParams
    from jaxurban.metrics.gps import GpsParams as GpsParams
    from jaxurban.metrics.lidar import LidarParams as LidarParams
    from jaxurban.metrics.population import PopulationParams as PopulationParams
    from jaxurban.metrics.protection import ProtectionParams as ProtectionParams
    from jaxurban.metrics.risk import RiskParams as RiskParams
    from jaxurban.metrics.weights import Weights as Weights
    from jaxurban.paths.batch import plan_many as plan_many
    from jaxurban.paths.cautions import cautions as cautions
    from jaxurban.paths.constraints import Constraints as Constraints
    from jaxurban.paths.cost_map import CostMap as CostMap
    from jaxurban.paths.cost_map import cost_map as cost_map
    from jaxurban.paths.explain import RouteReport as RouteReport
    from jaxurban.paths.explain import explain as explain
    from jaxurban.paths.path import PlannedPath as PlannedPath
    from jaxurban.paths.plan import plan as plan
    from jaxurban.paths.results import PlannedPaths as PlannedPaths
    from jaxurban.paths.simplify import simplify as simplify
    from jaxurban.paths.snapping import XY as XY
    from jaxurban.paths.vehicle import Vehicle as Vehicle
    from jaxurban.planners.cost_model import CostModel as CostModel
    from jaxurban.planners.envelope import planned_cost as planned_cost
    from jaxurban.report.buildings import write_buildings as write_buildings
    from jaxurban.report.map_comparison import save_comparison as save_comparison
    from jaxurban.report.receiver import save_validation as save_validation
    from jaxurban.report.run_montecarlo import study as study
    from jaxurban.report.run_sensitivity import sensitivity_study as sensitivity_study
    from jaxurban.report.sensitivity import save_sensitivity as save_sensitivity
    from jaxurban.report.sensitivity_study import SensitivityStudy as SensitivityStudy
    from jaxurban.scenario.settings import Scenario as Scenario
    from jaxurban.studies.demonstrations import Demonstration as Demonstration
    from jaxurban.studies.map_comparison.compare import MapComparison as MapComparison
    from jaxurban.studies.map_comparison.compare import compare as compare
    from jaxurban.studies.montecarlo.run import MapsFolder as MapsFolder
    from jaxurban.studies.montecarlo.sampling import sample_instances as sample_instances
    from jaxurban.studies.montecarlo.trial import BenchmarkSettings as BenchmarkSettings
    from jaxurban.studies.queries import make_queries as make_queries
    from jaxurban.studies.read_demonstrations import demonstrations_from_paths as demonstrations_from_paths
    from jaxurban.studies.read_demonstrations import read_demonstrations as read_demonstrations
    from jaxurban.studies.receiver.settings import ReceiverSettings as ReceiverSettings
    from jaxurban.studies.receiver.validate import ReceiverValidation as ReceiverValidation
    from jaxurban.studies.receiver.validate import validate as validate
    from jaxurban.studies.sensitivity.buildings import building_costs as building_costs
    from jaxurban.studies.sensitivity.remade import RemadeSettings as RemadeSettings
    from jaxurban.studies.sensitivity.routes import SensitivityStudySettings as SensitivityStudySettings
    from jaxurban.studies.sensitivity.study import SensitivitySettings as SensitivitySettings
    from jaxurban.studies.sensitivity.study import sensitivity as sensitivity
    from jaxurban.studies.tuning.compared_fits import compare_fits as compare_fits
    from jaxurban.studies.tuning.fit_settings import FitSettings as FitSettings
    from jaxurban.studies.tuning.target_fit import fit_targets as fit_targets
    from jaxurban.studies.tuning.targets import Target as Target
    from jaxurban.studies.tuning.weight_fit import fit_weights as fit_weights
    from jaxurban.viewer.widget import view as view
    from jaxurban.world.city import City as City
    from jaxurban.world.grid import Grid as Grid
    from jaxurban.world.synthetic import demo_city as demo_city

# Names are fetched when they are first used: JAX, Numba and the readers take seconds to import, and the command
# line must react, to --help and to Ctrl-C, before that. A test compares this list with the one above.
_NAMES = {
    "errors": "InputError JaxurbanError",
    "maps.build": "build_maps map_inputs soft_city",
    "maps.differentiable": "SoftCity SoftParams",
    "maps.levels": "Levels",
    "maps.metric_maps": "MetricMaps open_maps",
    "maps.pipeline": "all_maps",
    "metrics.custom": "Layer",
    "metrics.gps": "DopParams GpsParams",
    "metrics.lidar": "LidarParams",
    "metrics.population": "PopulationParams",
    "metrics.protection": "ProtectionParams",
    "metrics.risk": "RiskParams",
    "metrics.weights": "Weights",
    "paths.batch": "plan_many",
    "paths.cautions": "cautions",
    "paths.constraints": "Constraints",
    "paths.cost_map": "CostMap cost_map",
    "paths.explain": "RouteReport explain",
    "paths.path": "PlannedPath",
    "paths.plan": "plan",
    "paths.results": "PlannedPaths",
    "paths.simplify": "simplify",
    "paths.snapping": "XY",
    "paths.vehicle": "Vehicle",
    "planners.cost_model": "CostModel",
    "planners.envelope": "planned_cost",
    "report.buildings": "write_buildings",
    "report.map_comparison": "save_comparison",
    "report.receiver": "save_validation",
    "report.run_montecarlo": "study",
    "report.run_sensitivity": "sensitivity_study",
    "report.sensitivity": "save_sensitivity",
    "report.sensitivity_study": "SensitivityStudy",
    "scenario.settings": "Scenario",
    "studies.demonstrations": "Demonstration",
    "studies.map_comparison.compare": "MapComparison compare",
    "studies.montecarlo.run": "MapsFolder",
    "studies.montecarlo.sampling": "sample_instances",
    "studies.montecarlo.trial": "BenchmarkSettings",
    "studies.queries": "make_queries",
    "studies.read_demonstrations": "demonstrations_from_paths read_demonstrations",
    "studies.receiver.settings": "ReceiverSettings",
    "studies.receiver.validate": "ReceiverValidation validate",
    "studies.sensitivity.buildings": "building_costs",
    "studies.sensitivity.remade": "RemadeSettings",
    "studies.sensitivity.routes": "SensitivityStudySettings",
    "studies.sensitivity.study": "SensitivitySettings sensitivity",
    "studies.tuning.compared_fits": "compare_fits",
    "studies.tuning.fit_settings": "FitSettings",
    "studies.tuning.target_fit": "fit_targets",
    "studies.tuning.targets": "Target",
    "studies.tuning.weight_fit": "fit_weights",
    "viewer.widget": "view",
    "world.city": "City",
    "world.grid": "Grid",
    "world.synthetic": "demo_city",
}
_HOMES = {name: f"{__name__}.{module}" for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
