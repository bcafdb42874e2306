"""Paths written for other programs are read back by those programs' own readers."""

import json
from dataclasses import dataclass, field, replace
from typing import Any
from xml.etree import ElementTree

import geopandas
import numpy as np
import pytest
import shapely

from jaxurban.io.read.zone import Zone
from jaxurban.paths.export.write import write_path
from jaxurban.paths.path import Ground
from jaxurban.planners.base import Status
from jaxurban.world.grid import Grid

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_600, 400, 400)
KML = {"k": "http://www.opengis.net/kml/2.2"}


@dataclass(frozen=True)
class Route:
    """A path as `plan` returns it, without the planning."""

    xy_m: np.ndarray
    status: Status = Status.OPTIMAL
    altitude_m: float = 60.0
    facts: dict[str, Any] = field(default_factory=dict)
    climb_m: float = 0.0
    ground: Ground | None = None
    crs: str = GRID.crs
    zones: tuple[Zone, ...] = ()
    cautions: tuple[str, ...] = ()
    maps: None = None

    @property
    def z_m(self):
        """Rises by ``climb_m`` at the fourth point, and stays there."""
        return self.altitude_m + self.climb_m * (np.arange(len(self.xy_m)) >= 3)

    @property
    def lonlat(self):
        return np.stack(GRID.lonlat_of_xy(*self.xy_m.T), axis=-1)

    def to_dict(self):
        return {
            "planner": "astar-plus",
            "message": "Cheapest & best < 1.",
            "altitude_m": self.altitude_m,
            "cost": 12.5,
            "lower_bound": None,
            "cost_by_layer": {"distance": 2.5, "gps": 10.0},
            "metrics": {"gps": 0.75, "risk": 0.5},
            **self.facts,
        }


def staircase() -> np.ndarray:
    """300 points: 100 steps east, 100 north-east, 99 north."""
    steps = np.repeat([[1, 0], [1, 1], [0, 1]], [100, 100, 99], axis=0)
    cells = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    return np.array([GRID.x_min_m, GRID.y_min_m]) + (cells + 0.5) * GRID.resolution_m


@pytest.fixture
def route() -> Route:
    return Route(staircase())


def test_geojson_is_read_by_geopandas_at_the_same_place(route, tmp_path):
    file = tmp_path / "path.geojson"
    assert write_path(route, file)
    frame = geopandas.read_file(file)
    assert len(frame) == 1
    assert frame.crs.to_epsg() == 4326
    assert frame["cost"][0] == 12.5
    assert frame["altitude_m"][0] == 60.0
    assert frame[["mean_gps", "mean_risk"]].to_numpy().tolist() == [[0.75, 0.5]]  # beside the nested ``metrics``
    assert frame["cost_gps"][0] == 10.0
    line = frame.to_crs(GRID.crs).geometry[0]
    assert not line.has_z
    np.testing.assert_allclose(shapely.get_coordinates(line), route.xy_m, atol=0.02)


def test_geojson_keeps_nested_properties_and_writes_no_nan(route, tmp_path):
    write_path(route, tmp_path / "path.geojson")
    text = (tmp_path / "path.geojson").read_text()
    (feature,) = json.loads(text, parse_constant=pytest.fail)["features"]
    assert feature["properties"]["metrics"] == {"gps": 0.75, "risk": 0.5}
    assert feature["properties"]["lower_bound"] is None


def test_kml_line_lies_at_its_altitude_above_ground(route, tmp_path):
    file = tmp_path / "path.kml"
    assert write_path(route, file)
    root = ElementTree.parse(file).getroot()
    assert root.findtext(".//k:description", namespaces=KML) == "Cheapest & best < 1."
    assert json.loads(root.findtext(".//k:Data[@name='metrics']/k:value", namespaces=KML))["gps"] == 0.75
    line = root.find(".//k:LineString", KML)
    assert line.findtext("k:altitudeMode", namespaces=KML) == "relativeToGround"
    points = np.array(
        [[float(v) for v in p.split(",")] for p in line.findtext("k:coordinates", namespaces=KML).split()]
    )
    np.testing.assert_allclose(points[:, :2], route.lonlat, atol=1e-7)
    assert np.all(points[:, 2] == 60.0)


def test_kml_is_read_by_gdal(route, tmp_path):
    write_path(route, tmp_path / "path.kml")
    line = geopandas.read_file(tmp_path / "path.kml").geometry[0]
    np.testing.assert_allclose(shapely.get_coordinates(line), route.lonlat, atol=1e-7)


