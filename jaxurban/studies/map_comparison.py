"""compare: two sets of maps of one place, cell by cell, on the part that both hold."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.checks import at_least, finite, one_of, typed
from jaxurban.errors import InputError
from jaxurban.io.files import read_json
from jaxurban.io.results import Result
from jaxurban.io.stored import RUN_FILE
from jaxurban.maps.metric_maps import MapsLike, MetricMaps
from jaxurban.maps.provenance import Differing, differing
from jaxurban.maps.shared import OneMap, paired_times, shared_part
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import Progress, reporting
from jaxurban.settings import iso_utc
from jaxurban.studies.compared_routes import compared_routes, route_regrets
from jaxurban.world.grid import Grid

# The layer of cells that no planner enters, beside ``obstacle``, the metrics' rule.
CLOSED = "closed"
MASKS = ("obstacle", CLOSED)
SAME = 1e-6  # values that differ by no more, as on another device, have not changed


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Result):
    """Maps B beside maps A, on the cells, altitudes, times and layers that both hold. ``Y`` rows, ``X`` columns.

    Attributes:
      names: what A and B are called.
      a, b: the maps, cut to what both hold.
      left_out: what only one of them holds.
      settings: of the scenarios that made the maps, A's and B's value by dotted key where they differ; None where one
        of them was not made by `jaxurban maps`.
      tolerance: up to which values are the same.
      table: a row per layer, altitude, time and time of day: ``cells`` that are free (by the rule of ``obstacle``) and
        hold a number in both, ``mean``, ``median``, ``p05``, ``p95`` and ``rms`` of B - A in the layer's ``unit``,
        ``gained`` and ``lost``, the cells that are higher by more than ``tolerance`` in B and in A, and
        ``share_changed``, the share of both. Of ``obstacle`` and of ``closed`` (cells that no planner enters) the
        values are 1 where a cell is blocked and 0 elsewhere, and the cells all with data in both.
      routes: a row for each route of one map under the other (`compared_routes`); empty where none were asked for.
      seed: of their ends.

    Examples:
      >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
      >>> change = ju.studies.compare(maps, higher_mask, progress=False)
      >>> change.layers[:6], change.grid.shape
      (('obstacle', 'closed', 'gps', 'lidar', 'population', 'risk'), (30, 30))
      >>> change.left_out
      {'altitude 20 m': 'B holds no such map'}
    """

    _command = "compare"
    _report = "map_comparison:comparison_outputs"

    names: tuple[str, str]
    a: MetricMaps
    b: MetricMaps
    left_out: Mapping[str, str]
    settings: Differing | None = None
    tolerance: float = SAME
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    routes: pd.DataFrame = field(default_factory=pd.DataFrame)
    seed: int = 0

    @property
    def regrets(self) -> pd.DataFrame:
        """By altitude, how much too much routes planned on A cost on B, and the other way round; empty without routes.

        ``routes`` counts the routes that were found. ``closed`` is the share of them that the other map closes, and
        ``closed_m`` their median length in closed cells. Of the other routes ``regret`` is the median (0.05: 5 % above
        the cheapest there), with the 90 % quantile and the worst. ``closed`` and ``regret`` have 95 % intervals.
        """
        return route_regrets(self.routes) if len(self.routes) else pd.DataFrame()

    @property
    def times(self) -> dict[str, str]:
        """A's time and the one of B beside it; empty where no layer varies with the time."""
        return paired_times(self.a, self.b)

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
        """Return the maps of a layer that are compared.

        Returns:
          The altitude, time and time of day of each map, None where the layer does not vary along it; `of` takes them.

        Examples:
          >>> change = ju.studies.compare(maps, maps, progress=False)
          >>> [place.altitude_m for place in change.places("risk")]
          [20.0, 60.0]
        """
        dims = (ALTITUDE,) if layer == CLOSED else self.a.ds[layer].dims
        values: dict[str, Sequence[Any]] = {
            TIME: self.a.times,
            ALTITUDE: self.a.altitudes_m,
            TIME_OF_DAY: self.a.times_of_day,
        }
        choices = [values[dim] if dim in dims else (None,) for dim in values]
        return [OneMap(z_m, time, day) for time, z_m, day in itertools.product(*choices)]

    @typed
    def of(
        self,
        layer: str,
        altitude_m: float | None = None,
        *,
        time: str | None = None,
        time_of_day: str | None = None,
    ) -> np.ndarray:
        """Return B - A of one map.

        Args:
          layer: one of `layers`.
          altitude_m, time, time_of_day: as in `MetricMaps.m`; the first if left out.

        Returns:
          The differences, ``[Y, X]`` float32 in the layer's unit, NaN where either is blocked or holds no number. Of
          ``obstacle`` and ``closed`` 1 where only B is blocked, -1 where only A is, NaN without data. Infinite values
          (dilutions of precision) differ by 0 where both are infinite, else by an infinite number.

        Raises:
          InputError: no such layer, altitude or time in both.

        Examples:
          >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
          >>> change = ju.studies.compare(maps, higher_mask, progress=False).of("gps", 60.0)
          >>> change.shape, round(float(np.nanmean(change)), 2)
          ((30, 30), -0.12)
        """
        # The altitude: the first one if it is left out, and None where the layer does not vary with altitude.
        first_m = self.places(one_of("layer", layer, self.layers))[0].altitude_m
        z_m = first_m if None in (first_m, altitude_m) else altitude_m

        # [Y, X] cells with a number in both maps. Masks and layers without altitudes have one wherever there are data,
        # and other layers in the cells that are free by their centres.
        if z_m is None or layer in MASKS:
            is_known = self.a.ds["has_data"].values & self.b.ds["has_data"].values
        else:
            is_known = self.a.is_free(z_m, "centre") & self.b.is_free(z_m, "centre")

        # The two maps. The time is one of A's, and B's map beside it may have another time.
        time_of_b = None if time is None else self.times.get(iso_utc(time), time)
        a = _values(self.a, layer, OneMap(z_m, time, time_of_day))
        b = _values(self.b, layer, OneMap(z_m, time_of_b, time_of_day))
        with np.errstate(invalid="ignore"):
            # Two infinite values differ by 0, and not by NaN.
            change = np.where(a == b, np.float32(0), b - a)
        return np.where(is_known, change, np.float32(np.nan))

    @property
    def facts(self) -> dict[str, str]:
        """What is compared, how much of it changed at most, and what was left out or made by other settings."""
        times = [
            time_a if time_a == time_b else f"{time_a} of A beside {time_b} of B"
            for time_a, time_b in self.times.items()
        ]
        changed = [f"{name} {share:.1%}" for name, share in self.most_changed.items()]
        return {
            "A": self.names[0],
            "B": self.names[1],
            **{name: self.a.facts[name] for name in ("grid", "CRS", "altitudes")},
            "times": ", ".join(times),
            "cells changed, at most": ", ".join(changed),
            "left out": ", ".join(self.left_out),
            "settings that differ": ", ".join(self.settings or ()),
        }

    @property
    def most_changed(self) -> pd.Series:
        """By layer, the largest share of cells that changed in any of its maps."""
        return self.table.groupby("layer", sort=False)["share_changed"].max()


