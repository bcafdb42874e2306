"""Jobs: what makes maps current, what is swept, what a full disk and a damaged folder do."""

import shutil
import tomllib
from dataclasses import replace

import jax
import numpy as np
import pytest
import rasterio
import shapely

import jaxurban as ju
from figures.paper.common import population_totals
from jaxurban.errors import InputError
from jaxurban.io import files
from jaxurban.io.stored import stored_settings
from jaxurban.maps import provenance as record
from jaxurban.maps import run as pipeline
from jaxurban.maps.scenario import Scenario
from jaxurban.world.raster import Raster
from tests.cli_runs import TOWN, run, write_city
from tests.made_maps import city_of_boxes, made_maps
from tests.tiled_runs import files_of

SETTINGS = tomllib.loads(TOWN)
REGION = SETTINGS["region"]


def job_of(**sections) -> Scenario:
    """Return the town's scenario with other sections."""
    return Scenario.from_dict(SETTINGS | sections)


def far_ends(maps) -> dict:
    """Return the first and the last free cell, as `plan` takes them."""
    free = np.argwhere(maps.is_free(20.0))
    ends = [
        (float(maps.grid.x_m[col]), float(maps.grid.y_m[row])) for row, col in (free[0], free[-1])
    ]
    return {"start": ju.XY(*ends[0]), "goal": ju.XY(*ends[1]), "altitude_m": 20.0}


def test_other_code_settings_or_another_device_make_maps_stale_and_weights_do_not(job, monkeypatch):
    key = record.run_key(job_of(), {}, on := jax.default_backend())
    assert (
        pipeline.stored_key(job, 20.0) == key == record.run_key(job_of(weights={"gps": 3}), {}, on)
    )
    assert record.run_key(job_of(gps={"mask_deg": 6}), {}, on) != key
    assert record.run_key(job_of(), {}, "another") != key
    monkeypatch.setattr(record, "code_hash", lambda: "other code")
    assert record.run_key(job_of(), {}, on) != key


@pytest.mark.slow
@pytest.mark.parametrize("are_saved", [False, True])
def test_maps_that_came_while_another_run_read_its_city_are_not_replaced(
    are_saved, tmp_path, monkeypatch
):
    """Those of a run and those that were saved from Python; with ``overwrite`` they are."""
    tasks, other = pipeline.tasks_of, job_of(region=REGION | {"altitudes_m": [30, 60]})

    def end_late(**asked):
        def late(*read):
            monkeypatch.setattr(pipeline, "tasks_of", tasks)
            made_maps(8, 9).save(tmp_path) if are_saved else pipeline.run_scenario(
                other, tmp_path, progress=False
            )
            held.update(files_of(tmp_path))
            return tasks(*read)

        held.clear()
        monkeypatch.setattr(pipeline, "tasks_of", late)
        pipeline.run_scenario(job_of(), tmp_path, progress=False, **asked)

    held: dict[str, bytes] = {}
    with pytest.raises(
        InputError, match=r"holds another run of `jaxurban maps` .*-o, or pass --overwrite"
    ):
        end_late()
    assert files_of(tmp_path) == held != {}
    shutil.rmtree(tmp_path)
    end_late(overwrite=True)
    assert ju.open_maps(tmp_path, 20.0).altitudes_m == (20.0, 60.0)


def test_a_name_with_brackets_is_hashed_with_its_companions(tmp_path):
    shape = tmp_path / "b[1].shp"
    for suffix in (".shp", ".dbf"):
        shape.with_suffix(suffix).write_bytes(suffix.encode())
    scenario = job_of(buildings={"source": str(shape)})
    first = record.hash_inputs(scenario)["buildings"]["sha256"]
    shape.with_suffix(".dbf").write_bytes(b"changed")
    assert record.hash_inputs(scenario)["buildings"]["sha256"] != first


def test_what_a_killed_worker_left_half_written_is_gone_when_the_run_ends(job, monkeypatch):
    scrap, (file, *_) = (
        job / "geotiff" / f".gps.tif.0a1b2c3d{files.SCRATCH_SUFFIX}",
        (job / "geotiff").glob("*.tif"),
    )
    before, write = file.read_bytes(), pipeline.write_geotiffs
    file.unlink()
    monkeypatch.setattr(
        pipeline, "write_geotiffs", lambda *given, **more: (write(*given, **more), scrap.touch())
    )
    pipeline.run_scenario(job_of(), job)
    assert not scrap.exists()
    assert file.read_bytes() == before


