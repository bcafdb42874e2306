"""No-fly zones: read from files as they are written, put on cells that they touch, and on no others."""

import json
from contextlib import nullcontext

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.features import rasterize
from shapely import affinity

from jaxurban.errors import IgnoredZoneWarning, InputError
from jaxurban.io.read.airspace import read_zones
from jaxurban.io.read.zone import Zone, cell_boxes, mended, touched_cells
from jaxurban.world.grid import Grid, transformer, utm_crs

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_600, 70, 90)
LON, LAT = GRID.centre_lonlat
SQUARE = shapely.box(LON - 0.0005, LAT - 0.0005, LON + 0.0005, LAT + 0.0005)
INFINITE = (-np.inf, np.inf)


def by_brute_force(polygon: shapely.Geometry, grid: Grid) -> np.ndarray:
    """Every cell asked by itself."""
    cells = np.indices(grid.shape).reshape(2, -1).T
    return shapely.intersects(polygon, cell_boxes(grid, cells, 1)).reshape(grid.shape)


def write_geojson(file, *features, **more):
    listed = [
        {"type": "Feature", "properties": properties, "geometry": None if shape is None else shape.__geo_interface__}
        for shape, properties in features
    ]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": listed} | more))
    return file


def write_kml(file, *placemarks):
    file.write_text(
        '<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
        + "".join(placemarks)
        + "</Document></kml>"
    )
    return file


def placemark(name, height_m=0, tags="", data="", east=0.0, hole=""):
    corners = " ".join(f"{lon + east},{lat},{height_m}" for lon, lat in SQUARE.exterior.coords)
    ring = "<{0}BoundaryIs><LinearRing><coordinates>{1}</coordinates></LinearRing></{0}BoundaryIs>"
    extra = "".join(f'<Data name="{key}"><value>{value}</value></Data>' for key, value in dict(data).items())
    return (
        f"<Placemark><name>{name}</name><ExtendedData>{extra}</ExtendedData><Polygon>{tags}"
        f"{ring.format('outer', corners)}{ring.format('inner', hole) if hole else ''}</Polygon></Placemark>"
    )


def heights(zone: Zone) -> tuple[float, float]:
    return zone.floor_m, zone.ceiling_m


@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.floats(-60, 510), st.floats(-60, 410)), min_size=3, max_size=8, unique=True),
    st.floats(0.05, 1),
)
def test_exactly_the_cells_that_share_a_point_with_the_polygon_are_closed(corners, hole):
    hull = shapely.MultiPoint(corners).convex_hull.buffer(0.01)
    ring = affinity.scale(hull, hole * 0.9, hole * 0.9)
    polygon = affinity.translate(hull.difference(ring), GRID.x_min_m, GRID.y_min_m)
    assert np.array_equal(touched_cells(polygon, GRID), by_brute_force(polygon, GRID))


def test_a_polygon_on_cell_borders_closes_the_cells_around_it_too():
    closed = touched_cells(cell_boxes(GRID, np.array([[20, 30]]), 10)[0], GRID)
    rows, cols = np.nonzero(closed)
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (19, 30, 29, 40)
    assert closed.sum() == 12 * 12


def test_holes_stay_open_and_a_polygon_beyond_the_grid_is_cut():
    ring = shapely.box(-100, -100, 200, 200).difference(shapely.box(41, 41, 119, 119))
    closed = touched_cells(affinity.translate(ring, GRID.x_min_m, GRID.y_min_m), GRID)
    assert not closed[9:23, 9:23].any()
    assert closed.sum() == 41 * 41 - 14 * 14


def test_gdal_burns_the_same_cells_where_no_corner_lies_on_a_cell_border():
    rng = np.random.default_rng(0)
    for _ in range(40):
        turn = np.sort(rng.uniform(0, 2 * np.pi, 12))
        star = shapely.Polygon(np.column_stack([np.cos(turn), np.sin(turn)]) * rng.uniform(10, 170, (12, 1)))
        moved = affinity.translate(star, GRID.x_min_m + 210.3, GRID.y_min_m + 180.7)
        cells = shapely.transform(moved, lambda xy_m: xy_m / 5.0 - [GRID.first_col, GRID.first_row])
        burnt = rasterize([cells], GRID.shape, transform=Affine.identity(), all_touched=True) == 1
        assert np.array_equal(touched_cells(mended(moved), GRID), burnt)


