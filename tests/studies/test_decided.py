"""What studies decide, where the answer is known: few seeds of the cases of `benchmarks.decisions`."""

import json
import math
from enum import Enum

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from benchmarks.decisions import border_outcome, open_map, random_case
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, Clusters
from jaxurban.statistics.conclusions import (
    Conclusion,
    SharedVerdict,
    Verdict,
    concluded,
    runs_needed,
    sized,
)
from jaxurban.studies.decided import (
    Measure,
    border_verdict,
    edge_band,
    effects,
    ended_sides,
    is_at_edge,
    ranked,
    sides_at_edge,
    wider_bounds,
)

NUM = 60


class Kind(Enum):
    MORE = "{last} costs {size} more than {first} ({n})"


def ranking_of(num: int = NUM, **columns):
    """Return the ranks of alternatives by what each costs of a common cost, with 2 % of noise for each run."""
    rng = np.random.default_rng(3)
    cost = rng.lognormal(4.0, 0.8, num)
    values = {name: cost * factor for name, factor in columns.items()}
    values = {name: cost * np.exp(rng.normal(0, 0.02, num)) for name, cost in values.items()}
    values["twin"] = values["good"] * (1 + 1e-12)
    measure = Measure(pd.DataFrame(values), is_ratio=True)
    return ranked({"cost": measure}, Clusters(np.arange(num)))["cost"]


def test_what_is_equal_is_one_and_what_is_worse_is_behind_and_ties_share_a_rank():
    ranking = ranking_of(good=1.0, bad=1.1, worse=1.1)
    assert ranking.equal == (("good", "twin"),)
    assert ranking.table.set_index("name")["rank"].to_dict() == {
        "good = twin": 1,
        "bad": 2,
        "worse": 2,
    }
    verdicts = ranking.verdicts(Kind.MORE, "routes")
    assert [each.kind.name for each in verdicts] == ["MORE", "MORE", "TIED", "EQUAL"]
    for verdict in verdicts[:2]:
        assert verdict.is_decided
        assert verdict.low < 10 < verdict.high
        assert verdict.size == pytest.approx(10, abs=2)
    tied, equal = verdicts[2:]
    assert {*tied.what} == {"bad", "worse"}
    assert NUM < tied.needed < math.inf
    assert (equal.what, equal.size, equal.needed) == (("good", "twin"), 0.0, math.inf)
    most = 100 * (
        1 - 0.05 ** (1 / equal.n)
    )  # by which none of so many differs once in twenty times
    differ = f"; of all such routes at most {most:.0f} % differ"
    assert equal.sentence.endswith(differ)
    none = Verdict(Kind.MORE, ("a", "b"), 0.0, 0.0, 0.0, equal.n, needed=math.inf)
    assert none.sentence.endswith(differ)  # 0 on all
    scattered = Verdict(Kind.MORE, ("a", "b"), 0.0, -1.0, 1.0, equal.n, needed=math.inf)
    assert scattered.sentence.endswith("; no number of routes would change that")


def test_what_is_equal_on_few_common_runs_is_said_of_these_alone():
    costs = pd.DataFrame({name: [2.0, *[np.nan] * 19] for name in ("good", "twin")})
    ranking = ranked({"cost": Measure(costs, is_ratio=True)}, Clusters(np.arange(20)))["cost"]
    (equal,) = ranking.verdicts(Kind.MORE, "routes")
    assert equal.n == 1
    assert "at most" not in equal.sentence
    assert not equal.is_decided


def test_of_fewer_runs_than_have_an_interval_nothing_is_decided():
    verdicts = ranking_of(num=FEWEST_GROUPS - 1, good=1.0, bad=2.0).verdicts(Kind.MORE, "routes")
    assert not any(each.is_decided for each in verdicts)
    assert {each.needed for each in verdicts} == {FEWEST_GROUPS}


