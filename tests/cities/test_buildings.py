"""Buildings from any file: chosen by its suffix, their columns, all or those near a region, and where they lie."""

import json
import re
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.city import lonlat_extent, read_buildings
from jaxurban.cities.outlines import MARGIN_M, Near
from jaxurban.cities.vector import read_vector
from jaxurban.maps.build import view_sky
from jaxurban.maps.task import MapTask
from jaxurban.world.grid import transformer
from tests.cli_runs import run
from tests.guess_records import by_name
from tests.made_files import (
    LAT,
    LON,
    SQUARE,
    UTM,
    WGS84,
    X,
    Y,
    box,
    node,
    osm,
    way,
    write_features,
    write_raster,
    write_vector,
)


@pytest.fixture
def street(tmp_path):
    """Write a house, and an outline of 40 m whose two parts stand east of each other."""
    shapes = [box(0, 0, 10, 10), box(100, 0, 140, 10), box(100, 0, 120, 10), box(120, 0, 140, 10)]
    kinds = {"building": ["yes", "yes", None, None], "building:part": [None, None, "yes", "yes"]}
    return write_vector(tmp_path / "street.gpkg", shapes, height=[1, 2, 3, 4], **kinds)


def test_bounds_limit_what_is_kept_but_not_which_parts_replace_outlines(street):
    def heights(*sides):
        return read_buildings(
            ju.Buildings(street), UTM, bounds_m=box(*sides).bounds
        ).buildings.height_m.tolist()

    whole = read_buildings(ju.Buildings(street), UTM)
    east = read_buildings(ju.Buildings(street), UTM, bounds_m=(X + 125, Y, X + 200, Y + 5))
    assert whole.buildings.height_m.tolist() == [1, 3, 4]
    assert east.buildings.height_m.tolist() == [4]
    assert heights(50, 0, 60, 5) == []
    assert heights(10, 10, 20, 20) == [1]  # it touches the bounds
    assert east.read_issues == whole.read_issues
    assert whole.area.bounds == pytest.approx((X, Y, X + 140, Y + 10))
    assert east.area.bounds == pytest.approx((X + 120, Y, X + 140, Y + 10))


def test_a_height_raster_gives_roofs(tmp_path):
    source = read_buildings(
        ju.Buildings(write_raster(tmp_path / "roofs.TIF", np.float32([[-0.5, 12.0]]))), UTM
    )
    assert source.buildings is None
    np.testing.assert_array_equal(source.roofs.values, [[0, 12]])
    assert source.read_issues == {"cells_below_ground": 1}
    assert source.area.bounds == pytest.approx((X, Y, X + 20, Y + 10))


def test_a_crs_in_degrees_is_refused(street):
    with pytest.raises(ju.InputError, match="EPSG:4326"):
        read_buildings(ju.Buildings(street), "EPSG:4326")


def test_level_and_default_heights_are_settings(tmp_path):
    path = write_vector(tmp_path / "city.geojson", [SQUARE] * 2, WGS84, levels=["2", None])
    source = read_buildings(ju.Buildings(path, default_height_m=6.0, level_height_m=4.0), UTM)
    assert source.buildings.height_m.tolist() == [8.0, 6.0]
    assert source.buildings.origin_counts() == {"levels": 1, "default": 1}


EXTENT = (-74.012, 40.706, -74.008, 40.709)


@pytest.fixture
def town(tmp_path):
    """Write two buildings in opposite corners of a box."""
    west, south, east, north = EXTENT
    corners = (
        shapely.box(west, south, west + 1e-3, south + 1e-3),
        shapely.box(east - 1e-3, north - 1e-3, east, north),
    )
    return write_features(
        tmp_path / "town.geojson", *((shape, {"height": "30"}) for shape in corners)
    )


def test_bounds_left_out_are_those_of_the_file(town):
    scenario = ju.Scenario.from_dict({"buildings": {"source": town.name}}, folder=town.parent)
    for bounds in (lonlat_extent(town), ju.City.from_files(town).bounds, scenario.region.bounds):
        assert bounds == pytest.approx(EXTENT, abs=1e-9)
    with pytest.raises(ju.InputError, match=r"holds no outline.*give bounds"):
        ju.City.from_files(write_features(town.with_name("empty.geojson")))


