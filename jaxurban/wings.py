"""What the core asks of the wings, which it does not import: the stub beside this module names all of it.

A file of a city is read by the cities' readers, zones and missions by those of flights; each is imported when it is
first asked for, as the libraries of readers take long.
"""

from jaxurban.public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
