"""The bitmap lidar against a marcher that follows one beam of one ray at a time."""

import itertools
import math
import re
from functools import partial

import jax
import jax.numpy as jnp
import numba
import numpy as np
import pytest

from jaxurban.kernels.lidar import soft as soft_lidar
from jaxurban.kernels.lidar.hard import (
    count_returns,
    count_returns_by_azimuths,
    count_returns_by_steps,
    count_returns_on_terrain_by_steps,
    flat_thresholds,
    lowest_heights,
    num_steps,
    phase_starts,
    phases,
    ray_halo_cells,
    ray_offsets,
    round_up,
)
from jaxurban.kernels.lidar.terrain_cpu import count_on_terrain_on_host


@numba.njit
def march_rays(
    roof_m, terrain_m, halo, altitude_m, elevations_rad, num_azimuths, range_m, resolution_m
):
    """Return how many scan positions return from each cell inside the halo; one beam after the other."""
    rows, cols = roof_m.shape[0] - 2 * halo, roof_m.shape[1] - 2 * halo
    counts = np.zeros((rows, cols), np.int32)
    slopes, reaches_m = np.tan(elevations_rad), range_m * np.cos(elevations_rad)
    for k in range(num_azimuths):
        north, east = math.cos(2 * np.pi * k / num_azimuths), math.sin(2 * np.pi * k / num_azimuths)
        for row in range(halo, halo + rows):
            for col in range(halo, halo + cols):
                hit = False
                for beam in range(len(slopes)):
                    slope, reach_m = slopes[beam], reaches_m[beam]
                    n = 0
                    while not hit:
                        near_m, far_m = (
                            max(n - 0.5, 0.0) * resolution_m,
                            min((n + 0.5) * resolution_m, reach_m),
                        )
                        if near_m > reach_m:
                            break  # out of range
                        i = row + int(math.copysign(math.floor(abs(n * north) + 0.5 + 1e-9), north))
                        j = col + int(math.copysign(math.floor(abs(n * east) + 0.5 + 1e-9), east))
                        height_m = altitude_m + (far_m if slope < 0 else near_m) * slope
                        ground_m = terrain_m[i, j] - terrain_m[row, col]
                        hit = roof_m[i, j] > 0 and height_m <= ground_m + roof_m[i, j]
                        if height_m <= ground_m:
                            break  # met the ground
                        n += 1
                    if hit:
                        counts[row - halo, col - halo] += 1
                        break
    return counts