def test_plan_has_a_waypoint_at_turns_only(route, tmp_path):
    file = tmp_path / "path.plan"
    assert write_path(route, file)
    plan = json.loads(file.read_text())
    assert (plan["fileType"], plan["version"], plan["groundStation"]) == ("Plan", 1, "QGroundControl")
    items = plan["mission"]["items"]
    assert [item["command"] for item in items] == [22, 16, 16, 16, 21]
    assert [item["doJumpId"] for item in items] == [1, 2, 3, 4, 5]
    assert all(item["frame"] == 3 for item in items)
    assert [item["params"][6] for item in items] == [60.0, 60.0, 60.0, 60.0, 0.0]
    assert items[4]["params"][4:6] == items[3]["params"][4:6]
    latlon = np.array([item["params"][4:6] for item in items[:4]])
    np.testing.assert_allclose(latlon[:, ::-1], route.lonlat[[0, 100, 200, 299]], atol=1e-7)
    assert plan["mission"]["plannedHomePosition"][:2] == items[0]["params"][4:6]


def test_plan_keeps_a_path_that_turns_back_on_itself(tmp_path):
    there_and_back = np.array([[0.0, 0], [100, 0], [50, 0]]) + staircase()[0]
    write_path(Route(there_and_back), tmp_path / "path.plan", end="none")
    assert len(json.loads((tmp_path / "path.plan").read_text())["mission"]["items"]) == 3


@pytest.mark.parametrize("suffix", [".geojson", ".kml", ".gpx", ".plan", ".KML"])
def test_path_from_a_place_to_itself_is_written(suffix, tmp_path):
    assert write_path(Route(staircase()[:1]), tmp_path / f"path{suffix}")
    assert (tmp_path / f"path{suffix}").stat().st_size > 0


def test_without_a_path_nothing_is_written_and_an_old_file_stays(route, tmp_path):
    old = tmp_path / "path.kml"
    old.write_text("old")
    blocked = replace(route, status=Status.BLOCKED, xy_m=np.empty((0, 2)))
    assert not write_path(blocked, tmp_path / "path.geojson")
    assert not write_path(blocked, old)
    assert [file.name for file in tmp_path.iterdir()] == ["path.kml"]
    assert old.read_text() == "old"


def test_an_old_file_is_replaced_and_no_scrap_stays(route, tmp_path):
    (tmp_path / "path.geojson").write_text("old")
    write_path(route, tmp_path / "path.geojson")
    assert [file.name for file in tmp_path.iterdir()] == ["path.geojson"]
    assert json.loads((tmp_path / "path.geojson").read_text())["type"] == "FeatureCollection"


def test_a_climb_on_a_straight_line_is_a_waypoint_with_its_altitude_in_every_format(tmp_path):
    east = np.column_stack([np.linspace(0, 45, 10), np.zeros(10)]) + staircase()[0]
    route = Route(east, climb_m=12.25)
    for suffix in (".geojson", ".kml", ".plan"):
        write_path(route, tmp_path / f"path{suffix}")
    items = json.loads((tmp_path / "path.plan").read_text())["mission"]["items"]
    assert [item["Altitude"] for item in items] == [60.0, 60.0, 72.25, 72.25, 0.0]
    frame = geopandas.read_file(tmp_path / "path.geojson")
    assert list(frame["z_m"][0]) == route.z_m.tolist()
    text = ElementTree.parse(tmp_path / "path.kml").find(".//{*}coordinates").text
    assert [float(point.split(",")[2]) for point in text.split()] == route.z_m.tolist()


@dataclass(frozen=True)
class Report:
    """What `explain` tells, without the explaining."""

    lines: tuple[np.ndarray, ...]

    def to_dict(self):
        segments = [{"segment": 1, "cost": 5.0, "people_overflown": None}, {"segment": 2, "cost": 7.5}]
        return {"speed_m_s": 12.0, "people_overflown": 31.5, "segments": segments}


@pytest.fixture
def report(route) -> Report:
    return Report((route.lonlat[:150], route.lonlat[149:]))


def test_geojson_with_a_report_holds_the_path_and_a_line_for_each_segment(route, report, tmp_path):
    file = tmp_path / "path.geojson"
    assert write_path(route, file, report)
    path, first, second = json.loads(file.read_text(), parse_constant=pytest.fail)["features"]
    assert (path["properties"]["cost"], path["properties"]["people_overflown"]) == (12.5, 31.5)
    assert "segments" not in path["properties"]
    assert (first["properties"]["segment"], second["properties"]["cost"]) == (1, 7.5)
    frame = geopandas.read_file(file)
    assert frame["segment"].tolist()[1:] == [1, 2]
    whole = shapely.line_merge(shapely.union_all(frame.geometry[1:].to_list()))
    assert whole.equals(frame.geometry[0])


def test_kml_and_plan_take_the_facts_of_a_report(route, report, tmp_path):
    write_path(route, tmp_path / "path.kml", report)
    root = ElementTree.parse(tmp_path / "path.kml").getroot()
    assert root.findtext(".//k:Data[@name='people_overflown']/k:value", namespaces=KML) == "31.5"
    write_path(route, tmp_path / "path.plan", report)
    mission = json.loads((tmp_path / "path.plan").read_text())["mission"]
    assert (mission["cruiseSpeed"], mission["hoverSpeed"]) == (12.0, 12.0)
