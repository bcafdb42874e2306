"""Protection levels: how far off a position from the satellites in line of sight can be without anybody being told."""

from jaxurban.metrics.protection.hard import ProtectionMaps as ProtectionMaps
from jaxurban.metrics.protection.hard import levels_of_satellites as levels_of_satellites
from jaxurban.metrics.protection.hard import protection_maps as protection_maps
from jaxurban.metrics.protection.hard import protection_metric as protection_metric
from jaxurban.metrics.protection.metric import CAVEAT as CAVEAT
from jaxurban.metrics.protection.metric import LEVELS as LEVELS
from jaxurban.metrics.protection.metric import METRIC as METRIC
from jaxurban.metrics.protection.metric import WITHIN_LIMITS as WITHIN_LIMITS
from jaxurban.metrics.protection.params import ProtectionParams as ProtectionParams
from jaxurban.metrics.protection.range_errors import ranging_of as ranging_of
