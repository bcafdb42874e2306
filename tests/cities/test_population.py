"""People and where they are: census blocks with their tables, districts and zoning, rasters of people."""

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxurban as ju
from figures.paper.common import population_totals
from jaxurban.cities.census import (
    clean_polygons,
    largest_overlap,
    read_blocks,
    read_districts,
    zoning_of,
)
from jaxurban.io.city import City
from jaxurban.metrics.population import block_layers
from jaxurban.world.blocks import OTHER_DISTRICT, Zoning
from jaxurban.world.footprints import Footprints
from jaxurban.world.grid import Grid, transformer
from tests.made_files import UTM, WGS84, X, Y, box, north_up, write_raster, write_vector

IDS = ["360610001001000", "360610001001001", "360610001001002"]
COM, RES, OTHER = Zoning.COMMERCIAL, Zoning.RESIDENTIAL, Zoning.OTHER


def blocks_in(path, ids=IDS, **fields):
    """Write one block of 100 m x 100 m an id, in a row, in NAD83 as the Census does."""
    shapes = [box(100 * i, 0, 100 * i + 100, 100) for i in range(len(ids))]
    return write_vector(path, shapes, to="EPSG:4269", GEOID10=ids, **fields)


def read(tmp_path, table=None, blocks="b.gpkg", bounds_m=None, **files):
    """Read blocks with a table given as its text or as a frame."""
    path = tmp_path / blocks if (tmp_path / blocks).exists() else blocks_in(tmp_path / blocks)
    if table is not None:
        text = table if isinstance(table, str) else pd.DataFrame(table).to_csv(index=False)
        (tmp_path / "t.csv").write_text(text)
        files["table"] = tmp_path / "t.csv"
    return read_blocks(ju.Population(blocks=path, **files), UTM, bounds_m)


SF1 = (
    '"GEO_ID","NAME","P001001"\n"id","Geographic Area Name","Total"\n'
    f'"1000000US{IDS[0]}","Block 1000, New York County","123(r45678)"\n'
    f'"1000000US{IDS[2]}","Block 1002, New York County","1,400"\n'
    '"1000000US360470001001000","Block 1000, Kings County","7"\n'
)


@pytest.mark.parametrize("suffix", [".shp", ".gpkg", ".geojson", ".parquet"])
def test_blocks_of_any_format_join_the_table_of_two_header_rows(tmp_path, suffix):
    blocks, issues = read(tmp_path, SF1, f"blocks{suffix}")
    assert blocks.block_id.tolist() == IDS
    assert blocks.night_count.tolist() == [123, 0, 1400]
    np.testing.assert_allclose(blocks.area_m2, 1e4, rtol=1e-4)
    assert (set(blocks.district), set(blocks.zoning)) == ({OTHER_DISTRICT}, {OTHER})
    counted = {"blocks_without_count": 1, "blocks_without_district": 3, "counts_without_block": 1}
    assert {name: number for name, number in issues.items() if number} == counted


@pytest.mark.parametrize(
    ("table", "counts", "num_without"),
    [
        (
            {"people": [1, 2, 3], "name": list("abc"), "block": IDS},
            [1, 2, 3],
            0,
        ),  # whatever columns are called
        ({"id": IDS, "population": ["1", "n/a", "-4"]}, [1, 0, 0], 2),
        ({"id": IDS, "population": ["1", "9" * 400, "2"]}, [1, 0, 2], 1),
        ({"id": [IDS[0]] * 2, "population": [9, 9]}, [9, 0, 0], 2),  # equal rows count once
    ],
)
def test_a_plain_table_joins_and_a_count_that_cannot_be_read_is_nobody(
    tmp_path, table, counts, num_without
):
    blocks, issues = read(tmp_path, table)
    assert blocks.night_count.tolist() == counts
    assert (issues["blocks_without_count"], issues["counts_without_block"]) == (num_without, 0)


@pytest.mark.parametrize("as_numbers", [False, True])
def test_ids_join_also_as_numbers_and_without_their_leading_zero(tmp_path, as_numbers):
    ids = ["060370001001000", "060370001001001"]
    blocks_in(tmp_path / "b.gpkg", [int(each) for each in ids] if as_numbers else ids)
    blocks, _ = read(tmp_path, {"GEOID": [int(each) for each in ids], "POP100": [5, 6]})
    assert blocks.night_count.tolist() == [5, 6]
    assert as_numbers or blocks.block_id.tolist() == ids


