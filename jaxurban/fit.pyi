from jaxurban.studies.route_pool import FitSettings as FitSettings
from jaxurban.studies.study_demonstrations import demonstrations as demonstrations
from jaxurban.studies.tuning.target import Target as Target
from jaxurban.studies.tuning.target_fit import fit_targets as fit_targets
from jaxurban.studies.tuning.weight_fit import fit_weights as fit_weights
