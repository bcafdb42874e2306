"""``--json``: one object at every exit code, as docs/reference/json.schema.json describes it."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from jsonschema import Draft202012Validator, ValidationError
from shapely import box

from jaxurban.cli import demo
from jaxurban.cli import main as cli
from jaxurban.exit_codes import ExitCode
from jaxurban.maps import scenario
from jaxurban.paths import finish
from jaxurban.planners.base import Status
from tests.cli_runs import ENDS, SCHEMA, check_json, run, write_city

COMMANDS = cli.app.commands
WITH_JSON = [name for name in COMMANDS if name != "view"]
ROUTE = (*ENDS, "--altitude", 60, "--snap")
TWO_TIMES = 'gps.times=["2020-04-27T00:00:00Z", "2020-04-27T06:00:00Z"]'
FEW = ("--vary", "gps", "--workers", 1)


def codes_of(command: str) -> set[int]:
    """Return the exit codes that the schema allows a command."""
    return set(SCHEMA["$defs"][command]["properties"]["exit_code"]["enum"])


def test_the_schema_is_one_and_describes_every_command():
    Draft202012Validator.check_schema(SCHEMA)
    has_flag = [
        name
        for name, command in COMMANDS.items()
        if any("--json" in parameter.opts for parameter in command.params)
    ]
    assert has_flag == WITH_JSON
    assert set(WITH_JSON) <= set(SCHEMA["$defs"])
    for name in WITH_JSON:
        assert {
            ExitCode.DONE,
            ExitCode.FAULT,
            ExitCode.BAD_INPUT,
            ExitCode.INTERRUPTED,
        } <= codes_of(name)


@pytest.mark.parametrize("printed", ['{"exit_code": 2, "message": null, "argument": null}', "{}"])
def test_an_object_that_the_schema_does_not_allow_is_found(printed):
    with pytest.raises(ValidationError, match=r"is a required property|not of type 'string'"):
        check_json(printed, 2, "info")


@pytest.mark.parametrize("name", [*WITH_JSON, "view", "no-command"])
def test_wrong_usage_is_an_object_that_names_the_option(name, capsys):
    code, out, err = run(capsys, name, "--json", "--no-such")
    facts = check_json(out, code, name)
    assert (code, facts["message"] in err) == (ExitCode.BAD_INPUT, True)
    named = {"view": "--json", "no-command": None}.get(name, "--no-such")
    assert facts["argument"] == named


@pytest.mark.parametrize("name", WITH_JSON)
def test_a_fault_and_an_interrupt_are_objects_too(name, capsys, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("of this test")

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(COMMANDS[name], "make_context", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main([name, "--json"])
    facts = check_json(capsys.readouterr().out, ExitCode.FAULT, name)
    assert "of this test" in facts["message"]
    monkeypatch.setattr(COMMANDS[name], "make_context", interrupted)
    monkeypatch.setattr(cli.os, "_exit", sys.exit)
    code, out, _ = run(capsys, name, "--json")
    assert code == ExitCode.INTERRUPTED
    assert "interrupted" in check_json(out, code, name)["message"]


@pytest.mark.parametrize(
    ("words", "argument"),
    [
        ("plan maps --altitude high", "--altitude"),
        ("plan maps", "--start"),
        ("plan", "DIR"),
        ("info no.tif", None),
        ("maps town.toml -o out --set gps.mask_deg=95", None),
        ("plan maps {route} --mission land", None),
    ],
)
def test_bad_input_names_the_option_at_fault(words, argument, made, capsys, monkeypatch):
    monkeypatch.chdir(made.parent)
    route = " ".join(map(str, ROUTE))
    code, out, err = run(capsys, *words.format(route=route).split(), "--json")
    facts = check_json(out, ExitCode.BAD_INPUT, words.split()[0])
    assert (code, facts["argument"]) == (ExitCode.BAD_INPUT, argument)
    assert err == f"jaxurban: error: {facts['message']}\n"


def test_a_file_that_the_system_refuses_is_an_object(capsys, monkeypatch):
    def refused(*_, **__):
        raise PermissionError(13, "Permission denied", "town.toml")

    monkeypatch.setattr(COMMANDS["info"], "make_context", refused)
    code, out, _ = run(capsys, "info", "--json")
    assert "Permission denied" in check_json(out, code, "info")["message"]


def test_without_json_a_failure_prints_nothing_on_stdout(capsys):
    assert run(capsys, "info", "no.tif")[1] == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["maps", "info", "info-file", "info-at", "plan", "when", "compare", "fetch", "sky"]
)
def test_quick_commands_print_what_the_schema_says(name, made, tmp_path, capsys):
    write_city(tmp_path, box(-73.9975, 40.7568, -73.994, 40.7592))
    arguments = {
        "maps": ("maps", made.parent / "town.toml", "-o", made),
        "info": ("info", made),
        "info-file": ("info", tmp_path / "city.geojson"),
        "info-at": ("info", tmp_path / "city.geojson", "--at=-73.995,40.758"),
        "plan": ("plan", made, *ROUTE, "--report"),
        "when": ("plan", made, *ROUTE, "--when"),
        "compare": ("compare", made, made, "-o", tmp_path / "out"),
        "sky": ("sky", made, "--at=-73.997,40.758", "--altitude", 20),
        "fetch": ("fetch", "--bounds=-74,40.7,-73.99,40.71", "-o", tmp_path / "f", "--dry-run"),
    }[name]
    code, out, err = run(capsys, *arguments, "--json")
    assert code == ExitCode.DONE, err
    check_json(out, code, arguments[0])


@pytest.fixture(scope="module")
def walled(tmp_path_factory) -> tuple[Path, str]:
    """Return maps with a court that nothing leaves at 20 m, and the option of a goal in it."""
    folder, court = tmp_path_factory.mktemp("walled"), box(-73.9965, 40.7575, -73.995, 40.7585)
    file = write_city(folder, box(-73.9975, 40.7568, -73.994, 40.7592) - court)
    with pytest.raises(SystemExit):
        cli.main(["maps", str(file), "-o", str(folder / "maps"), "--set", TWO_TIMES])
    return folder / "maps", "--goal={},{}".format(*court.centroid.coords[0])


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--when",)])
def test_a_plan_without_a_path_says_so_as_an_object(walled, capsys, more):
    folder, goal = walled
    route = (ENDS[0], goal, "--altitude", 20, *more, "--json")
    code, out, _ = run(capsys, "plan", folder, *route)
    facts = check_json(out, ExitCode.NO_PATH, "plan")
    assert (code, "fly higher" in facts["message"]) == (ExitCode.NO_PATH, True)


def test_a_sensitivity_without_a_route_says_so_as_an_object(walled, capsys, tmp_path):
    folder, goal = walled
    route = (ENDS[0], goal, "--altitude", 20, "-o", tmp_path / "out", "--json")
    code, out, _ = run(capsys, "sensitivity", folder, *route)
    check_json(out, ExitCode.NO_PATH, "sensitivity")
    assert code == ExitCode.NO_PATH


def test_a_budget_that_is_spent_without_a_path_is_an_object(made, capsys, monkeypatch):
    plan_as_ever = finish.plan_on

    def without_time(*args, **kwargs):
        return replace(plan_as_ever(*args, **kwargs), status=Status.BUDGET_EMPTY)

    monkeypatch.setattr(finish, "plan_on", without_time)
    code, out, _ = run(capsys, "plan", made, *ROUTE, "--json")
    assert code == ExitCode.UNKNOWN
    assert check_json(out, code, "plan")["status"] == "budget-empty"


@pytest.mark.slow
@pytest.mark.parametrize("code", [ExitCode.DONE, ExitCode.NO_PATH])
def test_a_study_is_an_object(code, tmp_path, capsys, made):
    planner, altitude_m = ("ptp", 20) if code else ("astar-plus", 60)
    town = (made.parent / "town.toml").read_text(encoding="utf-8")
    if code == ExitCode.NO_PATH:  # a town of closed yards
        west, south, east, north = -74.0, 40.755, -73.993, 40.761
        walls = [box(x, south, x + 1e-4, north) for x in np.linspace(west, east, 8)]
        walls += [box(west, y, east, y + 1e-4) for y in np.linspace(south, north, 8)]
        town = write_city(tmp_path, *walls).read_text(encoding="utf-8")
    (tmp_path / "town.toml").write_text(
        f'{town}[study]\ninstances = 2\naltitudes_m = [{altitude_m}]\nplanners = ["{planner}"]\n'
    )
    options = ("--workers", 1, "--json")
    ended, out, err = run(capsys, "study", tmp_path / "town.toml", "-o", tmp_path / "out", *options)
    assert ended == code, err
    assert (check_json(out, code, "study")["message"] is None) == (code == ExitCode.DONE)


@pytest.mark.slow
@pytest.mark.parametrize("code", [ExitCode.DONE, ExitCode.NO_PATH])
def test_a_study_of_sensitivity_is_an_object(code, walled, made, tmp_path, capsys):
    folder, goal = walled if code else (made, ENDS[1])
    lon, lat = (float(part) for part in ENDS[0].removeprefix("--start=").split(","))
    goal_lon, goal_lat = (float(part) for part in goal.removeprefix("--goal=").split(","))
    route = {"start_lon": lon, "start_lat": lat, "goal_lon": goal_lon, "goal_lat": goal_lat}
    altitude_m = 20 if code else 60
    pd.DataFrame([route | {"altitude_m": altitude_m}]).to_csv(tmp_path / "q.csv", index=False)
    options = ("--routes", tmp_path / "q.csv", *FEW, "-o", tmp_path / "out", "--json")
    ended, out, err = run(capsys, "sensitivity", folder, *options)
    assert ended == code, err
    check_json(out, code, "sensitivity")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "code"),
    [
        ((), ExitCode.DONE),
        (("--limits", "max_people=0"), ExitCode.FINDINGS),
        (("--limits", "max_no_fix_m=0"), ExitCode.NOT_JUDGED),
        (("--time", "2020-04-28T16:00:00Z"), ExitCode.BAD_INPUT),
    ],
)
def test_a_check_is_an_object_at_each_of_its_codes(more, code, made, tmp_path, capsys):
    ends = "--start=-73.9985,40.7571", "--goal=-73.9946,40.7596"
    run(capsys, "plan", made, *ends, "--altitude", 60, "--snap", "-o", tmp_path / "x.plan")
    output = ("-o", tmp_path / "out", "-o", tmp_path / "x.geojson")
    ended, out, err = run(capsys, "check", made, tmp_path / "x.plan", *more, *output, "--json")
    assert ended == code, err + out
    if code != ExitCode.BAD_INPUT:
        assert (tmp_path / "out/report.md").exists()
        assert (tmp_path / "x.geojson").exists()


@pytest.mark.slow
def test_a_sensitivity_and_a_fit_are_objects(made, tmp_path, capsys):
    few = ("--vary", "gps", "-o", tmp_path / "one")
    code, out, err = run(capsys, "sensitivity", made, *ROUTE, *few, "--json")
    assert code == ExitCode.DONE, err
    facts = check_json(out, code, "sensitivity")
    assert facts["decided"]["lines"]["next"].startswith("jaxurban sensitivity ")
    assert len(facts["tables"]["ways"]) == 2
    few = ("--sample", 4, "--fit", "bootstrap=2", "--altitude", 60, "-o", tmp_path / "two")
    pilot = "distance=1,gps=1,risk=2"
    code, out, err = run(capsys, "tune", made, *few, "--pilot", pilot, "--json")
    assert code == ExitCode.DONE, err
    assert check_json(out, code, "tune")["weights"]["gps"] >= 0
    few = ("--wish", "mean_gps>=0.1", "--sample", 4, "--altitude", 60, "-o", tmp_path / "three")
    code, out, err = run(capsys, "tune", made, *few, "--json")
    assert code == ExitCode.DONE, err
    assert check_json(out, code, "tune")["is_met"] is True


@pytest.mark.slow
def test_the_demo_is_an_object_and_ends_with_a_picture_and_three_sentences(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(demo, "RESOLUTION_M", 50.0)
    monkeypatch.setattr(scenario, "PAPER_PLANNERS", ("ptp", "astar-plus"))
    code, out, err = run(capsys, "demo", "-o", tmp_path / "out", "--json")
    assert code == ExitCode.DONE, err
    paths = check_json(out, code, "demo")["paths"]
    assert len(paths) > 1
    picture, counts, view = err.splitlines()[-3:]
    assert Path(re.search(r"Look at (\S+):", picture)[1]).is_file()
    assert len(re.findall("no known height|Unknown heights", err)) == 1
    assert f" of {len(paths)} searches" in counts
    assert view.endswith(f"jaxurban view {tmp_path / 'out'}")
