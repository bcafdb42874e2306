"""The least disk that a run needs, against what lies there."""

import shutil
from collections import namedtuple
from dataclasses import replace

import pytest

from jaxurban.errors import InputError
from jaxurban.io.folders import WorkFolder
from jaxurban.maps.memory import check_disk, least_disk_bytes
from jaxurban.maps.run import Maker, make_zarr
from jaxurban.maps.task import MapTask
from jaxurban.progress import Report
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


def test_less_is_asked_for_than_the_maps_and_their_work_folder_take(task, tmp_path, monkeypatch):
    most, finish = [], WorkFolder.finish

    def counted(work, *target):
        most.append(bytes_in(tmp_path))
        finish(work, *target)

    monkeypatch.setattr(WorkFolder, "finish", counted)
    make_zarr(Maker(task, tmp_path, "key", 2), Report())
    assert 0.1 * most[0] < least_disk_bytes([task]) < most[0]


def test_finer_maps_and_more_altitudes_take_more(task):
    least = least_disk_bytes([task])
    assert least < least_disk_bytes([task, task]) < 2 * least
    assert least_disk_bytes([replace(task, params=replace(task.params, altitudes_m=(20.0, 60.0, 122.0)))]) > least


def test_a_disk_too_small_for_the_least_is_refused_and_old_maps_count_as_free(task, tmp_path, monkeypatch):
    least = least_disk_bytes([task])
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(0, 0, least))
    check_disk([task], tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: Usage(0, 0, least - 1000))
    with pytest.raises(InputError, match=r"at least .* of disk and .* are free in .*: use a smaller region"):
        check_disk([task], tmp_path)
    (tmp_path / "maps.zarr").mkdir()
    (tmp_path / "maps.zarr" / "chunk").write_bytes(bytes(1000))
    check_disk([task], tmp_path)
