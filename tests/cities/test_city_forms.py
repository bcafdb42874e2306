"""One building of 30 m in every way in which CityGML 1 to 3 and CityJSON 1 to 2 may write it: it is never lost."""

import json
from contextlib import suppress

import numpy as np
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.tiles import read_tiles
from tests.cities.test_city_model import (
    X,
    Y,
    block,
    citygml,
    cityjson,
    labelled,
    ring,
    solid,
    stand,
    text_of,
    thing,
    written,
)

TALL, LOW = block(0, 0, 30, 20, 0, 30), block(0, 0, 30, 20, 0, 3)
CORNERS = [corners for _, corners in TALL]
ROOF = ring(0, 0, 30, 20, 30)
MIDDLE = shapely.Point(X + 15, Y + 10)
BESIDE = thing(solid(block(100, 0, 110, 10, 0, 9)))
HREF = 'xlink:href="http://b.org/b.xml#p"'
COORDINATES = "<gml:coordinates>0,0,1 1,0,1 1,1,1 0,0,1</gml:coordinates>"
LINK = '<gml:surfaceMember xlink:href="#p{}"/>'
EDGE = '<gml:curveMember xlink:href="#c"/>'


def gml(name, content, **attributes):
    """Return an element of GML."""
    own = "".join(f' {key.replace("_", ":")}="{value}"' for key, value in attributes.items())
    return f"<gml:{name}{own}>{content}</gml:{name}>"


def face(border, kind="Polygon", side="exterior"):
    return gml(kind, gml(side, border))


def linear(corners):
    return gml("LinearRing", gml("posList", text_of(corners)))


def line(corners, name="LineString"):
    """Return an open line through corners."""
    numbers = " ".join(f"{number:.9g}" for corner in corners for number in corner)
    return gml(name, gml("posList", numbers))


def sides(corners):
    """Return the sides of a ring, each as its two ends."""
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def ring_of(*curves):
    return gml("Ring", "".join(gml("curveMember", curve) for curve in curves))


def positions(corners):
    return [" ".join(map(str, corner)) for corner in [*corners, corners[0]]]


BORDERS = {  # of a face
    "curve member": lambda corners: ring_of(line([*corners, corners[0]])),
    "curve members": lambda corners: ring_of(*map(line, sides(corners))),
    "segments of a curve": lambda corners: ring_of(
        gml("Curve", gml("segments", line([*corners, corners[0]], "LineStringSegment")))
    ),
    "composite curve": lambda corners: ring_of(
        gml("CompositeCurve", "".join(gml("curveMember", line(each)) for each in sides(corners)))
    ),
    "positions": lambda corners: gml(
        "LinearRing", "".join(gml("pos", position) for position in positions(corners))
    ),
    "points": lambda corners: gml(
        "LinearRing",
        "".join(
            gml("pointProperty", gml("Point", gml("pos", position)))
            for position in positions(corners)
        ),
    ),
    "a name": lambda corners: gml(
        "LinearRing", gml("name", "7") + gml("posList", text_of(corners))
    ),
}
SURFACES = {  # of faces
    "patches": lambda faces: gml(
        "Surface", gml("patches", "".join(face(linear(each), "PolygonPatch") for each in faces))
    ),
    "rectangles": lambda faces: gml(
        "Surface", gml("patches", "".join(face(linear(each), "Rectangle") for each in faces))
    ),
    "triangles": lambda faces: gml(
        "TriangulatedSurface",
        gml(
            "trianglePatches",
            "".join(
                face(linear(each), "Triangle")
                for a, b, c, d in faces
                for each in ([a, b, c], [a, c, d])
            ),
        ),
    ),
    "orientable surfaces": lambda faces: gml(
        "CompositeSurface",
        "".join(
            gml(
                "surfaceMember",
                gml("OrientableSurface", gml("baseSurface", face(linear(each))), orientation="-"),
            )
            for each in faces
        ),
    ),
    "GML 2": lambda faces: gml(
        "MultiPolygon",
        "".join(gml("polygonMember", face(linear(each), side="outerBoundaryIs")) for each in faces),
    ),
}


REVERSED = gml("OrientableCurve", gml("baseCurve", line(ROOF)), orientation="-")


def level(name, content):
    return f"<bldg:{name}>{content}</bldg:{name}>"


def surfaces(members, **attributes):
    return gml("MultiSurface", "".join(members), **attributes)


