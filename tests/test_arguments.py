"""No argument is ignored: each changes the result or is refused in a sentence, or the table says why neither can be.

`TABLE` has a value of every argument with a default of every public function and class. A new one without a row fails.
"""

import inspect
import json
import re
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any
from unittest.mock import patch

import click
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.cli.main import COMMANDS
from jaxurban.maps.build import compute_maps
from jaxurban.maps.run import load_city, tasks_of
from jaxurban.world.raster import Raster
from tests import arguments as on
from tests.arguments import BOX, ENGINE, GOAL, LATER, PROGRESS, START, WORKERS, Case, Same, home
from tests.cli_runs import run
from tests.test_misuse import CALLS

pytestmark = [
    pytest.mark.filterwarnings(f"ignore::jaxurban.errors.{each}")
    for each in ("GuessWarning", "OtherSettingsWarning", "SkippedRouteWarning")
]
pytestmark.append(pytest.mark.usefixtures("blank_pictures"))
TWO_SYSTEMS = ("sample:shinjuku/gps.tle", "sample:shinjuku/galileo.tle")
TOKYO = {"orbits": TWO_SYSTEMS, "times": "2018-12-19T03:00:00Z"}
SERIES = ("2020-04-27T16:00:00Z", "2020-04-27T18:00:00Z")
LEVELS = ju.Levels()
SMALL = {"resolution_m": 50.0, "altitudes_m": (20.0,)}


def zone() -> ju.Constraints:
    return ju.Constraints.read(home() / "zone.geojson")


def without(name: str, values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key != name}


ON_A_MAP = {  # which map, and how it is searched
    "weights": {"risk": 9.0},
    "objective": "distance",
    "cost_model": "cell",
    "time": LATER,
    "time_of_day": "night",
    "constraints": zone,
    "preset": "paper",
}
SEARCH = {
    "planner": "ptp",
    "heuristic": "landmarks",
    "backend": "jax",
    "budget_s": 1e-9,
    "max_samples": Case(50, {"planner": "bitstar-dist", "budget_s": 0.3}),
    "seed": Case(5, {"planner": "bitstar-dist", "budget_s": 0.3}),
    "snap": Case(False),
    "on_ground": True,
    "refine": True,
    "exposure": {"lidar": 1.0},
}
HEIGHTS = {
    "height_std_m": Case(ju.HeightStd(height=9.0), {"height_samples": 2}),
    "height_samples": 2,
}
SECTIONS = {
    "gps": ju.Gps(mask_deg=40.0),
    "lidar": ju.Lidar(range_m=20.0),
    "population": ju.Population(gamma_residential=9.0),
    "risk": ju.Risk(threshold_m=5.0),
    "gps_horizontal": ju.metrics.Dop(),
    "gps_vertical": ju.metrics.Dop(),
    "protection": ju.metrics.Protection(),
    "gps_floor": ju.metrics.GpsFloor(),
}
WITHOUT_FLOOR = Case(True, refused="these maps hold no GPS floor")
RULES = {"cost_model": "cell", "constraints": zone, "preset": "paper"}
MAP_OF = {"time": LATER, "time_of_day": "night"}
SKY = {
    "gps": ju.Gps(mask_deg=50.0),
    "sources": Case("no/such/folder", {"where": lambda: on.city()}, refused="sources"),
}


def made(**given: Any) -> Any:
    """Return maps without their attributes, which name settings that change no value as well."""
    return on.made(**given).ds.drop_attrs()


def maps_with(**given: Any) -> Any:
    return made(population=ju.Population(**given))


def with_people(**given: Any) -> Any:
    files = {"blocks": home() / "blocks.geojson"}
    return on.read(population=ju.Population(**files | given))


def with_gps(**given: Any) -> Any:
    return made(gps=ju.Gps(**given))


def under_trees(**given: Any) -> Any:
    return on.read(vegetation=home() / "canopy.tif", gps=ju.Gps(**given))


def of_kinds(**given: Any) -> Any:
    settings = {"region": {"bounds": BOX}, "buildings": {"source": str(home() / "few.geojson")}}
    settings |= {"vegetation": {"source": str(home() / "canopy.tif")}, "obstacles": given}
    return load_city(ju.Scenario.from_dict(settings)).plants


def few_maps() -> ju.MetricMaps:
    return ju.open_maps(home() / "few", 20.0)


def over_few() -> Any:
    west, south, east, _ = BOX
    start, goal = (west + 1e-4, south + 1e-4), (east - 1e-4, south + 1e-4)
    return ju.plan(few_maps(), start, goal, altitude_m=60.0).save(on.a_file("few.plan"))


@pytest.fixture(scope="module", autouse=True)
def cities() -> Iterator[None]:
    """The city of maps is read from its files once, and not by each call that looks at it."""
    known = dict[str, ju.City]()

    def read(scenario: ju.Scenario) -> ju.City:
        key = f"{scenario.path_of('.')} {scenario.to_toml()}"
        return known.get(key) or known.setdefault(key, load_city(scenario))

    with patch("jaxurban.maps.run.load_city", read):
        yield


@cache
def few() -> ju.City:
    return on.read()[0]


def scenario(**region: Any) -> Any:
    bounds = (-74.0, 40.755, -73.995, 40.759)
    settings = {"bounds": bounds, "resolution_m": 50.0, "altitudes_m": [20.0]} | region
    of = ju.Scenario.from_dict({"region": settings, "buildings": {"source": "synthetic"}})
    return [compute_maps(task) for task in tasks_of(of)]


def protected(**given: Any) -> Any:
    usual = {"horizontal_alert_limit_m": 20.0, "vertical_alert_limit_m": 30.0}
    gps = given.pop("gps", ju.Gps())
    return made(protection=ju.metrics.Protection(**usual | given), gps=gps)


def saved(**given: Any) -> bytes:
    suffix = given.pop("suffix", ".plan")
    return on.path().save(on.a_file(f"path{suffix}"), **given)


def raster_city(**given: Any) -> ju.MetricMaps:
    x, y = np.meshgrid(np.arange(8), np.arange(8))
    roofs = Raster(
        np.where((x % 3 > 0) & (y % 3 > 0), 30.0, 0.0).astype(np.float32),
        (10.0, 0, 0, 0, -10.0, 80.0),
        "EPSG:32618",
    )
    raster = ju.City("EPSG:32618", (0.0, 0.0, 80.0, 80.0), roofs=roofs)
    heights = ju.Heights(height_std_m=ju.HeightStd(**given), height_samples=2)
    return ju.build_maps(
        raster, resolution_m=20.0, altitudes_m=(20.0,), progress=False, heights=heights
    )


