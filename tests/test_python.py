"""The package as a library: what objects show and save, and one sentence for what is not what it should be."""

import ast
import dataclasses
import inspect
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import geopandas
import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.flights.export.write import write_path
from jaxurban.maps.citation import PAPER, SOFTWARE
from jaxurban.plot import bare, plot_metric, plot_overview, plot_paths
from jaxurban.public import NAMESPACES, PICTURES, TYPES
from jaxurban.typing import PlannedPaths
from tests.made_maps import made_maps

MAPS = made_maps(24, 30)
FREE = np.argwhere(MAPS.is_free(20.0))
START, GOAL = (MAPS.grid.lonlat_of_cell(*FREE[at]) for at in (0, -1))


@pytest.fixture(scope="module")
def paths() -> PlannedPaths:
    pairs = [(START, GOAL), (GOAL, START), (START, (0.0, 0.0))]
    return ju.plan_many(MAPS, pairs, altitude_m=20.0, weights={"risk": 5}, progress=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    MAPS.save(folder)
    return folder


def test_paths_show_a_few_facts_and_no_arrays(paths):
    for shown, words in (
        (paths[0], ("PlannedPath", "status: optimal", "astar (", "altitude: 20 m", "gps 0.")),
        (paths, ("PlannedPaths", "queries: 3", "optimal 2, bad-input 1", "of 2 paths")),
    ):
        text, html = repr(shown), shown._repr_html_()
        assert all(word in text for word in words)
        assert len(text.splitlines()[0]) < 250
        assert "array" not in text
        assert (html.count("<table>"), html.count("<tr ")) == (
            1,
            len(shown.facts) + len(shown.known_cautions),
        )


UNDER_PLATFORMS = """
import os
import jax
import jaxurban as ju
before = jax.config.jax_platforms
try:
    ju.build_maps(ju.demo_city(400, 400), resolution_m=50, altitudes_m=(20,), progress=False)
except ju.InputError as error:
    print(error)
assert before == jax.config.jax_platforms == os.environ["JAX_PLATFORMS"]
"""


@pytest.mark.slow
@pytest.mark.parametrize("platforms", ["bogus", "cuda", "cpu,bogus"])
def test_platforms_without_a_device_are_one_sentence(platforms, tmp_path):
    env = os.environ | {
        "JAX_PLATFORMS": platforms,
        "XDG_CACHE_HOME": str(tmp_path),
        "CUDA_VISIBLE_DEVICES": "",
    }
    done = subprocess.run(
        [sys.executable, "-c", UNDER_PLATFORMS], env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert (
        done.stdout
        == f"JAX does not work under JAX_PLATFORMS={platforms}: unset it, or choose another value\n"
    )


def test_a_path_keeps_its_weights_by_name_and_saves_itself_in_every_format(paths, tmp_path):
    weights = json.loads(json.dumps(paths[0].to_dict()))["settings"]["weights"]
    assert (weights["risk"], weights["gps"]) == (5.0, 1.0)
    files = [tmp_path / f"path{suffix}" for suffix in (".geojson", ".kml", ".plan")]
    assert paths[0].save(*files) == files[0]
    for file in files:
        write_path(paths[0], other := file.with_stem("other"))
        assert file.read_bytes() == other.read_bytes()
    blocked = ju.plan(MAPS, START, GOAL, altitude_m=20.0, planner="ptp")
    with pytest.raises(ju.InputError, match="there is no path to save: The straight line"):
        blocked.save(tmp_path / "none.geojson")


@pytest.mark.parametrize("suffix", [".geojson", ".kml"])
def test_a_batch_is_one_file_with_a_name_for_each_path(paths, tmp_path, suffix):
    file = paths.save(tmp_path / f"batch{suffix}")
    frame = geopandas.read_file(file)
    assert frame["name" if suffix == ".geojson" else "Name"].tolist() == ["query 0", "query 1"]
    for path, line in zip(paths, frame.geometry, strict=False):
        np.testing.assert_allclose(line.coords[0][:2], path.lonlat[0], atol=1e-6)
    write_path(paths[:2], tmp_path / f"named{suffix}", names=["there", "back"])
    assert "back" in geopandas.read_file(tmp_path / f"named{suffix}").iloc[1].tolist()


def test_a_batch_is_a_table_too(paths, tmp_path):
    for suffix, read in ((".csv", pd.read_csv), (".parquet", pd.read_parquet)):
        assert read(paths.save(tmp_path / f"batch{suffix}")).status.tolist() == [
            "optimal",
            "optimal",
            "bad-input",
        ]
    with pytest.raises(ju.InputError, match=r"\.parquet, \.csv, \.geojson, \.kml, \.gpx, \.plan"):
        paths.save(tmp_path / "batch.txt")
    with pytest.raises(ju.InputError, match=r"a \.plan holds one path, and these are 2"):
        paths.save(tmp_path / "batch.plan")


@pytest.mark.slow
def test_a_folder_stands_for_its_maps(paths, folder):
    under = {"altitude_m": 20.0, "weights": {"risk": 5}}
    path = ju.plan(str(folder), START, GOAL, **under)
    assert (
        path.cost
        == ju.cost_map(folder, 20.0, weights={"risk": 5}).plan(START, GOAL).cost
        == paths[0].cost
    )
    assert ju.plan_many(folder, [(START, GOAL)], progress=False, **under)[0].cost == path.cost
    assert ju.explain(path, folder).totals["cost"] == pytest.approx(path.cost, rel=1e-9)
    assert ju.cautions(path, folder) == ju.cautions(path, MAPS)
    assert plot_metric(str(folder), "risk").axes


@pytest.mark.usefixtures("without_layout")
def test_pictures_take_one_path_several_or_a_batch(paths):
    for given in (paths[0], [paths[0], paths[1]], paths):
        assert "20 m" in plot_paths(MAPS, given).axes[0].get_title("left")
    assert plot_overview(MAPS, paths).axes
    with pytest.raises(ju.InputError, match=r"paths must be PlannedPath \(from plan"):
        plot_paths(MAPS, [5])


def test_a_bare_picture_has_neither_title_nor_note_and_its_panels_are_as_large():
    figure = plot_metric(MAPS, "gps", altitude_m=20.0)
    figure.draw_without_rendering()
    high, panel = figure.get_figheight(), figure.axes[0].get_window_extent().size
    assert "Guessed" in figure.get_supxlabel() or MAPS.attribution in figure.get_supxlabel()
    assert bare(figure) is figure
    figure.draw_without_rendering()
    assert figure.get_suptitle() == figure.get_supxlabel() == ""
    assert figure.get_figheight() < high
    np.testing.assert_allclose(figure.axes[0].get_window_extent().size, panel, rtol=0.08)


def test_what_to_cite_names_the_version_and_ends_with_the_credit_of_the_data():
    software, paper, *data = ju.cite(MAPS).splitlines()
    assert software.endswith(f", version {ju.__version__}.")
    assert "10.48550/arXiv.2102.07218" in paper
    assert data == ([f"Data: {MAPS.attribution}."] if MAPS.attribution else [])
    credited = type(MAPS)(MAPS.ds.assign_attrs(attribution="© some city"))
    assert ju.cite(credited).endswith("\nData: © some city.")
    assert ju.cite().splitlines() == [software, paper]


def test_bibtex_says_what_the_text_says():
    entries = ju.cite(form="bibtex")
    assert re.findall(r"^@(\w+)\{(\w+),$", entries, re.MULTILINE) == [
        ("software", "jaxurban"),
        ("misc", "ochoa2021"),
    ]
    assert entries.count("{") == entries.count("}")
    assert f"version = {{{ju.__version__}}}" in entries
    plain = re.sub(r"[{}]", "", entries)
    author, software = SOFTWARE.split(": ", 1)
    paper = PAPER.split(": ")[1].split(", https")[0]
    for said in (author, software, paper, "10.48550/arXiv.2102.07218"):
        assert said in plain
    assert ju.cite(MAPS, "bibtex").endswith(ju.cite(MAPS).splitlines()[-1])


def test_dir_lists_exactly_the_public_names_and_checkers_see_the_same():
    spaces = {*NAMESPACES, PICTURES}
    for module in (ju, *(import_module(f"jaxurban.{name}") for name in {*spaces, TYPES})):
        stub = ast.parse(Path(module.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
        seen = {
            name.asname
            for line in stub.body
            if isinstance(line, ast.ImportFrom)
            for name in line.names
        }
        assert dir(module) == sorted(seen)
        found = {name: getattr(module, name) for name in dir(module)}
        assert all(thing.__name__.rpartition(".")[2] == name for name, thing in found.items())
        assert {name for name, thing in found.items() if inspect.ismodule(thing)} <= spaces
    assert spaces < {*dir(ju)}
    assert TYPES not in dir(ju)


def test_no_public_name_is_one_for_annotations_too():
    modules = {*NAMESPACES, PICTURES}
    names = [name for name in ju.__all__ if name not in modules]
    for space in NAMESPACES:
        names += getattr(ju, space).__all__
    assert not {*names} & {*import_module("jaxurban.typing").__all__}


def test_functions_come_before_classes_in_what_is_public():
    is_class = [inspect.isclass(getattr(ju, name)) for name in ju.__all__]
    assert is_class == sorted(is_class)


def test_a_path_is_explained_over_its_own_maps_and_says_where_it_names_none():
    path = ju.plan(MAPS, START, GOAL, altitude_m=20.0)
    own, given = path.explain(speed_m_s=10.0), ju.explain(path, MAPS, speed_m_s=10.0)
    assert own.totals == given.totals
    bare = replace(path, maps=None)
    assert bare.explain(MAPS).totals == path.explain().totals
    with pytest.raises(ju.InputError, match="path names no maps: give them"):
        bare.explain()


@pytest.mark.slow
def test_values_lead_to_their_pictures_and_one_map_is_taken_by_its_name():
    path = ju.plan(MAPS, START, GOAL, altitude_m=20.0)
    whole = [panel.get_title("left") for panel in MAPS.plot().axes]
    assert any("GPS quality" in title for title in whole)
    assert len(MAPS.plot("gps", 20.0).axes) < len(whole)
    assert any(path.search.planner in text.get_text() for text in path.plot().findobj(Text))
    with pytest.raises(ju.InputError, match="names no maps to be drawn over"):
        replace(path, maps=None).plot()
    roofs, *_ = ju.demo_city(400, 400).plot().axes
    assert "roofs above ground" in roofs.get_title("left")

    np.testing.assert_array_equal(MAPS["gps"], MAPS.ds["gps"])
    with pytest.raises(ju.InputError, match=r"hold no 'gsp' \(did you mean 'gps'\?\)"):
        _ = MAPS["gsp"]
    with pytest.raises(TypeError, match="not iterable"):
        list(MAPS)


def test_the_version_is_that_of_the_installed_package():
    assert ju.__version__ == version("jaxurban")
    with pytest.raises(AttributeError, match=r"'jaxurban.fit' has no attribute '__version__'"):
        _ = ju.fit.__version__


def test_a_path_is_not_explained_by_the_maps_of_another_place():
    with pytest.raises(ju.InputError, match="leaves the region"):
        ju.explain(ju.plan(MAPS, START, GOAL, altitude_m=20.0), made_maps(8, 8))


def test_a_part_of_maps_knows_where_it_lies_and_one_with_gaps_is_refused():
    part = ju.MetricMaps(MAPS.ds.isel(x=slice(5, 15), y=slice(3, 20)))
    np.testing.assert_allclose(part.grid.x_m, part.ds.x.values)
    np.testing.assert_allclose(part.grid.y_m, part.ds.y.values)
    np.testing.assert_array_equal(part.is_free(20.0), MAPS.is_free(20.0)[3:20, 5:15])
    with pytest.raises(ju.InputError, match="cut maps by slices without a step"):
        ju.MetricMaps(MAPS.ds.isel(x=slice(5, 15, 2)))


def test_a_fault_of_a_user_s_function_is_not_laid_to_an_argument():
    def broken(surface, altitude_m):
        raise TypeError("a fault of the user's")

    layers = {"wind": ju.Layer(broken, "high-is-bad", (0, 12))}
    with pytest.raises(TypeError, match="a fault of the user's"):
        ju.build_maps(ju.demo_city(400, 400), resolution_m=20.0, altitudes_m=(20.0,), layers=layers)


def test_times_may_be_datetimes_of_any_kind():
    city, sizes = ju.demo_city(400, 400), {"resolution_m": 50.0, "altitudes_m": (60.0,)}
    text = ju.build_maps(city, gps=ju.Gps(times=["2020-04-27T16:00:00Z"]), **sizes)
    for time in (pd.Timestamp("2020-04-27T16:00"), np.datetime64("2020-04-27T16:00:00.000000000")):
        assert ju.build_maps(city, gps=ju.Gps(times=[time]), **sizes).times == text.times
        np.testing.assert_array_equal(
            text.m("gps", time=time), text.m("gps", time="2020-04-27T16:00:00Z")
        )


def test_studies_of_routes_refuse_volumes():
    volume = ju.cost_map(MAPS, ju.Levels())
    with pytest.raises(ju.InputError, match="needs one altitude, not Levels"):
        ju.studies.make_queries(volume, [(START, GOAL)])
    path = ju.plan(MAPS, START, GOAL, altitude_m=20.0)
    climbing = dataclasses.replace(path, z_m=path.z_m + np.arange(len(path.z_m)))
    with pytest.raises(ju.InputError, match="path 1: it has no altitude, or several"):
        ju.fit.demonstrations(climbing, MAPS)


def test_numbers_and_sequences_of_numpy_are_taken_as_python_s():
    assert ju.fit.FitSettings(max_rounds=np.int64(3), budget_s=np.float32(2.0)).max_rounds == 3
    assert (
        ju.demo_city(np.float64(400.0), np.int32(400), seed=np.int64(0)).extent_m
        == ju.demo_city(400, 400).extent_m
    )
    assert ju.Layer("noise.tif", "high-is-bad", np.array([0.0, 80.0])).scaled(40.0) == 0.5


def test_places_in_metres_folders_generators_and_single_paths_are_taken_where_many_are(
    paths, folder
):
    ends = [ju.XY(*map(float, MAPS.grid.xy_of_cell(*FREE[at]))) for at in (0, -1)]
    path = ju.plan(MAPS, *ends, altitude_m=20.0, weights={"risk": 5})
    assert path.cost == paths[0].cost
    assert len(ju.fit.demonstrations((each for each in paths[:2]), MAPS)) == 2
    (shown,) = ju.fit.demonstrations(path, folder)
    assert shown.query.cost_map.maps.grid == MAPS.grid
    assert len(ju.studies.sample_instances(folder, 2, altitudes_m=[20.0])) == 2
    assert ju.studies.Study(planners="ptp").planners == ("ptp",)
    assert "weights: distance 0.1" in repr(shown.query.cost_map)
    assert "array" not in repr(shown.query.cost_map)


@pytest.mark.slow
def test_a_guess_is_warned_of_on_the_user_s_line(tmp_path):
    with pytest.warns(ju.GuessWarning) as of_city:
        city = ju.sample_city("shinjuku")
    with pytest.warns(ju.GuessWarning) as of_maps:
        ju.build_maps(city, resolution_m=100.0, altitudes_m=(60.0,), progress=False)
    assert {each.filename for each in (*of_city, *of_maps)} == {__file__}


def test_a_number_for_a_sequence_is_answered_by_how_to_write_it():
    with pytest.raises(ju.InputError, match=r"must be a sequence of numbers .*: write \[5\]"):
        ju.Region(bounds=(-74.02, 40.70, -73.98, 40.73), resolution_m=5.0)


def test_unknown_arguments_of_methods_are_named_and_numbers_of_numpy_are_numbers():
    cost_map = ju.cost_map(MAPS, 20.0)
    with pytest.raises(ju.InputError, match=r"no argument 'snapp' \(did you mean 'snap'\?\)"):
        cost_map.plan(START, GOAL, snapp=True)
    assert cost_map.plan(START, GOAL, snap=np.float32(30)).status.has_path
    pairs = ((START, GOAL) for _ in range(2))
    paths = ju.plan_many(MAPS, pairs, altitude_m=20.0, progress=False)
    assert [path.status.has_path for path in paths] == [True, True]


def test_classes_that_functions_return_are_reached_without_an_import_of_their_own():
    asked = "import jaxurban as ju; print(ju.typing.PlannedPath.__name__, 'typing' in dir(ju))"
    found = subprocess.run(
        [sys.executable, "-c", asked], capture_output=True, text=True, check=True
    )
    assert found.stdout == "PlannedPath False\n"
