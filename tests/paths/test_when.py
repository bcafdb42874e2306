"""Routes at every time of their maps: the table is that of plans one by one, and one departure suits all routes."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from jaxurban.plot import plot_when
from jaxurban.typing import Departures, PlannedPath, RouteReport
from tests.cli_runs import run
from tests.guess_records import FLAT, attribute

ALTITUDE_M = 20.0


@pytest.fixture(scope="module")
def maps() -> ju.MetricMaps:
    """A town at three hours, whose high mask leaves some places without a position fix."""
    hours = ju.Gps(
        times=("2020-04-27T05:00:00Z", "2020-04-27T15:00:00Z"), step_s=18_000, mask_deg=25.0
    )
    city = ju.demo_city(600, 600)
    return ju.build_maps(
        city, resolution_m=20.0, altitudes_m=(ALTITUDE_M,), gps=hours, progress=False
    )


@pytest.fixture(scope="module")
def pairs(maps) -> list:
    free = np.argwhere(ju.cost_map(maps, ALTITUDE_M).free_space.islands == 1)
    return [
        [maps.grid.lonlat_of_cell(*free[at]) for at in ends]
        for ends in ((0, -1), (15, -40), (len(free) // 2, 3))
    ]


@pytest.fixture(scope="module")
def departures(maps, pairs) -> Departures:
    return ju.when(maps, pairs, altitude_m=ALTITUDE_M, progress=False)


def cost_at(path: PlannedPath, maps: ju.MetricMaps, time: str, day: str) -> float:
    """Return what a route costs at another time."""
    on = ju.cost_map(maps, ALTITUDE_M, time=time, time_of_day=day)
    return on.problem.features(path.search.points_m).cost(on.weight_vector)


def longest_m(report: RouteReport) -> float:
    """Return the longest stretch of cells whose HDOP is infinite."""
    rows = report.profile.to_dict("records")
    stretches = [
        [*part]
        for is_inf, part in itertools.groupby(rows, lambda row: np.isinf(row["hdop"]))
        if is_inf
    ]
    return max((part[-1]["to_m"] - part[0]["from_m"] for part in stretches), default=0.0)


@pytest.mark.slow
def test_the_table_is_that_of_a_plan_at_each_time(maps, pairs, departures):
    # The town is in New York, five hours behind.
    times = [*zip(maps.times, ("night", "night", "day"), strict=True)]
    assert [*departures.table[["time", "time_of_day"]].itertuples(index=False, name=None)] == times
    assert "own day (7 to 19 h of local solar time) or night" in departures.facts["times"]
    plans = [
        [ju.plan(maps, *pair, altitude_m=ALTITUDE_M, time=time, time_of_day=day) for pair in pairs]
        for time, day in times
    ]
    costs = np.array([[path.cost for path in row] for row in plans])
    best = int(costs.sum(axis=1).argmin())
    assert departures.best == best
    for row, paths, at in zip(departures.table.to_dict("records"), plans, times, strict=True):
        reports = [ju.explain(path, maps) for path in paths]
        kept = [
            cost_at(other, maps, *at) / path.cost - 1
            for path, other in zip(paths, plans[best], strict=True)
        ]
        expected = {
            "cost": sum(path.cost for path in paths),
            "length_m": sum(path.length_m for path in paths),
            "no_fix_m": sum(report.totals["no_fix_m"] for report in reports),
            "longest_no_fix_m": max(map(longest_m, reports)),
            "people_overflown": sum(report.totals["people_overflown"] for report in reports),
            "above_best": sum(path.cost for path in paths) / costs.sum(axis=1).min() - 1,
            "num_changed": sum(more > 1e-9 for more in kept),
            "kept_above": max(kept),
            **{
                f"exposure_{name}": sum(path.exposure_by_layer[name] for path in paths)
                for name in maps.metrics
            },
        }
        assert {name: row[name] for name in expected} == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert departures.table["no_fix_m"].max() > 0
    assert departures.table["num_changed"].max() > 0
    np.testing.assert_allclose(departures.routes["cost"], costs.ravel(), rtol=1e-9)


def test_of_times_that_cost_the_same_but_for_rounding_the_first_is_the_best(maps, pairs):
    same = ju.MetricMaps(
        maps.ds.assign(gps=maps.ds["gps"].isel(time=[0, 0, 0]).assign_coords(time=maps.ds["time"]))
    )
    departures = ju.when(same, pairs, altitude_m=ALTITUDE_M, time_of_day="day", progress=False)
    assert departures.best == 0
    assert [*departures.table["above_best"]] == [0.0, 0.0, 0.0]
    table = departures.table.assign(cost=departures.table["cost"] * [1 + 1e-14, 1, 1 + 1e-14])
    assert Departures(table, departures.routes, departures.paths).best == 0
    assert departures.facts["best"].endswith(", the same at 3 of 3 times")
    assert "costs do not compare" in departures.facts["people overflown"]


def test_the_cautions_are_of_the_routes_at_the_best_time(maps, pairs):
    nowhere = ju.MetricMaps(
        maps.ds.assign(hdop=maps.ds["hdop"] * 0 + np.inf).assign_attrs(attribute(FLAT))
    )
    departures = ju.when(nowhere, pairs, altitude_m=ALTITUDE_M, time_of_day="day", progress=False)
    paths = departures.paths[departures.best * len(pairs) : (departures.best + 1) * len(pairs)]
    limits = [
        f"Route {k}: {each}"
        for k, path in enumerate(paths)
        for each in path.cautions
        if each.level == "limit"
    ]
    assert departures.cautions == ["Guessed: flat ground.", *limits]
    assert all(
        any(each.startswith(f"Route {k}: GPS: no fix") for each in limits)
        for k in range(len(pairs))
    )
    assert all(each in repr(departures) for each in limits)


def test_the_facts_say_how_small_the_effect_is(departures):
    cost, facts = departures.table["cost"], departures.facts
    assert f"{cost.max() / cost.min() - 1:.2%} above the best" in facts["worst"]
    assert facts["best"].endswith(f"cost {cost.min():,.2f}")
    people = departures.table["people_overflown"]
    assert facts["people overflown"].startswith(f"{people.min():,.0f} at ")
    assert f" to {people.max():,.0f} at " in facts["people overflown"]
    assert facts["times without a path"] == ""


def test_no_departure_is_one_at_which_a_route_has_no_path(maps, pairs):
    num_visible, limits = (
        maps.ds["num_visible"].copy(),
        ju.Constraints.read(require=["num_visible>=1"]),
    )
    num_visible[1, :, :, maps.grid.num_cols // 2] = (
        0  # a wall at the hour that is the best one without it
    )
    walled = ju.MetricMaps(maps.ds.assign(num_visible=num_visible))
    islands = ju.cost_map(maps, ALTITUDE_M).free_space.islands
    closed_in, beside = (
        np.argwhere(islands == 2)[0],
        np.argwhere(islands[:, : maps.grid.num_cols // 2] == 1),
    )
    never = maps.grid.lonlat_of_cell(*closed_in), pairs[0][1]
    always = [maps.grid.lonlat_of_cell(*beside[at]) for at in (0, -1)]
    asked = {
        "altitude_m": ALTITUDE_M,
        "time_of_day": "day",
        "constraints": limits,
        "progress": False,
    }
    departures = ju.when(walled, [always, pairs[0], never], **asked)
    del asked["progress"]
    plans = [
        [ju.plan(walled, *pair, time=time, **asked).cost for pair in (always, pairs[0])]
        for time in maps.times
    ]
    sums = np.sum(plans, axis=1)
    assert (np.isfinite(plans[1][0]), np.isinf(plans[1][1])) == (True, True)
    np.testing.assert_allclose(departures.table["cost"], np.where(np.isinf(sums), np.nan, sums))
    assert departures.best == np.argmin(sums)
    assert departures.facts["times without a path"].startswith(
        "route 1 at 1, route 2 at 3 (No path"
    )


def test_what_has_no_times_to_choose_from_is_refused(maps, pairs):
    single = {"altitude_m": ALTITUDE_M, "time": maps.times[0], "time_of_day": "day"}
    with pytest.raises(ju.InputError, match=r"one time alone .* step_s=3600"):
        ju.when(maps, pairs, **single)
    table = pd.DataFrame([[*pair[0], *pair[1], maps.times[0]] for pair in pairs])
    table.columns = ["start_lon", "start_lat", "goal_lon", "goal_lat", "time"]
    with pytest.raises(ju.InputError, match="drop time"):
        ju.when(maps, table, altitude_m=ALTITUDE_M)
    with pytest.raises(ju.InputError, match="start"):
        ju.when(maps, [((0.0, 0.0), pairs[0][1])], altitude_m=ALTITUDE_M, progress=False)


def test_a_strip_shows_the_table_and_its_nights(maps, departures):
    table = departures.table
    cost, no_fix = plot_when(departures, maps).axes
    np.testing.assert_array_equal(cost.lines[0].get_ydata(), 100 * table["above_best"])
    np.testing.assert_array_equal(no_fix.lines[0].get_ydata(), table["no_fix_m"])
    for panel in (cost, no_fix):
        assert [shade.get_x() for shade in panel.patches] == [-0.5, 0.5]


def by_day_and_night(table: pd.DataFrame) -> pd.DataFrame:
    """Return departures with each time by day and by night."""
    return pd.concat([table.assign(time_of_day=name) for name in ("day", "night")])


def test_a_strip_of_all_times_by_day_and_by_night_has_a_line_of_each(maps, departures):
    table = by_day_and_night(departures.table)
    table["no_fix_m"] = np.arange(len(table)) + 1.0
    _, no_fix = plot_when(replace(departures, table=table), maps).axes
    lines = [line.get_ydata().tolist() for line in no_fix.lines]
    assert lines == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def test_times_of_day_that_are_alike_throughout_are_one_line(maps, departures):
    alike = by_day_and_night(departures.table).assign(above_best=0.0, num_changed=0, no_fix_m=5.0)
    cost, no_fix = plot_when(replace(departures, table=alike), maps).axes
    assert len(no_fix.lines) == 1
    names = [text.get_text() for text in cost.get_legend().get_texts()]
    assert names[0] == " and ".join(maps.times_of_day)


def test_times_of_day_of_one_time_are_bars_of_the_cost_from_zero(maps, departures):
    rows = by_day_and_night(departures.table)
    table = rows[rows["time"] == maps.times[0]].assign(
        no_fix_m=[0.0, 12.0], above_best=[0.0, 0.5], num_changed=[0, 1]
    )
    cost, no_fix = plot_when(replace(departures, table=table), maps).axes
    for panel, values in ((cost, table["cost"]), (no_fix, table["no_fix_m"])):
        assert [bar.get_width() for bar in panel.patches] == values.tolist()
        assert panel.get_xlim()[0] == 0
    texts = [text.get_text() for text in cost.texts]
    assert texts[0].endswith(": best")
    assert texts[1].endswith(": 50.00% above the best, another route")
    assert [text.get_text() for text in no_fix.texts] == ["0", "12"]
    assert [label.get_text() for label in cost.get_yticklabels()] == list(maps.times_of_day)


def test_a_strip_without_a_stretch_without_a_fix_has_no_panel_for_it(maps, departures):
    table = departures.table.assign(no_fix_m=0.0)
    figure = plot_when(replace(departures, table=table), maps)
    assert len(figure.axes) == 1
    assert "no fix is known to be lost" in " ".join(figure._supxlabel.get_text().split())


@pytest.mark.slow
def test_the_command_prints_writes_and_draws_the_same(maps, pairs, tmp_path, capsys):
    folder = maps.save(tmp_path / "maps")
    start, goal = (",".join(map(str, place)) for place in pairs[0])
    arguments = (
        "plan",
        folder,
        f"--start={start}",
        f"--goal={goal}",
        "--altitude",
        ALTITUDE_M,
        "--when",
    )
    code, out, err = run(
        capsys, *arguments, "-o", tmp_path / "when.csv", "--profile", tmp_path / "when.png"
    )
    departures = ju.when(maps, pairs[:1], altitude_m=ALTITUDE_M, progress=False)
    table = departures.table
    assert (code, maps.times[2] in out, "above the best" in out) == (0, True, True)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "when.csv"), table)
    assert (tmp_path / "when.png").read_bytes().startswith(b"\x89PNG")
    assert f"wrote {tmp_path / 'when.png'}" in err
    facts = json.loads(run(capsys, *arguments, "--json")[1])
    assert facts["cautions"] == departures.cautions
    assert all(f"jaxurban: {sentence}" in err.splitlines() for sentence in departures.cautions)
    assert facts["table"][facts["best"]]["cost"] == pytest.approx(table["cost"].min())
    for options in (
        ("-o", "when.geojson"),
        ("--volume",),
        ("--report", "speed_m_s=12"),
        ("--exposure", "risk<=9"),
    ):
        code, out, err = run(capsys, *arguments, *options)
        assert (code, out) == (2, "")
        assert "--when takes" in err
