"""The metrics of the cost, in the paper's order, and those made on request: a new one is a file and a line here."""

from collections.abc import Mapping
from typing import Any

from jaxurban.checks import one_of
from jaxurban.errors import InputError
from jaxurban.metrics import gps, gps_floor, lidar, population, protection, risk
from jaxurban.metrics.base import Metric

METRICS: Mapping[str, Metric] = {
    metric.name: metric for metric in (gps.METRIC, lidar.METRIC, population.METRIC, risk.METRIC)
}
# Made where somebody gives their settings or a weight.
ON_REQUEST: Mapping[str, Metric] = {
    metric.name: metric
    for metric in (gps.HORIZONTAL, gps.VERTICAL, protection.METRIC, gps_floor.METRIC)
}


def known_metrics() -> dict[str, Metric]:
    """Return the metrics of every cost, then those made on request, by name."""
    return {**METRICS, **ON_REQUEST}


def checked_sections(sections: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of metrics by name, with the defaults of the metrics of every cost.

    Raises:
      InputError: a name that is no metric's, or another metric's settings.
    """
    known = known_metrics()
    for name, section in sections.items():
        metric = known[one_of("the metric of a section", name, known)]
        if not isinstance(section, metric.params):
            raise InputError(
                f"{name} must be {metric.params.__name__}, got {type(section).__name__}"
            )
    defaults = {name: metric.params() for name, metric in METRICS.items()}
    return {**defaults, **sections}
