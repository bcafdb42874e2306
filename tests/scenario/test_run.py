"""Jobs: what makes maps current, what is swept, what a full disk and a damaged folder do."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import rasterio
import shapely

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io import files
from jaxurban.io.store import settings_of
from jaxurban.maps import provenance as record
from jaxurban.maps import run as pipeline
from jaxurban.maps.scenario import Scenario
from jaxurban.world.city import Footprints, Raster
from tests.cli_runs import assert_one_sentence, run

REGION = {"bounds": [-74.0, 40.755, -73.993, 40.761], "resolution_m": 20, "altitudes_m": [20]}
SETTINGS = {"region": REGION, "buildings": {"source": "synthetic"}}


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    pipeline.run_scenario(Scenario.from_dict(SETTINGS), folder)
    return folder


@pytest.fixture
def job(finished, tmp_path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "job"))


def test_maps_of_other_code_are_not_current(job, monkeypatch):
    inputs: dict = {}
    key = record.run_key(Scenario.from_dict(SETTINGS), inputs, jax.default_backend())
    assert pipeline.stored_key(job, 20.0) == key
    monkeypatch.setattr(record, "code_hash", lambda: "other code")
    assert record.run_key(Scenario.from_dict(SETTINGS), inputs, jax.default_backend()) != key


def test_weights_and_planning_do_not_make_maps_stale():
    key = record.run_key(Scenario.from_dict(SETTINGS), {}, "cpu")
    assert record.run_key(Scenario.from_dict(SETTINGS | {"weights": {"gps": 3}}), {}, "cpu") == key
    assert record.run_key(Scenario.from_dict(SETTINGS | {"gps": {"mask_deg": 6}}), {}, "cpu") != key
    assert record.run_key(Scenario.from_dict(SETTINGS), {}, "gpu") != key


def test_a_name_with_brackets_is_hashed_with_its_companions(tmp_path):
    shape = tmp_path / "b[1].shp"
    for suffix in (".shp", ".dbf"):
        shape.with_suffix(suffix).write_bytes(suffix.encode())
    scenario = Scenario.from_dict({"region": REGION, "buildings": {"source": str(shape)}})
    first = record.hash_inputs(scenario)["buildings"]["sha256"]
    shape.with_suffix(".dbf").write_bytes(b"changed")
    assert record.hash_inputs(scenario)["buildings"]["sha256"] != first


def test_only_our_own_scraps_are_swept(tmp_path):
    theirs = [tmp_path / ".movie.mkv.part", tmp_path / ".backup.old" / "letter.txt"]
    ours = tmp_path / "geotiff" / f".gps_20m_5m.tif.0a1b2c3d{files.SCRATCH_SUFFIX}"
    for path in (*theirs, ours):
        path.parent.mkdir(exist_ok=True)
        path.write_text("x")
    files.sweep_scraps(tmp_path, tmp_path / "geotiff")
    assert all(path.exists() for path in theirs)
    assert not ours.exists()


def test_what_a_killed_worker_left_half_written_is_gone_when_the_run_ends(job, monkeypatch):
    scrap, (file, *_) = job / "geotiff" / f".gps.tif.0a1b2c3d{files.SCRATCH_SUFFIX}", (job / "geotiff").glob("*.tif")
    before, write = file.read_bytes(), pipeline.write_geotiffs
    file.unlink()
    monkeypatch.setattr(pipeline, "write_geotiffs", lambda *given, **more: (write(*given, **more), scrap.touch()))
    pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)
    assert not scrap.exists()
    assert file.read_bytes() == before


@pytest.mark.slow
def test_worker_processes_write_the_same_geotiffs(tmp_path):
    for name, workers in (("threads", None), ("processes", 2)):
        pipeline.run_scenario(Scenario.from_dict(SETTINGS), tmp_path / name, workers=workers, layers=("all",))
    threads, processes = (
        {file.name: file.read_bytes() for file in (tmp_path / name / "geotiff").iterdir()}
        for name in ("threads", "processes")
    )
    assert len(threads) > 20
    assert threads == processes


def test_a_folder_in_the_way_of_a_file_is_kept(tmp_path, capsys):
    (tmp_path / "run.json" / "letters").mkdir(parents=True)
    with pytest.raises(InputError, match="in the way"):
        pipeline.run_scenario(Scenario.from_dict(SETTINGS), tmp_path)
    assert (tmp_path / "run.json" / "letters").is_dir()


def test_a_disk_that_fills_up_is_one_sentence_and_leaves_nothing_half_written(tmp_path):
    (tmp_path / "scenario.toml").write_text(Scenario.from_dict(SETTINGS).to_toml())
    limited = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)); "
        "from jaxurban.cli.main import main; main(sys.argv[1:])"
    )
    command = [sys.executable, "-c", limited, "maps", str(tmp_path / "scenario.toml"), "-o", str(tmp_path / "out")]
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache")}
    ended = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=200, check=False)
    assert ended.returncode == 2, ended.stderr
    assert "cannot write" in ended.stderr.splitlines()[-1]
    assert "Traceback" not in ended.stderr
    assert not (tmp_path / "out" / "run.json").exists()


@pytest.mark.parametrize("damage", ["torn", "stray", "file"])
def test_a_damaged_folder_is_made_again_or_named(job, capsys, damage):
    if damage == "torn":
        (job / "maps.zarr" / "20m" / ".zmetadata").write_text("junk")
    elif damage == "stray":
        (job / "maps.zarr" / "20 copym").mkdir()
    else:
        (job / "geotiff" / "gps_20m_20m.tif").unlink()
    pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)
    assert ju.open_maps(job).m("gps", 20.0).shape == ju.open_maps(job).grid.shape
    assert (job / "geotiff" / "gps_20m_20m.tif").exists()


def test_torn_maps_are_named_when_planning(job, capsys):
    (job / "maps.zarr" / "20m" / ".zmetadata").write_text("junk")
    code, _, err = run(capsys, "plan", job, "--start", "-73.999,40.756", "--goal", "-73.994,40.76", "--altitude", 20)
    assert code == 2
    assert_one_sentence(err, ".zmetadata", "not as they were written", "jaxurban maps")


def test_a_free_cell_without_a_value_is_never_without_cost(job):
    maps = ju.open_maps(job)
    maps.ds["gps"][:] = np.nan
    free = np.argwhere(maps.is_free(20.0))
    ends = [(float(maps.grid.x_m[col]), float(maps.grid.y_m[row])) for row, col in (free[0], free[-1])]
    with pytest.raises(InputError, match="finite"):
        ju.plan(maps, start_xy_m=ends[0], goal_xy_m=ends[1], altitude_m=20.0)


def test_a_failed_job_leaves_no_empty_folder(tmp_path):
    with pytest.raises(InputError):
        pipeline.run_scenario(
            Scenario.from_dict({"region": REGION, "buildings": {"source": "none.osm"}}), tmp_path / "out"
        )
    assert not (tmp_path / "out").exists()


def test_a_region_beyond_the_data_warns(tmp_path, capsys):
    west, south, east, north = -74.0, 40.755, -73.993, 40.761
    ring = [[west, south], [west + 0.001, south], [west + 0.001, north], [west, north], [west, south]]
    (tmp_path / "city.geojson").write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"height": 30}, '
        f'"geometry": {{"type": "Polygon", "coordinates": [{ring}]}}}}]}}'
    )
    (tmp_path / "scenario.toml").write_text(
        f"[region]\nbounds = [{west}, {south}, {east}, {north}]\nresolution_m = 20\naltitudes_m = 20\n"
        '[buildings]\nsource = "city.geojson"\n'
    )
    code, _, err = run(capsys, "maps", tmp_path / "scenario.toml", "-o", tmp_path / "out")
    assert code == 0
    assert "of the region lies beyond" in err


def test_a_hill_beyond_the_buildings_hides_low_satellites():
    x, y = 500_000.0, 4_500_000.0
    heights = np.zeros((120, 120), np.float32)
    heights[80:90] = 3_000.0  # a ridge 1.5 to 2 km south of the region
    zero = np.zeros(1)
    city = ju.City(
        "EPSG:32618",
        (x, y, x + 400.0, y + 400.0),
        Footprints(
            np.array([shapely.box(x, y, x + 20, y + 20)], object), zero + 5, zero, zero.astype(np.uint8), zero > 0
        ),
        terrain=Raster(heights, (50.0, 0.0, x - 2_800.0, 0.0, -50.0, y + 2_600.0), "EPSG:32618"),
        terrain_extent_m=(x - 2_800.0, y - 3_400.0, x + 3_200.0, y + 2_600.0),
    )
    seen = ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,)).m("num_visible", 20.0)
    flat = ju.City(city.crs, city.extent_m, city.buildings)
    assert seen.mean() < ju.build_maps(flat, resolution_m=20.0, altitudes_m=(20.0,)).m("num_visible", 20.0).mean()


LONG = {"gps": {"start": "2020-04-27T00:00:00Z", "stop": "2020-04-27T06:00:00Z", "step_s": 900}}


def test_a_refused_job_leaves_the_old_maps_alone_even_with_overwrite(job, capsys):
    (job / "other.toml").write_text(Scenario.from_dict(SETTINGS | {"gps": {"mask_deg": 6.0}}).to_toml())
    before = {path: path.read_bytes() for path in job.rglob("*") if path.is_file()}
    code, _, err = run(capsys, "maps", job / "other.toml", "-o", job, "--overwrite", "--memory", "100MiB")
    assert code == 2
    assert "--memory" in err
    assert {path: path.read_bytes() for path in job.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("altitudes_m", [[20, 60], [60]])
def test_a_changed_scenario_is_refused_with_both_differences_and_a_new_folder(job, capsys, altitudes_m):
    (job.parent / "town.csv").write_text("new elements")
    orbits = {"gps": {"orbits": str(job.parent / "town.csv")}}
    made = files.read_json(job / "run.json")
    inputs = {"orbits": {"path": "town.csv", "sha256": "of the old elements"}}
    files.write_json(job / "run.json", made | {"inputs": inputs, "settings": made["settings"] | orbits})
    before = {path: path.read_bytes() for path in job.rglob("*") if path.is_file()}
    changed = Scenario.from_dict(SETTINGS | orbits | {"region": REGION | {"altitudes_m": altitudes_m}})
    with pytest.raises(
        InputError, match=r"altitudes_m was \[20.*other input files \(orbits.*-o \S*job-2\).*--overwrite"
    ):
        pipeline.run_scenario(changed, job)
    assert {path: path.read_bytes() for path in job.rglob("*") if path.is_file()} == before


def test_saved_maps_have_the_record_of_their_own_run_or_none(tmp_path):
    scenario = Scenario.from_dict(SETTINGS | {"weights": {"gps": 7}})
    made = next(iter(pipeline.run_scenario(scenario, tmp_path / "run").maps.values()))
    made.save(tmp_path / "copy")
    assert settings_of(tmp_path / "copy") == {}
    made.save(tmp_path / "run")
    assert settings_of(tmp_path / "run")["weights"]["gps"] == 7
    ju.build_maps(ju.demo_city(500, 500), resolution_m=made.grid.resolution_m, altitudes_m=[60.0]).save(
        tmp_path / "run"
    )
    assert settings_of(tmp_path / "run") == {}


def test_open_maps_refuse_to_read_those_of_another_run(job, tmp_path):
    maps, swapped = ju.open_maps(job), ju.open_maps(shutil.copytree(job, tmp_path / "swapped"))
    ends = [(float(maps.grid.x_m[k]), float(maps.grid.y_m[k])) for k in (2, -3)]
    chunk = job / "maps.zarr/20m/gps/0.0.0.0"
    chunk.unlink()
    pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)  # mended by the same run
    assert maps.m("gps", 20.0).size
    pipeline.run_scenario(Scenario.from_dict(SETTINGS | {"gps": {"mask_deg": 15.0}}), job, overwrite=True)
    (tmp_path / "swapped").rename(tmp_path / "old")
    shutil.copytree(job, tmp_path / "swapped")
    for each in (maps, swapped):
        with pytest.raises(InputError, match="made again or removed since they were opened"):
            each.m("risk", 20.0)
        with pytest.raises(InputError, match="open them again"):
            ju.plan(each, start_xy_m=ends[0], goal_xy_m=ends[1], altitude_m=20.0, snap=True)
    assert ju.open_maps(job).m("gps", 20.0).size


def test_open_maps_refuse_to_read_those_that_were_saved_over_them(tmp_path):
    made = ju.build_maps(ju.demo_city(500, 500), resolution_m=20.0, altitudes_m=(20.0,))
    made.save(tmp_path)
    maps = ju.open_maps(tmp_path)
    maps.m("risk", 20.0)
    made.save(tmp_path)
    with pytest.raises(InputError, match="made again or removed"):
        maps.m("risk", 20.0)


def test_a_second_run_in_the_same_folder_is_refused(job):
    with (
        files.only_writer(job),
        pytest.raises(InputError, match="another run is writing"),
    ):
        pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)
    pipeline.run_scenario(Scenario.from_dict(SETTINGS), job)


@pytest.mark.slow
def test_a_long_series_can_be_drawn_and_planned_on(tmp_path):
    from jaxurban.report.figures import save_figures

    done = pipeline.run_scenario(Scenario.from_dict(SETTINGS | LONG), tmp_path)
    maps = done.maps[20.0]
    free = np.argwhere(maps.is_free(20.0))
    ends = [(float(maps.grid.x_m[col]), float(maps.grid.y_m[row])) for row, col in (free[0], free[-1])]
    path = ju.plan(maps, start_xy_m=ends[0], goal_xy_m=ends[1], altitude_m=20.0)
    assert path.settings["time"] is None
    names = {file.name for file in save_figures(maps, [path], tmp_path / "figures")}
    assert {"gps.png", "sensor_choice.png", "paths.png", "overview.png"} <= names


def test_spreads_are_not_taken_for_statistics_over_time(tmp_path):
    pipeline.run_scenario(
        Scenario.from_dict(SETTINGS | {"buildings": {"source": "synthetic", "height_samples": 2}}), tmp_path
    )
    assert "gps_p05" in ju.open_maps(tmp_path).ds
    assert not list((tmp_path / "geotiff").glob("gps_p05*"))


def test_people_from_a_raster_and_every_credit_reach_the_files(tmp_path):
    west, south, _, north = REGION["bounds"]
    ring = [[west, south], [west + 0.001, south], [west + 0.001, north], [west, north], [west, south]]
    (tmp_path / "city.geojson").write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"height": 30}, '
        f'"geometry": {{"type": "Polygon", "coordinates": [{ring}]}}}}]}}'
    )
    people = np.random.default_rng(0).integers(0, 200, (16, 16)).astype(np.int32)
    place = rasterio.Affine(1 / 1200, 0, west - 0.004, 0, -1 / 1200, north + 0.004)
    options = {"driver": "GTiff", "width": 16, "height": 16, "count": 1, "dtype": "int32", "nodata": -9999}
    with rasterio.open(tmp_path / "people.tif", "w", crs="EPSG:4326", transform=place, **options) as file:
        file.write(people, 1)
    settings = {
        "region": REGION,
        "buildings": {"source": "city.geojson", "credit": "© a town"},
        "population": {"blocks": "people.tif", "credit": "© a count"},
    }
    made = pipeline.run_scenario(Scenario.from_dict(settings, folder=tmp_path), tmp_path / "out")
    maps = made.maps[20.0]
    assert maps.ds.attrs["attribution"] == "© a town; © a count"
    with rasterio.open(tmp_path / "out" / "geotiff" / "population_night_20m.tif") as file:
        assert file.tags()["credit"] == "© a town; © a count"
    cell_km2 = maps.grid.resolution_m**2 / 1e6
    in_cells = float(maps.m("density", time_of_day="night").sum(dtype=np.float64)) * cell_km2
    inside = made.record["population_in_region"]["night"]["total"]
    assert in_cells == pytest.approx(inside, rel=0.01)
    assert 0 < inside < people.sum()
