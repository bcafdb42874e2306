"""jaxurban info."""

import json
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jaxurban.errors import InputError
from jaxurban.io.samples import located
from jaxurban.io.sniff import LIDAR, sniff
from jaxurban.io.stored import (
    GEOTIFF_FOLDER,
    OF_ZARR,
    REPORT_FILE,
    RUN_FILE,
    ZARR_FOLDER,
    folders_of_maps,
    short_number,
    stored_maps,
    stored_resolutions,
    unfinished_said,
)
from jaxurban.knowledge import names_of, shown_rule
from jaxurban.public import listed
from jaxurban.terminal.common import GIVEN, JSON_FLAG, LONLAT, Point, Settings, print_json
from jaxurban.terminal.options import command

if TYPE_CHECKING:
    from jaxurban.io.city import City
    from jaxurban.io.zone import Zone
    from jaxurban.maps.metric_maps import MetricMaps

MOST_BYTES = 2**30  # of any other file than of buildings or a raster: most are read whole
DRAWN = (".geojson", ".geojsonl", ".kml")  # of outlines that may be zones
MISSIONS = (".plan", ".waypoints", ".kmz", ".wpml", ".ulg", ".bin", ".tlog")  # and nothing else


@command()
@click.argument("path", metavar="FILE|DIR", type=GIVEN)
@click.option("--at", "place", type=LONLAT, help="Say what stands at a place, and why.")
@JSON_FLAG
def info_command(path: Path, place: Point | None, as_json: bool) -> None:
    """Say what a file or a folder of maps holds.

    Of a folder of several folders of maps it says how far each is. FILE is of buildings, or a raster: printed are
    extent, CRS, counts and guessed heights. Of a mission, a receiver's log, a track, orbits, zones, a scenario, or what
    another command wrote, it says in a line what it holds, and what reads it; of the folder of a report it says the
    title. With --at, longitude,latitude in degrees, it says what stands there by a file of buildings, or by the files
    of maps: kind, rule, height and bound.
    """
    path = _folder_of(path)
    has_maps = any((path / name).exists() for name in (ZARR_FOLDER, RUN_FILE))
    if place is not None:
        things = _city_of(path, has_maps).why(*place)
        if as_json:
            rows = json.loads(things.to_json(orient="records"))  # null where nothing is known
            print_json({"stands": things.columns.name, "numbers": rows})
        elif len(things):
            things["rule"] = things["rule"].map(shown_rule)
            print(things.T.to_string(header=False))
        else:
            print(things.columns.name)
        return
    folders = folders_of_maps(path)
    if has_maps:
        facts, numbers = _facts_of_maps(path)
    elif (path / REPORT_FILE).is_file():
        title = (path / REPORT_FILE).read_text(encoding="utf-8").partition("\n")[0]
        facts = {"holds": f"a report, {title.lstrip('# ')!r}: read {str(path / REPORT_FILE)!r}"}
        numbers = []
    elif folders:
        facts = {folder.name: _state_of(folder) for folder in folders}
        numbers = []
    else:
        file = located(path)
        written = _line_of_written(file)
        try:
            facts, file_numbers = ({"holds": written}, {}) if written else _facts_of_file(file)
        except InputError as error:
            facts, file_numbers = {"holds": _line_of_other(file, error)}, {}
        numbers = [file_numbers]
    if as_json:
        print_json(facts | {"numbers": numbers})
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        print(f"{name:{width}}  {value}")


def _city_of(path: Path, has_maps: bool = False) -> "City":
    """Return the city in a file of buildings or heights, or of maps in a folder, whose files are read again.

    What is guessed is no warning here, as it is said of each thing.

    Raises:
      InputError: a city that cannot be read.
    """
    from jaxurban.io.city import City
    from jaxurban.maps.run import load_city
    from jaxurban.maps.sources import scenario_of
    from jaxurban.settings import Buildings

    with warnings.catch_warnings(action="ignore", category=UserWarning):
        if has_maps:
            return load_city(scenario_of(path))
        return City.from_files(Buildings(path, allow=("none",)))


def _folder_of(path: Path) -> Path:
    """Return the folder of maps that a folder within it belongs to; any other path as it is."""
    for folder in (path, path.parent):
        if folder.name in (ZARR_FOLDER, GEOTIFF_FOLDER) and (folder.parent / ZARR_FOLDER).is_dir():
            return folder.parent if path.is_dir() else path
    return path


