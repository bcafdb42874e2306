"""The metrics of the cost, in the paper's order, and those made on request: a new one is a file and a line here."""

from collections.abc import Mapping

from jaxurban.metrics import gps, lidar, population, protection, risk
from jaxurban.metrics.base import Metric

METRICS: Mapping[str, Metric] = {
    metric.name: metric for metric in (gps.METRIC, lidar.METRIC, population.METRIC, risk.METRIC)
}
# Made where somebody gives their settings or a weight.
ON_REQUEST: Mapping[str, Metric] = {metric.name: metric for metric in (gps.HORIZONTAL, gps.VERTICAL, protection.METRIC)}


def known_metrics() -> dict[str, Metric]:
    """Return the metrics of every cost, then those made on request, by name."""
    return {**METRICS, **ON_REQUEST}
