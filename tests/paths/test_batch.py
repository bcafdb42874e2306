"""plan_many: every query gets its result once, whatever happens to others, to the file or to the process."""

import inspect
import re
from ast import literal_eval

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.io.tables import RowStore, write_table
from jaxurban.paths import batch as many_module
from jaxurban.paths.choices import MapChoice, RulesChoice, SearchChoice
from jaxurban.paths.queries import LONLAT
from jaxurban.paths.search import PathSearch
from jaxurban.planners.base import Status
from jaxurban.planners.registry import solve_many
from jaxurban.typing import CostMap

METRES = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]


@pytest.fixture(scope="module")
def pairs(town):
    """Six pairs of places that are free at 20 m, longitude and latitude."""
    is_free = ju.Constraints().is_free(town, 20.0)
    cells = np.random.default_rng(0).choice(np.argwhere(is_free), (6, 2))
    return [
        tuple(tuple(map(float, town.grid.lonlat_of_cell(*cell))) for cell in pair) for pair in cells
    ]


@pytest.fixture(scope="module")
def many(town):
    """Plan many routes over the town, at 20 m or as is given."""
    return lambda queries, **options: ju.plan_many(
        town, queries, **({"altitude_m": 20.0} | options)
    )


@pytest.mark.parametrize("backend", ["numba", pytest.param("jax", marks=pytest.mark.slow)])
def test_a_batch_gives_the_paths_of_single_plans_in_order(town, many, pairs, backend):
    how = {
        "altitude_m": 35.0,
        "cost_model": "line",
        "budget_s": np.inf,
    }  # between those of the maps
    batch = many(pairs, **how, backend=backend)
    assert (len(batch), batch.was_interrupted) == (len(pairs), False)
    for pair, path in zip(pairs, batch, strict=True):
        alone = ju.plan(town, *pair, **how)
        assert (path.status, path.search.backend) == (alone.status, backend)
        assert path.cost == pytest.approx(alone.cost, rel=1e-9)


def test_each_row_of_a_table_has_its_own_altitude_time_of_day_and_weights(town, many, pairs):
    own = {
        "altitude_m": [20, np.nan, 35],
        "time_of_day": ["night", None, "day"],
        "w_risk": [np.nan, 7.0, 0.0],
    }
    table = pd.DataFrame([np.ravel(pairs[0])] * 3, columns=list(LONLAT)).assign(**own)
    batch = many(table, weights=ju.Weights(gps=2.0))
    assert [path.altitude_m for path in batch] == [20, 20, 35]
    assert (
        batch[2].cost
        == ju.plan(town, *pairs[0], altitude_m=35.0, weights={"gps": 2.0, "risk": 0.0}).cost
    )
    assert [path.settings["time_of_day"] for path in batch] == [
        "night",
        town.times_of_day[0],
        "day",
    ]
    assert [path.settings["weights"]["risk"] for path in batch] == [1, 7, 0]
    assert {path.settings["weights"]["gps"] for path in batch} == {2}
    rows = batch.to_dataframe()[["query", "cost", "m_gps"]]
    np.testing.assert_allclose(
        rows, [(k, path.cost, path.metrics["gps"]) for k, path in enumerate(batch)]
    )


def test_places_may_be_given_in_metres_and_in_an_array(town, many, pairs):
    xy_m = [np.ravel([town.grid.xy_of_lonlat(*place) for place in pair]) for pair in pairs]
    table = pd.DataFrame(xy_m, columns=METRES)
    places = [(ju.XY(*row[:2]), ju.XY(*row[2:])) for row in xy_m]
    costs = [[path.cost for path in many(of)] for of in (table, pairs, np.array(pairs), places)]
    assert costs[0] == costs[1] == costs[2] == costs[3]


def test_a_query_that_cannot_be_asked_is_a_row_with_its_sentence(town, many, pairs):
    wall = town.grid.lonlat_of_cell(*np.argwhere(~town.is_free(20.0, "centre"))[0])
    table = pd.DataFrame([np.ravel(pair) for pair in pairs], columns=list(LONLAT))
    table.loc[1, ["start_lon", "start_lat"]] = wall
    table.loc[2, "goal_lat"] = np.nan
    batch = many(table.assign(altitude_m=[20.0, 20, 20, 13, 20, 20], w_gps=[1.0, 1, 1, 1, -1, 1]))
    rows = batch.to_dataframe()
    assert rows["status"].tolist() == ["optimal", *["bad-input"] * 4, "optimal"]
    for k, words in {
        1: "nearest free cell",
        2: "two finite numbers",
        3: "altitude",
        4: "weight gps must be",
    }.items():
        assert (batch[k], words in rows["message"][k]) == (None, True)
    assert many(table[:2], snap=True)[1].snap_distance_m[0] > 0