def _line_of_written(path: Path) -> str:
    """Return what a report, a Zarr, a layer of maps or a file of zones holds, and what reads it; else ``""``."""
    if path.is_dir():
        is_zarr = any((path / name).is_file() for name in OF_ZARR)
        return f"a Zarr: xarray.open_zarr({str(path)!r}) reads it" if is_zarr else ""
    if path.suffix.lower() == ".tif":
        return _line_of_layer(path)
    return _line_of_zones(path) if path.is_file() else ""


def _line_of_layer(file: Path) -> str:
    """Return what a GeoTIFF holds that maps were written to, by its tags; ``""`` of any other raster."""
    import rasterio

    with suppress(rasterio.errors.RasterioIOError), rasterio.open(file) as layer:
        if "metric" in layer.tags():
            cells = f"{layer.height:,} x {layer.width:,} cells in {layer.crs}"
            return f"a map of {layer.descriptions[0]} ({cells}): QGIS and rasterio read it"
    return ""


def _line_of_zones(file: Path) -> str:
    """Return which zones a file holds that names their limits, and what reads it; ``""`` of any other file."""
    from jaxurban.flights.airspace import is_of_zones, read_zones

    zones: Sequence[Zone] = ()
    if is_of_zones(file):
        with warnings.catch_warnings(action="ignore", category=UserWarning), suppress(InputError):
            zones = read_zones(file)
    if not zones:
        return ""
    counts = Counter(zone.state for zone in zones)
    states = ", ".join(f"{num} {state}" for state, num in counts.items())
    names = listed([f"{zone.name!r} {zone.heights}" for zone in zones])
    return f"no-fly zones ({states}: {names}): jaxurban plan DIR --no-fly {str(file)!r}"


def _state_of(folder: Path) -> str:
    """Return of which resolutions a folder holds maps, and how far those are that are not finished."""
    listed = ", ".join(f"{short_number(each)} m" for each in stored_resolutions(folder))
    unfinished = unfinished_said(folder)
    return f"unfinished maps: {unfinished}" if unfinished else f"maps of {listed}"


def _facts_of_maps(folder: Path) -> tuple[Settings, list[Settings]]:
    """Return what to print of the maps in a folder, by name, and the same as numbers and lists, per resolution.

    Where the folder holds several resolutions each name begins with its own.
    """
    from jaxurban.maps.saving import open_maps
    from jaxurban.world.grid import WGS84, transformer

    facts: Settings = {}
    numbers: list[Settings] = []
    unfinished = unfinished_said(folder)
    if unfinished:
        return {"unfinished": unfinished}, numbers
    resolutions_m = list(stored_maps(folder))
    for resolution_m in resolutions_m:
        maps = open_maps(folder, resolution_m)
        grid = maps.grid
        bounds = transformer(grid.crs, WGS84).transform_bounds(*grid.bounds_m)
        guesses = names_of(maps.guesses) or "none"
        prefix = f"{short_number(resolution_m)} m: " if len(resolutions_m) > 1 else ""
        of_maps = {**_closed(maps), "bounds": _rounded(bounds), **maps.facts, "guesses": guesses}
        facts |= {prefix + name: value for name, value in of_maps.items() if value}
        numbers.append(
            {
                "resolution_m": grid.resolution_m,
                "num_rows": grid.num_rows,
                "num_cols": grid.num_cols,
                "altitudes_m": list(maps.altitudes_m),
                "times": list(maps.times),
                "times_of_day": list(maps.times_of_day),
                "metrics": list(maps.metrics),
            }
        )
    return facts, numbers


def _closed(maps: "MetricMaps") -> dict[str, str]:
    """Return what is closed to routes under the maps' own rules: first a note of the lowest altitude, then shares."""
    from jaxurban.paths.closed import causes_at, closed_facts, closed_note
    from jaxurban.paths.plan import rules_on

    if not maps.altitudes_m:
        return {}
    maps, _, limits = rules_on(maps)
    note = closed_note(maps, limits, min(maps.altitudes_m))
    return {"routes": note} | {
        f"closed at {z_m:g} m": closed_facts(causes_at(maps, limits, z_m))["closed"]
        for z_m in maps.altitudes_m
    }


def _rounded(bounds: Iterable[float]) -> list[float]:
    """Return bounds in degrees, to a tenth of a metre."""
    return [round(value, 6) for value in bounds]


