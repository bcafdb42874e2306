"""The study of weights over many routes: rows against planning alone, its report, and how both studies keep rows."""

import itertools
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.maps.run import run_scenario
from jaxurban.paths.rows import InstanceRuns, RouteRules, solve_here
from jaxurban.statistics.bootstrap import Clusters
from jaxurban.statistics.conclusions import SharedVerdict, Verdict
from jaxurban.studies.figures.sensitivity import plot_regret
from jaxurban.studies.montecarlo.sampling import sample_joined
from jaxurban.studies.reports.sensitivity import sensitivity_report, shown_tables
from jaxurban.studies.weights.changed_maps import changed_maps, differing_layers
from jaxurban.studies.weights.routes import OnChangedMaps
from jaxurban.studies.weights.summary import MORE, small_parts, summarise, summarise_changed
from jaxurban.studies.weights.verdicts import WeightVerdict, on_other_maps, verdicts_of
from jaxurban.typing import Sensitivity
from tests.cli_runs import TOWN, run
from tests.made_maps import made_maps
from tests.pictures import faults
from tests.studies.routes_made import WEIGHT_STUDY, run_study, same_rows

KEY = ["city", "instance", "altitude_m"]
WHERE = {"study": "", "weight_study": "routes/"}  # rows lie in a study's folder
CALL = "import sys; from tests.studies.routes_made import run_study; run_study(sys.argv[1], sys.argv[2:4], sys.argv[4])"


@pytest.mark.slow
def test_every_weight_of_a_city_is_studied_and_own_layers_by_their_name(weight_study):
    assert (weight_study.rows.status == "optimal").all()
    weights = weight_study.tables["weights"]
    assert set(weights[weights.city == "beta"].weight_name) == {
        "distance",
        "gps",
        "lidar",
        "risk",
        "noise",
    }
    assert set(weights[weights.city == "alpha"].weight_name) == {
        "distance",
        "gps",
        "lidar",
        "risk",
        "population",
    }
    summary = weight_study.tables["summary"]
    assert summary[(summary.cut == "all") & (summary.weight_name == "noise")].cities.tolist() == [1]


@pytest.mark.slow
def test_rows_are_what_planning_under_each_weight_gives(folders, weight_study):
    table = weight_study.rows.merge(weight_study.instances, on=KEY).iloc[[0, 7, 20]]
    for row in table.to_dict("records"):
        maps = ju.open_maps(folders[row["city"] == "beta"])
        ends = [ju.XY(row[f"{end}_x_m"], row[f"{end}_y_m"]) for end in ("start", "goal")]
        true = ju.Weights(**{name: row[f"w_{name}"] for name in ("distance", *maps.metrics)})
        when = {"time": row["time"]} | (
            {"time_of_day": row["time_of_day"]} if row["city"] == "alpha" else {}
        )

        def planned(weights, maps=maps, ends=ends, row=row, when=when):
            return ju.cost_map(
                maps, row["altitude_m"], weights=weights, cost_model="line", **when
            ).plan(*ends)

        best = planned(true)
        assert row["cost"] == pytest.approx(best.cost, rel=1e-12)
        assert row["length_m"] == pytest.approx(best.length_m)
        for name, value in best.to_dict()["cost_by_layer"].items():
            assert row[f"elasticity:{name}"] == pytest.approx(value / best.cost, abs=1e-12)
        for name in row["vary"].split(","):
            for side, factor in (("low", 0.5), ("high", 2.0)):
                wrong = planned(true.replace(**{name: true[name] * factor}))
                parts = wrong.to_dict()["cost_by_layer"]
                cost = sum(
                    value / (factor if layer == name else 1) for layer, value in parts.items()
                )
                assert row[f"regret_{side}:{name}"] == pytest.approx(cost / best.cost - 1, abs=1e-9)


@pytest.mark.slow
def test_elasticities_sum_to_one_and_a_route_that_no_factor_changes_has_no_regret(weight_study):
    weights = weight_study.tables["weights"]
    np.testing.assert_allclose(weights.groupby(KEY).elasticity.sum(), 1.0)
    calm = weights[weights.varies & (weights.nearest > 2.0)]
    assert len(calm) > 5
    assert (calm.regret < 1e-9).all()
    assert (weights[weights.varies].nearest >= 1).all()


