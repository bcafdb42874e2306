"""jaxurban info."""

import warnings
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import JSON_FLAG, PATH, print_json
from jaxurban.io.samples import located


@click.command()
@click.argument("path", metavar="FILE|DIR", type=PATH)
@JSON_FLAG
def info(path: Path, as_json: bool) -> None:
    """Say what a file of buildings, a raster or a folder of maps holds: extent, CRS, counts, guessed heights."""
    if path.is_dir():
        facts, numbers = _of_maps(path)
    else:
        facts, of_file = _of_file(located(path))
        numbers = [of_file]
    if as_json:
        print_json(facts | {"numbers": numbers})
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        print(f"{name:{width}}  {value}")


Facts = dict[str, Any]


def _of_maps(folder: Path) -> tuple[Facts, list[Facts]]:
    """Return what to print of each resolution's maps, and the same as numbers and lists."""
    from jaxurban.io.store import short_number, stored_resolutions
    from jaxurban.maps.saving import open_maps

    facts: Facts = {}
    numbers: list[Facts] = []
    resolutions_m: list[Any] = sorted(stored_resolutions(folder)) or [None]
    for resolution_m in resolutions_m:
        maps = open_maps(folder, resolution_m)
        known = {
            "bounds": _bounds_of(maps.grid),
            **maps.facts,
            "guesses": ", ".join(maps.guesses) or "none",
        }
        prefix = f"{short_number(resolution_m)} m: " if len(resolutions_m) > 1 else ""
        facts |= {f"{prefix}{name}": value for name, value in known.items() if value}
        numbers.append(
            {
                "resolution_m": maps.grid.resolution_m,
                "num_rows": maps.grid.num_rows,
                "num_cols": maps.grid.num_cols,
                "altitudes_m": list(maps.altitudes_m),
                "times": list(maps.times),
                "times_of_day": list(maps.times_of_day),
                "metrics": list(maps.metrics),
            }
        )
    return facts, numbers


def _bounds_of(grid: Any) -> list[float]:
    from jaxurban.world.grid import WGS84, transformer

    return [
        round(value, 6) for value in transformer(grid.crs, WGS84).transform_bounds(*grid.bounds_m)
    ]


def _of_file(file: Path) -> tuple[Facts, Facts]:
    """Return what to print of a file of buildings or a raster, and the same as numbers."""
    from jaxurban.io.city import City
    from jaxurban.io.read.city import lonlat_extent
    from jaxurban.io.read.raster import RASTER_SUFFIXES, read_raster
    from jaxurban.settings import Buildings
    from jaxurban.world.footprints import HeightOrigin
    from jaxurban.world.grid import WGS84

    bounds = [round(value, 6) for value in lonlat_extent(file)]
    facts: Facts = {"bounds": bounds}  # as [region] bounds takes them
    if file.suffix.lower() in RASTER_SUFFIXES:
        raster = read_raster(file, WGS84)
        num_rows, num_cols = raster.values.shape
        facts |= {"CRS": raster.crs, "cells": f"{num_rows:,} x {num_cols:,}"}
        values, of_values = _range_of(raster.values)
        return facts | values, {"num_rows": num_rows, "num_cols": num_cols} | of_values
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        city = City.from_files(Buildings(file, allow_none=True))
    facts |= {name: value for name, value in city.facts.items() if value and name != "terrain"}
    if city.buildings is None:
        return facts, {}
    num_by_origin: dict[str, int] = {}
    for origin in HeightOrigin:
        if num := int((city.buildings.origin == origin).sum()):
            name, share = origin.name.lower(), num / len(city.buildings)
            facts[f"heights by {name}"] = f"{num:,} ({share:.1%})"
            num_by_origin[name] = num
    return facts, {"num_buildings": len(city.buildings), "num_by_height_origin": num_by_origin}


def _range_of(values: Any) -> tuple[Facts, Facts]:
    import numpy as np

    known = values[np.isfinite(values)]
    if not known.size:
        return {"values": "none"}, {"missing_share": 1.0}
    lowest_m, highest_m = float(known.min()), float(known.max())
    missing_share = 1 - known.size / values.size
    facts = {
        "values": f"{lowest_m:g} to {highest_m:g} m",
        "without a value": f"{missing_share:.1%}",
    }
    return facts, {
        "lowest_m": lowest_m,
        "highest_m": highest_m,
        "missing_share": missing_share,
    }