def test_a_long_edge_bends_as_its_own_crs_draws_it():
    # The 42nd parallel over 6 degrees is 1.4 km away from the straight line between its projected ends.
    zone = Zone("south", shapely.box(-78, 40, -72, 42))
    grid = Grid.from_bounds((-75.02, 41.99, -74.98, 42.01), 100.0, crs="EPSG:32618")
    closed = touched_cells(zone.on(grid), grid)
    _, lat = grid.lonlat_of_cell(*np.indices(grid.shape))
    half_cell_deg = 75 / 111_000
    assert closed[lat < 42 - half_cell_deg].all()
    assert not closed[lat > 42 + half_cell_deg].any()


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32618", "EPSG:2263"])
@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".shp", ".parquet"])
def test_every_format_in_every_crs_closes_the_same_cells(tmp_path, suffix, crs):
    file = tmp_path / f"zones{suffix}"
    frame = gpd.GeoDataFrame({"name": ["A"], "floor_m": [10.0]}, geometry=[SQUARE], crs="EPSG:4326").to_crs(crs)
    frame.to_parquet(file) if suffix == ".parquet" else frame.to_file(file)
    (zone,) = read_zones(file)
    assert (zone.name, *heights(zone)) == ("A", 10.0, np.inf)
    expected = gpd.GeoSeries([SQUARE], crs="EPSG:4326").to_crs(GRID.crs)[0]
    part = zone.on(GRID)
    assert part.hausdorff_distance(expected) < 0.02  # GeoJSON rounds to 1e-7 degrees
    assert touched_cells(expected.buffer(-0.05), GRID)[touched_cells(part, GRID)].mean() > 0.95


@pytest.mark.parametrize(
    ("properties", "expected"),
    [
        ({}, INFINITE),
        ({"floor_m": 30, "ceiling_m": 80.5}, (30.0, 80.5)),
        ({"Floor_M": "30"}, (30.0, np.inf)),
        ({"minimumAltitude": 0, "maximumAltitude": 120}, (0.0, 120.0)),
        ({"max_altitude_m": 120, "ceiling_m": 150}, (-np.inf, 150.0)),
        ({"ceiling_m": None}, INFINITE),
        ({"ceiling_m": ""}, INFINITE),
        ({"ceiling_m": 120, "uomDimensions": "M", "upperVerticalReference": "AGL", "community": "Ely"}, (-np.inf, 120)),
    ],
)
def test_floors_and_ceilings_are_read_in_metres_above_ground(tmp_path, properties, expected):
    (zone,) = read_zones(write_geojson(tmp_path / "a.geojson", (SQUARE, properties)))
    assert heights(zone) == expected


@pytest.mark.parametrize(
    ("properties", "words"),
    [
        ({"ceiling": 400}, "'ceiling' of 'a.geojson' not read"),
        ({"LOWER_VAL": 400}, "'LOWER_VAL'"),
        ({"minimumAltitude": 400, "unit": "ft"}, "heights in 'ft'"),
        ({"ceiling_m": 120, "lowerVerticalReference": "AMSL"}, "heights in 'AMSL'"),
    ],
)
def test_heights_that_could_mean_something_else_close_every_altitude_and_say_so(tmp_path, properties, words):
    file = write_geojson(tmp_path / "a.geojson", (SQUARE, {"name": "A"} | properties))
    with pytest.warns(IgnoredZoneWarning, match=words):
        (zone,) = read_zones(file)
    assert heights(zone) == INFINITE


def test_kml_is_read_with_all_its_folders_holes_and_data(tmp_path):
    hole = " ".join(f"{LON + x},{LAT + y},0" for x, y in [(0, 0), (0.0002, 0), (0, 0.0002), (0, 0)])
    inner = (
        f"<Folder><name>in</name>{placemark('second', data={'floor_m': 30, 'ceiling_m': '80'}, east=0.002)}</Folder>"
    )
    file = write_kml(tmp_path / "a.kml", placemark("first", hole=hole), f"<Folder><name>out</name>{inner}</Folder>")
    first, second = read_zones(file)
    assert (first.name, *heights(first)) == ("first", *INFINITE)
    assert len(first.polygon.interiors) == 1
    assert (second.name, *heights(second)) == ("second", 30.0, 80.0)


def test_heights_of_the_corners_of_kml_are_not_read_and_close_every_altitude(tmp_path):
    tags = "<extrude>1</extrude><altitudeMode>relativeToGround</altitudeMode>"
    file = write_kml(tmp_path / "a.kml", placemark("A", 120, tags))
    with pytest.warns(IgnoredZoneWarning, match="'altitudeMode' of 'a.kml' not read.*is closed at all altitudes"):
        (zone,) = read_zones(file)
    assert heights(zone) == INFINITE


def test_an_outline_that_crosses_itself_closes_all_that_it_encloses(tmp_path):
    turn = np.linspace(0, 4 * np.pi, 6)
    star = shapely.Polygon(np.column_stack([LON + 0.001 * np.sin(turn), LAT + 0.001 * np.cos(turn)]))
    file = write_geojson(tmp_path / "a.geojson", (star, {"name": "star"}))
    with pytest.warns(IgnoredZoneWarning, match="'a.geojson' that have outlines that cross themselves.*'star'"):
        (zone,) = read_zones(file)
    assert zone.polygon.is_valid
    assert zone.polygon.contains(shapely.Point(LON, LAT))  # gone around twice


