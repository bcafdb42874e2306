"""Real Manhattan through the whole program: the census adds up, and a sub-box equals the crop."""

import json
import re

import numpy as np
import pytest

import jaxurban as ju
from figures.paper.common import CENSUS, ORBITS, OSM, population_totals
from jaxurban.maps.run import load_city
from jaxurban.maps.scenario import Scenario
from tests.cli_runs import run

pytestmark = pytest.mark.data

REFERENCE = (-74.0, 40.715)


@pytest.mark.slow
def test_the_census_of_all_manhattan_adds_up(data_dir, tmp_path, capsys):
    scenario = tmp_path / "manhattan.toml"
    scenario.write_text(
        "[region]\nbounds = [-74.05, 40.68, -73.90, 40.885]\nresolution_m = 10\naltitudes_m = [600]\n"
        f'[buildings]\nsource = "{OSM}"\n[population]\ntime_of_day = "night"\n'
        + "".join(f'{key} = "{path}"\n' for key, path in CENSUS.items())
    )
    assert run(capsys, "maps", scenario, "-o", tmp_path / "out")[0] == 0
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    night = population_totals(load_city(Scenario.from_toml(scenario)).blocks)["night"]
    assert (night["commercial"], night["residential"], night["total"]) == (
        611_934,
        965_451,
        1_585_873,
    )
    assert re.search(
        r"\(1,820 m2\) with 709,326 people per km2 .* gets 0\.06;", "\n".join(record["warnings"])
    )
    maps = ju.open_maps(tmp_path / "out")
    people = maps.m("density", time_of_day="night").sum(dtype=float) * (10.0 / 1000.0) ** 2
    assert people == pytest.approx(1_585_873, rel=0.005)


@pytest.mark.slow
def test_maps_of_a_sub_box_equal_the_crop_of_lower_manhattan(data_dir):
    def maps_of(bounds):
        city = ju.City.from_files(OSM, bounds=bounds)
        return ju.build_maps(
            city, bounds, altitudes_m=(20.0, 122.0), gps=ju.Gps(orbits=ORBITS, reference=REFERENCE)
        )

    whole, part = (
        maps_of((-74.02, 40.70, -73.98, 40.73)),
        maps_of((-74.011, 40.705, -74.002, 40.712)),
    )
    rows, cols = part.grid.window_in(whole.grid)
    for name in ("obstacle", "gps", "gdop", "num_visible", "lidar", "risk", "roof"):
        np.testing.assert_array_equal(
            part.ds[name].values, whole.ds[name].values[..., rows, cols], err_msg=name
        )
