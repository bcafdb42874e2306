"""Dilutions of precision from the satellites that are seen, in closed form, with one clock or one for each system."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt

from jaxurban.kernels.shadows.sweep import WORD_BITS
from jaxurban.programs import kept_jit

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

    Args:
      azimuth_rad: clockwise from north.
      elevation_rad: above the horizon.
    """
    azimuth = np.asarray(azimuth_rad, float)
    elevation = np.asarray(elevation_rad, float)
    level = np.cos(elevation)  # length of the horizontal part
    return np.column_stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)])


def geometry(
    directions: np.ndarray,
    dtype: type = np.float32,
    multiple_of: int = 1,
    clocks: Clocks | None = None,
) -> Geometry:
    """Return the geometry of all satellites, computed in float64 on the host.

    Args:
      directions: ``[S, 3]`` unit vectors east, north, up; S may be 0. If all satellites together leave the position
        undetermined (fewer than three plus one for each clock, or all on one cone), the DOPs of every choice of them
        are inf.
      dtype: type of the result's arrays; decides the precision of the DOPs.
      multiple_of: satellites of weight 0 fill S up to a multiple of this number, so that few programs are compiled.
      clocks: which clock each satellite has; left out, all share one.
    """
    directions = np.asarray(directions, float).reshape(-1, 3)
    num = len(directions)
    padded = max(1, -(-num // multiple_of)) * multiple_of  # satellites with those that fill up
    clocks = clocks or Clocks(np.zeros(num, int), 1)

    members = np.zeros((clocks.num, padded))
    counts = np.zeros(padded)
    rows = np.zeros((padded, 3))
    members[np.asarray(clocks.numbers, int), np.arange(num)] = 1
    counts[:num] = 1

    # Take each clock's mean direction off the directions of its satellites, which eliminates the clocks.
    sums = members @ counts
    means = (members * counts)[:, :num] @ directions / np.where(sums > 0, sums, 1.0)[:, None]
    centred = directions - members[:, :num].T @ means

    # Make what is left orthonormal by its QR decomposition; rows stay 0 where it has no full rank.
    basis = np.eye(3)
    scaled = centred * np.sqrt(counts[:num, None])
    if num >= 3 and np.linalg.matrix_rank(scaled) == 3:
        basis = np.linalg.inv(np.linalg.qr(scaled).R)
        rows[:num] = centred @ basis
    return Geometry(
        *(np.asarray(part, dtype) for part in (rows, basis, means @ basis, members, counts))
    )


@kept_jit
def dops(satellites: Geometry, weights: Float[Array, "S ..."]) -> Dops:
    """Return the DOPs of satellites under weights, each an array ``[...]`` of the cells.

    ``GDOP = sqrt(trace((G^T W G)^-1))``; the other DOPs take its east, north, up and clock terms (Langley 1999, the
    paper's PDOP equation with the square left out). Of several clocks the trace has one, the first that is seen. The
    DOPs are inf where a pivot is below `LEAST_PIVOT` (fewer satellites than three plus one for each clock, or all on
    one cone). Derivatives by the weights are exact, and zero where the result is inf.

    The clocks are eliminated by taking the weighted mean of their satellites off the rows, and what is left is made
    orthogonal by Gram and Schmidt. A clock's variance is one over the sum of its weights, plus the variance of the
    position along its mean direction.

    As the weights of a system go to 0, so does its influence, and its clock is left out. If that clock was the first,
    the next one takes its place in GDOP and TDOP, without a kink, while the sum of the system's weights goes from 1 to
    0.

    Args:
      satellites: from `geometry`.
      weights: ``[S, ...]`` 1 for a satellite that is seen, 0 for one that is not, or between; ``...`` are any axes of
        cells.

    Returns:
      The DOPs, each ``[...]``.
    """

    def over(per_satellite: Array | np.ndarray) -> Array:
        """Return ``[S]`` values with an axis of length 1 for each axis of cells."""
        return jnp.reshape(per_satellite, (-1, *[1] * (weights.ndim - 1)))

    def total(values: Array) -> Array:
        """Return the sum over satellites, ``[1, ...]``."""
        return jnp.sum(values, axis=0, keepdims=True)

    def by_clock(row: Array | np.ndarray, values: Array) -> Array:
        """Return the sum of ``row * values`` over each clock's satellites, ``[C, ...]``.

        Satellites are added in their order, so up to 31 satellites of weight 0 may follow them without changing a bit.
        """
        return jnp.concatenate(
            [total(over(member * row) * values) for member in satellites.members]
        )

    # Take the weighted mean of each clock's satellites off the rows.
    weighed = weights * over(satellites.weights)
    sums = by_clock(jnp.ones_like(satellites.weights), weighed)  # [C, ...] of the weights
    is_seen = sums > LEAST_CLOCK
    divisors = jnp.where(is_seen, sums, 1.0)
    means = [
        jnp.where(is_seen, by_clock(row, weighed) / divisors, 0.0) for row in satellites.rows.T
    ]
    clock_of_satellite = jnp.asarray(satellites.members).T
    # The highest precision, since GPUs would multiply in TF32.
    columns = [
        over(row) - jnp.tensordot(clock_of_satellite, mean, axes=1, precision=lax.Precision.HIGHEST)
        for row, mean in zip(satellites.rows.T, means, strict=True)
    ]

    # Gram and Schmidt: columns become orthogonal under the weights, and the normal matrix L D L^T of unit lower
    # triangular L and the diagonal D of pivots. A pivot too small is replaced by 1, so that gradients stay finite.
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
        """Return the variance of the position along a row: |D^-1/2 L^-1 row|^2, a sum of squares."""
        east = row[0]
        north = row[1] - lower[1, 0] * row[0]
        up = row[2] - lower[2, 0] * east - lower[2, 1] * north
        return east**2 / pivots[0] + north**2 / pivots[1] + up**2 / pivots[2]

    def root(squared: Array) -> Array:
        """Return the square root, inf where the position is undetermined, without the axis of length 1."""
        roots = jnp.sqrt(jnp.where(is_determined, squared, 1.0))
        return jnp.where(is_determined, roots, jnp.inf)[0]

    # Variances of the position along east, north and up, and of each clock.
    east, north, up = (variance(list(row)) for row in jnp.asarray(satellites.basis))
    # Mean direction of each clock's satellites under the weights: that of all of them, plus the mean of their rows.
    toward = [over(mean) + seen for mean, seen in zip(satellites.means.T, means, strict=True)]
    of_clocks = 1 / divisors + variance(toward)

    # The first clock that is seen counts; a share below 1 leaves the rest to the clocks after it.
    share = jnp.ones_like(sums)  # a clock without others counts whole
    if len(sums) > 1:
        share = jnp.where(
            is_seen, _smooth_step(by_clock(jnp.ones_like(satellites.weights), weights)), 0.0
        )
    # What the clocks before leave of 1.
    left = jnp.cumprod(jnp.concatenate([jnp.ones_like(share[:1]), 1 - share[:-1]]), axis=0)
    clock = total(left * share * of_clocks)
    position = east + north + up
    return Dops(root(position + clock), root(position), root(east + north), root(up), root(clock))


def _smooth_step(value: Array) -> Array:
    """Return 0 up to 0, 1 from 1 on, between them 3 x^2 - 2 x^3."""
    x = jnp.clip(value, 0.0, 1.0)
    return x * x * (3 - 2 * x)


@kept_jit
def dops_of_words(satellites: Geometry, words: UInt[Array, "W ..."]) -> Dops:
    """Return the DOPs of the satellites whose bits are set, each ``[...]``: `dops` with weights 0 and 1.

    Args:
      satellites: from `geometry`.
      words: ``[W, ...]`` satellite ``s`` is bit ``s % 32`` of word ``s // 32``; ``...`` are any axes of cells.
    """
    bits = [(words[s // WORD_BITS] >> (s % WORD_BITS)) & 1 for s in range(len(satellites.rows))]
    return dops(satellites, jnp.stack(bits).astype(satellites.rows.dtype))
