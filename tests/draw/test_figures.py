"""Pictures show the right colour in the right place, to scale, with every label whole."""

import re
import subprocess
import sys
import textwrap
from dataclasses import replace
from functools import partial

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.legend import Legend
from matplotlib.offsetbox import AnchoredOffsetbox
from matplotlib.text import Text
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from PIL import Image

import jaxurban as ju
from jaxurban import plot as plotting
from jaxurban.draw.frame import MAP, OBSTACLE_COLOUR, MapPanel, draw_maps, flat_layer, surroundings
from jaxurban.draw.metrics import obstacle_patches, precise_percent
from jaxurban.draw.paths import PALE, closed_at, colours_of_cost, cost_layers, maps_figures
from jaxurban.draw.routes import (
    BATCH_PT,
    EDGED,
    LINE_PT,
    ON_A_GRID,
    PLANNER_COLOURS,
    WIDEST_PT,
    CostChoice,
    outcome_line,
)
from jaxurban.draw.style import bar_ticks, chart, wrapped
from jaxurban.draw.write import DPI, write_picture
from jaxurban.errors import InputError
from jaxurban.knowledge import Guess, GuessKind
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.registry import METRICS
from jaxurban.metrics.variables import FREE_COLOUR, GROUP_COLOURS
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.base import EVERY_PATH, Status
from jaxurban.world.kinds import EFFECTS, GROUPS
from tests.guess_records import NOMINAL, attribute, heights
from tests.made_maps import made_maps, maps_of_kinds
from tests.pictures import assert_legible, drawn_texts
from tests.volumes import made_path

pytestmark = pytest.mark.usefixtures("without_layout")
ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
RULES = {"cost_model": "line", "objective": "weighted", "obstacles": "touched", "resolution_m": 5.0}
RULES |= {"weights": {"distance": 0.1, "gps": 1.0}, "limits": {"vertical_clearance_m": 3.0}}


