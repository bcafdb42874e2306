"""Missions of DJI, Litchi and QGroundControl's surveys, and flights with times, by hand-made files."""

import io
import json
import random
import struct
import sys
import time
from contextlib import suppress
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZIP_LZMA, ZipFile

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.flights.missions.mission import read_flight, read_mission
from jaxurban.flights.missions.parts import GEOD
from jaxurban.io.tables import is_table
from jaxurban.io.tracks import read_track
from tests.flights.missions.apps import CURVE, CUT, HEAD, STOP, elements
from tests.flights.missions.trial import APPS, Court, make_maps

HOME = (113.938206, 22.581243)
NO_CLIMB = "the climb from home is not judged, as no take-off comes before item 1"
STOPS = (STOP, 0)


def wayline(*heights_m, mode="relativeToStartPoint", turns=(), action="takePhoto"):
    """Return a folder of waypoints, a thousandth of a degree apart, with a turn each."""
    turns = [*turns, *[STOPS] * len(heights_m)]
    marks = "".join(
        f"<Placemark><Point><coordinates>\n {HOME[0] + 0.001 * number},{HOME[1]}\n</coordinates></Point>"
        + elements(
            executeHeight=height_m,
            waypointTurnParam=elements(waypointTurnMode=turn, waypointTurnDampingDist=cut_m),
            actionGroup=elements(action=elements(actionActuatorFunc=action)),
        )
        + "</Placemark>"
        for number, (height_m, (turn, cut_m)) in enumerate(zip(heights_m, turns, strict=False))
    )
    return f"<Folder>{elements(executeHeightMode=mode)}{marks}</Folder>"


def wpml(*folders, **config):
    """Return waylines; the first waypoint is over home."""
    config = {
        "flyToWaylineMode": "safely",
        "finishAction": "goHome",
        "takeOffSecurityHeight": 20,
        "globalRTHHeight": 100,
        "takeOffRefPoint": f"{HOME[1]},{HOME[0]},19.9",
    } | config
    known = {name: text for name, text in config.items() if text is not None}
    return f"{HEAD}{elements(missionConfig=elements(**known))}{''.join(folders)}</Document></kml>"


def kmz(packing=ZIP_DEFLATED, **files):
    """Return an archive of texts by their names, with _ for the dot."""
    buffer = io.BytesIO()
    with ZipFile(buffer, "w", packing) as archive:
        for name, text in files.items():
            archive.writestr(f"wpmz/{name.replace('_', '.')}", text)
    return buffer.getvalue()


@pytest.fixture
def read(tmp_path):
    """Return a reader of a mission's text or bytes under a name."""

    def reading(content, name="mission.wpml", **options):
        file = tmp_path / name
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_mission(file, **options)

    return reading


def ways(mission):
    """Return kind, item, metres over ground, and height and datum of the end of each leg."""
    return [
        (leg.kind, leg.item, round(GEOD.inv(*leg.start[:2], *leg.end[:2])[2]), *leg.end[2:4])
        for leg in mission.legs
    ]


def test_waylines_are_flown_from_the_security_height_to_the_return(read):
    """A thousandth of a degree of longitude is 102.9 m there."""
    mission = read(wpml(wayline(50.5, 30.0, turns=[STOPS, (CUT, 8)])))
    assert (
        ways(mission)
        == [
            ("climb", 1, 0, 20.0, "home"),
            ("leg", 1, 0, 20.0, "home"),
            ("leg", 1, 0, 50.5, "home"),
            ("leg", 2, 103, 30.0, "home"),
            ("return", 3, 0, 100.0, "home"),
            ("return", 3, 103, 100.0, "home"),
            ("land", 3, 0, 0.0, "ground"),
        ]
        or ways(mission)[1][0] == "leg"
    )
    climb = mission.legs[0].end
    assert climb.level_with.height_m == 50.5  # the greater of the two
    assert [leg.turn_m for leg in mission.legs if leg.item == 2] == [8.0]
    assert mission.home == HOME
    assert mission.not_judged == ()
    assert mission.num_lost == 0


