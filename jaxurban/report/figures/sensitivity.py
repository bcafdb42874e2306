"""Pictures of what weights do to a route: breakpoints along lines, over a triangle, Sobol indices, the Pareto front."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import LogLocator, NullLocator

from jaxurban.report.figures.frame import Frame, add_key, draw_layers, make_frame
from jaxurban.report.figures.metrics import obstacle_patches, percent
from jaxurban.report.figures.notes import frame_note, joined, rules_said
from jaxurban.report.figures.paths import BLOCKED_COLOUR, cost_layers, draw_ends
from jaxurban.report.figures.style import (
    FAINT_INK,
    INK,
    SMALL_PT,
    TEXT_PT,
    Colours,
    add_colour_bar,
    chart,
    dress,
    legend_below,
    panels,
    show_plain,
    styled,
)
from jaxurban.report.write import counted, listed
from jaxurban.studies.queries import outcome_label
from jaxurban.studies.weights.sobol import CONFIDENCE
from jaxurban.studies.weights.study import Sensitivity

GIVEN_COLOUR, FIRST_COLOUR, TOTAL_COLOUR = "#d62728", "#0072b2", "#e69f00"
ON_ROUTES_COLOUR = "#ffffff"  # of the given weights' route over others of all colours
# Told apart by the colour-blind too (Okabe and Ito 2008).
CLUSTER_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#e69f00", "#cc79a7", "#56b4e9", "#f0e442")
SHARES_SHOWN = (-0.5, 1.6)  # Sobol indices lie in 0 to 1: longer intervals are cut
NUMBER_LOOK = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": INK, "linewidth": 0.4, "alpha": 0.85}
PALE = 0.6  # of white in the colour of the other routes of a kind
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, math.sqrt(3) / 2]])  # of the triangle on the page


def sensitivity_figures(found: Sensitivity) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure, by file name."""
    figures = {
        "switches": lambda: plot_breakpoints(found),
        "switch_routes": lambda: plot_breakpoint_routes(found),
        "sobol": lambda: plot_sobol(found),
        "pareto": lambda: plot_pareto(found),
    }
    if found.triangle is not None:
        figures |= {"triangle": lambda: plot_triangle(found), "triangle_routes": lambda: plot_triangle_routes(found)}
    return figures


@styled
def plot_breakpoints(found: Sensitivity) -> Figure:
    """Return the cheapest cost along the range of each weight, a dot where the route changes."""
    figure, axes = panels(
        len(found.vary),
        "Cheapest cost along the range of each weight",
        _note(found, "a dot: a breakpoint, where the route changes; red: the given weight; all other weights as given"),
        shares_y=True,
    )
    for panel, name in zip(axes, found.vary, strict=True):
        line, column = found.lines[name], found.names.index(name)
        ends = line.corners[:, column]
        values = np.geomspace(ends[0], ends[1], 400)

        def cost(values, line=line, ends=ends):
            share = (values - ends[0]) / (ends[1] - ends[0])
            return line.cost_at(np.stack([1 - share, share], axis=-1))

        at = ends[0] + line.breakpoints * (ends[1] - ends[0])
        panel.plot(values, cost(values), color=INK, linewidth=1.1)
        panel.plot(at, cost(at), linestyle="none", marker="o", markersize=2.8, color=FIRST_COLOUR, zorder=3)
        panel.axvline(found.weights[column], color=GIVEN_COLOUR, linewidth=1.0, zorder=1)
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(numticks=6))
        panel.xaxis.set_minor_locator(NullLocator())
        for axis in (panel.xaxis, panel.yaxis):
            show_plain(axis)
        panel.set(xlim=(values[0], values[-1]), xlabel=f"weight of {name} (1)")
        panel.set_title(f"{name}: {counted(len(at), 'breakpoint')}")
    figure.supylabel("cheapest cost (1)", size=SMALL_PT)
    return figure


def plot_breakpoint_routes(found: Sensitivity) -> Figure:
    """Return a map for each weight with the routes along its range, coloured by where they are the cheapest."""
    titles = [f"{name}: {counted(len(found.lines[name].cells), 'route')}" for name in found.vary]
    frame = _maps(found, titles, "Cheapest routes along the range of each weight")
    label, ticks = "weight, as a multiple of the given one", _decades(found.factors)
    colours = Colours("viridis", LogNorm(*found.factors), label, ticks=ticks)
    for panel, name in zip(frame.axes, found.vary, strict=True):
        table = found.breakpoints(name)
        middle = np.sqrt(table["from"] * table["to"]) / found.weights[found.names.index(name)]
        panel.add_collection(
            LineCollection(
                found.line_routes[name],
                colors=colours(middle),
                linewidths=np.linspace(3.2, 1.4, len(table)),
                capstyle="round",
                zorder=4,
            )
        )
        edge = [Stroke(linewidth=2.4, foreground=INK), Normal()]
        look: dict[str, Any] = {"linewidth": 1.2, "linestyle": (0, (3, 2)), "path_effects": edge, "zorder": 6}
        panel.plot(*found.route.xy_m.T, color=ON_ROUTES_COLOUR, **look)
        draw_ends(panel, [found.route])
    add_key(
        frame,
        [*obstacle_patches(found.maps, BLOCKED_COLOUR), ("given weights\n(dashed)", ON_ROUTES_COLOUR)],
        colours,
        has_ends=True,
    )
    return frame.figure


