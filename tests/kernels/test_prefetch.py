"""A hint to the processor changes nothing, whatever it is given."""

import numpy as np
import pytest

from jaxurban.kernels.compiled import compiled
from jaxurban.kernels.search.heap import prefetch


@compiled()
def ask(values, index):
    prefetch(values, index)


@pytest.mark.parametrize("index", [0, 3, -1, 10**12, -(10**12)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_asking_for_an_item_even_outside_the_array_changes_nothing(dtype, index):
    values = np.arange(5, dtype=dtype)
    ask(values, index)
    np.testing.assert_array_equal(values, np.arange(5, dtype=dtype))
