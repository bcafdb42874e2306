"""Paths written for other programs are read back by those programs' own readers, over hills and flat ground."""

import json
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import geopandas as gpd
import numpy as np
import pytest
import shapely
from scipy.interpolate import RegularGridInterpolator

from benchmarks.random_routes import READERS
from jaxurban.cli.plan import plan_command
from jaxurban.errors import InputError
from jaxurban.flights.export.qgc_plan import height_note
from jaxurban.flights.export.write import FORMATS, write_path
from jaxurban.flights.missions.mission import read_mission
from jaxurban.flights.missions.parts import AUTOPILOTS
from jaxurban.io.zone import Zone
from jaxurban.kernels.tolerances import GROUND_TOLERANCE_M
from jaxurban.paths.ground import elevation_at, ground_along
from jaxurban.planners.base import Status
from jaxurban.typing import PlannedPath
from jaxurban.world.grid import Grid
from tests.mavlink import mission_reader
from tests.volumes import made_path

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_600, 400, 400)
KML = {"k": "http://www.opengis.net/kml/2.2"}
GPX = "{http://www.topografix.com/GPX/1/1}"
RTE_ORDER = (
    "name",
    "cmt",
    "desc",
    "src",
    "link",
    "number",
    "type",
    "extensions",
    "rtept",
)  # of GPX 1.1's schema
WPT_ORDER = (
    "ele",
    "time",
    "magvar",
    "geoidheight",
    "name",
    "cmt",
    "desc",
    "src",
    "link",
    "sym",
    "type",
)
SIDE_M = GRID.num_cols * GRID.resolution_m
CORNER_M = np.array([GRID.x_min_m, GRID.y_min_m])
RASTER_M = 0.02  # what a raster of 5 m cells loses of the hill below


def staircase() -> np.ndarray:
    """300 points: 100 steps east, 100 north-east, 99 north."""
    steps = np.repeat([[1, 0], [1, 1], [0, 1]], [100, 100, 99], axis=0)
    cells = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    return CORNER_M + (cells + 0.5) * GRID.resolution_m


@pytest.fixture
def route():
    return made_path(GRID, staircase(), note="Cheapest & best < 1.")


def plan_in(file) -> dict:
    return json.loads(file.read_text())


def test_geojson_is_read_by_geopandas_at_the_same_place_and_holds_no_nan(route, tmp_path):
    file = tmp_path / "path.geojson"
    file.write_text("old")
    assert write_path(route, file)
    assert [each.name for each in tmp_path.iterdir()] == ["path.geojson"]  # no scrap stays
    read = gpd.read_file(file)
    (frame,) = read.to_crs(GRID.crs).itertuples()
    assert (frame.cost, frame.altitude_m, frame.cost_gps) == (1234.56, 60.0, 1000.0)
    assert (frame.mean_gps, frame.mean_risk) == (0.75, 0.5)  # beside the nested ``metrics``
    assert (read.crs.to_epsg(), frame.geometry.has_z) == (4326, False)
    np.testing.assert_allclose(shapely.get_coordinates(frame.geometry), route.xy_m, atol=0.02)
    (feature,) = json.loads(file.read_text(), parse_constant=pytest.fail)["features"]
    assert feature["properties"]["metrics"] == {"gps": 0.75, "risk": 0.5}
    assert feature["properties"]["lower_bound"] is None


def test_kml_is_read_by_gdal_and_its_line_lies_at_its_altitude_above_ground(route, tmp_path):
    file = tmp_path / "path.kml"
    assert write_path(route, file)
    root = ElementTree.parse(file).getroot()
    assert "Cheapest & best < 1." in root.findtext(".//k:description", namespaces=KML)
    assert (
        json.loads(root.findtext(".//k:Data[@name='metrics']/k:value", namespaces=KML))["gps"]
        == 0.75
    )
    assert root.findtext(".//k:LineString/k:altitudeMode", namespaces=KML) == "relativeToGround"
    lonlatz = shapely.get_coordinates(gpd.read_file(file).geometry[0], include_z=True)
    np.testing.assert_allclose(lonlatz[:, :2], route.lonlat, atol=1e-7)
    assert np.all(lonlatz[:, 2] == 60.0)


