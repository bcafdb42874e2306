"""Attempts to lose a user's file: every command, before, during, between and after killed runs."""

import contextlib
import importlib
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import zarr

import jaxurban as ju
from jaxurban.cli.main import main
from jaxurban.io import workspace as workspaces
from jaxurban.io.files import SCRATCH_SUFFIX, read_json, write_json
from jaxurban.io.workspace import Workspace
from tests.cli_runs import assert_one_sentence, run
from tests.faulty_disk import Killed, counted
from tests.receivers.receiver_logs import scenario
from tests.satellite_logs import heard

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
    "compare": (("compare", "maps", "maps"), ("--routes", 1, "--overwrite")),
    "tune": (
        (
            "tune",
            "maps",
            "--sample",
            2,
            "--pilot",
            "distance=0.1,gps=1,risk=1",
            "--fit",
            "bootstrap=0,max_rounds=2",
        ),
        ("--metrics", "gps", "--overwrite"),
    ),
    "sensitivity": (
        (
            "sensitivity",
            "maps",
            *ENDS,
            "--vary",
            "gps,risk",
        ),
        ("--study", "seed=3", "--overwrite"),
    ),
    "routes": (
        ("sensitivity", "maps", "--routes", 2, "--workers", 1),
        ("--study", "seed=3", "--overwrite"),
    ),
    "validate": (
        ("validate", "drive.toml", "log.csv"),
        ("--block", 90, "--overwrite"),
    ),
    "study": (("study", "town.toml", "--workers", 1), ("--overwrite",)),
}
OF_THEIR_OWN = [
    name for name in COMMANDS if name not in ("maps", "study")
]  # folders that they share with none
PLANTED = "the user's words"

