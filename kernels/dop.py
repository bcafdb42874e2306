"""Dilutions of precision from the satellites that are seen, in closed form."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt

from jaxurban.kernels.shadows.sweep import WORD_BITS

LEAST_SATELLITES = 4  # three coordinates and the clock

# A pivot of the normal matrix, 1 with every satellite in view, that counts as none: rounding leaves
# about 1e-7 of a singular matrix, and a DOP of 20 keeps pivots above 1e-3.
LEAST_PIVOT = 1e-6

ENTRIES = [(i, j) for i in range(4) for j in range(i + 1)]  # lower triangle of a symmetric 4 x 4 matrix


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


class Dops(NamedTuple):
    """Geometric, position, horizontal, vertical and time dilution of precision; inf if undetermined."""

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


def geometry(directions: np.ndarray, dtype: type = np.float32, multiple_of: int = 1) -> Geometry:
    """Return the geometry of all satellites, computed in float64 on the host.

    Args:
      directions: ``[S, 3]`` unit vectors east, north, up. Satellites that all together leave the
        position undetermined (fewer than four, or on one cone) give inf for every choice of them.
      dtype: of the result; decides the precision of the DOPs.
      multiple_of: satellites that weigh nothing are added up to a multiple of this, so that few
        programs are compiled.
    """
    directions = np.asarray(directions, float).reshape(-1, 3)
    num = len(directions)
    rows = np.zeros((max(1, -(-num // multiple_of)) * multiple_of, 4))
    basis = np.eye(4)
    matrix = np.column_stack([directions, -np.ones(num)])
    if np.linalg.matrix_rank(matrix) == 4:
        rows[:num], triangle = np.linalg.qr(matrix)
        basis = np.linalg.inv(triangle)
    step = float(np.finfo(dtype).eps)
    products = np.array([rows[:, i] * rows[:, j] for i, j in ENTRIES])
    rounded = np.round(products / step) * step
    fine = step / 2**16  # rests of 500 satellites add up to less than 2^24 of these
    rests = np.round((products - rounded) / fine) * fine
    return Geometry(np.array([rounded, rests], dtype), basis.astype(dtype))


@jax.jit
def dops(satellites: Geometry, weights: Float[Array, "S ..."]) -> Dops:
    """Return the DOPs of satellites under weights, each ``[...]``.

    ``GDOP = sqrt(trace((G^T W G)^-1))``, its east, north, up and clock terms in the others (Langley
    1999, the paper's PDOP equation with the square left out). Exact derivatives by the weights; zero
    where the result is inf: where a pivot is below `LEAST_PIVOT` (fewer than four satellites, or all
    on one cone; rounding may turn this inf into a DOP of several hundreds).

    Args:
      satellites: from `geometry`.
      weights: 1 for a satellite that is seen, 0 for one that is not, or between; any axes of cells behind.
    """
    products, basis = satellites
    sums, rests = jnp.tensordot(products, weights, axes=1, precision=lax.Precision.HIGHEST)  # else GPUs take TF32
    normal = dict(zip(ENTRIES, sums + rests, strict=True))

    # normal = L D L^T, unit lower triangular L: unlike cofactors it does not cancel.
    lower: dict[tuple[int, int], Array] = {}
    pivots: list[Array] = []
    is_determined = jnp.asarray(True)
    for j in range(4):
        pivot = normal[j, j]
        for k in range(j):
            pivot -= lower[j, k] ** 2 * pivots[k]
        is_determined &= pivot > LEAST_PIVOT
        pivots.append(jnp.where(pivot > LEAST_PIVOT, pivot, 1.0))
        for i in range(j + 1, 4):
            rest = normal[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k] * pivots[k]
            lower[i, j] = rest / pivots[j]

    # Entry k, k of R^-1 normal^-1 R^-T is |D^-1/2 L^-1 (row k of R^-1)|^2: a sum of squares.
    variances: list[Array] = []
    for k in range(4):
        variance = jnp.zeros((), basis.dtype)
        solved: dict[int, Array] = {}
        for i in range(k, 4):  # R^-1 is upper triangular
            solved[i] = jnp.asarray(basis[k, i])
            for q in range(k, i):
                solved[i] -= lower[i, q] * solved[q]
            variance += solved[i] ** 2 / pivots[i]
        variances.append(variance)
    east, north, up, clock = variances

    def root(variance: Array) -> Array:
        return jnp.where(is_determined, jnp.sqrt(jnp.where(is_determined, variance, 1.0)), jnp.inf)

    position = east + north + up
    return Dops(root(position + clock), root(position), root(east + north), root(up), root(clock))


@jax.jit
def dops_of_words(satellites: Geometry, words: UInt[Array, "W ..."]) -> Dops:
    """Return the DOPs of the satellites whose bits are set, each ``[...]``: `dops` with weights 0 and 1.

    Args:
      satellites: from `geometry`.
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
    """
    has_enough = jnp.sum(lax.population_count(words), axis=0) >= LEAST_SATELLITES  # exact, where pivots are rounded
    num = satellites.products.shape[-1]
    bits = jnp.stack([(words[s // WORD_BITS] >> (s % WORD_BITS)) & 1 for s in range(num)])
    found = dops(satellites, bits.astype(satellites.products.dtype))
    return Dops(*(jnp.where(has_enough, dop, jnp.inf) for dop in found))