@pytest.mark.slow
def test_what_is_drawn_depends_on_the_order_of_the_cities_and_not_on_their_names(
    folders, weight_study, tmp_path
):
    names = {"west": "alpha", "east": "beta"}
    renamed = run_study("weight_study", dict(zip(names, folders, strict=True)), tmp_path)
    keys = {
        "routes": KEY,
        "summary": ["cut", "value"],
    }
    for name, key in keys.items():
        key = key if name == "routes" else [*key, "weight_name"]
        tables = [
            found.tables[name].replace(names, regex=True).set_index(key)
            for found in (weight_study, renamed)
        ]
        one, other = (
            table.sort_index().drop(columns="elapsed_s", errors="ignore") for table in tables
        )
        pd.testing.assert_frame_equal(one, other, check_like=True, check_exact=True)
    with pytest.raises(ju.InputError, match="its order of cities is"):
        run_study("weight_study", folders[::-1], weight_study.folder)


@pytest.mark.slow
def test_maps_in_memory_and_a_table_of_queries_give_the_same_rows(alpha, weight_study, tmp_path):
    of_alpha = weight_study.instances[weight_study.instances.city == "alpha"]
    asked = of_alpha[of_alpha.instance == weight_study.instances.instance[0]]
    queries = asked[
        ["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m", "time", "time_of_day"]
    ]
    again = ju.studies.sensitivity({"alpha": alpha}, tmp_path, queries, settings=WEIGHT_STUDY)
    assert f"cities: alpha; routes: {len(again.rows)}, " in repr(again)
    kinds = ("cost", "elasticity", "below", "above", "people")
    columns = [
        name
        for name in weight_study.rows
        if name.partition(":")[0] in kinds and "noise" not in name
    ]
    first = weight_study.rows.merge(asked[KEY], on=KEY).sort_values("altitude_m")[columns]
    np.testing.assert_allclose(
        again.rows.sort_values("altitude_m")[columns].astype(float), first.astype(float)
    )
    assert not again.is_sampled


@pytest.mark.slow
def test_a_route_that_fails_is_a_row_with_its_status(alpha, folders, weight_study, tmp_path):
    rows = weight_study.instances[weight_study.instances.city == "alpha"].iloc[:3].copy()
    rows["instance"] = [0, 1, 2]
    wall = np.argwhere(~alpha.is_free(20.0))[0]
    rows.loc[rows.index[0], ["goal_x_m", "goal_y_m"]] = alpha.grid.xy_of_cell(*wall)
    rows.loc[rows.index[1], ["goal_x_m", "goal_y_m"]] = rows.iloc[1][
        ["start_x_m", "start_y_m"]
    ].to_numpy()
    again = ju.studies.sensitivity(folders[0], tmp_path, rows, settings=WEIGHT_STUDY)
    assert again.rows.sort_values("instance").status.tolist() == [
        "bad-input",
        "bad-input",
        "optimal",
    ]
    report = (tmp_path / "report.md").read_text()
    assert "start and goal lie in one cell" in report
    assert "is inside an obstacle" in report
    (asked,) = (
        line for line in report.split("## ")[0].splitlines() if line.startswith("| alpha | ")
    )
    assert "| 20 m | 3 | 3 | 1 |" in asked


def test_the_report_names_every_figure_and_every_table_is_written(weight_study):
    report = (weight_study.folder / "report.md").read_text()
    assert "\n- Intervals are 95 %" in report  # a list, and no line of one
    shown = {part.split(")")[0] for part in report.split("](")[1:]}
    assert shown == {
        f"figures/{each.name}" for each in (weight_study.folder / "figures").glob("*.png")
    }
    for name, table in weight_study.tables.items():
        assert len(pd.read_parquet(weight_study.folder / "tables" / f"{name}.parquet")) == len(
            table
        )
    assert "nan" not in report.replace("dominant", "")
    assert report.count("© a made city") == 1
    assert "| of | weight | routes | regret % |" in report
    assert "Routes were drawn by stratum" in report


