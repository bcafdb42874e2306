"""Two sets of maps side by side: differences, strata and routes against brute force over the arrays themselves."""

import heapq
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.studies.map_comparison.routes import free_in_both
from jaxurban.studies.montecarlo.strata import STRATA, strata_of
from tests.made_maps import made_maps


def changed_from(maps: MetricMaps) -> MetricMaps:
    """Return maps with a new building, one less, dearer risk in a square, and better GPS everywhere at 60 m."""
    ds = maps.ds.copy(deep=True)
    ds["risk"][:, 20:60, 30:70] = np.clip(ds["risk"][:, 20:60, 30:70] + 0.1, 0, 1)
    ds["gps"][:, 1] = np.where(ds["obstacle"][1] == 1, 0, np.clip(ds["gps"][:, 1] + 0.05, 0, 1))
    for values, height in ((np.s_[40:50, 45:80], 90.0), (np.s_[0:3, 0:5], 0.0)):
        for name in ("roof", "roof_touched"):
            ds[name][values] = height
    ds["obstacle"].values[:] = np.stack([ds["roof"].values >= z for z in maps.altitudes_m])
    for name in ("gps", "lidar", "risk"):
        ds[name] = ds[name] * (1 - ds["obstacle"])
    return MetricMaps(ds)


@pytest.fixture(scope="module")
def maps() -> tuple[MetricMaps, MetricMaps]:
    a = made_maps()
    return a, changed_from(a)


@pytest.fixture(scope="module")
def found(maps):
    return ju.compare(*maps, routes=12, cost_model="line", progress=False)


def test_differences_are_b_less_a_where_both_are_free(maps, found):
    a, b = maps
    for z, altitude_m in enumerate(a.altitudes_m):
        is_free = (a.ds["obstacle"].values[z] == 0) & (b.ds["obstacle"].values[z] == 0)
        for name in ("gps", "risk", "lidar"):
            values = [maps.ds[name].values.reshape(-1, 2, *is_free.shape)[0, z] for maps in (a, b)]
            want = np.where(is_free, values[1] - values[0], np.nan)
            np.testing.assert_array_equal(found.of(name, altitude_m), want.astype(np.float32))
    assert found.of("lidar", 60.0)[np.isfinite(found.of("lidar", 60.0))].max() == 0


def test_statistics_are_numpys_over_the_cells_of_the_stratum(maps, found):
    a, _ = maps
    strata = strata_of(a)
    for row in found.table[found.table.layer.isin(["gps", "risk", "roof"])].itertuples():
        change = found.of(row.layer, None if np.isnan(row.altitude_m) else row.altitude_m).astype(float)
        chosen = np.isfinite(change) & ((row.stratum == "all") | (strata == [*STRATA, "all"].index(row.stratum)))
        values = change[chosen]
        assert row.cells == len(values) > 0
        want = [values.mean(), *np.percentile(values, [50, 5, 95]), np.sqrt((values**2).mean())]
        np.testing.assert_allclose([row.mean, row.median, row.p05, row.p95, row.rms], want, atol=1e-12)
        assert row.share_changed == (abs(values) > 1e-6).mean()
    by_stratum = found.table[(found.table.layer == "risk") & (found.table.altitude_m == 20.0)].set_index("stratum")
    assert by_stratum.cells["all"] == by_stratum.cells.drop("all").sum()


def test_gained_and_lost_obstacles_are_counted(maps, found):
    a, b = (each.ds["obstacle"].values.astype(int) for each in maps)
    rows = found.table[(found.table.layer == "obstacle") & (found.table.stratum == "all")].set_index("altitude_m")
    for z, altitude_m in enumerate(maps[0].altitudes_m):
        assert rows.gained[altitude_m] == ((b[z] == 1) & (a[z] == 0)).sum() > 200
        assert rows.lost[altitude_m] == ((b[z] == 0) & (a[z] == 1)).sum()
    assert rows.lost.sum() > 0


def test_maps_do_not_differ_from_themselves(maps):
    same = ju.compare(maps[0], maps[0], routes=4, progress=False)
    assert same.table.share_changed.max() == 0
    assert same.table.rms.max() == 0
    assert not same.routes.table.is_changed.any()
    assert (same.routes.table.regret == 0).all()
    assert (same.routes.table.overlap == 1).all()


def test_infinite_dilutions_are_alike_or_changed_but_never_a_mean(maps):
    a, ds = maps[0], maps[0].ds.copy(deep=True)
    free = np.argwhere((ds["obstacle"].values[0] == 0) & np.isfinite(ds["hdop"].values[0, 0]))[0]
    ds["hdop"].values[0, 0, *free] = np.inf
    found = ju.compare(a, MetricMaps(ds), progress=False)
    row = found.table[(found.table.layer == "hdop") & (found.table.stratum == "all")].iloc[0]
    assert np.isinf(found.of("hdop", 20.0)).sum() == 1
    assert row["mean"] == row.rms == 0
    assert row.share_changed == pytest.approx(1 / row.cells)


