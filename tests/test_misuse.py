"""Python misuse: for each parameter of each public function a wrong type and a wrong value, told by its name.

The functions, their parameters and what is of a wrong type come from the package; a wrong value is in `WRONG`, by the
parameter's name, or goes by its type. A new parameter of another type fails until somebody writes there what a wrong
value is, or that there is none.
"""

import copy
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
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.metrics.registry import known_metrics
from jaxurban.public import NAMESPACES, PICTURES, TYPES, find_public
from tests.made_maps import made_maps

MAPS = made_maps(24, 30)


def two_paths() -> list:
    return [ju.plan(MAPS, START, GOAL, altitude_m=20.0, weights={"gps": gps}) for gps in (1.0, 5.0)]


def beside_maps() -> ju.MetricMaps:
    ds = MAPS.ds
    return ju.MetricMaps(ds.assign_coords(x=ds.x + 10_000.0))


FREE = np.argwhere(MAPS.is_free(20.0))
START, GOAL = (MAPS.grid.lonlat_of_cell(*FREE[at]) for at in (0, -1))
BOUNDS = (-74.0, 40.755, -73.997, 40.757)
SETTINGS = {"region": {"bounds": BOUNDS}, "buildings": {"source": "synthetic"}}
RIGHT, LEFT_OUT = "every value of the type is a right one here", object()
MADE = (  # what functions return; XY is looked at where it is used
    *("Departures", "GuessWarning", "MissionCheck", "SkyAt", "SkyAlong"),
    *(
        "MetricMaps",
        "CostMap",
        "LineCost",
        "MapComparison",
        "OverflownDensity",
        "PlannedPath",
        "PlannedPaths",
        "ReturnAltitude",
        "RouteReport",
    ),
    *(
        "ReceiverValidation",
        "SatelliteAgreement",
        "WeightFit",
        "TargetFit",
        "Sensitivity",
        "OneRoute",
        "BenchmarkResult",
    ),
    *("SoftCity", "Demonstration", "InputError", "JaxurbanError", "Scenario", "XY", "City"),
)
METHODS = {  # of what they return
    "MetricMaps": (
        "m",
        "is_free",
        "with_obstacles",
        "costs",
        "total",
        "normalised",
        "plot",
        "save",
    ),
    "CostMap": ("only", "plan", "cost_of"),
    "Clusters": ("interval",),
    "MapComparison": ("save",),
    "PlannedPath": ("save",),
    "PlannedPaths": ("save", "to_dataframe"),
    "OneRoute": ("breakpoints",),
}
SIZES = {"first_row": 0, "first_col": 0, "num_rows": 2, "num_cols": 2}
PLAIN = {
    **dict.fromkeys(("maps", "maps_a", "maps_b", "MetricMaps"), MAPS),
    **{
        "start": START,
        "goal": GOAL,
        "home": START,
        "place": START,
        "places": [START, GOAL],
        "altitude_m": 20.0,
        "progress": False,
        "bounds": BOUNDS,
        "sample_city.name": "nihonbashi",
        "resolution_m": 5.0,
    },
    **{
        "build_maps.resolution_m": 50.0,
        "build_maps.altitudes_m": (20.0,),
        "build_maps.progress": False,
    },
    **{
        "queries": [(START, GOAL)],
        "pairs": [(START, GOAL)],
        "targets": ["detour<=0.1"],
        "tolerance_m": 1.0,
    },
    **{
        "crs": "EPSG:32618",
        **SIZES,
        "settings": SETTINGS,
        "file": "/proc/none.kml",
        "folder": "/proc/none",
    },
    **{
        "Buildings.source": "town.osm",
        "buildings": __file__,
        "City.from_files.bounds": BOUNDS,
        "name": "gps",
    },
    **{"source": "noise.tif", "cost": "high-is-bad", "scale": (0.0, 80.0), "text": "gps=1"},
    **{"Target.parse.text": "detour<=0.1", "outcome": "detour", "sense": "<=", "value": 0.1},
    **{
        "path": str(Path(__file__).parents[1] / "pyproject.toml"),
        "out": "/proc/none",
        "log": "no-such.csv",
    },
    **{
        "line": [START, GOAL],
        "groups": np.arange(9),
        "values": np.arange(9.0),
        "Clusters": ju.studies.Clusters(np.arange(9)),
        "sample_instances.num": 1,
        "study.instances": 1,
        "sensitivity.routes": 1,
        "sources": {"here": MAPS},
    },
    **{"obstacles": "touched", "metrics": ["gps"], "CostModel.from_settings.settings": {}},
    **{
        "PlannedPath.save.file": "path.geojson",
        "intercept": 0.0,
        "slope": 0.6,
        "scale_m": 2.0,
        "cut_m": 60.0,
        "half_width_m": 20.0,
    },
}
MADE_ONCE: dict[str, Callable[[], Any]] = {
    **dict.fromkeys(("city", "where"), lambda: ju.demo_city(400, 400)),
    "grid": lambda: (
        ju.build_maps(good("city"), resolution_m=50.0, altitudes_m=(20.0,), progress=False).grid
    ),
    **dict.fromkeys(
        ("planned", "paths", "PlannedPath", "overflown_density.path"),
        lambda: ju.plan(MAPS, START, GOAL, altitude_m=20.0),
    ),
    "density": lambda: ju.overflown_density(MAPS, good("planned"), half_width_m=20.0),
    "PlannedPaths": lambda: ju.plan_many(MAPS, [(START, GOAL)], altitude_m=20.0, progress=False),
    "demonstrations.routes": lambda: good("planned"),
    "check.mission": lambda: good("planned").save(Path(tempfile.mkdtemp()) / "path.plan"),
    "study": lambda: ju.studies.sample_instances(
        MAPS, 4, altitudes_m=[20.0], weights=[ju.Weights()]
    ),
    "quick": lambda: ju.studies.SensitivitySettings(vary=("gps",)),
    "OneRoute": lambda: (
        ju.studies.sensitivity(
            MAPS,
            tempfile.mkdtemp(),
            [(START, GOAL)],
            altitudes_m=[20.0],
            settings=good("quick"),
            progress=False,
        ).route
    ),
    "MapComparison": lambda: ju.studies.compare(MAPS, MAPS, progress=False),
    **dict.fromkeys(("cost_map", "CostMap", "on"), lambda: ju.cost_map(MAPS, 20.0)),
    "inputs": lambda: ju.grad.map_inputs(good("city"), good("grid"), altitudes_m=(20.0,))[0],
    "sky": lambda: ju.grad.map_inputs(good("city"), good("grid"), altitudes_m=(20.0,))[1],
    "params": lambda: ju.grad.SoftParams(altitude_m=20.0),
    "soft": lambda: ju.grad.soft_city(good("city"), good("grid"), good("params")),
    "fit_targets.queries": lambda: ju.studies.make_queries(good("cost_map"), [(START, GOAL)]),
    "problem": lambda: good("fit_targets.queries")[0].problem(np.ones(5)),
    "demonstrations": lambda: ju.fit.demonstrations(good("planned"), MAPS),
    "scenario": lambda: ju.Scenario.from_dict(SETTINGS),
}


