"""Solids: bodies of three dimensions stand as the prisms of their faces, and other outlines stay outlines."""

import sqlite3
import struct
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely

import jaxurban as ju
from jaxurban.cities.buildings import to_buildings
from jaxurban.cities.outlines import Near
from jaxurban.cities.vector import read_vector
from jaxurban.world.footprints import HeightOrigin
from tests.made_files import FEET, UTM, WGS84, box, write_vector

GROUND_M = 100.0
FOOT_M = 1200 / 3937  # of the United States' surveys
# ISO codes of Well-Known Binary with heights.
POLYGON, COLLECTION, POLYHEDRAL, TIN, TRIANGLE = 1003, 1007, 1015, 1016, 1017


def at(polygon, height_m):
    """Return a face at a height above the ground."""
    return shapely.force_3d(polygon, GROUND_M + height_m)


def moved(shape, *by_m):
    """Return a shape at another place."""
    return shapely.transform(shape, lambda xyz_m: xyz_m + np.array(by_m), include_z=True)


def walls(polygon, bottom_m, top_m):
    """Return the vertical faces below the edges of a polygon."""
    corners = shapely.get_coordinates(polygon)
    return [
        shapely.Polygon(
            [
                (*start, GROUND_M + bottom_m),
                (*end, GROUND_M + bottom_m),
                (*end, GROUND_M + top_m),
                (*start, GROUND_M + top_m),
            ]
        )
        for start, end in pairwise(corners)
    ]


def gable(x_min, y_min, x_max, y_max, eaves_m, ridge_m):
    """Return the two faces of a roof whose ridge runs along y."""
    middle = (x_min + x_max) / 2
    return [
        shapely.Polygon(
            [
                (*xy, GROUND_M + (ridge_m if number in (1, 2) else eaves_m))
                for number, xy in enumerate(
                    [(side, y_min), (middle, y_min), (middle, y_max), (side, y_max)]
                )
            ]
        )
        for side in (x_min, x_max)
    ]


PODIUM, TOWER = box(0, 0, 40, 40), box(10, 10, 30, 30)
HOUSE, EAVES, DORMER = box(0, 0, 20, 20), box(-0.5, -0.5, 20.5, 20.5), box(5, 5, 15, 15)
BODIES = {
    "podium": [
        at(PODIUM, 0),
        *walls(PODIUM, 0, 12),
        at(PODIUM - TOWER, 12),
        *walls(TOWER, 12, 60),
        at(TOWER, 60),
    ],
    "eaves": [at(HOUSE, 0), *walls(HOUSE, 0, 6), *gable(*EAVES.bounds, 6, 9)],
    "dormer": [
        at(HOUSE, 0),
        *walls(HOUSE, 0, 6),
        *gable(*HOUSE.bounds, 6, 11),
        *walls(DORMER, 8, 10),
        at(DORMER, 12),
    ],
}
# Area in plan, and area that is at least so high.
FACTS = {
    "podium": (1600, {12: 1600, 60: 400}),
    "eaves": (441, {9: 441}),
    "dormer": (400, {11: 400, 12: 100}),
}


def stand(path, crs=UTM):
    """Return the buildings of a file and what was counted."""
    buildings, _, _, issues, _ = to_buildings(ju.Buildings(path), read_vector(path), crs)
    return buildings, {name: count for name, count in issues.items() if count}


def area_from(buildings, height_m):
    """Return the area in plan of the buildings that are at least so high."""
    return shapely.union_all(buildings.polygons[buildings.height_m > height_m - 0.01]).area


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("suffix", [".gpkg", ".geojson", ".parquet"])
def test_a_body_stands_on_the_union_of_its_faces_up_to_its_roofs(tmp_path, name, suffix):
    area_m2, by_height = FACTS[name]
    faces = BODIES[name]
    path = tmp_path / f"solids{suffix}"
    write_vector(path, [shapely.MultiPolygon(faces)], to=WGS84 if suffix == ".geojson" else None)
    plan = shapely.union_all([face for face in shapely.force_2d(faces) if face.is_valid])

    buildings, issues = stand(path)

    assert plan.area == pytest.approx(area_m2)  # the file itself
    covered = shapely.union_all(buildings.polygons)
    assert covered.symmetric_difference(plan).area < 0.5
    for height_m, above_m2 in by_height.items():
        assert area_from(buildings, height_m) == pytest.approx(above_m2, rel=1e-3)
    assert buildings.height_m.max() == pytest.approx(max(by_height), abs=1e-6)
    assert issues == {"solids": 1}


