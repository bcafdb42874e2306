"""How high a return must be: it agrees with where planners may fly, and exact outlines ask for no more."""

import numpy as np
import pytest
import shapely
from matplotlib.text import Text
from scipy.ndimage import gaussian_filter

import jaxurban as ju
from jaxurban.paths.clearance import highest_within, reaches_m
from jaxurban.paths.elevation import Elevation
from jaxurban.viewer.requests import Cell, View
from jaxurban.viewer.viewer import Viewer
from tests.made_maps import made_maps
from tests.volumes import with_roofs

SIDE_M = 5.0
CLEARANCES = [(0.0, 0.0), (0.0, 3.0), (2.0, 3.0), (5.0, 4.0), (13.0, 3.0)]


def scattered(seed: int = 0) -> ju.MetricMaps:
    rng, maps = np.random.default_rng(seed), made_maps(40, 50, resolution_m=SIDE_M)
    is_built = rng.random(maps.grid.shape) < 0.03
    return with_roofs(
        maps, np.where(is_built, rng.choice([12.0, 18.0, 30.0, 80.0], is_built.shape), 0.0)
    )


def over_hills(maps: ju.MetricMaps) -> ju.MetricMaps:
    noise = np.random.default_rng(5).normal(size=maps.grid.shape)
    terrain_m = (300 * gaussian_filter(noise, 6)).astype(np.float32)
    return ju.MetricMaps(maps.ds.assign(terrain=(("y", "x"), terrain_m)))


@pytest.mark.parametrize(("clearance_m", "vertical_m"), CLEARANCES)
def test_cell_is_open_from_the_height_on_at_which_planners_may_fly(clearance_m, vertical_m):
    maps = scattered()
    limits = ju.Constraints(clearance_m=clearance_m, vertical_clearance_m=vertical_m)
    roof_m, _ = reaches_m(maps, clearance_m, "highest")
    top_m = highest_within(roof_m, clearance_m, SIDE_M)
    for altitude_m in (12.0, 15.0, 15.01, 18.0, 20.0, 21.0, 33.0, 34.5, 60.0, 83.0, 90.0):
        is_open = (altitude_m - vertical_m > top_m) | (top_m == 0)
        np.testing.assert_array_equal(is_open, limits.is_free(maps, altitude_m))


def test_over_hills_the_ground_counts_too():
    maps = over_hills(scattered())
    home = ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 25)), clearance_m=5.0)
    ground_m = maps.m("terrain")
    assert home.ground_m == pytest.approx(ground_m[20, 25], abs=1e-3)
    highest_m = (
        np.nanmax(Elevation(maps, None).highest_m + maps.m("roof_touched")) - home.ground_m + 3.0
    )
    assert home.figures["highest_m"] <= highest_m + 0.01
    least_m = ground_m + maps.m("roof_touched") - home.ground_m + 3.0
    has_value = np.isfinite(home.altitude_m)
    assert (home.altitude_m >= least_m - 1e-4)[has_value].all()
    assert has_value[2:-2, 2:-2].all()
    assert not has_value[0].any()


def test_value_is_just_above_what_is_highest_on_the_way():
    maps = made_maps(30, 30, resolution_m=SIDE_M)
    roof_m = np.zeros(maps.grid.shape)
    roof_m[15, 20] = 40.0
    maps = with_roofs(maps, roof_m)
    home = ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(15, 10)), vertical_clearance_m=5.0)
    assert home.altitude_m[15, 27] == pytest.approx(45.0)
    assert home.altitude_m[15, 27] > 45.0  # where planners fly; at 45 m the cell is closed
    assert home.altitude_m[3, 10] == pytest.approx(5.0)
    assert home.figures["highest_m"] == pytest.approx(45.0)
    assert home.figures["clear_share"] == 1.0
    assert home.sentence.startswith(
        "A return at 45 m above the ground at home clears all that stands from 100.0% of the area"
    )
    assert "PX4: RTL_RETURN_ALT = 45 (m)" in [": ".join(fact)[:28] for fact in home.facts.items()]
    lon, lat = maps.grid.lonlat_of_cell(15, 27)
    assert home.at_lonlat(lon, lat) == home.altitude_m[15, 27]


