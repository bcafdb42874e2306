"""Points of lidar as roofs, plants and ground: by their classes, in metres, and named where they cannot be read."""

import contextlib
import subprocess
import sys
import warnings

import numpy as np
import pyproj
import pytest

import jaxurban as ju
from jaxurban.cities import lidar, plausible
from jaxurban.cities.lidar import read_points
from jaxurban.errors import InputError
from jaxurban.io.sampling import raster_values
from tests.cli_runs import assert_one_sentence, run
from tests.made_files import UTM, X, Y, refused, write_raster

laspy = pytest.importorskip("laspy", reason="the extra `lidar` is not installed")

SIDE_M, GROUND_M, ROOF_M, TREE_M, WIRE_M = 100, 10.0, 15.0, 8.0, 12.0
CRS = f"{UTM}+5703"
FOOT_M = 0.3048
US_FOOT_M = 1200 / 3937
# Every 0.5 m, a little off the lattice: a house of 20 m, a tree of 10 m, a wire, a bird, and ground between them.
EAST, NORTH = (part.ravel() + 0.05 for part in np.meshgrid(*[np.arange(0, SIDE_M, 0.5)] * 2))
IN_HOUSE = (EAST >= 20) & (EAST < 40) & (NORTH >= 20) & (NORTH < 40)
IN_TREE = (EAST >= 60) & (EAST < 70) & (NORTH >= 20) & (NORTH < 30)
IN_WIRE = (NORTH >= 80) & (NORTH < 80.5)
IS_BIRD = (EAST < 0.5) & (NORTH < 0.5)
UP = np.select([IN_HOUSE, IN_TREE, IN_WIRE, IS_BIRD], [ROOF_M, TREE_M, WIRE_M, 300.0])
CLASSES = np.select([IN_HOUSE, IN_TREE, IN_WIRE, IS_BIRD], [6, 5, 14, 7], 2)


@pytest.fixture(autouse=True)
def _only_the_tile(monkeypatch):
    """Look at the tile alone where terrain is compared with roofs, and not 3 km around."""
    monkeypatch.setattr(plausible, "AROUND_M", 50.0)


def write_points(path, *, crs=CRS, classes=CLASSES, unit_m=1.0, keep=(), withheld=(), keys=None):
    """Write the scene, or those of its points that ``keep`` says, with heights in a unit."""
    header = laspy.LasHeader(version="1.4" if crs and "+" in crs else "1.2", point_format=1)
    if header.version.minor == 4:
        header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [0.001] * 3, [X, Y, 0]
    if crs:
        header.add_crs(pyproj.CRS(crs))
    for key, value in (keys or {}).items():
        (record,) = header.vlrs.get("GeoKeyDirectoryVlr")
        entry = type(record.geo_keys[0])(id=key, tiff_tag_location=0, count=1, value_offset=value)
        record.geo_keys.append(entry)
        record.geo_keys_header.number_of_keys += 1
    points = laspy.LasData(header)
    keep = keep if len(keep) else np.ones(len(EAST), bool)
    points.x, points.y = X + EAST[keep], Y + NORTH[keep]
    points.z = (GROUND_M + UP[keep]) / unit_m
    points.classification = np.broadcast_to(classes, len(EAST))[keep]
    if len(withheld):
        points.withheld = withheld[keep]
    points.write(path)
    return path


