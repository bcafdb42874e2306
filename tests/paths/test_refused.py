"""What the planning of paths refuses: each in one sentence that names what is wrong; a command exits with 2."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pytest

import jaxurban as ju
from jaxurban.flights.export.write import write_path
from jaxurban.io.files import write_json
from jaxurban.paths.constraints import Bound
from jaxurban.planners.registry import PLANNERS
from jaxurban.studies.queries import make_queries
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps
from tests.volumes import REGION, options_of, plan_volume

Z_M, NAN = 20.0, float("nan")
NOWHERE = ju.Constraints.read(require="hdop<=0.1")


class Scene:
    """Maps, a path on them, and what is called with arguments that are right but for those given."""

    def __init__(self, maps, ends, folder):
        self.maps, self.ends, self.folder = maps, ends, folder
        self.on = ju.cost_map(maps, Z_M)
        self.path = self.on.plan(**ends)
        self.untouched = ju.MetricMaps(maps.ds.drop_vars("roof_touched"), "centre")
        self.blocked = self.plan(planner="ptp")
        self.pairs = [
            [list(map(float, maps.grid.lonlat_of_xy(*xy_m[:2]))) for xy_m in ends.values()]
        ] * 3

    def plan(self, **changed):
        return ju.plan(self.maps, **({"altitude_m": Z_M} | self.ends | changed))

    def levels(self, **changed):
        return plan_volume(self.maps, **(self.ends | changed))

    def many(self, queries=None, **options):
        queries = self.pairs if queries is None else queries
        return ju.plan_many(self.maps, queries, **({"altitude_m": Z_M} | options), progress=False)

    def table(self, *columns):
        return self.many(pd.DataFrame([[0.0] * len(columns)], columns=columns))

    def closed(self, require):
        return ju.Constraints.read(require=require).closed(self.maps, Z_M)

    def explain(self, **changed):
        return ju.explain(self.path, self.maps, **changed)

    def simplify(self, path=None, maps=None, tolerance_m=2.0, **options):
        on = ju.cost_map(maps or self.maps, **({"altitude_m": Z_M} | options))
        return ju.simplify(path or self.path, on, tolerance_m)

    def write(self, name, **options):
        return write_path(self.path, self.folder / name, **options)


@pytest.fixture(scope="module")
def scene(maps, ends, tmp_path_factory) -> Scene:
    return Scene(maps, ends, tmp_path_factory.mktemp("folder.kml", numbered=False))


OTHER = "give the cost map that it was planned on"
ANOTHER = "another {}.*: " + OTHER
PAIRS = r"queries must be pairs of places in degrees, .* an array \[N, 2, 2\]"
LONLAT = ("start_lon", "start_lat", "goal_lon")
METRES = ("start_x_m", "start_y_m", "goal_x_m", "goal_y_m")
NO_CELL = r"no cell is free at this altitude: .* loosen the constraints \(hdop<=0.1, vertical clear"
NO_DISTANCES, NO_NUMBERS = (0.0, -1.0, NAN, "50"), (-1.0, NAN, np.inf, "wide")
SHAPES = ((3, 4), (2, 2), (3, 3), (3, 2, 3))


def each(call, values, words):
    """Return a row of the table for each value."""
    return [(lambda s, value=value: call(s, value), words) for value in values]


REFUSED = [
    # what is planned
    (lambda s: s.plan(planner="astr"), "planner must be .* got 'astr' .did you mean 'astar'"),
    (
        lambda s: s.plan(planner="theta"),
        "planner must be .* got 'theta' .did you mean 'theta-star'",
    ),
    (lambda s: s.plan(objective="fast"), "'weighted' or 'distance'"),
    (lambda s: s.plan(cost_model="cells"), "CostModel, 'cell', 'line' or None"),
    (lambda s: s.plan(weights={"gps": NAN}), "gps must be a finite number"),
    (lambda s: s.plan(preset="papers"), "preset must be '' or 'paper', got 'papers'"),
    (lambda s: s.plan(cost_model="cell", refine=True), "cost_model='line'"),
    (lambda s: s.plan(planner="bitstar-dist", seed=-1), "seed must be a whole number"),
    (lambda s: s.plan(planner="bitstar-dist", seed=1.5), "seed must be a whole number"),
    *each(
        lambda s, name: s.plan(planner=name, weights=ju.Weights(risk=-1)),
        PLANNERS,
        "weight risk must be a",
    ),
    *each(
        lambda s, z_m: s.plan(altitude_m=z_m),
        (19.999, 60.001, NAN, np.inf),
        "from 20 to 60 m|finite number",
    ),
    *each(lambda s, snap: s.plan(snap=snap), NO_DISTANCES, "snap must be True"),
    *each(lambda s, snap: s.levels(snap=snap), NO_DISTANCES, "snap must be True"),
    *each(lambda s, snap: s.many(snap=snap), NO_DISTANCES, "snap must be True"),
    *each(
        lambda s, snap: make_queries(s.on, s.pairs, snap=snap), NO_DISTANCES, "snap must be True"
    ),
    # between levels
    (
        lambda s: s.levels(min_altitude_m=80.0, max_altitude_m=40.0),
        "hold no altitude from 80 to 40 m",
    ),
    (
        lambda s: s.levels(min_altitude_m=30.0, max_altitude_m=50.0),
        "no altitude from 30 to 50 m, only 20, 60 m",
    ),
    (
        lambda s: s.levels(min_altitude_m=70.0, max_altitude_m=90.0, level_step_m=5.0),
        "no altitude from 70 to 90 m",
    ),
    (lambda s: s.levels(level_step_m=0.0), "level_step_m"),
    (lambda s: s.levels(level_step_m=1e-9), "10000 levels"),
    (lambda s: s.levels(goal_altitude_m=30.0), "goal altitude 30 m is none of the levels 20, 60 m"),
    (lambda s: s.levels(climb_cost=-1.0), "climb_cost"),
    (lambda s: s.levels(descent_cost=NAN), "descent_cost"),
    (lambda s: s.levels(heuristic="plsu"), "did you mean 'plus'"),
    (lambda s: s.levels(planner="ptp"), "planner in a volume must be 'astar-volume'"),
    (lambda s: s.levels(refine=True), "leave it out"),
    # many at once
    (
        lambda s: s.many(planer="ptp"),
        r"plan_many: there is no argument 'planer' \(did you mean 'planner'\?\)",
    ),
    (lambda s: s.many([(ju.XY(0.0, 0.0), (0.0, 0.0))]), PAIRS),
    (
        lambda s: s.many([(ju.XY(0.0, 0.0, 20.0), ju.XY(9.0, 9.0, 20.0))]),
        "pairs of ju.XY without altitudes",
    ),
    (lambda s: s.many(refine=True), "refine and exposure are of a single plan"),
    (lambda s: s.many(exposure={"gps": 1.0}), "refine and exposure are of a single plan"),
    (lambda s: s.plan(exposure={"gsp": 1.0}), "did you mean 'gps'"),
    (lambda s: s.plan(exposure={"gps": -1.0}), "0 or a positive number"),
    (lambda s: s.plan(exposure={"gps": NAN}), "exposure to gps must be a finite number"),
    (
        lambda s: s.plan(exposure={"gps": -1}),
        "exposure to gps must be 0 or a positive number, got -1",
    ),
    (
        lambda s: s.plan(exposure={"gps": 1.0}, planner="theta-star"),
        "take the planner astar or astar-dist or astar-plus",
    ),
    (lambda s: s.plan(exposure={"gps": 1.0}, refine=True), "leave out refine"),
    (lambda s: s.plan(exposure={"gps": 1.0}, cost_model="cell"), "without --preset paper"),
    (lambda s: s.many(planner="a-star"), "planner must be .* got 'a-star'"),
    (lambda s: s.many(objective="beauty"), "objective must be"),
    (lambda s: s.many(backend="gpu"), "backend must be 'auto', 'numba' or 'jax'"),
    (
        lambda s: s.many(altitude_m=19.0),
        "there are no maps for altitude 19 m: these maps reach from 20 to 60 m",
    ),
    (lambda s: s.table(*LONLAT, "goal_lat", "w_gsp"), "did you mean 'w_gps'"),
    (lambda s: s.table(*LONLAT), "lack the columns goal_lat"),
    (lambda s: s.table(*METRES, "goal_lon"), "not in both"),
    *each(lambda s, shape: s.many(np.zeros(shape)), SHAPES, PAIRS),
    *each(lambda s, shape: s.many(np.zeros(shape).tolist()), SHAPES, PAIRS),
    (lambda s: s.many([s.pairs[0], s.pairs[1][0]]), PAIRS),
    (lambda s: s.many([("a", "b")]), PAIRS),
    # constraints and vehicles
    *each(lambda s, wrong: ju.Constraints.read(clearance_m=wrong), NO_NUMBERS, "clearance_m"),
    *each(
        lambda s, wrong: ju.Constraints.read(vertical_clearance_m=wrong),
        NO_NUMBERS,
        "vertical_clearance_m",
    ),
    (lambda s: s.closed("gps=>0.3"), "comparison '=>': use >=, <=, >, <"),
    *each(lambda s, text: s.closed(text), ("gps>=much", "0.3"), "must read name"),
    *each(lambda s, text: s.closed(text), ("gps>=nan", "hdop<=inf"), "finite number"),
    (lambda s: s.closed("gps>=30"), "lies in 0 to 1"),
    (lambda s: s.closed("gpz>0.3"), "did you mean 'gps'"),
    (lambda s: s.closed("gps_median>0"), "do not hold"),
    (lambda s: Bound("lidar", ">=", 0.4).is_kept(s.maps, 61.0), "no maps for altitude 61"),
    (lambda s: s.plan(constraints=NOWHERE, snap=True), NO_CELL),
    (
        lambda s: ju.cost_map(s.maps, Z_M, constraints=NOWHERE).problem,
        "no cell is free at 20 m: ",
    ),
    (
        lambda s: ju.Constraints(clearance_m=1.0).is_free(s.untouched, Z_M),
        "these maps hold no 'roof_touched'",
    ),
    (lambda s: ju.Vehicle(max_turn_deg=181.0), "max_turn_deg must be at most 180 degrees"),
    (lambda s: ju.Vehicle(max_descent_m_s="slow"), "max_descent_m_s must be a number or None"),
    (lambda s: ju.Scenario.from_dict(REGION | {"vehicle": {"speed_km_h": 40}}), "speed_m_s"),
    (
        lambda s: ju.Scenario.from_dict(REGION | {"vehicle": {"max_climb_m_s": 0}}),
        "vehicle.*max_climb_m_s must be a",
    ),
    # of a path
    *each(
        lambda s, wrong: s.explain(speed_m_s=wrong),
        (0.0, NAN),
        "speed_m_s must be a positive number of metres",
    ),
    (lambda s: s.explain(power_w=200.0), "give the speed"),
    (lambda s: s.explain(swath_m=-1.0), "swath_m"),
    (lambda s: s.explain(num_segments=0), "num_segments"),
    (lambda s: ju.explain(s.maps, s.path), r"got MetricMaps: call explain\(planned, maps\)"),
    (lambda s: ju.explain(s.path, made_maps(40, 50, resolution_m=20.0)), "these maps are 20 m"),
    (lambda s: ju.explain(s.blocked, s.maps), "there is no path to explain"),
    (lambda s: ju.cautions(s.blocked, s.maps), "there is no path"),
    *each(lambda s, z_m: s.simplify(altitude_m=z_m), (60.0, ju.Levels()), OTHER),
    (lambda s: s.simplify(maps=made_maps(40, 50, resolution_m=20.0)), OTHER),
    (lambda s: s.simplify(constraints=ju.Constraints(clearance_m=6.0)), ANOTHER.format("limits")),
    (lambda s: s.simplify(weights={"gps": 2.0}), ANOTHER.format("weights")),
    (lambda s: s.simplify(maps=s.maps.with_obstacles("centre")), ANOTHER.format("obstacles")),
    (lambda s: s.simplify(cost_model="cell"), ANOTHER.format("cost_model")),
    (lambda s: s.simplify(replace(s.path, xy_m=s.path.xy_m + 5.0)), ANOTHER.format("region")),
    *each(
        lambda s, wrong: s.simplify(tolerance_m=wrong),
        (0.0, -1.0, np.inf, "far"),
        "tolerance_m must be",
    ),
    (lambda s: ju.simplify(None, s.on, 2.0), "planned must be PlannedPath"),
    # its files
    (lambda s: s.write(""), "is a folder"),
    (lambda s: s.write("path.gpz"), "end its name in one of .geojson, .kml, .gpx, .plan"),
    (lambda s: s.write("path"), "end its name in one of"),
    (lambda s: s.write("missing/path.kml"), "does not exist"),
    (lambda s: s.write("path.plan", end="hover"), "end must be 'land', 'return' or 'none'"),
    (lambda s: s.write("path.kml", end="land"), r"only a \.plan says how the flight ends"),
]


@pytest.mark.parametrize(
    ("call", "words"), REFUSED, ids=lambda value: value if isinstance(value, str) else ""
)
def test_what_cannot_be_planned_is_refused_in_one_sentence(scene, call, words):
    with pytest.raises(ju.InputError, match=words) as refused:
        call(scene)
    assert "\n" not in str(refused.value)
    assert not any(scene.folder.iterdir())


def test_too_little_memory_is_told_before_it_runs_out(scene, monkeypatch):
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=100_000))
    with pytest.raises(
        ju.InputError, match=r"volume of 2 levels of 80 x 100 cells .* choose a longer level_step_m"
    ):
        scene.levels()


@pytest.mark.parametrize(
    ("command", "options", "words"),
    [
        ("plan", ("--altitude", 61), ("altitude 61 m", "from 20 to 60 m")),
        (
            "plan",
            ("--rules", "clearance_m=-3"),
            ("clearance_m must be 0 or a positive number of metres, got -3",),
        ),
        ("plan", ("--no-fly", "none.kml"), ("none.kml", "does not exist")),
        ("plan", ("--volume", "climb=1"), ("climb_cost",)),
        ("plan", ("--volume", "--planner", "ptp"), ("must be 'astar-volume'",)),
        ("plan", ("--profile", "p.jpg"), ("end its name in .png",)),
        ("plan", ("--profile", "none/p.png"), ("folder that is there",)),
        ("plan", ("--simplify", -1), ("tolerance_m must be a positive number of metres",)),
        ("plan", ("--mission", "land"), ("add -o FILE.plan",)),
        ("plan", ("--mission", "hover", "-o", "x.plan"), ("land",)),
        ("sensitivity", ("--altitude", 35, "-o", "out"), ("ask for altitude_m 35",)),
    ],
)
def test_a_command_refuses_in_one_sentence_and_ends_with_2(
    folder, maps, ends, command, options, words, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, command, folder, *options_of(maps, **ends), *options)
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)
    assert not list(tmp_path.iterdir())


def test_many_routes_over_cities_of_other_scenarios_are_refused(tmp_path, capsys):
    cities = [tmp_path / "a", tmp_path / "b"]
    for speed_m_s, city in enumerate(cities, start=1):
        made_maps(40, 60).save(city)
        write_json(city / "run.json", {"settings": {"vehicle": {"speed_m_s": speed_m_s}}})
    code, _, err = run(capsys, "sensitivity", *cities, "--routes", 1, "-o", tmp_path / "out")
    assert code == 2
    assert_one_sentence(err, "a and b give other weights, cost models, clearances or vehicles")
