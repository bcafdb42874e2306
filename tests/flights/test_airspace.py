"""No-fly zones: GeoJSON, KML, ED-269 and ED-318 as they are written, in doubt closed, and the cells that they touch."""

import json
from contextlib import nullcontext
from datetime import UTC, datetime

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyproj import Geod
from shapely import affinity

import jaxurban as ju
from jaxurban.errors import IgnoredZoneWarning
from jaxurban.flights.airspace import read_zones
from jaxurban.io.zone import Zone, cell_boxes, touched_cells
from jaxurban.world.grid import Grid, transformer, utm_crs
from tests.made_files import UTM, WGS84, refused, write_features, write_vector
from tests.made_maps import made_maps

GRID = Grid(UTM, 5.0, 901_000, 116_600, 70, 90)
LON, LAT = GRID.centre_lonlat
SQUARE = shapely.box(LON - 0.0005, LAT - 0.0005, LON + 0.0005, LAT + 0.0005)
RING = [list(corner) for corner in SQUARE.exterior.coords]
KNOT = (-0.25, 1.7), (0.6, -0.8), (-1, 0.3), (1, 0.3), (-0.6, -0.8), (0.25, 1.7), (-0.25, 1.7)
STAR = [
    [LON + 0.001 * x, LAT + 0.001 * y] for x, y in KNOT
]  # whose top is gone around the other way
INFINITE = (-np.inf, np.inf)
GEOD = Geod(ellps="WGS84")
ALWAYS = {"permanent": "YES"}


def polygon(*rings, **limits):
    return {
        "uomDimensions": "M",
        "horizontalProjection": {"type": "Polygon", "coordinates": rings or [RING]},
    } | limits


def circle(radius, uom="M", centre=(LON, LAT), **limits):
    shape = {"type": "Circle", "center": list(centre), "radius": radius}
    return {"uomDimensions": uom, "horizontalProjection": shape} | limits


def agl(lower, upper):
    return {
        "lowerLimit": lower,
        "upperLimit": upper,
        "lowerVerticalReference": "AGL",
        "upperVerticalReference": "AGL",
    }


def zone(*volumes, name="Findel", restriction="PROHIBITED", applicability=(ALWAYS,)):
    """Return a zone of ED-269."""
    about = {
        "identifier": "LUX0001",
        "country": "LUX",
        "name": name,
        "type": "COMMON",
        "reason": ["AIR_TRAFFIC"],
    }
    authority = {"zoneAuthority": [{"name": "DAC", "purpose": "AUTHORIZATION"}]}
    when = {"restriction": restriction, "applicability": list(applicability)}
    return about | authority | when | {"geometry": list(volumes)}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "a.geojson"


def ed269(file, *zones, wrapper="features"):
    file.write_text(json.dumps({"title": "UAS zones", wrapper: list(zones)}), encoding="utf-8-sig")
    return file


def heights(zone: Zone) -> tuple[float, float]:
    return zone.floor_m, zone.ceiling_m


border = st.integers(-12, 102).map(lambda number: 5.0 * number)
places = st.tuples(st.floats(-60, 510) | border, st.floats(-60, 410) | border)


@pytest.mark.slow
@settings(max_examples=60)
@given(st.lists(places, min_size=3, max_size=8, unique=True), st.floats(0.05, 0.9))
def test_exactly_the_cells_that_share_a_point_with_the_polygon_are_closed(corners, hole):
    hull = shapely.MultiPoint(corners).convex_hull
    assume(hull.area > 1e-3)
    placed = affinity.translate(
        hull.difference(affinity.scale(hull, hole, hole)), GRID.x_min_m, GRID.y_min_m
    )
    cells = np.indices(GRID.shape).reshape(2, -1).T
    each = shapely.intersects(placed, cell_boxes(GRID, cells, 1)).reshape(GRID.shape)
    np.testing.assert_array_equal(touched_cells(placed, GRID), each)


