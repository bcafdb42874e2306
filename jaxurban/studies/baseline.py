"""What weights gain beside routes of distance alone, the baseline: less exposure, and what a user pays for it."""

from collections.abc import Iterator
from enum import Enum
from typing import Any

import pandas as pd

from jaxurban.statistics.bootstrap import Clusters
from jaxurban.statistics.conclusions import Conclusion, Verdict
from jaxurban.studies.decided import effects
from jaxurban.studies.weights.paid import AMOUNTS
from jaxurban.studies.weights.verdicts import paid_on_average

SHORTEST = "shortest_"  # begins the columns of the routes of distance alone
MEASURES = ("exposure", *AMOUNTS)


class BaselineVerdict(Enum):
    """Kinds of verdicts on routes under weights beside those of distance alone."""

    LESS = (
        "routes under these weights have {size} less exposure (what all metrics cost along them) than those of "
        "distance alone, the baseline (mean of each route's own share, {n}); flown more, on average: {paid}"
    )
    LESS_OPEN = (
        "whether routes under these weights have less exposure (what all metrics cost along them) than those of "
        "distance alone, the baseline, is open: {size} (mean of each route's own share, {n}); flown more, on average: "
        "{paid}"
    )


def baseline_verdicts(
    routes: pd.DataFrame, pairs: pd.Series | pd.Index, noun: str
) -> Iterator[Verdict]:
    """Yield how much less exposure routes have than the shortest ones between their ends; nothing without any.

    Both are the cheapest ones of one grid, so that none has more exposure than the shortest one.

    Args:
      routes: ``exposure`` (a cost), and as far as they are known `AMOUNTS`, each also of the shortest routes
        (`SHORTEST`); NaN where either route is missing.
      pairs: of places, that are drawn together.
      noun: what they are.
    """
    shortest = routes[f"{SHORTEST}exposure"]
    share = routes.exposure / shortest.where(shortest > 0)
    both = share.notna().to_numpy()
    if not both.any():
        return
    routes, clusters = routes[both], Clusters(pairs[both])
    less: Any = 100 * (1 - share[both])
    size, low, high, num, needed = effects(less.to_frame(), clusters, least=0.0).to_numpy()[0]
    known = [name for name in AMOUNTS if name in routes]
    more = {f"more_{name}": routes[name] - routes[SHORTEST + name] for name in known}
    facts = {"paid": paid_on_average(pd.DataFrame(more), clusters)}
    kind = BaselineVerdict.LESS_OPEN if needed else BaselineVerdict.LESS
    yield Verdict(kind, (), size, low, high, int(num), "%", noun, needed, facts)


def baseline_said(decided: Conclusion) -> str:
    """Return the sentence of `baseline_verdicts` in what a study decided; empty where it has none."""
    kinds = (each for each in decided.verdicts if isinstance(each.kind, BaselineVerdict))
    return "; ".join(each.sentence for each in kinds)