def test_plan_has_a_waypoint_at_turns_only(route, tmp_path):
    file = tmp_path / "path.plan"
    assert write_path(route, file)
    plan = plan_in(file)
    assert (plan["fileType"], plan["version"], plan["groundStation"]) == (
        "Plan",
        1,
        "QGroundControl",
    )
    items = plan["mission"]["items"]
    assert [item["params"][6] for item in items] == [60.0, 60.0, 60.0, 60.0, 0.0]
    assert items[4]["params"][4:6] == items[3]["params"][4:6]
    np.testing.assert_allclose(
        READERS[".plan"](file)[:, :2], route.lonlat[[0, 100, 200, 299]], atol=1e-7
    )
    write_path(
        made_path(GRID, np.array([[0.0, 0], [100, 0], [50, 0]]) + CORNER_M), file, end="none"
    )  # and back
    assert len(plan_in(file)["mission"]["items"]) == 3


@pytest.mark.parametrize("suffix", [".geojson", ".kml", ".gpx", ".plan", ".KML"])
def test_path_from_a_place_to_itself_is_written(suffix, tmp_path):
    assert write_path(made_path(GRID, staircase()[:1]), tmp_path / f"path{suffix}")
    assert (tmp_path / f"path{suffix}").stat().st_size > 0


def test_without_a_path_nothing_is_written_and_an_old_file_stays(tmp_path):
    (tmp_path / "path.kml").write_text("old")
    blocked = made_path(GRID, [], status=Status.BLOCKED)
    assert not any(
        write_path(blocked, tmp_path / f"path{suffix}") for suffix in (".geojson", ".kml")
    )
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("path.kml", "old")]


def test_files_take_the_facts_of_a_report_and_geojson_its_segments(route, tmp_path):
    segments = [{"segment": 1, "cost": 5.0, "people_overflown": None}, {"segment": 2, "cost": 7.5}]
    facts = {"speed_m_s": 12.0, "people_overflown": 31.5, "segments": segments}
    report = SimpleNamespace(to_dict=facts.copy)
    files = {suffix: tmp_path / f"path{suffix}" for suffix in READERS}
    assert all(write_path(route, file, report) for file in files.values())
    features = json.loads(files[".geojson"].read_text(), parse_constant=pytest.fail)["features"]
    (path,) = (feature["properties"] for feature in features)
    assert (path["cost"], path["people_overflown"]) == (1234.56, 31.5)
    assert path["segments"] == segments
    frame = gpd.read_file(files[".geojson"])
    assert len(frame) == 1
    root = ElementTree.parse(files[".kml"]).getroot()
    assert root.findtext(".//k:Data[@name='people_overflown']/k:value", namespaces=KML) == "31.5"
    mission = plan_in(files[".plan"])["mission"]
    assert (mission["cruiseSpeed"], mission["hoverSpeed"]) == (12.0, 12.0)


@pytest.fixture(scope="module")
def reader():
    with mission_reader() as reader:
        yield reader


def hill_m(x_m, y_m):
    """Return the ground's elevation: 120 m of relief, slopes up to 46 %."""
    return (
        75.0 + 40.0 * np.sin(x_m / 160.0) * np.cos(y_m / 210.0) + 20.0 * np.sin((x_m + y_m) / 330.0)
    )


HILL_M = hill_m(*np.meshgrid(*((np.arange(GRID.num_cols) + 0.5) * GRID.resolution_m,) * 2))