def surface(kind, faces):
    """Return faces as binary text of a PolyhedralSurface or of a TIN of triangles."""
    patch = {POLYHEDRAL: POLYGON, TIN: TRIANGLE}[kind]
    order = b"\x01"  # the lowest byte first
    patches = [shapely.to_wkb(face, flavor="iso", byte_order=1)[5:] for face in faces]
    head = order + struct.pack("<II", kind, len(faces))
    return head + b"".join(order + struct.pack("<I", patch) + rest for rest in patches)


def triangles(face):
    """Return the triangles between the first corner of a convex face and the others."""
    corners = shapely.get_coordinates(face, include_z=True)
    return [shapely.Polygon([corners[0], *corners[i : i + 2]]) for i in range(1, len(corners) - 2)]


def write_surface(path, wkb, declared):
    """Write a geometry that Shapely cannot hold, in a layer that declares a type."""
    with pytest.warns(RuntimeWarning, match="extension"):
        pyogrio.raw.write(
            path,
            geometry=np.array([wkb], object),
            field_data=[np.array([5.0])],
            fields=np.array(["height"]),
            geometry_type="Unknown",
            crs=UTM,
        )
    with closing(sqlite3.connect(path)) as file:
        file.execute("UPDATE gpkg_geometry_columns SET geometry_type_name = ?, z = 1", (declared,))
        file.commit()
    return path


BLOCK = [at(TOWER, 0), *walls(TOWER, 0, 60), at(TOWER, 60)]


def collected(*wkbs):
    """Return geometries as binary text of a collection."""
    return b"\x01" + struct.pack("<II", COLLECTION, len(wkbs)) + b"".join(wkbs)


PODIUM_SURFACE = surface(POLYHEDRAL, BODIES["podium"])
TOWER_TIN = surface(TIN, [triangle for face in BLOCK for triangle in triangles(face)])


@pytest.mark.parametrize(
    ("declared", "wkb", "areas"),
    [
        ("POLYHEDRALSURFACE", PODIUM_SURFACE, (1600, 400)),
        ("TIN", TOWER_TIN, (400, 400)),
        ("GEOMETRY", PODIUM_SURFACE, (1600, 400)),
        ("GEOMETRYCOLLECTION", collected(PODIUM_SURFACE, TOWER_TIN), (1600, 400)),
    ],
)
def test_surfaces_of_three_dimensions_are_read(tmp_path, monkeypatch, declared, wkb, areas):
    monkeypatch.chdir(tmp_path)
    path = Path('the "old" \\ city.gpkg')  # a name that GDAL's pipelines must not take apart
    buildings, issues = stand(write_surface(path, wkb, declared))

    assert (area_from(buildings, 0.1), area_from(buildings, 60)) == pytest.approx(areas)
    assert buildings.height_m.max() == pytest.approx(60)
    assert (buildings.origin == HeightOrigin.HEIGHT).all()
    assert issues == {"solids": 1}  # what its column says of 5 m is lower


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson"])
def test_a_collection_of_bodies_is_one_body(tmp_path, suffix):
    parts = [shapely.MultiPolygon(BODIES["podium"][:6]), shapely.MultiPolygon(BODIES["podium"][6:])]
    path = tmp_path / f"collection{suffix}"
    write_vector(path, [shapely.GeometryCollection(parts)])
    buildings, issues = stand(path)
    assert area_from(buildings, 12) == pytest.approx(1600, rel=1e-3)
    assert area_from(buildings, 60) == pytest.approx(400, rel=1e-3)
    assert issues == {"solids": 1}


def test_a_surface_far_from_the_region_is_left_out(tmp_path):
    path = write_surface(tmp_path / "city.gpkg", PODIUM_SURFACE, "POLYHEDRALSURFACE")
    assert len(read_vector(path, Near(box(50, 0, 90, 40).bounds, UTM)).polygons) == 1
    assert len(read_vector(path, Near(box(5000, 0, 5040, 40).bounds, UTM)).polygons) == 0


def test_outlines_with_heights_of_the_ground_stay_outlines(tmp_path):
    corners = shapely.get_coordinates(HOUSE)[:-1]
    slope = shapely.Polygon([(*xy, GROUND_M + 3 * number) for number, xy in enumerate(corners)])
    beside = moved(slope, 25, 0, 8)
    flat = shapely.MultiPolygon([at(HOUSE, 0), at(DORMER, 0)])
    shapes = [shapely.MultiPolygon([slope, beside]), slope, flat]
    path = write_vector(tmp_path / "outlines.gpkg", shapes, height=[7.0, 8.0, 9.0])

    buildings, issues = stand(path)

    assert buildings.height_m.tolist() == [7, 8, 9]
    assert shapely.area(buildings.polygons) == pytest.approx([800, 400, 400])
    assert issues == {"polygons_repaired": 1}  # the two that lie in each other