@pytest.mark.slow
def test_the_report_says_that_routes_were_given_and_how_each_city_normalises_population(
    weight_study,
):
    alpha = ju.MetricMaps(weight_study.maps["alpha"].ds.assign_attrs(pop_norm_per_km2=[5e4, 3e4]))
    maps = {**weight_study.maps, "alpha": alpha}
    report = sensitivity_report(replace(weight_study, is_sampled=False, maps=maps)).text
    assert "0.1 to 10, and where fewer routes change, the nearer end of these stands." in report
    assert "drawn by stratum" not in report
    assert "those that were given" in report
    alpha, beta = report.split("\n\n")[2].splitlines()[2:]
    assert alpha.endswith("| 50,000 (day), 30,000 (night) |")
    assert beta.endswith("|  |")


def test_no_text_of_a_figure_leaves_the_page(weight_study):
    assert faults(plot_regret(weight_study.tables["summary"], 2.0)) == []


def made_weights(**regret: float) -> pd.DataFrame:
    """A table of weights of 40 routes in each of two cities, whose regrets scatter about known ones."""
    rng = np.random.default_rng(5)
    same = {
        "altitude_m": 20.0,
        "varies": True,
        "nearest": 1.5,
        "below": 0.5,
        "above": 1.5,
        "time": "t",
    }
    same |= {
        "start_stratum": "open",
        "goal_stratum": "open",
        "range": "long",
        "time_of_day": None,
        "elasticity": 0.5,
        **dict.fromkeys(MORE, 0.0),
    }
    of_each = itertools.product("ab", range(40), regret)
    rows = [
        same | dict(zip(("city", "instance", "weight_name"), each, strict=True)) for each in of_each
    ]
    return pd.DataFrame(
        [row | {"regret": regret[row["weight_name"]] + rng.normal(0, 0.002)} for row in rows]
    )


def test_a_share_of_the_cost_is_no_measure_of_harm_and_regrets_have_the_interval_of_their_routes_within_cities():
    """Route A: 100 m, nothing of the layer. B: 1 m and 197 of it. Half the weight chooses B, which costs 98 % more."""
    table = made_weights(layer=0.98, other=0.001)
    table["elasticity"] = np.where(table.weight_name == "layer", 0.0, 0.5)
    rows = summarise(table, 2.0)
    tables = {"summary": rows, "together": pd.DataFrame({"needed": []})}
    first = shown_tables(tables)["by_all"].iloc[0]
    assert (first.weight, first["share %"]) == ("layer", 0.0)
    assert first["regret %"] == pytest.approx(98, abs=1)
    of_layer = table[table.weight_name == "layer"]
    row = rows[(rows.cut == "all") & (rows.weight_name == "layer")].iloc[0]
    interval = Clusters(of_layer.instance, of_layer.city).interval(of_layer.regret)
    alone = row.regret_alone, row.regret_alone_low, row.regret_alone_high
    assert alone == pytest.approx(tuple(interval))
    assert row.regret == row.regret_alone
    assert row.regret_low < row.regret_alone_low < row.regret_alone_high < row.regret_high


def said(table: pd.DataFrame, at_edge: float = 0.0) -> dict[WeightVerdict | SharedVerdict, Verdict]:
    """Return the verdicts of a made table of weights by their kinds, the first of each kind."""
    routes = pd.DataFrame({"at_edge": [at_edge] * 3 + [0.0] * 77})
    summary = summarise(table, 2.0)
    tables = {"weights": table, "routes": routes, "summary": summary, "together": pd.DataFrame()}
    verdicts = verdicts_of(tables, None, ju.studies.SensitivitySettings())
    return {each.kind: each for each in reversed(verdicts)}