def test_bounds_elsewhere_name_the_extent_and_a_swap(town):
    with pytest.raises(
        ju.InputError, match=r"it covers about -74\.012\d, 40\.706\d, -74\.008\d, 40\.709\d"
    ):
        ju.City.from_files(town, bounds=(10.0, 50.0, 10.01, 50.01))
    with pytest.raises(ju.InputError, match="look swapped"):
        ju.City.from_files(town, bounds=(41.881, -87.64, 41.882, -87.62))


@pytest.mark.slow
def test_info_says_what_a_file_or_a_folder_of_maps_holds_and_where(town, capsys):
    code, out, err = run(capsys, "info", town, "--json")
    facts = json.loads(out)
    assert (code, err) == (0, "")
    assert facts["bounds"] == pytest.approx(EXTENT, abs=1e-6)
    assert (facts["buildings"], facts["heights by height"]) == ("2", "2 (100.0%)")
    counts = {"num_buildings": 2, "num_by_height_origin": {"height": 2}}
    assert facts["numbers"] == [counts | {"num_structures_by_kind": {}}]
    maps = ju.build_maps(ju.demo_city(500, 500), resolution_m=50, altitudes_m=[20.0])
    maps.save(town.with_name("maps"))
    (numbers,) = json.loads(run(capsys, "info", town.with_name("maps"), "--json")[1])["numbers"]
    assert (numbers["resolution_m"], numbers["num_rows"], numbers["altitudes_m"]) == (50, 10, [20])
    code, out, _ = run(capsys, "info", town.with_name("maps"))
    assert (code, "10 x 10 cells of 50 m" in out, "gps, lidar, population, risk" in out) == (
        0,
        True,
        True,
    )


def read(path, shapes=None, **columns):
    """Write shapes in degrees with their columns, by default a square a row, and read the buildings of the file."""
    shapes = shapes or [SQUARE] * len(next(iter(columns.values())))
    return read_buildings(ju.Buildings(write_vector(path, shapes, WGS84, **columns)), UTM)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".shp", ".parquet"])
@pytest.mark.parametrize("crs", [WGS84, UTM, "EPSG:2263"])
def test_every_format_in_every_crs_gives_the_same_building(tmp_path, suffix, crs):
    write_vector(tmp_path / f"city{suffix}", [SQUARE], WGS84, crs, tall=[21.5])
    file = ju.Buildings(tmp_path / f"city{suffix}", height_column="tall", unit="m")
    source = read_buildings(file, UTM)
    expected = gpd.GeoSeries([SQUARE], crs=WGS84).to_crs(UTM)[0]
    assert source.buildings.height_m.tolist() == [21.5]
    assert (
        shapely.hausdorff_distance(source.buildings.polygons[0], expected) < 0.01
    )  # GeoJSON rounds to 1e-7 degrees
    assert source.area.bounds == pytest.approx(expected.bounds, abs=0.01)


ONE_MEANING = {
    "levels": ["2", "2", None],
    "building:levels": ["3", None, None],
    "height": [None, None, "-1"],
}
KINDS = {
    "building": ["yes", None, None],
    "building:part": [None, "yes", None],
    "height": ["9", "8", "7"],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "height_m", "issues"),
    [
        ({"HEIGHT": ["40 ft"]}, [12.192], {}),
        ({"height_m": [12.5]}, [12.5], {}),
        ({"measuredHeight": [7.25]}, [7.25], {}),
        ({"building:height": ["12'6\""]}, [3.81], {}),
        ({"building:levels": ["4"]}, [12.0], {}),
        ({"levels": [4]}, [12.0], {}),
        ({"num_floors": [4.0]}, [12.0], {}),
        ({"roof:height": ["4"]}, [18.9], {}),  # the height of the roof alone
        ({"heightroof": [40]}, [12.192], {}),  # New York's, in feet
        (
            {"height": [5.0, 6.0, 7.0], "is_underground": [True, False, None]},
            [6, 7],
            {"underground": 1},
        ),
        (ONE_MEANING, [9, 6, 18.9], {"heights_unusable": 1}),  # they fill each other's gaps
        (KINDS, [8], {"outlines_replaced_by_parts": 1}),  # the last is no building, and stands
    ],
)
def test_common_columns_are_understood(tmp_path, columns, height_m, issues):
    source = read(tmp_path / "city.parquet", **columns)
    assert source.buildings.height_m.tolist() == pytest.approx(height_m)
    assert {name: count for name, count in source.read_issues.items() if count} == issues


