"""The profile of a planned route: what it meets, by distance flown."""

from pathlib import Path
from typing import Unpack

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxurban.draw.frame import frame_note, joined
from jaxurban.draw.style import (
    FAINT_INK,
    SMALL_PT,
    TEXT_PT,
    chart,
    drawing,
    dress,
    legend_above,
    letter,
    tick_label,
)
from jaxurban.draw.write import Look, save
from jaxurban.maps.metric_maps import MapsLike, as_maps
from jaxurban.metrics.variables import BUILT_COLOUR, GROUP_COLOURS, ROOF_KIND
from jaxurban.paths.explain import explain
from jaxurban.paths.lines import along_of
from jaxurban.paths.path import PlannedPath
from jaxurban.paths.profile import without_fix
from jaxurban.paths.route_report import CLEARANCE, GUESSED, RouteReport
from jaxurban.paths.suffixes import check_picture
from jaxurban.pictures import Form
from jaxurban.world.kinds import GROUPS

ALTITUDE_COLOUR, CLEARANCE_COLOUR, NO_FIX_COLOUR = "#c51b8a", "#1a1a1a", "#ffd9d4"
LINEAR_UP_TO_M = 10.0  # above, the scale of clearance is logarithmic: near obstacles matter most
CLEARANCE_TICKS_M = (0, 5, 10, 30, 100, 300, 1000, 3000, 10_000)
NO_FIX_PT = 1.0  # at the ends of what is shaded, so that a single cell is seen
LIFT = 0.2  # of the first legend, over the numbers of segments
HATCHED: Look = {"facecolor": "#00000033", "edgecolor": "white", "hatch": "/////", "linewidth": 0.0}
HEIGHT_IN, SECOND_IN = 6.1, 1.2  # of the figure; of a second panel of metrics


@drawing
def plot_profile(
    planned: PlannedPath,
    maps: MapsLike,
    report: RouteReport | None = None,
    **form: Unpack[Form],
) -> Figure:
    """Return altitude and roofs beneath, metrics, and the clearance along a route, one above the other.

    Metrics of which 1 is the best are in one panel, and those of which 1 is the worst in another.

    Segments without a position fix are shaded, roofs of guessed height hatched, and trees, wires and the like in
    colours. The numbers on top are the report's segments.

    Args:
      planned: from `plan`.
      maps: the maps it was planned on, or their folder.
      report: from `explain`; made here if left out.
      form: width, ax and title, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Raises:
      InputError: there is no path, or the maps are others.

    Examples:
      >>> ju.plot.plot_profile(path, maps, width=120.0).savefig("profile.png")
    """
    maps = as_maps(maps)
    report = report or explain(planned, maps)
    profile = report.profile  # a row per cell along the route

    # The heading: planner, length, altitude, time of day and cost of the route.
    edges_km = np.append(profile["from_m"], profile["to_m"].iloc[-1]) / 1000
    altitude = f"{planned.facts['altitude']} above ground"
    facts = planned.search.planner, f"{planned.length_m / 1000:.2f} km", altitude
    day = planned.settings["time_of_day"]
    summary = joined(*facts, day, f"cost {planned.cost:,.1f}", by=", ")

    # The panels: heights, the metrics of which 1 is the best or the worst, one panel each, and the clearance.
    meanings = dict.fromkeys(metric.one_is for metric in maps.metrics.values())
    height_in = HEIGHT_IN + SECOND_IN * (len(meanings) - 1)
    note = frame_note(maps, planned.settings["time"])
    figure = chart(height_in, f"Route profile: {summary}", note, **form)
    ratios = (1, *(1.1, 0.7)[: len(meanings)], 1)
    axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    heights, *of_metrics, clearance = axes

    # What each panel shows along the route; edges [N + 1] are the ends of the cells, in km flown.
    _draw_heights(heights, planned, profile, edges_km)
    for meaning, panel in zip(meanings, of_metrics, strict=True):
        for name, metric in maps.metrics.items():
            if metric.one_is == meaning:
                panel.stairs(
                    profile[name],
                    edges_km,
                    baseline=None,
                    linewidth=1.3,
                    color=metric.colour,
                    label=metric.label,
                )
        panel.set(ylim=(-0.03, 1.03), ylabel=f"metric m\n(1 is {meaning})")
    _draw_clearance(clearance, profile, edges_km)
    clearance.set_xlabel("distance flown (km)")
    clearance.set_xlim(edges_km[0], max(edges_km[-1], edges_km[0] + 1e-3))

    # What all panels share: shades where there is no fix, which the legend of the second panel names once, and dotted
    # lines at the ends of segments.
    for place, panel in enumerate(axes):
        panel.set_ylabel(letter(place, len(axes)) + panel.get_ylabel())
        for number, (from_m, to_m) in enumerate(without_fix(profile)):
            panel.axvspan(
                from_m / 1000,
                to_m / 1000,
                label="no fix" if (place, number) == (1, 0) else "_",
                color=NO_FIX_COLOUR,
                linewidth=NO_FIX_PT,
                zorder=0,
            )
        for cut_m in report.segments["from_m"].iloc[1:]:
            panel.axvline(cut_m / 1000, color=FAINT_INK, linewidth=0.4, linestyle=":", zorder=0)
        dress(panel)
        # A line where the route ends, else the picture looks cut off.
        panel.spines["right"].set_visible(True)
        if panel.get_legend_handles_labels()[0]:
            legend_above(panel, LIFT if panel is heights else 0.0)
    figure.align_ylabels(axes)

    # The numbers of the report's segments, over the first panel.
    above = heights.secondary_xaxis("top")
    middles_km = (report.segments["from_m"] + report.segments["to_m"]).astype(float) / 2000
    above.set_xticks(middles_km, [str(number) for number in middles_km.index])
    above.tick_params(length=0, labelsize=SMALL_PT, labelcolor=FAINT_INK)
    above.set_xlabel("segment", color=FAINT_INK, loc="right")
    above.spines[:].set_visible(False)
    return figure