def test_the_first_lines_know_which_weight_dominates_which_are_equal_and_which_changes_nothing():
    table = made_weights(gps=0.5, lidar=0.01, risk=0.01, flat=0.0)
    of_weight = table.groupby("weight_name").groups
    table.loc[of_weight["risk"], "regret"] = table.loc[of_weight["lidar"], "regret"].to_numpy()
    table.loc[of_weight["flat"], ["regret", "below", "above"]] = 0.0, np.nan, np.nan
    verdicts = said(table)
    more = verdicts[WeightVerdict.MATTERS_MORE]
    assert more.what == ("gps", "lidar = risk")
    assert more.low < 49 < more.high
    assert verdicts[SharedVerdict.EQUAL].what == ("lidar", "risk")
    assert verdicts[WeightVerdict.NO_CHANGE].what == ("flat",)
    assert verdicts[WeightVerdict.COSTS].what == ("gps",)
    assert WeightVerdict.TIED not in verdicts
    assert SharedVerdict.BORDER not in verdicts


def test_weights_that_cannot_be_told_apart_share_a_rank_and_routes_along_the_border_are_counted():
    table = made_weights(gps=0.01, risk=0.0101)
    table["more_at_edge"] = (table.instance < 4).astype(float)
    verdicts = said(table)
    tied = verdicts[WeightVerdict.TIED]
    assert set(tied.what) == {"gps", "risk"}
    assert tied.needed > 80
    assert WeightVerdict.MATTERS_MORE not in verdicts
    assert verdicts[SharedVerdict.BORDER].facts["count"] == 2 * 4
    assert "one weight 2 times wrong" in verdicts[SharedVerdict.BORDER].sentence
    assert said(table.assign(more_at_edge=0.0), 1.0)[SharedVerdict.BORDER].facts["count"] == 3


def test_where_any_route_costs_more_it_is_open_how_much_and_not_whether():
    table = made_weights(gps=0.01)
    table["regret"] = np.where(range(80), 0.0, 0.01)  # of the first one alone
    sentence = said(table)[WeightVerdict.COSTS_OPEN].sentence
    assert sentence.startswith("how much more routes cost with gps 2 times wrong is open: 0.0")
    assert "on average, as 1 % of these cost more and none less (" in sentence


def test_strata_with_fewer_than_ten_routes_are_left_out_and_named():
    table = made_weights(gps=0.01)
    table["range"] = np.select(
        [table.instance < 30, table.instance < 33, table.instance < 36],
        ["long", "short", "middle"],
        "far",
    )
    rows = summarise(table, 2.0)
    of_range = rows[rows.cut == "range"].set_index("value").routes.to_dict()
    assert of_range == {"long": 60}
    assert small_parts(table) == ["far (8)", "middle (6)", "short (6)"]


def perturbed_rows(nominal, other, instances):
    job = OnChangedMaps(
        nominal_at=partial(RouteRules().cost_map, nominal), change={"change": "other", "draw": 0}
    )
    tasks = [InstanceRuns(instance, job.runs) for instance in instances]
    return pd.DataFrame(row for rows in solve_here(tasks, {"a": other}, job) for row in rows)


def test_routes_on_maps_made_anew_are_compared_both_ways(alpha):
    asked = sample_joined(alpha, 6, weights=[ju.Weights()]).assign(city="a").to_dict("records")
    same = perturbed_rows(alpha, alpha, asked)
    assert (same[["is_other", "nominal_regret", "nominal_is_closed"]] == 0).all(axis=None)
    assert (same.overlap == 1).all()
    other = ju.MetricMaps(alpha.ds.assign(risk=1 - alpha.ds["risk"]))
    found = perturbed_rows(alpha, other, asked)
    assert found.is_other.sum() > 3
    for row, instance in zip(found.to_dict("records"), asked, strict=True):
        ends = [ju.XY(instance[f"{end}_x_m"], instance[f"{end}_y_m"]) for end in ("start", "goal")]
        at = {
            "time": instance["time"],
            "time_of_day": instance["time_of_day"],
            "cost_model": "line",
        }
        here, there = (ju.cost_map(each, instance["altitude_m"], **at) for each in (alpha, other))
        nominal, best = here.plan(*ends), there.plan(*ends)
        corner_m = [alpha.grid.x_min_m, alpha.grid.y_min_m]
        cost = there.problem.features(nominal.xy_m - corner_m).cost(there.weight_vector)
        assert row["nominal_regret"] == pytest.approx(cost / best.cost - 1, abs=1e-9)


