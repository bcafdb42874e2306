"""Forms of features in files of zones: each is closed, open, unknown or refused, and none is passed over."""

import gzip
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.legend import Legend

import jaxurban as ju
from jaxurban.errors import IgnoredZoneWarning
from jaxurban.flights.airspace import read_zones
from jaxurban.flights.export.write import FORMATS
from jaxurban.flights.missions.items import read_plan
from jaxurban.flights.missions.parts import GEOD
from jaxurban.flights.report import plot_mission
from jaxurban.io.zone import Zone
from jaxurban.paths.suffixes import FLOWN
from tests.cli_runs import run
from tests.made_files import WGS84, write_vector
from tests.made_maps import made_maps

MAPS = made_maps()
LON, LAT = map(float, MAPS.grid.lonlat_of_cell(75, 95))  # in a corner, where no flight goes
SQUARE = [[[LON + 1e-4 * x, LAT + 1e-4 * y] for x, y in [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]]]
HOLE = [
    [LON + 1e-4 * x, LAT + 1e-4 * y] for x, y in [(0.4, 0.4), (0.6, 0.4), (0.5, 0.6), (0.4, 0.4)]
]
KNOT = [[LON + 1e-4 * x, LAT + 1e-4 * y] for x, y in [(0, 0), (1, 1), (1, 0), (0, 1), (0, 0)]]
JUMP = [[179.9, 0], [-179.9, 0], [-179.9, 1], [179.9, 1], [179.9, 0]]
POLYGON = {"type": "Polygon", "coordinates": SQUARE}
AROUND = GEOD.fwd(*np.broadcast_arrays(LON, LAT, np.arange(0, 361, 10), 10))
DISC = {"type": "Polygon", "coordinates": [np.column_stack(AROUND[:2]).tolist()]}
POINT = {"type": "Point", "coordinates": [LON, LAT]}
LINE = {"type": "LineString", "coordinates": SQUARE[0][:3]}
COLLECTION = {
    "type": "FeatureCollection",
    "features": [
        {"type": "Feature", "properties": {"name": "A"}, "geometry": POLYGON},
    ],
}
MIXED = {"type": "GeometryCollection", "geometries": [POLYGON, POINT]}
ALWAYS = [{"permanent": "YES"}]
LONG_AGO = {"startDateTime": "2001-01-01T00:00:00Z", "endDateTime": "2001-01-02T00:00:00Z"}
OVER = LONG_AGO | {"permanent": True}
REVERSED = [
    {"startDateTime": "2030-01-01T00:00:00Z", "endDateTime": "2020-01-01T00:00:00Z"},
]
CIRCLE = {"type": "Circle", "center": [LON, LAT], "radius": 500}


class Form(NamedTuple):
    """A file of zones, and what becomes of what it holds beside the polygon A."""

    suffix: str
    content: str
    states: dict | str  # of each zone, by name, or words of the refusal


def feature(geometry, name="B", **properties) -> dict:
    return {"type": "Feature", "properties": {"name": name} | properties, "geometry": geometry}


def geojson(*others, states) -> Form:
    """Return the form of features beside A."""
    features = [feature(POLYGON, "A"), *others]
    content = json.dumps({"type": "FeatureCollection", "features": features})
    return Form(
        ".geojson", content, {"A": "closed"} | states if isinstance(states, dict) else states
    )


def of(geometry, states="unknown", **properties) -> Form:
    return geojson(feature(geometry, **properties), states={"B": states})


def kml(inside: str, states) -> Form:
    """Return the form of KML beside A."""
    head = '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>'
    first = f"<Placemark><name>A</name>{AREA}</Placemark>"
    return Form(".kml", f"{head}{first}{inside}</Document></kml>", {"A": "closed"} | states)


def volume(uom="M", zero="AGL", **shape) -> dict:
    zeros = {"lowerVerticalReference": zero, "upperVerticalReference": zero}
    limits = {"lowerLimit": 0, "upperLimit": 400, "uomDimensions": uom} | zeros
    return limits | {"horizontalProjection": POLYGON | shape}


def ed269_zone(name: str, restriction: str, volumes) -> dict:
    about = {"name": name, "identifier": name, "applicability": ALWAYS, "restriction": restriction}
    return about | {"geometry": volumes}


