"""Every position and item of a mission's file is in a leg or in a reason, and nothing has two meanings."""

import json
import time
from itertools import product

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.flights.missions.mission import read_mission
from tests.made_maps import made_maps

LAT = 50.0
NAN = float("nan")
LINE = "0,50,40 0.01,50,40"
FLAT = [[0, 50], [0.01, 50]]
GOOD = {"type": "LineString", "coordinates": [[0, 50, 40], [0.01, 50, 40]]}
TRACK = "<gx:coord>0 50 40</gx:coord><gx:coord>0.01 50 40</gx:coord>"
CLIMB = "the climb from home is not judged, as the file names no home"


@pytest.fixture
def read(tmp_path):
    """Return a reader of a text, of bytes or of what JSON holds, under a name."""

    def reading(content, name, **options):
        if isinstance(content, dict):
            content = json.dumps(content)
        file = tmp_path / name
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_mission(file, **options)

    return reading


def kml(*more):
    """Return KML of a line that is read, and more; ``gx`` is a namespace."""
    line = placemark(f"<LineString>{MODE}<coordinates>{LINE}</coordinates></LineString>")
    return f'<kml xmlns:gx="g"><Document>{line}{"".join(more)}</Document></kml>'


def placemark(geometry):
    return f"<Placemark>{geometry}</Placemark>"


