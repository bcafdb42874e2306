import geopandas as gpd
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxurban.errors import InputError
from jaxurban.io.read.census import clean_polygons, largest_overlap, read_districts, zoning_of
from jaxurban.io.read.vector import open_frame
from jaxurban.world.city import OTHER_DISTRICT, Zoning

CRS = "EPSG:32618"
COMMERCIAL = (101, 102, 103, 104, 105, 106)
X0, Y0 = 585_000.0, 4_510_000.0


def boxes(*corners: tuple[float, float, float, float]) -> np.ndarray:
    x0, y0, x1, y1 = np.array(corners, float).T
    return shapely.box(X0 + x0, Y0 + y0, X0 + x1, Y0 + y1)


def write(path, polygons, crs=CRS, **fields):
    gpd.GeoDataFrame(fields, geometry=polygons, crs=CRS).to_crs(crs).to_file(path)
    return path


box = st.tuples(*[st.integers(0, 20)] * 2, *[st.integers(1, 9)] * 2).map(
    lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3])
)


@settings(deadline=None, max_examples=50)
@given(st.lists(box, min_size=1, max_size=6), st.lists(st.tuples(box, st.integers(101, 104)), min_size=1, max_size=6))
def test_largest_overlap_equals_counting_unit_squares(blocks, districts):
    polygons = shapely.box(*np.array(blocks, float).T)
    areas = shapely.box(*np.array([corners for corners, _ in districts], float).T)
    labels = np.array([label for _, label in districts], np.int32)
    shared = np.zeros((len(blocks), 105), int)
    for i, (x0, y0, x1, y1) in enumerate(blocks):
        for (a0, b0, a1, b1), label in districts:
            shared[i, label] += sum(a0 <= x < a1 and b0 <= y < b1 for x in range(x0, x1) for y in range(y0, y1))
    expected = np.where(shared.any(axis=1), shared.argmax(axis=1), OTHER_DISTRICT)  # argmax: the smallest label wins
    np.testing.assert_array_equal(largest_overlap(polygons, areas, labels), expected)


def test_touching_a_district_is_not_lying_in_it():
    result = largest_overlap(boxes((0, 0, 10, 10)), boxes((10, 0, 20, 10)), np.array([101]))
    assert result.tolist() == [OTHER_DISTRICT]


def test_zoning_follows_the_paper_in_manhattan():
    labels = [*range(101, 113), 164, 208]
    zoning = zoning_of(np.array([101, 106, 107, 112, 164, 208, OTHER_DISTRICT]), COMMERCIAL, labels)
    com, res, other = Zoning.COMMERCIAL, Zoning.RESIDENTIAL, Zoning.OTHER
    assert zoning.tolist() == [com, com, res, res, other, other, other]


def test_a_shorter_commercial_list_leaves_the_rest_of_the_twelve_residential():
    zoning = zoning_of(np.array([101, 106]), (101,), range(101, 113))
    assert zoning.tolist() == [Zoning.COMMERCIAL, Zoning.RESIDENTIAL]


def test_in_another_city_every_other_district_is_residential_unless_listed():
    district = np.array([1, 2, 3, OTHER_DISTRICT])
    com, res, other = Zoning.COMMERCIAL, Zoning.RESIDENTIAL, Zoning.OTHER
    assert zoning_of(district, (1,), (1, 2, 3)).tolist() == [com, res, res, other]


def test_text_labels_are_read_as_numbers_and_reprojected(tmp_path):
    path = write(tmp_path / "d.geojson", boxes((0, 0, 100, 100)), "EPSG:4326", code=["0104"])
    polygons, labels, num_invalid = read_districts(path, CRS, "code")
    assert labels.tolist() == [104]
    assert shapely.area(polygons)[0] == pytest.approx(1e4, rel=1e-4)
    assert num_invalid == 0


def test_an_unknown_field_names_the_nearest(tmp_path):
    path = write(tmp_path / "d.gpkg", boxes((0, 0, 1, 1)), BoroCD=[101])
    with pytest.raises(InputError, match=r"no field 'BoroCode' .did you mean 'BoroCD'"):
        read_districts(path, CRS, "BoroCode")


def test_a_label_that_is_no_whole_number_is_refused(tmp_path):
    path = write(tmp_path / "d.gpkg", boxes((0, 0, 1, 1), (1, 1, 2, 2)), BoroCD=["101", "Harlem"])
    with pytest.raises(InputError, match="Harlem"):
        read_districts(path, CRS)


def test_invalid_polygons_are_repaired_and_points_left_out():
    bow_tie = shapely.Polygon([(X0, Y0), (X0 + 10, Y0 + 10), (X0 + 10, Y0), (X0, Y0 + 10)])
    frame = gpd.GeoDataFrame(geometry=[bow_tie, shapely.Point(X0, Y0), *boxes((0, 0, 5, 5))], crs=CRS)
    cleaned, num_lost, num_invalid = clean_polygons(frame, CRS)
    assert (num_lost, num_invalid) == (1, 1)
    np.testing.assert_allclose(cleaned.area, [50, 25])
    assert cleaned.is_valid.all()


def test_only_what_touches_the_box_is_kept():
    frame = gpd.GeoDataFrame(geometry=boxes((0, 0, 10, 10), (20, 0, 30, 10), (40, 0, 50, 10)), crs=CRS).to_crs(4326)
    cleaned, _, _ = clean_polygons(frame, CRS, (X0 + 5, Y0, X0 + 25, Y0 + 10))
    assert cleaned.index.tolist() == [0, 1]


def test_files_that_cannot_serve_say_why(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        open_frame(tmp_path / "none.shp", "districts")
    (tmp_path / "torn.gpkg").write_bytes(b"SQLite format 3\x00 torn")
    with pytest.raises(InputError, match="cannot be read as a vector file"):
        open_frame(tmp_path / "torn.gpkg", "districts")
    (tmp_path / "empty.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    with pytest.raises(InputError, match="holds no polygons"):
        open_frame(tmp_path / "empty.geojson", "districts")
    metres = gpd.GeoSeries(boxes((0, 0, 1, 1))).to_json()  # UTM coordinates in a file that says degrees
    (tmp_path / "metres.geojson").write_text(metres)
    with pytest.raises(InputError, match="in degrees by its CRS but has coordinates such as 585001, 4510001"):
        open_frame(tmp_path / "metres.geojson", "districts")
    write(tmp_path / "bare.shp", boxes((0, 0, 1, 1)), code=[1])
    (tmp_path / "bare.prj").unlink()
    with pytest.raises(InputError, match="declares no CRS"):
        open_frame(tmp_path / "bare.shp", "districts")
