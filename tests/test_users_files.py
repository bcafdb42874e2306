"""Attempts to lose a user's file: every command, before, during, between and after killed runs."""

import importlib
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zarr

import jaxurban as ju
from jaxurban.io.files import SCRATCH_SUFFIX, read_json, write_json
from jaxurban.io.workspace import Workspace
from tests.cli_runs import assert_one_sentence, run
from tests.receiver_logs import scenario, true_log

SCENARIO = """
[region]
bounds = [-74.0, 40.755, -73.993, 40.761]
resolution_m = 20
altitudes_m = [60]
[buildings]
source = "synthetic"
[study]
instances = 2
planners = ["astar-dist"]
altitudes_m = [60]
"""
ENDS = ("--start", "-73.999,40.756", "--goal", "-73.994,40.76", "--altitude", 60, "--snap", 200)
COMMANDS = {  # what runs, and what makes it another run
    "maps": (("maps", "town.toml"), ("--set", "gps.mask_deg=15", "--overwrite")),
    "compare": (("compare", "maps", "maps"), ("--tolerance", 0.5, "--overwrite")),
    "tune": (
        ("tune", "maps", "--sample", 2, "--pilot", "distance=0.1,gps=1,risk=1", "--bootstrap", 0, "--rounds", 2),
        ("--seed", 3, "--overwrite"),
    ),
    "sensitivity": (
        ("sensitivity", "maps", *ENDS, "--samples", 2, "--tolerance", 0.5, "--vary", "gps,risk"),
        ("--seed", 3, "--overwrite"),
    ),
    "routes": (
        ("sensitivity-study", "maps", "--routes", 1, "--samples", 2, "--workers", 1),
        ("--seed", 3, "--overwrite"),
    ),
    "validate": (("validate", "drive.toml", "log.csv", "--sky-step", 300), ("--block", 150, "--overwrite")),
    "study": (("study", "town.toml", "--workers", 1), ("--overwrite",)),
}
OF_THEIR_OWN = [name for name in COMMANDS if name not in ("maps", "study")]  # folders that they share with none
PLANTED = "the user's words"