@typed
def compare(
    maps_a: MapsLike | MapsFolder,
    maps_b: MapsLike | MapsFolder,
    *,
    tolerance: float = SAME,
    routes: int = 0,
    seed: int = 0,
    progress: Progress = True,
) -> MapComparison:
    """Return how maps B differ from maps A, cell by cell.

    Both must have one CRS and one resolution. Compared are the cells, altitudes, times and layers that both hold.

    Args:
      maps_a, maps_b: from `build_maps` or `open_maps`, or folders of one resolution's maps; a `MapsFolder` where a
        folder holds several, or planners are to keep another rule of obstacles.
      tolerance: values that differ by no more than this, in their unit, have not changed.
      routes: pairs of places, free in both, drawn at each altitude, between which the cheapest route on A is judged on
        B, and B's on A (`MapComparison.regrets`); by A's weights, cost model and constraints, at the first time.
      seed: of these places.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      `MapComparison`: its ``table`` has a row per layer, altitude, time and time of day with statistics of B - A, `of`
      returns the differences of one map, and ``save`` writes the report.

    Raises:
      InputError: maps of another CRS or resolution, that share no cell, altitude, time or layer, or a wrong argument.

    Examples:
      >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
      >>> change = ju.studies.compare(maps, higher_mask, progress=False)
      >>> change.table.set_index("layer").loc[["gps", "lidar"], ["unit", "cells", "gained", "lost"]]
            unit  cells  gained  lost
      layer
      gps      1    891       0   792
      lidar    1    891       0     0
      >>> regrets = ju.studies.compare(maps, higher_mask, routes=20, progress=False).regrets
      >>> regrets[["planned_on", "judged_on", "routes", "closed"]].to_numpy().tolist()
      [['A', 'B', 20, 0.0], ['B', 'A', 20, 0.0]]
    """
    # The arguments, and the part that both maps hold.
    at_least("routes", routes)
    at_least("seed", seed)
    tolerance = finite("tolerance", tolerance)
    if tolerance < 0:
        raise InputError(f"tolerance must not be negative, got {tolerance:g}")
    a, name_a, settings_a = _side(maps_a, "A")
    b, name_b, settings_b = _side(maps_b, "B")
    part_a, part_b = shared_part(a, b.with_obstacles(b.rule or a.obstacles))

    # The settings that differ, where both maps name theirs.
    settings = None
    if settings_a is not None and settings_b is not None:
        settings = differing(settings_a, settings_b)
    result = MapComparison(
        names=(name_a, name_b),
        a=part_a,
        b=part_b,
        left_out=_left_out(a, part_a, "B") | _left_out(b, part_b, "A"),
        settings=settings,
        tolerance=tolerance,
    )

    rows = []
    with reporting("compare", progress) as report:
        # A row per map of each layer.
        for layer in report.over("layers", result.layers):
            for one_map in result.places(layer):
                place = one_map._asdict()
                change = result.of(layer, **place)
                head = {"layer": layer, "unit": unit_of(part_a, layer), **place}
                rows.append(head | _statistics(change[~np.isnan(change)], tolerance))

        # Routes, at the first pair of times.
        judged = result.routes
        if routes:
            times = next(iter(result.times.items()), (None, None))
            judged = compared_routes(part_a, part_b, routes, seed, times, report)
    return replace(result, table=pd.DataFrame(rows), routes=judged, seed=seed)


