"""plan_many: every query gets its result once, whatever happens to others, to the file or to the process."""

import inspect
from ast import literal_eval

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.tables import RowStore, write_table
from jaxurban.paths import batch as many_module
from jaxurban.paths.queries import LONLAT
from jaxurban.planners.base import Status
from jaxurban.planners.registry import solve_many


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    return ju.build_maps(ju.demo_city(1_000, 1_000), resolution_m=10.0, altitudes_m=(20.0, 600.0))


def places(maps, num, seed=0):
    """Free places at 20 m, longitude and latitude."""
    free = np.argwhere(maps.is_free(20.0))
    cells = free[np.random.default_rng(seed).choice(len(free), num)]
    return [tuple(float(v) for v in maps.grid.lonlat_of_cell(*cell)) for cell in cells]


@pytest.fixture(scope="module")
def pairs(maps):
    return list(zip(places(maps, 6, 0), places(maps, 6, 1), strict=True))


@pytest.mark.parametrize("backend", ["numba", pytest.param("jax", marks=pytest.mark.slow)])
def test_a_batch_gives_the_paths_of_single_plans_in_order(maps, pairs, backend):
    how = {"altitude_m": 20.0, "cost_model": "line", "budget_s": np.inf}
    batch = ju.plan_many(maps, pairs, **how, backend=backend)
    assert len(batch) == len(pairs)
    assert not batch.was_interrupted
    for (start, goal), path in zip(pairs, batch, strict=True):
        alone = ju.plan(maps, start, goal, **how)
        assert path.status is alone.status
        assert path.cost == pytest.approx(alone.cost, rel=1e-9)
        assert path.search.backend == backend


def test_each_row_of_a_table_has_its_own_altitude_time_of_day_and_weights(maps, pairs):
    table = pd.DataFrame(
        {
            "start_lon": [pairs[0][0][0]] * 3,
            "start_lat": [pairs[0][0][1]] * 3,
            "goal_lon": [pairs[0][1][0]] * 3,
            "goal_lat": [pairs[0][1][1]] * 3,
            "altitude_m": [20, np.nan, 600],
            "time_of_day": ["night", None, "day"],
            "w_risk": [np.nan, 7.0, 0.0],
        }
    )
    batch = ju.plan_many(maps, table, altitude_m=20.0, weights=ju.Weights(gps=2.0))
    assert [path.altitude_m for path in batch] == [20, 20, 600]
    assert [path.settings["time_of_day"] for path in batch] == ["night", maps.times_of_day[0], "day"]
    assert [path.settings["weights"]["risk"] for path in batch] == [1, 7, 0]
    assert {path.settings["weights"]["gps"] for path in batch} == {2}
    rows = batch.to_dataframe()
    assert rows["query"].tolist() == [0, 1, 2]
    np.testing.assert_allclose(rows["cost"], [path.cost for path in batch])
    np.testing.assert_allclose(rows["m_gps"], [path.metrics["gps"] for path in batch])


def test_places_may_be_given_in_metres_and_in_an_array(maps, pairs):
    xy_m = [np.ravel([maps.grid.xy_of_lonlat(*place) for place in pair]) for pair in pairs]
    table = pd.DataFrame(xy_m, columns=["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"])
    costs = [[path.cost for path in ju.plan_many(maps, of, altitude_m=20.0)] for of in (table, pairs, np.array(pairs))]
    assert costs[0] == costs[1] == costs[2]


def test_a_query_that_cannot_be_asked_is_a_row_with_its_sentence(maps, pairs):
    wall = maps.grid.lonlat_of_cell(*np.argwhere(~maps.is_free(20.0, "centre"))[0])
    table = pd.DataFrame([[*start, *goal] for start, goal in pairs], columns=list(LONLAT))
    table.loc[1, ["start_lon", "start_lat"]] = wall
    table.loc[2, "goal_lat"] = np.nan
    table["altitude_m"] = [20.0, 20, 20, 13, 20, 20]
    table["w_gps"] = [1.0, 1, 1, 1, -1, 1]
    batch = ju.plan_many(maps, table)
    rows = batch.to_dataframe()
    assert rows["status"].tolist() == ["optimal", *["bad-input"] * 4, "optimal"]
    for k, words in {1: "nearest free cell", 2: "two finite numbers", 3: "altitude", 4: "weight gps must be"}.items():
        assert words in rows["message"][k]
        assert batch[k] is None
    with pytest.raises(InputError, match="query 1: start is inside an obstacle"):
        ju.plan_many(maps, table[:2], strict=True)
    snapped = ju.plan_many(maps, table[:2], snap=True)
    assert snapped[1].snap_distance_m[0] > 0