def make_maps(rows=34, cols=40, resolution_m=100.0, has_all_data=True) -> MetricMaps:
    """Made maps at a round place, with GDOP beyond its scale where GPS is bad, hills, and a quarter without people."""
    made = made_maps(rows, cols, ALTITUDES_M, resolution_m).ds
    names = ("obstacle", "gps", "lidar", "risk", "num_visible", "population", "density", "roof")
    ds = made[[*names]].drop_vars(["x", "y", "spatial_ref"])
    ds["roof_touched"] = ds["roof"]
    ds["terrain"] = ds["roof"] * 0 + np.arange(rows)[:, None]
    ds["num_visible"][:] = 7
    ds["gps"][:] = np.random.default_rng(0).random(ds["gps"].shape) * (ds["obstacle"].values == 0)
    for name in ("population", "density"):
        ds[name][:, :, : cols // 4] = 0
    ds["gdop"] = (20 - 19 * ds["gps"]).where(ds["gps"] > 0.1, np.inf)
    has_data = np.ones((rows, cols), bool)
    has_data[-3:, -5:] = has_all_data
    ds["has_data"] = ("y", "x"), has_data
    ds = ds.assign(
        {
            name: values.where(ds["has_data"])
            for name, values in ds.items()
            if values.dtype.kind == "f"
        }
    )
    ds["gps"].attrs["one_means"] = "GDOP of 1, the best possible"
    first = {
        f"first_{name}": round(side_m / resolution_m)
        for name, side_m in (("row", 4_507_000), ("col", 583_000))
    }
    return MetricMaps(ds.assign_attrs(first))


def make_path(
    maps, planner, status=Status.OPTIMAL, altitude_m=20.0, time_of_day="day"
) -> PlannedPath:
    grid = maps.grid
    ends = (
        np.array([[0.2, 0.1], [0.5, 0.6], [0.8, 0.9]])
        * (grid.num_cols, grid.num_rows)
        * grid.resolution_m
    )
    xy_m = ends + np.array([grid.x_min_m, grid.y_min_m])
    settings = RULES | {"time": "2020-04-27T16:00:00Z", "time_of_day": time_of_day}
    return made_path(grid, xy_m, altitude_m, status, planner, settings=settings)


def make_paths(maps):
    planners = {"ptp": Status.BLOCKED, "astar-dist": Status.FEASIBLE, "astar-plus": Status.FEASIBLE}
    names = ("day", "day", "night", "night") if maps.times_of_day else (None,) * 4
    above = zip(ALTITUDES_M, names, strict=True)
    return [make_path(maps, *planner, z, name) for z, name in above for planner in planners.items()]


@pytest.fixture(scope="module")
def maps() -> MetricMaps:
    return make_maps()


def panels_of(figure):
    return [axes for axes in figure.axes if axes.images]


def drawn(axes) -> np.ndarray:
    """The panel's image as hex colours, row 0 in the south."""
    image = axes.images[0]
    assert image.origin == "lower"
    rgb = np.asarray(image.get_array()).astype(int) @ (1 << 16, 1 << 8, 1)
    names = {value: f"#{value:06x}" for value in np.unique(rgb).tolist()}
    return np.vectorize(names.get)(rgb)


def texts_of(figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def titles_of(figure) -> list[str]:
    return [panel.get_title(loc="left") for panel in panels_of(figure)]


def lines_of(panel) -> list[np.ndarray]:
    """Return the lines of routes, the widest first."""
    return [line.get_segments()[0] for line in routes_of(panel)]


def routes_of(panel) -> list:
    """Return what draws the routes of a panel, the widest first."""
    return [line for line in panel.collections if line.get_gid() == EDGED]


def colours_of(name: str, values) -> list[str]:
    return [
        to_hex(colour / 255) for colour in matplotlib.colormaps[name](values, bytes=True)[:, :3]
    ]


def test_each_cell_has_its_metric_colour_at_its_place(maps):
    figure = plotting.plot_metric(maps, "gps")
    panels = panels_of(figure)
    for panel, z in zip(panels, ALTITUDES_M, strict=True):
        colours, gps = drawn(panel), maps.m("gps", z)
        is_free = maps.is_free(z, "centre")
        assert colours[is_free].tolist() == colours_of("viridis", gps[is_free])
        assert set(colours[~is_free].tolist()) <= {OBSTACLE_COLOUR}
        grid = maps.grid
        assert panel.images[0].get_extent() == [
            grid.x_min_m,
            grid.x_max_m,
            grid.y_min_m,
            grid.y_max_m,
        ]


@pytest.mark.slow
def test_pictures_say_what_they_show():
    maps = make_maps()
    maps.ds.attrs["risk_threshold_m"] = 50.0
    maps.ds["risk"].attrs["one_means"] = METRICS["risk"].one_means
    mean = maps.m("gps", 60.0)[maps.is_free(60.0, "centre")].mean()
    good = (maps.m("gdop", 20.0)[maps.is_free(20.0, "centre")] <= 6).mean()
    shares = {z: precise_percent((maps.m("obstacle", z) == 1).mean()) for z in ALTITUDES_M}
    people = {
        name: maps.m("density", time_of_day=name).sum(dtype=float) * 0.01
        for name in ("day", "night")
    }
    ratings = ("Ideal", "Excellent", "Good", "Moderate", "Fair", "Poor")
    frame = ("2020-04-27 16:00 UTC", "100 m cells", "EPSG:32618", "1: GDOP of 1")
    near, none = "(1: no obstacle within 50 m)", "no people, or\nno data of them"
    for figure, said in (
        (
            plotting.plot_metric(maps, "gps", altitude_m=[60.0]),
            (f"60 m  ·  mean {mean:.2f}", *frame),
        ),
        (
            plotting.plot_gps_rating(maps),
            (f"20 m  ·  {precise_percent(good)} good or better", *ratings),
        ),
        (
            plotting.plot_obstacles(maps),
            [f"{z:g} m  ·  {share} blocked" for z, share in shares.items()],
        ),
        (
            plotting.plot_population(maps),
            [*(f"{name}  ·  {num:,.0f} people" for name, num in people.items()), none],
        ),
        (
            plotting.plot_overview(maps, (), altitude_m=60.0),
            ("Metric maps, 60 m above ground", f"{near}\n"),
        ),
        (plotting.plot_overview(maps, ()), ("(0: best free cell, 1: worst,\n",)),
        (plotting.plot_metric(maps, "risk"), (near,)),
        (plotting.plot_metric(maps, "num_visible"), ("median 7\n",)),
    ):
        text = texts_of(figure)
        assert [words for words in said if words not in text] == []


def legend_of(figure) -> dict[str, str]:
    """Return the colours of a legend's patches by their names."""
    (legend,) = figure.findobj(Legend)
    patches = legend.get_patches()
    return {patch.get_label(): to_hex(patch.get_facecolor()) for patch in patches}


def test_obstacles_have_the_colours_of_their_groups_and_the_legend_names_those_drawn():
    maps, _ = maps_of_kinds()
    kinds = set(np.array(["", *EFFECTS])[np.unique(maps.m("roof_kind"))[1:]])
    assert kinds == {"building", "chimney", "tree", "wood", "wire"}
    legend = legend_of(plotting.plot_metric(maps, "roof_kind"))
    assert [*legend] == ["nothing", "building", "chimney", "tree, wood", "wire"]
    groups = ["buildings", "trees", "other structures"]  # the wire is over no cell's centre
    for altitude_m, names in ((8.0, groups), (20.0, ["buildings", "other structures"])):
        figure = plotting.plot_obstacles(maps, altitude_m=altitude_m)
        assert legend_of(figure) == {"free": FREE_COLOUR} | {
            name: GROUP_COLOURS[name] for name in names
        }
        (panel,) = panels_of(figure)
        colours = np.array([FREE_COLOUR, *(GROUP_COLOURS[GROUPS[kind]] for kind in EFFECTS)])
        number = np.where(maps.m("obstacle", altitude_m) == 1, maps.m("roof_kind"), 0)
        np.testing.assert_array_equal(drawn(panel), colours[number])
    bare = MetricMaps(maps.ds.drop_vars("roof_kind"))
    assert [*legend_of(plotting.plot_obstacles(bare))] == ["free", "obstacle"]


def test_classes_people_and_costs_have_the_colours_of_their_values(maps):
    rating, people = plotting.plot_gps_rating(maps), plotting.plot_population(maps)
    dop = plotting.plot_metric(maps, "gdop", altitude_m=[20.0])
    cost, choice = (
        plotting.plot_paths(maps, (), altitude_m=[20.0]),
        plotting.plot_sensor_choice(maps),
    )
    gdop, is_free = maps.m("gdop", 20.0), maps.is_free(20.0, "centre")
    steps = matplotlib.colormaps["viridis"](np.linspace(1, 0, 6))
    at_night = maps.m("density", time_of_day="night")[5, 20]
    most = maps.ds["density"].values.max()
    unit = 10.0 ** np.floor(np.log10(most))
    share = (
        1 + np.log10(at_night / (unit * np.ceil(most / unit))) / 3
    )  # of one scale for day and night, up to a round number
    norm = np.where(is_free, maps.normalised(20.0, time_of_day="day"), np.nan)
    expected = [
        (dop, 0, is_free & np.isinf(gdop), to_hex(matplotlib.colormaps["viridis_r"](1.0))),
        (rating, 0, is_free & (gdop > 4) & (gdop <= 6), to_hex(steps[2])),
        (rating, 0, is_free & (gdop > 8) & (gdop <= 20), to_hex(steps[4])),
        (people, 0, np.s_[:, :10], "#ffffff"),
        (people, 1, np.s_[5:6, 20:21], *colours_of("magma_r", [share])),
        (cost, 0, norm == np.nanmin(norm), to_hex(PALE(0.0))),
        (cost, 0, norm == np.nanmax(norm), to_hex(PALE.get_over())),
    ]
    for k, z in enumerate(ALTITUDES_M):
        is_gps, is_free = maps.m("gps", z) > maps.m("lidar", z), maps.is_free(z, "centre")
        assert f"{z:g} m  ·  GPS in {precise_percent(is_gps[is_free].mean())}" in texts_of(choice)
        for name, cells in (("gps", is_free & is_gps), ("lidar", is_free & ~is_gps)):
            expected += [(choice, k, cells, METRICS[name].colour)] if cells.any() else []
    for figure, k, cells, colour in expected:
        assert set(drawn(panels_of(figure)[k])[cells].ravel()) == {colour}


def test_paths_have_the_papers_colours_and_coinciding_ones_both_show(maps):
    figure = plotting.plot_paths(maps, make_paths(maps))
    assert titles_of(figure) == [
        "(a) 20 m · day",
        "(b) 60 m · day",
        "(c) 122 m · night",
        "(d) 600 m · night",
    ]
    both = [make_path(maps, "ptp", time_of_day=name) for name in ("night", "day")]
    assert titles_of(plotting.plot_paths(maps, both)) == ["(a) 20 m · night", "(b) 20 m · day"]
    at_night = plotting.plot_paths(maps, (), time_of_day="night")
    assert titles_of(at_night)[0] == "(a) 20 m"
    assert at_night.get_suptitle().endswith(", night")
    for panel in panels_of(figure):
        colours = [to_hex(line.get_color()[0]) for line in routes_of(panel)]
        assert colours == [PLANNER_COLOURS["astar-dist"], PLANNER_COLOURS["astar-plus"]]
        outcomes = panel.get_xlabel().splitlines()[-3:]
        assert outcomes == [
            "ptp: blocked",
            "astar-dist: 1,235, 5.68 km",
            "astar-plus: 1,235, 5.68 km",
        ]
    entries = [
        zip(legend.texts, legend.legend_handles, strict=True) for legend in figure.findobj(Legend)
    ]
    named = {text.get_text(): line for entry in entries for text, line in entry}
    assert named["astar-plus"].get_color() == PLANNER_COLOURS["astar-plus"]


def test_paths_that_are_cheapest_by_proof_are_one_line(maps):
    proven = [make_path(maps, name) for name in ("astar-dist", "astar-plus")]
    (panel,) = panels_of(plotting.plot_paths(maps, proven))
    assert len(lines_of(panel)) == 1
    assert panel.get_xlabel().splitlines()[-1] == "astar: 1,235, 5.68 km"
    (panel,) = panels_of(plotting.plot_paths(maps, proven, names=["one", "other"]))
    assert len(lines_of(panel)) == 2
    dearer = replace(proven[1], cost=2000.0)
    (panel,) = panels_of(plotting.plot_paths(maps, [proven[0], dearer]))
    assert len(lines_of(panel)) == 2


def test_a_lone_costly_cell_leaves_the_scale_of_the_cost_to_the_others():
    cost = np.linspace(0, 0.1, 1000).reshape(20, 50)
    cost[0, 0], cost[1, 1] = 1.0, np.nan
    colours = colours_of_cost(cost)
    low, high = np.nanquantile(cost, [0.02, 0.98])
    assert (colours.norm.vmin, colours.norm.vmax) == pytest.approx((low, high))
    assert bar_ticks(colours)[-1] == pytest.approx(high)
    assert colours.extend == "both"
    assert "at most 2 % beyond an end" in colours.label
    flat = colours_of_cost(np.zeros((3, 3)))
    assert (flat.norm.vmin, flat.norm.vmax) == (0, 1)


def test_every_colour_of_the_cost_is_pale_and_costlier_cells_are_darker():
    luminance = PALE(np.linspace(0, 1, 50))[:, :3] @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(luminance) < 0).all()
    assert luminance.min() > 0.5


def test_of_maps_much_larger_than_the_routes_their_surroundings_are_drawn(maps):
    whole = make_path(maps, "astar")
    near = replace(whole, xy_m=whole.xy_m[1] + 100.0 * np.array([[0, 0], [1, 2], [3, 1]]))
    large = make_maps(200, 200)
    panels = {}
    for name, place, path in (("whole", maps, whole), ("part", large, near)):
        (panels[name],) = panels_of(plotting.plot_paths(place, path))
    grid = maps.grid
    assert panels["whole"].get_xlim() == (grid.x_min_m, grid.x_max_m)
    west, east = panels["part"].get_xlim()
    south, north = panels["part"].get_ylim()
    assert east - west == north - south == 60 * 100.0
    assert west < near.xy_m[:, 0].min() < near.xy_m[:, 0].max() < east
    cost = large.normalised(20.0, time_of_day="day")
    window = surroundings(large.grid, near.xy_m).window_in(large.grid)
    assert drawn(panels["part"]).shape == cost[window].shape


def test_paths_of_a_dictionary_are_called_by_its_keys(maps):
    path = make_path(maps, "astar")
    text = texts_of(plotting.plot_paths(maps, {"by day": path, "none": None}))
    assert "by day: " in text
    assert "astar" not in text
    named = plotting.plot_paths(maps, {"by day": path}, names=["mine"])
    assert "mine: " in texts_of(named)


def test_the_cheapest_path_of_a_grid_is_said_to_be_one_of_its_directions(maps):
    path = make_path(maps, "astar")
    graphs = {"8-neighbour grid": True, EVERY_PATH: False, "": False}
    note = ON_A_GRID.format("astar")
    for graph, is_said in graphs.items():
        best = replace(path, status=Status.OPTIMAL, search=replace(path.search, graph=graph))
        text = texts_of(plotting.plot_paths(maps, best))
        assert (note in text.replace("\n", " ")) == is_said
        assert ("km (best on the grid)" in text) == is_said
    assert note not in texts_of(plotting.plot_paths(maps, path)).replace("\n", " ")


def test_a_picture_fills_a_cell_of_another_figure_under_its_title_and_in_its_colours(maps):
    whole, (left, right) = plt.subplots(1, 2, figsize=(10, 5))
    part = plotting.plot_metric(maps, "gps", altitude_m=20.0, ax=left, cmap="cividis", title="Mine")
    path = plotting.plot_paths(maps, make_path(maps, "astar"), ax=right, title="")
    assert whole.subfigs == [part, path]
    assert not whole.axes or left not in whole.axes
    assert (part.get_suptitle(), path.get_suptitle()) == ("Mine", "")
    gps = maps.m("gps", 20.0)
    is_free = maps.is_free(20.0, "centre")
    colours = drawn(panels_of(part)[0])
    assert colours[is_free].tolist() == colours_of("cividis", gps[is_free])
    whole.draw_without_rendering()
    assert part.bbox.x1 <= path.bbox.x0 + 1
    plt.close(whole)


def test_below_a_route_that_climbs_stands_between_which_altitudes(maps):
    path = make_path(maps, "astar")
    climbing = replace(path, z_m=np.array([20.0, 41.4, 60.0]))
    assert "km, 20 to 60 m up" in outcome_line(climbing, "astar")
    assert " m up" not in outcome_line(path, "astar")


def test_a_method_takes_several_altitudes_and_one_cell_of_its_own_width(maps):
    assert len(titles_of(maps.plot("gps", [20.0, 60.0]))) == 2
    with pytest.raises(ju.InputError, match="altitude_m must be"):
        maps.plot(None, [20.0, 60.0])
    _, cells = plt.subplots(1, 2)
    for wrong in ({"ax": cells}, {"ax": cells[0], "width": 120.0}):
        with pytest.raises(ju.InputError, match=r"one cell of a grid|leave width out"):
            maps.plot("gps", 20.0, **wrong)
    plt.close("all")


def test_routes_are_drawn_on_the_map_of_their_altitude(maps):
    low, high = ALTITUDES_M[:2]
    path = make_path(maps, "astar", altitude_m=high)
    for name in "gps", "obstacle":
        figure = plotting.plot_metric(maps, name, altitude_m=[low, high], paths={"mine": path})
        assert [len(routes_of(panel)) for panel in panels_of(figure)] == [0, 1]
        assert "mine" in texts_of(figure)
        assert titles_of(maps.plot(name, paths=path))[0].startswith(f"{high:g} m")
    assert [len(routes_of(panel)) for panel in panels_of(maps.plot(paths=path))][-1] == 1
    with pytest.raises(ju.InputError, match=f"they are at {high:g} m"):
        maps.plot("gps", low, paths=path)


def test_in_a_small_cell_a_map_still_says_that_it_rests_on_guesses():
    maps = make_maps()
    maps.ds.attrs |= attribute(heights(0.03))
    for is_guessed, shown in ((True, maps), (False, make_maps())):
        _, (left, _) = plt.subplots(1, 2, figsize=(6.0, 3.0))
        part = plotting.plot_metric(shown, "gps", altitude_m=20.0, ax=left)
        assert ("Rests on guesses" in part.get_supxlabel()) == is_guessed
    plt.close("all")


@pytest.mark.parametrize(("side_in", "is_alone"), [(2.5, True), (5.0, True), (8.0, False)])
def test_in_a_small_cell_a_map_stands_alone_and_fills_it(maps, side_in, is_alone):
    whole, axes = plt.subplots(1, 2, figsize=(2 * side_in, side_in))
    for cell in axes:
        plotting.plot_paths(maps, make_path(maps, "astar"), ax=cell)
    whole.draw_without_rendering()
    for part in whole.subfigs:
        assert (part.get_supxlabel() == "") == is_alone
        assert ("goal" not in texts_of(part)) == is_alone
        (panel,) = panels_of(part)
        assert panel.get_window_extent().width > 0.5 * part.bbox.width
    plt.close(whole)


def test_a_map_without_a_value_is_a_sentence_and_no_picture(maps):
    gps = maps.ds["gps"]
    empty = replace(maps, ds=maps.ds.assign(gps=gps * np.nan))
    with pytest.raises(ju.InputError, match="gps has no value in any free cell of these maps"):
        empty.plot("gps")
    half = replace(maps, ds=maps.ds.assign(gps=gps.where(gps["altitude"] > 20.0)))
    text = texts_of(plotting.plot_metric(half, "gps"))
    assert "20 m  ·  no value" in text
    assert "nan" not in text


@pytest.mark.parametrize("size_in", [2.5, 10.0])
def test_in_small_axes_maps_keep_their_room(maps, size_in):
    whole, axes = plt.subplots(2, 2, figsize=(2 * size_in, 2 * size_in))
    pictures = (plotting.plot_overview, plotting.plot_obstacles)
    parts = [draw(maps, ax=ax) for draw, ax in zip(pictures, axes[0], strict=True)]
    parts.append(plotting.plot_metric(maps, "gps", altitude_m=20.0, ax=axes[1, 0]))
    parts.append(plotting.plot_paths(maps, make_path(maps, "astar"), ax=axes[1, 1]))
    whole.draw_without_rendering()  # which warns where a layout collapses, and warnings fail
    assert any(part.get_supxlabel() for part in parts) == (size_in > 3)
    alone = panels_of(parts[2])[0].get_window_extent().width / whole.dpi
    assert alone > 0.4 * size_in
    plt.close(whole)


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"ax": plt.Figure().add_axes((0, 0, 1, 1))}, "ax must be one cell of a grid"),
        ({"ax": [1, 2]}, "ax must be one cell of a grid"),
        ({"cmap": "viridus"}, r"cmap must be .* \(did you mean 'viridis'"),
        ({"title": 3}, "title must be a text or None, got 3"),
        ({"widht": 100}, "did you mean 'width'"),
    ],
)
def test_a_form_that_is_none_is_refused(maps, form, said):
    with pytest.raises(InputError, match=said):
        plotting.plot_metric(maps, "gps", altitude_m=20.0, **form)


