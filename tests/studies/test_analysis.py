"""Tables of a study on rows made up so that every number can be worked out by hand, and their bootstrap intervals."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

import jaxurban as ju
from jaxurban.paths.queries import IN_METRES
from jaxurban.statistics.bootstrap import (
    FEWEST_GROUPS,
    Clusters,
    draws_of,
    median_of,
)
from jaxurban.studies.figures.montecarlo import plot_costs
from jaxurban.studies.montecarlo import analysis
from jaxurban.studies.montecarlo.trial import row_columns
from tests.made_maps import made_maps

CHEAP, DEAR, LINE = "astar-plus", "bitstar-dist", "ptp"


def row(
    instance: int, planner: str, cost: float | None, *, objective="weighted", status="", **facts
) -> dict:
    told = {
        "status": status or ("feasible" if cost else "blocked"),
        "cost": cost,
        "elapsed_s": 0.1,
        "length_m": 100.0,
    }
    told |= {
        "planner": planner,
        "objective": objective,
        "m_gps": 0.5,
        "m_risk": 0.5,
        "num_expanded": 1,
    }
    return dict.fromkeys(row_columns()) | {"altitude_m": 20.0, "instance": instance} | told | facts


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    rows = []
    for k in range(10):
        rows += [
            row(k, CHEAP, 10.0, status="optimal", elapsed_s=1.0),
            row(k, DEAR, 12.0 if k else None, gap=0.5 if k < 4 else np.inf),
        ]
        rows += [row(k, LINE, 10.2 if k < 4 else None, elapsed_s=0.001)]
        rows += [row(k, CHEAP, 15.0, objective="distance", length_m=80.0, m_gps=0.25)]
    rows += [row(10, name, None, status="no-path") for name in (CHEAP, DEAR, LINE)]
    rows += [row(11, CHEAP, None, status="crashed"), row(11, DEAR, 7.0), row(11, LINE, None)]
    instances = pd.DataFrame(
        {"instance": range(12), "altitude_m": 20.0, "range": ["short"] * 6 + ["long"] * 6}
    )
    return analysis.with_instances(pd.DataFrame(rows), instances)


def test_a_pair_is_joined_unless_no_path_was_proven_and_ratios_are_to_the_cheapest_of_any_planner(
    table,
):
    assert set(table[~table.is_joined].instance) == {10}
    first = (
        table[(table.instance == 1) & (table.objective == "weighted")].set_index("planner").ratio
    )
    assert first.to_dict() == pytest.approx({CHEAP: 1.0, DEAR: 1.2, LINE: 1.02})
    assert table[table.status == "blocked"].ratio.isna().all()


def test_a_path_that_costs_nothing_is_the_best():
    rows = pd.DataFrame([row(0, CHEAP, 0.0, status="optimal"), row(0, DEAR, 1.0)])
    instances = pd.DataFrame({"instance": [0], "altitude_m": 20.0})
    found = analysis.with_instances(rows, instances)
    assert found.ratio[0] == 1.0
    assert np.isnan(found.ratio[1])
    assert (found.range == "any").all()


def test_success_counts_paths_pairs_and_crashes(table):
    found = analysis.success(table).set_index(["planner", "range"])
    cheap = found.loc[(CHEAP, "long")]
    assert (cheap.pairs, cheap.paths, cheap.joined, cheap.crashed) == (6, 4, 5, 1)
    shares = cheap.solved, cheap.proven, found.loc[(LINE, "short")].solved
    assert shares == pytest.approx((100 * 4 / 5, 100 * 4 / 6, 100 * 4 / 6))
    gaps = found.gap[DEAR]
    assert gaps["short"] == 50  # of those that have a bound above 0, on which alone a gap is known
    assert np.isnan(gaps["long"])


ALL_OF = {"short": [], "long": [], "all": ["short", "long"]}


def test_success_counts_pairs_without_a_path_by_their_reason(table):
    found = analysis.success(table).set_index(["planner", "range"])
    rows = analysis.weighted_rows(table)
    reasons = {"no_way": "no-path", "blocked": "blocked", "budget": "budget-empty"}
    for (planner, distance), row in found.iterrows():
        of_it = rows[(rows.planner == planner) & rows["range"].isin([distance, *ALL_OF[distance]])]
        assert row.pairs == len(of_it)
        for name, status in reasons.items():
            assert row[name] == (of_it.status == status).sum()
    assert found.loc[LINE].blocked.sum() > 0


def test_costs_above_the_cheapest_known_are_quantiles_in_percent(table):
    found = analysis.costs(table).set_index("planner")
    more = {CHEAP: 0.0, DEAR: 20.0, LINE: 2.0}
    for planner, percent in more.items():
        row = found.loc[planner]
        assert row.above_median == pytest.approx(percent)
        assert row.above_most >= row.above_p95 >= row.above_median
    assert found.cheapest[CHEAP] == 100
    assert found.cheapest[LINE] < 100


def test_the_curve_of_costs_ends_at_the_share_that_the_planner_solved():
    ratios = {CHEAP: [1.0, 1.0], DEAR: [1.0, 1.3]}
    rows = [(name, 20.0, ratio) for name, values in ratios.items() for ratio in values]
    figure = plot_costs(pd.DataFrame(rows, columns=["planner", "altitude_m", "ratio"]))
    panel = figure.axes[0]
    assert [line.get_ydata()[-1] for line in panel.lines] == [1.0, 1.0]
    assert panel.get_xlim()[1] > 1.3


def test_times_are_by_planner_and_altitude(table):
    time = analysis.times(table).set_index("planner")
    assert time.loc[CHEAP, "runs"] == 10  # those that found a path
    assert time.loc[LINE, "p95_s"] == 0.001  # and not that of refusing a pair


def test_planners_are_ranked_by_cost_where_all_found_a_path_and_by_the_pairs_that_they_solved(
    table,
):
    """The straight line solves 4 of 11 joined pairs, too few to be ranked by cost with the others."""
    of_cost, of_pairs, of_line = analysis.rankings(table).values()
    (pair,) = of_cost.pairs[of_cost.pairs.second == DEAR].query("first == @CHEAP").itertuples()
    assert (pair.n, pair.needed) == (9, 0)
    assert pair.size == pair.low == pair.high == pytest.approx(20)  # every pair says the same
    assert of_cost.table.set_index("name")["rank"].to_dict() == {CHEAP: 1, DEAR: 2}
    assert of_line.measure == "cost where all find a path"
    assert set(of_line.table.n.dropna()) == {3}
    assert of_line.table.behind[LINE] == pytest.approx(2)
    solved = of_pairs.pairs.set_index(["first", "second"])
    assert solved.loc[(CHEAP, LINE)].size == 5
    assert solved.loc[(CHEAP, LINE), "size"] == pytest.approx(100 * 6 / 11)
    place = dict.fromkeys(IN_METRES, 5.0) | {"altitude_m": 20.0, "instance": 1, "w_distance": 0.1}
    given = pd.DataFrame([place]), made_maps(10, 10), "jaxurban study city.toml -o DIR", "WIDER"
    decided = analysis.conclusion(table.assign(at_edge=0.0), *given)
    assert decided.facts["next"].startswith(
        "jaxurban study city.toml -o DIR --set study.instances="
    )
    assert f"{DEAR} costs 20.0 % (20.0 to 20.0) more than {CHEAP}" in decided.facts["decided"]
    fails = f"{LINE} finds no path for 64 % (30 to 90) of the joined pairs (11 joined instances)"
    assert decided.facts["decided"].startswith(fails)
    only_line = table[table.planner == LINE]
    assert analysis.failing(only_line[only_line.instance > 3]) == []  # nothing else to rank
    undecided = decided.facts["not decided"]
    assert f"{CHEAP} and {DEAR} cannot be told apart in pairs solved" in undecided
    assert f"({DEAR} finds a path for 0 percentage points (" in undecided
    assert f") fewer than {CHEAP}, " in undecided


def test_of_one_planner_there_is_nothing_to_compare(table):
    lost = {
        "altitude_m": 20.0,
        "instance": 10,
        "w_distance": 0.1,
        "w_gps": 2.0,
    }  # that no path joins
    maps = made_maps(40, 40)
    places = [
        lost | dict.fromkeys(IN_METRES, 5.0),
        lost | dict.fromkeys(IN_METRES, 15.0) | {"instance": 1},
    ]
    is_alone = (table.planner == CHEAP) & (table.objective == "weighted")
    alone = table[is_alone].assign(at_edge=0.0)
    given = pd.DataFrame(places), maps, "", ""
    lines = analysis.conclusion(alone, *given).facts
    assert lines["not decided"] == (f"there is nothing to compare, as {CHEAP} is the only planner.")
    assert lines["next"].startswith("jaxurban plan ")
    assert "--weights distance=0.1,gps=2,lidar=1,population=1,risk=1" in lines["next"]
    bounded = analysis.conclusion(alone, *given, "--require 'gps>=0.1' ").facts["next"]
    assert "--require 'gps>=0.1' --planner" in bounded
    empty = ju.MetricMaps(maps.ds.drop_vars(["population", "density"]))
    without = analysis.conclusion(alone, given[0], empty, "", "").facts["next"]
    assert without.endswith("--weights distance=0.1,gps=2,lidar=1,risk=1")  # what they hold
    first, second = (
        analysis.conclusion(alone, pd.DataFrame([place]), maps, "", "").facts["next"]
        for place in places
    )
    assert lines["next"] == second != first
    at_edge = analysis.conclusion(
        alone.assign(at_edge=1.0), given[0], maps, "", "wider --instances F"
    )
    assert at_edge.next_command.startswith('wider --instances F --set "region.bounds=[')


def test_shortest_paths_are_set_against_the_cheapest(table):
    (found,) = analysis.objectives(table).to_dict("records")
    assert (found["planner"], found["pairs"]) == (CHEAP, 10)
    changes = [found[f"{name}_change"] for name in ("cost", "length_m", "m_gps")]
    assert changes == pytest.approx([50, -20, -0.25])  # percent, metres, m
    assert "m_lidar_change" not in found
    is_shortest = table.objective == "distance"
    for other, num in (("astar-dist", 1), (DEAR, 0)):  # which A* ran is no matter
        by_other = table.assign(planner=table.planner.mask(is_shortest, other))
        of_both = analysis.objectives(by_other).query("planner == @CHEAP").to_dict("records")
        assert of_both == [found] * num
    lost = table.assign(has_path=table.has_path & is_shortest)
    assert analysis.objectives(lost).empty

    # No path of a grid costs less than its cheapest one or is shorter than its shortest one, whatever it scatters.
    scattered = table.assign(cost=table.cost.mask(is_shortest & (table.instance > 1), 10.0))
    scattered["length_m"] = table.length_m.mask(is_shortest & (table.instance > 1), 100.0)
    (row,) = analysis.objectives(scattered).to_dict("records")
    assert row["cost_change_low"] == row["length_m_change_high"] == 0
    assert row["m_gps_change_high"] < 0
    by_samples = scattered[scattered.planner == CHEAP].assign(planner=DEAR)
    (row,) = analysis.objectives(by_samples).to_dict("records")
    assert row["cost_change_low"] < 0 < row["length_m_change_high"]


def test_cheapest_paths_are_set_beside_the_baseline_of_distance_alone(table):
    """Costs of 10 and 15 over 100 m and 80 m at 0.05 a metre: 5 of exposure beside 11, 54.5 % less, for 20 m of way."""
    instances = pd.DataFrame({"instance": range(12), "altitude_m": 20.0, "w_distance": 0.05})
    (verdict,) = analysis.beside_baseline(table, instances)
    assert verdict.is_decided
    assert (verdict.n, verdict.low, verdict.size) == pytest.approx((10, 600 / 11, 600 / 11))
    assert "have 54.5 % (54.5 to 54.5) less exposure" in verdict.sentence
    own = "distance alone, the baseline (mean of each route's own share, 10 instances"
    assert own in verdict.sentence
    assert "flown more, on average: 20.0 m of way (20.0 to 20.0)" in verdict.sentence
    (few,) = analysis.beside_baseline(table[table.instance < 5], instances)
    assert not few.is_decided
    assert few.sentence.startswith("whether routes under these weights have less exposure")
    weighted = table[table.objective == "weighted"]
    assert analysis.beside_baseline(weighted, instances) == []
    by_other = table.assign(planner=table.planner.mask(table.objective == "distance", "astar-dist"))
    assert analysis.beside_baseline(by_other, instances)[0].sentence == verdict.sentence
    of_line = table.assign(planner=LINE)  # whose straight segments are no paths of the grid
    assert analysis.beside_baseline(of_line, instances) == []


def test_the_interval_of_independent_values_is_that_of_the_normal_law():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    found = Clusters(np.arange(400)).interval(values)
    half = 1.96 * values.std() / 20
    assert found.value == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_repeats_within_a_group_add_nothing():
    values = np.random.default_rng(1).normal(size=100)
    once = Clusters(np.arange(100)).interval(values)
    thrice = Clusters(np.repeat(np.arange(100), 3)).interval(np.repeat(values, 3))
    assert thrice == pytest.approx(once)


def test_draws_within_cities_leave_the_differences_of_cities_out_and_draws_of_cities_contain_them():
    rng = np.random.default_rng(2)
    num_cities, num_groups = 40, 50
    levels, cities = rng.normal(0, 3.0, num_cities), np.repeat(np.arange(num_cities), num_groups)
    values, groups = (
        levels[cities] + rng.normal(0, 1.0, cities.size),
        np.tile(np.arange(num_groups), num_cities),
    )
    within, over = Clusters(groups, cities).interval(values), Clusters(cities).interval(values)
    residual = (
        values - np.array([values[cities == city].mean() for city in range(num_cities)])[cities]
    )
    half = 1.96 * residual.std() / np.sqrt(cities.size - num_cities)
    assert (within.high - within.low) / 2 == pytest.approx(half, rel=0.1)
    of_means = [values[cities == city].mean() for city in range(num_cities)]
    assert (over.high - over.low) / 2 == pytest.approx(
        2.02 * np.std(of_means, ddof=1) / np.sqrt(num_cities), rel=0.1
    )


def test_every_draw_within_cities_holds_each_city_as_often_as_it_is_there():
    cities, group = np.repeat(["a", "b"], [6, 10]), np.repeat(np.arange(8), 2)
    clusters = Clusters(group, cities)
    np.testing.assert_allclose(clusters.drawn((cities == "a").astype(float)), 6 / 16)
    noise = np.random.default_rng(5).normal(size=8)[group]
    signs = np.tile([1.0, -1.0], 8)
    np.testing.assert_allclose(
        clusters.drawn(noise * signs), 0, atol=1e-12
    )  # both of a group are drawn together


def test_medians_and_means_of_drawn_values_are_those_of_the_values_repeated():
    rng = np.random.default_rng(3)
    values, counts = rng.normal(size=15), rng.integers(0, 4, (20, 15))
    expected = [np.quantile(np.repeat(values, each), 0.5, method="inverted_cdf") for each in counts]
    np.testing.assert_allclose(median_of(values, counts), expected, rtol=1e-12)
    drawn = [np.repeat(values, each).mean() for each in draws_of(15, [0, 0])]
    np.testing.assert_allclose(Clusters(np.arange(15)).drawn(values), drawn, rtol=1e-12)


def test_a_share_of_none_is_bounded_where_as_many_would_be_none_once_in_twenty_times():
    values, groups = np.zeros(60), np.arange(60)
    found = Clusters(groups).interval(values, "share")
    assert found[:2] == (0.0, 0.0)
    assert binom.pmf(0, 60, found.high) == pytest.approx(0.05)
    full = Clusters(groups).interval(values + 1, "share")
    assert full.value == full.high == 1.0
    assert full.low == pytest.approx(1 - found.high)


def test_no_values_and_those_of_few_pairs_have_no_interval_however_many_pairs_a_table_has():
    """Of 60 pairs the values of 7 are known; with 8 there is an interval."""
    assert np.isnan(Clusters(np.empty(0)).interval(np.empty(0))).all()
    pair, rng = np.arange(60), np.random.default_rng(15)
    drawn, values = Clusters(pair), pd.Series(rng.normal(size=60))
    for num, is_known in ((FEWEST_GROUPS - 1, False), (FEWEST_GROUPS, True)):
        assert np.isfinite(drawn.interval(values.where(pair < num)).low) == is_known
        assert (
            np.isfinite(drawn.interval((values > 0).astype(float).where(pair < num), "share").low)
            == is_known
        )


def independent(num, statistic, truth, draw):
    """Return what draws as many values as groups, and gives their interval and the truth."""
    clusters = Clusters(np.arange(num))
    return lambda rng: (clusters.interval(draw(rng, num), statistic), truth)


def uneven(num):
    """Groups of 1 to 12 values that are alike within a group."""

    def drawn(rng):
        groups = np.repeat(np.arange(num), rng.integers(1, 13, num))
        return Clusters(groups).interval(
            rng.normal(size=num)[groups] + rng.normal(size=groups.size)
        ), 0.0

    return drawn


def of_cities(num):
    """Means over pairs of places at two altitudes in three cities that differ; each more costs a degree of freedom."""
    pair = np.repeat(np.arange(2 * (num + 2)), 2)
    level, is_in = (pair % 3).astype(float), pair % 2 == 0
    part = Clusters(pair[is_in], np.array(["a", "b", "c"])[pair % 3][is_in])
    assert part.num_groups == num

    def drawn(rng):
        values = level + rng.normal(size=2 * (num + 2))[pair] + 0.5 * rng.normal(size=pair.size)
        return part.interval(values[is_in]), level[is_in].mean()

    return drawn


def of_routes_and_heights(num):
    route, draw = (part.ravel() for part in np.indices((12, num)))
    clusters = Clusters(route).crossed(Clusters(draw, seed=1))

    def drawn(rng):
        values = (
            rng.normal(size=12)[route] + rng.normal(size=num)[draw] + rng.normal(size=route.size)
        )
        return clusters.interval(values), 0.0

    return drawn


SEEDS = {"of cities": 13, "of routes and heights": 14}
MADE = {
    "normal": lambda num: independent(num, "mean", 0.0, lambda rng, num: rng.normal(size=num)),
    "skewed": lambda num: independent(
        num, "mean", np.exp(0.25**2 / 2), lambda rng, num: rng.lognormal(0, 0.25, num)
    ),
    "exponential": lambda num: independent(
        num, "mean", 1.0, lambda rng, num: rng.exponential(size=num)
    ),
    "median": lambda num: independent(num, "median", 0.0, lambda rng, num: rng.normal(size=num)),
    "share": lambda num: independent(
        num, "share", 0.3, lambda rng, num: (rng.random(num) < 0.3).astype(float)
    ),
    "uneven": uneven,
    "of cities": of_cities,
    "of routes and heights": of_routes_and_heights,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "num_groups"),
    [*itertools.product([*MADE][:-1], (FEWEST_GROUPS, 15, 30)), ([*MADE][-1], FEWEST_GROUPS)],
)
def test_intervals_contain_the_truth_in_93_of_100_cases_and_less_often_where_values_are_skewed(
    made, num_groups
):
    rng, drawn, inside = np.random.default_rng(SEEDS.get(made, 11)), MADE[made](num_groups), 0
    for _ in range(2000):
        interval, truth = drawn(rng)
        inside += interval.low <= truth <= interval.high
    assert inside >= (0.91 if made == "exponential" else 0.93) * 2000, inside / 2000
