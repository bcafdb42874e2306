"""Figure 1 of the paper: how data flow from sources to maps, to a path, and how gradients flow back."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

import jaxurban as ju
from figures.paper.common import CREDIT, PATH_M, TOWNS, Caption, Town, save
from jaxurban.maps.build import soften
from jaxurban.maps.differentiable import SoftParams
from jaxurban.paths.path import PlannedPath
from jaxurban.report.figures.colours import SMALL_PT
from jaxurban.report.figures.frame import FAINT_INK, INK, TEXT_PT, MapLayer, draw_layers, flat_layer
from jaxurban.report.figures.metrics import (
    BUILT_COLOUR,
    FREE_COLOUR,
    density_colours,
    density_layers,
    free_layer,
    metric_colours,
    obstacle_layer,
    roof_layers,
)
from jaxurban.report.figures.paths import cost_layers, draw_ends
from jaxurban.scenario.run import tasks_of
from jaxurban.scenario.settings import Scenario
from jaxurban.studies.sensitivity.buildings import building_costs
from jaxurban.world.city import Zoning
from jaxurban.world.sky import Sky

ALTITUDE_M, TIME_OF_DAY, SOFTNESS_M = 20.0, "day", 2.0
NEAR_M = 250.0  # around the building that costs most
ENDS = ((0.17, 0.15), (0.80, 0.85))  # of the path, as shares of the region, east and north
WIDTH_IN, HEIGHT_IN = 11.0, 7.5
EDGE, BACK, PATH = "#777777", "#b2182b", "#d62728"
ZONES = {Zoning.COMMERCIAL: "#d6604d", Zoning.RESIDENTIAL: "#4393c3", Zoning.OTHER: "#7fbf7b"}
NAMES = {"gps": "GPS", "lidar": "lidar", "population": "population", "risk": "clearance", "distance": "distance"}

PAPER = (
    "The chain from data to maps to a flight plan: building, census and orbit data become metric maps on a grid, and a "
    "planner weighs them. The picture is not part of the source that we have; this is what its caption and text name."
)


class Facts(NamedTuple):
    """All that the picture shows of a town."""

    town: Town
    maps: ju.MetricMaps
    city: ju.City
    sky: Sky
    mask_deg: float
    planned: PlannedPath
    by_building: pd.DataFrame

    @classmethod
    def of(cls, town: Town) -> "Facts":
        """Return the city, its maps, a path over them, and what every building costs that path."""
        scenario, maps = Scenario.from_dict(town.scenario), town.maps(PATH_M)
        task = next(task for task in tasks_of(scenario) if task.region == maps.grid)
        city, sky, params, grid = task.city, task.sky, task.params, task.region
        low, span = np.array(grid.bounds_m[:2]), np.array(grid.bounds_m[2:]) - grid.bounds_m[:2]
        start, goal = (tuple(low + np.array(at) * span) for at in ENDS)
        planned = ju.plan(
            maps,
            start_xy_m=start,
            goal_xy_m=goal,
            altitude_m=ALTITUDE_M,
            time_of_day=TIME_OF_DAY,
            cost_model="line",
            snap=True,
        )
        soft_params = SoftParams(ALTITUDE_M, SOFTNESS_M, params.gps, params.lidar, params.risk, params.population)
        with jax.enable_x64(True):
            soft = soften(task, time_of_day=TIME_OF_DAY, dtype=np.float64)
            by_building = building_costs(city, soft, planned, soft_params)
        return cls(town, maps, city, sky, scenario.gps.mask_deg, planned, by_building)

    @property
    def slopes(self) -> dict[str, float]:
        """The gradient of the path's cost by each weight."""
        weights = self.planned.settings["weights"]
        return {name: cost / weights[name] for name, cost in self.planned.cost_by_layer.items()}