def member(content):
    return gml("surfaceMember", content)


NAMED = [
    member(face(linear(corners)).replace(">", f' gml:id="p{index}">', 1))
    for index, corners in enumerate(CORNERS)
]
LINKS = [LINK.format(i) for i in range(len(CORNERS))]
WALLS = [member(face(linear(corners))) for _, corners in LOW]
PLAN = " ".join(f"{number:.9g}" for corner in [*ROOF, ROOF[1], ROOF[0]] for number in corner[:2])
IN_PLAN = level("lod0FootPrint", surfaces([member(face(gml("LinearRing", gml("posList", PLAN))))]))
TOWER = thing(solid(TALL))
PART = thing(solid(TALL), "BuildingPart")


def within(*names):
    """Return what wraps a building into elements."""
    return lambda content: (
        "".join(f"<{name}>" for name in names)
        + content
        + "".join(f"</{name}>" for name in names[::-1])
    )


STANDS = {  # members of a file
    **{
        f"border: {name}": [
            thing(level("lod2MultiSurface", surfaces([*WALLS, member(face(border(ROOF)))])))
        ]
        for name, border in BORDERS.items()
    },
    **{
        f"surface: {name}": [thing(level("lod2MultiSurface", surfaces([member(surface(CORNERS))])))]
        for name, surface in SURFACES.items()
    },
    "composite solid": [
        thing(
            solid(TALL)
            .replace("<gml:Solid>", "<gml:CompositeSolid><gml:solidMember><gml:Solid>")
            .replace("</gml:Solid>", "</gml:Solid></gml:solidMember></gml:CompositeSolid>")
        )
    ],
    "group": [within("grp:CityObjectGroup", "grp:groupMember")(TOWER)],
    "group of groups": [within(*("grp:CityObjectGroup", "grp:groupMember") * 2)(TOWER)],
    "wrapped": [within("x:Site", "x:holds", "x:Wing", "x:of")(TOWER)],
    "on land": [within("luse:LandUse", "x:carries")(TOWER)],
    "part alone": [PART],
    "kind of building": [thing(solid(TALL), "BuildingWing")],
    "building in a building": [thing(solid(LOW) + within("x:annex")(TOWER))],
    "room below": [
        thing(
            solid(TALL, "lod2Solid")
            + within("bldg:interiorRoom")(thing(solid(LOW, "lod4Solid"), "Room"))
        )
    ],
    "storey below": [
        thing(
            solid(TALL, "lod2Solid")
            + within("bldg:buildingSubdivision")(thing(solid(LOW, "lod3Solid"), "Storey"))
        )
    ],
    "unit": [thing(within("bldg:buildingSubdivision")(thing(solid(TALL), "BuildingUnit")))],
    "constructive element": [
        thing(
            within("bldg:buildingConstructiveElement")(
                thing(solid(TALL), "BuildingConstructiveElement")
            )
        )
    ],
    "CityGML 3": [
        thing(
            labelled(TALL)
            .replace("bldg:boundedBy", "core:boundary")
            .replace("<bldg:", "<con:")
            .replace("</bldg:", "</con:")
        )
    ],
    "property of an extension": [thing(solid(LOW) + within("x:shape")(solid(TALL, "x")))],
    "object of an extension": [within("x:Highrise")(solid(TALL))],
    "bridge": [thing(solid(TALL), "Bridge")],
    "in plan": [thing(IN_PLAN, measuredHeight=30)],
    "in plan as it says": [
        thing(
            IN_PLAN.replace("MultiSurface>", 'MultiSurface srsDimension="2">', 1), measuredHeight=30
        )
    ],
    "parts in plan": [
        thing(
            within("bldg:consistsOfBuildingPart")(
                thing(IN_PLAN, "BuildingPart", measuredHeight=30)
            ),
            measuredHeight=8,
        )
    ],
    "links to a higher level": [
        thing(
            level("lod1MultiSurface", surfaces(LINKS)) + level("lod2MultiSurface", surfaces(NAMED))
        )
    ],
    "links to a lower level": [
        thing(
            level("lod2MultiSurface", surfaces([*WALLS, *LINKS]))
            + level("lod1MultiSurface", surfaces(NAMED))
        )
    ],
    "links forward": [
        thing(level("lod2MultiSurface", surfaces(LINKS))),
        thing(
            level("lod1MultiSurface", surfaces(NAMED)) + level("lod2MultiSurface", surfaces(WALLS))
        ),
    ],
    "links to links": [
        thing('<bldg:lod1MultiSurface xlink:href="#a"/>'),
        thing(
            level("lod1MultiSurface", surfaces(LINKS, gml_id="a"))
            + level("lod2MultiSurface", surfaces(WALLS))
        ),
        thing(
            level("lod1MultiSurface", surfaces(NAMED)) + level("lod2MultiSurface", surfaces(WALLS))
        ),
    ],
}
UNKNOWN = {
    "curves": [
        thing(
            level(
                "lod2MultiCurve",
                gml(
                    "MultiCurve",
                    "".join(gml("curveMember", line([*each, each[0]])) for each in CORNERS),
                ),
            )
        )
    ],
    "curves above faces": [
        thing(
            solid(LOW) + level("lod1MultiCurve", gml("MultiCurve", gml("curveMember", line(ROOF))))
        )
    ],
    "surfaces of another kind": [
        thing(
            level(
                "lod2MultiSurface",
                surfaces([member(gml("FreeSurface", gml("posList", text_of(ROOF))))]),
            )
        )
    ],
    "in plan without a height": [thing(IN_PLAN)],
    "another thing in plan": [thing(IN_PLAN, "GenericCityObject")],
    "curves in plan": [
        thing(
            level("lod0MultiCurve", gml("LineString", gml("posList", PLAN), srsDimension="2")),
            "GenericCityObject",
        )
    ],
}
REFUSED = {
    "refers to 'b.gml#p', and no other file": [
        thing(level("lod2MultiSurface", surfaces(LINK.format("0").replace("#p0", "b.gml#p"))))
    ],
    "refers to 'b.gml#q', and no other file": [
        thing(solid(LOW) + '<bldg:consistsOfBuildingPart xlink:href="b.gml#q"/>')
    ],
    "edges in 'Arc', which is not read": [
        thing(level("lod2MultiSurface", surfaces([member(face(ring_of(line(ROOF, "Arc"))))])))
    ],
    "edges in 'curveMember', which is not read": [
        thing(level("lod2MultiSurface", surfaces([member(face(gml("Ring", EDGE)))])))
    ],
    "edges in 'coordinates', which is not read": [
        thing(level("lod2MultiSurface", surfaces([member(face(COORDINATES))])))
    ],
    "edges in 'OrientableCurve', which is not read": [
        thing(level("lod2MultiSurface", surfaces([member(face(ring_of(REVERSED)))])))
    ],
    "refers to 'http://b.org/b.xml#p'": [gml("x", "").replace(">", f" {HREF}>", 1)],
    "over and over by links": [
        thing(
            level("lod2MultiSurface", surfaces('<gml:surfaceMember xlink:href="#a"/>', gml_id="a"))
        )
    ],
    "damaged": [thing(level("lod2MultiSurface", surfaces(LINKS)))],
}


