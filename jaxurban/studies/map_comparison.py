"""compare: two sets of maps of one place, cell by cell, on the part that both hold."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from jaxurban.checks import at_least, one_of, typed
from jaxurban.io.files import read_json
from jaxurban.io.results import Result
from jaxurban.io.stored import RUN_FILE
from jaxurban.maps.metric_maps import MapsLike, MetricMaps
from jaxurban.maps.provenance import Differing, differing
from jaxurban.maps.shared import paired_times, shared_part
from jaxurban.metrics.base import ALTITUDE, TIME, TIME_OF_DAY
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import Progress, reporting
from jaxurban.settings import ObstacleRule, iso_utc
from jaxurban.studies.bootstrap import Clusters
from jaxurban.studies.compared_routes import compared_routes
from jaxurban.studies.decided import Conclusion, Verdict, border_verdict, concluded, effects
from jaxurban.world.grid import Grid

# The layer of cells that no planner enters, beside ``obstacle``, the metrics' rule.
CLOSED = "closed"
MASKS = ("obstacle", CLOSED)
STATISTICS = ["mean", "median", "p05", "p95", "rms"]
ORDER = (TIME, TIME_OF_DAY, ALTITUDE, "y", "x")
SAME = 1e-6  # values that differ by no more, as on another device, have not changed
PLACE = ["altitude_m", "time", "time_of_day"]
COLUMNS = ["layer", "unit", *PLACE, "cells", *STATISTICS, "higher", "lower", "share_changed"]
USUAL_ROUTES = 40  # at each altitude, from which routes are judged


class MapVerdict(Enum):
    """Kinds of verdicts on two sets of maps; ``cause`` is the one setting that differs, else B."""

    LOWER = "{cause} lowers m_{last} by {size} on average ({n})"
    HIGHER = "{cause} raises m_{last} by {size} on average ({n})"
    CLOSED = "{cause} closes {count:,} of {n} to planners and opens {others:,}"
    ROUTES = "{cause} changes {count:,} of {n} by at most {apart_m:,.0f} m, {size} of all; {closed:,} are closed"
    SAME_ROUTES = "{cause} changes none of {n} ({size} of all)"
    KEPT = "A route of A costs {size} more on B than B's own ({n})"
    KEPT_OPEN = "What a route of A costs on B above B's own cannot be told from 0: {size} ({n})"
    NO_ROUTES = "Whether routes change: none were planned"


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Result):
    """Maps B beside maps A, on the cells, altitudes, times and layers that both hold. ``Y`` rows, ``X`` columns.

    Attributes:
      names: what A and B are called.
      a, b: the maps, cut to what both hold.
      left_out: names of the layers, altitudes and times of day that one of them lacks.
      settings: of the scenarios that made the maps, A's and B's value by dotted key where they differ; None where one
        of them was not made by `jaxurban maps`.
      table: a row per layer, altitude, time and time of day: ``cells`` that are free (by the rule of ``obstacle``) and
        hold a number in both, ``mean``, ``median``, ``p05``, ``p95`` and ``rms`` of B - A in the layer's ``unit``,
        ``higher`` and ``lower``, the cells that are higher, and lower, by more than `SAME` in B, and
        ``share_changed``, the share of both. Of ``obstacle`` and of ``closed`` (cells that no planner enters) the
        values are 1 where a cell is blocked and 0 elsewhere, and the cells all with data in both.
      routes: a row for each route of A on B (`compared_routes`); empty where none were asked for.
      seed: of their ends.

    Examples:
      >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
      >>> change = ju.studies.compare(maps, higher_mask, progress=False)
      >>> change.layers[:6], change.grid.shape
      (('obstacle', 'closed', 'gps', 'lidar', 'population', 'risk'), (30, 30))
      >>> change.left_out
      ('altitude 20 m',)
    """

    _command = "compare"
    _report = "map_comparison:comparison_outputs"

    names: tuple[str, str]
    a: MetricMaps
    b: MetricMaps
    left_out: tuple[str, ...]
    settings: Differing | None = None
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    routes: pd.DataFrame = field(default_factory=pd.DataFrame)
    seed: int = 0

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

    @typed
    def difference(self, layer: str) -> xr.DataArray:
        """Return B - A of a layer.

        Args:
          layer: one of `layers`.

        Returns:
          The differences by time, altitude and time of day, as far as the layer has them, and ``[Y, X]``, float32 in
          its unit; times are A's. NaN where either is blocked or holds no number. Of ``obstacle`` and ``closed`` 1
          where only B is blocked, -1 where only A is, NaN without data. Infinite values (dilutions of precision)
          differ by 0 where both are infinite, else by an infinite number.

        Raises:
          InputError: no such layer in both.

        Examples:
          >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
          >>> change = ju.studies.compare(maps, higher_mask, progress=False).difference("gps")
          >>> change.sel(altitude=60.0).shape[-2:], round(float(change.mean()), 2)
          ((30, 30), -0.12)
        """
        one_of("layer", layer, self.layers)
        a, b = (_layer(maps, layer) for maps in (self.a, self.b))

        # [Y, X] or [K, Y, X] where both hold a number. Masks and layers without altitudes have one wherever there are
        # data, and other layers in the cells that are free by their centres.
        if ALTITUDE in a.dims and layer not in MASKS:
            is_known = _is_free(self.a, "centre") & _is_free(self.b, "centre")
        else:
            is_known = self.a.ds["has_data"].values & self.b.ds["has_data"].values
        with np.errstate(invalid="ignore"):
            # Two infinite values differ by 0, and not by NaN.
            change = np.where(a.values == b.values, np.float32(0), b.values - a.values)
        return a.copy(data=np.where(is_known, change, np.float32(np.nan)))

    @property
    def decided(self) -> Conclusion:
        """What B's maps change in the cost's metrics, in the cells open to planners, and for routes."""
        cause = "B"
        if self.settings is not None and len(self.settings) == 1:
            ((key, (of_a, of_b)),) = self.settings.items()
            cause = f"{key} {of_b} instead of {of_a}"
        verdicts = [*self._of_layers(cause), *self._of_routes(cause)]
        a, b = self.names
        more = f"jaxurban compare {a} {b} --routes {{needed}} -o OUT"
        done = f"jaxurban view {a} --against {b}"
        if self.routes.empty:
            done = more.format(needed=USUAL_ROUTES)
        return concluded(
            verdicts,
            more=more,
            done=done,
            wider='jaxurban maps SCENARIO -o DIR --set "region.bounds=[WEST, SOUTH, EAST, NORTH]"',
            factor=1 / len(self.a.altitudes_m),
        )

    def _of_layers(self, cause: str) -> Iterator[Verdict]:
        """Yield by how much each metric differs on average over all cells, and how many cells close and open."""
        rows = self.table[self.table.cells > 0]
        for name in self.a.metrics:
            of_metric = rows[rows.layer == self.a.variable(name)]
            if of_metric.share_changed.max() > 0:
                mean = float(np.average(of_metric["mean"], weights=of_metric.cells))
                kind = MapVerdict.LOWER if mean < 0 else MapVerdict.HIGHER
                num = int(of_metric.cells.sum())
                yield Verdict(kind, (name,), abs(mean), n=num, noun="cells", facts={"cause": cause})
        cells, count, others = rows[rows.layer == CLOSED][["cells", "higher", "lower"]].sum()
        if count or others:
            facts = {"cause": cause, "count": int(count), "others": int(others)}
            yield Verdict(MapVerdict.CLOSED, n=int(cells), noun="cells", facts=facts)

    def _of_routes(self, cause: str) -> Iterator[Verdict]:
        """Yield how many of A's routes change on B, what it costs to keep them, and how many the border may decide."""
        if self.routes.empty:
            yield Verdict(MapVerdict.NO_ROUTES, needed=math.nan)
            return
        routes = self.routes[self.routes.is_closed.notna()]
        clusters = Clusters(routes.pair)
        is_changed = (routes.is_closed > 0) | (routes.regret > SAME)
        share, low, high = (100 * each for each in clusters.interval(is_changed, "share"))
        facts = {
            "cause": cause,
            "count": int(is_changed.sum()),
            "closed": int(routes.is_closed.sum()),
            "apart_m": routes.apart_m.where(is_changed, 0.0).max(),
        }
        kind = MapVerdict.ROUTES if is_changed.any() else MapVerdict.SAME_ROUTES
        yield Verdict(kind, (), share, low, high, len(routes), "%", facts=facts)
        kept = effects(100 * routes[["regret"]].to_numpy(), clusters).iloc[0]
        if is_changed.any() and kept.n:
            kind = MapVerdict.KEPT_OPEN if kept.needed else MapVerdict.KEPT
            size = kept["size"], kept.low, kept.high
            yield Verdict(kind, (), *size, int(kept.n), "%", "pairs", kept.needed)
        yield from border_verdict(routes.at_edge.to_numpy() > 0)

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, what is compared, and what was left out or made by other settings."""
        names = dict(zip("AB", self.names, strict=True))
        places = {name: self.a.facts[name] for name in ("grid", "CRS", "altitudes")}
        return {
            **self.decided.facts,
            **names,
            **places,
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
    routes: int = 0,
    seed: int = 0,
    progress: Progress = True,
) -> MapComparison:
    """Return how maps B differ from maps A, cell by cell.

    Both must have one CRS and one resolution. Compared are the cells, altitudes, times and layers that both hold.

    Args:
      maps_a, maps_b: from `build_maps` or `open_maps`, or folders of one resolution's maps; a `MapsFolder` where a
        folder holds several, or planners are to keep another rule of obstacles.
      routes: pairs of places, free in both, drawn at each altitude, between which the cheapest route on A is judged on
        B (`MapComparison.routes`); by A's weights, cost model and constraints, at the first time.
      seed: of these places.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      `MapComparison`: its ``table`` has a row per layer, altitude, time and time of day with statistics of B - A,
      `difference` returns those of a layer, and ``save`` writes the report.

    Raises:
      InputError: maps of another CRS or resolution, that share no cell, altitude, time or layer, or a wrong argument.

    Examples:
      >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
      >>> change = ju.studies.compare(maps, higher_mask, progress=False)
      >>> change.table.set_index("layer").loc[["gps", "lidar"], ["unit", "cells", "higher", "lower"]]
            unit  cells  higher  lower
      layer
      gps      1    891       0    792
      lidar    1    891       0      0
      >>> routes = ju.studies.compare(maps, higher_mask, routes=20, progress=False).routes
      >>> len(routes), float(routes["is_closed"].max())
      (20, 0.0)
    """
    # The arguments, and the part that both maps hold.
    at_least("routes", routes)
    at_least("seed", seed)
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
        left_out=(*_left_out(a, part_a), *_left_out(b, part_b)),
        settings=settings,
    )

    with reporting("compare", progress) as report:
        rows: list[dict[str, Any]] = []
        for layer in report.over("layers", result.layers):
            rows += _rows_of(layer, unit_of(part_a, layer), result.difference(layer))
        table = pd.DataFrame(rows).rename(columns={ALTITUDE: "altitude_m"}).reindex(columns=COLUMNS)
        table["time"] = table["time"].map(iso_utc, na_action="ignore")

        # Routes, at the first pair of times.
        judged = result.routes
        if routes:
            times = next(iter(result.times.items()), (None, None))
            judged = compared_routes(part_a, part_b, routes, seed, times, report)
    return replace(result, table=table, routes=judged, seed=seed)


def _left_out(maps: MetricMaps, part: MetricMaps) -> Iterator[str]:
    """Yield the layers, altitudes and times of day of maps that their shared part lacks, and how many of its cells."""
    for name in maps.ds.data_vars:
        if name not in part.ds and "y" in maps.ds[name].dims:  # layers, not scalars
            yield str(name)
    yield from (f"altitude {z_m:g} m" for z_m in maps.altitudes_m if z_m not in part.altitudes_m)
    yield from (f"time of day {day}" for day in maps.times_of_day if day not in part.times_of_day)
    num_cells = maps.ds.sizes["y"] * maps.ds.sizes["x"] - part.ds.sizes["y"] * part.ds.sizes["x"]
    if num_cells:
        yield f"{num_cells:,} cells"


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


def _is_free(maps: MetricMaps, obstacles: ObstacleRule | None = None) -> np.ndarray:
    """Return ``[K, Y, X]`` bool, which cells are free at each altitude (`MetricMaps.is_free`)."""
    return np.stack([maps.is_free(altitude_m, obstacles) for altitude_m in maps.altitudes_m])


def _layer(maps: MetricMaps, layer: str) -> xr.DataArray:
    """Return a layer as float32, ``[..., Y, X]`` in its unit; of `CLOSED` 1 where planners may not enter."""
    array = maps.ds["obstacle" if layer == CLOSED else layer]
    array = array.transpose(*ORDER, missing_dims="ignore")
    values = ~_is_free(maps) if layer == CLOSED else array.values
    return array.copy(data=values.astype(np.float32))


def _rows_of(layer: str, unit: str, change: xr.DataArray) -> Iterator[dict[str, Any]]:
    """Yield a row of statistics for each map of a layer's differences, in their order.

    Infinite differences count as changed, ``higher`` or ``lower``, and in no other statistic. Where no difference is
    finite the other statistics are NaN.

    Args:
      layer: its name.
      unit: of the layer.
      change: ``[..., Y, X]`` in the layer's unit, NaN where it is not known.
    """
    dims = tuple(map(str, change.dims[:-2]))
    places = itertools.product(*(change[dim].values for dim in dims))
    for place, values in zip(places, change.values.reshape(-1, *change.shape[-2:]), strict=True):
        # The finite differences; a single NaN in their place makes all statistics of them NaN.
        numbers = values[np.isfinite(values)].astype(np.float64)
        if not len(numbers):
            numbers = np.array([np.nan])
        cells = int(np.sum(~np.isnan(values)))
        higher = int(np.sum(values > SAME))
        lower = int(np.sum(values < -SAME))
        quantiles = np.quantile(numbers, [0.5, 0.05, 0.95])
        statistics = (numbers.mean(), *quantiles, np.sqrt(np.mean(numbers**2)))
        yield {
            "layer": layer,
            "unit": unit,
            **dict(zip(dims, place, strict=True)),
            "cells": cells,
            **dict(zip(STATISTICS, statistics, strict=True)),
            "higher": higher,
            "lower": lower,
            "share_changed": (higher + lower) / cells if cells else np.nan,
        }
