"""What every public argument with a default does: calls on a small town, a value of each, or why none can show."""

import functools
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import jax
import numpy as np
import pandas as pd
import rasterio
import shapely
import xarray as xr

import jaxurban as ju
from jaxurban.maps.run import run_scenario
from jaxurban.typing import CostMap, Demonstration, Departures, PlannedPath, PlannedPaths
from tests.cli_runs import TOWN

NOON, LATER = "2020-04-27T16:00:00Z", "2020-04-27T21:00:00Z"
TIMES = f"""
[gps]
times = ["{NOON}", "{LATER}"]
mask_deg = 25
"""
CORNER = (-74.0, 40.755)
BOX = (-74.0, 40.755, -73.998, 40.757)
START, GOAL = (-73.997655, 40.755599), (-73.992836, 40.760962)  # in a building, and in a street
FREE, BETWEEN = (-73.99411, 40.755028), (-73.994532, 40.758455)
NOT_COMPARED = {  # how long a call took and where it wrote, of results
    *("elapsed_s", "setup_s", "folder", "cache", "mtime", "file", "batches", "history"),
    *("sources", "num_threads", "created", "version"),
}


@dataclass(frozen=True)
class Case:
    """A value of an argument, and beside which other arguments it must count.

    Attributes:
      value: other than the default; a function makes it when it is needed.
      beside: further arguments of both calls.
      refused: a part of the error, where the value is refused; None: the results must differ.
    """

    value: Any
    beside: Mapping[str, Any] = field(default_factory=dict)
    refused: str | None = None


@dataclass(frozen=True)
class Same:
    """Why no result can show the argument."""

    reason: str


PROGRESS = Same("it shows how far a call is, and no result holds that")
WORKERS = Same("any number of processes gives the same rows")
ENGINE = Same("either engine makes the same maps, to the bit on a CPU")


@functools.cache
def home() -> Path:
    """Return a folder with the town's scenario, its maps at 20 m and 40 m, and files of a few real buildings."""
    folder = Path(tempfile.mkdtemp())
    town = TOWN.replace("= 20\n", "= [20, 40]\n") + TIMES
    (folder / "town.toml").write_text(town, encoding="utf-8")
    run_scenario(ju.Scenario.from_toml(folder / "town.toml"), folder / "maps", progress=False)

    # Four buildings: of a known height, of levels, of nothing, and one that hangs.
    sides = [(0.0002 + 0.0004 * number, 0.0005, 0.0003) for number in range(4)]
    boxes = [shapely.box(*np.add([x, y, x + side, y + side], CORNER * 2)) for x, y, side in sides]
    tags = {"height": ["40", None, None, "30"], "building:levels": [None, "7", None, None]}
    tags["min_height"] = [None, None, None, "15"]
    gpd.GeoDataFrame(tags, geometry=boxes, crs="EPSG:4326").to_file(folder / "few.geojson")

    # Two blocks, their table and districts; two rasters of people; the ground.
    west, south, east, north = BOX
    middle = (west + east) / 2
    halves = [shapely.box(west, south, middle, north), shapely.box(middle, south, east, north)]
    ids = {"GEOID10": ["360610001001000", "360610001001001"], "other_id": ["1", "2"]}
    blocks = gpd.GeoDataFrame(ids | {"pop10": [10, 50]}, geometry=halves, crs="EPSG:4326")
    blocks.to_file(folder / "blocks.geojson")
    codes = {"BoroCD": [101, 110], "zone": [110, 101]}
    districts = gpd.GeoDataFrame(codes, geometry=halves, crs="EPSG:4326")
    districts.to_file(folder / "districts.geojson")
    pd.DataFrame({"GEOID10": ids["GEOID10"], "pop10": [70, 5]}).to_csv(
        folder / "table.csv", index=False
    )
    pd.DataFrame({"id": ids["other_id"], "pop10": [7, 5]}).to_csv(folder / "other.csv", index=False)
    for name, values in {
        "day.tif": [[9.0, 1.0], [2.0, 7.0]],
        "night.tif": [[1.0, 2.0], [30.0, 4.0]],
        "ground.tif": [[5.0, 9.0], [5.0, 90.0]],
        "canopy.tif": [[0.0, 0.0], [30.0, 0.0]],
    }.items():
        wide = 0.05 if name == "ground.tif" else 0.0
        side = (east - west) / 2 + wide
        transform = rasterio.Affine(side, 0, west - wide, 0, -side, north + wide)
        with rasterio.open(
            folder / name, "w", "GTiff", 2, 2, 1, "EPSG:4326", transform, "float32"
        ) as file:
            file.write(np.array(values, np.float32), 1)

    # Maps of the few buildings, whose file their record names, and a zone in the town.
    few = {"region": {"bounds": BOX, "resolution_m": 20.0, "altitudes_m": [20.0, 60.0]}}
    few |= {"buildings": {"source": "few.geojson"}}
    run_scenario(ju.Scenario.from_dict(few, folder=folder), folder / "few", progress=False)
    zone = shapely.Point(-73.993595, 40.757726).buffer(0.0004)
    gpd.GeoDataFrame(geometry=[zone], crs="EPSG:4326").to_file(folder / "zone.geojson")
    return folder