def texts_of(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text)]


def demos(**given: Any) -> Any:
    return ju.fit.demonstrations(on.instances(), on.maps(), **given)


def fit_of(**given: Any) -> Any:
    usual = {"settings": ju.fit.FitSettings(max_rounds=2), "bootstrap": 2}
    return ju.fit.fit_weights(on.routes(), **usual | given)


def targets(**given: Any) -> Any:
    queries = ju.studies.make_queries(on.on(), [(START, GOAL)], snap=True)
    usual = {"settings": ju.fit.FitSettings(max_rounds=3)}
    return ju.fit.fit_targets(queries, ["detour<=0.001", "mean_lidar>=0.95"], **usual | given)


@cache
def a_track() -> Any:
    from tests.satellite_logs import heard

    return heard()


def validated(log: Any = None, **given: Any) -> Any:
    from tests.receivers.receiver_logs import scenario

    settings = given.pop("settings", None)
    if settings is None:
        settings = ju.studies.ReceiverSettings(**given)
        given = {}
    log = a_track() if log is None else log
    return ju.studies.validate(scenario(), log, settings, progress=False, **given)


def page(**given: Any) -> Any:
    """Return what the page of a viewer shows first: its scene but for its key, and its outlines."""
    with patch("jaxurban.viewer.widget.widget_of", lambda viewer: viewer):
        viewer = ju.view(given.pop("maps", on.maps()), **given)
    scene = json.loads(viewer.answer("scene", {}).body)
    return {**scene, "key": ""}, viewer.answer("outlines", {})


