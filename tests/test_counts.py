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

# Every key, option and public name, with the reason why users write it. A new one has a reason of its own, or a row
# that is one.
KEYS = {
    "where, how fine, how high": "region: bounds crs resolution_m altitudes_m oversample",
    "what stands": "buildings: source kind crs credit; obstacles: kinds",
    "how a file says heights": "buildings: height_column ground_column levels_column unit level_height_m heights",
    "what is not known of heights": "buildings: default_height_m highest_m height_std_m height_samples",
    "what may be odd in a file": "buildings: allow hanging",
    "the ground and plants": "terrain: source credit; vegetation: source credit",
    "which satellites, when": "gps: times step_s series orbits clocks max_age_days reference bounds",
    "when a position is good": "gps: gdop_threshold availability_threshold mask_deg plants",
    "the lidar": "lidar: beams field_of_view_deg azimuths range_m",
    "who lives where": "population: blocks block_field table column blocks_day blocks_night credit districts "
    "district_field commercial",
    "how people count": "population: gamma_commercial gamma_residential quantity normalise time_of_day",
    "how near walls are": "risk: threshold_m distance",
    "maps on request": "gps_horizontal: dop_threshold; gps_vertical: dop_threshold; gps_floor: dop_threshold dop; "
    "protection: horizontal_alert_limit_m vertical_alert_limit_m isd",
    "how routes are planned": "planning: preset planner cost_model budget_s seed",
    "what routes keep away from": "planning: obstacles clearance_m vertical_clearance_m unknown_heights",
    "what flies": "vehicle: max_climb_m_s max_descent_m_s max_turn_deg speed_m_s power_w",
}
OPTIONS = {
    "where results go": "-o --overwrite --json --export --report --profile --figures --mission --simplify",
    "which maps, where and when": "--altitude --resolution --time --time-of-day --layers",
    "a place or two": "--at --start --goal --home --snap --on-ground",
    "what a route costs": "--weights --objective --preset --volume --exposure",
    "what a route keeps": "--rules --no-fly --require --ceiling",
    "how it is searched": "--planner --refine --when",
    "a scenario, changed": "--set",
    "a mission": "--heights --return-altitude --autopilot --limits --corridor --sources",
    "many routes": "--routes --instances --sample --seed",
    "which weights matter": "--vary --range --study",
    "weights from routes or wishes": "--pilot --wish --metrics --fit",
    "the sky": "--track --reference --by-satellite --speed",
    "a receiver's log": "--navigation --antenna-height --sky-step --block --known --systems",
    "open data": "--bounds --what --date --margin --source --max-size --dry-run",
    "the page": "--size --port --no-browser",
    "the machine": "--device --memory --workers --cluster",
}
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


def test_every_key_of_a_scenario_has_a_reason():
    keys = [
        f"{section}.{item.name}"
        for section, annotation in fields_of(Scenario).items()
        if section not in APART
        for item in fields(model_in(annotation))
    ]
    listed = []
    for row in "; ".join(KEYS.values()).split("; "):
        section, _, names = row.partition(": ")
        listed += [f"{section}.{name}" for name in names.split()]
    assert sorted(keys) == sorted(listed)


def test_every_option_of_a_command_has_a_reason_hidden_ones_included():
    options = {
        parameter.opts[0]
        for command in app.commands.values()
        for parameter in command.params
        if isinstance(parameter, click.Option)
    }
    assert sorted(options) == sorted(" ".join(OPTIONS.values()).split())


def test_every_public_name_has_a_reason():
    names = [name for name in dir(ju) if name not in (*NAMESPACES, "plot")]
    for space in NAMESPACES:
        names += [f"{space}.{name}" for name in dir(import_module(f"jaxurban.{space}"))]
    assert sorted(names) == sorted(" ".join(NAMES.values()).split())