def test_one_signature_lists_what_functions_pass_on_and_names_what_none_takes(maps, pairs):
    many, one = (set(inspect.signature(function).parameters) for function in (ju.plan_many, ju.plan))
    assert {"time", "weights", "preset", "planner", "snap"} <= many & one
    assert "asked" not in many | one
    for function in (ju.plan_many, ju.plan, ju.cost_map):  # their help names each
        arguments = function.__doc__[function.__doc__.index("Args:") :]
        assert [name for name in inspect.signature(function).parameters if name not in arguments] == []
    with pytest.raises(InputError, match=r"plan_many: there is no argument 'planer' \(did you mean 'planner'\?\)"):
        ju.plan_many(maps, pairs, altitude_m=20.0, planer="ptp")
    with pytest.raises(InputError, match="refine is of a single plan"):
        ju.plan_many(maps, pairs, altitude_m=20.0, refine=True)


def test_drawn_instances_are_planned_without_the_columns_that_a_refusal_names(maps):
    drawn = ju.studies.sample_instances(maps, 2).query("altitude_m == 20")
    with pytest.raises(InputError, match=r"unknown columns \[.*queries\.drop\(columns=") as refused:
        ju.plan_many(maps, drawn)
    named = literal_eval(str(refused.value)[str(refused.value).index("[") : str(refused.value).index("]") + 1])
    assert all(path.status is Status.OPTIMAL for path in ju.plan_many(maps, drawn.drop(columns=[*named, *LONLAT])))


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


def test_ctrl_c_returns_what_is_done(maps, pairs, monkeypatch, caplog):
    monkeypatch.setattr(many_module, "solve_many", Interrupting(2, KeyboardInterrupt()))
    batch = ju.plan_many(maps, pairs, altitude_m=20.0)
    assert batch.was_interrupted
    rows = batch.to_dataframe()
    assert (rows["status"] == "not-run").sum() == 4
    assert sum(path is not None for path in batch) == 2
    assert "2 of 6 queries are done" in caplog.text


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("power cut")])
def test_a_rerun_asks_only_what_the_file_lacks(maps, pairs, monkeypatch, tmp_path, error):
    file = tmp_path / "answers.parquet"
    whole = ju.plan_many(maps, pairs, altitude_m=20.0, planner="astar-dist")
    with monkeypatch.context() as patched:
        patched.setattr(many_module, "solve_many", Interrupting(2, error))
        if isinstance(error, KeyboardInterrupt):
            ju.plan_many(maps, pairs, altitude_m=20.0, planner="astar-dist", file=file)
        else:
            with pytest.raises(RuntimeError):
                ju.plan_many(maps, pairs, altitude_m=20.0, planner="astar-dist", file=file)
    assert len(pd.read_parquet(file)) == 2
    counting = Interrupting(99, error)
    monkeypatch.setattr(many_module, "solve_many", counting)
    batch = ju.plan_many(maps, pairs, altitude_m=20.0, planner="astar-dist", file=file)
    assert counting.asked == [4]
    again = ju.plan_many(maps, pairs, altitude_m=20.0, planner="astar-dist", file=file)
    assert counting.asked == [4, 0]
    rows = pd.read_parquet(file)
    assert rows["query"].tolist() == list(range(6))
    clocks = ["elapsed_s", "setup_s"]
    timing = [*clocks, "x_m", "y_m", "search", "key"]
    for other in (batch.to_dataframe(), again.to_dataframe(), rows):
        pd.testing.assert_frame_equal(
            other.drop(columns=timing, errors="ignore"), whole.to_dataframe().drop(columns=clocks), rtol=1e-12
        )
    for kept, fresh in zip(again, whole, strict=True):
        np.testing.assert_allclose(kept.xy_m, fresh.xy_m, rtol=0, atol=1e-6)
        assert kept.metrics == pytest.approx(fresh.metrics)
        assert kept.settings == fresh.settings


def test_a_larger_budget_plans_again_what_a_smaller_one_ended(maps, pairs, tmp_path, monkeypatch):
    file = tmp_path / "answers.parquet"
    whole = ju.plan_many(maps, pairs, altitude_m=20.0, budget_s=5.0, file=file)
    table = pd.read_parquet(file)
    table.loc[[1, 4], "status"] = ["budget-empty", "budget-feasible"]
    write_table(table, file)
    counting = Interrupting(99, None)
    monkeypatch.setattr(many_module, "solve_many", counting)
    for budget_s, num_asked, of_row in ((2.0, 0, 5.0), (5.0, 0, 5.0), (8.0, 2, 8.0), (9.0, 0, 8.0)):
        batch = ju.plan_many(maps, pairs, altitude_m=20.0, budget_s=budget_s, file=file)
        assert counting.asked.pop() == num_asked
        assert batch[1].settings["budget_s"] == of_row
        assert batch[0].settings["budget_s"] == 5.0
    np.testing.assert_array_equal(batch[1].xy_m, whole[1].xy_m)


