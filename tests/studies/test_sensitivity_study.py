"""A weight study over many routes: its rows against planning alone, kept through a kill, and what its report says."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import write_zarr
from jaxurban.metrics.custom import Layer
from jaxurban.paths.rows import InstanceRuns, solve_here
from jaxurban.report.figures.sensitivity_study import plot_nearest, study_figures
from jaxurban.report.sensitivity_study import shown_tables, study_markdown
from jaxurban.studies.montecarlo.sampling import sample_joined
from jaxurban.studies.weights.routes import OnPerturbedMaps
from jaxurban.studies.weights.summary import summarise, summarise_shares
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps

SETTINGS = ju.studies.SensitivityStudySettings(num_samples=2, seed=3)
NUM = 9
KEY = ["city", "instance", "altitude_m"]


def other_maps() -> ju.MetricMaps:
    """The same streets with a layer of noise and without people."""
    made = made_maps(60, 70)
    loud = np.random.default_rng(4).random(made.grid.shape).astype(np.float32)
    ds = made.ds.drop_vars(["population", "density", "time_of_day"])
    ds["noise"] = (("y", "x"), loud, {"layer": json.dumps(Layer("noise.tif", "high-is-bad", (0.0, 1.0)).record)})
    return ju.MetricMaps(ds)


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("maps")
    for name, maps in (("alpha", made_maps(60, 70)), ("beta", other_maps())):
        write_zarr(maps.ds, folder / name)
    return [folder / "alpha", folder / "beta"]


@pytest.fixture(scope="module")
def found(folders, tmp_path_factory) -> ju.studies.SensitivityStudy:
    return ju.studies.sensitivity_study(folders, tmp_path_factory.mktemp("study"), NUM, settings=SETTINGS)


def test_every_route_has_a_row_once(found):
    assert len(found.rows) == 2 * NUM * 2
    assert not found.rows.duplicated(KEY).any()
    assert (found.rows.status == "optimal").all()
    weights = found.tables["weights"]
    assert set(weights[weights.city == "beta"].weight_name) == {"distance", "gps", "lidar", "risk", "noise"}
    assert set(weights[weights.city == "alpha"].weight_name) == {"distance", "gps", "lidar", "risk", "population"}


def test_rows_are_what_planning_under_each_weight_gives(folders, found):
    table = found.rows.merge(found.instances, on=KEY).iloc[[0, 7, 20]]
    for row in table.to_dict("records"):
        maps = ju.open_maps(next(each for each in folders if each.name == row["city"]))
        ends = [ju.XY(row[f"{end}_x_m"], row[f"{end}_y_m"]) for end in ("start", "goal")]
        true = ju.Weights(**{name.removeprefix("w_"): row[name] for name in row if name.startswith("w_")})
        if row["city"] == "alpha":
            true = ju.Weights(**{name: value for name, value in true.to_dict().items() if name != "noise"})

        def planned(weights, maps=maps, ends=ends, row=row):
            when = {"time": row["time"]} | ({"time_of_day": row["time_of_day"]} if row["city"] == "alpha" else {})
            return ju.cost_map(maps, row["altitude_m"], weights=weights, cost_model="line", **when).plan(*ends)

        best = planned(true)
        assert row["cost"] == pytest.approx(best.cost, rel=1e-12)
        assert row["length_m"] == pytest.approx(best.length_m)
        shares = {name: value / best.cost for name, value in best.to_dict()["cost_by_layer"].items()}
        for name, share in shares.items():
            assert row[f"elasticity:{name}"] == pytest.approx(share, abs=1e-12)
        for name in row["vary"].split(","):
            for side, factor in (("low", 0.5), ("high", 2.0)):
                wrong = planned(true.replace(**{name: true[name] * factor}))
                parts = wrong.to_dict()["cost_by_layer"]
                cost = sum(value / (factor if layer == name else 1) for layer, value in parts.items())
                assert row[f"regret_{side}:{name}"] == pytest.approx(cost / best.cost - 1, abs=1e-9)


def test_elasticities_sum_to_one_and_a_route_that_no_factor_changes_has_no_regret(found):
    weights = found.tables["weights"]
    np.testing.assert_allclose(weights.groupby(KEY).elasticity.sum(), 1.0)
    calm = weights[weights.varies & (weights.nearest > 2.0)]
    assert len(calm) > 5
    assert (calm.regret < 1e-9).all()
    assert (weights[weights.varies].nearest >= 1).all()


def test_maps_in_memory_and_a_table_of_queries_give_the_same_rows(folders, found, tmp_path):
    alpha = found.instances[
        (found.instances.city == "alpha") & (found.instances.instance == found.instances.instance[0])
    ]
    queries = alpha[["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m", "time", "time_of_day"]]
    again = ju.studies.sensitivity_study({"alpha": made_maps(60, 70)}, tmp_path, queries, settings=SETTINGS)
    columns = [
        name for name in found.rows if name.partition(":")[0] in ("cost", "elasticity", "below", "above", "people")
    ]
    columns = [name for name in columns if "noise" not in name]
    first = found.rows.merge(alpha[KEY], on=KEY).sort_values("altitude_m")[columns]
    np.testing.assert_allclose(again.rows.sort_values("altitude_m")[columns].astype(float), first.astype(float))
    assert not again.is_sampled
    assert again.instances.start_stratum.tolist() == alpha.start_stratum.tolist()
    assert again.instances.range.tolist() == alpha.range.tolist()


def test_a_route_that_fails_is_a_row_with_its_status(folders, found, tmp_path):
    maps, rows = made_maps(60, 70), found.instances[found.instances.city == "alpha"].iloc[:3].copy()
    rows["instance"] = [0, 1, 2]
    wall = np.argwhere(~maps.is_free(20.0))[0]
    rows.loc[rows.index[0], ["goal_x_m", "goal_y_m"]] = maps.grid.xy_of_cell(*wall)
    rows.loc[rows.index[1], ["goal_x_m", "goal_y_m"]] = rows.iloc[1][["start_x_m", "start_y_m"]].to_numpy()
    again = ju.studies.sensitivity_study(folders[0], tmp_path, rows, settings=SETTINGS)
    assert again.rows.sort_values("instance").status.tolist() == ["bad-input", "bad-input", "optimal"]
    report = (tmp_path / "report.md").read_text()
    assert "start and goal lie in one cell" in report
    assert "is inside an obstacle" in report
    (asked,) = (line for line in report.split("## ")[0].splitlines() if line.startswith("| alpha | "))
    assert "| 20 m | 3 | 3 | 1 |" in asked


@pytest.mark.parametrize(
    ("named", "match"),
    [
        (["alpha", "gamma"], "name the city 'gamma', and the maps are of alpha, beta"),
        (["alpha", "alpha"], "none of the city 'beta'"),
        ([], "has no rows"),
    ],
)
def test_no_row_of_a_table_is_left_out_without_a_word(folders, found, tmp_path, named, match):
    table = found.instances.iloc[: len(named)].assign(city=named)
    with pytest.raises(InputError, match=match):
        ju.studies.sensitivity_study(folders, tmp_path / "study", table, settings=SETTINGS)


@pytest.mark.parametrize("routes", [0, -1, True, [((0.0, 0.0), (1.0, 1.0))]])
def test_routes_are_a_number_or_a_table(folders, tmp_path, routes):
    with pytest.raises(InputError, match="routes must be"):
        ju.studies.sensitivity_study(folders, tmp_path / "study", routes, settings=SETTINGS)
    with pytest.raises(InputError, match="factors must be two"):
        ju.studies.SensitivityStudySettings(factors=(0.1,))


def test_a_city_named_twice_is_refused(folders, tmp_path, capsys):
    code, _, err = run(capsys, "sensitivity-study", folders[0], folders[0], "--routes", 2, "-o", tmp_path / "out")
    assert code == 2
    assert_one_sentence(err, "alpha, alpha", "name each once")


KILLED = """
import sys, jaxurban as ju
if __name__ == "__main__":
    settings = ju.studies.SensitivityStudySettings(num_samples=2, seed=3)
    ju.studies.sensitivity_study(sys.argv[2:], sys.argv[1], 9, settings=settings)