def test_a_map_of_classes_takes_no_other_colours(maps):
    with pytest.raises(InputError, match="each of its own colour: leave cmap out"):
        plotting.plot_obstacles(maps, cmap="viridis")


@pytest.mark.usefixtures("laid_out")
def test_routes_that_coincide_are_all_seen_and_each_is_drawn_where_it_is(maps):
    paths = [make_path(maps, name) for name in PLANNER_COLOURS]
    figure = plotting.plot_paths(maps, paths, names=[*PLANNER_COLOURS])
    (panel,) = panels_of(figure)
    for line_m, path in zip(lines_of(panel), paths, strict=True):
        assert np.array_equal(line_m, path.xy_m)
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    west, south, east, north = panel.bbox.extents.round().astype(int)
    shown = np.asarray(canvas.buffer_rgba())[::-1][south:north, west:east, :3]
    for colour in PLANNER_COLOURS.values():  # one above another would hide four
        off = np.abs(shown - 255 * np.array(to_rgb(colour))).max(axis=-1)
        assert (off < 25).sum() > 500


@pytest.mark.slow
@pytest.mark.usefixtures("laid_out")
def test_cells_that_are_closed_and_no_obstacle_are_hatched_and_the_legend_says_so():
    maps = made_maps(30, 40, (20.0,))
    grid = maps.grid
    ends = grid.lonlat_of_cell(4, 6), grid.lonlat_of_cell(28, 38)
    limits = ju.Constraints(clearance_m=5.0)
    route = ju.plan(maps, *ends, altitude_m=20.0, snap=True, constraints=limits)
    assert route.status.has_path
    expected = ~ju.cost_map(maps, 20.0, constraints=limits).is_free & (
        maps.m("obstacle", 20.0) == 0
    )
    assert 0.05 < expected.mean() < 0.9
    assert np.array_equal(
        closed_at(maps, CostChoice(20.0, maps.times[0], "day"), [route]), expected
    )

    # The colours of a cell's middle, drawn without and with its hatch.
    for plot in (plotting.plot_paths, plotting.plot_overview):
        figure = plot(maps, [route])
        assert "closed to routes" in texts_of(figure)
        panel = panels_of(figure)[-1]
        shown = []
        for is_hatched in (False, True):
            panel.collections[0].set_visible(is_hatched)
            for drawn in (*panel.lines, *panel.collections[1:]):
                drawn.set_visible(False)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
            shown.append(np.asarray(canvas.buffer_rgba())[..., :3].astype(int))
        x, y = panel.transData.transform(
            np.stack(grid.xy_of_cell(*np.indices(grid.shape).reshape(2, -1)), axis=-1)
        ).T
        changed = np.abs(shown[0] - shown[1]).sum(axis=-1) > 0
        is_hatched = changed[changed.shape[0] - 1 - y.astype(int), x.astype(int)]
        assert (is_hatched.reshape(grid.shape) == expected).mean() > 0.97  # corners are cut


