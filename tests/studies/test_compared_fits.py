"""Fits compared: each judged by routes that it has not seen, and bad routes told from good ones."""

from dataclasses import replace

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.paths.plan import cost_map
from jaxurban.report.tuning import fits_section
from jaxurban.studies.demonstrations import Demonstration, optimal_demonstrations
from jaxurban.studies.tuning.compared_fits import compare_fits, split
from jaxurban.studies.tuning.confidence import draw_counts
from tests.studies.routes_made import HIDDEN, made_queries, small_maps

NUM = 16


def detour(query, rng):
    """Return the cheapest route by way of a random cell that makes it at most 1.6 times as far."""
    weights, free = HIDDEN.vector(query.names), np.argwhere(query.cost_map.is_free)
    by_way = sum(np.hypot(*(free - np.array(end)).T) for end in (query.start, query.goal))
    near = free[by_way <= 1.6 * np.hypot(*np.subtract(query.start, query.goal))]
    via = tuple(near[rng.integers(len(near))].tolist())
    first, second = replace(query, goal=via).cheapest(weights), replace(query, start=via).cheapest(weights)
    return Demonstration(query, np.concatenate([first, second[1:]]))


@pytest.fixture(scope="module")
def cities():
    """Two cities, a fifth of whose routes go by way of a random place."""
    rng = np.random.default_rng(0)
    made = {}
    for number, name in enumerate(("Aton", "Beton")):
        shown = optimal_demonstrations(
            made_queries(cost_map(small_maps(), 20.0, cost_model="cell"), NUM, seed=number), HIDDEN
        )
        for k in range(0, NUM, 5):
            shown[k] = detour(shown[k].query, rng)
        made[name] = shown
    return made


@pytest.fixture(scope="module")
def found(cities):
    return compare_fits(cities, bootstrap=20)


def cosine(one, other):
    return one @ other / np.linalg.norm(one) / np.linalg.norm(other)


def test_a_fit_finds_the_pilot_among_detours(found, cities):
    fits = found.table.set_index("fit")
    assert [*fits.index] == ["all", "only Aton", "only Beton"]
    shown = np.array([each.features for name in cities for each in cities[name]])
    spread = shown[~found.is_held_out].std(axis=0)
    best = found.fits["all"]
    assert cosine(best.vector * spread, HIDDEN.vector(best.names) * spread) > 0.999
    assert fits.held_out_regret["all"] < 1e-3


def test_every_detour_that_costs_much_is_told_as_bad_held_out_or_not(found, cities):
    shown = [each for name in cities for each in cities[name]]
    weights = HIDDEN.vector(shown[0].query.names)
    best = np.array([each.query.sums(each.query.cheapest(weights))[0] @ weights for each in shown])
    dearer = np.array([each.features @ weights for each in shown]) / best - 1
    is_detour = dearer > 0.02
    assert is_detour.sum() >= 6
    np.testing.assert_array_equal(found.is_bad, is_detour)
    assert found.is_held_out[is_detour].any()
    assert [*found.is_held_out.reshape(2, NUM).sum(axis=1)] == [NUM // 4] * 2


def test_regrets_are_those_of_a_search_of_ones_own(found, cities):
    weights = found.fits["only Aton"].vector
    shown = [each for name in cities for each in cities[name]]
    regret = [
        (each.features @ weights) / (each.query.sums(each.query.cheapest(weights))[0] @ weights) - 1 for each in shown
    ]
    good = found.is_held_out & ~found.is_bad
    assert found.table.held_out_regret[1] == pytest.approx(np.mean(np.array(regret)[good]), abs=1e-12)


def test_groups_stay_together_and_every_city_keeps_its_share():
    city, group = np.repeat(["a", "b"], [40, 20]), np.arange(60) // 2
    is_held_out = split(city, group, 0.25, seed=3)
    assert [is_held_out[city == name].sum() for name in "ab"] == [10, 4]
    assert np.all(is_held_out[::2] == is_held_out[1::2])
    assert np.any(is_held_out != split(city, group, 0.25, seed=4))
    assert not split(city, group, 0.0, seed=3).any()
    with pytest.raises(InputError, match="too few to hold some out"):
        split(np.array(["a"]), np.array([0]), 0.25, seed=0)


def test_draws_of_several_cities_take_whole_cities_and_of_one_its_members():
    rng = np.random.default_rng(0)
    counts = draw_counts(np.repeat([0, 1, 2], [5, 3, 4]), 400, rng)
    by_city = np.add.reduceat(counts, [0, 5, 8], axis=1) / [5, 3, 4]
    assert np.all(by_city == np.round(by_city))
    assert np.all(by_city.sum(axis=1) == 3)
    np.testing.assert_allclose(counts.mean(axis=0), 1, atol=0.3)
    assert np.all(draw_counts(np.zeros(7, int), 50, rng).sum(axis=1) == 7)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"hold_out": 1.0}, "hold_out must be a share"),
        ({"hold_out": 0.9}, "too few to hold some out"),
        ({"bootstrap": -1}, "bootstrap"),
    ],
)
def test_wrong_choices_are_one_sentence(cities, wrong, words):
    few = {name: shown[:4] for name, shown in cities.items()}
    with pytest.raises(InputError, match=words):
        compare_fits(few, **wrong)
    with pytest.raises(InputError, match="cities must be a dict of sequences of Demonstration"):
        compare_fits({"Aton": [5]})


def test_the_report_has_the_regret_of_each_fit_and_counts_the_routes_held_out_and_bad(found):
    text = fits_section(found)
    assert f"{NUM // 2} of {2 * NUM} routes were held out" in text
    assert f"{found.is_bad.sum()} of all routes are bad" in text
    for row in found.table.itertuples():
        assert f"| {row.fit} | {row.cities} | {row.num_fitted} | {row.held_out_regret:.3g} |" in text
