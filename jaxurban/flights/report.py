"""What a check of a mission writes: report.md, findings as a table and as GeoJSON, a map and a profile."""

import json
from functools import partial
from itertools import compress
from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxurban.draw import frame
from jaxurban.draw.metrics import roof_layers
from jaxurban.draw.profile import ALTITUDE_COLOUR
from jaxurban.draw.style import chart, dress, label_apart, legend_above, styled, wrapped
from jaxurban.draw.write import Figures, Look, Markdown, ResultReport, bullets, plain
from jaxurban.flights.check_result import MissionCheck
from jaxurban.knowledge import names_of
from jaxurban.metrics.variables import BUILT_COLOUR
from jaxurban.paths.constraints import describe_constraints
from jaxurban.paths.route_report import TOUCHED

FOUND_COLOUR, STREET_COLOUR = "#d00000", "#9a9a9a"
STREETS = ("street", "major")
NUMBER: Look = frame.HALO | {"color": FOUND_COLOUR, "zorder": 21}  # over the ends of the mission
FOUND: Look = NUMBER | {
    "marker": "x",
    "markersize": 9.0,
    "markeredgewidth": 2.0,
    "linestyle": "none",
    "label": "findings, by number",
}
MISSION: Look = frame.HALO | {"color": ALTITUDE_COLOUR, "label": "mission", "zorder": 4}
UNJUDGED: Look = frame.HALO | {
    "color": "none",
    "markeredgecolor": FOUND_COLOUR,
    "marker": "o",
    "markersize": 8.0,
    "markeredgewidth": 1.5,
    "linestyle": "none",
    "label": "not judged from here",
    "zorder": 20,
}
HOME: Look = frame.END_LOOK | {"marker": "p", "markersize": 20.0, "label": "home"}
ZONE: Look = {"facecolor": "none", "edgecolor": FOUND_COLOUR, "hatch": "////"}
LEGEND: tuple[Artist, ...] = (  # in the order of `is_drawn`
    Line2D([], [], **MISSION),
    Line2D([], [], **(HOME | {"markersize": 11.0})),
    *frame.ENDS,
    Line2D([], [], **FOUND),
    Line2D([], [], **UNJUDGED),
    Patch(label="no-fly zone", **ZONE),
    Patch(label="height guessed", color=frame.GUESSED_ROOF_COLOUR),
)
GAP_M = 10.0  # between steps, which are shorter: nothing is drawn there
HEIGHT_IN = 3.4
NUMBERS_IN = 1.2  # width of the numbers of one place, in lines


def check_report(result: MissionCheck) -> ResultReport:
    """Return what a check writes.

    A mission without a step over the maps has no figures.
    """
    figures: Figures = {}
    if len(result.flight.steps.leg):
        figures["map"] = partial(plot_mission, result)
        figures["profile"] = partial(plot_flown_heights, result)
    findings = [f"{number}. {plain(text)}" for number, text in enumerate(result.sentences, 1)]
    record = result.to_dict()
    return ResultReport(
        "flights/templates/check",
        {
            "credits": [result.maps.attribution],
            "result": result,
            "findings": Markdown("\n".join(findings) or "None."),
            "not_judged": bullets(result.not_judged) or "All of it was judged.",
            "autopilot": result.facts["autopilot"],
            "notes": bullets(f"Note: {text}" for text in result.notes),
            "numbers": bullets(f"{name}: {fact}" for name, fact in result.numbers.items()),
            "returns": bullets(result.return_lines) or "No item, or no home, to return from.",
            "limits": describe_constraints(result.limits) or "none",
            "guesses": names_of(result.maps.guesses) or "nothing",
        },
        tables={
            "findings": result.findings,
            "unjudged": result.unjudged,
            "return_altitudes": result.return_altitudes,
        },
        figures=figures,
        others={
            "findings.geojson": json.dumps(result.to_geojson(), indent=1),
            "check.json": json.dumps(record, indent=1),
        },
        key=record,
    )