def test_routes_under_other_rules_hatch_what_is_closed_to_all_of_them(maps):
    paths = [make_path(maps, name) for name in ("a", "b")]
    wide = replace(paths[1], settings=paths[1].settings | {"limits": {"clearance_m": 150.0}})
    place = CostChoice(20.0, maps.times[0], "day")
    narrow, both, alone = (
        closed_at(maps, place, chosen) for chosen in (paths, [paths[0], wide], [wide])
    )
    assert (narrow <= alone).all()
    assert (narrow < alone).any()
    assert np.array_equal(both, narrow)


@pytest.mark.slow
def test_paths_and_their_rules_are_named_only_where_there_are_some(maps):
    rules = "cost model: line · weights: distance 0.1, gps 1 · obstacles: touched, vertical clearance of 3 m"
    for draw in (plotting.plot_paths, plotting.plot_overview):
        bare, text = texts_of(draw(maps, ())), texts_of(draw(maps, make_paths(maps)))
        assert not any(word in bare for word in ("paths", "goal", "cost model"))
        assert "and paths" in text
        assert {"start", "goal"} <= set(text.splitlines())
        assert rules in " ".join(text.split())
    assert "ptp" not in text  # which found none
    assert "paths" not in maps_figures(maps, ())
    assert {"cost_day", "cost_night"} <= set(maps_figures(maps, ()))
    assert {"paths"} == {
        name for name in maps_figures(maps, make_paths(maps)) if name.startswith(("paths", "cost"))
    }


