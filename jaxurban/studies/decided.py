"""What a study decided, what it did not, and what to run next: records, and the three lines that stand first.

A `Verdict` is a record: its kind, what it is about, the size of the effect with its interval, the number of runs and
the unit. Its sentence is made where it is shown, and no code decides by one. Each study has its own kinds, an `Enum`
whose values are sentences with places for the record's fields (`Verdict.sentence`); `SharedVerdict` holds those of all.

Alternatives (planners, weights) are compared two by two on the same runs, and all differences of one call have
intervals that are simultaneous: with 95 % none of them misses its truth. So whichever of them a report selects, it may
say. One alternative is before another where their interval excludes 0, or where a third lies between them. Its rank is
1 and the number of those before it, so what cannot be told apart by any chain shares a rank (Mogstad et al., Rev. Econ.
Stud. 91, 2024). The half-width is a quantile of the largest deviation among all differences, each in its standard
errors over bootstrap draws of whole groups, which Student's t widens for few groups.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import shapely
from scipy import ndimage, special

from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.public import FactsRepr
from jaxurban.studies.bootstrap import FEWEST_GROUPS, LEVEL, NUM_DRAWS, Clusters
from jaxurban.world.grid import Grid

FEWEST_RUNS = 10  # of a stratum of which something is said
FOUND_SHARE = 0.9  # of repeated studies of the needed size, which find the effect
MOST_RUNS = 100_000  # more are called "no number"
SAME = 1e-9  # relative, and in the unit of the values: what differs by less is equal
EDGE_CELLS = 3  # a route this near to the border of the data may be what the border made it
USUAL_SHARE, FEWEST_TO_HOLD_OUT = (
    0.25,
    16,
)  # is held out of a fit where it has so many routes or more
SHOWN = 3  # sentences of a line


class SharedVerdict(Enum):
    """Kinds of verdicts that several studies have; each is a sentence with places for the record's fields."""

    EQUAL = "{what} are equal in {measure} on all {n}"
    TIED = "{what} cannot be told apart in {measure} ({last} over {first}: {size}, {n})"
    BORDER = (
        "{count:,} of {n} come within {cells} cells of the border of the maps' data, away from their ends: whether the "
        "border made them is not decided by more routes, but by maps of wider bounds"
    )


@dataclass(frozen=True)
class Verdict:
    """What a study says to one question.

    Attributes:
      kind: its value is the sentence, with places for ``{what}`` (all names), ``{first}`` and ``{last}`` of them,
        ``{size}`` (with unit and interval), ``{n}`` (with its noun) and the names of ``facts``.
      what: names of what it is about, planners or weights, the better one first.
      size, low, high: of the effect, and the ends of its interval, in the unit; NaN where there is none.
      n: number of groups of runs that it rests on.
      unit: of the effect: ``"%"``, ``"m"``, ``"percentage points"``; empty for a plain number.
      noun: what ``n`` counts: ``"routes"``.
      needed: how many would decide it if the effect is as large as it was found to be: 0: it is decided; inf: no number
        would; NaN: the sentence itself says what would.
      facts: what else the sentence says, by name.
    """

    kind: Enum
    what: tuple[str, ...] = ()
    size: float = math.nan
    low: float = math.nan
    high: float = math.nan
    n: int = 0
    unit: str = ""
    noun: str = "routes"
    needed: float = 0.0
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_decided(self) -> bool:
        """Whether the runs decide it."""
        return self.needed == 0

    @property
    def sentence(self) -> str:
        """The record in words, without a full stop; if it is not decided, with the number of runs that would do."""
        *most, last = self.what or ("",)
        words = {
            "what": f"{', '.join(most)} and {last}" if most else last,
            "first": self.what[0] if self.what else "",
            "last": last,
            "size": sized(self.size, self.low, self.high, self.unit),
            "n": f"{self.n:,} {self.noun}",
        }
        sentence = self.kind.value.format_map({**words, **self.facts})
        if self.is_decided or math.isnan(self.needed):
            return sentence
        if math.isinf(self.needed):
            return f"{sentence}; no number of {self.noun} would change that"
        return f"{sentence}; some {self.needed:,.0f} {self.noun} would decide so large an effect"

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain, JSON-ready values; what is not a finite number is None."""
        record = asdict(self) | {"kind": self.kind.name.lower(), "is_decided": self.is_decided}
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in record.items()
        }


@dataclass(frozen=True, repr=False)
class Conclusion(FactsRepr):
    """The three lines that stand first in a study's report, in its result and on the terminal.

    Attributes:
      verdicts: what was asked, the most important first.
      next_command: one command that decides more, or uses what is decided.
    """

    verdicts: tuple[Verdict, ...]
    next_command: str

    @property
    def facts(self) -> dict[str, str]:
        """The three lines by name: ``decided``, ``not decided`` and ``next``."""
        decided = [each for each in self.verdicts if each.is_decided]
        others = [each for each in self.verdicts if not each.is_decided]
        return {
            "decided": _line(decided),
            "not decided": _line(others),
            "next": self.next_command,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return lines and records as plain, JSON-ready values."""
        records = [verdict.to_dict() for verdict in self.verdicts]
        return {"lines": self.facts, "verdicts": records}


