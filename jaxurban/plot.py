"""Pictures of metric maps and paths, as matplotlib Figures, which a notebook shows (any but the last: ``show()``)."""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