def test_a_tolerance_in_the_layers_unit_counts_as_the_same(maps):
    found = ju.compare(*maps, tolerance=0.2, progress=False)
    rows = found.table.query("stratum == 'all' and layer in ('gps', 'risk')")
    assert rows.share_changed.max() == 0
    assert rows.rms.max() > 0.01


def test_only_the_cells_that_both_hold_are_compared_wherever_they_lie(maps):
    a, b = maps
    parts = ju.compare(MetricMaps(a.ds.isel(x=slice(10, 90))), MetricMaps(b.ds.isel(y=slice(30, None))), progress=False)
    whole = ju.compare(a, b, progress=False)
    assert parts.grid.shape == (50, 80)
    assert (parts.grid.first_row, parts.grid.first_col) == (450_030, 58_010)
    np.testing.assert_array_equal(parts.of("risk", 20.0), whole.of("risk", 20.0)[30:, 10:90])
    assert parts.part.cut == (30 * 80, 50 * 20)


def test_altitudes_times_of_day_and_layers_of_one_alone_are_left_out_by_name(maps):
    a, b = maps
    ds = b.ds.isel(altitude=[1], time_of_day=[1]).drop_vars("lidar").assign_attrs(pop_norm_per_km2=[7.0])
    found = ju.compare(a, MetricMaps(ds), progress=False)
    assert found.a.altitudes_m == found.b.altitudes_m == (60.0,)
    assert found.a.times_of_day == ("night",)
    assert set(found.part.left_out) == {"altitude 20 m", "lidar"}
    assert "only A" in found.part.left_out["lidar"]
    want = b.m("population", time_of_day="night") - a.m("population", time_of_day="night")
    np.testing.assert_array_equal(found.of("population"), want)


def at_time(maps: MetricMaps, *times: str) -> MetricMaps:
    ds = xr.concat([maps.ds] * len(times), "time", data_vars="minimal", coords="minimal", compat="override")
    return MetricMaps(ds.assign_coords(time=np.array(times, "datetime64[ns]")))


def test_single_times_are_set_beside_each_other_and_several_need_pairs(maps):
    a, b = maps
    first, later = "2020-04-27T16:00:00Z", "2020-04-28T06:00:00Z"
    single = ju.compare(a, at_time(b, later[:-1]), progress=False)
    assert dict(single.part.times) == {first: later}
    both = at_time(b, later[:-1], "2020-04-29T06:00:00")
    with pytest.raises(ju.InputError, match="--time"):
        ju.compare(a, both, progress=False)
    paired = ju.compare(a, both, times={first: later}, progress=False)
    np.testing.assert_array_equal(paired.of("gps", 60.0), ju.compare(a, b, progress=False).of("gps", 60.0))
    with pytest.raises(ju.InputError, match="B holds no maps of"):
        ju.compare(a, both, times={first: first}, progress=False)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ds: ds.assign_attrs(crs="EPSG:32617"), "crs = 'EPSG:32618'"),
        (lambda ds: ds.isel(y=slice(0, 5)).assign_coords(y=ds.y[:5] + 5000.0), "share no cell"),
        (lambda ds: ds.assign_coords(altitude=[30.0, 70.0]), "share no altitude"),
    ],
)
def test_maps_that_cannot_be_compared_are_refused_in_one_sentence(maps, change, words):
    with pytest.raises(ju.InputError, match=words) as refused:
        ju.compare(maps[0], MetricMaps(change(maps[1].ds)), progress=False)
    assert "\n" not in str(refused.value)


def test_another_resolution_is_refused_with_the_remedy(maps):
    with pytest.raises(ju.InputError, match=r"10 m wide and B's 5 m.*resolution_m"):
        ju.compare(maps[0], made_maps(resolution_m=5.0), progress=False)


def dijkstra(cost: np.ndarray, is_free: np.ndarray, start: tuple, goal: tuple, side_m: float, w_0: float) -> float:
    """Return the cheapest cost of a path by the ``cell`` model: w_0 a metre, and the cost of each cell entered."""
    best, queue = {start: 0.0}, [(0.0, start)]
    while queue:
        so_far, (row, col) = heapq.heappop(queue)
        if (row, col) == goal:
            return so_far
        for d_row, d_col in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            to = row + d_row, col + d_col
            if not (0 <= to[0] < cost.shape[0] and 0 <= to[1] < cost.shape[1] and is_free[to]):
                continue
            if not (is_free[row, to[1]] and is_free[to[0], col]):
                continue
            there = so_far + w_0 * side_m * float(np.hypot(d_row, d_col)) + cost[to]
            if there < best.get(to, np.inf):
                best[to] = there
                heapq.heappush(queue, (there, to))
    return np.inf


