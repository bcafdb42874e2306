"""The metrics of the cost, in the paper's order: a new one is one file beside these and one line here."""

from collections.abc import Mapping

from jaxurban.errors import one_of
from jaxurban.metrics import gps, lidar, population, risk
from jaxurban.metrics.base import Metric

METRICS: Mapping[str, Metric] = {
    metric.name: metric for metric in (gps.METRIC, lidar.METRIC, population.METRIC, risk.METRIC)
}


def find_metric(name: str, metrics: Mapping[str, Metric] = METRICS) -> Metric:
    """Return a metric by its name, among the built-in ones or those given.

    Raises:
      InputError: no such metric (names the nearest one).
    """
    return metrics[one_of("metric", name, metrics)]