@pytest.mark.slow
def test_a_long_edge_bends_as_its_own_crs_draws_it():
    # The 42nd parallel over 6 degrees is 1.4 km away from the straight line between its projected ends.
    grid = Grid.from_bounds((-75.02, 41.99, -74.98, 42.01), 100.0, crs=UTM)
    part = Zone("south", shapely.box(-78, 40, -72, 42)).on(grid)
    assert (
        part.area < 1e7
    )  # of the 1e11 m2: what is far off is neither cut into pieces nor projected
    closed = touched_cells(part, grid)
    _, lat = grid.lonlat_of_cell(*np.indices(grid.shape))
    half_cell_deg = 75 / 111_000
    assert closed[lat < 42 - half_cell_deg].all()
    assert not closed[lat > 42 + half_cell_deg].any()


@pytest.mark.parametrize("crs", [WGS84, UTM, "EPSG:2263"])
@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".shp", ".parquet"])
def test_every_format_in_every_crs_closes_the_same_cells(tmp_path, suffix, crs):
    file = write_vector(
        tmp_path / f"zones{suffix}", [SQUARE], WGS84, crs, name=["A"], floor_m=[10.0]
    )
    (read,) = read_zones(file)
    assert (read.name, *heights(read)) == ("A", 10.0, np.inf)
    expected = shapely.Polygon(
        np.column_stack(transformer(WGS84, GRID.crs).transform(*np.transpose(RING)))
    )
    assert read.on(GRID).hausdorff_distance(expected) < 0.02  # GeoJSON rounds to 1e-7 degrees
    assert (
        touched_cells(expected.buffer(-0.05), GRID)[touched_cells(read.on(GRID), GRID)].mean()
        > 0.95
    )


@pytest.mark.parametrize(
    ("properties", "expected", "words"),
    [
        ({}, INFINITE, ""),
        ({"floor_m": 30, "ceiling_m": 80.5}, (30.0, 80.5), ""),
        ({"Floor_M": "30"}, (30.0, np.inf), ""),
        ({"minimumAltitude": 0, "maximumAltitude": 120}, (0.0, 120.0), ""),
        ({"max_altitude_m": 120, "ceiling_m": 150}, (-np.inf, 150.0), ""),
        ({"ceiling_m": None}, INFINITE, ""),
        ({"ceiling_m": ""}, INFINITE, ""),
        (
            {
                "ceiling_m": 9,
                "uomDimensions": "M",
                "upperVerticalReference": "AGL",
                "community": "Ely",
            },
            (-np.inf, 9),
            "",
        ),
        ({"ceiling": 400}, INFINITE, "'ceiling' of 'a.geojson' not read"),
        ({"LOWER_VAL": 400}, INFINITE, "'LOWER_VAL'"),
        ({"minimumAltitude": 400, "unit": "ft"}, INFINITE, "limits in a unit or above a zero"),
        ({"minimumAltitude": 100, "floor_reference": "AMSL"}, INFINITE, "not read"),
        ({"minimumAltitude": 100, "altitudeType": 2}, INFINITE, "not read"),
        ({"floor_m": 100, "floor_ft": 0}, INFINITE, "not read"),
        ({"floor_m": 100, "Bezug": "NHN"}, INFINITE, "or above a zero"),
        ({"floor_m": 100, "dimension": "ft"}, INFINITE, "limits in a unit"),
        ({"floor_m": 100, "msl": True}, INFINITE, "or above a zero"),
        (
            {"ceiling_m": 120, "lowerVerticalReference": "AMSL"},
            INFINITE,
            "give metres above ground",
        ),
    ],
)
def test_heights_are_metres_above_ground_and_else_close_every_altitude_and_say_so(
    file, properties, expected, words
):
    write_features(file, (SQUARE, {"name": "A"} | properties))
    with pytest.warns(IgnoredZoneWarning, match=words) if words else nullcontext():
        (read,) = read_zones(file)
    assert heights(read) == expected


def placemark(name, *rings, data="", tags=""):
    drawn = ""
    for kind, ring in zip(("outer", "inner"), rings, strict=False):
        corners = " ".join(f"{lon},{lat},120" for lon, lat in ring)
        drawn += f"<{kind}BoundaryIs><LinearRing><coordinates>{corners}</coordinates></LinearRing></{kind}BoundaryIs>"
    about = f"<name>{name}</name><ExtendedData>{data}</ExtendedData>"
    return f"<Placemark>{about}<Polygon>{tags}{drawn}</Polygon></Placemark>"