def reach_m(path):
    """Return how high what covers the middle stands, up to where it may reach, and what was counted."""
    buildings, others, counts = stand(path)
    both = buildings.joined(others)
    covers = shapely.intersects(both.polygons, MIDDLE)
    return both.height_m[covers].max(initial=0), both.upper_m[covers].max(initial=0), counts


def file_of(folder, members):
    """Write members, and a building beside them, as CityGML."""
    return written(folder / "a.gml", citygml(*members, BESIDE))


@pytest.mark.slow
@pytest.mark.parametrize("name", STANDS)
def test_a_building_stands_however_it_is_written(tmp_path, name):
    height_m, _, counts = reach_m(file_of(tmp_path, STANDS[name]))
    assert height_m == pytest.approx(30)
    assert counts.get("unknown_extent", 0) == 0


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_is_not_read_of_a_building_is_unknown_where_it_is(tmp_path, name):
    height_m, upper_m, counts = reach_m(file_of(tmp_path, UNKNOWN[name]))
    assert height_m < 30 < 100 <= upper_m
    assert "polygons_dropped" not in counts


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_other_files_or_arcs_hold_is_refused_by_name(tmp_path, sentence):
    path = file_of(tmp_path, REFUSED[sentence])
    with pytest.raises(ju.InputError, match=sentence) as caught:
        read_tiles(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "member_of_gml", ["gml:member", "gml:members", "gml:featureMember", "x:parcel", "x:a><x:B"]
)
def test_a_building_is_found_outside_the_members_of_citygml_too(tmp_path, member_of_gml):
    outside = within(*member_of_gml.split("><"))(TOWER)
    text = citygml(BESIDE).replace("</core:CityModel>", f"{outside}</core:CityModel>")
    assert reach_m(written(tmp_path / "a.gml", text))[0] == pytest.approx(30)