def test_counts_can_lie_in_the_blocks_file(tmp_path):
    blocks_in(tmp_path / "b.gpkg", POP10=[4, 5, 6], HOUSING10=[1, 2, 3])
    assert read(tmp_path)[0].night_count.tolist() == [4, 5, 6]


def test_only_blocks_that_touch_the_region_are_kept(tmp_path):
    blocks, issues = read(tmp_path, SF1, "b.shp", box(210, 10, 900, 90).bounds)
    assert blocks.block_id.tolist() == IDS[2:]
    assert issues["counts_without_block"] == 1  # against the whole file, not the region
    with pytest.raises(ju.InputError, match="no block that touches the region"):
        read(tmp_path, SF1, "b.shp", (0, 0, 10, 10))


def test_districts_set_label_and_zoning(tmp_path):
    districts = write_vector(
        tmp_path / "d.gpkg", [box(0, 0, 160, 100), box(160, 0, 200, 100)], BoroCD=[101, 107]
    )
    blocks, issues = read(tmp_path, SF1, districts=districts, commercial=(101,))
    assert blocks.district.tolist() == [101, 101, OTHER_DISTRICT]
    assert blocks.zoning.tolist() == [COM, COM, OTHER]
    assert issues["blocks_without_district"] == 1


@pytest.mark.parametrize(
    ("field", "sentence"),
    [
        ("GEOID20", "no field 'GEOID20' .did you mean 'GEOID10'"),
        ("TRACT", "id '1' more than once in 'TRACT'"),
        ("NAME", "joins no block: no column holds ids such as 'x'"),
    ],
)
def test_a_wrong_block_field_is_refused_with_the_remedy(tmp_path, field, sentence):
    blocks_in(tmp_path / "b.gpkg", TRACT=["1", "1", "2"], NAME=["x", "y", "z"])
    with pytest.raises(ju.InputError, match=sentence):
        read(tmp_path, SF1, block_field=field)


@pytest.mark.slow
@pytest.mark.data
def test_manhattan_has_its_census_by_district(data_dir):
    files = ju.Population(
        blocks=data_dir / "census/tl_2010_36061_tabblock10.shp",
        table=data_dir / "census/DECENNIALSF12010.P1_nyc_blocks.csv",
        districts=data_dir / "districts/nyc_community_districts.geojson",
    )
    blocks, issues = read_blocks(files, UTM)
    assert (len(blocks), issues["blocks_without_count"]) == (3950, 0)
    night = population_totals(blocks)["night"]
    assert night == {
        "commercial": 611_934,
        "residential": 965_451,
        "other": 8_488,
        "total": 1_585_873,
    }
    assert blocks.night_count[blocks.district == 164].sum() == 25
    assert set(blocks.district) >= {*range(101, 113), 164, OTHER_DISTRICT}


sides = st.tuples(*[st.integers(0, 20)] * 2, *[st.integers(1, 9)] * 2)
boxes = sides.map(lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3]))


@settings(max_examples=50)
@given(
    st.lists(boxes, min_size=1, max_size=6),
    st.lists(st.tuples(boxes, st.integers(101, 104)), min_size=1, max_size=6),
)
def test_largest_overlap_equals_counting_unit_squares(blocks, districts):
    polygons = shapely.box(*np.array(blocks, float).T)
    areas = shapely.box(*np.array([corners for corners, _ in districts], float).T)
    labels = np.array([label for _, label in districts], np.int32)
    shared = np.zeros((len(blocks), 105), int)
    for i, (x0, y0, x1, y1) in enumerate(blocks):
        for (a0, b0, a1, b1), label in districts:
            shared[i, label] += sum(
                a0 <= x < a1 and b0 <= y < b1 for x in range(x0, x1) for y in range(y0, y1)
            )
    expected = np.where(
        shared.any(axis=1), shared.argmax(axis=1), OTHER_DISTRICT
    )  # argmax: the smallest label wins
    np.testing.assert_array_equal(largest_overlap(polygons, areas, labels), expected)


SEVEN = [101, 106, 107, 112, 164, 208, OTHER_DISTRICT]  # of Manhattan, as in the paper


