"""One path has one cost: every way through the package plans under the same cost model and the same constraints."""

import dataclasses
import itertools
import json
import pickle
import warnings

import numpy as np
import pandas as pd
import pytest
import shapely
from scipy.ndimage import label

import jaxurban as ju
from jaxurban.errors import OtherSettingsWarning
from jaxurban.flights.export.write import write_path
from jaxurban.io.files import write_json
from jaxurban.io.store import write_zarr
from jaxurban.studies.montecarlo.trial import Benchmark
from tests.cli_runs import run
from tests.made_maps import made_maps
from tests.studies.routes_made import write_geojson
from tests.volumes import REGION, with_roofs

ALTITUDE_M = 20.0
WEIGHTS = ju.Weights(distance=0.05, gps=1.0, lidar=0.5, population=0.7, risk=1.3)
VECTOR = np.array([*WEIGHTS.to_dict().values()])
START, GOAL = (1, 1), (24, 28)
MODELS = [
    ju.CostModel(kind, 4.0, connectivity, diagonal)
    for kind, connectivity, diagonal in itertools.product(
        ("cell", "line"), (4, 8), ("both-free", "always")
    )
]
QUICK = ju.studies.SensitivitySettings(vary=("gps",))
QUICK_OPTIONS = ("--vary", "gps", "-o")
REQUIRE = "risk>=0.08"


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    """Maps of scattered obstacles, which many diagonal steps pass at a corner."""
    rng = np.random.default_rng(4)
    is_wall = rng.random((26, 30)) < 0.3
    for row, col in (START, GOAL):
        is_wall[row - 1 : row + 2, col - 1 : col + 2] = False
    maps = with_roofs(made_maps(26, 30), np.where(is_wall, 80.0, 0.0))
    for name in ("gps", "lidar", "population", "risk"):
        maps.ds[name][:] = rng.uniform(0.05, 1.0, maps.ds[name].shape).astype(np.float32)
    return maps


@pytest.fixture(scope="module")
def ends(maps) -> tuple:
    return tuple(tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in (START, GOAL))


@pytest.fixture(scope="module")
def options(ends) -> tuple:
    places = (
        f"--{name}={lon},{lat}" for name, (lon, lat) in zip(("start", "goal"), ends, strict=True)
    )
    return (*places, "--altitude", ALTITUDE_M, "--json")


@pytest.fixture(scope="module")
def zone_file(maps, ends, tmp_path_factory):
    """A no-fly zone across the straight way between the ends."""
    geometry = shapely.geometry.mapping(
        shapely.LineString(ends).centroid.buffer(0.0004, quad_segs=1)
    )
    file = tmp_path_factory.mktemp("zones") / "zone.geojson"
    file.write_text(
        json.dumps({"type": "Feature", "properties": {"name": "square"}, "geometry": geometry})
    )
    return file


@pytest.fixture(scope="module")
def closing(zone_file) -> dict:
    return {"none": ju.Constraints(), "constraints": ju.Constraints.read(zone_file, REQUIRE)}


def instances_of(maps) -> pd.DataFrame:
    """The one query of a study."""
    ends_m = np.ravel([maps.grid.xy_of_cell(*cell) for cell in (START, GOAL)])
    names = (
        "start_x_m",
        "start_y_m",
        "goal_x_m",
        "goal_y_m",
        *(f"w_{name}" for name in WEIGHTS.to_dict()),
    )
    on = {"instance": 0, "altitude_m": ALTITUDE_M, "crs": maps.grid.crs}
    return pd.DataFrame([[*ends_m, *VECTOR]], columns=names).assign(**on)


@pytest.fixture(scope="module")
def plans(maps, ends, closing) -> dict:
    """The path of `plan` under every cost model and constraints."""
    where = {"altitude_m": ALTITUDE_M, "weights": WEIGHTS}
    return {
        (model, name): ju.plan(maps, *ends, **where, cost_model=model, constraints=constraints)
        for model, (name, constraints) in itertools.product(MODELS, closing.items())
    }


def test_each_part_of_a_cost_model_and_constraints_change_the_cost(plans):
    assert all(planned.status.has_path for planned in plans.values())
    costs = {round(planned.cost, 9) for planned in plans.values()}
    assert len(costs) == 2 * 3 * 2  # with 4 neighbours the rule for diagonal steps decides nothing


@pytest.mark.parametrize("constrained", ["none", "constraints"])
@pytest.mark.parametrize("model", MODELS, ids=str)
@pytest.mark.slow
def test_every_way_gives_one_path_one_cost(
    maps, ends, plans, closing, model, constrained, tmp_path
):
    closed = {"constraints": closing[constrained]}
    costs = costs_of_every_way(
        maps, ends, plans[model, constrained], {"cost_model": model} | closed, closed, tmp_path
    )
    assert costs == pytest.approx(dict.fromkeys(costs, plans[model, constrained].cost), rel=1e-9)