def city_of(source, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return ju.City.from_files(source, **more)


def at(raster, east_m, north_m):
    place = np.array([X + east_m]), np.array([Y + north_m])
    return float(raster_values(raster, *place, UTM, "nearest")[0])


def area_m2(raster, least_m):
    return np.sum(raster.values > least_m) * raster.transform[0] ** 2


def assert_scene(city):
    assert at(city.roofs, 30, 30) == pytest.approx(ROOF_M, abs=0.01)
    assert area_m2(city.roofs, ROOF_M - 1) == pytest.approx(400, rel=0.15)  # cells of 1 m
    assert at(city.roofs, 50, 80.1) == pytest.approx(WIRE_M, abs=0.01)
    assert at(city.roofs, 65, 25) == at(city.roofs, 50, 50) == at(city.roofs, 0.2, 0.2) == 0
    assert at(city.vegetation, 65, 25) == pytest.approx(TREE_M, abs=0.01)
    assert not np.nanmax(city.vegetation.values) > TREE_M + 0.01
    np.testing.assert_allclose(
        city.terrain.values[np.isfinite(city.terrain.values)], GROUND_M, atol=1e-3
    )


@pytest.mark.parametrize("name", ["tile.las", "tile.laz", "tile"])
def test_classes_become_roofs_plants_and_ground(tmp_path, name):
    made = write_points(tmp_path / f"a.{'las' if name == 'tile.las' else 'laz'}")
    assert_scene(city_of(made.rename(tmp_path / name)))


@pytest.mark.slow
def test_maps_have_the_house_and_the_tree(tmp_path):
    city = city_of(write_points(tmp_path / "a.laz"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        maps = ju.build_maps(city, resolution_m=5.0, altitudes_m=(5.0, 20.0))
    roof_m = maps.ds["roof_touched"].values
    assert np.nanmax(roof_m) == pytest.approx(ROOF_M, abs=0.01)
    assert np.sum(np.isclose(roof_m, TREE_M, atol=0.01)) >= 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("crs", "unit_m", "keys"),
    [
        (f"{UTM}+6360", US_FOOT_M, None),
        (f"{UTM}+8228", FOOT_M, None),
        (UTM, 1.0, None),
        (UTM, US_FOOT_M, {4099: 9003}),
        (UTM, FOOT_M, {4099: 9002}),
        (UTM, US_FOOT_M, {4096: 6360}),
    ],
)
def test_heights_come_in_metres_whatever_the_header_calls_them(tmp_path, crs, unit_m, keys):
    assert_scene(city_of(write_points(tmp_path / "a.laz", crs=crs, unit_m=unit_m, keys=keys)))


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ({"crs": None}, r'no CRS that is known: set ju\.Buildings\(crs.*"EPSG:28992\+5709"'),
        ({"crs": "EPSG:2263"}, r"which unit its heights are .*US survey foot.*EPSG:2263\+6360"),
        ({"crs": UTM, "keys": {4099: 9999}}, "which unit its heights are"),
        ({"keep": CLASSES == 6}, r"no elevation in the region.*ground have class 2"),
    ],
)
def test_what_the_file_does_not_say_is_asked_for(tmp_path, how, sentence):
    with pytest.raises(InputError, match=sentence):
        city_of(write_points(tmp_path / "a.laz", **how))


def test_a_tile_without_classes_of_buildings_is_a_surface_over_its_own_ground(tmp_path):
    unsorted = np.where(CLASSES == 2, 2, 1)
    unsorted[IS_BIRD] = 18
    city = city_of(write_points(tmp_path / "a.laz", classes=unsorted))
    assert at(city.roofs, 30, 30) == pytest.approx(ROOF_M, abs=0.01)
    assert at(city.roofs, 65, 25) == pytest.approx(TREE_M, abs=0.01)
    assert not city.vegetation.values.any()


def test_unclassified_points_beside_buildings_stand_as_plants(tmp_path):
    city = city_of(write_points(tmp_path / "a.laz", classes=np.where(IN_TREE, 1, CLASSES)))
    assert_scene(city)


def test_a_surface_counts_all_that_stands(tmp_path):
    city = city_of(ju.Buildings(write_points(tmp_path / "a.laz"), kind="surface"))
    assert at(city.roofs, 65, 25) == pytest.approx(TREE_M, abs=0.01)


def test_points_that_are_withheld_do_not_stand(tmp_path):
    city = city_of(write_points(tmp_path / "a.laz", withheld=IN_WIRE))
    assert at(city.roofs, 50, 80.1) == 0


LOW_PLACES = {  # metres east and north of ground points that are far too low
    "one": [(50, 50)],
    "three together": [(50, 50), (50.5, 50), (50, 50.5)],
    "two in different cells": [(50, 50), (51, 50)],
    "at the border": [(99.5, 50)],
    "in a corner": [(99.5, 99.5)],
    "beside the house": [(19.5, 30)],
    "several": [(50, 50), (90, 10), (10, 90), (70, 60)],
}