def test_as_many_runs_as_are_said_to_be_needed_decide_a_planner_better_by_one_percent():
    rng = np.random.default_rng(0)
    half = 0.02 * 1.96 / math.sqrt(12)
    num = int(runs_needed(0.01, 0.01 - half, 0.01 + half, 12))
    assert 40 <= num <= 44
    decided = [
        effects(rng.normal(0.01, 0.02, (num, 1)), Clusters(np.arange(num))).needed[0] == 0
        for _ in range(40)
    ]
    assert np.mean(decided) >= 0.8


@pytest.mark.parametrize(
    ("size", "low", "high", "needed"),
    [
        (0.0, 0.0, 0.0, math.inf),
        (1.0, 0.5, 1.5, 0.0),
        (1e-9, -1.0, 1.0, math.inf),
        (1.0, np.nan, np.nan, 21),
        (1.0, -1.0, 3.0, 220.0),
    ],
)
def test_runs_needed(size, low, high, needed):
    assert runs_needed(size, low, high, 20) == needed


def test_intervals_of_many_effects_hold_at_once():
    """Of 15 effects of 0 one interval of 95 % excludes 0 in half of the studies; all at once in one of twenty."""
    rng = np.random.default_rng(1)
    wrong = [
        (effects(rng.normal(size=(30, 15)), Clusters(np.arange(30))).needed == 0).any()
        for _ in range(60)
    ]
    assert np.mean(wrong) <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_random_cases_with_a_known_answer_are_not_decided_wrongly(seed):
    case = random_case(seed)
    num = case.stated_runs()
    outcomes = [case.outcome(np.random.default_rng(k), num) for k in range(12)]
    wrong, decided = np.sum(outcomes, axis=0)
    assert wrong <= 2
    assert decided >= 8


@pytest.mark.slow
def test_the_route_that_the_border_pins_is_counted_and_no_other():
    assert [border_outcome(seed) for seed in range(3)] == [(False, True)] * 3


def test_a_route_is_at_the_border_away_from_its_ends_alone():
    maps = open_map({"gps": np.ones((30, 40))})
    band = edge_band(maps)
    assert band.sum() == 30 * 40 - 24 * 34
    for row, is_pinned in ((15, False), (29, True)):  # from one side of the maps to the other
        line = np.array([[5.0, 155], [205, 10 * row + 5], [395, 155]])
        assert is_at_edge(line, maps.grid, band) == is_pinned
    maps.ds["has_data"][:, 20:] = False
    assert edge_band(maps)[10, 17:].all()


def test_one_route_is_called_so():
    (verdict,) = border_verdict(np.array([True]))
    assert verdict.sentence.startswith("the route comes within 3 cells of the border")
    one = Verdict(Kind.MORE, ("a", "b"), 1.3, n=1, noun="pairs of ends")
    assert one.sentence.endswith("(1 pair of ends)")


def test_the_border_is_not_decided_by_more_routes():
    (verdict,) = border_verdict(np.array([True, False, False]))
    assert verdict.sentence.startswith("1 of 3 routes comes within 3 cells of the border")
    assert not verdict.is_decided
    assert border_verdict(np.zeros(3, bool)) == []
    for wider, command in (
        ("wider", "wider"),
        ("", "done"),
    ):  # no wider maps where their source ends
        conclusion = concluded([verdict], more="{needed} more", done="done", wider=wider)
        assert conclusion.next_command == command


