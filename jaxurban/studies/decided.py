"""Alternatives in groups of ranks, effects with their intervals, and what the border of the maps decides.

Alternatives (planners, weights) are compared two by two on the same runs, and all differences of one call have
intervals that are simultaneous: with 95 % none of them misses its truth. So whichever of them a report selects, it may
say. The rank of an alternative is 1 and the number of those that are before it, of which the interval excludes 0; what
cannot be told apart shares a rank (Mogstad et al., Rev. Econ. Stud. 91, 2024). The half-width is a quantile of the
largest deviation among all differences, each in its standard errors over bootstrap draws of whole groups, which
Student's t widens for few groups.
"""

import itertools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely
from scipy import ndimage, special

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, LEVEL, Clusters
from jaxurban.statistics.conclusions import SAME, SharedVerdict, Verdict, runs_needed, singular
from jaxurban.world.grid import Grid

FEWEST_RUNS = 10  # of a stratum of which something is said
EDGE_CELLS = 3  # a route this near to the border of the data may be what the border made it
SIDES = {
    "west": (0, -1),
    "south": (-1, 0),
    "east": (0, 1),
    "north": (1, 0),
}  # steps of row and column
USUAL_SHARE = 0.25  # is held out of a fit
FEWEST_TO_HOLD_OUT = 16  # routes: of fewer none is held out
MOST_APART = 32  # runs: alternatives that have none of so many in common are not compared


def effects(
    values: np.ndarray | pd.DataFrame, clusters: Clusters, least: float = -math.inf
) -> pd.DataFrame:
    """Return means with intervals that hold all at once: a row per column of the values, by its name.

    ``size``, ``low``, ``high``; ``n``, the number of groups; ``needed`` (`runs_needed`). Ends are NaN with fewer groups
    than `FEWEST_GROUPS`; what is needed then rests on the spread of these few, by the normal law (Šidák's level).

    Args:
      values: ``[N, P]`` in the order of the groups; NaN does not count.
      clusters: draws of the groups of the ``N`` values.
      least: what no value is below, such as 0 of regrets, and so no end.
    """
    table = pd.DataFrame(values)
    size = table.mean()
    num = pd.Series(map(clusters.groups_of, table.notna().to_numpy().T), table.columns, dtype=int)
    drawn = pd.DataFrame({name: clusters.drawn(table[name].to_numpy()) for name in table})
    spread = drawn.std(ddof=0)

    # The largest deviation of each draw, in standard errors of its column, and its quantile; then, for each column, the
    # same level of Student's t.
    has_interval = num >= FEWEST_GROUPS
    varies = spread > SAME * size.abs()
    largest = ((drawn - size) / spread).loc[:, varies & has_interval].abs().max(axis=1)
    student = special.stdtrit(num.clip(lower=2) - 1, special.ndtr(largest.quantile(LEVEL)))
    normal = special.ndtri((1 + LEVEL ** (1 / max(len(size), 1))) / 2)
    half = np.where(has_interval, student, normal) * spread * np.sqrt(num / (num - 1).clip(lower=1))
    half = half.where(varies, 0.0)
    count = [clusters.count(is_known) for is_known in table.notna().to_numpy().T]
    ends = {"size": size, "low": size - half, "high": size + half, "n": count}
    result = pd.DataFrame(ends)
    needed = pd.Series([runs_needed(*row) for row in result.itertuples(index=False)], size.index)
    few = needed.clip(FEWEST_GROUPS).replace(math.inf, FEWEST_GROUPS)
    result[["low", "high"]] = result[["low", "high"]].clip(least).where(has_interval)
    return result.assign(needed=needed.where(has_interval, few))


class Measure(NamedTuple):
    """What alternatives are compared by.

    Attributes:
      values: a row per run and a column per alternative; NaN where a run has none.
      unit: of the differences; those of ratios are in %.
      is_ratio: values are positive, and compared by their ratio.
      is_better_high: more is better.
      largest: the largest difference that can be, in the unit, beyond which no interval goes.
    """

    values: pd.DataFrame
    unit: str = "%"
    is_ratio: bool = False
    is_better_high: bool = False
    largest: float = math.inf


