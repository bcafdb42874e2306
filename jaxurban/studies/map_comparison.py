"""compare: two sets of maps of one place, cell by cell, on the part that both hold."""

import json
import shlex
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from jaxurban.checks import at_least, one_of, typed
from jaxurban.io.files import read_json
from jaxurban.io.stored import RUN_FILE
from jaxurban.io.workspace import Differing, differing
from jaxurban.maps.metric_maps import MapsLike, MetricMaps, as_maps
from jaxurban.maps.shared import paired_times, shared_part
from jaxurban.metrics.base import ALTITUDE
from jaxurban.paths.rows import MapsFolder
from jaxurban.progress import Progress, reporting
from jaxurban.settings import iso_utc
from jaxurban.statistics.bootstrap import Clusters
from jaxurban.statistics.conclusions import Conclusion, Verdict, concluded, sized
from jaxurban.studies.baseline import baseline_verdicts
from jaxurban.studies.compared_routes import SAME as SAME_COST
from jaxurban.studies.compared_routes import compared_routes
from jaxurban.studies.decided import border_verdict, effects, ended_sides, wider_bounds
from jaxurban.studies.results import StudyResult

CELLS = ("y", "x")
SAME = 1e-5  # values that differ by no more, above 1 by no larger share, are equal: of float32, on another device
COLUMNS = (
    *("layer", "unit", "altitude_m", "time", "time_of_day"),
    *("cells", "mean_a", "mean", "rms", "higher", "lower", "lost", "gained"),
)
LATER_HOURS = (0, 3, 6, 9)
USUAL_ROUTES = 40  # at each altitude, from which routes are judged