# What is called with the argument; left out, the function on the town.
USES: dict[str, Callable[..., Any]] = {
    "Buildings": lambda **given: on.read(
        ju.Buildings(home() / "few.geojson", **without("bounds", given)),
        bounds=given.get("bounds", BOX),
    ),
    "City.from_files": lambda **given: on.read(**given),
    "City.why": lambda **given: few().why(**{"lon": BOX[0], "lat": BOX[1]} | given),
    "Constraints": on.with_limits,
    "Constraints.read": lambda **given: on.planned(constraints=ju.Constraints.read(**given)),
    "CostMap.plan": lambda **given: on.on().plan(
        **{"start": START, "goal": GOAL, "snap": True, "budget_s": 60.0} | given
    ),
    "CostModel": lambda **given: on.planned(cost_model=ju.CostModel(**given)),
    "Gps": with_gps,
    "Grid.from_bounds": lambda **given: ju.Grid.from_bounds(BOX, 20.0, **given),
    "HeightStd": lambda **given: on.read(
        ju.Buildings(home() / "few.geojson", height_std_m=ju.HeightStd(**given), height_samples=2)
    )[1],
    "Heights": lambda **given: ju.build_maps(
        few(), resolution_m=20.0, altitudes_m=(10.0,), progress=False, heights=ju.Heights(**given)
    ),
    "Layer": on.layered,
    "Levels": lambda **given: on.planned(
        start=(*START, 60.0), goal=(*GOAL, 60.0), altitude_m=ju.Levels(**given)
    ),
    "Lidar": lambda **given: made(lidar=ju.Lidar(**given)),
    "MetricMaps.m": lambda **given: on.maps().m(
        given.pop("name", "gps"), **{"altitude_m": 20.0, **given}
    ),
    "MetricMaps.is_free": lambda **given: on.maps().is_free(20.0, **given),
    "MetricMaps.costs": lambda **given: on.maps().costs(20.0, **given),
    "MetricMaps.total": lambda **given: on.maps().total(20.0, **given),
    "MetricMaps.normalised": lambda **given: on.maps().normalised(20.0, **given),
    "MetricMaps.plot": lambda **given: texts_of(on.maps().plot(**given)),
    "MetricMaps.save": lambda **given: sorted(
        each.name for each in (on.maps().save(on.a_file("maps"), **given) / "geotiff").iterdir()
    ),
    "Obstacles": of_kinds,
    "PlannedPath.save": saved,
    "PlannedPaths.to_dataframe": lambda **given: on.many().to_dataframe(**given),
    "Planning": on.under,
    "Population": maps_with,
    "Region": scenario,
    "Risk": lambda **given: made(risk=ju.Risk(**given), resolution_m=20.0),
    "Scenario.from_toml": lambda **given: ju.Scenario.from_toml(home() / "town.toml", **given),
    "Scenario.from_dict": lambda **given: (
        ju.Scenario.from_dict(
            {"region": {"bounds": BOX}, "buildings": {"source": "few.geojson"}}
            | given.pop("more", {}),
            **given,
        )
        .path_of("few.geojson")
        .as_posix()
    ),
    "Terrain": lambda **given: on.read(terrain=ju.Terrain(**given)),
    "Vegetation": lambda **given: on.read(vegetation=ju.Vegetation(**given)),
    "Vehicle": on.flown,
    "Weights": lambda **given: on.planned(weights=ju.Weights(**given)),
    "Weights.parse": lambda **given: ju.Weights.parse("gps=2", **given),
    "build_maps": on.made,
    "cite": lambda **given: ju.cite(**{"maps": on.maps()} | given),
    "cautions": lambda **given: ju.cautions(on.path(), on.maps(), **given),
    "check": on.checked,
    "cost_map": lambda **given: ju.cost_map(on.maps(), 20.0, **given),
    "cost_to_go": lambda **given: ju.cost_to_go(
        on.maps(), **{"goal": GOAL, "altitude_m": 20.0, "snap": True} | given
    ),
    "demo_city": lambda **given: ju.demo_city(**{"width_m": 400, "height_m": 400} | given),
    "explain": lambda **given: ju.explain(on.path(), on.maps(), **given),
    "open_maps": lambda **given: ju.open_maps(home() / "maps", **{"resolution_m": 20.0} | given),
    "overflown_density": lambda **given: ju.overflown_density(
        on.maps(), on.path(), half_width_m=20.0, **given
    ),
    "plan": on.planned,
    "plan_many": on.many,
    "return_altitude": lambda **given: on.returned(**{"home": GOAL} | given),
    "sample_city": lambda **given: ju.sample_city("nihonbashi", **given).kinds,
    "sky": lambda **given: ju.sky(given.pop("where", home() / "maps"), START, 20.0, **given),
    "sky_along": lambda **given: ju.sky_along(
        given.pop("where", home() / "maps"), [on.BETWEEN, GOAL], **{"altitude_m": 3.0} | given
    ),
    "view": page,
    "when": on.at_times,
    "FitSettings": on.fitted,
    "demonstrations": demos,
    "fit_targets": targets,
    "fit_weights": fit_of,
    "ReceptionCurve": lambda **given: ju.grad.ReceptionCurve(0.0, 1.5, 2.0, 60.0, **given),
    "SoftParams": lambda **given: on.soft(ju.grad.SoftParams(20.0, **given)),
    "all_maps": lambda **given: ju.grad.all_maps(
        (made := ju.grad.map_inputs(on.city(), on.made_grid(), altitudes_m=(20.0,)))[0],
        on.jax.tree.map(lambda values: values[0], made[1]),
        **given,
    ),
    "map_inputs": lambda **given: ju.grad.map_inputs(
        on.city(), on.made_grid(), **{"altitudes_m": (20.0,)} | given
    ),
    "planned_cost": lambda **given: ju.grad.planned_cost(
        on.on().problem.between((9, 2), (9, 30)), **given
    )(on.on().costs, on.on().weight_vector),
    "soft_city": lambda **given: on.soft(ju.grad.SoftParams(20.0), **given),
    "Dop": lambda **given: made(gps_horizontal=ju.metrics.Dop(**given)),
    "GpsFloor": lambda **given: made(gps_floor=ju.metrics.GpsFloor(**given)),
    "Protection": protected,
    "IntegritySupport": lambda gps=None, **given: protected(
        isd=ju.typing.IntegritySupport(**given), gps=gps or ju.Gps()
    ),
    "MapsFolder": lambda **given: ju.studies.MapsFolder(
        home() / "maps", **{"resolution_m": 20.0} | given
    ).open(),
    "ReceiverSettings": validated,
    "SensitivitySettings": on.of_weights_study,
    "Study": on.of_study,
    "building_costs": lambda **given: ju.studies.building_costs(
        on.city(),
        ju.grad.soft_city(on.city(), on.made_grid(), ju.grad.SoftParams(60.0)),
        ju.plan(
            on.made(altitudes_m=(60.0,)),
            (-73.972, 40.7785),
            (-73.9685, 40.781),
            altitude_m=60.0,
            snap=True,
        ),
        ju.grad.SoftParams(60.0),
        **given,
    ),
    "compare": lambda **given: ju.studies.compare(
        on.few_levels(),
        ju.MetricMaps(on.few_levels().ds.assign(risk=on.few_levels().ds["risk"] * 0.9)),
        **{"progress": False} | given,
    ),
    "make_queries": lambda **given: ju.studies.make_queries(on.on(), [(START, GOAL)], **given),
    "sample_instances": lambda **given: ju.studies.sample_instances(
        on.maps(), **{"num": 3} | given
    ),
    "sensitivity": on.weights_study,
    "Clusters": lambda **given: ju.studies.Clusters(np.arange(20), **given).interval(
        np.arange(20.0) ** 2
    ),
    "Clusters.interval": lambda **given: ju.studies.Clusters(np.arange(8)).interval(
        np.arange(8.0) ** 2, **given
    ),
    "study": on.a_study,
    "validate": validated,
}
TABLE: dict[str, dict[str, Any]] = {
    "Buildings": HEIGHTS
    | {
        "highest_m": 5.0,
        "heights": "estimated",
        "kind": Case("surface", refused="surface"),
        "default_height_m": 50.0,
        "level_height_m": 9.0,
        "allow": Case(("none",), {"bounds": (-73.9, 40.7, -73.899, 40.701)}),
        "hanging": "slabs",
        "credit": "a surveyor",
        "height_column": Case("height", refused="height_column and unit go together"),
        "ground_column": Case("min_height", {"height_column": "height", "unit": "m"}),
        "levels_column": "height",
        "unit": Case("ft", refused="height_column and unit go together"),
        "crs": Case(
            "EPSG:3857",
            {"bounds": (-73.9, 40.7, -73.899, 40.701)},
            refused="no building in the region",
        ),
    },
    "City.from_files": {
        "bounds": (-74.0, 40.7548, -73.9985, 40.757),
        "crs": "EPSG:32617",
        "population": lambda: ju.Population(blocks=home() / "blocks.geojson"),
        "terrain": lambda: home() / "ground.tif",
        "gps": ju.Gps(mask_deg=45.0),
        "vegetation": lambda: home() / "canopy.tif",
        "kinds": ("building",),
    },
    "Constraints": {
        "zones": lambda: zone().zones,
        "bounds": ju.Constraints.read(require=["lidar>=0.1"]).bounds,
        "clearance_m": 25.0,
        "vertical_clearance_m": 15.0,
        "vehicle": ju.Vehicle(speed_m_s=20.0),
        "unknown_heights": "highest",
        "above_gps_floor": WITHOUT_FLOOR,
    },
    "Constraints.read": {
        "no_fly": lambda: home() / "zone.geojson",
        "require": ["lidar>=0.1"],
        "clearance_m": 25.0,
        "vertical_clearance_m": 15.0,
        "vehicle": ju.Vehicle(speed_m_s=20.0),
        "unknown_heights": "highest",
    },
    "CostMap.plan": SEARCH,
    "CostModel": {
        "kind": "cell",
        "reference_length_m": 50.0,
        "connectivity": 4,
        "diagonal": "always",
    },
    "Gps": {
        "gdop_threshold": 5.0,
        "series": "statistics",
        "availability_threshold": Case(0.9, {"series": "statistics"}),
        "bounds": Case(True, {"clocks": "one"}),
        "clocks": Case("one", TOKYO),
        "orbits": Case(TWO_SYSTEMS, without("orbits", TOKYO)),
        "times": LATER,
        "step_s": Case(3600, {"times": SERIES}),
        "mask_deg": 40.0,
        "max_age_days": Case(0.01, TOKYO, refused="days"),
        "reference": (-60.0, 50.0),
        "plants": Case("hide", {"use": under_trees}),
    },
    "Grid.from_bounds": {"crs": "EPSG:32617", "nest_with_m": (70.0,)},
    "HeightStd": {
        "height": 9.0,
        "levels": 9.0,
        "default": 9.5,
        "raster": Case(9.0, {"use": raster_city}),
    },
    "Heights": HEIGHTS,
    "Layer": {
        "altitudes_m": Case(
            (60.0, 20.0),
            {"source": lambda: np.stack([np.zeros(made_shape()), np.ones(made_shape())])},
        ),
        "nan": Case("error", {"source": lambda: np.full(made_shape(), np.nan)}),
        "reach_m": Case(50.0, refused="reach_m"),
        "soft": Same("maps are exact: the row of soft_city has a layer with a soft form"),
        "credit": "a surveyor",
    },
    "Levels": {
        "min_altitude_m": 60.0,
        "max_altitude_m": Case(40.0, refused="level|altitude"),
        "level_step_m": 10.0,
        "climb_cost": 9.0,
        "descent_cost": 9.0,
    },
    "Lidar": {"beams": 3, "field_of_view_deg": (-5.0, 5.0), "azimuths": 8, "range_m": 20.0},
    "MetricMaps.m": {
        "altitude_m": 60.0,
        "time": LATER,
        "time_of_day": Case("night", {"name": "population", "altitude_m": None}),
    },
    "MetricMaps.is_free": {"obstacles": "centre"},
    "MetricMaps.costs": MAP_OF,
    "MetricMaps.total": MAP_OF,
    "MetricMaps.normalised": MAP_OF,
    "MetricMaps.plot": {
        "name": "gps",
        "altitude_m": 40.0,
        "time": LATER,
        "time_of_day": "night",
        "width": "column",
        "title": "GPS downtown",
        "ax": Case(5, refused="ax must be one cell"),
        "cmap": Case("none such", refused="cmap must be"),
        "paths": Case(5, refused="paths must be"),
    },
    "MetricMaps.save": {"layers": ("hdop",)},
    "PlannedPath.save": {
        "report": Case(lambda: ju.explain(on.path(), on.maps()), {"suffix": ".geojson"}),
        "end": "return",
        "autopilot": "ardupilot",
    },
    "Planning": {
        "preset": "paper",
        "planner": "ptp",
        "cost_model": "cell",
        "obstacles": "centre",
        "clearance_m": 15.0,
        "vertical_clearance_m": 15.0,
        "unknown_heights": "highest",
        "budget_s": 9.0,
        "seed": 5,
    },
    "Population": {
        "gamma_commercial": 9.0,
        "gamma_residential": 9.0,
        "quantity": "count",
        "normalise": "p50",
        "blocks": Case(lambda: home() / "blocks.geojson", {"use": on.read}),
        "block_field": Case(
            "other_id", {"use": with_people, "table": lambda: home() / "other.csv"}
        ),
        "table": Case(lambda: home() / "table.csv", {"use": with_people}),
        "districts": Case(lambda: home() / "districts.geojson", {"use": with_people}),
        "district_field": Case(
            "zone",
            {
                "use": with_people,
                "districts": lambda: home() / "districts.geojson",
                "commercial": [101],
            },
        ),
        "blocks_day": Case(
            lambda: home() / "day.tif",
            {"use": with_people, "blocks": None, "blocks_night": lambda: home() / "night.tif"},
        ),
        "blocks_night": Case(
            lambda: home() / "night.tif",
            {"use": with_people, "blocks": None, "blocks_day": lambda: home() / "day.tif"},
        ),
        "credit": Case("a census", {"use": with_people}),
        "column": Case("other_id", {"use": with_people}),
        "commercial": Case(
            [110], {"use": with_people, "districts": lambda: home() / "districts.geojson"}
        ),
        "time_of_day": "night",
    },
    "Region": {
        "crs": "EPSG:32617",
        "resolution_m": 25.0,
        "altitudes_m": [60.0],
        "oversample": 3,
    },
    "Risk": {"threshold_m": 5.0, "distance": "solid"},
    "Scenario.from_toml": {"changes": ["gps.mask_deg=50"]},
    "Scenario.from_dict": {
        "name": Case("my.toml", {"more": {"reigon": {}}}, refused="my.toml"),
        "folder": "elsewhere",
    },
    "Obstacles": {"kinds": ("building",)},
    "Terrain": {"source": lambda: home() / "ground.tif", "credit": "a surveyor"},
    "Vegetation": {"source": lambda: home() / "canopy.tif", "credit": "a surveyor"},
    "Vehicle": {
        "max_climb_m_s": 0.1,
        "max_descent_m_s": Case(0.1, {}),
        "max_turn_deg": 5.0,
        "speed_m_s": 7.0,
        "power_w": Case(90.0, {"speed_m_s": 7.0}),
    },
    "Weights": {"distance": 9.0},
    "Weights.parse": {"base": ju.Weights(risk=5.0)},
    "build_maps": SECTIONS
    | {
        "bounds": (-73.972, 40.779, -73.971, 40.780),
        "grid": Case(lambda: on.made_grid(), {"bounds": BOX}, refused="either bounds or grid"),
        "resolution_m": 40.0,
        "altitudes_m": (60.0,),
        "oversample": 3,
        "heights": ju.Heights(height_samples=2),
        "layers": lambda: {"noise": ju.Layer(np.zeros(made_shape()), "high-is-bad", (0.0, 1.0))},
        "engine": ENGINE,
        "progress": PROGRESS,
    },
    "cautions": {
        "profile": lambda: ju.explain(on.path(), on.maps()).profile.iloc[:3].assign(hdop=np.inf)
    },
    "cite": {"maps": None, "form": "bibtex"},
    "check": {
        "heights": Case("home", {"mission": lambda: on.a_mission(".kml")}),
        "home": Case(
            (-73.9985, 40.7565), {"mission": lambda: on.a_mission(".kml"), "heights": "home"}
        ),
        "home_above_ground_m": 5.0,
        "return_altitude_m": Case(
            90.0, {"mission": lambda: on.path().save(on.a_file("back.plan"), end="return")}
        ),
        "autopilot": Case(
            "ardupilot", {"mission": lambda: on.a_mission(".plan")}, refused="leave autopilot="
        ),
        "geoid_m": Case(-33.0, {"mission": lambda: on.a_mission(".kml"), "heights": "ellipsoid"}),
        "constraints": zone,
        "time": LATER,
        "time_of_day": "night",
        "max_no_fix_m": 0.5,
        "max_people": 0.001,
        "ceiling_m": 2,
        "sources": Case(
            "no/such/folder", {"mission": lambda: over_few(), "maps": lambda: few_maps()}
        ),
    },
    "cost_map": ON_A_MAP,
    "cost_to_go": ON_A_MAP
    | {
        "snap": Case(False, {"goal": START}),
        "backend": Same("both find the exact costs"),
    },
    "sample_city": {"kinds": ("building",)},
    "demo_city": {
        "width_m": 500.0,
        "height_m": 500.0,
        "centre_lonlat": (-73.9, 40.7),
        "crs": "EPSG:32617",
        "seed": 3,
    },
    "explain": {
        "maps": Same("left out, they are those that the path names"),
        "speed_m_s": 5.0,
        "power_w": Case(90.0, {"speed_m_s": 5.0}),
        "swath_m": 50.0,
        "num_segments": 3,
    },
    "open_maps": {"resolution_m": 40.0, "obstacles": "centre"},
    "overflown_density": {
        "contingency_m": 40.0,
        "buffer_m": 90.0,
        "cell_m": 60.0,
        "time_of_day": "night",
        "num_segments": 3,
    },
    "plan": ON_A_MAP | SEARCH,
    "plan_many": ON_A_MAP
    | SEARCH
    | {
        "altitude_m": 60.0,
        "file": Same("it keeps the rows of an interrupted call: the result is the same"),
        "num_threads": Same("any number of threads finds the same paths"),
        "progress": PROGRESS,
    },
    "return_altitude": {
        "clearance_m": 30.0,
        "vertical_clearance_m": 9.0,
        "ceiling_m": 2,
    },
    "sky": SKY | {"time": LATER},
    "sky_along": SKY | {"altitude_m": 60.0, "times": LATER, "speed_m_s": 10.0},
    "view": {
        "weights": {"risk": 9.0},
        "preset": "paper",
        "sources": Case("no/such/folder", {"maps": lambda: few_maps()}),
    },
    "when": ON_A_MAP
    | SEARCH
    | {
        "altitude_m": 60.0,
        "progress": PROGRESS,
        "time": Case(LATER),
        "time_of_day": Case("night"),
    },
    "FitSettings": {
        "max_rounds": 1,
        "seed": 5,
        "budget_s": 1e-9,
        "progress": PROGRESS,
    },
    "demonstrations": RULES
    | MAP_OF
    | {"altitude_m": 60.0, "pilot": ju.Weights(gps=9.0), "metrics": ["risk"]},
    "fit_targets": {
        "before": ju.Weights(risk=9.0),
        "hold_out": 0.5,
        "settings": ju.fit.FitSettings(max_rounds=1, seed=3),
    },
    "fit_weights": {
        "hold_out": 0.5,
        "bootstrap": 4,
        "settings": ju.fit.FitSettings(max_rounds=1, seed=3),
    },
    "ReceptionCurve": {"source": "a log"},
    "SoftParams": {
        "softness_m": 9.0,
        "sections": {"risk": ju.Risk(threshold_m=300.0)},
        "reception": ju.grad.ReceptionCurve(0.0, 1.5, 2.0, 60.0),
    },
    "all_maps": {"weights": ju.Weights(risk=5.0)},
    "map_inputs": SECTIONS | {"altitudes_m": (60.0,)},
    "planned_cost": {"planner": "ptp"},
    "soft_city": {
        "layers": lambda: {
            "noise": ju.Layer(
                lambda surface, altitude_m: surface.crop(surface.roof_m) + altitude_m,
                "high-is-bad",
                (0.0, 99.0),
                soft=lambda surface, altitude_m, softness_m: surface.crop(surface.roof_m),
            )
        }
    },
    "Dop": {"dop_threshold": 5.0},
    "GpsFloor": {"dop_threshold": 3.0, "dop": Case("vdop", {"dop_threshold": 3.0})},
    "Protection": {
        "horizontal_alert_limit_m": 60.0,
        "vertical_alert_limit_m": 1.0,
        "isd": ju.typing.IntegritySupport(sigma_ura_m=5.0),
    },
    "IntegritySupport": {
        "sigma_ura_m": 5.0,
        "sigma_ure_m": 5.0,
        "bias_m": 5.0,
        "p_sat": 1e-3,
        "p_const_gps": 1e-3,
        "p_const": Case(1e-3, {"gps": ju.Gps(**TOKYO)}),
        "phmi_horizontal": 1e-3,
        "phmi_vertical": 1e-3,
        "pfa_horizontal": 1e-3,
        "pfa_vertical": 1e-3,
        "p_unmonitored": 1e-9,
        "tolerance_m": (1.0, 1.0),
    },
    "MapsFolder": {"resolution_m": 40.0, "obstacles": "centre"},
    "ReceiverSettings": {
        "antenna_height_m": 9.0,
        "sky_step_s": Same("the log holds the directions of its satellites"),
        "block_m": 90.0,
        "known": "all",
        "systems": ("E",),
        "seed": 3,
    },
    "SensitivitySettings": {
        "vary": ("risk",),
        "factors": (0.5, 2.0),
        "wrong": 30.0,
        "num_heights": 1,
        "seed": 3,
        "height_seed": 3,
    },
    "Clusters": {"cities": np.arange(20) % 2, "seed": 3},
    "Clusters.interval": {"statistic": "median"},
    "Study": {
        "instances": 3,
        "planners": "ptp",
        "distance_only": (),
        "altitudes_m": [60.0],
        "land_cover": Case("town.osm", refused="land_cover"),
        "weights": (ju.Weights(risk=9.0),),
        "budget_s": 1e-9,
        "budget_iterations": 50,
        "seed": 3,
        "backend": "jax",
    },
    "building_costs": {"weights": ju.Weights(lidar=50.0)},
    "compare": {
        "routes": 2,
        "seed": Case(3, {"routes": 2}),
        "progress": PROGRESS,
    },
    "make_queries": {"snap": True},
    "sample_instances": RULES
    | {
        "num": 4,
        "cost_model": ju.CostModel(reference_length_m=50.0),
        "altitudes_m": [60.0],
        "weights": [ju.Weights()],
        "cover": lambda: covered(),
        "seed": 3,
    },
    "sensitivity": RULES
    | {
        "folder": Same("it decides where the study is kept"),
        "routes": 3,
        "altitudes_m": [20.0],
        "weights": {"risk": 9.0},
        "snap": Same("drawn ends are free; the command's row has a route of a closed one"),
        "settings": ju.studies.SensitivitySettings(vary=("risk",)),
        "workers": WORKERS,
        "overwrite": Same("it decides what a folder of other settings may lose"),
        "progress": PROGRESS,
    },
    "study": RULES
    | {
        "instances": 3,
        "settings": ju.studies.Study(planners="ptp"),
        "workers": WORKERS,
        "overwrite": Same("it decides what a folder of other settings may lose"),
        "progress": PROGRESS,
    },
    "validate": {
        "log": Case(lambda: a_track().iloc[:400]),
        "settings": ju.studies.ReceiverSettings(block_m=90.0),
        "navigation": Case("none.rnx", refused="none.rnx|navigation|RINEX"),
        "reference": Case("none.csv", refused="none.csv|reference|RINEX"),
        "progress": PROGRESS,
    },
}
SLOW = (
    "Constraints.read",
    "Levels",
    "MetricMaps.plot",
    "MetricMaps.save",
    "Study",
    "Vehicle",
    "compare",
    "sample_city",
    "ReceiverSettings",
    "validate",
    "FitSettings",
    "fit_targets",
    "fit_weights",
    "building_costs",
    "sensitivity",
    "when",
    "SoftParams",
    "all_maps",
    "Buildings",
    "City.from_files",
    "Constraints",
    "CostMap.plan",
    "Gps",
    "Population",
    "Protection",
    "Region",
    "SensitivitySettings",
    "Terrain",
    "build_maps",
    "check",
    "plan",
    "plan_many",
    "soft_city",
)


