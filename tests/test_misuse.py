"""Python misuse: for each parameter of each public function a wrong type and a wrong value, told by its name.

The functions, their parameters and what is of a wrong type come from the package; a wrong value is in `WRONG`, by the
parameter's name. A new parameter fails until somebody writes there what a wrong value is, or that there is none.
"""

import functools
import importlib
import inspect
import re
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.metrics.registry import known_metrics
from jaxurban.public import NAMESPACES, find_public
from tests.made_maps import made_maps

MAPS = made_maps(24, 30)
FREE = np.argwhere(MAPS.is_free(20.0))
START, GOAL = (MAPS.grid.lonlat_of_cell(*FREE[at]) for at in (0, -1))
BOUNDS = (-74.0, 40.755, -73.997, 40.757)
SETTINGS = {"region": {"bounds": BOUNDS}, "buildings": {"source": "synthetic"}}
RIGHT = "every value of the type is a right one here"
MADE = (  # what functions return; XY is looked at where it is used
    "GuessWarning",
    *("MetricMaps", "CostMap", "MapComparison", "PlannedPath", "PlannedPaths", "RouteReport", "SensitivityStudy"),
    "ReceiverValidation",
    *("SoftCity", "Demonstration", "InputError", "JaxurbanError", "Scenario", "XY", "City"),
)
METHODS = {  # of what they return
    "MetricMaps": ("check_altitude", "m", "is_free", "with_obstacles", "costs", "total", "normalised", "save"),
    "CostMap": ("only", "plan"),
    "MapComparison": ("save",),
    "PlannedPath": ("save",),
    "PlannedPaths": ("save", "to_dataframe"),
}


@functools.cache
def held(what: str) -> Any:
    """Return one of the things that calls are made with, made when it is first asked for."""
    return {
        "city": lambda: ju.demo_city(400, 400),
        "grid": lambda: ju.build_maps(held("city"), resolution_m=50.0, altitudes_m=(20.0,), progress=False).grid,
        "table": lambda: pd.DataFrame(
            [[*START, *GOAL, 20.0, 1.0]],
            columns=["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m", "w_gps"],
        ),
        "path": lambda: ju.plan(MAPS, START, GOAL, altitude_m=20.0),
        "file": lambda: held("path").save(Path(tempfile.mkdtemp()) / "path.geojson"),
        "paths": lambda: ju.plan_many(MAPS, [(START, GOAL)], altitude_m=20.0, progress=False),
        "comparison": lambda: ju.studies.compare(MAPS, MAPS, progress=False),
        "cost_map": lambda: ju.cost_map(MAPS, 20.0),
        "inputs": lambda: ju.grad.map_inputs(held("city"), held("grid"), altitudes_m=(20.0,)),
        "soft": lambda: ju.grad.soft_city(held("city"), held("grid"), ju.grad.SoftParams(altitude_m=20.0)),
        "query": lambda: ju.studies.make_queries(held("cost_map"), [(START, GOAL)])[0],
        "shown": lambda: ju.fit.demonstrations_from_paths(held("path"), MAPS)[0],
    }[what]()


