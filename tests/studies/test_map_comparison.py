"""Two sets of maps side by side: differences against brute force over the arrays themselves."""

import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import jaxurban as ju
from jaxurban.knowledge import GuessKind, guessed
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.maps.shared import paired_times
from tests.guess_records import attribute, heights
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


def at(found, layer: str, altitude_m: float | None = None) -> np.ndarray:
    """Return the difference of a layer at an altitude, and at its first time and time of day."""
    change = found.difference(layer)
    if altitude_m is not None:
        change = change.sel(altitude=altitude_m)
    return change.values.reshape(-1, *change.shape[-2:])[0]


@pytest.fixture(scope="module")
def maps() -> tuple[MetricMaps, MetricMaps]:
    a = made_maps()
    return a, changed_from(a)


@pytest.fixture(scope="module")
def found(maps):
    return ju.studies.compare(*maps, progress=False)


def test_differences_are_b_less_a_where_both_are_free(maps, found):
    a, b = maps
    for z, altitude_m in enumerate(a.altitudes_m):
        is_free = (a.ds["obstacle"].values[z] == 0) & (b.ds["obstacle"].values[z] == 0)
        for name in ("gps", "risk", "lidar"):
            values = [maps.ds[name].values.reshape(-1, 2, *is_free.shape)[0, z] for maps in (a, b)]
            want = np.where(is_free, values[1] - values[0], np.nan)
            np.testing.assert_array_equal(at(found, name, altitude_m), want.astype(np.float32))
    assert np.nanmax(at(found, "lidar", 60.0)) == 0


def test_statistics_are_numpys_over_all_cells(maps, found):
    for row in found.table[found.table.layer.isin(["gps", "risk", "roof"])].itertuples():
        altitude_m = None if np.isnan(row.altitude_m) else row.altitude_m
        change = at(found, row.layer, altitude_m).astype(float)
        of_a = maps[0].ds[row.layer]
        if altitude_m is not None:
            of_a = of_a.sel(altitude=altitude_m)
        of_a = of_a.values.reshape(-1, *change.shape)[0]
        assert row.mean_a == pytest.approx(of_a[np.isfinite(change)].mean(), rel=1e-5)
        values = change[np.isfinite(change)]
        assert row.cells == len(values) > 0
        want = [values.mean(), np.sqrt((values**2).mean())]
        np.testing.assert_allclose([row.mean, row.rms], want, atol=1e-12)
        assert (row.higher, row.lower) == ((values > 1e-5).sum(), (values < -1e-5).sum())


def test_obstacles_of_one_map_alone_are_counted(maps, found):
    a, b = (each.ds["obstacle"].values.astype(int) for each in maps)
    rows = found.table[found.table.layer == "obstacle"].set_index("altitude_m")
    for z, altitude_m in enumerate(maps[0].altitudes_m):
        assert rows.higher[altitude_m] == ((b[z] == 1) & (a[z] == 0)).sum() > 200
        assert rows.lower[altitude_m] == ((b[z] == 0) & (a[z] == 1)).sum()
    assert rows.lower.sum() > 0


def test_no_map_differs_from_itself(maps):
    same = ju.studies.compare(maps[0], maps[0], progress=False)
    assert same.table.higher.max() == same.table.lower.max() == same.table.rms.max() == 0
    is_free = maps[0].ds["obstacle"].values == 0
    num_times = maps[0].ds.sizes["time"]
    assert same.decided.facts["decided"].startswith(
        f"B changes no metric on average; of {num_times * is_free.sum():,} free cells"
    )


def test_rounding_of_a_dop_is_no_difference(maps):
    b = maps[0].ds.copy(deep=True)
    b["hdop"] = b["hdop"] * np.float32(1 - 1e-6)
    same = ju.studies.compare(maps[0], MetricMaps(b), progress=False).table
    assert same[same.layer == "hdop"][["higher", "lower"]].max(axis=None) == 0


def test_cells_that_lose_or_gain_their_fix_are_counted_and_in_no_mean(maps):
    a, b = (maps[0].ds.copy(deep=True) for _ in range(2))
    free = np.argwhere((a["obstacle"].values[0] == 0) & np.isfinite(a["hdop"].values[0, 0]))
    for row, col in free[:5]:
        b["hdop"].values[0, 0, row, col] = np.inf
    for row, col in free[5:8]:
        a["hdop"].values[0, 0, row, col] = np.inf
    found = ju.studies.compare(MetricMaps(a), MetricMaps(b), progress=False)
    row = found.table[found.table.layer == "hdop"].iloc[0]
    assert np.isinf(at(found, "hdop", 20.0)).sum() == 8
    assert row["mean"] == row.rms == 0
    assert (row.lost, row.gained, row.higher, row.lower) == (5, 3, 5, 3)
    assert " 5 lose their fix and 3 gain one (means of DOPs" in found.decided.facts["decided"]


def test_only_the_cells_that_both_hold_are_compared_wherever_they_lie(maps, found):
    a, b = maps
    west, north = MetricMaps(a.ds.isel(x=slice(10, 90))), MetricMaps(b.ds.isel(y=slice(30, None)))
    parts = ju.studies.compare(west, north, progress=False)
    assert parts.a.grid.shape == (50, 80)
    assert (parts.a.grid.first_row, parts.a.grid.first_col) == (450_030, 58_010)
    np.testing.assert_array_equal(at(parts, "risk", 20.0), at(found, "risk", 20.0)[30:, 10:90])
    assert parts.left_out == ()