def test_one_signature_lists_what_functions_pass_on_and_names_what_none_takes():
    many, one = (
        set(inspect.signature(function).parameters) for function in (ju.plan_many, ju.plan)
    )
    assert {"time", "weights", "preset", "planner", "snap"} <= many & one
    assert "asked" not in many | one
    for function in (ju.plan_many, ju.plan, ju.cost_map):  # their help names each
        arguments = function.__doc__[function.__doc__.index("Args:") :]
        assert [
            name for name in inspect.signature(function).parameters if name not in arguments
        ] == []


def test_keywords_that_functions_pass_on_are_those_of_a_cost_map_and_a_search():
    choices = {MapChoice: ju.cost_map, SearchChoice: PathSearch.of}
    for choice, function in choices.items():
        taken = {
            name: parameter.annotation
            for name, parameter in inspect.signature(function).parameters.items()
            if parameter.kind is parameter.KEYWORD_ONLY
        }
        assert choice.__annotations__ == taken
    studies = (ju.studies.study, ju.studies.sample_instances, ju.fit.demonstrations)
    for function in studies:
        assert {*RulesChoice.__annotations__} < {*inspect.signature(function).parameters}
    for function in (ju.plan, ju.plan_many, ju.when, ju.cost_to_go, CostMap.plan, *studies):
        parameters = inspect.signature(function).parameters.values()
        assert not any(each.kind is each.VAR_KEYWORD for each in parameters)
        assert ... in {each.default for each in parameters}


def test_drawn_instances_are_planned_without_the_columns_that_a_refusal_names(town, many):
    drawn = ju.studies.sample_instances(town, 2).query("altitude_m == 20")
    with pytest.raises(
        ju.InputError, match=r"unknown columns \[.*queries\.drop\(columns="
    ) as refused:
        many(drawn)
    named = literal_eval(re.search(r"\[.*?\]", str(refused.value))[0])
    assert all(
        path.status is Status.OPTIMAL for path in many(drawn.drop(columns=[*named, *LONLAT]))
    )


class Interrupting:
    """solve_many that stops as Ctrl-C does, or crashes, after some results; counts what it is asked."""

    def __init__(self, after, error):
        self.after, self.error, self.asked = after, error, []

    def __call__(self, problems, **options):
        self.asked.append(len(options["only"]))
        for done, outcome in enumerate(solve_many(problems, **options)):
            if done == self.after:
                raise self.error
            yield outcome


def test_ctrl_c_returns_what_is_done(many, pairs, monkeypatch, caplog):
    monkeypatch.setattr(many_module, "solve_many", Interrupting(2, KeyboardInterrupt()))
    batch = many(pairs)
    assert batch.was_interrupted
    assert batch.to_dataframe()["status"].tolist().count("not-run") == [*batch].count(None) == 4
    assert "2 of 6 queries are done" in caplog.text


def test_a_rerun_asks_only_what_the_file_lacks(many, pairs, monkeypatch, tmp_path):
    file = tmp_path / "answers.parquet"
    how = {"planner": "astar-dist", "file": file}
    whole = many(pairs, planner="astar-dist")
    with monkeypatch.context() as patched:
        patched.setattr(many_module, "solve_many", Interrupting(2, RuntimeError("power cut")))
        with pytest.raises(RuntimeError):
            many(pairs, **how)
    assert len(pd.read_parquet(file)) == 2
    counting = Interrupting(99, None)
    monkeypatch.setattr(many_module, "solve_many", counting)
    batch, again = many(pairs, **how), many(pairs, **how)
    assert counting.asked == [4, 0]
    rows = pd.read_parquet(file)
    assert rows["query"].tolist() == list(range(6))
    expected = whole.to_dataframe().drop(columns=["elapsed_s", "setup_s"])
    for other in (batch.to_dataframe(), again.to_dataframe(), rows):
        pd.testing.assert_frame_equal(other[expected.columns], expected, rtol=1e-12)
    for kept, fresh in zip(again, whole, strict=True):
        np.testing.assert_allclose(kept.xy_m, fresh.xy_m, rtol=0, atol=1e-6)
        assert kept.metrics == pytest.approx(fresh.metrics)
        assert kept.settings == fresh.settings


def test_a_larger_budget_plans_again_what_a_smaller_one_ended(many, pairs, tmp_path, monkeypatch):
    file = tmp_path / "answers.parquet"
    whole = many(pairs, budget_s=5.0, file=file)
    table = pd.read_parquet(file)
    table.loc[[1, 4], "status"] = ["budget-empty", "budget-feasible"]
    write_table(table, file)
    counting = Interrupting(99, None)
    monkeypatch.setattr(many_module, "solve_many", counting)
    for budget_s, num_asked, of_row in ((2.0, 0, 5.0), (5.0, 0, 5.0), (8.0, 2, 8.0), (9.0, 0, 8.0)):
        batch = many(pairs, budget_s=budget_s, file=file)
        assert counting.asked.pop() == num_asked
        assert batch[1].settings["budget_s"] == of_row
        assert batch[0].settings["budget_s"] == 5.0
    np.testing.assert_array_equal(batch[1].xy_m, whole[1].xy_m)


