from jaxurban.metrics.gps import Dop as Dop
from jaxurban.metrics.protection import Protection as Protection