MODE = "<altitudeMode>absolute</altitudeMode>"
RING = f"<LinearRing>{MODE}<coordinates>{LINE} 0,51,40</coordinates></LinearRing>"
OTHERS = {
    "ring": (RING, "LinearRing (3 positions)"),
    "polygon": (
        f"<Polygon><outerBoundaryIs>{RING}</outerBoundaryIs></Polygon>",
        "Polygon (3 positions)",
    ),
    "point": (
        "<MultiGeometry><Point><coordinates>0,50,3</coordinates></Point></MultiGeometry>",
        "Point (1 positions)",
    ),
    "model": ("<Model><Location/></Model>", "Model (0 positions)"),
    "tour": ("<gx:Tour/>", "Tour (0 positions)"),
    "offset": (
        f"<LineString>{MODE}<gx:altitudeOffset>-30</gx:altitudeOffset><coordinates>{LINE}</coordinates></LineString>",
        "has a part altitudeOffset",
    ),
    "offset of a track": (
        f"<gx:Track>{MODE}<gx:altitudeOffset>-30</gx:altitudeOffset>{TRACK}</gx:Track>",
        "has a part altitudeOffset",
    ),
    "mode of tracks": (
        f"<gx:MultiTrack>{MODE}<gx:Track>{TRACK}</gx:Track></gx:MultiTrack>",
        "MultiTrack (2 positions) is not judged, as it has a part altitudeMode",
    ),
    "unknown": (
        f"<gx:Curve><coordinates>{LINE}</coordinates></gx:Curve>",
        "coordinates (2 positions)",
    ),
    "twice": (
        f"<LineString>{MODE}<coordinates>{LINE}</coordinates><coordinates>{LINE}</coordinates></LineString>",
        "other positions (2 positions)",
    ),
    "alone": (
        f"<LineString>{MODE}<coordinates>0,50,40</coordinates></LineString>",
        "LineString (1 positions)",
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_what_kml_holds_beside_its_lines_is_counted_and_named(read, name):
    shape, words = OTHERS[name]
    mission = read(kml(placemark(shape)), "m.kml")
    assert any(words in sentence for sentence in mission.not_judged)
    assert (mission.num_lost, mission.accounts[-1].num) == (0, 2)
    assert mission.num_things == sum(each.num for each in mission.accounts)


def test_a_line_is_all_that_a_file_of_one_line_holds(read):
    mission = read(kml(), "m.kml")
    assert mission.not_judged == (CLIMB,)
    assert [each[1:] for each in mission.accounts] == [(2, (0,), "")]
    assert mission.num_things == 2


GPX = '<gpx creator="{}" xmlns:x="x"><rte><rtept lat="50" lon="0">{}</rtept>'
GPX += '<rtept lat="50" lon="0.01">{}</rtept></rte>{}</gpx>'
ELE = "<ele>40</ele>"


@pytest.mark.parametrize(
    ("inside", "more", "words"),
    [
        ("", '<wpt lat="50" lon="1"/><wpt lat="50" lon="1"/>', "wpt (2 positions)"),
        ('<extensions><x:rpt lat="50" lon="1"/></extensions>', "", "other positions (1 positions)"),
        ("", '<x:way><x:node lat="50" lon="1"/></x:way>', "node (1 positions)"),
        ("", '<trk><trkseg><trkpt lat="50" lon="1"/></trkseg></trk>', "trkseg (1 positions)"),
    ],
)
def test_what_gpx_holds_beside_its_lines_is_counted_and_named(read, inside, more, words):
    mission = read(GPX.format("a watch", ELE + inside, ELE, more), "m.gpx", heights="geoid")
    assert len(mission.legs) == 1
    assert words in mission.not_judged[1]
    assert mission.num_lost == 0


POINT = {"type": "Point", "coordinates": [0, 50]}


@pytest.mark.parametrize(
    ("geometry", "words", "num_legs"),
    [
        (POINT, "Point (1 positions)", 1),
        ({"type": "Polygon", "coordinates": [[*FLAT, [0, 51]]]}, "Polygon (3 positions)", 1),
        ({"type": "GeometryCollection", "geometries": [GOOD, POINT]}, "Point (1 positions)", 2),
        ({"type": "CompoundCurve", "geometries": [GOOD, POINT]}, "Point (1 positions)", 2),
        ({"type": "Arc", "coordinates": FLAT}, "Arc (2 positions)", 1),
        (GOOD | {"old": POINT}, "other positions (1 positions)", 2),
        (None, "a feature without geometry (0 positions)", 1),
    ],
)
def test_what_geojson_holds_beside_its_lines_is_counted_and_named(read, geometry, words, num_legs):
    features = [{"type": "Feature", "geometry": each} for each in (GOOD, geometry)]
    whole = {"type": "FeatureCollection", "features": features}
    mission = read(whole, "m.geojson", heights="geoid")
    assert any(words in sentence for sentence in mission.not_judged)
    assert (len(mission.legs), mission.num_lost) == (num_legs, 0)


def test_rows_of_a_table_are_counted_from_its_text(read):
    mission = read(
        b"lon,lat,alt\r\n0,50,40\r\n\r\n0,50,40\r\n1,50,40\r\n", "m.csv", heights="geoid"
    )
    assert (mission.num_things, mission.num_lost, mission.not_judged) == (3, 0, (CLIMB,))
    quoted = b'lon,lat,alt,note\n0,50,40,\n1,50,40,"a\n2,50,10,b"\n2,50,40,\n'
    mission = read(quoted, "m.csv", heights="geoid")
    assert (mission.num_things, mission.num_lost, mission.not_judged) == (3, 0, (CLIMB,))


@pytest.fixture(scope="module")
def report_of_route():
    maps = made_maps(20, 30)
    ends = maps.grid.lonlat_of_cell(2, 2), maps.grid.lonlat_of_cell(15, 27)
    route = ju.plan(maps, *ends, altitude_m=60.0, snap=True)
    return route, ju.explain(route, maps)


def test_a_route_with_its_report_is_one_line(report_of_route, tmp_path):
    route, report = report_of_route
    file = tmp_path / "route.geojson"
    route.save(file, report=report)
    mission = read_mission(file)
    assert (mission.not_judged, mission.num_lost) == ((CLIMB,), 0)
    assert {leg.profile for leg in mission.legs} == {"frame"}


def test_heights_of_two_notations_agree_or_are_refused(read):
    def own(third, z_m=60.0, **more):
        line = {"type": "LineString", "coordinates": [[0, 50, *third], [0.01, 50, *third]]}
        properties = {"settings": {}, "z_m": [z_m, z_m]} | more
        return {"type": "Feature", "properties": properties, "geometry": line}

    assert read(own([60.004]), "m.geojson").legs[0].end[2:4] == (60.0, "ground")
    with pytest.raises(
        ju.InputError, match=r"two values of the height of a position, 60\.0 and 30"
    ):
        read(own([30]), "m.geojson")
    foreign = own([30], altitude_m=60.0)
    del foreign["properties"]["settings"]
    with pytest.raises(
        ju.InputError, match=r"two values of the height of a position, 60\.0 and 30"
    ):
        read(foreign, "m.geojson", heights="ground")
    with pytest.raises(ju.InputError, match="z_m has 2 heights for 3 positions"):
        read(
            own([]) | {"geometry": {"type": "LineString", "coordinates": [*FLAT, [1, 1]]}}, "m.json"
        )


def test_elevations_of_a_gpx_of_jaxurban_count_as_other_programs_fly_them(read):
    words = "<desc>60.00 m above ground</desc>"
    flat = read(GPX.format("jaxurban", words, words, ""), "m.gpx")
    assert (flat.legs[0].end[2:4], flat.legs[0].profile) == ((60.0, "ground"), "frame")
    changed = "<ele>30</ele>" + words
    leg = read(GPX.format("jaxurban", changed, changed, ""), "m.gpx").legs[0]
    assert (leg.start[2:4], leg.end[2:4]) == ((30.0, "geoid"), (30.0, "geoid"))
    with pytest.raises(ju.InputError, match="point 2 has no height"):
        read(GPX.format("jaxurban", changed, words, ""), "m.gpx")
    with pytest.raises(ju.InputError, match="two values of ele"):
        read(GPX.format("a watch", ELE + "<ele>4</ele>", ELE, ""), "m.gpx", heights="geoid")
    with pytest.raises(ju.InputError, match="an ele has attributes: take them out"):
        read(GPX.format("a watch", '<ele unit="ft">4</ele>', ELE, ""), "m.gpx", heights="geoid")


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("lat,lon,altitude,height", "{},{},75,40"),
        ("lat,lon,Alt,alt", "{},{},30,60"),
        ("lat,lon,alt,altitude_m", "{},{},60,30"),
        ("lon,lat,alt,lon,lat", "{1},{0},40,{1},51"),
        ("lat,lon,alt,alt.1", "{},{},60,30"),
        ("lat,lon,alt,ele", "{},{},60,"),
    ],
)
def test_two_columns_of_one_quantity_agree_or_are_refused(read, header, row):
    rows = [row.format(50, lon) for lon in (0, 0.01)]
    with pytest.raises(ju.InputError, match=r"columns '.*' and '.*', .* and .*: keep one"):
        read("\n".join([header, *rows]), "m.csv", heights="ground")
    same = "lat,lon,alt,Height\n50,0,40,40.004\n50,0.01,40,40\n"
    assert read(same, "m.csv", heights="ground").legs[0].end.height_m == 40


