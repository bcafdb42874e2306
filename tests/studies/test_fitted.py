"""A fit as a value: who flew its routes, which weights are next to 0, what the border made, and how it shows itself."""

import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.fit import FitSettings, fit_targets, fit_weights
from jaxurban.statistics.bootstrap import Clusters, Interval
from jaxurban.statistics.conclusions import SharedVerdict, Verdict
from jaxurban.studies.demonstrations import demonstration_from_line, optimal_demonstrations
from jaxurban.studies.figures.tuning import plot_weights
from jaxurban.studies.queries import command_to_plan, command_to_vary, weights_option
from jaxurban.studies.tuning.confidence import FitVerdict
from jaxurban.studies.tuning.tested import HELD_OUT, wish_verdicts
from tests.studies.routes_made import HIDDEN, NUM, made_queries

QUICK = FitSettings(max_rounds=1)
WITHOUT_LIDAR = ju.Weights(distance=0.1, gps=0.4, lidar=0.0, population=0.2, risk=0.3)


@pytest.fixture(scope="module")
def unit(small):
    return ju.cost_map(small, 20.0)


@pytest.fixture(scope="module")
def blind(unit):
    """A fit to routes of a pilot to whom lidar is nothing."""
    return fit_weights(
        optimal_demonstrations(made_queries(unit, NUM, seed=9), WITHOUT_LIDAR), bootstrap=20
    )


def test_a_fit_names_the_pilot_of_planned_routes_and_none_of_lines(small, unit):
    instances = ju.studies.sample_instances(small, 4, altitudes_m=[20.0]).query("is_connected")
    flown = ju.fit.demonstrations(instances, small, pilot=HIDDEN, metrics=["gps", "lidar"])
    path = ju.plan(small, *ends_of(small), altitude_m=20.0, weights=HIDDEN)
    for routes, pilots in (
        (flown, (weights_option(HIDDEN),)),
        (ju.fit.demonstrations(path, small), (weights_option(HIDDEN),)),
        ([demonstration_from_line(unit, path.xy_m)], ()),
    ):
        assert fit_weights(routes, bootstrap=0, settings=QUICK).pilots == pilots


def test_commands_keep_the_constraints_and_the_times_of_routes(small):
    limits = ju.Constraints.read(require="gps>=0.1", vertical_clearance_m=0.0)
    *_, late = small.times_of_day
    assert late != small.times_of_day[0]
    for when, options in (({}, ""), ({"time_of_day": late}, f"--time-of-day {late} ")):
        (query,) = made_queries(ju.cost_map(small, 20.0, constraints=limits, **when), 1)
        rules = " --require 'gps>=0.1' --rules vertical_clearance_m=0.0 "
        assert f"{rules}{options}--weights" in command_to_plan(query, HIDDEN)
        assert rules in command_to_vary(query, HIDDEN, "out")
    (usual,) = made_queries(ju.cost_map(small, 20.0), 1)
    assert " --altitude 20 --weights " in command_to_plan(usual, HIDDEN)


def test_a_wish_whose_command_asks_for_no_routes_does_not_say_that_it_does(unit):
    """Of 8 pairs of ends 2 are held out, in Python, where none are drawn: 8 cannot be."""
    fit = fit_targets(made_queries(unit, 8), ["mean_gps>=0.9"], hold_out=0.25, settings=QUICK)
    assert fit.decided.next_command.startswith("jaxurban plan")
    assert fit.decided.asked == 0
    assert "Next asks" not in fit.decided.facts["not decided"]


def test_a_pilot_is_named_by_the_layers_that_the_maps_hold(small):
    empty = ju.MetricMaps(small.ds.drop_vars(["population", "density"]))
    fit = fit_targets(made_queries(ju.cost_map(empty, 20.0), 4), ["mean_gps>=0.05"])
    assert fit.pilots == ("distance=0.1,gps=1,lidar=1,risk=1",)  # which --pilot takes


