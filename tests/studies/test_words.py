"""Sentences of studies: no capital in their midst, and no weight of what the maps do not hold."""

import pandas as pd

import jaxurban as ju
from jaxurban.statistics.conclusions import SharedVerdict
from jaxurban.studies.baseline import BaselineVerdict
from jaxurban.studies.map_comparison import MapVerdict
from jaxurban.studies.montecarlo.analysis import StudyVerdict
from jaxurban.studies.queries import outcome_label
from jaxurban.studies.reports.sensitivity import weights_said
from jaxurban.studies.tuning.confidence import FitVerdict
from jaxurban.studies.tuning.tested import WishVerdict
from jaxurban.studies.weights.verdicts import WeightVerdict
from tests.made_maps import made_maps


def test_an_outcome_has_no_capital_in_a_sentence_unless_it_is_an_abbreviation():
    assert outcome_label("mean_risk") == "distance to obstacles"
    assert outcome_label("mean_gps") == "GPS quality"
    assert outcome_label("mean_noise") == "noise"


def test_verdicts_go_on_with_a_line_so_that_none_begins_with_a_capital():
    of_maps = MapVerdict, BaselineVerdict
    for kinds in (SharedVerdict, *of_maps, StudyVerdict, FitVerdict, WishVerdict, WeightVerdict):
        assert [each.name for each in kinds if each.value[0].isupper()] == []


def test_weights_of_routes_are_those_of_layers_that_the_maps_hold():
    weights = {"w_distance": 0.1, "w_gps": 1.0, "w_lidar": 1.0, "w_population": 1.0, "w_risk": 2.0}
    instances = pd.DataFrame([weights, weights])
    empty = ju.MetricMaps(made_maps(8, 8).ds.drop_vars(["population", "density"]))
    assert weights_said(instances, [empty]) == "distance 0.1, gps 1, lidar 1, risk 2"