def made_shape() -> tuple[int, int]:
    return on.made_grid().shape


def covered() -> Any:
    from jaxurban.world.land_cover import LandCover

    box = on.shapely.box(*on.maps().grid.bounds_m)
    return LandCover(water=box, park=on.shapely.Polygon())


def lazily(value: Any) -> Any:
    """Return a value, which a function of the table makes when it is needed."""
    return (
        value() if inspect.isfunction(value) and not inspect.signature(value).parameters else value
    )


def test_every_argument_with_a_default_has_a_row():
    wanted = {
        (name, parameter.name)
        for name, function in CALLS.items()
        for parameter in inspect.signature(function).parameters.values()
        if parameter.default is not parameter.empty
    }
    assert {(name, each) for name, rows in TABLE.items() for each in rows} == wanted


def why_ignored(name: str, argument: str) -> str:
    """Return why an argument counts as ignored; "" where it changes the result, or its error names it."""
    row = TABLE[name][argument]
    if isinstance(row, Same):
        return ""
    case = row if isinstance(row, Case) else Case(row)
    beside = {key: value if key == "use" else lazily(value) for key, value in case.beside.items()}
    use = beside.pop("use", USES[name])
    value = lazily(case.value)
    kind, result = on.outcome(lambda: use(**{**beside, argument: value}))
    if case.refused is not None or kind == "error":
        pattern = case.refused or f"{argument}|{argument.removesuffix('_m').replace('_', ' ')}"
        if kind == "error" and re.search(pattern, result):
            return ""
        return f"{name}({argument}={value!r}): not refused, or by {str(result)[:200]!r}"
    usual = on.outcome(lambda: use(**beside)) if case.beside else usual_of(name)
    return f"{name}({argument}={value!r}) changes nothing" if usual == (kind, result) else ""