def test_at_the_ceiling_a_return_clears_the_cells_that_need_no_more_and_no_more_is_typed():
    maps = scattered()
    home = ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 25)), ceiling_m=40)
    share = np.mean(home.altitude_m <= 40.0)  # roofs of 12, 18, 30 and 80 m, and 3 m over them
    assert home.figures == {
        "highest_m": pytest.approx(83.0),
        "typed_m": 40,
        "clear_share": share,
    }
    assert 0.1 < share < 0.9
    assert home.sentence == (
        f"A return at 40 m above the ground at home clears all that stands from {share:.1%} of the "
        "area, at 83 m from every cell with a value; elsewhere set a rally point, or return along "
        "the way flown."
    )
    assert home.facts["PX4"].startswith("RTL_RETURN_ALT = 40 (m)")
    share = home.figures["clear_share"]
    assert home.facts["PX4"].endswith(f" This clears {share:.1%} of the area.")
    exact = ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 25)), ceiling_m=83)
    assert exact.figures["clear_share"] == np.isfinite(exact.altitude_m).mean()
    assert exact.sentence.startswith("A return at 83 m")
    with pytest.raises(ju.InputError, match="whole number from 2 up"):
        ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 25)), ceiling_m=0)


def test_no_value_where_the_line_meets_what_is_unknown():
    maps = scattered()
    roof_m = maps.m("roof_touched").copy()
    roof_m[20, 30] = np.nan
    maps = ju.MetricMaps(maps.ds.assign(roof_touched=(("y", "x"), roof_m)))
    home = ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 20)))
    assert np.isnan(home.altitude_m[20, 30:]).all()
    assert np.isfinite(home.altitude_m[:, :25]).all()
    assert "have no value" in home.cautions[0]
    texts = [text.get_text() for text in ju.plot.plot_return(home).findobj(Text)]
    assert "no value" in texts
    assert any(
        text.replace("\n", " ").endswith("no altitude is known to be clear") for text in texts
    )
    with pytest.raises(ju.InputError, match="choose another home"):
        ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 30)))
    with pytest.raises(ju.InputError, match="border"):
        ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(0, 20)), clearance_m=5.0)


def test_exact_outlines_never_ask_for_more(town):
    city = ju.demo_city(1_000, 1_000)
    home = ju.return_altitude(town, ju.XY(*town.grid.xy_of_cell(80, 80)))
    row, col = np.random.default_rng(2).integers(0, town.grid.shape, (300, 2)).T
    x_m, y_m = town.grid.xy_of_cell(row, col)
    ends_m = np.stack([np.column_stack([x_m, y_m]), np.tile(home.home_xy_m, (300, 1))], axis=1)
    outlines = shapely.STRtree(city.standing.polygons)
    line, outline = outlines.query(shapely.linestrings(ends_m), predicate="intersects")
    exact_m = np.zeros(300)
    np.maximum.at(exact_m, line, city.standing.height_m[outline])
    over_m = home.altitude_m[row, col] - (exact_m + 3.0)
    assert np.nanmin(over_m) >= 0
    assert np.nanmedian(over_m) < 1


def test_files_hold_the_map(tmp_path):
    import rasterio

    maps = scattered()
    home = ju.return_altitude(maps, ju.XY(*maps.grid.xy_of_cell(20, 20)))
    with rasterio.open(home.save(tmp_path / "home.tif")) as file:
        np.testing.assert_array_equal(file.read(1)[::-1], home.altitude_m)
        assert file.units == ("m",)
    again = ju.open_maps(home.save(tmp_path / "maps"))
    np.testing.assert_array_equal(again.m("return_altitude"), home.altitude_m)
    assert (tmp_path / "maps/geotiff/return_altitude_5m.tif").is_file()


def test_viewer_has_a_layer_of_the_home_that_is_clicked():
    maps = scattered()
    lon, lat = map(float, maps.grid.lonlat_of_cell(20, 20))
    viewer, view = Viewer(maps), View(layer="return_altitude", at=(0, 0, 0), home=(lon, lat))
    home = ju.return_altitude(maps, (lon, lat))
    np.testing.assert_array_equal(viewer.values(view), home.altitude_m)
    assert np.isnan(viewer.values(view.model_copy(update={"home": None}))).all()
    rows = {
        row["name"]: row["value"]
        for row in viewer.values_at(Cell(at=(0, 0, 0), row=5, col=6, home=(lon, lat)))
    }
    assert rows["return_altitude"] == home.altitude_m[5, 6]
    assert "in metres" in viewer.legend(view)["html"]
