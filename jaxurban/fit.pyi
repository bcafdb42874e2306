from jaxurban.studies.demonstrations import Demonstration as Demonstration
from jaxurban.studies.demonstrations import demonstrations_from_paths as demonstrations_from_paths
from jaxurban.studies.demonstrations import read_demonstrations as read_demonstrations
from jaxurban.studies.route_pool import FitSettings as FitSettings
from jaxurban.studies.study_demonstrations import (
    demonstrations_from_study as demonstrations_from_study,
)
from jaxurban.studies.tuning.compared_fits import FitComparison as FitComparison
from jaxurban.studies.tuning.compared_fits import compare_fits as compare_fits
from jaxurban.studies.tuning.target import Target as Target
from jaxurban.studies.tuning.target_fit import TargetFit as TargetFit
from jaxurban.studies.tuning.target_fit import fit_targets as fit_targets
from jaxurban.studies.tuning.weight_fit import WeightFit as WeightFit
from jaxurban.studies.tuning.weight_fit import fit_weights as fit_weights