def _left_out(maps: MetricMaps, part: MetricMaps, other: str) -> dict[str, str]:
    """Return which layers, altitudes, times of day and cells of maps their shared part lacks, each with a reason.

    Args:
      maps: one side of the comparison.
      part: its part that the other side holds too.
      other: name of the other side, ``"A"`` or ``"B"``, for the reason.
    """
    lost = [name for name in maps.ds.data_vars if name not in part.ds]
    names = [str(name) for name in lost if "y" in maps.ds[name].dims]  # layers, not scalars
    names += [f"altitude {z_m:g} m" for z_m in maps.altitudes_m if z_m not in part.altitudes_m]
    names += [f"time of day {day}" for day in maps.times_of_day if day not in part.times_of_day]
    num_cells = int(np.prod(maps.grid.shape) - np.prod(part.grid.shape))
    if num_cells:
        names.append(f"{num_cells:,} cells")
    return dict.fromkeys(names, f"{other} holds no such map")


def _side(
    maps: MapsLike | MapsFolder, otherwise: str
) -> tuple[MetricMaps, str, dict[str, Any] | None]:
    """Return the maps of one side, what it is called, and the settings that made the maps.

    The settings are None where they cannot be read, as for maps in memory.

    Args:
      maps: opened maps, or their folder, by which the side is then called.
      otherwise: what maps in memory are called.
    """
    if isinstance(maps, MetricMaps):
        return maps, otherwise, None
    source = maps if isinstance(maps, MapsFolder) else MapsFolder(maps)
    opened = source.open()
    name = str(source.folder)
    try:
        return opened, name, read_json(Path(name) / RUN_FILE)["settings"]
    except (OSError, ValueError, LookupError):
        return opened, name, None


def unit_of(maps: MetricMaps, layer: str) -> str:
    """Return the unit of a layer."""
    return "1" if layer == CLOSED else str(maps.ds[layer].attrs.get("units", "1"))


def _values(maps: MetricMaps, layer: str, place: OneMap) -> np.ndarray:
    """Return ``[Y, X]`` float32 one map of a layer, in its unit; of `CLOSED` 1 where planners may not enter."""
    if layer == CLOSED:
        assert place.altitude_m is not None
        return (~maps.is_free(place.altitude_m)).astype(np.float32)
    return maps.m(layer, place.altitude_m, time=place.time, time_of_day=place.time_of_day).astype(
        np.float32
    )


def _statistics(values: np.ndarray, tolerance: float) -> dict[str, Any]:
    """Return the statistics of differences B - A of the ``N`` cells that both know, as columns of a row.

    Infinite differences count as changed, ``gained`` or ``lost``, and in no other statistic. Where no difference is
    finite the other statistics are NaN.

    Args:
      values: ``[N]`` in the layer's unit, none NaN.
      tolerance: a difference of at most this, in the same unit, is no change.
    """
    # The finite differences; a single NaN in their place makes all statistics of them NaN.
    numbers = values[np.isfinite(values)].astype(np.float64)
    if not len(numbers):
        numbers = np.array([np.nan])
    gained = int((values > tolerance).sum())
    lost = int((values < -tolerance).sum())
    return {
        "cells": len(values),
        "mean": numbers.mean(),
        "median": np.quantile(numbers, 0.5),
        "p05": np.quantile(numbers, 0.05),
        "p95": np.quantile(numbers, 0.95),
        "rms": np.sqrt(np.mean(numbers**2)),
        "gained": gained,
        "lost": lost,
        "share_changed": (gained + lost) / len(values) if len(values) else np.nan,
    }
