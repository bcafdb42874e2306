"""Geographical zones of ED-269 and ED-318: outlines, heights and times as the standards mean them, in doubt closed."""

import json
from contextlib import nullcontext
from datetime import UTC, datetime

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod

import jaxurban as ju
from jaxurban.errors import IgnoredZoneWarning, InputError
from jaxurban.io.read.airspace import read_zones
from jaxurban.io.read.zone import touched_cells
from jaxurban.world.grid import Grid
from tests.made_maps import made_maps

LON, LAT = 6.13, 49.61  # Luxembourg
SQUARE = [[LON, LAT], [LON + 0.01, LAT], [LON + 0.01, LAT + 0.01], [LON, LAT + 0.01], [LON, LAT]]
GEOD = Geod(ellps="WGS84")
ALWAYS = {"permanent": "YES"}


def polygon(rings=None, **limits):
    shape = {"type": "Polygon", "coordinates": rings or [SQUARE]}
    return {"uomDimensions": "M", "horizontalProjection": shape} | limits


def circle(radius, uom="M", centre=(LON, LAT), **limits):
    return {
        "uomDimensions": uom,
        "horizontalProjection": {"type": "Circle", "center": list(centre), "radius": radius},
    } | limits


def agl(lower, upper):
    return {
        "lowerLimit": lower,
        "upperLimit": upper,
        "lowerVerticalReference": "AGL",
        "upperVerticalReference": "AGL",
    }


def zone(*volumes, name="Findel", restriction="PROHIBITED", applicability=(ALWAYS,), **more):
    return {
        "identifier": "LUX0001",
        "country": "LUX",
        "name": name,
        "type": "COMMON",
        "restriction": restriction,
        "reason": ["AIR_TRAFFIC"],
        "applicability": list(applicability),
        "zoneAuthority": [{"name": "DAC", "purpose": "AUTHORIZATION"}],
        "geometry": list(volumes),
    } | more


def written(file, *zones, wrapper="features"):
    file.write_text(json.dumps({"title": "UAS zones", wrapper: list(zones)}), encoding="utf-8-sig")
    return file


def heights(zone):
    return zone.floor_m, zone.ceiling_m


@pytest.mark.parametrize("wrapper", ["features", "UASZoneList"])
def test_a_zone_is_read_with_its_outline_hole_and_limits(tmp_path, wrapper):
    hole = [[LON + 0.004, LAT + 0.004], [LON + 0.006, LAT + 0.004], [LON + 0.005, LAT + 0.006]]
    file = written(tmp_path / "zones.json", zone(polygon([SQUARE, hole], **agl(10, 120))), wrapper=wrapper)
    (read,) = read_zones(file)
    assert (read.name, read.source, read.crs, heights(read), read.start, read.end) == (
        "Findel",
        "zones.json",
        "EPSG:4326",
        (10.0, 120.0),
        None,
        None,
    )
    assert read.polygon.equals(shapely.Polygon(SQUARE, [hole]))


def test_feet_are_feet_and_a_zone_of_two_volumes_is_two(tmp_path):
    low, high = polygon(**agl(0, 100), uomDimensions="FT"), circle(500, **agl(50, None))
    first, second = read_zones(written(tmp_path / "z.json", zone(low, high)))
    np.testing.assert_allclose(heights(first), (0.0, 30.48))
    assert heights(second) == (50.0, np.inf)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({"lowerVerticalReference": "AMSL"}, (-np.inf, 120.0)),
        ({"upperVerticalReference": "AMSL"}, (10.0, np.inf)),
        ({"lowerVerticalReference": "WGS84", "upperVerticalReference": "AMSL"}, (-np.inf, np.inf)),
        ({"uomDimensions": "FL"}, (-np.inf, np.inf)),
    ],
)
def test_limits_above_another_zero_or_in_another_unit_close_every_altitude_at_that_end_and_are_told(
    tmp_path, limits, expected
):
    file = written(tmp_path / "z.json", zone(polygon(**(agl(10, 120) | limits))))
    with pytest.warns(IgnoredZoneWarning, match="reach on to every altitude") as caught:
        (read,) = read_zones(file)
    assert heights(read) == expected
    assert len(caught) == 1


@settings(max_examples=40)
@given(
    st.floats(-179.9, 179.9), st.floats(-84, 84), st.floats(1, 300_000), st.sampled_from([("M", 1.0), ("FT", 0.3048)])
)
def test_a_circles_polygon_holds_all_of_it_and_little_more(tmp_path_factory, lon, lat, radius, unit):
    uom, metres = unit
    file = written(tmp_path_factory.mktemp("c") / "z.json", zone(circle(radius, uom, (lon, lat))))
    (read,) = read_zones(file)
    turn = np.linspace(0, 360, 721)
    full = np.full(turn.shape, 1.0)

    def ring(away_m):
        lons, lats, _ = GEOD.fwd(lon * full, lat * full, turn, away_m * full)
        return np.column_stack([lon + (lons - lon + 180) % 360 - 180, lats])

    assert shapely.covers(read.polygon, shapely.points(ring(radius * metres))).all()
    assert not shapely.covers(read.polygon, shapely.points(ring(1.003 * radius * metres))).any()


