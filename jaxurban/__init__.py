"""jaxurban: urban metric maps for small drones, and planning on them.

On a CPU the heavy kernels are compiled by Numba; under ``jax.jit``, ``jax.vmap``, on export and on a GPU maps are JAX.
Gradients come from soft forms of the metrics.
"""

from jaxurban.public import public_names as _public_names

__getattr__, __dir__, __all__ = _public_names(__name__, __file__)