def ends_of(maps) -> list[tuple[float, float]]:
    free = np.argwhere(maps.is_free(20.0))
    return [tuple(map(float, maps.grid.lonlat_of_cell(*cell))) for cell in (free[40], free[-40])]


@pytest.mark.slow
def test_a_weight_next_to_0_is_decided_drawn_and_not_asked_about(blind):
    """Where lidar costs 1 at every step it adds at most 5 % to the least that a step of these routes costs."""
    (verdict,) = (each for each in blind.verdicts if each.kind is FitVerdict.AT_MOST)
    assert verdict.what == ("lidar",)
    assert verdict.is_decided
    row = blind.table.loc["lidar"]
    assert row.weight == 0 < row.high
    assert f"lidar is at most {row.high:.2g}, which adds less than 5 %" in verdict.sentence
    features = np.mean([each.features for each in blind.routes], axis=0)
    num_steps = features[0] / 5
    assert row.high * num_steps <= 0.05 * (blind.table.low @ features)
    assert not blind.unidentified
    kinds = {each.what[0]: each.kind for each in blind.decided.verdicts if each.what}
    assert kinds["gps"] is kinds["risk"] is FitVerdict.WEIGHED

    (axes,) = plot_weights(blind).axes
    drawn = {
        line.get_marker(): line.get_xdata() for line in axes.lines if line.get_marker() in "o<"
    }
    assert drawn["<"] == pytest.approx([row.high])
    assert "triangle: the weight is 0, and at most this" in axes.get_xlabel()
    alike = blind.table.assign(weight=1.0, low=0.0, high=0.8)
    least, most = plot_weights(replace(blind, table=alike)).axes[0].get_xlim()
    assert least <= most / 10  # bars that reach 0 are long
    weighed = replace(blind, table=blind.table.assign(weight=0.2))
    assert "triangle" not in plot_weights(weighed).axes[0].get_xlabel()
    assert axes.get_yticklabels()[2].get_text() == "lidar, per 5 m flown"
    none_asks = replace(blind, tested=Interval(0.0, 0.0, 0.0), num_tested=8)
    assert none_asks.decided.next_command.startswith("jaxurban plan")


def test_the_pilots_weights_stand_beside_the_fitted_ones_and_intervals_say_whether_they_hold(blind):
    flown_by = WITHOUT_LIDAR.vector(blind.names)
    assert blind.table.pilot.to_numpy() == pytest.approx(flown_by / flown_by.sum())
    is_within = blind.table.pilot.between(blind.table.low - 1e-6, blind.table.high + 1e-6)
    text = blind.report.text
    assert ("The interval of each weight contains the pilot's" in text) == is_within.all()
    risk = blind.table.index == "risk"
    moved = replace(blind, table=blind.table.assign(low=blind.table.low.mask(risk, 0.9)))
    assert "The pilot's weight of risk lies outside its interval" in moved.report.text
    unknown = replace(blind, table=blind.table.assign(pilot=np.nan))
    assert "the pilot's weight" not in unknown.report.text.lower()


def test_routes_that_were_held_out_and_are_not_counted_are_said(blind):
    regret = np.array([*[0.001] * 9, 0.2])
    fit = replace(
        blind,
        tested=Interval(0.001, 0.001, 0.001),
        num_tested=9,
        others_regret=regret,
        others_trust=np.array([*[1.0] * 9, 0.01]),
    )
    sentence = fit.decided.verdicts[0].sentence
    assert "0.100 % (0.100 to 0.100) more than the cheapest" in sentence
    assert "not counted: 1 of 10 routes, with up to 20 % more; all of them have 2.1 %" in sentence


def test_a_pilot_who_weighs_none_of_the_fitted_metrics_is_one_sentence(small):
    instances = ju.studies.sample_instances(small, 3, altitudes_m=[20.0]).query("is_connected")
    pilot = ju.Weights(distance=0.0, gps=0.0, lidar=1.0, population=0.0, risk=0.0)
    flown = ju.fit.demonstrations(instances, small, pilot=pilot, metrics=["gps"])
    with warnings.catch_warnings(action="error"):
        fit = fit_weights(flown, bootstrap=0, settings=QUICK)
    assert fit.table.pilot.isna().all()
    (said,) = (each for each in fit.warnings if "pilot" in each)
    assert said.startswith(
        f"The pilot of {len(flown)} of {len(flown)} demonstrations gives no weight"
    )
    assert "to any of distance, gps, " in said


