"""Classes of what functions return, for annotations: ``from jaxurban.typing import MissionCheck``."""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