def test_routes_on_several_draws_of_heights_count_once():
    rows = {"city": "a", "instance": [0, 1, 0, 1], "altitude_m": 60.0, "draw": [0, 0, 1, 1]}
    facts = dict.fromkeys(("is_other", "overlap", "nominal_is_closed", "nominal_regret"), 0.0)
    rows |= {"change": "heights", "layers": "risk", "status": "optimal"} | facts
    (row,) = summarise_changed(pd.DataFrame(rows)).to_dict("records")
    assert (row["routes"], row["draws"]) == (2, 2)


@pytest.fixture(scope="module")
def of_heights(tmp_path_factory) -> Sensitivity:
    """Return a study of a town, with maps of drawn heights."""
    folder = tmp_path_factory.mktemp("town")
    region = {
        "bounds": [-73.98, 40.775, -73.968, 40.785],
        "resolution_m": 25.0,
        "altitudes_m": [20],
    }
    sections = {"region": region, "buildings": {"source": "synthetic"}}
    run_scenario(ju.Scenario.from_dict(sections), folder / "maps", progress=False)
    chosen = ju.studies.SensitivitySettings(vary=("risk",), num_heights=1)
    how = {"weights": ju.Weights(population=5.0), "settings": chosen, "progress": False}
    return ju.studies.sensitivity({"town": folder / "maps"}, folder / "out", 9, **how)


@pytest.mark.slow
def test_rows_on_changed_maps_that_are_kept_are_not_made_again(of_heights, monkeypatch):
    def refuse(task):
        raise AssertionError("these maps were made before")

    monkeypatch.setattr("jaxurban.studies.weights.changed_maps.compute_maps", refuse)
    folder = of_heights.folder
    study = partial(
        ju.studies.sensitivity,
        {"town": folder.parent / "maps"},
        folder,
        9,
        weights=ju.Weights(population=5.0),
        progress=False,
    )
    again = study(settings=of_heights.settings)
    pd.testing.assert_frame_equal(again.changed, of_heights.changed)
    more = replace(of_heights.settings, num_heights=2)
    with pytest.raises(AssertionError, match="made before"):
        study(settings=more)


@pytest.mark.slow
def test_routes_on_maps_without_their_sources_are_studied_but_for_drawn_heights(
    alpha, weight_study, tmp_path
):
    chosen = replace(WEIGHT_STUDY, vary=("risk",), num_heights=1)
    routes = weight_study.instances.query("city == 'alpha'").iloc[:1]
    found = ju.studies.sensitivity(
        {"alpha": alpha}, tmp_path, routes, settings=chosen, progress=False
    )
    assert set(found.changed.change) == {"time_of_day"}
    assert "maps in memory do not name their sources" in found.skipped[0]


def test_wider_maps_come_next_with_the_same_routes_of_each_city(weight_study):
    rows = weight_study.rows
    none = dict.fromkeys(rows.filter(regex="^(regret|together|more)").columns, 0.0)
    none |= dict.fromkeys(rows.filter(regex="^(below|above):").columns, np.nan)
    pinned = replace(weight_study, rows=rows.assign(**none, at_edge=1.0))
    *makes, studies = pinned.decided.next_command.split(" && ")
    folders = []
    for (city, maps), make in zip(pinned.maps.items(), makes, strict=True):
        folders.append(f"{maps.folder}-wider/{city}")  # a city is called as its folder
        assert make.startswith(f"jaxurban maps {maps.folder} -o {folders[-1]} --set ")
    assert studies.startswith(f"jaxurban sensitivity {' '.join(folders)} --resolution ")
    assert studies.endswith(f" --routes {pinned.folder / 'instances.parquet'}")
    assert "--altitude" not in studies  # which the table names
    assert "--weights" not in studies

    # Where nothing is open other routes come next, as many as were studied.
    table = pinned.instances
    more = [table.assign(instance=table.instance + 100 * turn) for turn in range(9)]
    settled = replace(pinned, rows=pinned.rows.assign(at_edge=0.0), instances=pd.concat(more))
    num = settled.instances.query("city == 'alpha'").instance.nunique()
    assert num > 30
    assert f" --study seed={settled.settings.seed + 1} " in settled.decided.next_command
    assert settled.decided.next_command.endswith(f" --routes {num}")


