"""What a wish costs, on routes that its weights were not fitted to."""

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.studies.bootstrap import Clusters
from jaxurban.studies.decided import (
    FEWEST_TO_HOLD_OUT,
    Conclusion,
    Verdict,
    effects,
    next_step,
)
from jaxurban.studies.queries import LENGTH, PEOPLE, RouteQuery, outcome_label, outcomes_of
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.tuning.target import DETOUR, Target

UNITS = {LENGTH: "m", PEOPLE: "times the shortest routes'", DETOUR: "above the shortest routes"}


class WishVerdict(Enum):
    """What is decided of a wish."""

    HOLDS = "{first} holds on routes that the weights were not fitted to: {size} ({n})"
    MISSED = "{first} is missed on routes that the weights were not fitted to: {size} ({n})"
    OPEN = "Whether {first} holds on other routes is open: {size} on {n}"
    COSTS = "With the wish {first} changes by {size} ({n})"
    UNSEEN = "Whether {first} changes with the wish is open: {size} on {n}"


def tested_outcomes(
    queries: Sequence[RouteQuery], targets: Sequence[Target], weights: np.ndarray
) -> pd.DataFrame:
    """Return what routes are like without a wish and with it: a row per target, then per other outcome.

    ``what`` is the target or the outcome; ``without_wish`` and ``with_wish`` are means over the queries, in ``unit``;
    ``change`` with its interval; ``ahead``, by how much a target is kept (below 0: missed), with its interval; and as
    of `effects` ``n`` and ``needed``, of ``ahead`` where there is one, else of ``change``. All intervals hold at once.

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
        values[PEOPLE] = values[PEOPLE] / max(float(values[PEOPLE][:, 0].mean()), 1e-9)
    values = {DETOUR: values[LENGTH] / values[LENGTH][:, :1] - 1, **values}

    # How far each target is kept, and every change; queries between the same cells are drawn together.
    wished = [target.outcome for target in targets]
    outcomes = [*wished, *(name for name in values if name not in (*wished, DETOUR))]
    _, before, after = np.transpose([values[name] for name in outcomes], (2, 0, 1))
    ahead = [each.sign * (row - each.value) for each, row in zip(targets, after, strict=False)]
    group, _ = pd.factorize(pd.Series([(query.start, query.goal) for query in queries]))
    table = effects(np.transpose([*ahead, *(after - before)]), Clusters(group))
    of_target, of_change = table[: len(targets)], table[len(targets) :].reset_index(drop=True)
    result = pd.DataFrame(
        {
            "what": [*map(str, targets), *outcomes[len(targets) :]],
            "without_wish": before.mean(axis=1),
            "with_wish": after.mean(axis=1),
            "unit": [UNITS.get(name, "") for name in outcomes],
        }
    )
    for name, part in (("change", of_change), ("ahead", of_target)):
        columns = {"size": name, "low": f"{name}_low", "high": f"{name}_high"}
        result = result.join(part.rename(columns=columns)[[*columns.values()]])
    return result.join(of_target[["n", "needed"]].combine_first(of_change[["n", "needed"]]))


def wish_conclusion(
    tested: pd.DataFrame, targets: Sequence[Target], num_held_out: int, num: int
) -> Conclusion:
    """Return what a fit to targets decided.

    Args:
      tested: from `tested_outcomes`.
      targets: of the fit.
      num_held_out: routes of the test that the fit did not see; 0: it saw all, so that nothing is decided.
      num: routes in all.
    """
    verdicts = []
    for number, row in enumerate(tested.to_dict("records")):
        needed = row["needed"]
        if not num_held_out:
            needed = max(needed, FEWEST_TO_HOLD_OUT)
        if number < len(targets):
            verdicts.append(_of_target(row, targets[number], needed))
            continue
        kind = WishVerdict.UNSEEN if needed else WishVerdict.COSTS
        change = row["change"], row["change_low"], row["change_high"]
        label = outcome_label(row["what"])
        verdicts.append(Verdict(kind, (label,), *change, row["n"], row["unit"], needed=needed))
    return Conclusion(
        tuple(verdicts),
        next_step(
            verdicts,
            more='jaxurban tune DIR --sample {needed} --wish "..." -o OUT',
            factor=num / (num_held_out or num),
            done="jaxurban plan DIR --start LON,LAT --goal LON,LAT --weights ...",
        ),
    )


def _of_target(row: Mapping[Any, Any], target: Target, needed: float) -> Verdict:
    """Return the verdict on a target, with what was reached and its interval."""
    kind = WishVerdict.OPEN
    if not needed:
        kind = WishVerdict.HOLDS if row["ahead"] > 0 else WishVerdict.MISSED
    low, high = sorted(target.value + target.sign * row[f"ahead_{end}"] for end in ("low", "high"))
    reached = row["with_wish"]
    unit = row["unit"]
    return Verdict(kind, (row["what"],), reached, low, high, row["n"], unit, needed=needed)
