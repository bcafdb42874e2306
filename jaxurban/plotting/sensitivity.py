"""Pictures of what weights do to a route: switches along lines, over a triangle, Sobol indices, the Pareto front."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from jaxurban.plotting.frame import (
    FAINT_INK,
    INK,
    SMALL_PT,
    TEXT_PT,
    add_colour_bar,
    add_key,
    draw_layers,
    make_frame,
)
from jaxurban.plotting.metrics import colour_map, frame_note, obstacle_patches
from jaxurban.plotting.paths import BLOCKED_COLOUR, cost_layers, draw_ends
from jaxurban.studies.sensitivity import Sensitivity
from jaxurban.studies.sobol import CONFIDENCE

LABELS = {  # of outcomes
    "length_m": "length",
    "mean_gps": "GPS quality",
    "mean_lidar": "lidar quality",
    "people": "people",
    "mean_risk": "clearance (risk)",
}
GIVEN_COLOUR, FIRST_COLOUR, TOTAL_COLOUR = "#d62728", "#0072b2", "#e69f00"
FACTOR_MAP, PARETO_MAP = "viridis", "viridis"
KIND_COLOURS = ("#d62728", "#1f77b4", "#2ca02c", "#ff7f0e", "#9467bd", "#17becf", "#e377c2")
PALE = 0.6  # of white in the colour of the other routes of a kind
PANEL_IN, NUM_COLS = (2.9, 2.0), 3
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, math.sqrt(3) / 2]])  # of the triangle on the page


def sensitivity_figures(found: Sensitivity) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure, by file name."""
    figures = {
        "switches": lambda: plot_switches(found),
        "switch_routes": lambda: plot_switch_routes(found),
        "sobol": lambda: plot_sobol(found),
        "pareto": lambda: plot_pareto(found),
    }
    if found.triangle is not None:
        figures |= {"triangle": lambda: plot_triangle(found), "triangle_routes": lambda: plot_triangle_routes(found)}
    return figures


def plot_switches(found: Sensitivity) -> Figure:
    """Return the cheapest cost along the range of each weight, a dot where the route switches."""
    figure, panels = _panels(
        len(found.vary),
        "Cheapest cost along the range of each weight",
        "a dot: the route switches there; red: the given weight; all other weights as given",
    )
    for panel, name in zip(panels, found.vary, strict=True):
        line, column = found.lines[name], found.names.index(name)
        ends = line.corners[:, column]
        values = np.geomspace(ends[0], ends[1], 400)

        def cost(values, line=line, ends=ends):
            share = (values - ends[0]) / (ends[1] - ends[0])
            return line.cost_at(np.stack([1 - share, share], axis=-1))

        at = ends[0] + line.cuts * (ends[1] - ends[0])
        panel.plot(values, cost(values), color=INK, linewidth=1.1)
        panel.plot(at, cost(at), linestyle="none", marker="o", markersize=2.8, color=FIRST_COLOUR, zorder=3)
        panel.axvline(found.weights[column], color=GIVEN_COLOUR, linewidth=1.0, zorder=1)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(numticks=6))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.set_title(f"{name}: {_counted(len(at), 'switch', 'switches')}", size=TEXT_PT, loc="left", color=INK)
        panel.set_xlabel(f"weight of {name} (1)", size=SMALL_PT)
        panel.set_ylabel("cheapest cost (1)", size=SMALL_PT)
        panel.set_xlim(values[0], values[-1])
        panel.yaxis.set_major_formatter(
            FuncFormatter(lambda value, _: f"{value:,.0f}" if value >= 10 else f"{value:g}")
        )
    return figure


