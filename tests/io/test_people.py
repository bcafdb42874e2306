"""Rasters of people: nobody is lost or counted twice, in whatever CRS they come."""

from itertools import pairwise

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.read.census import read_blocks
from jaxurban.maps.provenance import population_totals
from jaxurban.world.city import City, Footprints, Zoning
from jaxurban.world.grid import Grid, transformer

CRS = "EPSG:32618"
X0, Y0 = 585_000.0, 4_510_000.0


def write_people(path, values, transform, crs=CRS, nodata=-99999.0):
    shape = {"height": values.shape[0], "width": values.shape[1], "count": 1}
    with rasterio.open(
        path, "w", driver="GTiff", dtype=values.dtype, crs=crs, transform=transform, nodata=nodata, **shape
    ) as file:
        file.write(values, 1)
    return path


@pytest.fixture
def degrees(tmp_path):
    """Counts on pixels of 3 arc seconds, as WorldPop gives them, a few without data."""
    rng = np.random.default_rng(0)
    values = rng.gamma(0.5, 40.0, (30, 40)).astype(np.float32)
    values[rng.random(values.shape) < 0.1] = -99999.0
    lon, lat = transformer(CRS, "EPSG:4326").transform(X0, Y0)
    return write_people(tmp_path / "people.tif", values, Affine(1 / 1200, 0, lon, 0, -1 / 1200, lat), "EPSG:4326")


def test_every_person_is_in_one_block(degrees):
    blocks, _ = read_blocks(ju.Population(blocks=degrees), CRS)
    with rasterio.open(degrees) as file:
        counts = file.read(1, masked=True)
    assert blocks.night_count.sum() == counts.astype(np.float64).sum()
    assert len(blocks) == counts.count()
    union = shapely.union_all(blocks.polygons)
    np.testing.assert_allclose(shapely.area(union), blocks.area_m2.sum(), rtol=1e-9)  # no two overlap


def test_boxes_share_out_people_by_area(degrees):
    """The boxes of a mesh cut pixels anyhow; together they hold everybody, as GeoPandas counts them too."""
    blocks, _ = read_blocks(ju.Population(blocks=degrees), CRS)
    x_min, y_min, x_max, y_max = shapely.total_bounds(blocks.polygons)
    x, y = np.linspace(x_min, x_max, 6), np.linspace(y_min, y_max, 5)
    frame = gpd.GeoDataFrame({"people": blocks.night_count}, geometry=blocks.polygons, crs=CRS)
    total = 0.0
    for low_x, high_x in pairwise(x):
        for low_y, high_y in pairwise(y):
            box = low_x, low_y, high_x, high_y
            inside = population_totals(blocks, bounds_m=box, is_cut=True)["night"]["total"]
            cut = gpd.clip(frame, box)
            assert inside == pytest.approx((cut.people * cut.area / frame.area[cut.index]).sum(), rel=1e-9)
            total += inside
    assert total == pytest.approx(blocks.night_count.sum(), rel=1e-12)


def test_maps_of_pixels_that_cells_divide_hold_everybody(tmp_path):
    values = np.arange(1.0, 13.0).reshape(3, 4)
    path = write_people(tmp_path / "p.tif", values, Affine(100, 0, X0, 0, -100, Y0 + 300))
    blocks, _ = read_blocks(ju.Population(blocks=path), CRS)
    tower = Footprints(
        np.array([shapely.box(X0 + 11, Y0 + 11, X0 + 29, Y0 + 29)]),
        *(np.array([value]) for value in (30.0, 0.0, np.uint8(0), False)),
    )
    city = City(CRS, (X0, Y0, X0 + 400, Y0 + 300), buildings=tower, blocks=blocks)
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0,))
    cells = maps.m("density", time_of_day="night") * maps.grid.resolution_m**2 / 1e6
    assert cells.sum(dtype=np.float64) == pytest.approx(values.sum(), rel=1e-6)
    here = Grid(CRS, 10.0, round(Y0 / 10), round(X0 / 10), 30, 40).window_in(maps.grid)
    np.testing.assert_allclose(cells[here][::-1].reshape(3, 10, 4, 10).sum(axis=(1, 3)), values, rtol=1e-6)


def test_districts_and_bounds_are_as_of_census_blocks(degrees, tmp_path):
    everywhere = gpd.GeoDataFrame({"BoroCD": [101]}, geometry=[shapely.box(X0 - 1e4, Y0 - 1e4, X0 + 1e4, Y0)], crs=CRS)
    everywhere.to_file(tmp_path / "d.gpkg")
    box = X0 + 500, Y0 - 900, X0 + 800, Y0 - 500
    blocks, _ = read_blocks(ju.Population(blocks=degrees, districts=tmp_path / "d.gpkg"), CRS, box)
    assert set(blocks.zoning) == {Zoning.COMMERCIAL}
    assert blocks.touches(box).all()
    assert 10 < len(blocks) < 60


def test_what_is_no_count_of_people_is_refused(tmp_path):
    place = Affine(100, 0, X0, 0, -100, Y0)
    path = write_people(tmp_path / "p.tif", np.array([[1.0, -200.0]]), place, nodata=None)
    with pytest.raises(InputError, match="1 pixels of less than 0 people: declare"):
        read_blocks(ju.Population(blocks=path), CRS)
    path = write_people(tmp_path / "q.tif", np.array([[1.0, -200.0]]), place, nodata=-200.0)
    assert read_blocks(ju.Population(blocks=path), CRS)[0].night_count.tolist() == [1.0]
    with pytest.raises(InputError, match="table"):
        read_blocks(ju.Population(blocks=path, table=tmp_path / "t.csv"), CRS)
    with pytest.raises(InputError, match="does not reach the region"):
        read_blocks(ju.Population(blocks=path), CRS, (X0 + 1e5, Y0, X0 + 1.1e5, Y0 + 1e4))
