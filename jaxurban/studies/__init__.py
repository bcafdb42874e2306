"""Monte Carlo studies, sensitivities, comparisons of maps and with receivers."""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