def test_what_needs_an_authorisation_is_closed_and_told_and_what_restricts_nothing_is_left_out_and_told(tmp_path):
    kinds = ("REQ_AUTHORISATION", "CONDITIONAL", "NO_RESTRICTION", "PROHIBITED")
    file = written(tmp_path / "z.json", *(zone(polygon(), name=kind, restriction=kind) for kind in kinds))
    with pytest.warns(IgnoredZoneWarning) as caught:
        read = read_zones(file)
    assert [each.name for each in read] == ["REQ_AUTHORISATION", "CONDITIONAL", "PROHIBITED"]
    said = sorted(str(warning.message) for warning in caught)
    assert said == [
        "zones of 'z.json' that need an authorisation or hold on conditions, and are closed: 2 "
        "('REQ_AUTHORISATION', 'CONDITIONAL')",
        "zones of 'z.json' that restrict nothing, and are left out: 1 ('NO_RESTRICTION')",
    ]


WINTER = {"permanent": "NO", "startDateTime": "2026-01-01T00:00:00Z", "endDateTime": "2026-03-31T23:59:59Z"}
NEXT_WINTER = {"startDateTime": "2027-01-01T00:00:00Z", "endDateTime": "2027-03-31T23:59:59Z"}
OFFICE = {"schedule": [{"day": ["MON", "FRI"], "startTime": "08:00:00.00Z", "endTime": "16:00:00Z"}]}


@pytest.mark.parametrize(
    ("periods", "time", "is_on", "words"),
    [
        ([WINTER], "2025-12-31T22:30:00Z", False, ""),
        ([WINTER], "2025-12-31T23:30:00Z", True, ""),  # within the hour that a flight is given
        ([WINTER], "2026-02-03T12:00:00Z", True, ""),
        ([WINTER], "2026-04-01T00:00:00Z", False, ""),
        ([WINTER, NEXT_WINTER], "2026-07-06T09:00:00Z", True, ""),  # from the first to the last
        ([WINTER, NEXT_WINTER], "2027-04-01T00:00:00Z", False, ""),
        ([WINTER | OFFICE], "2026-01-06T09:00:00Z", True, "days or hours, which are not read"),
        ([WINTER | OFFICE], "2026-04-06T09:00:00Z", False, "days or hours, which are not read"),
        ([OFFICE], "2026-04-07T09:00:00Z", True, "days or hours, which are not read"),
        ([WINTER, ALWAYS], "2026-07-06T09:00:00Z", True, ""),
        ([WINTER | {"endDateTime": "2026-03-31T23:59:59"}], "2026-07-06T09:00:00Z", True, "in force always"),
        ([WINTER | {"endDateTime": "March"}], "2026-07-06T09:00:00Z", True, "in force always"),
    ],
)
def test_a_zone_is_in_force_from_its_first_to_its_last_time(tmp_path, periods, time, is_on, words):
    file = written(tmp_path / "z.json", zone(polygon(), applicability=periods))
    with pytest.warns(IgnoredZoneWarning, match=words) if words else nullcontext():
        (read,) = read_zones(file)
    assert read.is_in_force(datetime.fromisoformat(time)) == is_on
    for last in ("0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z"):  # nothing overflows
        assert read.is_in_force(datetime.fromisoformat(last)) == (read.start is read.end is None)


def ed318(geometry, **facts):
    return {
        "type": "Feature",
        "geometry": geometry,
        "properties": {
            "identifier": "CHE1",
            "country": "CHE",
            "type": "PROHIBITED",
            "variant": "COMMON",
            "name": [{"lang": "de-CH", "text": "Flugplatz"}, {"lang": "en-GB", "text": "airfield"}],
        }
        | facts,
    }


def test_ed318_is_read_with_layers_circles_names_and_times(tmp_path):
    layer = {"upper": 400, "upperReference": "AGL", "lower": 0, "lowerReference": "AGL", "uom": "ft"}
    area = {"type": "Polygon", "coordinates": [SQUARE], "layer": layer}
    point = {"type": "Point", "coordinates": [LON, LAT], "extent": {"subType": "Circle", "radius": 300}, "layer": layer}
    both = {"type": "GeometryCollection", "geometries": [area, point]}
    when = [{"startDateTime": "2026-01-01T00:00:00Z"}]
    features = [ed318(area), ed318(both, limitedApplicability=when)]
    file = tmp_path / "zones.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    first, second, third = read_zones(file)
    assert first.polygon.equals(shapely.Polygon(SQUARE))
    assert second.polygon.equals(first.polygon)
    np.testing.assert_allclose(heights(third), (0.0, 121.92))
    _, _, across_m = GEOD.inv(third.polygon.bounds[0], LAT, third.polygon.bounds[2], LAT)
    assert 600 < across_m < 602
    assert {each.name for each in (first, second, third)} == {"Flugplatz"}
    assert (first.start, second.start, second.end) == (None, datetime(2026, 1, 1, tzinfo=UTC), None)


