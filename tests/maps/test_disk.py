"""What a run says of its disk beforehand, against what lies there."""

import re
import shutil
from collections import namedtuple
from dataclasses import replace

import pytest

from jaxurban.errors import InputError
from jaxurban.io.folders import WorkFolder
from jaxurban.maps import disk
from jaxurban.maps.task import MapTask
from jaxurban.progress import Report
from jaxurban.scenario.run import Maker, make_zarr
from jaxurban.world.grid import Grid
from tests import tiled_runs

Usage = namedtuple("Usage", "total used free")


def bytes_in(folder) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


@pytest.fixture(scope="module")
def task() -> MapTask:
    """300 x 280 cells of 4 m amid buildings."""
    city = tiled_runs.city()
    first_col, first_row = (int(value // 4) + 40 for value in city.extent_m[:2])
    return MapTask(city, Grid(city.crs, 4.0, first_row, first_col, 300, 280), tiled_runs.sky(), tiled_runs.params())


@pytest.mark.parametrize("shape", [(300, 280), (100, 140)])
def test_what_is_foretold_of_scratch_lies_in_the_work_folder(task, tmp_path, monkeypatch, shape):
    found, finish = [], WorkFolder.finish

    def counted(work, *target):
        found.append(bytes_in(work.path / "arrays"))
        finish(work, *target)

    monkeypatch.setattr(WorkFolder, "finish", counted)
    monkeypatch.setattr(disk, "shape_of_tiles", lambda task: shape)
    make_zarr(Maker(task, tmp_path, "key", 2), Report(), shape)
    assert found[0] < disk.scratch_bytes(task) < 1.25 * found[0]
    of_zarr, _ = disk.file_bytes(task)
    assert 1 / 1.5 < of_zarr / bytes_in(tmp_path / "maps.zarr") < 4


def test_finer_maps_more_altitudes_and_layers_take_more(task):
    least = disk.disk_bytes([task])
    assert disk.disk_bytes([task, task], ("all",)) > disk.disk_bytes([task, task])
    assert disk.disk_bytes([task], share=0.25) < least
    higher = replace(task, params=replace(task.params, altitudes_m=(20.0, 60.0, 122.0)))
    assert disk.disk_bytes([higher]) > least
    assert least < disk.disk_bytes([task, task]) < 2 * least


def test_a_disk_with_room_for_the_least_but_not_for_what_is_foretold_is_warned_of(task, tmp_path, monkeypatch, caplog):
    about = disk.disk_bytes([task])
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(0, 0, about))
    disk.check_disk([task], tmp_path)
    assert not caplog.records
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(0, 0, about - 1))
    disk.check_disk([task], tmp_path)
    assert re.search(r"about \d+ MiB of disk and \d+ MiB are free", caplog.text)


def test_a_disk_too_small_for_the_least_is_refused_and_old_maps_count_as_free(task, tmp_path, monkeypatch):
    least = disk.disk_bytes([task], share=disk.LEAST_SHARE)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(0, 0, least))
    assert disk.check_disk([task], tmp_path) == disk.disk_bytes([task]) > least
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(0, 0, least - 1000))
    with pytest.raises(InputError, match=r"at least .* of disk and .* are free in .*: use a smaller region"):
        disk.check_disk([task], tmp_path)
    (tmp_path / "maps.zarr").mkdir()
    (tmp_path / "maps.zarr" / "chunk").write_bytes(bytes(1000))
    disk.check_disk([task], tmp_path)
