"""The summary says what the maps hold, in numbers that can be counted by hand."""

import numpy as np
import pytest
import xarray as xr

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.base import Path, Status
from jaxurban.report.demo import summary_markdown

ROWS, COLS, RESOLUTION_M = 4, 5, 10.0
FLOWN = ("altitude", "y", "x")


def make_maps(with_population: bool = True, altitudes_m=(20.0, 600.0)) -> MetricMaps:
    """4 x 5 cells; at the lower altitude 5 are obstacles, and of 15 free ones 6 prefer lidar and 3 have no fix."""
    low = np.zeros((ROWS, COLS), np.float32)
    obstacle = np.zeros((2, ROWS, COLS), np.uint8)
    obstacle[0, 0] = 1
    gps, lidar = np.stack([low, low + 0.9]), np.stack([low, low])
    gps[0, 1:], lidar[0, 1:] = 0.8, 0.1
    gps[0, 1, :], lidar[0, 1, :] = 0.2, 0.7
    gps[0, 2, 0], lidar[0, 2, 0] = 0.2, 0.7
    gdop = np.where(gps == 0.2, 7.0, 2.0)
    gdop[0, 3, :3] = np.inf
    risk = np.where(obstacle == 1, 0.0, 0.5).astype(np.float32)
    num = len(altitudes_m)
    data = {
        "obstacle": (FLOWN, obstacle[:num]),
        "gps": (("time", *FLOWN), gps[None, :num]),
        "gdop": (("time", *FLOWN), gdop[None, :num]),
        "lidar": (FLOWN, lidar[:num]),
        "risk": (FLOWN, risk[:num]),
        "roof": (("y", "x"), np.where(obstacle[0] == 1, 123.4, 0.0)),
        "has_data": (("y", "x"), np.ones((ROWS, COLS), bool)),
    }
    coords = {"altitude": list(altitudes_m), "time": np.array(["2020-04-27T16:00:00"], "datetime64[ns]")}
    if with_population:
        density = np.stack([low + 30_000, low + 10_000])
        data["population"] = (("time_of_day", "y", "x"), density / 30_000)
        data["density"] = (("time_of_day", "y", "x"), density)
        coords["time_of_day"] = ["day", "night"]
    attrs = {"crs": "EPSG:32618", "resolution_m": RESOLUTION_M, "first_row": 450_700, "first_col": 58_400}
    return MetricMaps(
        xr.Dataset(data, coords=coords, attrs=attrs | {"satellites": ", ".join(f"G{i}" for i in range(9))})
    )


def make_path(planner: str, status: Status, cost: float = np.inf, altitude_m: float = 20.0) -> PlannedPath:
    xy_m = np.array([[584_005.0, 4_507_005.0], [584_045.0, 4_507_035.0]]) if status.has_path else np.empty((0, 2))
    names = ("gps", "lidar", "population", "risk")
    return PlannedPath(
        status=status,
        xy_m=xy_m,
        lonlat=xy_m,
        z_m=np.full(len(xy_m), altitude_m),
        altitude_m=altitude_m,
        cost=cost,
        cost_by_layer={},
        length_m=1500.0 if status.has_path else np.inf,
        metrics={name: 0.25 for name in names} if status.has_path else {},
        snap_distance_m=(0.0, 0.0),
        search=Path(status, xy_m, cost, -np.inf, 10, 0.5, planner, graph="8-neighbour grid"),
        settings={
            "time": "2020-04-27T16:00:00Z",
            "time_of_day": "day",
            "cost_model": "cell",
            "weights": {"distance": 0.1, "gps": 1.0},
            "objective": "weighted",
            "obstacles": "touched",
            "limits": {"vertical_clearance_m": 3.0},
            "resolution_m": 5.0,
        },
        crs="EPSG:32618",
    )


@pytest.fixture(scope="module")
def summary() -> str:
    planned = [
        make_path("ptp", Status.BLOCKED),
        make_path("astar-dist", Status.OPTIMAL, 110.0),
        make_path("astar-plus", Status.OPTIMAL, 100.0),
    ]
    return summary_markdown(make_maps(), {20.0: planned})


def row_of(summary: str, *starts: str) -> list[str]:
    """The cells of the one table row that starts with these cells."""
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in summary.splitlines() if line[:1] == "|"]
    (row,) = [row for row in rows if tuple(row[: len(starts)]) == starts]
    return row