@cache
def usual_of(name: str) -> tuple[str, Any]:
    """Return the outcome of a call without the argument, which most arguments share."""
    return on.outcome(USES[name])


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=[pytest.mark.slow] * (each in SLOW)) for each in TABLE]
)
def test_no_argument_is_ignored(name):
    ignored = [why_ignored(name, argument) for argument in TABLE[name]]
    assert not list(filter(None, ignored)), "\n".join(filter(None, ignored))


# Commands: their words, and a value of each option, "" for a flag; `{...}` are files (see `files`).
ROUTE = ("--start={start}", "--goal={goal}", "--altitude=20", "--resolution=20", "--snap")
OF_ROUTE = {
    "--start": "-73.99411,40.755028",
    "--goal": "-73.993819,40.758629",
    "--altitude": "60",
    "--time-of-day": "night",
    "--time": LATER,
    "--resolution": "40",
    "--preset": "paper",
    "--weights": "risk=9",
    "--no-fly": "{home}/zone.geojson",
    "--require": "lidar>=0.1",
    "--rules clearance_m": "25",
    "--rules vertical_clearance_m": "15",
    "--rules unknown_heights": "highest",
    "--snap": "1",
}
OF_CORRIDOR = {
    "--corridor half_width_m": "20",
    "--corridor contingency_m": Case("40,half_width_m=20", ("--corridor=20",)),
    "--corridor buffer_m": Case("90,half_width_m=20", ("--corridor=20",)),
    "--corridor cell_m": Case("60,half_width_m=20", ("--corridor=20",)),
}
RULES_OF_ROUTES = {
    name: case
    for name, case in OF_ROUTE.items()
    if name.startswith(("--preset", "--no-fly", "--require", "--rules"))
}
KNOWN_HEIGHTS = Same("no height of the made city is unknown; tests/paths/test_unknown_heights.py")
DEVICE = Same("any device makes the same result, to rounding")
JSON = Same("it is how a result is printed")
OVERWRITE = Same("it decides what a folder of other settings may lose")
OPTIONS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "plan": (
        ("{home}/maps", *ROUTE, "--planner=budget_s=60"),
        OF_ROUTE
        | {
            "--planner planner": "ptp",
            "--planner heuristic": "landmarks",
            "--planner backend": "jax",
            "--planner budget_s": "1e-9",
            "--planner max_samples": Case("50", ("--planner=bitstar-dist,budget_s=0.3",)),
            "--planner seed": "5",
            "--refine": "",
            "--exposure": "lidar<=1",
            "--objective": "distance",
            "--volume goal_altitude_m": Case("60", ("--volume",)),
            "--volume min_altitude_m": Case("60", ("--volume", "--altitude=60")),
            "--volume max_altitude_m": Case("20", ("--volume",)),
            "--volume level_step_m": Case("10", ("--volume",)),
            "--volume climb_cost": Case("9,goal_altitude_m=60", ("--volume=60", "--resolution=20")),
            "--volume descent_cost": Case("9,goal_altitude_m=20", ("--volume=20", "--altitude=60")),
            "--report speed_m_s": "5",
            "--report power_w": Case("90,speed_m_s=5", ("--report=5",)),
            "--report swath_m": Case("50", ("--report",)),
            "--profile": Case("profile.txt", refused="profile.txt"),
            "--when": Case("", ("-o", "{out}.csv")),
            "--on-ground": "",
            "-o": Case("path.txt", refused="path.txt"),
            "--simplify": "30",
            "--mission end": Case("return", ("-o", "{out}.plan")),
            "--mission autopilot": Case("ardupilot", ("-o", "{out}.plan")),
            "--device": DEVICE,
            "--json": JSON,
        },
    ),
    "check": (
        ("{home}/maps", "{mission}", "--resolution=20"),
        OF_CORRIDOR
        | {
            "--heights above": Case("ground", ("{kml}",)),
            "--heights geoid_m": Case("-33,above=ellipsoid", ("{kml}", "--heights=ellipsoid")),
            "--heights home_above_ground_m": "5",
            "--home": Case("-73.9985,40.7565", ("{kml}", "--heights=home")),
            "--return-altitude": "90",
            "--autopilot": Case("px4", ("{kml}", "--heights=home")),
            "--no-fly": "{home}/zone.geojson",
            "--require": "lidar>=0.5",
            "--rules clearance_m": "60",
            "--rules vertical_clearance_m": "30",
            "--time": LATER,
            "--time-of-day": "night",
            "--limits max_no_fix_m": "0.5",
            "--limits max_people": "0.001",
            "--limits ceiling_m": "2",
            "--sources": Case("no/such/folder", refused="no/such"),
            "--resolution": "40",
            "-o": Case("{home}/town.toml", refused="town.toml"),
            "--overwrite": OVERWRITE,
            "--json": JSON,
        },
    ),
    "compare": (
        ("{home}/maps", "{home}/other", "-o", "{out}", "--resolution=20"),
        {
            "-o": Case("{home}/town.toml", refused="town.toml"),
            "--resolution": "40",
            "--routes": "2",
            "--seed": Case("3", ("--routes=2",)),
            "--overwrite": OVERWRITE,
            "--device": DEVICE,
            "--json": JSON,
        },
    ),
    "info": (("{home}/maps",), {"--at": "{start}", "--json": JSON}),
    "return": (
        ("{home}/maps", "--home={start}", "--resolution=20"),
        {
            "--home": "-73.993819,40.758629",
            "--rules clearance_m": "30",
            "--rules vertical_clearance_m": "9",
            "--ceiling": "2",
            "--resolution": "40",
            "-o": Case("home.txt", refused=".tif"),
            "--json": JSON,
        },
    ),
    "sky": (
        ("{home}/maps", "--at={start}", "--altitude=20"),
        {
            "--at": "-73.993819,40.758629",
            "--track": Case("none.csv", refused="none.csv"),
            "--reference": Case("none.csv", refused="none.csv"),
            "--by-satellite": Case("", refused="--by-satellite"),
            "--altitude": "40",
            "--time": LATER,
            "--speed": Case("9", refused="--speed|--track"),
            "--sources": Case("no/such/folder", refused="no/such"),
            "-o": Case("sky.txt", refused="-o"),
            "--json": JSON,
        },
    ),
    "study": (
        ("{home}/small.toml", "-o", "{out}", "--workers=1"),
        {
            "--preset": "paper",
            "--no-fly": "{home}/zone.geojson",
            "--require": "lidar>=0.1",
            "-o": Case("{home}/town.toml", refused="town.toml"),
            "--instances": Case("none.csv", refused="none.csv"),
            "--resolution": "40",
            "--set": "study.instances=3",
            "--workers": WORKERS,
            "--cluster": WORKERS,
            "--overwrite": OVERWRITE,
            "--device": DEVICE,
            "--json": JSON,
        },
    ),
    "tune": (
        (
            "{home}/maps",
            "--resolution=20",
            "-o",
            "{out}",
            "--sample=3",
            "--pilot=gps=1,distance=0.1",
            "--fit=max_rounds=2,bootstrap=2",
            "--altitude=60",
        ),
        RULES_OF_ROUTES
        | {
            "-o": Case("{home}/town.toml", refused="town.toml"),
            "--sample": "4",
            "--rules unknown_heights": KNOWN_HEIGHTS,
            "--pilot": "risk=1,distance=0.1",
            "--wish": Case("detour<=0.1", refused="--wish"),
            "--metrics": "gps",
            "--altitude": "20",
            "--time-of-day": "night",
            "--time": "2020-04-27T16:00:00Z",
            "--resolution": "40",
            "--fit bootstrap": Case("0,max_rounds=2"),
            "--fit hold_out": Case("0.5,max_rounds=2,bootstrap=2"),
            "--fit max_rounds": Case("1,bootstrap=2"),
            "--fit seed": Case("3,max_rounds=2,bootstrap=2"),
            "--fit budget_s": Case("1e-9,max_rounds=2,bootstrap=2"),
            "--overwrite": OVERWRITE,
            "--device": DEVICE,
            "--json": JSON,
        },
    ),
    "sensitivity": (
        (
            *("{home}/maps", *ROUTE, "-o", "{out}"),
            *("--vary=gps", "--workers=1"),
        ),
        {name: case for name, case in OF_ROUTE.items() if not name.startswith("--time")}
        | {
            "--rules unknown_heights": KNOWN_HEIGHTS,
            "--routes": Case("none.csv", refused="none.csv"),
            "--vary": "risk",
            "--range": "0.5,2",
            "--study num_heights": "1",
            "--study wrong": "30",
            "--study seed": Same("one route whose heights are known draws nothing"),
            "--study height_seed": Same("one route whose heights are known draws nothing"),
            "--workers": WORKERS,
            "--overwrite": OVERWRITE,
            "--json": JSON,
            "-o": Case("{home}/town.toml", refused="town.toml"),
        },
    ),
}
NOT_WALKED = {
    "demo": "it has no option that decides a result",
    "fetch": "it asks servers",
    "maps": "its options are of how maps are kept, and --set is a row of Scenario.from_toml",
    "validate": "its options are rows of ReceiverSettings",
    "view": "it serves until it is stopped; ju.view has the rows",
}
SLOW_COMMANDS = ("plan", "check", "compare", "study", "tune", "sensitivity")


