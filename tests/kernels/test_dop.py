"""Dilutions of precision, with one clock or one a system: float64 inverses, known and degenerate sets, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxurban.io.orbits import look_angles, read_orbits
from jaxurban.kernels.dop import Clocks, Dops, dops, dops_of_words, geometry, unit_vectors

RING = unit_vectors(
    np.radians([0.0, 50.0, 130.0, 200.0, 300.0, 20.0]), np.full(6, np.radians(40.0))
)
RING_AND_ZENITH = np.vstack([RING, [0.0, 0.0, 1.0]])
NUM_CHOICES = 2000  # at once in every test, of 16 or 48 satellites and 1 or 4 clocks: few programs are compiled
SLOPE = jax.jit(
    jax.grad(lambda satellites, w: jnp.sum(jnp.minimum(dops(satellites, w).gdop, 20.0)), argnums=1)
)


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


def random_sky(num, seed):
    rng = np.random.default_rng(seed)
    return unit_vectors(rng.uniform(0, 2 * np.pi, num), rng.uniform(np.radians(8), np.pi / 2, num))


def random_choices(seed, num):
    rng = np.random.default_rng(seed)
    return rng.random((NUM_CHOICES, num)) < rng.uniform(0.2, 1, (NUM_CHOICES, 1))


def words_of(is_seen, num_words=1):
    bits = np.pad(
        is_seen, ((0, NUM_CHOICES - len(is_seen)), (0, 32 * num_words - is_seen.shape[1]))
    )
    return np.packbits(bits, axis=1, bitorder="little").view("<u4").T


def dops_seen(directions, is_seen, numbers=None):
    """Return ``[5, N]`` the DOPs of N choices of satellites; with ``numbers``, of up to four clocks."""
    is_seen = np.atleast_2d(np.asarray(is_seen, bool))
    clocks = None if numbers is None else Clocks(np.array(numbers), 4)
    satellites = geometry(directions, multiple_of=16, clocks=clocks)
    words = words_of(is_seen, -(-len(satellites.rows) // 32))
    return np.array(dops_of_words(satellites, jnp.asarray(words)))[:, : len(is_seen)]


def assert_as_float64(directions, numbers, is_seen):
    """Every DOP below 20 within 1e-5, inf for sets without a rank."""
    found = dops_seen(directions, is_seen, numbers)
    numbers = np.zeros(len(directions), int) if numbers is None else numbers
    expected = inverse_dops(directions, numbers, is_seen)
    is_useful = expected[0] < 20
    assert is_useful.sum() > NUM_CHOICES // 3
    np.testing.assert_allclose(found[:, is_useful], expected[:, is_useful], rtol=1e-5)
    num_clocks = np.array([len(np.unique(numbers[row])) for row in is_seen])
    has_few = is_seen.sum(axis=1) < 3 + num_clocks
    assert has_few.any()
    assert np.all(np.isinf(found[:, has_few]))
    assert np.all(np.isinf(found).all(axis=0) == np.isinf(found).any(axis=0))
    assert np.all(found[:, np.isinf(expected[0])] > 300)


@pytest.mark.parametrize(
    ("num", "num_systems"),
    [
        (6, 1),
        (16, 2),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((12, 1), (33, 4))),
    ],
)
def test_dops_below_20_of_random_skies_equal_float64_to_1e_5(num, num_systems):
    numbers = (
        np.random.default_rng(num).permutation(np.arange(num) % num_systems)
        if num_systems > 1
        else None
    )
    assert_as_float64(random_sky(num, num), numbers, random_choices(num, num))


@pytest.mark.slow
@pytest.mark.data
def test_dops_below_20_of_gps_and_galileo_over_tokyo_equal_float64_to_1e_5(data_dir):
    files = [data_dir / "tokyo" / f"{system}_2018-12-19.tle" for system in ("gps", "galileo")]
    times = ["2018-12-19T06:07:00Z", "2018-12-19T12:00:00Z", "2018-12-19T18:00:00Z"]
    sky = look_angles(read_orbits(files), times, 139.73, 35.69)
    for t in range(len(times)):
        seen = np.flatnonzero(sky.elevation_rad[t] > np.radians(10))
        numbers = np.array([sky.systems[s] == "galileo" for s in seen], int)
        assert set(numbers) == {0, 1}
        directions = unit_vectors(sky.azimuth_rad[t, seen], sky.elevation_rad[t, seen])
        assert_as_float64(directions, numbers, random_choices(t, len(seen)))


@pytest.mark.data
@pytest.mark.parametrize("file", ["2012-12-07.tle", "2020-04-27.tle", "2024-03-31_omm.csv"])
def test_dops_below_20_of_gps_over_manhattan_equal_float64_to_1e_5(data_dir, file):
    orbits, time = read_orbits(data_dir / f"gps/gps-ops_{file}"), f"{file[:10]}T16:00:00Z"
    sky = look_angles(orbits, [time], -74.0, 40.715).under(5.0)
    directions = unit_vectors(sky.azimuth_rad[0], sky.elevation_rad[0])
    assert_as_float64(directions, None, random_choices(0, len(directions)))


def test_four_satellites_at_the_corners_of_a_tetrahedron_have_known_dops():
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    # Sum of u u^T is 4/3 of the identity and the mean direction is 0.
    expected = Dops(np.sqrt(2.5), 1.5, np.sqrt(1.5), np.sqrt(0.75), 0.5)
    np.testing.assert_allclose(dops_seen(corners, [1] * 4)[:, 0], expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("numbers", [None, np.arange(12) % 2])
def test_satellites_that_fill_up_change_no_bit(numbers):
    # A sum has as many terms, some of them 0, and is added up in the same order (up to 31 of them).
    directions, clocks = random_sky(12, 5), None if numbers is None else Clocks(numbers, 4)
    words = jnp.asarray(words_of(random_choices(1, 12)))
    plain = dops_of_words(geometry(directions, clocks=clocks), words)
    np.testing.assert_array_equal(
        plain, dops_of_words(geometry(directions, multiple_of=16, clocks=clocks), words)
    )


def test_one_more_satellite_never_raises_a_dop():
    directions = random_sky(9, 4)
    less = dops_seen(directions, 1 - np.eye(9))  # each row leaves one out
    assert np.all(less >= dops_seen(directions, [1] * 9) * (1 - 1e-6))


def test_a_system_of_which_nothing_is_seen_changes_nothing():
    directions, numbers = random_sky(16, 2), np.repeat([0, 1], 8)
    is_seen = random_choices(2, 8)
    for first in (0, 8):
        both = dops_seen(directions, np.pad(is_seen, ((0, 0), (first, 8 - first))), numbers)
        alone = dops_seen(directions[first : first + 8], is_seen)
        is_useful = alone[0] < 20
        np.testing.assert_allclose(both[:, is_useful], alone[:, is_useful], rtol=2e-5)
        np.testing.assert_array_equal(np.isinf(both), np.isinf(alone))


@pytest.mark.parametrize("alone", [0, 7])  # of the first system, and of the last
def test_a_system_with_one_satellite_fixes_its_own_clock_and_nothing_else(alone):
    directions, numbers = random_sky(8, 3), np.full(8, int(alone == 0))
    numbers[alone] = int(alone != 0)
    found, others = (
        dops_seen(directions, [1] * 8, numbers),
        dops_seen(np.delete(directions, alone, 0), [1] * 7),
    )
    np.testing.assert_allclose(found[1:4], others[1:4], rtol=1e-5)
    if alone == 7:
        np.testing.assert_allclose(found, others, rtol=1e-5)


def test_gdop_is_of_the_position_and_the_first_systems_clock():
    by_order = [
        Dops(*dops_seen(random_sky(12, 4), [1] * 12, (np.arange(12) + k) % 3)) for k in range(3)
    ]
    for found in by_order:
        np.testing.assert_allclose(found.gdop**2, found.pdop**2 + found.tdop**2, rtol=1e-6)
        np.testing.assert_allclose(found.pdop, by_order[0].pdop, rtol=1e-6)
    assert len({round(float(found.tdop[0]), 4) for found in by_order}) == 3


def test_more_clocks_never_lower_the_dops_of_the_position():
    directions, is_seen = random_sky(16, 6), random_choices(6, 16)
    one, two = dops_seen(directions, is_seen), dops_seen(directions, is_seen, np.arange(16) % 2)
    assert np.all(two[1:4] >= one[1:4] * (1 - 1e-4))
    assert np.isinf(two[0]).sum() > np.isinf(one[0]).sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numbers", "seen"),
    [
        (None, [0, 0, 0, 0, 0, 0, 0]),
        (None, [1, 1, 1, 0, 0, 0, 0]),
        (None, [1, 1, 1, 1, 1, 1, 0]),  # all on one cone
        ([0, 0, 0, 1, 1, 1, 1], [1, 1, 0, 1, 1, 0, 0]),  # two and two
        ([0, 0, 0, 1, 1, 1, 1], [1, 0, 0, 1, 1, 1, 0]),  # three and one that fixes its own clock
        ([0, 0, 0, 1, 1, 1, 1], [1, 1, 1, 1, 1, 1, 0]),  # all on one cone
        ([0, 0, 0, 0, 0, 0, 1], [1, 1, 1, 1, 1, 1, 1]),  # one cone, and another system's zenith
        ([0, 0, 0, 1, 1, 2, 2], [0, 0, 0, 1, 0, 1, 0]),
        ([0, 0, 0, 1, 1, 1, 1], [0, 0, 0, 0, 0, 0, 0]),
    ],
)
def test_sets_without_a_rank_give_inf_and_a_finite_gradient(numbers, seen):
    assert np.all(np.isinf(dops_seen(RING_AND_ZENITH, seen, numbers)))
    clocks = None if numbers is None else Clocks(np.array(numbers), 4)
    assert np.all(
        np.isfinite(SLOPE(geometry(RING_AND_ZENITH, clocks=clocks), jnp.array(seen, jnp.float32)))
    )


def test_satellites_that_all_leave_the_position_undetermined_give_inf_for_every_choice():
    assert np.all(np.isinf(dops_seen(RING[:5], [1] * 5)))
    assert np.all(np.isinf(dops_seen(np.empty((0, 3)), np.empty((1, 0)))))
    assert np.all(np.isfinite(dops_seen(RING_AND_ZENITH, [1] * 7)))


@pytest.mark.slow
@pytest.mark.parametrize("num_clocks", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_weights_equal_float64_and_their_derivatives_finite_differences(num_clocks):
    directions, numbers = random_sky(11, 8), np.arange(11) % num_clocks
    weights = np.random.default_rng(8).uniform(0.1, 1, 11)
    if num_clocks > 1:
        weights[numbers == 0] *= (
            0.1  # less than 1 in all, so that the second clock has its part in the time
        )
    with jax.enable_x64(True):
        satellites = geometry(directions, np.float64, clocks=Clocks(numbers, num_clocks))
        found = dops(satellites, jnp.asarray(weights))
        np.testing.assert_allclose(
            found[1:4], inverse_dops(directions, numbers, weights[None])[1:4, 0], rtol=1e-12
        )

        def total(w):
            return sum(dops(satellites, jnp.asarray(w)))

        slope, step = jax.jit(jax.grad(total))(weights), 1e-6 * np.eye(11)
        expected = (total(weights[:, None] + step) - total(weights[:, None] - step)) / 2e-6
        np.testing.assert_allclose(slope, expected, rtol=1e-6)


@pytest.mark.slow
def test_a_system_fades_without_a_jump_and_its_slopes_stay_finite():
    directions, numbers = random_sky(10, 9), np.arange(10) % 2
    fading = -np.sort(-np.concatenate([np.linspace(1, 0, 20_001), 10.0 ** -np.arange(3, 38, 0.25)]))
    satellites = geometry(directions, clocks=Clocks(numbers, 2))
    for system in (0, 1):
        weights = jnp.where(
            (numbers == system)[:, None], jnp.asarray(fading, jnp.float32), jnp.float32(1)
        )
        found = dops(satellites, weights)
        gone = dops_seen(directions[numbers != system], [1] * 5)[:, 0]
        for dop, alone in zip(found, gone, strict=True):
            np.testing.assert_allclose(dop[-1], alone, rtol=2e-5)
            assert np.abs(np.diff(dop)).max() < 0.01 * np.max(dop)
        assert np.all(np.isfinite(SLOPE(satellites, weights)))
