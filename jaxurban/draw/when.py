"""The strip of departures: by time, what routes cost above the best time, and how far they fly without a fix."""

import math
from itertools import product
from typing import Unpack

import pandas as pd
from matplotlib.figure import Figure

from jaxurban.draw.frame import frame_note, joined
from jaxurban.draw.style import (
    INK,
    POINTS,
    SERIES_COLOURS,
    chart,
    drawing,
    dress,
    legend_above,
    letter,
    name_rows,
)
from jaxurban.maps.metric_maps import MapsLike, as_maps
from jaxurban.paths.when import NIGHT, Departures
from jaxurban.pictures import Form
from jaxurban.settings import time_said

MOST_TICKS, HEIGHT_IN = 8, 3.0
BAR_IN, BAR_COLOUR = 0.35, "#9ecae1"  # of times of day: height, and a colour that ink is read on
NIGHT_COLOUR = "#e4e4ec"
MARK_PT = 4.0  # of a hollow mark, over others
FACTS = "best", "worst", "times without a path"  # of the departures, in the note
WIDTHS_PT = 6.0, 2.5, *(1.2,) * 5  # of the lines, whose marks are as much wider
LABELS = "cost above best (%)", "no fix (m)"
FOOT = 0.05  # of the scales, below 0, so that marks there are whole
LEAST_TOP = 10.0, 50.0  # of the scales, percent and metres, so that a small effect looks small


@drawing
def plot_when(departures: Departures, maps: MapsLike, **form: Unpack[Form]) -> Figure:
    """Return the cost above the best time and the length without a fix by time, a line for each time of day.

    Where each time has its own day or night there is one line, and the nights are shaded. At hollow marks a route
    differs from the best time's. A line has a gap where a route has no path. With one time alone there are bars of the
    cost and of the length without a fix, one for each time of day. Where no fix is known to be lost, that panel is left
    out.

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
    # A panel of the cost, and one of the length without a fix where a route has any.
    known = departures.facts
    facts = [f"{name}: {known[name]}" for name in FACTS if known.get(name)]
    num = 2
    if "no_fix_m" not in table or not table["no_fix_m"].any():
        num = 1
        facts.append("no fix is known to be lost")
    note = f"{joined(*facts)}\n{frame_note(as_maps(maps))}"
    if table["time"].nunique() == 1:
        return _bars(table, num, note, form)
    figure = chart(HEIGHT_IN, "When to fly", note, **form)
    ratios = (2, 1)[:num]
    axes = figure.subplots(num, 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
    labels = [time[11:16] for time in table["time"].unique()]  # hours and minutes
    table["x"] = table["time"].factorize()[0]

    # A line for each time of day, later ones thinner, so that all are seen where they coincide.
    cost, *no_fix = axes
    is_paired = table["time"].is_unique and table["time_of_day"].nunique() > 1
    lines = [("", table)] if is_paired else _lines(table)
    widths_pt = WIDTHS_PT[len(lines) == 1 :]  # a line alone hides none
    for colour, wide_pt, (name, line) in zip(SERIES_COLOURS, widths_pt, lines, strict=False):
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
    if is_paired:
        nights = table["x"][table["time_of_day"] == NIGHT]
        for panel, x in product(axes, nights):
            label = "night" if (panel, x) == (cost, nights.iloc[0]) else ""
            panel.axvspan(x - 0.5, x + 0.5, color=NIGHT_COLOUR, zorder=0, label=label)
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
    panel.set_xlabel(f"UTC, from {table['time'].iloc[0][:10]}")
    return figure


def _lines(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Return the rows of each time of day with its name; times of day whose lines no eye could part are one."""
    lines: dict[str, tuple[list[str], pd.DataFrame]] = {}
    for name, line in table.groupby("time_of_day", sort=False):
        facts = line.reindex(columns=["x", "above_best", "num_changed", "no_fix_m"])
        names, _ = lines.setdefault(facts.round(3).to_csv(index=False), ([], line))
        names.append(str(name))
    return [(" and ".join(names), line) for names, line in lines.values()]


def _bars(table: pd.DataFrame, num: int, note: str, form: Form) -> Figure:
    """Return the costs, and lengths without a fix, of the times of day of one time, as bars with their numbers.

    Args:
      table: a row for each time of day, as of `Departures.table`.
      num: of panels: 1 without the lengths.
      note: the lines beneath.
      form: as of `plot_when`.
    """
    figure = chart(BAR_IN * (len(table) + 2), "When to fly", note, **form)
    axes = figure.subplots(1, num, sharey=True, width_ratios=(2, 1)[:num], squeeze=False)[0]
    names = "cost", "no_fix_m"
    time = table["time"].iloc[0]
    labels = f"cost at {time_said(time)}" if time else "cost", "no fix (m)"
    texts = _costs_said(table), [f"{lost_m:,.0f}" for lost_m in table.get("no_fix_m", ())]
    for number, panel in enumerate(axes):
        panel.barh(range(len(table)), table[names[number]], height=0.6, color=BAR_COLOUR)
        for row, text in enumerate(texts[number]):
            panel.annotate(text, (0, row), (4, 0), textcoords=POINTS, va="center", color=INK)
        name_rows(panel, table["time_of_day"].tolist())
        panel.set(xlabel=letter(number, num) + labels[number], xlim=(0, None))
    return figure


def _costs_said(table: pd.DataFrame) -> list[str]:
    """Return the cost of each row of departures in words: by how much it is above the best, and if routes change."""
    said = []
    for row in table.to_dict("records"):
        text = f"{row['cost']:,.2f}: best"
        if row["above_best"] > 0:
            text = f"{row['cost']:,.2f}: {row['above_best']:.2%} above the best"
        if row["num_changed"]:
            text += ", another route"
        said.append("no path" if math.isnan(row["cost"]) else text)
    return said