def test_altitudes_times_of_day_and_layers_of_one_alone_are_left_out(maps):
    a, b = maps
    ds = (
        b.ds.isel(altitude=[1], time_of_day=[1])
        .drop_vars("lidar")
        .assign_attrs(pop_norm_per_km2=[7.0])
    )
    found = ju.studies.compare(a, MetricMaps(ds), progress=False)
    assert found.a.altitudes_m == found.b.altitudes_m == (60.0,)
    assert found.a.times_of_day == ("night",)
    assert found.left_out == ("lidar",)
    want = b.m("population", time_of_day="night") - a.m("population", time_of_day="night")
    np.testing.assert_array_equal(at(found, "population"), want)


def at_time(maps: MetricMaps, *times: str) -> MetricMaps:
    ds = xr.concat(
        [maps.ds] * len(times), "time", data_vars="minimal", coords="minimal", compat="override"
    )
    return MetricMaps(ds.assign_coords(time=np.array(times, "datetime64[ns]")))


def test_single_times_are_set_beside_each_other_and_of_several_those_that_both_hold(maps, found):
    a, b = maps
    first, later = "2020-04-27T16:00:00Z", "2020-04-28T06:00:00Z"
    single = ju.studies.compare(a, at_time(b, later[:-1]), progress=False)
    assert paired_times(single.a, single.b) == {first: later}
    both = at_time(b, later[:-1], "2020-04-29T06:00:00")
    with pytest.raises(ju.InputError, match="share no time"):
        ju.studies.compare(a, both, progress=False)
    several = ju.studies.compare(a, at_time(b, first[:-1], later[:-1]), progress=False)
    assert paired_times(several.a, several.b) == {first: first}
    np.testing.assert_array_equal(at(several, "gps", 60.0), at(found, "gps", 60.0))


def test_the_comparison_shows_itself(found):
    assert repr(found).startswith("MapComparison(decided: B ")
    assert "not decided" in found._repr_html_()
    with pytest.raises(ju.InputError, match=r"layer must be .*got 'gsp'"):
        found.difference("gsp")


def test_the_verdict_names_the_one_setting_that_differs_and_the_mean_over_all_cells(found):
    one = replace(found, settings={"gps.mask_deg": (5.0, 15.0)})
    first, *others = one.decided.verdicts
    means = {name: float(found.difference(name).astype(float).mean()) for name in ("gps", "risk")}
    assert min(means.values()) > 0
    said = " and ".join(f"m_{name} by {mean:.3g}" for name, mean in means.items())
    assert first.sentence.startswith(f"gps.mask_deg 15.0 instead of 5.0 changes {said} on average;")
    unset = replace(found, settings={"buildings.default_height_m": (None, 30.0)})
    said = unset.decided.verdicts[0].sentence
    assert said.startswith("buildings.default_height_m 30.0 instead of none changes")
    rows = found.table[found.table.layer == "obstacle"]
    assert first.n == rows.cells.sum()
    assert (first.facts["closed"], first.facts["opened"]) == (rows.higher.sum(), rows.lower.sum())
    assert [verdict.kind.name for verdict in others] == ["NO_ROUTES", "ONE_TIME"]


def test_guesses_of_one_name_that_differ_are_said_to_be_made_in_another_way(found):
    a = MetricMaps(found.a.ds.assign_attrs(attribute(heights(0.4, "3 by the default of 10 m"))))
    b = MetricMaps(found.b.ds.assign_attrs(attribute(heights(0.4, "3 by the median"))))
    *_, last = replace(found, a=a, b=b).decided.verdicts
    assert "(A: 40 % of heights; B: 40 % of heights in another way)" in last.sentence


@pytest.mark.slow
def test_the_next_command_can_be_pasted(maps, found, tmp_path):
    assert found.decided.facts["next"] == "ju.studies.compare(A, B, routes=40)"
    folders = [each.save(tmp_path / name) for each, name in zip(maps, ("a {b}", "c"), strict=True)]
    folders = [str(folder) for folder in folders]
    named = ju.studies.compare(*folders, progress=False)
    assert shlex.split(named.decided.facts["next"]) == [
        *("jaxurban", "compare", *folders, "--resolution", "10"),
        *("--routes", "40", "-o", f"{folders[1]}_routes_40"),
    ]
    few = ju.studies.compare(*folders, routes=4, progress=False)
    (more,) = re.findall(r"--routes (\d+) -o", few.decided.facts["next"])
    assert int(more) >= 8  # the fewest that have an interval
    # Of equal maps it decides what the weights gain beside the baseline of distance alone.
    same = ju.studies.compare(folders[0], folders[0], routes=4, progress=False)
    words = shlex.split(same.decided.facts["next"])
    assert words[:4] == ["jaxurban", "compare", folders[0], folders[0]]
    assert int(words[words.index("--routes") + 1]) > 4


def test_what_only_one_of_the_maps_guesses_is_said(maps):
    def with_share(share: float, of: int = 0) -> MetricMaps:
        guess = guessed(GuessKind.BEYOND_DATA, share, altitude_m=20.0)[0].to_dict()
        return MetricMaps(maps[of].ds.assign_attrs(guesses=json.dumps([guess])))

    said = ju.studies.compare(with_share(0.17), with_share(0.04, 1), progress=False).decided.facts
    assert "(A: 17 % of lines of sight" in said["not decided"]
    assert "; B: 4 % of lines of sight" in said["not decided"]
    alike = ju.studies.compare(with_share(0.17), with_share(0.17, 1), progress=False).decided
    equal = ju.studies.compare(with_share(0.17), with_share(0.04), progress=False).decided
    # Of what does not differ nothing comes of guesses, nor of the one time.
    assert [verdict.kind.name for verdict in alike.verdicts] == ["CELLS", "NO_ROUTES", "ONE_TIME"]
    assert [verdict.kind.name for verdict in equal.verdicts] == ["CELLS", "NO_ROUTES"]
