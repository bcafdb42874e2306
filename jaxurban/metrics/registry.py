"""The metrics of the cost, in the paper's order, and those made on request: a new one is a file and a line here."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from inspect import signature
from typing import Any

from jaxurban.errors import InputError, nearest_name, place_of
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


def checked_sections(sections: Mapping[str, Any], function: Callable | None = None) -> dict[str, Any]:
    """Return settings by the name of their metric; those that are None are left out.

    Args:
      sections: an object of `Metric.params` each.
      function: of which they are further arguments, for the message.

    Raises:
      InputError: a name that is no metric's (names the nearest one, or where it belongs), or another metric's settings.
    """
    known = known_metrics()
    for name, section in sections.items():
        if name not in known:
            choices = [*known, *(() if function is None else signature(function).parameters)]
            homes = (key for key, metric in known.items() if name in {field.name for field in fields(metric.params)})
            home = next((f" (give {key}={known[key].params.__name__}({name}=...))" for key in homes), "")
            place = place_of(name, function) if function else ""
            found = f"there is no argument {name!r}" if function else f"there is no metric {name!r}"
            where = f"{function.__name__}: " if function else ""
            raise InputError(f"{where}{found}{home or place or nearest_name(name, choices)}")
        if section is not None and not isinstance(section, known[name].params):
            kind = known[name].params.__name__
            raise InputError(f"{name} must be a {kind}, as in {name}={kind}(), got {type(section).__name__}")
    return {name: section for name, section in sections.items() if section is not None}
