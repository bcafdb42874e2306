"""DOPs with one clock for each system against float64 linear algebra, degenerate sets, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.io.read.orbits import look_angles, read_orbits
from jaxurban.kernels.dop import Clocks, dops, dops_of_words, geometry, unit_vectors

RING = unit_vectors(np.radians([0.0, 50.0, 130.0, 200.0, 300.0, 20.0]), np.full(6, np.radians(40.0)))
SLOPE = jax.jit(jax.grad(lambda satellites, w: jnp.sum(jnp.minimum(dops(satellites, w).gdop, 20.0)), argnums=1))


def inverse_dops(directions, numbers, weights):
    """The definition in float64, one choice of satellites at a time: roots of the diagonal of (G^T W G)^-1, [5, N]."""
    found = np.full((5, len(weights)), np.inf)
    for n, row in enumerate(weights):
        used = row > 0
        columns = [-(numbers[used] == clock).astype(float) for clock in np.unique(numbers[used])]
        matrix = np.column_stack([*columns, directions[used]]) * np.sqrt(row[used])[:, None]
        if len(matrix) and np.linalg.matrix_rank(matrix) == matrix.shape[1]:
            variance = np.diag(np.linalg.inv(matrix.T @ matrix))
            clock, (east, north, up) = variance[0], variance[-3:]
            position = east + north + up
            found[:, n] = np.sqrt([position + clock, position, east + north, up, clock])
    return found


def words_of(is_seen):
    words = np.zeros((-(-is_seen.shape[1] // 32), len(is_seen)), np.uint32)
    for s in range(is_seen.shape[1]):
        words[s // 32] |= is_seen[:, s].astype(np.uint32) << np.uint32(s % 32)
    return jnp.asarray(words)


def assert_as_float64(directions, clocks, is_seen):
    """Every DOP below 20 within 1e-5, inf for sets without a rank."""
    found = np.array(dops_of_words(geometry(directions, clocks=clocks), words_of(is_seen)))
    expected = inverse_dops(directions, clocks.numbers, is_seen)
    is_useful = expected[0] < 20
    assert is_useful.sum() > 1000
    np.testing.assert_allclose(found[:, is_useful], expected[:, is_useful], rtol=1e-5)
    num_clocks = np.array([len(np.unique(clocks.numbers[row])) for row in is_seen])
    has_few = is_seen.sum(axis=1) < 3 + num_clocks
    assert has_few.any()
    assert np.all(np.isinf(found[:, has_few]))
    assert np.all(np.isinf(found).all(axis=0) == np.isinf(found).any(axis=0))
    assert np.all(found[:, np.isinf(expected[0])] > 300)


def random_choices(rng, num_choices, num):
    return rng.random((num_choices, num)) < rng.uniform(0.2, 1, (num_choices, 1))


@pytest.mark.parametrize(("num", "num_systems"), [(16, 2), (24, 3), (33, 4)])
def test_dops_below_20_of_random_skies_equal_float64_to_1e_5(num, num_systems):
    rng = np.random.default_rng(num)
    elevation_rad = rng.uniform(np.radians(5), np.pi / 2, num)
    directions = unit_vectors(rng.uniform(0, 2 * np.pi, num), elevation_rad)
    clocks = Clocks(rng.permutation(np.arange(num) % num_systems), num_systems)
    assert_as_float64(directions, clocks, random_choices(rng, 3000, num))


@pytest.mark.data
def test_dops_below_20_of_gps_and_galileo_over_tokyo_equal_float64_to_1e_5(data_dir):
    files = [data_dir / "tokyo" / f"{system}_2018-12-19.tle" for system in ("gps", "galileo")]
    times = ["2018-12-19T06:07:00Z", "2018-12-19T12:00:00Z", "2018-12-19T18:00:00Z"]
    sky = look_angles(read_orbits(files), times, 139.73, 35.69)
    rng = np.random.default_rng(0)
    for t in range(len(times)):
        seen = np.flatnonzero(sky.elevation_rad[t] > np.radians(10))
        numbers = np.array([sky.systems[s] == "galileo" for s in seen], int)
        assert set(numbers) == {0, 1}
        directions = unit_vectors(sky.azimuth_rad[t, seen], sky.elevation_rad[t, seen])
        assert_as_float64(directions, Clocks(numbers, 2), random_choices(rng, 3000, len(seen)))


def test_a_system_of_which_nothing_is_seen_changes_nothing():
    rng = np.random.default_rng(2)
    directions = unit_vectors(rng.uniform(0, 6, 16), rng.uniform(0.1, 1.5, 16))
    both = geometry(directions, clocks=Clocks(np.repeat([0, 1], 8), 2))
    for first in (0, 8):
        words = jnp.asarray(rng.integers(0, 2**8, (1, 3000)) << first, jnp.uint32)
        alone = dops_of_words(geometry(directions[first : first + 8]), words >> first)
        is_useful = np.asarray(alone.gdop) < 20
        for one, other in zip(dops_of_words(both, words), alone, strict=True):
            np.testing.assert_allclose(one[is_useful], other[is_useful], rtol=2e-5)
            np.testing.assert_array_equal(np.isinf(one), np.isinf(other))
    empty = geometry(directions, clocks=Clocks(np.zeros(16, int), 2))
    np.testing.assert_allclose(dops(empty, jnp.ones(16)), dops(geometry(directions), jnp.ones(16)), rtol=1e-6)


def test_a_system_with_one_satellite_fixes_its_own_clock_and_nothing_else():
    rng = np.random.default_rng(3)
    directions = unit_vectors(rng.uniform(0, 6, 8), rng.uniform(0.2, 1.5, 8))
    for alone in (0, 7):  # of the first system, and of the last
        numbers = np.full(8, 1 if alone == 0 else 0)
        numbers[alone] = 1 - numbers[alone]
        found = dops(geometry(directions, clocks=Clocks(numbers, 2)), jnp.ones(8))
        others = dops(geometry(np.delete(directions, alone, axis=0)), jnp.ones(7))
        np.testing.assert_allclose(found[1:4], others[1:4], rtol=1e-5)
        if alone == 7:
            np.testing.assert_allclose(found, others, rtol=1e-5)


def test_gdop_is_of_the_position_and_the_first_systems_clock():
    rng = np.random.default_rng(4)
    directions, numbers = unit_vectors(rng.uniform(0, 6, 12), rng.uniform(0.2, 1.5, 12)), np.arange(12) % 3
    by_order = [dops(geometry(directions, clocks=Clocks((numbers + k) % 3, 3)), jnp.ones(12)) for k in range(3)]
    for found in by_order:
        np.testing.assert_allclose(found.gdop**2, found.pdop**2 + found.tdop**2, rtol=1e-6)
        np.testing.assert_allclose(found.pdop, by_order[0].pdop, rtol=1e-6)
    assert len({round(float(found.tdop), 4) for found in by_order}) == 3


def test_one_clock_is_todays_program_to_the_bit():
    rng = np.random.default_rng(5)
    directions = unit_vectors(rng.uniform(0, 6, 9), rng.uniform(0.1, 1.5, 9))
    plain, one = geometry(directions), geometry(directions, clocks=Clocks(np.zeros(9, int), 1))
    for each, other in zip(jax.tree.leaves(plain), jax.tree.leaves(one), strict=True):
        np.testing.assert_array_equal(each, other)
    assert jax.tree.structure(plain) == jax.tree.structure(one)


def test_more_clocks_never_lower_the_dops_of_the_position():
    rng = np.random.default_rng(6)
    directions = unit_vectors(rng.uniform(0, 6, 16), rng.uniform(0.1, 1.5, 16))
    words = words_of(random_choices(rng, 3000, 16))
    one = dops_of_words(geometry(directions), words)
    two = dops_of_words(geometry(directions, clocks=Clocks(np.arange(16) % 2, 2)), words)
    for name in ("pdop", "hdop", "vdop"):
        assert np.all(np.asarray(getattr(two, name)) >= np.asarray(getattr(one, name)) * (1 - 1e-4))
    assert np.isinf(two.gdop).sum() > np.isinf(one.gdop).sum()


@pytest.mark.parametrize(
    ("numbers", "seen"),
    [
        ([0, 0, 0, 1, 1, 1, 1], [1, 1, 0, 1, 1, 0, 0]),  # two and two
        ([0, 0, 0, 1, 1, 1, 1], [1, 0, 0, 1, 1, 1, 0]),  # three and one that fixes its own clock
        ([0, 0, 0, 1, 1, 1, 1], [1, 1, 1, 1, 1, 1, 0]),  # all on one cone
        ([0, 0, 0, 0, 0, 0, 1], [1, 1, 1, 1, 1, 1, 1]),  # one cone, and another system's zenith
        ([0, 0, 0, 1, 1, 2, 2], [0, 0, 0, 1, 0, 1, 0]),
        ([0, 0, 0, 1, 1, 1, 1], [0, 0, 0, 0, 0, 0, 0]),
    ],
)
def test_sets_without_a_rank_give_inf_and_a_finite_gradient(numbers, seen):
    directions = np.vstack([RING, [0.0, 0.0, 1.0]])
    satellites = geometry(directions, clocks=Clocks(np.array(numbers), 3))
    weights = jnp.array(seen, jnp.float32)
    assert np.all(np.isinf(dops(satellites, weights)))
    assert np.all(np.isinf(dops_of_words(satellites, words_of(np.array([seen]) == 1))))
    assert np.all(np.isfinite(SLOPE(satellites, weights)))


def test_satellites_that_fill_up_change_no_bit_with_two_clocks():
    rng = np.random.default_rng(7)
    directions, clocks = unit_vectors(rng.uniform(0, 6, 16), rng.uniform(0.1, 1.5, 16)), Clocks(np.arange(16) % 2, 2)
    words = jnp.asarray(rng.integers(0, 2**16, (1, 3000)), jnp.uint32)
    plain = dops_of_words(geometry(directions, clocks=clocks), words)
    padded = dops_of_words(geometry(directions, multiple_of=24, clocks=clocks), words)
    np.testing.assert_array_equal(plain, padded)


@pytest.mark.slow
def test_weights_equal_float64_and_their_derivatives_finite_differences():
    rng = np.random.default_rng(8)
    directions, numbers = unit_vectors(rng.uniform(0, 6, 11), rng.uniform(0.2, 1.5, 11)), np.arange(11) % 3
    weights = rng.uniform(0.1, 1, 11)
    weights[numbers == 0] *= 0.1  # less than 1 in all, so that the second clock has its part in the time
    with jax.enable_x64(True):
        satellites = geometry(directions, np.float64, clocks=Clocks(numbers, 3))
        found = dops(satellites, jnp.asarray(weights))
        np.testing.assert_allclose(found[1:4], inverse_dops(directions, numbers, weights[None])[1:4, 0], rtol=1e-12)

        def total(w):
            return sum(dops(satellites, w))

        slope = jax.jit(jax.grad(total))(jnp.asarray(weights))
        step = 1e-6 * np.eye(11)
        more, less = total(weights[:, None] + step), total(weights[:, None] - step)
        np.testing.assert_allclose(slope, (more - less) / 2e-6, rtol=1e-6)


@pytest.mark.slow
def test_a_system_fades_without_a_jump_and_its_slopes_stay_finite():
    rng = np.random.default_rng(9)
    directions, numbers = unit_vectors(rng.uniform(0, 6, 10), rng.uniform(0.2, 1.5, 10)), np.arange(10) % 2
    fading = -np.sort(-np.concatenate([np.linspace(1, 0, 20_001), 10.0 ** -np.arange(3, 38, 0.25)]))
    satellites = geometry(directions, clocks=Clocks(numbers, 2))
    for system in (0, 1):
        weights = jnp.where((numbers == system)[:, None], jnp.asarray(fading, jnp.float32), jnp.float32(1))
        found = dops(satellites, weights)
        gone = dops(geometry(directions[numbers != system]), jnp.ones(5))
        for dop, alone in zip(found, gone, strict=True):
            np.testing.assert_allclose(dop[-1], alone, rtol=2e-5)
            assert np.abs(np.diff(dop)).max() < 0.01 * np.max(dop)
        assert np.all(np.isfinite(SLOPE(satellites, weights)))
