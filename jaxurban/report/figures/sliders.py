"""Sliders for the weights in a notebook: let one go, and the route is planned and drawn anew."""

import io
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from jaxurban.errors import InputError
from jaxurban.maps.metric_maps import GivenMaps
from jaxurban.metrics.weights import GivenWeights, Weights
from jaxurban.paths.cost_map import CostMap, cost_map
from jaxurban.paths.snapping import Point
from jaxurban.report.figures.paths import plot_paths

if TYPE_CHECKING:
    from ipywidgets import VBox

LOWEST, HIGHEST, STEP = -3.0, 2.0, 0.1  # powers of ten


def weight_sliders(
    maps: GivenMaps | CostMap,
    start: Point,
    goal: Point,
    *,
    altitude_m: float | None = None,
    weights: GivenWeights = None,
    planner: str = "astar-plus",
    snap: bool | float = False,
) -> "VBox":
    """Return a slider for each weight over a map with the cheapest route under them, beside the shortest one.

    What a notebook shows when it is the last line of a cell. The sliders run from 0.001 to 100, or to the largest
    weight given; one at its left end weighs nothing. `route_under` draws the same for weights given in code.

    Args:
      maps: from `build_maps` or `open_maps`, or their folder; or a `cost_map`, which tells altitude, time, cost model
        and constraints.
      start, goal: longitude, latitude in degrees.
      altitude_m: one of the maps' altitudes; not for a cost map.
      weights: where the sliders start; left out, `Weights()` or those of the cost map.
      planner, snap: as in `plan`.

    Raises:
      InputError: ipywidgets is not installed, a cost map of the shortest path or of levels, or `plan` cannot plan this
        route.
    """
    try:
        from ipywidgets import HTML, FloatLogSlider, HBox, Image, VBox
    except ModuleNotFoundError as error:
        raise InputError("sliders need ipywidgets: pip install 'jaxurban[notebook]'") from error
    on = _cost_map(maps, altitude_m)
    given = on.weights if weights is None else Weights.of(weights).checked(on.names)
    top = max(HIGHEST, *(math.ceil(math.log10(max(given[name], 1.0))) for name in on.weight_names))
    draw = route_under(on, start, goal, planner=planner, snap=snap)
    look = {
        "base": 10,
        "min": LOWEST,
        "max": top,
        "step": STEP,
        "continuous_update": False,
        "readout_format": ".3g",
        "style": {"description_width": "initial"},
    }
    meant = {"distance": "each metre flown"} | {name: on.maps.metrics[name].label for name in on.names}
    sliders = {
        name: FloatLogSlider(
            max(given[name], 10**LOWEST), description=f"{name}:", tooltip=f"weight of {name}: {meant[name]}", **look
        )
        for name in on.weight_names
    }
    told = HTML(
        "<b>Weights</b>, what each counts in the cost of a route: "
        + ", ".join(f"<b>{name}</b> {said}" for name, said in meant.items())
        + ". Let a slider go, and the cheapest route is planned anew."
    )
    # An Image, as the Output that `interact` draws into can hang a notebook run without a browser (nbclient issue 312).
    picture = Image(format="png")

    def show(_: object = None) -> None:
        chosen = {name: slider.value if slider.value > 10**LOWEST else 0.0 for name, slider in sliders.items()}
        drawn = io.BytesIO()
        draw(**chosen).savefig(drawn, format="png")
        picture.value = drawn.getvalue()

    for slider in sliders.values():
        slider.observe(show, "value")
    show()
    return VBox([told, HBox(list(sliders.values()), layout={"flex_flow": "row wrap"}), picture])


def route_under(
    maps: GivenMaps | CostMap,
    start: Point,
    goal: Point,
    *,
    altitude_m: float | None = None,
    planner: str = "astar-plus",
    snap: bool | float = False,
) -> Callable[..., Figure]:
    """Return a function of weights by name that draws the cheapest route under them, beside the shortest one.

    Weights that are not named are 0. Arguments and errors as for `weight_sliders`.
    """
    on = _cost_map(maps, altitude_m)
    shortest = replace(on, objective="distance").plan(start, goal, planner=planner, snap=snap)

    def figure(**weights: float) -> Figure:
        chosen = Weights(**dict.fromkeys(on.weight_names, 0.0) | weights).checked(on.names)
        found = replace(on, weights=chosen).plan(start, goal, planner=planner, snap=snap)
        return plot_paths(on.maps, [shortest, found], names=["shortest", "cheapest under these weights"])

    return figure


def _cost_map(maps: GivenMaps | CostMap, altitude_m: float | None) -> CostMap:
    if isinstance(maps, CostMap) and altitude_m is None:
        on = maps
    elif not isinstance(maps, CostMap) and altitude_m is not None:
        on = cost_map(maps, altitude_m)
    else:
        raise InputError("the sliders need maps and an altitude_m, or a cost map, which has one: give one or the other")
    if on.objective != "weighted" or on.levels is not None:
        raise InputError("the sliders show routes on one altitude: give a cost map with objective='weighted' there")
    return on