def ed269(geometry, states, restriction="PROHIBITED", **more) -> Form:
    first = ed269_zone("A", "PROHIBITED", [volume()])
    second = ed269_zone("B", restriction, geometry) | more
    states = {"A": "closed"} | states if isinstance(states, dict) else states
    return Form(".json", json.dumps({"features": [first, second]}), states)


def ed318(geometry, states) -> Form:
    layer = {
        "layer": {
            "upper": 100,
            "upperReference": "AGL",
            "lower": 0,
            "lowerReference": "AGL",
            "uom": "m",
        }
    }
    about = {"type": "PROHIBITED"}
    features = [feature(POLYGON | layer, "A", **about), feature(geometry, **about)]
    return Form(".json", json.dumps({"type": "FeatureCollection", "features": features}), states)


CORNERS = " ".join(f"{lon},{lat}" for lon, lat in SQUARE[0])
RING = f"<LinearRing><coordinates>{CORNERS}</coordinates></LinearRing>"
AREA = f"<Polygon><outerBoundaryIs>{RING}</outerBoundaryIs></Polygon>"
SPOT = f"<Point><coordinates>{LON},{LAT}</coordinates></Point>"
TRACK = "<gx:Track>{}</gx:Track>".format(
    "".join(
        f"<when>2020-01-0{k}T00:00:00Z</when><gx:coord>{LON} {LAT} {k}</gx:coord>" for k in (1, 2)
    )
)
SIDES = {"north": LAT + 1e-4, "south": LAT, "east": LON + 1e-4, "west": LON}
OVERLAY = "".join(f"<{side}>{degrees}</{side}>" for side, degrees in SIDES.items())
BOTH = {"B": "closed", "B ": "unknown"}  # its polygon, and the rest
FORMS = {
    "point with a radius": of(POINT, radius=500),
    "line": of(LINE),
    "line that closes": of({"type": "LineString", "coordinates": SQUARE[0]}),
    "points": of({"type": "MultiPoint", "coordinates": SQUARE[0]}),
    "no geometry": of(None),
    "geometry left out": geojson(
        {"type": "Feature", "properties": {"name": "B"}}, states={"B": "unknown"}
    ),
    "circle of another format": of(CIRCLE),
    "collection": geojson(feature(MIXED), states=BOTH),
    "collection in a collection": geojson(
        feature({"type": "GeometryCollection", "geometries": [MIXED]}), states=BOTH
    ),
    "collection with a circle": geojson(
        feature({"type": "GeometryCollection", "geometries": [POLYGON, {"type": "Circle"}]}),
        states=BOTH,
    ),
    "empty collection": of({"type": "GeometryCollection", "geometries": []}),
    "empty polygon": of({"type": "Polygon", "coordinates": []}),
    "empty ring": of({"type": "Polygon", "coordinates": [[]]}),
    "empty polygons": of({"type": "MultiPolygon", "coordinates": []}),
    "shapes beside the features": Form(
        ".geojson",
        json.dumps(COLLECTION | {"exclusions": {"inner": [POLYGON, LINE]}}),
        {"A": "closed", "2 more": "unknown"},
    ),
    "geometries beside the geometry": geojson(
        feature(POLYGON) | {"geometries": [POLYGON]}, states={"B": "closed", "1 more": "unknown"}
    ),
    "geometries in a polygon": geojson(
        feature(POLYGON | {"geometries": [POINT]}), states={"B": "closed", "1 more": "unknown"}
    ),
    "shape in a property": geojson(
        feature(POLYGON, area=POLYGON), states={"B": "closed", "1 more": "unknown"}
    ),
    "shape in a property of its own name": geojson(
        feature(POLYGON, Geometry=POLYGON), states={"B": "closed", "1 more": "unknown"}
    ),
    "polygon with a buffer": geojson(feature(POLYGON, buffer_m=50), states=BOTH),
    "polygon with a margin": geojson(feature(POLYGON, SafetyMargin="50 m"), states=BOTH),
    "polygon with a stand-off": geojson(feature(POLYGON, standoff_m=50), states=BOTH),
    "polygon with a wider radius": geojson(feature(POLYGON, radius_m=5000), states=BOTH),
    "polygon with a radius in words": geojson(feature(POLYGON, radius="wide"), states=BOTH),
    "circle drawn, in nautical miles": of(DISC, "closed", radius=0.0054),
    "circle drawn, in metres": of(DISC, "closed", Radius_M=10),
    "polygon without its buffer": of(POLYGON, "closed", buffer=None),
    "shapes beside the features of ED-269": Form(
        ".json",
        json.dumps(
            {"features": [ed269_zone("A", "PROHIBITED", [volume()])], "others": [POLYGON, POINT]}
        ),
        {"A": "closed", "2 more": "unknown"},
    ),
    "two outer rings": kml(
        f"<Placemark><name>B</name><Polygon><outerBoundaryIs>{RING}</outerBoundaryIs><outerBoundaryIs>{RING}"
        "</outerBoundaryIs></Polygon></Placemark>",
        {"B": "closed", "1 more": "unknown"},
    ),
    "photo with a point": kml(f"<PhotoOverlay>{SPOT}</PhotoOverlay>", {"1 more": "unknown"}),
    "two lists of ED-269": Form(
        ".json",
        json.dumps(
            {
                "features": [ed269_zone("A", "PROHIBITED", [volume()])],
                "UASZoneList": [ed269_zone("B", "PROHIBITED", [volume()])],
            }
        ),
        {"A": "closed", "B": "closed"},
    ),
    "layers in a list": ed318({**POLYGON, "layer": [{}]}, "its layer is no object"),
    "bare geometry among features": geojson(POLYGON, states={"1 more": "unknown"}),
    "two shapes in a placemark": kml(
        f"<Placemark><name>B</name>{AREA}{SPOT}</Placemark>", {"B": "unknown", "1 more": "unknown"}
    ),
    "features in features": geojson(
        {"type": "FeatureCollection", "features": [feature(POLYGON)]}, states={"1 more": "unknown"}
    ),
    "crossing ring": of({"type": "Polygon", "coordinates": [KNOT]}, "closed"),
    "hole": of({"type": "Polygon", "coordinates": [*SQUARE, HOLE]}, "closed"),
    "edge across the antimeridian": of({"type": "Polygon", "coordinates": [JUMP]}, "closed"),
    "polygons": of({"type": "MultiPolygon", "coordinates": [SQUARE]}, "closed"),
    "limits left out": of(POLYGON, "closed", floor_m=None, ceiling_m=""),
    "limits in feet": of(POLYGON, "closed", floor_m=0, ceiling_m=400, unit="ft"),
    "limits of another name": of(POLYGON, "closed", ceiling=400),
    "ring without area": geojson(
        feature({"type": "Polygon", "coordinates": [[[LON, LAT]] * 4]}), states="no area"
    ),
    "ring of two corners": geojson(
        feature({"type": "Polygon", "coordinates": [SQUARE[0][:2]]}), states="cannot be read"
    ),
    "KML: area and point": kml(
        f"<Placemark><name>B</name><MultiGeometry>{AREA}{SPOT}</MultiGeometry></Placemark>", BOTH
    ),
    "KML: areas": kml(
        f"<Placemark><name>B</name><MultiGeometry>{AREA}{AREA}</MultiGeometry></Placemark>",
        {"B": "closed"},
    ),
    "KML: point in a folder": kml(
        f"<Folder><Placemark><name>B</name>{SPOT}</Placemark></Folder>", {"B": "unknown"}
    ),
    "KML: no geometry": kml("<Placemark><name>B</name></Placemark>", {"B": "unknown"}),
    "KML: no geometry in a folder": kml(
        "<Folder><Placemark><name>B</name></Placemark></Folder>", {"B": "unknown"}
    ),
    "KML: track": kml(f"<Placemark><name>B</name>{TRACK}</Placemark>", {"B": "unknown"}),
    "KML: empty area": kml("<Placemark><name>B</name><Polygon/></Placemark>", {"B": "unknown"}),
    "KML: link": kml(
        "<NetworkLink><Link><href>http://localhost/b.kml</href></Link></NetworkLink>",
        {"1 more": "unknown"},
    ),
    "KML: picture": kml(
        f"<GroundOverlay><name>B</name><LatLonBox>{OVERLAY}</LatLonBox></GroundOverlay>",
        {"B": "closed"},
    ),
    "lines of JSON": Form(
        ".geojsonl",
        f"{json.dumps(feature(POLYGON, 'A'))}\n{json.dumps(feature(POINT))}\n",
        {"A": "closed", "B": "unknown"},
    ),
    "damaged line of JSON": Form(
        ".geojsonl",
        f"{json.dumps(feature(POLYGON, 'A'))}\n{json.dumps(feature(POLYGON))[:-9]}\n",
        {"A": "closed", "1 more": "unknown"},
    ),
    "ED-269: two volumes, m and ft": ed269(
        [volume(), volume("FT")], {"B": "closed", "B ": "closed"}
    ),
    "ED-269: above the sea": ed269([volume(zero="AMSL")], {"B": "closed"}),
    "ED-269: another unit beside": ed269([volume(uom="FT") | {"uom": "M"}], {"B": "closed"}),
    "ED-269: ends before it begins": ed269([volume()], {"B": "closed"}, applicability=REVERSED),
    "ED-269: permanent, and over": ed269([volume()], {"B": "closed"}, applicability=[OVER]),
    "ED-269: over, and again": ed269(
        [volume()],
        {"B": "closed"},
        applicability=[OVER | {"permanent": "NO"}],
        limitedApplicability=ALWAYS,
    ),
    "ED-269: prohibited beside for information": ed269(
        [volume()], {"B": "closed"}, "NO_RESTRICTION", type="PROHIBITED"
    ),
    "ED-269: buffer": ed269([volume() | {"buffer": 500}], BOTH),
    "ED-269: circle beside the zones": Form(
        ".json",
        json.dumps(
            {"features": [ed269_zone("A", "PROHIBITED", [volume()])], "more": [{"shape": CIRCLE}]}
        ),
        {"A": "closed", "1 more": "unknown"},
    ),
    "ED-318: polygon with an extent": ed318(
        POLYGON | {"extent": {"subType": "Circle", "radius": 500}}, {"A": "closed"} | BOTH
    ),
    "ED-269: for information": ed269([volume()], {"B": "open"}, "NO_RESTRICTION"),
    "ED-269: no volume": ed269([], "'B' of .*it has no volume"),
    "ED-269: point": ed269([volume(**POINT)], "'B' of .* cannot be read"),
    "ED-318: point without extent": ed318(POINT, "'B' of .*a part is missing"),
    "ED-318: such a point in a collection": ed318(MIXED, "'B' of .*a part is missing"),
    "ED-318: line": ed318(LINE, "'B' of .*a part is missing"),
    "ED-318: no geometry": ed318(None, "'B' of .*a part is missing"),
    "ED-318: empty collection": ed318(
        {"type": "GeometryCollection", "geometries": []}, "'B' of .*it has no volume"
    ),
    "points alone": Form(".geojson", json.dumps(feature(POINT)), "draw a polygon around what is"),
}
READ = {name: form for name, form in FORMS.items() if isinstance(form.states, dict)}
REFUSED = FORMS.keys() - READ.keys()
pytestmark = pytest.mark.filterwarnings(
    "ignore::jaxurban.errors.IgnoredZoneWarning", "ignore::UserWarning"
)


