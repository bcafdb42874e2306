"""Dilutions of precision from the satellites that are seen, in closed form, with one clock or one for each system."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt

from jaxurban.kernels.shadows.sweep import WORD_BITS

# A pivot of the normal matrix, 1 with every satellite in view, that counts as none: rounding leaves
# about 1e-14 of a singular matrix, and a DOP of 20 keeps pivots above 1e-3.
LEAST_PIVOT = 1e-6

# A clock's sum of weights below which its satellites say nothing, and it is left out: far above where a float's
# reciprocal squared, in gradients, overflows.
LEAST_CLOCK = 1e-12


class Clocks(NamedTuple):
    """Which receiver clock each satellite is measured by, one for each system.

    Attributes:
      numbers: ``[S]`` number of each satellite's clock, from 0 up, in the order in which one of them is the time's.
      num: how many there are, some perhaps without satellites.
    """

    numbers: np.ndarray
    num: int


class Geometry(NamedTuple):
    """The directions to all satellites, made ready for the DOPs of any choice of them.

    With every satellite in view the rows, less the mean of each clock's, are orthonormal; of those in view the pivots
    lie between 0 and 1. The rows are made orthogonal themselves, and no sums of their products inverted: so float32
    keeps DOPs of 20 to 1e-5, where normal matrices lose them to 1e-3.

    Attributes:
      rows: ``[S, 3]`` the directions less the mean of their clock's, times ``basis``; 0 where all satellites together
        leave the position undetermined.
      basis: ``[3, 3]`` what turns directions into rows, upper triangular.
      means: ``[C, 3]`` the mean direction of each clock's satellites, times ``basis``.
      members: ``[C, S]`` 1 where a satellite is measured by a clock; clocks may be without.
      weights: ``[S]`` of the satellites, 0 where they fill up.
    """

    rows: np.ndarray
    basis: np.ndarray
    means: np.ndarray
    members: np.ndarray
    weights: np.ndarray


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
    azimuth = np.asarray(azimuth_rad, float)
    elevation = np.asarray(elevation_rad, float)
    level = np.cos(elevation)
    return np.column_stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)])


def geometry(
    directions: np.ndarray,
    dtype: type = np.float32,
    multiple_of: int = 1,
    clocks: Clocks | None = None,
) -> Geometry:
    """Return the geometry of all satellites, computed in float64 on the host.

    Args:
      directions: ``[S, 3]`` unit vectors east, north, up. Satellites that all together leave the
        position undetermined (fewer than three and one for each clock, or on one cone) give inf for every choice of
        them.
      dtype: of the result; decides the precision of the DOPs.
      multiple_of: satellites that weigh nothing are added up to a multiple of this, so that few
        programs are compiled.
      clocks: which clock each satellite has; left out, all share one.
    """
    directions = np.asarray(directions, float).reshape(-1, 3)
    num = len(directions)
    padded = max(1, -(-num // multiple_of)) * multiple_of
    clocks = clocks or Clocks(np.zeros(num, int), 1)
    members = np.zeros((clocks.num, padded))
    counts = np.zeros(padded)
    rows = np.zeros((padded, 3))
    members[np.asarray(clocks.numbers, int), np.arange(num)] = 1
    counts[:num] = 1
    sums = members @ counts
    means = (members * counts)[:, :num] @ directions / np.where(sums > 0, sums, 1.0)[:, None]
    centred = directions - members[:, :num].T @ means
    basis = np.eye(3)
    scaled = centred * np.sqrt(counts[:num, None])
    if num >= 3 and np.linalg.matrix_rank(scaled) == 3:
        basis = np.linalg.inv(np.linalg.qr(scaled).R)
        rows[:num] = centred @ basis
    return Geometry(
        *(np.asarray(part, dtype) for part in (rows, basis, means @ basis, members, counts))
    )


@jax.jit
def dops(satellites: Geometry, weights: Float[Array, "S ..."]) -> Dops:
    """Return the DOPs of satellites under weights, each ``[...]``.

    ``GDOP = sqrt(trace((G^T W G)^-1))``, its east, north, up and clock terms in the others (Langley
    1999, the paper's PDOP equation with the square left out); of several clocks the trace has one, the first that is
    seen. Exact derivatives by the weights; zero where the result is inf: where a pivot is below `LEAST_PIVOT` (fewer
    satellites than three and one for each clock, or all on one cone).

    The clocks are eliminated by taking the weighted mean of their satellites off the rows; what is left is made
    orthogonal by Gram and Schmidt, and a clock's variance is one over its weights and the position's along its mean.

    As the weights of a system go to 0, so does all that it says, and its clock is left out. Where it was the first, the
    next one takes its place in GDOP and TDOP, without a kink, while the sum of its weights goes from 1 to 0.

    Args:
      satellites: from `geometry`.
      weights: 1 for a satellite that is seen, 0 for one that is not, or between; any axes of cells behind.
    """

    def over(per_satellite: Array | np.ndarray) -> Array:
        return jnp.reshape(per_satellite, (-1, *[1] * (weights.ndim - 1)))

    def total(values: Array) -> Array:
        return jnp.sum(values, axis=0, keepdims=True)

    def by_clock(row: Array | np.ndarray, values: Array) -> Array:
        """Return sums over each clock's satellites: in order, so that up to 31 of them may be filled up."""
        return jnp.concatenate(
            [total(over(member * row) * values) for member in satellites.members]
        )

    weighed = weights * over(satellites.weights)
    sums = by_clock(jnp.ones_like(satellites.weights), weighed)
    is_seen = sums > LEAST_CLOCK
    divisors = jnp.where(is_seen, sums, 1.0)
    means = [
        jnp.where(is_seen, by_clock(row, weighed) / divisors, 0.0) for row in satellites.rows.T
    ]
    of_each = jnp.asarray(satellites.members).T
    columns = [
        over(row)
        - jnp.tensordot(
            of_each, mean, axes=1, precision=lax.Precision.HIGHEST
        )  # else GPUs take TF32
        for row, mean in zip(satellites.rows.T, means, strict=True)
    ]
    lower = {}
    pivots = []
    is_determined = jnp.asarray(True)
    for j in range(3):
        pivot = total(weighed * columns[j] ** 2)
        is_determined &= pivot > LEAST_PIVOT
        pivots.append(jnp.where(pivot > LEAST_PIVOT, pivot, 1.0))
        for i in range(j + 1, 3):
            lower[i, j] = total(weighed * columns[i] * columns[j]) / pivots[j]
            columns[i] -= lower[i, j] * columns[j]

    def variance(row: list[Array]) -> Array:
        """Return that of the position along a row: |D^-1/2 L^-1 row|^2, a sum of squares."""
        east = row[0]
        north = row[1] - lower[1, 0] * row[0]
        up = row[2] - lower[2, 0] * east - lower[2, 1] * north
        return east**2 / pivots[0] + north**2 / pivots[1] + up**2 / pivots[2]

    def root(squared: Array) -> Array:
        roots = jnp.sqrt(jnp.where(is_determined, squared, 1.0))
        return jnp.where(is_determined, roots, jnp.inf)[0]

    east, north, up = (variance(list(row)) for row in jnp.asarray(satellites.basis))
    toward = [over(mean) + found for mean, found in zip(satellites.means.T, means, strict=True)]
    of_clocks = 1 / divisors + variance(toward)
    share = jnp.ones_like(sums)  # of a clock that has no other
    if len(sums) > 1:
        share = jnp.where(
            is_seen, _smooth_step(by_clock(jnp.ones_like(satellites.weights), weights)), 0.0
        )
    left = jnp.cumprod(jnp.concatenate([jnp.ones_like(share[:1]), 1 - share[:-1]]), axis=0)
    clock = total(left * share * of_clocks)
    position = east + north + up
    return Dops(root(position + clock), root(position), root(east + north), root(up), root(clock))


def _smooth_step(value: Array) -> Array:
    """Return 0 up to 0, 1 from 1 on, between them 3 x^2 - 2 x^3."""
    x = jnp.clip(value, 0.0, 1.0)
    return x * x * (3 - 2 * x)


@jax.jit
def dops_of_words(satellites: Geometry, words: UInt[Array, "W ..."]) -> Dops:
    """Return the DOPs of the satellites whose bits are set, each ``[...]``: `dops` with weights 0 and 1.

    Args:
      satellites: from `geometry`.
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
    """
    bits = [(words[s // WORD_BITS] >> (s % WORD_BITS)) & 1 for s in range(len(satellites.rows))]
    return dops(satellites, jnp.stack(bits).astype(satellites.rows.dtype))
