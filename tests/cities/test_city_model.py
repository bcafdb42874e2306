"""City models: CityGML and CityJSON stand on the union of their faces, up to their roofs, wherever their CRS says."""

import gzip
import json
import shutil
import time
import warnings
import zipfile
from contextlib import suppress

import geopandas as gpd
import numpy as np
import pyproj
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities import tiles as tiles_module
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.city import lonlat_extent
from jaxurban.cities.osm import read_osm
from jaxurban.cities.tiles import read_tiles
from jaxurban.maps.provenance import hash_inputs
from jaxurban.maps.scenario import Scenario
from jaxurban.world.footprints import HeightOrigin
from tests.cli_runs import run
from tests.io.test_sniff import edited
from tests.made_files import refused

X, Y, Z = 565_000.0, 5_934_000.0, 20.0  # Hamburg, UTM zone 32, and its ground
UTM32 = "EPSG:25832"
ADV = "urn:adv:crs:ETRS89_UTM32*DE_DHHN2016_NH*GCG2016"
LOD2 = "lod2MultiSurface"


def ring(x_min, y_min, x_max, y_max, z):
    """Return the corners of a level rectangle, in metres from the place and its ground."""
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
    return [(X + x, Y + y, Z + z) for x, y in corners]


def block(x_min, y_min, x_max, y_max, low, high):
    """Return the faces of a block as pairs of a label and corners."""
    floor, roof = (ring(x_min, y_min, x_max, y_max, z) for z in (low, high))
    walls = [
        ("WallSurface", [floor[i], floor[i - 1], roof[i - 1], roof[i]]) for i in range(len(floor))
    ]
    return [("GroundSurface", floor), *walls, ("RoofSurface", roof)]


def gable(x_min, y_min, x_max, y_max, eaves, ridge):
    """Return the faces of a house whose ridge runs along y."""
    faces = block(x_min, y_min, x_max, y_max, 0, eaves)[:-1]
    middle = X + (x_min + x_max) / 2
    for x in (x_min, x_max):
        slope = [
            (X + x, Y + y_min, Z + eaves),
            (middle, Y + y_min, Z + ridge),
            (middle, Y + y_max, Z + ridge),
            (X + x, Y + y_max, Z + eaves),
        ]
        faces.append(("RoofSurface", slope))
    return faces


def text_of(corners):
    return " ".join(f"{number:.9g}" for corner in [*corners, corners[0]] for number in corner)


def polygon(corners, *holes):
    """Return a gml:Polygon."""
    rings = [
        f"<gml:{side}><gml:LinearRing><gml:posList>{text_of(each)}</gml:posList></gml:LinearRing></gml:{side}>"
        for side, each in [("exterior", corners), *(("interior", hole) for hole in holes)]
    ]
    return f"<gml:Polygon>{''.join(rings)}</gml:Polygon>"


def labelled(faces, lod=LOD2):
    """Return faces as boundary surfaces of CityGML."""
    return "".join(
        f"<bldg:boundedBy><bldg:{label}><bldg:{lod}><gml:MultiSurface><gml:surfaceMember>{polygon(corners)}"
        f"</gml:surfaceMember></gml:MultiSurface></bldg:{lod}></bldg:{label}></bldg:boundedBy>"
        for label, corners in faces
    )


def solid(faces, lod="lod1Solid"):
    """Return faces as a solid without labels."""
    members = "".join(
        f"<gml:surfaceMember>{polygon(corners)}</gml:surfaceMember>" for _, corners in faces
    )
    return (
        f"<bldg:{lod}><gml:Solid><gml:exterior><gml:CompositeSurface>{members}"
        f"</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:{lod}>"
    )


def thing(content, kind="Building", **values):
    """Return an object with values of its own, and whatever it holds."""
    own = "".join(f"<bldg:{name}>{value}</bldg:{name}>" for name, value in values.items())
    return f"<bldg:{kind}>{own}{content}</bldg:{kind}>"


def part(content, holder="consistsOfBuildingPart", kind="BuildingPart"):
    return f"<bldg:{holder}>{thing(content, kind)}</bldg:{holder}>"


def citygml(*things, srs=ADV):
    """Return a file of CityGML."""
    declared = f'<gml:boundedBy><gml:Envelope srsName="{srs}"/></gml:boundedBy>' if srs else ""
    members = "".join(f"<core:cityObjectMember>{each}</core:cityObjectMember>" for each in things)
    spaces = " ".join(f'xmlns:{name}="urn:{name}"' for name in ("core", "bldg", "gml"))
    return f'<?xml version="1.0"?>\n<core:CityModel {spaces}>{declared}{members}</core:CityModel>'


