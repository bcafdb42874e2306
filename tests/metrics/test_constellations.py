"""More satellites than one word holds: from several element sets to maps and run.json."""

import json
import math

import numpy as np
import pytest

from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from tests.io.test_orbits import WALKER, walker_tle

TIME = "2020-04-27T03:00:00Z"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    files = []
    for i, system in enumerate(WALKER):
        files.append(folder / f"{system}.tle")
        files[-1].write_text(walker_tle(system, 40_000 + 100 * i))
    region = {"bounds": [-74.0, 40.755, -73.995, 40.76], "resolution_m": 20, "altitudes_m": [20, 800]}
    gps = {"orbits": ["nominal", *map(str, files)], "times": [TIME], "mask_deg": 5.0}
    sections = {"region": region, "buildings": {"source": "synthetic"}, "gps": gps, "lidar": {"azimuths": 12}}
    return run_scenario(Scenario.from_dict(sections), folder / "out"), folder / "out"


def test_more_than_32_satellites_of_four_systems_count_in_the_dops_of_an_open_sky(run):
    made, _ = run
    satellites = made.record["satellites"]
    above = [s for s in satellites if s["elevation_deg"][0] >= 5.0]
    assert len(above) > 32
    azimuth, elevation = (np.radians([s[name][0] for s in above]) for name in ("azimuth_grid_deg", "elevation_deg"))
    clocks = [[-float(s["system"] == system) for s in above] for system in ("gps", *WALKER)]
    places = [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)]
    rows = np.column_stack([*clocks, *places])
    variance = np.diag(np.linalg.inv(rows.T @ rows))
    gdop = math.sqrt(variance[-3:].sum() + variance[0])  # of the position and the first system's clock
    ds = made.maps[20.0].ds
    assert (ds["num_visible"].sel(altitude=800) == len(above)).all()  # above all roofs
    np.testing.assert_allclose(ds["gdop"].sel(altitude=800), gdop, rtol=1e-4)
    assert ds["num_visible"].sel(altitude=20).min() < len(above)


def test_run_json_counts_satellites_by_system_and_names_every_file(run):
    _, folder = run
    record = json.loads((folder / "run.json").read_text())
    counts = record["satellites_above_mask"]
    assert set(counts) == {"gps", *WALKER}
    assert sum(count for (count,) in counts.values()) == sum(s["elevation_deg"][0] >= 5.0 for s in record["satellites"])
    assert {role for role in record["inputs"] if role.startswith("orbits")} == {"orbits", "orbits_2", "orbits_3"}
    assert record["settings"]["gps"]["orbits"][0] == "nominal"
