# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 3. Five planners on one map, and why the printed heuristic fails
#
# **Which planner finds the cheapest path, how soon, and can its result be trusted?**
#
# The paper's five planners, and one more that this package adds, on one query 30 m above Shinjuku in Tokyo:
#
# | planner | idea |
# |---|---|
# | `ptp` | the straight line |
# | `astar-dist` | A\* from cell to cell, guided by the straight distance to the goal |
# | `astar-plus` | A\* guided by distance and by what the maps cost at least |
# | `bitstar-dist`, `bitstar-plus` | BIT\*: random points joined to a tree, better with every batch; bounds as above |
# | `theta-star` | A\* whose legs may point anywhere, not only to the eight neighbours |
#
# All pay the same: the default cost model, `line`, costs every path by the exact length in each cell. The first call on
# a machine compiles for some ten seconds.

# %%
# %matplotlib inline
from collections.abc import Callable

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import jaxurban as ju
from jaxurban.draw.routes import planner_colours
from jaxurban.draw.style import legend_below, panels, styled
from jaxurban.planners.astar import astar, heuristic_at, make_heuristic
from jaxurban.planners.base import Problem
from jaxurban.planners.bitstar.planner import bitstar_plus
from jaxurban.planners.bulk import solve_batched
from jaxurban.plot import plot_paths
from jaxurban.settings import PlannerName
from jaxurban.typing import PlannedPath

city = ju.sample_city("shinjuku")
maps = ju.build_maps(city, resolution_m=10.0, altitudes_m=(30.0,))
weighted = ju.cost_map(maps, 30.0)
x_m, y_m = maps.grid.x_m, maps.grid.y_m
ends = ju.XY(x_m[20], y_m[25]), ju.XY(x_m[175], y_m[170])
planners: tuple[PlannerName, ...] = (
    "ptp",
    "astar-dist",
    "astar-plus",
    "bitstar-dist",
    "bitstar-plus",
    "theta-star",
)
paths: dict[str, PlannedPath] = {
    name: weighted.plan(*ends, planner=name, budget_s=2.0, snap=True) for name in planners
}

# %% [markdown]
# `optimal` means proven, **on this planner's own graph**: A\* knows the eight directions of the grid only, so BIT\* and
# Theta\* may find cheaper paths. `gap` is by how much the path's cost can exceed that of the best path **of that
# graph** at most; inf where a planner proves nothing. A\* and Theta\* stop when they are done, BIT\* when its 2 s are
# over.

# %%
pd.DataFrame(
    {
        name: {
            "status": path.status.value,
            "cost": f"{path.cost:.1f}",
            "gap (%)": f"{100 * path.search.gap:.1f}",
            "length (m)": f"{path.length_m:,.0f}",
            "time (s)": f"{path.search.elapsed_s:.3f}",
            "expanded": f"{path.search.num_expanded:,}",
        }
        for name, path in paths.items()
    }
).T

# %%
plot_paths(maps, list(paths.values()))

# %% [markdown]
# ## How soon
#
# Planners that improve as they go keep their history. A point is a path found; the line at the bottom is the cheapest
# of all.

# %%
colours = planner_colours(planners)


@styled
def plot_history() -> Figure:
    """Return the cost of the best path by time."""
    figure, (panel,) = panels(1, "Cost of the best path so far", height_in=2.5)
    for name in ("bitstar-dist", "bitstar-plus"):
        seconds, _, costs = np.array(paths[name].search.history).T
        panel.step(seconds, costs, where="post", marker=".", color=colours[name], label=name)
    for name, marker in (("astar-dist", "s"), ("astar-plus", "o"), ("theta-star", "^")):
        ended = paths[name].search.elapsed_s, paths[name].cost
        panel.plot(*ended, marker, color=colours[name], markersize=7, label=f"{name}, when done")
    cheapest = min(path.cost for path in paths.values())
    panel.axhline(cheapest, color="black", linewidth=0.8, label="cheapest of all")
    panel.set(xscale="log", xlabel="time since the start of the search (s)", ylabel="cost")
    legend_below(figure, panel)
    return figure


plot_history()

# %% [markdown]
# ## One search after the other, or all together
#
# `plan_many` runs queries with Numba, one search after the other on every core, or with JAX, all of them together, the
# shape for a GPU; BIT\*'s graphs are searched in bulk then. Costs are the same, given time to end (A\*) or the same
# number of samples (BIT\*). On a CPU Numba is the faster one by far, so `backend="auto"` takes it there.

# %%
instances = ju.studies.sample_instances(maps, 24, weights=[ju.Weights()]).query("is_connected")
pairs = instances[["start_x_m", "start_y_m", "goal_x_m", "goal_y_m"]]
shortest = instances["distance_m"].argmin()  # which few samples solve
x0, y0, x1, y1 = pairs.to_numpy()[shortest]
start_end, goal_end = weighted.free_space.ends(ju.XY(x0, y0), ju.XY(x1, y1))
query = weighted.problem.between(start_end.cell, goal_end.cell)
rows = {}
for backend in ("numba", "jax"):
    many = ju.plan_many(
        maps, pairs, altitude_m=30.0, cost_model="line", backend=backend, budget_s=120.0
    )
    if backend == "numba":
        one = bitstar_plus(query, max_samples=2_000, budget_s=120.0)
    else:
        ((_, one),) = solve_batched(
            [query],
            planner="bitstar-plus",
            heuristic="plus",
            seeds=[0],
            max_samples=2_000,
            budget_s=120.0,
        )
    planned = [path for path in many if path is not None]
    total = sum(path.cost for path in planned)
    rows["astar-plus", backend] = len(planned), total, {path.search.backend for path in planned}
    rows["bitstar-plus", backend] = 1, one.cost, {one.backend}
