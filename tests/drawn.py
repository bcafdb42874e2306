"""Every picture that the package draws, of small made data: with few and short names, or many and long ones.

A function of `PICTURES` is named as the package's own, ``module.plot_name``, and draws one figure of a `Case`.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import jaxurban as ju
from jaxurban.draw.style import Width
from jaxurban.knowledge import Guess, GuessKind
from jaxurban.studies.weights.breakpoints import WeightLine
from jaxurban.typing import PlannedPath
from tests.draw.test_figures import at_epochs, make_maps, make_path, make_paths
from tests.draw.test_legible import agreement, crowded
from tests.guess_records import FLAT, NOMINAL, attribute, heights
from tests.made_agreement import made
from tests.made_maps import city_of_boxes, made_maps, maps_of_kinds

CREDIT = "Data: OpenStreetMap contributors (ODbL 1.0); U.S. Geological Survey; WorldPop (CC BY 4.0); own survey"
GUESSES = (
    heights(0.97),
    FLAT,
    NOMINAL,
    Guess(GuessKind.UNCOUNTED_BLOCKS, number=5, facts={"of": 9, "unreadable": 1, "missing": 4}),
)
METRICS = ("gps", "lidar", "population", "risk")
LAYERS = (*METRICS, "noise_of_neighbours", "wind_at_roofs", "x1")
PLANNERS = ("ptp", "astar-dist", "astar-plus", "bitstar-dist", "bitstar-plus", "theta-star")
CITIES = ("alpha", "Lower Manhattan, New York", "Niterói", "Shinjuku", "Wien, Innere Stadt", "beta")


DRAWS = re.compile(r"draw|figures|report")  # in the name of a module


class Case(NamedTuple):
    """How a picture is drawn.

    Attributes:
      is_hard: of many panels, long names and much to say below, in place of few and short ones.
      width: of the figure, where its function takes one.
    """

    is_hard: bool
    width: Width

    def pick(self, easy: Any, hard: Any) -> Any:
        """Return what belongs to the case."""
        return hard if self.is_hard else easy


def functions() -> dict[str, Callable[..., Figure]]:
    """Return the functions of the package that draw, by name."""
    drawn = {}
    for found_module in pkgutil.walk_packages(ju.__path__, f"{ju.__name__}."):
        if not DRAWS.search(found_module.name):
            continue
        module: ModuleType = importlib.import_module(found_module.name)
        drawn |= {
            name: function
            for name, function in inspect.getmembers(module, inspect.isfunction)
            if name.startswith("plot_") and function.__module__ == module.__name__
        }
    return drawn


def draw(name: str, case: Case) -> Figure:
    """Return a picture of `PICTURES`."""
    function = functions()[name]
    if "width" in inspect.signature(function).parameters:
        # Without the check of arguments, as some cases have stand-ins.
        bare_function = function.__wrapped__
        return PICTURES[name](
            lambda *given, **more: bare_function(*given, width=case.width, **more), case
        )
    return PICTURES[name](function, case)


@cache
def maps_for(is_hard: bool) -> ju.MetricMaps:
    """Return maps of four altitudes, with guesses and a long credit where it is hard."""
    maps = make_maps(has_all_data=not is_hard)
    if is_hard:
        maps.ds.attrs |= attribute(*GUESSES) | {"attribution": CREDIT}
        maps.ds["roof_guessed"] = maps.ds["roof"] > 20
    return maps


def _metric(plot, case: Case) -> Figure:
    altitude_m = case.pick(60.0, None)
    return plot(maps_for(case.is_hard), case.pick("gps", "gdop"), altitude_m=altitude_m)


def _epochs(plot, case: Case) -> Figure:
    return plot(at_epochs(case.pick(2, 10), maps_for(case.is_hard)))


def _named_paths(case: Case, is_one_altitude: bool = False):
    maps = maps_for(case.is_hard)
    if not case.is_hard:
        return maps, make_paths(maps)[:3], None
    altitudes_m = maps.altitudes_m[:1] if is_one_altitude else maps.altitudes_m
    names = [f"a planner of a long name {number}" for number in range(8)]
    paths = [make_path(maps, name, altitude_m=z) for name in names for z in altitudes_m]
    return maps, paths, None


def _paths(plot, case: Case) -> Figure:
    maps, paths, names = _named_paths(case)
    return plot(maps, paths, names=names)


def _overview(plot, case: Case) -> Figure:
    maps, paths, names = _named_paths(case, is_one_altitude=True)
    return plot(maps, paths, names=names)


@cache
def _flown(is_hard: bool) -> tuple[PlannedPath, ju.MetricMaps]:
    maps = maps_of_kinds()[0] if is_hard else made_maps(40, 40)
    ends = maps.grid.lonlat_of_cell(1, 1), maps.grid.lonlat_of_cell(38, 38)
    return ju.plan(maps, *ends, altitude_m=maps.altitudes_m[0], snap=True), maps


def _profile(plot, case: Case) -> Figure:
    return plot(*_flown(case.is_hard))


@cache
def _departures(is_hard: bool):
    maps = at_epochs(12 if is_hard else 2, made_maps(40, 40).ds.pipe(lambda ds: made_maps(40, 40)))
    ends = maps.grid.lonlat_of_cell(1, 1), maps.grid.lonlat_of_cell(38, 38)
    return ju.when(maps, [ends], altitude_m=20.0, snap=True, progress=False), maps


def _when(plot, case: Case) -> Figure:
    return plot(*_departures(case.is_hard))


@cache
def _sky():
    gps = ju.Gps(times=["2020-04-27T16:00:00Z"])
    return ju.sky(ju.demo_city(400, 400), (-73.97, 40.78), 20.0, gps=gps)


def _over_place(plot, case: Case) -> Figure:
    rows = crowded(*case.pick((9, "GPS slot A{}"), (30, "GPS BIIF-9 (PRN {:02})")))
    return plot(replace(_sky(), table=rows.assign(time=_sky().times[0]), attribution=CREDIT))


@cache
def _checked(is_hard: bool):
    maps = maps_for(is_hard)
    grid = maps.grid
    num = 24 if is_hard else 4
    turns = np.linspace(0, 2 * np.pi, num)
    rows = (grid.num_rows * (0.5 + 0.4 * np.sin(turns))).astype(int)
    cols = (grid.num_cols * (0.5 + 0.4 * np.cos(turns))).astype(int)
    xy_m = np.column_stack(grid.xy_of_cell(rows, cols))
    path = replace(make_path(maps, "p"), xy_m=xy_m, z_m=np.full(num, 20.0))
    lonlat = np.stack(grid.lonlat_of_xy(*xy_m.T), axis=-1)
    return ju.check(
        maps, replace(path, lonlat=lonlat), constraints=ju.Constraints(clearance_m=30.0)
    )


def _mission(plot, case: Case) -> Figure:
    return plot(_checked(case.is_hard))


def _boxes(case: Case) -> ju.City:
    """Return a city of sixty boxes, with a long credit where it is hard."""
    corners = np.random.default_rng(3).uniform(0, 3000, (60, 2))
    boxes = np.hstack([corners, corners + 120])
    city = city_of_boxes(boxes, np.full(60, 30.0), 3400.0, make_maps().grid.bounds_m[:2])
    return replace(city, attribution=CREDIT) if case.is_hard else city


def _city(plot, case: Case) -> Figure:
    return plot(_boxes(case))


def _costs(plot, case: Case) -> Figure:
    planners = case.pick(PLANNERS[:2], (*PLANNERS, "theta-star refined", "OMPL BIT*"))
    rng = np.random.default_rng(1)
    rows = [
        (planner, z, ratio)
        for planner in planners
        for z in case.pick((20.0,), (20.0, 60.0, 122.0, 600.0))
        for ratio in 1 + rng.exponential(0.2, 9)
    ]
    return plot(pd.DataFrame(rows, columns=["planner", "altitude_m", "ratio"]))


@cache
def _weighed(is_hard: bool) -> Any:
    """Return what the pictures of a sensitivity take of it: routes between two places, bent ever further."""
    maps = maps_for(is_hard)
    varied = ("gps", *LAYERS[4:], "lidar") if is_hard else ("gps",)
    names = ("distance", *varied)
    num = 15 if is_hard else 3
    rng = np.random.default_rng(2)
    route = make_path(maps, "astar-plus")
    route.settings["reference_length_m"] = 5.0
    bends = np.linspace(-1, 1, num)[:, None] * (900.0, -700.0)
    routes = [np.array([route.xy_m[0], route.xy_m[1] + bend, route.xy_m[-1]]) for bend in bends]
    cuts = np.geomspace(0.1, 10, num + 1)
    lines = {}
    for name in varied:
        corners = np.ones((2, len(names)))
        corners[:, names.index(name)] = 0.1, 10.0
        shares = (cuts - 0.1) / 9.9
        cells = np.array([[[1 - a, a], [1 - b, b]] for a, b in pairwise(shares)])
        sums = rng.uniform(1, 2, (num, len(names))) * 1e4
        lines[name] = WeightLine(corners, sums, sums, cells)
    return SimpleNamespace(
        path=replace(route, maps=maps),
        names=names,
        weights=np.ones(len(names)),
        factors=(0.1, 10.0),
        features=np.full(len(names), 1.5e4),
        lines=lines,
        line_routes=dict.fromkeys(varied, routes),
        breakpoints=lambda _: pd.DataFrame({"from": cuts[:-1], "to": cuts[1:]}),
    )


def _of_weights(plot, case: Case) -> Figure:
    return plot(_weighed(case.is_hard))


def _summary(case: Case) -> pd.DataFrame:
    rng = np.random.default_rng(4)
    rows = [
        (cut, value, name)
        for cut, values in (
            ("city", CITIES[: case.pick(1, 6)]),
            ("altitude_m", [f"{z} m" for z in (20, 60, 122, 600)[: case.pick(1, 4)]]),
        )
        for value in values
        for name in case.pick(METRICS, LAYERS)
    ]
    table = pd.DataFrame(rows, columns=["cut", "value", "weight_name"])
    for name, least in (("regret", 0.0), ("nearest", 1.0)):
        values = least + rng.exponential(0.1, (3, len(table))).cumsum(axis=0)
        table[f"{name}_low"], table[name], table[f"{name}_high"] = values
    half = (table["regret_high"] - table["regret_low"]) / 4  # of the interval of each weight alone
    table["regret_alone_low"] = np.maximum(table["regret"] - half, 0.0)
    table["regret_alone_high"] = table["regret"] + half
    ends = [name for name in table if str(name).endswith(("_low", "_high"))]
    table.loc[::5, ends] = np.nan
    return table


def _of_summary(plot, case: Case) -> Figure:
    return plot(_summary(case), 2.0)


def _fitted(plot, case: Case) -> Figure:
    names = ("distance", *case.pick(METRICS, LAYERS))
    weight = np.geomspace(1e-4, 3e3, len(names))
    table = pd.DataFrame({"weight": weight, "low": weight / 3, "high": 4 * weight}, names)
    table.iloc[1, 1:] = np.nan
    table.iloc[2, :2] = 0.0
    table["pilot"] = case.pick(np.nan, 1.5 * weight)
    table["unit"] = ["per metre", *["per 5 m flown"] * (len(names) - 1)]
    is_open = SimpleNamespace(needed=np.nan, what=case.pick((), names[2:3]))
    return plot(SimpleNamespace(table=table, verdicts=[is_open]))


def _imitated(plot, case: Case) -> Figure:
    maps = maps_for(case.is_hard)
    on = ju.cost_map(maps, 20.0)
    lines_m = [make_path(maps, "p").xy_m - maps.grid.bounds_m[:2] for _ in range(2)]
    query = SimpleNamespace(cost_map=on, start=(4, 8), goal=(30, 32))
    given, planned = ([SimpleNamespace(query=query, points_m=line_m)] for line_m in lines_m)
    name = case.pick("demonstration", "pair of ends that targets are given for")
    return plot(given, planned, on, np.linspace(0.1, 1.0, len(on.names) + 1), name)


def _difference(plot, case: Case) -> Figure:
    one = maps_for(case.is_hard)
    other = ju.MetricMaps(one.ds.copy(deep=True))
    other.ds["gps"][:] = other.ds["gps"][:] * 0.7
    compared = ju.studies.compare(one, other, progress=False)
    names = case.pick(("A", "B"), ("maps_of_lower_manhattan_2024_buildings", "out/chicago_10_m"))
    return plot(replace(compared, names=names), "gps")


def _agreement(plot, case: Case) -> Figure:
    return plot(agreement(45, "G{:02}") if case.is_hard else made())


def _return(plot, case: Case) -> Figure:
    maps = maps_for(case.is_hard)
    xy_m = maps.grid.xy_of_cell(*case.pick((20, 20), (20, 25)))
    return plot(ju.return_altitude(maps, ju.XY(*xy_m), vertical_clearance_m=case.pick(0.0, 12.5)))


def _all_maps(plot, case: Case) -> Figure:
    return plot(maps_for(case.is_hard))


PICTURES: dict[str, Callable[[Callable[..., Figure], Case], Figure]] = {
    "plot_city": _city,
    "plot_flown_heights": _mission,
    "plot_mission": _mission,
    "plot_return": _return,
    "plot_difference": _difference,
    "plot_epochs": _epochs,
    "plot_gps_rating": _all_maps,
    "plot_heights": _all_maps,
    "plot_metric": _metric,
    "plot_obstacles": _all_maps,
    "plot_population": _all_maps,
    "plot_sensor_choice": _all_maps,
    "plot_costs": _costs,
    "plot_overview": _overview,
    "plot_paths": _paths,
    "plot_profile": _profile,
    "plot_margin": _agreement,
    "plot_track": _agreement,
    "plot_breakpoint_routes": _of_weights,
    "plot_regret": _of_summary,
    "plot_sky": _over_place,
    "plot_fitted_routes": _imitated,
    "plot_weights": _fitted,
    "plot_when": _when,
}