def test_samples_instead_of_seconds_give_the_same_route_through_every_door(
    town, many, pairs, tmp_path
):
    """Of `plan_many` alone, too, from its file, and by a machine that is slower."""
    how = {"planner": "bitstar-plus", "max_samples": 200, "seed": 3}
    file = tmp_path / "rows.parquet"
    batch, again = (many(pairs[:2], **how, file=file) for _ in range(2))
    on = ju.cost_map(town, 20.0)
    for pair, path, kept in zip(pairs, batch, again, strict=False):
        assert path.settings["budget_s"] is None
        assert path.settings["max_samples"] == 200
        doors = [ju.plan(town, *pair, altitude_m=20.0, **how), on.plan(*pair, **how), kept]
        for other in doors:
            np.testing.assert_allclose(other.xy_m, path.xy_m, rtol=0, atol=1e-6)
    with pytest.raises(ju.InputError, match="max_samples is of the planners bitstar-dist and"):
        many(pairs, max_samples=200)
    limited = on.plan(*pairs[0], **how, budget_s=9.0)
    assert limited.settings["budget_s"] == 9.0


def test_a_resumed_batch_gives_the_routes_of_the_whole_one(town, many, monkeypatch, tmp_path):
    free = np.argwhere(ju.Constraints().is_free(town, 20.0))
    cells = np.random.default_rng(1).choice(free, (30, 2))
    cells[20:, 1] = cells[0, 1]  # of which ten share a goal, and the rest are enough for landmarks
    xy_m = np.stack(town.grid.xy_of_cell(cells[..., 0], cells[..., 1]), axis=-1)
    queries = pd.DataFrame(xy_m.reshape(30, 4), columns=METRES)
    given = {"objective": "distance"}  # under which many routes are as short
    whole = many(queries, **given, num_threads=1)
    names = [path.search.heuristic for path in whole]
    assert names == ["exact"] + ["landmarks"] * 19 + ["exact"] * 10
    assert whole.facts["heuristics"] == "landmarks 19, exact 11"
    file = tmp_path / "answers.parquet"
    with monkeypatch.context() as patched:
        patched.setattr(many_module, "solve_many", Interrupting(14, KeyboardInterrupt()))
        many(queries, **given, file=file)
    resumed = many(queries, **given, file=file, num_threads=2)
    for path, other in zip(resumed, whole, strict=True):
        assert path.search.heuristic == other.search.heuristic
        np.testing.assert_allclose(path.xy_m, other.xy_m, rtol=0, atol=1e-6)


def test_a_file_with_other_results_is_left_alone(many, pairs, tmp_path):
    file = tmp_path / "answers.parquet"
    many(pairs, file=file)
    before = file.read_bytes()
    for options in ({"weights": ju.Weights(gps=3.0)}, {"planner": "ptp"}, {"altitude_m": 600.0}):
        with pytest.raises(ju.InputError, match="results of other queries"):
            many(pairs, **options, file=file)
    with pytest.raises(ju.InputError, match="no results of these queries"):
        many(pairs[:3], file=file)
    assert file.read_bytes() == before
    write_table(pd.DataFrame({"a": [1]}), file)
    with pytest.raises(ju.InputError, match="holds no 'query'"):
        many(pairs, file=file)
    file.write_text("no table")
    with pytest.raises(ju.InputError, match="name another file"):
        many(pairs, file=file)


def test_a_crash_is_a_row(many, pairs, monkeypatch):
    def crash_one(problems, **options):
        for index, path in solve_many(problems, **options):
            yield index, ZeroDivisionError("by a bug") if index == 1 else path

    monkeypatch.setattr(many_module, "solve_many", crash_one)
    batch = many(pairs)
    assert batch[1] is None
    assert batch.to_dataframe()["message"][1] == "ZeroDivisionError: by a bug"
    assert all(path.status is Status.OPTIMAL for k, path in enumerate(batch) if k != 1)


def test_the_file_is_rewritten_on_the_way(many, pairs, monkeypatch, tmp_path):
    monkeypatch.setattr("jaxurban.io.tables.SAVE_EVERY_S", 0.0)
    monkeypatch.setattr("jaxurban.io.tables.SAVING_SHARE", np.inf)
    saved = []
    monkeypatch.setattr(
        RowStore, "save", lambda self, save=RowStore.save: (save(self), saved.append(len(self)))
    )
    many(pairs, file=tmp_path / "answers.parquet")
    assert saved == [1, 2, 3, 4, 5, 6, 6]


def test_an_empty_batch_is_an_empty_table(many):
    assert many([]).to_dataframe().empty