def test_names_that_a_shapefile_cuts_are_understood(tmp_path):
    with (
        pytest.warns(UserWarning, match="10 characters"),
        pytest.warns(RuntimeWarning, match="Normalized"),
    ):
        source = read(tmp_path / "city.shp", **{"building:levels": ["4"], "roof:levels": ["1"]})
    assert source.buildings.height_m.tolist() == [15.0]


def test_what_is_no_polygon_is_counted_and_left_out_and_collections_give_their_polygons(tmp_path):
    mixed = shapely.GeometryCollection([SQUARE, shapely.Point(0, 0)])
    source = read(tmp_path / "city.geojson", [SQUARE.centroid, mixed, SQUARE], height=[None, 2, 3])
    assert source.buildings.height_m.tolist() == [2.0, 3.0]
    assert source.read_issues["non_polygons"] == 1
    rings = ([[0, 0], [1, 1], [0, 0]], [[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]])
    broken = [(None, {}), *(({"type": "Polygon", "coordinates": [ring]}, {}) for ring in rings)]
    source = read_buildings(
        ju.Buildings(write_features(tmp_path / "broken.geojson", *broken)), "EPSG:32631"
    )
    assert len(source.buildings) == 1
    assert [source.read_issues[f"polygons_{what}"] for what in ("dropped", "repaired")] == [1, 1]
    assert source.read_issues["unknown_extent"] == 1


def test_the_layer_of_polygons_is_chosen_or_asked_for(tmp_path):
    for layer, shape in (("trees", SQUARE.centroid), ("houses", SQUARE)):
        gpd.GeoDataFrame({"height": [5]}, geometry=[shape], crs=WGS84).to_file(
            tmp_path / "a.gpkg", layer=layer
        )
    assert read_buildings(ju.Buildings(tmp_path / "a.gpkg"), UTM).buildings.height_m.tolist() == [
        5.0
    ]
    for layer in ("parcels", "Buildings"):
        gpd.GeoDataFrame({"height": [7]}, geometry=[SQUARE], crs=WGS84).to_file(
            tmp_path / "a.gpkg", layer=layer
        )
    assert read_buildings(ju.Buildings(tmp_path / "a.gpkg"), UTM).buildings.height_m.tolist() == [
        7.0
    ]


BOX_M = (X, Y, X + 900.0, Y + 900.0)
FORMATS = ["city.geojson", "city.gpkg", "city.shp", "city.parquet", "covered.parquet"]