def beneath(profile: pd.DataFrame) -> dict[str, tuple[str, pd.Series]]:
    """Return the colour and the heights of the roofs beneath a route by group, 0 elsewhere; of all without kinds."""
    roof_m = profile["roof_m"].fillna(0.0)
    if ROOF_KIND not in profile:
        return {"roofs beneath": (BUILT_COLOUR, roof_m)}
    return {
        name: (GROUP_COLOURS[name], part_m.reindex(roof_m.index, fill_value=0.0))
        for name, part_m in roof_m.groupby(profile[ROOF_KIND].map(GROUPS))
        if part_m.any()
    }


def _draw_heights(
    panel: Axes, planned: PlannedPath, profile: pd.DataFrame, edges_km: np.ndarray
) -> None:
    """Draw the flight altitude and what is beneath by its group, hatched where its height is guessed.

    Args:
      panel: to draw in.
      planned: the route.
      profile: a row per cell along the route.
      edges_km: ``[N + 1]`` distance flown at the ends of the rows.
    """
    for name, (colour, roof_m) in beneath(profile).items():
        panel.stairs(roof_m, edges_km, fill=True, color=colour, label=name)
    if GUESSED in profile and profile[GUESSED].any():
        guessed_m = profile["roof_m"].where(profile[GUESSED], 0.0)
        panel.stairs(guessed_m, edges_km, fill=True, **HATCHED, label="of guessed height")

    # The flight: legs are measured in the air, as climbs have a length too.
    along_km = along_of(np.column_stack([planned.xy_m, planned.z_m])) / 1000
    panel.plot(along_km, planned.z_m, color=ALTITUDE_COLOUR, linewidth=1.6, label="flight altitude")
    top_m = max(planned.z_m.max(), profile["roof_m"].max())
    panel.set(ylim=(0, 1.15 * max(top_m, 1.0)), ylabel="height above\nground (m)")


def _draw_clearance(panel: Axes, profile: pd.DataFrame, edges_km: np.ndarray) -> None:
    """Draw the distance to obstacles, with a mark where it is the least; in words where there is no obstacle.

    Args:
      panel: to draw in.
      profile: a row per cell along the route; its distance is infinite where the route is above every obstacle.
      edges_km: ``[N + 1]`` distance flown at the ends of the rows.
    """
    panel.set(ylabel=f"distance (m),\nlogarithmic\nabove {LINEAR_UP_TO_M:g} m")
    is_known = np.isfinite(profile[CLEARANCE])
    if not is_known.any():
        label = "no obstacle at this altitude"
        panel.text(0.5, 0.5, label, transform=panel.transAxes, ha="center", size=TEXT_PT)
        panel.set_yticks([])
        return

    drawn_m = profile[CLEARANCE].where(is_known)
    panel.stairs(
        drawn_m,
        edges_km,
        baseline=None,
        linewidth=1.3,
        color=CLEARANCE_COLOUR,
        label="nearest obstacle",
    )

    # A mark in the middle of the cell with the least distance.
    place = np.argmin(profile[CLEARANCE])
    nearest_m = profile[CLEARANCE].iloc[place]
    at_km = edges_km[place : place + 2].mean()
    label = f"least: {nearest_m:.3g} m"
    panel.plot(at_km, nearest_m, "v", color=CLEARANCE_COLOUR, label=label, zorder=10, clip_on=False)
    if not is_known.all():
        panel.plot([], [], linestyle="none", label="gaps: above every obstacle")

    top_m = 1.15 * max(drawn_m.max(), 2 * LINEAR_UP_TO_M)
    panel.set_yscale("symlog", linthresh=LINEAR_UP_TO_M)
    panel.set_ylim(0, top_m)
    ticks_m = [tick_m for tick_m in CLEARANCE_TICKS_M if tick_m <= top_m]
    panel.set_yticks(ticks_m, map(tick_label, ticks_m))
    panel.minorticks_off()


def save_profile(
    planned: PlannedPath, maps: MapsLike, file: str | Path, report: RouteReport | None = None
) -> None:
    """Write the profile of a route (`plot_profile`) as PNG, PDF or SVG; the file appears whole or not at all.

    Args:
      planned, maps, report: as in `plot_profile`.
      file: to write, in the format that its name ends in.

    Raises:
      InputError: there is no path, the maps are others, or the file cannot be written.

    Examples:
      >>> ju.plot.save_profile(path, maps, "profile.pdf")
    """
    check_picture(file)
    save(Path(file).parent, {Path(file).name: lambda: plot_profile(planned, maps, report)})
