"""Protection levels against a published example, another library, and slow linear algebra with a root finder."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import norm

from jaxurban.kernels.dop import unit_vectors
from jaxurban.kernels.protection import Ranging, RiskBudget, protection_levels, quantile, tail

BUDGET = RiskBudget(2e-9, 9.8e-8, 9e-8, 3.9e-6, 8e-8, 0.05, 1e-4)  # LPV-200
FINE = BUDGET._replace(tolerance_horizontal_m=1e-9, tolerance_vertical_m=1e-9)
# WG-C Reference Airborne Algorithm Description Document 3.0, appendix D: toward the receiver, and both variances (m2).
EXAMPLE = np.array(
    [
        [0.0225, 0.9951, -0.0966, 3.8865, 3.5740],
        [0.6750, -0.6900, -0.2612, 1.4377, 1.1252],
        [0.0723, -0.6601, -0.7477, 0.8604, 0.5479],
        [-0.9398, 0.2553, -0.2269, 1.6383, 1.3258],
        [-0.5907, -0.7539, -0.2877, 1.3229, 1.0104],
        [-0.3236, -0.0354, -0.9455, 0.8434, 0.5309],
        [-0.6748, 0.4356, -0.5957, 0.8963, 0.5838],
        [0.0938, -0.7004, -0.7075, 0.8669, 0.5544],
        [0.5571, 0.3088, -0.7709, 0.8573, 0.5448],
        [0.6622, 0.6958, -0.2780, 1.3616, 1.0491],
    ]
)


def ranging(
    directions, constellation, sigma_m, p_sat=1e-5, p_const=(1e-4, 1e-4), bias_m=0.5
) -> Ranging:
    num = len(directions)
    sigma_int_m, sigma_acc_m = sigma_m
    of_all = np.full(num, bias_m), np.full(num, p_sat)
    return Ranging(
        directions, np.asarray(constellation), sigma_int_m, sigma_acc_m, *of_all, np.array(p_const)
    )


def drawn(seed: int, counts, **rest) -> Ranging:
    """Return satellites drawn over the sky above 6 degrees, so many of each constellation."""
    draw, num = np.random.default_rng(seed), sum(counts)
    directions = unit_vectors(draw.uniform(0, 2 * np.pi, num), np.arcsin(draw.uniform(0.1, 1, num)))
    sigma_m = draw.uniform(0.8, 2.0, num)
    return ranging(
        directions, np.repeat(np.arange(len(counts)), counts), (sigma_m, 0.7 * sigma_m), **rest
    )


def words_of(is_seen) -> np.ndarray:
    """Return the words ``[W, N]`` of N choices of satellites ``[S, N]``."""
    parts = [is_seen[first : first + 32] for first in range(0, len(is_seen), 32)]
    return np.array([(part.T << np.arange(len(part))).sum(axis=1) for part in parts], np.uint32)


def levels_of(satellites: Ranging, budget: RiskBudget = BUDGET) -> tuple[float, float]:
    all_seen = np.ones((len(satellites.directions), 1), bool)
    hpl_m, vpl_m = protection_levels(words_of(all_seen), satellites, budget)[:, 0]
    return hpl_m, vpl_m


def gains(satellites: Ranging, seen) -> np.ndarray | None:
    """Return S ``[3, S]`` of some satellites by the pseudo-inverse; None where they leave the position undetermined."""
    clocks = np.unique(satellites.constellation[seen])
    matrix = np.hstack(
        [-satellites.directions[seen], satellites.constellation[seen][:, None] == clocks]
    )
    if np.linalg.matrix_rank(matrix) < matrix.shape[1]:
        return None
    root = 1 / satellites.sigma_int_m[seen]
    found = np.zeros((3, len(satellites.directions)))
    found[:, seen] = (np.linalg.pinv(root[:, None] * matrix) * root)[:3]
    return found


def slow_levels(satellites: Ranging, budget: RiskBudget) -> tuple[float, float]:
    """Return both levels as the equations stand, with sets for fault modes and Brent's method for roots."""
    num, names = len(satellites.directions), np.unique(satellites.constellation)
    events = [({s}, satellites.p_sat[s]) for s in range(num)]
    events += [
        ({*np.flatnonzero(satellites.constellation == c)}, satellites.p_const[c]) for c in names
    ]
    events = [(lost, prior) for lost, prior in events if prior > 0]
    modes = list(events)
    at_most_two = [(one | other, p * q) for (one, p), (other, q) in combinations(events, 2)]
    several = (
        np.prod([1 + np.longdouble(p) for _, p in events])
        - 1
        - sum(np.longdouble(p) for _, p in events)
    )
    left = float(several)
    for equal in sorted({float(f"{prior:.9e}") for _, prior in at_most_two}, reverse=True):
        if left <= budget.p_unmonitored:
            break
        taken = [mode for mode in at_most_two if mode[1] == pytest.approx(equal, rel=1e-8, abs=0)]
        modes += taken
        left -= sum(prior for _, prior in taken)
    whole = gains(satellites, np.arange(num))
    if whole is None:
        return np.inf, np.inf
    rows = []
    for lost, prior in modes:
        kept = np.array([s for s in range(num) if s not in lost], int)
        part = gains(satellites, kept) if len(kept) else None
        if part is None:
            left += prior
        else:
            rows.append((part, prior))
    if left > budget.p_unmonitored:
        return np.inf, np.inf
    share, found = 1 - left / (budget.phmi_horizontal + budget.phmi_vertical), []
    for axis in range(3):
        pfa = budget.pfa_vertical / 2 if axis == 2 else budget.pfa_horizontal / 4
        risk = share * (budget.phmi_vertical if axis == 2 else budget.phmi_horizontal / 2)
        factor = norm.isf(pfa / len(modes))

        of_axis = np.array([whole[axis], *(part[axis] for part, _ in rows)])
        sigma_m = np.linalg.norm(of_axis * satellites.sigma_int_m, axis=1)
        apart_m = np.linalg.norm((of_axis - of_axis[0]) * satellites.sigma_acc_m, axis=1)
        offset_m = factor * apart_m + np.abs(of_axis) @ satellites.bias_m
        prior = np.array([2.0, *(prior for _, prior in rows)])

        def excess(level_m, sigma_m=sigma_m, offset_m=offset_m, prior=prior, risk=risk):
            beyond = np.where(level_m > offset_m, ndtr((offset_m - level_m) / sigma_m), 1.0)
            return np.log(max(prior @ beyond, 1e-300) / risk)

        found.append(brentq(excess, 1e-3, 1e7, xtol=1e-10, rtol=1e-15, maxiter=500))
    return float(np.hypot(found[0], found[1])), found[2]