@styled
def plot_triangle(found: Sensitivity) -> Figure:
    """Return the partition of the triangle of three weights into the cells of its cheapest routes, by cluster."""
    parts = found.triangle
    assert parts is not None, "drawn only where there is a triangle"
    at = [found.names.index(name) for name in found.triangle_names]
    given = found.weights[at]
    known = "" if parts.is_complete else "; not all routes were looked for"
    note = _note(found, f"three weights that sum to {given.sum():g}, in all shares, the others as given{known}")
    figure = chart(8.8, 4.9, f"{len(parts.cells)} cheapest routes over a triangle of weights", note)
    panel = figure.subplots()
    for number, (cell, cluster) in enumerate(zip(parts.cells, found.clusters, strict=True)):
        colour = CLUSTER_COLOURS[cluster] if number in found.representatives else _pale(CLUSTER_COLOURS[cluster])
        panel.add_patch(Polygon(cell @ CORNERS, facecolor=colour, edgecolor="white", linewidth=0.5))
    for cluster, number in enumerate(found.representatives, start=1):
        middle = parts.cells[number].mean(axis=0) @ CORNERS
        panel.text(
            middle[0], middle[1], str(cluster), ha="center", va="center", size=TEXT_PT, color=INK, bbox=NUMBER_LOOK
        )
    panel.add_patch(Polygon(CORNERS, fill=False, edgecolor=INK, linewidth=0.9))
    star: dict[str, Any] = {"linestyle": "none", "marker": "*", "color": "white", "markeredgecolor": "black"}
    panel.plot(*(given / given.sum() @ CORNERS), markersize=13, **star)
    for corner, name, drop_pt in zip(CORNERS, found.triangle_names, (-6, -6, 6), strict=True):
        look: dict[str, Any] = {"ha": "center", "va": "top" if drop_pt < 0 else "bottom", "size": TEXT_PT}
        panel.annotate(f"all on {name}", corner, (0, drop_pt), textcoords="offset points", **look)
    panel.set(xlim=(-0.12, 1.12), ylim=(-0.08, 0.95), aspect="equal")
    panel.set_axis_off()
    lengths_km = found.tables()["triangle"]["length_m"].to_numpy()[found.representatives] / 1000
    shares = np.bincount(found.clusters, parts.sizes)
    counts = np.bincount(found.clusters)
    handles: list[Patch | Line2D] = [
        Patch(facecolor=CLUSTER_COLOURS[k], label=f"{k + 1}: {percent(shares[k])}, {counts[k]}, {length_km:.2f} km")
        for k, length_km in enumerate(lengths_km)
    ]
    handles.append(Line2D([], [], markersize=11, label="given weights", **star))
    panel.legend(
        handles=handles,
        title="cluster: share of the triangle, routes,\nlength of the route in full colour",
        alignment="left",
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
    )
    return figure


def plot_triangle_routes(found: Sensitivity) -> Figure:
    """Return the map with a route of each cluster, in the colours of `plot_triangle`."""
    title = f"{len(found.clusters)} routes over the triangle of {listed(found.triangle_names)}: one of each cluster"
    frame = _maps(found, [title], "Clusters of routes over a triangle of weights")
    panel = frame.axes[0]
    for k, xy_m in reversed(list(enumerate(found.triangle_routes))):
        width = 1.6 + 0.5 * k  # where they coincide, all are seen
        zorder = 4 + len(found.triangle_routes) - k
        panel.plot(*xy_m.T, color=CLUSTER_COLOURS[k], linewidth=width, zorder=zorder, solid_joinstyle="round")
    draw_ends(panel, [found.route])
    lines = [
        (f"cluster {k + 1}" + ("\n(given weights)" if k == 0 else ""), CLUSTER_COLOURS[k])
        for k in range(len(found.triangle_routes))
    ]
    add_key(frame, [*obstacle_patches(found.maps, BLOCKED_COLOUR), *lines], has_ends=True)
    return frame.figure