@pytest.mark.slow
def test_worker_processes_write_the_same_geotiffs(job, tmp_path):
    for folder, workers in ((job, None), (tmp_path / "processes", 2)):
        pipeline.run_scenario(job_of(), folder, workers=workers, layers=("all",))
    threads, processes = (files_of(folder / "geotiff") for folder in (job, tmp_path / "processes"))
    assert len(threads) > 20
    assert threads == processes


def test_a_failed_job_leaves_no_empty_folder(tmp_path):
    with pytest.raises(ju.InputError):
        pipeline.run_scenario(job_of(buildings={"source": "none.osm"}), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_free_cell_without_a_value_is_never_without_cost(job):
    maps = ju.open_maps(job)
    maps.ds["gps"][:] = np.nan
    with pytest.raises(ju.InputError, match="finite"):
        ju.plan(maps, **far_ends(maps))


def test_a_hill_beyond_the_buildings_hides_low_satellites():
    x, y = 500_000.0, 4_500_000.0
    flat = city_of_boxes([(0, 0, 20, 20)], 5.0, 400.0, (x, y))
    heights = np.zeros((120, 120), np.float32)
    heights[80:90] = 3_000.0  # a ridge 1.5 to 2 km south of the region
    ridge = Raster(heights, (50.0, 0.0, x - 2_800.0, 0.0, -50.0, y + 2_600.0), "EPSG:32618")
    extent_m = (x - 2_800.0, y - 3_400.0, x + 3_200.0, y + 2_600.0)
    seen, open_sky = (
        ju.build_maps(city, resolution_m=20.0, altitudes_m=(20.0,)).m("num_visible", 20.0).mean()
        for city in (replace(flat, terrain=ridge, terrain_extent_m=extent_m), flat)
    )
    assert seen < open_sky


@pytest.mark.parametrize("altitudes_m", [[20], [20, 90]])
def test_a_changed_scenario_is_refused_with_both_differences_and_a_new_folder(job, altitudes_m):
    (job.parent / "town.csv").write_text("new elements")
    orbits = {"gps": {"orbits": str(job.parent / "town.csv")}}
    made = files.read_json(job / "run.json")
    inputs = {"orbits": {"path": "town.csv", "sha256": "of the old elements"}}
    files.write_json(
        job / "run.json", made | {"inputs": inputs, "settings": made["settings"] | orbits}
    )
    (job / "geotiff/gps_90m_20m.tif").write_text("the user's words")
    before = files_of(job)
    both = r"inputs.orbits was 'of the o'.*altitudes_m was \[20.*another folder \(-o\).*--overwrite"
    with pytest.raises(ju.InputError, match=both):
        pipeline.run_scenario(job_of(**orbits, region=REGION | {"altitudes_m": altitudes_m}), job)
    with pytest.raises(
        ju.InputError, match="--memory"
    ):  # nor is a job begun that may replace them but has no room
        pipeline.run_scenario(
            job_of(gps={"mask_deg": 6.0}), job, overwrite=True, memory_bytes=10**8
        )
    with pytest.raises(ju.InputError, match="in the way"):
        pipeline.run_scenario(job_of(region=REGION | {"altitudes_m": [90.0]}), job, overwrite=True)
    assert files_of(job) == before


@pytest.mark.slow
def test_saved_maps_have_the_record_of_their_own_run_or_none(job, tmp_path):
    made = pipeline.run_scenario(job_of(weights={"gps": 7}), job).maps[20.0]
    made.save(tmp_path / "copy")
    assert stored_settings(tmp_path / "copy") == {}
    made.save(job)
    assert stored_settings(job)["weights"]["gps"] == 7
    made_maps(20, 20, resolution_m=20.0).save(job)
    assert stored_settings(job) == {}


@pytest.mark.slow
def test_open_maps_refuse_to_read_those_of_another_run_or_that_were_saved_over_them(job, tmp_path):
    folders = job, *(shutil.copytree(job, tmp_path / name) for name in ("swapped", "saved"))
    maps, swapped, saved = map(ju.open_maps, folders)
    ends = far_ends(maps)
    chunk = job / "maps.zarr/20m/gps/0.0.0.0"
    chunk.unlink()
    pipeline.run_scenario(job_of(), job)  # mended by the same run
    assert maps.m("gps", 20.0).size
    pipeline.run_scenario(job_of(gps={"mask_deg": 15.0}), job, overwrite=True)
    (tmp_path / "swapped").rename(tmp_path / "old")
    shutil.copytree(job, tmp_path / "swapped")
    made_maps(20, 20, resolution_m=20.0).save(tmp_path / "saved")
    for each in (maps, swapped, saved):
        with pytest.raises(ju.InputError, match="made again or removed since they were opened"):
            each.m("risk", 20.0)
        with pytest.raises(ju.InputError, match="open them again"):
            ju.plan(each, **ends)
    assert ju.open_maps(job).m("gps", 20.0).size


def test_a_second_run_in_the_same_folder_is_refused(job):
    with files.only_writer(job), pytest.raises(ju.InputError, match="another run is writing"):
        pipeline.run_scenario(job_of(), job)
    pipeline.run_scenario(job_of(), job)


@pytest.mark.slow
def test_spreads_are_not_taken_for_statistics_over_time(tmp_path):
    pipeline.run_scenario(job_of(buildings={"source": "synthetic", "height_samples": 2}), tmp_path)
    assert "gps_p05" in ju.open_maps(tmp_path).ds
    assert not list((tmp_path / "geotiff").glob("gps_p05*"))


def people_inside(file, grid, changes) -> dict:
    """Return the people by time of day that a scenario's census has inside a grid."""
    city = pipeline.load_city(Scenario.from_toml(file, changes))
    return population_totals(city.blocks, city.population, grid.bounds_m, is_cut=True)


@pytest.mark.slow
def test_people_from_a_raster_and_every_credit_reach_the_files_and_a_region_beyond_the_data_warns(
    tmp_path, capsys
):
    west, south, _, north = REGION["bounds"]
    scenario = write_city(tmp_path, shapely.box(west, south, west + 0.001, north))
    people = np.random.default_rng(0).integers(0, 200, (16, 16)).astype(np.int32)
    place = rasterio.Affine(1 / 1200, 0, west - 0.004, 0, -1 / 1200, north + 0.004)
    options = {
        "driver": "GTiff",
        "width": 16,
        "height": 16,
        "count": 1,
        "dtype": "int32",
        "nodata": -9999,
    }
    with rasterio.open(
        tmp_path / "people.tif", "w", crs="EPSG:4326", transform=place, **options
    ) as file:
        file.write(people, 1)
    credits = (
        'buildings.credit="© a town"',
        'population.blocks="people.tif"',
        'population.credit="© a count"',
    )
    given = (part for setting in credits for part in ("--set", setting))
    code, _, err = run(capsys, "maps", scenario, "-o", tmp_path / "out", *given)
    assert code == 0, err
    assert "of the region lies beyond" in err
    maps = ju.open_maps(tmp_path / "out")
    assert maps.ds.attrs["attribution"] == "© a town; © a count"
    with rasterio.open(tmp_path / "out" / "geotiff" / "population_night_20m.tif") as file:
        assert file.tags()["credit"] == "© a town; © a count"
    cell_km2 = maps.grid.resolution_m**2 / 1e6
    in_cells = float(maps.m("density", time_of_day="night").sum(dtype=np.float64)) * cell_km2
    inside = people_inside(scenario, maps.grid, credits)["night"]["total"]
    assert in_cells == pytest.approx(inside, rel=0.01)
    assert 0 < inside < people.sum()
    by_day = tmp_path / "people_by_day.tif"
    with rasterio.open(by_day, "w", crs="EPSG:4326", transform=place, **options) as file:
        file.write(3 * people[::-1], 1)
    given = (
        "--set",
        'population.blocks_day="people_by_day.tif"',
        "--set",
        'population.blocks_night="people.tif"',
    )
    code, _, err = run(capsys, "maps", scenario, "-o", tmp_path / "both", *given)
    assert code == 0, err
    assert "by day are not counted" not in err
    both, record = ju.open_maps(tmp_path / "both"), files.read_json(tmp_path / "both" / "run.json")
    assert [record["inputs"][f"blocks_{name}"]["path"] for name in ("day", "night")] == [
        by_day.name,
        "people.tif",
    ]
    night, day = (
        both.m("density", time_of_day=name).sum(dtype=np.float64) * cell_km2
        for name in ("night", "day")
    )
    counted = people_inside(scenario, maps.grid, given[1::2])
    assert (night, day) == pytest.approx(
        (counted["night"]["total"], counted["day"]["total"]), rel=0.005
    )
    assert counted["night"]["total"] == pytest.approx(inside)
    code, _, err = run(
        capsys,
        "maps",
        scenario,
        "-o",
        tmp_path / "none",
        *given,
        "--set",
        "population.gamma_commercial=2",
    )
    assert (code, (tmp_path / "none").exists()) == (2, False)
    assert "leave out gamma_commercial" in err