@cache
def other_maps() -> None:
    """Make the maps that ``compare`` holds against the town's."""
    other = ju.Scenario.from_toml(home() / "town.toml", ["gps.mask_deg=40"])
    on.run_scenario(other, home() / "other", progress=False)


@cache
def files() -> dict[str, str]:
    """Return the files that commands name, made once."""
    study = '[study]\ninstances = 2\nplanners = ["astar-plus"]\nbudget_s = 60.0\n'
    (home() / "small.toml").write_text((home() / "town.toml").read_text() + study)
    return {
        "home": str(home()),
        "mission": str(on.path().save(home() / "back.plan", end="return")),
        "kml": str(on.a_mission(".kml")),
        "start": ",".join(map(str, START)),
        "goal": ",".join(map(str, GOAL)),
    }


def written(out: on.Path) -> Any:
    """Return what lies in a folder or file that a command wrote, tables and missions alone."""
    kept = [out, *out.parent.glob(f"{out.name}*"), *out.rglob("*")]
    return {
        each.name: on.without_times(each)
        for each in sorted(kept)
        if each.suffix in (".csv", ".plan", ".toml")
    }


def ran(capsys: Any, command: str, words: tuple[str, ...]) -> tuple[int, Any]:
    """Return the exit code of a command and what it printed or wrote; of one that failed its error."""
    out = on.a_file("out")
    if command == "compare":
        other_maps()
    given = [word.format(out=out, **files()) for word in words]
    if "{kml}" in words:
        given.remove(files()["mission"])
    code, printed, err = run(capsys, command, *given, "--json")
    if code == 2:
        return code, err
    shown = on.plain(json.loads(printed))
    return code, (str(shown).replace(str(out), ""), written(out))