def _line(verdicts: Sequence[Verdict]) -> str:
    """Return the sentences of the first verdicts as one line, and how many more there are."""
    sentences = [verdict.sentence for verdict in verdicts[:SHOWN]]
    if len(verdicts) > SHOWN:
        sentences.append(f"{len(verdicts) - SHOWN} more in the records")
    return ". ".join(sentences) + "." if sentences else "Nothing."


def sized(value: float, low: float, high: float, unit: str = "") -> str:
    """Return a number with its unit and its interval, as ``1.3 % (0.9 to 1.7)``.

    Its last digit is that of the second figure of the interval's half-width, so that no digit says what is not known;
    without an interval it has three figures.

    Args:
      value, low, high: in the unit; NaN ends where there is no interval.
      unit: stands once, behind the value.
    """
    half = (high - low) / 2
    scale = half / 10 if half > SAME else abs(value) / 100
    decimals = max(0, -math.floor(math.log10(scale))) if scale > SAME else 0
    numbers = [f"{round(each, decimals) + 0.0:,.{decimals}f}" for each in (value, low, high)]
    text = f"{numbers[0]} {unit}".strip()
    return text if math.isnan(half) else f"{text} ({numbers[1]} to {numbers[2]})"


def runs_needed(size: float, low: float, high: float, n: int) -> float:
    """Return how many runs would decide whether an effect differs from 0, if it is as large as it was found to be.

    So many that the interval excludes 0 in `FOUND_SHARE` of the studies, to two figures; 0 if it does already; inf for
    an effect of 0, and beyond `MOST_RUNS`. Of fewer runs than have an interval: as many as one takes.

    Args:
      size, low, high: of the effect and the ends of its interval; NaN where there is none.
      n: number of runs, counted as the bootstrap's groups.
    """
    if low > 0 or high < 0:
        return 0.0
    if size == 0 and not high > low:
        return math.inf if n >= FEWEST_GROUPS else FEWEST_GROUPS
    if math.isnan(low) or math.isnan(high):
        return max(FEWEST_GROUPS, n + 1)
    if size == 0:
        return math.inf
    half = (high - low) / 2
    further = 1 + special.ndtri(FOUND_SHARE) / special.ndtri((1 + LEVEL) / 2)
    runs = max(n + 1, n * (further * half / abs(size)) ** 2)
    if runs > MOST_RUNS:
        return math.inf
    digit = 10 ** max(0, math.floor(math.log10(runs)) - 1)
    return float(math.ceil(runs / digit) * digit)