def random_route(seed: int, over_hill: bool):
    """Return up to 12 points anywhere, level or climbing; on odd seeds along the grid, at cells' middles."""
    rng = np.random.default_rng(seed)
    points_m = rng.uniform(20, SIDE_M - 20, (rng.integers(2, 13), 2))
    if seed % 2:
        steps = np.repeat(rng.integers(-1, 2, (8, 2)), rng.integers(1, 25, 8), axis=0)
        points_m = (np.clip(200 + np.cumsum(steps, axis=0), 0, 399) + 0.5) * GRID.resolution_m
    z_m = 60.0 if seed % 4 < 2 else rng.uniform(20, 120, len(points_m))
    return made_path(
        GRID,
        points_m + CORNER_M,
        z_m,
        ground=ground_along(points_m, HILL_M, GRID) if over_hill else None,
    )


@pytest.mark.slow
@pytest.mark.parametrize("over_hill", [True, False])
def test_what_mavsdk_reads_is_the_path_in_place_and_in_height(over_hill, reader, tmp_path):
    file = tmp_path / "path.plan"
    num_added = 0
    for seed in range(25):
        route = random_route(seed, over_hill)
        assert write_path(route, file)
        assert reader.differences(file) == []
        commands, places = reader.read(file)
        assert commands == [22] + [16] * (len(places) - 2) + [21]
        landing, places = places[-1], places[:-1]
        np.testing.assert_allclose(landing[:2], places[-1, :2], atol=1e-7)
        assert -0.02 < places[-1, 2] - landing[2] - route.z_m[-1] < GROUND_TOLERANCE_M
        lat, lon, home_m = plan_in(file)["mission"]["plannedHomePosition"]
        np.testing.assert_allclose([lon, lat], route.lonlat[0], atol=1e-7)
        xy_m = np.column_stack(GRID.xy_of_lonlat(*places[:, :2].T)) - CORNER_M
        path = shapely.LineString(np.column_stack([route.xy_m - CORNER_M, route.z_m]))
        flown = shapely.LineString(np.column_stack([xy_m, places[:, 2]]))
        assert flown.hausdorff_distance(path) < 0.03  # a centimetre, and the digits of a degree
        # Walked along in step, so that a path that crosses itself cannot hide a wrong height.
        share = np.linspace(0, 1, 4000)
        here, planned = (
            shapely.get_coordinates(
                shapely.line_interpolate_point(line, share, normalized=True), include_z=True
            )
            for line in (flown, path)
        )
        assert np.hypot(*(here - planned)[:, :2].T).max() < 0.2
        ground_m = hill_m(*here[:, :2].T) if over_hill else 0.0
        missed_m = home_m + here[:, 2] - ground_m - planned[:, 2]
        if over_hill:
            assert home_m == pytest.approx(hill_m(*(route.xy_m[0] - CORNER_M)), abs=RASTER_M)
            # and what z changes over 0.2 m of a climb
            assert -0.25 < missed_m.min() < missed_m.max() < GROUND_TOLERANCE_M + 0.25
            num_added += len(places) - len(shapely.get_coordinates(path.simplify(0.01)))
        else:
            assert home_m == 0.0
            assert np.abs(missed_m).max() < 0.3
    assert num_added > 50 or not over_hill


def test_a_plan_for_ardupilot_has_the_items_of_one_for_px4_and_is_read_as_its_own(route, tmp_path):
    files = {name: tmp_path / f"{name}.plan" for name in ("px4", "ardupilot")}
    plans = {}
    for name, file in files.items():
        assert write_path(route, file, autopilot=name)
        plans[name] = plan_in(file)
        assert read_mission(file, autopilot=name).autopilot == name
        assert f"for {AUTOPILOTS[name]}." in plans[name]["note"]
    firmwares = {name: plan["mission"].pop("firmwareType") for name, plan in plans.items()}
    assert firmwares == {"px4": 12, "ardupilot": 3}
    assert plans["px4"]["mission"] == plans["ardupilot"]["mission"]
    assert write_path(route, files["px4"])  # left out
    assert plan_in(files["px4"])["mission"]["firmwareType"] == 12
    with pytest.raises(InputError, match=r"autopilot must be .* got 'inav'"):
        write_path(route, files["px4"], autopilot="inav")
    with pytest.raises(InputError, match="leave end and autopilot out"):
        write_path(route, tmp_path / "path.kml", autopilot="px4")


