"""Weights of one route: breakpoints against SciPy, the gradient of its cost, report and command."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

import jaxurban as ju
from jaxurban.planners.cost import STEPS
from jaxurban.studies.figures.sensitivity import plot_breakpoint_routes
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.reports.sensitivity import sensitivity_report
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.weights.breakpoints import find_breakpoints, nearest_breakpoints
from jaxurban.studies.weights.one_route import SAME_WAY
from jaxurban.studies.weights.paid import paid_on
from jaxurban.typing import CostMap, PlannedPath, Sensitivity
from tests.cli_runs import run
from tests.pictures import faults
from tests.studies.routes_made import walled

GIVEN = np.array([0.1, 1.0, 1.0, 1.0, 1.0])
NAMES = ("distance", "gps", "lidar", "population", "risk")


def dijkstra_cost(query: RouteQuery, weights: np.ndarray) -> float:
    """Return the cheapest cost by SciPy, over edges that are made here."""
    unit = query.cost_map
    price = (
        weights[0] + np.tensordot(weights[1:], unit.costs, 1) / unit.cost_model.reference_length_m
    )
    is_free, price = np.pad(unit.is_free, 1), np.pad(price, 1)
    (row, col), number = np.nonzero(is_free), np.arange(is_free.size).reshape(is_free.shape)
    edges = csr_matrix((is_free.size, is_free.size))
    for rows, cols in STEPS:
        is_open = (
            is_free[row + rows, col + cols] & is_free[row + rows, col] & is_free[row, col + cols]
        )
        tail, head = (row[is_open], col[is_open]), (row[is_open] + rows, col[is_open] + cols)
        cost = np.hypot(rows, cols) * unit.grid.resolution_m * (price[tail] + price[head]) / 2
        edges += csr_matrix((cost, (number[tail], number[head])), edges.shape)
    start, goal = (number[row + 1, col + 1] for row, col in (query.start, query.goal))
    return float(dijkstra(edges, indices=start)[goal])


def line_of(name: str) -> np.ndarray:
    ends = np.tile(GIVEN, (2, 1))
    ends[:, NAMES.index(name)] *= (0.1, 10.0)
    return ends


@pytest.mark.parametrize("name", ["risk", "population"])
def test_along_a_line_the_route_changes_at_the_cuts_and_has_ever_less_of_a_rising_weight(
    crossing, name
):
    found = find_breakpoints(RoutePool([crossing]), line_of(name))
    ends = np.concatenate([[0.0], found.breakpoints, [1.0]])
    assert np.all(np.diff(ends) > 0)
    assert len(found.cells) >= 3
    assert np.all(np.diff(found.features[:, NAMES.index(name)]) < 0)
    for route, (begin, end) in enumerate(pairwise(ends)):
        inside = np.linspace(begin, end, 5)[1:-1]
        weights = found.weights_at(np.stack([1 - inside, inside], -1))
        truth = [dijkstra_cost(crossing, each) for each in weights]
        np.testing.assert_allclose(weights @ found.features[route], truth, rtol=1e-9)


def test_a_line_on_which_nothing_changes_has_one_cell(crossing):
    found = find_breakpoints(RoutePool([crossing]), np.stack([GIVEN, 3 * GIVEN]))
    assert len(found.cells) == 1
    assert found.breakpoints.size == 0


def test_nearest_breakpoints_are_the_first_along_the_line_where_dijkstra_finds_a_cheaper_route(
    crossing,
):
    pool = RoutePool([crossing])
    found = nearest_breakpoints(pool, GIVEN, range(1, 5), (0.1, 10.0))
    given = pool.cheapest(GIVEN[None])[0, 0, 0]
    assert np.isfinite(found).sum() > 4, "a grid of many routes is what tells"
    for column, ends in zip(range(1, 5), found, strict=True):
        factors = (
            0.1 + find_breakpoints(RoutePool([crossing]), line_of(NAMES[column])).breakpoints * 9.9
        )
        first = [
            factors[factors < 1].max(initial=-np.inf),
            factors[factors > 1].min(initial=np.inf),
        ]
        np.testing.assert_allclose(ends, np.where(np.isfinite(first), first, np.nan), rtol=1e-6)
        for nearest, end in zip(ends, (0.1, 10.0), strict=True):
            step = np.sign(end - 1) * 1e-4
            inside, outside = (
                (end, None) if np.isnan(nearest) else (nearest * (1 - step), nearest * (1 + step))
            )
            for factor in filter(None, (inside, outside)):
                weights = GIVEN.copy()
                weights[column] *= factor
                saved = 1 - dijkstra_cost(crossing, weights) / (weights @ given)
                assert (saved > 1e-12) == (factor == outside), (column, factor, saved)


def test_a_weight_of_zero_has_no_nearest_breakpoint(crossing):
    assert np.isnan(
        nearest_breakpoints(RoutePool([crossing]), GIVEN * [1, 0, 1, 1, 1], [1], (0.1, 10.0))
    ).all()


@pytest.fixture(scope="module")
def found(crossed, ends, tmp_path_factory) -> Sensitivity:
    return ju.studies.sensitivity(
        crossed,
        tmp_path_factory.mktemp("one"),
        [ends],
        altitudes_m=[20.0],
        progress=False,
    )


@pytest.fixture
def command(crossed, ends, tmp_path, capsys):
    """Return what runs the command of a small study, with other options, over its maps or others."""
    crossed.save(tmp_path / "maps")
    few = ("--vary", "risk,population", "-o", tmp_path / "out")

    def runs(*options, start=ends[0]):
        places = [
            "--start={:.9f},{:.9f}".format(*start),
            "--goal={:.9f},{:.9f}".format(*ends[1]),
            "--altitude",
            20,
        ]
        return run(capsys, "sensitivity", tmp_path / "maps", *places, *few, *options)

    return runs


@pytest.mark.slow
def test_gradient_of_the_cheapest_cost_equals_central_differences(crossing, found):
    route = found.route
    shares = found.tables["weights"].set_index("weight_name").elasticity
    for column, name in enumerate(crossing.names):
        step = np.eye(len(GIVEN))[column] * 1e-6
        above, below = (
            dijkstra_cost(crossing, weights) for weights in (GIVEN + step, GIVEN - step)
        )
        assert route.features[column] == pytest.approx((above - below) / 2e-6, rel=1e-5)
        share = GIVEN[column] * route.features[column] / dijkstra_cost(crossing, GIVEN)
        assert shares[name] == pytest.approx(share)
    assert shares.sum() == pytest.approx(1)


def test_the_route_stays_the_same_up_to_the_first_factor_and_goes_another_way_at_the_other(
    crossed, ends, found
):
    under = {"altitude_m": 20.0, "cost_model": "line"}
    given = ju.plan(crossed, *ends, **under)
    own = {tuple(cell) for cell in np.floor(given.xy_m).astype(int)}
    ways = found.tables["ways"]
    assert set(ways.weight_name) == set(found.route.lines)
    assert ways.factor.notna().sum() > 1
    for row in ways.dropna(subset="first").to_dict("records"):
        step = 1.001 if row["side"] == "more" else 1 / 1.001
        for factor, is_same in ((row["first"] / step, True), (row["first"] * step, False)):
            weights = {row["weight_name"]: factor}
            other = ju.plan(crossed, *ends, weights=weights, **under)
            sums = [(route.length_m, *route.metrics.values()) for route in (other, given)]
            assert np.allclose(*sums, rtol=1e-9) == is_same
    for row in ways.dropna(subset="factor").to_dict("records"):
        step = 1.001 if row["side"] == "more" else 1 / 1.001
        weights = {row["weight_name"]: row["factor"] * step}
        other = ju.plan(crossed, *ends, weights=weights, **under)
        cells = {tuple(cell) for cell in np.floor(other.xy_m).astype(int)}
        assert len(own & cells) / len(own) < SAME_WAY
        assert row["more_length_m"] == pytest.approx(other.length_m - given.length_m, abs=1e-6)
        on = ju.cost_map(crossed, **under)
        cost = on.problem.features(other.xy_m - crossed.grid.bounds_m[:2]).cost(on.weight_vector)
        assert row["more_cost"] == pytest.approx(cost / given.cost - 1, rel=1e-6)


def test_what_a_route_costs_is_what_its_report_says(town_route):
    on, path = town_route
    totals = ju.explain(path, on.maps).totals
    paid = paid_on(on)(path.xy_m - on.grid.bounds_m[:2])
    assert paid["length_m"] == pytest.approx(path.length_m)
    assert paid["people_below"] == pytest.approx(totals["people_overflown"], rel=1e-6)
    profile = ju.explain(path, on.maps).profile
    lost = profile[~np.isfinite(profile.hdop)]
    assert paid["no_fix_m"] == pytest.approx((lost.to_m - lost.from_m).sum(), abs=1e-6)
    assert paid["at_edge"] in (0.0, 1.0)


@pytest.fixture(scope="module")
def town_route() -> tuple[CostMap, PlannedPath]:
    maps = ju.build_maps(
        ju.demo_city(600, 600), resolution_m=20.0, altitudes_m=(20.0,), progress=False
    )
    on = ju.cost_map(maps, 20.0)
    lonlat = maps.grid.lonlat_of_cell
    return on, on.plan(lonlat(1, 1), lonlat(28, 28), snap=True)


def test_the_first_lines_say_where_the_route_changes_and_that_one_route_says_nothing_of_others(
    found,
):
    lines = found.decided.facts
    ways = found.tables["ways"].dropna(subset="factor")
    nearest = ways.loc[np.abs(np.log(ways.factor)).idxmin()]
    first = found.decided.verdicts[0]
    assert first.what == (nearest.weight_name,)
    assert first.facts["factor"] == nearest.factor
    assert f"{nearest.weight_name} times {nearest.factor:.3g} sends the drone" in lines["decided"]
    assert "which one route cannot say" in lines["not decided"]
    assert lines["next"].startswith("jaxurban sensitivity DIR --resolution 10 ")  # in memory
    assert lines["next"].endswith(f" -o {found.folder}-more --routes 30")
    report = (found.folder / "report.md").read_text().splitlines()
    assert report[2].startswith("- **Decided**: ")
    assert all(line in repr(found) for line in lines.values())


def test_a_given_route_along_the_border_is_cautioned_in_the_first_lines(found, tmp_path):
    assert "may have made" not in found.decided.facts["decided"]
    ways = found.route.ways.assign(at_edge=0.0, edge_sides="")
    route = replace(found.route, ways=ways, edge_sides=("north",))
    (city,) = found.maps
    folder = found.maps[city].save(tmp_path / "out-wider" / city)
    wide = {city: ju.open_maps(folder)}
    pinned = replace(found, route=route, rows=found.rows.assign(at_edge=1.0), maps=wide)
    lines = pinned.decided.facts
    assert "sends the drone another way (from a route that the border may have made)" in str(lines)
    assert lines["not decided"].startswith("the route comes within 3 cells of the border")
    assert "data in the north, away" in lines["not decided"]
    assert f"-o {tmp_path}/out-wider-wider/{city} --set" in lines["next"]
    ended = {"known_bounds_m": wide[city].grid.bounds_m}
    ends = {city: ju.MetricMaps(found.maps[city].ds.assign_attrs(ended))}
    assert "region.bounds" not in replace(pinned, maps=ends).decided.facts["next"]


def test_the_report_of_one_route_has_no_words_on_what_only_several_have(found):
    report = sensitivity_report(found).text
    for words in ("tables/pairs", "brackets", "*heights*", "bootstrap"):
        assert words not in report
    more = found.instances.assign(instance=7)
    several = replace(found, route=None, instances=pd.concat([found.instances, more]))
    assert "`tables/pairs` compares each two" in sensitivity_report(several).text
    assert "by bootstrap over pairs of places" in sensitivity_report(several).text


@pytest.mark.slow
def test_the_report_names_every_figure_and_every_table_has_its_files(found):
    assert faults(plot_breakpoint_routes(found.route)) == []
    report = (found.folder / "report.md").read_text()
    assert report.count("© a made city") == 1
    assert all(sentence in report for sentence in found.route.path.cautions or ["no caution"])
    shown = {part.split(")")[0] for part in report.split("](")[1:]}
    assert shown == {f"figures/{name}.png" for name in ["switch_routes"]}
    assert {f"figures/{file.name}" for file in (found.folder / "figures").iterdir()} == shown
    for name, table in found.tables.items():
        for read, suffix in ((pd.read_csv, "csv"), (pd.read_parquet, "parquet")):
            assert len(read(found.folder / "tables" / f"{name}.{suffix}")) == len(table)


@pytest.mark.slow
def test_the_command_prints_json_and_tells_a_start_that_was_moved_there_and_in_the_report(
    crossed, command, tmp_path
):
    start = crossed.grid.lonlat_of_cell(*np.argwhere(~crossed.is_free(20.0))[0])
    code, out, err = command("--snap", "--json", start=start)
    assert code == 0, err
    assert {row["weight_name"] for row in json.loads(out)["tables"]["ways"]} == {
        "risk",
        "population",
    }
    report = (tmp_path / "out" / "report.md").read_text()
    for text in (err, report):
        assert "The start was not free: it was moved 30.0 m, to a free cell." in text


def test_an_end_that_is_missing_is_named_and_so_is_what_asks_for_several_routes(
    crossed, ends, tmp_path, capsys
):
    folder = crossed.save(tmp_path / "maps")
    start, goal = ("{:.6f},{:.6f}".format(*end) for end in ends)
    for options, said in (
        ([f"--start={start}"], "name the --goal, too"),
        ([f"--goal={goal}"], "name the --start, too"),
        ([f"--start={start}", f"--goal={goal}", "--routes", 3], "--routes of several: name one"),
    ):
        code, _, err = run(capsys, "sensitivity", folder, *options)
        assert code == 2
        assert said in err


@pytest.mark.slow
def test_a_walled_goal_is_exit_3(crossed, command, tmp_path):
    walled(crossed, 15).save(tmp_path / "maps")
    code, _, err = command()
    assert code == 3
    assert "joins start and goal" in err