@pytest.mark.parametrize("spaces", [("core:", ""), ("bldg:", "b-1:"), ("gml:", "g.m:")])
def test_prefixes_say_nothing(tmp_path, spaces):
    text = citygml(*STANDS["links to a higher level"], BESIDE).replace(*spaces)
    assert reach_m(written(tmp_path / "a.gml", text))[0] == pytest.approx(30)


def test_an_object_without_a_shape_reaches_the_warning_and_what_is_left_out(tmp_path):
    path = file_of(tmp_path, [TOWER, thing("", measuredHeight=90)])
    with pytest.warns(ju.GuessWarning, match="1 objects in the file of buildings have no shape"):
        city = ju.City.from_files(path)
    assert city.facts["left out"] == "1 polygons dropped"
    assert reach_m(file_of(tmp_path, [TOWER]))[2] == {"solids": 2}


def test_a_bound_lies_above_all_that_is_not_read(tmp_path):
    tall = [(x, y, z + 150) for x, y, z in ROOF]
    curves = level("lod1MultiCurve", gml("MultiCurve", gml("curveMember", line([*ROOF, *tall]))))
    _, upper_m, _ = reach_m(file_of(tmp_path, [thing(solid(LOW) + curves)]))
    assert upper_m >= 180


# CityJSON.
def document(things):
    """Return CityJSON of the things and of a building beside them."""
    beside = {"beside": ({}, block(100, 0, 110, 10, 0, 9))}
    return cityjson(things | beside)


def geometry_of(kind):
    """Return CityJSON in which the building has another kind of geometry."""
    whole = document({"tower": ({}, TALL)})
    (drawn,) = whole["CityObjects"]["tower"]["geometry"]
    (shell,) = drawn["boundaries"]
    nested = {
        "MultiSurface": shell,
        "CompositeSurface": shell,
        "MultiSolid": [[shell]],
        "CompositeSolid": [[shell]],
        "MultiLineString": [border for (border,) in shell],
        "MultiPoint": [index for (border,) in shell for index in border],
    }
    drawn.update(type=kind, boundaries=nested[kind])
    del drawn["semantics"]
    return whole


def part_of(*parents):
    return {"type": "BuildingPart", "parents": list(parents)}


PARENTS = {
    "each other": {"a": (part_of("b"), TALL), "b": (part_of("a"), LOW)},
    "itself": {"a": (part_of("a"), TALL)},
    "missing": {"a": (part_of("gone"), TALL)},
    "a group first": {
        "group": ({"type": "CityObjectGroup", "children": ["a", "whole"]}, []),
        "a": (part_of("group", "whole"), TALL),
        "whole": ({"parents": ["group"], "children": ["a"]}, LOW),
    },
    "of a room": {"a": ({}, TALL), "room": ({"type": "BuildingRoom", "parents": ["a"]}, LOW)},
    "of another kind": {"a": ({"type": "+Highrise"}, TALL)},
    "a group alone": {"a": ({"type": "CityObjectGroup"}, TALL)},
}


@pytest.mark.parametrize("name", PARENTS)
def test_parts_stand_whatever_they_name_as_parents(tmp_path, name):
    path = written(tmp_path / "a.city.json", json.dumps(document(PARENTS[name])))
    assert reach_m(path)[0] == pytest.approx(30)


@pytest.mark.parametrize(
    "kind", ["MultiSurface", "CompositeSurface", "MultiSolid", "CompositeSolid"]
)
def test_every_geometry_of_faces_stands(tmp_path, kind):
    path = written(tmp_path / "a.city.json", json.dumps(geometry_of(kind)))
    assert reach_m(path)[0] == pytest.approx(30)


def test_lines_are_unknown_and_points_have_no_extent(tmp_path):
    lines = written(tmp_path / "a.city.json", json.dumps(geometry_of("MultiLineString")))
    height_m, upper_m, _ = reach_m(lines)
    assert height_m == 0 < 100 < upper_m
    points = written(tmp_path / "a.city.json", json.dumps(geometry_of("MultiPoint")))
    assert reach_m(points)[2]["polygons_dropped"] == 1


