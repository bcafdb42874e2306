"""Bad sources through the command line: one clear sentence, exit code 2 (3 for no path), nothing half-written."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import osmium
import pandas as pd
import pytest
import rasterio
from affine import Affine

from jaxurban.errors import InputError
from jaxurban.io.files import check_writable
from jaxurban.io.tables import read_table
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps

WEST, SOUTH, EAST, NORTH = -74.012, 40.706, -74.008, 40.709
SYNTHETIC_BOUNDS = (-74.0, 40.755, -73.993, 40.761)


def write_scenario(folder: Path, source: str, extra: str = "", bounds=(WEST, SOUTH, EAST, NORTH)) -> Path:
    path = folder / "scenario.toml"
    path.write_text(
        f"[region]\nbounds = {list(bounds)}\nresolution_m = 10\naltitudes_m = [20]\n"
        f'[buildings]\nsource = "{source}"\n{extra}'
    )
    return path


def rectangle(west: float, south: float, east: float, north: float) -> list[list[float]]:
    return [[west, south], [east, south], [east, north], [west, north], [west, south]]


def write_geojson(path: Path, *rings: list[list[float]], height="30") -> None:
    features = [
        {
            "type": "Feature",
            "properties": {"height": height, "building": "yes"},
            "geometry": {"type": "Polygon", "coordinates": [ring] if isinstance(ring[0][0], float) else ring},
        }
        for ring in rings
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def write_pbf(path: Path) -> None:
    with osmium.SimpleWriter(str(path)) as writer:
        for i in range(4000):
            writer.add_node(osmium.osm.mutable.Node(id=i + 1, location=(WEST + i * 1e-6, SOUTH + (i % 7) * 1e-4)))
        for i in range(0, 4000, 4):
            nodes = [i + 1, i + 2, i + 3, i + 4, i + 1]
            writer.add_way(osmium.osm.mutable.Way(id=i + 1, nodes=nodes, tags={"building": "yes", "height": "20"}))


def fails(capsys, tmp_path, scenario: Path, *words: str) -> None:
    code, out, err = run(capsys, "maps", scenario, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert_one_sentence(err, *words)
    assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]


def test_a_truncated_pbf(tmp_path, capsys):
    path = tmp_path / "city.osm.pbf"
    write_pbf(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    fails(capsys, tmp_path, write_scenario(tmp_path, path.name), "city.osm.pbf")


def test_a_geojson_in_metres(tmp_path, capsys):
    write_geojson(tmp_path / "city.geojson", rectangle(583_000.0, 4_506_000.0, 583_100.0, 4_506_100.0))
    fails(capsys, tmp_path, write_scenario(tmp_path, "city.geojson"), "city.geojson", "CRS")


def test_a_region_without_buildings_tells_where_they_are(tmp_path, capsys):
    write_geojson(tmp_path / "city.geojson", rectangle(-73.95, 40.75, -73.949, 40.751))
    fails(
        capsys, tmp_path, write_scenario(tmp_path, "city.geojson"), "no building in the region", "-73.95", "allow_none"
    )


def test_a_region_without_buildings_is_fine_when_asked_for(tmp_path, capsys):
    write_geojson(tmp_path / "city.geojson", rectangle(-73.95, 40.75, -73.949, 40.751))
    code, _, _ = run(
        capsys, "maps", write_scenario(tmp_path, "city.geojson", "allow_none = true"), "-o", tmp_path / "out"
    )
    assert code == 0


def test_bounds_with_latitude_first_are_recognised(tmp_path, capsys):
    write_geojson(tmp_path / "city.geojson", rectangle(WEST, SOUTH, EAST, NORTH))
    swapped = write_scenario(tmp_path, "city.geojson", bounds=(SOUTH, WEST, NORTH, EAST))
    fails(capsys, tmp_path, swapped, "latitude and longitude look swapped")


def test_elements_years_old(tmp_path, capsys, data_dir):
    orbits = data_dir / "gps" / "gps-ops_2020-04-27.tle"
    extra = f'[gps]\norbits = "{orbits}"\ntimes = ["2026-01-01T00:00:00Z"]\n'
    scenario = write_scenario(tmp_path, "synthetic", extra, bounds=SYNTHETIC_BOUNDS)
    fails(capsys, tmp_path, scenario, "days", "max_age_days")


def test_elements_weeks_old_warn_and_work(tmp_path, capsys, data_dir):
    orbits = data_dir / "gps" / "gps-ops_2020-04-27.tle"
    extra = f'[gps]\norbits = "{orbits}"\ntimes = ["2020-05-20T00:00:00Z"]\n'
    scenario = write_scenario(tmp_path, "synthetic", extra, bounds=SYNTHETIC_BOUNDS)
    code, _, err = run(capsys, "maps", scenario, "-o", tmp_path / "out")
    assert code == 0
    assert "warning: " in err
    (warning,) = json.loads((tmp_path / "out" / "run.json").read_text())["warnings"]
    assert "days" in warning


@pytest.mark.parametrize(("nodata", "words"), [(None, ("NaN", "nodata")), (-1.0, ("NaN", "nodata"))])
def test_nan_in_a_height_raster(tmp_path, capsys, nodata, words):
    heights = np.full((60, 60), 12.0, np.float32)
    heights[10, 10] = np.nan
    transform = Affine(10.0, 0.0, 583_400.0, 0.0, -10.0, 4_507_000.0)
    profile = {"width": 60, "height": 60, "count": 1, "dtype": "float32", "crs": "EPSG:32618", "transform": transform}
    with rasterio.open(tmp_path / "heights.tif", "w", driver="GTiff", nodata=nodata, **profile) as file:
        file.write(heights, 1)
    fails(capsys, tmp_path, write_scenario(tmp_path, "heights.tif"), "heights.tif", *words)


def test_a_goal_that_is_walled_in_ends_with_exit_code_three(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxurban.progress.SILENT_S", 600.0)  # compiling into empty caches may take longer than 5 s
    outer = rectangle(-74.0112, 40.7068, -74.0098, 40.7082)
    court = rectangle(-74.0108, 40.7072, -74.0102, 40.7078)
    write_geojson(tmp_path / "city.geojson", [outer, court])
    assert run(capsys, "maps", write_scenario(tmp_path, "city.geojson"), "-o", tmp_path / "out")[0] == 0
    code, out, err = run(
        capsys,
        "plan",
        tmp_path / "out",
        "--start",
        "-74.0118,40.7062",
        "--goal",
        "-74.0105,40.7075",
        "--altitude",
        20,
        "--json",
    )
    assert (code, err) == (3, "")
    facts = json.loads(out)
    assert facts["status"] == "no-path"
    assert facts["cost"] is None
    assert "fly higher" in facts["message"]


def test_a_torn_run_file_is_named(tmp_path, capsys):
    made_maps().save(tmp_path)
    (tmp_path / "run.json").write_text('{"settings": ')
    code, _, err = run(capsys, "plan", tmp_path, "--start", "-74,40.7", "--goal", "-74,40.71", "--altitude", 20)
    assert code == 2
    assert_one_sentence(err, "run.json")


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["JAX_PLATFORMS=bogus", "JAX_PLATFORMS=cuda", "JAX_ENABLE_X64=bogus"])
def test_a_variable_of_the_environment_that_libraries_refuse_is_one_sentence(tmp_path, setting):
    scenario = write_scenario(tmp_path, "synthetic", bounds=SYNTHETIC_BOUNDS)
    name, value = setting.split("=")
    command = [sys.executable, "-m", "jaxurban", "maps", scenario, "-o", tmp_path / "out"]
    done = subprocess.run(command, env=os.environ | {name: value}, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert_one_sentence(done.stderr.splitlines()[-1], name)
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("time", ["9999-12-31T23:59:59-10:00", "0001-01-01T00:00:00+10:00", "1979-12-31T00:00:00Z"])
def test_a_time_without_satellites_is_refused(tmp_path, capsys, time):
    scenario = write_scenario(tmp_path, "synthetic", f'[gps]\ntimes = ["{time}"]\n', SYNTHETIC_BOUNDS)
    fails(capsys, tmp_path, scenario, f"gps: {time!r} is not a time")


@pytest.mark.parametrize("text", ["a = " + "{a = " * 3000 + "1" + "}" * 3000, ".".join("a" * 5000) + " = 1"])
def test_tables_in_tables_without_end_are_one_sentence(tmp_path, capsys, text):
    scenario = tmp_path / "deep.toml"
    scenario.write_text(text)
    fails(capsys, tmp_path, scenario, "deep.toml")


def test_a_name_with_nul_is_one_sentence(tmp_path, capsys):
    scenario = write_scenario(tmp_path, "a\\u0000b.geojson")
    fails(capsys, tmp_path, scenario, "buildings", "null")


def test_an_endless_source_is_one_sentence(tmp_path, capsys):
    (tmp_path / "endless.geojson").symlink_to("/dev/zero")
    fails(capsys, tmp_path, write_scenario(tmp_path, "endless.geojson"), "a pipe or a device")


def test_a_table_of_lists_is_refused_by_its_column(tmp_path):
    pd.DataFrame({"crs": [["EPSG:32618"]], "altitude_m": [20.0]}).to_parquet(tmp_path / "lists.parquet")
    with pytest.raises(InputError, match=r"lists\.parquet.*'crs' holds lists"):
        read_table(tmp_path / "lists.parquet", "instances")


def test_an_output_folder_whose_name_is_no_text_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot write to the output folder"):
        check_writable(tmp_path / "\udcff")


def test_more_instances_than_any_study_has_are_refused(tmp_path, capsys):
    scenario = write_scenario(tmp_path, "synthetic", "[study]\ninstances = 1000000000\n", SYNTHETIC_BOUNDS)
    fails(capsys, tmp_path, scenario, "study: instances must be at most 1,000,000")


@pytest.mark.parametrize("command", ["compare", "validate"])
def test_an_output_folder_of_others_is_refused_before_the_work(tmp_path, capsys, monkeypatch, command):
    from jaxurban.studies import map_comparison
    from jaxurban.studies.receiver import validate

    def work(*_, **__):
        raise AssertionError("the work began")

    monkeypatch.setattr(map_comparison, "compare", work)
    monkeypatch.setattr(validate, "validate", work)
    scenario = tmp_path / "city.toml"
    scenario.write_text('[region]\nbounds = [-74.0, 40.755, -73.993, 40.761]\n[buildings]\nsource = "synthetic"\n')
    (tmp_path / "out").mkdir()
    (tmp_path / "out/notes.txt").write_text("mine")
    inputs = (scenario, tmp_path / "log.csv") if command == "validate" else (tmp_path / "a", tmp_path / "b")
    code, _, err = run(capsys, command, *inputs, "-o", tmp_path / "out")
    assert (code, "notes.txt' is there already, and not from" in err) == (2, True)