def costs_of_every_way(maps, ends, planned, under, closed, folder) -> dict[str, float]:
    """What a path costs by every way, under arguments of `plan`, and those of them that a path in a file needs."""
    costs = {}
    (answer,) = ju.plan_many(
        maps, [ends], altitude_m=ALTITUDE_M, weights=WEIGHTS, progress=False, **under
    )
    costs["plan_many"] = answer.cost
    costs["explain"] = ju.explain(planned, maps).totals["cost"]
    found = ju.studies.sensitivity(
        maps,
        folder / "sensitivity",
        [ends],
        altitudes_m=[ALTITUDE_M],
        weights=WEIGHTS,
        settings=QUICK,
        progress=False,
        **under,
    )
    costs["sensitivity"] = found.rows.cost.item()
    costs["sensitivity's path"] = found.route.path.cost
    costs["sensitivity's gradient"] = float(found.route.features @ VECTOR)
    given = found.route.breakpoints("gps").query("is_given")
    assert given.length_m.item() == pytest.approx(planned.length_m, rel=1e-9)
    for name, (shown,) in {
        "demonstrations of a file": ju.fit.demonstrations(
            planned.save(folder / "route.geojson"), maps, **closed
        ),
        "demonstrations of paths": ju.fit.demonstrations([planned], maps, **closed),
    }.items():
        assert shown.query.cost_map.cost_model == ju.CostModel.from_settings(planned.settings)
        costs[name] = float(shown.features @ VECTOR)
        costs[f"the search of {name}"] = float(
            shown.query.sums(shown.query.cheapest(VECTOR))[0] @ VECTOR
        )
    how = ju.studies.Study(planners=["astar-plus"], distance_only=())
    found = ju.studies.study(
        maps, folder / "study", instances_of(maps), settings=how, **under, progress=False
    )
    return costs | {"study": found.rows.cost.item()}


@pytest.fixture(scope="module")
def low_roofs(maps) -> ju.MetricMaps:
    """The same maps with roofs 2 m below the altitude, and walls that touch cells without covering their centres."""
    rng = np.random.default_rng(8)
    is_free = maps.m("roof") == 0
    is_low, is_touched = (is_free & (rng.random(is_free.shape) < share) for share in (0.05, 0.02))
    for row, col in (START, GOAL):
        is_low[row, col] = is_touched[row, col] = False
    roof_m = np.where(is_low, np.float32(ALTITUDE_M - 2), maps.m("roof"))
    touched_m = np.where(is_touched, np.float32(80.0), roof_m)
    return ju.MetricMaps(
        maps.ds.assign(roof=(("y", "x"), roof_m), roof_touched=(("y", "x"), touched_m))
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "planning", "rules"),
    [
        ("", {}, ("line", "touched", 3.0)),
        ("paper", {}, ("cell", "centre", 0.0)),
        ("", {"cost_model": "cell", "vertical_clearance_m": 0.0}, ("cell", "touched", 0.0)),
        ("", {"preset": "paper", "vertical_clearance_m": 3.0}, ("cell", "centre", 3.0)),
        ("paper", {"cost_model": "line", "vertical_clearance_m": 3.0}, ("line", "centre", 3.0)),
    ],
)
def test_without_a_model_every_way_has_the_rules_of_scenario_and_preset_and_one_cost(
    low_roofs, ends, options, preset, planning, rules, tmp_path, capsys
):
    under = {"preset": preset} if preset else {}
    kind, rule, clearance_m = rules
    counted = "guess" if rule == "centre" else "likely"  # of unknown heights
    constraints = ju.Constraints(vertical_clearance_m=clearance_m, unknown_heights=counted)
    named = {"cost_model": kind, "constraints": constraints}
    where = {"altitude_m": ALTITUDE_M, "weights": WEIGHTS}
    expected = ju.plan(low_roofs.with_obstacles(rule), *ends, **where, **named)
    write_zarr(low_roofs.ds, tmp_path / "maps")
    write_json(
        tmp_path / "maps" / "run.json",
        {"settings": {"weights": WEIGHTS.to_dict(), "planning": planning}},
    )
    low_roofs = ju.open_maps(tmp_path / "maps")
    planned = ju.plan(low_roofs, *ends, **where, **under)
    assert planned.settings == expected.settings
    costs = {"plan": planned.cost} | costs_of_every_way(
        low_roofs, ends, planned, under, under, tmp_path
    )
    for planner in ("astar-dist", "astar-plus"):
        costs[planner] = ju.plan(low_roofs, *ends, **where, **under, planner=planner).cost
    options += ("--preset", preset) if preset else ()
    for command, more in (
        ("plan", ()),
        ("sensitivity", (*QUICK_OPTIONS, tmp_path / "study-of-one")),
    ):
        facts = json.loads(run(capsys, command, tmp_path / "maps", *options, *more)[1])
        costs[f"the command {command}"] = cost_of(facts)
    assert costs == pytest.approx(dict.fromkeys(costs, expected.cost), rel=1e-9)