def test_a_resumed_batch_gives_the_routes_of_the_whole_one(maps, monkeypatch, tmp_path):
    free = np.argwhere(ju.Constraints().is_free(maps, 20.0))
    ends = np.random.default_rng(1).choice(len(free), (30, 2))
    ends[20:, 1] = ends[0, 1]  # of which ten share a goal, and the rest are enough for landmarks
    xy_m = np.stack([maps.grid.x_m[free[:, 1]], maps.grid.y_m[free[:, 0]]], axis=-1)
    columns = ["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]
    queries = pd.DataFrame(np.column_stack([xy_m[ends[:, 0]], xy_m[ends[:, 1]]]), columns=columns)
    given = {"altitude_m": 20.0, "objective": "distance"}  # under which many routes are as short
    whole = ju.plan_many(maps, queries, **given, num_threads=1)
    names = [path.search.heuristic for path in whole]
    assert names == ["exact"] + ["landmarks"] * 19 + ["exact"] * 10
    assert whole.facts["heuristics"] == "landmarks 19, exact 11"
    file = tmp_path / "answers.parquet"
    with monkeypatch.context() as patched:
        patched.setattr(many_module, "solve_many", Interrupting(14, KeyboardInterrupt()))
        ju.plan_many(maps, queries, **given, file=file)
    resumed = ju.plan_many(maps, queries, **given, file=file, num_threads=2)
    for path, other in zip(resumed, whole, strict=True):
        assert path.search.heuristic == other.search.heuristic
        np.testing.assert_allclose(path.xy_m, other.xy_m, rtol=0, atol=1e-6)


def test_a_file_with_other_results_is_left_alone(maps, pairs, tmp_path):
    file = tmp_path / "answers.parquet"
    ju.plan_many(maps, pairs, altitude_m=20.0, file=file)
    before = file.read_bytes()
    for options in ({"weights": ju.Weights(gps=3.0)}, {"planner": "ptp"}, {"altitude_m": 600.0}):
        with pytest.raises(InputError, match="results of other queries"):
            ju.plan_many(maps, pairs, **({"altitude_m": 20.0} | options), file=file)
        assert file.read_bytes() == before
    with pytest.raises(InputError, match="no results of these queries"):
        ju.plan_many(maps, pairs[:3], altitude_m=20.0, file=file)
    write_table(pd.DataFrame({"a": [1]}), file)
    with pytest.raises(InputError, match="holds no 'query'"):
        ju.plan_many(maps, pairs, altitude_m=20.0, file=file)
    file.write_text("no table")
    with pytest.raises(InputError, match="name another file"):
        ju.plan_many(maps, pairs, altitude_m=20.0, file=file)


def test_a_crash_is_a_row_and_strict_raises_it(maps, pairs, monkeypatch):
    def crash_one(problems, **options):
        for index, path in solve_many(problems, **options):
            yield index, ZeroDivisionError("by a bug") if index == 1 else path

    monkeypatch.setattr(many_module, "solve_many", crash_one)
    batch = ju.plan_many(maps, pairs, altitude_m=20.0)
    assert batch[1] is None
    assert batch.to_dataframe()["message"][1] == "ZeroDivisionError: by a bug"
    assert all(path.status is Status.OPTIMAL for k, path in enumerate(batch) if k != 1)
    with pytest.raises(ZeroDivisionError):
        ju.plan_many(maps, pairs, altitude_m=20.0, strict=True)


def test_the_file_is_rewritten_on_the_way(maps, pairs, monkeypatch, tmp_path):
    monkeypatch.setattr("jaxurban.io.tables.SAVE_EVERY_S", 0.0)
    monkeypatch.setattr("jaxurban.io.tables.SAVING_SHARE", np.inf)
    saved = []
    monkeypatch.setattr(RowStore, "save", lambda self, save=RowStore.save: (save(self), saved.append(len(self))))
    ju.plan_many(maps, pairs, altitude_m=20.0, file=tmp_path / "answers.parquet")
    assert saved == [1, 2, 3, 4, 5, 6, 6]


def test_an_empty_batch_is_an_empty_table(maps):
    batch = ju.plan_many(maps, [], altitude_m=20.0)
    assert len(batch) == 0
    assert batch.to_dataframe().empty
