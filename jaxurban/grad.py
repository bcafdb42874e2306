"""Maps as pure functions of JAX, to be jitted, mapped over and differentiated, and gradients through planned paths."""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