def option_ignored(run_with: Callable[..., tuple[int, Any]], command: str, option: str) -> str:
    """Return why an option counts as ignored; "" where it changes the result, or its error names it."""
    words, rows = OPTIONS[command]
    row = rows[option]
    if isinstance(row, Same):
        return ""
    case = row if isinstance(row, Case) else Case(row)
    beside = (*words, *case.beside)
    option, _, name = option.partition(" ")
    value = f"{name}={case.value}" if name else case.value
    named = (f"{option}={value}",) if option.startswith("--") and value else (option,)
    named = (option, case.value) if option == "-o" else named
    code, result = run_with(command, (*beside, *named))
    if case.refused is not None or code == 2:
        is_named = code == 2 and re.search(
            case.refused or name or option.strip("-").replace("-", "."), result
        )
        return "" if is_named else f"{command} {option}: not refused, or by {str(result)[:200]}"
    usual = run_with(command, beside)
    return f"{command} {option} changes nothing" if (code, result) == usual else ""


def test_every_option_of_every_command_has_a_row():
    for command in COMMANDS:
        if command.name not in NOT_WALKED:
            options = [each for each in command.params if isinstance(each, click.Option)]
            named = [
                f"{each.opts[0]} {name}".strip()
                for each in options
                for name in getattr(each.type, "names", [""])
            ]
            assert sorted(named) == sorted(OPTIONS[command.name][1]), command.name


