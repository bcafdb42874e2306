"""Maps that take over the values of smaller ones: many tiles, terrain with holes, every file as if made at once."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxurban.maps.held import HeldMaps
from jaxurban.maps.task import MapTask
from jaxurban.maps.tiled import TileJob
from jaxurban.progress import Report
from jaxurban.scenario.run import Maker, make_zarr
from jaxurban.world.sky import Sky
from jaxurban.world.tiling import Tiling
from tests import tiled_runs


def sky_at(sky: Sky, *numbers: int) -> Sky:
    """Return a sky at some of its times, in this order."""
    at = list(numbers)
    angles = {name: getattr(sky, name)[at] for name in ("azimuth_rad", "elevation_rad", "element_age_days")}
    return replace(sky, times=tuple(sky.times[t] for t in at), **angles)


def part_of(task: MapTask, altitudes_m: tuple[float, ...], *times: int) -> MapTask:
    return replace(task, params=replace(task.params, altitudes_m=altitudes_m), sky=sky_at(task.sky, *times))


def made(task: MapTask, folder: Path, held: HeldMaps | None = None) -> dict[str, bytes]:
    make_zarr(Maker(task, folder, "key", 2), Report(), tiled_runs.RAGGED, held)
    return tiled_runs.files_of(folder / "maps.zarr/20m")


@pytest.mark.slow
@pytest.mark.parametrize("with_terrain", [False, True])
@pytest.mark.parametrize(
    ("altitudes_m", "times"), [((60.0,), (1,)), ((20.0,), (0, 1)), ((60.0, 20.0), (1,)), ((20.0, 60.0), (0, 1))]
)
def test_the_larger_maps_are_those_made_at_once(tmp_path, with_terrain, altitudes_m, times):
    task = tiled_runs.task(tiled_runs.city(with_terrain))
    made(part_of(task, altitudes_m, *times), tmp_path / "small")
    held = HeldMaps.of(tmp_path / "small/maps.zarr/20m", task, task.sky.times)
    num_held = sum(metric == "gps" for metric, _ in held.places)
    assert num_held == len(altitudes_m) * len(times)
    assert made(task, tmp_path / "grown", held) == made(task, tmp_path / "whole")


def test_a_time_at_which_satellites_stand_elsewhere_is_made_anew(tmp_path):
    task = tiled_runs.task(tiled_runs.city())
    moved = replace(task.sky, azimuth_rad=task.sky.azimuth_rad + np.radians([[30.0], [0.0]]))
    made(replace(task, sky=moved), tmp_path / "small")
    held = HeldMaps.of(tmp_path / "small/maps.zarr/20m", task, task.sky.times[1:])
    assert {place[0] for metric, place in held.places if metric == "gps"} == {1}
    assert made(task, tmp_path / "grown", held) == made(task, tmp_path / "whole")


def test_shadows_of_times_that_are_held_are_not_handed_on(tmp_path):
    task = tiled_runs.task(tiled_runs.city())
    made(part_of(task, (20.0, 60.0), 0), tmp_path / "small")
    held = HeldMaps.of(tmp_path / "small/maps.zarr/20m", task, task.sky.times)
    tiling = Tiling.over(task.region, task.with_margin(), tiled_runs.RAGGED)
    pairs = [pair for some in TileJob(task, None, tiling, held).order.values() for pair in some]
    assert {t for t, _ in pairs} == {1}
    shutil.rmtree(tmp_path / "small")
