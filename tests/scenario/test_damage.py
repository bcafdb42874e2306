"""A finished folder, file by file deleted, cut and flipped: told, and mended by the same command, byte for byte."""

import itertools
import json
import random
import re
import tomllib
import warnings
from pathlib import Path
from unittest.mock import Mock

import pytest

from jaxurban.errors import InputError
from jaxurban.io.files import read_json, write_json
from jaxurban.io.stored import stored_maps, unfinished_said
from jaxurban.maps import run as pipeline
from jaxurban.maps.scenario import Scenario
from jaxurban.progress import Report
from tests import tiled_runs
from tests.cli_runs import ENDS, TOWN, assert_one_sentence, run
from tests.faulty_disk import DAMAGES, harm, values_of
from tests.logs import logged
from tests.tiled_runs import files_of

SETTINGS = tomllib.loads(TOWN)
LETTER = "run.json/letter.txt", "in the way"  # a folder in the place of the record


def told_on_use(job: Path) -> str:
    """Return the error or warning of opening and reading everything."""
    try:
        with warnings.catch_warnings(action="error"):
            values_of(job)
            json.loads((job / "run.json").read_text())
    except (InputError, UserWarning, OSError, ValueError) as fault:
        return str(fault)
    return ""


def mend(job: Path) -> list[str]:
    """Return what is told of the damage; that parts of the Zarr were moved to ``kept`` is told too."""
    with logged() as told:
        pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)
    moved = [
        sentence
        for sentence in told
        if f"{job / 'kept'}/" in sentence and "geotiff" not in sentence
    ]
    kept = [path for path in (job / "kept").rglob("*") if not path.is_dir() or path.name == "0.0.0"]
    assert len(moved) <= len(kept)
    return [sentence for sentence in told if sentence not in moved]


def without_times(files: dict[str, bytes]) -> dict[str, bytes]:
    """Return files of maps but for the record of their run, with its times, and its checksum."""
    return {
        n: data
        for n, data in files.items()
        if n.split("/")[0] not in ("run.json", "checksums.json", "kept")
    }


def test_an_untouched_folder_is_kept_to_the_last_byte(job):
    before, stamps = files_of(job), {path: path.stat().st_mtime_ns for path in job.rglob("*")}
    assert mend(job) == []
    assert files_of(job) == before
    assert {path: path.stat().st_mtime_ns for path in job.rglob("*")} == stamps


def test_new_weights_change_the_record_and_not_its_times(job):
    before = json.loads((job / "run.json").read_text())
    pipeline.run_scenario(Scenario.from_dict(SETTINGS | {"weights": {"gps": 3.0}}), job)
    after = json.loads((job / "run.json").read_text())
    assert after["settings"]["weights"]["gps"] == 3.0
    assert (after["started_utc"], after["elapsed_s"]) == (
        before["started_utc"],
        before["elapsed_s"],
    )


@pytest.mark.parametrize(
    ("part", "least"),
    [
        ("run.json", 1),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("maps.zarr/**/[0-9]*", 20), ("maps.zarr/**/.z*", 40), ("geotiff/*", 6))
        ),
    ],
)
def test_damage_to_every_file_of_a_kind_is_told_and_mended(job, part, least):
    """Files are deleted, cut and flipped by turns; `test_interrupted` damages one at a time."""
    before, values, rng = files_of(job), values_of(job), random.Random(0)
    files = [path for path in job.glob(part) if path.is_file()]
    assert len(files) >= least
    for path, damage in zip(files, itertools.cycle(DAMAGES), strict=False):
        harm(path, damage, rng)
    assert told_on_use(job)
    told = mend(job)
    assert len(told) == (len(files) if part == "geotiff/*" else 1)
    for style in (
        path for path in files if path.suffix == ".qml"
    ):  # a changed one stays until it is removed
        style.unlink()
    mend(job)
    assert without_times(files_of(job)) == without_times(before)
    assert values_of(job) == values
    assert mend(job) == []
    records = [json.loads(text) for text in ((job / "run.json").read_text(), before["run.json"])]
    for record in records:
        del record["elapsed_s"], record["started_utc"], record["checksum"]
    assert records[0] == records[1]


def test_a_folder_in_the_place_of_a_chunk_is_told_and_mended(job):
    before, chunk = files_of(job), job / "maps.zarr/20m/lidar/0.0.0"
    harm(chunk, "a folder", random.Random(0))
    assert str(chunk) in told_on_use(job)
    assert [sentence.split("'")[1] for sentence in mend(job)] == [str(chunk)]
    assert without_times(files_of(job)) == without_times(before)


def test_what_cannot_be_moved_out_of_the_way_is_one_sentence(job):
    (job / "kept").write_text("mine")
    harm(job / "geotiff/gps_20m_20m.tif", "cut", random.Random(0))
    with pytest.raises(InputError, match=r"gps_20m_20m\.tif' is in the way"):
        pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)
    assert (job / "kept").read_text() == "mine"


def test_the_record_of_another_run_in_the_place_of_ours_is_kept(job):
    record = read_json(job / "run.json")
    write_json(job / "run.json", record | {"run_key": "another"})
    data = (job / "run.json").read_bytes()
    pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)
    assert (job / "kept/run.json").read_bytes() == data
    assert read_json(job / "run.json")["run_key"] == record["run_key"]


