"""Lidar, risk and obstacles on a surface, the population of blocks, and statistics of a metric over time."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from scipy.ndimage import distance_transform_edt

from figures.paper.common import population_totals
from jaxurban.errors import InputError
from jaxurban.kernels.blocks import rounded_up
from jaxurban.kernels.distance.nearest import window_cells
from jaxurban.metrics import lidar
from jaxurban.metrics.lidar import Lidar, compute_lidar
from jaxurban.metrics.population import (
    BlockPopulation,
    Population,
    block_people,
    day_share,
    density_per_km2,
    soft_population,
)
from jaxurban.metrics.risk import Risk, compute_risk
from jaxurban.metrics.variables import series_statistics
from jaxurban.world.blocks import Blocks, Zoning
from jaxurban.world.grid import Grid
from jaxurban.world.surface import Surface, obstacle_mask, soft_obstacle
from tests.metrics.soft.scene import check_gradient
from tests.metrics.whole_maps import population_maps, surface_on

GRID = Grid("EPSG:32618", 5.0, 901_000, 116_000, 70, 62)
REGION = GRID.padded(-10, -10, -10, -10)  # a margin of 50 m
ALTITUDES_M = [20.0, 60.0, 122.0]


RNG = np.random.default_rng(0)
SCATTERED_M = np.where(RNG.random(GRID.shape) < 0.03, RNG.uniform(3, 130, GRID.shape), 0).astype(
    np.float32
)


def solid_by_brute_force(roof_m, terrain_m, altitude_m, threshold_m):
    """Return the distance of each receiver to the nearest column, every pair tried."""
    row, col = np.indices(roof_m.shape)
    nearest_m2 = np.full(roof_m.shape, np.inf)
    for i, j in np.argwhere(roof_m > 0):
        drop_m = np.maximum(terrain_m + altitude_m - terrain_m[i, j] - roof_m[i, j], 0)
        nearest_m2 = np.minimum(nearest_m2, 25.0 * ((row - i) ** 2 + (col - j) ** 2) + drop_m**2)
    return np.minimum(np.sqrt(nearest_m2), threshold_m)


@pytest.mark.parametrize(
    ("distance", "relief_m"), [("slice", 0.0), ("slice", 50.0), ("solid", 0.0), ("solid", 40.0)]
)
def test_the_slice_is_scipys_distance_transform_over_any_terrain_and_the_solid_that_of_brute_force(
    distance, relief_m
):
    roof_m, ground_m = SCATTERED_M, np.random.default_rng(1).uniform(0, relief_m, GRID.shape)
    surface = surface_on(roof_m, GRID, REGION, ground_m if relief_m else None)
    m = compute_risk(surface, ALTITUDES_M, Risk(distance=distance))
    assert m.dtype == jnp.float32
    for altitude_m, got in zip(ALTITUDES_M, m, strict=True):
        if distance == "slice":
            expected_m = np.minimum(distance_transform_edt(roof_m < altitude_m, sampling=5.0), 50)
        else:
            expected_m = solid_by_brute_force(roof_m, ground_m, altitude_m, 50.0)
        np.testing.assert_allclose(got * 50, expected_m[10:-10, 10:-10], atol=1e-3)


def test_one_program_makes_the_risk_of_other_places_resolutions_thresholds_and_altitudes(caplog):
    def mean_risk(resolution_m, first_row, margin, altitude_m, params):
        grid = Grid("EPSG:32618", resolution_m, first_row, 0, 37 + 2 * margin, 41 + 2 * margin)
        roof_m = np.resize(SCATTERED_M, grid.shape)
        around = grid.padded(-margin, -margin, -margin, -margin)
        surface = Surface(roof_m, None, None, None, grid, around)
        return np.asarray(compute_risk(surface, [altitude_m], params)).mean()

    with jax.log_compiles():
        means = [
            mean_risk(5.0, 0, 16, 20.0, Risk(50.0)),
            mean_risk(4.0, 900_000, 3, 60.0, Risk(33.3)),
            mean_risk(2.0, 7, 20, 20.0, Risk(31.0, "solid")),
        ]
    programs = [text for text in caplog.messages if text.startswith("Finished XLA compilation")]
    assert len(programs) <= 1, programs  # none where another test compiled it
    assert len(set(means)) == 3


@pytest.mark.slow
def test_a_traced_threshold_gives_the_maps_of_each_and_the_slope_of_a_share():
    surface, thresholds_m = surface_on(SCATTERED_M, GRID, REGION), jnp.array([20.0, 37.0, 50.0])

    def shares(threshold_m):
        return compute_risk(surface, [20.0], Risk(threshold_m), reach_m=50.0)

    found = jax.jit(jax.vmap(shares))(thresholds_m)
    for threshold_m, m in zip(thresholds_m, found, strict=True):
        np.testing.assert_array_equal(m, compute_risk(surface, [20.0], Risk(float(threshold_m))))
    slope = jax.jacfwd(shares)(jnp.float32(37.0))
    np.testing.assert_allclose(slope, np.where(found[1] < 1, -found[1] / 37, 0), rtol=1e-5)
    with pytest.raises(InputError, match=r"reach_m must be .* that risk threshold_m never exceeds"):
        jax.jit(lambda threshold_m: compute_risk(surface, [20.0], Risk(threshold_m)))(37.0)


def test_the_halo_holds_the_threshold_in_whole_steps():
    halos = [rounded_up(window_cells(cap_m, 5.0)) for cap_m in (1.0, 80.0, 80.1, 81.0, 100.0)]
    assert halos == [16, 16, 32, 32, 32]


@pytest.mark.slow
def test_nothing_stands_beyond_the_surface():
    roof_m, scan = SCATTERED_M[10:-10, 10:-10], Lidar(azimuths=60)
    alone = compute_lidar(surface_on(roof_m, REGION, REGION), [20.0], scan)
    padded = REGION.padded(30, 30, 30, 30)
    among_nothing = compute_lidar(surface_on(np.pad(roof_m, 30), padded, REGION), [20.0], scan)
    assert alone.min() < alone.max()
    np.testing.assert_array_equal(alone, among_nothing)


def test_similar_ranges_share_a_program_and_see_the_more_the_longer_they_are():
    surface = surface_on(SCATTERED_M, GRID, REGION)
    scans = [Lidar(azimuths=60, range_m=range_m) for range_m in (90.0, 100.0, 112.0)]
    before = len(lidar._lidar.programs)
    near, usual, far = (np.asarray(compute_lidar(surface, [20.0], scan)) for scan in scans)
    assert len(lidar._lidar.programs) <= before + 1  # the same where another test compiled it
    assert (near <= usual).all()
    assert (usual <= far).all()
    assert near.mean() < usual.mean() < far.mean()


def test_a_scan_is_given_a_halo_in_steps_of_16_cells_that_matters_as_far_as_its_range():
    surface, scan = surface_on(SCATTERED_M, GRID, REGION), Lidar(azimuths=60)
    assert [lidar.halo_cells(scan, resolution_m) for resolution_m in (10.0, 5.0, 2.0)] == [
        16,
        32,
        64,
    ]
    assert lidar.halo_cells(scan, 5.0, oversample=3) == 32
    within = compute_lidar(replace(surface, most_halo=20), [20.0], scan)
    np.testing.assert_array_equal(within, compute_lidar(surface, [20.0], scan))
    with pytest.raises(InputError, match="looks 100 m sideways"):
        compute_lidar(replace(surface, most_halo=19), [20.0], scan)
    near = compute_risk(replace(surface, most_halo=10), [20.0], Risk(50.0))
    np.testing.assert_array_equal(near, compute_risk(surface, [20.0], Risk(50.0)))
    with pytest.raises(InputError, match="looks 50 m sideways"):
        compute_risk(replace(surface, most_halo=9), [20.0], Risk(50.0))


def test_a_single_beam_lies_in_the_middle_and_several_at_equal_steps():
    np.testing.assert_allclose(
        Lidar(beams=1, field_of_view_deg=(-10, 20)).elevations_rad, np.deg2rad([5])
    )
    np.testing.assert_allclose(
        np.rad2deg(Lidar().elevations_rad), np.arange(-15, 16, 2), atol=1e-12
    )


ROOF_M = jnp.array([0.0, 5.0, 17.9, 18.0, 18.5, 19.0, 19.9, 20.0, 21.0, 300.0])


def test_a_cell_is_an_obstacle_up_to_its_roof_and_free_above_and_bare_ground_is_free_even_at_altitude_zero():
    roof_m, z_m = (
        np.array([[0.0, 19.9, 20.0, 60.0, 60.1]], np.float32),
        np.array([0.0, 20.0, 60.0, 122.0]),
    )
    expected = [[0, 1, 1, 1, 1], [0, 0, 1, 1, 1], [0, 0, 0, 1, 1], [0, 0, 0, 0, 0]]
    np.testing.assert_array_equal(obstacle_mask(roof_m, z_m)[:, 0], expected)


def test_a_soft_obstacle_is_never_less_than_the_exact_one_and_the_same_beyond_one_softness():
    exact = obstacle_mask(ROOF_M[None], [20.0])[0, 0]
    soft = soft_obstacle(ROOF_M, 20.0, 2.0)
    assert np.all(soft >= exact)
    is_near = (ROOF_M > 18) & (ROOF_M < 20)
    np.testing.assert_array_equal(soft[~is_near], exact[~is_near])
    np.testing.assert_allclose(soft[ROOF_M == 19.0], 0.5)


def test_softness_0_is_the_exact_rule_also_where_roof_and_altitude_meet():
    for z_m in (20.0, 18.0, 0.0, -1.0):
        exact = obstacle_mask(ROOF_M[None], [z_m])[0, 0]
        for softness_m in (0.0, 1e-6):
            np.testing.assert_array_equal(soft_obstacle(ROOF_M, z_m, softness_m), exact)


def test_derivatives_of_a_soft_obstacle_equal_central_differences_and_are_0_at_softness_0():
    def total(at):
        return soft_obstacle(at["roof_m"], at["altitude_m"], at["softness_m"]).sum()

    with jax.enable_x64(True):
        at = {"roof_m": np.linspace(17.9, 20.1, 12), "altitude_m": 20.0, "softness_m": 2.0}
        slopes = jax.jit(jax.value_and_grad(total))
        check_gradient(slopes, {name: jnp.asarray(value) for name, value in at.items()}, rtol=1e-6)
        exact = slopes(
            {
                "roof_m": jnp.full(12, 19.0),
                "altitude_m": jnp.asarray(20.0),
                "softness_m": jnp.asarray(0.0),
            }
        )
    assert not any(np.any(slope) for slope in exact[1].values())


@pytest.mark.parametrize("num_times", [1, 2, 7, 24, 288])
def test_statistics_equal_numpys_quantiles(num_times):
    m = np.random.default_rng(num_times).random((num_times, 3, 50), np.float32)
    m[0, 0] = 0.5  # exactly at the threshold: not available
    found = series_statistics(m, 0.5)
    np.testing.assert_allclose(found["median"], np.median(m, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["p05"], np.quantile(m, 0.05, axis=0), atol=1e-6)
    np.testing.assert_allclose(found["availability"], (m > 0.5).mean(axis=0), atol=1e-6)
    assert all(values.dtype == np.float32 for values in found.values())


# Four blocks of 100 m x 100 m in a row: commercial, residential, other, empty.
WEST_M = np.arange(4) * 100.0
BLOCKS = Blocks(
    polygons=shapely.box(WEST_M, 0.0, WEST_M + 100.0, 100.0),
    night_count=np.array([100.0, 400.0, 200.0, 0.0]),
    district=np.array([101, 107, 13, 102], np.int32),
    zoning=np.array(
        [Zoning.COMMERCIAL, Zoning.RESIDENTIAL, Zoning.OTHER, Zoning.COMMERCIAL], np.uint8
    ),
    block_id=np.array(["a", "b", "c", "d"], object),
)
UNEQUAL = replace(BLOCKS, polygons=shapely.box(WEST_M, 0.0, WEST_M + 100.0, [9, 1, 4, 1]))
BLOCK = jnp.array([[0, 1, 2], [3, -1, 0]])


def test_night_is_the_census_day_multiplies_by_gamma_and_the_densest_block_of_the_time_has_m_one():
    maps = population_maps(BLOCK, BLOCKS, ("night", "day"))
    np.testing.assert_allclose(maps.density_per_km2[0], [[1e4, 4e4, 2e4], [0, 0, 1e4]])
    np.testing.assert_allclose(maps.density_per_km2[1], [[3e4, 2e4, 1e4], [0, 0, 3e4]])
    np.testing.assert_allclose(maps.norm_per_km2, [4e4, 3e4])
    np.testing.assert_allclose(maps.m[1], [[1, 2 / 3, 1 / 3], [0, 0, 1]], rtol=1e-6)
    assert maps.m.dtype == jnp.float32


@pytest.mark.parametrize(
    ("blocks", "settings", "bounds_m", "norm", "m"),
    [
        (BLOCKS, {}, None, 4e4, [0.25, 1, 0.5]),
        (
            BLOCKS,
            {},
            (210, 10, 290, 90),
            2e4,
            [0.5, 1, 1],
        ),  # only blocks that touch the region count
        (BLOCKS, {"normalise": 2e4}, None, 2e4, [0.5, 1, 1]),
        (
            BLOCKS,
            {"normalise": "p50"},
            None,
            2e4,
            [0.5, 1, 1],
        ),  # the median of the three inhabited blocks
        (UNEQUAL, {"quantity": "count"}, None, 400, [0.25, 1, 0.5]),  # counts ignore the area
    ],
)
def test_a_number_a_percentile_or_the_greatest_of_the_region_normalises_and_clips(
    blocks, settings, bounds_m, norm, m
):
    maps = population_maps(BLOCK, blocks, ("night",), Population(**settings), bounds_m)
    np.testing.assert_allclose(maps.norm_per_km2, [norm])
    np.testing.assert_allclose(maps.m[0], [m, [0, 0, m[0]]])


def test_a_region_without_people_has_m_zero_everywhere():
    empty = replace(BLOCKS, night_count=np.zeros(4))
    for normalise in ("max", "p95"):
        maps = population_maps(BLOCK, empty, ("day",), Population(normalise=normalise))
        assert not np.any(maps.m)
    nobody = population_maps(BLOCK, BLOCKS, ("day",), bounds_m=(5000, 5000, 5001, 5001))
    assert np.all(np.isfinite(nobody.m))


def test_a_block_without_area_has_density_zero_and_finite_gradients():
    def density(area_m2):
        return density_per_km2(
            block_people(jnp.array([5.0]), jnp.array([2]), 1.0, 3.0, 0.5), area_m2
        ).sum()

    assert density(jnp.zeros(1)) == 0
    assert jax.grad(density)(jnp.zeros(1)) == 0


def test_hours_of_the_week_move_between_night_and_day():
    assert day_share("night") == day_share("weekday-03") == 0.0
    assert day_share("day") == day_share("weekday-12") == 1.0
    assert 0.0 < day_share("weekday-08") < 1.0
    # Moss and Qing (2012), in millions: 2.05 at night, 2.90 on a weekend day, 3.94 on a working day.
    assert 2.05 + day_share("weekend-12") * (3.94 - 2.05) == pytest.approx(2.90)
    share = day_share("weekday-08")
    night, hour = population_maps(BLOCK, BLOCKS, ("night", "weekday-08")).density_per_km2
    np.testing.assert_allclose(
        hour[0], night[0] * (1 + share * np.array([2.0, -0.5, -0.5])), rtol=1e-6
    )


def test_totals_add_up_by_zoning():
    totals = population_totals(BLOCKS)
    assert totals["night"] == {
        "commercial": 100.0,
        "residential": 400.0,
        "other": 200.0,
        "total": 700.0,
    }
    assert totals["day"] == {
        "commercial": 300.0,
        "residential": 200.0,
        "other": 100.0,
        "total": 600.0,
    }
    assert population_totals(BLOCKS, bounds_m=(110, 10, 190, 90))["night"]["total"] == 400.0
    box = (
        125.0,
        0.0,
        300.0,
        50.0,
    )  # three eighths of the residential block and half of the other one
    assert population_totals(BLOCKS, bounds_m=box)["night"]["total"] == 600.0
    inside = population_totals(BLOCKS, bounds_m=box, is_cut=True)
    assert inside["night"]["residential"] == pytest.approx(400 * 0.75 * 0.5)
    assert inside["night"]["other"] == pytest.approx(200 * 0.5)
    assert inside["day"]["total"] == pytest.approx(0.5 * inside["night"]["total"])


# Twelve blocks side by side, of which the last two lie beyond the bounds.
BOUNDS_M, DRAW = (0.0, 0.0, 950.0, 100.0), np.random.default_rng(0)
ZONING = DRAW.permutation(np.repeat([Zoning.COMMERCIAL, Zoning.RESIDENTIAL], 6)).astype(np.uint8)
EAST_M = 100.0 * np.arange(12)
ROW = Blocks(
    polygons=shapely.box(EAST_M, 0.0, EAST_M + DRAW.uniform(40, 90, 12), 100.0),
    night_count=DRAW.uniform(10, 500, 12),
    district=np.zeros(12, np.int32),
    zoning=ZONING,
    block_id=np.arange(12).astype(object),
)
CELLS = jnp.asarray(np.random.default_rng(1).integers(-1, 12, (6, 7)), jnp.int32)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("time_of_day", "normalise"), [("day", "max"), ("night", 30_000.0), ("weekend-20", "p80")]
)
def test_as_a_function_of_gammas_and_counts_it_is_the_metrics_own_map(time_of_day, normalise):
    params = Population(normalise=normalise)
    expected = population_maps(CELLS, ROW, [time_of_day], params, BOUNDS_M).m[0]
    population, cells = BlockPopulation.of(ROW, BOUNDS_M), np.array([[0, 0], [5, 6], [2, 3]])
    np.testing.assert_array_equal(soft_population(CELLS, population, time_of_day, params), expected)
    at_cells = soft_population(CELLS, population, time_of_day, params, cells=cells)
    np.testing.assert_array_equal(at_cells, expected[*cells.T])


@pytest.mark.parametrize(
    ("quantity", "normalise"),
    [("density", "max"), ("density", "p80"), ("density", 150_000.0), ("count", "max")],
)
def test_gradients_of_population_agree_with_finite_differences(quantity, normalise):
    params = Population(normalise=normalise, quantity=quantity)
    with jax.enable_x64(True):
        population, weight = (
            BlockPopulation.of(ROW, BOUNDS_M, np.float64),
            DRAW.uniform(size=CELLS.shape),
        )

        @jax.jit
        @jax.value_and_grad
        def total(inputs):
            gammas = {name: inputs[name] for name in ("gamma_commercial", "gamma_residential")}
            those = population._replace(
                night_count=inputs["night_count"], area_m2=1e4 * inputs["area_ha"]
            )
            return (
                weight * soft_population(CELLS, those, "weekday-18", replace(params, **gammas))
            ).sum()

        gammas = {"gamma_commercial": jnp.asarray(2.0), "gamma_residential": jnp.asarray(0.6)}
        inputs = {
            "night_count": population.night_count,
            "area_ha": population.area_m2 / 1e4,
        } | gammas
        check_gradient(total, inputs, zero={"area_ha"} if quantity == "count" else (), rtol=1e-6)


def test_gammas_are_leaves_of_the_settings_and_batches_take_no_new_compilation():
    population = BlockPopulation.of(ROW, BOUNDS_M)

    @jax.jit
    def m(params, night_count):
        return soft_population(CELLS, population._replace(night_count=night_count), "day", params)

    several = [
        Population(gamma_commercial=g, gamma_residential=h) for g, h in ((3.0, 0.5), (2.0, 0.7))
    ]
    one_by_one = jnp.stack([m(params, population.night_count) for params in several])
    assert m._cache_size() == 1
    stacked = jax.tree.map(lambda *gammas: jnp.asarray(gammas), *several)
    np.testing.assert_allclose(
        jax.vmap(m, (0, None))(stacked, population.night_count), one_by_one, rtol=1e-6
    )
