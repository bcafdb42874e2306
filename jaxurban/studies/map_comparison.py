"""compare: two sets of maps of one place, cell by cell, on the part that both hold."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyproj
import xarray as xr

from jaxurban.errors import InputError, finite, one_of, typed
from jaxurban.io.files import read_json
from jaxurban.io.store import RUN_FILE
from jaxurban.maps.metric_maps import GivenMaps, MetricMaps, as_maps
from jaxurban.maps.validation import Differing, differing
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import Progress, reporting
from jaxurban.settings import iso_utc
from jaxurban.studies.queries import NORMS
from jaxurban.studies.result import Result
from jaxurban.world.grid import Grid
from jaxurban.world.show import listed

CLOSED = "closed"  # the layer of cells that no planner enters, beside ``obstacle``, the metrics' rule
MASKS = ("obstacle", CLOSED)
SAME = 1e-6  # values that differ by no more, as on another device, have not changed
QUANTILES = (0.05, 0.5, 0.95)


class OneMap(NamedTuple):
    """One map of a layer: its altitude, time and time of day, None where the layer does not vary along it."""

    altitude_m: float | None = None
    time: str | None = None
    time_of_day: str | None = None


@dataclass(frozen=True, eq=False, repr=False)
class SharedPart:
    """Two sets of maps cut to what both hold, so that cell (y, x), altitude and time mean the same in both.

    Attributes:
      a, b: the maps; those of ``b`` carry the names of ``a``'s times.
      times: A's time and the one of B beside it.
      left_out: what only one of them holds, with the reason.
      cut: ``[2]`` how many of the cells of A and of B were cut off.
    """

    a: MetricMaps
    b: MetricMaps
    times: Mapping[str, str]
    left_out: Mapping[str, str]
    cut: tuple[int, int]

    @property
    def grid(self) -> Grid:
        """The cells that both hold."""
        return self.a.grid

    @property
    def layers(self) -> tuple[str, ...]:
        """The layers that both hold: blocked cells, the cost's metrics, then the others by name."""
        metrics = [self.a.variable(name) for name in self.a.metrics]
        others = sorted({*map(str, self.a.ds.data_vars)} - {"obstacle", "has_data", *metrics})
        return (*MASKS, *metrics, *others)

    def places(self, layer: str) -> list[OneMap]:
        """Return the maps of a layer that are compared."""
        dims = (ALTITUDE,) if layer == CLOSED else self.a.ds[layer].dims
        held: dict[str, Sequence[Any]] = {
            TIME: self.a.times,
            ALTITUDE: self.a.altitudes_m,
            TIME_OF_DAY: self.a.times_of_day,
        }
        chosen = itertools.product(*(held[dim] if dim in dims else (None,) for dim in held))
        return [OneMap(z_m, time, day) for time, z_m, day in chosen]

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
        first_m = self.places(one_of("layer", layer, self.layers))[0].altitude_m
        z_m = first_m if None in (first_m, altitude_m) else altitude_m
        if z_m is None or layer in MASKS:
            is_known = self.a.ds["has_data"].values & self.b.ds["has_data"].values
        else:
            is_known = self.a.is_free(z_m, "centre") & self.b.is_free(z_m, "centre")
        a, b = (_values(maps, layer, OneMap(z_m, time, time_of_day)) for maps in (self.a, self.b))
        with np.errstate(invalid="ignore"):
            change = np.where(a == b, np.float32(0), b - a)  # two infinite values too
        return np.where(is_known, change, np.float32(np.nan))


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(SharedPart, Result):
    """Maps B beside maps A, on the cells, altitudes, times and layers that both hold. ``Y`` rows, ``X`` columns.

    Attributes:
      names: what A and B are called.
      table: a row a layer, altitude, time and time of day: ``cells`` that are free (by the rule of ``obstacle``) and
        hold a number in both, ``mean``, ``median``, ``p05``, ``p95`` and ``rms`` of B - A in the layer's ``unit``,
        ``gained`` and ``lost``, the cells that are higher by more than ``tolerance`` in B and in A, and
        ``share_changed``, the share of both. Of ``obstacle`` and of ``closed`` (cells that no planner enters) the
        values are 1 where a cell is blocked and 0 elsewhere, and the cells all with data in both.
      settings: of the scenarios that made the maps, A's and B's value by dotted key where they differ; None where one
        of them was not made by `jaxurban maps`.
      tolerance: up to which values are the same.
    """

    names: tuple[str, str]
    table: pd.DataFrame
    settings: Differing | None = field(default_factory=dict)
    tolerance: float = SAME

    @property
    def facts(self) -> dict[str, str]:
        """What is compared, and how much of it changed."""
        held = self.a.facts
        facts = {"A": self.names[0], "B": self.names[1]} | {name: held[name] for name in ("grid", "CRS", "altitudes")}
        facts["times"] = ", ".join(
            of_a if of_a == of_b else f"{of_a} of A beside {of_b} of B" for of_a, of_b in self.times.items()
        )
        facts["cells changed, at most"] = ", ".join(f"{name} {share:.1%}" for name, share in self.most_changed.items())
        facts["left out"] = ", ".join(self.left_out)
        facts["settings that differ"] = ", ".join(self.settings or ())
        return facts

    @property
    def most_changed(self) -> pd.Series:
        """By layer, the largest share of cells that changed in any of its maps."""
        return self.table.groupby("layer", sort=False)["share_changed"].max()


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
    sides = [_side(maps, name) for maps, name in ((maps_a, "A"), (maps_b, "B"))]
    (a, name_a, settings_a), (b, name_b, settings_b) = sides
    part = shared_part(a, b.with_obstacles(b.rule or a.obstacles), times)
    rows: list[dict[str, Any]] = []
    with reporting("compare", progress) as report:
        for number, layer in enumerate(names := part.layers):
            report("layers", number, len(names))
            for place in part.places(layer):
                change = part.of(layer, **place._asdict())
                head = {"layer": layer, "unit": unit_of(part.a, layer), **place._asdict()}
                rows.append(head | _statistics(change[~np.isnan(change)], tolerance))
        report("layers", len(names), len(names))
    settings = None if settings_a is None or settings_b is None else differing(settings_a, settings_b)
    return MapComparison(
        **vars(part), names=(name_a, name_b), table=pd.DataFrame(rows), settings=settings, tolerance=tolerance
    )