def test_what_is_no_polygon_closes_nothing_and_is_told(tmp_path):
    mixed = shapely.GeometryCollection([SQUARE, shapely.Point(LON, LAT)])
    file = write_geojson(
        tmp_path / "a.geojson", (SQUARE, {}), (shapely.Point(LON, LAT), {}), (None, {}), (mixed, {"name": "mixed"})
    )
    with pytest.warns(IgnoredZoneWarning, match=r"3 feature\(s\) of 'a.geojson' are not polygons"):
        zones = read_zones(file)
    assert [zone.name for zone in zones] == ["polygon 1", "mixed"]
    assert zones[1].polygon.equals(SQUARE)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "does not exist"),
        ("nonsense", "cannot be read as a vector file"),
        ([], "holds no polygons"),
        ([(shapely.Point(LON, LAT), {})], "holds no polygons"),
        ([(SQUARE, {"floor_m": 80, "ceiling_m": 30})], "floor 80 m and ceiling 30 m"),
        (
            [(SQUARE, {"floor_m": "ground"})],
            "floor_m of the no-fly zone 'polygon 1' of 'a.geojson' must be a finite number .* got 'ground'",
        ),
        ([(shapely.Polygon([(0, 0), (1, 1), (2, 2)]), {})], "has no area"),
        ([(shapely.box(583_000, 4_505_000, 583_100, 4_505_100), {})], "is in degrees by its CRS"),
    ],
)
@pytest.mark.filterwarnings("ignore::jaxurban.errors.IgnoredZoneWarning")
def test_a_file_that_cannot_be_is_refused_in_one_sentence(tmp_path, content, words):
    file = tmp_path / "a.geojson"
    if isinstance(content, str):
        file.write_text(content)
    elif content is not None:
        write_geojson(file, *content)
    with pytest.raises(InputError, match=words) as caught:
        read_zones(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("num_corners", "words"), [(3, "'polygon 2' of 'a.geojson' has no area"), (2, "cannot be read")]
)
def test_a_ring_of_too_few_corners_is_refused_and_not_passed_over(tmp_path, num_corners, words):
    file = tmp_path / "a.geojson"
    ring = [[LON, LAT], *[[LON + 0.001, LAT]] * (num_corners - 2), [LON, LAT]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {}, "geometry": shape}
    whole = {"type": "Feature", "properties": {}, "geometry": SQUARE.__geo_interface__}
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [whole, feature]}))
    with pytest.raises(InputError, match=words):
        read_zones(file)


@pytest.mark.filterwarnings("ignore:.crs. was not provided")
def test_a_file_without_a_crs_is_refused(tmp_path):
    gpd.GeoDataFrame({"a": [1]}, geometry=[SQUARE]).to_file(tmp_path / "a.shp")
    with pytest.raises(InputError, match="declares no CRS"):
        read_zones(tmp_path / "a.shp")


WEST_OF_IT, ACROSS, EAST_OF_IT, ELSEWHERE = 179.985, 179.995, -179.995, 20.0  # of the antimeridian
BEYOND = shapely.box(179.98, -16.9, 180.02, -16.7)
JUMPING = shapely.Polygon([(179.98, -16.9), (-179.98, -16.9), (-179.98, -16.7), (179.98, -16.7)])


def closed_share(zone: Zone, west: float) -> float:
    crs = utm_crs(west, -16.8)
    x_m, y_m = transformer("EPSG:4326", crs).transform(west, -16.805)
    grid = Grid(crs, 20.0, int(y_m // 20), int(x_m // 20), 55, 53)
    return float(touched_cells(zone.on(grid), grid).mean())


@pytest.mark.parametrize(
    ("shape", "west", "share"),
    [
        *((BEYOND, west, 1.0) for west in (WEST_OF_IT, ACROSS, EAST_OF_IT)),
        (BEYOND, ELSEWHERE, 0.0),
        *((JUMPING, west, 1.0) for west in (WEST_OF_IT, ACROSS, EAST_OF_IT, ELSEWHERE)),  # either way round
        (shapely.box(-180, -90, 180, 90), ACROSS, 1.0),
    ],
)
def test_a_zone_across_the_antimeridian_is_closed_on_both_sides_of_it(tmp_path, shape, west, share):
    file = write_geojson(tmp_path / "z.geojson", (shape, {}))
    with pytest.warns(IgnoredZoneWarning, match="all around the Earth") if shape is JUMPING else nullcontext():
        (zone,) = read_zones(file)
    assert closed_share(zone, west) == share


def test_an_outline_with_one_meaning_stays_as_it_is(tmp_path):
    for shape in (SQUARE, BEYOND, shapely.box(-180, -90, 180, 90)):
        (zone,) = read_zones(write_geojson(tmp_path / "z.geojson", (shape, {})))
        assert zone.polygon.equals(shape)


def test_a_file_that_a_library_refuses_at_length_is_refused_briefly(tmp_path):
    file = tmp_path / "long.geojson"
    file.write_text('{"type": "FeatureCollection", "features": [], "number": ' + "9" * 6000 + "}")
    with pytest.raises(InputError) as refused:
        read_zones(file)
    assert len(str(refused.value)) < 700
