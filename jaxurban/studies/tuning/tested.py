"""Routes that weights are not fitted to: which they are, what a wish costs on them, and which fit has more of them."""

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, Clusters, interval_columns
from jaxurban.statistics.conclusions import Verdict, runs_needed, within_reach
from jaxurban.studies.decided import FEWEST_TO_HOLD_OUT, USUAL_SHARE, effects
from jaxurban.studies.queries import (
    LENGTH,
    PEOPLE,
    RouteQuery,
    outcome_label,
    outcomes_of,
)
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.tuning.target import DETOUR, MEAN, Target

SPLIT = 0  # stream of random numbers
MOST_HELD_OUT = 0.9
MOST_ASKED = 0.5  # share that a further fit holds out: of more routes are needed
PAIRS = "pairs of ends"
HELD_OUT = "held-out pairs of ends"
OF_PEOPLE = f"{MEAN}population"
UNITS = {LENGTH: "m", PEOPLE: "times the shortest routes'", DETOUR: "above the shortest routes"}


class WishVerdict(Enum):
    """What is decided of a wish."""

    BEFORE = "{first} is met without the wish already: {size} ({n})"
    HOLDS = "{first} holds on routes that the weights were not fitted to: {size} ({n})"
    MISSED = "{first} is missed on routes that the weights were not fitted to: {size} ({n})"
    OPEN = "whether {first} holds on other routes is open: {size} on {n}"
    FAR = (
        "whether {first} holds on other routes is open: {size} on {n}; on the fitted ones the best weights miss it, "
        "which more routes hardly change"
    )
    SEEN = (
        "whether {first} holds on other routes is open: {size} on {n}, of which none was held out"
    )
    COSTS = "with the wish {first} changes by {size}, on one route by {largest:.3g} ({n})"
    UNSEEN = "whether {first} changes with the wish is open: {size} on {n}"


class FitCommands(NamedTuple):
    """What fits again, as text; of a fit in Python its calls.

    Attributes:
      again: the same routes, of which ``{share}`` are held out.
      more: ``{needed}`` routes that are drawn; empty where routes are only as they were given.
      folder: beside which further studies are kept; empty: the folder of the maps.
      sample: number of routes that were drawn, of which a path joins the pairs of ends of the fit; None: none were.
      wider: the same over maps of wider ``{bounds}``; empty where these are not of one folder.
    """

    again: str
    more: str = ""
    folder: str = ""
    sample: int | None = None
    wider: str = ""

    def holding_out(self, needed: float, num_pairs: int, share: float) -> str:
        """Return the command of a fit that is tested on as many pairs of ends as are needed; empty where none is known.

        Args:
          needed: pairs of ends.
          num_pairs: that the fit had, held out or not.
          share: of these that it was tested on; 0: `USUAL_SHARE` will be.
        """
        if needed <= MOST_ASKED * num_pairs:
            return self.again.replace("{share}", f"{math.ceil(100 * needed / num_pairs) / 100:g}")
        # Where a path joins few of those that were drawn, their share is taken smaller than it was, so that one more
        # fit is likely to do.
        drawn = 1 / (share or USUAL_SHARE)
        if self.sample and self.sample > num_pairs:
            drawn *= (self.sample + 2) / max(num_pairs - 1, 1)
        return self.more.replace("{needed}", f"{math.ceil(drawn * needed)}")


def split(city: np.ndarray, group: np.ndarray, share: float | None, seed: int) -> np.ndarray:
    """Return ``[N]`` bool: whether each route is held out.

    In every city about the given share of the groups is held out, at least one unless the share is 0. Without a share
    it is `USUAL_SHARE` where there are `FEWEST_TO_HOLD_OUT` groups and two in every city, else 0.

    Args:
      city: ``[N]`` number of each route's city.
      group: ``[N]`` number of each route's group, whose members stay together.
      share: from 0 to `MOST_HELD_OUT`; None: not given.
      seed: of the draw.

    Raises:
      InputError: a city without a group left to be fitted, or another share.
    """
    if share is None:
        sizes = [len(np.unique(group[city == name])) for name in np.unique(city)]
        share = USUAL_SHARE if sum(sizes) >= FEWEST_TO_HOLD_OUT and min(sizes) > 1 else 0.0
    if not 0 <= share <= MOST_HELD_OUT:
        raise InputError(f"hold_out must be a share from 0 to {MOST_HELD_OUT:g}, got {share}")
    is_held_out = np.zeros(len(city), bool)
    rng = np.random.default_rng([SPLIT, seed])
    for name in dict.fromkeys(city.tolist()):
        groups = rng.permutation(np.unique(group[city == name]))
        num = 0
        if share > 0:
            num = max(1, round(share * len(groups)))
        if num >= len(groups):
            raise InputError(
                f"the routes of one city join {len(groups)} pair(s) of ends, too few to hold some out: give more "
                "routes, or a smaller share (hold_out)"
            )
        is_held_out |= np.isin(group, groups[:num])
    return is_held_out