def test_no_command_asks_about_what_no_routes_decide(blind):
    constant = Verdict(FitVerdict.CONSTANT, ("risk",), needed=np.inf)
    none = Interval(0.0, 0.0, 0.0)
    share = Clusters(np.arange(8)).interval(np.zeros(8), "share")
    fit = replace(blind, verdicts=(constant,), tested=none, not_cheapest=share, num_tested=8)
    # 1 - 0.05^(1 / 8), as 8 of 8 are the cheapest once in 20 times where 31 % are not.
    assert fit.decided.verdicts[0].sentence.endswith(
        "cost 0 % (0 to 0) more than the cheapest under the weights (8 pairs of ends), and of all such routes at most "
        "31 % are not the cheapest"
    )
    assert not fit.decided.verdicts[-2].is_decided
    assert fit.decided.next_command.startswith("jaxurban plan")
    wide = Verdict(FitVerdict.WIDE, ("lidar",), 0.0, 0.0, 0.5, needed=np.nan)
    table = fit.table.assign(high=0.5).assign(
        weight=fit.table.weight.mask(fit.table.index == "lidar", 0.0)
    )
    again = replace(fit, verdicts=(wide,), table=table).decided.next_command
    assert again.startswith("jaxurban sensitivity")
    assert "lidar=0.5," in again  # at 0 it would change nothing
    table.loc["lidar", "weight"] = 0.04  # 10 times it is less than 0.5
    faint = replace(fit, verdicts=(wide,), table=table)
    assert "lidar=0.5," in faint.decided.next_command
    assert "--vary" not in faint.decided.next_command
    table.loc["lidar", "weight"] = 0.06
    both = replace(wide, what=("distance",))
    again = replace(fit, verdicts=(wide, both), table=table).decided.next_command
    assert "lidar=0.06," in again
    assert "--vary distance,gps,lidar,population,risk " in again  # the length is open too
    table.loc["lidar", "weight"] = 0.0
    wide = replace(wide, what=("risk",))
    small = Verdict(FitVerdict.AT_MOST, ("lidar",), 0.0, 0.0, 0.01)
    again = replace(fit, verdicts=(small, wide), table=table).decided.next_command
    assert "lidar=0," in again  # as that is decided


def test_the_border_is_said_of_fits_and_wider_maps_come_next(blind, unit):
    """A route is at the border that comes into the frame of 3 cells farther than 6 cells from both of its ends."""
    width_m, height_m = np.multiply(unit.grid.shape[::-1], 10.0)
    whole = shapely.box(0, 0, width_m, height_m)
    frame = whole.difference(whole.buffer(-30, join_style="mitre"))

    def is_at_border(route) -> bool:
        ends = shapely.MultiPoint(route.points_m[[0, -1]]).buffer(60, quad_segs=64)
        return shapely.LineString(route.points_m).difference(ends).intersection(frame).length > 0.1

    pairs = zip(blind.routes, blind.planned, strict=True)
    count = sum(is_at_border(route) or is_at_border(planned) for route, planned in pairs)
    (verdict,) = (each for each in blind.decided.verdicts if each.kind is SharedVerdict.BORDER)
    assert verdict.facts["count"] == count > 0
    settled = replace(
        blind,
        verdicts=(),
        tested=Interval(0.0, 0.0, 0.0),
        num_tested=8,
        commands=blind.commands._replace(wider="wider {bounds}"),
    )
    assert settled.decided.next_command.startswith("wider [-7")


