"""The sky at a place and along a track: the maps' own answer at centres, exact outlines elsewhere."""

import re
from dataclasses import replace
from functools import cache
from itertools import count

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.io.samples import located
from jaxurban.kernels.dop import unit_vectors
from jaxurban.maps.build import region_of
from jaxurban.receivers import outlines
from jaxurban.receivers.along import sky_from
from jaxurban.receivers.figures import plot_sky
from jaxurban.receivers.sight import Sight
from jaxurban.world.footprints import Footprints
from jaxurban.world.raster import Raster
from tests.embree_scene import CityScene

CRS, X_M, Y_M, SIDE_M = "EPSG:32618", 583_000.0, 4_507_000.0, 2000.0
TIMES = ("2020-04-27T16:00:00Z", "2020-04-27T17:00:00Z")
GPS = ju.Gps(times=TIMES, mask_deg=10.0)
MIDDLE = ju.XY(X_M + SIDE_M / 2, Y_M + SIDE_M / 2)
OF_BOTH = ju.Gps(
    orbits=("sample:shinjuku/gps.tle", "sample:shinjuku/galileo.tle"), times="2018-12-19T03:00:00Z"
)
DOPS = ["gdop", "pdop", "hdop", "vdop", "tdop"]

pytestmark = pytest.mark.filterwarnings("ignore::jaxurban.GuessWarning")


@cache
def city(*more: tuple[float, float, float, float, float]) -> ju.City:
    """Return 2 x 2 km with a wall west and a tower south of the middle, and more boxes: their corners, and heights."""
    boxes = [(940.0, 900.0, 950.0, 1100.0, 70.0), (990.0, 900.0, 1010.0, 920.0, 80.0), *more]
    at = np.add(boxes, [X_M, Y_M, X_M, Y_M, 0.0])
    polygons, none = shapely.box(*at[:, :4].T), np.zeros(len(at))
    buildings = Footprints(polygons, at[:, 4], none, none.astype(np.uint8), none > 0)
    return ju.City(CRS, (X_M, Y_M, X_M + SIDE_M, Y_M + SIDE_M), buildings)


@cache
def maps() -> ju.MetricMaps:
    return ju.build_maps(city(), altitudes_m=(20.0,), gps=GPS, progress=False)


def at_cells(made: ju.MetricMaps, num: int, seed: int) -> tuple[np.ndarray, list[ju.XY]]:
    """Return rows and columns of free cells, ``[2, num]``, and their centres."""
    free = np.argwhere(made.m("obstacle") == 0)
    cells = free[np.random.default_rng(seed).choice(len(free), num, replace=False)].T
    return cells, [ju.XY(*xy) for xy in zip(*made.grid.xy_of_cell(*cells), strict=True)]


@pytest.mark.slow
def test_a_roof_hides_what_is_below_its_edge_and_is_named():
    here = ju.sky(city(), MIDDLE, 20.0, gps=GPS)
    table = here.table
    assert set(table["state"]) == {"seen", "hidden"}
    hidden = table[table["state"] == "hidden"]
    assert set(hidden["roof_height_m"]) <= {70.0, 80.0}
    assert len(hidden)
    assert table.loc[table["state"] == "seen", "roof_height_m"].isna().all()
    rise_m = hidden["roof_distance_m"] * np.tan(np.radians(hidden["elevation_deg"])) + 20.0
    np.testing.assert_allclose(hidden["margin_m"], rise_m - hidden["roof_height_m"], atol=1e-9)
    x_m, y_m = maps().grid.xy_of_lonlat(hidden["roof_lon"], hidden["roof_lat"])
    np.testing.assert_allclose(
        np.hypot(x_m - MIDDLE.x_m, y_m - MIDDLE.y_m), hidden["roof_distance_m"], atol=1e-3
    )
    toward = np.degrees(np.arctan2(x_m - MIDDLE.x_m, y_m - MIDDLE.y_m)) % 360
    np.testing.assert_allclose(toward, hidden["grid_azimuth_deg"], atol=1e-3)
    by_time = table.groupby("time")["state"].value_counts().unstack(fill_value=0)
    np.testing.assert_array_equal(here.dops["num_visible"], by_time["seen"])
    np.testing.assert_array_equal(here.dops["num_hidden"], by_time["hidden"])