@pytest.mark.slow
def test_the_published_example_has_its_published_levels():
    satellites = ranging(-EXAMPLE[:, :3], np.repeat([0, 1], 5), np.sqrt(EXAMPLE[:, 3:].T))
    hpl_m, vpl_m = levels_of(satellites)
    assert hpl_m == pytest.approx(14.5, abs=0.05)
    assert vpl_m == pytest.approx(19.2, abs=0.05)


SINGLE = [
    (counts, 1e-5, (1e-8, 1e-4, 1e-4))
    for counts in ((5,), (9,), (4, 4), (3, 6), (8, 1), (9, 7), (5, 4, 4))
]
PAIRS = [((6, 6), 1e-4, (0.0, 1e-4)), ((8,), 3e-4, (0.0,)), ((14, 13, 14), 2e-5, (0.0, 1e-4, 1e-5))]


@pytest.mark.parametrize(("counts", "p_sat", "p_const"), SINGLE + PAIRS)
def test_levels_are_those_of_the_equations_with_pairs_of_faults_until_what_is_left_is_little(
    counts, p_sat, p_const
):
    for seed in range(5) if p_sat == 1e-5 else [7]:
        satellites = drawn(seed, counts, p_sat=p_sat, p_const=p_const[: len(counts)])
        found = levels_of(satellites, FINE)
        assert np.isfinite(found).all() or p_sat == 1e-5
        np.testing.assert_allclose(
            found, slow_levels(satellites, FINE), rtol=1e-9, atol=1e-7 if p_sat == 1e-5 else 0
        )


def test_levels_are_rounded_up_by_their_tolerance_at_most():
    satellites = drawn(1, (8, 7))
    lifted_m = np.subtract(levels_of(satellites), levels_of(satellites, FINE))
    assert ((lifted_m >= 0) & (lifted_m <= [np.hypot(0.05, 0.05), 1e-4])).all()


