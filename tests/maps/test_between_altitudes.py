"""Metrics between two altitudes of maps, which routes in a volume take from both, against maps made there."""

import re
from pathlib import Path

import numpy as np
import pytest

import jaxurban as ju

PAGE = (Path(__file__).parents[2] / "docs" / "model" / "maps.md").read_text(encoding="utf-8")
LEVELS_M = (20.0, 60.0, 122.0)
BETWEEN_M = (30.0, 40.0, 50.0, 70.0, 80.0, 90.0, 100.0, 110.0)


@pytest.mark.slow
def test_the_page_on_maps_says_how_far_interpolated_metrics_are_off():
    (said,) = re.findall(r"the error of m is (.+?) in single ones", PAGE, re.DOTALL)
    said = [float(number) for number in re.findall(r"0\.\d\d", said)]
    city = ju.sample_city("lower-manhattan")
    maps, there = (
        ju.build_maps(city, resolution_m=10.0, altitudes_m=altitudes_m)
        for altitudes_m in (LEVELS_M, BETWEEN_M)
    )
    means, wide, highest = [], [], []
    for name in ("gps", "lidar", "risk"):
        errors = []
        for z_m in BETWEEN_M:
            upper = np.searchsorted(LEVELS_M, z_m)
            low_m, high_m = LEVELS_M[upper - 1 : upper + 1]
            share = (z_m - low_m) / (high_m - low_m)
            between = (1 - share) * maps.m(name, low_m) + share * maps.m(name, high_m)
            is_free = there.is_free(z_m) & maps.is_free(low_m)
            errors.append(np.abs(between - there.m(name, z_m))[is_free])
        means.append(max(error.mean() for error in errors))
        wide.append(max(np.quantile(error, 0.95) for error in errors))
        highest.append(max(error.max() for error in errors))
    assert said == pytest.approx([*means, *wide, max(highest)], abs=0.006)