def effects(values: np.ndarray, clusters: Clusters) -> pd.DataFrame:
    """Return means with intervals that hold all at once: a row per column of the values.

    ``size``, ``low``, ``high``; ``n``, the number of groups; ``needed`` (`runs_needed`). Ends are NaN with fewer groups
    than `FEWEST_GROUPS`.

    Args:
      values: ``[N, P]`` in the order of the groups; NaN does not count.
      clusters: draws of the groups of the ``N`` values.
    """
    num = np.array([clusters.groups_of(is_known) for is_known in ~np.isnan(values).T])
    size = np.array(
        [np.nanmean(each) if count else np.nan for each, count in zip(values.T, num, strict=True)]
    )
    drawn = np.array([clusters.drawn(column) for column in values.T]).reshape(-1, NUM_DRAWS)
    spread = np.array(
        [np.nanstd(each) if count else 0.0 for each, count in zip(drawn, num, strict=True)]
    )
    has_interval = num >= FEWEST_GROUPS

    # The largest deviation of each draw, in standard errors of its column, and its quantile; then, for each column, the
    # same level of Student's t.
    varies = has_interval & (spread > SAME * np.abs(size))
    reach = 0.0
    if varies.any():
        deviation = np.abs(drawn[varies] - size[varies, None]) / spread[varies, None]
        reach = float(np.quantile(np.nanmax(deviation, axis=0), LEVEL))
    groups = np.maximum(num, 2)
    student = special.stdtrit(groups - 1, special.ndtr(reach)) * np.sqrt(groups / (groups - 1))
    half = np.where(varies, student * spread, 0.0)
    half[~has_interval] = np.nan
    table = pd.DataFrame({"size": size, "low": size - half, "high": size + half, "n": num})
    rows = zip(table["size"], table.low, table.high, table.n, strict=True)
    return table.assign(needed=[runs_needed(*row) for row in rows])


class Measure(NamedTuple):
    """What alternatives are compared by.

    Attributes:
      values: a row per run and a column per alternative; NaN where a run has none.
      unit: of the differences; those of ratios are in %.
      is_ratio: values are positive, and compared by their ratio.
      is_better_high: more is better.
    """

    values: pd.DataFrame
    unit: str = "%"
    is_ratio: bool = False
    is_better_high: bool = False


@dataclass(frozen=True, eq=False)
class Ranking:
    """Alternatives in groups of ranks.

    Attributes:
      measure: what they are compared by.
      names: the alternatives, the best first; those that are equal on all runs stand as one, ``"a = b"``.
      ranks: of each name, from 1; what cannot be told apart shares a rank.
      equal: names of the alternatives that are one, for each such group.
      pairs: a row for each two names: ``first``, ``second`` (the worse one on average), ``size`` (second over first,
        from 0 up), ``low``, ``high``, ``n``, ``needed`` and ``is_before`` (first comes before second).
      unit: of the sizes.
    """

    measure: str
    names: tuple[str, ...]
    ranks: Mapping[str, int]
    equal: tuple[tuple[str, ...], ...]
    pairs: pd.DataFrame
    unit: str

    @property
    def table(self) -> pd.DataFrame:
        """A row per name: ``measure``, ``rank``, ``name``, and ``behind`` the first one, in ``unit``, of ``n`` groups.

        The ends of the interval are ``behind_low`` and ``behind_high``; the first one has no numbers.
        """
        columns = {"size": "behind", "low": "behind_low", "high": "behind_high"}
        pairs = self.pairs[self.pairs["first"] == self.names[0]].rename(columns=columns)
        behind = pairs.set_index("second").reindex(self.names)[[*columns.values(), "n"]]
        ranks = [self.ranks[name] for name in self.names]
        head = {"measure": self.measure, "rank": ranks, "name": self.names}
        return pd.DataFrame(head).join(behind.reset_index(drop=True)).assign(unit=self.unit)

    def verdicts(self, before: Enum, noun: str, tied: Enum = SharedVerdict.TIED) -> list[Verdict]:
        """Return what the ranks say: who is behind whom, who is equal, and who cannot be told apart.

        Args:
          before: kind of a difference that is decided: ``{last}`` is worse than ``{first}`` by ``{size}``.
          noun: what runs are.
          tied: kind of those that cannot be told apart; ``{size}`` is between the outermost of them.
        """
        # Of each name behind another its largest difference to one before it.
        decided = self.pairs[self.pairs.needed == 0].sort_values("size", ascending=False)
        behind = decided.drop_duplicates("second").iloc[::-1]
        verdicts = [self._verdict(before, row, noun) for row in behind.itertuples()]
        counts = int(self.pairs.n.max()) if len(self.pairs) else 0
        verdicts += [
            Verdict(
                SharedVerdict.EQUAL,
                names,
                0.0,
                n=counts,
                noun=noun,
                needed=math.inf,
                facts={"measure": self.measure},
            )
            for names in self.equal
        ]
        for names in self._tied():
            is_outermost = (self.pairs["first"] == names[0]) & (self.pairs.second == names[-1])
            (row,) = self.pairs[is_outermost].itertuples()
            verdicts.append(self._verdict(tied, row, noun, names))
        return verdicts

    def _verdict(self, kind: Enum, pair: Any, noun: str, what: Sequence[str] = ()) -> Verdict:
        """Return the record of a pair, of the names ``what`` where there are more than its two."""
        names = tuple(what) or (pair.first, pair.second)
        size = pair.size, pair.low, pair.high
        facts = {"measure": self.measure}
        return Verdict(kind, names, *size, int(pair.n), self.unit, noun, pair.needed, facts)

    def _tied(self) -> Iterator[tuple[str, ...]]:
        """Yield the largest sets of names of which none comes before another, each in the order of the names."""
        rows = self.pairs[~self.pairs.is_before]
        open_pairs = set(zip(rows["first"], rows.second, strict=True))
        larger: list[set[str]] = []
        for size in range(len(self.names), 1, -1):
            for names in itertools.combinations(self.names, size):
                is_part = any(each.issuperset(names) for each in larger)
                if not is_part and open_pairs.issuperset(itertools.combinations(names, 2)):
                    larger.append(set(names))
                    yield names