def test_tables_that_do_not_fit_their_header_are_refused_at_once(read):
    with pytest.raises(ju.InputError, match=r"line 2 of 'm.csv' and its header .* 4 and 3"):
        read("lon,lat,alt\n0,50,40,1\n0.01,50,40,1\n", "m.csv", heights="ground")
    began = time.process_time()
    wide = ",".join(f"c{number}" for number in range(100_000))
    with pytest.raises(ju.InputError, match="2,000 are read at most"):
        read(f"lon,lat,alt,{wide}\n0,50,40\n1,50,40\n", "m.csv", heights="ground")
    assert time.process_time() - began < 2


def test_keys_that_json_has_twice_are_refused(read):
    line = '{"type": "LineString", "coordinates": [[0,50,1],[1,50,1]], "coordinates": [[0,50,9],[1,50,9]]}'
    with pytest.raises(ju.InputError, match="two values of 'coordinates'"):
        read(line, "m.geojson", heights="ground")
    twice = json.dumps(plan()).replace('"mission"', '"mission": {}, "mission"')
    with pytest.raises(ju.InputError, match="two values of 'mission'"):
        read(twice, "m.plan")


@pytest.mark.parametrize(
    "name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326"]
)
def test_wgs84_may_be_named(read, name):
    crs = {"crs": {"type": "name", "properties": {"name": name}}}
    assert read(GOOD | crs, "m.geojson", heights="geoid").legs
    assert read(GOOD | {"crs": None}, "m.geojson", heights="geoid").legs


