"""The strip of departures: by time, what routes cost above the best time, and how far they fly without a fix."""

import math
from typing import Unpack

from matplotlib.figure import Figure

from jaxurban.draw.frame import frame_note, joined
from jaxurban.draw.style import (
    SERIES_COLOURS,
    chart,
    drawing,
    dress,
    legend_above,
    letter,
)
from jaxurban.maps.metric_maps import MapsLike, as_maps
from jaxurban.paths.when import Departures
from jaxurban.pictures import Form

MOST_TICKS, HEIGHT_IN = 8, 3.0
MARK_PT = 4.0  # of a hollow mark, over others
FACTS = "best", "worst", "times without a path"  # of the departures, in the note
WIDTHS_PT = 6.0, 2.5, *(1.2,) * 5  # of the lines, whose marks are as much wider
LABELS = "cost above best (%)", "no fix (m)"
FOOT = 0.05  # of the scales, below 0, so that marks there are whole
LEAST_TOP = 10.0, 50.0  # of the scales, percent and metres, so that a small effect looks small


@drawing
def plot_when(departures: Departures, maps: MapsLike, **form: Unpack[Form]) -> Figure:
    """Return the cost above the best time and the length without a fix by time, a line for each time of day.

    At hollow marks a route differs from the best time's. A line has a gap where a route has no path. With one time
    alone, times of day are along the axis instead. Where no fix is known to be lost, that panel is left out.

    Args:
      departures: from `jaxurban.when`.
      maps: that it was planned on, or their folder.
      form: width, ax and title, as in `MetricMaps.plot`.

    Returns:
      A Matplotlib figure, or the part of one in place of ``ax``.

    Examples:
      >>> departures = ju.when(maps, [(start, goal)], altitude_m=60.0)
      >>> ju.plot.plot_when(departures, maps).savefig("when.png")
    """
    table = departures.table.fillna({"time": "", "time_of_day": ""})
    # Columns: the first is along the axis, and each value of the second has a line.
    along, series = "time_of_day", "time"
    axis_label = "time of day"
    labels = table[along].unique().tolist()
    if table["time"].nunique() > 1:
        along, series = series, along
        axis_label = f"UTC, from {table['time'].iloc[0][:10]}"
        labels = [time[11:16] for time in table["time"].unique()]  # hours and minutes
    table["x"] = table[along].factorize()[0]

    # A panel of the cost, and one of the length without a fix where a route has any.
    known = departures.facts
    facts = [f"{name}: {known[name]}" for name in FACTS if known.get(name)]
    num = 2
    if "no_fix_m" not in table or not table["no_fix_m"].any():
        num = 1
        facts.append("no fix is known to be lost")
    note = f"{joined(*facts)}\n{frame_note(as_maps(maps))}"
    figure = chart(HEIGHT_IN, "When to fly", note, **form)
    ratios = (2, 1)[:num]
    axes = figure.subplots(num, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]

    # A line for each value, later ones thinner, so that all are seen where they coincide.
    cost, *no_fix = axes
    lines = table.groupby(series, sort=False)
    for colour, wide_pt, (name, line) in zip(SERIES_COLOURS, WIDTHS_PT, lines, strict=False):
        above = 100 * line["above_best"]
        changed = line["num_changed"] > 0
        cost.plot(
            line["x"],
            above,
            "o-",
            color=colour,
            linewidth=wide_pt,
            markersize=MARK_PT + wide_pt,
            label=name or "the best time's route",
        )
        cost.plot(
            line["x"][changed],
            above[changed],
            "o",
            color=colour,
            markersize=MARK_PT,
            markerfacecolor="white",
        )
        for panel in no_fix:
            panel.plot(line["x"], line["no_fix_m"], color=colour, linewidth=wide_pt)
    cost.plot([], [], "ok", markerfacecolor="white", label="another route than at the best time")
    legend_above(cost)

    # The scales: they reach as far as `LEAST_TOP`, so that a small effect looks small, and begin a little below 0.
    for number, panel in enumerate(axes):
        top = 1.1 * max(LEAST_TOP[number], panel.dataLim.y1)
        panel.set(ylabel=letter(number, num) + LABELS[number], ylim=(-FOOT * top, top))
        dress(panel)
    figure.align_ylabels(axes)
    step = math.ceil(len(labels) / MOST_TICKS)
    panel.set_xticks(range(0, len(labels), step), labels[::step])
    panel.set_xlabel(axis_label)
    return figure
