"""Soft metrics of one scene: derivatives, limits (of Lower Manhattan too), types, chosen cells, batches, programs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.cities.synthetic import demo_city
from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.rasterise import build_surface, building_index, rasterise
from jaxurban.kernels.dop import unit_vectors
from jaxurban.kernels.shadows.sweep import digital_line, shadow_height
from jaxurban.metrics.gps import Gps, soft_gps
from jaxurban.metrics.lidar import Lidar, compute_lidar, soft_lidar
from jaxurban.metrics.risk import Risk, compute_risk, soft_risk
from jaxurban.metrics.visibility import SkyView
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from jaxurban.world.surface import NO_BUILDING, roofs_of
from tests.made_maps import city_of_boxes
from tests.metrics.soft.scene import (
    ALTITUDE_M,
    AZIMUTH_RAD,
    BUILDING,
    CASES,
    CELLS,
    ELEVATION_RAD,
    GRID,
    HALO,
    HEIGHT_M,
    REGION,
    check_gradient,
    surface_of,
)
from tests.metrics.whole_maps import compute_gps, gdop_by_inverse

MIX = np.random.default_rng(1).uniform(0.5, 1.5, REGION.shape)
WINDOW = REGION.window_in(GRID)
HAS_ROOF = (BUILDING >= 0)[WINDOW]


@partial(jax.jit, static_argnums=0)
@partial(jax.value_and_grad, argnums=1, has_aux=True)
def mix_and_slopes(name, inputs, view):
    m = CASES[name].m(inputs, view)
    return jnp.sum(jnp.asarray(MIX, m.dtype) * m), m


BY_CASE = [  # the others take longer to compile, with their derivatives
    pytest.param(name, marks=[pytest.mark.slow] * (name != "risk")) for name in CASES
]


@partial(jax.jit, static_argnums=0)
def map_of(name, inputs, view):
    return CASES[name].m(inputs, view)


def soft_map(name, **changes):
    """Return the float32 map of a case."""
    return map_of(name, CASES[name].inputs(np.float32, **changes), CASES[name].view())


def apart(name, softness_m, z_m=ALTITUDE_M):
    exact = CASES[name].exact(CASES[name].surface(), z_m)
    return jnp.abs(soft_map(name, softness_m=softness_m, altitude_m=z_m) - exact)


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_CASE)
def test_derivatives_equal_central_differences_and_float32_keeps_the_values(name):
    with jax.enable_x64(True):
        view, inputs = CASES[name].view(np.float64), CASES[name].inputs()

        def value_and_gradient(inputs):
            (value, _), gradient = mix_and_slopes(name, inputs, view)
            return value, gradient

        check_gradient(
            value_and_gradient, inputs, zero={"softness_m"} if name.startswith("solid") else ()
        )
        m = mix_and_slopes(name, inputs, view)[0][1]
    assert soft_map(name).dtype == np.float32
    np.testing.assert_allclose(soft_map(name), m, atol=1e-4 if name == "gps" else 1e-5)


@pytest.mark.slow
def test_float32_keeps_slopes_of_gps_to_1e_3_of_the_largest():
    case = CASES["gps"]
    with jax.enable_x64(True):
        _, expected = mix_and_slopes("gps", case.inputs(), case.view(np.float64))
    _, found = mix_and_slopes("gps", case.inputs(np.float32), case.view())
    for name, slope in expected.items():
        assert found[name].dtype == np.float32
        np.testing.assert_allclose(found[name], slope, atol=1e-3 * np.abs(slope).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_CASE)
def test_one_program_serves_all_altitudes_limits_softnesses_heights_and_skies(name):
    case = CASES[name]
    for program, dtype in ((map_of, np.float32), (mix_and_slopes, np.float64)):
        with jax.enable_x64(dtype == np.float64):
            start = program._cache_size()
            for i, softness_m in enumerate((2.0, 0.1, 0.0)):
                changes = {
                    "altitude_m": ALTITUDE_M + i,
                    "limit": case.limit - i,
                    "height_m": HEIGHT_M * (1 + i / 10),
                }
                found = program(
                    name,
                    case.inputs(dtype, softness_m=softness_m, **changes),
                    case.view(dtype, 0.1 * i),
                )
                assert all(np.all(np.isfinite(values)) for values in jax.tree.leaves(found))
            assert program._cache_size() <= start + 1


@pytest.mark.parametrize("name", BY_CASE)
def test_softness_0_is_the_exact_map_and_the_solid_has_no_softness(name):
    exact = CASES[name].exact(CASES[name].surface(), ALTITUDE_M)
    assert 0.05 < exact.mean() < 0.95
    for z_m in (ALTITUDE_M, 3.0):
        assert apart(name, 3.0 if name.startswith("solid") else 0.0, z_m).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gps", "lidar", "lidar over hills", "risk"])
def test_each_halving_of_the_softness_comes_nearer_to_the_exact_map(name):
    """Of the slice until no roof lies so little below."""
    halvings, last = (range(-5, 8), 1e-6) if name == "risk" else (range(-3, 7), 1e-3)
    means = np.array([float(apart(name, 2.0**-power).mean()) for power in halvings])
    is_apart = means[:-1] > 1e-6
    assert is_apart.sum() > (3 if name == "risk" else 8)
    assert (np.diff(means)[is_apart] < 0).all()
    assert means[-1] < last


def test_a_softness_of_the_threshold_makes_the_solid_of_the_slice():
    solid = compute_risk(CASES["risk"].surface(), [ALTITUDE_M], Risk(39.0, "solid"))[0]
    np.testing.assert_allclose(soft_map("risk", softness_m=39.0), solid, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gps", "lidar", "risk"])
def test_a_roof_at_the_altitude_is_an_obstacle_at_every_softness(name):
    height_m = np.full(len(HEIGHT_M), 20.0, np.float32)
    for softness_m in (0.0, 1.0, 2.0):
        m = soft_map(name, softness_m=softness_m, altitude_m=20.0, height_m=height_m)
        if name == "risk":
            np.testing.assert_allclose(
                m, CASES[name].exact(surface_of(height_m, BUILDING), 20.0), atol=1e-6
            )
        assert (m[HAS_ROOF] == 0).all()
        assert (m[~HAS_ROOF] > 0).any()
    just_below = soft_map(name, softness_m=2.0, altitude_m=20.0, height_m=height_m - 0.1)
    assert (just_below[HAS_ROOF] < 0.06).all()


def test_level_terrain_changes_nothing_of_the_lidar():
    level = soft_map("lidar over hills", terrain_m=np.full(BUILDING.shape, 30.0))
    np.testing.assert_allclose(level, soft_map("lidar"), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gps", "lidar", "risk"])
def test_chosen_cells_with_altitudes_of_their_own_and_batches_give_the_values_of_the_map(name):
    """Satellites that fill up change nothing: those of the map are filled up, those of the cells are not."""
    case, own_m = CASES[name], jnp.array([-8.0, 0.0, 9.0, -8.0, 0.0])
    several = [
        case.inputs(np.float32, height_m=HEIGHT_M * (1 - i / 10), limit=case.limit - i)
        for i in range(2)
    ]
    if name == "gps":
        filled, alone = (case.view(multiple_of=number).lines.drop_m for number in (32, 1))
        assert len(alone) < len(filled) == 32
        several = [inputs | {"drop_m": alone} for inputs in several]

    @jax.jit
    @jax.vmap
    def at_cells(inputs):
        return case.m(
            inputs | {"altitude_m": inputs["altitude_m"] + own_m}, case.view(multiple_of=1), CELLS
        )

    found = at_cells(jax.tree.map(lambda *values: jnp.stack(values), *several))
    assert len(np.unique(found)) > 3
    for i, cells_m in enumerate(found):
        changes = {"height_m": HEIGHT_M * (1 - i / 10), "limit": case.limit - i}
        for at, (row, col) in enumerate(CELLS):
            expected = soft_map(name, altitude_m=ALTITUDE_M + own_m[at], **changes)[row, col]
            np.testing.assert_allclose(cells_m[at], expected, atol=1e-6)


@pytest.mark.slow
def test_of_gps_a_higher_roof_never_helps_and_a_higher_receiver_never_harms():
    with jax.enable_x64(True):
        _, slopes = mix_and_slopes("gps", CASES["gps"].inputs(), CASES["gps"].view(np.float64))
    assert np.asarray(slopes["roof_m"]).max() <= 0 < float(slopes["altitude_m"])


@pytest.mark.slow
def test_softness_0_has_no_gradient_of_gps_by_heights_and_the_exact_one_of_the_slice_by_its_threshold():
    found = {}
    for name, softness_m in (("gps", 0.0), ("risk", 0.0)):
        with jax.enable_x64(True):
            inputs = CASES[name].inputs(softness_m=softness_m)
            found[name] = jax.tree.map(
                np.asarray, mix_and_slopes(name, inputs, CASES[name].view(np.float64))
            )
    assert not found["gps"][1]["height_m"].any()
    (_, m), slopes = found["risk"]
    np.testing.assert_allclose(
        slopes["limit"], -(MIX * m)[m < 1].sum() / CASES["risk"].limit, rtol=1e-9
    )


@pytest.mark.slow
def test_of_risk_a_roof_above_the_altitude_has_no_gradient_and_one_below_brings_risk_as_it_grows():
    height_m = np.where(np.arange(len(HEIGHT_M)) % 2, 30.0, 18.0)
    with jax.enable_x64(True):
        inputs = CASES["risk"].inputs(height_m=height_m, altitude_m=20.0, softness_m=4.0)
        slope = np.asarray(
            mix_and_slopes("risk", inputs, CASES["risk"].view(np.float64))[1]["height_m"]
        )
    assert (slope[1::2] == 0).all()
    assert (slope[::2] <= 0).all()
    assert (slope[::2] < 0).any()


@pytest.mark.slow
@pytest.mark.parametrize(("num", "wall_m"), [(0, 0.0), (9, 5000.0)])
def test_where_no_satellite_is_there_or_seen_m_and_its_slopes_are_0_and_not_nan(num, wall_m):
    with jax.enable_x64(True):
        view = CASES["gps"].view(np.float64, num=num)
        ground_m = np.pad(np.zeros(REGION.shape), HALO, constant_values=wall_m)
        inputs = CASES["gps"].inputs(softness_m=1e-3, terrain_m=ground_m, drop_m=view.lines.drop_m)
        found = mix_and_slopes("gps", inputs, view)
    assert not any(np.any(values) for values in jax.tree.leaves(found))


@pytest.mark.slow
def test_soft_gps_equals_its_definition_cell_by_cell():
    case, softness_m, angles = CASES["gps"], 2.0, (AZIMUTH_RAD, ELEVATION_RAD)
    with jax.enable_x64(True):
        (_, found), _ = mix_and_slopes("gps", case.inputs(), case.view(np.float64))
        roof_m, place = (
            case.surface(np.float64).roof_m,
            (GRID.resolution_m, GRID.first_row, GRID.first_col, GRID.shape),
        )
        lines = [digital_line(*toward, *place) for toward in zip(*angles, strict=True)]
        shadows_m = np.array([shadow_height(roof_m + case.ground_m, line) for line in lines])
    clear_m = (case.ground_m + ALTITUDE_M - shadows_m)[:, *WINDOW]
    gdop = gdop_by_inverse((1 + np.exp(-clear_m / softness_m)) ** -2, unit_vectors(*angles))
    roof_m = np.asarray(roof_m)[WINDOW]
    t = np.where(roof_m > 0, np.clip((ALTITUDE_M - roof_m) / softness_m, 0, 1), 1)
    expected = (
        t**3
        * (10 - 15 * t + 6 * t**2)
        * (case.limit - np.minimum(gdop, case.limit))
        / (case.limit - 1)
    )
    assert np.mean((expected > 0) & (expected < 0.85)) > 0.1
    assert (expected == 0).any()
    np.testing.assert_allclose(found, expected, atol=1e-9)


def exact_gps(surface, altitudes_m, params):
    return compute_gps(surface, AZIMUTH_RAD, ELEVATION_RAD, altitudes_m, params).m


def soft_gps_of(surface, altitude_m, params, softness_m):
    view = SkyView.of(surface, AZIMUTH_RAD, ELEVATION_RAD)
    return soft_gps(surface, altitude_m, params.gdop_threshold, softness_m, view)


GPS = exact_gps, soft_gps_of, Gps(), range(-3, 6)
LIDAR, RISK = (
    (compute_lidar, soft_lidar, Lidar(), range(-3, 7)),
    (compute_risk, soft_risk, Risk(), range(-3, 4)),
)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(("exact", "soft", "params", "powers"), [GPS, LIDAR, RISK])
def test_each_halving_comes_nearer_to_lower_manhattan_and_the_last_map_is_its_own_but_for_half_a_percent(
    data_dir, exact, soft, params, powers
):
    bounds, halo = (-74.02, 40.70, -73.98, 40.73), 21  # cells of 5 m
    city = City.from_files(data_dir / "osm" / "lower-manhattan.osm.pbf", bounds=bounds)
    region = Grid.from_bounds(bounds, 5.0, city.crs)
    surface = build_surface(city, region, region.padded(halo, halo, halo, halo))
    expected = exact(surface, [20.0], params)[0]
    of_softness = jax.jit(lambda softness_m: soft(surface, 20.0, params, softness_m))
    apart = [np.asarray(jnp.abs(of_softness(2.0**-power) - expected)) for power in powers]
    assert (np.diff([values.mean() for values in apart]) < 0).all()
    assert (apart[-1] > 0.01).mean() < 0.005
    np.testing.assert_allclose(of_softness(0.0), expected, atol=1e-6)


EIGHT = Grid(GRID.crs, 5.0, 0, 0, 8, 8)


def test_roofs_by_index_are_the_burnt_roofs_exactly():
    city = demo_city(600, 500)
    x_min, y_min = city.extent_m[:2]
    grid = Grid(city.crs, 5.0, round(y_min / 5), round(x_min / 5), 100, 120)
    building = building_index(city, grid)
    assert building.dtype == np.int32
    height_m = city.buildings.height_m.astype(np.float32)
    roof_m = rasterise(city, grid).roof_m
    assert (building == NO_BUILDING).any()
    np.testing.assert_array_equal(roofs_of(jnp.asarray(height_m), jnp.asarray(building)), roof_m)
    region = grid.padded(-5, -5, -5, -5)
    surface = build_surface(city, region, grid)
    np.testing.assert_array_equal(
        surface.with_heights(
            jnp.asarray(2 * height_m), jnp.asarray(building), jnp.asarray(height_m)
        ).roof_m,
        2 * roof_m,
    )


def test_where_buildings_overlap_the_higher_one_has_the_cell_and_all_of_the_gradient():
    city = city_of_boxes([(0, 0, 20, 20), (10, 10, 30, 30), (12, 12, 18, 18)], [30, 20, 10], 40.0)
    building = building_index(city, EIGHT)
    np.testing.assert_array_equal(
        np.unique(building), [NO_BUILDING, 0, 1]
    )  # the third one is covered
    gradient = jax.grad(lambda h: roofs_of(h, jnp.asarray(building)).sum())(
        jnp.asarray([30.0, 20.0, 10.0])
    )
    np.testing.assert_array_equal(gradient, [16, 12, 0])


def test_a_region_without_buildings_and_a_height_raster_have_none_to_differentiate_by():
    city = city_of_boxes([(0, 0, 20, 20)], 30.0, 40.0)
    assert (building_index(city, Grid(GRID.crs, 5.0, 100, 100, 4, 4)) == NO_BUILDING).all()
    raster = Raster(np.ones((8, 8), np.float32), (5.0, 0.0, 0.0, 0.0, -5.0, 40.0), GRID.crs)
    with pytest.raises(InputError, match="gradients by building need outlines"):
        building_index(City(GRID.crs, (0.0, 0.0, 40.0, 40.0), roofs=raster), EIGHT)