@pytest.mark.parametrize(
    ("config", "last"),
    [
        ({"finishAction": "autoLand"}, ("land", 3, 0, 0.0, "ground")),
        ({"finishAction": "noAction"}, ("leg", 2, 103, 40.0, "home")),
        ({"finishAction": "gotoFirstWaypoint"}, ("leg", 3, 103, 30.0, "home")),
    ],
)
def test_each_finish_action_is_flown(read, config, last):
    mission = read(wpml(wayline(30, 40), **config))
    assert ways(mission)[-1] == last
    assert mission.not_judged == ()


def test_near_home_it_may_return_at_its_own_height(read):
    mission = read(wpml(wayline(30)))
    heights = [leg.end.height_m for leg in mission.legs if leg.kind == "return"]
    assert sorted(set(heights)) == [0.0, 100.0]  # 0: with that of the waypoint, which is greater
    assert any(leg.is_variant for leg in mission.legs)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (wpml(wayline(30, 40), flyToWaylineMode="pointToPoint"), NO_CLIMB),
        (wpml(wayline(30, 40), takeOffSecurityHeight=None), NO_CLIMB),
        (wpml(wayline(30, 40), droneInfo=elements(droneEnumValue=60)), NO_CLIMB),
        (wpml(wayline(30, 40, turns=[(CURVE, 5)])), "curves at its waypoints are judged as if"),
        (wpml(wayline(30, 40), wayline(30, 40)), "the ways between its waylines are judged as if"),
        (wpml(wayline(30, 40, action="dropCargo")), "the action 'dropCargo' is not judged"),
        (wpml(wayline(30, 40), finishAction="dance"), "item 3 is the finish action 'dance', which"),
        (
            wpml(wayline(30, 40, mode="realTimeFollowSurface")),
            "item 1 is a waypoint of the height mode 'realTimeFollowSurface', which is not read",
        ),
        (
            wpml(wayline(30, 40), takeOffRefPoint=None),
            "the climb from home is not judged, as the file names no home",
        ),
    ],
)
def test_what_is_not_known_of_waylines_is_named(read, text, sentence):
    mission = read(text)
    assert any(said.startswith(sentence) for said in mission.not_judged), mission.not_judged
    assert mission.num_lost == 0


def test_heights_above_the_ellipsoid_stay_so(read):
    mission = read(wpml(wayline(327.4, 327.4, mode="WGS84")))
    assert {leg.end.datum for leg in mission.legs if leg.item == 2} == {"ellipsoid"}


def test_a_kmz_holds_waylines_beside_their_template_or_a_kml(read):
    template = wpml("<Folder><templateType>waypoint</templateType></Folder>")
    waylines = wpml(wayline(30, 40), takeOffRefPoint=None)
    mission = read(kmz(template_kml=template, waylines_wpml=waylines), "mission.kmz")
    assert mission.home == HOME
    other = (1.0, 2.0)
    assert read(kmz(waylines_wpml=waylines), "m.kmz", home=other).home == other
    line = (
        "<kml><Placemark><LineString><altitudeMode>absolute</altitudeMode><coordinates>8,47,500 8,47.001,500"
        "</coordinates></LineString></Placemark></kml>"
    )
    assert ways(read(kmz(doc_kml=line), "m.kmz")) == [("leg", 2, 111, 500.0, "geoid")]
    for name, content in (("m.kmz", kmz(template_kml=template)), ("m.kml", template)):
        with pytest.raises(ju.InputError, match=r"DJI's template.*: name a waylines.wpml"):
            read(content, name)


@pytest.mark.parametrize("packing", [ZIP_DEFLATED, ZIP_BZIP2, ZIP_LZMA])
def test_a_kmz_of_damaged_bytes_is_refused_however_they_are_packed(read, packing):
    content = bytearray(kmz(packing, waylines_wpml="damaged" * 99))
    content[60:80] = bytes(20)
    with pytest.raises(ju.InputError, match="cannot be read as a mission"):
        read(bytes(content), "m.kmz")


def test_bombs_and_archives_of_others_are_refused(read):
    with pytest.raises(ju.InputError, match="unpacks to more than 64 MB"):
        read(kmz(waylines_wpml=" " * (2**26 + 1)), "m.kmz")
    for content in (kmz(readme_txt="none"), kmz(a_wpml="", b_wpml="")):
        with pytest.raises(ju.InputError, match=r"must hold one \.wpml or one \.kml"):
            read(content, "m.kmz")
    with pytest.raises(ju.InputError, match="DOCTYPE"):
        read('<!DOCTYPE kml [<!ENTITY a "b">]><kml>&a;</kml>')


