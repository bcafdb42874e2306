"""jaxurban: urban metric maps for small drones, and planning on them.

JAX makes the maps, and Numba searches paths and traces lidar over terrain. Gradients come from soft forms of the
metrics.
"""

from jaxurban.public import public_names as _public_names

__getattr__, __dir__, __all__ = _public_names(__name__, __file__)