@pytest.mark.parametrize(
    ("districts", "commercial", "labels", "expected"),
    [
        (
            SEVEN,
            range(101, 107),
            [*range(101, 113), 164, 208],
            [COM, COM, RES, RES, OTHER, OTHER, OTHER],
        ),
        ([101, 106], (101,), range(101, 113), [COM, RES]),  # the rest of the twelve
        ([1, 2, 3, OTHER_DISTRICT], (1,), (1, 2, 3), [COM, RES, RES, OTHER]),  # another city's
    ],
)
def test_districts_that_are_not_commercial_are_residential_but_for_those_that_nobody_lists(
    districts, commercial, labels, expected
):
    assert zoning_of(np.array(districts), tuple(commercial), labels).tolist() == expected


def test_text_labels_are_read_as_numbers_and_reprojected(tmp_path):
    path = write_vector(tmp_path / "d.geojson", [box(0, 0, 100, 100)], to=WGS84, code=["0104"])
    polygons, labels, num_invalid = read_districts(path, UTM, "code")
    assert (labels.tolist(), num_invalid) == ([104], 0)
    assert shapely.area(polygons) == pytest.approx([1e4], rel=1e-4)


def test_invalid_polygons_are_repaired_and_points_and_what_lies_beyond_the_box_left_out():
    bow_tie = shapely.Polygon([(X, Y), (X + 10, Y + 10), (X + 10, Y), (X, Y + 10)])
    frame = gpd.GeoDataFrame(
        geometry=[bow_tie, shapely.Point(X + 6, Y + 1), box(0, 0, 5, 5), box(20, 0, 30, 9)], crs=UTM
    )
    cleaned, num_lost, num_invalid = clean_polygons(
        frame.to_crs(WGS84), UTM, box(4, 0, 15, 10).bounds
    )
    assert (num_lost, num_invalid) == (1, 1)
    assert cleaned.area.to_dict() == pytest.approx({0: 50, 2: 25}, rel=1e-4)
    assert cleaned.is_valid.all()


@pytest.fixture(scope="module")
def degrees(tmp_path_factory):
    """Counts on pixels of 3 arc seconds, as WorldPop gives them, a few without data."""
    rng = np.random.default_rng(0)
    values = rng.gamma(0.5, 40.0, (30, 40)).astype(np.float32)
    values[rng.random(values.shape) < 0.1] = -99999.0
    lon, lat = transformer(UTM, WGS84).transform(X, Y)
    place = Affine(1 / 1200, 0, lon, 0, -1 / 1200, lat)
    return write_raster(
        tmp_path_factory.mktemp("people") / "people.tif", values, place, WGS84, -99999.0
    )


def test_every_person_of_a_raster_is_in_one_block(degrees):
    blocks, _ = read_blocks(ju.Population(blocks=degrees), UTM)
    with rasterio.open(degrees) as file:
        counts = file.read(1, masked=True)
    assert blocks.night_count.sum() == counts.astype(np.float64).sum()
    assert len(blocks) == counts.count()
    np.testing.assert_allclose(
        shapely.union_all(blocks.polygons).area, blocks.area_m2.sum(), rtol=1e-9
    )  # no overlap


def test_maps_of_pixels_that_cells_divide_hold_everybody(tmp_path):
    values = np.arange(1.0, 13.0).reshape(3, 4)
    blocks, _ = read_blocks(
        ju.Population(blocks=write_raster(tmp_path / "p.tif", values, north_up(100, 3))), UTM
    )
    numbers = (np.array([value]) for value in (30.0, 0.0, np.uint8(0), False))
    tower = Footprints(np.array([box(11, 11, 29, 29)]), *numbers)
    city = City(UTM, box(0, 0, 400, 300).bounds, buildings=tower, blocks=blocks)
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0,))
    cells = maps.m("density", time_of_day="night") * maps.grid.resolution_m**2 / 1e6
    assert cells.sum(dtype=np.float64) == pytest.approx(values.sum(), rel=1e-6)
    here = Grid(UTM, 10.0, round(Y / 10), round(X / 10), 30, 40).window_in(maps.grid)
    np.testing.assert_allclose(
        cells[here][::-1].reshape(3, 10, 4, 10).sum(axis=(1, 3)), values, rtol=1e-6
    )


