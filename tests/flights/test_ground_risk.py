"""Density beneath a corridor: means and places are those of brute force over the raster; what is unknown is said."""

import json
import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import shapely

import jaxurban as ju
from jaxurban.flights.ground_risk import GATHERINGS, RESIDENTS
from jaxurban.knowledge import Guess, GuessKind
from jaxurban.paths.route_report import GRIDS_M
from tests.cli_runs import run
from tests.guess_records import FLAT, attribute
from tests.made_maps import made_maps
from tests.volumes import made_path

WIDTHS = {"half_width_m": 15.0, "contingency_m": 10.0, "buffer_m": 35.0}
REACH_M = sum(WIDTHS.values())


@pytest.fixture(scope="module")
def holed() -> ju.MetricMaps:
    """Maps of 30 m cells, which no grid of 100 or 200 m nests, with a hole in the data."""
    maps = made_maps(60, 70, resolution_m=30.0)
    density = maps.ds["density"].copy()
    density[:, 20:33, 25:50] = np.nan
    return ju.MetricMaps(maps.ds.assign(density=density))


def overlap_m(first, first_m, second, second_m) -> float:
    low, high = max(first * first_m, second * second_m), 0.0
    high = min((first + 1) * first_m, (second + 1) * second_m)
    return max(high - low, 0.0)


def brute_force(maps, line, side_m, time_of_day) -> list[tuple]:
    """Return mean, known share, row and column of each cell of a grid that the corridor touches, one by one."""
    grid, density = maps.grid, maps.m("density", time_of_day=time_of_day)
    x_min, y_min, x_max, y_max = line.bounds
    cells = []
    for row in range(
        math.floor((y_min - REACH_M) / side_m) - 1, math.ceil((y_max + REACH_M) / side_m) + 1
    ):
        for col in range(
            math.floor((x_min - REACH_M) / side_m) - 1, math.ceil((x_max + REACH_M) / side_m) + 1
        ):
            square = shapely.box(col * side_m, row * side_m, (col + 1) * side_m, (row + 1) * side_m)
            if square.distance(line) > REACH_M:
                continue
            people = known_m2 = 0.0
            first = math.floor(row * side_m / grid.resolution_m) - grid.first_row
            for y in range(max(first, 0), min(first + 40, grid.num_rows)):
                tall_m = overlap_m(row, side_m, grid.first_row + y, grid.resolution_m)
                start = math.floor(col * side_m / grid.resolution_m) - grid.first_col
                for x in range(max(start, 0), min(start + 40, grid.num_cols)):
                    m2 = tall_m * overlap_m(col, side_m, grid.first_col + x, grid.resolution_m)
                    if m2 and np.isfinite(density[y, x]):
                        people += m2 * float(density[y, x])
                        known_m2 += m2
            mean = people / known_m2 if known_m2 else math.nan
            cells.append((mean, known_m2 / side_m**2, row, col))
    return cells


def random_line(maps, seed) -> np.ndarray:
    """Return 2 to 6 points of the maps, in their CRS; every fourth line ends beyond the border."""
    rng, grid = np.random.default_rng(seed), maps.grid
    low, high = np.array(grid.bounds_m[:2]), np.array(grid.bounds_m[2:])
    points_m = rng.uniform(low + 40, high - 40, (rng.integers(2, 7), 2))
    if seed % 4 == 0:
        points_m[-1, 0] = high[0] + 250
    return points_m


@pytest.mark.slow
@pytest.mark.parametrize("side_m", GRIDS_M)
def test_means_and_places_are_those_of_brute_force_on_20_routes(side_m, holed):
    num_partly = 0
    for seed in range(20):
        points_m = random_line(holed, seed)
        line = shapely.LineString(points_m)
        density = ju.overflown_density(holed, points_m, **WIDTHS, cell_m=side_m)
        assert [*density.largest["cell_m"].unique()] == [*GRIDS_M]
        for name in holed.times_of_day:
            cells = brute_force(holed, line, side_m, name)
            mean, share, row, col = max(cells, key=lambda cell: (cell[0] == cell[0], cell[0]))
            got = density.largest.query("cell_m == @side_m and time_of_day == @name").iloc[0]
            assert got["density_per_km2"] == pytest.approx(mean, rel=1e-12)
            assert got["known_share"] == pytest.approx(share, rel=1e-12)
            middle = (np.array([col, row]) + 0.5) * side_m
            np.testing.assert_allclose(
                holed.grid.xy_of_lonlat(got["lon"], got["lat"]), middle, atol=1e-3
            )
            along_m = line.project(shapely.Point(middle))
            assert got["along_m"] == pytest.approx(along_m, abs=1e-6)
            shares = np.array([cell[1] for cell in cells])
            assert got["num_cells"] == len(cells)
            assert got["num_unknown"] == (shares == 0).sum()
            num_partly += int(got["num_partly_known"])
            of_segments = density.segments.query("time_of_day == @name")
            assert of_segments["density_per_km2"].max() == got["density_per_km2"]
        assert (
            density.density_per_km2
            == density.largest.query("cell_m == @side_m")["density_per_km2"].max()
        )
    assert num_partly > 20