@functools.cache
def good(what: str) -> Any:
    """Return what calls take for a parameter, by its name or by "function.parameter", made when it is first asked for.

    What methods are called on is by the name of its class.
    """
    return MADE_ONCE[what]() if what in MADE_ONCE else PLAIN[what]


def good_arguments(name: str) -> dict[str, Any]:
    """Return what a call needs beside the argument that is wrong; of methods what they are called on is "self"."""
    home, _, _ = name.rpartition(".")
    found = {"self": good(home)} if home in METHODS else {}
    parameters = inspect.signature(CALLS[name]).parameters
    usual = {"altitude_m", "progress", *(("start", "goal") if "goal" in parameters else ())}
    for parameter, of in parameters.items():
        own = f"{name}.{parameter}"
        if own in MADE_ONCE or own in PLAIN:
            found[parameter] = good(own)
        elif of.kind in (of.VAR_POSITIONAL, of.VAR_KEYWORD) or parameter == "self":
            continue
        elif of.default is of.empty or parameter in usual:
            found[parameter] = good(parameter)
    return found


# A wrong value of each parameter, by its name, or by "function.parameter" where it is another one.
LAYERS = {"gps": ju.Layer("a.tif", "high-is-bad", (0, 1))}
WRONG_VALUES: tuple[tuple[Any, str], ...] = (
    ("a-star", "planner planners distance_only heuristic objective"),
    ("cells", "cost_model preset CostModel.kind"),
    (("gsp",), "CostMap.only.metrics metrics layers"),
    ((1e300, 0.0), "start goal reference centre_lonlat place home"),
    ([(1e300, 0.0)], "places"),
    ("now", "time MetricMaps.m.time stop"),
    ("no/such/place", "folder line maps maps_a maps_b path file study where check.sources"),
    ("/proc/none", "MetricMaps.save.folder study.folder sensitivity.folder"),
    (
        "no-such.file",
        "table districts blocks_day blocks_night buildings no_fly log mission navigation validate.reference",
    ),
    ("path.txt", "PlannedPath.save.file PlannedPaths.save.file PlannedPath.save.more"),
    ("no/such/place.parquet", "plan_many.file"),
    ((-1e300, 1e300), "altitudes_m nest_with_m MetricMaps.m.altitude_m factors"),
    ((1.0, 2.0, 3.0, 4.0, 5.0), "scale field_of_view_deg bounds"),
    ({}, "cities sources"),
    ([], "queries demonstrations paths targets times"),
    (-1, "seed height_seed height_samples num_heights bootstrap routes instances"),
    (
        0,
        "max_rounds num num_segments num_threads workers budget_iterations max_samples oversample num_rows "
        "num_cols",
    ),
    (0, "beams azimuths step_s num_displaced"),
    (-1.0, "HeightStd.height HeightStd.levels HeightStd.default HeightStd.raster"),
    (10**30, "first_row first_col"),
    (-1, "ceiling_m"),
    (5, "connectivity source"),
    ("EPSG:4326", "crs"),
    ("gps", "require text"),
    (
        "none such",
        "nan hanging clocks quantity outcome time_of_day PlannedPath.save.end MetricMaps.m.name cost sense",
    ),
    (
        "none such",
        "kind Protection.isd MetricMaps.plot.name sample_city.name sample_instances.weights",
    ),
    (
        "none such",
        "OneRoute.breakpoints.name MetricMaps.plot.ax MetricMaps.plot.cmap MetricMaps.plot.paths",
    ),
    (3, "MetricMaps.plot.title"),
    (("gps.mask_deg",), "changes"),
    ((-1.0,), "other_pieces_m"),
    (("X",), "systems"),
    (-1.0, "known"),
    ((0.0, 1e-4), "IntegritySupport.tolerance_m"),
    ([5], "pairs"),
    ("none such", "height_column ground_column Population.column"),
    ({"gsp": 1.0}, "weights SoftParams.sections"),
    ({"connectivity": 5}, "CostModel.from_settings.settings"),
    ({**SETTINGS, "reigon": {}}, "Scenario.from_dict.settings"),
    (LAYERS, "build_maps.layers"),
    (pd.DataFrame({"start": [1]}), "plan_many.queries"),
    (
        RIGHT,
        "credit block_field district_field commercial levels_column zones "
        "Scenario.from_dict.name Scenario.from_dict.folder",
    ),
    # Known only with the maps, the files or the folder, or as good as none.
    (
        RIGHT,
        "Planning.planner Constraints.bounds "
        "Buildings.crs soft_city.layers all_maps.weights building_costs.weights MapsFolder.folder",
    ),
    (
        RIGHT,
        "SensitivitySettings.vary open_maps.obstacles",
    ),
    (
        RIGHT,
        "City.from_files.terrain Gps.orbits Buildings.source Terrain.source demonstrations.metrics "
        "Population.blocks "
        "City.from_files.vegetation Vegetation.source",
    ),
    (RIGHT, "Study.land_cover"),
)
WRONG = {name: value for value, names in WRONG_VALUES for name in names.split()}
WRONG_BY_TYPE = {"float": 1e300, "Literal": "none such"}  # of all other parameters


