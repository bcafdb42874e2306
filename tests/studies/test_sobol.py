"""Sobol indices against the known ones of the Ishigami function, and of weights."""

import numpy as np
import pytest

import jaxurban as ju
from jaxurban.errors import InputError
from jaxurban.paths.plan import cost_map
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.sobol import FEW_SAMPLES, check_vary, sobol_indices, sobol_of_weights
from tests.made_maps import made_maps

GIVEN = np.array([0.1, 1.0, 1.0, 1.0, 1.0])
NAMES = ("x1", "x2", "x3")


@pytest.fixture(scope="module")
def queries() -> list[RouteQuery]:
    unit = cost_map(made_maps(30, 36), 20.0, cost_model="line")
    return [RouteQuery(unit, (4, 1), (28, 34)), RouteQuery(unit, (4, 34), (28, 1))]


A, B, PI = 7.0, 0.1, np.pi
# Parts of the variance in closed form (Ishigami and Homma, ISUMA 1990).
ONE, TWO, BOTH = 0.5 * (1 + B * PI**4 / 5) ** 2, A**2 / 8, B**2 * PI**8 * (1 / 18 - 1 / 50)
KNOWN = {
    kind: np.array(parts) / (ONE + TWO + BOTH)
    for kind, parts in (("first", (ONE, TWO, 0)), ("total", (ONE + BOTH, TWO, BOTH)))
}


def ishigami(num_samples: int, seed: int):
    def evaluate(unit):
        x = PI * (2 * unit - 1)
        return {"y": np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])}

    return sobol_indices(evaluate, NAMES, num_samples, seed).loc["y"]


def test_indices_of_the_ishigami_function_are_the_known_ones():
    table = ishigami(1024, 0)
    for kind, known in KNOWN.items():
        off = np.abs(table[kind].to_numpy() - known)
        assert np.all(off < 0.03), (kind, off)
        assert np.all(off < table[f"{kind}_ci"])
        assert np.all(table[f"{kind}_ci"] < 0.1)


@pytest.mark.slow
def test_intervals_from_the_fewest_samples_contain_the_known_indices_in_93_of_100_cases(monkeypatch):
    monkeypatch.setattr("jaxurban.studies.weights.sobol.NUM_RESAMPLES", 200)
    inside = np.zeros((2, 3))
    for seed in range(2000):
        table = ishigami(FEW_SAMPLES, seed)
        inside += [np.abs(table[kind] - known) <= table[f"{kind}_ci"] for kind, known in KNOWN.items()]
    assert (inside >= 0.93 * 2000).all(), inside / 2000


def test_a_product_of_log_uniform_factors_has_equal_first_order_indices_in_its_logarithm():
    found = sobol_indices(lambda x: {"y": np.log(0.1 * 100 ** x[:, 0] * 100 ** x[:, 1])}, NAMES[:2], 128)
    np.testing.assert_allclose(found["first"], 0.5, atol=0.05)
    assert found["mean"].to_numpy() == pytest.approx(np.log(10), abs=0.05)


def test_an_outcome_that_does_not_vary_has_no_indices():
    found = sobol_indices(lambda x: {"y": np.ones(len(x))}, NAMES[:2], 4)
    assert found[["first", "first_ci", "total", "total_ci"]].isna().all().all()


def test_the_same_seed_gives_the_same_indices_and_intervals():
    def once():
        return sobol_indices(lambda x: {"y": x[:, 0] * x[:, 1]}, NAMES[:2], 8)

    assert once().equals(once())


def test_indices_of_weights_come_with_intervals_and_take_n_times_factors_plus_2_plans(queries):
    pool = RoutePool(queries)
    told: list[int] = []
    found = sobol_of_weights(pool, GIVEN, [3, 4], (0.1, 10.0), 16, on_plans=told.append)
    assert pool.num_plans == told[-1] == 2 * 16 * 4
    assert list(found.loc["people"].index) == ["population", "risk"]
    assert np.isfinite(found.loc["people"]).all().all()
    assert (found["lowest"] <= found["highest"]).all()


@pytest.mark.parametrize(
    ("vary", "word"), [(("rsk",), "did you mean 'risk'"), ((), "nothing varies"), (("gps",), "weight gps is 0")]
)
def test_weights_that_cannot_vary_are_refused(queries, vary, word):
    with pytest.raises(InputError, match=word):
        check_vary(queries[0].names, np.array([0.1, 0.0, 1.0, 1.0, 1.0]), vary)


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"factors": (2.0, 3.0)}, "from below 1 to above 1"),
        ({"num_samples": 12}, "power of two"),
        ({"vary": ("gps", "gps")}, "each weight once"),
    ],
)
def test_wrong_settings_are_refused_by_both_studies(wrong, word):
    for settings in (ju.studies.SensitivitySettings, ju.studies.SensitivityStudySettings):
        with pytest.raises(InputError, match=word):
            settings(**wrong)