@pytest.fixture
def written(request, tmp_path) -> Path:
    """The file of a form."""
    form = FORMS[request.param]
    file = tmp_path / f"zones{form.suffix}"
    file.write_text(form.content)
    return file


@pytest.fixture(scope="module")
def path():
    """A path that meets no zone of the forms."""
    free = np.argwhere(MAPS.m("roof_touched") == 0)
    ends = [MAPS.grid.lonlat_of_cell(*free[k]) for k in (200, 2000)]
    return ju.plan(MAPS, *ends, altitude_m=60.0, snap=True, on_ground=True)


@pytest.fixture(scope="module")
def mission(path, tmp_path_factory):
    file = tmp_path_factory.mktemp("mission") / "clean.plan"
    path.save(file)
    return read_plan(file.read_bytes(), file.name, None, math.nan)


@pytest.mark.parametrize(("written", "form"), READ.items(), indirect=["written"], ids=READ)
def test_whatever_a_file_holds_has_a_state_which_the_check_and_json_name(written, form, mission):
    zones = read_zones(written)
    assert [(zone.name, zone.state) for zone in zones] == [
        (name.strip(), state) for name, state in form.states.items()
    ]
    result = ju.check(MAPS, mission, constraints=ju.Constraints(zones=zones))
    is_unknown = "unknown" in form.states.values()
    assert result.state == ("not-judged" if is_unknown else "clean")
    told = [text for text in result.not_judged if "what they close is not known" in text]
    assert len(told) == is_unknown
    listed = result.to_dict()["limits"]["no_fly"]
    assert [(each["name"], each["state"]) for each in listed] == [(z.name, z.state) for z in zones]
    for each in listed:
        assert each["state"] == "closed" or each["remarks"]
        if each["state"] == "unknown":
            assert repr(each["name"]) in told[0]
    json.dumps(listed, allow_nan=False)