@pytest.mark.parametrize(
    ("name", "sentence"),
    [(name, f"{name}' is a file .* move it") for name in ("maps.zarr", "geotiff")] + [LETTER],
)
def test_a_file_in_the_place_of_a_folder_or_a_folder_in_that_of_a_file_is_one_sentence(
    tmp_path, name, sentence
):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=sentence):
        mend(tmp_path)
    assert (tmp_path / name).read_text() == "mine"


DAMAGED = {"run.json": DAMAGES, "maps.zarr/20m/obstacle/0.0.0": ("deleted", "cut")}
DAMAGED |= {"maps.zarr/20m/gps/.zarray": ("deleted",), "maps.zarr/20m/spatial_ref/0": ("flipped",)}


@pytest.mark.parametrize(
    ("part", "damage"), [(part, damage) for part in DAMAGED for damage in DAMAGED[part]]
)
def test_planning_on_damaged_maps_is_one_sentence(job, capsys, part, damage):
    harm(job / part, damage, random.Random(2))
    code, out, err = run(capsys, "plan", job, *ENDS, "--altitude", 20, "--snap")
    assert (code, out) == (2, "")
    words = "run the same `jaxurban maps` command again"
    if (part, damage) == ("run.json", "deleted"):  # as a run that was killed leaves maps
        words = "20 m is finished; run.json is still to be written: the same `jaxurban maps` command goes on"
    assert_one_sentence(err, words, str(job))


def test_damaged_maps_of_another_job_are_not_taken_for_ours(job):
    (job / "maps.zarr" / "20m" / ".zmetadata").unlink()
    before = files_of(job)
    with pytest.raises(InputError, match="--overwrite"):
        pipeline.run_scenario(Scenario.from_dict(SETTINGS | {"gps": {"mask_deg": 6.0}}), job)
    assert files_of(job) == before


@pytest.mark.slow
def test_unfinished_maps_say_how_many_tiles_there_are_and_a_resumed_run_how_many_were(
    tmp_path, monkeypatch, caplog, capsys
):
    city = tiled_runs.city()
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.WorkFolder, "finish", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            tiled_runs.make(tmp_path / "job", city)
    marks = sorted((tmp_path / "job" / "maps.zarr" / ".20m.jaxurban-part" / "done").glob("tile_*"))
    marks[0].unlink()
    left = f"{len(marks) - 1} of {len(marks)} tiles"
    words = f"20 m has {left}: the same `jaxurban maps` command goes on, if none is at work"
    with pytest.raises(InputError, match=re.escape(f"holds unfinished maps: {words}")):
        stored_maps(tmp_path / "job")
    code, out, err = run(capsys, "info", tmp_path / "job")
    assert (code, out.strip()) == (0, f"unfinished  {words}"), err
    tiled_runs.make(tmp_path / "other", city)
    (tmp_path / "other" / "run.json").write_text("{}")  # the last file of the command
    code, out, err = run(capsys, "info", tmp_path)  # which holds both
    assert code == 0, err
    assert out.splitlines() == [f"job    unfinished maps: {words}", "other  maps of 20 m"]
    with caplog.at_level("INFO", logger="jaxurban"):
        pipeline.make_zarr(tiled_runs.maker(tmp_path / "job", city), Report(), tiled_runs.RAGGED)
    assert f"resumed, {left} of 20 m" in caplog.messages


def test_unfinished_maps_say_what_is_not_begun_and_what_is_to_be_written(tmp_path):
    region = SETTINGS["region"] | {"resolution_m": [40, 80], "altitudes_m": [20]}
    states = ["0"]

    def look(*_):
        state = unfinished_said(tmp_path).partition(": ")[0]
        if state != states[-1]:
            states.append(state)

    pipeline.run_scenario(Scenario.from_dict(SETTINGS | {"region": region}), tmp_path, look)
    assert [each for each in states if each not in ("0", "")] == [
        "40 m is not begun; 80 m is not begun",
        "40 m has 0 of 1 tiles; 80 m is not begun",
        "40 m has 1 of 1 tiles, and files are still to be written; 80 m is not begun",
        "40 m is finished; 80 m is not begun",
        "40 m is finished; 80 m has 0 of 1 tiles",
        "40 m is finished; 80 m has 1 of 1 tiles, and files are still to be written",
        "40 m is finished; 80 m is finished; run.json is still to be written",
    ]
    assert unfinished_said(tmp_path) == ""


@pytest.mark.slow
def test_damage_to_unfinished_work_is_told_and_made_again(tmp_path, monkeypatch):
    city, rng = tiled_runs.city(), random.Random(4)
    whole = files_of(tiled_runs.make(tmp_path / "whole", city).parents[1])
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.WorkFolder, "finish", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            tiled_runs.make(tmp_path / "job", city)
    work = tmp_path / "job" / "maps.zarr" / ".20m.jaxurban-part"
    arrays = [next((work / "arrays").glob(f"raster_{number}_*.npz")) for number in (1, 2)]
    parts = [*arrays, work / "done" / "tile_2_2.json", work / "zarr" / "obstacle" / "0.0.0"]
    for file, damage in zip(parts, ("flipped", "a folder", "flipped", "cut"), strict=True):
        harm(file, damage, rng)
    with logged() as told:
        pipeline.make_zarr(tiled_runs.maker(tmp_path / "job", city), Report(), tiled_runs.RAGGED)
    assert sorted(sentence.split("'")[1] for sentence in told) == sorted(map(str, parts))
    assert files_of(tmp_path / "job") == whole