def test_kml_is_read_with_all_its_folders_holes_and_data_but_for_the_heights_of_its_corners(
    tmp_path,
):
    hole = [(LON, LAT), (LON + 0.0002, LAT), (LON, LAT + 0.0002), (LON, LAT)]
    data = '<Data name="floor_m"><value>30</value></Data><Data name="ceiling_m"><value>80</value></Data>'
    inner = f"<Folder><name>in</name>{placemark('second', RING, data=data)}</Folder>"
    third = placemark(
        "third", RING, tags="<extrude>1</extrude><altitudeMode>relativeToGround</altitudeMode>"
    )
    document = f"{placemark('first', RING, hole)}<Folder><name>out</name>{inner}</Folder>{third}"
    head = '<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
    (tmp_path / "a.kml").write_text(f"{head}{document}</Document></kml>")
    with pytest.warns(
        IgnoredZoneWarning, match=r"'altitudeMode' of 'a.kml' not read.*is closed at all altitudes"
    ):
        read = {each.name: each for each in read_zones(tmp_path / "a.kml")}
    assert [heights(read[name]) for name in ("first", "second", "third")] == [
        INFINITE,
        (30.0, 80.0),
        INFINITE,
    ]
    assert len(read["first"].polygon.interiors) == 1


def test_what_is_no_polygon_is_unknown_and_told(file):
    point = shapely.Point(LON, LAT)
    mixed = shapely.GeometryCollection([SQUARE, point])
    write_features(file, (SQUARE, {}), (point, {}), (None, {}), (mixed, {"name": "mixed"}))
    words = r"'a.geojson' that are points, lines.*: 3 \('feature 2', 'feature 3', 'mixed'\)"
    with pytest.warns(IgnoredZoneWarning, match=words):
        zones = read_zones(file)
    assert [zone.name for zone in zones if zone.state == "closed"] == ["feature 1", "mixed"]
    assert zones[3].polygon.equals(SQUARE)


@pytest.mark.parametrize("name", ["z.geojson", "z.txt", "z.kml", "z", "z.ed269"])
def test_geographical_zones_and_geojson_are_known_by_their_content(tmp_path, name):
    ed269(tmp_path / name, zone(polygon(**agl(0, 120))))
    assert [each.ceiling_m for each in read_zones(tmp_path / name)] == [120]
    write_features(tmp_path / name, (SQUARE, {"ceiling_m": 50}))
    assert [each.ceiling_m for each in read_zones(tmp_path / name)] == [50]


@pytest.mark.parametrize("is_ed269", [False, True])
def test_an_outline_that_crosses_itself_closes_all_that_it_encloses(file, is_ed269):
    if is_ed269:
        ed269(file, zone(polygon(STAR), name="star"))
    else:
        write_features(file, (shapely.Polygon(STAR), {"name": "star"}))
    with pytest.warns(
        IgnoredZoneWarning, match=r"'a.geojson' that have outlines that cross themselves.*'star'"
    ):
        (read,) = read_zones(file)
    assert read.polygon.is_valid
    assert shapely.contains_xy(
        read.polygon, LON, [LAT, LAT + 0.0015]
    ).all()  # gone around twice, and backwards