@pytest.mark.parametrize(
    "name", ["EPSG:4267", "urn:ogc:def:crs:EPSG::4301", "EPSG:14326", "EPSG:4979", "NAD27"]
)
def test_another_datum_that_is_named_is_refused(read, name):
    remedy = rf"has its positions in '{name}': convert them to WGS 84 \(EPSG:4326\)"
    for crs in ({"type": "name", "properties": {"name": name}}, name):
        for whole in (GOOD | {"crs": crs}, {"features": [{"geometry": GOOD, "crs": crs}]}):
            with pytest.raises(ju.InputError, match=remedy):
                read(whole, "m.geojson", heights="geoid")
    datum = f"<extensions><x:Datum>{name}</x:Datum></extensions>"
    with pytest.raises(ju.InputError, match=remedy):
        read(GPX.format("a watch", ELE, ELE, datum), "m.gpx", heights="geoid")
    with pytest.raises(ju.InputError, match=remedy):
        read(kml(f'<x srsName="{name}"/>'), "m.kml")
    with pytest.raises(ju.InputError, match=remedy):
        read(f"lon,lat,alt,crs\n0,50,1,\n1,50,1,{name}", "m.csv", heights="geoid")


STRANGE = ["3_0", "٣٠", "３０", "inf", "1e400", "0x1e", "30m"]


@pytest.mark.parametrize("number", STRANGE)
def test_only_digits_points_signs_and_exponents_are_numbers(read, number):
    texts = {
        "m.kml": kml().replace("0.01,50,40", f"0.01,50,{number}"),
        "m.gpx": GPX.format("a watch", ELE, f"<ele>{number}</ele>", ""),
        "m.csv": f"lon,lat,alt\n0,50,1\n1,50,{number}\n",
        "m.waypoints": waypoints(1, number),
    }
    for name, text in texts.items():
        options = {"heights": "geoid"} if name[-3:] in ("gpx", "csv") else {}
        with pytest.raises(ju.InputError, match=r"must be a (finite )?number, got"):
            read(text, name, **options)
    assert read(waypoints(1, "+3.0e1"), "m.waypoints").legs[-1].end.height_m == 30.0


def waypoints(number, height):
    """Return ``QGC WPL 110`` of home, a take-off and a waypoint with a number and a height."""
    rows = [(0, 16, 10), (1, 22, 50), (number + 1, 16, height)]
    return "QGC WPL 110\n" + "".join(
        f"{key}\t0\t{3 * bool(key)}\t{command}\t0\t0\t0\t0\t50\t0.0{key}1\t{z_m}\t1\n"
        for key, command, z_m in rows
    )


def plan(items=None, **more):
    mission = {"version": 2, "plannedHomePosition": [50, 0.001, 10]}
    return {"fileType": "Plan", "version": 1, "mission": mission | {"items": items or TWO}} | more


def item(key, command=16, **more):
    whole = {"type": "SimpleItem", "doJumpId": key, "command": command, "frame": 3}
    return whole | {"params": [0, 0, 0, 0, 50, 0.01 * key, 40]} | more


TWO = [item(1, 22), item(2)]


def test_items_and_rows_are_counted_from_the_file(read):
    camera = item(3, 2000)
    mission = read(plan([*TWO, camera]), "m.plan")
    assert (mission.num_things, mission.num_lost, mission.not_judged) == (3, 0, ())
    assert [each.what for each in mission.accounts] == ["item 1", "item 2", "item 3"]
    mission = read("# made by hand\n" + waypoints(1, 30), "m.waypoints")
    assert (mission.num_things, mission.num_lost, mission.not_judged) == (2, 0, ())
    hidden = read(waypoints(1, 30).replace("\n2\t", "\n# \x0c2\t"), "m.waypoints")
    assert hidden.num_lost == 1


def test_a_file_that_is_no_plan_of_a_known_version_is_never_judged_whole(read):
    with pytest.raises(ju.InputError, match="of the type 'GeoFence', which holds no mission"):
        read(plan(fileType="GeoFence"), "m.plan")
    missing = plan()
    del missing["fileType"]
    assert "does not say that it is a plan" in read(missing, "m.plan").not_judged[0]
    for version in (99, None, 0, True, "1"):
        assert f"its version is {version}" in read(plan(version=version), "m.plan").not_judged[0]
        whole = plan()
        whole["mission"]["version"] = version
        assert f"mission is {version}" in read(whole, "m.plan").not_judged[0]


