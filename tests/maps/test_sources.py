"""The city behind a folder of maps: read again only from files that are still those of the run."""

import shutil

import numpy as np
import pytest
from shapely import box

import jaxurban as ju
from jaxurban.io.files import read_json, write_json
from jaxurban.io.stored import RUN_FILE
from jaxurban.maps.run import run_scenario
from jaxurban.maps.scenario_files import read_scenario
from jaxurban.maps.sources import city_of
from jaxurban.world.kinds import ALL_KINDS
from tests.cli_runs import write_city
from tests.made_maps import made_maps


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("town")
    write_city(folder, box(-73.998, 40.757, -73.997, 40.758))
    return folder


@pytest.fixture(scope="module")
def maps(folder):
    scenario = ju.Scenario.from_toml(folder / "town.toml")
    run_scenario(scenario, folder / "maps", progress=False)
    return folder / "maps"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_the_city_is_found_beside_its_maps_and_where_it_is_named(folder, maps, tmp_path):
    beside = city_of(maps)
    opened = city_of(ju.open_maps(maps))
    np.testing.assert_array_equal(beside.buildings.height_m, [30.0])
    assert beside.facts == opened.facts
    assert city_of(beside) is beside
    (tmp_path / "city.geojson").write_bytes((folder / "city.geojson").read_bytes())
    assert city_of(maps, tmp_path).facts == beside.facts


def test_a_file_that_is_gone_or_changed_is_named(folder, maps, tmp_path):
    (tmp_path / "city.geojson").write_bytes((folder / "city.geojson").read_bytes() + b" ")
    (tmp_path / "empty").mkdir()
    for place in (tmp_path, tmp_path / "empty", tmp_path / "none"):
        with pytest.raises(ju.InputError, match=r"no longer there as it was \('city\.geojson'\)"):
            city_of(maps, place)


def test_a_folder_of_maps_is_the_scenario_of_its_run_with_changes(folder, maps):
    file = read_scenario(folder / "town.toml", ["gps.mask_deg=40"])
    again = read_scenario(maps, ["gps.mask_deg=40"])
    assert again.gps.mask_deg == 40
    assert again == file
    assert again.path_of(again.buildings.source).samefile(folder / "city.geojson")
    with pytest.raises(ju.InputError, match="unknown"):
        read_scenario(maps, ["gps.musk_deg=40"])
    with pytest.raises(ju.InputError, match="holds no maps itself"):
        read_scenario(folder)


def test_maps_in_memory_or_saved_from_python_ask_for_the_city(tmp_path):
    made = made_maps(8, 9)
    with pytest.raises(ju.InputError, match="made in memory do not hold their city"):
        city_of(made)
    with pytest.raises(ju.InputError, match="not made by `jaxurban maps`"):
        city_of(made.save(tmp_path))


def test_a_record_of_somebody_else_names_no_file_that_is_read(maps, tmp_path):
    record = read_json(maps / RUN_FILE)
    del record["settings"]["region"]["bounds"]
    write_json(tmp_path / RUN_FILE, record)
    with pytest.raises(ju.InputError, match="not made by `jaxurban maps`"):
        city_of(tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")
def test_a_check_says_first_which_kinds_the_maps_leave_out(maps, folder, tmp_path):
    record = read_json(maps / RUN_FILE)
    shutil.copytree(maps, tmp_path / "maps")
    own = record["settings"].pop("obstacles")

    def told(**settings) -> set[str]:
        """Return the end of the verdict where the city's files are there, and where they are gone."""
        changed = record["settings"] | settings
        write_json(tmp_path / "maps" / RUN_FILE, record | {"settings": changed})
        of = ju.open_maps(tmp_path / "maps")
        (row, col), *_ = np.argwhere(of.is_free(60.0))
        place = of.grid.lonlat_of_cell(row, col)
        path = ju.plan(of, place, place, altitude_m=60.0)
        checks = [ju.check(of, path, sources=sources) for sources in (folder, None)]
        assert [check.outlines[:5] for check in checks] == ["exact", "by ce"]
        return {check.lines[0].partition("judged.")[2] for check in checks}

    assert told(obstacles=own) == {""}
    (alone,) = told(planning={"preset": "paper"}, obstacles={})
    assert alone.endswith(f": {', '.join(ALL_KINDS[1:])}.")
    (some,) = told(obstacles={"kinds": ["building", "tree", *ALL_KINDS[4:-3]]})
    assert some.endswith(": chimney, tank, tower, wood, wire, cableway.")