def test_without_faults_a_level_is_a_multiple_of_its_standard_deviation_and_the_bias():
    satellites = drawn(2, (7,), p_sat=0.0, p_const=(0.0,))
    of_up = gains(satellites, np.arange(7))[2]
    expected_m = norm.isf(BUDGET.phmi_vertical / 2) * np.hypot.reduce(
        of_up * satellites.sigma_int_m
    )
    assert levels_of(satellites)[1] == pytest.approx(
        expected_m + np.abs(of_up) @ satellites.bias_m, abs=1e-9
    )


def test_what_no_subset_stands_for_too_few_satellites_and_those_on_one_cone_have_no_level():
    satellites = drawn(3, (4, 1), p_sat=0.0, p_const=(0.0, 0.0))
    patterns = np.array([[0, 0b00111, 0b10111, 0b01111, 0b11111]], np.uint32)
    is_finite = np.isfinite(protection_levels(patterns, satellites, BUDGET))
    np.testing.assert_array_equal(is_finite, [[False, False, False, True, True]] * 2)
    cone = unit_vectors(np.linspace(0, 2 * np.pi, 8, endpoint=False), np.full(8, 0.6))
    assert levels_of(ranging(cone, np.zeros(8, int), (np.ones(8), np.ones(8)), p_const=(0.0,))) == (
        np.inf,
        np.inf,
    )
    # All of one constellation may fail at once; without another nothing would tell.
    assert np.isfinite(levels_of(drawn(4, (9,), p_const=(1e-8,)))).all()
    assert levels_of(drawn(4, (9,), p_const=(1e-7,))) == (np.inf, np.inf)


def test_levels_do_not_depend_on_the_order_of_satellites_nor_on_those_unseen():
    satellites, order = drawn(5, (22, 20)), np.random.default_rng(0).permutation(42)
    seen = np.random.default_rng(1).random((42, 30)) < 0.4
    turned = Ranging(*(values[order] for values in satellites[:-1]), satellites.p_const)

    of_all = protection_levels(words_of(seen), satellites, FINE)
    np.testing.assert_allclose(
        protection_levels(words_of(seen[order]), turned, FINE), of_all, rtol=1e-9
    )
    chosen = np.flatnonzero(seen[:, 0])
    alone = Ranging(*(values[chosen] for values in satellites[:-1]), satellites.p_const)
    np.testing.assert_allclose(levels_of(alone, FINE), of_all[:, 0], rtol=1e-12)


@pytest.mark.parametrize("counts", [(8, 7, 9), (9, 8, 7, 8)])
def test_levels_do_not_depend_on_the_order_of_systems(counts):
    """With three and more, pairs of a constellation and a satellite are equally probable, and only some were taken."""
    satellites = drawn(6, counts, p_const=(1e-4,) * len(counts))
    of_all = levels_of(satellites, FINE)
    for order in (np.roll(range(len(counts)), 1), range(len(counts))[::-1]):
        rows = np.concatenate([np.flatnonzero(satellites.constellation == c) for c in order])
        renamed = Ranging(*(values[rows] for values in satellites[:-1]), satellites.p_const)
        renamed = renamed._replace(constellation=np.argsort(order)[renamed.constellation])
        np.testing.assert_allclose(levels_of(renamed, FINE), of_all, rtol=1e-9)


def test_tails_and_quantiles_are_scipys():
    probability = np.logspace(-16, -0.5, 60)
    found = np.array([quantile(p) for p in probability])
    np.testing.assert_allclose(found, norm.isf(probability), rtol=1e-13)
    np.testing.assert_allclose([tail(x) for x in found], probability, rtol=1e-12)


@pytest.mark.parametrize("counts", [(5,), (9,), (6, 5), (12, 10)])
def test_levels_are_sidereons(counts):
    peer = pytest.importorskip(
        "benchmarks.sidereon_peer", reason="sidereon (dev extra) is not installed"
    )
    systems = np.repeat(["gps", "galileo"], (*counts, 0)[:2]).tolist()
    satellites = drawn(11, counts, p_const=(1e-8, 1e-4)[: len(counts)])
    patterns = np.random.default_rng(2).integers(0, 2 ** len(systems), (1, 200)).astype(np.uint32)
    theirs = peer.Peer(satellites, systems, BUDGET).levels(patterns)
    ours = protection_levels(patterns, satellites, BUDGET)
    np.testing.assert_array_equal(np.isfinite(ours), np.isfinite(theirs))
    is_near = (
        theirs < 1000
    )  # beyond, satellites that all but leave the position undetermined magnify rounding
    np.testing.assert_allclose(ours[is_near], theirs[is_near], atol=1e-6, rtol=0)
    assert is_near.any()