@pytest.mark.slow
def test_a_fit_shows_itself_writes_its_report_and_draws_its_pictures(blind, unit, tmp_path):
    wish = fit_targets(
        made_queries(unit, 4), ["mean_gps>=0.1"], before=WITHOUT_LIDAR, settings=QUICK
    )
    for fit, pictures in ((blind, ["weights", "routes_1"]), (wish, ["routes_1"])):
        html = fit._repr_html_()
        shown = [*fit.decided.facts, fit.sentence, "per metre", "per 5 m flown", *fit.names]
        assert all(text in html for text in shown)
        assert fit.pilots == (weights_option(WITHOUT_LIDAR),)
        assert list(fit.report.figures) == pictures
        assert fit.tables["weights"].unit.tolist() == ["per metre", *["per 5 m flown"] * 4]
        assert fit.plot("routes_1").axes
        folder = tmp_path / pictures[0]
        report = fit.save(folder)[-1].read_text()
        assert f"`{weights_option(WITHOUT_LIDAR)}`" in report
        assert "sum to 1" in report
        verdicts = pd.read_csv(folder / "tables" / "verdicts.csv").sentence
        assert verdicts.tolist() == [each.sentence for each in fit.decided.verdicts]
        with pytest.raises(ju.InputError, match="holds another run"):
            replace(fit, weights=HIDDEN).save(folder)


def test_a_wish_asks_for_as_many_routes_as_decide_all_that_is_open():
    """Of 8 pairs 48, 40 and 60 are within reach, and 670 are not."""
    columns = dict.fromkeys(["with_wish", "change", "largest"], 1.0)
    rows = [
        {"what": "mean_lidar >= 0.3", "needed": 670.0},
        {"what": "length_m", "needed": 48.0},
        {"what": "mean_gps", "needed": 40.0},
        {"what": "people", "needed": 60.0},
    ]
    ends = {f"{name}{end}": 0.0 for name in ("with_wish", "change") for end in ("_low", "_high")}
    tested = pd.DataFrame([columns | ends | row | {"n": 8, "unit": ""} for row in rows])
    targets = [ju.fit.Target.parse("mean_lidar>=0.3")]
    verdicts, needed = wish_verdicts(tested, targets, [True], is_tested=True, is_kept=False)
    assert [each.noun for each in verdicts] == [HELD_OUT] * 4
    assert needed == 60


def test_what_a_wish_gains_on_other_routes_is_decided_though_the_target_is_open():
    row = {"what": "mean_lidar >= 0.3", "unit": "", "n": 54, "largest": 0.1, "needed": 350.0}
    wish = {"with_wish": 0.249, "with_wish_low": 0.170, "with_wish_high": 0.328}
    gain = {"change": 0.019, "change_low": 0.007, "change_high": 0.032}
    targets = [ju.fit.Target.parse("mean_lidar>=0.3")]
    tested = pd.DataFrame([row | wish | gain])
    target, gained = wish_verdicts(tested, targets, [True], is_tested=True, is_kept=False)[0]
    assert not target.is_decided
    assert "lidar quality changes by 0.019 (0.007 to 0.032)" in gained.sentence.lower()
    for is_tested, is_kept in ((False, False), (True, True)):
        how = {"is_tested": is_tested, "is_kept": is_kept}
        assert len(wish_verdicts(tested, targets, [True], **how)[0]) == 1


def test_of_a_target_that_the_best_weights_miss_more_routes_are_said_to_change_little():
    row = {"what": "mean_lidar >= 0.9", "unit": "", "n": 54, "largest": 0.1, "needed": 350.0}
    wish = {"with_wish": 0.249, "with_wish_low": 0.170, "with_wish_high": 0.328}
    gain = {"change": 0.019, "change_low": 0.007, "change_high": 0.032}
    tested = pd.DataFrame([row | wish | gain])
    targets = [ju.fit.Target.parse("mean_lidar>=0.9")]
    how = {"is_tested": True, "is_kept": False}
    near, far = (
        wish_verdicts(tested, targets, [is_reached], **how)[0][0].sentence
        for is_reached in (True, False)
    )
    assert "hardly change" not in near
    assert "the best weights miss it, which more routes hardly change" in far