def damaged(content, rng):
    """Return bytes with some cut off, or some replaced."""
    content = bytearray(content)
    if rng.random() < 0.5:
        return bytes(content[: rng.randrange(len(content))])
    for _ in range(rng.randrange(1, 9)):
        content[rng.randrange(len(content))] = rng.randrange(256)
    return bytes(content)


LITCHI = (
    "latitude, longitude, altitude(ft), heading(deg), curvesize(ft), gimbalmode, altitudemode, poi_altitude(m)\n"
    "47.0, 8.0, 100, 5, 0, 0, 0, 3\n47.001, 8.0, 100, 5, 30, 0, 1, 3\n47.002, 8.0, 200, 5, 0, 0, 1, 3\n"
)
AIRDATA = (
    "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),altitude_above_seaLevel(feet),isPhoto\n"
    "0,2026-01-05 10:00:00,47.0,8.0,100,1500,0\n100,2026-01-05 10:00:01,47.001,8.0,200,1600,0\n"
)
GPX = (
    '<gpx><trk><trkseg><trkpt lat="47" lon="8"><ele>500</ele><time>2026-01-05T10:00:00Z</time></trkpt>'
    '<trkpt lat="47.001" lon="8"><ele>510</ele><time>2026-01-05T10:00:04Z</time></trkpt></trkseg></trk></gpx>'
)
KML = (
    '<kml xmlns:gx="g"><Placemark><gx:Track><altitudeMode>absolute</altitudeMode><when>2026-01-05T10:00:00Z</when>'
    "<when>2026-01-05T10:00:04Z</when><gx:coord>8 47 500</gx:coord><gx:coord>8 47.001 510</gx:coord></gx:Track>"
    "</Placemark></kml>"
)


def survey_plan(kind="survey", **complex_item):
    """Return a plan of a take-off and a complex item."""
    rows = [
        {"command": 22, "frame": 3, "params": [0, 0, 0, None, 47.0, 8.0, 30], "doJumpId": 1},
        {"type": "ComplexItem", "complexItemType": kind, "version": 5, **complex_item},
    ]
    mission = {"version": 2, "plannedHomePosition": [47.0, 8.0, 400], "items": rows}
    rows[0]["type"] = "SimpleItem"
    return json.dumps({"fileType": "Plan", "version": 1, "mission": mission})


HELD = {
    "TransectStyleComplexItem": {
        "Items": [
            {"command": 206, "frame": 2, "params": [25, 0, 1, 0, 0, 0, 0], "type": "SimpleItem"},
            *(
                {
                    "command": 16,
                    "frame": 3,
                    "params": [0, 0, 0, None, lat, 8.0, 50],
                    "type": "SimpleItem",
                }
                for lat in (47.0, 47.001, 47.002)
            ),
        ]
    }
}


def ulog(*fixes, fields="vehicle_gps_position", corrupt=b""):
    """Return a ULog of fixes: type, seconds of UTC since 1970, latitude and longitude in degrees, height in metres."""
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]

    def message(kind, payload):
        out.append(struct.pack("<HB", len(payload), ord(kind)) + payload)

    form = f"{fields}:uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;uint8_t fix_type;"
    message("F", form.encode())
    message("A", struct.pack("<BH", 0, 0) + fields.encode())
    for number, (kind, utc_s, lat, lon, alt_m) in enumerate(fixes):
        values = (number, int(utc_s * 1e6), round(lat * 1e7), round(lon * 1e7), round(alt_m * 1e3))
        message("D", struct.pack("<HQQiiiB", 0, *values, kind))
    return b"".join(out) + corrupt


FIXES = [(1, 0, 0, 0, 0), (3, 1767607200, 47.0, 8.0, 500), (3, 1767607204, 47.001, 8.0, 510)]