LINE = [(0, 0), (1, 1), (2, 2), (0, 0)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "holds no polygons"),
        (
            b'{"type": "FeatureCollection", "features": [], "number": ' + b"9" * 6000 + b"}",
            "cannot be read",
        ),
        ([(shapely.Point(LON, LAT), {})], "holds no polygons"),
        ([(SQUARE, {"floor_m": 80, "ceiling_m": 30})], "floor 80 m and ceiling 30 m"),
        (
            [(SQUARE, {"floor_m": "ground"})],
            "'feature 1' of 'a.geojson' must be a finite number .* got 'ground'",
        ),
        ([(SQUARE, {}), (shapely.Polygon(LINE), {})], "'feature 2' of 'a.geojson' has no area"),
        ([(SQUARE, {}), ({"type": "Polygon", "coordinates": [LINE[::3]]}, {})], "cannot be read"),
        (polygon([[LON, LAT], [LON, LAT + 1]]), "cannot be read"),
        (polygon([[LAT, "north"], [LON, LAT], [0, 0]]), "cannot be read"),
        (polygon([[200, 10], [201, 10], [201, 11]]), "no longitude and latitude"),
        (polygon(LINE), "has no area"),
        (polygon(horizontalProjection=None), "a part is missing, or is of another kind"),
        (
            polygon(**agl("low", 100)),
            "lower limit of the no-fly zone 'Findel' of 'a.geojson' must be a finite number",
        ),
        (polygon(**agl(100, 50)), "floor 100 m and ceiling 50 m"),
        (circle(0), "a circle of 0 m around"),
        (circle(1e9), "at most 300000 m"),
        (circle(10**400), "cannot be read"),
        (circle(100, centre=(0, 89.9)), "not at a pole"),
        (circle(100, centre=()), "cannot be read"),
        (circle(100, uom="NM"), "a part is missing, or is of another kind"),
        (zone(polygon(), restriction="NO_RESTRICTION"), "holds no polygons that restrict flights"),
    ],
)
@pytest.mark.filterwarnings("ignore::jaxurban.errors.IgnoredZoneWarning")
def test_a_file_that_cannot_be_is_refused_in_one_sentence(file, content, words):
    if isinstance(content, list):
        write_features(file, *content)
    elif isinstance(content, dict):
        ed269(file, content if "geometry" in content else zone(content))
    said = refused(read_zones, file, content if isinstance(content, bytes) else None, words)
    assert len(said) < 700  # also where a library says more


WEST_OF_IT, ACROSS, EAST_OF_IT, ELSEWHERE = 179.985, 179.995, -179.995, 20.0  # of the antimeridian
BEYOND = shapely.box(179.98, -16.9, 180.02, -16.7)
JUMPING = shapely.Polygon([(179.98, -16.9), (-179.98, -16.9), (-179.98, -16.7), (179.98, -16.7)])
EVERYWHERE = shapely.box(-180, -90, 180, 90)
FEATURES = {"plain": BEYOND, "jumping": JUMPING, "everywhere": EVERYWHERE}
VOLUMES = {
    "ED-269": polygon([list(corner) for corner in JUMPING.exterior.coords]),
    "circle": circle(4000, centre=(179.999, -16.8)),
}


@pytest.mark.parametrize(
    ("name", "west", "share"),
    [
        *((name, west, 1.0) for name in FEATURES for west in (WEST_OF_IT, ACROSS, EAST_OF_IT)),
        *((name, west, 1.0) for name in VOLUMES for west in (WEST_OF_IT, EAST_OF_IT)),
        ("plain", ELSEWHERE, 0.0),
        ("jumping", ELSEWHERE, 1.0),  # either way round
    ],
)
def test_a_zone_across_the_antimeridian_is_closed_on_both_sides_of_it(file, name, west, share):
    write_features(file, (FEATURES[name], {})) if name in FEATURES else ed269(
        file, zone(VOLUMES[name])
    )
    is_both = name in ("jumping", "ED-269")
    with (
        pytest.warns(IgnoredZoneWarning, match="all around the Earth") if is_both else nullcontext()
    ):
        (read,) = read_zones(file)
    crs = utm_crs(west, -16.8)
    x_m, y_m = transformer(WGS84, crs).transform(west, -16.805)
    grid = Grid(crs, 20.0, int(y_m // 20), int(x_m // 20), 55, 53)
    assert touched_cells(read.on(grid), grid).mean() == share


@pytest.mark.parametrize("wrapper", ["features", "UASZoneList"])
def test_a_zone_of_ed269_is_read_with_its_outline_hole_and_limits_and_one_of_two_volumes_is_two(
    file, wrapper
):
    hole = [[LON, LAT], [LON + 0.0002, LAT], [LON, LAT + 0.0002]]
    volumes = polygon(RING, hole, **agl(10, 120)), circle(500, uomDimensions="FT", **agl(100, None))
    first, second = read_zones(ed269(file, zone(*volumes), wrapper=wrapper))
    assert (first.name, first.source, first.crs, first.start, first.end) == (
        "Findel",
        "a.geojson",
        WGS84,
        None,
        None,
    )
    assert first.polygon.equals(shapely.Polygon(RING, [hole]))
    assert (heights(first), heights(second)) == ((10.0, 120.0), (pytest.approx(30.48), np.inf))


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"lowerVerticalReference": "AMSL"}, (-np.inf, 120.0)),
        ({"upperVerticalReference": "AMSL"}, (10.0, np.inf)),
        ({"lowerVerticalReference": "WGS84", "upperVerticalReference": "AMSL"}, INFINITE),
        ({"uomDimensions": "FL"}, INFINITE),
    ],
)
def test_limits_above_another_zero_or_in_another_unit_reach_on_at_that_end_and_are_told(
    file, limits, expected
):
    ed269(file, zone(polygon(**(agl(10, 120) | limits))))
    with pytest.warns(IgnoredZoneWarning, match="reach on to every altitude") as caught:
        (read,) = read_zones(file)
    assert (heights(read), len(caught)) == (expected, 1)