def plot_switch_routes(found: Sensitivity) -> Figure:
    """Return a map for each weight with the routes along its range, coloured by where they are the cheapest."""
    titles = [f"{name}: {_counted(len(found.lines[name].cells), 'route', 'routes')}" for name in found.vary]
    frame = _maps(found, titles, "Cheapest routes along the range of each weight")
    norm = LogNorm(*found.factors)
    for panel, name in zip(frame.axes, found.vary, strict=True):
        table = found.switches(name)
        middle = np.sqrt(table["from"] * table["to"]) / found.weights[found.names.index(name)]
        panel.add_collection(
            LineCollection(
                found.line_routes[name],
                colors=colour_map(FACTOR_MAP)(norm(middle)),
                linewidths=np.linspace(3.2, 1.4, len(table)),
                capstyle="round",
                zorder=4,
            )
        )
        panel.plot(*found.route.xy_m.T, color=GIVEN_COLOUR, linewidth=1.2, linestyle=(0, (3, 2)), zorder=6)
        draw_ends(panel, [found.route])
    add_key(
        frame,
        [*obstacle_patches(found.maps, BLOCKED_COLOUR), ("given weights\n(dashed)", GIVEN_COLOUR)],
        (colour_map(FACTOR_MAP), norm),
        "weight, as a multiple of the given one",
        ticks=_decades(found.factors),
    )
    return frame.figure


def plot_triangle(found: Sensitivity) -> Figure:
    """Return the partition of the triangle of three weights into the cells of its cheapest routes, by kind."""
    parts = found.triangle
    assert parts is not None, "asked for only where there is a triangle"
    figure = Figure(figsize=(8.8, 5.6), facecolor="white")
    panel = figure.add_axes((0.02, 0.05, 0.64, 0.8))
    at = [found.names.index(name) for name in found.triangle_names]
    given = found.weights[at]
    note = f"three weights share {given.sum():g} in all ways, the others as given"
    known = "" if parts.is_complete else "; not all routes were looked for"
    _head(figure, f"{len(parts.cells)} cheapest routes over a triangle of weights", note + known)
    for number, (cell, kind) in enumerate(zip(parts.cells, found.kinds, strict=True)):
        colour = KIND_COLOURS[kind] if number in found.standing else _pale(KIND_COLOURS[kind])
        panel.add_patch(Polygon(cell @ CORNERS, facecolor=colour, edgecolor="white", linewidth=0.5))
    panel.add_patch(Polygon(CORNERS, fill=False, edgecolor=INK, linewidth=0.9))
    star: dict[str, Any] = {"linestyle": "none", "marker": "*", "color": "white", "markeredgecolor": "black"}
    panel.plot(*(given / given.sum() @ CORNERS), markersize=13, **star)
    for corner, name, drop_pt in zip(CORNERS, found.triangle_names, (-6, -6, 6), strict=True):
        look: dict[str, Any] = {"ha": "center", "va": "top" if drop_pt < 0 else "bottom", "size": TEXT_PT}
        panel.annotate(f"all on {name}", corner, (0, drop_pt), textcoords="offset points", **look)
    panel.set(xlim=(-0.12, 1.12), ylim=(-0.08, 0.95), aspect="equal")
    panel.set_axis_off()
    lengths_km = found.tables()["triangle"]["length_m"].to_numpy()[found.standing] / 1000
    shares = np.bincount(found.kinds, parts.sizes)
    counts = np.bincount(found.kinds)
    handles: list[Patch | Line2D] = [
        Patch(facecolor=KIND_COLOURS[kind], label=f"{kind + 1}: {shares[kind]:.0%}, {counts[kind]}, {length_km:.2f} km")
        for kind, length_km in enumerate(lengths_km)
    ]
    handles.append(Line2D([], [], markersize=11, label="given weights", **star))
    figure.legend(
        handles=handles,
        title="kind: share of the triangle, routes,\nlength of the route in full colour",
        alignment="left",
        loc="upper left",
        bbox_to_anchor=(0.68, 0.84),
        fontsize=SMALL_PT,
        title_fontsize=SMALL_PT,
        frameon=False,
    )
    return figure


def plot_triangle_routes(found: Sensitivity) -> Figure:
    """Return the map with a route of each kind, in the colours of `plot_triangle`."""
    title = f"{len(found.kinds)} routes over the triangle of {_listed(found.triangle_names)}: one of each kind"
    frame = _maps(found, [title], "Kinds of route over a triangle of weights")
    panel = frame.axes[0]
    for kind, xy_m in reversed(list(enumerate(found.triangle_routes))):
        width = 1.6 + 0.5 * kind  # where they coincide, all are seen
        zorder = 4 + len(found.triangle_routes) - kind
        panel.plot(*xy_m.T, color=KIND_COLOURS[kind], linewidth=width, zorder=zorder, solid_joinstyle="round")
    draw_ends(panel, [found.route])
    lines = [
        (f"kind {kind + 1}" + ("\n(given weights)" if kind == 0 else ""), KIND_COLOURS[kind])
        for kind in range(len(found.triangle_routes))
    ]
    add_key(frame, [*obstacle_patches(found.maps, BLOCKED_COLOUR), *lines])
    return frame.figure