def test_the_horizon_of_boxes_is_the_closed_form():
    """The wall stands 50 m west, the tower 80 m south; true north is half a degree off the grid's."""
    horizon_deg = ju.sky(city(), MIDDLE, 20.0, gps=GPS).horizon_deg
    turn_deg = np.degrees(maps().grid.convergence_rad(*maps().grid.lonlat_of_xy(*MIDDLE[:2])))
    for azimuth, away_m, roof_m in ((270, 50.0, 70.0), (300, 50.0, 70.0), (180, 80.0, 80.0)):
        off = np.cos(np.radians(azimuth - turn_deg - (180 if azimuth == 180 else 270)))
        expected = np.degrees(np.arctan2(roof_m - 20.0, away_m / off))
        assert horizon_deg[azimuth] == pytest.approx(max(expected, 10.0), abs=1e-6)
    assert (horizon_deg[:90] == 10.0).all()  # the mask


def test_what_is_unknown_follows_from_place_and_direction_alone():
    at_edge = ju.XY(X_M + SIDE_M - 100.0, Y_M + 1000.0)
    beside = (1910.0, 900.0, 1920.0, 1100.0, 79.0)
    bare, built = (ju.sky(each, at_edge, 20.0, gps=GPS) for each in (city(), city(beside)))
    is_unknown = bare.table["state"] == "unknown"
    assert 0 < is_unknown.sum() < len(is_unknown)
    np.testing.assert_array_equal(is_unknown, built.table["state"] == "unknown")
    assert (built.table["state"] != bare.table["state"]).any()
    assert bare.table.loc[is_unknown, "margin_m"].isna().all()
    assert "their rays leave the known buildings" in " ".join(bare.cautions)
    run_m = 60.0 / np.tan(np.radians(bare.table["elevation_deg"]))
    azimuth = np.radians(bare.table["grid_azimuth_deg"])
    ends = shapely.points(
        at_edge.x_m + run_m * np.sin(azimuth), at_edge.y_m + run_m * np.cos(azimuth)
    )
    np.testing.assert_array_equal(is_unknown, ~shapely.covers(city().known_ground, ends))
    outside = ju.sky(city(), ju.XY(X_M - 50.0, Y_M), 20.0, gps=GPS)
    assert set(outside.table["state"]) == {"unknown"}
    assert np.isinf(outside.dops["hdop"]).all()


def test_a_fix_that_unknown_satellites_decide_on_is_not_known():
    rng = np.random.default_rng(8)
    places = [ju.XY(*xy) for xy in np.add(rng.uniform(0, SIDE_M, (60, 2)), [X_M, Y_M])]
    inside = [ju.XY(X_M + 1000, Y_M + 910)] * 3
    along = ju.sky_along(city(), [*places, *inside], 2.0, TIMES[0], gps=GPS)
    table = along.table
    is_lost = table["num_visible"] < 4  # of one system
    is_open = is_lost & (table["num_visible"] + table["num_unknown"] >= 4)
    assert is_open.sum() > 0
    assert (is_lost & ~is_open).sum() >= 3
    said = " ".join(along.cautions)
    assert f"It is not known whether {is_open.sum()} of 63 rows have a position fix" in said
    assert f"{(is_lost & ~is_open).sum()} of 63 rows are without a position fix." in said


def test_in_a_building_all_is_hidden_and_that_is_said():
    inside = ju.sky(city(), ju.XY(X_M + 1000, Y_M + 910), 20.0, gps=GPS)
    assert set(inside.table["state"]) == {"hidden"}
    assert np.isinf(inside.dops[DOPS]).all(axis=None)
    assert "2 of 2 rows are in a building, where all that is known is hidden." in inside.cautions
    assert set(ju.sky(city(), ju.XY(X_M + 1000, Y_M + 910), 80.5, gps=GPS).table["state"]) == {
        "seen"
    }