def _facts_of_file(file: Path) -> tuple[Settings, Settings]:
    """Return what to print of a file of buildings or a raster, by name, and the same as numbers.

    Raises:
      InputError: a file that cannot be read.
    """
    import numpy as np

    from jaxurban.cities.city import lonlat_extent
    from jaxurban.cities.lidar import read_points
    from jaxurban.cities.raster import RASTER_SUFFIXES, read_raster
    from jaxurban.io.issues import listed_counts
    from jaxurban.world.grid import WGS84

    facts: Settings = {"bounds": _rounded(lonlat_extent(file))}  # as [region] bounds takes them
    has_points = sniff(file) == LIDAR
    if has_points or file.suffix.lower() in RASTER_SUFFIXES:
        if has_points:
            points = read_points(file, "height", None)
            raster = points.highest
            facts["points"] = listed_counts(points.counts)
        else:
            raster = read_raster(file, WGS84)
        num_rows, num_cols = raster.values.shape
        facts |= {"CRS": raster.crs, "cells": f"{num_rows:,} x {num_cols:,}"}
        numbers: Settings = {"num_rows": num_rows, "num_cols": num_cols}

        # The range of the heights, and the share of cells without one.
        known = raster.values[np.isfinite(raster.values)]
        if not known.size:
            return facts | {"values": "none"}, numbers | {"missing_share": 1.0}
        lowest_m = float(known.min())
        highest_m = float(known.max())
        missing_share = 1 - known.size / raster.values.size
        facts["values"] = f"{lowest_m:g} to {highest_m:g} m"
        facts["without a value"] = f"{missing_share:.1%}"
        heights = {"lowest_m": lowest_m, "highest_m": highest_m, "missing_share": missing_share}
        return facts, numbers | heights

    city = _city_of(file)  # what is guessed is among the facts
    facts |= {name: value for name, value in city.facts.items() if value and name != "terrain"}
    if city.buildings is None:
        return facts, {}
    num_by_origin = city.buildings.origin_counts()
    for name, num in num_by_origin.items():
        facts[f"heights by {name}"] = f"{num:,} ({num / len(city.buildings):.1%})"
    if num_by_origin.get("default") == len(city.buildings) and sniff(file) in DRAWN:
        facts["if these are zones"] = f"jaxurban plan DIR --no-fly {str(file)!r}"
    facts["unknown heights"] = "; ".join(f"{name} {each}" for name, each in city.learned.items())
    num_by_name = Counter(() if city.structures is None else city.structures.named.tolist())
    return facts, {
        "num_buildings": len(city.buildings),
        "num_by_height_origin": num_by_origin,
        "num_structures_by_kind": dict(num_by_name),
    }


def _line_of_other(file: Path, error: InputError) -> str:
    """Return what a file holds that is neither of buildings nor a raster, and what reads it.

    Raises:
      InputError: a scenario or a mission that cannot be read; ``error``, why it is none of buildings, if it is no other
        file either.
    """
    from jaxurban.flights.missions.mission import read_mission
    from jaxurban.io.orbits import read_orbits, span_of
    from jaxurban.io.tracks import UTC, read_track
    from jaxurban.maps.scenario import Scenario
    from jaxurban.receivers.log_files import read_log

    if file.stat().st_size > MOST_BYTES:
        raise error
    suffix = file.suffix.lower()
    reason = error
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        if suffix == ".toml":
            region = Scenario.from_toml(file).region
            return f"a scenario of {len(region.altitudes_m)} altitudes: jaxurban maps {str(file)!r} -o OUTPUT"
        with suppress(InputError):
            log = read_log(file)
            times = (read_track(file) if log is None else log)[UTC].dt.floor("s")
            span = f"{times.min():%Y-%m-%dT%H:%M:%SZ} to {times.max():%Y-%m-%dT%H:%M:%SZ}"
            what = f"a log or a track of {times.nunique():,} s, from {span}"
            return f"{what}: jaxurban sky DIR --track {str(file)!r}"
        try:
            satellites = read_orbits(file).satellites
            what = f"orbits of {len(satellites)} satellites from {span_of(satellites)}"
            return f"{what}: [gps] orbits = {str(file)!r} in a scenario"
        except InputError as refusal:
            if isinstance(refusal.__cause__, ImportError):  # of their reader
                raise
        for heights in (None, "ground"):  # which the file says itself, or not
            try:
                mission = read_mission(file, heights=heights)
                return (
                    f"a mission of {mission.num_things:,} items: jaxurban check DIR {str(file)!r}"
                )
            except InputError as refusal:
                reason = reason if heights else refusal
    raise reason if suffix in MISSIONS else error