pytestmark = pytest.mark.filterwarnings("ignore:Object at")  # Zarr's own, of files that it does not know


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """Return a folder with a scenario, its maps, and what each command makes of them."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "town.toml").write_text(SCENARIO)
    (folder / "drive.toml").write_text(scenario().to_toml())
    true_log()[:400].to_csv(folder / "log.csv", index=False)
    for name, (command, _) in COMMANDS.items():
        done = subprocess.run(words(command, name), cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    return folder


def words(command: tuple, out: str, *more: object) -> list[str]:
    return [sys.executable, "-m", "jaxurban", *map(str, command), "-o", out, *map(str, more)]


def outputs_of(out: Path) -> list[Path]:
    names = ("checksums.json", ".checksums.jsonl", ".jaxurban.lock")
    files = (path for path in sorted(out.rglob("*")) if path.is_file() and path.name not in names)
    return [path for path in files if not any(part.endswith(SCRATCH_SUFFIX) for part in path.relative_to(out).parts)]


def plant(out: Path, what: str) -> dict[Path, bytes]:
    """Put files of a user beside the outputs, or change outputs; return them with their bytes."""
    outputs = outputs_of(out)
    planted: dict[Path, bytes] = {}
    by_kind = {(path.suffix, path.parent): path for path in outputs}.values()
    if what == "changed":
        path = next(
            path for path in reversed(outputs) if path.suffix in (".md", ".qml", ".csv", ".parquet", ".npz", "")
        )
        planted[path] = path.read_bytes() + b"\n" + PLANTED.encode()
    else:
        for path in by_kind:
            planted[path.with_name(f"my_copy{path.suffix}")] = path.read_bytes()
            planted[path.with_name(f"{path.name}.bak")] = path.read_bytes()
        for folder in {out, *(path.parent for path in outputs)}:
            planted[folder / "mine.txt"] = PLANTED.encode()
            planted[folder / "my folder/mine.txt"] = PLANTED.encode()
    for path, data in planted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return planted


def assert_kept(planted: dict[Path, bytes], out: Path) -> None:
    for path, data in planted.items():
        places = (
            path,
            *(each / "kept" / path.relative_to(each) for each in (out, out / "study") if each in path.parents),
        )
        assert any(place.is_file() and place.read_bytes() == data for place in places), f"{path} is lost"


def go_on(place: Path, name: str, monkeypatch, capsys) -> None:
    """Run the command again as it was, then as another one that replaces it; it may be refused, and not crash."""
    monkeypatch.chdir(place)
    for more in ((), COMMANDS[name][1], ("--overwrite",)):
        code, _, err = run(capsys, *COMMANDS[name][0], "-o", "out", *more)
        assert code in (0, 2), err


@pytest.fixture
def job(place, tmp_path) -> Path:
    for name in ("town.toml", "drive.toml", "log.csv", "maps"):
        (shutil.copytree if name == "maps" else shutil.copy)(place / name, tmp_path / name)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("what", ["beside", "changed"])
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_lost_between_runs(place, job, name, what, monkeypatch, capsys):
    shutil.copytree(place / name, job / "out")
    planted = plant(job / "out", what)
    go_on(job, name, monkeypatch, capsys)
    assert_kept(planted, job / "out")


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_lost_that_was_there_before(place, job, name, monkeypatch, capsys):
    """Under every name that the command writes."""
    names = [path.relative_to(place / name) for path in outputs_of(place / name)]
    planted = {job / "out" / each: PLANTED.encode() for each in names}
    for path, data in planted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    go_on(job, name, monkeypatch, capsys)
    assert all(path.read_bytes() == data for path, data in planted.items())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_lost_that_comes_during_a_run(job, name, monkeypatch, capsys):
    planted, put = {}, Workspace.put

    def late(workspace, scratch, path):
        put(workspace, scratch, path)
        for each in (path.with_name("mine.txt"), path.with_name(f"my_copy{path.suffix}")):
            planted[each] = path.read_bytes()
            each.write_bytes(planted[each])

    monkeypatch.chdir(job)
    with monkeypatch.context() as patched:
        patched.setattr(Workspace, "put", late)
        assert run(capsys, *COMMANDS[name][0], "-o", "out")[0] in (0, 2)
    assert len(planted) > 4
    planted = {job / path: data for path, data in planted.items()}
    go_on(job, name, monkeypatch, capsys)
    assert_kept(planted, job / "out")


KILLER = """
    import os, sys
    from jaxurban.io.workspace import Workspace

    put, calls = Workspace.put, []

    def killed(workspace, scratch, path):
        calls.append(1)
        if len(calls) == 3:
            os.kill(os.getpid(), int(sys.argv.pop()))
        put(workspace, scratch, path)

    Workspace.put = killed
    from jaxurban.cli.main import main

    main(sys.argv[1:-1])
