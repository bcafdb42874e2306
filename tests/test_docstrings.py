"""What is public says what comes back and shows it: every docstring has ``Returns:`` and an example that runs."""

import doctest
import inspect
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.public import NAMESPACES, PICTURES, TYPES

MODULES = [ju, *(import_module(f"jaxurban.{name}") for name in (*NAMESPACES, PICTURES, TYPES))]
HOOKS = {
    "model_post_init",
    "tree_flatten_with_keys",
    "tree_unflatten",
}  # of Pydantic and JAX, which call them
LEAVE_NOTHING = inspect.Signature.empty, None, "None"


@cache
def assumed() -> dict[str, Any]:
    """Return the names that all examples start from, as docs/reference/api.md says."""
    city = ju.demo_city(width_m=600, height_m=600)
    maps = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0, 60.0))
    start, goal = maps.grid.lonlat_of_cell(2, 2), maps.grid.lonlat_of_cell(27, 27)
    path = ju.plan(maps, start, goal, altitude_m=60.0)
    region = {"bounds": [-73.974, 40.778, -73.968, 40.782], "resolution_m": 10.0}
    scenario = ju.Scenario.from_dict({"region": region, "buildings": {"source": "synthetic"}})
    log = pd.DataFrame({"utc": pd.date_range("2020-04-27T16:00:00Z", periods=80, freq="s")})
    log = log.assign(lon=np.linspace(-73.973, -73.969, 80), lat=40.7803)
    heard = pd.DataFrame({"satellite": ["G05", "G21"], "azimuth_deg": [20.0, 260.0]})
    log = log.merge(heard.assign(elevation_deg=60.0, cn0_dbhz=[44.0, 25.0]), how="cross")
    return {
        "ju": ju,
        "np": np,
        "city": city,
        "maps": maps,
        "start": start,
        "goal": goal,
        "path": path,
        "scenario": scenario,
        "log": log,
    }


def members(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """Yield what is public of a public name: itself, and the methods that its class defines."""
    yield name, thing
    attributes = vars(thing) if inspect.isclass(thing) else {}
    for each, member in attributes.items():
        function = getattr(member, "__func__", member)
        if not each.startswith("_") and each not in HOOKS and inspect.isfunction(function):
            yield f"{name}.{each}", function


NAMES = [
    (name, getattr(module, name))
    for module in MODULES
    for name in module.__all__
    if name not in (*NAMESPACES, PICTURES)
]
PUBLIC = dict(member for name, thing in NAMES for member in members(name, thing))


@pytest.mark.parametrize(
    "name", [name for name, thing in PUBLIC.items() if inspect.isfunction(thing)]
)
def test_a_docstring_says_what_comes_back(name):
    if inspect.signature(PUBLIC[name]).return_annotation not in LEAVE_NOTHING:
        assert "\nReturns:\n" in (inspect.getdoc(PUBLIC[name]) or "")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.errors.GuessWarning")
@pytest.mark.parametrize("name", PUBLIC)
def test_an_example_shows_what_the_docstring_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if name == "view":
        pytest.importorskip("anywidget", reason="anywidget is not installed")
    text = inspect.getdoc(PUBLIC[name]) or ""
    assert "\nExamples:\n" in text
    example = doctest.DocTestParser().get_doctest(text, dict(assumed()), name, None, None)
    assert example.examples
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS).run(
        example, out=said.append
    )
    assert not said, "".join(said)