@pytest.mark.parametrize("name", ["gps", "gdop", "num_visible", "population"])
def test_colour_bars_carry_both_ends_and_satellites_whole_numbers(maps, name):
    figure = (
        plotting.plot_population(maps) if name == "population" else plotting.plot_metric(maps, name)
    )
    (bar,) = [axes for axes in figure.axes if axes.get_xlabel() and axes.get_gid() != MAP]
    assert bar.get_xticks()[[0, -1]] == pytest.approx(bar.get_xlim())
    assert name != "num_visible" or ({*bar.get_xticks() % 1}, bar.get_xlim()) == (
        {0},
        (0, 7),
    )  # there are 7


def at_epochs(num, maps=None):
    maps = maps or make_maps()
    times = np.datetime64("2020-04-27T16:00:00", "ns") + 3 * np.timedelta64(1, "h") * np.arange(num)
    ds = maps.ds.isel(time=[0] * num).assign_coords(time=times)
    ds["gps"] *= np.linspace(1, 0.3, num).astype(np.float32)[:, None, None, None]
    ds["num_visible"] += np.arange(num, dtype=np.uint8)[:, None, None, None]
    return MetricMaps(ds.assign_attrs(maps.ds.attrs, constellations="galileo, gps"))


def test_every_epoch_is_drawn_and_the_share_of_good_ones():
    maps = at_epochs(3)
    assert {"gps_epochs", "gps_availability"} <= set(maps_figures(maps, ()))
    text = texts_of(plotting.plot_epochs(maps))
    assert all(f"04-27 {time}  ·  mean" in text for time in ("16:00", "19:00", "22:00"))
    assert "3 epochs, 2020-04-27 16:00 UTC to 2020-04-27 22:00 UTC, GALILEO and GPS" in text
    assert "2020-04-27 16:00 UTC, GALILEO and GPS" in texts_of(plotting.plot_metric(maps, "gps"))
    figure = plotting.plot_metric(maps, "gps_availability")
    share = np.mean([maps.m("gps", 60.0, time=time) > 0.5 for time in maps.times], axis=0)
    is_free, panel = maps.is_free(60.0, "centre"), panels_of(figure)[1]
    assert drawn(panel)[is_free].tolist() == colours_of(
        "viridis", share[is_free].astype(np.float32)
    )
    assert not {"gps_epochs", "gps_availability"} & set(maps_figures(make_maps(), ()))


@pytest.mark.slow
def test_a_long_series_is_drawn_by_its_statistics(maps):
    ds = at_epochs(3).ds
    series = {f"gps_{what}": ds["gps"].isel(time=0) for what in ("median", "p05", "availability")}
    maps = MetricMaps(
        ds.drop_vars(["gps", "gdop", "num_visible"]).assign(series).assign_attrs(satellites="a, b")
    )
    figures = maps_figures(maps, ())
    assert {"gps", "gps_p05", "gps_availability"} <= set(figures)
    text = texts_of(figures["gps"]())
    assert "GPS quality, median over time" in text
    assert "3 epochs, 2020-04-27 16:00 UTC to 2020-04-27 22:00 UTC, GALILEO and GPS" in text
    assert "epochs" not in texts_of(figures["lidar"]())


def test_notes_tell_the_place_and_only_the_guesses_that_concern_the_picture():
    maps = make_maps()
    beyond = Guess(GuessKind.BEYOND_DATA, 0.05, facts={"altitude_m": 20.0})
    maps.ds.attrs |= attribute(heights(0.03), NOMINAL, beyond)
    lon, lat = maps.grid.centre_lonlat
    place = f"around {lat:.3f}°N {-lon:.3f}°W"
    told = texts_of(plotting.plot_metric(maps, "gps", altitude_m=60.0))
    assert f"Guessed: 3 % of heights, {NOMINAL.name}, {beyond.name}" in told
    for figure in (
        plotting.plot_metric(maps, "lidar", altitude_m=60.0),
        plotting.plot_obstacles(maps, altitude_m=60.0),
        plotting.plot_heights(maps),
    ):
        assert "Guessed: 3 % of heights\n" in texts_of(figure)
        assert place in texts_of(figure)


