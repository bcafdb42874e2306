"""Small worlds for random missions: houses, towers, thin walls and slabs, on level ground and on hills, as files.

Of jaxurban nothing is imported here: the truth of a world is its outlines and its terrain, as they are in the files.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyproj
import rasterio
import shapely
from scipy.interpolate import RegularGridInterpolator

from tests.cities.generator import plant
from tests.cities.generator.extracts import FROM_EXTRACTS

CRS, CORNER_M = "EPSG:32618", (583_000.0, 4_506_000.0)  # in Lower Manhattan
SIDE_M, MARGIN_M = 500.0, 160.0  # of the maps, and by how much files reach beyond them
PIXEL_M = 2.0  # of the terrain
LOWEST_M, HIGHEST_M = 0.5, 260.0  # altitudes of the maps
GEOID_M = 37.0  # above the ellipsoid
LEVEL_M = 12.0  # elevation above the geoid of level ground
BLOCK_M = 62.0  # between the centres of houses
ROOFS_M = (8.0, 12.0, 25.0, 40.0, 90.0)
STREETS_M = np.arange(BLOCK_M / 2 - MARGIN_M / 4, SIDE_M, BLOCK_M)[1:]  # between houses
NUM_THINGS, BY_CELLS = 20, " by cells"
THINGS = ("things 1", "things 2", "things 3")  # names of worlds
TO_LONLAT = pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
SCENARIO = """
[region]
bounds = {bounds}
crs = "{crs}"
resolution_m = {resolutions_m}
altitudes_m = [{lowest_m}, {highest_m}]
[buildings]
source = "buildings.geojson"
hanging = "slabs"
{terrain}
[gps]
times = ["2020-04-27T16:00:00Z"]
[lidar]
beams = 1
azimuths = 8
range_m = 10.0
[risk]
threshold_m = 10.0
"""
RunMaps = Callable[[Path, Path], None]  # makes the maps of a scenario's file in a folder


@dataclass(frozen=True, eq=False)
class World:
    """A world as its files have it. ``B`` buildings, places in metres from its southwest corner.

    Attributes:
      name: of the world.
      folder: of the maps.
      resolution_m: of the maps that count.
      outlines: ``[B]`` polygons.
      floor_m, top_m: ``[B]`` heights above the ground that they reach from and to; -inf for what stands.
      terrain_m: ``[Y, X]`` elevation of the pixels' centres from the southwest; None on level ground.
      has_files: the files are still there, so that exact outlines count.
      things: what stands at crossings, the last of the ``B``.
    """

    name: str
    folder: Path
    resolution_m: float
    outlines: np.ndarray
    floor_m: np.ndarray
    top_m: np.ndarray
    terrain_m: np.ndarray | None = None
    has_files: bool = True
    things: tuple[plant.Thing, ...] = ()

    @property
    def num_houses(self) -> int:
        """The number of buildings, which come first."""
        return len(self.outlines) - sum(len(thing.core) for thing in self.things)

    def ground_m(self, x_m, y_m) -> np.ndarray:
        """Return the elevation of the ground above the geoid, bilinear between the centres of the file's pixels."""
        if self.terrain_m is None:
            return np.full(np.shape(x_m), LEVEL_M)
        y_at, x_at = (_centres_m(size) for size in self.terrain_m.shape)
        ground_m = RegularGridInterpolator((y_at, x_at), self.terrain_m)(
            np.stack([y_m, x_m], axis=-1)
        )
        return ground_m.reshape(np.shape(x_m))

    def lonlat(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return longitude and latitude of a place."""
        return TO_LONLAT.transform(x_m + CORNER_M[0], y_m + CORNER_M[1])

    def xy_m(self, lon, lat) -> np.ndarray:
        """Return ``[..., 2]`` the place of longitude and latitude."""
        xy_m = TO_LONLAT.transform(lon, lat, direction="INVERSE")
        return np.stack(xy_m, axis=-1) - CORNER_M


def _centres_m(num_pixels: int) -> np.ndarray:
    """Return the places of pixels' centres along one side."""
    return (np.arange(num_pixels) + 0.5) * PIXEL_M - MARGIN_M


def hills_m(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    """Return the elevation of hills, with ridges that cells of 20 m cannot show."""
    broad_m = 40 + 14 * np.sin(x_m / 47) + 9 * np.cos(y_m / 39)
    return broad_m + 4 * np.sin((x_m + 0.6 * y_m) / 13)


def buildings(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return outlines of houses, towers, walls and slabs in any direction, their floors and their tops."""
    outlines, floors_m, tops_m = [], [], []
    centres_m = np.arange(-MARGIN_M / 4, SIDE_M + MARGIN_M / 4, BLOCK_M)
    for number, (x_m, y_m) in enumerate(
        np.stack(np.meshgrid(centres_m, centres_m), -1).reshape(-1, 2)
    ):
        is_wall = number % 5 == 2
        is_slab = number % 7 == 3 and not is_wall
        width_m, depth_m = (30.0, 0.5) if is_wall else rng.uniform(10, 28, 2)
        box = shapely.box(-width_m / 2, -depth_m / 2, width_m / 2, depth_m / 2)
        turned = shapely.affinity.rotate(box, rng.uniform(0, 180), origin=(0, 0))
        outlines.append(shapely.affinity.translate(turned, x_m, y_m))
        floors_m.append(rng.choice([6.0, 20.0]) if is_slab else -np.inf)
        tops_m.append(floors_m[-1] + 8.0 if is_slab else rng.choice(ROOFS_M))
    return np.array(outlines), np.array(floors_m), np.array(tops_m)


def write_buildings(file: Path, world: World) -> None:
    """Write the buildings of a world as GeoJSON."""
    features = []
    records = [record for thing in world.things for record in thing.records]
    kind = {"building": "yes"} if records else {}  # which else all are
    for index in range(world.num_houses):
        floor_m, top_m = world.floor_m[index], world.top_m[index]
        about = {"height": top_m} | ({"min_height": floor_m} if floor_m > 0 else {}) | kind
        records.append(plant.Record(world.outlines[index], about))
    for record in records:
        placed = shapely.transform(record.shape, world.lonlat, interleaved=False)
        shape = shapely.geometry.mapping(placed)
        features.append({"type": "Feature", "properties": record.tags, "geometry": shape})
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))


def write_terrain(file: Path, world: World) -> None:
    """Write the terrain of a world as a GeoTIFF."""
    num_rows, num_cols = world.terrain_m.shape
    west_m, south_m = np.subtract(CORNER_M, MARGIN_M)
    transform = rasterio.Affine(PIXEL_M, 0, west_m, 0, -PIXEL_M, south_m + num_rows * PIXEL_M)
    form = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": CRS, "transform": transform}
    with rasterio.open(file, "w", width=num_cols, height=num_rows, **form) as raster:
        raster.write(world.terrain_m[::-1].astype(np.float32), 1)


def with_things(name: str, folder: Path) -> World:
    """Return a world of a name of `THINGS` with things at crossings, as OpenStreetMap's extracts have them."""
    draw = plant.Draw(np.random.default_rng([*name.encode()]))
    crossings = np.stack(np.meshgrid(STREETS_M, STREETS_M), axis=-1).reshape(-1, 2)
    things = []
    for centre_m in draw.rng.permutation(crossings):
        draw.centre_m = tuple(centre_m)
        thing = plant.plant(draw, draw.one_of(*FROM_EXTRACTS[:3]))
        if thing.core or draw.one_of(True, False, False):
            things.append(thing)
    things = tuple(things[:NUM_THINGS])
    outlines, floor_m, top_m = buildings(draw.rng)
    prisms = [prism for thing in things for prism in thing.core]
    return World(
        name,
        folder,
        5.0,
        np.append(outlines, [prism.outline for prism in prisms]),
        np.append(floor_m, [prism.floor_m for prism in prisms]),
        np.append(top_m, [prism.top_m for prism in prisms]),
        things=things,
    )


def worlds_in(folder: Path) -> dict[str, World]:
    """Return worlds by name, whose files and maps are in a folder: ``flat``, ``gone``, ``hills``, ``coarse`` and more.

    ``gone`` is the flat one after its files were lost, so that its buildings are cells; ``coarse`` is the hills by
    maps of 20 m. Those of `THINGS` are flat and have things beside houses; by cells their files are lost as well.
    """
    parts = buildings(np.random.default_rng(46))
    centres_m = _centres_m(int((SIDE_M + 2 * MARGIN_M) / PIXEL_M))
    terrain_m = hills_m(*np.meshgrid(centres_m, centres_m)).astype(np.float32).astype(float)
    flat, gone, hills = (folder / name / "maps" for name in ("flat", "gone", "hills"))
    worlds = (
        World("flat", flat, 5.0, *parts),
        World("gone", gone, 5.0, *parts, has_files=False),
        World("hills", hills, 5.0, *parts, terrain_m),
        World("coarse", hills, 20.0, *parts, terrain_m),
    )
    named = {world.name: world for world in worlds}
    for name in THINGS:
        home = folder / name.replace(" ", "_")
        named[name] = world = with_things(name, home / "maps")
        by_cells = {"name": name + BY_CELLS, "folder": home / "lost" / "maps", "has_files": False}
        named[name + BY_CELLS] = replace(world, **by_cells)
    return named


def make_worlds(folder: Path, run_maps: RunMaps) -> dict[str, World]:
    """Make the files and the maps of `worlds_in` a folder, and return the worlds."""
    worlds = worlds_in(folder)
    resolutions_m = {"hills": [5.0, 20.0]}
    for name in ("flat", "hills", *THINGS):
        world = worlds[name]
        home = world.folder.parent
        home.mkdir(parents=True)
        write_buildings(home / "buildings.geojson", world)
        terrain = ""
        if world.terrain_m is not None:
            write_terrain(home / "terrain.tif", world)
            terrain = '[terrain]\nsource = "terrain.tif"'
        text = SCENARIO.format(
            bounds=[*world.lonlat(0.0, 0.0), *world.lonlat(SIDE_M, SIDE_M)],
            crs=CRS,
            resolutions_m=resolutions_m.get(name, [5.0]),
            lowest_m=LOWEST_M,
            highest_m=HIGHEST_M,
            terrain=terrain,
        )
        (home / "scenario.toml").write_text(text)
        run_maps(home / "scenario.toml", world.folder)
    shutil.copytree(worlds["flat"].folder, worlds["gone"].folder)
    for name in THINGS:
        shutil.copytree(worlds[name].folder, worlds[name + BY_CELLS].folder)
    return worlds
