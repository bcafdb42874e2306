"""compare: two sets of maps of one place, cell by cell."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from jaxurban.errors import InputError, finite, typed
from jaxurban.io.files import read_json
from jaxurban.io.store import RUN_FILE
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.progress import Progress, reporting
from jaxurban.scenario.differences import Differing, differing
from jaxurban.studies.map_comparison.shared_part import SharedPart, shared_part
from jaxurban.studies.montecarlo.run import MapsFolder
from jaxurban.world.grid import Grid
from jaxurban.world.show import Shown

CLOSED = "closed"  # the layer of cells that no planner enters, beside ``obstacle``, the metrics' rule
MASKS = ("obstacle", CLOSED)
SAME = 1e-6  # values that differ by no more, as on another device, have not changed
QUANTILES = (0.05, 0.5, 0.95)


class Place(NamedTuple):
    """One map of a layer: its altitude, time and time of day, None where the layer does not vary along it."""

    altitude_m: float | None = None
    time: str | None = None
    time_of_day: str | None = None


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Shown):
    """Maps B beside maps A, on the cells, altitudes, times and layers that both hold. ``Y`` rows, ``X`` columns.

    Attributes:
      part: the maps, cut to what they share.
      names: what A and B are called.
      table: a row a layer, altitude, time and time of day: ``cells`` that are free (by the rule of ``obstacle``) and
        hold a number in both, ``mean``, ``median``, ``p05``, ``p95`` and ``rms`` of B - A
        in the layer's ``unit``, ``share_changed``, the share of cells that differ by more than ``tolerance``. Of
        ``obstacle`` and of ``closed`` (cells that no planner enters) the cells are all with data in both; ``gained``
        and ``lost`` count those blocked in B alone and in A alone.
      settings: of the scenarios that made the maps, A's and B's value by dotted key where they differ; None where one
        of them was not made by `jaxurban maps`.
      tolerance: up to which values are the same.
    """

    part: SharedPart
    names: tuple[str, str]
    table: pd.DataFrame
    settings: Differing | None = field(default_factory=dict)
    tolerance: float = SAME

    @property
    def a(self) -> MetricMaps:
        """The maps A, cut to the part that B shares."""
        return self.part.a

    @property
    def b(self) -> MetricMaps:
        """The maps B, cut to the part that A shares; its times are called by A's."""
        return self.part.b

    @property
    def grid(self) -> Grid:
        """The cells that both hold."""
        return self.a.grid

    @property
    def layers(self) -> tuple[str, ...]:
        """The layers that are compared."""
        return layers_of(self.part)

    @property
    def facts(self) -> dict[str, str]:
        """What is compared, and how much of it changed."""
        held = self.a.facts
        facts = {"A": self.names[0], "B": self.names[1]} | {name: held[name] for name in ("grid", "CRS", "altitudes")}
        facts["times"] = ", ".join(
            of_a if of_a == of_b else f"{of_a} of A beside {of_b} of B" for of_a, of_b in self.part.times.items()
        )
        facts["cells changed, at most"] = ", ".join(f"{name} {share:.1%}" for name, share in self.most_changed.items())
        facts["left out"] = ", ".join(self.part.left_out)
        facts["settings that differ"] = ", ".join(self.settings or ())
        return facts

    @property
    def most_changed(self) -> pd.Series:
        """By layer, the largest share of cells that changed in any of its maps."""
        return self.table.groupby("layer", sort=False)["share_changed"].max()

    def places(self, layer: str) -> list[Place]:
        """Return the maps of a layer that are compared."""
        return list(_places(self.part, layer))

    @typed
    def of(
        self, layer: str, altitude_m: float | None = None, *, time: str | None = None, time_of_day: str | None = None
    ) -> np.ndarray:
        """Return ``[Y, X]`` float32 B - A of one map, NaN where either is blocked or holds no number.

        Of ``obstacle`` and ``closed`` 1 where only B is blocked, -1 where only A is, NaN without data. Infinite values
        (dilutions of precision) differ by 0 where both are, else by an infinite number.

        Args:
          layer: one of `layers`.
          altitude_m, time, time_of_day: as in `MetricMaps.m`; the first if left out.

        Raises:
          InputError: no such layer, altitude or time in both.
        """
        if layer not in self.layers:
            raise InputError(f"{layer!r} is not compared: the layers that both hold are {', '.join(self.layers)}")
        wanted = Place(altitude_m, time, time_of_day)._asdict()
        first = self.places(layer)[0]._asdict()
        chosen = {name: held if held is None or wanted[name] is None else wanted[name] for name, held in first.items()}
        return _difference(self.part, layer, Place(**chosen))

    @cached_property
    def difference(self) -> xr.Dataset:
        """B - A of every layer as a dataset along the dims of the maps, all of it in memory (see `of`)."""
        ds, data = self.a.ds, {}
        for layer in self.layers:
            dims = (ALTITUDE, "y", "x") if layer in MASKS else ds[layer].dims
            maps = [_difference(self.part, layer, place) for place in self.places(layer)]
            shape = tuple(ds.sizes[dim] for dim in dims)
            data[layer] = (
                dims,
                np.stack(maps).reshape(shape),
                {"units": unit_of(self.a, layer), "long_name": f"{layer}, B - A"},
            )
        names = {dim for dims, _, _ in data.values() for dim in dims} | {"spatial_ref"}
        coords = {name: ds[name] for name in map(str, ds.coords) if name in names}
        attrs = {name: ds.attrs[name] for name in ("crs", "resolution_m", "first_row", "first_col")}
        return xr.Dataset(data, coords, attrs | {"maps_a": self.names[0], "maps_b": self.names[1]})


