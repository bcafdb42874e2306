"""Settings of the metrics that are made on request; those of every map stand at the top, as ``ju.Gps``."""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