def test_only_ground_that_bends_adds_waypoints(tmp_path):
    ends_m = np.array([[100.0, 1000.0], [1900.0, 1000.0]])
    x_m = (np.arange(GRID.num_cols) + 0.5) * GRID.resolution_m
    slope_m = np.tile(0.1 * x_m, (GRID.num_rows, 1))
    ridge_m = np.tile(100.0 - 0.1 * np.abs(x_m - 1002.5), (GRID.num_rows, 1))
    for terrain_m, heights_m in ((slope_m, [60.0, 240.0]), (ridge_m, [60.0, 150.25, 60.5])):
        write_path(
            made_path(GRID, ends_m + CORNER_M, ground=ground_along(ends_m, terrain_m, GRID)),
            tmp_path / "path.plan",
        )
        items = plan_in(tmp_path / "path.plan")["mission"]["items"]
        np.testing.assert_allclose([item["Altitude"] for item in items[:-1]], heights_m, atol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "slope", "bump_m"),
    [(".plan", 0.2, 3.0), (".gpx", 0.2, 3.0), (".kml", 0.2, 3.0), (".plan", 0.54, 8.0)],
)
def test_no_leg_of_a_file_is_lower_over_the_ground_than_planned_nor_a_metre_higher(
    suffix, slope, bump_m, tmp_path
):
    """Over bumps from cell to cell on a slope; bilinear ground, each written leg sampled every 5 cm."""
    rng, file = np.random.default_rng(0), tmp_path / f"path{suffix}"
    terrain_m = slope * (GRID.x_m - GRID.x_min_m) + rng.uniform(0.0, bump_m, GRID.shape)
    for seed in range(8):
        points_m = random_route(seed, over_hill=False).xy_m - CORNER_M
        ground = ground_along(points_m, terrain_m, GRID)
        write_path(made_path(GRID, points_m + CORNER_M, 60.004, ground=ground), file)
        xyz_m = heights_over_the_sea(file, terrain_m)
        at = np.linspace(0, len(xyz_m) - 1, 100 * len(xyz_m) + 1)
        x_m, y_m, z_m = (np.interp(at, np.arange(len(xyz_m)), values) for values in xyz_m.T)
        above_m = z_m - elevation_at(x_m, y_m, terrain_m, GRID.resolution_m)
        # 2 cm aside, by digits of a degree and bends left out, the ground is a centimetre or two higher
        assert 60.004 - 0.02 < above_m.min() < above_m.max() < 60.004 + GROUND_TOLERANCE_M
        assert above_m.max() > 60.3


def read_gpx(file) -> np.ndarray:
    points = ElementTree.parse(file).getroot().iter(f"{GPX}rtept")
    return np.array(
        [
            [point.get("lon"), point.get("lat"), point.findtext(f"{GPX}ele", "nan")]
            for point in points
        ],
        float,
    )


def heights_over_the_sea(file, terrain_m) -> np.ndarray:
    """Return x, y and the elevation of the points that a file's straight legs join, ``[W, 3]``."""
    lonlatz = read_gpx(file) if file.suffix == ".gpx" else READERS[file.suffix](file)
    x_m, y_m = np.subtract(np.stack(GRID.xy_of_lonlat(*lonlatz[:, :2].T)), CORNER_M[:, None])
    zero_m = 0.0
    if file.suffix == ".kml":
        zero_m = elevation_at(x_m, y_m, terrain_m, GRID.resolution_m)
    elif file.suffix == ".plan":
        zero_m = plan_in(file)["mission"]["plannedHomePosition"][2]
    return np.column_stack([x_m, y_m, lonlatz[:, 2] + zero_m])


