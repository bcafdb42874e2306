"""GPS: how well the satellites seen from each cell fix a position."""

from jaxurban.metrics.gps.hard import BLOCK_CELLS as BLOCK_CELLS
from jaxurban.metrics.gps.hard import RATING_UPPER_GDOP as RATING_UPPER_GDOP
from jaxurban.metrics.gps.hard import SATELLITES_STEP as SATELLITES_STEP
from jaxurban.metrics.gps.hard import Gps as Gps
from jaxurban.metrics.gps.hard import GpsMaps as GpsMaps
from jaxurban.metrics.gps.hard import Rating as Rating
from jaxurban.metrics.gps.hard import gps_metric as gps_metric
from jaxurban.metrics.gps.hard import maps_of_choices as maps_of_choices
from jaxurban.metrics.gps.hard import maps_of_words as maps_of_words
from jaxurban.metrics.gps.hard import rating as rating
from jaxurban.metrics.gps.hard import satellites_of as satellites_of
from jaxurban.metrics.gps.metric import DOPS as DOPS
from jaxurban.metrics.gps.metric import HORIZONTAL as HORIZONTAL
from jaxurban.metrics.gps.metric import METRIC as METRIC
from jaxurban.metrics.gps.metric import VERTICAL as VERTICAL
from jaxurban.metrics.gps.metric import WEIGHTED_DOPS as WEIGHTED_DOPS
from jaxurban.metrics.gps.metric import Dop as Dop
from jaxurban.metrics.gps.soft import soft_gps as soft_gps
