"""One's own cost layer goes through every study as the built-in metrics do, by its name, and its weight counts."""

import numpy as np
import pytest

import jaxurban as ju
from benchmarks.movingai import export_benchmark
from jaxurban.studies.demonstrations import optimal_demonstrations
from jaxurban.studies.montecarlo.trial import row_columns
from jaxurban.studies.queries import weights_from
from jaxurban.studies.route_pool import FitSettings
from jaxurban.studies.tuning.target import Target
from jaxurban.studies.tuning.target_fit import outcome_values
from tests.studies.routes_made import made_queries

NAMES = ("distance", "gps", "lidar", "population", "risk", "noise")
LOUD = ju.Weights(0.05, gps=0.2, lidar=0.2, population=0.2, risk=0.2, noise=5.0)


def test_its_weight_changes_the_route_of_plan_many_and_explain_agrees(noisy, ends):
    under = {"altitude_m": 20.0, "progress": False}
    loud, deaf = (
        ju.plan_many(noisy, [ends], weights=w, **under)[0] for w in (LOUD, LOUD.replace(noise=0.0))
    )
    assert loud.metrics["noise"] < deaf.metrics["noise"]
    assert ju.explain(loud, noisy).totals["cost"] == pytest.approx(loud.cost, rel=1e-9)


@pytest.mark.slow
def test_sensitivity_finds_the_breakpoints_of_its_weight(noisy, ends, tmp_path):
    how = ju.studies.SensitivitySettings(vary=("noise",))
    under = {"altitudes_m": [20.0], "weights": LOUD.replace(noise=1.0), "progress": False}
    found = ju.studies.sensitivity(noisy, tmp_path, [ends], settings=how, **under)
    assert found.route.names == NAMES
    assert len(found.route.breakpoints("noise")) > 1
    assert "| noise | " in (tmp_path / "report.md").read_text()


def test_a_benchmark_draws_its_weight_and_tells_its_mean_in_rows_report_and_export(noisy, tmp_path):
    settings = ju.studies.Study(planners=["astar-plus"], seed=3)
    found = ju.studies.study(noisy, tmp_path, 12, settings=settings, progress=False)
    shares = found.instances[[f"w_{name}" for name in NAMES]].to_numpy() * [5.0, 1, 1, 1, 1, 1]
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    assert list(found.rows) == list(row_columns(found.instances.columns))
    assert {*found.rows} == {*row_columns(), "m_noise"}
    assert found.rows.m_noise[found.rows.cost.notna()].between(0, 1).all()
    export_benchmark(
        noisy, found.instances, found.rows, tmp_path / "b", found.settings, "loud-city"
    )
    assert "`w_noise`" in (tmp_path / "b" / "README.md").read_text()
    with np.load(next((tmp_path / "b" / "costs").glob("*.npz"))) as kept:
        assert kept["names"].tolist() == list(NAMES[1:])


@pytest.mark.slow
def test_weights_are_fitted_to_it_and_other_layers_weigh_nothing_then(noisy):
    queries = made_queries(ju.cost_map(noisy, 20.0).only(("gps", "noise")), 4)
    shown = optimal_demonstrations(queries, LOUD)
    fit = ju.fit.fit_weights(shown, bootstrap=0, settings=FitSettings(max_rounds=1))
    assert fit.weights["noise"] > fit.weights["gps"] / 10
    assert fit.weights.to_dict().keys() == set(NAMES)
    assert fit.weights.risk == 0
    (deaf,) = made_queries(ju.cost_map(noisy, 20.0).only(("gps",)), 1)
    assert weights_from(deaf, np.ones(2))["noise"] == 0  # not 1, as a weight that nobody names
    sums = np.array([each.sums.ravel() for each in shown])
    targets = [Target.parse(text) for text in ("mean_noise<=0.2", "detour<=0.2")]
    expected = np.mean(sums[:, -1] / sums[:, 3]), 0.25
    assert outcome_values(sums, 0.8 * sums, queries[0].names, targets).tolist() == pytest.approx(
        expected
    )