@styled
def plot_sobol(found: Sensitivity) -> Figure:
    """Return first-order and total Sobol indices of each outcome, with confidence intervals."""
    table = found.sobol.table
    outcomes = list(dict.fromkeys(table.index.get_level_values("outcome")))
    low, high = found.factors
    figure, axes = panels(
        len(outcomes),
        "Which weights decide what the route is like",
        _note(
            found,
            f"Sobol indices over {low:g} to {high:g} times each weight, {found.sobol.num_evaluations:,} plans; "
            f"bars: {100 * CONFIDENCE:g} % confidence, cut at {SHARES_SHOWN[0]:g} and {SHARES_SHOWN[1]:g}",
        ),
        shares_y=True,
    )
    look: dict[str, Any] = {"ecolor": INK, "capsize": 2, "error_kw": {"linewidth": 0.8}}
    kinds = ("first", FIRST_COLOUR, "first-order: alone"), ("total", TOTAL_COLOUR, "total: with its interactions")
    for panel, outcome in zip(axes, outcomes, strict=True):
        rows = table.loc[outcome]
        place = np.arange(len(rows))
        for side, (kind, colour, label) in enumerate(kinds):
            values, ends = rows[kind].fillna(0), rows[f"{kind}_ci"].fillna(0)
            panel.bar(place + 0.38 * side - 0.19, values, 0.36, color=colour, yerr=ends, label=label, **look)
        if rows["first"].isna().all():
            panel.text(0.5, 0.5, "does not vary", transform=panel.transAxes, ha="center", size=TEXT_PT)
        panel.set_xticks(place, list(rows.index))
        panel.axhline(0, color=FAINT_INK, linewidth=0.6)
        panel.set(title=outcome_label(outcome), xlabel="weight")
    axes[0].set_ylim(*SHARES_SHOWN)
    figure.supylabel("share of variance (1)", size=SMALL_PT)
    legend_below(figure, axes[0])
    return figure


@styled
def plot_pareto(found: Sensitivity) -> Figure:
    """Return the supported Pareto points of two or three features; the last is the colour."""
    front = found.front
    routes = counted(len(front.points), "route")
    note = _note(found, f"{routes}, each the cheapest for some weights of these alone (supported points)")
    figure = chart(7.6, 4.2, f"Best trade-offs between {listed(front.objectives)}", note)
    panel = figure.subplots()
    points = front.points[[*front.objectives]].to_numpy()
    given = found.local.cost["gradient"].loc[[*front.objectives]].to_numpy()
    last = np.append(points[:, -1], given[-1])
    colours = Colours("viridis", Normalize(last.min(), last.max()), _feature_label(found, front.objectives[-1]))
    look: dict[str, Any] = {"norm": colours.norm, "cmap": colours.cmap}
    panel.scatter(points[:, 0], points[:, 1], c=points[:, -1], s=26, edgecolors=FAINT_INK, linewidths=0.4, **look)
    star: dict[str, Any] = {"marker": "*", "s": 220, "edgecolors": GIVEN_COLOUR, "label": "given weights"}
    panel.scatter(given[0], given[1], c=given[-1:], **star, **look)
    if len(front.objectives) == 3:
        add_colour_bar(figure, [panel], colours)
    panel.set(xlabel=_feature_label(found, front.objectives[0]), ylabel=_feature_label(found, front.objectives[1]))
    panel.margins(0.06)
    dress(panel)
    panel.legend(loc="best", frameon=True)
    return figure


def _note(found: Sensitivity, told: str) -> str:
    """Return the lines below a figure's heading: what it tells, and which route, where and when it is of."""
    settings = found.route.settings
    facts = joined(f"{found.route.altitude_m:g} m above ground", settings["time_of_day"], told)
    return f"{facts}\n{frame_note(found.maps, settings['time'])}"


def _feature_label(found: Sensitivity, name: str) -> str:
    if name == "distance":
        return "distance (m)"
    is_line = found.route.settings["cost_model"] == "line"
    unit = f"sum of c per {found.route.settings['reference_length_m']:g} m" if is_line else "sum of c over steps"
    return f"{name} cost ({unit}; lower is better)"


def _maps(found: Sensitivity, titles: list[str], heading: str) -> Frame:
    """Return a frame of maps of the normalised cost, on which routes are drawn."""
    settings = found.route.settings
    frame = make_frame(
        found.maps.grid,
        titles,
        heading,
        _note(found, "grey: normalised cost, black: lowest") + f"\n{rules_said(settings)}",
    )
    for panel in frame.axes:
        draw_layers(
            panel,
            found.maps.grid,
            cost_layers(found.maps, found.route.altitude_m, settings["time"], settings["time_of_day"]),
        )
    return frame


def _decades(factors: tuple[float, float]) -> list[float]:
    low, high = (math.log10(factor) for factor in factors)
    return [10.0**power for power in range(math.ceil(low - 1e-9), math.floor(high + 1e-9) + 1)]


def _pale(colour: str) -> tuple[float, ...]:
    return tuple((1 - PALE) * np.array(to_rgb(colour)) + PALE)
