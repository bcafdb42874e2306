"""Routes that weights are not fitted to: which they are, and what a wish costs on them."""

from collections.abc import Sequence
from enum import Enum

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.metrics.weights import Weights
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, Clusters, interval_columns
from jaxurban.statistics.conclusions import Conclusion, Verdict, concluded, runs_needed
from jaxurban.studies.decided import FEWEST_TO_HOLD_OUT, USUAL_SHARE, effects
from jaxurban.studies.queries import (
    LENGTH,
    PEOPLE,
    RouteQuery,
    command_to_plan,
    outcome_label,
    outcomes_of,
)
from jaxurban.studies.route_pool import RoutePool
from jaxurban.studies.tuning.target import DETOUR, Target

SPLIT = 0  # stream of random numbers
MOST_HELD_OUT = 0.9
PAIRS = "pairs of ends"
UNITS = {LENGTH: "m", PEOPLE: "times the shortest routes'", DETOUR: "above the shortest routes"}


class WishVerdict(Enum):
    """What is decided of a wish."""

    BEFORE = "{first} is met without the wish already: {size} on average of {n}"
    HOLDS = "{first} holds on routes that the weights were not fitted to: {size} ({n})"
    MISSED = "{first} is missed on routes that the weights were not fitted to: {size} ({n})"
    OPEN = "whether {first} holds on other routes is open: {size} on {n}"
    COSTS = "with the wish {first} changes by {size}, on one route by {largest:.3g} ({n})"
    UNSEEN = "whether {first} changes with the wish is open: {size} on {n}"


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
    the latter with its interval; ``change`` with its interval; ``largest``, the change of the route that changes most;
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
        values[PEOPLE] = values[PEOPLE] / max(float(values[PEOPLE][:, 0].mean()), 1e-9)
    values = {DETOUR: values[LENGTH] / values[LENGTH][:, :1] - 1, **values}

    # Every outcome with the wish, and its change; queries between the same cells are drawn together.
    wished = [target.outcome for target in targets]
    outcomes = [*wished, *(name for name in values if name not in (*wished, DETOUR))]
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
    return pd.DataFrame(
        {
            "what": [*map(str, targets), *outcomes[len(targets) :]],
            "unit": [UNITS.get(name, "") for name in outcomes],
            "without_wish": before.mean(axis=1),
            **dict(zip(interval_columns("with_wish"), reached.T, strict=True)),
            **dict(zip(interval_columns("change"), change.T, strict=True)),
            "largest": largest,
            "n": num,
            "needed": needed,
        }
    )


def wish_conclusion(
    tested: pd.DataFrame,
    targets: Sequence[Target],
    num_held_out: int,
    queries: Sequence[RouteQuery],
    weights: Weights,
) -> Conclusion:
    """Return what a fit to targets decided.

    Args:
      tested: from `tested_outcomes`.
      targets: of the fit.
      num_held_out: routes of the test that the fit did not see; 0: it saw all, so that nothing is decided.
      queries: all, held out or not.
      weights: of the fit.
    """
    met = []
    verdicts = []
    for number, row in enumerate(tested.to_dict("records")):
        needed = row["needed"]
        if not num_held_out:
            needed = max(needed, FEWEST_TO_HOLD_OUT)
        name = "change"
        label = outcome_label(row["what"])
        kind = WishVerdict.UNSEEN if needed else WishVerdict.COSTS
        if number < len(targets):
            target = targets[number]
            name, label = "with_wish", str(target)
            is_kept = target.sign * (row[name] - target.value) > 0
            kind = WishVerdict.HOLDS if is_kept else WishVerdict.MISSED
            if needed:
                kind = WishVerdict.OPEN
            before = row["without_wish"]
            if target.sign * (before - target.value) >= 0:
                already = before, np.nan, np.nan, row["n"], row["unit"], PAIRS
                few = FEWEST_GROUPS if row["n"] < FEWEST_GROUPS else 0
                met.append(Verdict(WishVerdict.BEFORE, (label,), *already, few))
        size, low, high = (row[column] for column in interval_columns(name))
        facts = {"largest": row["largest"]}
        about = size, low, high, row["n"], row["unit"], PAIRS, needed, facts
        verdicts.append(Verdict(kind, (label,), *about))
    cost_map = queries[0].cost_map
    altitudes_m = {query.cost_map.altitude_m for query in queries}
    altitude = f"--altitude {cost_map.altitude_m:g} " if len(altitudes_m) == 1 else ""
    wishes = " ".join(f'--wish "{target}"' for target in targets)
    metrics = ",".join(cost_map.names)
    folder = cost_map.maps.folder or "DIR"
    # A folder of its own for each number of routes, as one that holds another fit is refused.
    output = f"{folder}-wish-{{needed}}"
    return concluded(
        [*met, *verdicts],
        more=f"jaxurban tune {folder} --sample {{needed}} {wishes} --metrics {metrics} "
        f"{altitude}-o {output}",
        factor=len(queries) / (num_held_out or len(queries)),
        done=command_to_plan(queries[0], weights),
    )