UNITS = st.sampled_from([("M", 1.0), ("FT", 0.3048)])


@settings(max_examples=40)
@given(st.floats(-179.9, 179.9), st.floats(-84, 84), st.floats(1, 300_000), UNITS)
def test_a_circles_polygon_holds_all_of_it_and_little_more(
    tmp_path_factory, lon, lat, radius, unit
):
    uom, metres = unit
    (read,) = read_zones(
        ed269(tmp_path_factory.mktemp("c") / "z.json", zone(circle(radius, uom, (lon, lat))))
    )
    turn, full = np.linspace(0, 360, 721), np.ones(721)

    def held(away_m):
        lons, lats, _ = GEOD.fwd(lon * full, lat * full, turn, away_m * full)
        return shapely.covers(
            read.polygon, shapely.points(lon + (lons - lon + 180) % 360 - 180, lats)
        )

    assert held(radius * metres).all()
    assert not held(1.003 * radius * metres).any()


def test_what_needs_an_authorisation_is_closed_and_told_and_what_restricts_nothing_is_left_out_and_told(
    file,
):
    kinds = ("REQ_AUTHORISATION", "CONDITIONAL", "NO_RESTRICTION", "PROHIBITED")
    ed269(file, *(zone(polygon(), name=kind, restriction=kind) for kind in kinds))
    with pytest.warns(IgnoredZoneWarning) as caught:
        read = read_zones(file)
    assert [each.name for each in read if each.state == "open"] == ["NO_RESTRICTION"]
    assert [each.state for each in read].count("closed") == 3
    assert sorted(str(warning.message) for warning in caught) == [
        "zones of 'a.geojson' that need an authorisation or hold on conditions, and are closed: 2 "
        "('REQ_AUTHORISATION', 'CONDITIONAL')",
        "zones of 'a.geojson' that restrict nothing, and are left out: 1 ('NO_RESTRICTION')",
    ]


WINTER = {
    "permanent": "NO",
    "startDateTime": "2026-01-01T00:00:00Z",
    "endDateTime": "2026-03-31T23:59:59Z",
}
NEXT_WINTER = {"startDateTime": "2027-01-01T00:00:00Z", "endDateTime": "2027-03-31T23:59:59Z"}
OFFICE = {
    "schedule": [{"day": ["MON", "FRI"], "startTime": "08:00:00.00Z", "endTime": "16:00:00Z"}]
}
HOURS = "days or hours, which are not read"