@styled
def plot_mission(result: MissionCheck) -> Figure:
    """Return the mission over roofs, streets and zones, as far as the maps hold it, and its findings by number."""
    # The part of the maps around the mission, a square with a margin as far as the maps reach.
    maps = result.maps
    flight = result.flight
    grid = frame.surroundings(maps.grid, flight.lines_m.reshape(-1, 2))

    # The roofs there, and what the legend names.
    layers = roof_layers(maps)
    colours = layers[-1].colours
    has_guessed = "roof_guessed" in maps.ds
    if has_guessed:
        is_guessed = maps.m("roof_guessed") & (layers[-1].values > 0)
        layers.append(frame.flat_layer(is_guessed, frame.GUESSED_ROOF_COLOUR))
    found = result.findings
    of_zones = [zone.part_on(grid) for zone in result.zones if zone.state != "open"]
    unjudged = result.unjudged.dropna(subset=["lon", "lat"])
    has_home = flight.mission.home is not None
    is_drawn = True, has_home, True, True, len(found), len(unjudged), of_zones, has_guessed
    legend = [*compress(LEGEND, is_drawn)]
    panel = frame.cropped(frame.MapPanel("Roof height (m)", layers), maps.grid, grid)
    heading = frame.joined(flight.mission.name, result.sentence)
    note = frame.frame_note(maps)
    figure, (axes,) = frame.draw_maps(grid, [panel], heading, note, legend=legend, colours=colours)

    # Over them streets, zones, the mission with its home and ends, and the findings.
    if maps.base_map is not None:
        for kind, lines in maps.base_map.to_crs(grid.crs).groupby("kind"):
            if kind in STREETS:
                lines.plot(ax=axes, aspect=None, color=STREET_COLOUR, linewidth=0.5)
    for part in shapely.get_parts(of_zones):
        gpd.GeoSeries([part]).plot(ax=axes, aspect=None, **ZONE)
    line_m = np.pad(flight.lines_m, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
    axes.plot(*line_m.reshape(-1, 2).T, **MISSION)
    if flight.mission.home:
        axes.plot(*grid.xy_of_lonlat(*flight.mission.home), **HOME)
    frame.mark_ends(axes, flight.lines_m[0, 0], flight.lines_m[-1, 1])
    axes.plot(*grid.xy_at(unjudged[["lon", "lat"]].to_numpy(float)).T, **UNJUDGED)
    _mark(axes, *grid.xy_at(found[["lon", "lat"]].to_numpy(float)).T)
    return figure


@styled
def plot_flown_heights(result: MissionCheck) -> Figure:
    """Return the height above the ground along the mission, the roofs of the cells below, and the findings."""
    steps = result.flight.steps
    along_m = steps.along_m[:, 0]  # at the start of each step
    # In a gap between steps the mission has left the maps, where neither it nor a roof is drawn.
    is_before_gap = np.append(np.diff(along_m) > GAP_M, False)
    figure = chart(HEIGHT_IN, "Height along the mission")
    axes = figure.subplots()
    roof_m = np.where(is_before_gap, np.nan, result.maps.m(TOUCHED)[tuple(steps.cell.T)])
    label = "roofs of the cells below, which reach beyond outlines"
    axes.fill_between(along_m, 0, roof_m, color=BUILT_COLOUR, label=label)
    axes.plot(along_m, np.where(is_before_gap, np.nan, steps.z_m[:, 0]), **MISSION)
    axes.set(xlabel="flown (m)", ylabel="height above\nground (m)")
    dress(axes)
    found = result.findings
    _mark(axes, found["along_m"], found["height_m"])
    legend_above(axes)
    return figure


def _mark(axes: Axes, x: Any, y: Any) -> None:
    """Mark findings at ``x`` and ``y``, and write their numbers, from 1, beside them; the limits of the axes stay."""
    if len(x):
        axes.plot(x, y, **FOUND)
    # Findings at one place have one mark, with all their numbers.
    numbers_at: dict[tuple[float, float], list[str]] = {}
    for number, place in enumerate(zip(x, y, strict=True), 1):
        numbers_at.setdefault(place, []).append(str(number))
    names = [wrapped(", ".join(numbers), NUMBERS_IN) for numbers in numbers_at.values()]
    label_apart(axes, names, np.array([*numbers_at]).reshape(-1, 2), **NUMBER)