"""


@pytest.mark.slow
@pytest.mark.parametrize("ended", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_lost_after_a_kill_and_the_run_goes_on(place, job, name, ended, monkeypatch, capsys):
    command = [sys.executable, "-c", textwrap.dedent(KILLER), *words(COMMANDS[name][0], "out")[3:], str(int(ended))]
    done = subprocess.run(command, cwd=job, capture_output=True, text=True, check=False)
    assert done.returncode == -ended, done.stderr
    planted = plant(job / "out", "beside") | {job / "out/mine.txt": PLANTED.encode()}
    (job / "out/mine.txt").write_text(PLANTED)
    monkeypatch.chdir(job)
    code, _, err = run(capsys, *COMMANDS[name][0], "-o", "out")
    assert code == 0, err
    made = {path.relative_to(place / name) for path in outputs_of(place / name)}
    assert made <= {path.relative_to(job / "out") for path in outputs_of(job / "out")}
    if name == "maps":
        kept = [each for each in made if each.name != "run.json"]
        assert [each for each in kept if (place / name / each).read_bytes() != (job / "out" / each).read_bytes()] == []
    go_on(job, name, monkeypatch, capsys)
    assert_kept(planted, job / "out")
    assert not [path for path in (job / "out").rglob("*") if path.name.endswith(SCRATCH_SUFFIX)]


def test_refused_options_leave_no_record(job_of_maps, monkeypatch, capsys):
    monkeypatch.chdir(job_of_maps)
    for more in (("--pareto", "gps,gps"), ("--range", "0,1"), ("--vary", "x")):
        assert run(capsys, "sensitivity", "maps", *ENDS, "-o", "out", *more)[0] == 2
        assert not os.path.exists("out/checksums.json")
    for more in (("--range", "0,1"), ("--vary", "x")):
        assert run(capsys, "sensitivity-study", "maps", "--routes", 2, "-o", "out", *more)[0] == 2
        assert not os.path.exists("out/checksums.json")


@pytest.fixture
def job_of_maps(tmp_path, capsys) -> Path:
    (tmp_path / "town.toml").write_text(SCENARIO)
    assert run(capsys, "maps", tmp_path / "town.toml", "-o", tmp_path / "maps")[0] == 0
    return tmp_path


def test_the_demo_replaces_no_scenario_or_table_of_the_users(tmp_path, monkeypatch, capsys):
    demo = importlib.import_module("jaxurban.cli.demo")
    monkeypatch.setattr(demo, "BOUNDS", (-74.0, 40.755, -73.993, 40.761))
    monkeypatch.setattr(demo, "RESOLUTION_M", 20.0)
    monkeypatch.setattr(demo, "BUDGET_S", 0.01)
    monkeypatch.setattr("jaxurban.report.figures.save_figures", lambda *_, **__: [])
    for name in ("scenario.toml", "paths/paths.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(PLANTED)
        code, _, err = run(capsys, "demo", "-o", tmp_path, "--overwrite")
        assert (code, name in err) == (2, True)
        assert (tmp_path / name).read_text() == PLANTED
        assert not (tmp_path / "checksums.json").exists()
        (tmp_path / name).unlink()
    for _ in range(2):
        assert run(capsys, "demo", "-o", tmp_path)[0] == 0


def test_a_refused_overwrite_has_removed_nothing(job_of_maps, monkeypatch, capsys):
    monkeypatch.chdir(job_of_maps)
    for command in (("maps",), ("study", "--workers", 1)):
        assert run(capsys, command[0], "town.toml", *command[1:], "-o", "maps")[0] == 0
    (job_of_maps / "maps/geotiff/gps_40m_20m.tif").write_text(PLANTED)
    rows = job_of_maps / "maps/study/rows.parquet"
    rows.write_bytes(rows.read_bytes() + PLANTED.encode())
    (job_of_maps / "other.toml").write_text(SCENARIO + "budget_s = 0.7\n")
    outputs = [path for path in outputs_of(job_of_maps) if path.name != "run.json"]  # which names the scenario's file
    before = {path: path.read_bytes() for path in outputs}
    for name, command in (
        ("gps_40m_20m.tif", ("maps", "town.toml", "--set", "region.altitudes_m=[40]")),
        ("rows.parquet", ("study", "other.toml", "--workers", 1)),
    ):
        code, _, err = run(capsys, *command, "-o", "maps", "--overwrite")
        assert (code, name in err) == (2, True), err
        assert [path for path in outputs if not path.is_file() or path.read_bytes() != before[path]] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_THEIR_OWN)
def test_every_output_is_checked_before_any_older_one_is_removed(place, job, name, monkeypatch, capsys):
    checked: list[str] = []

    def open_noted(folder, *arguments, names=(), **options):
        checked.extend(names)
        return opened(folder, *arguments, names=names, **options)

    shutil.copytree(place / name, job / "out")
    out, opened = job / "out", Workspace.open
    monkeypatch.chdir(job)
    record = read_json(out / "checksums.json")
    (section,) = record.values()
    user, *_ = (each for each in reversed(section["written"]) if each != "report.md")
    del section["written"][user]  # it has not been there, and is the user's now
    write_json(out / "checksums.json", record)
    (out / user).write_text(PLANTED)
    before = {path: path.read_bytes() for path in outputs_of(out)}
    monkeypatch.setattr(Workspace, "open", open_noted)
    code, _, err = run(capsys, *COMMANDS[name][0], "-o", "out", *COMMANDS[name][1])
    assert code == 2
    assert f"{user}' is in the way" in err
    assert {path: path.read_bytes() for path in outputs_of(out)} == before
    assert {path.relative_to(place / name).as_posix() for path in outputs_of(place / name)} <= set(checked)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["array", "group", "file", "consolidated", "other resolution"])
def test_what_a_user_adds_to_the_zarr_is_kept_and_the_maps_are_read(place, job, kind, monkeypatch, capsys):
    """`maps` in each of its ways, and `MetricMaps.save`."""
    monkeypatch.chdir(job)
    path = job / "maps/maps.zarr/20m"
    mine = path.with_name("10m") if kind == "other resolution" else path / "mine"
    if kind == "file":
        mine.write_text(PLANTED)
    else:
        array = zarr.open_group(mine, mode="w", zarr_format=2).create_array("heights", shape=(3, 4), dtype="f4")
        array[:] = 1.0
    if kind == "array":
        (mine / "heights").rename(path / "heights")
    if kind == "consolidated":
        zarr.consolidate_metadata(path, zarr_format=2)
    places = [path / "heights", mine]
    kept = {each: each.read_bytes() for top in places for each in (top, *top.rglob("*")) if each.is_file()}
    made = ju.open_maps(place / "maps")
    again, other = (("maps", "town.toml", "-o", "maps", *more) for more in ((), COMMANDS["maps"][1]))
    coarse = (*again, "--set", "region.resolution_m=30", "--overwrite")
    for command in (again, None, other, coarse, coarse):
        if command is None:
            made.save("maps")
        else:
            code, _, err = run(capsys, *command)
            assert code == 0, err
        assert np.isfinite(ju.open_maps("maps").m("gps", 60.0)).any()
        assert {each: each.read_bytes() for each in kept} == kept


def test_a_file_among_unfinished_maps_that_are_not_gone_on_with_is_moved(job_of_maps, monkeypatch, capsys):
    monkeypatch.chdir(job_of_maps)
    work = job_of_maps / "maps/maps.zarr/.10m.jaxurban-part"
    for name in ("key.txt", "zarr/gps/.zarray", "zarr/gps/0.1.2", "zarr/gps/mine.txt"):
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        (work / name).write_text(PLANTED)
    code, _, err = run(capsys, "maps", "town.toml", "-o", "maps")
    assert (code, work.exists()) == (0, False), err
    files = [path for path in (job_of_maps / "maps/kept").rglob("*") if path.is_file()]
    assert [(path.name, path.read_text()) for path in files] == [("mine.txt", PLANTED)]
    assert str(files[0].relative_to(job_of_maps)) in err


@pytest.mark.parametrize("command", [("maps", "town.toml"), ("study", "town.toml"), ("demo",), ("tune", "maps")])
def test_an_empty_name_is_not_the_current_folder(tmp_path, command, monkeypatch, capsys):
    (tmp_path / "town.toml").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *command, "-o", "")
    assert code == 2
    assert_one_sentence(err, "-o", "the name is empty")
    assert [path.name for path in tmp_path.iterdir()] == ["town.toml"]


@pytest.mark.slow
def test_the_demo_writes_maps_routes_and_figures(tmp_path, monkeypatch, capsys):
    demo = importlib.import_module("jaxurban.cli.demo")
    monkeypatch.setattr(demo, "BOUNDS", (-74.0, 40.755, -73.986, 40.767))
    monkeypatch.setattr(demo, "RESOLUTION_M", 20.0)
    assert run(capsys, "demo", "-o", tmp_path / "out")[0] == 0
    written = [route.name for route in (tmp_path / "out" / "paths").glob("*.geojson")]
    assert {name.rpartition("_")[0] for name in written} >= {"ptp", "astar-dist", "astar-plus", "bitstar-plus"}
    drawn = {picture.stem for picture in (tmp_path / "out" / "figures").glob("*.png")}
    assert drawn >= {"overview", "gps", "lidar", "risk", "population", "paths"}
    table = pd.read_csv(tmp_path / "out" / "paths" / "paths.csv")
    assert len(table) == 5 * table["altitude_m"].nunique()
    assert table["cost"].notna().sum() == len(written)