def test_parts_of_a_plan_that_are_not_known_are_named(read):
    fence = plan(geoFence={"version": 2, "polygons": {"a": 1}}, rallyPoints={"others": [1]})
    said = ("geofence polygon 1 is damaged, and not judged", "its rally points are not judged")
    assert read(fence, "m.plan").not_judged == said
    fence = plan(geoFence={"version": 2, "params": [{}], "polygons": []})
    assert read(fence, "m.plan").not_judged == ("its part 'params' is not judged",)
    whole = plan(mission2={"items": TWO}, comment="a text")
    whole["mission"]["moreItems"] = TWO
    said = ("its part 'mission2' is not judged", "its part 'moreItems' is not judged")
    assert read(whole, "m.plan").not_judged == said


def test_numbers_that_two_items_have_are_refused_where_a_jump_names_them(read):
    jump = {"type": "SimpleItem", "command": 177, "frame": 2, "doJumpId": 9}
    named, other = (jump | {"params": [number, 1, 0, 0, 0, 0, 0]} for number in (2, 1))
    unnamed = [each | {"doJumpId": None} for each in TWO]
    for items in ([*TWO, item(2)], [*TWO, item(2), other], unnamed):
        assert read(plan(items), "m.plan").not_judged == ()
    with pytest.raises(ju.InputError, match="item 4 jumps to the number 2, which 2 of them have"):
        read(plan([*TWO, item(2), named]), "m.plan")
    twice = waypoints(0, 30)
    assert "its rows are not numbered in their order" in read(twice, "m.waypoints").not_judged[0]
    with pytest.raises(ju.InputError, match="line 5 jumps to the number 1, which 2 of them have"):
        read(twice + "9\t0\t0\t177\t1\t1\t0\t0\t0\t0\t0\t1\n", "m.waypoints")
    survey = {"type": "ComplexItem", "complexItemType": "survey"}
    mission = read(plan([*TWO, survey, survey, item(3)]), "m.plan")
    assert (
        "item 3 is a survey without its waypoints (open and save it in QGroundControl), which is not read"
        in mission.not_judged
    )


FRAMES = {0: "geoid", 5: "geoid", 3: "home", 6: "home", 10: "ground", 11: "ground"}
# By QGroundControlQmlGlobal::AltMode; 0 and 5 are of no item, and 3 makes metres above the geoid.
MODES = {0: None, 1: "home", 2: "geoid", 3: "geoid", 4: "ground", 5: None, None: None}
STRANGE_MODES = {7: "?", "home": "?"}


@pytest.mark.parametrize(("frame", "mode"), [*product(FRAMES, MODES | STRANGE_MODES)])
def test_the_frame_and_the_altitude_mode_of_an_item_say_the_same_or_are_refused(read, frame, mode):
    said = (MODES | STRANGE_MODES)[mode]
    shown = item(2, frame=frame) | {"AltitudeMode": mode, "Altitude": 40}
    survey = {"CameraCalc": {"DistanceMode": mode}, "Items": [item(2, frame=frame)]}
    for each in (shown, {"complexItemType": "survey", "TransectStyleComplexItem": survey}):
        if said in (None, FRAMES[frame]):
            assert read(plan([TWO[0], each]), "m.plan").legs[-1].end.datum == FRAMES[frame]
        else:
            with pytest.raises(ju.InputError, match=r"what item 2 is above, by its frame and by"):
                read(plan([TWO[0], each]), "m.plan")


@pytest.mark.parametrize(
    ("frame", "is_relative", "follows_ground"), [*product((0, 3), (True, False), (True, False))]
)
def test_a_survey_of_an_older_version_says_what_its_items_say(
    read, frame, is_relative, follows_ground
):
    camera = {"DistanceToSurfaceRelative": is_relative, "DistanceToSurface": 40}
    survey = {"CameraCalc": camera, "FollowTerrain": follows_ground}
    survey["Items"] = [item(2, frame=frame)]
    whole = {"complexItemType": "survey", "TransectStyleComplexItem": survey}
    if (frame == 3) == (is_relative and not follows_ground):
        assert read(plan([TWO[0], whole]), "m.plan").legs[-1].end.height_m == 40
    else:
        with pytest.raises(ju.InputError, match="what item 2 is above"):
            read(plan([TWO[0], whole]), "m.plan")


