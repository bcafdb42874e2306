"""The command line: exit codes, one sentence for bad input, nothing half-written, resuming."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jaxurban.cli import main as cli
from jaxurban.cli.plan import _path_table
from tests.cli_runs import assert_one_sentence, run

SCENARIO = """
[region]
bounds = [-74.0, 40.755, -73.99, 40.765]
resolution_m = 20
altitudes_m = [20, 60]
[buildings]
source = "synthetic"
"""
START, GOAL = "-73.9985,40.7565", "-73.9915,40.7635"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    (folder / "scenario.toml").write_text(SCENARIO)
    with pytest.raises(SystemExit) as ended:
        cli.main(["maps", str(folder / "scenario.toml"), "-o", str(folder / "out")])
    assert ended.value.code == 0
    return folder / "out"


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in ("run.json", "checksums.json")
    }


def test_maps_writes_the_files_of_the_contract(made):
    names = {path.name for path in (made / "geotiff").iterdir()}
    per_altitude = {f"{metric}_{z}m_20m.tif" for metric in ("obstacle", "gps", "lidar", "risk") for z in (20, 60)}
    styles = {f"{metric}_20m.qml" for metric in ("obstacle", "gps", "lidar", "risk", "population")}
    assert names == per_altitude | styles | {"population_day_20m.tif", "population_night_20m.tif"}
    assert (made / "maps.zarr" / "20m" / ".zmetadata").is_file()
    record = json.loads((made / "run.json").read_text())
    for key in (
        "versions",
        "settings",
        "inputs",
        "buildings",
        "satellites",
        "rays_leave_data_share",
        "population",
        "elapsed_s",
        "started_utc",
    ):
        assert key in record
    assert set(record["population"]["night"]) == {"commercial", "residential", "other", "total"}
    assert {"read", "gps", "lidar", "risk", "population"} <= set(record["elapsed_s"])


def test_a_rerun_gives_the_same_bytes(made, tmp_path, capsys):
    code, _, _ = run(capsys, "maps", made.parent / "scenario.toml", "-o", tmp_path / "again")
    assert code == 0
    assert files_of(tmp_path / "again") == files_of(made)
    first, second = (json.loads((folder / "run.json").read_text()) for folder in (made, tmp_path / "again"))
    for record in (first, second):
        del record["elapsed_s"], record["started_utc"], record["checksum"]
    assert first == second


def test_a_finished_job_is_not_done_again(made, capsys):
    zarr = made / "maps.zarr" / "20m" / ".zmetadata"
    before = zarr.stat().st_mtime_ns
    code, _, _ = run(capsys, "maps", made.parent / "scenario.toml", "-o", made)
    assert (code, zarr.stat().st_mtime_ns) == (0, before)


def test_another_jobs_maps_are_not_overwritten_unless_asked(made, tmp_path, capsys):
    other = tmp_path / "other.toml"
    other.write_text(SCENARIO.replace("[20, 60]", "[20, 40]"))
    kept = files_of(made)
    code, _, err = run(capsys, "maps", other, "-o", made)
    assert code == 2
    assert_one_sentence(err, "--overwrite")
    assert files_of(made) == kept


@pytest.mark.parametrize("planner", ["ptp", "astar-dist", "astar-plus"])
def test_plan_prints_one_json_object(made, capsys, planner):
    code, out, err = run(
        capsys,
        "plan",
        made,
        "--start",
        START,
        f"--goal={GOAL}",
        "--altitude",
        60,
        "--planner",
        planner,
        "--snap",
        "--json",
    )
    facts = json.loads(out)
    assert facts["planner"] == planner
    assert code == {"optimal": 0, "feasible": 0, "blocked": 3, "no-path": 3}[facts["status"]]
    if code == 0:
        assert facts["cost"] > 0
        assert len(facts["lonlat"]) == facts["num_points"]
    assert "error" not in err


def test_plan_writes_each_file_asked_for(made, tmp_path, capsys):
    files = [tmp_path / f"path{suffix}" for suffix in (".geojson", ".kml", ".plan")]
    options = [part for file in files for part in ("-o", file)]
    code, out, _ = run(capsys, "plan", made, "--start", START, "--goal", GOAL, "--altitude", 60, "--snap", *options)
    assert code == 0
    assert "status" in out
    assert all(file.stat().st_size > 0 for file in files)


def test_weights_change_the_cost(made, capsys):
    def cost(*options):
        _, out, _ = run(
            capsys, "plan", made, "--start", START, "--goal", GOAL, "--altitude", 60, "--snap", "--json", *options
        )
        return json.loads(out)["cost"]

    assert cost("--weights", "gps=5") > cost()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--start", "40.7565,-73.9985", "--goal", GOAL, "--altitude", 60), ("start", "longitude comes first")),
        (("--start", "-75,40.7565", "--goal", GOAL, "--altitude", 60), ("start", "outside the region")),
        (("--start", "here", "--goal", GOAL, "--altitude", 60), ("longitude,latitude",)),
        (("--start", START, "--goal", GOAL, "--altitude", 61), ("altitude", "from 20 to 60 m")),
        (("--start", START, "--goal", GOAL, "--altitude", 60, "--planner", "astar"), ("astar-",)),
        (("--start", START, "--goal", GOAL, "--altitude", 60, "--heuristic", "octil"), ("octile",)),
        (("--start", START, "--goal", GOAL, "--altitude", 60, "--time-of-day", "noon"), ("day, night",)),
        (("--start", START, "--goal", GOAL, "--altitude", 60, "--weights", "gsp=1"), ("did you mean 'gps'",)),
        (("--start", START, "--goal", GOAL, "--altitude", 60, "--resolution", 5), ("20 m",)),
        (("--start", START, "--goal", GOAL, "--altitude", 60, "-o", "path.txt"), (".geojson",)),
        (("--start", START, "--altitude", 60), ("--goal",)),
        (("--start", START, "--goal", GOAL, "--altitude", "high"), ("--altitude",)),
    ],
)
def test_bad_plan_input_is_one_sentence_and_exit_two(made, capsys, arguments, words):
    code, out, err = run(capsys, "plan", made, *arguments)
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)


def test_a_start_inside_a_building_names_the_nearest_free_cell(made, capsys):
    import jaxurban as ju

    maps = ju.open_maps(made)
    blocked = [int(value[0]) for value in (~maps.is_free(20.0, "centre")).nonzero()]
    lon, lat = maps.grid.lonlat_of_cell(*blocked)
    arguments = ("plan", made, "--start", f"{lon},{lat}", "--goal", GOAL, "--altitude", 20)
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert_one_sentence(err, "start is inside an obstacle", "nearest free cell", "--snap")
    code, out, _ = run(capsys, *arguments, "--snap", "--json")
    assert code in (0, 2, 3)
    if code == 0:
        assert json.loads(out)["snap_distance_m"]["start"] > 0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('source = "synthetic"', 'source = "none.osm.pbf"', ("the buildings file", "none.osm.pbf", "does not exist")),
        ("resolution_m", "resolution", ("resolution_m",)),
        ("[-74.0, 40.755, -73.99, 40.765]", "[40.755, -120.0, 40.765, -73.99]", ("longitude first",)),
        ("altitudes_m = [20, 60]", "altitudes_m = []", ("altitudes_m",)),
        ("[buildings]", '[gps]\norbits = "bad.osm.pbf"\n[buildings]', ("bad.osm.pbf",)),
        ("[buildings]", "[gps]\nmask_deg = 89.9\n[buildings]", ("no satellite is above", "mask_deg")),
        ("resolution_m = 20", "resolution_m = 0.001", ("GiB", "resolution_m")),
        ("[buildings]", "[lidar]\nrange_m = 1e8\n[buildings]", ("GiB", "range_m")),
        ("[buildings]", "[risk]\nthreshold_m = 1e8\n[buildings]", ("GiB", "threshold_m")),
    ],
)
def test_bad_scenarios_are_one_sentence_and_exit_two(tmp_path, capsys, old, new, words):
    scenario = tmp_path / "scenario.toml"
    assert old in SCENARIO
    scenario.write_text(SCENARIO.replace(old, new))
    (tmp_path / "bad.osm.pbf").write_bytes(b"\x00\x01\x02 not orbits")
    code, out, err = run(capsys, "maps", scenario, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)
    assert not list((tmp_path / "out").rglob("*.tif"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--memory", "much"), ("4GiB", "much")),
        (("--memory", "100MiB"), ("raise --memory", "100 MiB", "resolution_m")),
        (("--workers", 0), ("--workers", "x>=1")),
        (("--workers", 2, "--memory", "1GiB"), ("raise --memory", "fewer --workers")),
        (("--workers", 2, "--cluster", "tcp://localhost:8786"), ("not both",)),
    ],
)
def test_what_a_run_may_not_use_is_refused_in_one_sentence(tmp_path, capsys, options, words):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(SCENARIO)
    code, out, err = run(capsys, "maps", scenario, "-o", tmp_path / "out", *options)
    assert (code, out) == (2, "")
    assert_one_sentence(err.splitlines()[-1], *words)  # below what computes


def test_the_size_of_the_job_is_told_before_it_begins(made, capsys):
    _, _, err = run(capsys, "maps", made.parent / "scenario.toml", "-o", made, "--memory", "8GiB")
    assert re.search(r"\b[1-9][\d,]* cells, ", err.splitlines()[0])
    assert "of 8.0 GiB allowed" in err.splitlines()[0]


def test_further_maps_are_written_when_they_are_asked_for(made, tmp_path, capsys):
    scenario, out = made.parent / "scenario.toml", tmp_path / "out"
    shutil.copytree(made, out)
    code, _, err = run(capsys, "maps", scenario, "-o", out, "--layers", "hdop,rooof")
    assert code == 2
    assert_one_sentence(err, "rooof", "roof")
    assert run(capsys, "maps", scenario, "-o", out, "--layers", "hdop,roof")[0] == 0
    names = {path.name for path in (out / "geotiff").iterdir()} - {path.name for path in (made / "geotiff").iterdir()}
    assert names == {"hdop_20m_20m.tif", "hdop_60m_20m.tif", "hdop_20m.qml", "roof_20m.tif", "roof_20m.qml"}


def test_a_long_series_of_epochs_is_kept_as_statistics(tmp_path, capsys):
    scenario = tmp_path / "scenario.toml"
    series = '[gps]\nstart = "2020-04-27T00:00:00Z"\nstop = "2020-04-27T23:59:00Z"\nstep_s = 3000\n'
    scenario.write_text(SCENARIO + series)
    assert run(capsys, "maps", scenario, "-o", tmp_path / "out")[0] == 0
    names = {path.name for path in (tmp_path / "out" / "geotiff").iterdir()}
    assert {f"gps_{kind}_{z}m_20m.tif" for kind in ("availability", "median", "p05") for z in (20, 60)} <= names
    assert not {name for name in names if name.startswith("gps_20m")}
    code, out, _ = run(
        capsys, "plan", tmp_path / "out", "--start", START, "--goal", GOAL, "--altitude", 60, "--snap", "--json"
    )
    assert (code, json.loads(out)["cost_by_layer"]["gps"] > 0) == (0, True)
    code, _, err = run(
        capsys, "plan", tmp_path / "out", "--start", START, "--goal", GOAL, "--altitude", 60, "--time", "2020-04-27"
    )
    assert code == 2
    assert_one_sentence(err, "statistics over 29 epochs", 'series = "epochs"')


@pytest.mark.slow
def test_pictures_of_former_maps_are_removed_but_not_what_the_user_changed(tmp_path, capsys):
    scenario, out = tmp_path / "scenario.toml", tmp_path / "out"
    scenario.write_text(SCENARIO)
    command = "maps", scenario, "-o", out
    assert run(capsys, *command, "--figures")[0] == 0
    figures = out / "figures" / "20m"
    drawn = {file.name for file in figures.iterdir()}
    assert run(capsys, *command)[0] == 0
    assert {file.name for file in figures.iterdir()} == drawn
    (figures / "gps.png").write_bytes(b"mine")
    code, _, err = run(capsys, *command, "--overwrite", "--set", "gps.mask_deg=10")
    assert code == 0
    assert "the pictures of the former maps are removed" in err
    assert [file.name for file in figures.iterdir()] == ["gps.png"]


def test_an_output_folder_that_is_a_file_is_refused(tmp_path, capsys):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(SCENARIO)
    (tmp_path / "out").write_text("a file")
    code, _, err = run(capsys, "maps", scenario, "-o", tmp_path / "out")
    assert code == 2
    assert_one_sentence(err, "cannot write to the output folder")


def test_an_unknown_command_is_a_usage_error(capsys):
    code, _, err = run(capsys, "mpas")
    assert code == 2
    assert_one_sentence(err, "mpas")


@pytest.mark.slow
def test_ctrl_c_exits_130_leaves_no_scrap_and_resumes(tmp_path):
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(SCENARIO.replace("resolution_m = 20", "resolution_m = [20, 2]"))
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-c",
        "from jaxurban.cli.main import main; main()",
        "maps",
        str(scenario),
        "-o",
        str(out),
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ)
    # Interrupt once the first resolution is down and the second is under way.
    deadline = time.monotonic() + 120
    while (
        not (out / "geotiff" / "risk_60m_20m.tif").exists() and time.monotonic() < deadline and process.poll() is None
    ):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    work = out / "maps.zarr" / ".2m.jaxurban-part"  # what the next run goes on with
    assert not [
        path
        for path in out.rglob("*")
        if path.name.endswith(".jaxurban-part") and path != work and work not in path.parents
    ]
    assert not (out / "run.json").exists()
    kept = {n: data for n, data in files_of(out).items() if ".jaxurban-part" not in n}
    assert kept
    assert subprocess.run(command, stderr=subprocess.PIPE, timeout=200, check=False).returncode == 0
    finished = files_of(out)
    assert all(finished[name] == data for name, data in kept.items())
    assert (out / "run.json").exists()
    assert not work.exists()


@pytest.mark.parametrize("arguments", [["--help"], ["plan", "--help"], ["--version"]])
def test_a_reader_of_stdout_that_leaves_is_no_error(arguments):
    read_end, write_end = os.pipe()
    os.close(read_end)
    try:
        left = subprocess.run([sys.executable, "-m", "jaxurban", *arguments], stdout=write_end, stderr=subprocess.PIPE)
    finally:
        os.close(write_end)
    assert (left.returncode, left.stderr) == (0, b"")


def test_the_table_of_a_path_parts_long_names_from_their_numbers():
    metrics = {"gps_horizontal": 0.9, "a_layer_of_a_very_long_name": 0.5}
    facts = {"planner": "p", "heuristic": "h", "backend": "b", "status": "optimal", "cost": 1.0, "gap": 0.0}
    facts |= {"length_m": 1.0, "snap_distance_m": {}, "cost_by_layer": metrics, "metrics": metrics, "message": ""}
    lines = _path_table(facts | {"num_expanded": 1, "elapsed_s": 0.1, "setup_s": 3.0}).splitlines()
    assert lines[-1].split(maxsplit=2)[2] == "0.100 s, after 3.0 s of compiling"
    assert f"{'mean m_gps_horizontal':<36}0.900" in lines
    assert "cost of a_layer_of_a_very_long_name 0.500" in lines