pd.DataFrame(rows, ["queries", "sum of costs", "what ran"]).T.sort_index()

# %% [markdown]
# ## Why the printed heuristic fails
#
# A\* expands the cell of least f = g + h: the cost to get there, plus an estimate h of the cost to go. The path is the
# cheapest one if h **never exceeds** the true cost to go. The paper's h_plus adds up the cheapest cell of each column,
# and of each row, **within the box between the cell and the goal**, and is said never to exceed it. Nine cells show
# that it does. The numbers are what entering a cell costs; a metre costs 1, cells are 1 m.

# %%
cost = np.array([[0, 5, 0], [0, 5, 0], [0, 0, 0]], float)  # row 0 in the south
start, goal = (0, 0), (0, 2)
nine = Problem(
    cost[None],
    np.ones((3, 3), bool),
    start,
    goal,
    resolution_m=1.0,
    weights=1.0,
    cost_model=ju.CostModel("cell"),
)
printed, truth = make_heuristic("plus-printed", nine), make_heuristic("exact", nine)


def as_table(value: Callable[[tuple[int, int]], float]) -> pd.DataFrame:
    """Return the nine cells' values with the north on top."""
    rows = [[value((row, col)) for col in range(3)] for row in (2, 1, 0)]
    return pd.DataFrame(
        rows, ["row 2", "row 1", "row 0"], ["column 0", "column 1", "column 2"]
    ).round(2)


pd.concat(
    {
        "cost of entering": as_table(lambda cell: cost[cell]),
        "printed h_plus": as_table(lambda cell: heuristic_at(printed, cell, goal)),
        "true cost to go": as_table(lambda cell: heuristic_at(truth, cell, goal)),
    },
    axis=1,
)

# %% [markdown]
# The start is in row 0, column 0, the goal in row 0, column 2, and the wall of fives between them is open in row 2. In
# row 1, column 0 the true cost to go is 3.83, around the wall. But the box from there to the goal ends at row 1: within
# it the middle column costs 5, so h_plus says 7.41. A\* never looks there, and goes through the wall:

# %%
for name in ("plus-printed", "tiles"):
    found = astar(nine, heuristic=name)
    steps = " -> ".join(f"({y:g}, {x:g})" for x, y in np.floor(found.points_m))
    print(f"{name:13} cost {found.cost:.2f}  {found.status.value:9} by (row, column) {steps}")

# %% [markdown]
# ## How much it matters on a city
#
# Forty random queries on the map above, less those that no path joins, under the paper's own cost model `cell`. `tiles`
# is the bound that this package uses instead: the cost to go over tiles that cost what their cheapest cell does.
# [How the search works](../docs/algorithms/search.md) has the proof.

# %%
by_cell = ju.cost_map(maps, 30.0, cost_model="cell")
queries = ju.studies.sample_instances(maps, 40, weights=[ju.Weights()]).query("is_connected")
compared = []
for x0, y0, x1, y1 in queries[pairs.columns].to_numpy():
    ends = ju.XY(x0, y0), ju.XY(x1, y1)
    best = by_cell.plan(*ends, heuristic="tiles")
    by_printed = by_cell.plan(*ends, heuristic="plus-printed")
    excess_percent = 100 * (by_printed.cost / best.cost - 1)
    compared.append((excess_percent, by_printed.search.num_expanded / best.search.num_expanded))
excess, expanded = np.array(compared).T
print(
    f"{len(queries)} queries: the path of the printed heuristic costs more in {np.mean(excess > 1e-6):.0%} of them,"
)
print(f"by {np.median(excess):.2f} % in the median and {excess.max():.1f} % at worst,")
print(f"and it expands {np.median(expanded):.2f} times the cells in the median.")

# %%


@styled
def plot_printed() -> Figure:
    """Return how much more paths of the printed heuristic cost, by the cells that they took."""
    heading = f"The printed heuristic finds a more costly path in {np.mean(excess > 1e-6):.0%} of the queries"
    figure, (panel,) = panels(1, heading, height_in=2.5)
    panel.plot(expanded, excess, "o", color=colours["astar-plus"], markersize=5, label="a query")
    panel.axhline(0, color="black", linewidth=0.8, label="the cheapest path")
    panel.axvline(1, color="black", linewidth=0.8, linestyle="--", label="as many cells as tiles")
    panel.set(xlabel="cells expanded, as a multiple of those of the heuristic tiles")
    panel.set(ylabel="cost above the cheapest path (%)")
    legend_below(figure, panel)
    return figure


plot_printed()

# %% [markdown]
# ## A question to try
#
# Does the order of the planners stay the same on a map of 20 m cells? Change `resolution_m`, and run it all again.