class MapVerdict(Enum):
    """Kinds of verdicts on two sets of maps; ``cause`` is the one setting that differs, else B."""

    CELLS = (
        "{cause} changes {means} on average; of {free:,} free cells at all altitudes and times {lost:,} lose their "
        "fix and {gained:,} gain one (means of DOPs leave these out), and of {n}, free or not, {closed:,} become "
        "obstacles and {opened:,} free"
    )
    ROUTES = (
        "{count:,} of A's {n}, {size}, are closed on B or cost over {same:g} % more there than B's own ({where}), and "
        "these are up to {apart_m:,.0f} m away; B closes {closed:,} of A's, and {lost:,} have no way on B"
    )
    KEPT = "routes of A that B leaves open cost {size} more on B than B's own, on average ({n})"
    KEPT_OPEN = (
        "how much more routes of A cost on B than B's own, on average, is open: {size} ({n})"
    )
    NO_ROUTES = "whether routes change: none were planned"
    ONE_TIME = (
        "how much of it is of this one time, {time}, where a single satellite that rises or sets may make all of it: "
        "maps of further times show it ([gps] times)"
    )
    GUESSES = "how much of it comes of what they guess differently (A: {of_a}; B: {of_b})"


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(StudyResult):
    """Maps B beside maps A, on the cells, altitudes, times and layers that both hold.

    Attributes:
      names: folders of A and B; empty for maps in memory.
      a, b: the maps, cut to what both hold; both with the settings of A's scenario for routes.
      left_out: names of the layers that one of them lacks.
      settings: of the scenarios that made the maps, A's and B's value by dotted key where they differ; empty where one
        of them was not made by `jaxurban maps`.
      table: a row per layer, altitude, time and time of day: ``cells`` that are free (by the rule of ``obstacle``) and
        hold a number in both, ``mean_a``, the mean of A, and ``mean`` and ``rms`` (root of the mean square) of B - A,
        where these are finite, in the layer's ``unit``, ``higher`` and ``lower``, the cells that are higher, and lower,
        in B, and ``lost`` and ``gained``, those of them whose value is infinite, as a DOP is without a fix, in B alone,
        and in A alone, which neither mean nor rms counts. Of ``obstacle`` and of layers without altitudes the cells are
        all with data in both.
      routes: a row for each route of A on B (`compared_routes`); empty where none were asked for.
      routes_file: where these are written; empty where that is not known.

    Examples:
      >>> higher_mask = ju.build_maps(city, resolution_m=20.0, altitudes_m=(60.0,), gps=ju.Gps(mask_deg=30.0))
      >>> change = ju.studies.compare(maps, higher_mask, progress=False)
      >>> change.layers[:3], change.a.grid.shape
      (('obstacle', 'gps', 'gdop'), (30, 30))
      >>> change.a.altitudes_m, change.left_out
      ((60.0,), ())
    """

    _command = "compare"
    _report = "jaxurban.studies.reports.map_comparison:comparison_report"

    names: tuple[str, str]
    a: MetricMaps
    b: MetricMaps
    left_out: tuple[str, ...]
    settings: Differing = field(default_factory=dict)
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    routes: pd.DataFrame = field(default_factory=pd.DataFrame)
    routes_file: str = ""

    @property
    def layers(self) -> tuple[str, ...]:
        """The layers that both hold."""
        return tuple(map(str, self.a.ds.drop_vars("has_data").data_vars))

    @typed
    def difference(self, layer: str) -> xr.DataArray:
        """Return B - A of a layer.

        Args:
          layer: one of `layers`.

        Returns:
          The differences by time, altitude and time of day, as far as the layer has them, and ``[y, x]``, float32 in
          its unit; times are A's. NaN where either is blocked or holds no number. Of ``obstacle`` 1 where only B is
          blocked, -1 where only A is, NaN without data. Sizes up to `SAME`, of values above 1 that share of them, are
          0. Infinite values (dilutions of precision) differ by 0 where both are infinite, else by an infinite number.

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
        is_same = abs(change) <= SAME * np.minimum(abs(a), abs(b)).clip(1)
        change = change.where((a != b) & ~is_same, np.float32(0))

        # Obstacles and layers without altitudes have a number wherever there are data, others where cells are free too.
        is_known = self.a.ds["has_data"] & self.b.ds["has_data"]
        if ALTITUDE in a.dims and layer != "obstacle":
            is_known = is_known & (self.a.ds["obstacle"] == 0) & (self.b.ds["obstacle"] == 0)
        return change.where(is_known).transpose(..., *CELLS)

    @cached_property
    def decided(self) -> Conclusion:
        """What B's maps change in the cost's metrics, in the cells open to planners, and for routes."""
        of_time = self._of_time()
        verdicts = [self._of_cells(), *self._of_routes(), *of_time, *self._of_guesses()]

        # Commands that can be pasted as they are; of maps in memory they are Python's.
        more = "ju.studies.compare(A, B, routes={needed})"
        view = "ju.view(B)"
        wider = "ju.build_maps(city, grid=wider_grid)"
        bounds = wider_bounds(self.a)
        if all(self.names):
            a, b = map(shlex.quote, self.names)
            which = f"--resolution {self.a.grid.resolution_m:g}"
            more = f"jaxurban compare {a} {b} {which} --routes {{needed}} -o {b}_routes_{{needed}}"
            view = f"jaxurban view {b} {which}"
            wider = self._again("wider", f"region.bounds={bounds}")
            if of_time:
                view = self._again("times", f"gps.times={json.dumps(self._further_times)}")
        command = more if self.routes.empty else view
        done = command.replace("{needed}", str(USUAL_ROUTES))
        num = 0 if self.routes.empty else self.routes.pair.nunique()
        return concluded(verdicts, more=more, done=done, wider=bounds and wider, ran=num)

    def _again(self, ending: str, setting: str) -> str:
        """Return the command that makes both maps with another setting, in such a folder, and compares them."""
        a, b = map(shlex.quote, self.names)
        made = " ".join(f"{b}_{ending}/{shlex.quote(Path(name).name)}" for name in self.names)
        same = self.routes_file or self.routes.get("pair", pd.Series()).nunique()
        return (
            f"jaxurban maps {a} {b} -o {b}_{ending} --set {shlex.quote(setting)} && jaxurban compare {made} "
            f"--resolution {self.a.grid.resolution_m:g} --routes {same} -o {b}_{ending}_routes"
        )

    @property
    def _further_times(self) -> list[str]:
        """The first time, and those some hours later, when other satellites are low."""
        first = pd.Timestamp(self.table.time.dropna().iloc[0])
        return [iso_utc(str(first + pd.Timedelta(hours=hours))) for hours in LATER_HOURS]

    def _of_time(self) -> list[Verdict]:
        """Return that a difference in the sky may be of the one time that both hold; nothing of several."""
        of_sky = self.table.dropna(subset="time")
        if of_sky.time.nunique() != 1 or not of_sky[["higher", "lower"]].any(axis=None):
            return []
        return [Verdict(MapVerdict.ONE_TIME, needed=np.nan, facts={"time": of_sky.time.iloc[0]})]

    def _of_cells(self) -> Verdict:
        """Return by how much each metric differs on average, and how many cells change for planners."""
        cause = "B"
        if len(self.settings) == 1:
            ((key, (of_a, of_b)),) = self.settings.items()
            cause = f"{key} {setting_said(of_b)} instead of {setting_said(of_a)}"

        means = []
        for name in self.a.metrics:
            mean = float(self.difference(self.a.variable(name)).astype(np.float64).mean())
            if mean:
                means.append(f"m_{name} by {sized(mean, np.nan, np.nan)}")

        # Numbers of cells over all maps of a layer. All DOPs lack a number in the same ones.
        sums: Any = self.table.groupby("layer").sum(numeric_only=True)
        obstacles = sums.loc["obstacle"]
        first = next(map(self.a.variable, self.a.metrics), "obstacle")  # gps, which has times
        facts = {
            "cause": cause,
            "means": " and ".join(means) or "no metric",
            "free": int(sums.cells[first]),
            "lost": int(sums.lost.max()),
            "gained": int(sums.gained.max()),
            "closed": int(obstacles.higher),
            "opened": int(obstacles.lower),
        }
        return Verdict(MapVerdict.CELLS, n=int(obstacles.cells), noun="cells", facts=facts)

    def _of_routes(self) -> Iterator[Verdict]:
        """Yield how many of A's routes change on B, what it costs to keep them, the baseline, and the border's part."""
        if self.routes.empty:
            yield Verdict(MapVerdict.NO_ROUTES, needed=np.nan)
            return
        routes = self.routes.dropna(subset="is_changed")
        by_altitude = routes.groupby("altitude_m").is_changed.agg(["sum", "count"]).itertuples()
        facts = {
            "count": int(routes.is_changed.sum()),
            "same": 100 * SAME_COST,
            "where": ", ".join(f"{num:.0f} of {of} at {z_m:g} m" for z_m, num, of in by_altitude),
            "apart_m": (routes.apart_m * routes.is_changed).fillna(0).max(),
            "closed": int(routes.is_closed.sum()),
            "lost": int(routes.best_there.isna().sum()),
        }
        clusters = Clusters(routes.pair)
        share, low, high = (100 * each for each in clusters.interval(routes.is_changed, "share"))
        yield Verdict(MapVerdict.ROUTES, (), share, low, high, len(routes), "%", facts=facts)
        regret = effects(100 * routes[["regret"]], clusters, least=0.0)
        size, low, high, num, needed = regret.to_numpy()[0]
        if facts["count"] and num:
            kind = MapVerdict.KEPT_OPEN if needed else MapVerdict.KEPT
            yield Verdict(kind, (), size, low, high, int(num), "%", "pairs", needed)
        yield from baseline_verdicts(routes, routes.pair, "pairs")
        yield from border_verdict(routes.at_edge.to_numpy() > 0, ended=ended_sides(self.a))

    def _of_guesses(self) -> Iterator[Verdict]:
        """Yield that sets that differ rest on other guesses, such as how far their rays stay within the data."""
        of_a, of_b = self.a.guesses, self.b.guesses
        if of_a != of_b and self.table[["higher", "lower"]].any(axis=None):
            own_a = [each.name for each in of_a if each not in of_b]
            own_b = [
                f"{each.name} in another way" if each.name in own_a else each.name
                for each in of_b
                if each not in of_a
            ]
            facts = {
                "of_a": ", ".join(own_a) or "nothing",
                "of_b": ", ".join(own_b) or "nothing",
            }
            yield Verdict(MapVerdict.GUESSES, needed=np.nan, facts=facts)

    @property
    def facts(self) -> dict[str, str]:
        """What it decided, and what is compared."""
        return self.decided.facts | dict(zip("AB", self.names, strict=True))


@typed
def compare(
    maps_a: MapsLike | MapsFolder,
    maps_b: MapsLike | MapsFolder,
    *,
    routes: int | pd.DataFrame = 0,
    seed: int = 0,
    progress: Progress = True,
) -> MapComparison:
    """Return how maps B differ from maps A, cell by cell.

    Both must have one CRS and one resolution. Compared are the cells, altitudes, times and layers that both hold.

    Args:
      maps_a, maps_b: from `build_maps` or `open_maps`, or folders of one resolution's maps; a `MapsFolder` where a
        folder holds several, or planners are to keep another rule of obstacles.
      routes: pairs of places that a path on A joins at every altitude, as studies draw them; or a table with their ends
        and ``altitude_m``, as of another comparison; the cheapest route on A is judged on B (`MapComparison.routes`),
        by A's weights, cost model and constraints, at the first time.
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
    if isinstance(routes, int):
        at_least("routes", routes)
    at_least("seed", seed)
    a = _opened(maps_a)
    b = _opened(maps_b)
    part_a, part_b = shared_part(a, b.with_obstacles(b.rule or a.obstacles))
    part_b = part_b.with_recorded(a.recorded)
    settings: Differing = {}
    if a.folder and b.folder:
        with suppress(OSError, ValueError, LookupError):  # maps that `jaxurban maps` did not make
            records = (read_json(folder / RUN_FILE)["settings"] for folder in (a.folder, b.folder))
            settings = differing(*records)
    result = MapComparison(
        names=(str(a.folder or ""), str(b.folder or "")),
        a=part_a,
        b=part_b,
        left_out=tuple(sorted({*a.ds.data_vars, *b.ds.data_vars} - {*part_a.ds.data_vars})),
        settings=settings,
    )

    with reporting("compare", progress) as report:
        layers = report.over("layers", result.layers)
        rows = [
            _statistics(layer, result.a.ds[layer], result.difference(layer)) for layer in layers
        ]
        table = pd.concat(rows, ignore_index=True)
        table = table.rename(columns={ALTITUDE: "altitude_m"}).reindex(columns=COLUMNS)
        table["time"] = table["time"].map(iso_utc, na_action="ignore")
        judged = result.routes
        if not isinstance(routes, int) or routes:
            times = next(iter(paired_times(part_a, part_b).items()), (None, None))
            judged = compared_routes(part_a, part_b, routes, seed, times, report)
    return replace(result, table=table, routes=judged)


