"""Population as a function of gammas and of the people in each block. It is smooth as it is: there is no softness."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float, Int

from jaxurban.city import Blocks
from jaxurban.grid import Bounds
from jaxurban.metrics.population import PopulationParams, block_values, day_share, map_blocks, region_blocks


class People(NamedTuple):
    """Census blocks as arrays. ``N`` blocks, ``M`` of which set the norm.

    Attributes:
      night_count: ``[N]`` people by the census.
      area_m2: ``[N]`` area.
      zoning: ``[N]`` a `jaxurban.city.Zoning` each.
      in_region: ``[M]`` index of the blocks that touch the region.
    """

    night_count: jax.Array
    area_m2: jax.Array
    zoning: jax.Array
    in_region: jax.Array

    @classmethod
    def of(cls, blocks: Blocks, bounds_m: Bounds | None = None, dtype: DTypeLike = np.float32) -> "People":
        """Return the people of a city's blocks.

        Args:
          blocks: the blocks.
          bounds_m: the region's box; left out, all blocks set the norm.
          dtype: float32 or, where JAX has it enabled, float64.
        """
        return cls(
            jnp.asarray(blocks.night_count, dtype),
            jnp.asarray(blocks.area_m2, dtype),
            jnp.asarray(blocks.zoning),
            jnp.asarray(region_blocks(blocks, bounds_m)),
        )


def soft_population(
    block: Int[Array, "y x"],
    people: People,
    time_of_day: str,
    params: PopulationParams,
    *,
    cells: Int[Array, "P 2"] | None = None,
) -> Float[Array, "y x"] | Float[Array, " P"]:
    """Return m_population at one time of day, on the region ``[y, x]`` or at chosen cells ``[P]``; no softness.

    Differentiable in both gammas and in ``people.night_count`` and ``area_m2``; batch by `jax.vmap`. The gradient is
    exact: it holds the norm's own change with the block (or two, of a percentile) that sets it, and is 0 above a norm.
    Undefined where two blocks tie for the norm or a block lies just at it. Docs: gradients/population.md.

    Args:
      block: index of the block under each cell, -1 without one.
      people: from `People.of`.
      time_of_day: see `jaxurban.metrics.population.day_share`.
      params: gammas and norm.
      cells: row and column in the region; left out, the whole region.

    Raises:
      InputError: no such time of day.
    """
    m, _, _ = block_values(*people, share=day_share(time_of_day, params), params=params)
    return map_blocks(block if cells is None else block[cells[:, 0], cells[:, 1]], m)