def spoiled(change):
    """Return CityJSON of the building after a change to its geometry."""
    whole = document({"tower": ({}, TALL)})
    change(whole["CityObjects"]["tower"]["geometry"][0])
    return json.dumps(whole)


@pytest.mark.parametrize(
    "change",
    [
        lambda drawn: drawn["semantics"]["values"][0].__setitem__(0, -1),
        lambda drawn: drawn["boundaries"][0][0][0].__setitem__(0, True),
        lambda drawn: drawn.update(type="Tube"),
        lambda drawn: drawn.update(lod="nan"),
    ],
)
def test_damaged_geometry_is_refused_without_words_of_python(tmp_path, change):
    path = written(tmp_path / "a.city.json", spoiled(change))
    with pytest.raises(ju.InputError, match="damaged or cut short, or holds what is not read"):
        read_tiles(path)


@pytest.mark.parametrize("name", [None, 7, [1]])
def test_a_crs_that_is_no_name_is_asked_for(tmp_path, name):
    whole = document({"tower": ({}, TALL)})
    whole["metadata"]["referenceSystem"] = name
    path = written(tmp_path / "a.city.json", json.dumps(whole))
    with pytest.raises(ju.InputError, match="does not say where it lies"):
        read_tiles(path)


def test_features_before_their_header_are_refused(tmp_path):
    feature = cityjson({"a": ({}, TALL)}, "", "CityJSONFeature")
    del feature["transform"]
    lines = [json.dumps(feature), json.dumps(document({}))]
    path = written(tmp_path / "a.city.jsonl", "\n".join(lines))
    with pytest.raises(ju.InputError, match="features before the line of CityJSON"):
        read_tiles(path)
    path.write_text("\n".join(lines[::-1]))
    assert reach_m(path)[0] == pytest.approx(30)


# What may have any size.
def nested_parts(depth):
    return within(*("bldg:consistsOfBuildingPart", "bldg:BuildingPart") * depth)(solid(TALL))


def test_parts_in_parts_are_read_in_time_or_refused(tmp_path):
    path = file_of(tmp_path, [thing(nested_parts(100))])
    assert reach_m(path)[0] == pytest.approx(30)
    with pytest.raises(ju.InputError, match="cannot be read as a city model"):
        read_tiles(file_of(tmp_path, [thing(nested_parts(10_000))]))
    chain = {f"p{index}": (part_of(f"p{index - 1}"), []) for index in range(1, 3000)}
    fan = {f"f{index}": (part_of(*(f"f{k}" for k in range(index))), []) for index in range(100)}
    things = {"p0": ({}, TALL)} | chain | fan
    path = written(tmp_path / "a.city.json", json.dumps(document(things)))
    assert reach_m(path)[0] == pytest.approx(30)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x", "EPSG:", "EPSG" + "." * 99, "ETRS89_UTM3"])
def test_a_crs_of_any_length_is_refused_at_once(tmp_path, name):
    path = written(tmp_path / "a.gml", citygml(TOWER, srs=name * (20_000 // len(name))))
    with pytest.raises(ju.InputError, match="does not say where it lies") as caught:
        read_tiles(path)
    assert len(str(caught.value)) < 3000


def test_a_coordinate_that_is_no_number_is_refused(tmp_path):
    text = citygml(TOWER, BESIDE)
    for lost in ("inf", "NaN"):
        path = written(tmp_path / "a.gml", text.replace(f"{X + 30:.9g}", lost))
        with pytest.raises(ju.InputError, match="lies at inf"):
            read_tiles(path)


def test_mutated_files_are_read_or_refused(tmp_path):
    texts = [citygml(*members, BESIDE) for members in (STANDS | UNKNOWN).values()]
    rng = np.random.default_rng(7)
    names = ["gml:", "exterior", "Solid", "x:", "pos", "Ring"]
    for text in texts:
        start, end = sorted(rng.integers(0, len(text), 2))
        ways = [
            text[:end] + text[start:end] + text[end:],
            text[:start] + text[start + 9 :],
            text.replace(*rng.choice(names, 2)),
        ]
        with suppress(ju.InputError):
            stand(written(tmp_path / "a.gml", rng.choice(ways)))