def test_districts_and_bounds_of_a_raster_of_people_are_as_of_census_blocks(degrees, tmp_path):
    everywhere = write_vector(tmp_path / "d.gpkg", [box(-1e4, -1e4, 1e4, 0)], BoroCD=[101])
    bounds_m = box(500, -900, 800, -500).bounds
    blocks, _ = read_blocks(ju.Population(blocks=degrees, districts=everywhere), UTM, bounds_m)
    assert set(blocks.zoning) == {COM}
    assert blocks.touches(bounds_m).all()
    assert 10 < len(blocks) < 60


def people_in(path, bounds_m):
    """Return the people of a raster in a box by hand: pixel by pixel, its ring in the box's CRS, pro rata by area."""
    with rasterio.open(path) as file:
        counts, place, crs = file.read(1, masked=True), file.transform, file.crs.to_wkt()
    side = [(0, 0), (0.5, 0), (1, 0), (1, 0.5), (1, 1), (0.5, 1), (0, 1), (0, 0.5)]
    row, col = np.indices(counts.shape)
    ring = [transformer(crs, UTM).transform(*place @ (col + i, row + j)) for i, j in side]
    pixel = shapely.polygons(np.transpose(ring, (2, 3, 0, 1)))
    inside_m2 = shapely.area(shapely.intersection(pixel, shapely.box(*bounds_m)))
    return (counts.filled(0) * inside_m2 / shapely.area(pixel)).sum(dtype=float)


def people_raster(path, seed, step_deg, side=16, empty=-1.0, mean=80.0):
    """Write a raster of people in degrees around the place, a few pixels without data."""
    rng = np.random.default_rng(seed)
    values = rng.gamma(1.0, mean, (side, side)).astype(np.float32)
    values[rng.random(values.shape) < 0.05] = empty
    lon, lat = transformer(UTM, WGS84).transform(X, Y)
    west, north = lon - side / 2 * step_deg - seed * 1e-5, lat + side / 2 * step_deg
    return write_raster(path, values, Affine(step_deg, 0, west, 0, -step_deg, north), WGS84, empty)


ARC_S = 1 / 3600


def test_maps_by_day_and_by_night_hold_the_people_that_each_raster_has_in_the_region(tmp_path):
    files = {
        f"blocks_{name}": people_raster(tmp_path / f"{name}.tif", 1, 3 * ARC_S, 16, mean=mean)
        for name, mean in (("day", 200.0), ("night", 20.0))
    }
    blocks, _ = read_blocks(ju.Population(**files), UTM)
    numbers = (np.array([value]) for value in (30.0, 0.0, np.uint8(0), False))
    tower = Footprints(np.array([box(11, 11, 29, 29)]), *numbers)
    city = City(UTM, box(-400, -300, 413, 290).bounds, buildings=tower, blocks=blocks)
    maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(20.0,))
    totals = population_totals(blocks, bounds_m=maps.grid.bounds_m, is_cut=True)
    for name in ("day", "night"):
        inside = people_in(files[f"blocks_{name}"], maps.grid.bounds_m)
        assert totals[name]["total"] == pytest.approx(inside, rel=1e-4)
        cells = maps.m("density", time_of_day=name) * maps.grid.resolution_m**2 / 1e6
        assert cells.sum(dtype=np.float64) == pytest.approx(inside, rel=0.005)


def test_rasters_by_day_and_by_night_on_two_grids_are_refused(tmp_path):
    files = {
        f"blocks_{name}": people_raster(tmp_path / f"{name}.tif", 1, step)
        for name, step in (("day", 3 * ARC_S), ("night", 7 * ARC_S))
    }
    with pytest.raises(ju.InputError, match=r"lie on two grids: put one on .*gdalwarp -r sum"):
        read_blocks(ju.Population(**files), UTM)