def test_files_say_which_height_they_give_and_what_the_ground_is_taken_for(tmp_path):
    for over_hill, words in ((False, "level ground is assumed"), (True, "vertical datum")):
        route = random_route(3, over_hill)
        for suffix in READERS:
            write_path(route, tmp_path / f"path{suffix}")
        assert words in height_note(route)
        assert words in plan_in(tmp_path / "path.plan")["note"]
        (feature,) = plan_in(tmp_path / "path.geojson")["features"]
        assert ("ground_m" in feature["properties"]) == over_hill
    for suffix in (".geojson", ".kml"):
        said = (tmp_path / f"path{suffix}").read_text()
        assert "metres above the ground below each point, not above sea level" in said
    expected_m = hill_m(*(route.xy_m - CORNER_M).T)
    np.testing.assert_allclose(feature["properties"]["ground_m"], expected_m, atol=RASTER_M)
    assert "zero of the terrain file" in feature["properties"]["ground_reference"]


def test_the_ground_is_that_of_scipys_interpolation_and_of_the_cell_beside_missing_data():
    rng = np.random.default_rng(0)
    terrain_m = rng.uniform(0, 50, (7, 9))
    x_m, y_m = rng.uniform(1, 17, 200), rng.uniform(1, 13, 200)
    by_scipy = RegularGridInterpolator((np.arange(7) * 2 + 1.0, np.arange(9) * 2 + 1.0), terrain_m)
    np.testing.assert_allclose(
        elevation_at(x_m, y_m, terrain_m, 2.0), by_scipy(np.column_stack([y_m, x_m]))
    )
    assert elevation_at(np.array([0.1]), np.array([0.2]), terrain_m, 2.0) == terrain_m[0, 0]
    terrain_m[3, 4] = np.nan
    assert elevation_at(np.array([7.5]), np.array([7.0]), terrain_m, 2.0) == terrain_m[3, 3]
    one = Grid(GRID.crs, 5.0, 0, 0, 1, 1)
    assert ground_along(np.array([[2.0, 2.0]]), np.array([[7.0]]), one).elevation_m.tolist() == [
        7.0
    ]


@pytest.mark.parametrize(
    ("end", "last"), [(None, [21]), ("land", [21]), ("return", [20]), ("none", [])]
)
@pytest.mark.parametrize("speed_m_s", [None, 7.5])
def test_a_mission_sets_its_speed_after_take_off_and_ends_as_it_is_told(
    end, last, speed_m_s, reader, tmp_path
):
    route, file = random_route(4, over_hill=True), tmp_path / "path.plan"
    report = SimpleNamespace(to_dict=lambda: {"speed_m_s": speed_m_s, "segments": []})
    write_path(route, file, None if speed_m_s is None else report, end=end)
    assert reader.differences(file) == []
    items, _ = reader.items(file)
    speed = [] if speed_m_s is None else [178]
    commands = [item.command for item in items]
    assert commands == [22, *speed, *[16] * (len(items) - 1 - len(speed) - len(last)), *last]
    if speed:
        assert (items[1].param1, items[1].param2, items[1].param3) == (1.0, 7.5, -1.0)
    said = {"return": "not checked", "none": "without"}.get(end, "landing at the goal")
    assert said in plan_in(file)["note"]


def fenced_by(zones, file) -> dict:
    """Write a level route at 60 m along the middle of the region and return its plan."""
    write_path(
        made_path(
            GRID, np.array([[200.0, 1000.0], [1800.0, 1000.0]]) + CORNER_M, zones=tuple(zones)
        ),
        file,
    )
    return plan_in(file)


def disc(x_m, y_m, radius_m) -> shapely.Polygon:
    return shapely.Point(CORNER_M[0] + x_m, CORNER_M[1] + y_m).buffer(radius_m)


def square(x_m, y_m, half_m, **heights) -> Zone:
    return Zone(f"{x_m:g},{y_m:g}", shapely.envelope(disc(x_m, y_m, half_m)), GRID.crs, **heights)