def _side(maps: GivenMaps | MapsFolder, otherwise: str) -> tuple[MetricMaps, str, dict[str, Any] | None]:
    """Return maps, what they are called, and the settings that made them; None where none can be read."""
    opened = maps.open() if isinstance(maps, MapsFolder) else as_maps(maps)
    folder = maps.folder if isinstance(maps, MapsFolder) else maps
    if isinstance(folder, MetricMaps):
        return opened, otherwise, None
    try:
        return opened, str(folder), read_json(Path(folder) / RUN_FILE)["settings"]
    except (OSError, ValueError, LookupError):
        return opened, str(folder), None


def unit_of(maps: MetricMaps, layer: str) -> str:
    """Return the unit of a layer."""
    return "1" if layer == CLOSED else str(maps.ds[layer].attrs.get("units", "1"))


def _values(maps: MetricMaps, layer: str, place: OneMap) -> np.ndarray:
    if layer == CLOSED:
        assert place.altitude_m is not None
        return (~maps.is_free(place.altitude_m)).astype(np.float32)
    return maps.m(layer, place.altitude_m, time=place.time, time_of_day=place.time_of_day).astype(np.float32)


def _statistics(values: np.ndarray, tolerance: float) -> dict[str, Any]:
    """Return what differences ``[N]`` come to; infinite ones count as changed and nowhere else."""
    numbers = values[np.isfinite(values)].astype(np.float64)
    p05, median, p95 = np.quantile(numbers, QUANTILES) if len(numbers) else [np.nan] * 3
    gained, lost = int((values > tolerance).sum()), int((values < -tolerance).sum())
    return {
        "cells": len(values),
        "mean": numbers.mean() if len(numbers) else np.nan,
        "median": median,
        "p05": p05,
        "p95": p95,
        "rms": np.sqrt(np.mean(numbers**2)) if len(numbers) else np.nan,
        "gained": gained,
        "lost": lost,
        "share_changed": (gained + lost) / len(values) if len(values) else np.nan,
    }


def shared_part(a: MetricMaps, b: MetricMaps, times: Mapping[str, str] | None = None) -> SharedPart:
    """Return what two sets of maps share.

    Args:
      a, b: the maps.
      times: B's time by A's, for maps of different times; left out, the times that both hold, and where each holds a
        single one, these two.

    Raises:
      InputError: another CRS or resolution, no cell, altitude or layer that both hold, or times that do not pair.
    """
    grid = _shared_grid(a.grid, b.grid)
    altitudes_m = [z_m for z_m in a.altitudes_m if z_m in b.altitudes_m]
    if not altitudes_m:
        had = (listed([f"{z_m:g}" for z_m in maps.altitudes_m]) for maps in (a, b))
        raise InputError(
            f"the maps share no altitude: A holds {next(had)} m and B {next(had)} m; add one of A's to B's scenario"
        )
    days = [item for item in a.times_of_day if item in b.times_of_day]
    names, left_out = _shared_layers(a, b)
    left_out |= {
        f"altitude {z_m:g} m": f"only {which} holds it"
        for which, maps in (("A", a), ("B", b))
        for z_m in maps.altitudes_m
        if z_m not in altitudes_m
    }
    if not days:
        for name in [name for name in names if TIME_OF_DAY in a.ds[name].dims]:
            names.remove(name)
            left_out[name] = (
                f"A's times of day ({', '.join(a.times_of_day) or 'none'}) are none of B's "
                f"({', '.join(b.times_of_day) or 'none'})"
            )
    paired = _paired(a, b, times) if any(TIME in a.ds[name].dims for name in names) else {}
    parts = []
    for maps, when in ((a, paired.keys()), (b, paired.values())):
        shared: dict[str, Sequence[Any]] = {ALTITUDE: altitudes_m, TIME_OF_DAY: days, TIME: list(when) or maps.times}
        parts.append(_cut(maps, grid, names, shared))
    if paired:
        parts[1] = MetricMaps(parts[1].ds.assign_coords(time=parts[0].ds["time"]), b.obstacles)
    num_cells = grid.num_rows * grid.num_cols
    cut = tuple(int(np.prod(maps.grid.shape)) - num_cells for maps in (a, b))
    return SharedPart(parts[0], parts[1], paired, left_out, (cut[0], cut[1]))


