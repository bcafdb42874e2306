"""Protection levels of choices of satellites: multiple-hypothesis solution separation (ARAIM), compiled by Numba."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt

from jaxurban.kernels.compiled import compiled

AXES = 3  # east, north, up
WORD_BITS = 32
# Of a pivot of the normal matrix to its diagonal, below which the satellites leave the position undetermined.
LEAST_PIVOT = 1e-13
SAME = 1 - 1e-9  # priors that differ by less, as products of the same numbers may, are equal
MOST_HALVINGS = 100  # of the interval that holds a protection level
NO_EVENT = -1  # second event of a mode of one
SQRT_HALF, SQRT_TWO_PI = math.sqrt(0.5), math.sqrt(2 * math.pi)


class Ranging(NamedTuple):
    """What is known of ``S`` satellites of ``C`` constellations before anything is measured.

    Attributes:
      directions: ``[S, 3]`` unit vectors east, north, up.
      constellation: ``[S]`` number of each satellite's own, whose clock is one unknown.
      sigma_int_m: ``[S]`` standard deviation of range errors that integrity counts on.
      sigma_acc_m: ``[S]`` that of accuracy and continuity.
      bias_m: ``[S]`` largest nominal bias.
      p_sat: ``[S]`` prior probability that the satellite is faulty.
      p_const: ``[C]`` that of a fault of the whole constellation.
    """

    directions: Float[np.ndarray, "S 3"]
    constellation: Int[np.ndarray, " S"]
    sigma_int_m: Float[np.ndarray, " S"]
    sigma_acc_m: Float[np.ndarray, " S"]
    bias_m: Float[np.ndarray, " S"]
    p_sat: Float[np.ndarray, " S"]
    p_const: Float[np.ndarray, " C"]


class RiskBudget(NamedTuple):
    """How risks are shared out; see `protection_levels` for the equations.

    Attributes:
      phmi_horizontal, phmi_vertical: integrity risk, half of the first for each horizontal axis.
      pfa_horizontal, pfa_vertical: false alerts.
      p_unmonitored: most probability of faults that no subset stands for.
      tolerance_horizontal_m, tolerance_vertical_m: by how much a protection level may be rounded up.
    """

    phmi_horizontal: float
    phmi_vertical: float
    pfa_horizontal: float
    pfa_vertical: float
    p_unmonitored: float
    tolerance_horizontal_m: float
    tolerance_vertical_m: float


def protection_levels(
    patterns: UInt[np.ndarray, "W P"], ranging: Ranging, budget: RiskBudget
) -> Float[np.ndarray, "2 P"]:
    """Return the horizontal and the vertical protection level (metres, float64) of each choice of satellites.

    Weighted least squares with G = [-e -n -u | clocks] and W = 1 / sigma_int^2, one clock for each constellation in
    view: S = (G^T W G)^-1 G^T W with all satellites, S_k without the satellites of fault mode k, of which there are N.
    With sigma_k^2 = sum (S_k sigma_int)^2, b_k = sum |S_k| b, T_k = K_fa sqrt(sum ((S_k - S) sigma_acc)^2) and K_fa =
    Q^-1(P_fa / (2 N)), where each horizontal axis takes half of P_fa, the level L of an axis solves
    ``2 Q((L - b_0) / sigma_0) + sum_k p_k Q'((L - T_k - b_k) / sigma_k) = PHMI (1 - P_unmonitored / sum of PHMI)``,
    Q' = Q above 0 and 1 below. The horizontal level is the hypotenuse of east and north.

    Fault modes are each satellite and each constellation in view, then pairs of these by falling probability, until the
    probability of all other faults is at most ``p_unmonitored``. Of pairs of equal probability all are taken or none,
    so that the order of satellites and systems changes nothing. Modes whose subset leaves the position undetermined
    count as unmonitored too. A level is inf if more than ``p_unmonitored`` is left unmonitored, or if all satellites
    together leave the position undetermined.

    Sources: Blanch et al. 2012 (ION GNSS) and 2015 (IEEE Trans. AES 51, "Baseline advanced RAIM user algorithm and
    possible improvements"); EU-US Working Group C, ARAIM Milestone 3 report, 2016, and its Reference Airborne Algorithm
    Description Document 3.0, equations 26, 27, 31, 32. The level is the upper end of an interval that holds the
    solution, so it is never below the solution. The interval begins with 0 and the level without faults (doubled until
    it is enough), and is halved until it is no longer than the tolerance.

    Args:
      patterns: ``[W, P]`` choices of satellites; satellite ``s`` is bit ``s % 32`` of word ``s // 32``.
      ranging: what is known of the satellites.
      budget: how the risks are shared out.
    """
    levels = np.empty((2, patterns.shape[1]))
    _fill_levels(
        np.ascontiguousarray(patterns), Ranging(*map(np.ascontiguousarray, ranging)), budget, levels
    )
    return levels


@compiled()
def _fill_levels(patterns, ranging, budget, levels):
    """Fill ``levels`` ``[2, P]`` with the horizontal and the vertical level of each choice of satellites, metres.

    Arguments are otherwise those of `protection_levels`.
    """
    num_satellites = len(ranging.directions)
    for number in range(patterns.shape[1]):
        seen = np.empty(num_satellites, np.int64)
        num = 0
        for s in range(num_satellites):
            if (patterns[s // WORD_BITS, number] >> np.uint32(s % WORD_BITS)) & np.uint32(1):
                seen[num] = s
                num += 1
        # The satellites of this choice, whose bits are set, are the first `num` of `seen`.
        levels[0, number], levels[1, number] = _levels_of(seen[:num], ranging, budget)


@compiled()
def _levels_of(seen, ranging, budget):
    """Return the horizontal and the vertical protection level, metres; both inf where there is none.

    The equations are those of `protection_levels`. A fault mode has two events: a number below ``n`` is a satellite of
    ``seen``, a number from ``n`` on is a constellation in view, and `NO_EVENT` in the second place means one event
    only.

    Args:
      seen: ``[n]`` numbers of the satellites in view.
      ranging: `Ranging` of all satellites.
      budget: `RiskBudget`.
    """
    # S of all satellites; without it there is no position.
    num = len(seen)
    is_kept = np.ones(num, np.bool_)
    of_all, of_subset = np.empty((AXES, num)), np.empty((AXES, num))
    if not _fill_gains(seen, is_kept, ranging, of_all):
        return np.inf, np.inf

    # Fault modes, and K_fa: false alerts are shared by the modes, by both tails, and by the two horizontal axes.
    constellations, prior = _events(seen, ranging)
    modes, p_mode, p_left = _fault_modes(prior, budget.p_unmonitored)
    num_modes = len(modes)
    k_horizontal, k_vertical = 0.0, 0.0
    if num_modes:
        k_horizontal = quantile(budget.pfa_horizontal / (4 * num_modes))
        k_vertical = quantile(budget.pfa_vertical / (2 * num_modes))

    # Terms of the modes that are monitored, the one without faults first: sigma_k, and T_k + b_k together.
    sigma_m = np.empty((AXES, num_modes + 1))
    offset_m = np.empty((AXES, num_modes + 1))
    p_row = np.empty(num_modes + 1)
    _fill_terms(of_all, of_all, 0.0, 0.0, seen, ranging, sigma_m[:, 0], offset_m[:, 0])
    rows = 1  # modes filled in so far
    for mode in range(num_modes):
        # Leave out the satellites of the mode's events.
        for i in range(num):
            is_kept[i] = True
        for event in modes[mode]:
            if event >= num:
                for i in range(num):
                    is_kept[i] &= ranging.constellation[seen[i]] != constellations[event - num]
            elif event != NO_EVENT:
                is_kept[event] = False

        # A mode whose subset leaves the position undetermined is not monitored.
        if not _fill_gains(seen, is_kept, ranging, of_subset):
            p_left += p_mode[mode]
            continue
        _fill_terms(
            of_subset,
            of_all,
            k_horizontal,
            k_vertical,
            seen,
            ranging,
            sigma_m[:, rows],
            offset_m[:, rows],
        )
        p_row[rows] = p_mode[mode]
        rows += 1

    # Faults that are left unmonitored take their share of the integrity risk; modes share the rest.
    share = 1 - p_left / (budget.phmi_horizontal + budget.phmi_vertical)
    if p_left > budget.p_unmonitored or share <= 0:
        return np.inf, np.inf

    # Axis 2 is up; east and north take half of the horizontal risk each.
    of_axis = np.empty(AXES)
    for axis in range(AXES):
        risk = budget.phmi_vertical if axis == 2 else budget.phmi_horizontal / 2
        tolerance_m = budget.tolerance_vertical_m if axis == 2 else budget.tolerance_horizontal_m
        of_axis[axis] = _level(
            sigma_m[axis, :rows], offset_m[axis, :rows], p_row[:rows], risk * share, tolerance_m
        )
    return math.hypot(of_axis[0], of_axis[1]), of_axis[2]


@compiled()
def _events(seen, ranging):
    """Return the constellations in view, and the prior probabilities of all events.

    Args:
      seen: ``[n]`` numbers of the satellites in view.
      ranging: `Ranging` of all satellites.

    Returns:
      ``[m]`` numbers of the constellations, ascending, and ``[n + m]`` priors: of a fault of each satellite of
      ``seen``, then of each of these constellations.
    """
    constellations = np.unique(ranging.constellation[seen])
    prior = np.empty(len(seen) + len(constellations))
    for i in range(len(seen)):
        prior[i] = ranging.p_sat[seen[i]]
    for c in range(len(constellations)):
        prior[len(seen) + c] = ranging.p_const[constellations[c]]
    return constellations, prior


@compiled()
def _fault_modes(prior, p_unmonitored):
    """Return the fault modes, their priors, and the probability of all sets of several events that are no modes.

    Modes are the single events, and as many pairs of events as `protection_levels` says.

    Args:
      prior: ``[E]`` prior probabilities of the events; an event of probability 0 is in no mode.
      p_unmonitored: largest probability that may be left.

    Returns:
      ``[K, 2]`` numbers of each mode's events, the second one `NO_EVENT` for a single event; ``[K]`` its prior; what is
      left.
    """
    # The elementary symmetric sums: p_of_order[k] is the sum of the products of every k priors. Each event adds to all
    # orders from the highest down, so that it is in no product twice.
    num_events = len(prior)
    p_of_order = np.zeros(num_events + 1)
    p_of_order[0] = 1.0
    for event in range(num_events):
        for order in range(event + 1, 0, -1):
            p_of_order[order] += p_of_order[order - 1] * prior[event]

    # Pairs are needed only where single events leave too much.
    p_left = p_of_order[2:].sum()
    num_pairs = num_events * (num_events - 1) // 2 if p_left > p_unmonitored else 0

    # Single events.
    modes = np.full((num_events + num_pairs, 2), NO_EVENT)
    p_mode = np.empty(num_events + num_pairs)
    num_modes = 0
    for event in range(num_events):
        if prior[event] > 0:
            modes[num_modes, 0] = event
            p_mode[num_modes] = prior[event]
            num_modes += 1

    # The likeliest pairs first, until little enough is left and the next pair is less likely than the last one.
    if num_pairs:
        pairs = np.empty((num_pairs, 2), np.int64)
        p_pair = np.empty(num_pairs)
        pair = 0
        for event in range(num_events):
            for other_event in range(event + 1, num_events):
                pairs[pair, 0] = event
                pairs[pair, 1] = other_event
                p_pair[pair] = prior[event] * prior[other_event]
                pair += 1
        # Pairs of equal priors stay in their order, and are taken all or none.
        for pair in np.argsort(-p_pair, kind="mergesort"):
            is_enough = p_left <= p_unmonitored and p_pair[pair] < p_mode[num_modes - 1] * SAME
            if is_enough or p_pair[pair] == 0:
                break
            modes[num_modes, 0] = pairs[pair, 0]
            modes[num_modes, 1] = pairs[pair, 1]
            p_mode[num_modes] = p_pair[pair]
            p_left -= p_pair[pair]
            num_modes += 1
    return modes[:num_modes], p_mode[:num_modes], p_left


@compiled()
def _fill_gains(seen, is_kept, ranging, gains):
    """Fill ``gains`` with the rows of S for east, north and up; return whether the position is determined.

    Args:
      seen: ``[n]`` numbers of the satellites in view.
      is_kept: ``[n]`` bool which of these are used; the gains of the others are 0.
      ranging: `Ranging` of all satellites.
      gains: ``[3, n]`` filled in place, or left as it was if the position is undetermined.
    """
    # Number the unknowns: east, north, up, then a clock for each constellation that is used.
    clock = np.full(len(ranging.p_const), -1, np.int64)
    size, num_kept = AXES, 0
    for i in range(len(seen)):
        if is_kept[i]:
            num_kept += 1
            if clock[ranging.constellation[seen[i]]] < 0:
                clock[ranging.constellation[seen[i]]] = size
                size += 1
    if num_kept < size or num_kept == 0:
        return False

    # The lower triangle of the normal matrix G^T W G, G = [-e -n -u | clocks].
    normal = np.zeros((size, size))
    for i in range(len(seen)):
        if is_kept[i]:
            s = seen[i]
            weight = 1 / ranging.sigma_int_m[s] ** 2
            own = clock[ranging.constellation[s]]
            for j in range(AXES):
                for k in range(j + 1):
                    normal[j, k] += weight * ranging.directions[s, j] * ranging.directions[s, k]
                normal[own, j] -= weight * ranging.directions[s, j]
            normal[own, own] += weight
    if not _factorise(normal):
        return False

    # S = (G^T W G)^-1 G^T W, of which the first three rows are needed.
    inverse = np.zeros((AXES, size))  # rows of the inverse of the normal matrix
    for axis in range(AXES):
        _solve(normal, axis, inverse[axis])
    for i in range(len(seen)):
        s = seen[i]
        for axis in range(AXES):
            gains[axis, i] = 0.0
            if is_kept[i]:
                gain = -inverse[axis, clock[ranging.constellation[s]]]
                for j in range(AXES):
                    gain += inverse[axis, j] * ranging.directions[s, j]
                gains[axis, i] = gain / ranging.sigma_int_m[s] ** 2
    return True


@compiled()
def _factorise(normal):
    """Turn the lower triangle of a symmetric matrix ``[n, n]`` into its Cholesky factor, in place.

    Return False, with the work half done, where the matrix is singular: a pivot is below `LEAST_PIVOT` of its diagonal.
    """
    for j in range(len(normal)):
        diagonal = normal[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= normal[j, k] ** 2
        if not pivot > LEAST_PIVOT * diagonal:
            return False
        normal[j, j] = math.sqrt(pivot)
        for i in range(j + 1, len(normal)):
            for k in range(j):
                normal[i, j] -= normal[i, k] * normal[j, k]
            normal[i, j] /= normal[j, j]
    return True


@compiled()
def _solve(factor, unit, column):
    """Fill ``column`` ``[n]`` with column number ``unit`` of the inverse of L L^T, L the Cholesky factor ``[n, n]``."""
    # L y = e, e the unit vector, from the first row down.
    for i in range(len(factor)):
        column[i] = 1.0 if i == unit else 0.0
        for k in range(i):
            column[i] -= factor[i, k] * column[k]
        column[i] /= factor[i, i]

    # L^T x = y, from the last row up.
    for i in range(len(factor) - 1, -1, -1):
        for k in range(i + 1, len(factor)):
            column[i] -= factor[k, i] * column[k]
        column[i] /= factor[i, i]


@compiled()
def _fill_terms(gains, of_all, k_horizontal, k_vertical, seen, ranging, sigma_m, offset_m):
    """Fill sigma_k and T_k + b_k of one fault mode, by axis, in metres (see `protection_levels`).

    Args:
      gains: ``[3, n]`` S_k of the mode.
      of_all: ``[3, n]`` S of all satellites.
      k_horizontal, k_vertical: K_fa of either direction.
      seen: ``[n]`` numbers of the satellites in view.
      ranging: `Ranging` of all satellites.
      sigma_m, offset_m: ``[3]`` filled in place.
    """
    for axis in range(AXES):
        variance, separation, bias_m = 0.0, 0.0, 0.0
        for i in range(len(seen)):
            s = seen[i]
            variance += (gains[axis, i] * ranging.sigma_int_m[s]) ** 2
            separation += ((gains[axis, i] - of_all[axis, i]) * ranging.sigma_acc_m[s]) ** 2
            bias_m += abs(gains[axis, i]) * ranging.bias_m[s]
        sigma_m[axis] = math.sqrt(variance)
        k_alert = k_vertical if axis == 2 else k_horizontal
        offset_m[axis] = k_alert * math.sqrt(separation) + bias_m


@compiled()
def _level(sigma_m, offset_m, prior, risk, tolerance_m):
    """Return the protection level of one axis, metres, at most ``tolerance_m`` above the solution.

    Args:
      sigma_m, offset_m: ``[K]`` sigma_k and T_k + b_k of the modes, the one without faults first.
      prior: ``[K]`` probabilities of the modes; the first is not read.
      risk: integrity risk of the axis.
      tolerance_m: length of the interval at which halving ends.
    """
    # Half of the risk lies in either tail. Without fault modes that is the answer; with them, where to begin.
    high_m = quantile(risk / 2) * sigma_m[0] + offset_m[0]
    if len(sigma_m) == 1:
        return high_m
    while not _is_enough(high_m, sigma_m, offset_m, prior, risk):
        high_m *= 2

    low_m = 0.0
    for _ in range(MOST_HALVINGS):
        if high_m - low_m <= tolerance_m:
            break
        middle_m = (low_m + high_m) / 2
        if _is_enough(middle_m, sigma_m, offset_m, prior, risk):
            high_m = middle_m
        else:
            low_m = middle_m
    return low_m + tolerance_m


@compiled()
def _is_enough(level_m, sigma_m, offset_m, prior, risk):
    """Return whether the probability of errors beyond a level is at most the risk; arguments as in `_level`."""
    total = 2 * tail((level_m - offset_m[0]) / sigma_m[0])
    for mode in range(1, len(sigma_m)):
        beyond = (level_m - offset_m[mode]) / sigma_m[mode]
        total += prior[mode] * (tail(beyond) if beyond > 0 else 1.0)
        if total > risk:
            return False
    return total <= risk


@compiled()
def tail(x):
    """Return Q(x), the probability that a standard normal variable is larger."""
    return 0.5 * math.erfc(x * SQRT_HALF)


@compiled()
def quantile(probability):
    """Return Q^-1 of a probability between 0 and 0.5, by Newton's method on the logarithm of Q, which is concave."""
    # Above the solution, since Q(x) <= exp(-x^2 / 2) / 2.
    x = math.sqrt(-2 * math.log(2 * probability))
    for _ in range(MOST_HALVINGS):
        of_tail = tail(x)
        # -log(Q(x) / probability) over the derivative of log Q, -exp(-x^2 / 2) / (sqrt(2 pi) Q(x)).
        step = math.log(of_tail / probability) * of_tail * SQRT_TWO_PI * math.exp(x * x / 2)
        x += step
        if abs(step) <= 1e-14 * x:  # rounding
            break
    return x
