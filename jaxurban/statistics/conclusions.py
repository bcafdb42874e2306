"""What a study decided, what it did not, and what to run next: records, and the three lines that stand first.

A `Verdict` is a record: its kind, what it is about, the size of the effect with its interval, the number of runs and
the unit. Its sentence is made where it is shown, and no code decides by one. Each study has its own kinds, an `Enum`
whose values are sentences with places for the record's fields (`Verdict.sentence`); `SharedVerdict` holds those of all.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from jaxurban.io.tables import records_of
from jaxurban.public import FactsRepr
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, LEVEL

FOUND_SHARE = 0.9  # of repeated studies of the needed size, which find the effect
MOST_RUNS = 1e6  # more are called "no number"
SAME = 1e-9  # relative, and in the unit of the values: what differs by less is equal
SHOWN = 3  # sentences of a line
VERDICTS = "tables/verdicts"  # file of all, beside the report
COLUMNS = [
    *("kind", "is_decided", "sentence"),
    *("size", "low", "high", "unit", "n", "noun", "needed"),
]
FAR = 20  # times the runs of a study, beyond which no command asks for more
MOST_ASKED_FOR = 1000  # runs, beyond which none does either


class SharedVerdict(Enum):
    """Kinds of verdicts that several studies have; each is a sentence with places for the record's fields."""

    EQUAL = "{what} are equal in {measure} on all {n}"
    TIED = "{what} cannot be told apart in {measure} ({last} over {first}: {size}, {n})"
    APART = "{what} cannot be compared in {measure}, as there are {n}"
    BORDER = (
        "{which} within {cells} cells of the border of the maps' data{where}, away from the ends: whether the "
        "border made this is not decided by more routes, but by {wider}"
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
    def finding(self) -> str:
        """The record in words, without a full stop and without what would decide it."""
        *most, last = self.what or ("",)
        noun = self.noun if self.n != 1 else singular(self.noun)
        words = {
            "what": f"{', '.join(most)} and {last}" if most else last,
            "first": self.what[0] if self.what else "",
            "last": last,
            "size": sized(self.size, self.low, self.high, self.unit),
            "n": f"{self.n:,} {noun}",
        }
        return self.kind.value.format_map({**words, **self.facts})

    @property
    def sentence(self) -> str:
        """The record in words, without a full stop; if it is not decided, with the number of runs that would do."""
        sentence = self.finding
        if self.is_decided or math.isnan(self.needed):
            return sentence
        if math.isinf(self.needed) and self.size == 0 and not self.high > 0:  # the same on all
            most = 100 * (1 - (1 - LEVEL) ** (1 / self.n))
            return f"{sentence}; of all such {self.noun} at most {most:.0f} % differ"
        if math.isinf(self.needed):
            return f"{sentence}; no number of {self.noun} would change that"
        if math.isnan(self.low) and self.needed <= FEWEST_GROUPS:
            return f"{sentence}; an interval takes {self.needed:,.0f} {self.noun}"
        return f"{sentence}; some {self.needed:,.0f} {self.noun} would decide so large an effect"


@dataclass(frozen=True, repr=False)
class Conclusion(FactsRepr):
    """The three lines that stand first in a study's report, in its result and on the terminal.

    Attributes:
      verdicts: what was asked, the most important first.
      next_command: one command that decides more, or uses what is decided.
      asked: runs that it asks for, in the nouns of the verdicts; 0: for none.
    """

    verdicts: tuple[Verdict, ...]
    next_command: str
    asked: float = 0.0

    @property
    def facts(self) -> dict[str, str]:
        """The three lines by name: ``decided``, ``not decided`` and ``next``."""
        decided = [each for each in self.verdicts if each.is_decided]
        others = [each for each in self.verdicts if not each.is_decided]
        served = sum(each.needed <= self.asked for each in others)
        left = ""
        if 0 < served < len(others):
            left = f" Next asks for what would decide {served} of these {len(others)}."
        return {
            "decided": _line(decided),
            "not decided": _line(others) + left + _cheapest(within_reach(others)),
            "next": self.next_command,
        }

    @property
    def records(self) -> list[dict[str, Any]]:
        """Each verdict's record, its ``kind`` by name, with ``is_decided`` and ``sentence``."""
        return [
            {
                **vars(each),
                "kind": each.kind.name.lower(),
                "is_decided": each.is_decided,
                "sentence": each.sentence,
            }
            for each in self.verdicts
        ]

    @property
    def table(self) -> pd.DataFrame:
        """A row per verdict, with what of its record is no list of names or facts."""
        return pd.DataFrame(self.records, columns=COLUMNS)

    def to_dict(self) -> dict[str, Any]:
        """Return lines and records as plain, JSON-ready values; a number that is not finite is None."""
        table = pd.DataFrame(self.records).replace([np.inf, -np.inf], np.nan)
        return {"lines": self.facts, "verdicts": records_of(table)}


def _line(verdicts: Sequence[Verdict]) -> str:
    """Return the sentences of the first verdicts as one line, and how many more there are."""
    sentences = [verdict.sentence for verdict in verdicts[:SHOWN]]
    if len(verdicts) > SHOWN:
        sentences.append(f"{len(verdicts) - SHOWN} more in {VERDICTS}.csv")
    return "; ".join(sentences) + "." if sentences else "Nothing."


def _cheapest(verdicts: Sequence[Verdict]) -> str:
    """Return which of several open verdicts the fewest further runs would decide; nothing of fewer than two."""
    if len(verdicts) < 2:
        return ""
    least = min(verdicts, key=lambda each: each.needed - each.n)
    more = math.ceil(least.needed - least.n)
    noun = least.noun if more != 1 else singular(least.noun)
    return f" The cheapest of these to decide, by some {more:,} more {noun}: {least.finding}."


def sized(value: float, low: float, high: float, unit: str = "") -> str:
    """Return a number with its unit and its interval, as ``1.3 % (0.9 to 1.7)``.

    Its last digit is that of the second figure of the interval's half-width, so that no digit says what is not known;
    without an interval it has three figures. An end that is not 0, but would read so, has one figure.

    Args:
      value, low, high: in the unit; NaN ends where there is no interval.
      unit: stands once, behind the value.
    """
    half = (high - low) / 2
    scale = half / 10 if half > SAME else abs(value) / 100
    decimals = max(0, -math.floor(math.log10(scale))) if scale > SAME else 0
    text = f"{_rounded(value, decimals)} {unit}".strip()
    if math.isnan(half):
        return text
    ends = []
    for end in (low, high):
        first_figure = -math.floor(math.log10(max(abs(end), SAME)))
        reads_as_0 = abs(end) > SAME and round(end, decimals) == 0
        ends.append(_rounded(end, first_figure if reads_as_0 else decimals))
    return f"{text} ({' to '.join(ends)})"


def _rounded(value: float, decimals: int) -> str:
    """Return a number with so many decimals, and 0 without a sign."""
    return f"{round(value, decimals) + 0.0:,.{decimals}f}"


def singular(noun: str) -> str:
    """Return the word for one of what a noun names, as ``pair of ends`` for ``pairs of ends``."""
    return re.sub(r"s\b", "", noun, count=1)


def runs_needed(size: float, low: float, high: float, n: int) -> float:
    """Return how many runs would decide whether an effect differs from 0, if it is as large as it was found to be.

    So many that the interval excludes 0 in `FOUND_SHARE` of the studies, to two figures; 0 if it does already; inf for
    an effect of 0. Without an interval as many as one takes.

    Args:
      size, low, high: of the effect and the ends of its interval; NaN where there is none.
      n: number of runs, counted as the bootstrap's groups.
    """
    if low > 0 or high < 0:
        return 0.0
    if math.isnan(low):
        return max(FEWEST_GROUPS, n + 1)
    further = 1 + special.ndtri(FOUND_SHARE) / special.ndtri((1 + LEVEL) / 2)
    half = further * (high - low) / 2
    if abs(size) * math.sqrt(MOST_RUNS) <= half * math.sqrt(n):
        return math.inf
    return max(n + 1.0, float(f"{n * (half / size) ** 2:.2g}"))


def concluded(
    verdicts: Sequence[Verdict],
    *,
    more: str,
    done: str,
    wider: str = "",
    factor: float = 1.0,
    ran: int = 0,
) -> Conclusion:
    """Return a study's verdicts with the command that decides the next thing, or uses what is decided.

    Args:
      verdicts: the most important first.
      more: command of more runs, with a place for ``{needed}``: as many as would decide the first that is open.
      done: where nothing is left that a study of this kind decides.
      wider: of maps of wider bounds, where only they would decide; empty where their source ends at these.
      factor: how many runs the command makes for each one of ``ran``.
      ran: how many the study has; fewer may count for a verdict (`_runs_for`).
    """
    command = done
    if any(each.kind is SharedVerdict.BORDER for each in verdicts):
        command = wider or done
    asked = 0.0
    runs = ((each.needed, factor * _runs_for(each, ran)) for each in within_reach(verdicts))
    asked_for = [(needed, num) for needed, num in runs if num <= MOST_ASKED_FOR]
    if asked_for:
        asked, num = asked_for[0]
        command = more.replace("{needed}", str(math.ceil(num)))
    return Conclusion(tuple(verdicts), command, asked)


def within_reach(verdicts: Iterable[Verdict]) -> list[Verdict]:
    """Return what is open and would be decided by more runs, but not by too many (`FAR`, `MOST_ASKED_FOR`)."""
    return [
        each
        for each in verdicts
        if 0 < each.needed < min(FAR * max(each.n, FEWEST_GROUPS), MOST_ASKED_FOR)
    ]


def _runs_for(verdict: Verdict, ran: int) -> float:
    """Return how many runs a study must make so that as many count as a verdict needs.

    Where few of ``ran`` counted, their share is taken smaller than it was, so that one more study is likely to do.
    """
    if verdict.n >= ran:
        return verdict.needed
    return max(ran + 1, verdict.needed * (ran + 2) / max(verdict.n - 1, 1))