"""


@pytest.mark.slow
def test_a_killed_study_goes_on_with_no_row_lost_or_doubled(folders, found, tmp_path):
    script, out = tmp_path / "job.py", tmp_path / "out"
    script.write_text(KILLED)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    job = subprocess.Popen([sys.executable, script, out, *folders], env=environment, cwd=tmp_path)
    while len(list((out / "routes/parts").glob("*.json"))) < 3:
        assert job.poll() is None
        time.sleep(0.005)
    job.send_signal(signal.SIGKILL)
    job.wait()
    kept = [row for part in (out / "routes/parts").glob("*.json") for row in json.loads(part.read_text())["rows"]]
    assert 0 < len(kept) < len(found.rows)
    again = ju.studies.sensitivity_study(folders, out, NUM, settings=SETTINGS).rows
    pd.testing.assert_frame_equal(
        again.drop(columns="elapsed_s")[sorted(set(again) - {"elapsed_s"})],
        found.rows[sorted(set(found.rows) - {"elapsed_s"})],
    )
    times = again.set_index(KEY).elapsed_s
    for row in kept:  # what was done before is not done again
        assert times[row["city"], row["instance"], row["altitude_m"]] == row["elapsed_s"]


def test_a_folder_keeps_one_study(folders, found):
    with pytest.raises(InputError, match="another run of `jaxurban sensitivity-study`"):
        ju.studies.sensitivity_study(folders, found.folder, NUM, settings=replace(SETTINGS, wrong=3.0))
    with pytest.raises(InputError, match="another run of `jaxurban sensitivity-study`"):
        ju.studies.sensitivity_study(folders, found.folder, NUM + 1, settings=SETTINGS)


@pytest.mark.slow
def test_two_workers_give_the_rows_of_one(folders, found, tmp_path):
    again = ju.studies.sensitivity_study(folders, tmp_path, NUM, settings=SETTINGS, workers=2)
    drop = ["elapsed_s"]
    pd.testing.assert_frame_equal(
        again.rows.drop(columns=drop)[found.rows.columns.drop(drop)], found.rows.drop(columns=drop)
    )


def test_the_report_names_every_figure_and_no_share_below_zero(found):
    report = (found.folder / "report.md").read_text()
    shown = {part.split(")")[0] for part in report.split("](")[1:]}
    assert shown == {f"figures/{each.name}" for each in (found.folder / "figures").glob("*.png")}
    for name, table in found.tables.items():
        assert len(pd.read_parquet(found.folder / "tables" / f"{name}.parquet")) == len(table)
    assert "nan" not in report.replace("dominant", "")
    sobol = report.split("## What the routes are like")[1].split("##")[0]
    assert "| -" not in sobol.replace("| ---", "")
    assert "2 samples each; with fewer than 64" in report
    assert report.count("© a made city") == 1
    assert "over cities" not in [*found.tables["summary"].cut], "two cities say nothing of others"
    assert "| of | weight | cities | routes | regret |" in report


def test_the_report_says_whether_routes_were_drawn_or_given(found):
    assert "Routes were drawn by stratum" in study_markdown(found)
    given = study_markdown(replace(found, is_sampled=False))
    assert "drawn by stratum" not in given
    assert "those of the table that was given" in given


def test_panels_that_are_compared_share_their_scale(found):
    figure = plot_nearest(found.tables["weights"], 2.0)
    assert len({panel.get_xlim() for panel in figure.axes}) == 1


def test_the_report_says_by_what_population_is_normalised_in_each_city(found):
    alpha = ju.MetricMaps(found.maps["alpha"].ds.assign_attrs(pop_norm_per_km2=[5e4, 3e4]))
    report = study_markdown(replace(found, maps={**found.maps, "alpha": alpha}))
    alpha, beta = report.split("\n\n")[1].splitlines()[2:]
    assert alpha.endswith("| 50,000 (day), 30,000 (night) |")
    assert beta.endswith("|  |")


def test_no_text_of_a_figure_leaves_the_page(found):
    for name, draw in study_figures(found.tables, 2.0).items():
        figure = draw()
        renderer = FigureCanvasAgg(figure).get_renderer()
        figure.draw(renderer)
        width, height = figure.bbox.size
        axes = [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)]
        ticks = {id(label) for axis in axes for label in axis.get_ticklabels(which="both")}
        for text in figure.findobj(Text):
            if text.get_visible() and text.get_text().strip() and id(text) not in ticks:
                box = text.get_window_extent(renderer)
                is_inside = box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1
                assert is_inside, (name, text.get_text())


def made_weights(regret: dict[str, float], num: int = 40, spread: float = 0.002, seed: int = 5) -> pd.DataFrame:
    """A table of weights whose regrets scatter about known ones."""
    rng = np.random.default_rng(seed)
    rows = [
        {"city": city, "instance": k, "altitude_m": 20.0, "weight_name": name, "varies": True, "elasticity": 0.2}
        | {"nearest": 1.5, "regret": value + rng.normal(0, spread), "below": 0.5, "above": 1.5, "start_stratum": "open"}
        | {"goal_stratum": "open", "range": "long", "time": "t", "time_of_day": None}
        for city in ("a", "b")
        for k in range(num)
        for name, value in regret.items()
    ]
    return pd.DataFrame(rows)


def made_summary() -> pd.DataFrame:
    return summarise(made_weights({"gps": 0.01}), 2.0)


def test_a_share_of_the_cost_is_no_measure_of_harm():
    """Route A: 100 m, nothing of the layer. B: 1 m and 197 of it. Half the weight chooses B, which costs 98 % more."""
    features = {"A": np.array([100.0, 0.0]), "B": np.array([1.0, 197.0])}
    cost = {name: route @ np.ones(2) for name, route in features.items()}
    wrong = {name: route @ np.array([1.0, 0.5]) for name, route in features.items()}
    assert (min(cost, key=cost.get), min(wrong, key=wrong.get)) == ("A", "B")
    table = made_weights({"layer": cost["B"] / cost["A"] - 1, "other": 0.001}, 10)
    table["elasticity"] = np.where(table.weight_name == "layer", 0.0, 0.5)
    rows = summarise(table, 2.0)
    first = shown_tables({"summary": rows})["by_all"].iloc[0]
    assert (first.weight, first.share) == ("layer", 0.0)
    assert first.regret == pytest.approx(0.98, abs=0.01)


def test_intervals_of_the_summary_hold_the_truth_nineteen_times_in_twenty():
    held = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        table = made_weights({"gps": 0.0}, 25)
        table["regret"] = rng.normal(0.02, 0.005, len(table))
        row = summarise(table, 2.0).set_index("cut").loc["all"]
        held += row.regret_low <= 0.02 <= row.regret_high
    assert held >= 53  # of 60: 57 expected


def test_a_share_that_is_not_told_from_zero_is_words_and_no_number_below_zero():
    rng = np.random.default_rng(6)
    rows = [
        {"city": "a", "instance": k, "altitude_m": 20.0, "outcome": "length_m", "weight_name": name}
        | {kind: mean + rng.normal(0, 0.1) for kind in ("first", "total")}
        | {"first_ci": 0.2, "total_ci": 0.2}
        for k in range(30)
        for name, mean in (("gps", -0.02), ("risk", 0.6))
    ]
    told = summarise_shares(pd.DataFrame(rows)).set_index(["weight_name", "kind"])
    assert told.loc[("gps", "first"), "share"] < 0
    shown = shown_tables({"summary": made_summary(), "sobol_summary": told.reset_index()})["sobol"]
    gps, risk = shown.set_index("weight_name").loc[["gps", "risk"]].to_dict("records")
    assert np.isnan(gps["share"])
    assert gps["verdict"] == "not told from 0"
    assert 0 <= gps["at most"] < 0.1
    assert risk["share"] == pytest.approx(0.6, abs=0.05)
    few = summarise_shares(pd.DataFrame(rows[:6]))
    assert set(few.verdict) == {"too few routes"}


def perturbed_rows(nominal, other, instances):
    job = OnPerturbedMaps(nominal=nominal, draw=0)
    tasks = [InstanceRuns(instance, job.runs) for instance in instances]
    return pd.DataFrame(row for rows in solve_here(tasks, {"a": other}, job) for row in rows)


def test_routes_on_maps_made_anew_are_compared_both_ways(tmp_path):
    maps = made_maps(40, 50)
    instances = sample_joined(maps, 6, weights=[ju.Weights()]).assign(city="a")
    asked = instances.to_dict("records")
    same = perturbed_rows(maps, maps, asked)
    assert (same[["is_other", "regret", "nominal_regret", "is_closed"]] == 0).all(axis=None)
    assert (same.overlap == 1).all()
    other = ju.MetricMaps(maps.ds.copy(deep=True))
    other.ds["risk"].values[:] = 1 - other.ds["risk"].values
    found = perturbed_rows(maps, other, asked)
    assert found.is_other.sum() > 3
    for row, instance in zip(found.to_dict("records"), asked, strict=True):
        ends = [ju.XY(instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal")]
        at = {"time": instance["time"], "time_of_day": instance["time_of_day"], "cost_model": "line"}
        here, there = (ju.cost_map(each, instance["altitude_m"], **at) for each in (maps, other))
        nominal, best = here.plan(*ends), there.plan(*ends)
        corner_m = [maps.grid.x_min_m, maps.grid.y_min_m]
        cost = there.problem.features(nominal.xy_m - corner_m).cost(there.weight_vector)
        assert row["nominal_regret"] == pytest.approx(cost / best.cost - 1, abs=1e-9)


SCENARIO = """
[region]
bounds = [-74.0, 40.755, -73.985, 40.765]
resolution_m = 25.0
altitudes_m = [20, 60]
[buildings]
source = "synthetic"
[planning]
cost_model = "line"
"""


@pytest.mark.slow
def test_the_command_studies_cities_and_remakes_their_maps(tmp_path, capsys):
    for name, east in (("one", 0.0), ("two", 0.02)):
        scenario = tmp_path / f"{name}.toml"
        moved = SCENARIO.replace("-74.0,", f"{-74.0 + east},").replace("-73.985", f"{-73.985 + east}")
        scenario.write_text(moved)
        code, _, err = run(capsys, "maps", scenario, "-o", tmp_path / name)
        assert code == 0, err
    cities, out = [tmp_path / "one", tmp_path / "two"], tmp_path / "out"
    options = ["--routes", 8, "--altitudes", "20,60", "--samples", 2, "--workers", 1, "-o", out, "--json"]
    code, text, err = run(capsys, "sensitivity-study", *cities, *options)
    assert code == 0, err
    assert json.loads(text)["statuses"] == {"optimal": 2 * 8 * 2}
    code, text, err = run(capsys, "sensitivity-study", *cities, *options, "--heights", 2)
    assert code == 0, err
    told = json.loads(text)["tables"]["remade_summary"]
    heights = next(row for row in told if row["of"] == "all")
    assert heights["is_other"] == 0, "the synthetic city knows its heights"
    assert "## Other heights" in (out / "report.md").read_text()
    queries = tmp_path / "queries.csv"
    pd.read_parquet(out / "instances.parquet").query("city == 'one'")[
        ["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m"]
    ].to_csv(queries, index=False)
    options = ["--queries", queries, "--samples", 0, "--workers", 1, "-o", tmp_path / "q"]
    code, _, err = run(capsys, "sensitivity-study", cities[0], *options)
    assert code == 0, err
    assert len(pd.read_parquet(tmp_path / "q/routes/rows.parquet")) == 16


def test_own_layers_take_part_by_their_name(found):
    summary = found.tables["summary"]
    noise = summary[(summary.cut == "all") & (summary.weight_name == "noise")]
    assert len(noise) == 1
    assert noise.cities.item() == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--routes", 3, "--queries", "a.csv"], ["--queries"]),
        (["--altitudes", "low"], ["--altitudes", "20,60"]),
        (["--samples", 3], ["power of two"]),
        (["--wrong", 1], ["wrong"]),
        (["--vary", "gpss"], ["a weight that varies", "'gps'", "'gpss'"]),
        (["--vary", "gps,gps"], ["vary must name each weight once", "gps, gps"]),
        (["--vary", "gps", "--weights", "gps=0"], ["weight gps is 0 on every route"]),
        (["--weights", "gps=0,lidar=0,risk=0,population=0"], ["every metric has weight 0", "give one a weight"]),
    ],
)
def test_wrong_options_are_one_sentence_and_exit_2(folders, tmp_path, capsys, options, words):
    code, _, err = run(capsys, "sensitivity-study", folders[0], *options, "--workers", 1, "-o", tmp_path / "out")
    assert code == 2
    assert_one_sentence(err, *words)
    assert not (tmp_path / "out/report.md").exists()
