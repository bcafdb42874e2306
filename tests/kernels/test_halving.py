"""Halved rasters are GDAL's overviews, to the last bit, however many rows come at a time."""

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.io import MemoryFile
from rasterio.shutil import copy

from jaxurban.kernels.halving import Halving

SHAPES = [(600, 1536), (1301, 1023), (513, 2047), (3, 1500), (1, 1029), (2051, 517)]


def gdals(values: np.ndarray, resampling: str) -> list[np.ndarray]:
    """Return the overviews that GDAL's COG driver makes of a raster, NaN or 255 being no value."""
    height, width = values.shape
    profile = {
        "width": width,
        "height": height,
        "count": 1,
        "dtype": values.dtype,
        "transform": Affine(5, 0, 0, 0, -5, 0),
    }
    with MemoryFile() as plain, MemoryFile(ext=".tif") as made:
        with plain.open(driver="GTiff", nodata=np.nan if values.dtype.kind == "f" else 255, **profile) as file:
            file.write(values, 1)
        copy(plain.name, made.name, driver="COG", blocksize=512, overview_resampling=resampling)
        with rasterio.open(made.name) as file:
            num = len(file.overviews(1))
        found = []
        for level in range(num):
            with rasterio.open(made.name, overview_level=level) as file:
                found.append(file.read(1))
        return found


def raster(shape: tuple[int, int], kind: str) -> np.ndarray:
    rng = np.random.default_rng(0)
    if kind == "classes":
        return rng.integers(0, 256, shape, np.uint8)
    values = (rng.standard_normal(shape) * 10 ** rng.uniform(-6, 6, shape)).astype(np.float32)
    values[rng.random(shape) < 0.3] = np.nan
    return values


@pytest.mark.parametrize("kind", ["means", "middles", "classes"])
@pytest.mark.parametrize("shape", SHAPES)
def test_halved_rasters_are_the_overviews_of_gdal(shape, kind):
    values, is_averaged = raster(shape, kind), kind == "means"
    overviews = gdals(values, "average" if is_averaged else "nearest")
    assert overviews
    for overview in overviews:
        halving = Halving(values.shape, is_averaged)
        assert halving.halved == overview.shape
        values = halving.rows(values, 0, 0, halving.halved[0])
        np.testing.assert_array_equal(values, overview)
        np.testing.assert_array_equal(np.signbit(values)[values == 0], np.signbit(overview)[values == 0])


@pytest.mark.parametrize("is_averaged", [True, False])
@pytest.mark.parametrize("shape", [(77, 40), (64, 33), (3, 5), (1, 4)])
def test_rows_made_of_the_first_rows_alone_are_those_of_the_whole(shape, is_averaged):
    values, halving = raster(shape, "means"), Halving(shape, is_averaged)
    whole = halving.rows(values, 0, 0, halving.halved[0])
    assert halving.num_ready(shape[0]) == halving.halved[0]
    for num_rows in range(shape[0]):
        ready = halving.num_ready(num_rows)
        assert ready == sum(halving.needed(row)[1] <= num_rows for row in range(halving.halved[0]))
        if ready:
            first = halving.needed(ready - 1)[0]
            row = halving.rows(values[first:num_rows], first, ready - 1, ready)
            np.testing.assert_array_equal(row, whole[ready - 1 : ready])