def ranked(measures: Mapping[str, Measure], clusters: Clusters) -> dict[str, Ranking]:
    """Return alternatives in groups of ranks by each measure, with intervals that hold for all measures at once.

    Args:
      measures: by name, of the same ``N`` runs.
      clusters: draws of the groups of the runs, such as pairs of places at several altitudes.
    """
    # Of each measure the names, the best first, and the differences [N] of each two of them, worse over better.
    parts = {}
    columns = [np.empty((len(next(iter(measures.values())).values), 0))]
    for name, measure in measures.items():
        values, equal = _without_equal(measure)
        names = [*map(str, values)]
        pairs = list(itertools.combinations(names, 2))
        parts[name] = names, equal, pairs
        columns += [_difference(measure, values[a], values[b])[:, None] for a, b in pairs]
    table = effects(np.hstack(columns), clusters)
    result = {}
    for name, (names, equal, pairs) in parts.items():
        of_measure, table = table[: len(pairs)], table[len(pairs) :]
        result[name] = _ranking(name, measures[name], names, equal, pairs, of_measure)
    return result


def _ranking(
    name: str,
    measure: Measure,
    names: Sequence[str],
    equal: Sequence[tuple[str, ...]],
    pairs: Sequence[tuple[str, str]],
    of_pairs: pd.DataFrame,
) -> Ranking:
    """Return the groups of ranks by one measure.

    Args:
      name: of the measure.
      measure: decides the unit.
      names, equal: as `Ranking` has them.
      pairs: each two of the names.
      of_pairs: a row for each pair, from `effects`; of ratios logarithms.
    """
    # The first of a pair is the better one on average over the runs that both have.
    table = of_pairs.reset_index(drop=True).assign(
        first=[pair[0] for pair in pairs], second=[pair[1] for pair in pairs]
    )
    is_turned = table["size"] < 0
    table.loc[is_turned, ["first", "second"]] = table.loc[is_turned, ["second", "first"]].to_numpy()
    table.loc[is_turned, ["low", "high"]] = -table.loc[is_turned, ["high", "low"]].to_numpy()
    table["size"] = table["size"].abs()
    if measure.is_ratio:
        table[["size", "low", "high"]] = 100 * np.expm1(table[["size", "low", "high"]])

    # [A, A] who comes before whom, also by way of others.
    place = {each: number for number, each in enumerate(names)}
    first = table["first"].map(place).to_numpy(int)
    second = table.second.map(place).to_numpy(int)
    before = np.zeros((len(names), len(names)), bool)
    before[first, second] = table.needed == 0
    for middle in range(len(names)):
        before |= before[:, [middle]] & before[[middle], :]
    ranks = dict(zip(names, (1 + before.sum(axis=0)).tolist(), strict=True))
    order = sorted(names, key=lambda each: (ranks[each], place[each]))
    table = table.assign(is_before=before[first, second] | before[second, first])
    return Ranking(name, tuple(order), ranks, tuple(equal), table, measure.unit)


