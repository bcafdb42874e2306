"""How much there is to learn: keys of a scenario, options of commands, public names."""

from dataclasses import fields
from importlib import import_module

import click

import jaxurban as ju
from jaxurban.cli.main import app
from jaxurban.maps.scenario import Scenario, fields_of, model_in
from jaxurban.public import NAMESPACES

# Sections with pages of their own, and the weights, which are named after metrics.
APART = ("layers", "study", "weights")
MOST_KEYS, MOST_OPTIONS = 80, 170

# Every public name, with the reason why users write it. A new one has a reason of its own, or a row that is one.
NAMES = {
    "a city and what stands in it": "City Buildings Terrain Vegetation Obstacles sample_city demo_city",
    "a job from a file": "Scenario Region Planning",
    "maps and their settings": "build_maps open_maps MetricMaps Grid Gps Lidar Population Risk Layer Heights HeightStd",
    "maps on request": "metrics.Dop metrics.GpsFloor metrics.Protection",
    "routes": "plan plan_many cost_map cost_to_go simplify XY",
    "the rules of routes": "Weights CostModel Levels Constraints Vehicle",
    "when to fly": "when",
    "what a route meets": "explain cautions overflown_density",
    "the sky": "sky sky_along",
    "missions": "check return_altitude",
    "the viewer and what to cite": "view cite",
    "what is raised and warned of": "InputError JaxurbanError GuessWarning",
    "derivatives": "grad.map_inputs grad.all_maps grad.soft_city grad.SoftParams grad.ReceptionCurve grad.planned_cost",
    "weights from routes or targets": "fit.demonstrations fit.fit_weights fit.FitSettings fit.Target fit.fit_targets",
    "which weights matter": "studies.sensitivity studies.SensitivitySettings studies.building_costs",
    "intervals by stratum, time or city, which no table has": "studies.Clusters",
    "planners compared": "studies.study studies.Study studies.sample_instances studies.make_queries studies.MapsFolder",
    "maps compared, also with a receiver": "studies.compare studies.validate studies.ReceiverSettings",
}


def test_a_scenario_has_few_keys():
    keys = [
        f"{section}.{item.name}"
        for section, annotation in fields_of(Scenario).items()
        if section not in APART
        for item in fields(model_in(annotation))
    ]
    assert len(keys) <= MOST_KEYS, keys


def test_commands_have_few_options_hidden_ones_included():
    options = [
        f"{name} {parameter.opts[0]}"
        for name, command in app.commands.items()
        for parameter in command.params
        if isinstance(parameter, click.Option)
    ]
    assert len(options) <= MOST_OPTIONS, options


def test_every_public_name_has_a_reason():
    names = [name for name in dir(ju) if name not in (*NAMESPACES, "plot")]
    for space in NAMESPACES:
        names += [f"{space}.{name}" for name in dir(import_module(f"jaxurban.{space}"))]
    assert sorted(names) == sorted(" ".join(NAMES.values()).split())