def test_the_next_study_asks_what_this_one_asks_under_the_same_rules(weight_study):
    def next_of(**changes) -> str:
        return replace(weight_study, **changes).decided.next_command

    asked = replace(WEIGHT_STUDY, wrong=3.0, num_heights=2, seed=0, height_seed=5)
    assert " --study wrong=3,num_heights=2,height_seed=5 " in next_of(settings=asked)
    limits = ju.Constraints.read(require=["gps>=0.3", "gps_floor"], clearance_m=2.5)
    rules = replace(weight_study.rules, constraints=limits, snap=20.0)
    command = next_of(rules=rules)
    assert " --require 'gps>=0.3' --require gps_floor --rules clearance_m=2.5 " in command
    assert " --snap 20 " in command
    usual = next_of()
    assert "--require" not in usual
    assert "--rules" not in usual
    assert " --altitude 20,60 " in usual

    # A layer that a city lacks has a weight in the others, and may have none in a table of its routes.
    table = weight_study.instances
    assert "population" not in weight_study.maps["beta"].metrics
    is_listed = table.w_population.mask(table.city == "beta", 0.0)
    listed = next_of(instances=table.assign(w_population=is_listed))
    assert listed == usual
    assert ",population=1," in usual

    # Where cities hold other altitudes, each was asked for all of its own.
    is_lower = (table.city == "beta") & (table.altitude_m == 60.0)
    lower = table.assign(altitude_m=table.altitude_m.mask(is_lower, 50.0))
    assert "--altitude" not in next_of(instances=lower)


def test_only_layers_that_differ_at_another_time_of_day_are_named_and_alike_times_are_no_change(
    alpha,
):
    settings = ju.studies.SensitivitySettings()

    def changes(maps):
        found = changed_maps("alpha", maps, maps, settings, None)
        is_error = (isinstance(make, ju.InputError) for *_, make in found)
        return [*is_error]

    assert changes(alpha) == [False]
    assert differing_layers(alpha, "time_of_day", 1) == ["population"]
    ds = alpha.ds.copy(deep=True)
    ds["population"].values[1:] = ds["population"].values[0] + 6e-8  # norms that are multiples
    alike = ju.MetricMaps(ds)
    assert changes(alike) == [True]
    ((*_, error),) = changed_maps("alpha", alike, alike, settings, None)
    assert str(error) == "the maps of each time of day are the same: nothing was compared"

    row = {"change": "time_of_day", "is_other": 0.2, "is_other_low": 0.1, "is_other_high": 0.3}
    row |= {"routes": 40, "nominal_regret": 0.01}
    drawn = on_other_maps(row | {"change": "heights", "layers": "risk", "draws": 2}).sentence
    assert drawn.endswith("(40 routes, each on the maps of 2 draws)")
    people = on_other_maps(row | {"layers": "population"}).sentence
    assert people.startswith("with people of another time of day 20 % (10 to 30) of the routes")
    noise = on_other_maps(row | {"layers": "noise"}).sentence
    assert noise.startswith("with m_noise of another time of day 20 %")