@functools.cache
def maps() -> ju.MetricMaps:
    return ju.open_maps(home() / "maps", 20.0)


@functools.cache
def few_levels() -> ju.MetricMaps:
    """Return maps of the same town at one altitude, small enough for studies."""
    return ju.MetricMaps(maps().ds.isel(altitude=slice(1, 2)))


@functools.cache
def city() -> ju.City:
    return ju.demo_city(400, 400)


@functools.cache
def path() -> PlannedPath:
    """Return a path that a mission can fly, from the ground to the ground."""
    return ju.plan(maps(), START, GOAL, altitude_m=20.0, snap=True, on_ground=True)


@functools.cache
def on() -> CostMap:
    return ju.cost_map(maps(), 20.0)


@functools.cache
def instances() -> pd.DataFrame:
    return ju.studies.sample_instances(maps(), 3, weights=[ju.Weights(risk=5.0)], seed=1)


@functools.cache
def routes() -> list[Demonstration]:
    return ju.fit.demonstrations(instances(), maps(), altitude_m=60.0)


def outcome(call: Callable[[], Any]) -> tuple[str, Any]:
    """Return what a call gives as plain values, or the error that it ends in."""
    try:
        result = call()
    except ju.InputError as error:
        return "error", str(error)
    return "result", plain(result)


def plain(value: Any, depth: int = 0) -> Any:
    """Return a result as values that can be compared: arrays as bytes, tables as text, without what took how long."""
    if depth > 12 or (callable(value) and not is_dataclass(value)):
        return None
    if isinstance(value, ju.MetricMaps):
        return plain(value.ds, depth + 1), value.rule
    if isinstance(value, xr.Dataset):
        return plain({**value.variables, **value.attrs}, depth + 1)
    if isinstance(value, np.ndarray | jax.Array | xr.Variable):
        values = np.asarray(value)
        return str(values.tolist()) if values.dtype == object else (values.shape, values.tobytes())
    if isinstance(value, pd.DataFrame | pd.Series):
        table = value.to_frame() if isinstance(value, pd.Series) else value
        return table.drop(columns=[name for name in table if name in NOT_COMPARED]).to_csv()
    if isinstance(value, Mapping):
        return {
            str(key): plain(each, depth + 1)
            for key, each in value.items()
            if str(key) not in NOT_COMPARED
        }
    if is_dataclass(value):
        return plain({item.name: getattr(value, item.name) for item in fields(value)}, depth + 1)
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each, depth + 1) for each in value]
    if isinstance(value, Path):
        return value.read_bytes() if value.is_file() else value.name
    return repr(value)


def a_file(name: str) -> Path:
    return Path(tempfile.mkdtemp()) / name


def made(**given: Any) -> ju.MetricMaps:
    """Return maps of a piece of the made-up city."""
    usual: dict[str, Any] = {"resolution_m": 50.0, "altitudes_m": (20.0,), "progress": False}
    return ju.build_maps(city(), **usual | given)


def read(buildings: Any = None, **given: Any) -> tuple[ju.City, ju.MetricMaps]:
    """Return the city of a few real buildings and its maps."""
    usual: dict[str, Any] = {"bounds": BOX}
    of = ju.City.from_files(buildings or home() / "few.geojson", **usual | given)
    return of, ju.build_maps(of, resolution_m=20.0, altitudes_m=(10.0,), progress=False)


def planned(**given: Any) -> PlannedPath:
    usual: dict[str, Any] = {"start": START, "goal": GOAL, "altitude_m": 20.0, "snap": True}
    usual |= {"budget_s": 60.0}
    return ju.plan(given.pop("maps", maps()), **usual | given)


def with_limits(**given: Any) -> PlannedPath:
    return planned(constraints=ju.Constraints(**given))