def cityjson(things, srs="https://www.opengis.net/def/crs/EPSG/0/25832", kind="CityJSON"):
    """Return a document of CityJSON, in millimetres from the place, of pairs of facts and labelled faces by name."""
    vertices, objects = [], {}
    for name, (facts, faces) in things.items():
        shell = []
        for _, corners in faces:
            shell.append([[*range(len(vertices), len(vertices) + len(corners))]])
            vertices += np.rint((np.array(corners) - (X, Y, 0)) * 1000).astype(int).tolist()
        labels = [label for label, _ in faces]
        semantics = {
            "surfaces": [{"type": each} for each in labels],
            "values": [[*range(len(labels))]],
        }
        drawn = {"type": "Solid", "lod": "2.2", "boundaries": [shell], "semantics": semantics}
        objects[name] = {"type": "Building", **facts, "geometry": [drawn] if faces else []}
    document = {"type": kind, "version": "2.0", "CityObjects": objects, "vertices": vertices}
    document["transform"] = {"scale": [0.001] * 3, "translate": [X, Y, 0]}
    if srs:
        document["metadata"] = {"referenceSystem": srs}
    return document


HOUSE = gable(0, 0, 10, 12, 6, 9)
TOWER = block(20, 0, 40, 20, 0, 12) + block(25, 5, 35, 15, 12, 60)


def stand(path, crs=None):
    """Return the buildings of a source in UTM, the other structures, and what was counted."""
    outlines = read_tiles(path, crs=crs)
    buildings, others, _, issues, _ = to_buildings(ju.Buildings(path), outlines, UTM32)
    return buildings, others, {str(name): num for name, num in issues.items() if num}


def area_from(buildings, height_m):
    """Return the area in plan of what is at least so high."""
    return shapely.union_all(buildings.polygons[buildings.height_m > height_m - 0.01]).area