def test_pixels_of_two_rasters_of_one_grid_stay_whole_though_data_are_missing_in_either(tmp_path):
    day, night = np.arange(1.0, 13).reshape(3, 4), np.arange(21.0, 33).reshape(3, 4)
    day[0, 0], night[2, 3], day[1, 1], night[1, 1] = -9, -9, -9, -9
    files = {
        f"blocks_{name}": write_raster(
            tmp_path / f"{name}.tif", values, north_up(100, 3), nodata=-9
        )
        for name, values in (("day", day), ("night", night))
    }
    blocks, issues = read_blocks(ju.Population(**files), UTM)
    np.testing.assert_allclose(blocks.area_m2, np.full(11, 1e4))
    by_id = dict(
        zip(blocks.block_id, zip(blocks.day_count, blocks.night_count, strict=True), strict=True)
    )
    assert (by_id["0,0"], by_id["2,3"], by_id["0,1"]) == ((0, 21), (12, 0), (2, 22))
    assert issues["blocks_without_count"] == 2
    part = blocks.take(blocks.block_id == "0,1")
    assert (part.day_count.tolist(), part.night_count.tolist()) == ([2], [22])


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"blocks_night": None}, "go together"),
        ({"blocks": "b.tif"}, "leave out blocks"),
        ({"districts": "d.shp"}, "leave out districts"),
        ({"gamma_commercial": 2.0, "column": "P"}, "leave out gamma_commercial, column"),
        ({"time_of_day": ("day", "weekday-08")}, "leave out time_of_day weekday-08"),
    ],
)
def test_what_would_change_measured_people_is_refused(settings, sentence):
    with pytest.raises(ju.InputError, match=sentence):
        ju.Population(**{"blocks_day": "d.tif", "blocks_night": "n.tif"} | settings)


def test_factors_are_refused_where_the_city_holds_measured_people(tmp_path):
    files = {
        f"blocks_{name}": people_raster(tmp_path / f"{name}.tif", 1, 3 * ARC_S)
        for name in ("day", "night")
    }
    blocks, _ = read_blocks(ju.Population(**files), UTM)
    with pytest.raises(ju.InputError, match=r"leave out gamma_residential\Z"):
        block_layers(blocks, ju.Population(gamma_residential=0.4))
    day, night = block_layers(blocks).density_per_km2
    np.testing.assert_array_equal(day, night)


@pytest.mark.parametrize(
    ("night", "sentence"),
    [
        ({"crs": None}, "no CRS"),
        ({"values": np.full((8, 8), -3.0)}, "less than 0 people.*nodata"),
        ({"values": np.full((8, 8), -9.0)}, "no data in the region"),
        ({"place": north_up(100, 8, x_m=X + 5e5)}, "does not reach the region"),
    ],
)
def test_a_raster_by_night_that_says_nothing_of_the_region_is_refused(tmp_path, night, sentence):
    sound = {"values": np.full((8, 8), 5.0), "place": north_up(100, 8), "crs": UTM}
    for name, how in (("day", sound), ("night", sound | night)):
        write_raster(tmp_path / f"{name}.tif", how["values"], how["place"], how["crs"], -9.0)
    files = ju.Population(blocks_day=tmp_path / "day.tif", blocks_night=tmp_path / "night.tif")
    with pytest.raises(ju.InputError, match=sentence) as caught:
        read_blocks(files, UTM, box(-500, -500, 1000, 1000).bounds, box(100, 100, 300, 300).bounds)
    assert "night.tif" in str(caught.value)


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        (["12,5", "8,25", "101,75"], [12.5, 8.25, 101.75]),
        (["1,234", "12,345,678", "5"], [1234, 12345678, 5]),
        (["1 234", "1 234,5", "0,1234"], [1234, 1234.5, 0.1234]),
        (["12 5", "1,2,3", "+7,5 (r1,234)"], [0, 0, 7.5]),
        (["1.5", "1,2E+2", "12,"], [1.5, 120, 12]),
        (["12.345", "0,500", "0,125"], [12.345, 0.5, 0.125]),
    ],
)
def test_a_comma_parts_thousands_before_three_digits_alone(tmp_path, counts, expected):
    blocks_in(tmp_path / "b.gpkg", POP10=counts)
    np.testing.assert_array_equal(read(tmp_path)[0].night_count, expected)


@pytest.mark.parametrize(
    "counts", [["12,5", "1,234", "5"], ["1,234,567", "8,25", "1"], ["12,345", "0,500", "1"]]
)
def test_a_column_whose_commas_part_both_is_refused(tmp_path, counts):
    blocks_in(tmp_path / "b.gpkg", POP10=counts)
    with pytest.raises(ju.InputError, match="a comma parts either thousands or decimals"):
        read(tmp_path)