def plot_sobol(found: Sensitivity) -> Figure:
    """Return first-order and total Sobol indices of each outcome, with confidence intervals."""
    table = found.sobol.table
    outcomes = list(dict.fromkeys(table.index.get_level_values("outcome")))
    low, high = found.factors
    figure, panels = _panels(
        len(outcomes),
        "Which weights decide what the route is like",
        f"Sobol indices over {low:g} to {high:g} times each weight, {found.sobol.num_evaluations:,} plans; "
        f"bars: {CONFIDENCE:.0%} confidence",
        foot_in=0.35,
    )
    for panel, outcome in zip(panels, outcomes, strict=True):
        rows = table.loc[outcome]
        place = np.arange(len(rows))
        for shift, kind, colour in ((-0.19, "first", FIRST_COLOUR), (0.19, "total", TOTAL_COLOUR)):
            bars: dict[str, Any] = {"ecolor": INK, "capsize": 2, "error_kw": {"linewidth": 0.8}}
            panel.bar(
                place + shift, rows[kind].fillna(0), 0.36, color=colour, yerr=rows[f"{kind}_ci"].fillna(0), **bars
            )
        if rows["first"].isna().all():
            panel.text(0.5, 0.5, "does not vary", transform=panel.transAxes, ha="center", size=TEXT_PT)
        panel.set_xticks(place, list(rows.index))
        panel.axhline(0, color=FAINT_INK, linewidth=0.6)
        panel.set_title(LABELS[outcome], size=TEXT_PT, loc="left", color=INK)
        panel.set_ylabel("share of variance (1)", size=SMALL_PT)
        panel.set_xlabel("weight", size=SMALL_PT)
        panel.set_ylim(
            min(-0.1, float((rows["first"] - rows["first_ci"]).min() - 0.03)) if rows["first"].notna().any() else -0.1,
            None,
        )
        panel.set_ylim(top=max(1.05, panel.get_ylim()[1]))
    figure.legend(
        handles=[
            Patch(color=FIRST_COLOUR, label="first-order: alone"),
            Patch(color=TOTAL_COLOUR, label="total: with its interactions"),
        ],
        loc="lower left",
        bbox_to_anchor=(0.05, 0.0),
        ncols=2,
        fontsize=SMALL_PT,
        frameon=False,
    )
    return figure


def plot_pareto(found: Sensitivity) -> Figure:
    """Return the supported Pareto points of two or three features; the third is the colour."""
    front = found.front
    figure = Figure(figsize=(7.6, 5.0), facecolor="white")
    panel = figure.add_axes((0.1, 0.11, 0.68, 0.71))
    counted = _counted(len(front.points), "route", "routes")
    _head(
        figure,
        f"Best trade-offs between {_listed(front.wishes)}",
        f"{counted}, each the cheapest for some weights of these alone (supported points)",
    )
    order = front.points.sort_values(front.wishes[0])
    x, y = (order[name].to_numpy() for name in front.wishes[:2])
    gradient = found.local.cost["gradient"].to_numpy()
    given = [gradient[found.names.index(name)] for name in front.wishes]
    if len(front.wishes) == 2:
        panel.plot(x, y, color=FAINT_INK, linewidth=0.8, marker="o", markersize=4, markerfacecolor=FIRST_COLOUR)
        panel.plot(
            *given,
            marker="*",
            markersize=13,
            color="white",
            markeredgecolor=GIVEN_COLOUR,
            linestyle="none",
            label="given weights",
        )
    else:
        third = order[front.wishes[2]].to_numpy()
        norm = Normalize(min(third.min(), given[2]), max(third.max(), given[2]))
        panel.scatter(x, y, c=third, norm=norm, cmap=PARETO_MAP, s=26, edgecolors=FAINT_INK, linewidths=0.4)
        panel.scatter(
            given[0],
            given[1],
            c=given[2:],
            norm=norm,
            cmap=PARETO_MAP,
            marker="*",
            s=220,
            edgecolors=GIVEN_COLOUR,
            label="given weights",
        )
        add_colour_bar(
            figure, (0.81, 0.11, 0.022, 0.6), (colour_map(PARETO_MAP), norm), _feature_label(found, front.wishes[2])
        )
    panel.set_xlabel(_feature_label(found, front.wishes[0]), size=SMALL_PT)
    panel.set_ylabel(_feature_label(found, front.wishes[1]), size=SMALL_PT)
    panel.margins(0.06)
    _dress(panel)
    figure.legend(loc="upper right", bbox_to_anchor=(0.99, 0.84), fontsize=SMALL_PT, frameon=False)
    return figure


