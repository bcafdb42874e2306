"""compare: two sets of maps of one place, cell by cell, on the part that both hold."""

import shlex
import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from jaxurban.checks import at_least, one_of, typed
from jaxurban.io.files import read_json
from jaxurban.io.results import Result
from jaxurban.io.stored import RUN_FILE
from jaxurban.knowledge import names_of
from jaxurban.maps.metric_maps import MapsLike, MetricMaps
from jaxurban.maps.provenance import Differing, differing
from jaxurban.maps.shared import paired_times, shared_part
from jaxurban.metrics.base import ALTITUDE
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import Progress, reporting
from jaxurban.settings import iso_utc
from jaxurban.studies.bootstrap import Clusters
from jaxurban.studies.compared_routes import compared_routes
from jaxurban.studies.decided import Conclusion, Verdict, border_verdict, concluded, effects, sized

# The layer of cells that no planner enters, beside ``obstacle``, the metrics' rule.
CLOSED = "closed"
MASKS = ("obstacle", CLOSED)
CELLS = ("y", "x")
SAME = 1e-6  # values that differ by no more, as on another device, are equal
PLACE = ["altitude_m", "time", "time_of_day"]
STATISTICS = ["mean", "median", "p05", "p95", "rms"]
COUNTS = ["higher", "lower", "lost", "gained"]
COLUMNS = ["layer", "unit", *PLACE, "cells", *STATISTICS, *COUNTS, "share_changed"]
USUAL_ROUTES = 40  # at each altitude, from which routes are judged