@dataclass(frozen=True, eq=False)
class Ranking:
    """Alternatives in groups of ranks.

    Attributes:
      measure: what they are compared by.
      names: the alternatives, the best first; those that are equal on all runs stand as one, ``"a = b"``.
      equal: the names of these, for each such group.
      pairs: a row for each two names: ``first``, ``second`` (the worse one on average), ``size`` (second over first,
        from 0 up), ``low``, ``high``, ``n`` and ``needed``; first is before second where this is 0.
      unit: of the sizes.
      n: number of groups of runs.
      num_common: number of those in which all have a value.
    """

    measure: str
    names: tuple[str, ...]
    equal: tuple[tuple[str, ...], ...]
    pairs: pd.DataFrame
    unit: str
    n: int
    num_common: int

    @property
    def table(self) -> pd.DataFrame:
        """A row per name: ``measure``, ``rank``, ``name``, and ``behind`` the first one, in ``unit``, of ``n`` groups.

        The ends of the interval are ``behind_low`` and ``behind_high``; the first one has no numbers.
        """
        columns = {"size": "behind", "low": "behind_low", "high": "behind_high"}
        behind = self.pairs[self.pairs["first"] == self.names[0]].set_index("second")
        num_before = self.pairs[self.pairs.needed == 0].second.value_counts()
        table = behind.reindex(self.names).rename(columns=columns)[[*columns.values(), "n"]]
        rank = 1 + num_before.reindex(self.names, fill_value=0)
        table = table.assign(measure=self.measure, rank=rank, name=self.names, unit=self.unit)
        shown = ["measure", "rank", "name", *columns.values(), "unit", "n"]
        return table.sort_values("rank", kind="stable")[shown]

    def verdicts(self, before: Enum, noun: str, tied: Enum = SharedVerdict.TIED) -> list[Verdict]:
        """Return what the ranks say: who is behind whom, who is equal, and who cannot be told apart or compared.

        Args:
          before: kind of a difference that is decided: ``{last}`` is worse than ``{first}`` by ``{size}``.
          noun: what runs are.
          tied: kind of those that cannot be told apart; ``{size}`` is between the outermost of them.
        """
        # Of each name behind another its largest difference to one before it; then names that are tied.
        decided = self.pairs[self.pairs.needed == 0].sort_values("size")
        pairs: Any = decided.drop_duplicates("second", keep="last").itertuples()
        behind = ((before, (row.first, row.second), row) for row in pairs)
        rows = [*behind, *((tied, names, row) for names, row in self._tied())]
        facts = {"measure": self.measure}
        verdicts = []
        for kind, what, row in rows:
            size = row.size, row.low, row.high
            verdicts.append(Verdict(kind, what, *size, row.n, self.unit, noun, row.needed, facts))

        # And those that are equal, and those that have no runs in common.
        num = self.num_common
        needed = math.inf if num >= FEWEST_GROUPS else FEWEST_GROUPS
        verdicts += [
            Verdict(SharedVerdict.EQUAL, each, 0.0, n=num, noun=noun, needed=needed, facts=facts)
            for each in self.equal
        ]
        apart = self.pairs[self.pairs.n == 0]
        needed = math.nan if self.n >= MOST_APART else FEWEST_GROUPS
        verdicts += [
            Verdict(SharedVerdict.APART, each, noun=noun, needed=needed, facts=facts)
            for each in zip(apart["first"], apart["second"], strict=True)
        ]
        return verdicts

    def _tied(self) -> Iterator[tuple[tuple[str, ...], Any]]:
        """Yield names in order, as many as have runs in common and no decided pair, and the pair of the outermost.

        The better one of the outermost, on the runs that both have, stands first and the other last.
        """
        pair_of: dict[frozenset, Any] = {
            frozenset((row.first, row.second)): row for row in self.pairs.itertuples()
        }
        end = 0
        for begin in range(len(self.names)):
            stop = begin + 1
            for name in self.names[stop:]:
                others = self.names[begin:stop]
                pairs = [pair_of[frozenset((name, other))] for other in others]
                if not all(pair.needed and pair.n for pair in pairs):
                    break
                stop += 1
            if stop > max(end, begin + 1):
                outermost = pair_of[frozenset((self.names[begin], self.names[stop - 1]))]
                between = self.names[begin + 1 : stop - 1]
                yield (outermost.first, *between, outermost.second), outermost
            end = max(end, stop)


