"""The command line: what commands write and say, resuming, interruption, and which device computes."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import click
import jax
import pytest
from shapely import box

import jaxurban as ju
from jaxurban.cli.main import app, main
from jaxurban.exit_codes import ExitCode
from jaxurban.io.glance import glance
from jaxurban.metrics.custom import held_metrics
from jaxurban.terminal.common import again, use_device
from jaxurban.terminal.options import TYPED
from jaxurban.world.grid import grid_of
from tests.cli_runs import ENDS, TOWN, assert_one_sentence, run, write_city
from tests.test_process import heavy_modules

AT_60_M = (*ENDS, "--altitude", 60, "--snap", "--json")
TLE = "gps/gps-ops_2020-04-27.tle"


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.slow
def test_maps_writes_the_files_of_the_contract(made):
    per_altitude = {
        f"{metric}_{z}m_20m.tif"
        for metric in ("obstacle", "gps", "lidar", "risk")
        for z in (20, 60)
    }
    styles = {f"{metric}_20m.qml" for metric in ("obstacle", "gps", "lidar", "risk", "population")}
    people = {"population_day_20m.tif", "population_night_20m.tif"}
    assert names_in(made / "geotiff") == per_altitude | styles | people
    assert (made / "maps.zarr" / "20m" / ".zmetadata").is_file()
    record = json.loads((made / "run.json").read_text())
    keys = {
        "versions",
        "settings",
        "inputs",
        "buildings",
        "started_utc",
    }
    assert keys <= set(record)
    assert {"read", "gps", "lidar", "risk", "population"} <= set(record["elapsed_s"])


def test_a_finished_job_is_not_done_again_and_tells_its_size_before_it_begins(made, capsys):
    zarr = made / "maps.zarr" / "20m" / ".zmetadata"
    before = zarr.stat().st_mtime_ns
    code, _, err = run(capsys, "maps", made.parent / "town.toml", "-o", made, "--memory", "8GiB")
    assert (code, zarr.stat().st_mtime_ns) == (0, before)
    assert re.search(r"\b[1-9][\d,]* cells, ", err.splitlines()[0])
    assert "of 8.00 GiB allowed" in err.splitlines()[0]


@pytest.mark.parametrize("planner", ["ptp", "astar-dist", "astar-plus"])
def test_plan_prints_one_json_object(made, capsys, planner):
    code, out, err = run(capsys, "plan", made, *AT_60_M, "--planner", planner)
    facts = json.loads(out)
    assert facts["planner"] == planner
    assert code == {"optimal": 0, "feasible": 0, "blocked": 3, "no-path": 3}[facts["status"]]
    if code == 0:
        assert facts["cost"] > 0
        assert len(facts["lonlat"]) == facts["num_points"]
    assert "error" not in err


def test_plan_writes_each_file_asked_for_and_weights_change_the_cost(made, tmp_path, capsys):
    files = [tmp_path / f"path{suffix}" for suffix in (".geojson", ".kml", ".plan")]
    code, out, _ = run(
        capsys, "plan", made, *AT_60_M[:-1], *(part for file in files for part in ("-o", file))
    )
    assert code == 0
    assert "status" in out
    assert all(file.stat().st_size > 0 for file in files)
    costs = [
        json.loads(run(capsys, "plan", made, *AT_60_M, "--weights", f"gps={gps}")[1])["cost"]
        for gps in (1, 5)
    ]
    assert costs[0] < costs[1]


def test_what_a_path_notes_is_printed_in_its_message_alone(made, capsys):
    between = (*ENDS, "--altitude", 40, "--snap")
    code, out, err = run(capsys, "plan", made, *between)
    assert code == 0, err
    assert "are interpolated between" in out
    assert "are interpolated between" not in err
    assert "Roofs: the lowest pass" in err


@pytest.mark.slow
def test_a_goal_that_is_walled_in_ends_with_exit_code_three(tmp_path, capsys):
    court = box(-73.9965, 40.7575, -73.995, 40.7585)
    scenario = write_city(tmp_path, box(-73.9975, 40.7568, -73.994, 40.7592) - court)
    assert run(capsys, "maps", scenario, "-o", tmp_path / "out")[0] == 0
    goal = "--goal={},{}".format(*court.centroid.coords[0])
    code, out, err = run(
        capsys, "plan", tmp_path / "out", ENDS[0], goal, "--altitude", 20, "--json"
    )
    assert (code, err) == (3, "")
    facts = json.loads(out)
    assert (facts["status"], facts["cost"]) == ("no-path", None)
    assert "fly higher" in facts["message"]


@pytest.mark.slow
def test_a_region_without_buildings_is_fine_when_asked_for(tmp_path, capsys):
    scenario = write_city(tmp_path, box(-73.95, 40.75, -73.949, 40.751))
    assert (
        run(capsys, "maps", scenario, "-o", tmp_path / "out", "--set", "buildings.allow=['none']")[
            0
        ]
        == 0
    )


@pytest.mark.slow
def test_elements_weeks_old_warn_and_work_and_years_old_are_refused(
    made, tmp_path, capsys, data_dir
):
    job = (
        "maps",
        made.parent / "town.toml",
        "-o",
        tmp_path,
        "--set",
        f'gps.orbits="{data_dir / TLE}"',
        "--set",
    )
    code, _, err = run(capsys, *job, 'gps.times=["2026-01-01T00:00:00Z"]')
    assert code == 2
    assert_one_sentence(err, "days", "max_age_days")
    code, _, err = run(capsys, *job, 'gps.times=["2020-05-20T00:00:00Z"]')
    assert code == 0
    assert "warning: " in err
    (warning,) = json.loads((tmp_path / "run.json").read_text())["warnings"]
    assert "days" in warning


def test_further_maps_are_written_when_they_are_asked_for(made, tmp_path, capsys):
    out = shutil.copytree(made, tmp_path / "out")
    assert (
        run(capsys, "maps", made.parent / "town.toml", "-o", out, "--layers", "hdop,roof")[0] == 0
    )
    names = names_in(out / "geotiff") - names_in(made / "geotiff")
    assert names == {
        "hdop_20m_20m.tif",
        "hdop_60m_20m.tif",
        "hdop_20m.qml",
        "roof_20m.tif",
        "roof_20m.qml",
    }


@pytest.mark.slow
def test_several_scenarios_are_made_in_one_call_and_one_that_fails_keeps_none_from_it(
    tmp_path, capsys
):
    town = write_city(tmp_path, box(-73.998, 40.757, -73.997, 40.758))
    texts = dict.fromkeys(("a", "bad", "c"), town.read_text())
    (tmp_path / "lone.tif").write_text("no raster")  # which only its reader sees
    texts["bad"] += "[terrain]\nsource = 'lone.tif'\n"
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text)
    files = [tmp_path / f"{name}.toml" for name in texts]
    few = "--set", "region.altitudes_m=[20]", "--set", "gps.mask_deg=60"
    code, out, err = run(capsys, "maps", *files, "-o", tmp_path / "out", *few, "--json")
    entries = json.loads(out)["scenarios"]
    assert code == 2
    assert [each["exit_code"] for each in entries] == [0, 2, 0]
    assert (err.count("maps finished: "), err.count("error: ")) == (2, 1)
    for number, (name, file) in enumerate(zip(texts, files, strict=True), start=1):
        assert f"jaxurban: {name}, {number} of 3 ({file})\n" in err
    assert entries[0]["warnings"]
    for warning in {*entries[0]["warnings"], *entries[2]["warnings"]}:
        assert err.count(f"warning: {warning} (a, c)") == 1
    runs = [tmp_path / "out" / name / "run.json" for name in ("a", "c")]
    before = [file.stat().st_mtime_ns for file in runs]
    code, _, err = run(capsys, "maps", files[0], files[2], "-o", tmp_path / "out", *few)
    assert [file.stat().st_mtime_ns for file in runs] == before
    assert (code, err.count("maps kept as finished: "), err.count("warning: ")) == (0, 2, 0)
    _, _, err = run(capsys, "maps", files[0], "-o", tmp_path / "out" / "a", *few)  # alone
    assert err.count("warning: ") == len(entries[0]["warnings"])


WRONG = {  # scenarios, and words of the sentence on each
    "syntax.toml": (f"{TOWN}[bad", "syntax.toml' cannot be read as a scenario in TOML"),
    "section.toml": (
        TOWN.replace("[buildings]", "[building]"),
        "section.toml: unknown section 'building'",
    ),
    "key.toml": (
        TOWN.replace("altitudes_m", "altitude_m"),
        "key.toml: unknown key 'region.altitude_m'",
    ),
    "file.toml": (TOWN.replace("synthetic", "gone.osm"), "file.toml: the buildings file '"),
    "orbits.toml": (f"{TOWN}[gps]\norbits='gone.tle'", "orbits.toml: the orbits file '"),
}


def test_no_scenario_is_made_where_one_is_wrong_and_every_wrong_one_is_named(tmp_path, capsys):
    (tmp_path / "good.toml").write_text(TOWN)
    for name, (text, _) in WRONG.items():
        (tmp_path / name).write_text(text)
    files = [tmp_path / name for name in ("good.toml", *WRONG)]
    code, out, err = run(capsys, "maps", *files, "-o", tmp_path / "out", "--json")
    *lines, last = err.splitlines()
    assert (code, len(lines)) == (2, len(WRONG)), err
    for line, (_, words) in zip(lines, WRONG.values(), strict=True):
        assert words in line
        assert line.removeprefix("jaxurban: error: ") in json.loads(out)["message"]
    assert last == "jaxurban: none of the 6 scenarios is made: mend the wrong ones"
    assert not (tmp_path / "out").exists()


def test_maps_named_in_the_place_of_a_scenario_are_said_to_be_made_again(made, tmp_path, capsys):
    shutil.copytree(made, tmp_path / "maps")
    code, _, err = run(capsys, "maps", made, "-o", tmp_path / "maps")
    said = f"'{made}' is a folder of maps: they are made with the settings of its run"
    assert (code, said in err) == (0, True), err


def test_scenarios_of_one_name_are_named(made, tmp_path, capsys):
    files = [made.parent / "town.toml", tmp_path / "town.toml"]
    files[1].write_text(TOWN)
    code, _, err = run(capsys, "maps", *files, "-o", tmp_path / "none")
    assert code == 2
    assert_one_sentence(err, "two scenarios have one name", *map(str, files))
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_long_series_of_epochs_is_kept_as_statistics(made, tmp_path, capsys):
    series = ('times=["2020-04-27T00:00:00Z", "2020-04-27T23:59:00Z"]', "step_s=3000")
    given = (part for setting in series for part in ("--set", f"gps.{setting}"))
    assert run(capsys, "maps", made.parent / "town.toml", "-o", tmp_path, *given)[0] == 0
    names = names_in(tmp_path / "geotiff")
    assert {
        f"gps_{kind}_{z}m_20m.tif" for kind in ("availability", "median", "p05") for z in (20, 60)
    } <= names
    assert not {name for name in names if name.startswith("gps_20m")}
    code, out, _ = run(capsys, "plan", tmp_path, *AT_60_M)
    assert (code, json.loads(out)["cost_by_layer"]["gps"] > 0) == (0, True)
    code, _, err = run(capsys, "plan", tmp_path, *AT_60_M, "--time", "2020-04-27")
    assert code == 2
    assert_one_sentence(err, "statistics over 29 epochs", 'series = "epochs"')


@pytest.mark.slow
def test_pictures_of_former_maps_are_removed_but_not_what_the_user_changed(made, tmp_path, capsys):
    command = "maps", made.parent / "town.toml", "-o", tmp_path
    assert run(capsys, *command, "--figures")[0] == 0
    figures = tmp_path / "figures" / "20m"
    drawn = names_in(figures)
    assert run(capsys, *command)[0] == 0
    assert names_in(figures) == drawn
    (figures / "gps.png").write_bytes(b"mine")
    code, _, err = run(capsys, *command, "--overwrite", "--set", "gps.mask_deg=10")
    assert code == 0
    assert "the pictures of the former maps are removed" in err
    assert names_in(figures) == {"gps.png"}


@pytest.mark.slow
def test_ctrl_c_exits_130_leaves_no_scrap_and_resumes(tmp_path):
    (tmp_path / "town.toml").write_text(TOWN.replace("resolution_m = 20", "resolution_m = [20, 2]"))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "jaxurban", "maps", tmp_path / "town.toml", "-o", out]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    # Interrupt once the first resolution is down and the second is under way.
    deadline = time.monotonic() + 120
    while (
        not (out / "geotiff/risk_60m_20m.tif").exists()
        and time.monotonic() < deadline
        and process.poll() is None
    ):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    work = out / "maps.zarr" / ".2m.jaxurban-part"  # what the next run goes on with
    scraps = [
        path for path in out.rglob("*.jaxurban-part") if path != work and work not in path.parents
    ]
    assert not scraps
    assert not (out / "run.json").exists()
    assert subprocess.run(command, stderr=subprocess.PIPE, timeout=200, check=False).returncode == 0
    assert (out / "run.json").exists()
    assert not work.exists()


def heavy_after(words: list[str], folder: Path) -> tuple[str, str]:
    """Return which of three heavy packages a command in a folder has imported, and what it said."""
    code = (
        f"import sys\nfrom jaxurban.cli.main import main\ntry: main({words})\nexcept SystemExit as ended:\n"
        " assert not ended.code\n print(*sorted({'numba', 'pandas', 'xarray'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return ended.stdout.strip(), ended.stderr


@pytest.mark.slow
def test_wrong_options_and_files_are_answered_before_jax_is_imported(made, tmp_path):
    wrong = tmp_path / "wrong.plan"
    wrong.write_text("no plan")
    ends = ["--start=-73.999,40.756", "--goal=-73.994,40.76", "--altitude=20"]
    route = ["plan", str(made), *ends]
    lines = [
        [*route, "-o", "route.xyz"],
        [*route, "--profile", "route.xyz"],
        [*route, "--require", "gps"],
        [*route, "--no-fly", str(wrong)],
        [*route, "--rules=clearance_m=-1"],
        [*route, "--mission", "land"],
        [*route, "--altitude=600"],
        [*route, "--time", "noon"],
        [*route, "--time", "2020-04-27T17:00"],
        ["plan", str(made), "--start=-70,40.756", *ends[1:]],
        ["sensitivity", str(made), ends[0], "--goal=-70,40.76", ends[2]],
        [*route, "--when", "--refine"],
        ["check", str(made), str(wrong)],
        ["compare", str(made), str(made), "-o", str(made)],
        ["sensitivity", str(made), ends[0], "--routes=3"],
        ["tune", str(made), "-o", "new", "--wish", "gps>=1", "--fit", "bootstrap=3"],
    ]
    runs = "".join(
        f"\ntry: main({line})\nexcept SystemExit as e: assert e.code == 2" for line in lines
    )
    heavy = heavy_modules(f"from jaxurban.cli.main import main{runs}")
    assert not {"jax", "matplotlib", "numba", "rasterio", "scipy", "xarray"} & set(heavy)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "allowed"),
    [
        ("--planner=dijkstra", {"numba", "scipy"}),
        ("--planner=astar-volume", {"numba", "scipy"}),
        ("--planner=heuristic=near", {"numba", "scipy"}),
        ("--weights=noise=1", {"jax"}),
        ("--weights=gps=-1", {"jax"}),
        ("--weights=gps_vertical=1", {"jax"}),
    ],
)
def test_wrong_names_and_weights_are_answered_before_maps_are_opened(made, capsys, option, allowed):
    words = ["plan", str(made), *ENDS, "--altitude=20", option]
    heavy = heavy_modules(
        f"from jaxurban.cli.main import main\ntry: main({words})\nexcept SystemExit as e: assert e.code == 2"
    )
    assert set(heavy) <= {"numpy", "pyproj", "shapely"} | allowed

    # What is said is what the same words of Python say.
    name, _, text = option.removeprefix("--planner=").removeprefix("--").rpartition("=")
    name = name or "planner"
    if option.startswith("--weights="):
        name, text = "weights", option.removeprefix("--weights=")
    value = ju.Weights.named_in(text) if name == "weights" else text
    start, goal = ([float(x) for x in end.partition("=")[2].split(",")] for end in ENDS)
    with pytest.raises(ju.InputError) as refused:
        ju.plan(ju.open_maps(made), start, goal, altitude_m=20.0, **{name: value})
    code, _, err = run(capsys, *words)
    assert (code, err) == (2, f"jaxurban: error: {refused.value}\n")


def test_a_glance_at_maps_sees_what_their_opening_does(made, tmp_path):
    maps = ju.open_maps(made)
    glanced = glance(made)
    assert tuple(glanced.altitudes_m) == maps.altitudes_m
    assert tuple(glanced.times) == maps.times
    assert list(held_metrics(glanced)) == list(maps.metrics)
    assert maps.recorded == {name: glanced.recorded[name] for name in maps.recorded}
    assert grid_of(glanced) == maps.grid

    # Maps of Python have no record of a run. What is damaged, and one of several, is left to their opening.
    folder = maps.with_recorded({"planning": {"planner": "ptp"}}).save(tmp_path / "saved")
    assert glance(folder).recorded == {"planning": {"planner": "ptp"}}
    for part in (".zmetadata", "time/0"):
        shutil.copytree(folder, tmp_path / part)
        (tmp_path / part / "maps.zarr/20m" / part).write_bytes(b"{}")
        assert glance(tmp_path / part) is None


@pytest.mark.slow
def test_complete_maps_are_answered_soon_and_changed_ones_are_made_again(made, tmp_path):
    shutil.copy(made.parent / "town.toml", tmp_path)
    shutil.copytree(made, tmp_path / "maps")
    words = ["maps", "town.toml", "-o", "maps"]
    record = (tmp_path / "maps/run.json").read_bytes()
    heavy, said = heavy_after(words, tmp_path)
    assert (heavy, "maps kept as finished" in said) == ("", True)
    assert (tmp_path / "maps/run.json").read_bytes() == record

    # Settings that no map depends on are written to the record, and what is damaged is made again.
    heavy, _ = heavy_after([*words, "--set", "weights.gps=3"], tmp_path)
    assert heavy
    assert json.loads((tmp_path / "maps/run.json").read_text())["settings"]["weights"]["gps"] == 3
    geotiff = next((tmp_path / "maps/geotiff").glob("gps_*.tif"))
    geotiff.unlink()
    heavy, said = heavy_after([*words, "--set", "weights.gps=3"], tmp_path)
    assert heavy
    assert f"{geotiff.name}' is missing: writing it again" in said
    assert geotiff.is_file()


def test_summaries_of_commands_are_whole_on_a_terminal_of_80_columns(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = run(capsys, "--help")
    *_, commands = out.partition("Commands:")
    lines = commands.strip().splitlines()
    assert len(lines) == len(app.commands)
    assert all(line.endswith(".") and not line.endswith("..") for line in lines)


@pytest.mark.parametrize("arguments", [["--help"], ["plan", "--help"], ["--version"]])
def test_a_reader_of_stdout_that_leaves_is_no_error(arguments):
    read_end, write_end = os.pipe()
    os.close(read_end)
    try:
        left = subprocess.run(
            [sys.executable, "-m", "jaxurban", *arguments], stdout=write_end, stderr=subprocess.PIPE
        )
    finally:
        os.close(write_end)
    assert (left.returncode, left.stderr) == (0, b"")


@pytest.mark.parametrize("buffering", [1, -1])  # which is noticed in the midst, and at the end
def test_a_check_whose_reader_leaves_ends_with_the_code_of_its_verdict(
    made, tmp_path, capsys, monkeypatch, buffering
):
    _, _, err = run(capsys, "plan", made, *AT_60_M, "--snap", "-o", tmp_path / "a.plan")
    assert "jaxurban: the path as planned: " in err  # its lengths are not those of the file
    words = ["check", str(made), str(tmp_path / "a.plan"), "--limits", "max_people=0"]
    verdict, *_ = run(capsys, *words)
    assert verdict == ExitCode.FINDINGS
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end, "w", buffering) as left:
        monkeypatch.setattr(sys, "stdout", left)
        with pytest.raises(SystemExit) as ended:
            main(words)
    assert ended.value.code == verdict


def test_view_writes_one_file_that_asks_nobody(made, tmp_path, capsys):
    code, _, err = run(capsys, "view", made, "--export", tmp_path / "page.html")
    assert code == 0
    assert "open it in a browser" in err
    assert not re.findall(
        r'(?:src|href)="(?!data:)', (tmp_path / "page.html").read_text(encoding="utf-8")
    )


@pytest.mark.slow
def test_view_serves_until_ctrl_c_and_then_ends_without_an_error(made):
    command = [sys.executable, "-m", "jaxurban", "view", str(made), "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        address = re.search(r"http://127\.0\.0\.1:\d+/", running.stderr.readline())[0]
        with urllib.request.urlopen(address, timeout=20) as page:
            assert b"<!doctype html>" in page.read()
        ask = urllib.request.Request(
            f"{address}ask/scene", b"{}", {"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(ask, timeout=20) as scene:
            assert json.load(scene)["html"]
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=30)
    assert running.returncode == 0
    assert "Traceback" not in said


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="states what holds where JAX has no GPU")
def test_the_device_is_told(caplog):
    caplog.set_level("INFO", "jaxurban")
    use_device(None)
    use_device("auto")
    assert caplog.messages == ["device: cpu (cpu)"]


@pytest.mark.parametrize("options", [["--device", "cpu"], ["--workers", "2"]])
def test_the_cpu_is_for_a_command_and_for_its_workers(monkeypatch, tmp_path, capsys, options):
    set_up = {}
    monkeypatch.setattr(jax.config, "update", set_up.__setitem__)
    monkeypatch.setenv("JAX_PLATFORMS", "")
    scenario = tmp_path / "of_nothing.toml"
    scenario.touch()
    code, _, _ = run(capsys, "maps", scenario, "-o", tmp_path, *options)
    assert (code, set_up, os.environ["JAX_PLATFORMS"]) == (2, {"jax_platforms": "cpu"}, "cpu")


def test_a_command_runs_again_without_files_however_they_were_typed():
    with click.Context(click.Command("tune")) as context:
        typed = ["./my city/", "--altitude", "60", "x/../routes.csv", "routes.csv", "-o", "out"]
        context.meta[TYPED] = ["tune", *typed, "--json"]
        assert again("-o", "my city", "routes.csv") == (
            "jaxurban tune --altitude 60 x/../routes.csv"
        )
        assert again() == f"jaxurban {shlex.join(['tune', *typed])}"