def test_outlines_at_the_heights_of_roofs_bound_what_is_guessed(tmp_path):
    path = write_vector(tmp_path / "roofs.gpkg", [at(HOUSE, 2), moved(at(TOWER, 150), 100, 0, 0)])
    buildings, _ = stand(path)
    assert buildings.is_guessed.all()
    likely_m = buildings.likely_m
    assert (likely_m - likely_m.min()).tolist() == pytest.approx([0, 148])


def test_ground_outside_the_roofs_stands_as_high_as_the_lowest(tmp_path):
    roofs = [at(DORMER, 9), *walls(DORMER, 0, 9), at(TOWER, 30), *walls(TOWER, 0, 30)]
    porch = shapely.MultiPolygon([at(PODIUM, 0.2), *roofs])
    roofless = shapely.MultiPolygon([at(PODIUM, 0), *walls(PODIUM, 0, 8)])
    path = write_vector(tmp_path / "ground.gpkg", [roofless, moved(porch, 100, 0, 0)])

    buildings, _ = stand(path)

    heights_by_area = zip(buildings.height_m, shapely.area(buildings.polygons), strict=True)
    assert sorted(heights_by_area) == [(8, 1600), (9, 1600), (30, 400)]


def test_walls_alone_enclose_what_is_unknown(tmp_path):
    path = write_vector(tmp_path / "walls.gpkg", [shapely.MultiPolygon(walls(HOUSE, 0, 6))])
    file = ju.Buildings(path)
    _, unknown, _, issues, _ = to_buildings(file, read_vector(path), UTM)
    counts = {name: count for name, count in issues.items() if count}
    assert counts == {"unknown_extent": 1}
    assert unknown.kinds.tolist() == ["unknown"]
    assert unknown.polygons[0].covers(HOUSE)


def test_a_body_counts_more_than_its_columns_unless_they_are_much_higher(tmp_path):
    blocks = [shapely.MultiPolygon(BLOCK)] * 5
    heights = ["80", "62.5", "20", None, "high"]
    path = write_vector(tmp_path / "columns.gpkg", blocks, height=heights)
    buildings, issues = stand(path)
    assert sorted({*buildings.height_m}) == [60, 80]
    assert (buildings.height_m == 80).sum() * 5 == len(buildings)
    assert issues == {"solids": 5, "solids_coarse": 1}


def test_heights_of_bodies_are_in_the_unit_of_the_file(tmp_path):
    body = shapely.MultiPolygon(BLOCK)
    in_feet = shapely.transform(body, lambda xyz: xyz * [1, 1, 1 / FOOT_M], include_z=True)
    path = write_vector(tmp_path / "feet.gpkg", [in_feet], to=FEET["crs"])
    buildings, _ = stand(path)
    assert buildings.height_m.max() == pytest.approx(60)
    assert area_from(buildings, 60) == pytest.approx(400, rel=1e-4)


def test_a_dome_of_a_thousand_triangles_is_a_prism_for_each_step_of_height(tmp_path):
    angles = np.linspace(0, 2 * np.pi, 41)
    radii = 10 * np.cos(np.linspace(0, np.pi / 2, 26))[:, None]
    x, y = radii * np.cos(angles), radii * np.sin(angles)
    z = np.broadcast_to(np.sqrt(100 - radii**2), x.shape)
    place = shapely.get_coordinates(TOWER.centroid)[0]
    points = np.stack([x + place[0], y + place[1], z + GROUND_M], axis=-1)
    quads = np.stack(
        [points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]], axis=2
    ).reshape(-1, 4, 3)
    faces = [shapely.Polygon(quad[corners]) for quad in quads for corners in ([0, 1, 2], [0, 2, 3])]
    base = shapely.Polygon(points[0])

    path = write_vector(tmp_path / "dome.gpkg", [shapely.MultiPolygon([base, *faces])])
    buildings, issues = stand(path)

    assert issues == {"solids": 1}
    assert len(buildings) <= 100
    assert shapely.union_all(buildings.polygons).area == pytest.approx(shapely.force_2d(base).area)
    assert buildings.height_m.max() == pytest.approx(10)