pytestmark = [
    pytest.mark.filterwarnings("ignore:Object at"),  # Zarr's own, of files that it does not know
    pytest.mark.usefixtures("blank_pictures"),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory, blank_pictures) -> Path:
    """Return a folder with a scenario, its maps, and what each command makes of them."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "town.toml").write_text(SCENARIO)
    (folder / "drive.toml").write_text(scenario().to_toml())
    heard().to_csv(folder / "log.csv", index=False)
    for name, (command, _) in COMMANDS.items():
        with contextlib.chdir(folder), pytest.raises(SystemExit, match="0"):
            main([*map(str, command), "-o", name])
    return folder


def outputs_of(out: Path) -> list[Path]:
    names = ("checksums.json", ".checksums.jsonl", ".jaxurban.lock")
    files = (path for path in sorted(out.rglob("*")) if path.is_file() and path.name not in names)
    return [
        path
        for path in files
        if not any(part.endswith(SCRATCH_SUFFIX) for part in path.relative_to(out).parts)
    ]


def write(planted: dict[Path, bytes]) -> dict[Path, bytes]:
    for path, data in planted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return planted


def beside(out: Path) -> dict[Path, bytes]:
    """Return files of a user for the places beside the outputs: copies, and others."""
    outputs, planted = outputs_of(out), dict[Path, bytes]()
    for path in {(path.suffix, path.parent): path for path in outputs}.values():
        planted |= {
            path.with_name(name): path.read_bytes()
            for name in (f"my_copy{path.suffix}", f"{path.name}.bak")
        }
    for folder in {out, *(path.parent for path in outputs)}:
        planted |= {folder / name: PLANTED.encode() for name in ("mine.txt", "my folder/mine.txt")}
    return planted


def assert_kept(planted: dict[Path, bytes], out: Path) -> None:
    for path, data in planted.items():
        kept = [
            each / "kept" / path.relative_to(each)
            for each in (out, out / "study")
            if each in path.parents
        ]
        assert any(place.is_file() and place.read_bytes() == data for place in (path, *kept)), (
            f"{path} is lost"
        )


def go_on(place: Path, name: str, monkeypatch, capsys) -> None:
    """Run the command again as it was, then as another one that replaces it; if it is refused, it removed nothing."""
    monkeypatch.chdir(place)
    for more in ((), COMMANDS[name][1], ("--overwrite",)):
        before = {path: path.read_bytes() for path in outputs_of(place / "out")}
        code, _, err = run(capsys, *COMMANDS[name][0], "-o", "out", *more)
        is_unchanged = {path: path.read_bytes() for path in outputs_of(place / "out")} == before
        assert code == 0 or (code == 2 and is_unchanged), err


@pytest.fixture
def job(place, tmp_path) -> Path:
    for name in ("town.toml", "drive.toml", "log.csv", "maps"):
        (shutil.copytree if name == "maps" else shutil.copy)(place / name, tmp_path / name)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_lost_that_comes_during_a_killed_run_and_after_it(
    place, job, name, monkeypatch, capsys
):
    """Of the names beside outputs; and the same command makes all that it makes undisturbed."""
    planted, put, out = {}, Workspace.put, job / "out"

    def late(workspace: Workspace, scratch: Path, path: Path) -> None:
        put(workspace, scratch, path)
        planted.update(write({path.with_name(f"my {path.name}"): path.read_bytes()}))

    monkeypatch.chdir(job)
    with monkeypatch.context() as patched:
        patched.setattr(Workspace, "put", late)
        with contextlib.suppress(Killed), counted(out, 20) as steps:
            run(capsys, *COMMANDS[name][0], "-o", out)
    assert steps.is_over
    planted |= write(beside(out) | {out / "mine.txt": PLANTED.encode()})
    code, _, err = run(capsys, *COMMANDS[name][0], "-o", out)
    assert code == 0, err
    made = {path.relative_to(place / name) for path in outputs_of(place / name)}
    assert made <= {path.relative_to(out) for path in outputs_of(out)}
    go_on(job, name, monkeypatch, capsys)
    assert_kept(planted, out)
    assert not [path for path in out.rglob("*") if path.name.endswith(SCRATCH_SUFFIX)]


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_is_lost_that_a_user_changed_or_that_was_there_before(
    place, job, name, monkeypatch, capsys
):
    """Under every name that the command writes."""
    out, names = job / "out", [path.relative_to(place / name) for path in outputs_of(place / name)]
    planted = write({out / each: PLANTED.encode() for each in names})
    go_on(job, name, monkeypatch, capsys)
    assert {path: path.read_bytes() for path in planted} == planted
    shutil.rmtree(out)
    shutil.copytree(place / name, out)
    suffixes = (".md", ".qml", ".csv", ".parquet", ".npz", "")
    changed = next(out / each for each in reversed(names) if each.suffix in suffixes)
    planted = write({changed: changed.read_bytes() + PLANTED.encode()})
    go_on(job, name, monkeypatch, capsys)
    assert_kept(planted, out)


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_THEIR_OWN)
def test_a_file_in_the_way_is_refused_before_any_older_output_is_removed(
    place, job, name, monkeypatch, capsys
):
    shutil.copytree(place / name, job / "out")
    out = job / "out"
    monkeypatch.chdir(job)
    record = read_json(out / "checksums.json")
    (section,) = record.values()
    user, *_ = (each for each in reversed(section["written"]) if each != "report.md")
    del section["written"][user]  # it has not been there, and is the user's now
    write_json(out / "checksums.json", record)
    (out / user).write_text(PLANTED)
    before = {path: path.read_bytes() for path in outputs_of(out)}
    code, _, err = run(capsys, *COMMANDS[name][0], "-o", "out", *COMMANDS[name][1])
    assert code == 2
    assert f"{user}' is in the way" in err
    assert {path: path.read_bytes() for path in outputs_of(out)} == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "at"),
    [*((name, "first") for name in COMMANDS), *((name, "last") for name in OF_THEIR_OWN)],
)
def test_of_two_runs_one_wins_and_the_other_one_says_so(place, job, name, at, monkeypatch, capsys):
    """What another run finishes just before this one takes the folder, at first or at last, is not replaced."""
    out, hold, num_holds = job / "out", workspaces.only_writer, 0

    @contextlib.contextmanager
    def counted_hold(folder, *remedy):
        nonlocal num_holds
        num_holds += Path(folder).resolve() == out
        if Path(folder).resolve() == out and num_holds == come_at:
            shutil.copytree(place / name, out, dirs_exist_ok=True)
            held.update({path: path.read_bytes() for path in outputs_of(out)})
        with hold(folder, *remedy):
            yield

    monkeypatch.chdir(job)
    monkeypatch.setattr(workspaces, "only_writer", counted_hold)
    other = [each for each in COMMANDS[name][1] if each != "--overwrite"] or [
        "--set",
        "study.seed=3",
    ]
    held: dict[Path, bytes] = {}
    come_at = 1
    if at == "last":
        come_at = 0
        assert run(capsys, *COMMANDS[name][0], "-o", out, *other)[0] == 0
        come_at, num_holds = num_holds, 0
        shutil.rmtree(out)
    code, _, err = run(capsys, *COMMANDS[name][0], "-o", out, *other)
    assert (code, "--overwrite" in err) == (2, True), err
    held.pop(out / "run.json", None)  # of the same maps: it has the weights of the newer run
    assert {path: path.read_bytes() for path in held} == held != {}


@pytest.mark.slow
@pytest.mark.parametrize("is_consolidated", [False, True])
def test_what_a_user_adds_to_the_zarr_is_kept_and_the_maps_are_read(
    place, job, is_consolidated, monkeypatch, capsys
):
    """`maps` in each of its ways, and `MetricMaps.save`."""
    monkeypatch.chdir(job)
    path = job / "maps/maps.zarr/20m"
    places = [path / "mine", path.with_name("10m")]
    for mine in places:
        zarr.open_group(mine, mode="w", zarr_format=2).create_array(
            "heights", shape=(3, 4), dtype="f4"
        )[:] = 1.0
    (path / "mine.txt").write_text(PLANTED)
    shutil.copytree(path / "mine/heights", path / "heights")
    if is_consolidated:
        zarr.consolidate_metadata(path, zarr_format=2)
    places += [path / "heights", path / "mine.txt"]
    kept = {
        each: each.read_bytes()
        for top in places
        for each in (top, *top.rglob("*"))
        if each.is_file()
    }
    made = ju.open_maps(place / "maps")
    again, other = (
        ("maps", "town.toml", "-o", "maps", *more) for more in ((), COMMANDS["maps"][1])
    )
    coarse = (*again, "--set", "region.resolution_m=30", "--overwrite")
    for command in (again, None, other, coarse, coarse):
        if command is None:
            made.save("maps")
        else:
            code, _, err = run(capsys, *command)
            assert code == 0, err
        assert np.isfinite(ju.open_maps("maps").m("gps", 60.0)).any()
        assert {each: each.read_bytes() for each in kept} == kept


@pytest.mark.slow
def test_a_file_among_unfinished_maps_that_are_not_gone_on_with_is_moved(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "town.toml").write_text(SCENARIO)
    assert run(capsys, "maps", "town.toml", "-o", "maps")[0] == 0
    work = tmp_path / "maps/maps.zarr/.10m.jaxurban-part"
    for name in ("key.txt", "zarr/gps/.zarray", "zarr/gps/0.1.2", "zarr/gps/mine.txt"):
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        (work / name).write_text(PLANTED)
    code, _, err = run(capsys, "maps", "town.toml", "-o", "maps")
    assert (code, work.exists()) == (0, False), err
    files = [path for path in (tmp_path / "maps/kept").rglob("*") if path.is_file()]
    assert [(path.name, path.read_text()) for path in files] == [("mine.txt", PLANTED)]
    assert str(files[0].relative_to(tmp_path)) in err


@pytest.mark.parametrize(
    "command", [("maps", "town.toml"), ("study", "town.toml"), ("demo",), ("tune", "maps")]
)
def test_an_empty_name_is_not_the_current_folder(tmp_path, command, monkeypatch, capsys):
    (tmp_path / "town.toml").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *command, "-o", "")
    assert code == 2
    assert_one_sentence(err, "-o", "the name is empty")
    assert [path.name for path in tmp_path.iterdir()] == ["town.toml"]


@pytest.mark.slow
def test_the_demo_replaces_no_file_of_the_users_and_writes_maps_routes_and_figures(
    tmp_path, monkeypatch, capsys
):
    demo = importlib.import_module("jaxurban.cli.demo")
    monkeypatch.setattr(demo, "RESOLUTION_M", 20.0)
    monkeypatch.setattr(demo, "BUDGET_S", 0.1)
    for name in ("scenario.toml", "paths/paths.csv"):
        write({tmp_path / name: PLANTED.encode()})
        code, _, err = run(capsys, "demo", "-o", tmp_path, "--overwrite")
        assert (code, name in err) == (2, True)
        assert (tmp_path / name).read_text() == PLANTED
        assert not (tmp_path / "checksums.json").exists()
        (tmp_path / name).unlink()
    for _ in range(2):
        assert run(capsys, "demo", "-o", tmp_path)[0] == 0
    written = [route.name for route in (tmp_path / "paths").glob("*.geojson")]
    assert {name.rpartition("_")[0] for name in written} >= {"ptp", "astar", "bitstar-plus"}
    drawn = {picture.stem for picture in (tmp_path / "figures").glob("*.png")}
    assert drawn >= {"overview", "gps", "lidar", "risk", "population", "paths"}
    table = pd.read_csv(tmp_path / "paths" / "paths.csv")
    assert len(table) == 4 * table["altitude_m"].nunique()
    assert table["cost"].notna().sum() == len(written)
