"""Local derivatives, and the whole study with its report, figures and command."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import write_zarr
from jaxurban.paths.plan import cost_map
from jaxurban.report.figures.sensitivity import sensitivity_figures
from jaxurban.report.sensitivity import ranges, sensitivity_markdown
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.sobol import cost_gradient, outcome_slopes
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps

GIVEN = np.array([0.1, 1.0, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def maps():
    return made_maps(30, 36)


@pytest.fixture(scope="module")
def ends(maps):
    return [tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in ((4, 1), (28, 34))]


@pytest.fixture(scope="module")
def found(maps, ends):
    return ju.studies.sensitivity(
        cost_map(maps, 20.0, cost_model="line"), *ends, settings=ju.studies.SensitivitySettings(num_samples=4)
    )


@pytest.fixture(scope="module")
def folder(maps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    write_zarr(maps.ds, folder)
    return folder


def test_gradient_of_the_cheapest_cost_equals_central_differences(maps):
    query = RouteQuery(cost_map(maps, 20.0, cost_model="line"), (4, 1), (28, 34))
    pool = RoutePool([query])
    cost = cost_gradient(query.names, GIVEN, pool.cheapest(GIVEN[None])[0, :, 0])
    for column, name in enumerate(query.names):
        step = np.eye(len(GIVEN))[column] * 1e-6
        costs = [w @ pool.cheapest(w[None, None])[0, 0, 0] for w in (GIVEN + step, GIVEN - step)]
        assert cost.loc[name, "gradient"] == pytest.approx((costs[0] - costs[1]) / 2e-6, rel=1e-6)
    assert cost["elasticity"].sum() == pytest.approx(1)


def test_expected_outcomes_answer_to_weights_as_differences_of_many_searches_do(maps):
    query = RouteQuery(cost_map(maps, 20.0, cost_model="line"), (4, 1), (28, 34))
    pool = RoutePool([query])
    noise = 0.5
    row = outcome_slopes(pool, GIVEN, pool.cheapest(GIVEN[None])[1, :, 0], noise).loc[("mean_risk", "risk")]
    drawn = np.random.default_rng(5).normal(size=(600, len(GIVEN))) * noise
    step, means = 0.4, []
    for sign in (1, -1):
        weights = GIVEN * np.exp(drawn + sign * step * np.eye(len(GIVEN))[4])
        sums = pool.cheapest(weights[None])[1, 0].mean(axis=0)
        means.append(sums[4] / sums[0])
    assert row["expected_slope"] == pytest.approx((means[0] - means[1]) / (2 * step), abs=4 * row["expected_slope_se"])
    assert row["expected_slope"] > 0


def test_the_route_stays_the_same_inside_its_range_and_changes_outside(maps, ends, found):
    for name in found.lines:
        at = ranges(found, name)
        assert at["alike_from"] <= at["same_from"] <= 1 <= at["same_to"] <= at["alike_to"]
        for value, is_same in ((at["same_to"] * 0.999, True), (at["same_to"] * 1.001, False)):
            if at["same_to"] < 10:
                weights = ju.Weights(**{name: value})
                other = ju.plan(maps, *ends, altitude_m=20.0, cost_model="line", weights=weights)
                sums = [(route.length_m, *route.metrics.values()) for route in (other, found.route)]
                assert np.allclose(*sums, rtol=1e-9) == is_same


@pytest.mark.slow
def test_it_shows_the_route_and_what_each_weight_does(found):
    text = repr(found)
    assert text.startswith(f"Sensitivity(route: cost {found.route.cost:,.2f}, ")
    for name in found.lines:
        assert f"{name}: {found.weights[found.names.index(name)]:g}, " in text
        assert f"{len(found.lines[name].cells)}" in found.facts[name].rpartition(": ")[2]
    assert "array" not in text
    assert found._repr_html_().count("<tr>") == len(found.facts)


def test_report_names_every_weight_and_every_file_that_it_shows(found, tmp_path):
    files = found.save(tmp_path / "out")
    report = (tmp_path / "out" / "report.md").read_text()
    assert report == sensitivity_markdown(found)
    assert report.count("© a made city") == 1
    costs = pd.DataFrame({"per_metre": [2.0], "height_m": 30.0, "lon": -74.0, "lat": 40.75, "distance_m": 5.0})
    told = sensitivity_markdown(found, costs)
    assert told.index("| 0 | 2 | 30 | -74.0 | 40.75 | 5 |") < told.index("## How to read this")
    assert "Which buildings" not in report
    assert all(sentence in report for sentence in found.route.cautions or ["no caution"])
    for name in found.names:
        assert name in report
    shown = {part.split(")")[0] for part in report.split("](")[1:]}
    assert len(shown) == 3
    assert {f"figures/{file.name}" for file in files if file.suffix == ".png"} == shown
    for name, table in found.tables().items():
        for read, suffix in ((pd.read_csv, "csv"), (pd.read_parquet, "parquet")):
            assert len(read(tmp_path / "out" / "tables" / f"{name}.{suffix}")) == len(table)
    found.save(tmp_path / "out")
    for change in ({"factors": (0.5, 2.0)}, {"num_samples": 8}, {"tolerance": 0.1}, {"seed": 1}):
        other = dataclasses.replace(found, settings=dataclasses.replace(found.settings, **change))
        with pytest.raises(InputError, match="another run of `jaxurban sensitivity`"):
            other.save(tmp_path / "out")


def test_no_text_of_a_figure_leaves_the_page(found):
    for name, draw in sensitivity_figures(found).items():
        figure = draw()
        renderer = FigureCanvasAgg(figure).get_renderer()
        figure.draw(renderer)
        width, height = figure.bbox.size
        axes = [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)]
        ticks = {id(label) for axis in axes for label in axis.get_ticklabels()}
        for text in figure.findobj(Text):
            if text.get_visible() and text.get_text().strip() and id(text) not in ticks:
                box = text.get_window_extent(renderer)
                is_inside = box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1
                assert is_inside, (name, text.get_text())


def test_command_writes_the_study_and_prints_json(folder, ends, tmp_path, capsys):
    places = ["--start={},{}".format(*ends[0]), "--goal={},{}".format(*ends[1]), "--altitude", 20]
    options = [
        "--vary",
        "risk,population",
        "--samples",
        2,
        "--pareto",
        "distance,risk",
        "-o",
        tmp_path / "out",
        "--json",
    ]
    code, out, err = run(capsys, "sensitivity", folder, *places, *options)
    assert code == 0, err
    told = json.loads(out)
    assert set(told["ranges"]) == {"risk", "population"}
    assert (tmp_path / "out" / "report.md").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--vary", "rsk"], ["rsk", "risk"]),
        (["--range", "1"], ["--range", "0.1,10"]),
        (["--range", "2,3"], ["range"]),
        (["--samples", 3], ["power of two"]),
        (["--pareto", "gps"], ["objectives"]),
        (["--weights", "wind=1"], ["wind"]),
        (["--tolerance", 0], ["tolerance"]),
    ],
)
def test_wrong_options_are_one_sentence_and_exit_2(folder, ends, tmp_path, capsys, options, words):
    places = ["--start={},{}".format(*ends[0]), "--goal={},{}".format(*ends[1]), "--altitude", 20]
    code, _, err = run(capsys, "sensitivity", folder, *places, "-o", tmp_path / "out", *options)
    assert code == 2
    assert_one_sentence(err, *words)


def test_a_start_that_was_moved_is_told_on_the_terminal_and_in_the_report(maps, folder, ends, tmp_path, capsys):
    row, col = np.argwhere(~maps.is_free(20.0))[0]
    start = "{:.9f},{:.9f}".format(*maps.grid.lonlat_of_cell(row, col))
    places = [f"--start={start}", "--goal={},{}".format(*ends[1]), "--altitude", 20, "--snap"]
    options = ["--vary", "risk", "--samples", 2, "--pareto", "distance,risk", "-o", tmp_path / "out"]
    code, _, err = run(capsys, "sensitivity", folder, *places, *options)
    assert code == 0, err
    for text in (err, (tmp_path / "out" / "report.md").read_text()):
        assert "The start was not free: it was moved 30.0 m, to a free cell." in text
    assert "obstacles: touched" in (tmp_path / "out" / "report.md").read_text()


def test_a_walled_goal_is_exit_3_and_in_python_an_error(maps, ends, tmp_path, capsys):
    ds = maps.ds.copy(deep=True)
    ds["obstacle"].values[:, 15, :] = 1
    walled = ju.MetricMaps(ds)
    write_zarr(ds, tmp_path / "maps")
    places = ["--start={},{}".format(*ends[0]), "--goal={},{}".format(*ends[1]), "--altitude", 20]
    code, _, err = run(capsys, "sensitivity", tmp_path / "maps", *places, "-o", tmp_path / "out")
    assert code == 3
    assert "joins start and goal" in err
    with pytest.raises(InputError, match="no route to study"):
        ju.studies.sensitivity(cost_map(walled, 20.0), *ends)


def test_start_and_goal_in_one_cell_are_refused(maps, ends):
    with pytest.raises(InputError, match="one cell"):
        ju.studies.sensitivity(cost_map(maps, 20.0), ends[0], ends[0])