def test_a_preset_sets_only_what_is_left_out(low_roofs):
    for given, kind, clearance_m in (
        ({"cost_model": "line"}, "line", 0.0),
        ({"constraints": ju.Constraints(vertical_clearance_m=3.0)}, "cell", 3.0),
        ({"constraints": ju.Constraints.read(require="gps>=0.1")}, "cell", 0.0),
    ):
        on = ju.cost_map(low_roofs, ALTITUDE_M, preset="paper", **given)
        assert (on.cost_model.kind, on.maps.obstacles) == (kind, "centre")
        assert on.constraints.vertical_clearance_m == clearance_m
    planning = ju.Scenario.from_dict(
        REGION | {"planning": {"preset": "paper", "clearance_m": 2.0}}
    ).planning
    assert (planning.cost_model, planning.clearance_m, planning.budget_s) == (None, 2.0, 10.0)
    assert vars(planning.rules) == {
        "cost_model": "cell",
        "obstacles": "centre",
        "clearance_m": 2.0,
        "vertical_clearance_m": 0.0,
        "unknown_heights": "guess",
    }


@pytest.fixture(scope="module")
def folder(maps, tmp_path_factory):
    """A folder of maps whose scenario plans under another cost model than the default one."""
    folder = tmp_path_factory.mktemp("maps")
    write_zarr(maps.ds, folder)
    settings = {"planning": {"cost_model": "cell"}, "weights": WEIGHTS.to_dict()}
    write_json(folder / "run.json", {"settings": settings})
    return folder


def cost_of(facts: dict) -> float:
    """Return the cost in what a command prints, of a path or of a study of one."""
    if "tables" in facts:
        (facts,) = facts["tables"]["routes"]
    return facts["cost"]


@pytest.mark.slow
def test_commands_plan_one_path_under_the_scenarios_cost_model_and_the_same_constraints(
    maps, ends, folder, options, zone_file, tmp_path, capsys
):
    where = (folder, *options, "--no-fly", zone_file, "--require", REQUIRE)
    expected = ju.plan(
        maps,
        *ends,
        altitude_m=ALTITUDE_M,
        weights=WEIGHTS,
        cost_model="cell",
        constraints=ju.Constraints.read(zone_file, REQUIRE),
    )
    for command, more in (("plan", ()), ("sensitivity", (*QUICK_OPTIONS, tmp_path))):
        facts = json.loads(run(capsys, command, *where, *more)[1])
        assert cost_of(facts) == pytest.approx(expected.cost, rel=1e-9)
        assert facts.get("settings", expected.settings) == expected.settings
    rules = "(reference length 5 m, 8 neighbours, diagonal steps 'both-free'); constraints: 1 no-fly zone, risk>=0.08"
    assert f"'cell' {rules}" in (tmp_path / "report.md").read_text()


def test_routes_are_fitted_under_the_cost_model_they_were_planned_under_and_differing_ones_are_told(
    maps, plans, tmp_path
):
    line, cell = (plans[ju.CostModel(kind, 4.0), "none"] for kind in ("line", "cell"))
    both = tmp_path / "both.geojson"
    write_path([line, cell], both, names=["line", "cell"])
    for read in (
        lambda **more: ju.fit.demonstrations(both, maps, **more),
        lambda **more: ju.fit.demonstrations([line, cell], maps, **more),
    ):
        with pytest.raises(
            ju.InputError,
            match=r"planned under the cost model 'line' .* under 'cell' .*cost_model=",
        ):
            read()
        with pytest.warns(
            OtherSettingsWarning, match="model 'cell' .* fitted under the cost model 'line'"
        ):
            shown = read(cost_model=ju.CostModel("line", 4.0))
        assert {each.query.cost_map.cost_model.kind for each in shown} == {"line"}
        with pytest.warns(OtherSettingsWarning) as told:
            read(cost_model="line")
        assert len(told) == 1  # of the first, whose reference length is another one
    drawn = write_geojson(tmp_path / "drawn.geojson", shown)
    (unit,) = {each.query.cost_map for each in ju.fit.demonstrations(drawn, maps)}
    assert unit.cost_model == ju.CostModel("line")

    both.write_text(both.read_text().replace('"cost_model": "line"', '"cost_model": "area"', 1))
    with pytest.raises(ju.InputError, match="cost_model must be 'cell' or 'line', got 'area'"):
        ju.fit.demonstrations(both, maps)