class Sheet:
    """The figure, measured in inches from its upper left corner."""

    def __init__(self) -> None:
        self.figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor="white")
        self.ground = self.figure.add_axes((0, 0, 1, 1))
        self.ground.set(xlim=(0, WIDTH_IN), ylim=(HEIGHT_IN, 0))
        self.ground.set_axis_off()

    def box(
        self, x: float, y: float, width: float, height: float, title: str, note: str = "", note_y: float = 0.2
    ) -> None:
        """Draw a box with its title, and a note ``note_y`` below its top."""
        look = {
            "boxstyle": "round,pad=0,rounding_size=0.06",
            "facecolor": "#fafafa",
            "edgecolor": EDGE,
            "linewidth": 0.9,
        }
        self.ground.add_patch(FancyBboxPatch((x, y), width, height, zorder=1, **look))
        self.text(x + 0.07, y + 0.06, title, weight="bold", size=SMALL_PT)
        if note:
            self.text(x + 0.07, y + note_y + 0.02, note, size=SMALL_PT - 1, color=FAINT_INK, linespacing=1.3)

    def text(self, x: float, y: float, text: str, **look) -> None:
        """Write below a point."""
        self.ground.text(x, y, text, **({"va": "top", "color": INK, "zorder": 5} | look))

    def panel(self, x: float, y: float, width: float, height: float, **look) -> Axes:
        """Return axes for a thumbnail."""
        box = (x / WIDTH_IN, 1 - (y + height) / HEIGHT_IN, width / WIDTH_IN, height / HEIGHT_IN)
        panel = self.figure.add_axes(box, **look)
        panel.set(xticks=[], yticks=[])
        return panel

    def map(self, x: float, y: float, side: float, grid: ju.Grid, layers: Sequence[MapLayer] = ()) -> Axes:
        """Draw layers as a thumbnail, and return it."""
        panel = self.panel(x, y, side, side)
        if layers:
            draw_layers(panel, grid, layers)
        panel.set(xlim=(grid.x_min_m, grid.x_max_m), ylim=(grid.y_min_m, grid.y_max_m), aspect="equal")
        for spine in panel.spines.values():
            spine.set(linewidth=0.5, color=EDGE)
        return panel

    def arrow(self, *points: tuple[float, float], back: bool = False) -> None:
        """Draw a line through points with a head at the last; a gradient's is dashed and red."""
        look = {"color": BACK if back else INK, "linewidth": 1.7 if back else 1.2, "zorder": 3}
        style = {"linestyle": (0, (4, 2))} if back else {}
        if len(points) > 2:
            self.ground.plot(*zip(*points[:-1], strict=True), **look, **style)
        head = {"arrowstyle": "-|>", "mutation_scale": 11, "shrinkA": 0, "shrinkB": 0}
        self.ground.add_patch(FancyArrowPatch(points[-2], points[-1], **head, **look, **style))


def outlines(panel: Axes, polygons: np.ndarray, **look) -> None:
    """Draw polygons, as an image also in a PDF."""
    rings = [np.asarray(part.exterior.coords) for part in shapely.get_parts(polygons)]
    panel.add_collection(PolyCollection(rings, rasterized=True, **look))


def draw_sources(sheet: Sheet, facts: Facts) -> None:
    """Draw the first column: what is read."""
    grid, blocks, buildings = facts.maps.grid, facts.city.blocks, facts.city.buildings
    is_real = facts.town.scenario["buildings"]["source"] != "synthetic"
    x, width, side = 0.12, 1.84, 0.86
    near = shapely.box(*grid.bounds_m)
    num_buildings = int(shapely.intersects(buildings.polygons, near).sum())
    is_near = shapely.intersects(blocks.polygons, near)
    notes = {
        "Orbits": "elements (TLE) of the GPS\nsatellites, or nominal ones",
        "Buildings": f"{'OpenStreetMap' if is_real else 'made up'}:\noutlines and\nheights of\n{num_buildings:,}",
        "Census": f"people living in\n{int(is_near.sum()):,} blocks",
        "Districts": "offices (red),\nhomes (blue),\nneither (green):\nwhere people\nare by day",
    }
    for number, (title, note) in enumerate(notes.items()):
        y = 0.98 + number * 1.2
        sheet.box(x, y, width, 1.1, title, note)
        if title == "Orbits":
            continue
        panel = sheet.map(x + width - side - 0.06, y + 0.12, side, grid)
        if title == "Buildings":
            outlines(panel, buildings.polygons, facecolor=INK, linewidth=0)
        elif title == "Census":
            per_km2 = blocks.night_count / (shapely.area(blocks.polygons) / 1e6)
            norm, shown = LogNorm(max(per_km2.max() / 1000, 1), per_km2.max()), np.maximum(per_km2, 1e-9)
            look = {"edgecolor": "white", "linewidth": 0.15}
            parts, owner = shapely.get_parts(blocks.polygons, return_index=True)
            outlines(panel, parts, array=shown[owner], cmap="magma_r", norm=norm, **look)
        else:
            for zone, colour in ZONES.items():
                outlines(
                    panel, blocks.polygons[blocks.zoning == zone], facecolor=colour, edgecolor=colour, linewidth=0.2
                )


