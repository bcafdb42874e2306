"""jaxurban info."""

import warnings
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import JSON_FLAG, PATH, print_json
from jaxurban.samples.catalogue import located


@click.command()
@click.argument("path", metavar="FILE|DIR", type=PATH)
@JSON_FLAG
def info(path: Path, as_json: bool) -> None:
    """Say what a file of buildings, a raster or a folder of maps holds: extent, CRS, counts, guessed heights."""
    facts = _of_maps(path) if path.is_dir() else _of_file(located(path))
    if as_json:
        print_json(facts)
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        print(f"{name:{width}}  {value}")


def _of_maps(folder: Path) -> dict[str, Any]:
    from jaxurban.io.store import short_number, stored_resolutions
    from jaxurban.maps.metric_maps import open_maps

    facts: dict[str, Any] = {}
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
    return facts


def _bounds_of(grid: Any) -> list[float]:
    from jaxurban.world.grid import WGS84, transformer

    return [
        round(value, 6) for value in transformer(grid.crs, WGS84).transform_bounds(*grid.bounds_m)
    ]


def _of_file(file: Path) -> dict[str, Any]:
    from jaxurban.io.read.city import lonlat_extent
    from jaxurban.io.read.raster import RASTER_SUFFIXES, read_raster
    from jaxurban.settings import Buildings
    from jaxurban.world.city import City, HeightOrigin
    from jaxurban.world.grid import WGS84

    bounds = [round(value, 6) for value in lonlat_extent(file)]
    facts: dict[str, Any] = {"bounds": bounds}  # as [region] bounds takes them
    if file.suffix.lower() in RASTER_SUFFIXES:
        raster = read_raster(file, WGS84)
        num_rows, num_cols = raster.values.shape
        return facts | {
            "CRS": raster.crs,
            "cells": f"{num_rows:,} x {num_cols:,}",
            **_range_of(raster.values),
        }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        city = City.from_files(Buildings(file, allow_none=True))
    facts |= {name: value for name, value in city.facts.items() if value and name != "terrain"}
    if city.buildings is not None and len(city.buildings):
        for origin in HeightOrigin:
            if num := int((city.buildings.origin == origin).sum()):
                facts[f"heights by {origin.name.lower()}"] = (
                    f"{num:,} ({num / len(city.buildings):.1%})"
                )
    return facts


def _range_of(values: Any) -> dict[str, str]:
    import numpy as np

    known = values[np.isfinite(values)]
    if not known.size:
        return {"values": "none"}
    return {
        "values": f"{known.min():g} to {known.max():g} m",
        "without a value": f"{1 - known.size / values.size:.1%}",
    }