@pytest.mark.parametrize("depth_m", [12.0, 90.0])
@pytest.mark.parametrize("spacing", [1, 3])  # of points kept, by column and by row
@pytest.mark.parametrize("where", LOW_PLACES)
def test_ground_points_far_below_all_around_are_left_out_and_counted(
    tmp_path, monkeypatch, where, spacing, depth_m
):
    keep = (np.rint(EAST * 2) % spacing == 0) & (np.rint(NORTH * 2) % spacing == 0)
    up = UP.copy()
    for east, north in LOW_PLACES[where]:
        away_m = np.where(keep & (UP == 0), np.hypot(EAST - east, NORTH - north), np.inf)
        up[np.argmin(away_m)] = -depth_m
    monkeypatch.setattr(sys.modules[__name__], "UP", up)
    path = write_points(tmp_path / "a.laz", keep=keep)
    points = read_points(path, "height", None)
    assert np.nanmin(points.ground.values) == pytest.approx(GROUND_M, abs=1e-3)
    assert 1 <= points.counts["ground_far_below"] <= len(LOW_PLACES[where])


def test_a_cell_without_its_low_point_is_level_and_counted(tmp_path, monkeypatch):
    is_low = (abs(EAST - 50) < 0.2) & (abs(NORTH - 50) < 0.2)
    monkeypatch.setattr(sys.modules[__name__], "UP", np.where(is_low, -90.0, UP))
    path = write_points(tmp_path / "a.laz")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        city = ju.City.from_files(path)
    said = "the lowest ground points in 1 cells of the terrain"
    assert sum(str(each.message).startswith(said) for each in caught) == 1
    assert_scene(city)
    assert at(city.terrain, 50.05, 50.05) == pytest.approx(GROUND_M, abs=1e-3)
    assert city.read_issues["ground_far_below"] == 1


@pytest.mark.parametrize("spacing", [1, 3, 6])
@pytest.mark.parametrize(
    "pit",
    [
        (EAST > 45) & (EAST < 55) & (NORTH > 45) & (NORTH < 55),  # an excavation
        (EAST > 45) & (EAST < 51) & (NORTH > 5) & (NORTH < 75),  # an underpass
        (EAST > 50) & (NORTH < 18),  # a quarry at the border
    ],
    ids=["excavation", "underpass", "quarry"],
)
def test_a_pit_stays(tmp_path, monkeypatch, pit, spacing):
    keep = (np.rint(EAST * 2) % spacing == 0) & (np.rint(NORTH * 2) % spacing == 0)
    up = np.where(pit & (UP == 0), -15.0, UP)
    monkeypatch.setattr(sys.modules[__name__], "UP", up)
    points = read_points(write_points(tmp_path / "a.laz", keep=keep), "height", None)
    assert points.counts["ground_far_below"] == 0
    deep = points.ground.values < GROUND_M - 14
    area_m2 = deep.sum() * points.ground.transform[0] ** 2
    assert area_m2 == pytest.approx(0.25 * pit.sum(), rel=0.6)


def test_where_no_point_is_nothing_is_known_but_small_voids_are_filled(tmp_path):
    rng = np.random.default_rng(0)
    is_far = (EAST > 75) & (NORTH < 15)
    keep = ~is_far & (rng.random(len(EAST)) > 0.3)
    city = city_of(write_points(tmp_path / "a.laz", keep=keep))
    assert np.isnan(at(city.roofs, 90, 5))
    assert at(city.roofs, 30, 30) == pytest.approx(ROOF_M, abs=0.01)
    assert np.isfinite(city.roofs.values).mean() == pytest.approx(1 - 0.25 * 0.15, abs=0.03)