@pytest.mark.parametrize(
    ("written", "words"),
    [(name, FORMS[name].states) for name in sorted(REFUSED)],
    indirect=["written"],
)
def test_what_cannot_be_read_is_refused_with_its_place(written, words):
    with pytest.raises(ju.InputError, match=words):
        read_zones(written)


@pytest.mark.parametrize("suffix", [".gpkg", ".shp", ".parquet"])
def test_a_feature_without_a_shape_is_unknown_in_every_format(tmp_path, suffix):
    shapes = [shapely.Polygon(SQUARE[0]), None]
    file = write_vector(tmp_path / f"zones{suffix}", shapes, WGS84, name=["A", "B"])
    assert {zone.name: zone.state for zone in read_zones(file)} == {"A": "closed", "B": "unknown"}


def test_an_unknown_zone_keeps_its_place_and_limits_and_how_it_was_closed_wider_is_kept(tmp_path):
    form = geojson(feature(POINT, floor_m=30), feature(POLYGON, "C", top_height=9), states={})
    (tmp_path / "a.geojson").write_text(form.content)
    limits = ju.Constraints.read(tmp_path / "a.geojson")
    _, unknown, wider = limits.to_dict()["no_fly"]
    assert (unknown["place"], unknown["floor_m"]) == ([LON, LAT], 30)
    assert unknown["remarks"] == ["no_area"]
    assert (wider["state"], wider["remarks"]) == ("closed", ["other_limits"])
    assert str(limits).startswith("2 no-fly zones, ")