# What a call needs beside the argument that is wrong, by the function; of methods what they are called on is "self".
GOOD: dict[str, Callable[[], dict[str, Any]]] = {
    "Buildings": lambda: {"source": "town.osm"},
    "City.from_files": lambda: {"buildings": __file__, "bounds": BOUNDS},
    "CostMap.only": lambda: {"self": held("cost_map")},
    "CostMap.plan": lambda: {"self": held("cost_map"), "start": START, "goal": GOAL},
    "Grid": lambda: dict(crs="EPSG:32618", resolution_m=5.0, first_row=0, first_col=0, num_rows=2, num_cols=2),
    "Grid.from_bounds": lambda: {"bounds": BOUNDS, "resolution_m": 5.0},
    "Layer": lambda: {"source": "noise.tif", "cost": "high-is-bad", "scale": (0.0, 80.0)},
    "MapsFolder": lambda: {"folder": "here"},
    **dict.fromkeys(
        ("MetricMaps.check_altitude", "MetricMaps.costs", "MetricMaps.total", "MetricMaps.normalised"),
        lambda: {"self": MAPS, "altitude_m": 20.0},
    ),
    "MetricMaps.m": lambda: {"self": MAPS, "name": "gps", "altitude_m": 20.0},
    "MetricMaps.is_free": lambda: {"self": MAPS, "altitude_m": 20.0},
    "MetricMaps.with_obstacles": lambda: {"self": MAPS},
    "MapComparison.save": lambda: {"self": held("comparison"), "folder": "/proc/none"},
    "MetricMaps.save": lambda: {"self": MAPS, "folder": "/proc/none"},
    "PlannedPath.save": lambda: {"self": held("path"), "file": "/proc/none.kml"},
    "PlannedPaths.to_dataframe": lambda: {"self": held("paths")},
    "PlannedPaths.save": lambda: {"self": held("paths")},
    "Scenario.from_toml": lambda: {"path": str(Path(__file__).parents[1] / "pyproject.toml")},
    "Scenario.from_dict": lambda: {"settings": SETTINGS},
    "SoftParams": lambda: {"altitude_m": 20.0},
    "Target.parse": lambda: {"text": "detour<=0.1"},
    "map_inputs": lambda: {"city": held("city"), "grid": held("grid")},
    "open_maps": lambda: {"folder": "no/such/place"},
    "Target": lambda: {"outcome": "detour", "sense": "<=", "value": 0.1},
    "Weights.parse": lambda: {"text": "gps=1"},
    "build_maps": lambda: {"city": held("city"), "resolution_m": 50.0, "altitudes_m": (20.0,), "progress": False},
    "all_maps": lambda: dict(zip(("inputs", "sky"), held("inputs"), strict=True)),
    "building_costs": lambda: {
        **{"city": held("city"), "soft": held("soft"), "planned": held("path")},
        "params": ju.grad.SoftParams(altitude_m=20.0),
    },
    "cautions": lambda: {"planned": held("path"), "maps": MAPS},
    "compare": lambda: {"maps_a": MAPS, "maps_b": MAPS, "progress": False},
    "compare_fits": lambda: {"cities": {"here": [held("shown")]}},
    "cost_map": lambda: {"maps": MAPS, "altitude_m": 20.0},
    "demonstrations_from_paths": lambda: {"paths": held("path"), "maps": MAPS},
    "explain": lambda: {"planned": held("path"), "maps": MAPS},
    "fit_targets": lambda: {"queries": [held("query")], "targets": ["detour<=0.1"]},
    "fit_weights": lambda: {"demonstrations": [held("shown")]},
    "make_queries": lambda: {"cost_map": held("cost_map"), "pairs": [(START, GOAL)]},
    "simplify": lambda: {"planned": held("path"), "on": held("cost_map"), "tolerance_m": 1.0},
    "plan": lambda: {"maps": MAPS, "start": START, "goal": GOAL, "altitude_m": 20.0},
    "plan_many": lambda: {"maps": MAPS, "queries": [(START, GOAL)], "altitude_m": 20.0, "progress": False},
    "planned_cost": lambda: {"problem": held("query").problem(np.ones(5))},
    "read_demonstrations": lambda: {"file": held("file"), "maps": MAPS},
    "sample_instances": lambda: {"maps": MAPS, "num": 1},
    "sensitivity": lambda: {"cost_map": held("cost_map"), "start": START, "goal": GOAL},
    "sensitivity_study": lambda: {"sources": {"here": MAPS}, "folder": "/proc/none", "routes": 1, "progress": False},
    "soft_city": lambda: {
        "city": held("city"),
        "grid": held("grid"),
        "params": ju.grad.SoftParams(altitude_m=20.0),
    },
    "study": lambda: {"maps": MAPS, "folder": "/proc/none", "instances": 1, "progress": False},
    "validate": lambda: {"scenario": ju.Scenario.from_dict(SETTINGS), "log": "no-such.csv", "progress": False},
    "view": lambda: {"maps": MAPS},
    "write_buildings": lambda: {"folder": "no/such/place", "planned": held("path"), "out": "/proc/none"},
}