def public() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield every public function, constructor, class method and method of what functions return, by its name."""
    modules = {*NAMESPACES, PICTURES}
    spaces = [ju, *(importlib.import_module(f"jaxurban.{name}") for name in (*NAMESPACES, TYPES))]
    for name in [name for space in spaces for name in space.__all__ if name not in modules]:
        thing = find_public(name)
        if not inspect.isclass(thing) or name not in MADE:
            yield name, thing
        bases = [base for base in getattr(thing, "__mro__", ()) if base.__name__ == name]
        for method, function in (each for base in bases for each in vars(base).items()):
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


def call(name: str, parameter: str, value: Any) -> str:
    """Return what a call with a wrong argument answers."""
    function, given = CALLS[name], good_arguments(name)
    kind, args = (
        inspect.signature(function).parameters[parameter].kind,
        [given.pop("self")] if "self" in given else [],
    )
    if kind is kind.VAR_POSITIONAL:
        args += [given.pop("file"), value]
    else:
        given[f"my_{parameter}" if kind is kind.VAR_KEYWORD else parameter] = value
    with pytest.raises(ju.InputError) as raised:
        function(*args, **given)
    return str(raised.value)


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_a_wrong_type_names_the_argument(name, parameter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = call(name, parameter, object())
    assert parameter in told
    assert "\n" not in told


def words_of(parameter: str, value: Any) -> str:
    """Return what a sentence may call an argument: its name, the name in words, or the text that is wrong in it."""
    items = value if isinstance(value, list | tuple | dict) else [value]
    texts = [re.escape(item) for item in items if isinstance(item, str)]
    return "|".join([parameter, parameter.removesuffix("_m").replace("_", " "), *texts])


def types_of(name: str, parameter: str) -> set[str]:
    """Return what a parameter takes; none for a flag, a function or a thing whose own class is tested here."""
    hint = str(inspect.signature(CALLS[name]).parameters[parameter].annotation).partition(
        "Callable["
    )[0]
    return {
        *re.findall(
            r"\b(str|int|float|Path|Sequence|Iterable|tuple|Any|Mapping|dict|Literal)\b", hint
        )
    }


@pytest.mark.parametrize(("name", "parameter"), [each for each in PARAMETERS if types_of(*each)])
def test_a_wrong_value_names_the_argument(name, parameter, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    of_type = [wrong for kind, wrong in WRONG_BY_TYPE.items() if kind in types_of(name, parameter)]
    value = WRONG.get(f"{name}.{parameter}", WRONG.get(parameter, *of_type))
    assert value is not None, f"write a wrong value of {name}.{parameter} into WRONG, or RIGHT"
    if value is RIGHT:
        return
    told = call(name, parameter, value)
    assert re.search(words_of(parameter, value), told, re.IGNORECASE)
    assert "\n" not in told


WITHOUT_PEOPLE = ju.MetricMaps(MAPS.ds.drop_vars(["population", "density"]))


@pytest.mark.parametrize(
    ("name", "changed", "sentence"),
    [
        ("plan", {"altitude_m": LEFT_OUT}, "argument: 'altitude_m'"),
        (
            "plan",
            {"altitudes_m": 20},
            "plan: there is no argument 'altitudes_m' (did you mean 'altitude_m'?)",
        ),
        (
            "build_maps",
            {"altitude_m": 20},
            "there is no argument 'altitude_m' (did you mean 'altitudes_m'?)",
        ),
        ("plan", {"constraints": {"gps": 0.3}}, 'Constraints.read(require=["gps>=0.3"])'),
        ("plan", {"start": LEFT_OUT}, "argument: 'start'"),
        ("plan", {"goal": LEFT_OUT}, "argument: 'goal'"),
        ("plan", {"start_xy_m": (0, 0)}, "no argument 'start_xy_m'"),
        (
            "MetricMaps.m",
            {"self": WITHOUT_PEOPLE, "time_of_day": "noon"},
            "these maps hold none, so leave it out",
        ),
        (
            "plan",
            {"maps": 5},
            "maps must be MetricMaps (from build_maps or open_maps), a text or a path",
        ),
        (
            "plan",
            {"start": 5.0},
            "start must be a sequence of numbers or XY (longitude, latitude in degrees",
        ),
        ("plan", {"goal": ("a", 1)}, "(longitude, latitude in degrees), got tuple of 'a', 1"),
        ("plan", {"altitude_m": "low"}, "altitude_m must be a number or Levels (metres"),
        ("plan", {"weights": 5}, "weights must be Weights, a dict of numbers or None"),
        ("plan", {"weights": {"self": 1}}, "weights must be Weights or numbers"),
        (
            "make_queries",
            {"cost_map": MAPS},
            "cost_map must be CostMap (from cost_map), got MetricMaps",
        ),
        (
            "fit_weights",
            {"demonstrations": 5},
            "a sequence of Demonstration (from demonstrations), got 5",
        ),
        ("build_maps", {"gps": ju.Lidar()}, "gps must be Gps or None, got Lidar"),
        (
            "MetricMaps.is_free",
            {"obstacles": "toched"},
            "or None, got 'toched' (did you mean 'touched'",
        ),
        ("MetricMaps.is_free", {"altitude_m": float("nan")}, "altitude_m must be a finite number"),
        (
            "Constraints.read",
            {"no_fly": 5},
            "must be a text, a path or a sequence of texts or paths, got 5",
        ),
        (
            "Constraints",
            {"zones": 5},
            "zones must be a sequence of Zone (from Constraints.read), got 5",
        ),
        (
            "build_maps",
            {"layers": {"noise": np.zeros((2, 2))}},
            "got a dict of ndarray: write {'noise': Layer(...)}",
        ),
        ("FitSettings", {"max_rounds": True}, "max_rounds must be a whole number, got True"),
        ("SensitivitySettings", {"seed": -1}, "seed must be a whole number from 0 up, got -1"),
        ("SensitivitySettings", {"vary": 5}, "vary must be a sequence of texts, got 5"),
        (
            "PlannedPath.save",
            {"file": "a\0.plan"},
            r"cannot write 'a\x00.plan': no file's name can hold NUL",
        ),
    ],
)
def test_arguments_that_are_missing_misspelt_or_of_another_kind_name_the_remedy_or_the_kinds_that_they_may_be(
    name, changed, sentence
):
    given = {
        key: value
        for key, value in {**good_arguments(name), **changed}.items()
        if value is not LEFT_OUT
    }
    arguments = [given.pop("self")] if "self" in given else []
    with pytest.raises(ju.InputError) as raised:
        CALLS[name](*arguments, **given)
    assert sentence in str(raised.value)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: ju.plan(MAPS, START, GOAL, 20.0), "plan: too many positional arguments: write altitude_m=20.0"),
        (lambda: ju.plot.plot_paths(MAPS, *two_paths()), "plot_paths: too many positional arguments: give paths as"),
        (lambda: MAPS.m("gps", 61.0), "these maps hold 20.0, 60.0; name it in altitudes_m to make a map of it"),
        (lambda: ju.plot.plot_sky("out/maps"), "of must be SkyAt (from sky, as in sky(maps, place, 60.0))"),
        (lambda: ju.plot.plot_city(MAPS), "city must be City (from City.from_files, sample_city or demo_city), got M"),
        (lambda: ju.sky("out/maps", START, 60.0), "'out/maps' does not exist"),
        (lambda: ju.plan(MAPS, START, GOAL, altitude_m=20.0, planner="A*"), "got 'A*' (did you mean 'astar'?)"),
        (lambda: ju.plan(MAPS, MAPS.grid.xy_of_cell(2, 2), GOAL, altitude_m=20.0), "look like metres: give degrees"),
        (lambda: ju.plan(MAPS, START, GOAL, altitude_m=20.0, weights={"gps": "1"}), "got dict of 'gps': '1'"),
        (lambda: ju.plan_many(MAPS, "a.csv", altitude_m=20.0), "got 'a.csv': read a file with pandas.read_csv or"),
        (lambda: good("planned").plot("gps"), "plot: too many positional arguments"),
        (lambda: ju.plot.plot_paths(beside_maps(), good("planned")), "nowhere over these maps: give the maps that"),
        (lambda: ju.plot.plot_overview(beside_maps(), good("planned")), "nowhere over these maps: give the maps that"),
        (lambda: MAPS.plot().show(), "a picture has no window: write it to a file, as with savefig"),
        (lambda: ju.build_maps(good("city"), gps={"mask_deg": 5}), "got dict of 'mask_deg': 5: write Gps(mask_deg"),
        (lambda: ju.build_maps(good("city"), gps=ju.Gps), "got the class Gps: write Gps()"),
        (lambda: ju.build_maps(good("city"), layers=LAYERS["gps"]), 'write {"name": Layer(...)}'),
        (lambda: ju.City("a.osm"), "City: missing a required argument: 'extent_m': take City.from_files"),
        (lambda: ju.City.from_files("https://a.org/a.osm"), "is an address, not a file: download it first"),
        (lambda: ju.sky(ju.demo_city(400, 400), (40.779, -73.971), 60.0), "place: the point "),
    ],
)  # fmt: skip
def test_a_likely_mistake_is_answered_with_its_remedy(call, sentence):
    with pytest.raises(ju.InputError, match=re.escape(sentence)):
        call()


HOMES = {
    "build_maps": {
        "mask_deg": "gps=Gps(mask_deg=...)",
        "times_of_day": "population=Population(time_of_day=...)",
        "height_std": "heights=Heights(height_std_m=...)",
        **dict.fromkeys(
            ("metrics", "weights", "device", "seed", "gps_mask", "default_height_m"), ""
        ),
    },
    "cost_map": {"clearance_m": "constraints=Constraints.read(clearance_m=...)", "snap": ""},
    "MetricMaps.save": {"overwrite": ""},
    "plan": {
        "clearance_m": "constraints=Constraints.read(clearance_m=...)",
        "max_altitude_m": "altitude_m=Levels(max_altitude_m=...)",
        **dict.fromkeys(("levels", "closed", "volume", "simplify", "time_limit"), ""),
    },
    "study": {"planers": "settings=Study(planners=...)"},
}


@pytest.mark.parametrize(
    ("name", "wrong"), [(name, wrong) for name, homes in HOMES.items() for wrong in homes]
)
def test_an_unknown_argument_is_answered_by_what_takes_it_or_by_the_list_of_all_and_no_guess(
    name, wrong
):
    given, home = good_arguments(name), HOMES[name][wrong]
    method = CALLS[name].__get__(given.pop("self")) if "self" in given else CALLS[name]
    with pytest.raises(ju.InputError) as raised:
        method(**given, **{wrong: 1})
    remedy = (
        f" (give {home})"
        if home
        else f"; it takes {', '.join(inspect.signature(method).parameters)}"
    )
    assert str(raised.value) == f"{name.rpartition('.')[2]}: there is no argument {wrong!r}{remedy}"


@pytest.mark.parametrize(
    ("module", "name", "home"),
    [
        ("jaxurban", "fit_weights", "jaxurban.fit.fit_weights"),
        ("jaxurban", "all_maps", "jaxurban.grad.all_maps"),
        ("jaxurban", "Dop", "jaxurban.metrics.Dop"),
        ("jaxurban", "GpsParams", "jaxurban.Gps"),
        ("jaxurban.fit", "plan", "jaxurban.plan"),
        ("jaxurban", "openmaps", "jaxurban.open_maps"),
        ("jaxurban", "plann", "jaxurban.plan"),
        ("jaxurban", "load_maps", "jaxurban.open_maps"),
        ("jaxurban.plot", "plot_gps", "jaxurban.plot.plot_metric"),
    ],
)
def test_a_name_that_is_public_elsewhere_is_said_to_be_there(module, name, home):
    with pytest.raises(
        AttributeError, match=rf"has no attribute '{name}' \(did you mean {re.escape(home)}\?\)"
    ):
        getattr(importlib.import_module(module), name)
    assert not hasattr(ju, "BenchmarkSettings")


def test_a_missing_attribute_of_a_result_names_the_one_that_is_meant():
    path = ju.plan(MAPS, START, GOAL, altitude_m=20.0)
    for owner, wrong, meant in (
        (MAPS, "gps", '["gps"]'),
        (MAPS, "altitudes", "altitudes_m"),
        (MAPS.grid, "bounds", "bounds_m"),
        (path, "xy", "xy_m"),
        (path, "length", "length_m"),
        (path, "coords", "lonlat"),
        (path, "to_file", "save"),
        (path.plot(), "save", "savefig"),
    ):
        expected = (
            f"'{type(owner).__name__}' object has no attribute '{wrong}' (did you mean {meant}?)"
        )
        with pytest.raises(AttributeError, match=f"^{re.escape(expected)}$"):
            getattr(owner, wrong)
    with pytest.raises(AttributeError, match=r"has no attribute 'quite_another'$"):
        path.quite_another  # noqa: B018
    assert copy.deepcopy(path).length_m == path.length_m


def test_a_length_with_its_unit_is_answered_with_its_metres():
    for text, metres in (("200 ft", "60.96"), ("60m", "60")):
        with pytest.raises(
            ju.InputError, match=rf"^altitude_m is a number of metres, .* {metres}$"
        ):
            ju.plan(MAPS, START, GOAL, altitude_m=text)
    with pytest.raises(ju.InputError, match="altitudes_m is a number of metres, got '200ft'"):
        ju.build_maps(ju.demo_city(), altitudes_m=["200ft"])


def test_help_lists_the_sections_that_maps_are_made_with():
    parameters = inspect.signature(ju.build_maps).parameters
    assert {name: parameters[name].annotation for name in known_metrics()} == {
        name: metric.params | None for name, metric in known_metrics().items()
    }


def test_a_notebook_shows_ones_own_lines_and_the_sentence():
    source = "def make():\n    return ju.Gps(mask_deg=95)\n\nmake()"
    with pytest.raises(ju.InputError) as caught:
        exec(compile(source, "a cell", "exec"), {"ju": ju})  # as a kernel does
    shown = caught.value._render_traceback_()
    assert shown[-1] == f"InputError: {caught.value}"
    assert [line.partition(":")[0] for line in shown[-3:-1]] == ["line 4", "line 2"]
    assert len(caught.traceback) > len(shown)


def test_alternatives_of_one_planner_have_names_and_colours_of_their_own():
    texts = ju.plot.plot_paths(MAPS, two_paths()).findobj(Text)
    assert {"astar 1", "astar 2"} <= {text.get_text() for text in texts}
