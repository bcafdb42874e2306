"""The GeoTIFFs of maps: what they hold, their overviews, and what happens where the disk is full."""

import resource

import numpy as np
import pytest
import rasterio
from rasterio.shutil import copy

from jaxurban.io import geotiff
from jaxurban.io.geotiff import profile_of
from jaxurban.world.grid import Grid

rio_cogeo = pytest.importorskip("rio_cogeo", reason="needs the dev extra")

TAGS = {"metric": "gps", "credit": "© those who measured it"}


def grid_of(shape: tuple[int, int]) -> Grid:
    return Grid("EPSG:32618", 2.5, 1_800_000, 230_000, *shape)


def map_of(shape: tuple[int, int], dtype: type) -> np.ndarray:
    rng = np.random.default_rng(1)
    if dtype == np.uint8:
        return rng.choice(np.array([0, 1, 255], np.uint8), shape)
    values = rng.random(shape, np.float32)
    values[rng.random(shape) < 0.2] = np.nan
    return values


def write(path, values: np.ndarray, is_averaged: bool, num_rows: int = geotiff.BLOCK) -> None:
    parts = (values[start : start + num_rows] for start in range(0, len(values), num_rows))
    about = {"is_averaged": is_averaged, "tags": TAGS, "title": "GPS quality", "unit": "1"}
    geotiff.write_cog(path, grid_of(values.shape), values.dtype, parts, **about)


def facts_of(path) -> list:
    with rasterio.open(path) as file:
        num = len(file.overviews(1))
        profile = {name: str(value) for name, value in file.profile.items()}
        facts = [
            profile,
            file.tags(),
            file.tags(ns="IMAGE_STRUCTURE"),
            file.descriptions,
            file.units,
            file.overviews(1),
        ]
        facts.append(file.read(1).tobytes())
    for level in range(num):
        with rasterio.open(path, overview_level=level) as file:
            facts += [file.shape, str(file.nodata), file.block_shapes, file.read(1).tobytes()]
    return facts


@pytest.mark.parametrize(
    ("shape", "dtype", "is_averaged"),
    [
        ((40, 30), np.float32, True),
        ((512, 512), np.float32, True),
        ((513, 40), np.uint8, False),
        ((1301, 1023), np.float32, True),
        ((1024, 1536), np.float32, False),
        ((700, 2100), np.uint8, False),
    ],
)
def test_a_file_is_that_of_gdals_cog_driver(tmp_path, shape, dtype, is_averaged):
    values = map_of(shape, dtype)
    with rasterio.open(tmp_path / "plain.tif", "w", **profile_of(grid_of(shape), values.dtype)) as file:
        file.write(values, 1)
        file.update_tags(**TAGS)
        file.set_band_description(1, "GPS quality")
        file.set_band_unit(1, "1")
    how = {
        "compress": "ZSTD",
        "level": 1,
        "blocksize": 512,
        "overview_resampling": "average" if is_averaged else "nearest",
    }
    copy(tmp_path / "plain.tif", tmp_path / "gdal.tif", driver="COG", **how)
    write(tmp_path / "ours.tif", values, is_averaged)
    assert facts_of(tmp_path / "ours.tif") == facts_of(tmp_path / "gdal.tif")
    assert rio_cogeo.cog_validate(tmp_path / "ours.tif", strict=True, quiet=True) == (True, [], [])


def test_a_file_does_not_depend_on_how_many_rows_come_at_a_time(tmp_path):
    values = map_of((1301, 700), np.float32)
    write(tmp_path / "a.tif", values, True)
    write(tmp_path / "b.tif", values, True, 1024)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_a_file_leaves_nothing_beside_it(tmp_path):
    write(tmp_path / "a.tif", map_of((1301, 700), np.float32), True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]


def test_a_disk_that_is_full_at_any_point_is_an_os_error(tmp_path):
    values = np.random.default_rng(1).random((1024, 1024), np.float32)  # as noise, which no compression makes smaller
    write(tmp_path / "whole.tif", values, True)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    num_bytes = (tmp_path / "whole.tif").stat().st_size
    for most_bytes in [*range(0, num_bytes, 150_000), num_bytes - 5, num_bytes - 4096, num_bytes - 65536]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, limits[1]))
        try:
            with pytest.raises(OSError, match="GDAL could not write"):
                write(tmp_path / "a.tif", values, True)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