def written(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.fixture
def files(tmp_path):
    """The house and the tower on its podium, in every way in which they are published."""
    things = {"house": ({}, HOUSE), "tower": ({}, TOWER)}
    whole = citygml(thing(labelled(HOUSE)), thing(labelled(TOWER)))
    lines = [cityjson({})] + [
        cityjson({name: each}, "", "CityJSONFeature") for name, each in things.items()
    ]
    sequence = "".join(json.dumps(line) + "\n" for line in lines)
    contents = {
        "a.gml": whole,
        "a.xml.gz": gzip.compress(whole.encode()),
        "a.citygml": whole.replace(
            "<bldg:Building>", "<bldg:Building><energy:isHeated>1</energy:isHeated>"
        ),
        "solids.gml": citygml(thing(solid(HOUSE, "lod2Solid")), thing(solid(TOWER, "lod2Solid"))),
        "a.json": json.dumps(cityjson(things), indent=1),
        "a.city.json.gz": gzip.compress(json.dumps(cityjson(things)).encode()),
        "a.city.jsonl": sequence,
        "b.gz": gzip.compress(sequence.encode()),
    }
    return [written(tmp_path / name, content) for name, content in contents.items()]


def test_every_format_stands_on_the_union_of_its_faces(files):
    for path in files:
        buildings, _, counts = stand(path)
        assert counts == {"solids": 2}, path.name
        assert area_from(buildings, 0) == pytest.approx(120 + 400, rel=1e-6), path.name
        assert area_from(buildings, 9) == pytest.approx(120 + 400, rel=1e-6)
        assert area_from(buildings, 12) == pytest.approx(400, rel=1e-6)
        assert area_from(buildings, 60) == pytest.approx(100, rel=1e-6)
        assert buildings.height_m.max() == pytest.approx(60, abs=1e-3)


def test_info_counts_bodies_and_says_where_they_stand(files, capsys):
    for path in files[:1] + files[-2:]:
        code, out, _ = run(capsys, "info", path)
        assert code == 0
        assert "prisms of 2 solids on their lowest vertices" in out
    city = ju.City.from_files(files[0])
    assert area_from(city.buildings, 60) == pytest.approx(100, rel=2e-3)  # in the next zone or not


def test_labels_decide_what_is_a_roof(tmp_path):
    # Ground that slopes by 3 m, which the roof covers in part alone, is no roof of 3 m.
    ground = [(X, Y, Z), (X + 30, Y, Z + 3), (X + 30, Y + 10, Z + 3), (X, Y + 10, Z)]
    faces = [("GroundSurface", ground), ("RoofSurface", ring(0, 0, 20, 10, 15))]
    buildings, _, _ = stand(written(tmp_path / "a.gml", citygml(thing(labelled(faces)))))
    assert area_from(buildings, 15) == pytest.approx(300)


def test_the_highest_level_with_roofs_counts(tmp_path):
    lod1 = solid(block(0, 0, 10, 12, 0, 7))
    walls_alone = labelled(HOUSE[1:5], "lod3MultiSurface")
    template = (
        "<bldg:lod4ImplicitRepresentation><core:ImplicitGeometry><core:relativeGMLGeometry>"
        + polygon(ring(0, 0, 1, 1, 500))
        + "</core:relativeGMLGeometry></core:ImplicitGeometry></bldg:lod4ImplicitRepresentation>"
    )
    for content, height_m in ((lod1, 7), (lod1 + labelled(HOUSE) + walls_alone + template, 9)):
        buildings, _, _ = stand(written(tmp_path / "a.gml", citygml(thing(content))))
        assert buildings.height_m.max() == pytest.approx(height_m)
        assert area_from(buildings, 0) == pytest.approx(120)


def drawn(*heights_m, x=0):
    """Return LOD1, LOD2 and so on of one house, each as high as it says."""
    levels = [block(x, 0, x + 10, 12, 0, height_m) for height_m in heights_m]
    return solid(levels[0]) + "".join(
        labelled(faces, f"lod{number}MultiSurface") for number, faces in enumerate(levels[1:], 2)
    )


@pytest.mark.parametrize(
    ("content", "height_m", "num_coarse"),
    [
        (drawn(30, 3), 30, 1),
        (drawn(30, 27), 27, 0),  # near
        (drawn(12, 30), 30, 0),
        (drawn(9, 30, 8), 30, 1),  # LOD2 of three
        (drawn(30) + part(labelled(block(0, 0, 10, 12, 0, 8))), 30, 1),  # a whole over its parts
        (part(drawn(30, 3)) + part(drawn(9, 40, x=20)), 30, 1),  # of one part of two
        (part(drawn(20, 20)) + part(drawn(20, 18, x=20)), 20, 0),
    ],
)
def test_a_coarser_solid_that_is_higher_counts_and_is_said(tmp_path, content, height_m, num_coarse):
    path = written(tmp_path / "a.gml", citygml(thing(content)))
    buildings, _, counts = stand(path)
    is_first = shapely.intersects(buildings.polygons, shapely.box(X + 1, Y + 1, X + 9, Y + 11))
    assert buildings.height_m[is_first].max() == pytest.approx(height_m)
    assert counts.get("solids_coarse", 0) == num_coarse
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ju.City.from_files(path)
    assert sum("more than 3 m lower" in str(each.message) for each in caught) == num_coarse


@pytest.mark.parametrize(
    ("measured_m", "height_m", "num_coarse"),
    [(30, 30, 1), (15, 12, 0), (3, 12, 0), (-9999, 12, 0), (5000, 12, 0)],
)
def test_a_measured_height_that_is_higher_than_the_solid_counts_and_is_said(
    tmp_path, measured_m, height_m, num_coarse
):
    path = written(tmp_path / "a.gml", citygml(thing(drawn(12), measuredHeight=measured_m)))
    buildings, _, counts = stand(path)
    assert buildings.height_m.tolist() == [height_m]
    assert counts.get("solids_coarse", 0) == num_coarse


def test_of_the_levels_of_cityjson_the_higher_counts(tmp_path):
    document = cityjson({"house": ({}, block(0, 0, 10, 12, 0, 3))})
    coarse = cityjson({"house": ({}, block(0, 0, 10, 12, 0, 30))})
    first = len(document["vertices"])
    document["vertices"] += coarse["vertices"]
    (drawn_coarse,) = coarse["CityObjects"]["house"]["geometry"]
    shells = [
        [[[index + first for index in ring] for ring in face] for face in shell]
        for shell in drawn_coarse["boundaries"]
    ]
    geometry = document["CityObjects"]["house"]["geometry"]
    geometry.append(drawn_coarse | {"lod": "1.2", "boundaries": shells})
    buildings, _, counts = stand(written(tmp_path / "a.json", json.dumps(document)))
    assert buildings.height_m.max() == pytest.approx(30)
    assert counts["solids_coarse"] == 1


def test_a_footprint_has_the_measured_height_or_levels(tmp_path):
    plan = (
        "<bldg:lod0FootPrint>"
        + polygon(ring(0, 0, 10, 10, 0), ring(4, 4, 6, 6, 0))
        + "</bldg:lod0FootPrint>"
    )
    for values, height_m, origin in (
        ({"measuredHeight": 14.5, "storeysAboveGround": 2}, 14.5, HeightOrigin.HEIGHT),
        ({"storeysAboveGround": 4}, 12, HeightOrigin.LEVELS),
        ({"measuredHeight": -9999}, 6.4, HeightOrigin.DEFAULT),
    ):
        buildings, _, _ = stand(written(tmp_path / "a.gml", citygml(thing(plan, **values))))
        assert (buildings.height_m[0], buildings.origin[0]) == (height_m, origin)
        assert area_from(buildings, 0) == pytest.approx(96)


@pytest.mark.parametrize(
    ("source", "origin"), [("1000", HeightOrigin.HEIGHT), ("3000", HeightOrigin.ESTIMATED)]
)
def test_an_attribute_of_a_model_says_how_its_heights_are_known(tmp_path, source, origin):
    said = f'<gen:stringAttribute name="DatenquelleDachhoehe"><gen:value>{source}</gen:value></gen:stringAttribute>'
    text = citygml(thing(said + labelled(HOUSE), measuredHeight=9)).replace(
        "xmlns:gml", 'xmlns:gen="urn:gen" xmlns:gml'
    )
    facts = {"attributes": {"measuredHeight": 9, "DatenquelleDachhoehe": source}}
    document = json.dumps(cityjson({"house": (facts, HOUSE)}))
    for name, content in (("a.gml", text), ("a.json", document)):
        buildings, _, _ = stand(written(tmp_path / name, content))
        assert {*buildings.origin} == {origin}
        assert buildings.height_m.max() == pytest.approx(9)


@pytest.mark.parametrize(
    ("unit", "height_m"),
    [
        *((unit, 20) for unit in ("m", "#m", "urn:adv:uom:m", "urn:ogc:def:uom:EPSG::9001")),
        *((unit, 6.096) for unit in ("ft", "feet", "urn:ogc:def:uom:UCUM::[ft_i]")),
        ("cm", None),
        ("urn:ogc:def:uom:EPSG::9002", None),
    ],
)
def test_measured_heights_have_their_units(tmp_path, unit, height_m):
    plan = f"<bldg:lod0FootPrint>{polygon(ring(0, 0, 10, 10, 0))}</bldg:lod0FootPrint>"
    text = citygml(thing(plan, measuredHeight=20)).replace("Height>", f'Height uom="{unit}">', 1)
    buildings, _, counts = stand(written(tmp_path / "a.gml", text))
    if height_m is None:
        assert buildings.origin[0] != HeightOrigin.HEIGHT
        assert counts["heights_unusable"] == 1
    else:
        assert buildings.height_m[0] == pytest.approx(height_m)


def test_parts_replace_a_coarser_whole_and_stand_on_its_ground(tmp_path):
    podium, tower = block(0, 0, 30, 30, 0, 8), block(10, 10, 20, 20, 8, 40)
    coarse = solid(block(0, 0, 30, 30, 0, 40))
    gml = thing(coarse + part(labelled(podium)) + part(labelled(tower)))
    chimney = block(2, 2, 4, 4, 5, 15)
    gml_whole = thing(
        labelled(podium)
        + part(
            labelled(chimney, "lod3MultiSurface"),
            "outerBuildingInstallation",
            "BuildingInstallation",
        )
    )
    document = cityjson(
        {
            "tower": ({"type": "BuildingPart", "parents": ["whole", "group"]}, tower),
            "podium": ({"type": "BuildingPart", "parents": ["whole"]}, podium),
            "whole": ({"parents": ["group"], "children": ["tower", "podium"]}, []),
            "group": ({"type": "CityObjectGroup", "children": ["whole"]}, []),
        }
    )
    for name, content in (("a.gml", citygml(gml)), ("a.json", json.dumps(document))):
        buildings, _, counts = stand(written(tmp_path / name, content))
        assert counts["solids"] == 1
        assert area_from(buildings, 0) == pytest.approx(900)
        assert area_from(buildings, 9) == area_from(buildings, 40) == pytest.approx(100)
    buildings, _, _ = stand(written(tmp_path / "a.gml", citygml(gml_whole)))
    assert (area_from(buildings, 8), area_from(buildings, 15)) == pytest.approx((900, 4))


def test_what_is_no_building_stands_or_is_counted(tmp_path):
    relief = [("TIN", [(X, Y, Z), (X + 90, Y, Z + 40), (X + 90, Y + 90, Z)])]
    things = {
        "house": ({}, HOUSE),
        "hill": ({"type": "TINRelief"}, relief),
        "road": ({"type": "Road"}, [("Road", ring(0, 50, 90, 60, 0))]),
        "stack": ({"type": "OtherConstruction"}, block(60, 0, 64, 4, 0, 50)),
        "bench": ({"type": "CityFurniture"}, block(70, 0, 71, 1, 0, 1)),
        "bridge": ({"type": "Bridge"}, block(80, 0, 90, 40, 5, 12)),
        "tunnel": ({"type": "Tunnel"}, block(80, 50, 90, 90, -9, -2)),
        "lime": ({"type": "SolitaryVegetationObject"}, block(70, 20, 76, 26, 0, 18)),
        "empty": ({}, []),
    }
    buildings, others, counts = stand(written(tmp_path / "a.json", json.dumps(cityjson(things))))
    assert area_from(buildings, 0) == pytest.approx(120)
    highest = {}
    for kind, height_m in zip(others.kinds, others.height_m, strict=True):
        highest[kind] = max(height_m, highest.get(kind, 0))
    assert highest == pytest.approx({"structure": 50, "bridge": 7, "tree": 18})
    assert counts["not_standing"] == 3
    assert counts["underground"] == 1
    assert counts["polygons_dropped"] == 1


@pytest.mark.parametrize("lost", ["NaN", "-2147483", "1e9", "inf"])
def test_a_height_that_is_lost_bounds_nothing(tmp_path, lost):
    text = citygml(thing(labelled(HOUSE)), thing(labelled(block(50, 0, 60, 10, 0, 5))))
    roof = text_of(HOUSE[-1][1])
    spoiled = roof.replace(" 26 ", f" {lost} ").replace(" 29 ", f" {lost} ")
    assert roof != spoiled
    buildings, _, counts = stand(written(tmp_path / "a.gml", text.replace(roof, spoiled)))
    is_near = shapely.intersects(buildings.polygons, shapely.box(X, Y, X + 10, Y + 12))
    assert not np.isfinite(buildings.limit_m[is_near]).all()
    assert (buildings.height_m[~is_near] == 5).all()
    assert buildings.height_m.max() < 100
    assert counts["heights_unusable"] >= 1


def moved(corners, crs):
    """Return corners in another CRS, in the order of its axes."""
    to = pyproj.Transformer.from_crs(UTM32, crs)
    return [(*to.transform(x, y), z) for x, y, z in corners]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("srs", "crs", "is_asked"),
    [
        (ADV, UTM32, False),
        ("urn:adv:crs:DE_DHDN_3GK3_NI200*DE_DHHN92_NH", "EPSG:31467", False),
        ("urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::5783", UTM32, False),
        ("urn:ogc:def:crs:EPSG:6.12:3068", None, True),
        ("EPSG:2056", None, True),
        ("http://www.opengis.net/def/crs/EPSG/0/4258", "EPSG:4258", False),
        ("EPSG:25832", UTM32, False),
        ("somewhere", None, True),
        ("", None, True),
    ],
)
def test_names_of_crs_place_a_file_or_are_asked_for(tmp_path, srs, crs, is_asked):
    if is_asked:
        path = written(tmp_path / "a.gml", citygml(thing(labelled(HOUSE)), srs=srs))
        if "EPSG" in srs:  # made for Berlin and for Switzerland
            refused(read_tiles, path, None, r"far from the area .*ju\.Buildings\(crs")
        else:
            refused(read_tiles, path, None, r'set ju\.Buildings\(crs="EPSG')
        assert area_from(stand(path, UTM32)[0], 0) == pytest.approx(120)
        city = ju.City.from_files(ju.Buildings(path, crs=UTM32))
        assert len(city.buildings) == 1
        return
    # Gauß and Krüger's eastings come first in files, whatever the CRS says.
    faces = [(label, moved(corners, crs)) for label, corners in HOUSE]
    if crs == "EPSG:31467":
        faces = [(label, [(y, x, z) for x, y, z in corners]) for label, corners in faces]
    path = written(tmp_path / "a.gml", citygml(thing(labelled(faces)), srs=srs))
    west, south, east, north = lonlat_extent(path)
    lat, lon = pyproj.Transformer.from_crs(UTM32, "EPSG:4326").transform(X + 5, Y + 6)
    assert west < lon < east
    assert south < lat < north


