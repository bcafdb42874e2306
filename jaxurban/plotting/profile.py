"""The profile of a planned route: what it meets, by distance flown."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from jaxurban.maps import MetricMaps
from jaxurban.planned import PlannedPath
from jaxurban.plotting.frame import FAINT_INK, INK, SMALL_PT, TEXT_PT
from jaxurban.plotting.metrics import BUILT_COLOUR, GPS_COLOUR, LIDAR_COLOUR, frame_note
from jaxurban.route_report import WALL, RouteReport, explain, without_fix

METRIC_LINES = {  # name, colour
    "gps": ("GPS quality", GPS_COLOUR),
    "lidar": ("lidar quality", LIDAR_COLOUR),
    "population": ("population (1: most)", "#cc79a7"),
    "risk": ("risk (1: far from walls)", "#009e73"),
}
ALTITUDE_COLOUR, WALL_COLOUR, NO_FIX_COLOUR = "#d62728", "#5b3a8c", "#ffd9d4"
LINEAR_UP_TO_M = 10.0  # above, the wall's scale is logarithmic: near walls matter most
WALL_TICKS_M = (0, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
SIZE_IN, RIGHT = (10.0, 7.0), 0.79  # the legends stand beside the panels


def plot_profile(planned: PlannedPath, maps: MetricMaps, report: RouteReport | None = None) -> Figure:
    """Return altitude and roofs beneath, metrics, and the nearest wall along a route, one above the other.

    Stretches with fewer than four satellites in view are shaded. The numbers on top are the report's segments.

    Args:
      planned: from `plan`.
      maps: the maps it was planned on.
      report: from `explain`; made here if left out.

    Raises:
      InputError: there is no path, or the maps are others.
    """
    report = report or explain(planned, maps)
    profile = report.profile
    edges_km = np.append(profile["from_m"], profile["to_m"].iloc[-1]) / 1000
    figure = Figure(figsize=SIZE_IN, facecolor="white")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(1, 1.3, 1))
    figure.subplots_adjust(left=0.075, right=RIGHT, top=0.86, bottom=0.075, hspace=0.12)
    heading = f"Route profile: {planned.search.planner}, {planned.length_m / 1000:.2f} km, cost {planned.cost:,.1f}"
    figure.text(0.075, 0.975, heading, va="top", size=12, weight="bold", color=INK)
    times = " · ".join(filter(None, (frame_note(maps, planned.settings["time"]), planned.settings["time_of_day"])))
    figure.text(0.075, 0.94, times, va="top", size=TEXT_PT, color=FAINT_INK)
    _draw_heights(axes[0], planned, profile, edges_km)
    for name in maps.metrics:
        label, colour = METRIC_LINES[name]
        axes[1].stairs(profile[name], edges_km, baseline=None, color=colour, linewidth=1.3, label=label)
    axes[1].set(ylim=(-0.03, 1.03), ylabel="metric m (1)")
    _draw_walls(axes[2], profile, edges_km)
    axes[2].set_xlabel("distance flown (km)", size=SMALL_PT)
    no_fix = _no_fix_km(profile)
    for panel in axes:
        for begin_km, end_km in no_fix:
            panel.axvspan(begin_km, end_km, color=NO_FIX_COLOUR, linewidth=0, zorder=0)
        for cut_m in report.segments["from_m"].iloc[1:]:
            panel.axvline(cut_m / 1000, color=FAINT_INK, linewidth=0.4, linestyle=":", zorder=0)
        _dress(panel, edges_km, bool(no_fix) and panel is axes[1])
    look = {"transform": axes[0].get_xaxis_transform(), "size": SMALL_PT, "color": FAINT_INK}
    axes[0].text(edges_km[0], 1.03, "segment ", ha="right", **look)
    for number, row in report.segments.iterrows():
        axes[0].text((row["from_m"] + row["to_m"]) / 2000, 1.03, str(number), ha="center", **look)
    return figure


def _draw_heights(panel: Axes, planned: PlannedPath, profile: pd.DataFrame, edges_km: np.ndarray) -> None:
    panel.stairs(profile["roof_m"], edges_km, fill=True, color=BUILT_COLOUR, label="roofs beneath")
    moved_m = np.diff(np.column_stack([planned.xy_m, planned.z_m]), axis=0)
    along_km = np.append(0.0, np.cumsum(np.linalg.norm(moved_m, axis=1))) / 1000
    panel.plot(along_km, planned.z_m, color=ALTITUDE_COLOUR, linewidth=1.6, label="flight altitude")
    top_m = max(planned.z_m.max(), profile["roof_m"].max())
    panel.set(ylim=(0, 1.15 * max(top_m, 1.0)), ylabel="height above ground (m)")


def _draw_walls(panel: Axes, profile: pd.DataFrame, edges_km: np.ndarray) -> None:
    panel.set(ylabel="nearest wall (m)")
    if not np.isfinite(profile[WALL]).all():
        panel.text(0.5, 0.5, "no wall at this altitude", transform=panel.transAxes, ha="center", size=TEXT_PT)
        panel.set_yticks([])
        return
    panel.stairs(profile[WALL], edges_km, baseline=None, color=WALL_COLOUR, linewidth=1.3, label="nearest wall")
    place = int(np.argmin(profile[WALL]))
    nearest_m, at_km = profile[WALL].iloc[place], edges_km[place : place + 2].mean()
    label = f"nearest: {nearest_m:.3g} m"
    panel.plot(at_km, nearest_m, marker="v", linestyle="none", color=WALL_COLOUR, markersize=6, label=label)
    top_m = 1.15 * max(profile[WALL].max(), 2 * LINEAR_UP_TO_M)
    panel.set_yscale("symlog", linthresh=LINEAR_UP_TO_M)
    panel.set_ylim(0, top_m)
    panel.yaxis.set_major_locator(FixedLocator([tick for tick in WALL_TICKS_M if tick <= top_m]))
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.yaxis.set_minor_locator(NullLocator())


def _no_fix_km(profile: pd.DataFrame) -> list[tuple[float, float]]:
    """Return begin and end of each stretch with too few satellites for a fix, kilometres."""
    return [(from_m / 1000, to_m / 1000) for from_m, to_m in without_fix(profile)]


def _dress(panel: Axes, edges_km: np.ndarray, with_no_fix: bool) -> None:
    panel.set_xlim(edges_km[0], max(edges_km[-1], edges_km[0] + 1e-3))
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    panel.yaxis.label.set_fontsize(SMALL_PT)
    panel.grid(axis="y", linewidth=0.4, alpha=0.5)
    for spine in panel.spines.values():
        spine.set(linewidth=0.6, color=FAINT_INK)
    handles, _ = panel.get_legend_handles_labels()
    if with_no_fix:
        handles.append(Patch(facecolor=NO_FIX_COLOUR, label="under 4 satellites"))
    if handles:
        panel.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.005, 1.02), fontsize=SMALL_PT, frameon=False)