def test_routes_of_other_constraints_than_the_fits_are_told(maps, plans, zone_file, tmp_path):
    free, limited = (plans[MODELS[0], name] for name in ("none", "constraints"))
    file = limited.save(tmp_path / "route.kml")
    constraints = "1 no-fly zone, risk>=0.08, vertical clearance of 3 m"
    with pytest.warns(
        OtherSettingsWarning, match=rf"and {constraints} and is fitted .*constraints="
    ):
        ju.fit.demonstrations(file, maps)
    with pytest.warns(
        OtherSettingsWarning, match="vertical clearance of 3 m and is fitted .* lidar>=0"
    ):
        ju.fit.demonstrations([free], maps, constraints=ju.Constraints.read(require="lidar>=0"))
    moved = tmp_path / "moved.geojson"
    moved.write_text(
        zone_file.read_text()
    )  # the same zone from another file is no other constraint
    (read,) = ju.fit.demonstrations(file, maps, constraints=ju.Constraints.read(moved, REQUIRE))
    assert read.note == ""


@pytest.mark.slow
def test_tune_takes_cost_model_and_constraints_from_its_routes_and_options(
    folder, plans, zone_file, tmp_path, capsys
):
    model = ju.CostModel("cell", 4.0, 8, "always")
    routes = plans[model, "constraints"].save(tmp_path / "routes.geojson")
    asked = ("tune", folder, routes, "-o", tmp_path / "fit", "--fit", "max_rounds=1,bootstrap=0")
    code, _, err = run(capsys, *asked, "--no-fly", zone_file, "--require", REQUIRE)
    assert (code, "was planned under" in err) == (0, False), err
    report = (tmp_path / "fit" / "report.md").read_text()
    constraints = "1 no-fly zone, risk>=0.08, vertical clearance of 3 m"
    assert f"| {model} | {constraints} | touched |" in report
    line = plans[ju.CostModel("line", 4.0), "none"].save(tmp_path / "line.geojson")
    warnings.simplefilter("always")
    code, _, err = run(capsys, *asked, folder, line, "--overwrite")
    assert code == 2
    assert "1 no-fly zone, risk>=0.08, vertical clearance of 3 m and is fitted under" in err
    assert "different cost models: name one for all" in err


def test_a_studys_queries_keep_to_its_constraints_and_are_joined_by_its_rule_for_diagonal_steps(
    maps, closing
):
    constraints = closing["constraints"]
    is_free = constraints.is_free(maps, ALTITUDE_M)
    for diagonal, islands in (("both-free", None), ("always", np.ones((3, 3)))):
        how = {"altitudes_m": [ALTITUDE_M], "cost_model": ju.CostModel("line", 5.0, 8, diagonal)}
        asked = ju.studies.sample_instances(maps, 30, **how, constraints=constraints)
        labels, _ = label(is_free, islands)
        ends = [
            labels[maps.grid.cell_of_xy(asked[f"{end}_x_m"], asked[f"{end}_y_m"])]
            for end in ("start", "goal")
        ]
        assert np.all(ends)  # 0 where no path may fly
        assert ((ends[0] == ends[1]) == asked.is_connected).all()
        anywhere = ju.studies.sample_instances(maps, 30, **how)
        assert not is_free[maps.grid.cell_of_xy(anywhere.start_x_m, anywhere.start_y_m)].all()


def test_a_folder_keeps_one_study_under_one_set_of_constraints(maps, closing, tmp_path):

    def study(constraints=None):
        how = {
            "settings": ju.studies.Study(planners=["ptp"], distance_only=()),
            "constraints": constraints,
        }
        return ju.studies.study(maps, tmp_path, instances_of(maps), **how, progress=False)

    study(closing["constraints"])
    kept = json.loads((tmp_path / "checksums.json").read_text())["study"]["settings"]
    assert ju.CostModel.from_settings(kept) == ju.CostModel("line")
    assert kept["set of constraints"] == str(closing["constraints"])
    other = "its set of constraints is 1 no-fly zone, risk>=0.08, vertical clearance of 3 m, now vertical"
    with pytest.raises(ju.InputError, match=other):
        study()
    (zone,) = closing["constraints"].zones
    redrawn = dataclasses.replace(zone, polygon=zone.polygon.buffer(1e-4))
    with pytest.raises(ju.InputError, match="outlines of no-fly zones"):
        study(dataclasses.replace(closing["constraints"], zones=(redrawn,)))
    settings = Benchmark(constraints=closing["constraints"])
    assert pickle.loads(pickle.dumps(settings)) == settings  # so that a worker reads its maps once
    assert len({settings, pickle.loads(pickle.dumps(settings))}) == 1