@pytest.mark.parametrize(
    ("srs", "lonlat", "orders"),
    [
        # Of coordinates that lie in the area of their CRS in one order alone, each order comes right.
        ("http://www.opengis.net/def/crs/EPSG/0/6697", (139.76, 35.68), "yx xy"),
        ("EPSG:31467", (9.9, 53.5), "yx xy"),
        ("urn:ogc:def:crs:EPSG::4979", (139.76, 35.68), "yx xy"),
        ("EPSG:4269", (-122.4, 37.8), "yx xy"),
        (ADV, (9.9, 53.5), "yx xy"),
        # Others are in the order of a CRS that a URN or a URL names, and of degrees.
        ("urn:ogc:def:crs:EPSG::6677", (139.76, 35.68), "yx"),
        ("http://www.opengis.net/def/crs/EPSG/0/3035", (10.0, 53.5), "yx"),
        ("EPSG:6677", (139.76, 35.68), "xy"),
        ("EPSG:4326", (9.9, 53.5), "yx"),
    ],
)
def test_axes_are_in_the_order_that_lies_where_the_crs_is_made_for(tmp_path, srs, lonlat, orders):
    code = {ADV: UTM32}.get(srs, f"EPSG:{srs[-4:] if srs != 'EPSG:31467' else 31467}")
    east, north = pyproj.Transformer.from_crs("EPSG:4326", code, always_xy=True).transform(*lonlat)
    scale = 1e-5 if pyproj.CRS(code).is_geographic else 1
    for order in orders.split():
        faces = []
        for label, corners in HOUSE:
            moved_to = [(east + (x - X) * scale, north + (y - Y) * scale, z) for x, y, z in corners]
            faces.append(
                (label, [(*xyz[:2][:: 1 if order == "xy" else -1], xyz[2]) for xyz in moved_to])
            )
        path = written(tmp_path / "a.gml", citygml(thing(labelled(faces)), srs=srs))
        assert lonlat_extent(path)[:2] == pytest.approx(lonlat, abs=2e-3), order


