"""Dilutions of precision from the satellites that are seen, in closed form, with one clock or one for each system."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, UInt

from jaxurban.kernels.shadows.sweep import WORD_BITS
from jaxurban.kernels.two_floats import product_and_rest, sum_and_rest

LEAST_SATELLITES = 4  # three coordinates and the clock

# A pivot of the normal matrix, 1 with every satellite in view, that counts as none: rounding leaves
# about 1e-7 of a singular matrix, and a DOP of 20 keeps pivots above 1e-3.
LEAST_PIVOT = 1e-6

# A clock's pivot below which its satellites say nothing, and it is left out: a millionth of the least pivot, and far
# above where a float's reciprocal squared, in gradients, overflows.
LEAST_CLOCK = 1e-12

ENTRIES = [(i, j) for i in range(4) for j in range(i + 1)]  # lower triangle of a symmetric 4 x 4 matrix
POSITION_ENTRIES = ENTRIES[:6]  # the same of a 3 x 3 matrix

Matrix = dict[tuple[int, int], Array]
TwoFloats = tuple[Array, Array]  # a number, and what rounding left of it


class Clocks(NamedTuple):
    """Which receiver clock each satellite is measured by, one for each system.

    Attributes:
      numbers: ``[S]`` number of each satellite's clock, from 0 up, in the order in which one of them is the time's.
      num: how many there are, some perhaps without satellites.
    """

    numbers: np.ndarray
    num: int


class Geometry(NamedTuple):
    """The geometry matrix G = Q R of all satellites, rows [east, north, up, -1].

    In the columns of Q the normal matrix of all satellites is the identity, and that of those in
    view lies between 0 and 1: so float32 keeps DOPs of 20 to about 1e-5, where sums of unit vectors
    lose them to 1e-3. And as no sum of products passes 1, products rounded to the float's step above
    1 add up exactly, and so do the rests: the DOPs of a choice of satellites are the same bits in any
    order of summation.

    Attributes:
      products: ``[2, 10, S]`` products of Q's columns by `ENTRIES`, rounded, and what rounding left.
      basis: ``[4, 4]`` the inverse of R, upper triangular.
    """

    products: np.ndarray
    basis: np.ndarray


class ClockGeometry(NamedTuple):
    """The same with a clock for each of ``C`` systems, rows [-1 in the column of its system, 0 ..., east, north, up].

    No two clocks have a satellite in common, so that the columns of Q that stand for clocks are those of G, scaled,
    the normal matrix is diagonal there, and what a clock takes from the position is its own satellites' mean.

    Attributes:
      products: ``[2, 4 C + 6, S]`` products of Q's columns, rounded, and what rounding left: the square of every
        clock's, its products with the three of the position, and those of the position by `POSITION_ENTRIES`.
      basis: ``[3, 3]`` the inverse of R where it is the position's, upper triangular.
      clocks: ``[C, 4]`` the rest of R's inverse: a clock's diagonal entry and its entries in the position's columns.
      members: ``[C, S]`` 1 where a satellite is of a system; systems may be without.
    """

    products: np.ndarray
    basis: np.ndarray
    clocks: np.ndarray
    members: np.ndarray


AnyGeometry = Geometry | ClockGeometry


class Dops(NamedTuple):
    """Geometric, position, horizontal, vertical and time dilution of precision; inf if undetermined.

    With a clock for each system the time is that of the first one that is seen.
    """

    gdop: Array
    pdop: Array
    hdop: Array
    vdop: Array
    tdop: Array


def unit_vectors(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> np.ndarray:
    """Return ``[S, 3]`` float64 unit vectors east, north, up from ``[S]`` look angles.

    Azimuth is clockwise from north, elevation above the horizon.
    """
    azimuth, elevation = np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float)
    level = np.cos(elevation)
    return np.column_stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)])


def geometry(
    directions: np.ndarray,
    dtype: type = np.float32,
    multiple_of: int = 1,
    clocks: Clocks | None = None,
    weights: ArrayLike | None = None,
) -> AnyGeometry:
    """Return the geometry of all satellites, computed in float64 on the host.

    Args:
      directions: ``[S, 3]`` unit vectors east, north, up. Satellites that all together leave the
        position undetermined (fewer than four, or on one cone) give inf for every choice of them.
      dtype: of the result; decides the precision of the DOPs.
      multiple_of: satellites that weigh nothing are added up to a multiple of this, so that few
        programs are compiled.
      clocks: which clock each satellite has; left out, or where there is one, all share it.
      weights: ``[S]`` of the satellites where they count differently, as one over the variance of a range; left out, 1.
    """
    directions = np.asarray(directions, float).reshape(-1, 3)
    num = len(directions)
    padded = max(1, -(-num // multiple_of)) * multiple_of
    scale = np.ones(num) if weights is None else np.sqrt(np.asarray(weights, float))
    if clocks is not None and clocks.num > 1:
        return _clock_geometry(directions, scale, clocks, padded, dtype)
    rows = np.zeros((padded, 4))
    basis = np.eye(4)
    matrix = np.column_stack([directions, -np.ones(num)]) * scale[:, None]
    if np.linalg.matrix_rank(matrix) == 4:
        rows[:num], triangle = np.linalg.qr(matrix)
        basis = np.linalg.inv(triangle)
    products = [rows[:, i] * rows[:, j] for i, j in ENTRIES]
    return Geometry(_in_two_parts(products, dtype), basis.astype(dtype))


def _clock_geometry(
    directions: np.ndarray, scale: np.ndarray, clocks: Clocks, padded: int, dtype: type
) -> ClockGeometry:
    """Return `geometry` with several clocks; rows are multiplied by ``scale`` ``[S]``, and filled up to ``padded``."""
    num = len(directions)
    members, inverse = np.zeros((clocks.num, padded)), np.zeros((clocks.num, 4))
    members[np.asarray(clocks.numbers, int), np.arange(num)] = 1
    times, places, basis = np.zeros((padded, clocks.num)), np.zeros((padded, 3)), np.eye(3)
    columns, matrix = -members[:, :num].T * scale[:, None], directions * scale[:, None]
    norms = np.linalg.norm(columns, axis=0)
    if np.linalg.matrix_rank(np.column_stack([columns, matrix])) == np.count_nonzero(norms) + 3:
        norms = np.where(norms > 0, norms, 1.0)
        times[:num] = columns / norms
        across = times[:num].T @ matrix
        places[:num], triangle = np.linalg.qr(matrix - times[:num] @ across)
        basis = np.linalg.inv(triangle)
        inverse = np.column_stack([1 / norms, -across @ basis / norms[:, None]])
    products = [
        *(times[:, c] ** 2 for c in range(clocks.num)),
        *(times[:, c] * places[:, i] for c in range(clocks.num) for i in range(3)),
        *(places[:, i] * places[:, j] for i, j in POSITION_ENTRIES),
    ]
    basis, inverse, members = basis.astype(dtype), inverse.astype(dtype), members.astype(dtype)
    return ClockGeometry(_in_two_parts(products, dtype), basis, inverse, members)


def _in_two_parts(products: list[np.ndarray], dtype: type) -> np.ndarray:
    """Return products of Q's columns rounded to the float's step above 1, and what that left, rounded too."""
    step = float(np.finfo(dtype).eps)
    exact = np.array(products)
    rounded = np.round(exact / step) * step
    fine = step / 2**16  # rests of 500 satellites add up to less than 2^24 of these
    rests = np.round((exact - rounded) / fine) * fine
    return np.array([rounded, rests], dtype)


@jax.jit
def dops(satellites: AnyGeometry, weights: Float[Array, "S ..."]) -> Dops:
    """Return the DOPs of satellites under weights, each ``[...]``.

    ``GDOP = sqrt(trace((G^T W G)^-1))``, its east, north, up and clock terms in the others (Langley
    1999, the paper's PDOP equation with the square left out); of several clocks the trace has one, the first that is
    seen. Exact derivatives by the weights; zero where the result is inf: where a pivot is below `LEAST_PIVOT` (fewer
    satellites than three and one for each clock, or all on one cone; rounding may turn this inf into a DOP of several
    hundreds).

    As the weights of a system go to 0, so does all that it says, and its clock is left out. Where it was the first, the
    next one takes its place in GDOP and TDOP, without a kink, while the sum of its weights goes from 1 to 0.

    Args:
      satellites: from `geometry`.
      weights: 1 for a satellite that is seen, 0 for one that is not, or between; any axes of cells behind.
    """
    sums, rests = _summed(satellites.products, weights)
    if isinstance(satellites, ClockGeometry):
        seen = _summed(satellites.members, weights)
        (east, north, up, clock), is_determined = _variances_by_clock(satellites, sums, rests, seen)
    else:
        (east, north, up, clock), is_determined = _variances(satellites.basis, list(sums + rests))

    def root(variance: Array) -> Array:
        return jnp.where(is_determined, jnp.sqrt(jnp.where(is_determined, variance, 1.0)), jnp.inf)

    position = east + north + up
    return Dops(root(position + clock), root(position), root(east + north), root(up), root(clock))


def _summed(values: Float[np.ndarray, "... S"], weights: Float[Array, "S ..."]) -> Array:
    return jnp.tensordot(values, weights, axes=1, precision=lax.Precision.HIGHEST)  # else GPUs take TF32


def _variances(basis: Array | np.ndarray, summed: list[Array]) -> tuple[list[Array], Bool[Array, "..."]]:
    """Return the variances east, north, up and of the one clock, and whether they are determined."""
    lower, pivots, is_determined = _factors(dict(zip(ENTRIES, summed, strict=True)), 4)
    return [_variance(row, lower, pivots) for row in _upper_rows(basis)], is_determined


def _variances_by_clock(
    satellites: ClockGeometry, sums: Float[Array, "P ..."], rests: Float[Array, "P ..."], seen: Float[Array, "C ..."]
) -> tuple[list[Array], Bool[Array, "..."]]:
    """Return the variances east, north, up and of the first clock seen, and whether they are determined.

    The clocks are eliminated first. In the normal matrix [D B; B^T A], D diagonal, the position's part of the inverse
    is that of A - B^T D^-1 B, and a clock's variance is one over what it sees, and the position's along its mean row
    B / D. The difference is taken of two floats each: in one, DOPs near 20 would lose 1e-5.

    Args:
      satellites: their geometry.
      sums, rests: of its products under the weights.
      seen: sums of the weights, by clock.
    """
    num = len(seen)
    pivots_of = sum_and_rest(sums[:num], rests[:num])
    is_seen = pivots_of[0] > LEAST_CLOCK
    pivots_of = jnp.where(is_seen, pivots_of[0], 1.0), jnp.where(is_seen, pivots_of[1], 0.0)
    rows = [part[num : 4 * num].reshape(num, 3, *seen.shape[1:]) for part in (sums, rests)]
    rows = [jnp.where(is_seen[:, None], part, 0.0) for part in rows]
    means = _quotient((rows[0], rows[1]), (pivots_of[0][:, None], pivots_of[1][:, None]))
    normal = sums[4 * num :], rests[4 * num :]
    first, second = (np.array(side) for side in zip(*POSITION_ENTRIES, strict=True))
    for c in range(num):
        normal = _difference(normal, (means[0][c, first], means[1][c, first]), (rows[0][c, second], rows[1][c, second]))
    lower, pivots, is_determined = _factors(dict(zip(POSITION_ENTRIES, normal[0] + normal[1], strict=True)), 3)
    position = [_variance(row, lower, pivots) for row in _upper_rows(satellites.basis)]
    own, across = (
        part.reshape(*part.shape, *[1] * (seen.ndim - 1))
        for part in (satellites.clocks[:, 0], satellites.clocks[:, 1:])
    )
    toward = across - own[:, None] * (means[0] + means[1])
    along = _variance({i: toward[:, i] for i in range(3)}, lower, pivots)
    of_clocks = own**2 / (pivots_of[0] + pivots_of[1]) + along
    share = jnp.where(is_seen, _smooth_step(seen), 0.0)
    left = jnp.cumprod(jnp.concatenate([jnp.ones_like(share[:1]), 1 - share[:-1]]), axis=0)
    return [*position, jnp.sum(left * share * of_clocks, axis=0)], is_determined


def _quotient(a: TwoFloats, b: TwoFloats) -> TwoFloats:
    """Return a / b."""
    high = a[0] / b[0]
    product, rest = product_and_rest(high, b[0])
    return high, ((a[0] - product) - rest + a[1] - high * b[1]) / b[0]


def _difference(a: TwoFloats, b: TwoFloats, c: TwoFloats) -> TwoFloats:
    """Return a - b c."""
    product, rest = product_and_rest(b[0], c[0])
    high, low = sum_and_rest(a[0], -product)
    return high, a[1] + (low - (rest + b[0] * c[1] + b[1] * c[0]))


def _smooth_step(value: Array) -> Array:
    """Return 0 up to 0, 1 from 1 on, between them 3 x^2 - 2 x^3."""
    x = jnp.clip(value, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def _factors(normal: Matrix, size: int) -> tuple[Matrix, list[Array], Bool[Array, "..."]]:
    """Return L and D of normal = L D L^T, unit lower triangular L, and whether no pivot counts as none.

    Unlike cofactors they do not cancel. Pivots that count as none are 1 instead.
    """
    lower: Matrix = {}
    pivots: list[Array] = []
    is_determined = jnp.asarray(True)
    for j in range(size):
        pivot = normal[j, j]
        for k in range(j):
            pivot -= lower[j, k] ** 2 * pivots[k]
        is_determined &= pivot > LEAST_PIVOT
        pivots.append(jnp.where(pivot > LEAST_PIVOT, pivot, 1.0))
        for i in range(j + 1, size):
            rest = normal[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k] * pivots[k]
            lower[i, j] = rest / pivots[j]
    return lower, pivots, is_determined


def _upper_rows(basis: Array | np.ndarray) -> list[dict[int, Array]]:
    """Return the rows of an upper triangular matrix, each from its diagonal on."""
    return [{i: jnp.asarray(basis[k, i]) for i in range(k, len(basis))} for k in range(len(basis))]


def _variance(row: dict[int, Array], lower: Matrix, pivots: list[Array]) -> Array:
    """Return row normal^-1 row^T, which is |D^-1/2 L^-1 row|^2, a sum of squares.

    Args:
      row: its entries, from the first that is not 0 to the last.
      lower, pivots: L and D of the normal matrix.
    """
    variance = jnp.zeros((), pivots[0].dtype)
    solved: dict[int, Array] = {}
    for i, entry in row.items():
        solved[i] = entry
        for q in solved:
            if q < i:
                solved[i] -= lower[i, q] * solved[q]
        variance += solved[i] ** 2 / pivots[i]
    return variance


@jax.jit
def dops_of_words(satellites: AnyGeometry, words: UInt[Array, "W ..."]) -> Dops:
    """Return the DOPs of the satellites whose bits are set, each ``[...]``: `dops` with weights 0 and 1.

    Args:
      satellites: from `geometry`.
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
    """
    num = satellites.products.shape[-1]
    bits = jnp.stack([(words[s // WORD_BITS] >> (s % WORD_BITS)) & 1 for s in range(num)])
    weights = bits.astype(satellites.products.dtype)
    least: int | Array = LEAST_SATELLITES
    if isinstance(satellites, ClockGeometry):
        least = 3 + jnp.sum(jnp.tensordot(satellites.members, weights, axes=1) > 0, axis=0)
    has_enough = jnp.sum(lax.population_count(words), axis=0) >= least  # exact, where pivots are rounded
    found = dops(satellites, weights)
    return Dops(*(jnp.where(has_enough, dop, jnp.inf) for dop in found))