def ranked(measures: Mapping[str, Measure], clusters: Clusters) -> dict[str, Ranking]:
    """Return alternatives in groups of ranks by each measure, with intervals that hold for all measures at once.

    Args:
      measures: by name, of the same ``N`` runs.
      clusters: draws of the groups of the runs, such as pairs of places at several altitudes.
    """
    # Of each measure its values, less being better; and the differences [N] of each two alternatives, worse over better
    # on average, 0 where they are the same to the precision of a sum.
    columns = {}
    equal = {}
    keys: list[tuple] = []
    differences: dict[int, np.ndarray] = {}
    for name, measure in measures.items():
        values = -measure.values if measure.is_better_high else measure.values
        if measure.is_ratio:
            values = values.map(math.log)
        columns[name], equal[name] = _without_equal(values)
        for first, second in itertools.combinations(columns[name], 2):
            sides = columns[name][first], columns[name][second]
            change = np.where(np.isclose(*sides, SAME, SAME), 0.0, sides[1] - sides[0])
            differences[len(keys)] = change
            keys.append((name, first, second))
    table = pd.DataFrame(keys, columns=["measure", "first", "second"])
    table = table.join(effects(pd.DataFrame(differences), clusters))

    # Over the runs that both have the order may be another one.
    is_turned = table["size"] < 0
    for one, other in (("first", "second"), ("low", "high")):
        table.loc[is_turned, [one, other]] = table.loc[is_turned, [other, one]].to_numpy()
    table.loc[is_turned, ["size", "low", "high"]] *= -1
    result = {}
    for name, measure in measures.items():
        pairs = table[table.measure == name].drop(columns="measure")
        if measure.is_ratio:
            pairs[["size", "low", "high"]] = 100 * np.expm1(pairs[["size", "low", "high"]])
        ends = pairs[["low", "high"]].clip(-measure.largest, measure.largest)
        pairs[["low", "high"]] = ends
        names = tuple(map(str, columns[name]))
        num_common = clusters.count(measure.values.notna().all(axis=1).to_numpy())
        about = measure.unit, clusters.num_groups, num_common
        result[name] = Ranking(name, names, equal[name], pairs, *about)
    return result


def _without_equal(values: pd.DataFrame) -> tuple[pd.DataFrame, tuple[tuple[str, ...], ...]]:
    """Return values with one column for those that are equal on all runs, and the names of these.

    The least on the runs that all have stands first; where there are none, the least on its own runs.
    """
    groups: dict[str, list[str]] = {}
    for name in map(str, values):
        same = [
            each for each in groups if np.allclose(values[each], values[name], SAME, SAME, True)
        ]
        groups.setdefault(same[0] if same else name, []).append(name)
    merged = values[[*groups]].rename(columns={each: " = ".join(groups[each]) for each in groups})
    common = merged.dropna()
    order = (merged if common.empty else common).mean().sort_values(kind="stable").index
    return merged[order], tuple(tuple(each) for each in groups.values() if len(each) > 1)


def edge_band(maps: MetricMaps) -> np.ndarray:
    """Return ``[Y, X]`` bool: the cells within `EDGE_CELLS` of the border of the maps or of their data."""
    has_data = maps.ds["has_data"].values
    return ~ndimage.minimum_filter(has_data, 2 * EDGE_CELLS + 1, mode="constant", cval=False)


def is_at_edge(points_m: np.ndarray, grid: Grid, band: np.ndarray) -> bool:
    """Return whether a route comes into the band along the border, further from its ends than twice the band's width.

    Args:
      points_m: ``[N, 2]`` the route, metres from the map's southwest corner.
      grid: of the maps.
      band: from `edge_band`.
    """
    # Places along the route, half a cell apart at most, without those near its ends.
    line = shapely.segmentize(shapely.LineString(points_m), grid.resolution_m / 2)
    places_m = shapely.get_coordinates(line)
    ends_m = np.asarray(points_m)[[0, -1]]
    away_m = np.linalg.norm(places_m[:, None] - ends_m, axis=-1).min(axis=1)
    x_m, y_m = (places_m[away_m > 2 * EDGE_CELLS * grid.resolution_m] + grid.bounds_m[:2]).T
    rows, cols = grid.cell_of_xy(x_m, y_m)
    return bool(band[rows, cols].any())