def test_wider_bounds_end_where_the_source_of_the_buildings_does():
    """Of 400 x 300 m a quarter is 100 m and 75 m; degrees of five digits are some 1 m."""
    maps = open_map({"gps": np.ones((30, 40))})
    west, south, east, north = maps.grid.bounds_m
    far = 1e4
    for known_m, wanted_m in (
        ((-far, -far, far, far), (-100, -75, 100, 75)),
        ((-50, -far, 0, 60), (-50, -75, 0, 60)),
        ((40, 40, -40, far), (0, 0, 0, 75)),
    ):
        known = np.add((west, south, east, north), known_m)
        inside = ju.MetricMaps(maps.ds.assign_attrs(known_bounds_m=known.tolist()))
        lonlat = np.reshape(json.loads(wider_bounds(inside)), (2, 2))
        wanted = np.add((west, south, east, north), wanted_m)
        assert np.ravel(maps.grid.xy_at(lonlat)) == pytest.approx(wanted, abs=1)
    nowhere = ju.MetricMaps(maps.ds.assign_attrs(known_bounds_m=[west, south, east, north + 20]))
    assert wider_bounds(nowhere) == ""
    quarter = np.reshape(json.loads(wider_bounds(maps)), (2, 2))  # maps that do not say
    assert np.ptp(maps.grid.xy_at(quarter), axis=0) == pytest.approx((600, 450), abs=20)


def test_the_border_is_named_by_its_sides_and_a_source_that_ends_there_asks_for_a_wider_one():
    """The source ends with the maps in the north alone."""
    maps = open_map({"gps": np.ones((30, 40))})
    west, south, east, north = maps.grid.bounds_m
    known_m = [west - 1e4, south - 1e4, east + 1e4, north]
    inside = ju.MetricMaps(maps.ds.assign_attrs(known_bounds_m=known_m))
    assert ended_sides(inside) == ["north"]
    assert ended_sides(maps) == []
    along_north = np.array([[5.0, 155], [205, 295], [395, 155]])
    assert sides_at_edge(along_north, inside) == ["north"]
    assert wider_bounds(inside, ["north"]) == ""
    assert wider_bounds(inside, ["north", "east"]) == wider_bounds(inside) != ""

    def sentence(*sides: str) -> str:
        (verdict,) = border_verdict(np.array([True]), sides=sides, ended=ended_sides(inside))
        return verdict.sentence

    assert "data in the north, away from the ends" in sentence("north")
    assert sentence("east").endswith("more routes, but by maps of wider bounds")
    partly = "wider bounds, and in the north, where their source ends, by a wider source"
    assert all(sentence(*sides).endswith(partly) for sides in (["north"], ["east", "north"], []))


def test_a_conclusion_has_three_lines_and_plain_records():
    known = Verdict(Kind.MORE, ("a", "b"), 1.312, 0.92, 1.7, 40, "%")
    unknown = Verdict(SharedVerdict.TIED, ("c", "d"), 1.0, -1, 3, 40, "m", needed=120.0)
    facts = {"measure": "length"}
    unknown = Verdict(**{**vars(unknown), "facts": facts})
    conclusion = concluded([known, unknown], more="run {needed}", done="done", factor=4)
    assert conclusion.facts == {
        "decided": "b costs 1.31 % (0.92 to 1.70) more than a (40 routes).",
        "not decided": "c and d cannot be told apart in length (d over c: 1.0 m (-1.0 to 3.0), 40 routes); some 120 "
        "routes would decide so large an effect.",
        "next": "run 480",
    }
    records = conclusion.to_dict()["verdicts"]
    assert [(each["kind"], each["is_decided"]) for each in records] == [
        ("more", True),
        ("tied", False),
    ]
    assert [each["sentence"] for each in records] == [known.sentence, unknown.sentence]
    table = Conclusion((known,) * 5, "done").table
    assert table.sentence.tolist() == [known.sentence] * 5
    assert table.loc[4, ["size", "low", "high", "n", "unit"]].tolist() == [
        1.312,
        0.92,
        1.7,
        40,
        "%",
    ]
    line = Conclusion((known,) * 5, "done").facts["decided"]
    assert line.count(known.sentence) == 3
    assert line.endswith("; 2 more in tables/verdicts.csv.")
    assert Conclusion((), "done").facts == {
        "decided": "Nothing.",
        "not decided": "Nothing.",
        "next": "done",
    }


