"""Sliders for the weights, without a browser: a slider let go plans and draws anew."""

import sys

import numpy as np
import pytest

from jaxurban.errors import InputError
from jaxurban.metrics.weights import Weights
from jaxurban.paths.plan import plan
from jaxurban.report.figures import route_under, weight_sliders
from tests.made_maps import made_maps

MAPS = made_maps(24, 30, altitudes_m=(20.0,))
FREE = np.argwhere(MAPS.is_free(20.0))
ENDS = {name: MAPS.grid.lonlat_of_cell(*FREE[at]) for name, at in (("start", 0), ("goal", -1))}


def test_a_slider_let_go_redraws_the_route_under_its_weight():
    box = weight_sliders(MAPS, **ENDS, altitude_m=20.0, weights=Weights(gps=0.5))
    sliders, picture = {slider.description.rstrip(":"): slider for slider in box.children[1].children}, box.children[2]
    assert list(sliders) == ["distance", "gps", "lidar", "population", "risk"]
    assert sliders["gps"].value == 0.5
    assert "<b>gps</b> GPS quality" in box.children[0].value
    first = picture.value
    sliders["risk"].value = 100.0
    assert picture.value != first
    sliders["risk"].value = 1.0
    assert picture.value == first


def test_a_slider_at_its_left_end_weighs_nothing():
    box = weight_sliders(MAPS, **ENDS, altitude_m=20.0)
    sliders, picture = {slider.description.rstrip(":"): slider for slider in box.children[1].children}, box.children[2]
    for name in ("gps", "lidar", "population", "risk"):
        sliders[name].value = sliders[name].base ** sliders[name].min
    shortest = plan(MAPS, **ENDS, altitude_m=20.0, weights=Weights(0.1, 0.0, 0.0, 0.0, 0.0))
    figure = route_under(MAPS, **ENDS, altitude_m=20.0)(distance=0.1)
    legend = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert f"cheapest under these weights: {shortest.cost:,.1f}, {shortest.length_m / 1000:.2f} km" in legend
    assert picture.value


def test_without_ipywidgets_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(InputError, match=r"pip install 'jaxurban\[notebook\]'"):
        weight_sliders(MAPS, **ENDS, altitude_m=20.0)
