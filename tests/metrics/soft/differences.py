"""Central finite differences: what gradients are held against."""

from collections.abc import Callable, Mapping

import jax
import numpy as np

STEP = 1e-6


def check_gradient(
    value_and_gradient: Callable, inputs: Mapping[str, jax.Array], directions: Mapping[str, list], rtol: float = 1e-4
) -> None:
    """Assert that the gradient in every input agrees with central differences along directions.

    Each of them must be well away from zero, or agreement would mean nothing.

    Args:
      value_and_gradient: of a dictionary of inputs.
      inputs: where.
      directions: of each input: arrays of its shape.
    """
    _, gradient = value_and_gradient(inputs)
    for name, along in directions.items():
        assert along
        for direction in along:
            above, below = (
                float(value_and_gradient(inputs | {name: inputs[name] + step * direction})[0]) for step in (STEP, -STEP)
            )
            expected = (above - below) / (2 * STEP)
            assert abs(expected) > 1e-6, name
            np.testing.assert_allclose(float((gradient[name] * direction).sum()), expected, rtol=rtol, err_msg=name)


def axes(gradient: jax.Array, count: int) -> list[np.ndarray]:
    """Return the unit vectors of the largest parts of a gradient."""
    return list(np.eye(len(gradient))[np.argsort(-np.abs(gradient))[:count]])


def anyhow(shape: tuple[int, ...]) -> np.ndarray:
    """Return a direction in which every part moves."""
    return np.random.default_rng(2).normal(size=shape)
