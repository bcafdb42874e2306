"""One's own cost layer goes through every study as the built-in metrics do, by its name, and its weight counts."""

import json

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.io.store import write_zarr
from jaxurban.metrics.custom import Layer
from jaxurban.paths.plan import cost_map
from jaxurban.report.benchmark import export_benchmark
from jaxurban.report.montecarlo import report_markdown, tables_of
from jaxurban.report.sensitivity import sensitivity_markdown
from jaxurban.studies.demonstrations import optimal_demonstrations
from jaxurban.studies.montecarlo.trial import row_columns
from jaxurban.studies.queries import weights_from
from jaxurban.studies.route_pool import FitSettings
from jaxurban.studies.tuning.target_fit import Target, outcome_values
from tests.cli_runs import assert_one_sentence, run
from tests.made_maps import made_maps
from tests.studies.routes_made import made_queries

NAMES = ("distance", "gps", "lidar", "population", "risk", "noise")
LOUD = ju.Weights(0.05, gps=0.2, lidar=0.2, population=0.2, risk=0.2, noise=5.0)
ENDS = ((4, 1), (28, 34))


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    """Small maps with a layer of noise: a loud stripe that the straight way crosses, and a gap in it."""
    made = made_maps(30, 36)
    loud = np.zeros(made.grid.shape, np.float32)
    loud[4:, 16:20] = 1.0
    made.ds["noise"] = (("y", "x"), loud, {"layer": json.dumps(Layer("noise.tif", "high-is-bad", (0.0, 80.0)).record)})
    return made


@pytest.fixture(scope="module")
def ends(maps) -> list[tuple[float, float]]:
    return [tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in ENDS]


def test_its_weight_changes_the_route_of_plan_many_and_explain_agrees(maps, ends):
    under = {"altitude_m": 20.0, "progress": False}
    loud, deaf = (ju.plan_many(maps, [ends], weights=w, **under)[0] for w in (LOUD, LOUD.replace(noise=0.0)))
    assert loud.metrics["noise"] < deaf.metrics["noise"]
    planned = ju.plan(maps, *ends, altitude_m=20.0, weights=LOUD)
    assert planned.cost == pytest.approx(loud.cost, rel=1e-12)
    assert ju.explain(planned, maps).totals["cost"] == pytest.approx(planned.cost, rel=1e-9)


def test_sensitivity_finds_the_breakpoints_of_its_weight(maps, ends, monkeypatch):
    monkeypatch.setattr("jaxurban.studies.weights.sobol.NUM_REPEATS", 2)
    how = ju.studies.SensitivitySettings(
        vary=("noise", "gps"), num_samples=4, objectives=("distance", "noise"), max_plans=20
    )
    found = ju.studies.sensitivity(ju.cost_map(maps, 20.0, weights=LOUD.replace(noise=1.0)), *ends, settings=how)
    assert found.names == NAMES
    assert len(found.breakpoints("noise")) > 1
    assert found.front.points["noise"].is_monotonic_decreasing != found.front.points["noise"].is_monotonic_increasing
    assert found.sobol.loc[("mean_noise", "noise"), "total"] > 0.1
    assert "| noise | " in sensitivity_markdown(found)


def test_a_benchmark_draws_its_weight_and_tells_its_mean_in_rows_report_and_export(maps, tmp_path):
    settings = ju.studies.Study(planners=["astar-plus"], seed=3)
    found = ju.studies.study(maps, tmp_path, 12, settings=settings, progress=False)
    shares = found.instances[[f"w_{name}" for name in NAMES]].to_numpy() * [5.0, 1, 1, 1, 1, 1]
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    assert list(found.rows) == list(row_columns(found.instances.columns))
    assert set(found.rows) - set(row_columns()) == {"m_noise"}
    assert found.rows.m_noise[found.rows.cost.notna()].between(0, 1).all()
    assert "m_noise" in report_markdown(found, tables_of(found))
    export_benchmark(maps, found.instances, found.rows, tmp_path / "b", found.settings, "loud-city")
    assert "`w_noise`" in (tmp_path / "b" / "README.md").read_text()
    with np.load(next((tmp_path / "b" / "costs").glob("*.npz"))) as kept:
        assert kept["names"].tolist() == list(NAMES[1:])
    for table, words in (
        (found.instances.drop(columns="w_noise"), "no weight 'w_noise'"),
        (found.instances.assign(w_nois=1.0), "or 'noise', got 'nois'"),
    ):
        with pytest.raises(InputError, match=words):
            ju.studies.study(maps, tmp_path / "other", table, settings=settings)


def test_weights_are_fitted_to_it_and_other_layers_weigh_nothing_then(maps):
    queries = made_queries(cost_map(maps, 20.0).only(("gps", "noise")), 4)
    shown = optimal_demonstrations(queries, LOUD)
    fit = ju.fit.fit_weights(shown, bootstrap=0, settings=FitSettings(max_rounds=1))
    assert fit.weights["noise"] > fit.weights["gps"] / 10
    assert fit.weights.to_dict().keys() == set(NAMES)
    assert fit.weights.risk == 0
    (deaf,) = made_queries(cost_map(maps, 20.0).only(("gps",)), 1)
    assert weights_from(deaf, np.ones(2))["noise"] == 0  # not 1, as a weight that nobody names
    sums = np.array([each.sums.ravel() for each in shown])
    target = Target.parse("mean_noise<=0.2")
    expected = np.mean(sums[:, -1] / sums[:, 3])
    assert float(outcome_values(sums, sums, queries[0].names, [target])[0]) == pytest.approx(expected)
    with pytest.raises(InputError, match="did you mean 'mean_noise'"):
        ju.fit.fit_targets(queries, [Target("mean_nois", "<=", 0.2)])


def test_commands_take_its_name(maps, ends, tmp_path, capsys):
    write_zarr(maps.ds, tmp_path / "maps")
    places = [f"--{name}={lon},{lat}" for name, (lon, lat) in zip(("start", "goal"), ends, strict=True)]
    where = (tmp_path / "maps", *places, "--altitude", 20, "--weights", "noise=2", "-o", tmp_path / "out")
    code, _, err = run(capsys, "sensitivity", *where, "--vary", "noise,nois")
    assert code == 2
    assert_one_sentence(err, "or 'noise', got 'nois'")