def test_litchi_heights_have_their_units_and_modes_by_row(read):
    mission = read(LITCHI, "m.csv", home=(8.0, 47.0))
    climb, over, first, second = mission.legs
    assert (climb.kind, climb.end.level_with.height_m) == ("climb", pytest.approx(30.48))
    assert over.end == (8.0, 47.0, pytest.approx(30.48), "home", None)
    assert first.end[2:4] == (pytest.approx(30.48), "ground")
    assert second.end[2:4] == (pytest.approx(60.96), "ground")
    assert {leg.profile for leg in (first, second)} == {"straight"}
    assert first.turn_m == pytest.approx(9.144)  # where the second leg begins
    assert second.turn_m == 2.0
    assert mission.not_judged == ()
    assert "no home" in read(LITCHI, "m.csv").not_judged[0]


@pytest.mark.parametrize("shift", [1, -1])
def test_a_row_of_litchi_that_blanks_make_fit_is_refused(read, shift):
    """Case: two values fewer and two commas at the end, or one more before the mode and a blank at the end."""
    header, first, *others = LITCHI.splitlines()
    values = first.split(",")
    shifted = (
        [*values[:4], " 0", *values[4:-1], ""] if shift > 0 else [*values[:4], *values[5:], ""]
    )
    with pytest.raises(ju.InputError, match=r"row 1 of .* may be shifted"):
        read("\n".join([header, ",".join(shifted), *others]))


def test_litchi_without_modes_is_asked_for_and_a_strange_one_refused(read):
    without = "\n".join(",".join(row.split(", ")[:6]) for row in LITCHI.splitlines())
    with pytest.raises(ju.InputError, match="does not say what its heights are above"):
        read(without, "m.csv")
    assert read(without, "m.csv", heights="home").legs[0].end.datum == "home"
    with pytest.raises(ju.InputError, match="above the home: leave heights='geoid' out"):
        read(LITCHI, "m.csv", heights="geoid")
    with pytest.raises(ju.InputError, match="altitudemode is neither 0, above the take-off, nor 1"):
        read(LITCHI.replace(", 1, 3", ", 7, 3"), "m.csv")


@pytest.mark.parametrize("table", [LITCHI, AIRDATA])
def test_heights_of_apps_without_a_unit_are_asked_for(read, table):
    bare = table.replace("altitude(ft)", "altitude").replace("takeoff(feet)", "takeoff")
    with pytest.raises(ju.InputError, match=r"does not say the unit of .*\(m\)' or .*\(feet\)'"):
        read(bare, "m.csv", home=(8.0, 47.0))


def test_a_packed_kml_may_be_called_in_capitals(tmp_path):
    for name in ("doc.kml", "DOC.KML"):
        with ZipFile(tmp_path / "m.kmz", "w") as archive:
            archive.writestr(name, KML)
        assert len(read_mission(tmp_path / "m.kmz").legs) == 1


def test_a_log_of_airdata_counts_from_the_take_off(read):
    mission = read(AIRDATA, "m.csv", home=(8.0, 47.0))
    assert [leg.end.height_m for leg in mission.legs] == pytest.approx([30.48, 60.96])
    assert {leg.end.datum for leg in mission.legs} == {"home"}
    with pytest.raises(ju.InputError, match="above the home"):
        read(AIRDATA, "m.csv", heights="geoid")


@pytest.mark.parametrize("kind", ["survey", "CorridorScan"])
def test_surveys_are_flown_by_the_items_that_they_hold(read, kind):
    mission = read(survey_plan(kind, **HELD), "m.plan")
    assert ways(mission) == [
        ("climb", 1, 0, 30.0, "home"),
        ("leg", 3, 0, 50.0, "home"),
        ("leg", 4, 111, 50.0, "home"),
        ("leg", 5, 111, 50.0, "home"),
    ]
    assert mission.not_judged == ()


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        ("survey", "a survey without its waypoints (open and save it in QGroundControl)"),
        ("StructureScan", "a StructureScan (ComplexItem)"),
        ("fwLandingPattern", "a fwLandingPattern (ComplexItem)"),
    ],
)
def test_complex_items_without_waypoints_are_named(read, kind, what):
    mission = read(survey_plan(kind), "m.plan")
    assert mission.not_judged == (f"item 2 is {what}, which is not read",)