@pytest.mark.parametrize(("name", "crs"), [("CH1903", "EPSG:21781"), ("CH1903+", "EPSG:2056")])
def test_swiss_names_without_codes_are_known(tmp_path, name, crs):
    bern = pyproj.Transformer.from_crs("EPSG:4326", crs).transform(46.95, 7.44)
    faces = [
        (label, [(x - X + bern[0], y - Y + bern[1], z) for x, y, z in face])
        for label, face in HOUSE
    ]
    path = written(tmp_path / "a.gml", citygml(thing(labelled(faces)), srs=name))
    assert lonlat_extent(path)[:2] == pytest.approx((7.44, 46.95), abs=1e-3)


def test_a_region_elsewhere_is_refused_with_where_the_file_lies(tmp_path):
    path = written(tmp_path / "a.gml", citygml(thing(labelled(HOUSE))))
    with pytest.raises(ju.InputError, match=r"covers about 9\.9\d+, 53\.5"):
        ju.City.from_files(path, bounds=(16.34, 48.20, 16.35, 48.21))


def test_settings_replace_a_wrong_crs_in_a_scenario_without_bounds(tmp_path):
    written(tmp_path / "a.gml", citygml(thing(labelled(HOUSE)), srs=""))
    settings = {"buildings": {"source": "a.gml", "crs": UTM32}}
    scenario = Scenario.from_dict(settings, folder=tmp_path)
    assert scenario.region.bounds[:2] == pytest.approx((9.98, 53.55), abs=0.02)