@pytest.mark.parametrize(
    ("periods", "time", "is_on", "words"),
    [
        ([WINTER], "2025-12-31T22:30", False, ""),
        ([WINTER], "2025-12-31T23:30", True, ""),  # within the hour that a flight is given
        ([WINTER], "2026-02-03T12:00", True, ""),
        ([WINTER], "2026-04-01T00:00", False, ""),
        ([WINTER, NEXT_WINTER], "2026-07-06T09:00", True, ""),  # from the first to the last
        ([WINTER, NEXT_WINTER], "2027-04-01T00:00", False, ""),
        ([WINTER | OFFICE], "2026-01-06T09:00", True, HOURS),
        ([WINTER | OFFICE], "2026-04-06T09:00", False, HOURS),
        ([OFFICE], "2026-04-07T09:00", True, HOURS),
        ([WINTER, ALWAYS], "2026-07-06T09:00", True, ""),
        (
            [WINTER | {"endDateTime": "2026-03-31T23:59:59"}],
            "2026-07-06T09:00",
            True,
            "in force always",
        ),
        ([WINTER | {"endDateTime": "March"}], "2026-07-06T09:00", True, "in force always"),
    ],
)
def test_a_zone_is_in_force_from_its_first_to_its_last_time(file, periods, time, is_on, words):
    ed269(file, zone(polygon(), applicability=periods))
    with pytest.warns(IgnoredZoneWarning, match=words) if words else nullcontext():
        (read,) = read_zones(file)
    assert read.is_in_force(datetime.fromisoformat(f"{time}Z")) == is_on
    for last in ("0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z"):  # nothing overflows
        assert read.is_in_force(datetime.fromisoformat(last)) == (read.start is read.end is None)


def test_ed318_is_read_with_layers_circles_names_and_times(file):
    layer = {
        "upper": 400,
        "upperReference": "AGL",
        "lower": 0,
        "lowerReference": "AGL",
        "uom": "ft",
    }
    area = {"type": "Polygon", "coordinates": [RING], "layer": layer}
    point = {
        "type": "Point",
        "coordinates": [LON, LAT],
        "extent": {"subType": "Circle", "radius": 300},
        "layer": layer,
    }
    names = [{"lang": "de-CH", "text": "Flugplatz"}, {"lang": "en-GB", "text": "airfield"}]
    about = {
        "identifier": "CHE1",
        "country": "CHE",
        "type": "PROHIBITED",
        "variant": "COMMON",
        "name": names,
    }
    when = {"limitedApplicability": [{"startDateTime": "2026-01-01T00:00:00Z"}]}
    write_features(
        file,
        (area, about),
        ({"type": "GeometryCollection", "geometries": [area, point]}, about | when),
    )
    first, second, third = read_zones(file)
    assert shapely.equals([first.polygon, second.polygon], SQUARE).all()
    np.testing.assert_allclose(heights(third), (0.0, 121.92))
    _, _, across_m = GEOD.inv(third.polygon.bounds[0], LAT, third.polygon.bounds[2], LAT)
    assert 600 < across_m < 602
    assert {each.name for each in (first, second, third)} == {"Flugplatz"}
    assert (first.start, second.start, second.end) == (None, datetime(2026, 1, 1, tzinfo=UTC), None)


def test_a_zone_closes_at_no_named_time_and_opens_where_the_named_one_is_outside_its_own(file):
    maps = made_maps()
    corners_m = maps.grid.xy_of_cell(np.array([40, 40, 60, 40]), np.array([30, 50, 40, 30]))
    ring = np.column_stack(maps.grid.lonlat_of_xy(*corners_m)).tolist()
    when = {"permanent": "NO", "startDateTime": "2026-01-01T00:00:00Z"}
    ed269(file, zone(polygon(ring, **agl(0, 120)), applicability=[when]))
    constraints = ju.Constraints.read(no_fly=file, vertical_clearance_m=0.0)
    closed = ju.cost_map(maps, 20.0, constraints=constraints)
    assert closed.constraints.zones == constraints.zones
    assert constraints.closed(maps, 20.0).sum() > 100
    assert not closed.is_free[45, 38]
    with pytest.warns(
        IgnoredZoneWarning, match=r"zones not in force at 2020-.* which close nothing: 1 \('Findel'"
    ):
        opened = ju.cost_map(maps, 20.0, constraints=constraints, time="2020-04-27T16:00:00Z")
    assert [zone.state for zone in opened.constraints.zones] == ["open"]
    np.testing.assert_array_equal(opened.is_free, maps.is_free(20.0))