def _difference(measure: Measure, first: pd.Series, second: pd.Series) -> np.ndarray:
    """Return ``[N]`` by how much the second is worse; 0 where both are the same to the precision of a sum."""
    sign = -1.0 if measure.is_better_high else 1.0
    change = np.log(second / first) if measure.is_ratio else second - first
    is_same = np.isclose(first, second, rtol=SAME, atol=SAME)
    return np.where(is_same, 0.0, sign * change)


def _without_equal(measure: Measure) -> tuple[pd.DataFrame, list[tuple[str, ...]]]:
    """Return the values with one column for those that are equal on all runs, the best first, and their names."""
    groups: list[list[str]] = []
    for name in measure.values:
        column = measure.values[name]
        for group in groups:
            other = measure.values[group[0]]
            if np.isclose(column, other, rtol=SAME, atol=SAME, equal_nan=True).all():
                group.append(str(name))
                break
        else:
            groups.append([str(name)])
    values = pd.DataFrame({" = ".join(group): measure.values[group[0]] for group in groups})
    order = values.mean().sort_values(ascending=not measure.is_better_high, kind="stable").index
    return values[order], [tuple(group) for group in groups if len(group) > 1]


def next_step(
    verdicts: Sequence[Verdict], *, more: str, done: str, wider: str = "", factor: float = 1.0
) -> str:
    """Return the command that decides the next thing, or uses what is decided.

    Args:
      verdicts: of a study.
      more: of more runs, with a place for ``{needed}``: the fewest that would decide one of the verdicts.
      done: where nothing is left that a study of this kind decides.
      wider: of maps of wider bounds, where only they would decide.
      factor: how many runs the command makes for each one that counts.
    """
    needed = [each.needed for each in verdicts if 0 < each.needed < math.inf]
    if needed:
        return more.format(needed=math.ceil(factor * min(needed)))
    is_pinned = any(each.kind is SharedVerdict.BORDER for each in verdicts)
    return wider if is_pinned else done


def edge_band(maps: MetricMaps, cells: int = EDGE_CELLS) -> np.ndarray:
    """Return ``[Y, X]`` bool: the cells that so few cells part from the border of the maps or of their data."""
    has_data = maps.ds["has_data"].values
    return ~ndimage.minimum_filter(has_data, 2 * cells + 1, mode="constant", cval=False)


def is_at_edge(points_m: np.ndarray, grid: Grid, band: np.ndarray, cells: int = EDGE_CELLS) -> bool:
    """Return whether a route comes into the band along the border, further from its ends than twice the band's width.

    Args:
      points_m: ``[N, 2]`` the route, metres from the map's southwest corner.
      grid: of the maps.
      band: from `edge_band`.
      cells: width of the band.
    """
    # Places along the route, half a cell apart at most, without those near its ends.
    line = shapely.segmentize(shapely.LineString(points_m), grid.resolution_m / 2)
    places_m = shapely.get_coordinates(line)
    ends_m = np.asarray(points_m)[[0, -1]]
    away_m = np.linalg.norm(places_m[:, None] - ends_m, axis=-1).min(axis=1)
    x_m, y_m = (places_m[away_m > 2 * cells * grid.resolution_m] + grid.bounds_m[:2]).T
    rows, cols = grid.cell_of_xy(x_m, y_m)
    return bool(band[rows, cols].any())


def border_verdict(
    is_pinned: np.ndarray, noun: str = "routes", cells: int = EDGE_CELLS
) -> list[Verdict]:
    """Return how many routes the border may have decided; nothing where none comes near it.

    Args:
      is_pinned: ``[N]`` bool, of each route (`is_at_edge`).
      noun: what they are.
      cells: width of the band.
    """
    count = int(np.sum(is_pinned))
    if not count:
        return []
    facts = {"count": count, "cells": cells}
    n = len(is_pinned)
    return [Verdict(SharedVerdict.BORDER, n=n, noun=noun, needed=math.nan, facts=facts)]