def test_crs_is_for_outlines_alone(tmp_path):
    path = written(tmp_path / "a.geojson", "{}")
    with pytest.raises(ju.InputError, match="crs 'nowhere' is not a known CRS"):
        ju.City.from_files(ju.Buildings(path, crs="nowhere"))
    osm = written(
        tmp_path / "a.osm",
        '<osm version="0.6"><bounds minlat="53" minlon="9" maxlat="54" maxlon="10"/></osm>',
    )
    with pytest.raises(ju.InputError, match=r"crs=\.\.\.\) is for outlines"):
        ju.City.from_files(ju.Buildings(osm, crs=UTM32), bounds=(9.4, 53.4, 9.5, 53.5))


def test_crs_of_settings_is_that_of_outlines_without_one(tmp_path):
    box = shapely.box(X, Y, X + 10, Y + 10)
    with pytest.warns(UserWarning, match="'crs' was not provided"):
        gpd.GeoDataFrame({"height": [9.0]}, geometry=[box]).to_file(tmp_path / "a.gpkg")
    with pytest.raises(ju.InputError, match=r"declares no CRS.*ju\.Buildings\(crs"):
        ju.City.from_files(tmp_path / "a.gpkg")
    city = ju.City.from_files(ju.Buildings(tmp_path / "a.gpkg", crs=UTM32))
    assert city.bounds[:2] == pytest.approx((9.98, 53.55), abs=0.02)


def folder_of_tiles(folder):
    """Write a folder of tiles: one within an archive in it, and files that are none."""
    (folder / "bldg").mkdir(parents=True)
    tower = citygml(thing(labelled(TOWER)))
    written(folder / "bldg" / "house.gml", citygml(thing(labelled(HOUSE))))
    with zipfile.ZipFile(folder / "bldg" / "tower.zip", "w") as archive:
        archive.writestr("../../tower.gml", tower)
        archive.writestr("__MACOSX/._tower.gml", b"\0")
    written(folder / "codelists.xml", "<dictionary/>")
    written(folder / ".house.gml", "<CityModel")
    return folder