def test_twelve_paths_have_twelve_colours_and_stay_lines(maps):
    names = [f"a planner of a long name {number}" for number in range(12)]
    paths = [make_path(maps, name) for name in names]
    (panel,) = panels_of(plotting.plot_paths(maps, paths, names=[*PLANNER_COLOURS, *names[6:]]))
    lines = routes_of(panel)
    assert len({to_hex(line.get_color()[0]) for line in lines}) == 12
    widths_pt = [line.get_linewidth()[0] for line in lines]
    assert (np.diff(widths_pt) < 0).all()
    assert (widths_pt[0], widths_pt[-1]) == (WIDEST_PT, LINE_PT)


def test_a_batch_is_narrow_lines_under_one_summary_with_all_ends(maps):
    paths = [make_path(maps, "astar") for _ in range(29)]
    paths.append(replace(paths[0], status=Status.NO_PATH))
    batch = {f"{number}": path for number, path in enumerate(paths)}
    (panel,) = panels_of(plotting.plot_paths(maps, batch))
    assert {line.get_linewidth()[0] for line in routes_of(panel)} == {BATCH_PT}
    (*_, foot) = panel.get_xlabel().splitlines()
    assert foot == "29 of 30 have a route, 5.68 to 5.68 km, median 5.68 km"


def test_a_route_between_the_maps_altitudes_is_drawn_over_the_costs_that_it_pays(maps):
    path = replace(make_path(maps, "astar"), altitude_m=40.0)
    (panel,) = panels_of(plotting.plot_paths(maps, path))
    assert panel.get_title(loc="left") == "40 m"
    costs = ju.cost_map(maps, 40.0).costs.sum(axis=0)
    free = costs[maps.is_free(40.0, "centre")]
    expected = (costs - free.min()) / (free.max() - free.min())
    layers = cost_layers(maps, 40.0, None, None)
    is_free = np.isfinite(layers[0].values)
    assert layers[0].values[is_free] == pytest.approx(expected[is_free], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows", "cols", "resolution_m"), [(34, 40, 100.0), (100, 50, 200.0), (30, 75, 20.0)]
)
@pytest.mark.usefixtures("laid_out")
def test_scale_bar_is_as_long_as_it_says(rows, cols, resolution_m):
    frame_maps = make_maps(rows, cols, resolution_m)
    figure = plotting.plot_metric(frame_maps, "risk", altitude_m=[20.0, 60.0])
    figure.draw_without_rendering()
    scales, shown = figure.findobj(AnchoredSizeBar), panels_of(figure)
    assert [scale.axes for scale in scales] == shown
    scale = scales[0]
    number, unit = scale.txt_label.get_text().split()
    length_m = float(number) * {"m": 1, "km": 1000}[unit]
    width = scale.size_bar.get_window_extent().width
    for panel in shown:
        assert "▲\nN" in [text.get_text() for text in panel.findobj(Text)]
        x_pixels = panel.transData.transform(
            [(583_000, 4_507_000), (583_000 + length_m, 4_507_000 + length_m)]
        )
        np.testing.assert_allclose(np.diff(x_pixels, axis=0)[0], width, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "width_mm"), [("column", 88.9), ("page", 182.0), (120, 120.0)])
def test_a_file_is_as_wide_as_asked_and_its_text_stays_text(maps, tmp_path, width, width_mm):
    figure, again = (
        plotting.plot_metric(maps, "risk", altitude_m=60, width=width) for _ in range(2)
    )
    # Every drawing lays a figure out anew from where it stands, so the two are drawn by turns.
    for suffix in ("pdf", "svg"):
        figure.savefig(tmp_path / f"risk.{suffix}")
        write_picture(again, tmp_path / f"again.{suffix}")
        files = [(tmp_path / f"{name}.{suffix}").read_bytes() for name in ("risk", "again")]
        assert files[0] == files[1]
    figure.savefig(tmp_path / "risk.png")
    with Image.open(tmp_path / "risk.png") as image:
        assert image.info["dpi"] == pytest.approx((300, 300), abs=0.1)
        assert image.size[0] / 300 * 25.4 == pytest.approx(width_mm, abs=0.1)
    svg = (tmp_path / "risk.svg").read_text(encoding="utf-8")
    width_pt = float(re.search(r'<svg[^>]* width="([\d.]+)pt"', svg)[1])
    assert width_pt / 72 * 25.4 == pytest.approx(width_mm, abs=0.1)
    assert "easting (km)</text>" in svg
    pdf = (tmp_path / "risk.pdf").read_bytes()
    assert b"/TrueType" in pdf or b"/CIDFontType2" in pdf
    assert b"/Type3" not in pdf


@pytest.mark.parametrize("width", ["poster", 20.0, 5000.0, float("nan")])
def test_a_width_that_is_none_is_refused(maps, width):
    with pytest.raises(
        InputError,
        match=r"'column'(, 'page' or a number| \(88.9 mm\) or 'page' \(182 mm\), or from 60 to 1000)",
    ):
        plotting.plot_obstacles(maps, width=width)


def test_every_function_takes_altitude_m(maps):
    for name, draw in (("risk", plotting.plot_metric), ((), plotting.plot_paths)):
        assert len(panels_of(draw(maps, name, altitude_m=60.0))) == 1
    for draw in (plotting.plot_obstacles, plotting.plot_gps_rating, plotting.plot_sensor_choice):
        assert len(panels_of(draw(maps, altitude_m=[20.0, 60.0]))) == 2


@pytest.mark.slow
@pytest.mark.parametrize("width", ["page", "column"])
@pytest.mark.usefixtures("laid_out")
def test_no_axes_are_empty_and_no_bar_is_wider_than_its_map(maps, width):
    bare = MetricMaps(maps.ds.drop_vars(["population", "density", "time_of_day"]))
    figure = plotting.plot_overview(bare, make_paths(bare), width=width)
    figure.draw_without_rendering()
    assert len(panels_of(figure)) == 5
    for axes in figure.axes:
        assert axes.images or axes.get_legend() or axes.collections or axes.patches
    for panel in panels_of(figure):
        (bar,) = panel.child_axes
        room = panel.get_window_extent().width
        assert 0.9 * room < bar.get_window_extent().width < room + 1e-3  # its open ends lie beyond