def test_another_terrain_counts_where_it_is_given(tmp_path):
    terrain = write_raster(tmp_path / "t.tif", np.full((30, 30), GROUND_M + 1, np.float32))
    city = city_of(write_points(tmp_path / "a.laz"), terrain=terrain)
    assert at(city.roofs, 30, 30) == pytest.approx(ROOF_M - 1, abs=0.01)
    high = write_raster(tmp_path / "h.tif", np.full((30, 30), GROUND_M + 50, np.float32))
    with pytest.raises(InputError, match="does not stand on the terrain"):
        city_of(tmp_path / "a.laz", terrain=high)


def test_points_are_plants_and_ground_of_other_buildings(tmp_path):
    points = write_points(tmp_path / "a.laz")
    roofs = np.zeros((10, 10), np.float32)
    roofs[5, 5] = 20
    heights = write_raster(tmp_path / "r.tif", roofs)
    city = city_of(heights, terrain=points, vegetation=points)
    assert at(city.vegetation, 65, 25) == pytest.approx(TREE_M, abs=0.01)
    with pytest.raises(InputError, match=r"stand on the ground.*ju\.Terrain\(source"):
        city_of(heights, vegetation=points)


def test_a_file_that_changes_is_read_again(tmp_path):
    first = city_of(write_points(tmp_path / "a.laz"))
    second = city_of(write_points(tmp_path / "a.laz", keep=~IN_HOUSE))
    assert at(first.roofs, 30, 30) > 0
    assert not at(second.roofs, 30, 30) > 0


def test_info_counts_points_by_class(tmp_path, capsys):
    code, out, err = run(capsys, "info", write_points(tmp_path / "a.laz"))
    assert (code, err) == (0, "")
    assert f"{np.sum(CLASSES == 6):,} of class 6" in out
    assert "1 of class 7" in out
    assert "10 to 25 m" in out


def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, capsys):
    path = write_points(tmp_path / "a.laz")
    monkeypatch.setitem(sys.modules, "lazrs", None)
    code, _, err = run(capsys, "info", path)
    assert code == 2
    assert_one_sentence(err, "a.laz", "pip install 'jaxurban[lidar]'")


