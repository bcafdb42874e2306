"""What the scenario of maps gives holds wherever routes are planned on them, and a preset sets only the rest."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxurban as ju
from jaxurban.io.files import write_json
from jaxurban.maps.provenance import settings_of
from jaxurban.maps.run import run_scenario
from jaxurban.settings import Planning, Rules
from jaxurban.viewer.plans import Plans
from tests.cli_runs import TOWN, run
from tests.made_maps import made_maps, maps_of_kinds
from tests.volumes import options_of

ALTITUDE_M = 20.0
MADE = made_maps(40, 60)
CELLS = np.argwhere(MADE.is_free(ALTITUDE_M))[[5, -9]]
START, GOAL = (tuple(map(float, MADE.grid.lonlat_of_cell(*cell))) for cell in CELLS)
PLANNING = [  # with the preset that is named
    ({}, ""),
    ({}, "paper"),
    ({"vertical_clearance_m": 0.0, "obstacles": "centre"}, ""),
    ({"clearance_m": 1.0, "cost_model": "cell"}, "paper"),
    ({"preset": "paper", "vertical_clearance_m": 3.0}, ""),
    ({"planner": "astar-dist"}, "paper"),
    ({"planner": "theta-star", "seed": 5, "budget_s": 9.0}, ""),
]


def folder_of(place, **settings):
    """A folder of maps whose record holds settings."""
    MADE.save(place)
    write_json(place / "run.json", {"settings": settings})
    return place


def command(capsys, folder, *options):
    """What the command says of one route."""
    places = options_of(MADE, *(MADE.grid.xy_of_cell(*cell) for cell in CELLS))
    code, out, err = run(capsys, "plan", folder, *places, "--json", *options)
    assert code == 0, err
    return json.loads(out)


@pytest.mark.slow
@pytest.mark.parametrize(("planning", "preset"), PLANNING)
def test_python_plans_over_a_folder_as_the_command_does(planning, preset, tmp_path, capsys):
    weights = ju.Weights(distance=0.02, gps=3.0, risk=0.5).to_dict()
    folder = folder_of(
        tmp_path / "a",
        planning=planning,
        vehicle={"max_climb_m_s": 3.0, "speed_m_s": 9.0},
        weights=weights,
    )
    maps, under = ju.open_maps(folder), {"preset": preset}
    maps.save(tmp_path / "copy")
    limits = {"clearance_m": 0.0, "vertical_clearance_m": 4.0}
    given = {
        "weights": {"lidar": 4.0},
        "constraints": ju.Constraints(**limits),
    }
    line = (
        "--weights",
        "lidar=4",
        "--rules",
        "clearance_m=0,vertical_clearance_m=4",
    )
    for named, options in (({}, ()), (given, line)):
        options += ("--report", "--preset", preset) if preset else ("--report",)
        expected = command(capsys, folder, *options)
        assert expected["report"]["time_s"] == pytest.approx(expected["length_m"] / 9)
        stated = expected["settings"]["limits"]
        assert (stated["vehicle_max_climb_m_s"], expected["settings"]["weights"]["gps"]) == (
            3.0,
            3.0,
        )
        recorded = (
            limits if named else {name: planning[name] for name in limits if name in planning}
        )
        assert {name: stated.get(name, 0.0) for name in recorded} == recorded
        assert command(capsys, tmp_path / "copy", *options)["settings"] == expected["settings"]
        cut = ju.MetricMaps(maps.ds.isel(x=slice(0, 60)))
        found = [
            ju.plan(on, START, GOAL, altitude_m=ALTITUDE_M, **named, **under)
            for on in (str(folder), maps, cut)
        ]
        (one,) = ju.plan_many(
            folder, [(START, GOAL)], altitude_m=ALTITUDE_M, progress=False, **named, **under
        )
        for path in found:
            assert path.settings == expected["settings"]
            assert path.search.planner == expected["planner"]
            assert path.xy_m.tolist() == expected["xy_m"]
            assert one.cost == pytest.approx(expected["cost"], rel=1e-9)
        without = {
            name: value for name, value in expected["settings"].items() if name != "budget_s"
        }
        assert one.settings | without == one.settings


def test_what_is_named_wins_over_the_scenario(tmp_path):
    planning = {
        "clearance_m": 1.0,
        "vertical_clearance_m": 5.0,
        "obstacles": "centre",
    }
    maps = ju.open_maps(folder_of(tmp_path, planning=planning, vehicle={"speed_m_s": 3.0}))
    on = ju.cost_map(
        maps,
        ALTITUDE_M,
        constraints=ju.Constraints(clearance_m=0.0, vehicle=ju.Vehicle(speed_m_s=1.0)),
    )
    limits = {"no_fly": [], "require": [], "vertical_clearance_m": 5.0}
    limits |= {"unknown_heights": "likely"}
    assert on.constraints.to_dict() == limits | {"vehicle_speed_m_s": 1.0}
    assert (maps.obstacles, maps.with_obstacles("touched").obstacles) == ("centre", "touched")
    for rule, preset in (("touched", "paper"), ("centre", "")):
        assert (
            ju.cost_map(
                ju.open_maps(tmp_path, obstacles=rule), ALTITUDE_M, preset=preset
            ).maps.obstacles
            == rule
        )
    planned = ju.cost_map(maps, ALTITUDE_M).plan(START, GOAL)
    assert planned.cost == ju.plan(maps, START, GOAL, altitude_m=ALTITUDE_M).cost
    defaults = ju.plan(ju.MetricMaps(MADE.ds), START, GOAL, altitude_m=ALTITUDE_M).settings
    assert defaults["limits"] == limits | {"vertical_clearance_m": 3.0}


def test_a_presets_rule_is_one_for_scenarios_studies_and_the_viewer(tmp_path):
    given = {"vertical_clearance_m": 3.0, "cost_model": "line"}  # the defaults, but given
    lines = "\n".join(f"{name} = {json.dumps(value)}" for name, value in given.items())
    (tmp_path / "town.toml").write_text(f"{TOWN}[planning]\n{lines}\n", encoding="utf-8")
    study = ju.Scenario.from_toml(tmp_path / "town.toml", ["planning.preset='paper'"])
    rules = study.planning.rules
    assert (rules.cost_model, rules.obstacles, rules.vertical_clearance_m) == (
        "line",
        "centre",
        3.0,
    )
    settings = settings_of(ju.Scenario.from_toml(tmp_path / "town.toml"))
    assert settings["planning"] == given  # what was given, and no default
    folder = folder_of(tmp_path / "a", **settings)
    maps = ju.open_maps(folder)
    plans = Plans(maps, preset="paper")
    assert (plans.cost_model.kind, plans.limits.vertical_clearance_m) == ("line", 3.0)
    drawn = ju.studies.sample_instances(
        maps, 2, altitudes_m=[ALTITUDE_M], weights=[ju.Weights()], preset="paper"
    )
    (row,) = drawn[drawn.instance == 0].itertuples()
    ends = ju.XY(row.start_x_m, row.start_y_m), ju.XY(row.goal_x_m, row.goal_y_m)
    path = ju.plan(maps, *ends, altitude_m=ALTITUDE_M, preset="paper")
    assert (path.settings["cost_model"], path.settings["obstacles"]) == ("line", "centre")


def test_a_run_knows_its_scenario_in_memory_and_in_its_folder(tmp_path):
    (tmp_path / "town.toml").write_text(
        f"{TOWN}[planning]\nobstacles = 'centre'\n[vehicle]\nspeed_m_s = 2\n"
    )
    (held,) = run_scenario(
        ju.Scenario.from_toml(tmp_path / "town.toml"), tmp_path / "out"
    ).maps.values()
    opened = ju.open_maps(tmp_path / "out")
    recorded = {"planning": {"obstacles": "centre"}, "vehicle": {"speed_m_s": 2.0}}
    for maps in (held, opened):
        assert (maps.recorded | recorded, maps.obstacles) == (maps.recorded, "centre")
    (tmp_path / "out" / "run.json").unlink()
    with pytest.raises(
        ju.InputError,
        match=r"run.json is still to be written: the same `jaxurban maps` command goes on",
    ):
        ju.open_maps(tmp_path / "out")


LEFT_OUT_OR_DEFAULT = {item.name: st.sampled_from([None, item.default]) for item in fields(Rules)}
PLANNINGS = st.fixed_dictionaries(
    {},
    optional=LEFT_OUT_OR_DEFAULT
    | {
        "preset": st.sampled_from(["", "paper"]),
        "planner": st.sampled_from(["astar-plus", "astar-dist"]),
        "seed": st.integers(0, 3),
        "budget_s": st.sampled_from([9.0, 10.0]),
    },
)


@pytest.mark.slow
@given(PLANNINGS, st.sampled_from(["", "paper"]))
@settings(max_examples=25, deadline=None)
def test_equal_settings_plan_equally_under_every_preset_and_after_replace(named, preset):
    first = Planning(**named)
    others = (
        replace(Planning(), **named),
        replace(replace(first, seed=7), seed=first.seed),
        Planning(**vars(first)),
        Planning(**first.given),
    )
    assert {first, *others} == {first}
    assert {replace(each, preset=preset).rules for each in others} == {
        replace(first, preset=preset).rules
    }
    expected, *planned = (
        ju.plan(
            MADE.with_recorded({"planning": each.given}),
            START,
            GOAL,
            altitude_m=ALTITUDE_M,
            preset=preset,
        )
        for each in (first, *others)
    )
    for path in planned:
        assert path.settings == expected.settings
        np.testing.assert_array_equal(path.xy_m, expected.xy_m)


def test_what_is_named_as_its_default_is_not_what_is_left_out():
    named = Planning(vertical_clearance_m=3.0)
    assert named != Planning()
    assert Planning().rules == named.rules == replace(Planning(), budget_s=5.0).rules
    paper = replace(Planning(), preset="paper")
    assert (paper.rules.vertical_clearance_m, paper) == (0.0, Planning(preset="paper"))
    assert replace(named, preset="paper").rules.vertical_clearance_m == 3.0


def test_the_preset_of_the_paper_over_other_kinds_than_buildings_is_a_caution():
    maps, _ = maps_of_kinds()
    cells = np.argwhere(maps.is_free(20.0))[[10, -10]]
    ends = [tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in cells]
    plain = replace(maps, ds=maps.ds.drop_vars("roof_kind"))

    def cautions(on, **options) -> str:
        path = ju.plan(on, *ends, altitude_m=20.0, **options)
        (many,) = ju.plan_many(on, [ends], altitude_m=20.0, progress=False, **options)
        assert path.message == many.message
        return " ".join(path.cautions)

    said = "The paper's preset knows buildings alone, and these maps hold other kinds"
    assert said in cautions(maps, preset="paper")
    assert said in cautions(maps.with_recorded({"planning": {"preset": "paper"}}))
    assert said not in cautions(maps) + cautions(plain, preset="paper")