@pytest.mark.slow
def test_the_command_studies_cities_and_remakes_their_maps(tmp_path, capsys):
    (tmp_path / "town.toml").write_text(TOWN)
    for name, east in (("one", 0.0), ("two", 0.02)):
        moved = f"region.bounds=[{-74.0 + east}, 40.755, {-73.985 + east}, 40.765]"
        cell = ("--set", "region.resolution_m=25", "--set", 'planning.cost_model="line"')
        assert (
            run(
                capsys, "maps", tmp_path / "town.toml", "-o", tmp_path / name, "--set", moved, *cell
            )[0]
            == 0
        )
    cities, out = [tmp_path / "one", tmp_path / "two"], tmp_path / "out"
    options = [
        "--routes",
        8,
        "--altitude",
        "20,60",
        "--workers",
        1,
        "-o",
        out,
        "--json",
    ]
    code, text, err = run(capsys, "sensitivity", *cities, *options)
    assert code == 0, err
    assert json.loads(text)["statuses"] == {"optimal": 2 * 8 * 2}
    more = ("--study", "num_heights=2")
    code, text, err = run(capsys, "sensitivity", *cities, *options, *more)
    assert code == 0, err
    told = [row for row in json.loads(text)["tables"]["changed_summary"] if row["of"] == "all"]
    assert len(told) == 2
    heights = next(row for row in told if row["change"] == "heights")
    assert heights["is_other"] == 0, "the synthetic city knows its heights"
    assert "| heights | all |" in (out / "report.md").read_text()
    places = ["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m"]
    pd.read_parquet(out / "instances.parquet").query("city == 'one'")[places].to_csv(
        tmp_path / "q.csv", index=False
    )
    options = [
        "--routes",
        tmp_path / "q.csv",
        "--workers",
        1,
        "-o",
        tmp_path / "q",
    ]
    code, _, err = run(capsys, "sensitivity", cities[0], *options)
    assert code == 0, err
    assert len(pd.read_parquet(tmp_path / "q/routes/rows.parquet")) == 16


@pytest.fixture(params=WHERE)
def kept(request, folders):
    """Return a study's name, what it gave, how it is run in another folder, and the columns that name a row."""
    result = request.getfixturevalue(request.param)
    key = [
        "instance",
        "altitude_m",
        *(["planner", "objective"] if request.param == "study" else ["city"]),
    ]
    return request.param, result, partial(run_study, request.param, folders), key


def test_every_run_has_a_row_once_and_the_file_holds_them(kept):
    name, result, _, key = kept
    assert len(result.rows) == (
        12 * 2 * 6 if name == "study" else 2 * 9 * 2
    )  # five planners and one distance-only run
    assert not result.rows.duplicated(key).any()
    assert not result.rows.status.isin(["crashed", "invalid", "bad-input"]).any()
    same_rows(pd.read_parquet(result.folder / WHERE[name] / "rows.parquet"), result.rows)


@pytest.mark.slow
def test_a_killed_study_goes_on_with_no_row_lost_or_doubled(kept, folders, tmp_path):
    name, result, again, key = kept
    out = tmp_path / "out"
    parts = out / WHERE[name] / "parts"
    job = subprocess.Popen(
        [sys.executable, "-c", CALL, name, *folders, out], cwd=Path(__file__).parents[2]
    )
    while len(list(parts.glob("*.json"))) < 3:
        assert job.poll() is None
        time.sleep(0.005)
    job.send_signal(signal.SIGKILL)
    job.wait()
    rows = [row for part in parts.glob("*.json") for row in json.loads(part.read_text())["rows"]]
    assert 0 < len(rows) < len(result.rows)
    found = again(out).rows
    same_rows(found, result.rows)
    times = found.set_index(key).elapsed_s
    for row in rows:  # what was done before is not done again
        assert times[tuple(row[column] for column in key)] == row["elapsed_s"]


@pytest.mark.slow
def test_two_workers_give_the_rows_of_one(kept, tmp_path):
    _, result, again, _ = kept
    same_rows(again(tmp_path, workers=2).rows, result.rows)


def test_a_route_that_nothing_joins_is_studied_next_at_the_altitude_that_joins_its_ends(tmp_path):
    maps = made_maps(24, 24, (20.0, 60.0))
    maps.ds["obstacle"].values[0, 12] = 1  # a wall from side to side, 20 m up alone
    start, goal = (maps.grid.lonlat_of_cell(row, 12) for row in (4, 20))
    assert not ju.plan(maps, start, goal, altitude_m=20.0).status.has_path
    queries = [(start, goal)]
    found = ju.studies.sensitivity(
        {"made": maps}, tmp_path / "out", queries, altitudes_m=[20.0], progress=False
    )
    assert "as no path was found" in str(found.decided)
    assert found.rows.note[0].rstrip(".") in found.decided.facts["not decided"]
    with pytest.raises(ju.InputError, match=r"no table 'ways'.*: it has routes"):
        len(found.tables["ways"])
    command = found.decided.next_command
    assert "--altitude 60 " in command
    assert f"--start {start[0]:.6f},{start[1]:.6f}" in command