def _feature_label(found: Sensitivity, name: str) -> str:
    if name == "distance":
        return "distance (m)"
    is_line = found.route.settings["cost_model"] == "line"
    unit = f"sum of c per {found.route.settings['reference_length_m']:g} m" if is_line else "sum of c over steps"
    return f"{name} cost ({unit}; lower is better)"


def _maps(found: Sensitivity, titles: list[str], heading: str):
    """Return a frame of maps of the normalised cost, on which routes are drawn."""
    settings = found.route.settings
    where = [
        f"{found.route.altitude_m:g} m above ground",
        settings["time_of_day"],
        frame_note(found.maps, settings["time"]),
    ]
    frame = make_frame(found.maps.grid, titles, heading, "  ·  ".join(filter(None, where)))
    for panel in frame.axes:
        draw_layers(
            panel,
            found.maps.grid,
            cost_layers(found.maps, found.route.altitude_m, settings["time"], settings["time_of_day"]),
        )
    return frame


def _panels(num: int, heading: str, note: str, foot_in: float = 0.0) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels of equal size."""
    num_cols = min(NUM_COLS, num) if num != 4 else 2
    num_rows = math.ceil(num / num_cols)
    gap_x, gap_y, left, head = 0.75, 0.8, 0.75, 0.95
    width = max(left + num_cols * (PANEL_IN[0] + gap_x) - gap_x + 0.15, 7.2)
    height = head + num_rows * (PANEL_IN[1] + gap_y) - gap_y + 0.55 + foot_in
    figure = Figure(figsize=(width, height), facecolor="white")
    _head(figure, heading, note)
    panels = []
    for number in range(num):
        row, col = divmod(number, num_cols)
        x = left + col * (PANEL_IN[0] + gap_x)
        y = height - head - row * (PANEL_IN[1] + gap_y) - PANEL_IN[1]
        panel = figure.add_axes((x / width, y / height, PANEL_IN[0] / width, PANEL_IN[1] / height))
        _dress(panel)
        panels.append(panel)
    return figure, panels


def _head(figure: Figure, heading: str, note: str) -> None:
    width, height = figure.get_size_inches()
    figure.text(0.3 / width, 1 - 0.10 / height, heading, va="top", size=12, weight="bold", color=INK)
    figure.text(0.3 / width, 1 - 0.38 / height, note, va="top", size=TEXT_PT, color=FAINT_INK)


def _dress(panel: Axes) -> None:
    panel.tick_params(labelsize=SMALL_PT, length=3, color=FAINT_INK)
    panel.grid(axis="y", linewidth=0.4, alpha=0.5)
    panel.set_axisbelow(True)
    for spine in panel.spines.values():
        spine.set(linewidth=0.6, color=FAINT_INK)


def _decades(factors: tuple[float, float]) -> list[float]:
    low, high = (math.log10(factor) for factor in factors)
    return [10.0**power for power in range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1)]


def _pale(colour: str) -> tuple[float, ...]:
    return tuple((1 - PALE) * np.array(to_rgb(colour)) + PALE)


def _counted(num: int, one: str, many: str) -> str:
    return f"{num} {one if num == 1 else many}"


def _listed(items: tuple[str, ...]) -> str:
    return f"{', '.join(items[:-1])} and {items[-1]}"