def test_titles_name_the_time_of_day(maps):
    day = [make_path(maps, "astar-dist"), make_path(maps, "ptp", Status.FEASIBLE)]
    night = make_path(maps, "ptp", time_of_day="night")
    assert plotting.plot_paths(maps, day).get_suptitle().endswith("ground, day")
    assert plotting.plot_overview(maps, night).get_suptitle().endswith("ground, night")
    assert plotting.plot_paths(maps, [day[0], night]).get_suptitle().endswith("ground")


def test_all_panels_of_routes_have_the_cost_of_the_weights_that_the_note_names(maps, monkeypatch):
    used = []

    def layers_of(maps, altitude_m, time, time_of_day, weights):
        used.append(weights)
        return cost_layers(maps, altitude_m, time, time_of_day, weights)

    monkeypatch.setattr("jaxurban.draw.paths.cost_layers", layers_of)
    day, night = (make_path(maps, "astar", time_of_day=name) for name in ("day", "night"))
    other = replace(night, settings=night.settings | {"weights": {"distance": 0.1, "gps": 2.0}})
    for path, weights in ((night, RULES["weights"]), (other, {})):
        used.clear()
        texts = plotting.plot_paths(maps, [day, path]).findobj(Text)
        is_named = any("cost: that of all weights 1" in text.get_text() for text in texts)
        assert is_named == (not weights)
        assert used == [weights] * 2


@pytest.mark.usefixtures("laid_out")
@pytest.mark.parametrize(
    "draw", [partial(plotting.plot_metric, name="gps"), plotting.plot_obstacles]
)
def test_panels_of_one_colour_are_left_out_and_named_unless_all_are(draw):
    maps = make_maps()
    low_m, z = maps.altitudes_m[0], maps.altitudes_m[-1]
    maps.ds["obstacle"][-1] = 0
    maps.ds["gps"][-1] = 0.75
    figure = draw(maps, altitude_m=[low_m, z])
    (title,) = titles_of(figure)
    assert title.startswith(f"{low_m:g} m")
    note = " ".join(figure._supxlabel.get_text().split())
    assert f"Not drawn, as the map is the same everywhere: {z:g} m" in note
    assert len(titles_of(draw(maps, altitude_m=z))) == 1