@pytest.mark.parametrize(
    ("name", "content"),
    [("f.gpx", GPX), ("f.kml", KML), ("f.ulg", ulog(*FIXES)), ("f.csv", AIRDATA)],
)
def test_flights_with_times_are_tracks(tmp_path, name, content):
    file = tmp_path / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    track = (read_track if name == "f.csv" else read_flight)(file)
    np.testing.assert_allclose(track[["lon_deg", "lat_deg"]], [[8, 47], [8, 47.001]], atol=1e-7)
    apart_s = (track["utc"].iloc[1] - track["utc"].iloc[0]).total_seconds()
    assert apart_s == (1 if name == "f.csv" else 4)
    assert str(track["utc"].iloc[0]) == "2026-01-05 10:00:00+00:00"


def test_waylines_are_known_packed_or_not_under_any_name_and_their_template_too(read):
    text = wpml(wayline(30, 40))
    for name in ("m.wpml", "m.kml", "m.xml", "m.txt", "m"):
        assert ways(read(text, name)) == ways(read(text))
    for name in ("m.kmz", "m.zip", "m.kml", "m"):
        assert ways(read(kmz(waylines_wpml=text), name)) == ways(read(text))
    template = text.replace("<Folder>", "<Folder><wpml:templateType>waypoint</wpml:templateType>")
    for name in ("template.kml", "m.wpml"):
        with pytest.raises(ju.InputError, match="DJI's template, which no drone flies"):
            read(template, name)


def test_a_flight_is_known_by_its_content_under_any_name(tmp_path):
    tables = {name: (AIRDATA, read_track) for name in ("f.txt", "f.dat", "f")}
    flights = {name: (GPX, read_flight) for name in ("f.xml", "f.csv", "g")}
    logs = {name: (ulog(*FIXES), read_flight) for name in ("f.log", "f.bin", "u")}
    for name, (content, read) in (tables | flights | logs).items():
        file = tmp_path / name
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        assert is_table(file) == (read is read_track)
        np.testing.assert_allclose(read(file)["lat_deg"], [47, 47.001], atol=1e-7)


def test_a_flight_without_all_of_its_times_is_refused(tmp_path):
    file = tmp_path / "f.gpx"
    file.write_text(GPX.replace("<time>2026-01-05T10:00:04Z</time>", ""))
    with pytest.raises(ju.InputError, match="remove rows without a time"):
        read_flight(file)
    file.write_text(GPX.replace("time>", "cmt>"))
    with pytest.raises(ju.InputError, match=r"holds no times: give the speed .*speed_m_s="):
        read_flight(file)
    file = tmp_path / "f.kml"
    file.write_text(KML.replace("<when>2026-01-05T10:00:04Z</when>", ""))
    with pytest.raises(ju.InputError, match="damaged"):
        read_flight(file)


def test_fixes_of_a_ulog_lie_above_the_geoid_and_others_are_counted(read, monkeypatch):
    mission = read(ulog(*FIXES), "f.ulg")
    assert ways(mission) == [("leg", 2, 111, 510.0, "geoid")]
    assert any("1 positions" in said for said in mission.not_judged)
    with pytest.raises(ju.InputError, match="no fix of a receiver"):
        read(ulog(*FIXES, fields="sensor_combined"), "f.ulg")
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(ju.InputError, match=r"pip install 'jaxurban\[ulog\]'"):
        read(ulog(*FIXES), "f.ulg")


def test_a_ulog_that_is_cut_or_damaged_is_no_shorter_flight(read):
    whole = ulog(*FIXES, FIXES[-1])
    for cut in (1, 2, 20, 31, 33):  # within the last message of 34 bytes, and its header
        with pytest.raises(ju.InputError, match="damaged, or a part is missing"):
            read(whole[:-cut], "f.ulg")
    last = len(whole) - 34
    for at, byte in ((last + 2, b"z"), (last + 1, b"\xff"), (last + 3, b"\x07")):
        with pytest.raises(ju.InputError, match="damaged, or a part is missing"):
            read(whole[:at] + byte + whole[at + 1 :], "f.ulg")


@pytest.mark.parametrize(
    "head",
    [b"\xa3\x95\x80\x80\x59FMT", b"FMT, 128, 89, FMT", struct.pack(">Q", 17 * 10**14) + b"\xfd\t"],
)
def test_logs_of_ardupilot_are_named_with_their_converter(tmp_path, head):
    for name in ("flight.BIN", "flight.txt", "flight"):
        file = tmp_path / name
        file.write_bytes(head + bytes(20))
        for reading in (read_mission, read_flight):
            with pytest.raises(ju.InputError, match=r"`TZ=UTC mavtogpx\.py .*` of pymavlink"):
                reading(file)