def draw_sky(sheet: Sheet, x: float, y: float, side: float, facts: Facts) -> None:
    """Draw the satellites: north up, the zenith in the middle, the horizon as the rim."""
    panel = sheet.panel(x, y, side, side, projection="polar")
    panel.set(theta_zero_location="N", theta_direction=-1, rlim=(0, 90))
    panel.grid(linewidth=0.4, color="#cccccc")
    panel.set_rgrids([30, 60], labels=[])
    panel.spines["polar"].set(linewidth=0.6, color=EDGE)
    at = facts.sky.azimuth_rad[0], 90 - np.degrees(facts.sky.elevation_rad[0])
    panel.plot(*at, "o", markersize=3.5, color="#2b5c8a")


def draw_world(sheet: Sheet, facts: Facts) -> None:
    """Draw the second column: what the sources become."""
    x, width, grid = 2.22, 1.6, facts.maps.grid
    time = facts.sky.times[0]
    note = f"{time[:10]}\n{time[11:16]} UTC:\n{len(facts.sky.names)} above\n{facts.mask_deg:g} degrees"
    sheet.box(x, 0.98, width, 1.1, "Sky", note)
    draw_sky(sheet, x + width - 0.86, 1.2, 0.8, facts)
    sheet.box(x, 2.4, width, 0.86, "City", "outlines, heights, blocks\nand districts in one map\nprojection, in metres")
    sheet.box(x, 3.6, width, 2.08, "Surface", f"rasters of {grid.resolution_m:g} m cells:")
    side = 0.72
    density = facts.maps.m("density", time_of_day=TIME_OF_DAY)
    thumbs = {
        "roof heights": roof_layers(facts.maps),
        f"people\nper km², {TIME_OF_DAY}": density_layers(
            density, density_colours(float(np.nanmax(facts.maps.ds["density"].values)))
        ),
    }
    for number, (name, layers) in enumerate(thumbs.items()):
        y = 4.05 + number * (side + 0.08)
        sheet.map(x + 0.08, y, side, grid, layers)
        sheet.text(x + side + 0.15, y + 0.05, name, size=SMALL_PT - 1, color=FAINT_INK, linespacing=1.3)


def draw_metrics(sheet: Sheet, facts: Facts) -> list[float]:
    """Draw the third column, the five metrics, and return the heights of their middles."""
    x, width, height, maps = 4.1, 1.5, 0.86, facts.maps
    colours = metric_colours(maps, "population")
    people = MapLayer(maps.m("population", time_of_day=TIME_OF_DAY), colours)
    has_data = maps.ds["has_data"].values

    def free(name: str, **at) -> list[MapLayer]:
        return [obstacle_layer(maps, ALTITUDE_M), free_layer(maps, name, ALTITUDE_M, **at)]

    metrics = {
        "GPS": ("sky that is\nnot hidden", free("gps", time=maps.times[0])),
        "Lidar": ("walls in\nreach", free("lidar")),
        "Obstacles": (
            f"roofs at\n{ALTITUDE_M:g} m or\nhigher",
            [flat_layer(has_data, FREE_COLOUR), obstacle_layer(maps, ALTITUDE_M, BUILT_COLOUR)],
        ),
        "Population": ("people\nbelow", [people]),
        "Clearance": ("distance to\nobstacles", free("risk")),
    }
    middles = []
    for number, (title, (note, layers)) in enumerate(metrics.items()):
        y = 0.98 + number * 0.96
        sheet.box(x, y, width, height, title, note)
        sheet.map(x + width - 0.74, y + 0.13, 0.69, maps.grid, layers)
        middles.append(y + height / 2)
    return middles