def test_damaged_points_are_one_sentence(tmp_path):
    whole = write_points(tmp_path / "whole.laz").read_bytes()
    refused(city_of, tmp_path / "empty.laz", whole[: len(whole) * 9 // 10], "damaged or cut short")
    rng = np.random.default_rng(0)
    for number in range(40):
        damaged = bytearray(whole)
        for place in rng.integers(4, 420 if number % 2 else len(whole), 4):
            damaged[place] = rng.integers(256)
        path = tmp_path / "damaged.laz"
        path.write_bytes(damaged[: rng.integers(4, len(whole))] if number % 5 == 0 else damaged)
        read_points.cache_clear()
        with contextlib.suppress(InputError):  # and nothing else
            read_points(path, "height", None)


def test_points_outside_the_box_of_the_header_are_not_lost_in_silence(tmp_path):
    path = write_points(tmp_path / "a.las")
    data = bytearray(path.read_bytes())
    data[179:187] = np.float64(X + 50).tobytes()  # the header's highest x
    refused(city_of, path, bytes(data), "damaged or cut short")


def changed(path, **numbers):
    """Write other numbers of points into a header: the one of 32 bits, or the one of 64 bits."""
    data = bytearray(path.read_bytes())
    for name, (at, num_bytes) in {"short": (107, 4), "long": (247, 8)}.items():
        if name in numbers:
            data[at : at + num_bytes] = numbers[name].to_bytes(num_bytes, "little")
    path.write_bytes(data)
    return path


NUM = len(EAST)


@pytest.mark.parametrize("crs", [UTM, CRS])  # LAS 1.2 and 1.4
@pytest.mark.parametrize("number", [0, 1, NUM - 1000, NUM - 1, NUM + 1, NUM + 10**6, 2**32 - 1])
def test_a_header_that_names_another_number_of_points_is_refused_at_once(tmp_path, crs, number):
    path = write_points(tmp_path / "a.las", crs=crs)
    changed(path, **{"long" if "+" in crs else "short": number})
    refused(
        city_of, path, None, f"number of points is {number:,} by its header, and {NUM:,} are in it"
    )


@pytest.mark.parametrize("crs", [UTM, CRS])
@pytest.mark.parametrize("number", [1, NUM - 1000, NUM + 10**6])
def test_packed_points_are_as_many_as_the_header_names(tmp_path, crs, number):
    path = write_points(tmp_path / "a.laz", crs=crs)
    changed(path, **{"long" if "+" in crs else "short": number})
    refused(city_of, path, None, "by its header, and more are in it|damaged or cut short")


def test_no_number_of_points_makes_reading_endless(tmp_path, monkeypatch):
    monkeypatch.setattr(lidar, "MOST_CELLS", 2**16)
    for name in ("a.las", "a.laz"):
        path = changed(write_points(tmp_path / name), long=2**63)
        refused(
            city_of,
            path,
            None,
            "number of points is 9,223,372,036,854,775,808|damaged or cut short",
        )


def test_no_length_of_packed_points_makes_room_for_more_than_the_file_holds(tmp_path, monkeypatch):
    def unpack(*_):
        raise AssertionError("lazrs makes room for what is unpacked")

    monkeypatch.setattr(laspy.LasReader, "chunk_iterator", unpack)
    path = write_points(tmp_path / "a.laz")
    with laspy.open(path) as reader:
        begin, size = reader.header.offset_to_point_data, reader.header.point_format.size
    whole = path.read_bytes()
    for layer in range(9):  # of format 6; their lengths follow the number of points
        data = bytearray(whole)
        at = begin + 8 + size + 4 + 4 * layer
        data[at : at + 4] = (2**32 - 1).to_bytes(4, "little")
        refused(city_of, path, bytes(data), "damaged or cut short")


@pytest.mark.parametrize("num_bytes", [0, 1, 29])
def test_a_file_that_broke_off_is_refused(tmp_path, num_bytes):
    path = write_points(tmp_path / "a.las")
    with laspy.open(path) as reader:
        begin, size = reader.header.offset_to_point_data, reader.header.point_format.size
    data = path.read_bytes()
    cut = data[: begin + NUM // 2 * size + num_bytes]
    refused(city_of, path, cut, f"is {NUM:,} by its header, and {NUM // 2:,} are in it")
    path.write_bytes(data + bytes(num_bytes))
    assert_scene(city_of(path))


def test_records_behind_the_points_are_no_points(tmp_path):
    path = write_points(tmp_path / "a.las")
    points = laspy.read(path)
    points.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("us", 1, "a note", bytes(1000))])
    points.write(path)
    assert_scene(city_of(path))


def test_more_chunks_than_bytes_are_damage_and_end_no_process(tmp_path):
    path = write_points(tmp_path / "a.laz")
    with laspy.open(path) as reader:
        begin = reader.header.offset_to_point_data
    data = bytearray(path.read_bytes())
    table = int.from_bytes(data[begin : begin + 8], "little")
    data[table + 4 : table + 8] = b"\xff" * 4
    refused(city_of, path, bytes(data), "damaged or cut short")


MEMORY = """
import re, sys, warnings
warnings.simplefilter("ignore")
import jaxurban as ju
city = ju.City.from_files(sys.argv[1])
print(int(re.search(r"VmHWM:\\s+(\\d+) kB", open("/proc/self/status").read())[1]) / 2**20)  # of no parent
"""


@pytest.mark.slow
def test_ten_million_points_take_less_than_a_gibibyte(tmp_path):
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [0.01] * 3, [X, Y, 0]
    header.add_crs(pyproj.CRS(CRS))
    rng = np.random.default_rng(0)
    with laspy.open(tmp_path / "a.laz", "w", header=header) as writer:
        for _ in range(10):
            record = laspy.ScaleAwarePointRecord.zeros(1_000_000, header=header)
            record.x, record.y = X + rng.random(10**6) * 1000, Y + rng.random(10**6) * 1000
            is_built = (np.array(record.x) % 100 < 50) & (np.array(record.y) % 100 < 50)
            record.z = 10 + 20 * is_built
            record.classification = np.where(is_built, 6, 2)
            writer.write_points(record)
    command = [sys.executable, "-c", MEMORY, str(tmp_path / "a.laz")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(done.stdout) < 1