def test_no_interval_of_shares_goes_beyond_what_can_be():
    solved = np.where(np.arange(12) < 9, 100.0, 0.0)
    values = pd.DataFrame({"astar": np.full(12, 100.0), "rrt": 100.0 - solved})
    clusters = Clusters(np.arange(12))
    of_shares = {}
    for largest in (math.inf, 100.0):
        measure = Measure(values, "percentage points", is_better_high=True, largest=largest)
        ranking = ranked({"solved": measure}, clusters)["solved"]
        of_shares[largest] = ranking
    assert of_shares[math.inf].pairs.high.item() > 100
    ranking = of_shares[100.0]
    assert ranking.pairs["size"].item() == 75
    assert ranking.pairs.high.item() == ranking.table.behind_high.max() == 100
    (verdict,) = ranking.verdicts(Kind.MORE, "instances")
    assert verdict.sentence.startswith("rrt costs 75 percentage points (")
    assert " to 100) more" in verdict.sentence


def test_the_next_study_is_longer_than_the_one_that_ran():
    """Of 10 instances 7 are solved by both planners."""
    tied = Verdict(SharedVerdict.TIED, ("a", "b"), 1.0, n=7, needed=8.0, facts={"measure": "cost"})
    conclusion = concluded([tied], more="run {needed}", done="done", ran=10)
    assert conclusion.next_command == "run 16"  # 8 / 0.7 and a margin, as the share may be smaller
    all_count = Verdict(**{**vars(tied), "n": 10, "needed": 30.0})
    assert concluded([all_count], more="{needed}", done="", ran=10).next_command == "30"


def test_of_two_that_cannot_be_told_apart_the_better_one_on_common_runs_stands_first():
    """Astar alone solved the two long pairs, so its own mean is the greater one."""
    values = pd.DataFrame({"ptp": [10.0, 11.0] + [np.nan] * 10, "astar": [9.0, 10.0] + [50.0] * 10})
    ranking = ranked({"cost": Measure(values, is_ratio=True)}, Clusters(np.arange(12)))["cost"]
    (tied,) = ranking.verdicts(SharedVerdict.TIED, "instances")
    assert tied.what == ("astar", "ptp")
    assert tied.sentence == (
        "astar and ptp cannot be told apart in cost (ptp over astar: 10.6 %, 2 instances); "
        "an interval takes 8 instances"
    )


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ((1.312, 0.92, 1.7), "1.31 (0.92 to 1.70)"),
        ((1234.5, 1100.0, 1400.0), "1,234 (1,100 to 1,400)"),
        ((2.2e-16, 0.0, 0.0), "0 (0 to 0)"),
        ((0.12345, np.nan, np.nan), "0.123"),
        ((10.3, 0.214, 22.6), "10 (0.2 to 23)"),
        ((10.3, 0.0, 22.6), "10 (0 to 23)"),
        ((-1e-12, -0.002, 0.002), "0.0000 (-0.0020 to 0.0020)"),
    ],
)
def test_no_digit_says_what_is_not_known(numbers, text):
    assert sized(*numbers) == text


def test_the_first_lines_name_the_open_question_that_the_fewest_further_runs_decide():
    near = Verdict(Kind.MORE, ("a", "b"), 1.0, -0.2, 2.2, 30, "m", needed=33.0)
    far = Verdict(Kind.MORE, ("c", "d"), 1.0, -1, 3, 60, "m", needed=120.0)
    beyond = Verdict(Kind.MORE, ("e", "f"), 1.0, -9, 11, 30, "m", needed=math.inf)
    text = Conclusion((far, near, beyond), "next").facts["not decided"]
    assert text.endswith(
        " The cheapest of these to decide, by some 3 more routes: b costs 1.0 m (-0.2 to 2.2) more than a (30 routes)."
    )
    assert "cheapest" not in Conclusion((far, beyond), "next").facts["not decided"]