def draw_planning(sheet: Sheet, facts: Facts) -> None:
    """Draw what stands right of the metrics: H, weights, the cost map, the planner, the path and studies."""
    maps, planned, grid = facts.maps, facts.planned, facts.maps.grid
    altitudes = ", ".join(f"{z:g}" for z in maps.altitudes_m)
    sheet.box(5.9, 0.98, 1.35, 2.28, "Metric maps H", f"each from 0 to 1; at\n{altitudes} m,\nday and night, epochs")
    for number, z in enumerate(reversed(maps.altitudes_m)):
        layers = [obstacle_layer(maps, z), free_layer(maps, "gps", z, time=maps.times[0])]
        sheet.map(6.0 + 0.13 * number, 1.75 + 0.17 * number, 0.76, grid, layers)
    weights = planned.settings["weights"]
    listed = "\n".join(
        f"{NAMES[name]}: {value:g}{' per metre' if name == 'distance' else ''}" for name, value in weights.items()
    )
    note = f"what each map's\nworst is worth, per\n{planned.settings['reference_length_m']:g} m of path:\n\n{listed}"
    sheet.box(5.9, 3.6, 1.35, 2.08, "Weights W", note)
    sheet.box(7.55, 0.98, 1.55, 2.28, "Cost map", "sum of weighted costs;\nblack: best, white: worst,\ntan: obstacle")
    sheet.map(7.63, 1.74, 1.39, grid, cost_layers(maps, ALTITUDE_M, maps.times[0], TIME_OF_DAY))
    names = "straight line, A*, Theta*,\nBIT*; no path enters\nan obstacle"
    sheet.box(9.4, 0.98, 1.48, 0.86, "Planner", names)
    length = f"{planned.length_m / 1000:.2f} km, cost {planned.cost:,.0f};\nits parts:"
    parts = "\n".join(f"{NAMES[name]} {cost:,.0f}" for name, cost in planned.cost_by_layer.items())
    sheet.box(9.4, 2.16, 1.48, 3.52, "Path", f"{length}\n{parts}", note_y=1.72)
    panel = sheet.map(9.47, 2.4, 1.34, grid, cost_layers(maps, ALTITUDE_M, maps.times[0], TIME_OF_DAY))
    panel.plot(*planned.xy_m.T, color="white", linewidth=2.8)
    panel.plot(*planned.xy_m.T, color=PATH, linewidth=1.5)
    draw_ends(panel, [planned])
    note = (
        "Monte Carlo: many\nrandom flights, planner\nby planner\n\nSensitivity: which setting\ndecides the cost\n\n"
        "Tuning: weights learned\nfrom given routes"
    )
    sheet.box(7.55, 3.6, 1.55, 2.08, "Studies", note)


def draw_gradients(sheet: Sheet, facts: Facts) -> None:
    """Draw the last row: the gradients of the path's cost, and where they lead back to."""
    x, y, width, height = 5.9, 6.0, 4.98, 1.42
    table, polygons, grid = facts.by_building, facts.city.buildings.polygons, facts.maps.grid
    by_weight = ", ".join(f"{NAMES[name]} {slope:,.0f}" for name, slope in facts.slopes.items() if name != "distance")
    most = table.iloc[0]
    note = (
        f"by the weights: {by_weight};\nby the cost of a metre: {facts.slopes['distance']:,.0f}\n\n"
        f"by the heights: {len(table):,} buildings matter; the one that\nmatters most, in the middle at the right, "
        f"adds {most.per_metre:.1f} per\nmetre (red adds, blue lowers, grey has no effect;\n{2 * NEAR_M:g} m across)"
    )
    sheet.box(x, y, width, height, "Gradients of the path's cost", note)
    panel = sheet.map(x + width - 1.36, y + 0.06, 1.3, grid)
    middle = shapely.get_coordinates(shapely.point_on_surface(polygons[most.building]))[0]
    panel.set(xlim=middle[0] + np.array([-NEAR_M, NEAR_M]), ylim=middle[1] + np.array([-NEAR_M, NEAR_M]))
    outlines(panel, np.delete(polygons, table.building), facecolor="#dcdcdc", linewidth=0)
    top = float(table.per_metre.abs().max())
    drawn = table.sort_values("per_metre", key=abs)
    shapes, owner = shapely.get_parts(polygons[drawn.building], return_index=True)
    look = {"cmap": "RdBu_r", "norm": SymLogNorm(top / 1000, vmin=-top, vmax=top)}
    outlines(panel, shapes, array=drawn.per_metre.to_numpy()[owner], linewidth=0, **look)
    panel.plot(*facts.planned.xy_m.T, color=INK, linewidth=1.4)
    sheet.arrow((10.14, 5.68), (10.14, y), back=True)
    sheet.arrow((6.57, y), (6.57, 5.68), back=True)
    sheet.arrow((x, 6.7), (3.02, 6.7), (3.02, 5.68), back=True)
    look = {"color": BACK, "size": SMALL_PT}
    sheet.text(3.15, 6.74, "slope of the cost by every building's height", **look)
    sheet.text(6.65, 5.75, "slope by every weight", **look)
    sheet.arrow((0.15, 6.25), (0.6, 6.25))
    sheet.text(0.7, 6.25, "values", size=SMALL_PT, va="center")
    sheet.arrow((0.15, 6.55), (0.6, 6.55), back=True)
    sheet.text(0.7, 6.55, "gradients", size=SMALL_PT, va="center", color=BACK)


