"""Surface models as buildings: told from heights above ground, and made into them with the terrain."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.raster import check_is_no_surface, heights_of_surface, low_levels, read_raster
from jaxurban.io.read.sampling import heights_above
from jaxurban.settings import Buildings
from jaxurban.world.city import City, Raster

UTM = "EPSG:32618"
X, Y = 583000.0, 4506000.0
SIDE_M = 600


def raster(values, pixel_m):
    return Raster(np.asarray(values, np.float32), (pixel_m, 0, X, 0, -pixel_m, Y + SIDE_M), UTM)


def city_heights(built_share, pixel_m=1.0):
    """Blocks of 50 m of 20 m height with streets between them that leave a share of the ground open, and noise."""
    size = round(SIDE_M / pixel_m)
    along = (np.arange(size) * pixel_m) % 50 < 50 * np.sqrt(built_share)
    heights = np.where(along[:, None] & along, 20.0, 0.0)
    return raster(heights + np.random.default_rng(0).normal(0, 0.2, heights.shape), pixel_m)


def hills(pixel_m=7.0, least_m=15.0):
    size = round(SIDE_M / pixel_m) + 10
    row, col = np.mgrid[:size, :size]
    hill = raster(least_m + 10 + 10 * np.sin(row / 25) * np.cos(col / 30), pixel_m)
    return replace(hill, transform=(pixel_m, 0, X - 20, 0, -pixel_m, Y + SIDE_M + 20))


def surface_on(terrain, heights):
    """Heights raised by a terrain of another grid."""
    return heights_above(heights, replace(terrain, values=-terrain.values))


@pytest.mark.parametrize("built_share", [0.1, 0.5, 0.85])
def test_heights_above_ground_are_taken_however_dense(built_share):
    check_is_no_surface("h.tif", city_heights(built_share), UTM)


@pytest.mark.parametrize("built_share", [0.1, 0.5, 0.85])
def test_a_surface_is_refused_with_the_share_seen_and_the_remedy(built_share):
    surface = surface_on(hills(), city_heights(built_share))
    remedy = r'kind = "surface".*\[terrain\] source'
    with pytest.raises(InputError, match=rf"'h\.tif' looks like a surface model.*\d+% of its blocks.*{remedy}"):
        check_is_no_surface("'h.tif'", surface, UTM)


def test_open_fields_and_water_tell_nothing():
    check_is_no_surface("h.tif", raster(np.full((60, 60), 40.0), 10.0), UTM)


def test_a_surface_less_a_terrain_of_another_grid_gives_the_heights_back():
    heights = city_heights(0.5)
    with pytest.warns(UserWarning, match="trees, bridges and cranes.*as buildings.*2 m as ground"):
        found, issues = heights_of_surface("s.tif", surface_on(hills(), heights), hills(), UTM)
    np.testing.assert_allclose(found.values[heights.values > 10], heights.values[heights.values > 10], atol=1e-4)
    assert (found.values[heights.values < 2] == 0).all()  # noise on the ground is no building
    assert issues["cells_near_ground"] == np.sum(heights.values < 2)
    assert issues["cells_below_ground"] == pytest.approx(np.sum(heights.values < 0), abs=3)


def test_a_surface_needs_terrain_and_one_that_goes_with_it():
    heights = city_heights(0.5)
    surface = surface_on(hills(), heights)
    with pytest.raises(InputError, match=r"s\.tif.*\[terrain\] source"):
        heights_of_surface("s.tif", surface, None, UTM)
    for other in (heights, replace(surface, values=surface.values + 34)):
        with pytest.raises(InputError, match=r"s\.tif does not stand on the terrain .*\d+%.*datum.*leave out"):
            heights_of_surface("s.tif", other, hills(), UTM)


def test_outlines_are_no_surface(tmp_path):
    path = tmp_path / "city.geojson"
    path.touch()
    with pytest.raises(InputError, match=r'kind = "surface" is for rasters, and .*city\.geojson'):
        read_buildings(Buildings(path, kind="surface"), UTM)


@pytest.mark.data
def test_gothenburgs_surface_is_refused_and_less_its_terrain_gives_a_city(data_dir):
    surface, terrain = (data_dir / "raster" / f"gothenburg_{kind}.tif" for kind in ("dsm", "dem"))
    options = {"bounds": (11.962, 57.7063, 11.9652, 57.708), "crs": "EPSG:3007"}
    for ground in (None, terrain):
        with pytest.raises(InputError, match=r"gothenburg_dsm\.tif' looks like a surface model"):
            City.from_files(surface, terrain=ground, **options)
    with pytest.warns(UserWarning, match="trees"):
        city = City.from_files(Buildings(surface, kind="surface"), terrain=terrain, **options)
    assert 0.4 < np.mean(city.roofs.values == 0) < 0.6
    assert city.roofs.values.max() == pytest.approx(52.4, abs=0.1)


@pytest.mark.data
def test_bilbaos_heights_are_taken_and_its_surface_refused(data_dir):
    heights, terrain = (
        read_raster(data_dir / "raster" / f"bilbao_{kind}.tif", "EPSG:25830") for kind in ("building_heights", "dem")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_is_no_surface("heights", heights, "EPSG:25830")
    with pytest.raises(InputError, match="looks like a surface model"):
        check_is_no_surface("surface", surface_on(terrain, heights), "EPSG:25830")
    assert np.mean(np.abs(low_levels(heights, "EPSG:25830")) > 2) < 0.01