def test_tiles_in_folders_and_archives_are_joined(tmp_path, capsys):
    folder = folder_of_tiles(tmp_path / "town")
    packed = tmp_path / "town.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in folder.rglob("*.*"):
            if file.is_file():
                archive.write(file, f"udx/{file.relative_to(folder)}")
    for source in (folder, packed):
        with pytest.warns(ju.GuessWarning, match="1 files .*codelists.xml.* hold no city model"):
            buildings, _, counts = stand(source)
        assert counts == {"solids": 2}
        assert area_from(buildings, 0) == pytest.approx(520)
        assert area_from(buildings, 60) == pytest.approx(100)
        code, out, _ = run(capsys, "info", source)
        assert (code, "prisms of 2 solids on their lowest vertices" in out) == (0, True)
        city = ju.City.from_files(ju.Buildings(source))
        assert area_from(city.buildings, 60) == pytest.approx(100, rel=2e-3)
    assert not list(tmp_path.rglob("tower.gml"))


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("b.gml", citygml(thing("")).encode("utf-16"), "text in UTF-16: make UTF-8 of it"),
        (
            "b.gml",
            b"<!DOCTYPE a [<!ENTITY b 'c'>]>\n<CityModel/>",
            "a DOCTYPE, which is never read",
        ),
        ("b.gml.gz", gzip.compress(citygml(thing("")).encode())[:-30], "cannot be read as a file"),
        ("b.zip", b"PK\x03\x04" + bytes(99), "an archive that is damaged: fetch it again"),
        ("b.tar", bytes(257) + b"ustar" + bytes(250), "an archive: unpack it with `tar -xf"),
        ("b.7z", b"7z\xbc\xaf\x27\x1c", "an archive: unpack it with `7z x"),
        ("b.gml", b"<html>Not found</html>", "a web page: fetch the file again"),
    ],
)
def test_tiles_that_cannot_be_read_are_refused_in_company_too(tmp_path, name, content, sentence):
    folder = tmp_path / "town"
    folder.mkdir()
    written(folder / "a.gml", citygml(thing(labelled(HOUSE))))
    refused(read_tiles, folder / name, content, sentence)
    shutil.make_archive(str(tmp_path / "town"), "zip", folder)
    for source in (folder, tmp_path / "town.zip"):
        with pytest.raises(ju.InputError, match=sentence) as caught:
            read_tiles(source)
        assert f"{source}/{name}" in str(caught.value)
        assert "jaxurban-" not in str(caught.value)
    # Pages about tiles may stand beside them.
    (folder / name).rename(folder / "read me.html")
    with pytest.warns(ju.GuessWarning, match=r"1 files .*read me.* hold no city model"):
        assert area_from(stand(folder)[0], 0) == pytest.approx(120)


def test_files_of_one_table_in_folders_and_archives_are_read_once(tmp_path):
    floor = [shapely.box(X, Y, X + 10, Y + 10), shapely.box(X + 20, Y, X + 30, Y + 10)]
    frame = gpd.GeoDataFrame({"height": [8.0, 9.0]}, geometry=floor, crs=UTM32)
    (tmp_path / "shape").mkdir()
    frame.to_file(tmp_path / "shape" / "town.SHP", driver="ESRI Shapefile")
    (tmp_path / "esri").mkdir()
    frame.to_file(tmp_path / "esri" / "town.gdb", driver="OpenFileGDB")
    for name in ("shape", "esri"):
        shutil.make_archive(str(tmp_path / name), "zip", tmp_path / name)
    (tmp_path / "packed").mkdir()
    shutil.copy(tmp_path / "esri.zip", tmp_path / "packed" / "town.gdb.zip")
    for source in ("shape", "shape.zip", "esri", "esri.zip", "packed"):
        with warnings.catch_warnings():
            warnings.simplefilter("error", ju.GuessWarning)
            buildings, _, _ = stand(tmp_path / source)
        assert sorted(buildings.height_m) == [8, 9], source


def test_members_of_gml_alone_stand_too(tmp_path):
    text = citygml(thing(labelled(HOUSE)), thing(labelled(TOWER)))
    for name in ("gml:featureMember", "gml:featureMembers"):
        head, _, tail = text.rpartition("<core:cityObjectMember>")
        last = tail.replace("core:cityObjectMember", name)
        buildings, _, counts = stand(written(tmp_path / "a.gml", f"{head}<{name}>{last}"))
        assert counts == {"solids": 2}
        assert area_from(buildings, 0) == pytest.approx(520)


def test_a_folder_is_named_in_provenance_by_names_and_contents(tmp_path):
    folder = folder_of_tiles(tmp_path / "town")
    settings = {"buildings": {"source": "town"}, "region": {"bounds": [9.9, 53.5, 10.0, 53.6]}}
    scenario = Scenario.from_dict(settings, folder=tmp_path)
    sums = [hash_inputs(scenario)["buildings"]["sha256"]]
    house = folder / "bldg" / "house.gml"
    house.rename(house.with_name("home.gml"))
    sums.append(hash_inputs(scenario)["buildings"]["sha256"])
    house.with_name("home.gml").write_text(citygml(thing(labelled(TOWER))))
    sums.append(hash_inputs(scenario)["buildings"]["sha256"])
    assert len({*sums}) == 3