def test_zones_near_the_route_at_its_heights_are_the_geofence_without_holes_and_others_are_told(
    reader, tmp_path
):
    ring = disc(1000, 1400, 200).difference(
        shapely.union_all([disc(920, 1400, 40), disc(1080, 1400, 40)])
    )
    held = [
        square(600, 1300, 100),
        square(1500, 800, 50, floor_m=50.0, ceiling_m=60.0),
        Zone("ring", ring, GRID.crs),
    ]
    degrees = shapely.transform(
        disc(1000, 600, 80), lambda x, y: GRID.lonlat_of_xy(x, y), interleaved=False
    )
    left_out = [square(1000, 1000, 30, ceiling_m=50.0), square(300, 1200, 40, floor_m=61.0)]
    far, file = [square(1000, 9000, 100)], tmp_path / "path.plan"
    plan = fenced_by([*held, Zone("degrees", degrees), *left_out, *far], file)
    assert reader.differences(file) == []
    assert "keeps out of 4 no-fly zones within 1 km" in plan["note"]
    assert "2 above or below the flight are left out" in plan["note"]
    rings = (np.array(ring["polygon"])[:, ::-1] for ring in plan["geoFence"]["polygons"])
    fenced = shapely.union_all(
        [shapely.Polygon(np.column_stack(GRID.xy_of_lonlat(*ring.T))) for ring in rings]
    )
    wanted = shapely.union_all([*(zone.polygon for zone in held), disc(1000, 600, 80)])
    assert shapely.hausdorff_distance(fenced, wanted) < 0.05
    assert shapely.symmetric_difference(fenced, wanted).area < 1e-4 * wanted.area
    for zones in ([], far):
        assert fenced_by(zones, file)["geoFence"]["polygons"] == []


@pytest.mark.parametrize("over_hill", [True, False])
def test_gpx_is_a_route_that_gdal_reads_in_the_schemas_order_with_elevations_over_terrain_only(
    over_hill, tmp_path
):
    file = tmp_path / "path.gpx"
    for seed in range(6):
        route = random_route(seed, over_hill)
        assert write_path(route, file)
        root = ElementTree.parse(file).getroot()
        assert (root.tag, root.get("version"), root.get("creator")) == (
            f"{GPX}gpx",
            "1.1",
            "jaxurban",
        )
        (rte,) = root
        for element, order in (
            (rte, RTE_ORDER),
            *((point, WPT_ORDER) for point in rte.findall(f"{GPX}rtept")),
        ):
            places = [order.index(child.tag.removeprefix(GPX)) for child in element]
            assert places == sorted(places)
        *places, elevation_m = read_gpx(file).T
        (line,) = gpd.read_file(file, layer="routes").geometry
        np.testing.assert_allclose(shapely.get_coordinates(line), np.transpose(places))
        xy_m = np.column_stack(GRID.xy_of_lonlat(*places))
        assert (
            shapely.hausdorff_distance(shapely.LineString(xy_m), shapely.LineString(route.xy_m))
            < 0.03
        )
        above_m = [float(desc.text.split()[0]) for desc in rte.findall(f"{GPX}rtept/{GPX}desc")]
        assert ("zero of the terrain file" if over_hill else "no elevation") in rte.findtext(
            f"{GPX}desc"
        )
        ground_m = hill_m(*(xy_m - CORNER_M).T) if over_hill else np.full(len(xy_m), np.nan)
        np.testing.assert_allclose(elevation_m - above_m, ground_m, atol=RASTER_M + 0.05)


def test_gpx_holds_several_routes_by_name(tmp_path):
    routes = [random_route(seed, over_hill=False) for seed in range(3)]
    write_path(routes, tmp_path / "paths.gpx", names=["a", "b & c", "d"])
    root = ElementTree.parse(tmp_path / "paths.gpx").getroot()
    assert [rte.findtext(f"{GPX}name") for rte in root] == ["a", "b & c", "d"]


def test_texts_name_every_format():
    option = next(option for option in plan_command.params if option.name == "files")
    guide = (Path(__file__).parents[2] / "docs/guides/routes.md").read_text(encoding="utf-8")
    for suffix in FORMATS:
        assert suffix in option.help
        assert f"``{suffix}``" in PlannedPath.save.__doc__
        assert f"| `{suffix}` |" in guide
