"""The city that the benchmarks fly over: Lower Manhattan where the real data are at hand, else the embedded one."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from jaxurban.build import make_surface, view_sky
from jaxurban.city import City
from jaxurban.demo import demo_city_for_bounds
from jaxurban.grid import Grid
from jaxurban.io.buildings import read_buildings
from jaxurban.layers import MapParams
from jaxurban.surface import Surface

DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data"))
OSM, ORBITS = DATA / "osm" / "lower-manhattan.osm.pbf", DATA / "gps" / "gps-ops_2020-04-27.tle"
BOUNDS, CRS, REFERENCE = (-74.02, 40.70, -73.98, 40.73), "EPSG:32618", (-74.0, 40.715)
TIME = "2020-04-27T16:00:00Z"
MASK_DEG = 5.0
ALTITUDES_M = (20.0, 60.0, 122.0)
REACH_M = 2000.0  # the real buildings end about here
PARAMS = MapParams(altitudes_m=ALTITUDES_M, mask_deg=MASK_DEG)


@dataclass(frozen=True)
class Scene:
    """A city and a sky. ``S`` satellites above the mask."""

    name: str
    city: City
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray

    def region(self, resolution_m: float) -> Grid:
        return Grid.from_bounds(BOUNDS, resolution_m, CRS, nest_with_m=(2, 5, 10))

    def sky(self, resolution_m: float = 5.0):
        return view_sky(
            self.region(resolution_m),
            ORBITS if ORBITS.exists() else "nominal",
            [TIME],
            mask_deg=MASK_DEG,
            reference=REFERENCE,
            max_age_days=90,
        )

    def surface(self, resolution_m: float) -> Surface:
        return make_surface(self.city, self.region(resolution_m), self.sky(resolution_m), PARAMS)


def load_scene() -> Scene:
    """Return Lower Manhattan, or the embedded city in its box where the real files are missing."""
    if OSM.exists():
        extent_m = Grid.from_bounds(BOUNDS, 10.0, CRS).padded(*(int(REACH_M / 10),) * 4).bounds_m
        name, city = "Lower Manhattan", City(CRS, extent_m, buildings=read_buildings(OSM, CRS).buildings)
    else:
        name, city = "embedded city (no real data found)", demo_city_for_bounds(BOUNDS, CRS)
    scene = Scene(name, city, np.empty(0), np.empty(0))
    sky = scene.sky()
    return Scene(name, city, sky.azimuth_rad[0], sky.elevation_rad[0])
