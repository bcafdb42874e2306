"""Pictures of metric maps and paths, as matplotlib Figures (in a notebook: ``%matplotlib inline`` shows them)."""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
