"""What a check of a mission writes: report.md, findings as a table and as GeoJSON, a map and a profile."""

import json
from collections.abc import Iterable
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxurban.metrics.variables import BUILT_COLOUR
from jaxurban.paths.check_result import MissionCheck
from jaxurban.paths.constraints import describe_constraints
from jaxurban.paths.route_report import TOUCHED
from jaxurban.report.figures.frame import MapPanel, draw_maps, frame_note
from jaxurban.report.figures.metrics import roof_layers
from jaxurban.report.figures.profile import ALTITUDE_COLOUR
from jaxurban.report.figures.style import chart, dress, legend_above, styled
from jaxurban.report.write import Figures, Look, Outputs, Written, bullets, fill, study_outputs

FOUND: Look = {
    "color": "#d00000",
    "marker": "x",
    "linestyle": "none",
    "label": "findings, by number",
}
MISSION: Look = {
    "color": ALTITUDE_COLOUR,
    "marker": ".",
    "markersize": 1.5,
    "linestyle": "none",
    "label": "mission",
}
GAP_M = 10.0  # between steps, which are shorter: nothing is drawn there
HEIGHT_IN = 3.4
HEADS = ["item", "kind", "what", "along_m", "height_m", "lon", "lat"]


def check_outputs(result: MissionCheck) -> Written:
    """Return what a check writes, by file name, and the record that identifies it.

    A mission without a step over the maps has no figures.
    """
    figures: Figures = {}
    if len(result.flight.steps.leg):
        figures["map"] = partial(plot_mission, result)
        figures["profile"] = partial(plot_flown_heights, result)
    report = check_markdown(result, list(figures))
    record = result.to_dict()
    outputs: Outputs = {
        "findings.geojson": json.dumps(result.to_geojson(), indent=1),
        "check.json": json.dumps(record, indent=1),
    }
    return outputs | study_outputs(report, {"findings": result.findings}, figures), record


def check_markdown(result: MissionCheck, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the names of the pictures that lie beside it."""
    findings = result.findings[HEADS].round({"lon": 6, "lat": 6}).astype({"lon": str, "lat": str})
    findings.insert(0, "number", range(1, len(findings) + 1))
    return fill(
        "check",
        {"findings": findings},
        figures,
        [result.maps.attribution],
        result=result,
        not_judged=bullets(result.not_judged) or "All of it was judged.",
        numbers=bullets(f"{name}: {fact}" for name, fact in result.numbers.items()),
        note=result.figures.get("cost_note", ""),
        limits=describe_constraints(result.limits) or "none",
        guesses=", ".join(result.maps.guesses) or "nothing",
    )


@styled
def plot_mission(result: MissionCheck) -> Figure:
    """Return the mission over the roofs, as far as the maps hold it, and its findings."""
    steps = result.flight.steps
    grid = result.maps.grid
    panel = MapPanel(f"Roof height (m), {result.flight.mission.name}", roof_layers(result.maps))
    legend = [Line2D([], [], **MISSION), Line2D([], [], **FOUND)]
    note = frame_note(result.maps)
    figure, (axes,) = draw_maps(grid, [panel], result.sentence, note, legend=legend)
    starts_m = steps.ends_m[:, 0]  # of each step, easting and northing
    axes.plot(*starts_m.T, **MISSION)
    places = result.findings.dropna(subset=["lon"])  # limits have none
    x_m, y_m = grid.xy_of_lonlat(places["lon"].to_numpy(), places["lat"].to_numpy())
    axes.plot(x_m, y_m, zorder=5, **FOUND)
    _number(axes, places.index, x_m, y_m)
    return figure


@styled
def plot_flown_heights(result: MissionCheck) -> Figure:
    """Return the height above the ground along the mission, the roofs of the cells below, and the findings.

    Maps without the highest roof that touches a cell (`TOUCHED`) show no roofs.
    """
    steps = result.flight.steps
    along_m = steps.along_m[:, 0]  # at the start of each step
    figure = chart(HEIGHT_IN, "Height along the mission", result.sentence)
    axes = figure.subplots()
    if TOUCHED in result.maps.ds:
        roof_m = result.maps.m(TOUCHED)[tuple(steps.cell.T)].astype(float)
        # In a gap between steps the mission has left the maps, where no roof is known.
        is_before_gap = np.diff(along_m) > GAP_M
        roof_m[:-1][is_before_gap] = np.nan
        axes.fill_between(along_m, 0, roof_m, color=BUILT_COLOUR, label="roofs of the cells below")
    axes.plot(along_m, steps.z_m[:, 0], **MISSION)
    places = result.findings.dropna(subset=["lon"])
    axes.plot(places["along_m"], places["height_m"], **FOUND)
    _number(axes, places.index, places["along_m"], places["height_m"])
    axes.set(xlabel="flown (m)", ylabel="height above\nground (m)")
    dress(axes)
    legend_above(axes)
    return figure


def _number(axes: Axes, rows: pd.Index, x: Iterable[float], y: Iterable[float]) -> None:
    """Write the numbers of findings, from 1, a little to the right of and above their marks.

    Args:
      axes: to write in.
      rows: of the table of findings, from 0.
      x, y: place of each mark, in the units of the axes.
    """
    look: Look = {"color": FOUND["color"], "textcoords": "offset points", "zorder": 6}
    look["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
    for number, right, up in zip(rows + 1, x, y, strict=True):
        axes.annotate(str(number), (right, up), (4, 3), **look)