def tested_outcomes(
    queries: Sequence[RouteQuery], targets: Sequence[Target], weights: np.ndarray
) -> pd.DataFrame:
    """Return what routes are like without a wish and with it: a row per target, then per other outcome.

    ``what`` is the target or the outcome; ``without_wish`` and ``with_wish`` are means over the queries, in ``unit``,
    the latter with its interval; ``change`` with its interval; ``median``, the median of the changes, and ``largest``,
    that of the route that changes most;
    ``n``, the number of pairs of ends; and how many would decide whether a target holds, else whether the outcome
    changes (``needed``). All intervals hold at once.

    Args:
      queries: ``Q``, which the weights were not fitted to, or were.
      targets: of the fit.
      weights: ``[2, K]`` without the wish, and with it.
    """
    # [Q, 3] each outcome of the shortest route, and of those without and with the wish.
    names = queries[0].names
    rows = np.vstack([np.eye(len(names))[:1], weights])
    values = outcomes_of(RoutePool(queries).cheapest(rows)[1], names)
    if PEOPLE in values:
        values[OF_PEOPLE] = values[PEOPLE] / values[LENGTH]
        values[PEOPLE] = values[PEOPLE] / max(float(values[PEOPLE][:, 0].mean()), 1e-9)
    others = [name for name in values if name != OF_PEOPLE]
    values[DETOUR] = values[LENGTH] / values[LENGTH][:, :1] - 1

    # Every outcome with the wish, and its change; queries between the same cells are drawn together.
    wished = [target.outcome for target in targets]
    outcomes = [*wished, *(name for name in others if name not in wished)]
    _, before, after = np.transpose([values[name] for name in outcomes], (2, 0, 1))
    changes = after - before
    group, _ = pd.factorize(pd.Series([(query.start, query.goal) for query in queries]))
    table = effects(np.vstack([after, changes]).T, Clusters(group))
    reached, change = np.split(table[["size", "low", "high"]].to_numpy(), 2)
    num = table.n[: len(outcomes)]
    largest = np.take_along_axis(changes, np.abs(changes).argmax(axis=1)[:, None], axis=1)[:, 0]
    needed = table.needed[len(outcomes) :].to_numpy(copy=True)
    for number, target in enumerate(targets):
        size, low, high = reached[number] - target.value
        needed[number] = runs_needed(size, low, high, num[number])
    # No outcome is below 0, and no mean of m above 1.
    most = [[1.0 if name.startswith(MEAN) else np.inf] for name in outcomes]
    reached = np.clip(reached, 0.0, most)
    return pd.DataFrame(
        {
            "what": [*map(str, targets), *outcomes[len(targets) :]],
            "unit": [UNITS.get(name, "") for name in outcomes],
            "without_wish": before.mean(axis=1),
            **dict(zip(interval_columns("with_wish"), reached.T, strict=True)),
            **dict(zip(interval_columns("change"), change.T, strict=True)),
            "median": np.median(changes, axis=1),
            "largest": largest,
            "n": num,
            "needed": needed,
        }
    )


def wish_verdicts(
    tested: pd.DataFrame,
    targets: Sequence[Target],
    is_reached: Sequence[bool],
    *,
    is_tested: bool,
    is_kept: bool,
) -> tuple[tuple[Verdict, ...], float]:
    """Return what a fit to targets decided, and how many pairs of ends, held out, would decide more; 0: none.

    Args:
      tested: from `tested_outcomes`.
      targets: of the fit.
      is_reached: whether each is met on the routes that were fitted.
      is_tested: on routes that the fit did not see; else nothing is decided.
      is_kept: nothing was fitted, as the weights without the wish meet all targets.
    """
    rows = tested.to_dict("records")
    verdicts = []
    noun = HELD_OUT if is_tested and not is_kept else PAIRS
    for target, row, is_near in zip(targets, rows, is_reached, strict=False):
        kind = _kind_of(target.is_met(row["with_wish"]), row["needed"], is_kept, is_near)
        if not is_tested:  # an interval of routes that were fitted says nothing of others
            row = row | {"with_wish_low": np.nan, "with_wish_high": np.nan, "needed": np.nan}
            kind = WishVerdict.SEEN
        verdicts.append(_wish_verdict(kind, str(target), row, "with_wish", row["needed"], noun))
    has_changed = tested["change"].any()  # else the weights are those without the wish
    if is_tested and not is_kept and has_changed:
        wished = [target.outcome for target in targets]
        for outcome, row in zip([*wished, *tested["what"][len(targets) :]], rows, strict=True):
            label = outcome_label(outcome)
            size, low, high = (row[name] for name in interval_columns("change"))
            if outcome in wished and runs_needed(size, low, high, row["n"]):
                continue  # whether the target holds is what is open
            needed = 0.0 if outcome in wished else row["needed"]
            kind = WishVerdict.UNSEEN if needed else WishVerdict.COSTS
            verdicts.append(_wish_verdict(kind, label, row, "change", needed, noun))
    needs = [each.needed for each in within_reach(verdicts)] if is_tested else [FEWEST_GROUPS]
    return tuple(verdicts), max(needs, default=0.0)


def _wish_verdict(
    kind: WishVerdict, label: str, row: Mapping[Any, Any], name: str, needed: float, noun: str
) -> Verdict:
    """Return what is decided of an outcome, by its row of `tested_outcomes`.

    Args:
      kind: of verdict.
      label: the outcome, or the target.
      row: of the table.
      name: of the columns of its size and interval.
      needed: further pairs of ends that would decide it.
      noun: what these are.
    """
    size, low, high = (row[column] for column in interval_columns(name))
    facts = {"largest": row["largest"]}
    return Verdict(kind, (label,), size, low, high, row["n"], row["unit"], noun, needed, facts)


def _kind_of(is_met: bool, needed: float, is_kept: bool, is_reached: bool) -> WishVerdict:
    """Return what is decided of a target on routes that the weights were not fitted to.

    Args:
      is_met: on their average.
      needed: further pairs of ends that would decide it.
      is_kept: nothing was fitted.
      is_reached: it is met on the routes that were fitted.
    """
    if needed:
        return WishVerdict.OPEN if is_reached else WishVerdict.FAR
    if not is_met:
        return WishVerdict.MISSED
    return WishVerdict.BEFORE if is_kept else WishVerdict.HOLDS