# A wrong value of each parameter, by its name, or by "function.parameter" where it is another one.
WRONG: dict[str, Any] = {
    **dict.fromkeys(("planner", "planners", "distance_only", "heuristic", "objective"), "a-star"),
    **dict.fromkeys(("cost_model", "preset", "CostModel.kind"), "cells"),
    **dict.fromkeys(("CostMap.only.metrics", "metrics", "vary", "objectives"), ("gsp",)),
    **dict.fromkeys(("start", "goal", "reference", "centre_lonlat"), (1e300, 0.0)),
    **dict.fromkeys(("start_xy_m", "goal_xy_m"), ("east", "north")),
    "PlannedPath.save.end": "hover",
    **dict.fromkeys(("time", "MetricMaps.m.time"), "yesterday"),
    **dict.fromkeys(("folder", "maps", "maps_a", "maps_b", "other", "path", "file"), "no/such/place"),
    **dict.fromkeys(("MetricMaps.save.folder", "MapComparison.save.folder"), "/proc/none"),
    "other_pieces_m": (-1.0,),
    **dict.fromkeys(("study.folder", "sensitivity_study.folder", "out"), "/proc/none"),
    **dict.fromkeys(("blocks", "table", "districts", "terrain", "buildings", "no_fly", "orbits"), "no-such.file"),
    "log": "no-such.csv",
    **dict.fromkeys(("PlannedPath.save.file", "PlannedPaths.save.file", "PlannedPath.save.more"), "path.txt"),
    **dict.fromkeys(("plan_many.file", "FitSettings.state_file"), "no/such/place.parquet"),
    **dict.fromkeys(("altitudes_m", "nest_with_m", "MetricMaps.m.altitude_m", "factors"), (-1e300, 1e300)),
    **dict.fromkeys(("weekday", "weekend", "scale", "field_of_view_deg", "bounds"), (1.0, 2.0, 3.0, 4.0, 5.0)),
    **dict.fromkeys(("compare_fits.scale", "fit_weights.scale"), "metres"),
    **{name: {} for name in ("cities", "scenarios", "sources")},
    **{name: [] for name in ("queries", "demonstrations", "paths", "targets")},
    **dict.fromkeys(("seed", "height_seed", "height_samples", "num_heights", "bootstrap", "num_samples"), -1),
    **dict.fromkeys(("max_rounds", "max_plans", "num", "num_segments", "num_threads", "workers"), 0),
    **dict.fromkeys(("budget_iterations", "oversample", "num_rows", "num_cols", "beams", "azimuths"), 0),
    **dict.fromkeys(("routes", "instances"), -1),
    **dict.fromkeys((f"HeightStd.{origin}" for origin in ("height", "levels", "default", "raster")), -1.0),
    **dict.fromkeys(("first_row", "first_col"), 10**30),
}
# Numbers where a finite range is meant.
WRONG |= dict.fromkeys(
    (
        *("altitude_m", "resolution_m", "width_m", "height_m", "min_altitude_m", "max_altitude_m", "level_step_m"),
        *("climb_cost", "descent_cost", "reference_length_m", "reach_m", "range_m", "threshold_m", "snap", "tolerance"),
        *("default_height_m", "level_height_m", "mask_deg", "max_age_days", "wrong", "hold_out", "softness_m"),
        *("antenna_height_m", "piece_m", "block_m", "sky_step_s"),
        *("speed_m_s", "power_w", "swath_m", "value", "gdop_threshold", "availability_threshold", "normalise"),
        "dop_threshold",
        *("horizontal_alert_limit_m", "vertical_alert_limit_m", "sigma_ura_m", "sigma_ure_m", "bias_m", "p_sat"),
        *("p_const_gps", "p_const", "phmi_horizontal", "phmi_vertical", "pfa_horizontal", "pfa_vertical"),
        *("p_unmonitored",),
        *(
            "clearance_m",
            "vertical_clearance_m",
            "radius_m",
            "max_climb_m_s",
            "max_descent_m_s",
            "max_turn_deg",
            "tolerance_m",
        ),
        *("gamma_commercial", "gamma_residential", "distance", "gps", "lidar", "population", "risk", "own", "budget_s"),
    ),
    1e300,
)
WRONG |= {
    **{"connectivity": 5, "diagonal": "never", "obstacles": "toched", "backend": "gpu", "engine": "gpu"},
    **{"kind": "roof", "nan": "open"},
    **{"hanging": "in the air", "clocks": "two"},
    **{
        "series": "all",
        "quantity": "people",
        "Risk.distance": "sphere",
        "cost": "bad",
        "sense": "=",
        "time": "now",
    },
    **{"outcome": "beauty", "crs": "EPSG:4326", "source": 5, "credit": RIGHT, "block_field": RIGHT, "require": "gps"},
    **{"district_field": RIGHT, "commercial": RIGHT, "weights": {"gsp": 1.0}},
    **{
        "CostModel.from_settings.settings": {"connectivity": 5},
        "Scenario.from_dict.settings": {**SETTINGS, "reigon": {}},
    },
    **{
        "Scenario.from_dict.name": RIGHT,
        "Scenario.from_dict.folder": RIGHT,
        "MetricMaps.m.name": "gsp",
        "zones": RIGHT,
    },
    **{"Constraints.bounds": RIGHT, "layers": ("gsp",), "changes": ("gps.mask_deg",), "text": "gps", "base": RIGHT},
    **{"build_maps.layers": {"gps": ju.Layer("a.tif", "high-is-bad", (0, 1))}, "soft_city.layers": RIGHT, "pairs": [5]},
    **{
        "SoftParams.sections": {"gsp": 1},
        "Protection.tolerance_m": (0.0, 1e-4),
        "times": (),
        "stop": "yesterday",
        "step_s": 0,
        "compare.times": {"now": "then"},
        "scenario": "no.toml",
    },
    **{"time_of_day": "noon", "times_of_day": ("noon",), "profile": RIGHT},
    **{
        "plan_many.queries": pd.DataFrame({"start": [1]}),
        "sample_instances.weights": "uniform",
        "all_maps.weights": RIGHT,
    },
}
WRONG |= dict.fromkeys(  # known only with the maps, the files or the folder, or as good as none
    (
        *("building_costs.weights", "FitSettings.state_file", "MapsFolder.folder", "sensitivity_study.scenarios"),
        *("SensitivitySettings.vary", "SensitivitySettings.objectives"),
        *("SensitivityStudySettings.vary", "write_buildings.out", "write_buildings.scenario"),
        *("Population.blocks", "City.from_files.terrain", "Gps.orbits", "Buildings.source", "Terrain.source"),
        *("read_demonstrations.metrics", "Study.land_cover"),
        "open_maps.obstacles",
    ),
    RIGHT,
)


