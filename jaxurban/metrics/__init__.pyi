from jaxurban.metrics.gps import Dop as Dop
from jaxurban.metrics.gps_floor import GpsFloor as GpsFloor
from jaxurban.metrics.protection import Protection as Protection
