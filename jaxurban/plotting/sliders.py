"""Sliders for the weights in a notebook: let one go, and the route is planned and drawn anew."""

import io
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from jaxurban.cost import METRICS, Weights
from jaxurban.errors import InputError
from jaxurban.maps import MetricMaps
from jaxurban.planning import plan
from jaxurban.plotting.paths import plot_paths
from jaxurban.weighted import Point

if TYPE_CHECKING:
    from ipywidgets import VBox

LOWEST, HIGHEST, STEP = -3.0, 2.0, 0.1  # powers of ten


def weight_sliders(
    maps: MetricMaps,
    start: Point,
    goal: Point,
    *,
    altitude_m: float,
    weights: Weights | None = None,
    **options: Any,
) -> "VBox":
    """Return a slider for each weight over a map with the cheapest route under them, beside the shortest one.

    What a notebook shows when it is the last line of a cell. The sliders run from 0.001 to 100, or to the largest
    weight given; one at its left end weighs nothing. `route_under` draws the same for weights given in code.

    Args:
      maps: from `build_maps` or `open_maps`.
      start, goal: longitude, latitude in degrees.
      altitude_m: one of the maps' altitudes.
      weights: where the sliders start; `Weights()` if left out.
      options: of `plan`: ``planner``, ``cost_model``, ``time_of_day``, ``snap`` ...

    Raises:
      InputError: ipywidgets is not installed, or `plan` cannot plan this route.
    """
    try:
        from ipywidgets import FloatLogSlider, HBox, Image, VBox
    except ModuleNotFoundError as error:
        raise InputError("sliders need ipywidgets: pip install 'jaxurban[notebook]'") from error
    names = ["distance", *(name for name in METRICS if name in maps.metrics)]
    given = (weights or Weights()).checked()
    top = max(HIGHEST, *(math.ceil(math.log10(max(getattr(given, name), 1.0))) for name in names))
    draw = route_under(maps, start, goal, altitude_m=altitude_m, **options)
    look = {
        "base": 10,
        "min": LOWEST,
        "max": top,
        "step": STEP,
        "continuous_update": False,
        "readout_format": ".3g",
    }
    sliders = {name: FloatLogSlider(max(getattr(given, name), 10**LOWEST), description=name, **look) for name in names}
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
    return VBox([HBox(list(sliders.values()), layout={"flex_flow": "row wrap"}), picture])


def route_under(
    maps: MetricMaps, start: Point, goal: Point, *, altitude_m: float, planner: str = "astar-plus", **options: Any
) -> Callable[..., Figure]:
    """Return a function of weights by name that draws the cheapest route under them, beside the shortest one.

    Weights that are not named are 0. Arguments and errors as for `weight_sliders`.
    """
    if "objective" in options:
        raise InputError("the sliders weigh the route, so that its objective cannot be chosen: leave it out")
    ends = {"start": start, "goal": goal, "altitude_m": altitude_m, **options}
    # Another name than the planner's own, so that the picture tells the two apart.
    shortest = plan(
        maps, **ends, planner="astar-dist" if planner != "astar-dist" else "astar-plus", objective="distance"
    )

    def figure(**weights: float) -> Figure:
        wanted = Weights(**dict.fromkeys(("distance", *METRICS), 0.0) | weights)
        found = plan(maps, **ends, planner=planner, weights=wanted)
        return plot_paths(maps, {altitude_m: [shortest, found]}, altitudes_m=[altitude_m])

    return figure