def houses(num=600):
    """Return houses, some with holes, of several polygons or with parts, on 30 km around the region, and a point."""
    rng = np.random.default_rng(7)
    corner = np.array([X, Y]) + rng.uniform(-15e3, 15e3, (num, 2))
    corner[: num // 2] = np.array([X, Y]) + rng.uniform(-0.5e3, 1.4e3, (num // 2, 2))
    size = rng.uniform(5, 60, (num, 2))
    shapes = shapely.box(*corner.T, *(corner + size).T)
    shapes[::7] = shapely.difference(
        shapes[::7], shapely.buffer(shapely.centroid(shapes[::7]), 1.0)
    )
    shapes[1::9] = shapely.union(
        shapes[1::9], shapely.transform(shapes[1::9], lambda xy_m: xy_m + 70.0)
    )
    levels = [None if k % 3 else str(k % 11) for k in range(num)]
    columns = {
        "building": "yes",
        "building:part": None,
        "height": rng.uniform(3, 90, num).round(2),
        "levels": levels,
    }
    frame = gpd.GeoDataFrame(columns, geometry=shapes, crs=UTM)
    halves = frame[:40].assign(**{"building": None, "building:part": "yes"})
    halves.geometry = shapely.intersection(
        halves.geometry, shapely.box(*corner.T, *(corner + size * [0.95, 1]).T)[:40]
    )
    point = frame[:1].set_geometry(shapely.points([[X, Y]]), crs=UTM)
    return gpd.GeoDataFrame(gpd.pd.concat([frame, halves, point], ignore_index=True), crs=UTM)


def write(frame, path):
    """Write a frame in row groups of 50 where the format has any."""
    if path.suffix == ".shp":  # which holds one kind alone
        frame = frame[frame.geom_type != "Point"]
    if path.suffix != ".parquet":
        frame.rename(columns={"building:part": "building_p"}).to_file(path)
        return path
    order = np.argsort(
        frame.bounds["minx"].to_numpy(), kind="stable"
    )  # so that row groups are places
    frame.iloc[order].to_parquet(
        path, row_group_size=50, write_covering_bbox=path.stem == "covered"
    )
    return path


def facts_of(source):
    """Return what can be compared of buildings that were read."""
    b = source.buildings
    return [
        values.tolist()
        for values in (shapely.to_wkb(b.polygons), b.height_m, b.min_height_m, b.origin, b.is_part)
    ]


@pytest.fixture(scope="module", params=FORMATS)
def path(tmp_path_factory, request):
    return write(houses().to_crs(WGS84), tmp_path_factory.mktemp("town") / request.param)


TURNED = (
    "+proj=omerc +lat_0=40.7 +lonc=-74 +alpha=40 +gamma=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"
)


@pytest.mark.slow
@pytest.mark.parametrize("crs", [UTM, TURNED])
def test_buildings_near_a_region_are_those_of_the_whole_file_in_its_order(path, crs):
    x_m, y_m = transformer(UTM, crs).transform(X + 450, Y + 450)
    bounds_m = (x_m - 700, y_m - 700, x_m + 700, y_m + 700)
    part, whole = (
        read_buildings(ju.Buildings(path), crs, bounds_m=bounds_m),
        read_buildings(ju.Buildings(path), crs),
    )
    is_kept = shapely.intersects(shapely.box(*whole.buildings.boxes_m), shapely.box(*bounds_m))
    assert 40 < is_kept.sum() < 0.5 * len(is_kept)
    assert facts_of(part) == facts_of(replace(whole, buildings=whole.buildings.take(is_kept)))
    assert part.buildings.is_part.any()
    assert part.read_issues["outlines_replaced_by_parts"] > 0


def test_what_lies_elsewhere_is_left_out(path):
    near, whole = read_vector(path, Near(BOX_M, UTM)), read_vector(path)
    assert 0.3 * len(whole.polygons) < len(near.polygons) < 0.7 * len(whole.polygons)
    assert (near.is_part, whole.is_part) == (True, False)
    assert near.issues == whole.issues == {"non_polygons": 0}  # a line that says building stays


@pytest.mark.slow
def test_a_region_without_buildings_is_told_of_by_the_whole_file(path):
    away = (X + 9e5, Y, X + 9e5 + 10, Y + 10)
    part, whole = (
        read_buildings(ju.Buildings(path), UTM, bounds_m=away),
        read_buildings(ju.Buildings(path), UTM),
    )
    assert len(part.buildings) == 0
    assert part.area.equals(whole.area)
    assert part.read_issues == whole.read_issues


@pytest.mark.parametrize("name", ["city.gpkg", "city.parquet"])
def test_an_outline_wider_than_the_margin_comes_with_the_parts_at_its_far_end(tmp_path, name):
    ends_m = MARGIN_M * np.array([[0, 5.0], [0.5, 4.8], [4.8, 5.0]])
    columns = {
        "building": ["yes", None, None],
        "building:part": [None, "yes", "yes"],
        "height": [9.0, 8.0, 7.0],
    }
    write_vector(tmp_path / name, [box(west, 0, east, 10) for west, east in ends_m], **columns)
    part = read_buildings(ju.Buildings(tmp_path / name), UTM, bounds_m=(X, Y, X + 100, Y + 100))
    assert part.read_issues["outlines_replaced_by_parts"] == 1
    assert shapely.area(part.buildings.polygons).tolist() == [5000.0]  # what the parts leave


@pytest.mark.parametrize("near", [Near(BOX_M, UTM), None])
@pytest.mark.parametrize(
    "damage",
    [
        lambda geo: geo | {"primary_column": "foo"},
        lambda geo: geo | {"columns": []},
        lambda geo: geo | {"columns": {"foo": geo["columns"]["geometry"]}, "primary_column": "foo"},
        lambda geo: geo | {"columns": {"geometry": []}},
        lambda geo: (
            geo | {"columns": {"geometry": geo["columns"]["geometry"] | {"encoding": "polygon"}}}
        ),
        lambda geo: [geo],
        lambda geo: None,
    ],
)
def test_damaged_metadata_of_geoparquet_are_one_sentence(tmp_path, damage, near):
    path = write(houses(60), tmp_path / "city.parquet")
    table = pq.read_table(path)
    changed = damage(json.loads(table.schema.metadata[b"geo"]))
    pq.write_table(table.replace_schema_metadata({b"geo": json.dumps(changed)}), path)
    with pytest.raises(
        ju.InputError, match=r"city\.parquet' cannot be read as a vector file .*: give a whole one"
    ):
        read_vector(path, near)


@pytest.mark.parametrize("near", [Near(BOX_M, UTM), None])
def test_heights_that_pandas_wrote_as_an_index_are_read(tmp_path, near):
    frame = houses()
    expected = read_vector(write(frame, tmp_path / "city.parquet"), near).tags["height"]
    indexed = read_vector(write(frame.set_index("height"), tmp_path / "covered.parquet"), near)
    np.testing.assert_array_equal(indexed.tags["height"], expected)


def test_coordinates_beyond_the_globe_are_refused_though_those_near_are_sound(tmp_path):
    shapes = [shapely.box(LON, LAT, LON + 1e-4, LAT + 1e-4), box(0, 0, 1, 1)]
    with pytest.raises(ju.InputError, match=r"city\.parquet.*degrees"):
        read_vector(write_vector(tmp_path / "city.parquet", shapes, WGS84), Near(BOX_M, UTM))


def test_only_a_file_that_may_declare_a_wrong_crs_is_asked_for_it_where_its_region_is_elsewhere(
    tmp_path,
):
    shape = shapely.box(LON, LAT, LON + 1e-4, LAT + 1e-4)
    nodes = [node(number, *at) for number, at in enumerate(shape.exterior.coords[:-1], start=1)]
    town = tmp_path / "town.osm"
    town.write_text(osm(*nodes, way(9, (1, 2, 3, 4, 1), building="yes", height="10")))
    vector = write_vector(tmp_path / "town.geojson", [shape], WGS84, height=[10.0])
    for path, is_asked in ((town, False), (vector, True)):
        with pytest.raises(ju.InputError, match="no building in the region") as refused:
            ju.City.from_files(path, bounds=(10.0, 50.0, 10.01, 50.01))
        assert ("crs" in str(refused.value)) is is_asked


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg"])
def test_a_file_without_a_feature_has_no_building_in_the_region(tmp_path, suffix):
    path = write_vector(tmp_path / f"none{suffix}", [shapely.Point()], WGS84, height=[3.0])
    with pytest.raises(ju.InputError, match=r"no building in the region|holds no"):
        ju.City.from_files(path, bounds=(139.69, 35.68, 139.70, 35.69))


def test_one_box_is_proposed_by_all_and_its_maps_lack_no_buildings(tmp_path, capsys):
    west, south = np.random.default_rng(0).uniform((10.0, 50.0), (10.0098, 50.006), (200, 2)).T
    west[0], south[0], east, north = 10.0, 50.0, west + 2e-4, south + 1e-4
    lone = [(14.0, 50.0, 14.0002, 50.0001), (10.0, 53.0, 10.0002, 53.0001)]
    shapes = shapely.box(*np.concatenate([np.stack([west, south, east, north], axis=-1), lone]).T)
    path = write_vector(tmp_path / "houses.geojson", shapes, WGS84, height=[10] * len(shapes))
    (tmp_path / "a.toml").write_text(
        "[buildings]\nsource = 'houses.geojson'\n[region]\nresolution_m = [5, 20]\n"
    )
    proposed = [10.0, 50.0, 10.01, 50.0061]
    np.testing.assert_array_equal(
        np.ceil([1e4 * east.max(), 1e4 * north.max()]) / 1e4, proposed[2:]
    )
    assert (
        f"bounds = {proposed}; give these"
        in run(capsys, "maps", tmp_path / "a.toml", "-o", tmp_path / "out")[2]
    )
    assert json.loads(run(capsys, "info", path, "--json")[1])["99 % of buildings in"] == str(
        proposed
    )
    for crs in (None, "EPSG:3035"):
        with pytest.warns(ju.GuessWarning, match=re.escape(f"bounds = {proposed}")):
            assert ju.City.from_files(path, crs=crs).facts["99 % of buildings in"] == str(proposed)
    given = [f"region.bounds={proposed}", "region.altitudes_m=[20]"]
    scenario, wider = (
        ju.Scenario.from_toml(tmp_path / "a.toml", changes=[*given, *more])
        for more in ([], ["region.bounds=[9.998, 50.0, 10.01, 50.0061]"])
    )
    for asked, is_told in ((scenario, False), (wider, True)):
        city = ju.City.from_files(path, bounds=asked.region.bounds)
        for resolution_m, other_m in ((5.0, 20.0), (20.0, 5.0)):
            region = ju.Grid.from_bounds(asked.region.bounds, resolution_m, nest_with_m=[other_m])
            said = MapTask(city, region, view_sky(region, ju.Gps()), asked.map_params).all_guesses
            said = by_name(said)
            assert any(name.endswith("of the region without data") for name in said) == is_told


@pytest.fixture
def scattered(tmp_path):
    """Write 300 houses in a square of 1 km, and two a hundred kilometres and more away."""
    corners = np.random.default_rng(0).uniform(0, 990, (300, 2))
    shapes = [
        *(box(x, y, x + 10, y + 10) for x, y in corners),
        box(3e5, 0, 3e5 + 10, 10),
        box(0, 1e5, 10, 1e5 + 10),
    ]
    return write_vector(tmp_path / "houses.gpkg", shapes, height=[10] * len(shapes))


def test_bounds_that_are_left_out_are_proposed_where_most_buildings_stand(
    scattered, tmp_path, capsys
):
    with pytest.warns(
        ju.GuessWarning, match="bounds are left out.*99 % of its buildings.*: bounds = "
    ):
        city = ju.City.from_files(scattered)
    proposed = json.loads(city.facts["99 % of buildings in"])
    inside_m = transformer(WGS84, city.crs).transform_bounds(*proposed)
    around_m = X, Y, X + 1000, Y + 1000
    assert (
        0.9e6
        < shapely.box(*inside_m).intersection(shapely.box(*around_m)).area
        <= shapely.box(*inside_m).area
        < 1.1e6
    )
    near = ju.City.from_files(scattered, bounds=proposed)
    assert near.facts["buildings"] == "300"
    assert near.facts["extent"].startswith(("1 x", "1.0"))
    assert "99 % of buildings in" not in repr(near)
    assert json.loads(run(capsys, "info", scattered, "--json")[1])["99 % of buildings in"] == str(
        proposed
    )
    (tmp_path / "a.toml").write_text(
        "[buildings]\nsource = 'houses.gpkg'\n[region]\nresolution_m = 5\n"
    )
    code, _, err = run(capsys, "maps", tmp_path / "a.toml", "-o", tmp_path / "out")
    assert code == 2
    assert "houses.gpkg' covers 303 x 109 km" in err  # the box in degrees stands askew
    assert "; give these in [region] (all of it is 1,326 million cells of 5 m: bounds = [" in err
    assert not (tmp_path / "out").exists()
    coarse = ["region.resolution_m=500"]
    with pytest.warns(ju.GuessWarning, match="bounds are left out"):
        scenario = ju.Scenario.from_toml(tmp_path / "a.toml", changes=coarse)
    assert scenario.region.bounds == pytest.approx(lonlat_extent(scattered))


def test_a_region_says_its_own_size_and_buildings_and_those_around(street):
    near = transformer(UTM, WGS84).transform_bounds(X - 20, Y - 20, X + 60, Y + 40)
    facts = ju.City.from_files(street, bounds=near).facts
    assert (facts["buildings"], facts["extent"]) == (
        "1, and 2 around",
        "0.0813 x 0.0618 km",
    )  # of a box in degrees