@pytest.mark.parametrize(
    ("frame", "facts"),
    [
        (3, {"Altitude": 30}),
        (3, {"Altitude": 30, "params": [0, 0, 0, 0, 50, 0.02, None]}),
        (3, {"Altitude": "thirty"}),
        (0, {"AltitudeMode": 3, "AMSLAltAboveTerrain": 30}),
    ],
)
def test_two_heights_of_an_item_are_refused(read, frame, facts):
    with pytest.raises(ju.InputError, match="two values of the height of item 2, "):
        read(plan([TWO[0], item(2, frame=frame) | facts]), "m.plan")


def test_a_survey_names_the_height_of_its_items(read):
    survey = {"CameraCalc": {"DistanceToSurface": 30}, "Items": [item(2)]}
    whole = {"complexItemType": "survey", "TransectStyleComplexItem": survey}
    with pytest.raises(ju.InputError, match=r"two values of the height of item 2, 40\.0 and 30"):
        read(plan([TWO[0], whole]), "m.plan")


@pytest.mark.parametrize("other", ["Height", "alt_m", "ELE"])
def test_two_properties_of_one_height_agree_or_are_refused(read, other):
    feature = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": FLAT}}
    for height_m, is_same in ((40.004, True), (30, False), (None, True)):
        properties = {"properties": {"altitude_m": 40, other: height_m}}
        if is_same:
            mission = read(feature | properties, "m.geojson", heights="ground")
            assert mission.legs[0].end.height_m == 40
        else:
            with pytest.raises(ju.InputError, match="the height of a feature, 40 and 30"):
                read(feature | properties, "m.geojson", heights="ground")


def test_values_that_are_the_same_in_two_places_are_one(read):
    twice = json.dumps(plan()).replace('"frame": 3', '"frame": 3, "frame": 3.0')
    assert read(twice, "m.plan").not_judged == ()
    point = "<ele>40</ele><ele>40.0</ele><desc><p>a note</p></desc>"
    gpx = read(GPX.format("a watch", point, point, ""), "m.gpx", heights="geoid")
    assert gpx.legs[0].end.height_m == 40
    line = f"<coordinates>{LINE}</coordinates>"
    again = placemark(f"<LineString>{MODE}{MODE}{line}{line}</LineString>")
    assert len(read(kml(again), "m.kml").legs) == 2


@pytest.mark.parametrize("frame", [0, 3])
def test_parrots_rows_are_those_of_ardupilot_but_row_0_may_be_flown(read, frame):
    rows = waypoints(1, 30).replace("110", "120").replace("\t0\t0\t16", f"\t0\t{frame}\t16", 1)
    for name in ("m.mavlink", "m.waypoints"):
        mission = read(rows, name)
        assert (mission.home is not None) == (frame == 0)
        assert mission.autopilots == ("ardupilot", "px4")
        assert (mission.not_judged == ()) == (frame == 0)
    assert [leg.end.height_m for leg in mission.legs][-1] == 30


def test_missions_of_inav_are_named_with_their_converter(read):
    step = {"no": 1, "action": "WAYPOINT", "lat": 50.0, "lon": 8.0, "alt": 40}
    for content, name in (("<MISSION/>", "m.mission"), ({"mission": [step]}, "m.json")):
        with pytest.raises(ju.InputError, match=r"of INAV: make KML of it with `mission2kml -home"):
            read(content, name)


@pytest.mark.parametrize("height_m", [29_064.96, 9_000.5, -500.5])
def test_a_home_where_no_ground_is_is_refused(read, height_m):
    for name, content in {
        "m.plan": plan(mission=plan()["mission"] | {"plannedHomePosition": [50, 0, height_m]}),
        "m.waypoints": waypoints(1, 30).replace("\t10\t", f"\t{height_m}\t"),
    }.items():
        with pytest.raises(ju.InputError, match=r"home is .* m above the sea.*centimetres\?"):
            read(content, name)


BROKEN = {
    "deep.plan": b"[" * 100_000,
    "digits.geojson": b'{"coordinates": ' + b"9" * 10_000 + b"}",
    "text.geojson": json.dumps(
        {"properties": {"settings": 1, "z_m": [1]}, "geometry": GOOD}
    ).encode(),
    "numbers.geojson": b'{"type": "LineString", "coordinates": [1, 2, 3]}',
    "latin.csv": "lon,lat,alt,ü\n".encode("latin-1"),
    "quote.csv": b'lon,lat,alt\n0,50,"1\n',
    "long.csv": b"lon,lat,alt\n" + b"1" * 200_000,
    "empty.csv": b"",
    "cut.kml": kml()[:-9].encode(),
    "encoding.kml": b'<?xml version="1.0" encoding="euc-jp"?><kml/>',
}
LIBRARIES = (
    "recursion",
    "zip",
    "unpack",
    "digits",
    "codec",
    "token",
    "field",
    "Expecting",
    "argum",
)


