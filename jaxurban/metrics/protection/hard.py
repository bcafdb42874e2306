"""Protection levels of the satellites seen from each cell, every distinct choice of them solved once."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, UInt, UInt8

from jaxurban.kernels.protection import protection_levels
from jaxurban.metrics.base import AnyArray
from jaxurban.metrics.protection.params import ProtectionParams
from jaxurban.metrics.protection.range_errors import ranging_of
from jaxurban.metrics.visibility import distinct_choices
from jaxurban.world.sky import InView


class ProtectionMaps(NamedTuple):
    """Protection maps of one time. ``C`` stands for any axes of cells.

    Attributes:
      m: see `protection_metric`.
      hpl: horizontal protection level, metres; inf where it is undetermined and inside obstacles.
      vpl: vertical protection level, metres; inf as that.
      within_limits: 1 where both are at most their alert limits, else 0.
    """

    m: Float32[np.ndarray, "*C"]
    hpl: Float32[np.ndarray, "*C"]
    vpl: Float32[np.ndarray, "*C"]
    within_limits: UInt8[np.ndarray, "*C"]


def protection_metric(hpl_m: np.ndarray, alert_limit_m: float) -> np.ndarray:
    """Return m = 1 - min(HPL, limit) / limit in [0, 1]: 0 from the limit up, and at HPL = inf."""
    return 1 - np.minimum(hpl_m, alert_limit_m) / alert_limit_m


def levels_of_satellites(in_view: InView, params: ProtectionParams, patterns: UInt[np.ndarray, "W P"]) -> np.ndarray:
    """Return ``[2, P]`` float64 horizontal and vertical protection levels of choices of the satellites in view.

    Args:
      in_view: all of them.
      params: settings.
      patterns: satellite ``s`` is bit ``s % 32`` of word ``s // 32``.
    """
    return protection_levels(patterns, ranging_of(in_view, params), params.budget)


def protection_maps(
    words: UInt[AnyArray, "W ..."], is_obstacle: Bool[AnyArray, "..."], in_view: InView, params: ProtectionParams
) -> ProtectionMaps:
    """Return the protection maps of the satellites seen; inside obstacles none is. No gradient.

    Args:
      words: satellite ``s`` is bit ``s % 32`` of word ``s // 32``; any axes of cells behind.
      is_obstacle: where nobody flies.
      in_view: the satellites.
      params: settings.
    """
    choices, number = distinct_choices(words, is_obstacle)
    hpl_m, vpl_m = levels_of_satellites(in_view, params, choices)
    is_within = (hpl_m <= params.horizontal_alert_limit_m) & (vpl_m <= params.vertical_alert_limit_m)
    levels = [protection_metric(hpl_m, params.horizontal_alert_limit_m), hpl_m, vpl_m]
    table = [*(level.astype(np.float32) for level in levels), is_within.astype(np.uint8)]
    return ProtectionMaps(*(np.take(values, number) for values in table))
