"""The cities that the benchmarks fly over: those whose real data are at hand, and the synthetic one."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from jaxurban.cities.city import read_buildings
from jaxurban.cities.synthetic import demo_city_for_bounds
from jaxurban.io.city import City
from jaxurban.maps.build import view_sky
from jaxurban.maps.params import MapParams
from jaxurban.maps.task import MapTask
from jaxurban.metrics.gps import Gps
from jaxurban.settings import Buildings
from jaxurban.world.grid import Bounds, Grid
from jaxurban.world.sky import Sky
from jaxurban.world.surface import Surface

DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data"))
OSM, ORBITS = DATA / "osm" / "lower-manhattan.osm.pbf", DATA / "gps" / "gps-ops_2020-04-27.tle"
BOUNDS, CRS, REFERENCE = (-74.02, 40.70, -73.98, 40.73), "EPSG:32618", (-74.0, 40.715)
TIME = "2020-04-27T16:00:00Z"
MASK_DEG = 5.0
ALTITUDES_M = (20.0, 60.0, 122.0)
REACH_M = 2000.0  # the real buildings of Lower Manhattan end about here
PARAMS = MapParams(altitudes_m=ALTITUDES_M, sections={"gps": Gps(mask_deg=MASK_DEG)})


@dataclass(frozen=True)
class Place:
    """Where a city's buildings and its sky come from; ``buildings`` is None for the synthetic city."""

    name: str
    buildings: Path | None = None
    bounds: Bounds = BOUNDS
    crs: str = CRS
    reference: tuple[float, float] = REFERENCE
    orbits: Path = ORBITS
    time: str = TIME

    @property
    def is_here(self) -> bool:
        return self.buildings is None or self.buildings.exists()


MANHATTAN = Place("Lower Manhattan", OSM)
SYNTHETIC = Place("synthetic city")
TOKYO = Place(
    "Tokyo (Shinjuku)",
    DATA / "tokyo" / "tokyo-central-lod2.parquet",
    (139.69, 35.685, 139.71, 35.70),
    "EPSG:32654",
    (139.70, 35.6925),
    DATA / "tokyo" / "gps_2018-12-19.tle",
    "2018-12-19T06:20:00Z",
)
PLACES = {"manhattan": MANHATTAN, "tokyo": TOKYO, "synthetic": SYNTHETIC}


@dataclass(frozen=True)
class Scene:
    """A city and a sky. ``S`` satellites above the mask."""

    name: str
    city: City
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    place: Place = MANHATTAN

    def region(self, resolution_m: float) -> Grid:
        return Grid.from_bounds(
            self.place.bounds, resolution_m, self.place.crs, nest_with_m=(2, 5, 10)
        )

    def sky(self, resolution_m: float = 5.0) -> Sky:
        return view_sky(
            self.region(resolution_m),
            Gps(
                orbits=self.place.orbits if self.place.orbits.exists() else "nominal",
                times=[self.place.time],
                mask_deg=MASK_DEG,
                reference=self.place.reference,
            ),
        )

    def task(self, resolution_m: float) -> MapTask:
        return MapTask(self.city, self.region(resolution_m), self.sky(resolution_m), PARAMS)

    def surface(self, resolution_m: float) -> Surface:
        return self.task(resolution_m).surface()


def load_place(place: Place) -> Scene:
    """Return a city whose files are at hand, its real buildings as far as ``REACH_M`` around the box."""
    if place.buildings is None:
        city = demo_city_for_bounds(place.bounds, place.crs)
    else:
        extent_m = (
            Grid.from_bounds(place.bounds, 10.0, place.crs)
            .padded(*(int(REACH_M / 10),) * 4)
            .bounds_m
        )
        source = read_buildings(Buildings(place.buildings), place.crs, bounds_m=extent_m)
        city = City(place.crs, extent_m, buildings=source.buildings)
    scene = Scene(place.name, city, np.empty(0), np.empty(0), place)
    sky = scene.sky()
    return Scene(place.name, city, sky.azimuth_rad[0], sky.elevation_rad[0], place)


def load_scene() -> Scene:
    """Return Lower Manhattan, or the synthetic city in its box where the real files are missing."""
    return load_place(MANHATTAN if MANHATTAN.is_here else SYNTHETIC)
