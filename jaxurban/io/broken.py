"""What readers and their libraries raise of a file that is damaged, or whose parts are missing or of another kind."""

import csv
from xml.etree.ElementTree import ParseError

from shapely.errors import ShapelyError

BROKEN = (
    *(ArithmeticError, AttributeError, LookupError, NameError, RuntimeError, TypeError, ValueError),
    *(csv.Error, ParseError, ShapelyError),
)