@pytest.mark.parametrize("name", BROKEN)
def test_no_sentence_of_a_library_reaches_the_user(read, name):
    options = {} if name[-3:] in ("lan", "kml") else {"heights": "geoid"}
    with pytest.raises(ju.InputError) as caught:
        read(BROKEN[name], name, **options)
    reason = str(caught.value).partition("cannot be read as a mission")[2] or str(caught.value)
    assert not [word for word in LIBRARIES if word in reason]


def test_lines_say_whether_they_follow_the_ground(read, report_of_route, tmp_path):
    above_ground = kml().replace("absolute", "relativeToGround")
    assert {leg.profile for leg in read(above_ground, "m.kml").legs} == {"both"}
    assert {leg.profile for leg in read(GOOD, "m.json", heights="ground").legs} == {"both"}
    assert {leg.profile for leg in read(kml(), "m.kml").legs} == {"frame"}
    route, _ = report_of_route
    for suffix in (".kml", ".gpx", ".geojson"):
        route.save(tmp_path / f"own{suffix}")
        legs = read_mission(tmp_path / f"own{suffix}").legs
        assert {(leg.end.datum, leg.profile) for leg in legs} == {("ground", "frame")}


def test_a_long_track_is_read_in_linear_time(read):
    points = "".join(f'<trkpt lat="{50 + n / 1e5}" lon="8">{ELE}</trkpt>' for n in range(10_000))
    began = time.process_time()
    mission = read(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>", "m.gpx", heights="geoid")
    assert len(mission.legs) == 9_999
    assert time.process_time() - began < 1.1  # 1.4 s and more in the square of it


def test_many_lines_and_many_things_are_read_in_seconds(read):
    began = time.process_time()
    rng = np.random.default_rng(1)
    lines = [{"type": "LineString", "coordinates": rng.uniform(0, 1, (2, 3)).tolist()}] * 3_000
    whole = {"type": "GeometryCollection", "geometries": lines + [POINT] * 3_000}
    mission = read(whole, "m.json", heights="geoid")
    assert (mission.num_things, mission.num_lost) == (9_000, 0)
    deep = "<gx:MultiTrack>" * 50_000 + "</gx:MultiTrack>" * 50_000
    assert len(read(kml(deep), "m.kml").legs) == 1
    assert time.process_time() - began < 5


@pytest.mark.parametrize(
    ("name", "value", "is_read"),
    [
        *(("unit", "m", True), ("community", "Harlem", True), ("model", "M300", True)),
        *(("unit", "ft", False), ("altitude_units", "feet", False), ("altitudemode", "1", False)),
        *(("horizontal_datum", "NAD27", False), ("frame", "3", False), ("alt_agl", "30", False)),
    ],
)
def test_columns_that_say_how_others_are_meant_are_read_or_refused(read, name, value, is_read):
    table = f"lon,lat,alt,{name}\n0,50,40,{value}\n1,50,40,{value}\n".encode()
    if is_read:
        assert len(read(table, "m.csv", heights="geoid").legs) == 1
    else:
        with pytest.raises(ju.InputError, match=name):
            read(table, "m.csv", heights="geoid")


@pytest.mark.parametrize(("name", "is_read"), [("units", False), ("community", True)])
def test_properties_that_say_how_others_are_meant_are_not_judged(read, name, is_read):
    geometry = {"type": "LineString", "coordinates": [[0, 50, 40], [1, 50, 40]]}
    feature = {"type": "Feature", "properties": {name: "feet"}, "geometry": geometry}
    plain = {**feature, "properties": {}}
    whole = json.dumps({"type": "FeatureCollection", "features": [plain, feature]}).encode()
    words = " ".join(read(whole, "m.geojson", heights="geoid").not_judged)
    assert ("which is not understood" in words) != is_read