def test_table_by_altitude_counts_free_cells_only(summary):
    # 6 of 15 free cells at gps 0.2 and lidar 0.7, 9 at 0.8 and 0.1; 6 at GDOP 7, 3 without a fix
    mean_gps, mean_lidar = (6 * 0.2 + 9 * 0.8) / 15, (6 * 0.7 + 9 * 0.1) / 15
    expected = ["20", "0.25", f"{mean_gps:.3g}", f"{mean_lidar:.3g}", "0.5", "0.6", "0.4", "0.2", "-1"]
    assert row_of(summary, "20", "0.25") == expected
    assert "highest 123 m" in summary
    assert row_of(summary, "600")[1:] == ["0", "0.9", "0", "0.5", "1", "1", "0", ""]


def test_population_is_density_times_area(summary):
    # 20 cells of 100 m2 are 0.002 km2
    assert row_of(summary, "day")[1:3] == ["60", "30,000"]
    assert row_of(summary, "night")[1:3] == ["20", "10,000"]


def test_paths_are_compared_with_the_cheapest(summary):
    assert row_of(summary, "20", "day", "ptp")[4:13] == ["blocked", "0.5"] + [""] * 7
    found = row_of(summary, "20", "day", "astar-plus")
    assert found[3:10] == ["8-neighbour grid", "optimal", "0.5", "100", "0", "1500", "0.25"]
    assert row_of(summary, "20", "day", "astar-dist")[6:8] == ["110", "0.1"]
    rules = "cost model: cell  ·  weights: distance 0.1, gps 1  ·  obstacles: touched, vertical clearance of 3 m"
    assert f"Planned under: {rules}." in summary


def test_a_report_without_paths_names_none_and_one_with_says_of_which_graph_a_path_is_optimal(summary):
    alone = summary_markdown(make_maps(), {})
    assert alone.startswith("# Metric maps: summary")
    assert "and paths" not in alone
    assert "(figures/cost_day.png)" in alone
    assert "(figures/paths.png)" not in alone
    assert summary.startswith("# Metric maps and paths: summary")
    assert "(figures/paths.png)" in summary
    assert "*optimal* says that no path of the planner's own graph is cheaper" in summary


def test_what_run_json_holds_is_told():
    run = {
        "elapsed_s": {"read": 1.0, "gps": 3.0},
        "inputs": {"buildings": {"path": "city.osm.pbf", "sha256": "00"}},
        "buildings": {"in_region": 1234, "height_origin_counts": {"height": 1200, "default": 34}},
        "population": {"day": {"commercial": 5000.0, "residential": 600.0, "other": 7.0, "total": 5607.0}},
        "rays_leave_data_share": {"20": 0.125, "600": 0.0},
        "warnings": ["elements are 20 days old"],
    }
    summary = summary_markdown(make_maps(), {}, run)
    assert row_of(summary, "buildings in the region") == ["buildings in the region", "1234"]
    assert row_of(summary, "heights from: default")[1] == "34"
    assert row_of(summary, "source of buildings")[1] == "`city.osm.pbf`"
    assert row_of(summary, "seconds: gps")[1] == "3"
    assert row_of(summary, "day")[3:] == ["5000", "600", "7", "5607"]
    assert row_of(summary, "night")[3:] == [""] * 4
    assert row_of(summary, "cells at 20 m with a ray that leaves the data")[1] == "12.5%"
    assert row_of(summary, "warned")[1] == "elements are 20 days old"
    assert "## Paths" not in summary


def test_summary_without_population_one_altitude_and_nothing_free():
    maps = make_maps(with_population=False, altitudes_m=(20.0,))
    assert "## Population" not in summary_markdown(maps, {})
    maps.ds["obstacle"][:] = 1
    assert row_of(summary_markdown(maps, {}), "20")[1:] == ["1"] + [""] * 7
    assert "nan" not in summary_markdown(maps, {})


def test_summary_is_markdown_with_every_picture_linked(summary):
    for name in (
        "overview",
        "heights",
        "obstacle",
        "gps",
        "gps_rating",
        "lidar",
        "sensor_choice",
        "risk",
        "population",
    ):
        assert f"(figures/{name}.png)" in summary
    assert summary.startswith("# ")
    assert summary.endswith("\n")
    tables = [block.splitlines() for block in summary.split("\n\n") if block.startswith("|")]
    assert len(tables) == 3
    assert all(len({line.count("|") for line in table}) == 1 for table in tables)