def sides_at_edge(points_m: np.ndarray, maps: MetricMaps) -> list[str]:
    """Return the sides (`SIDES`) to which the data end within `EDGE_CELLS` of a route, away from its ends.

    Args:
      points_m: ``[N, 2]`` the route, metres from the map's southwest corner.
      maps: of the route.
    """
    known = np.pad(maps.ds["has_data"].values, EDGE_CELLS)
    sides = []
    for side, step in SIDES.items():
        moved = [np.roll(known, -num * np.array(step), (0, 1)) for num in range(EDGE_CELLS + 1)]
        band = ~np.all(moved, axis=0)[EDGE_CELLS:-EDGE_CELLS, EDGE_CELLS:-EDGE_CELLS]
        if is_at_edge(points_m, maps.grid, band):
            sides.append(side)
    return sides


def ended_sides(maps: MetricMaps) -> list[str]:
    """Return the sides (`SIDES`) on which the source of the buildings ends within `EDGE_CELLS` of the maps."""
    reach_m = np.abs(_wider_m(maps) - np.reshape(maps.grid.bounds_m, (2, 2))).ravel()
    is_end = reach_m <= EDGE_CELLS * maps.grid.resolution_m
    return [side for side, ends in zip(SIDES, is_end, strict=True) if ends]


def wider_bounds(maps: MetricMaps, sides: Collection[str] = SIDES) -> str:
    """Return bounds a quarter wider to each side, as ``--set region.bounds=`` takes them.

    They end where the source of the buildings does (``known_bounds_m`` of the maps), as the ground beyond is taken as
    free. Empty where it ends at the maps on all sides that matter (`ended_sides`).

    Args:
      maps: whose bounds are made wider.
      sides: that matter, such as those that a route comes near to.
    """
    if not {*sides} - {*ended_sides(maps)}:
        return ""
    lonlat = maps.grid.lonlat_at(_wider_m(maps)).round(5)  # to 1 m, so that no cell is lost
    return str(lonlat.ravel().tolist())


def _wider_m(maps: MetricMaps) -> np.ndarray:
    """Return ``[2, 2]`` the southwest and the northeast corner of `wider_bounds`, in the grid's CRS."""
    grid = maps.grid
    low_m, high_m = np.reshape(grid.bounds_m, (2, 2))
    quarter_m = (high_m - low_m) / 4
    wide_m = low_m - quarter_m, high_m + quarter_m
    known_m = np.reshape(maps.ds.attrs.get("known_bounds_m", wide_m), (2, 2))
    return known_m.clip([wide_m[0], high_m], [low_m, wide_m[1]])


def border_verdict(
    is_pinned: np.ndarray,
    noun: str = "routes",
    sides: Collection[str] = (),
    ended: Collection[str] = (),
) -> list[Verdict]:
    """Return how many routes the border may have decided; nothing where none comes near it.

    Args:
      is_pinned: ``[N]`` bool, of each route (`is_at_edge`).
      noun: what they are.
      sides: that they come near to; empty: not known.
      ended: sides on which the source of the maps ends (`ended_sides`).
    """
    count = int(np.sum(is_pinned))
    if not count:
        return []
    n = len(is_pinned)
    which = f"{count:,} of {n:,} {noun}" if n > 1 else f"the {singular(noun)}"
    which += " comes" if count == 1 else " come"
    where = f" in the {' and '.join(sides)}" if sides else ""
    beyond = " and ".join(side for side in ended if side in sides or not sides)
    wider = "maps of wider bounds"
    if beyond:
        wider += f", and in the {beyond}, where their source ends, by a wider source"
    facts = {"which": which, "count": count, "cells": EDGE_CELLS, "where": where, "wider": wider}
    return [Verdict(SharedVerdict.BORDER, n=n, noun=noun, needed=math.nan, facts=facts)]