def test_a_segment_has_the_largest_mean_of_the_cells_near_itself(holed):
    points_m = random_line(holed, 3)
    line = shapely.LineString(points_m)
    density = ju.overflown_density(holed, points_m, **WIDTHS, time_of_day="night", num_segments=4)
    ends_m = np.linspace(0, line.length, 5)
    assert density.segments["to_m"].tolist() == pytest.approx(ends_m[1:].tolist())
    for number, (from_m, to_m) in enumerate(pairwise(ends_m), start=1):
        places = np.array(
            [line.interpolate(at_m).coords[0] for at_m in np.linspace(from_m, to_m, 400)]
        )
        part = shapely.LineString(places)  # bends are missed by a metre or two
        cells = brute_force(holed, part, 200.0, "night")
        known = max(mean for mean, *_ in cells if mean == mean)
        assert density.segments.loc[number, "density_per_km2"] == pytest.approx(known, rel=1e-9)


def test_what_is_unknown_is_never_empty_and_is_said(holed):
    grid = holed.grid
    y_m = grid.y_min_m + 26 * grid.resolution_m
    through = np.array([[grid.x_min_m + 300, y_m], [grid.x_max_m - 300, y_m]])
    density = ju.overflown_density(holed, through, **WIDTHS)
    assert any("reach beyond what is known" in each for each in density.cautions)
    inside = grid.x_min_m + np.array([35.0, 40.0]) * grid.resolution_m
    with pytest.raises(ju.InputError, match="no density of people is known"):
        ju.overflown_density(
            holed,
            np.column_stack([inside, [y_m, y_m]]),
            half_width_m=1.0,
            buffer_m=0.0,
            cell_m=20.0,
        )
    whole = ju.overflown_density(made_maps(), random_line(made_maps(), 1), **WIDTHS)
    assert density.cautions[-2:] == [RESIDENTS, GATHERINGS] == whole.cautions[-2:]


def test_by_day_alone_nobody_is_called_a_resident_and_guesses_are_passed_on():
    factors = {"commercial": 3.0, "residential": 0.5}
    by_factors = Guess(GuessKind.PEOPLE_BY_FACTORS, facts=factors)
    of_layer = Guess(GuessKind.BEYOND_LAYER, 0.5, facts={"layer": "nobody"})
    guesses = attribute(by_factors, FLAT, of_layer)
    maps = made_maps()
    maps = ju.MetricMaps(maps.ds.assign_attrs(guesses))
    density = ju.overflown_density(maps, random_line(maps, 1), **WIDTHS, time_of_day="day")
    assert density.cautions == ["Guessed: people by factors.", GATHERINGS]
    assert density.cautions[0].level == "guess"
    assert density.source == "© a made city"


def test_the_buffer_is_as_wide_as_the_flight_is_high_where_none_is_named():
    maps = made_maps()
    points_m = random_line(maps, 2)
    path = made_path(maps.grid, points_m, np.linspace(20, 60, len(points_m)))
    for line in (path, np.column_stack([points_m, path.z_m])):
        density = ju.overflown_density(maps, line, half_width_m=5.0)
        assert (density.settings["buffer_m"], density.reach_m) == (60.0, 65.0)
    with pytest.raises(ju.InputError, match=r"buffer_m must be given.*\[N, 3\]"):
        ju.overflown_density(maps, points_m, half_width_m=5.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"half_width_m": 0.0}, "half_width_m must be a positive number"),
        ({"contingency_m": -1.0}, "contingency_m must be 0 or a positive number"),
        ({"cell_m": 0.01}, "cells around the path"),
        ({"num_segments": 0}, "num_segments must be a whole number from 1"),
        ({"time_of_day": "noon"}, "no maps for time of day noon"),
        ({"path": np.zeros((3, 4))}, r"points \[N, 2\]"),
        ({"path": np.array([[0.0, np.nan]])}, "finite"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(changes, words):
    maps = made_maps()
    given = {"path": random_line(maps, 1), **WIDTHS} | changes
    with pytest.raises(ju.InputError, match=words):
        ju.overflown_density(maps, **given)


def test_maps_without_people_are_refused():
    maps = made_maps()
    maps = ju.MetricMaps(maps.ds.drop_vars(["density", "population"]))
    with pytest.raises(ju.InputError, match=r"hold no density.*ju\.Population"):
        ju.overflown_density(maps, np.zeros((2, 3)), half_width_m=5.0)


def test_the_command_reports_density_below_a_route_in_words_and_in_json(
    maps, folder, ends, capsys, tmp_path
):
    path = ju.plan(maps, altitude_m=20.0, **ends)
    route = ("check", folder, path.save(tmp_path / "route.geojson"))
    words = ("--corridor", "10,contingency_m=5,buffer_m=15,cell_m=150")
    code, out, err = run(capsys, *route, *words, "--json")
    assert code in (0, 5, 6), err
    record = json.loads(out)["density"]
    assert record["buffer_m"] == 15.0
    assert [row["cell_m"] for row in record["largest"]][:4] == [100.0, 150.0, 200.0, 500.0]
    density = ju.overflown_density(
        maps, path, half_width_m=10.0, contingency_m=5.0, buffer_m=15.0, cell_m=150.0
    )
    assert record["density_per_km2"] == pytest.approx(density.density_per_km2)
    pd.testing.assert_frame_equal(
        pd.DataFrame(record["largest"]), density.largest, check_exact=False, atol=0.1, rtol=1e-3
    )
    _, out, _ = run(capsys, *route, *words)
    assert GATHERINGS in out
    assert "people per km2 over a cell of 150 m" in out
    code, _, err = run(capsys, *route, "--corridor", "buffer_m=15")
    assert (code, "half_width_m" in err) == (2, True)