def test_regret_and_overlap_are_those_of_brute_force(maps):
    a, b = maps
    weights = {"distance": 0.02, "gps": 1.0, "lidar": 0.5, "risk": 3.0, "population": 0.0}
    rules = {"cost_model": "cell", "constraints": ju.Constraints(vertical_clearance_m=0.0)}
    found = ju.compare(a, b, routes=6, weights=weights, **rules, progress=False)
    rows, num_dearer = found.routes.table, 0
    for row in rows[rows.altitude_m == 60.0].itertuples():
        layers = b.costs(60.0, time=row.time, time_of_day=row.time_of_day)
        cost = sum(weights[name] * layer.astype(float) for name, layer in layers.items())
        ends = [
            tuple(map(int, b.grid.cell_of_xy(x, y)))
            for x, y in ((row.start_x_m, row.start_y_m), (row.goal_x_m, row.goal_y_m))
        ]
        cheapest = dijkstra(cost, b.is_free(60.0), *ends, 10.0, weights["distance"])
        assert row.cost_b == pytest.approx(cheapest, rel=1e-9)
        cells = [tuple(map(int, b.grid.cell_of_xy(*xy))) for xy in found.routes.a[row.query].xy_m]
        of_b = {tuple(map(int, b.grid.cell_of_xy(*xy))) for xy in found.routes.b[row.query].xy_m}
        is_blocked = any(not b.is_free(60.0)[cell] for cell in cells)
        assert row.is_blocked == is_blocked
        if is_blocked:
            assert np.isinf(row.regret)
            assert row.blocked_m > 0
            continue
        steps = [weights["distance"] * 10.0 * np.hypot(p[0] - q[0], p[1] - q[1]) + cost[q] for p, q in pairwise(cells)]
        assert row.cost_of_a_on_b == pytest.approx(sum(steps), rel=1e-9)
        assert row.regret == pytest.approx(sum(steps) / cheapest - 1, abs=1e-9)
        assert row.is_changed == (set(cells) != of_b)
        num_dearer += row.regret > 1e-6
    assert num_dearer >= 1
    assert rows.is_blocked.astype(bool).sum() >= 1


def test_sampled_ends_are_free_in_both_and_joined_in_both(maps, found):
    a, b = maps
    both = free_in_both(found.part)
    for z in a.altitudes_m:
        np.testing.assert_array_equal(both.is_free(z), a.is_free(z) & b.is_free(z))
    assert len(found.routes.table) == 24
    assert found.routes.table.status_a.eq("optimal").all()
    assert found.routes.table.status_b.eq("optimal").all()


def test_queries_of_a_table_fly_at_every_altitude_unless_they_name_one(maps):
    a, b = maps
    lonlat = [a.grid.lonlat_of_cell(*cell) for cell in ((70, 5), (10, 95))]
    pair = [tuple(map(float, place)) for place in lonlat]
    found = ju.compare(a, b, routes=[(pair[0], pair[1])], snap=True, progress=False)
    assert found.routes.table.altitude_m.tolist() == [20.0, 60.0]
    table = pd.DataFrame(
        [(*pair[0], *pair[1], 60.0)], columns=["start_lon", "start_lat", "goal_lon", "goal_lat", "altitude_m"]
    )
    one = ju.compare(a, b, routes=table, snap=True, progress=False)
    assert one.routes.table.cost_b.tolist() == found.routes.table.cost_b.tolist()[1:]
    instances = ju.sample_instances(a, 3, cost_model="cell", seed=4)
    sampled = ju.compare(a, b, routes=instances, progress=False).routes
    assert len(sampled.table) == 6
    assert sampled.table.w_risk.tolist() == instances.w_risk.tolist()


def test_a_start_that_is_closed_in_b_alone_is_a_row_with_the_reason(maps):
    a, b = maps
    (x, y), (gx, gy) = a.grid.xy_of_cell(42, 75), a.grid.xy_of_cell(10, 95)
    places = {"start_x_m": [x], "start_y_m": [y], "goal_x_m": [gx], "goal_y_m": [gy], "altitude_m": [60.0]}
    assert a.is_free(60.0)[42, 75]
    row = ju.compare(a, b, routes=pd.DataFrame(places), progress=False).routes.table.iloc[0]
    assert (row.status_a, row.status_b) == ("optimal", "bad-input")
    assert "start" in row.note
    assert np.isnan(row.regret)
    snapped = ju.compare(a, b, routes=pd.DataFrame(places), snap=100.0, progress=False).routes.table.iloc[0]
    assert "snapped to another cell" in snapped.note
    assert np.isnan(snapped.regret)


def test_the_comparison_shows_itself(found):
    assert repr(found).startswith("MapComparison(A: A; B: B; grid: 80 x 100 cells")
    assert "24 queries" in found._repr_html_()
    assert found.difference["gps"].dims == ("time", "altitude", "y", "x")
    np.testing.assert_array_equal(found.difference["gps"].values[0, 1], found.of("gps", 60.0))
    np.testing.assert_array_equal(found.difference["population"].values[1], found.of("population", time_of_day="night"))
    with pytest.raises(ju.InputError, match="'gsp' is not compared"):
        found.of("gsp")
