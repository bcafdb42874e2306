"""The files of docs/guides/recipes.md are read back by other libraries, and hold what the maps hold."""

import sqlite3
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rasterio
from PIL import Image
from rasterio.warp import transform

from tests.test_docs import PAGES, Block, blocks_of, folder, prepared  # noqa: F401

RECIPES: dict[str, Block] = dict(
    zip(
        ("gps", "tiles", "nav2", "paper"),
        blocks_of(next(page for page in PAGES if page.name == "recipes.md")),
        strict=True,
    )
)


@pytest.fixture
def made(request, folder) -> dict:  # noqa: F811
    """The names that a recipe leaves, in a folder with its files."""
    names: dict = {}
    exec(RECIPES[request.param].text, names)
    return names


def test_a_recipe_has_40_lines_at_most():
    assert max(recipe.text.count("\n") for recipe in RECIPES.values()) <= 40


@pytest.mark.slow
@pytest.mark.parametrize("made", ["gps"], indirect=True)
def test_commands_of_px4_give_each_second_the_satellites_of_the_table(made):
    table = pd.read_csv("gps.csv")
    lines = pd.read_csv("gps.txt", sep=" ", names=["elapsed_s", "a", "b", "name", "satellites"])
    assert set(lines["name"]) == {"SIM_GPS_USED"}
    last = np.searchsorted(lines["elapsed_s"], table["elapsed_s"].round(), side="right") - 1
    np.testing.assert_array_equal(lines["satellites"].to_numpy()[last], table["satellites"])
    assert (table.loc[~np.isfinite(table["hdop"]), "satellites"] == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("made", ["tiles"], indirect=True)
def test_tiles_are_where_the_map_is_in_its_colours(made):
    with rasterio.open("out/manhattan/geotiff/gps_60m_25m.tif") as file:
        values, crs = file.read(1), file.crs
        rows, cols = np.nonzero(np.isfinite(values))
        places = np.stack(file.xy(rows, cols), axis=-1)[::97]
    with rasterio.open("gps_colours.tif") as file:
        assert file.read(4)[::10, ::10][~np.isfinite(values)].max(initial=0) == 0
        colours = np.stack([*file.sample(places)])
    xs, ys = transform(crs, "EPSG:3857", *places.T)
    with rasterio.open("gps.mbtiles") as file:
        assert (file.driver, file.crs.to_epsg()) == ("MBTiles", 3857)
        tiles = np.stack([*file.sample(zip(xs, ys, strict=True))])
    assert (np.abs(tiles.astype(int) - colours).max(axis=1) <= 2).mean() > 0.9  # else a cell beside
    with sqlite3.connect("gps.mbtiles") as database:
        facts = dict(database.execute("select name, value from metadata"))
        zooms = {zoom for (zoom,) in database.execute("select distinct zoom_level from tiles")}
        (image,) = database.execute("select tile_data from tiles limit 1").fetchone()
    assert (facts["name"], facts["format"]) == ("GPS", "png")
    assert zooms == {13, 14, 15, 16}
    assert image.startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("made", ["nav2"], indirect=True)
def test_a_map_of_ros_has_its_cells_at_their_places(made):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    with open("flight.yaml") as file:
        facts = yaml.safe_load(file)
    assert (facts["mode"], facts["negate"], facts["origin"]) == ("raw", 0, [0.0, 0.0, 0.0])
    picture = np.asarray(Image.open(facts["image"]))
    on = made["on"]
    assert (picture.shape, facts["resolution"]) == (on.is_free.shape, on.grid.resolution_m)
    for row, col in np.argwhere(np.ones_like(on.is_free))[::501]:
        x_m, y_m = (np.array([col, row]) + 0.5) * facts["resolution"]  # in the frame of the map
        assert on.grid.cell_of_xy(x_m + on.grid.x_min_m, y_m + on.grid.y_min_m) == (row, col)
        value = picture[len(picture) - 1 - row, col]  # of the lower left corner on
        assert (value == 100) == (not on.is_free[row, col])
        if on.is_free[row, col]:
            weighed = on.weight_vector[1:] @ on.costs[:, row, col] / on.weight_vector[1:].sum()
            assert abs(value / 99 - weighed) <= 0.5 / 99 + 1e-6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::jaxurban.errors.GuessWarning")
@pytest.mark.parametrize("made", ["paper"], indirect=True)
def test_the_figure_shows_the_five_planners_under_the_rules_of_the_paper(made):
    assert [path.search.planner for path in made["paths"]] == made["planners"]
    for path in made["paths"]:
        assert path.settings["cost_model"] == "cell"
        assert path.settings["obstacles"] == "centre"
    assert Path("figure.pdf").read_bytes().startswith(b"%PDF")