@typed
def compare(
    maps_a: GivenMaps | MapsFolder,
    maps_b: GivenMaps | MapsFolder,
    *,
    times: Mapping[str, str] | None = None,
    tolerance: float = SAME,
    progress: Progress = True,
) -> MapComparison:
    """Return how maps B differ from maps A, cell by cell.

    Both must lie on one CRS and resolution; what is compared are the cells, altitudes, times and layers that both hold.

    Args:
      maps_a, maps_b: from `build_maps` or `open_maps`, or folders of one resolution's maps; a `MapsFolder` where a
        folder holds several, or planners are to keep another rule of obstacles.
      times: B's time by A's, to set maps of different times beside each other; left out, the times that both hold, and
        where each holds a single one, these two.
      tolerance: by how much values may differ, in their unit, and have not changed.
      progress: as in `jaxurban.progress.reporting`.

    Raises:
      InputError: maps of another CRS or resolution, that share no cell, altitude, time or layer, or a wrong argument.
    """
    tolerance = finite("tolerance", tolerance)
    if tolerance < 0:
        raise InputError(f"tolerance must not be negative, got {tolerance:g}")
    a, b = (maps.open() if isinstance(maps, MapsFolder) else as_maps(maps) for maps in (maps_a, maps_b))
    part = shared_part(a, b.with_obstacles(b.rule or a.obstacles), times)
    rows: list[dict[str, Any]] = []
    with reporting("compare", progress) as report:
        for number, layer in enumerate(names := layers_of(part)):
            report("layers", number, len(names))
            rows += _rows(part, layer, tolerance)
        report("layers", len(names), len(names))
    names_of = tuple(_name(maps, other) for maps, other in ((maps_a, "A"), (maps_b, "B")))
    held = [_settings(maps) for maps in (maps_a, maps_b)]
    settings = None if held[0] is None or held[1] is None else differing(held[0], held[1])
    return MapComparison(part, (names_of[0], names_of[1]), pd.DataFrame(rows), settings, tolerance)


def layers_of(part: SharedPart) -> tuple[str, ...]:
    """Return the layers that two sets of maps share: blocked cells, the cost's metrics, then the others by name."""
    metrics = [part.a.variable(name) for name in part.a.metrics]
    others = sorted({*map(str, part.a.ds.data_vars)} - {"obstacle", "has_data", *metrics})
    return (*MASKS, *metrics, *others)