def flown(**given: Any) -> Any:
    """Return what is said of a climb for a vehicle."""
    vehicle = ju.Vehicle(**given)
    climb = planned(
        altitude_m=ju.Levels(),
        goal=(*GOAL, 60.0),
        start=(*START, 20.0),
        constraints=ju.Constraints(vehicle=vehicle),
    )
    return climb, ju.explain(climb, maps())


def under(**planning: Any) -> PlannedPath:
    """Return a path over maps whose scenario has a section of planning."""
    recorded = {"planning": vars(ju.Planning(**planning))}
    return ju.plan(maps().with_recorded(recorded), START, GOAL, altitude_m=20.0, snap=True)


def layered(source: Any = None, **given: Any) -> ju.MetricMaps:
    grid = made_grid()
    values = np.arange(float(np.prod(grid.shape))).reshape(grid.shape)
    layer = ju.Layer(values if source is None else source, "high-is-bad", (0.0, 100.0), **given)
    return made(layers={"noise": layer}, altitudes_m=(20.0, 60.0))


@functools.cache
def made_grid() -> ju.Grid:
    return made().grid


def soft(params: ju.grad.SoftParams, **given: Any) -> Any:
    made_soft = ju.grad.soft_city(city(), made_grid(), params, **given)
    return made_soft.names, made_soft.layers(made_soft.height_m, params)


def many(**given: Any) -> PlannedPaths:
    usual: dict[str, Any] = {"altitude_m": 20.0, "snap": True, "progress": False, "budget_s": 60.0}
    queries = given.pop("queries", [(START, GOAL), (GOAL, START)])
    return ju.plan_many(maps(), queries, **usual | given)


def at_times(**given: Any) -> Departures:
    usual: dict[str, Any] = {"altitude_m": 20.0, "snap": True, "progress": False, "budget_s": 60.0}
    return ju.when(maps(), [(START, GOAL)], **usual | given)


def a_study(instances_: Any = None, **given: Any) -> Any:
    usual: dict[str, Any] = {"progress": False, "instances": 2}
    if isinstance(given.get("settings"), dict):
        given["settings"] = ju.studies.Study(**given["settings"])
    usual["settings"] = ju.studies.Study(planners="astar-plus", budget_s=60.0)
    return ju.studies.study(few_levels(), a_file("study"), **usual | given)


def of_study(**given: Any) -> Any:
    usual: dict[str, Any] = {"planners": "astar-plus", "instances": 2, "budget_s": 60.0}
    return ju.studies.study(
        maps(), a_file("study"), settings=ju.studies.Study(**usual | given), progress=False
    )


def weights_study(**given: Any) -> Any:
    usual: dict[str, Any] = {"progress": False, "routes": 2, "altitudes_m": [60.0]}
    quick = ju.studies.SensitivitySettings(vary=("gps",))
    sources = given.pop("sources", {"town": maps()})
    return ju.studies.sensitivity(sources, a_file("weights"), **usual | {"settings": quick} | given)


def of_weights_study(**given: Any) -> Any:
    usual: dict[str, Any] = {"vary": ("gps",)}
    result = weights_study(
        routes=[(START, GOAL)],
        altitudes_m=[20.0],
        snap=True,
        settings=ju.studies.SensitivitySettings(**usual | given),
        sources={"town": ju.studies.MapsFolder(home() / "maps", 20.0)},
    )
    return result.settings, result.tables


def checked(mission: Path | None = None, **given: Any) -> Any:
    result = ju.check(given.pop("maps", maps()), mission or a_mission(".plan"), **given)
    said = result.not_judged, result.return_lines
    return result.findings, said, result.figures, result.limits


def returned(**given: Any) -> Any:
    home = ju.return_altitude(maps(), **given)
    return home.altitude_m, home.figures


@functools.cache
def a_mission(suffix: str) -> Path:
    if suffix != ".kml":
        return path().save(a_file(f"mission{suffix}"))
    west, south = START
    line = f"{west},{south},70 {GOAL[0]},{GOAL[1]},70"
    file = a_file("line.kml")
    file.write_text(
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><LineString>'
        f"<coordinates>{line}</coordinates></LineString></Placemark></Document></kml>"
    )
    return file


def fitted(**given: Any) -> Any:
    settings = ju.fit.FitSettings(**{"max_rounds": 2, **given})
    return ju.fit.fit_weights(routes(), bootstrap=0, settings=settings)


def without_times(file: Path) -> str:
    """Return the text of a file that a command wrote, of a table without its columns of times."""
    if file.suffix != ".csv" or not file.read_text().strip():
        return file.read_text()
    return plain(pd.read_csv(file))