def test_no_word_of_a_note_stands_alone_and_no_line_is_too_long():
    words = ["one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]
    for num in range(1, len(words) + 1):
        line = " ".join(words[:num])
        for width_in in (0.6, 0.9, 1.4, 2.0):
            lines = wrapped(line, width_in).splitlines()
            full = textwrap.wrap(line, max(8, int((width_in - 0.1) * 18)))
            assert len(lines) == len(full)
            assert max(map(len, lines)) <= max(map(len, full))
            narrower = textwrap.wrap(line, max(map(len, lines)) - 1, break_long_words=False)
            assert len(narrower) > len(lines) or max(map(len, lines)) in map(len, words)


def test_no_line_begins_or_ends_with_a_dot_nor_parts_a_number_from_its_unit_or_name():
    note = "weights: distance 0.1, gps 1  ·  5 m cells  ·  97 % of heights  ·  16:00 UTC"
    for width_in in (1.0, 1.5, 2.0, 3.0):
        lines = wrapped(note, width_in).splitlines()
        assert " ".join(lines).replace("·", "").split() == note.replace("·", "").split()
        assert not [line for line in lines if re.match(r"[ ·%m]|cells", line) or line[-1] in " ·"]
        assert all(
            line.count(" m") + line.count(" %") == line.count("5 m") + line.count("7 %")
            for line in lines
        )


def test_scale_and_north_stand_on_white_over_black(maps):
    figure, (panel,) = draw_maps(
        maps.grid, [MapPanel("", [flat_layer(np.ones(maps.grid.shape, bool), "black")])], ""
    )
    marks = [mark for mark in panel.artists if isinstance(mark, AnchoredOffsetbox)]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[::-1, :, :3] / 255
    for mark in marks:
        (text,) = [part for part in mark.findobj(Text) if part.get_text()]
        (left, foot), (right, top) = text.get_window_extent().get_points().round().astype(int)
        assert image[foot:top, left:right].mean() > 0.6


def test_scale_and_north_keep_out_of_the_way_of_a_routes_ends(maps):
    grid = maps.grid
    ends = np.reshape(grid.bounds_m, (2, 2)) + np.array([[150.0], [-150.0]])
    path = made_path(
        grid, ends, 20.0, Status.OPTIMAL, "ptp", settings=make_path(maps, "p").settings
    )
    figure = plotting.plot_paths(maps, path)
    figure.draw_without_rendering()
    (panel,) = panels_of(figure)
    marks = panel.findobj(AnchoredOffsetbox)
    boxes = [mark.get_window_extent() for mark in marks if mark.axes is panel]
    assert len(boxes) >= 2
    for x, y in panel.transData.transform(ends):
        assert not any(box.contains(x, y) for box in boxes)


def all_figures(maps):
    paths = make_paths(maps)
    names = [f"a planner of a long name {number}" for number in range(9)]
    many = [make_path(maps, name, altitude_m=z) for name in names for z in ALTITUDES_M]
    for draw in (
        plotting.plot_gps_rating,
        plotting.plot_heights,
        plotting.plot_population,
        plotting.plot_obstacles,
    ):
        yield draw(maps)
    yield plotting.plot_metric(maps, "gdop")
    yield plotting.plot_epochs(at_epochs(10, maps))
    yield plotting.plot_overview(maps, paths)
    yield plotting.plot_paths(maps, paths)
    yield plotting.plot_paths(maps, many)


@pytest.mark.parametrize(
    ("rows", "cols"),
    [(34, 40), (20, 60), (90, 12)],
)
@pytest.mark.slow
def test_no_label_is_cut_and_no_two_overlap(rows, cols):
    for figure in all_figures(make_maps(rows, cols, has_all_data=False)):
        assert figure.get_figheight() < 11.5
        assert len(assert_legible(figure)) > 10
        assert min(text.get_size() for text in drawn_texts(figure)) >= 6


def test_a_large_map_is_thinned_and_keeps_its_place():
    maps = make_maps(9001, 6, 1.0)
    image = panels_of(plotting.plot_metric(maps, "risk", altitude_m=[20.0]))[0].images[0]
    assert image.get_array().shape[:2] == (3001, 2)
    assert image.get_extent() == [583_000, 583_006, 4_507_000, 4_507_000 + 9003]
    assert image.axes.get_ylim() == (4_507_000, 4_507_000 + 9001)


def test_cells_without_data_are_told_from_obstacles():
    maps = make_maps(has_all_data=False)
    figure = plotting.plot_metric(maps, "risk", altitude_m=[20.0])
    assert "no data" in texts_of(figure)
    assert len({*drawn(panels_of(figure)[0])[-3:, -5:].ravel()} - {OBSTACLE_COLOUR}) == 1
    assert "no data" not in texts_of(plotting.plot_metric(make_maps(), "risk", altitude_m=[20.0]))


def test_percentages_are_exact_only_where_they_are():
    shares = (0, 0.0001, 0.051, 0.5, 0.998, 0.99999, 1)
    assert [precise_percent(share) for share in shares] == [
        "0 %",
        "< 0.1 %",
        "5.1 %",
        "50 %",
        "99.8 %",
        "> 99.9 %",
        "100 %",
    ]


@pytest.mark.slow
def test_all_figures_are_written_small_whole_and_the_same_again(maps, tmp_path):
    paths = make_paths(maps)
    written = plotting.save_figures(maps, paths, tmp_path / "figures")
    names = "gps gps_rating heights lidar obstacle overview paths population risk sensor_choice"
    assert sorted(file.stem for file in written) == names.split()
    assert sorted(written) == sorted((tmp_path / "figures").glob("*.png"))
    for file in written:
        assert file.stat().st_size < 500_000
        with Image.open(file) as image:
            assert image.format == "PNG"
            assert image.size[0] == pytest.approx(DPI * 182 / 25.4, abs=1)
            assert image.info["dpi"] == pytest.approx((DPI, DPI), abs=0.1)
    write_picture(plotting.plot_paths(maps, paths), tmp_path / "paths.png")
    assert (tmp_path / "paths.png").read_bytes() == (
        tmp_path / "figures" / "paths.png"
    ).read_bytes()
    with Image.open(tmp_path / "paths.png") as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    for planner in ("astar-dist", "astar-plus", "ptp"):
        away = np.abs(pixels - 255 * np.array(to_rgb(PLANNER_COLOURS[planner]))).max(axis=1)
        assert away.min() <= 12, f"the palette lost the colour of {planner}"


def test_maps_without_population_are_drawn_without_it(maps):
    maps = MetricMaps(maps.ds.drop_vars(["population", "density", "time_of_day"]))
    titles = titles_of(plotting.plot_overview(maps, make_paths(maps)))
    assert len(titles) == 5
    assert "People" not in " ".join(titles)
    assert titles_of(plotting.plot_paths(maps, ())) == [
        "(a) 20 m",
        "(b) 60 m",
        "(c) 122 m",
        "(d) 600 m",
    ]


def without_a_value(maps: MetricMaps) -> None:
    for values in maps.ds.values():
        values[:] = np.nan if values.dtype.kind == "f" else 0


def without_a_free_cell(maps: MetricMaps) -> None:
    maps.ds["obstacle"][:] = 1


def without_a_building(maps: MetricMaps) -> None:
    for name in ("roof", "obstacle", "density", "population"):
        maps.ds[name][:] = 0


@pytest.mark.parametrize(
    ("empty", "picture", "text"),
    [
        (without_a_value, "obstacle", "no data"),
        (without_a_free_cell, "risk", "no free cell"),
        (without_a_building, "risk", ""),
    ],
)
@pytest.mark.slow
def test_maps_without_a_value_a_free_cell_or_a_building_are_drawn(empty, picture, text):
    maps = make_maps()
    empty(maps)
    pictures = {name: draw() for name, draw in maps_figures(maps, ()).items()}
    assert all(figure.axes for figure in pictures.values())
    assert text in texts_of(pictures[picture])


def test_what_cannot_be_drawn_is_named(maps):
    with pytest.raises(
        InputError, match=r"a map to draw from these maps must be 'obstacle', 'gps', .* got 'wind'"
    ):
        plotting.plot_metric(maps, "wind")
    with pytest.raises(InputError, match="altitude 33"):
        plotting.plot_metric(maps, "risk", altitude_m=[33.0])
    with pytest.raises(InputError, match="hold no population"):
        plotting.plot_population(MetricMaps(maps.ds.drop_vars("density")))


@pytest.mark.usefixtures("laid_out")
def test_a_single_panel_keeps_the_maps_proportions():
    figure = plotting.plot_metric(make_maps(300, 100, 10.0), "risk", altitude_m=[20.0])
    (panel,) = panels_of(figure)
    figure.draw_without_rendering()
    box = panel.get_window_extent()
    assert box.height / box.width == pytest.approx(3.0)
    assert box.height > 0.7 * figure.bbox.height


@pytest.mark.slow
def test_drawing_does_not_import_pyplot():
    code = "import sys, jaxurban.plot; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.usefixtures("laid_out")
def test_a_notebook_shows_heading_and_note_too():
    """Jupyter cuts a figure to its tight box, which holds only what is in the layout."""
    figure = chart(3.0, "Heading", "note")
    figure.subplots()
    shown = figure.get_tightbbox().transformed(figure.dpi_scale_trans)
    boxes = [text.get_window_extent() for text in figure.texts]
    assert len(boxes) == 2
    assert all(
        shown.y0 - 1e-4 <= box.y0 < box.y1 <= shown.y1 + 1e-4 for box in boxes
    )  # 1e-6 inches


def test_the_legend_names_closed_cells_only_where_a_panel_hatches_some():
    maps = made_maps(20, 20)
    nowhere, somewhere = np.zeros((3, 4), bool), np.eye(3, 4, dtype=bool)
    panels = [MapPanel("", is_closed=is_closed) for is_closed in (nowhere, somewhere)]
    assert obstacle_patches(maps, panels=panels[:1]) == obstacle_patches(maps)
    *_, patch = obstacle_patches(maps, panels=panels)
    assert patch.get_label().startswith("closed to routes")