def unit_of(maps: MetricMaps, layer: str) -> str:
    """Return the unit of a layer."""
    return "1" if layer == CLOSED else str(maps.ds[layer].attrs.get("units", "1"))


def _places(part: SharedPart, layer: str) -> Iterator[Place]:
    dims = (ALTITUDE,) if layer in MASKS else part.a.ds[layer].dims
    for time in part.a.times if TIME in dims else (None,):
        for altitude_m in part.a.altitudes_m if ALTITUDE in dims else (None,):
            for time_of_day in part.a.times_of_day if TIME_OF_DAY in dims else (None,):
                yield Place(altitude_m, time, time_of_day)


def _both_hold(part: SharedPart, altitude_m: float | None) -> np.ndarray:
    """Return ``[Y, X]`` bool: data in both and, at an altitude, no obstacle by the metrics' rule."""
    if altitude_m is None:
        return part.a.ds["has_data"].values & part.b.ds["has_data"].values
    return part.a.is_free(altitude_m, "centre") & part.b.is_free(altitude_m, "centre")


def _difference(part: SharedPart, layer: str, place: Place) -> np.ndarray:
    if layer in MASKS:
        assert place.altitude_m is not None
        a, b = (_blocked(maps, layer, place.altitude_m) for maps in (part.a, part.b))
        return np.where(_both_hold(part, None), b.astype(np.float32) - a, np.float32(np.nan))
    a, b = (
        maps.m(layer, place.altitude_m, time=place.time, time_of_day=place.time_of_day).astype(np.float32)
        for maps in (part.a, part.b)
    )
    with np.errstate(invalid="ignore"):
        change = np.where(a == b, np.float32(0), b - a)  # two infinite values too
    return np.where(_both_hold(part, place.altitude_m), change, np.float32(np.nan))


def _blocked(maps: MetricMaps, layer: str, altitude_m: float) -> np.ndarray:
    return ~maps.is_free(altitude_m) if layer == CLOSED else maps.m(layer, altitude_m) != 0


def _rows(part: SharedPart, layer: str, tolerance: float) -> Iterator[dict[str, Any]]:
    """Yield the row of each of a layer's maps."""
    for place in _places(part, layer):
        change = _difference(part, layer, place)
        head = {"layer": layer, "unit": unit_of(part.a, layer), **place._asdict()}
        yield head | _statistics(change[~np.isnan(change)], tolerance, layer in MASKS)


def _statistics(values: np.ndarray, tolerance: float, is_mask: bool) -> dict[str, Any]:
    """Return what differences ``[N]`` come to; infinite ones count as changed and nowhere else."""
    numbers = values[np.isfinite(values)].astype(np.float64)
    p05, median, p95 = np.quantile(numbers, QUANTILES) if len(numbers) else [np.nan] * 3
    return {
        "cells": len(values),
        "mean": numbers.mean() if len(numbers) else np.nan,
        "median": median,
        "p05": p05,
        "p95": p95,
        "rms": np.sqrt(np.mean(numbers**2)) if len(numbers) else np.nan,
        "share_changed": float(np.mean(np.abs(values) > tolerance)) if len(values) else np.nan,
        "gained": int((values > 0).sum()) if is_mask else pd.NA,
        "lost": int((values < 0).sum()) if is_mask else pd.NA,
    }


def _name(maps: GivenMaps | MapsFolder, otherwise: str) -> str:
    folder = maps.folder if isinstance(maps, MapsFolder) else maps
    return otherwise if isinstance(folder, MetricMaps) else str(folder)


def _settings(maps: GivenMaps | MapsFolder) -> dict[str, Any] | None:
    """Return the settings that made the maps of a folder; None of maps from elsewhere, or where none can be read."""
    folder = maps.folder if isinstance(maps, MapsFolder) else maps
    if isinstance(folder, MetricMaps):
        return None
    try:
        return read_json(Path(folder) / RUN_FILE)["settings"]
    except (OSError, ValueError, LookupError):
        return None