def test_a_plain_geojson_of_polygons_is_read_as_before(tmp_path):
    feature = {
        "type": "Feature",
        "geometry": {"type": "Polygon", "coordinates": [SQUARE]},
        "properties": {"ceiling_m": 50},
    }
    (tmp_path / "z.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    (read,) = read_zones(tmp_path / "z.geojson")
    assert heights(read) == (-np.inf, 50.0)


BOW_TIE = [[LON, LAT], [LON + 0.01, LAT + 0.01], [LON + 0.01, LAT], [LON, LAT + 0.01], [LON, LAT]]


def test_an_outline_that_crosses_itself_closes_all_that_it_encloses_and_is_told(tmp_path):
    with pytest.warns(IgnoredZoneWarning, match="cross themselves"):
        (read,) = read_zones(written(tmp_path / "z.json", zone(polygon([BOW_TIE]))))
    assert read.polygon.is_valid
    assert read.polygon.area == pytest.approx(0.01**2 / 2)


@pytest.mark.parametrize(
    ("volume", "words"),
    [
        (polygon([[[LON, LAT], [LON, LAT + 1]]]), "cannot be read"),
        (polygon([[[LAT, "north"], [LON, LAT], [0, 0]]]), "cannot be read"),
        (polygon([[[200, 10], [201, 10], [201, 11]]]), "no longitude and latitude"),
        (circle(0), "a circle of 0 m around"),
        (circle(1e9), "at most 300000 m"),
        (circle(100, centre=(0, 89.9)), "not at a pole"),
        (circle(10**400), "cannot be read"),
        (polygon(horizontalProjection=None), "a part is missing, or is of another kind"),
        (circle(100, uom="NM"), "a part is missing, or is of another kind"),
        (circle(100, centre=()), "cannot be read"),
        (polygon(**agl("low", 100)), "lower limit of the no-fly zone 'Findel' of 'z.json' must be a finite number"),
        (polygon(**agl(100, 50)), "floor 100 m and ceiling 50 m"),
        (polygon([[[LON, LAT], [LON + 1, LAT], [LON + 2, LAT], [LON, LAT]]]), "has no area"),
    ],
)
def test_a_zone_that_cannot_be_read_is_refused_in_one_sentence(tmp_path, volume, words):
    with pytest.raises(InputError, match=words) as caught:
        read_zones(written(tmp_path / "z.json", zone(volume)))
    assert "\n" not in str(caught.value)


def test_a_file_of_zones_that_restrict_nothing_is_refused(tmp_path):
    file = written(tmp_path / "z.json", zone(polygon(), restriction="NO_RESTRICTION"))
    with pytest.raises(InputError, match="holds no polygons that restrict flights"), pytest.warns(IgnoredZoneWarning):
        read_zones(file)


def test_a_zone_closes_at_no_named_time_and_opens_where_the_named_one_is_outside_its_own(tmp_path):
    maps = made_maps()
    grid = maps.grid
    corners_m = grid.xy_of_cell(np.array([40, 40, 60]), np.array([30, 50, 40]))
    ring = np.column_stack(grid.lonlat_of_xy(*corners_m)).tolist()
    when = {"permanent": "NO", "startDateTime": "2026-01-01T00:00:00Z"}
    file = written(tmp_path / "z.json", zone(polygon([[*ring, ring[0]]], **agl(0, 120)), applicability=[when]))
    constraints = ju.Constraints.read(no_fly=file, vertical_clearance_m=0.0)
    closed = ju.cost_map(maps, 20.0, constraints=constraints)
    assert closed.constraints.zones == constraints.zones
    assert constraints.closed(maps, 20.0).sum() > 100
    assert not closed.is_free[45, 38]
    with pytest.warns(IgnoredZoneWarning, match=r"zones not in force at 2020-.* which close nothing: 1 \('Findel'"):
        opened = ju.cost_map(maps, 20.0, constraints=constraints, time="2020-04-27T16:00:00Z")
    assert opened.constraints.zones == ()
    np.testing.assert_array_equal(opened.is_free, maps.is_free(20.0))


@pytest.mark.parametrize("west", [179.985, -179.995])
def test_a_circle_and_a_polygon_across_the_antimeridian_are_closed_on_both_sides(tmp_path, west):
    ring = [[179.9, -16.9], [-179.9, -16.9], [-179.9, -16.7], [179.9, -16.7], [179.9, -16.9]]
    grid = Grid.from_bounds((west, -16.805, west + 0.01, -16.795), 20.0)
    for volume, said in (
        (circle(4000, centre=(179.999, -16.8)), nullcontext()),
        (polygon([ring]), pytest.warns(IgnoredZoneWarning, match="all around the Earth")),
    ):
        with said:
            (read,) = read_zones(written(tmp_path / "z.json", zone(volume)))
        assert touched_cells(read.on(grid), grid).all()