@pytest.mark.parametrize(
    "command",
    [pytest.param(each, marks=[pytest.mark.slow] * (each in SLOW_COMMANDS)) for each in OPTIONS],
)
def test_no_option_is_ignored(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_with = cache(partial(ran, capsys))  # most options are held against the same run
    ignored = [option_ignored(run_with, command, option) for option in OPTIONS[command][1]]
    assert not list(filter(None, ignored)), "\n".join(filter(None, ignored))


@cache
def without_people() -> ju.MetricMaps:
    return ju.MetricMaps(on.few_levels().ds.drop_vars(["population", "density"]))


PEOPLE = ju.Weights(population=5.0)
NAMED_IN_VAIN: dict[str, tuple[Callable[[], Any], str]] = {
    "weights of a study beside a table": (
        lambda: on.a_study(instances=on.instances(), settings=ju.studies.Study(weights=(PEOPLE,))),
        "settings name weights",
    ),
    "altitudes of a study beside a table": (
        lambda: on.a_study(instances=on.instances(), settings=ju.studies.Study(altitudes_m=[60.0])),
        "settings name altitudes_m",
    ),
    "weights of a study of weights beside instances": (
        lambda: on.weights_study(routes=on.instances(), altitudes_m=None, weights={"risk": 2.0}),
        "leave weights out",
    ),
    "people without their files": (
        lambda: on.read(population=ju.Population(time_of_day="night")),
        "population has settings and the city has no people",
    ),
    "people of a city without": (
        lambda: ju.build_maps(few(), population=ju.Population(gamma_commercial=2.0)),
        "population has settings and the city has no people",
    ),
    **{
        f"a weight of people, {name}": (call, "population")
        for name, call in {
            "cost_map": lambda: ju.cost_map(without_people(), 60.0, weights={"population": 1.0}),
            "plan": lambda: ju.plan(without_people(), START, GOAL, altitude_m=60.0, weights=PEOPLE),
            "plan_many": lambda: ju.plan_many(
                without_people(), [(START, GOAL)], altitude_m=60.0, weights=PEOPLE, progress=False
            ),
            "sample": lambda: ju.studies.sample_instances(without_people(), 1, weights=[PEOPLE]),
            "table": lambda: ju.studies.study(
                without_people(),
                on.a_file("study"),
                on.instances().query("altitude_m == 60").assign(w_population=5.0, time_of_day=None),
            ),
            "study of weights": lambda: on.weights_study(
                sources={"town": without_people()}, weights={"population": 5.0}
            ),
            "pilot": lambda: ju.fit.demonstrations(
                routes=on.instances().query("altitude_m == 60"), maps=without_people(), pilot=PEOPLE
            ),
            "view": lambda: page(maps=without_people(), weights={"population": 5.0}),
        }.items()
    },
}


@pytest.mark.parametrize("what", NAMED_IN_VAIN)
def test_what_counts_nowhere_is_refused(what):
    call, sentence = NAMED_IN_VAIN[what]
    with pytest.raises(ju.InputError, match=sentence):
        call()


def test_a_weight_that_nobody_named_or_of_0_passes_over_maps_without_its_layer_and_a_caution_says_so():
    maps = without_people()
    recorded = maps.with_recorded({"weights": PEOPLE.to_dict()})
    for of, weights in (
        (maps, None),
        (maps, {"population": 0}),
        (maps, ju.Weights()),
        (recorded, None),
    ):
        path = ju.plan(of, START, GOAL, altitude_m=60.0, snap=True, weights=weights)
        said = "These maps hold no population, so that weight is ignored."
        assert (said in path.cautions) == (said in path.message) == (weights != {"population": 0})
    assert all(sentence in path.cautions for sentence in path.search.note.split(". ")[-1:])
