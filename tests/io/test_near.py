"""Reading only what lies near a region: the same buildings as of the whole file, and nothing decoded of the rest."""

import json
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely

from jaxurban.errors import InputError
from jaxurban.io.read.city import read_buildings
from jaxurban.io.read.outlines import MARGIN_M, Near
from jaxurban.io.read.vector import read_vector
from jaxurban.settings import Buildings
from jaxurban.world.city import City
from jaxurban.world.grid import transformer
from tests.io.made_files import LAT, LON, UTM, WGS84, X, Y, box, write_vector

BOX_M = (X, Y, X + 900.0, Y + 900.0)
FORMATS = ["city.geojson", "city.gpkg", "city.shp", "city.parquet", "covered.parquet"]


def town(num=600):
    """Return houses, some with holes, of several polygons or with parts, on 30 km around the region, and a point."""
    rng = np.random.default_rng(7)
    corner = np.array([X, Y]) + rng.uniform(-15e3, 15e3, (num, 2))
    corner[: num // 2] = np.array([X, Y]) + rng.uniform(-0.5e3, 1.4e3, (num // 2, 2))
    size = rng.uniform(5, 60, (num, 2))
    shapes = shapely.box(*corner.T, *(corner + size).T)
    shapes[::7] = shapely.difference(shapes[::7], shapely.buffer(shapely.centroid(shapes[::7]), 1.0))
    shapes[1::9] = shapely.union(shapes[1::9], shapely.transform(shapes[1::9], lambda xy_m: xy_m + 70.0))
    levels = [None if k % 3 else str(k % 11) for k in range(num)]
    columns = {"building": "yes", "building:part": None, "height": rng.uniform(3, 90, num).round(2), "levels": levels}
    frame = gpd.GeoDataFrame(columns, geometry=shapes, crs=UTM)
    halves = frame[:40].assign(**{"building": None, "building:part": "yes"})
    halves.geometry = shapely.intersection(halves.geometry, shapely.box(*corner.T, *(corner + size * [0.95, 1]).T)[:40])
    point = frame[:1].set_geometry(shapely.points([[X, Y]]), crs=UTM)
    return gpd.GeoDataFrame(gpd.pd.concat([frame, halves, point], ignore_index=True), crs=UTM)


def write(frame, path):
    """Write a frame in row groups of 50 where the format has any."""
    if path.suffix == ".shp":  # which holds one kind alone
        frame = frame[frame.geom_type != "Point"]
    if path.suffix != ".parquet":
        frame.rename(columns={"building:part": "building_p"}).to_file(path)
        return path
    order = np.argsort(frame.bounds["minx"].to_numpy(), kind="stable")  # so that row groups are places
    frame.iloc[order].to_parquet(path, row_group_size=50, write_covering_bbox=path.stem == "covered")
    return path


def facts_of(source):
    """Return what can be compared of buildings that were read."""
    b = source.buildings
    return [values.tolist() for values in (shapely.to_wkb(b.polygons), b.height_m, b.min_height_m, b.origin, b.is_part)]


@pytest.fixture(scope="module", params=FORMATS)
def path(tmp_path_factory, request):
    return write(town().to_crs(WGS84), tmp_path_factory.mktemp("town") / request.param)


TURNED = "+proj=omerc +lat_0=40.7 +lonc=-74 +alpha=40 +gamma=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"


@pytest.mark.parametrize("crs", [UTM, TURNED])
def test_buildings_near_a_region_are_those_of_the_whole_file_in_its_order(path, crs):
    x_m, y_m = transformer(UTM, crs).transform(X + 450, Y + 450)
    bounds_m = (x_m - 700, y_m - 700, x_m + 700, y_m + 700)
    part, whole = read_buildings(Buildings(path), crs, bounds_m=bounds_m), read_buildings(Buildings(path), crs)
    is_kept = shapely.intersects(shapely.box(*whole.buildings.boxes_m), shapely.box(*bounds_m))
    assert 40 < is_kept.sum() < 0.5 * len(is_kept)
    assert facts_of(part) == facts_of(replace(whole, buildings=whole.buildings.take(is_kept)))
    assert part.buildings.is_part.any()
    assert part.read_issues["outlines_replaced_by_parts"] > 0


def test_what_lies_elsewhere_is_left_out(path):
    near, whole = read_vector(path, Near(BOX_M, UTM)), read_vector(path)
    assert 0.3 * len(whole.polygons) < len(near.polygons) < 0.7 * len(whole.polygons)
    assert (near.is_part, whole.is_part) == (True, False)
    assert near.issues == whole.issues == {"non_polygons": int(path.suffix != ".shp")}


def test_a_region_without_buildings_is_told_of_by_the_whole_file(path):
    away = (X + 9e5, Y, X + 9e5 + 10, Y + 10)
    part, whole = read_buildings(Buildings(path), UTM, bounds_m=away), read_buildings(Buildings(path), UTM)
    assert len(part.buildings) == 0
    assert part.area.equals(whole.area)
    assert part.read_issues == whole.read_issues


@pytest.mark.parametrize("name", ["city.gpkg", "city.parquet"])
def test_an_outline_wider_than_the_margin_comes_with_the_parts_at_its_far_end(tmp_path, name):
    ends_m = MARGIN_M * np.array([[0, 5.0], [0.5, 4.8], [4.8, 5.0]])
    columns = {"building": ["yes", None, None], "building:part": [None, "yes", "yes"], "height": [9.0, 8.0, 7.0]}
    write_vector(tmp_path / name, [box(west, 0, east, 10) for west, east in ends_m], **columns)
    part = read_buildings(Buildings(tmp_path / name), UTM, bounds_m=(X, Y, X + 100, Y + 100))
    assert part.read_issues["outlines_replaced_by_parts"] == 1
    assert len(part.buildings) == 0


@pytest.mark.parametrize("near", [Near(BOX_M, UTM), None])
@pytest.mark.parametrize(
    "damage",
    [
        lambda geo: geo | {"primary_column": "foo"},
        lambda geo: geo | {"columns": []},
        lambda geo: geo | {"columns": {"foo": geo["columns"]["geometry"]}, "primary_column": "foo"},
        lambda geo: geo | {"columns": {"geometry": []}},
        lambda geo: geo | {"columns": {"geometry": geo["columns"]["geometry"] | {"encoding": "polygon"}}},
        lambda geo: [geo],
        lambda geo: None,
    ],
)
def test_damaged_metadata_of_geoparquet_are_one_sentence(tmp_path, damage, near):
    path = write(town(60), tmp_path / "city.parquet")
    table = pq.read_table(path)
    changed = damage(json.loads(table.schema.metadata[b"geo"]))
    pq.write_table(table.replace_schema_metadata({b"geo": json.dumps(changed)}), path)
    with pytest.raises(InputError, match=r"city\.parquet' cannot be read as a vector file .*: give a whole one"):
        read_vector(path, near)


@pytest.mark.parametrize("near", [Near(BOX_M, UTM), None])
def test_heights_that_pandas_wrote_as_an_index_are_read(tmp_path, near):
    frame = town()
    expected = read_vector(write(frame, tmp_path / "city.parquet"), near).tags["height"]
    indexed = read_vector(write(frame.set_index("height"), tmp_path / "covered.parquet"), near)
    np.testing.assert_array_equal(indexed.tags["height"], expected)


def test_coordinates_beyond_the_globe_are_refused_though_those_near_are_sound(tmp_path):
    shapes = [shapely.box(LON, LAT, LON + 1e-4, LAT + 1e-4), box(0, 0, 1, 1)]
    with pytest.raises(InputError, match=r"city\.parquet.*degrees"):
        read_vector(write_vector(tmp_path / "city.parquet", shapes, WGS84), Near(BOX_M, UTM))


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg"])
def test_a_file_without_a_feature_has_no_building_in_the_region(tmp_path, suffix):
    path = write_vector(tmp_path / f"none{suffix}", [shapely.Point()], WGS84, height=[3.0])
    with pytest.raises(InputError, match=r"no building in the region|holds no"):
        City.from_files(path, bounds=(139.69, 35.68, 139.70, 35.69))