def public() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield every public function, constructor, class method and method of what functions return, by its name."""
    spaces = [ju, *(getattr(ju, name) for name in NAMESPACES)]
    for name in [name for space in spaces for name in space.__all__ if name not in NAMESPACES]:
        thing = find_public(name)
        if not inspect.isclass(thing) or name not in MADE:
            yield name, thing
        for method, function in vars(thing).items() if inspect.isclass(thing) else ():
            if isinstance(function, classmethod) and not method.startswith(("_", "tree_", "of")):
                yield f"{name}.{method}", getattr(thing, method)
            elif method in METHODS.get(name, ()):
                yield f"{name}.{method}", function


CALLS = dict(public())
PARAMETERS = [
    (name, parameter)
    for name, function in CALLS.items()
    for parameter in inspect.signature(function).parameters
    if parameter != "self"
]


def call(name: str, parameter: str, value: Any, good: dict[str, Any]) -> str:
    """Return what a call with a wrong argument answers."""
    function, given = CALLS[name], {**good, parameter: value}
    kind = inspect.signature(function).parameters[parameter].kind
    if kind is kind.VAR_POSITIONAL:
        given = {**good, "file": "path.geojson"}
    if kind is kind.VAR_KEYWORD:
        given = {**good, f"my_{parameter}": value}
    args = (given.pop("self"),) if "self" in given else ()
    args += (given.pop("file"), value) if kind is kind.VAR_POSITIONAL else ()
    with pytest.raises(InputError) as raised:
        function(*args, **given)
    return str(raised.value)


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_a_wrong_type_names_the_argument(name, parameter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    good = GOOD.get(name, dict)()
    told = call(name, parameter, object(), good)
    assert parameter in told
    assert "\n" not in told


def words_of(parameter: str, value: Any) -> str:
    """Return what a sentence may call an argument: its name, the name in words, or the text that is wrong in it."""
    texts = [value] if isinstance(value, str) else filter(lambda item: isinstance(item, str), _items(value))
    return "|".join([parameter, parameter.removesuffix("_m").replace("_", " "), *map(re.escape, texts)])


def _items(value: Any) -> Any:
    return value if isinstance(value, list | tuple | dict) else ()


def is_checked_elsewhere(name: str, parameter: str) -> bool:
    """Return whether a parameter takes nothing but a flag, a function or a thing whose own class is tested here."""
    hint = str(inspect.signature(CALLS[name]).parameters[parameter].annotation)
    told = re.sub(r"Callable\[.*", "", hint)
    return not re.search(r"\b(str|int|float|Path|Sequence|Iterable|tuple|Any|Mapping|dict|Literal)\b", told)


@pytest.mark.parametrize(("name", "parameter"), [each for each in PARAMETERS if not is_checked_elsewhere(*each)])
def test_a_wrong_value_names_the_argument(name, parameter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    value = WRONG.get(f"{name}.{parameter}", WRONG.get(parameter))
    assert value is not None, f"write a wrong value of {name}.{parameter} into WRONG, or RIGHT"
    if value is RIGHT:
        return
    told = call(name, parameter, value, GOOD.get(name, dict)())
    assert re.search(words_of(parameter, value), told, re.IGNORECASE)
    assert "\n" not in told


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: ju.plan("maps", (0, 0), (1, 1)), "plan: missing a required (keyword-only )?argument: 'altitude_m'"),
        (
            lambda: ju.plan("maps", (0, 0), (1, 1), altitudes_m=20),
            r"plan: there is no argument 'altitudes_m' \(did you mean 'altitude_m'\?\)",
        ),
        (
            lambda: ju.build_maps(ju.demo_city(500, 500), altitude_m=20),
            r"build_maps: there is no argument 'altitude_m' \(did you mean 'altitudes_m'\?\)",
        ),
        (
            lambda: ju.plan("maps", (0, 0), (1, 1), altitude_m=20, constraints={"gps": 0.3}),
            r"Constraints\.read\(require=\[\"gps>=0\.3\"\]\)",
        ),
        (
            lambda: ju.plan("maps", (0, 0), (1, 1), altitude_m=20, clearance_m=5.0),
            r"'clearance_m' \(give constraints=Constraints\.read\(clearance_m=\.\.\.\)\)",
        ),
        (
            lambda: ju.cost_map("maps", 20, radius_m=0.5),
            r"'radius_m' \(give constraints=Constraints\.read\(vehicle=Vehicle\(radius_m=\.\.\.\)\)\)",
        ),
        (lambda: ju.plan(MAPS, altitude_m=20), "start is missing: give it as longitude, latitude or as start_xy_m"),
        (lambda: ju.plan(MAPS, START, altitude_m=20), "goal is missing: give it as"),
        (
            lambda: ju.plan(MAPS, START, GOAL, altitude_m=20, start_xy_m=(0, 0)),
            "start must be given in one way, not both: give it as longitude, latitude or as start_xy_m",
        ),
        (
            lambda: ju.MetricMaps(MAPS.ds.drop_vars(["population", "density"], errors="ignore")).m(
                "gps", time_of_day="noon"
            ),
            "there are no maps for time of day noon: these maps hold none, so leave it out",
        ),
        (lambda: held("path").save("a\0.plan"), r"cannot write 'a\\x00\.plan': no file's name can hold NUL"),
    ],
)
def test_arguments_that_are_missing_misspelt_or_of_another_kind_name_the_remedy(call, sentence):
    with pytest.raises(InputError, match=sentence):
        call()


HOMES = {
    "build_maps": {
        **{"mask_deg": "gps=Gps(mask_deg=...)", "mask": "gps=Gps(mask_deg=...)", "gps_mask": "gps=Gps(mask_deg=...)"},
        "times_of_day": "population=Population(time_of_day=...)",
        "height_std": "heights=Heights(height_std_m=...)",
        "population_table": "population=Population(table=...)",
        "default_height_m": "city=City.from_files(buildings=Buildings(default_height_m=...))",
    },
    "plan": {
        "levels": "altitude_m=Levels(...)",
        "max_altitude_m": "altitude_m=Levels(max_altitude_m=...)",
        "speed": "constraints=Constraints.read(vehicle=Vehicle(speed_m_s=...))",
    },
    "study": {"planers": "settings=Study(planners=...)"},
}


@pytest.mark.parametrize(("name", "wrong"), [(name, wrong) for name, homes in HOMES.items() for wrong in homes])
def test_an_argument_of_what_makes_another_is_given_there(name, wrong):
    with pytest.raises(
        InputError, match=re.escape(f"{name}: there is no argument {wrong!r} (give {HOMES[name][wrong]})")
    ):
        CALLS[name](**GOOD[name](), **{wrong: 1})


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("build_maps", wrong) for wrong in ("metrics", "weights", "device", "seed")),
        *(("plan", wrong) for wrong in ("closed", "volume", "simplify", "time_limit")),
        *(("cost_map", "snap"), ("MetricMaps.save", "overwrite")),
    ],
)
def test_an_argument_like_no_other_is_answered_by_the_list_of_all_and_no_guess(name, wrong):
    good = GOOD[name]()
    method = CALLS[name].__get__(good.pop("self")) if "self" in good else CALLS[name]
    with pytest.raises(InputError) as raised:
        method(**good, **{wrong: 1})
    takes = ", ".join(inspect.signature(method).parameters)
    assert str(raised.value) == f"{name.rpartition('.')[2]}: there is no argument {wrong!r}; it takes {takes}"


@pytest.mark.parametrize(
    ("module", "name", "home"),
    [
        ("jaxurban", "fit_weights", "jaxurban.fit.fit_weights"),
        ("jaxurban", "all_maps", "jaxurban.grad.all_maps"),
        ("jaxurban", "Dop", "jaxurban.metrics.Dop"),
        ("jaxurban", "GpsParams", "jaxurban.Gps"),
        ("jaxurban.fit", "plan", "jaxurban.plan"),
        ("jaxurban", "openmaps", "jaxurban.open_maps"),
    ],
)
def test_a_name_that_is_public_elsewhere_is_said_to_be_there(module, name, home):
    with pytest.raises(AttributeError, match=rf"has no attribute '{name}' \(did you mean {re.escape(home)}\?\)"):
        getattr(importlib.import_module(module), name)
    assert not hasattr(ju, "BenchmarkSettings")


def test_help_lists_the_sections_that_maps_are_made_with():
    parameters = inspect.signature(ju.build_maps).parameters
    assert {name: parameters[name].annotation for name in known_metrics()} == {
        name: metric.params | None for name, metric in known_metrics().items()
    }
