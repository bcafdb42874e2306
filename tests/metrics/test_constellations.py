"""More satellites than one word holds: from several element sets to maps and run.json."""

import json

import numpy as np

from jaxurban.kernels.dop import unit_vectors
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario import Scenario
from tests.io.test_orbits import WALKER, walker_tle
from tests.kernels.test_dop import inverse_dops


def test_more_than_32_satellites_of_four_systems_count_in_the_dops_of_an_open_sky_and_in_run_json(tmp_path):
    files = [tmp_path / f"{system}.tle" for system in WALKER]
    for i, file in enumerate(files):
        file.write_text(walker_tle(file.stem, 40_000 + 100 * i))
    region = {"bounds": [-74.0, 40.755, -73.995, 40.76], "resolution_m": 20, "altitudes_m": [20, 800]}
    gps = {"orbits": ["nominal", *map(str, files)], "times": ["2020-04-27T03:00:00Z"], "mask_deg": 5.0}
    sections = {"region": region, "buildings": {"source": "synthetic"}, "gps": gps, "lidar": {"azimuths": 12}}
    made = run_scenario(Scenario.from_dict(sections), tmp_path / "out")
    above = [s for s in made.record["satellites"] if s["elevation_deg"][0] >= 5.0]
    assert len(above) > 32
    azimuth, elevation = (np.radians([s[name][0] for s in above]) for name in ("azimuth_grid_deg", "elevation_deg"))
    clocks = np.array([("gps", *WALKER).index(s["system"]) for s in above])
    gdop = inverse_dops(unit_vectors(azimuth, elevation), clocks, np.ones((1, len(above))))[0, 0]
    ds = made.maps[20.0].ds
    assert (ds["num_visible"].sel(altitude=800) == len(above)).all()  # above all roofs
    np.testing.assert_allclose(ds["gdop"].sel(altitude=800), gdop, rtol=1e-4)
    assert ds["num_visible"].sel(altitude=20).min() < len(above)
    record = json.loads((tmp_path / "out/run.json").read_text())
    counts = record["satellites_above_mask"]
    assert set(counts) == {"gps", *WALKER}
    assert sum(count for (count,) in counts.values()) == len(above)
    assert {role for role in record["inputs"] if role.startswith("orbits")} == {"orbits", "orbits_2", "orbits_3"}
    assert record["settings"]["gps"]["orbits"][0] == "nominal"