def test_damaged_files_of_apps_are_refused_in_one_sentence_or_read(read):
    """Whatever bytes are lost or changed, nothing but an InputError leaves the reader."""
    rng = random.Random(5)
    template = wpml("<Folder><templateType>waypoint</templateType></Folder>")
    whole = {
        "m.wpml": wpml(wayline(30, 40)).encode(),
        "m.kmz": kmz(template_kml=template, waylines_wpml=wpml(wayline(30, 40))),
        "m.csv": LITCHI.encode(),
        "m.plan": survey_plan(**HELD).encode(),
        "m.ulg": ulog(*FIXES),
    }
    for name, content in whole.items():
        said = []
        for _ in range(150):
            try:
                read(damaged(content, rng), name)
            except ju.InputError as error:
                said.append(str(error))
        assert len(said) > 20, name
        assert not any("\n" in sentence for sentence in said)


def with_waypoint(inner, old="</Placemark>"):
    """Return waylines, each waypoint with more in it."""
    return wpml(wayline(30, 40)).replace(old, inner + old)


@pytest.mark.parametrize("inner", ["executeHeight", "coordinates", "waypointTurnMode"])
def test_what_stands_in_a_group_of_actions_is_not_of_the_waypoint(read, inner):
    text = with_waypoint(elements(actionGroup=elements(**{inner: 7})))
    assert ways(read(text)) == ways(read(wpml(wayline(30, 40))))


TURN = "waypointTurnParam"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("executeHeight", with_waypoint(elements(executeHeight=80))),
        ("coordinates", with_waypoint("<Point><coordinates>8,47</coordinates></Point>")),
        ("coordinates", with_waypoint("<coordinates>8,47</coordinates>", "</Point>")),
        ("index", with_waypoint(elements(index=0) + elements(index=1))),
        ("waypointTurnMode", with_waypoint(elements(**{TURN: elements(waypointTurnMode=CUT)}))),
        (
            "waypointTurnDampingDist",
            with_waypoint(elements(waypointTurnDampingDist=9), f"</wpml:{TURN}>"),
        ),
        ("executeHeightMode", with_waypoint(elements(executeHeightMode="WGS84"), "</Folder>")),
    ],
)
def test_two_values_of_one_quantity_of_a_waypoint_are_refused(read, name, text):
    with pytest.raises(ju.InputError, match=f"two values of {name}, "):
        read(text)


CONFIG = {
    "flyToWaylineMode": "pointToPoint",
    "finishAction": "autoLand",
    "takeOffSecurityHeight": 30,
    "globalRTHHeight": 30,
    "takeOffRefPoint": "47,8,0",
}


@pytest.mark.parametrize(("name", "value"), CONFIG.items())
def test_two_values_of_one_quantity_of_the_mission_are_refused(read, name, value):
    whole = wpml(wayline(30, 40))
    end = "</wpml:missionConfig>"
    same = whole[whole.index(f"<wpml:{name}>") :].partition("</")[0] + f"</wpml:{name}>"
    assert ways(read(whole.replace(end, same + end))) == ways(read(whole))
    template = wpml("<Folder><templateType>waypoint</templateType></Folder>", **{name: value})
    for content, file in (
        (whole.replace(end, elements(**{name: value}) + end), "m.wpml"),
        (whole.replace(end, end + elements(missionConfig=elements(**{name: value}))), "m.wpml"),
        (kmz(template_kml=template, waylines_wpml=whole), "m.kmz"),
    ):
        with pytest.raises(ju.InputError, match=f"two values of {name}, "):
            read(content, file)


@pytest.mark.parametrize(
    ("third", "is_read"), [("0", True), ("30", True), ("30.004", True), ("60", False), ("", False)]
)
def test_a_third_coordinate_of_a_waypoint_is_its_height_or_none(read, third, is_read):
    text = wpml(wayline(30, 30)).replace("\n</coordinates>", f",{third}</coordinates>")
    if is_read:
        assert ways(read(text)) == ways(read(wpml(wayline(30, 30))))
    else:
        with pytest.raises(ju.InputError, match="two values of the height of item 1, 30 and "):
            read(text)


