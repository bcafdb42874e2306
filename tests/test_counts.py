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
MOST_KEYS, MOST_OPTIONS, MOST_NAMES = 80, 170, 70


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


def test_few_names_are_public():
    names = [name for name in dir(ju) if name not in (*NAMESPACES, "plot")]
    for space in NAMESPACES:
        names += [f"{space}.{name}" for name in dir(import_module(f"jaxurban.{space}"))]
    assert len(names) <= MOST_NAMES, len(names)
