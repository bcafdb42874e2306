"""Metric maps made up by NumPy alone: a city of blocks with smooth random metrics, for tests that need no real ones."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
import xarray as xr
from scipy.ndimage import gaussian_filter

from jaxurban.io.city import City
from jaxurban.io.rasterise import build_surface
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.world.footprints import Footprints, HeightOrigin
from jaxurban.world.grid import Grid
from jaxurban.world.raster import Raster
from jaxurban.world.surface import obstacles_on

FLOWN = ("altitude", "y", "x")


def city_of_boxes(
    boxes: Sequence, height_m, side_m: float, corner_m=(0.0, 0.0), crs: str = "EPSG:32618"
) -> City:
    """Return a square city of boxes (x_min, y_min, x_max, y_max from its corner) that stand on the ground."""
    outlines, zero = (
        shapely.box(*(np.transpose(boxes) + np.tile(corner_m, 2)[:, None])),
        np.zeros(len(boxes)),
    )
    buildings = Footprints(outlines, zero + height_m, zero, zero.astype(np.uint8), zero > 0)
    return City(crs, (*corner_m, corner_m[0] + side_m, corner_m[1] + side_m), buildings)


def made_maps(
    num_rows: int = 80,
    num_cols: int = 100,
    altitudes_m: Sequence[float] = (20.0, 60.0),
    resolution_m: float = 10.0,
) -> MetricMaps:
    """Return maps with streets between blocks of 0 to 80 m; every metric takes all values from 0 to 1."""
    rng = np.random.default_rng(7)
    grid = Grid("EPSG:32618", resolution_m, 450_000, 58_000, num_rows, num_cols)
    row, col = np.indices(grid.shape)
    block_m = rng.choice([0.0, 12.0, 30.0, 80.0], (num_rows // 6 + 1, num_cols // 8 + 1))
    roof_m = np.where((row % 6 < 3) & (col % 8 < 5), block_m[row // 6, col // 8], 0.0).astype(
        np.float32
    )
    obstacle = np.stack([roof_m >= z for z in altitudes_m]).astype(np.uint8)

    def smooth(*sizes: int) -> np.ndarray:
        values = gaussian_filter(rng.normal(size=(*sizes, *grid.shape)), [0] * len(sizes) + [6, 6])
        return ((values - values.min()) / np.ptp(values)).astype(np.float32)

    a, flown = (
        len(altitudes_m),
        {name: smooth(len(altitudes_m)) * (1 - obstacle) for name in ("lidar", "risk")},
    )
    gps, visible = (
        smooth(1, a) * (1 - obstacle),
        (9 * smooth(1, a) * (1 - obstacle)).astype(np.uint8),
    )
    people = smooth(2)
    data = {
        "obstacle": (FLOWN, obstacle),
        "gps": (("time", *FLOWN), gps),
        "num_visible": (("time", *FLOWN), visible),
        "hdop": (
            ("time", *FLOWN),
            np.where(visible >= 4, 1 / np.maximum(gps, 0.1), np.inf).astype(np.float32),
        ),
        **{name: (FLOWN, values) for name, values in flown.items()},
        "population": (("time_of_day", "y", "x"), people),
        "density": (("time_of_day", "y", "x"), 50_000 * people),
        **dict.fromkeys(("roof", "roof_touched"), (("y", "x"), roof_m)),
        "has_data": (("y", "x"), np.ones(grid.shape, bool)),
    }
    coords = {
        "y": grid.y_m,
        "x": grid.x_m,
        "altitude": np.asarray(altitudes_m, float),
        "time": np.array(["2020-04-27T16:00:00"], "datetime64[ns]"),
        "time_of_day": np.array(["day", "night"], np.dtypes.StringDType()),
        "spatial_ref": 0,
    }
    attrs = {
        "crs": grid.crs,
        "resolution_m": resolution_m,
        "first_row": grid.first_row,
        "first_col": grid.first_col,
    }
    return MetricMaps(xr.Dataset(data, coords, attrs | {"attribution": "© a made city"}))


def missing_inside(maps: MetricMaps, **attrs) -> MetricMaps:
    """Return maps with NaN inside obstacles, as `build_maps` makes them, and more attributes."""
    is_free, names = maps.ds["obstacle"] == 0, ("gps", "lidar", "risk")
    return MetricMaps(
        maps.ds.assign({name: maps.ds[name].where(is_free) for name in names}).assign_attrs(attrs)
    )


def city_of_kinds(corner_m=(0.0, 0.0), **more) -> City:
    """Return a square city of 200 m: two houses, a chimney, a row of trees, a wood, a wire, and plants as a raster.

    The trees are guessed to have 12 m and may have 30 m. The raster's plants have 14 m in a square of 20 m.
    """
    city = city_of_boxes([(0, 0, 40, 40), (100, 100, 140, 160)], [20.0, 30.0], 200.0, corner_m)
    rows = np.arange(5)
    shapes = [
        shapely.box(60, 10, 70, 20),
        *shapely.buffer(shapely.points(20 + 10 * rows, 90), 4.0, quad_segs=4),
        shapely.box(150, 0, 190, 60),
        shapely.box(50, 180, 200, 181),
    ]
    kinds = ["chimney", *["tree"] * 5, "wood", "wire"]
    is_tree = np.array(kinds) == "tree"
    structures = Footprints(
        polygons=shapely.transform(np.array(shapes), lambda xy: xy + corner_m),
        height_m=np.array([90.0, *[12.0] * 5, 15.0, 10.0]),
        min_height_m=np.zeros(8),
        origin=np.where(is_tree, HeightOrigin.DEFAULT, HeightOrigin.HEIGHT).astype(np.uint8),
        is_part=np.zeros(8, bool),
        kind=np.array(kinds, object),
        limit_m=np.where(is_tree, 30.0, np.inf),
    )
    heights_m = np.zeros((40, 40), np.float32)  # row 0 in the north
    heights_m[12:16, 4:8] = 14.0
    place = 5.0, 0.0, corner_m[0], 0.0, -5.0, corner_m[1] + 200.0
    return replace(
        city, structures=structures, vegetation=Raster(heights_m, place, city.crs), **more
    )


def maps_of_kinds(**more) -> tuple[MetricMaps, City]:
    """Return maps in cells of 5 m of `city_of_kinds`, with an obstacle at 8, 13 and 20 m, and the city."""
    maps = made_maps(40, 40, (8.0, 13.0, 20.0), 5.0)
    city = city_of_kinds(maps.grid.bounds_m[:2], **more)
    surface = build_surface(city, maps.grid, maps.grid, has_guessed=True, has_kinds=True)
    names = {"roof": "roof_m", "roof_touched": "roof_touched_m", "roof_guessed": "roof_guessed"}
    names |= {"roof_limit": "roof_limit_m", "roof_kind": "roof_kind"}
    ds = maps.ds.assign({name: (("y", "x"), getattr(surface, of)) for name, of in names.items()})
    obstacle = obstacles_on(surface, maps.altitudes_m).astype(np.uint8)
    return replace(maps, ds=ds.assign(obstacle=ds["obstacle"].copy(data=obstacle))), city