def test_what_cannot_be_joined_is_refused(tmp_path, monkeypatch):
    folder = tmp_path / "town"
    folder.mkdir()
    with pytest.raises(ju.InputError, match="is empty: name the file of buildings"):
        ju.City.from_files(folder)
    written(folder / "a.gml", citygml(thing(labelled(HOUSE))))
    written(folder / "b.gml", citygml(thing(labelled(HOUSE)), srs="EPSG:25833"))
    # One CRS for all would move the others, so that settings do not mend it.
    with pytest.raises(
        ju.InputError, match=r"declares several CRSs, .*25833, .*into a folder of its"
    ):
        ju.City.from_files(folder)
    written(folder / "b.gml", citygml(thing(labelled(HOUSE)))[:-40])
    with pytest.raises(ju.InputError, match=r"town/b\.gml' cannot be read as a city model"):
        ju.City.from_files(folder)
    bomb = tmp_path / "a.zip"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.gml", bytes(2_000_000))
    monkeypatch.setattr(tiles_module, "MOST_UNPACKED", 2**20)
    with pytest.raises(ju.InputError, match="unpack it yourself if you trust it"):
        list(tiles_module._files(bomb, "a.zip", 2**20))


def test_an_archive_of_many_empty_files_is_refused_for_their_number(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for number in range(4000):
            archive.writestr(f"{number}.gml", b"")
    with pytest.raises(ju.InputError, match="with 16 kB for each of its 4,000 files"):
        read_tiles(tmp_path / "a.zip")


ENTITY = '<!DOCTYPE a SYSTEM "http://127.0.0.1:9/a.dtd">'


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("565000 ", "5650x0 ", 1),
        lambda text: text.replace("565000 5934000 20 ", "565000 5934000 ", 1),
        lambda text: text.replace("<core:cityObjectMember>", "", 1),
    ],
)
def test_damaged_citygml_is_refused_in_one_sentence(tmp_path, spoil):
    text = citygml(thing(labelled(HOUSE)))
    assert spoil(text) != text
    refused(read_tiles, tmp_path / "a.gml", spoil(text).encode(), "cannot be read as a city model")


def test_a_doctype_is_refused(tmp_path):
    text = citygml(thing(labelled(HOUSE))).replace("<core:CityModel", f"{ENTITY}<core:CityModel")
    refused(read_tiles, tmp_path / "a.gml", text.encode(), "has a DOCTYPE, .*: remove it")


LONG = "x" * 8_000_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "token",
    [
        f"<a b='{LONG}'/>",
        f"<!--{LONG}-->",
        f"<?a {LONG}?>",
        f"<{LONG}/>",
        LONG,
        f"<![CDATA[{LONG}]]>",
    ],
)
def test_a_token_of_any_length_is_read_once_and_not_again_with_each_piece_of_the_file(
    tmp_path, token
):
    text = citygml(thing(labelled(HOUSE))).replace(
        "<core:cityObjectMember>", f"{token}<core:cityObjectMember>", 1
    )
    file = written(tmp_path / "a.gml", text)
    began = time.process_time()
    assert len(read_tiles(file).polygons) > 0
    file = written(tmp_path / "a.osm", edited().replace("<node", f"<!--{LONG}--><node", 1))
    assert len(read_osm(file).polygons) == 2
    assert time.process_time() - began < 3  # pieces of 2 kB took 8 s


@pytest.mark.parametrize("index", [-1, 1000, 1.5, None, True])
def test_indices_of_no_vertex_are_refused(tmp_path, index):
    document = cityjson({"house": ({}, HOUSE)})
    document["CityObjects"]["house"]["geometry"][0]["boundaries"][0][0][0][0] = index
    content = json.dumps(document).encode()
    refused(read_tiles, tmp_path / "a.city.json", content, "cannot be read as a city model")


def test_fuzzed_cityjson_is_read_or_refused(tmp_path):
    text = json.dumps(cityjson({"house": ({"attributes": {"measuredHeight": 9}}, HOUSE)}))
    rng = np.random.default_rng(3)
    words = ["null", "[]", "-1", '"x"', "{}", "1e400"]
    places = [i for i, letter in enumerate(text) if letter in "[{0123456789"]
    for _ in range(150):
        at, word = rng.choice(places), rng.choice(words)
        spoiled = text[:at] + word + text[at + 1 :] if rng.random() < 0.7 else text[:at]
        path = written(tmp_path / "a.city.json", spoiled)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with suppress(ju.InputError):
                read_tiles(path)