@pytest.mark.slow
def test_an_unknown_zone_is_drawn_where_it_lies(mission, path, tmp_path):
    lon, lat = path.lonlat[5]
    spot, line = shapely.Point(lon, lat), shapely.LineString(path.lonlat[[3, 9]])
    kept = [Zone(str(k), shape, state="unknown") for k, shape in enumerate((spot, line))]
    result = ju.check(MAPS, mission, constraints=ju.Constraints(zones=tuple(kept)))
    axes = plot_mission(result).axes[0]
    drawn = [each.get_offsets() for each in axes.collections if isinstance(each, PathCollection)]
    assert any(np.allclose(place, path.xy_m[5], atol=0.01) for place in drawn)
    lines = [each for each in axes.collections if isinstance(each, LineCollection)]
    ends = np.array([each.get_segments()[0][[0, -1]] for each in lines if each.get_segments()])
    assert np.isclose(ends, path.xy_m[[3, 9]], atol=0.01).all(axis=(1, 2)).any()
    assert "no-fly zone" in [text.get_text() for text in axes.figure.findobj(Legend)[0].get_texts()]


@pytest.mark.parametrize("suffix", FORMATS)
def test_nothing_that_is_flown_is_written_where_a_zone_is_unknown(path, tmp_path, suffix):
    (tmp_path / "a.geojson").write_text(FORMS["point with a radius"].content)
    zones = read_zones(tmp_path / "a.geojson")
    beside = replace(path, zones=zones)
    file = tmp_path / f"route{suffix}"
    if suffix in FLOWN:
        with pytest.raises(
            ju.InputError, match=r"no mission is written.*'B' of 'a.geojson'.*draw them"
        ):
            beside.save(file)
        with pytest.raises(ju.InputError, match="no mission is written"):
            FORMATS[suffix].encode([("", beside)], None)
        assert not file.exists()
        return
    beside.save(file)
    (properties,) = (each["properties"] for each in json.loads(file.read_text())["features"])
    assert "'B' of 'a.geojson'" in properties["cautions"][0]
    assert properties["settings"] == path.settings