def draw_arrows(sheet: Sheet, middles: Sequence[float]) -> None:
    """Join the boxes in the order of the data."""
    sheet.arrow((1.96, 1.53), (2.22, 1.53))  # orbits, sky
    for y in (2.73, 3.93, 5.13):  # buildings, census, districts
        sheet.arrow((1.96, y), (2.09, y), (2.09, 2.83), (2.22, 2.83))
    sheet.arrow((3.02, 3.26), (3.02, 3.6))  # city, surface
    sheet.arrow((3.82, 1.16), (4.1, 1.16))  # sky, gps
    for middle in middles:
        sheet.arrow((3.82, 4.64), (3.96, 4.64), (3.96, middle), (4.1, middle))
        sheet.arrow((5.6, middle), (5.75, middle), (5.75, 2.12), (5.9, 2.12))
    sheet.arrow((7.25, 2.12), (7.55, 2.12))  # maps, cost map
    sheet.arrow((7.25, 4.3), (7.4, 4.3), (7.4, 2.9), (7.55, 2.9))  # weights, cost map
    sheet.arrow((9.1, 1.41), (9.4, 1.41))  # cost map, planner
    sheet.arrow((10.14, 1.84), (10.14, 2.16))  # planner, path
    sheet.arrow((9.4, 4.64), (9.1, 4.64))  # path, studies
    sheet.arrow((7.55, 5.3), (7.25, 5.3))  # tuning, weights


def caption(facts: Facts) -> Caption:
    most, grid = facts.by_building.iloc[0], facts.maps.grid
    return Caption(
        PAPER,
        f"The same chain, each small map a real one of {facts.town.title} at {ALTITUDE_M:g} m ({grid.num_rows} x "
        f"{grid.num_cols} cells of {grid.resolution_m:g} m): the path found costs {facts.planned.cost:,.0f} over "
        f"{facts.planned.length_m / 1000:.2f} km. Ours adds the way back: {len(facts.by_building):,} buildings change "
        f"its cost, one of {most.height_m:.1f} m by {most.per_metre:.1f} per metre of its height.",
        "Beside the exact maps ours has soft ones with derivatives, so that weights can be learned from routes and one "
        f"sees what makes a route costly. Slopes by height are those of maps smoothed over {SOFTNESS_M:g} m: the exact "
        "cost moves in jumps.",
    )


def main() -> None:
    facts, sheet = Facts.of(TOWNS[-1]), Sheet()
    sheet.text(0.12, 0.12, "From open data to a path, and back", size=12, weight="bold")
    grid, is_real = facts.maps.grid, facts.town.scenario["buildings"]["source"] != "synthetic"
    size = f"{(grid.x_max_m - grid.x_min_m) / 1000:.1f} x {(grid.y_max_m - grid.y_min_m) / 1000:.1f} km, north up"
    note = "  ·  ".join([f"{facts.town.title}: {size}, {ALTITUDE_M:g} m above ground", *([CREDIT] if is_real else [])])
    sheet.text(0.12, 0.38, note, size=TEXT_PT, color=FAINT_INK)
    heads = {
        0.12: "Sources",
        2.22: "The world",
        4.1: "Five metrics",
        5.9: "Maps, weights",
        7.55: "Cost, studies",
        9.4: "Planning",
    }
    for x, head in heads.items():
        sheet.text(x, 0.72, head, size=TEXT_PT, weight="bold", color=FAINT_INK)
    draw_sources(sheet, facts)
    draw_world(sheet, facts)
    middles = draw_metrics(sheet, facts)
    draw_planning(sheet, facts)
    draw_gradients(sheet, facts)
    draw_arrows(sheet, middles)
    save(sheet.figure, "fig_01_data_flow", caption(facts))