def raster(values: np.ndarray, side_m: float) -> Raster:
    """Return a raster of which row 0 is the northernmost."""
    transform = (side_m, 0.0, X_M, 0.0, -side_m, Y_M + SIDE_M)
    return Raster(values.astype(np.float32), transform, CRS)


def test_a_raster_of_roofs_gives_what_its_outlines_give():
    side_m = 5.0
    roofs = np.zeros((400, 400))
    for west, south, east, north, height_m in (
        (940, 900, 950, 1100, 70),
        (990, 900, 1010, 920, 80),
    ):
        roofs[400 - north // 5 : 400 - south // 5, west // 5 : east // 5] = height_m
    of_cells = replace(city(), buildings=None, roofs=raster(roofs, side_m))
    exact, sampled = (ju.sky(each, MIDDLE, 20.0, gps=GPS) for each in (city(), of_cells))
    np.testing.assert_array_equal(exact.table["state"], sampled.table["state"])
    is_hidden = exact.table["state"] == "hidden"
    for name, most in (("margin_m", 1.5), ("roof_height_m", 0.0), ("roof_distance_m", 1.5)):
        np.testing.assert_allclose(
            exact.table[name][is_hidden], sampled.table[name][is_hidden], atol=most
        )
    off_deg = np.abs(exact.horizon_deg - sampled.horizon_deg)
    assert np.mean(off_deg < 1.0) > 0.98  # but for the ends of walls
    roofs[:, 250:] = np.nan  # 250 m east nothing is known
    holed = ju.sky(replace(of_cells, roofs=raster(roofs, side_m)), MIDDLE, 20.0, gps=GPS)
    east = np.sin(np.radians(holed.table["grid_azimuth_deg"]))
    run_m = 60.0 / np.tan(np.radians(holed.table["elevation_deg"]))
    np.testing.assert_array_equal(holed.table["state"] == "unknown", run_m * east > 250.0)


def test_a_hill_hides_what_outlines_do_not_and_has_no_roof():
    """A square ring of hills stands around the middle, as high as it gets from 212.5 m on."""
    away = np.abs(np.arange(80) - 39.5)
    ring = np.maximum(away, away[:, None])
    heights = np.where((ring > 8) & (ring < 14), 205.0, 5.0)
    hilly = replace(city(), terrain=raster(heights, 25.0), terrain_extent_m=city().extent_m)
    here = ju.sky(hilly, MIDDLE, 90.0, gps=GPS)
    table = here.table[here.table["state"] != "unknown"]
    azimuth = np.radians(table["grid_azimuth_deg"])
    away_m = 212.5 / np.maximum(np.abs(np.sin(azimuth)), np.abs(np.cos(azimuth)))
    is_hidden = table["state"] == "hidden"
    rise_m = away_m * np.tan(np.radians(table["elevation_deg"]))
    np.testing.assert_array_equal(is_hidden, rise_m < 205.0 - 95.0)
    assert is_hidden.any()
    assert not is_hidden.all()
    assert table.loc[is_hidden, "roof_height_m"].isna().all()
    assert here.horizon_deg[0] == pytest.approx(np.degrees(np.arctan2(110.0, 212.5)), abs=0.5)


def test_along_a_track_rows_are_the_skies_of_their_places_and_times():
    places, when = [MIDDLE, ju.XY(X_M + 900, Y_M + 1000), MIDDLE], [TIMES[1], TIMES[0], TIMES[0]]
    along = ju.sky_along(city(), places, [20.0, 25.0, 60.0], when, gps=GPS).table
    for row, place in zip(along.to_dict("records"), places, strict=True):
        alone = ju.sky(city(), place, row["altitude_m"], time=row["time"], gps=GPS).dops.iloc[0]
        assert row["num_visible"] == alone["num_visible"]
        assert row["gdop"] == pytest.approx(alone["gdop"], rel=1e-3)
    assert along["time"].tolist() == when


def test_a_table_of_a_track_gives_places_heights_and_times():
    lon, lat = maps().grid.lonlat_of_xy(
        X_M + np.array([900.0, 950.0]), Y_M + np.array([1000.0] * 2)
    )
    columns = {"utc": TIMES[:2], "lon_deg": lon, "lat_deg": lat, "altitude_m": [25.0, 60.0]}
    track = pd.DataFrame(columns)
    along = ju.sky_along(city(), track, gps=GPS).table
    places = list(zip(lon, lat, strict=True))
    listed = ju.sky_along(city(), places, [25.0, 60.0], TIMES[:2], gps=GPS).table
    pd.testing.assert_frame_equal(along, listed)
    lower = ju.sky_along(city(), track, 20.0, TIMES[0], gps=GPS).table
    assert lower[["altitude_m", "time"]].to_numpy().tolist() == [[20.0, TIMES[0]]] * 2
    with pytest.raises(ju.InputError, match="places must have rows of the columns utc, lon_deg"):
        ju.sky_along(city(), track.drop(columns="utc"), gps=GPS)
    with pytest.raises(ju.InputError, match="altitude_m is missing"):
        ju.sky_along(city(), track.drop(columns="altitude_m"), gps=GPS)


@pytest.mark.parametrize("kind", [np.asarray, np.float64, str, float])
def test_a_table_takes_numbers_of_any_kind_such_as_those_of_a_cell(kind):
    lon, lat = ju.Grid.from_bounds((-74.02, 40.71, -74.0, 40.72), 20.0, CRS).lonlat_of_cell(3, 4)
    numbers = {"lon_deg": lon, "lat_deg": lat, "altitude_m": 20.0}
    expected, along = (
        ju.sky_along(city(), pd.DataFrame([{"utc": TIMES[0], **row}] * 2, dtype=object), gps=GPS)
        for row in (numbers, {name: kind(value) for name, value in numbers.items()})
    )
    pd.testing.assert_frame_equal(along.table, expected.table)
    assert along.table[["lon", "lat"]].to_numpy() == pytest.approx(np.array([[lon, lat]] * 2))


@pytest.mark.parametrize("value", [True, "x", None, [1.0], np.array([1.0, 2.0]), np.asarray(True)])
def test_a_table_of_other_things_than_numbers_is_refused(value):
    row = {"utc": TIMES[0], "lon_deg": value, "lat_deg": 40.7, "altitude_m": 20.0}
    with pytest.raises(ju.InputError, match=r"in lon_deg of 2 row\(s\), where a number from -180"):
        ju.sky_along(city(), pd.DataFrame([row] * 2, dtype=object), gps=GPS)


def test_rows_at_0_0_are_left_out_of_a_track_and_counted():
    table = pd.DataFrame({"utc": TIMES[0], "lon_deg": [0, -74.0, 0.0], "lat_deg": [0, 40.71, 0.0]})
    with pytest.warns(
        UserWarning, match="table of places has 2 of 3 places without a fix, at 0, 0"
    ):
        assert len(ju.sky_along(city(), table, 20.0, gps=GPS).table) == 1
    with pytest.raises(ju.InputError, match="has 2 of 2 places without a fix"):
        ju.sky_along(city(), table[::2], 20.0, gps=GPS)


def test_a_row_a_satellite_is_the_sky_of_its_place_with_what_the_log_heard(tmp_path):
    number = count(1)
    text = located("sample:shinjuku/gps.tle").read_text()
    named = re.sub(r"GPS slot .*", lambda _: f"GPS (PRN {next(number):02d})", text)
    (tmp_path / "gps.tle").write_text(named)
    lon, lat = maps().grid.lonlat_of_xy(
        X_M + np.array([900.0, 1000.0]), Y_M + np.array([1000.0] * 2)
    )
    gps = replace(OF_BOTH, orbits=tmp_path / "gps.tle", mask_deg=10.0)
    utc = ["2018-12-19T03:00:00Z", "2018-12-19T03:00:01Z"]
    columns = {"utc": utc, "lon_deg": lon, "lat_deg": lat}
    track = pd.DataFrame(columns)
    plain = ju.sky_along(city(), track, 20.0, gps=gps)
    assert "cn0_dbhz" not in plain.satellites
    first, second = plain.satellites.satellite.str.extract(r"PRN (\d+)")[0].dropna().unique()[:2]
    names = [f"G{first}", f"G{second}", "X99"]
    heard = pd.DataFrame({"satellite": names, "cn0_dbhz": [40.0, 22.5, 30.0]})
    log = track.merge(heard, "cross")
    along = ju.sky_along(city(), log, 20.0, gps=gps)
    pd.testing.assert_frame_equal(along.table, plain.table)
    for number, place in enumerate(zip(lon, lat, strict=True)):
        alone = ju.sky(city(), place, 20.0, time=utc[number], gps=gps).table.drop(columns="time")
        rows = along.satellites[along.satellites.utc == utc[number]]
        assert np.allclose(rows[["lon_deg", "lat_deg"]], [place])
        pd.testing.assert_frame_equal(
            rows[list(alone)].reset_index(drop=True), alone, atol=5e-3, check_exact=False
        )
        named = rows.satellite.str.extract(r"PRN (\d+)")[0]
        expected = named.map({first: 40.0, second: 22.5})
        np.testing.assert_array_equal(rows.cn0_dbhz, expected)
    assert along.satellites.cn0_dbhz.notna().any()


def test_a_route_is_flown_at_its_speed():
    corners = [
        MIDDLE,
        ju.XY(MIDDLE.x_m + 100, MIDDLE.y_m),
        ju.XY(MIDDLE.x_m + 100, MIDDLE.y_m + 45),
    ]
    table = ju.sky_along(city(), corners, 60.0, TIMES[0], speed_m_s=10.0, gps=GPS).table
    assert table["time"].iloc[[0, 10, -1]].tolist() == [
        TIMES[0], "2020-04-27T16:00:10Z", "2020-04-27T16:00:14Z",
    ]  # fmt: skip
    x_m, y_m = maps().grid.xy_of_lonlat(table["lon"], table["lat"])
    np.testing.assert_allclose(np.hypot(np.diff(x_m), np.diff(y_m)), [*[10.0] * 14, 5.0], atol=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"altitude_m": 0.0}, "altitude_m must be a positive"),
        ({"place": (200.0, 95.0)}, "place must be longitude, latitude"),
        ({"place": (float("nan"), 40.7)}, "place must be longitude, latitude"),
        ({"time": "noon"}, "'noon' is not a time"),
        ({"where": "no-folder"}, "no-folder"),
        ({"gps": ju.Gps(mask_deg=89.9)}, "no satellite is above"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_sentence(change, message):
    asked = {"where": city(), "place": MIDDLE, "altitude_m": 20.0, "gps": GPS} | change
    with pytest.raises(ju.InputError, match=message):
        ju.sky(**asked)


def test_numbers_of_places_and_times_that_differ_are_refused():
    with pytest.raises(ju.InputError, match="one for all 2 places or one for each, got 1 and 3"):
        ju.sky_along(city(), [MIDDLE] * 2, 20.0, [TIMES[0]] * 3, gps=GPS)
    with pytest.raises(ju.InputError, match="times must be one, of departure"):
        ju.sky_along(city(), [MIDDLE] * 3, 20.0, [TIMES[0]] * 3, speed_m_s=3.0, gps=GPS)
    with pytest.raises(ju.InputError, match="altitude_m is missing"):
        ju.sky_along(city(), [MIDDLE], gps=GPS)


def test_the_picture_fills_the_horizon_and_names_every_satellite():
    here = ju.sky(city(), MIDDLE, 20.0, gps=GPS)
    (panel,) = plot_sky(here, TIMES[1]).axes
    now = here.table[here.table["time"] == TIMES[1]]
    names = {text.get_text().removesuffix(" ✕") for text in panel.texts}
    assert names == {name.removesuffix(" (nominal)").split()[-1] for name in now["satellite"]}
    labels = panel.get_legend_handles_labels()[1]
    assert labels == ["rings: 60°, 30°", "buildings", "GPS, seen", "GPS, hidden ✕"]
    with pytest.raises(ju.InputError, match=r"time must be .* or "):
        plot_sky(here, "2020-04-27T18:00:00Z")


@cache
def sample(name: str) -> ju.City:
    return ju.sample_city(name)


def clears_m(of: ju.City, place: ju.XY, row: dict) -> np.ndarray:
    """Return by how much a ray clears every building of a city, by brute force; NaN where it does not cross it."""
    azimuth, slope = np.radians(row["grid_azimuth_deg"]), np.tan(np.radians(row["elevation_deg"]))
    end = np.array(place[:2]) + 5000.0 * np.array([np.sin(azimuth), np.cos(azimuth)])
    line = shapely.LineString([place[:2], end])
    shapely.prepare(line)
    polygons = of.standing.polygons
    crosses = shapely.intersects(line, polygons)
    entry_m = np.full(len(polygons), np.nan)
    crossed = shapely.intersection(line, polygons[crosses])
    entry_m[crosses] = shapely.distance(shapely.Point(place[:2]), crossed)
    return 20.0 + entry_m * slope - of.standing.height_m


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lower-manhattan", "shinjuku"])
def test_at_200_places_of_a_sample_embree_agrees_and_50_roofs_are_those_of_brute_force(name):
    of = sample(name)
    polygons, height_m = of.standing.polygons, of.standing.height_m
    scene, tree = CityScene(polygons, height_m), shapely.STRtree(polygons)
    grid, rng = region_of(of, None, 5.0), np.random.default_rng(2)
    sight = Sight.of(of, OF_BOTH, None)
    agree, roofs = [], []
    while len(agree) < 200:
        place = ju.XY(
            float(rng.uniform(grid.x_min_m, grid.x_max_m)),
            float(rng.uniform(grid.y_min_m, grid.y_max_m)),
        )
        if (height_m[tree.query(shapely.Point(place[:2]), predicate="intersects")] >= 20.0).any():
            continue
        table = sky_from(sight, place, 20.0).table
        table = table[table["state"] != "unknown"]
        azimuth, elevation = np.radians(table[["grid_azimuth_deg", "elevation_deg"]].to_numpy().T)
        start = np.tile([*place[:2], 20.0], (len(table), 1))
        distance_m = scene.distance_m(start, unit_vectors(azimuth, elevation))
        agree.append(np.isinf(distance_m) == (table["state"] == "seen"))
        hidden = table[table["state"] == "hidden"]
        if len(hidden) and len(roofs) < 50:
            row = hidden.iloc[int(rng.integers(len(hidden)))].to_dict()
            every_m = clears_m(of, place, row)
            roofs.append(row["roof_height_m"] == height_m[np.nanargmin(every_m)])
            assert row["margin_m"] == pytest.approx(np.nanmin(every_m), abs=1e-6)
    assert np.concatenate(agree).mean() >= 0.995
    assert len(roofs) == 50
    assert all(roofs)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lower-manhattan", "shinjuku"])
def test_a_thousand_places_of_a_city_are_seen(name):
    grid = region_of(sample(name), None, 5.0)
    rng = np.random.default_rng(0)
    x_m = rng.uniform(grid.x_min_m, grid.x_max_m, 1000)
    y_m = rng.uniform(grid.y_min_m, grid.y_max_m, 1000)
    places = [ju.XY(*xy) for xy in zip(x_m.tolist(), y_m.tolist(), strict=True)]
    table = ju.sky_along(sample(name), places, 20.0).table
    assert len(table) == 1000
    # Directions are those from the middle of the places.
    few = ju.sky_along(sample(name), places[:5], 20.0).table
    pd.testing.assert_frame_equal(table.head(5), few, rtol=1e-3)


def test_rays_are_followed_in_parts_and_too_many_are_refused_with_their_number(monkeypatch):
    _, places = at_cells(maps(), 6, seed=3)
    times = [TIMES[k % 2] for k in range(6)]
    whole = ju.sky_along(city(), places, 20.0, times, gps=GPS).table
    monkeypatch.setattr(outlines, "MOST_AT_ONCE", 7)
    assert ju.sky_along(city(), places, 20.0, times, gps=GPS).table.equals(whole)
    monkeypatch.setattr(outlines, "MOST_RAYS", 10)
    with pytest.raises(ju.InputError, match=r"\d+ rays .* 10 are followed at most: give fewer"):
        ju.sky_along(city(), places, 20.0, times, gps=GPS)
