"""Pictures show the right colour in the right place, to scale, with every label whole."""

import json
import subprocess
import sys
from itertools import combinations

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.text import Text
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from PIL import Image

from jaxurban.errors import InputError
from jaxurban.io.read.guesses import BEYOND_DATA, NOMINAL_SKY
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.registry import METRICS
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.base import Path, Status
from jaxurban.report import figures as plotting
from jaxurban.report.figures.frame import MAP, OBSTACLE_COLOUR, MapPanel, draw_maps
from jaxurban.report.figures.metrics import percent
from jaxurban.report.figures.paths import PLANNER_COLOURS, maps_figures
from jaxurban.report.figures.style import chart
from jaxurban.report.write import DPI, write_png
from jaxurban.world.grid import Grid

ALTITUDES_M = (20.0, 60.0, 122.0, 600.0)
FLOWN = ("altitude", "y", "x")
RULES = {
    "cost_model": "line",
    "weights": {"distance": 0.1, "gps": 1.0},
    "objective": "weighted",
    "obstacles": "touched",
    "limits": {"vertical_clearance_m": 3.0},
    "resolution_m": 5.0,
}


def make_maps(rows=34, cols=40, resolution_m=100.0, seed=0, has_all_data=True, with_population=True) -> MetricMaps:
    """Random roofs and metrics, one value a cell; GPS rises and lidar falls with altitude."""
    rng = np.random.default_rng(seed)
    roof_m = (rng.random((rows, cols)) < 0.4) * rng.uniform(5, 200, (rows, cols))
    z = np.array(ALTITUDES_M)[:, None, None]
    obstacle = (roof_m >= z).astype(np.uint8)
    chance = rng.random((len(ALTITUDES_M), rows, cols))
    gps = np.where(obstacle, 0, chance ** (20 / z)).astype(np.float32)
    lidar = np.where(obstacle, 0, (1 - chance) * 20 / z).astype(np.float32)
    risk = np.where(obstacle, 0, chance).astype(np.float32)
    density = np.stack([rng.uniform(0, 90_000, (rows, cols)), rng.uniform(0, 30_000, (rows, cols))])
    density[:, :, : cols // 4] = 0
    has_data = np.ones((rows, cols), bool)
    has_data[-3:, -5:] = has_all_data
    data = {
        "obstacle": (FLOWN, obstacle),
        "gps": (("time", *FLOWN), gps[None]),
        "gdop": (("time", *FLOWN), np.where(gps > 0, 20 - 19 * gps, np.inf)[None]),
        "num_visible": (("time", *FLOWN), np.full((1, *obstacle.shape), 7, np.uint8)),
        "lidar": (FLOWN, lidar),
        "risk": (FLOWN, risk),
        "roof": (("y", "x"), roof_m.astype(np.float32)),
        "terrain": (("y", "x"), 100 * rng.random((rows, cols))),
    }
    coords = {"altitude": list(ALTITUDES_M), "time": np.array(["2020-04-27T16:00:00"], "datetime64[ns]")}
    if with_population:
        data["population"] = (("time_of_day", "y", "x"), density / density.max(axis=(1, 2), keepdims=True))
        data["density"] = (("time_of_day", "y", "x"), density)
        coords["time_of_day"] = ["day", "night"]
    data = {
        name: (dims, np.where(has_data, values, np.nan) if values.dtype.kind == "f" else values)
        for name, (dims, values) in data.items()
    }
    data["has_data"] = (("y", "x"), has_data)
    first_row, first_col = round(4_507_000 / resolution_m), round(583_000 / resolution_m)
    attrs = {"crs": "EPSG:32618", "resolution_m": resolution_m, "first_row": first_row, "first_col": first_col}
    ds = xr.Dataset(data, coords=coords, attrs=attrs)
    ds["gps"].attrs["one_means"] = "GDOP of 1, the best possible"
    return MetricMaps(ds)


def make_path(maps, planner, altitude_m, status=Status.OPTIMAL, time_of_day="day") -> PlannedPath:
    grid = maps.grid
    ends = np.array([[0.2, 0.1], [0.5, 0.6], [0.8, 0.9]]) * (grid.num_cols, grid.num_rows) * grid.resolution_m
    xy_m = ends + np.array([grid.x_min_m, grid.y_min_m]) if status.has_path else np.empty((0, 2))
    return PlannedPath(
        status=status,
        xy_m=xy_m,
        lonlat=xy_m,
        z_m=np.full(len(xy_m), altitude_m),
        altitude_m=altitude_m,
        cost=1234.56 if status.has_path else np.inf,
        cost_by_layer={},
        length_m=5678.0 if status.has_path else np.inf,
        metrics={},
        snap_distance_m=(0.0, 0.0),
        search=Path(status, xy_m, 1.0, 0.0, 1, 0.1, planner),
        settings=RULES | {"time": "2020-04-27T16:00:00Z", "time_of_day": time_of_day},
        crs=grid.crs,
    )


def make_paths(maps):
    times_of_day = dict(zip(ALTITUDES_M, ("day", "day", "night", "night"), strict=True))
    if not maps.times_of_day:
        times_of_day = dict.fromkeys(ALTITUDES_M)
    return [
        make_path(maps, planner, z, Status.BLOCKED if planner == "ptp" else Status.OPTIMAL, name)
        for z, name in times_of_day.items()
        for planner in ("ptp", "astar-dist", "astar-plus")
    ]


@pytest.fixture(scope="module")
def maps() -> MetricMaps:
    return make_maps()


def panels_of(figure):
    return [axes for axes in figure.axes if axes.images]


def drawn(axes) -> np.ndarray:
    """The panel's image as hex colours, row 0 in the south."""
    image = axes.images[0]
    assert image.origin == "lower"
    return np.apply_along_axis(lambda rgb: to_hex(rgb / 255), 2, np.asarray(image.get_array()))


def texts_of(figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def test_each_cell_has_its_metric_colour_at_its_place(maps):
    figure = plotting.plot_metric(maps, "gps")
    panels = panels_of(figure)
    assert len(panels) == 4
    for panel, z in zip(panels, ALTITUDES_M, strict=True):
        colours, gps = drawn(panel), maps.m("gps", z)
        is_free = maps.is_free(z, "centre")
        expected = matplotlib.colormaps["viridis"](gps[is_free], bytes=True)[:, :3]
        assert colours[is_free].tolist() == [to_hex(colour / 255) for colour in expected]
        assert set(colours[~is_free].tolist()) <= {OBSTACLE_COLOUR}
        grid = maps.grid
        assert panel.images[0].get_extent() == [grid.x_min_m, grid.x_max_m, grid.y_min_m, grid.y_max_m]


def test_titles_name_altitude_time_resolution_and_frame(maps):
    text = texts_of(plotting.plot_metric(maps, "gps", altitudes_m=[60.0]))
    mean = maps.m("gps", 60.0)[maps.is_free(60.0, "centre")].mean()
    for part in (f"60 m  ·  mean {mean:.2f}", "2020-04-27 16:00 UTC", "100 m cells", "EPSG:32618", "1: GDOP of 1"):
        assert part in text


def test_dops_beyond_the_scale_are_drawn_as_its_end():
    maps = make_maps()
    row, col = np.argwhere(maps.is_free(20.0, "centre"))[7]
    maps.ds["gdop"][0, 0, row, col] = np.inf
    panel = panels_of(plotting.plot_metric(maps, "gdop", altitudes_m=[20.0]))[0]
    assert drawn(panel)[row, col] == to_hex(matplotlib.colormaps["viridis_r"](1.0))


def test_gps_rating_has_the_papers_classes(maps):
    figure = plotting.plot_gps_rating(maps)
    for name in ("Ideal", "Excellent", "Good", "Moderate", "Fair", "Poor"):
        assert name in texts_of(figure)
    gdop, is_free = maps.m("gdop", 20.0), maps.is_free(20.0, "centre")
    assert f"20 m  ·  {percent((gdop[is_free] <= 6).mean())} good or better" in texts_of(figure)
    colours = drawn(panels_of(figure)[0])
    steps = matplotlib.colormaps["viridis"](np.linspace(1, 0, 6))
    assert set(colours[is_free & (gdop > 4) & (gdop <= 6)]) == {to_hex(steps[2])}
    assert set(colours[is_free & (gdop > 8) & (gdop <= 20)]) == {to_hex(steps[4])}


def test_sensor_choice_is_gps_where_it_beats_lidar(maps):
    figure = plotting.plot_sensor_choice(maps)
    for panel, z in zip(panels_of(figure), ALTITUDES_M, strict=True):
        is_gps, is_free = maps.m("gps", z) > maps.m("lidar", z), maps.is_free(z, "centre")
        colours = drawn(panel)
        assert set(colours[is_free & is_gps].tolist()) <= {METRICS["gps"].colour}
        assert set(colours[is_free & ~is_gps].tolist()) <= {METRICS["lidar"].colour}
        assert f"{z:g} m  ·  GPS in {percent(is_gps[is_free].mean())}" in texts_of(figure)


def test_population_titles_count_people_and_both_times_share_one_scale(maps):
    figure = plotting.plot_population(maps)
    for name in ("day", "night"):
        people = maps.m("density", time_of_day=name).sum() * 0.01  # 100 m cells
        assert f"{name}  ·  {people:,.0f} people" in texts_of(figure)
    colours = [drawn(panel) for panel in panels_of(figure)]
    assert set(colours[0][:, :10].ravel()) == {"#ffffff"}
    scale = matplotlib.colormaps["magma_r"]
    highest = maps.ds["density"].values.max()
    share = 1 + np.log10(maps.m("density", time_of_day="night")[5, 20] / highest) / 3
    assert colours[1][5, 20] == to_hex(scale(share))


def test_obstacle_titles_give_their_share(maps):
    text = texts_of(plotting.plot_obstacles(maps))
    for z in ALTITUDES_M:
        assert f"{z:g} m  ·  {percent((maps.m('obstacle', z) == 1).mean())} blocked" in text


def test_paths_have_the_papers_colours_and_coinciding_ones_both_show(maps):
    figure = plotting.plot_paths(maps, make_paths(maps))
    panels = panels_of(figure)
    assert [panel.get_title(loc="left") for panel in panels] == [
        "20 m · day",
        "60 m · day",
        "122 m · night",
        "600 m · night",
    ]
    for panel in panels:
        lines = [line for line in panel.lines if line.get_marker() in ("None", None, "")]
        assert [line.get_color() for line in lines] == [PLANNER_COLOURS["astar-dist"], PLANNER_COLOURS["astar-plus"]]
        assert lines[0].get_linewidth() > lines[1].get_linewidth()
        outcomes = panel.get_xlabel().splitlines()[-3:]
        assert outcomes == ["ptp: blocked", "astar-dist: 1,235, 5.68 km", "astar-plus: 1,235, 5.68 km"]
    named = {
        text.get_text(): line
        for legend in figure.legends
        for text, line in zip(legend.texts, legend.legend_handles, strict=True)
    }
    assert named["astar-plus"].get_color() == PLANNER_COLOURS["astar-plus"]


def test_paths_planned_by_day_and_by_night_get_a_panel_each(maps):
    paths = [make_path(maps, "ptp", 20.0, time_of_day=name) for name in ("night", "day")]
    figure = plotting.plot_paths(maps, paths)
    assert [panel.get_title(loc="left") for panel in panels_of(figure)] == ["20 m · night", "20 m · day"]


def test_titles_name_paths_only_where_there_are_some(maps, tmp_path):
    for figure in (plotting.plot_paths(maps, ()), plotting.plot_overview(maps, ())):
        assert "paths" not in texts_of(figure)
        assert "goal" not in texts_of(figure)
    assert "ptp" not in texts_of(plotting.plot_overview(maps, make_paths(maps)))  # which found none
    for figure in (plotting.plot_paths(maps, make_paths(maps)), plotting.plot_overview(maps, make_paths(maps))):
        assert "and paths" in texts_of(figure)
        assert {"start", "goal"} <= set(texts_of(figure).splitlines())
    assert "paths" not in maps_figures(maps, ())
    assert {"cost_day", "cost_night"} <= set(maps_figures(maps, ()))
    assert {"paths"} == {name for name in maps_figures(maps, make_paths(maps)) if name.startswith(("paths", "cost"))}


def test_the_time_of_day_is_named_in_every_panel(maps):
    panels = panels_of(plotting.plot_paths(maps, (), time_of_day="night"))
    assert [panel.get_title(loc="left") for panel in panels] == [f"{z:g} m · night" for z in ALTITUDES_M]


@pytest.mark.parametrize("name", ["gps", "gdop", "num_visible", "population"])
def test_colour_bars_carry_both_ends(maps, name):
    figure = plotting.plot_population(maps) if name == "population" else plotting.plot_metric(maps, name)
    (bar,) = [axes for axes in figure.axes if axes.get_ylabel() and axes.get_gid() != MAP]
    assert bar.get_yticks()[[0, -1]] == pytest.approx(bar.get_ylim())


def at_epochs(num, maps=None):
    maps = maps or make_maps()
    times = np.datetime64("2020-04-27T16:00:00", "ns") + 3 * np.timedelta64(1, "h") * np.arange(num)
    parts = [maps.ds.assign_coords(time=[time]) for time in times]
    ds = xr.concat(parts, "time", data_vars="minimal", coords="minimal", compat="override", join="outer")
    ds["gps"] = ds["gps"] * xr.DataArray(np.linspace(1, 0.3, num).astype(np.float32), dims="time")
    ds["num_visible"][:] = (7 + np.arange(num, dtype=np.uint8))[:, None, None, None]
    return MetricMaps(ds.assign_attrs(maps.ds.attrs, constellations="galileo, gps"))


def test_every_epoch_is_drawn_and_the_share_of_good_ones():
    maps = at_epochs(3)
    assert {"gps_epochs", "gps_availability"} <= set(maps_figures(maps, ()))
    text = texts_of(plotting.plot_epochs(maps))
    for time in ("16:00", "19:00", "22:00"):
        assert f"04-27 {time}  ·  mean" in text
    assert "3 epochs, 2020-04-27 16:00 UTC to 2020-04-27 22:00 UTC, GALILEO and GPS" in text
    figure = plotting.plot_metric(maps, "gps_availability")
    share = np.mean([maps.m("gps", 60.0, time=time) > 0.5 for time in maps.times], axis=0)
    is_free, panel = maps.is_free(60.0, "centre"), panels_of(figure)[1]
    expected = matplotlib.colormaps["viridis"](share[is_free].astype(np.float32), bytes=True)[:, :3]
    assert drawn(panel)[is_free].tolist() == [to_hex(colour / 255) for colour in expected]
    assert "2020-04-27 16:00 UTC, GALILEO and GPS" in texts_of(plotting.plot_metric(maps, "gps"))
    assert not {"gps_epochs", "gps_availability"} & set(maps_figures(make_maps(), ()))


def test_a_long_series_is_drawn_by_its_statistics(maps):
    ds = at_epochs(3).ds
    series = {f"gps_{what}": ds["gps"].isel(time=0) for what in ("median", "p05", "availability")}
    maps = MetricMaps(ds.drop_vars(["gps", "gdop", "num_visible"]).assign(series).assign_attrs(satellites="a, b"))
    figures = maps_figures(maps, ())
    assert {"gps", "gps_p05", "gps_availability"} <= set(figures)
    text = texts_of(figures["gps"]())
    assert "GPS quality, median over time" in text
    assert "3 epochs, 2020-04-27 16:00 UTC to 2020-04-27 22:00 UTC, GALILEO and GPS" in text
    assert "epochs" not in texts_of(figures["lidar"]())


def test_notes_tell_the_place_and_only_the_guesses_that_concern_the_picture():
    maps = make_maps()
    guesses = dict.fromkeys(("3 % of heights", NOMINAL_SKY, f"5 % of {BEYOND_DATA}"), "")
    maps.ds.attrs["guesses"] = json.dumps(guesses)
    lon, lat = maps.grid.centre_lonlat
    place = f"around {lat:.3f}°N {-lon:.3f}°W"
    told = texts_of(plotting.plot_metric(maps, "gps"))
    assert f"Guessed: 3 % of heights, {NOMINAL_SKY}, 5 % of {BEYOND_DATA}" in told
    for figure in (plotting.plot_metric(maps, "lidar"), plotting.plot_obstacles(maps), plotting.plot_heights(maps)):
        assert "Guessed: 3 % of heights\n" in texts_of(figure)
        assert place in texts_of(figure)


def test_the_overview_says_its_altitude_and_what_one_means():
    maps = make_maps()
    maps.ds.attrs["risk_threshold_m"] = 50.0
    maps.ds["risk"].attrs["one_means"] = METRICS["risk"].one_means
    told = texts_of(plotting.plot_overview(maps, (), altitude_m=60.0))
    assert "Metric maps, 60 m above ground" in told
    assert {"(1: no obstacle within 50 m)", "(0: best free cell, 1: worst)"} <= set(told.splitlines())
    assert "(1: no obstacle within 50 m)" in texts_of(plotting.plot_metric(maps, "risk"))


def test_people_that_no_source_counts_are_not_told_to_be_none(maps):
    assert "no people\nin the data" in texts_of(plotting.plot_population(maps))


def test_twelve_paths_have_twelve_colours_and_stay_lines(maps):
    names = [f"a planner of a long name {number}" for number in range(12)]
    paths = [make_path(maps, name, 20.0) for name in names]
    (panel,) = panels_of(plotting.plot_paths(maps, paths, names=[*PLANNER_COLOURS, *names[5:]]))
    lines = [line for line in panel.lines if line.get_marker() in ("None", None, "")]
    assert len({line.get_color() for line in lines}) == 12
    widths = [line.get_linewidth() for line in lines]
    assert sorted(set(widths), reverse=True) == widths
    assert widths[0] < 10


def test_cost_is_black_where_best_and_white_where_worst(maps):
    colours = drawn(panels_of(plotting.plot_paths(maps, (), altitudes_m=[20.0]))[0])
    norm = np.where(maps.is_free(20.0, "centre"), maps.normalised(20.0, time_of_day="day"), np.nan)
    assert colours[np.unravel_index(np.nanargmin(norm), norm.shape)] == "#000000"
    assert colours[np.unravel_index(np.nanargmax(norm), norm.shape)] == "#ffffff"


@pytest.mark.parametrize(("rows", "cols", "resolution_m"), [(34, 40, 100.0), (100, 50, 200.0), (30, 75, 20.0)])
def test_scale_bar_is_as_long_as_it_says(rows, cols, resolution_m):
    frame_maps = make_maps(rows, cols, resolution_m)
    figure = plotting.plot_metric(frame_maps, "risk")
    FigureCanvasAgg(figure).draw()
    (scale,) = figure.findobj(AnchoredSizeBar)
    number, unit = scale.txt_label.get_text().split()
    length_m = float(number) * {"m": 1, "km": 1000}[unit]
    width = scale.size_bar.get_window_extent().width
    for panel in panels_of(figure):
        x_pixels = panel.transData.transform([(583_000, 4_507_000), (583_000 + length_m, 4_507_000 + length_m)])
        assert width == pytest.approx(np.diff(x_pixels[:, 0])[0], rel=1e-3)
        assert width == pytest.approx(np.diff(x_pixels[:, 1])[0], rel=1e-3)


def all_figures(maps):
    paths = make_paths(maps)
    yield plotting.plot_overview(maps, paths)
    yield plotting.plot_paths(maps, paths)
    yield plotting.plot_metric(maps, "gdop")
    yield plotting.plot_gps_rating(maps)
    yield plotting.plot_heights(maps)
    yield plotting.plot_population(maps)
    yield plotting.plot_obstacles(maps)
    yield plotting.plot_epochs(at_epochs(10, maps))
    many = [make_path(maps, f"a planner of a long name {number}", z) for number in range(9) for z in ALTITUDES_M]
    yield plotting.plot_paths(maps, many)


@pytest.mark.parametrize(("rows", "cols"), [(34, 40), (51, 39), (100, 50), (20, 60), (90, 12)])
def test_no_label_is_cut_and_no_two_overlap(rows, cols, monkeypatch):
    drawn_texts = []
    draw = Text.draw
    monkeypatch.setattr(Text, "draw", lambda self, renderer: (drawn_texts.append(self), draw(self, renderer))[1])
    for figure in all_figures(make_maps(rows, cols, has_all_data=False)):
        drawn_texts.clear()
        FigureCanvasAgg(figure).draw()
        assert figure.get_figwidth() * DPI < 1300
        assert figure.get_figheight() * DPI < 1100
        shown = [text for text in drawn_texts if text.get_text().strip() and text.get_visible()]
        boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
        assert len(boxes) > 10
        for name, box in boxes:
            assert min(box.x0, box.y0) >= 0, name
            assert box.x1 <= figure.bbox.x1, name
            assert box.y1 <= figure.bbox.y1, name
        clashes = [
            (name, other)
            for (name, box), (other, other_box) in combinations(boxes, 2)
            if box.shrunk(0.98, 0.9).overlaps(other_box)
        ]
        assert not clashes


def test_a_large_map_is_thinned_and_keeps_its_place():
    maps = make_maps(9001, 6, 1.0)
    image = panels_of(plotting.plot_metric(maps, "risk", altitudes_m=[20.0]))[0].images[0]
    assert image.get_array().shape[:2] == (3001, 2)
    assert image.get_extent() == [583_000, 583_006, 4_507_000, 4_507_000 + 9003]
    assert image.axes.get_ylim() == (4_507_000, 4_507_000 + 9001)


def test_cells_without_data_are_told_from_obstacles():
    maps = make_maps(has_all_data=False)
    figure = plotting.plot_metric(maps, "risk", altitudes_m=[20.0])
    assert "no data" in texts_of(figure)
    assert len({*drawn(panels_of(figure)[0])[-3:, -5:].ravel()} - {OBSTACLE_COLOUR}) == 1
    assert "no data" not in texts_of(plotting.plot_metric(make_maps(), "risk", altitudes_m=[20.0]))


def test_percentages_are_exact_only_where_they_are():
    shares = (0, 0.0001, 0.051, 0.5, 0.998, 0.99999, 1)
    assert [percent(share) for share in shares] == ["0 %", "< 0.1 %", "5.1 %", "50 %", "99.8 %", "> 99.9 %", "100 %"]


@pytest.mark.slow
def test_all_figures_are_written_small_whole_and_the_same_again(maps, tmp_path):
    paths = make_paths(maps)
    written = plotting.save_figures(maps, paths, tmp_path / "figures")
    names = "overview heights obstacle gps gps_rating lidar sensor_choice risk paths population"
    assert sorted(file.stem for file in written) == sorted(names.split())
    assert sorted(written) == sorted((tmp_path / "figures").glob("*.png"))
    first = {file.name: file.read_bytes() for file in written}
    for file in written:
        assert file.stat().st_size < 400_000
        with Image.open(file) as image:
            assert image.format == "PNG"
            assert 700 <= image.size[0] <= 1300
    write_png(plotting.plot_paths(maps, paths), tmp_path / "paths.png")
    assert (tmp_path / "paths.png").read_bytes() == first["paths.png"]
    with Image.open(tmp_path / "paths.png") as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    for planner in ("astar-dist", "astar-plus", "ptp"):
        away = np.abs(pixels - 255 * np.array(to_rgb(PLANNER_COLOURS[planner]))).max(axis=1)
        assert away.min() <= 12, f"the palette lost the colour of {planner}"


def test_maps_without_population_are_drawn_without_it(tmp_path):
    maps = make_maps(with_population=False)
    titles = [panel.get_title(loc="left") for panel in panels_of(plotting.plot_overview(maps, make_paths(maps)))]
    assert len(titles) == 5
    assert "People" not in " ".join(titles)
    panels = panels_of(plotting.plot_paths(maps, ()))
    assert [panel.get_title(loc="left") for panel in panels] == ["20 m", "60 m", "122 m", "600 m"]
    with pytest.raises(InputError, match="hold no population"):
        plotting.plot_population(maps)


def test_maps_without_a_value_a_free_cell_or_a_building_are_drawn():
    nothing, closed, empty = make_maps(), make_maps(), make_maps()
    for values in nothing.ds.values():
        values[:] = np.nan if values.dtype.kind == "f" else 0
    closed.ds["obstacle"][:] = 1
    for name in ("roof", "obstacle", "density", "population"):
        empty.ds[name][:] = 0
    for maps in (nothing, closed, empty):
        for draw in maps_figures(maps, ()).values():
            assert draw().axes
    assert "no data" in texts_of(plotting.plot_obstacles(nothing))
    assert "no free cell" in texts_of(plotting.plot_metric(closed, "risk"))


def test_what_cannot_be_drawn_is_named(maps):
    with pytest.raises(InputError, match=r"a map to draw from these maps must be 'obstacle', 'gps', .* got 'wind'"):
        plotting.plot_metric(maps, "wind")
    with pytest.raises(InputError, match="altitude 33"):
        plotting.plot_metric(maps, "risk", altitudes_m=[33.0])


def test_a_single_panel_keeps_the_maps_proportions():
    grid = Grid("EPSG:32618", 10.0, 450_000, 58_000, 300, 100)
    figure, (panel,) = draw_maps(grid, [MapPanel("a")], "heading", "note")
    figure.draw_without_rendering()
    box = panel.get_window_extent()
    assert box.height / box.width == pytest.approx(3.0)
    assert box.height > 0.7 * figure.bbox.height


def test_drawing_does_not_import_pyplot():
    code = "import sys, jaxurban.report.figures; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_satellites_are_drawn_in_whole_numbers(maps):
    figure = plotting.plot_metric(maps, "num_visible")
    assert "median 7" in texts_of(figure)
    assert "median 7.0" not in texts_of(figure)
    (bar,) = [panel for panel in figure.axes if panel.get_ylabel() == "satellites in view"]
    assert [tick % 1 for tick in bar.get_yticks()] == [0] * len(bar.get_yticks())


def test_pictures_of_routes_name_the_rules_that_they_were_planned_under():
    maps = make_maps(34, 40)
    said = "cost model: line · weights: distance 0.1, gps 1 · obstacles: touched, vertical clearance of 3 m"
    for figure in (plotting.plot_paths(maps, make_paths(maps)), plotting.plot_overview(maps, make_paths(maps))):
        assert said in " ".join(texts_of(figure).split())
    assert "cost model" not in texts_of(plotting.plot_paths(maps, ()))


def test_a_notebook_shows_heading_and_note_too():
    """Jupyter cuts a figure to its tight box, which holds only what is in the layout."""
    figure = chart(7.2, 3.0, "Heading", "note")
    figure.subplots()
    renderer = FigureCanvasAgg(figure).get_renderer()
    shown_in = figure.get_tightbbox(renderer)
    boxes_in = [
        text.get_window_extent(renderer).transformed(figure.dpi_scale_trans.inverted()) for text in figure.texts
    ]
    assert len(boxes_in) == 2
    assert all(shown_in.y0 - 1e-6 <= box.y0 < box.y1 <= shown_in.y1 + 1e-6 for box in boxes_in)