@pytest.mark.slow
def test_the_commands_tell_of_an_unknown_zone_and_write_no_mission(tmp_path, path, capsys):
    folder, clean, zones = MAPS.save(tmp_path / "maps"), tmp_path / "c.plan", tmp_path / "a.geojson"
    path.save(clean)
    zones.write_text(FORMS["line"].content)
    files = [tmp_path / name for name in ("r.plan", "r.kml", "r.gpx", "r.geojson")]
    ends = [f"{lon:.7f},{lat:.7f}" for lon, lat in path.lonlat[[0, -1]]]
    plan = ["plan", folder, f"--start={ends[0]}", f"--goal={ends[1]}", "--altitude=60"]
    code, out, _ = run(capsys, *plan, "--no-fly", zones, "--json")
    planned = json.loads(out)
    assert (code, planned["cautions"][0][:38]) == (0, "1 no-fly zone(s) have no area that is ")
    code, out, _ = run(capsys, *plan, "--no-fly", zones, "--json", *(f"-o{file}" for file in files))
    assert (code, json.loads(out)["message"].count("no mission is written")) == (2, 3)
    assert [file.exists() for file in files] == [False, False, False, True]

    code, out, _ = run(
        capsys, "check", folder, clean, "--no-fly", zones, "--json", "-o", tmp_path / "r"
    )
    checked = json.loads(out)
    assert (code, checked["state"]) == (6, "not-judged")
    for answer in (planned["settings"], checked):
        assert [zone["state"] for zone in answer["limits"]["no_fly"]] == ["closed", "unknown"]
    assert "'B' of 'a.geojson'" in (tmp_path / "r" / "report.md").read_text()


def test_a_zone_that_is_not_in_force_at_the_flight_is_named_as_open(tmp_path, mission):
    form = ed269([volume()], {})
    content = json.loads(form.content)
    content["features"][1]["applicability"] = [
        {"startDateTime": "2026-01-01T00:00:00Z", "endDateTime": "2026-02-01T00:00:00Z"}
    ]
    (tmp_path / "a.json").write_text(json.dumps(content))
    limits = ju.Constraints.read(tmp_path / "a.json")
    time = MAPS.times[0]
    result = ju.check(MAPS, mission, constraints=limits, time=time)
    states = {each["name"]: each["state"] for each in result.to_dict()["limits"]["no_fly"]}
    assert (result.state, states) == ("clean", {"A": "closed", "B": "open"})
    assert (result.figures["num_zones"], result.figures["num_zones_in_force"]) == (2, 1)
    with pytest.warns(IgnoredZoneWarning, match="not in force"):
        planned = limits.at(time).to_dict()["no_fly"]
    assert planned[1]["remarks"] == ["not_in_force"]


def test_packed_zones_are_read_by_their_own_format_and_damaged_ones_refused(tmp_path):
    file = tmp_path / "zones.json.gz"
    packed = gzip.compress(ed269([volume()], {}, "NO_RESTRICTION").content.encode())
    file.write_bytes(packed)
    assert [zone.state for zone in read_zones(file)] == ["closed", "open"]
    file.write_bytes(packed[:-20])
    with pytest.raises(ju.InputError, match="damaged or cut short"):
        read_zones(file)


def test_a_model_of_kml_is_refused_before_gdal_reads_it(tmp_path):
    """GDAL 3.12.4 ends the process with one in a MultiGeometry."""
    inside = "<Placemark><MultiGeometry><Model/></MultiGeometry></Placemark>"
    file = tmp_path / "zones.kml"
    file.write_text(kml(inside, {}).content)
    with pytest.raises(ju.InputError, match="holds a model in three dimensions"):
        read_zones(file)


def test_a_second_column_of_shapes_is_an_unknown_zone(tmp_path):
    near, far = shapely.Polygon(SQUARE[0]), shapely.Polygon(JUMP).centroid.buffer(0.001)
    frame = gpd.GeoDataFrame({"name": ["A"]}, geometry=[near], crs=WGS84)
    frame["other"] = gpd.GeoSeries([far], crs=WGS84)
    frame.to_parquet(tmp_path / "two.parquet")
    states = [zone.state for zone in read_zones(tmp_path / "two.parquet")]
    assert states == ["closed", "unknown"]


def test_a_table_without_shapes_in_a_geopackage_is_an_unknown_zone(tmp_path):
    file = tmp_path / "zones.gpkg"
    shapes = gpd.GeoDataFrame({"name": ["A"]}, geometry=[shapely.Polygon(SQUARE[0])], crs=WGS84)
    shapes.to_file(file, layer="zones")
    circles = pd.DataFrame({"lon": [LON, LON], "lat": [LAT, LAT], "radius_m": [100.0, 50.0]})
    pyogrio.write_dataframe(circles, file, layer="circles", append=True)
    packed = tmp_path / "zones.gpkg.gz"
    packed.write_bytes(gzip.compress(file.read_bytes()))
    for each in (file, packed):
        states = [(zone.name, zone.state) for zone in read_zones(each)]
        assert states == [("A", "closed"), ("2 more", "unknown")]