def _shared_grid(a: Grid, b: Grid) -> Grid:
    """Return the cells that two grids share; cells of one CRS and one resolution coincide wherever they meet."""
    if pyproj.CRS(a.crs) != pyproj.CRS(b.crs):
        raise InputError(
            f"A's maps are in {a.crs} and B's in {b.crs}, so that no cell is in both: make one of them again with "
            f"[region] crs = {a.crs!r}"
        )
    if a.resolution_m != b.resolution_m:
        raise InputError(
            f"A's cells are {a.resolution_m:g} m wide and B's {b.resolution_m:g} m: make one of them again with "
            "[region] resolution_m set to the other's (a list makes both), or choose with --resolution"
        )
    first = max(a.first_row, b.first_row), max(a.first_col, b.first_col)
    end = (
        min(a.first_row + a.num_rows, b.first_row + b.num_rows),
        min(a.first_col + a.num_cols, b.first_col + b.num_cols),
    )
    if end[0] <= first[0] or end[1] <= first[1]:
        raise InputError(
            f"the maps share no cell: A spans {_extent(a)} and B {_extent(b)} in {a.crs}; compare maps of regions that "
            "overlap"
        )
    return Grid(a.crs, a.resolution_m, *first, end[0] - first[0], end[1] - first[1])


def _extent(grid: Grid) -> str:
    return f"{grid.x_min_m:.0f} to {grid.x_max_m:.0f} m east and {grid.y_min_m:.0f} to {grid.y_max_m:.0f} m north"


def _shared_layers(a: MetricMaps, b: MetricMaps) -> tuple[list[str], dict[str, str]]:
    """Return the maps that both hold along the same dims, and what only one holds."""
    shared, left_out = [], {}
    for name in dict.fromkeys((*map(str, a.ds.data_vars), *map(str, b.ds.data_vars))):
        held = [maps.ds[name].dims if name in maps.ds else None for maps in (a, b)]
        if any(dims is not None and not {"y", "x"} <= set(dims) for dims in held):
            continue  # a number a time, no map
        if held[0] == held[1]:
            shared.append(name)
        elif None in held:
            left_out[name] = f"only {'A' if held[1] is None else 'B'} holds it"
        else:
            left_out[name] = "it varies along other dimensions in B"
    return shared, left_out


def _paired(a: MetricMaps, b: MetricMaps, times: Mapping[str, str] | None) -> dict[str, str]:
    if times is not None:
        pairs = {iso_utc(of_a): iso_utc(of_b) for of_a, of_b in times.items()}
        for which, maps, wanted in (("A", a, pairs), ("B", b, pairs.values())):
            if lost := [time for time in wanted if time not in maps.times]:
                raise InputError(f"{which} holds no maps of {lost[0]}: it holds {listed(maps.times)}")
        if not pairs:
            raise InputError("times is empty: name at least one pair of times, or leave it out")
        return pairs
    shared = {time: time for time in a.times if time in b.times}
    if shared:
        return shared
    if len(a.times) == len(b.times) == 1:
        return {a.times[0]: b.times[0]}
    raise InputError(
        f"the maps share no time: A holds {listed(a.times)} and B {listed(b.times)}; name the pairs to compare, as in "
        f"--time {a.times[0]}={b.times[0]} (times={{...}})"
    )


def _cut(maps: MetricMaps, grid: Grid, names: Sequence[str], wanted: Mapping[str, Sequence[Any]]) -> MetricMaps:
    """Return the maps of these names in the cells of a grid, at the wanted altitudes and times."""
    rows, cols = grid.window_in(replace(maps.grid, crs=grid.crs))
    ds: xr.Dataset = maps.ds[list(names)].isel(y=rows, x=cols)
    attrs = dict(ds.attrs, crs=grid.crs)
    if TIME not in ds.coords:  # of maps without GPS; `MetricMaps` has times all the same
        ds = ds.assign_coords({TIME: maps.ds[TIME]})
    held = {ALTITUDE: maps.altitudes_m, TIME: maps.times, TIME_OF_DAY: maps.times_of_day}
    chosen = {dim: [held[dim].index(item) for item in items] for dim, items in wanted.items() if dim in ds.dims}
    for norm in NORMS if TIME_OF_DAY in chosen else ():
        if norm in attrs:
            attrs[norm] = np.atleast_1d(attrs[norm])[chosen[TIME_OF_DAY]].tolist()
    return MetricMaps(ds.isel(chosen).assign_attrs(attrs), maps.obstacles)