def setting_said(value: Any) -> str:
    """Return the value of a setting as sentences have it; one that is left out is none."""
    return "none" if value is None else str(value)


def _opened(maps: MapsLike | MapsFolder) -> MetricMaps:
    """Return maps, read from their folder if they are one."""
    return maps.open() if isinstance(maps, MapsFolder) else as_maps(maps)


def _statistics(layer: str, of_a: xr.DataArray, change: xr.DataArray) -> pd.DataFrame:
    """Return a row of statistics for each map of a layer's differences (`MapComparison.table`).

    Where no difference is finite, the statistics are NaN.

    Args:
      layer: its name.
      of_a: ``[..., y, x]`` its values in A.
      change: ``[..., y, x]``, NaN where it is not known.
    """
    finite = change.where(np.isfinite(change)).astype(np.float64)
    columns = {
        "cells": change.count(CELLS),
        "mean_a": of_a.where(finite.notnull() & np.isfinite(of_a)).mean(CELLS, dtype=np.float64),
        "mean": finite.mean(CELLS),
        "rms": np.sqrt((finite**2).mean(CELLS)),
        "higher": (change > 0).sum(CELLS),
        "lower": (change < 0).sum(CELLS),
        "lost": (change == np.inf).sum(CELLS),
        "gained": (change == -np.inf).sum(CELLS),
    }
    key = {"layer": [layer], "unit": [change.attrs.get("units", "1")]}
    return xr.Dataset(columns).expand_dims(key).to_dataframe().reset_index()