class MapVerdict(Enum):
    """Kinds of verdicts on two sets of maps; ``cause`` is the one setting that differs, else B."""

    CELLS = (
        "{cause} changes {means} on average; of {n} at all altitudes and times {lost:,} lose their fix and {gained:,} "
        "gain one (no mean of a DOP counts these), {closed:,} close to planners and {opened:,} open"
    )
    ROUTES = (
        "{cause} changes {count:,} of {n} ({where}), {size}, by at most {apart_m:,.0f} m; {closed:,} of A's routes are "
        "closed on B, and {lost:,} of their pairs have no path there"
    )
    KEPT = "A route of A that B leaves open costs {size} more on B than B's own ({n})"
    NO_ROUTES = "Whether routes change: none were planned"
    GUESSES = (
        "A rests on other guesses than B (A alone: {of_a}; B alone: {of_b}), and how much of the difference is theirs "
        "is not known"
    )


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Result):
    """Maps B beside maps A, on the cells, altitudes, times and layers that both hold.

    Attributes:
      names: folders of A and B; empty for maps in memory.
      a, b: the maps, cut to what both hold, with a layer ``closed``, 1 in cells that no planner enters; both with the
        settings of A's scenario for routes.
      left_out: names of the layers, altitudes and times of day that one of them lacks.
      settings: of the scenarios that made the maps, A's and B's value by dotted key where they differ; None where one
        of them was not made by `jaxurban maps`.
      table: a row per layer, altitude, time and time of day: ``cells`` that are free (by the rule of ``obstacle``) and
        hold a number in both, ``mean``, ``median``, ``p05``, ``p95`` and ``rms`` of B - A in the layer's ``unit``,
        ``higher`` and ``lower``, the cells that are higher, and lower, in B, ``lost`` and ``gained``, those of them
        whose value is infinite, as a DOP is without a fix, in B alone, and in A alone (no other statistic counts
        these), and ``share_changed``, the share of both. Of ``obstacle`` and of ``closed`` the values are 1 where a
        cell is blocked and 0 elsewhere, and the cells all with data in both.
      routes: a row for each route of A on B (`compared_routes`); empty where none were asked for.
      seed: of their ends.

    Examples:
      >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
      >>> change = ju.studies.compare(maps, higher_mask, progress=False)
      >>> change.layers[:6], change.a.grid.shape
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
    def layers(self) -> tuple[str, ...]:
        """The layers that both hold: blocked cells, the cost's metrics, then the others by name."""
        first = (*MASKS, *map(self.a.variable, self.a.metrics))
        others = {*map(str, self.a.ds.data_vars)} - {"has_data", *first}
        return (*first, *sorted(others))

    @typed
    def difference(self, layer: str) -> xr.DataArray:
        """Return B - A of a layer.

        Args:
          layer: one of `layers`.

        Returns:
          The differences by time, altitude and time of day, as far as the layer has them, and ``[y, x]``, float32 in
          its unit; times are A's. NaN where either is blocked or holds no number. Of ``obstacle`` and ``closed`` 1
          where only B is blocked, -1 where only A is, NaN without data. Sizes up to `SAME` are 0. Infinite values
          (dilutions of precision) differ by 0 where both are infinite, else by an infinite number.

        Raises:
          InputError: no such layer in both.

        Examples:
          >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
          >>> change = ju.studies.compare(maps, higher_mask, progress=False).difference("gps")
          >>> change.sel(altitude=60.0).shape[-2:], round(float(change.mean()), 2)
          ((30, 30), -0.12)
        """
        one_of("layer", layer, self.layers)
        a = self.a.ds[layer].astype(np.float32)
        b = self.b.ds[layer].astype(np.float32).assign_coords(a.coords)
        with np.errstate(invalid="ignore"):  # two infinite values have no difference
            change = b - a
        change = change.where((a != b) & ~(abs(change) <= SAME), np.float32(0))

        # Masks and layers without altitudes have a number wherever there are data, others where cells are free too.
        is_known = self.a.ds["has_data"] & self.b.ds["has_data"]
        if ALTITUDE in a.dims and layer not in MASKS:
            is_known = is_known & (self.a.ds["obstacle"] == 0) & (self.b.ds["obstacle"] == 0)
        return change.where(is_known).transpose(..., *CELLS)

    @property
    def decided(self) -> Conclusion:
        """What B's maps change in the cost's metrics, in the cells open to planners, and for routes."""
        cause = "B"
        if self.settings is not None and len(self.settings) == 1:
            ((key, (of_a, of_b)),) = self.settings.items()
            cause = f"{key} {of_b} instead of {of_a}"
        verdicts = [self._of_cells(cause), *self._of_routes(cause), *self._of_guesses()]

        # Commands that can be pasted as they are; of maps in memory they are Python's.
        more = "ju.studies.compare(A, B, routes={needed})"
        view = "ju.view(A, against=B)"
        if all(self.names):
            a, b = map(shlex.quote, self.names)
            side = f"--resolution {self.a.grid.resolution_m:g}"
            folder = shlex.quote(f"{self.names[1]}_routes")
            more = f"jaxurban compare {a} {b} {side} --routes {{needed}} -o {folder}_{{needed}}"
            view = f"jaxurban view {a} --against {b} {side}"
        usual = more.format(needed=USUAL_ROUTES)
        done = usual if self.routes.empty else view
        return concluded(verdicts, more=more, done=done, wider=done)

    def _of_cells(self, cause: str) -> Verdict:
        """Return by how much each metric differs on average, and how many cells change for planners."""
        rows = self.table[self.table.cells > 0]
        means = []
        for name in self.a.metrics:
            of_metric = rows[rows.layer == self.a.variable(name)]
            if of_metric.share_changed.max() > 0:
                mean = np.average(of_metric["mean"], weights=of_metric.cells)
                means.append(f"m_{name} by {sized(mean, np.nan, np.nan)}")

        # All dilutions of precision lack a number in the same cells.
        counts = rows.groupby("layer")[["cells", *COUNTS]].sum()
        closed = counts.loc[CLOSED]
        facts = {
            "cause": cause,
            "means": " and ".join(means) or "no metric",
            "lost": counts.lost.max(),
            "gained": counts.gained.max(),
            "closed": closed.higher,
            "opened": closed.lower,
        }
        return Verdict(MapVerdict.CELLS, n=int(closed.cells), noun="cells", facts=facts)

    def _of_routes(self, cause: str) -> Iterator[Verdict]:
        """Yield how many of A's routes change on B, what it costs to keep them, and how many the border may decide."""
        if self.routes.empty:
            yield Verdict(MapVerdict.NO_ROUTES, needed=np.nan)
            return
        routes = self.routes[self.routes.is_changed.notna()]
        clusters = Clusters(routes.pair)
        by_altitude = routes.groupby("altitude_m").is_changed.agg(["sum", "count"]).itertuples()
        facts = {
            "cause": cause,
            "count": int(routes.is_changed.sum()),
            "where": ", ".join(f"{num:.0f} of {of} at {z_m:g} m" for z_m, num, of in by_altitude),
            "apart_m": (routes.apart_m * routes.is_changed).max(),
            "closed": int(routes.is_closed.sum()),
            "lost": int(routes.best_there.isna().sum()),
        }
        share = 100 * np.array(clusters.interval(routes.is_changed, "share"))
        yield Verdict(MapVerdict.ROUTES, (), *share, len(routes), "%", facts=facts)
        kept = effects(100 * routes[["regret"]], clusters).iloc[0]
        if facts["count"] and kept.n:
            size = kept["size"], kept.low, kept.high
            yield Verdict(MapVerdict.KEPT, (), *size, int(kept.n), "%", "pairs", kept.needed)
        yield from border_verdict(routes.at_edge.to_numpy() > 0)

    def _of_guesses(self) -> Iterator[Verdict]:
        """Yield that the sets rest on other guesses, such as how far their rays stay within the data."""
        of_a, of_b = self.a.guesses, self.b.guesses
        facts = {
            "of_a": names_of(each for each in of_a if each not in of_b) or "none",
            "of_b": names_of(each for each in of_b if each not in of_a) or "none",
        }
        if of_a != of_b:
            yield Verdict(MapVerdict.GUESSES, needed=np.nan, facts=facts)

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, what is compared, and what was left out."""
        a, b = self.names
        return {**self.decided.facts, "A": a, "B": b, "left out": ", ".join(self.left_out)}


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
      routes: pairs of places that a path on A joins at every altitude, as studies draw them; the cheapest route on A
        is judged on B (`MapComparison.routes`), by A's weights, cost model and constraints, at the first time.
      seed: of these places.
      progress: True for a bar (off a terminal, lines in the log), False for none, or a function (stage, done, total).

    Returns:
      `MapComparison`: its ``table`` has a row per layer, altitude, time and time of day with statistics of B - A,
      `difference` returns those of a layer, and ``save`` writes the report.

    Raises:
      InputError: maps of another CRS or resolution, that share no cell, altitude, time or layer, a wrong argument, or
        too few pairs that a path on A joins.

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
    # The arguments, and the part that both maps hold, for routes under the settings of A's scenario.
    at_least("routes", routes)
    at_least("seed", seed)
    a = _opened(maps_a)
    b = _opened(maps_b)
    part_a, part_b = shared_part(a, b.with_obstacles(b.rule or a.obstacles))
    part_b = part_b.with_recorded(a.recorded)

    settings = None
    of_a, of_b = map(_settings_of, (a, b))
    if of_a is not None and of_b is not None:
        settings = differing(of_a, of_b)
    result = MapComparison(
        names=(str(a.folder or ""), str(b.folder or "")),
        a=_with_closed(part_a),
        b=_with_closed(part_b),
        left_out=(*_left_out(a, part_a), *_left_out(b, part_b)),
        settings=settings,
        seed=seed,
    )

    with reporting("compare", progress) as report:
        layers = report.over("layers", result.layers)
        rows = [_statistics(layer, result.difference(layer)) for layer in layers]
        table = pd.concat(rows).rename(columns={ALTITUDE: "altitude_m"}).reindex(columns=COLUMNS)
        table["time"] = table["time"].map(iso_utc, na_action="ignore")
        table["share_changed"] = (table.higher + table.lower) / table.cells
        judged = result.routes
        if routes:
            times = next(iter(result.times.items()), (None, None))
            judged = compared_routes(part_a, part_b, routes, seed, times, report)
    return replace(result, table=table.reset_index(drop=True), routes=judged)


def _opened(maps: MapsLike | MapsFolder) -> MetricMaps:
    """Return maps, read from their folder if they are one."""
    if isinstance(maps, MetricMaps):
        return maps
    return (maps if isinstance(maps, MapsFolder) else MapsFolder(maps)).open()


def _settings_of(maps: MetricMaps) -> dict[str, Any] | None:
    """Return the settings that made maps; None where they cannot be read, as for maps in memory."""
    with suppress(OSError, ValueError, LookupError):
        return read_json(maps.folder / RUN_FILE)["settings"] if maps.folder else None
    return None


def _with_closed(maps: MetricMaps) -> MetricMaps:
    """Return maps with the layer `CLOSED`."""
    is_free = np.stack([maps.is_free(altitude_m) for altitude_m in maps.altitudes_m])
    layer = xr.Variable((ALTITUDE, *CELLS), ~is_free, {"long_name": "cells that no planner enters"})
    return replace(maps, ds=maps.ds.assign({CLOSED: layer}))


def _left_out(maps: MetricMaps, part: MetricMaps) -> Iterator[str]:
    """Yield the layers, altitudes and times of day of maps that their shared part lacks, and how many of its cells."""
    for name in maps.ds.data_vars:
        if name not in part.ds and "y" in maps.ds[name].dims:  # layers, not scalars
            yield str(name)
    yield from (f"altitude {z_m:g} m" for z_m in maps.altitudes_m if z_m not in part.altitudes_m)
    yield from (f"time of day {day}" for day in maps.times_of_day if day not in part.times_of_day)
    num_cells = maps.ds["has_data"].size - part.ds["has_data"].size
    if num_cells:
        yield f"{num_cells:,} cells"


def _statistics(layer: str, change: xr.DataArray) -> pd.DataFrame:
    """Return a row of statistics for each map of a layer's differences (`MapComparison.table`).

    Where no difference is finite, the statistics are NaN.

    Args:
      layer: its name.
      change: ``[..., y, x]``, NaN where it is not known.
    """
    finite = change.where(np.isfinite(change)).astype(np.float64)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # without a number
        columns = {
            "cells": change.count(CELLS),
            "mean": finite.mean(CELLS),
            "median": finite.median(CELLS),
            "p05": finite.quantile(0.05, CELLS).drop_vars("quantile"),
            "p95": finite.quantile(0.95, CELLS).drop_vars("quantile"),
            "rms": np.sqrt((finite**2).mean(CELLS)),
            "higher": (change > 0).sum(CELLS),
            "lower": (change < 0).sum(CELLS),
            "lost": (change == np.inf).sum(CELLS),
            "gained": (change == -np.inf).sum(CELLS),
        }
    unit = change.attrs.get("units", "1")
    maps = xr.Dataset(columns).expand_dims(layer=[layer], unit=[unit])
    return maps.to_dataframe().reset_index()