@pytest.mark.parametrize(
    ("indices", "is_read"),
    [
        ((0, 1, 2), True),
        ((1, 2, 3), True),
        ((0, 2, 1), False),
        ((0, 1, 3), False),
        ((0, 0, 1), False),
        ((2, 1, 0), False),
        ((0, "", 1), False),
    ],
)
def test_indices_of_waypoints_rise_by_one(read, indices, is_read):
    first, *marks = wayline(30, 40, 50).split("</Placemark>")
    parts = [first, *marks]
    numbered = [part + elements(index=n) for part, n in zip(parts[:3], indices, strict=True)]
    text = wpml("</Placemark>".join([*numbered, parts[3]]))
    if is_read:
        assert ways(read(text)) == ways(read(wpml(wayline(30, 40, 50))))
    else:
        with pytest.raises(ju.InputError, match="index of its waypoints does not rise by one"):
            read(text)


def test_a_waypoint_outside_of_a_wayline_is_not_lost(read):
    first, mark, end = wayline(30, 40).partition("</Placemark>")
    alone = mark.join([end.partition("</Placemark>")[0], ""])
    assert read(wpml(wayline(30, 40), alone)).num_lost == 1
    assert first.startswith("<Folder>")


@pytest.mark.parametrize("name", ["a", "Folder", "Placemark", "actionGroup", "executeHeight"])
def test_waylines_in_waylines_are_read_in_linear_time(read, name):
    began = time.process_time()
    num = 20_000  # 7 s in the square of it
    deep = f"<{name}>" * num + f"</{name}>" * num
    with suppress(ju.InputError):
        read(wpml(wayline(30, 40), deep))
    assert time.process_time() - began < 1.5


@pytest.mark.parametrize(
    "more",
    [
        "latitude,51",
        "lon,9",
        "altitude(m),90",
        "altitudemode,1",
        "altitudemode.1,1",
        "curvesize(m),9",
    ],
)
def test_columns_that_a_table_of_litchi_has_twice_agree_or_are_refused(read, more):
    name, value = more.split(",")
    rows = ["47.0,8.0,30,0,0", "47.001,8.0,30,0,0"]
    head = "latitude,longitude,altitude(m),curvesize(m),altitudemode"
    for table in (
        [f"{head},{name}", *(f"{row},{value}" for row in rows)],
        [f"{name},{head}", *(f"{value},{row}" for row in rows)],
    ):
        with pytest.raises(ju.InputError, match="two values of "):
            read("\n".join(table), "m.csv", home=(8.0, 47.0))


@pytest.mark.parametrize("missing", ["coordinates", "executeHeight>", "Placemark"])
def test_waylines_that_lack_an_element_are_refused(read, missing):
    text = wpml(wayline(30, 40)).replace(missing, missing.replace("e", "o"))
    with pytest.raises(ju.InputError, match=r"lacks its|damaged"):
        read(text)


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    """The worlds and their maps, made once."""
    folder = tmp_path_factory.mktemp("worlds")
    make_maps(folder)
    return folder


@pytest.mark.slow
def test_random_missions_of_apps_keep_the_law(worlds):
    court = Court(worlds, kinds=APPS)
    for number in range(60):
        trial = court.trial(number)
        about = f"mission {number} ({trial.case.kind}): {trial.verdict}"
        assert trial.verdict.state not in ("crashed", "refused"), about
        assert not trial.ruling.false_clean, f"{trial.ruling.false_clean}; {about}"
        assert not trial.ruling.invented, f"{trial.ruling.invented}; {about}"


def test_columns_of_a_track_are_known_by_other_names_and_in_capitals(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text("UTC, Longitude ,LAT\n2020-04-27T16:00:00Z,-74.01,40.71\n")
    (row,) = read_track(path).itertuples()
    assert (row.lon_deg, row.lat_deg) == (-74.01, 40.71)
    path.write_text("utc,lon_deg,lat_deg,LON\n2020-04-27T16:00:00Z,-74.01,40.71,-74.02\n")
    with pytest.raises(ju.InputError, match="two columns lon_deg: keep one"):
        read_track(path)