def random_city(size: int, halo: int, seed: int) -> np.ndarray:
    """Return roofs in eighths of a metre (their sums are exact), blocks of cells with streets between."""
    rng = np.random.default_rng(seed)
    shape = (size + 2 * halo, size + 2 * halo)
    coarse = rng.gamma(1.0, 20.0, (shape[0] // 4 + 1, shape[1] // 4 + 1))
    coarse *= rng.random(coarse.shape) < 0.3
    blocks = np.kron(coarse, np.ones((4, 4)))[: shape[0], : shape[1]]
    single = np.where(rng.random(shape) < 0.01, rng.uniform(1, 80, shape), 0)
    return (np.round(8 * np.maximum(blocks, single)) / 8).astype(np.float32)


FLAT = {  # for a CPU and for a GPU
    "cpu": jax.jit(count_returns_by_azimuths, static_argnames="halo"),
    "gpu": count_returns_by_steps,
}
ON_TERRAIN = {"numba": count_on_terrain_on_host, "jax": count_returns_on_terrain_by_steps}


def counts_of(
    roof_m,
    terrain_m,
    altitudes_m,
    elevations_rad,
    num_azimuths,
    range_m,
    resolution_m,
    form="",
    per_cell=1,
):
    """Return the counts of receivers, one in the middle of so many by so many cells; left out, by the form of a CPU."""
    steps, roofs_m = num_steps(resolution_m, range_m), phases(roof_m, per_cell)
    lowest_m = lowest_heights(np.array(altitudes_m), elevations_rad, resolution_m, range_m, steps)
    starts, halo = (
        phase_starts(ray_offsets(num_azimuths, steps), per_cell),
        ray_halo_cells(steps, per_cell),
    )
    if terrain_m is None:
        count = (FLAT | {"jax": count_returns})[form or "cpu"]
        thresholds_m = round_up(flat_thresholds(lowest_m), np.float32)
        return count(roofs_m, thresholds_m, starts, halo=halo)
    where = {"halo": halo, "receiver_phase": per_cell // 2 * (per_cell + 1)}
    return ON_TERRAIN[form or "numba"](
        roofs_m, phases(terrain_m, per_cell), round_up(lowest_m, np.float32), starts, **where
    )


CASES = {  # those that may share their shapes do, and so one program
    "the default puck at fewer azimuths": ([2.0, 20.0, 60.0], (-15, 15, 16), 22, 100.0, 5.0),
    "all beams up": ([1.0, 10.0, 30.0], (2, 40, 5), 33, 47.0, 2.5),
    "all beams down": ([1.0, 10.0, 30.0], (-60, -5, 7), 33, 47.0, 2.5),
    "one level beam": ([2.0, 20.0, 60.0], (0, 0, 1), 33, 46.25, 2.5),
    "a range under half a cell": ([2.0, 20.0, 60.0], (-80, 15, 4), 4, 2.0, 5.0),
    "the default puck": ([2.0, 20.0, 60.0], (-15, 15, 16), 360, 100.0, 5.0),
}
# What differs between cases beside shapes is made on the host: two of them show the form for a GPU.
BY_GPU = ("the default puck at fewer azimuths", "a range under half a cell")
SLOW = ("the default", "all beams")  # the begin of a name
PARAMS = [
    pytest.param(name, form, marks=[pytest.mark.slow] * name.startswith(SLOW))
    for name, form in itertools.product(CASES, FLAT)
    if form == "cpu" or name in BY_GPU
]


SIDE = 100  # of a city in cells


def assert_as_marched(counts, roof_m, terrain_m, altitudes_m, *scan):
    halo = (roof_m.shape[0] - counts.shape[1]) // 2
    for altitude_m, count in zip(altitudes_m, counts, strict=True):
        np.testing.assert_array_equal(count, march_rays(roof_m, terrain_m, halo, altitude_m, *scan))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "form"), PARAMS)
def test_counts_equal_a_marcher_of_single_beams_in_every_cell(name, form):
    altitudes_m, (low, high, num_beams), num_azimuths, range_m, resolution_m = CASES[name]
    scan = (
        np.linspace(np.deg2rad(low), np.deg2rad(high), num_beams),
        num_azimuths,
        range_m,
        resolution_m,
    )
    roof_m = random_city(SIDE, num_steps(resolution_m, range_m) - 1, seed=len(name))
    counts = counts_of(roof_m, None, altitudes_m, *scan, form)
    assert_as_marched(counts, roof_m, np.zeros_like(roof_m), altitudes_m, *scan)
    assert counts.min() < counts.max()


GROUNDS = {
    "hills that hide buildings": lambda rng, slope_m: 700 + 15 * (slope_m - 700),
    "constant, which is flat": lambda rng, slope_m: np.full_like(slope_m, 33.3),
    "level in whole metres, of which many are equal": lambda rng, slope_m: np.round(slope_m),
    "rough below the width of a class": lambda rng, slope_m: (
        slope_m + rng.normal(0, 0.01, slope_m.shape)
    ),
    "cliffs of hundreds of metres": lambda rng, slope_m: 300 * np.floor(slope_m / 4) + slope_m,
    "unknown in places": lambda rng, slope_m: np.where(
        rng.random(slope_m.shape) < 0.01, np.nan, slope_m
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("form", ON_TERRAIN)
@pytest.mark.parametrize("name", GROUNDS)
def test_counts_on_any_ground_equal_the_marcher_over_several_tiles(name, form):
    rng, scan = (
        np.random.default_rng(len(name)),
        (np.deg2rad(np.linspace(-25, 15, 6)), 18, 40.0, 5.0),
    )
    roof_m = (random_city(300, 8, seed=4) * np.float32(np.pi / 3))[
        :90
    ]  # heights whose sums are rounded
    row, col = np.indices(roof_m.shape)
    terrain_m = GROUNDS[name](rng, 700 + 3 * np.sin(row / 9) + 0.02 * col).astype(np.float32)
    altitudes_m = [4.0, 40.0]  # where the ground ends beams, and where it ends none
    counts = counts_of(roof_m, terrain_m, altitudes_m, *scan, form)
    assert_as_marched(counts, roof_m, terrain_m, altitudes_m, *scan)
    assert (counts.min(axis=(1, 2)) < counts.max(axis=(1, 2))).all()
    flat = counts_of(roof_m, None, altitudes_m, *scan)
    if name.startswith("constant"):
        np.testing.assert_array_equal(counts, flat)
    else:
        assert (counts < flat).any()


def test_a_long_wall_returns_the_share_of_azimuths_that_reach_it():
    # A level beam reaches a wall d away where its azimuth is within arccos(d / r) of the normal.
    halo, resolution_m, range_m = 100, 1.0, 100.0
    roof_m = np.zeros((33 + 2 * halo, 8 + 2 * halo), np.float32)
    roof_m[halo + 33 :] = 30.0  # north of every cell that answers
    counts = counts_of(roof_m, None, [10.0], np.array([0.0]), 720, range_m, resolution_m)[0]
    distance_m = (33 - np.arange(33)) * resolution_m - resolution_m / 2
    expected = np.arccos(distance_m / range_m) / np.pi
    np.testing.assert_allclose(
        counts / 720, np.broadcast_to(expected[:, None], counts.shape), atol=0.01
    )


@pytest.mark.slow
@pytest.mark.parametrize("form", FLAT)
def test_a_roof_that_is_unknown_is_no_building_and_hides_no_other(form):
    roof_m = random_city(40, 6, seed=2)
    unknown_m = np.where(
        np.random.default_rng(0).random(roof_m.shape) < 0.02, np.nan, roof_m
    ).astype(np.float32)
    both, scan = (
        (unknown_m, np.nan_to_num(unknown_m)),
        ([5.0], np.deg2rad(np.linspace(-15, 15, 4)), 12, 30.0, 5.0),
    )
    fine = [counts_of(roofs, None, *scan, form) for roofs in both]
    coarse = [counts_of(roofs, None, *scan, form, per_cell=2) for roofs in both]
    for with_unknown, without in (fine, coarse):
        assert without.max() > 0
        np.testing.assert_array_equal(with_unknown, without)


@pytest.mark.slow
def test_counts_of_fine_cells_and_long_rays_are_the_same_over_several_blocks():
    elevations_rad = np.deg2rad(np.linspace(-15, 15, 4))
    rng = np.random.default_rng(9)
    shape = 140 + 2 * 400, 600 + 2 * 400
    roof_m = np.where(rng.random(shape) < 5e-5, rng.uniform(1, 30, shape), 0).astype(np.float32)
    few = counts_of(roof_m, None, [6.0], elevations_rad, 6, 100.0, 0.25)
    np.testing.assert_array_equal(
        few, counts_of(roof_m, None, [6.0], elevations_rad, 6, 100.0, 0.25, "gpu")
    )
    assert few.min() < few.max()


def test_more_positions_return_than_sixteen_bits_count():
    roof_m = np.full((5, 9), 30, np.float32)
    assert (counts_of(roof_m, None, [10.0], np.array([0.0]), 70_000, 2.0, 5.0) == 70_000).all()


@pytest.mark.slow
def test_counts_mapped_over_cities_are_those_of_each_and_have_no_slope():
    scan = [5.0], np.deg2rad(np.linspace(-15, 15, 4)), 12, 30.0, 5.0
    roofs_m = np.stack([random_city(40, 6, seed) for seed in (2, 3)])

    def total(roof_m):
        counts = counts_of(roof_m, None, *scan, "jax")
        return counts.sum(dtype=jnp.float32), counts

    each = jax.vmap(jax.value_and_grad(total, has_aux=True))
    (_, mapped), slopes = jax.jit(each)(roofs_m)
    assert not slopes.any()
    for roof_m, counts in zip(roofs_m, mapped, strict=True):
        assert_as_marched(counts, roof_m, np.zeros_like(roof_m), *scan)


def test_new_heights_altitudes_and_azimuths_of_known_shapes_compile_nothing():
    elevations_rad = np.deg2rad(np.linspace(-15, 15, 16))
    roof_m = random_city(SIDE, 19, seed=1)
    counts_of(roof_m, None, [2.0, 20.0, 60.0], elevations_rad, 33, 47.0, 2.5, "cpu")
    compiled = FLAT["cpu"]._cache_size()
    counts_of(roof_m + 1, None, [2.0, 15.0, 90.0], 0.5 * elevations_rad, 33, 48.0, 2.5, "cpu")
    assert FLAT["cpu"]._cache_size() == compiled


@pytest.mark.parametrize("num_azimuths", [8, 360])
def test_rays_have_the_symmetry_of_the_grid(num_azimuths):
    offsets = ray_offsets(num_azimuths, 51)
    quarter = np.stack(
        [-offsets[..., 1], offsets[..., 0]], axis=-1
    )  # turned by 90 degrees, clockwise
    np.testing.assert_array_equal(quarter, np.roll(offsets, -num_azimuths // 4, axis=0))
    np.testing.assert_array_equal(offsets[0, -1], [50, 0])  # grid north first
    np.testing.assert_array_equal(offsets[num_azimuths // 4, -1], [0, 50])  # then east


@pytest.mark.slow
@pytest.mark.parametrize(
    ("per_cell", "form"), [(3, "cpu"), (2, "cpu"), (3, "gpu"), (3, "numba"), (3, "jax")]
)
def test_receivers_of_a_coarser_map_get_the_counts_of_their_fine_cells(per_cell, form):
    on_terrain = form in ON_TERRAIN
    scan = [2.0, 10.0], np.deg2rad(np.linspace(-15, 15, 5)), 24, 30.0, 2.0
    steps = num_steps(2.0, 30.0)
    halo = ray_halo_cells(steps, per_cell) * per_cell
    roof_m = random_city(12 * per_cell, halo, seed=per_cell)
    row, col = np.indices(roof_m.shape)
    terrain_m = (np.round(8 * (9 * np.sin(row / 9) + 6 * np.cos(col / 6) + 30)) / 8).astype(
        np.float32
    )
    terrain_m = terrain_m if on_terrain else None
    near, middle = (
        slice(halo - (steps - 1), steps - 1 - halo or None),
        slice(per_cell // 2, None, per_cell),
    )
    dense = counts_of(roof_m[near, near], terrain_m[near, near] if on_terrain else None, *scan)
    found = counts_of(roof_m, terrain_m, *scan, form, per_cell)
    np.testing.assert_array_equal(found, dense[:, middle, middle])
    assert found.min() < found.max()


@pytest.mark.slow
@pytest.mark.parametrize("on_terrain", [False, True])
def test_counts_can_be_traced_and_exported_and_for_a_gpu_have_no_loop_whose_end_is_data(on_terrain):
    scan, roof_m = (
        ([5.0], np.deg2rad(np.linspace(-15, 15, 4)), 12, 30.0, 5.0),
        random_city(40, 6, seed=2),
    )
    row, col = np.indices(roof_m.shape)
    terrain_m = (
        (8 * np.sin(row / 15) + 6 * np.cos(col / 11)).astype(np.float32) if on_terrain else None
    )

    def traced(form):
        return jax.jit(lambda roof_m, terrain_m: counts_of(roof_m, terrain_m, *scan, form))

    def words(form):
        return set(re.findall(r"\w+(?=\[)", str(jax.make_jaxpr(traced(form))(roof_m, terrain_m))))

    np.testing.assert_array_equal(
        traced("jax")(roof_m, terrain_m), counts_of(roof_m, terrain_m, *scan)
    )
    jax.export.export(traced("jax"), platforms=("cuda",))(roof_m, terrain_m)
    of_gpu = words("jax" if on_terrain else "gpu")
    assert "scan" in of_gpu
    assert not of_gpu & {"while", "cond"}
    assert on_terrain or words("cpu") >= {
        "while",
        "cond",
    }  # the text shows the loops of the form for a CPU


@pytest.mark.slow
@pytest.mark.parametrize("on_terrain", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("num_azimuths", [16, pytest.param(43, marks=pytest.mark.slow)])
def test_soft_returns_of_both_forms_are_the_same_for_any_number_of_azimuths(
    num_azimuths, on_terrain
):
    halo, softness_m, range_m = 4, jnp.float32(2.0), jnp.float32(20.0)
    roof_m = jnp.asarray(random_city(9, halo, seed=2))
    offsets, cells = (
        jnp.asarray(ray_offsets(num_azimuths, halo + 1)),
        jnp.indices((9, 9)).reshape(2, -1).T,
    )
    hills_m = 3 * jnp.sin(jnp.arange(roof_m.size, dtype=jnp.float32).reshape(roof_m.shape))

    forms, forms_at = (
        (soft_lidar.one_by_one, soft_lidar.together),
        [
            partial(soft_lidar.in_batches, at_once=at_once)
            for at_once in (1, soft_lidar.azimuths_at_once(num_azimuths))
        ],
    )

    def mean_return(roof_m, altitude_m, range_m, hills_m, number):
        scan = soft_lidar.scan_of(
            altitude_m * (not on_terrain), range_m, np.deg2rad([-15.0, 0.0, 15.0]), 5.0
        )
        if not on_terrain:
            return forms[number](roof_m, scan, offsets, softness_m).mean()
        heights_m = jnp.broadcast_to(altitude_m, len(cells))
        at = soft_lidar.ScansAt(roof_m, hills_m, heights_m, scan, offsets, softness_m, cells)
        return forms_at[number](at).mean()

    inputs = roof_m, jnp.float32(9), range_m, hills_m
    both = (
        jax.jit(jax.value_and_grad(partial(mean_return, number=number), range(4)))
        for number in (0, 1)
    )
    (by_cpu, cpu_slopes), (by_gpu, gpu_slopes) = (each(*inputs) for each in both)
    assert 0.02 < float(by_cpu) < 0.98
    np.testing.assert_allclose(by_gpu, by_cpu, rtol=1e-6)
    for of_gpu, of_cpu in list(zip(gpu_slopes, cpu_slopes, strict=True))[: 4 if on_terrain else 3]:
        assert float(jnp.abs(of_cpu).max()) > 1e-4
        np.testing.assert_allclose(of_gpu, of_cpu, atol=1e-7)


def test_a_gpu_takes_azimuths_in_few_groups_whatever_their_number():
    for num_azimuths in range(1, 500):
        num_groups = -(-num_azimuths // soft_lidar.azimuths_at_once(num_azimuths))
        assert num_groups == -(-num_azimuths // soft_lidar.MOST_AZIMUTHS_AT_ONCE)
