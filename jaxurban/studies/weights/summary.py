"""What the rows of a weight study say together: means and medians over routes, cut many ways, each with its interval.

Intervals are 95 % (of mean regrets some 90 %), by bootstrap over pairs of places within their cities, all altitudes of
a pair drawn together: they are of these cities. From 8 cities on there is a second one, for which whole cities are
drawn.
"""

from collections.abc import Callable, Iterator
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.paths.rows import HAS_PATH
from jaxurban.statistics.bootstrap import FEWEST_GROUPS, Clusters, Interval, Statistic, named
from jaxurban.studies.decided import FEWEST_RUNS
from jaxurban.studies.weights.paid import PAID
from jaxurban.studies.weights.routes import OF_WEIGHT, ROUTE_KEY
from jaxurban.studies.weights.sobol import FEW_SAMPLES, OF_SHARE

DESCRIBED = ("time", "time_of_day", "start_stratum", "goal_stratum", "range", "distance_m")
ALL = "all"
CUTS = ("city", "altitude_m", "stratum", "range", "time", "time_of_day")
OVER_CITIES = "over cities"
CLEAR, UNCLEAR = "clear", "not distinguishable from 0"
TOO_FEW, CONSTANT = "too few routes", "does not vary"
UNRESOLVED = "not resolved"
MOST_PERCENT = (
    110  # no share is above 100 %: one whose interval reaches beyond this is not resolved
)
MORE = [f"more_{name}" for name in PAID]
HEIGHTS = "heights"  # the change of all draws of them
CHANGED_STATISTICS = ("is_other", "overlap", "nominal_is_closed", "nominal_regret")
SHARES_OF_ROUTES = ("is_other", "nominal_is_closed")


def routes_of(rows: pd.DataFrame, instances: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of routes that were found, beside the columns of their instances that describe them.

    Args:
      rows: of the study, a row per route.
      instances: of the study, with the columns `DESCRIBED`.
    """
    wanted = [*ROUTE_KEY, *DESCRIBED]
    return rows[rows.status.isin(HAS_PATH)].merge(
        instances[wanted], on=list(ROUTE_KEY), validate="many_to_one"
    )


def weights_table(routes: pd.DataFrame, factors: tuple[float, float]) -> pd.DataFrame:
    """Return a row per route and weight: the columns `OF_WEIGHT`, ``varies``, ``nearest`` and ``regret``.

    ``varies`` says whether the weight was varied. ``nearest`` is the least factor above 1 by which the weight can be
    multiplied or divided to change the route; where no factor of the range does, it is the factor of the range's nearer
    end. ``regret`` is the larger one of ``regret_low`` and ``regret_high``. Both are NaN for weights that do not vary.

    Args:
      routes: from `routes_of`.
      factors: the range in which breakpoints were looked for, below and above 1.
    """
    # A row for each route and weight, from columns such as "below:gps" that stand side by side. A metric that the maps
    # of a city lack has no number there, and no row here.
    varied = routes["vary"].str.split(",")
    parts = []
    for column in map(str, routes.filter(regex="^elasticity:")):
        name = column.removeprefix("elasticity:")
        part = routes[[*ROUTE_KEY, *DESCRIBED]]
        part = part.assign(weight_name=name, varies=[name in names for names in varied])
        for kind in OF_WEIGHT:
            part[kind] = routes.get(f"{kind}:{name}", np.nan)
        parts.append(part)
    table = pd.concat(parts, ignore_index=True)
    table = table[table.elasticity.notna()]

    # The nearer one of the factors above and below; `np.fmin` passes over NaN, where the route does not change.
    limit = min(factors[1], 1 / factors[0])
    nearest = table.above.combine(1 / table.below, np.fmin).clip(upper=limit).fillna(limit)
    regret = table[["regret_low", "regret_high"]].max(axis=1)
    return table.assign(
        nearest=nearest.where(table.varies), regret=regret.where(table.varies)
    ).reset_index(drop=True)


def statistics_of(wrong: float) -> dict[str, tuple[Callable[[pd.DataFrame], pd.Series], Statistic]]:
    """Return the statistics of a weight by name: a function of its rows that gives the values, and their average.

    ``share`` is the mean share of the cost, ``nearest`` the median factor, ``changes`` the share of routes that change
    where the weight is up to ``wrong`` times too small or too large, ``regret`` the mean regret, and ``more_length_m``
    and the like what a user pays more for such a weight on average (`PAID`).

    Args:
      wrong: factor of a wrong weight, above 1.
    """

    def is_changed(table: pd.DataFrame) -> pd.Series:
        """Return 1 for each route that changes and 0 for the others; NaN where the weight does not vary."""
        return (table.nearest <= wrong).astype(float).where(table.varies)

    return {
        "share": (lambda table: table.elasticity, "mean"),
        "nearest": (lambda table: table.nearest, "median"),
        "changes": (is_changed, "share"),
        **{name: (itemgetter(name), "mean") for name in ("regret", *MORE)},
    }


def cuts_of(table: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield the parts of a table of weights: what the table is cut by, the value of the part, and the part.

    First the whole table, then the parts of each cut (`parts_of`); those with fewer than `FEWEST_RUNS` routes are left
    out.
    """
    yield ALL, ALL, table
    yield from (part for part in parts_of(table) if num_routes(part[-1]) >= FEWEST_RUNS)


def parts_of(table: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield the parts of each cut that has two values or more, as `cuts_of`, however small they are."""
    # The table with ``stratum``, each row once for each stratum that its route starts or ends in.
    ends = [table.assign(stratum=table[name]) for name in ("start_stratum", "goal_stratum")]
    both = pd.concat(ends).dropna(subset="stratum").reset_index()
    strata = both.drop_duplicates(["index", "stratum"], ignore_index=True)
    for cut in CUTS:
        source = strata if cut == "stratum" else table
        if _differs(source, cut):
            for value, part in source.groupby(cut, sort=True):
                yield cut, _text_of(value), part


def small_parts(table: pd.DataFrame) -> list[str]:
    """Return the values of the parts that have too few routes for a row, with their number of routes."""
    sizes = [(value, num_routes(part)) for _, value, part in parts_of(table)]
    return [f"{value} ({num})" for value, num in sizes if num < FEWEST_RUNS]


def num_routes(table: pd.DataFrame) -> int:
    """Return how many routes a table of weights holds, each counted once."""
    return len(table.drop_duplicates([*ROUTE_KEY]))


def _differs(table: pd.DataFrame, column: str) -> bool:
    """Return whether a column has two values; times that differ between cities only say no more than the cities."""
    if column in ("time", "time_of_day"):
        return table.groupby("city")[column].nunique().max() > 1
    return table[column].nunique() > 1


def _text_of(value: Any) -> str:
    """Return the value of a cut as text; a number is an altitude in metres."""
    return f"{value:g} m" if isinstance(value, float) else str(value)


def pairs_of(table: pd.DataFrame) -> Clusters:
    """Return draws of the rows of a table, of pairs of places within cities."""
    return Clusters(table.instance, table.city)


def summarise(weights: pd.DataFrame, wrong: float) -> pd.DataFrame:
    """Return which weights matter where: a row for each part (``cut``, ``value``) of the routes and each weight.

    Its columns are the sizes of the part and the statistics of `statistics_of` with their intervals. For all routes
    together, in 8 cities or more, a second row ``over cities`` has intervals for which whole cities are drawn.

    Args:
      weights: from `weights_table`.
      wrong: factor of a wrong weight.
    """
    rows = []
    for cut, value, part in cuts_of(weights):
        for name, of_weight in part.groupby("weight_name", sort=False):
            # The groups that the bootstrap draws, for each row that is made of this part, by its cut and value.
            draws = {(cut, value): pairs_of(of_weight)}
            if cut == ALL and of_weight.city.nunique() >= FEWEST_GROUPS:
                draws[OVER_CITIES, OVER_CITIES] = Clusters(of_weight.city)
            for (drawn_cut, drawn_value), clusters in draws.items():
                row = {
                    "cut": drawn_cut,
                    "value": drawn_value,
                    "weight_name": name,
                    **_sizes_of(of_weight),
                }
                for statistic, (values_of, average) in statistics_of(wrong).items():
                    row |= named(statistic, clusters.interval(values_of(of_weight), average))
                rows.append(row)
    return pd.DataFrame(rows)


def _sizes_of(part: pd.DataFrame) -> dict[str, float]:
    """Return how many routes, pairs of places and cities a part of a table holds."""
    return {
        "routes": len(part),
        "pairs": part.groupby(["city", "instance"]).ngroups,
        "cities": part.city.nunique(),
    }


def shares_table(routes: pd.DataFrame) -> pd.DataFrame:
    """Return the Sobol shares of every route: a row for each route, outcome and weight, with the columns `OF_SHARE`.

    Without any share the table has these columns and no rows.

    Args:
      routes: from `routes_of`, which hold the shares side by side, as ``"first:gps:length_m"``.
    """
    # A table without rows stands first, for routes without shares. Each column ``first:NAME:OUTCOME`` then gives the
    # rows of a weight and an outcome.
    parts = [pd.DataFrame(columns=[*ROUTE_KEY, "outcome", "weight_name", *OF_SHARE])]
    for column in map(str, routes.filter(regex="^first:")):
        _, name, outcome = column.split(":")
        shares = {kind: routes[f"{kind}:{name}:{outcome}"] for kind in OF_SHARE}
        key = routes[list(ROUTE_KEY)]
        parts.append(key.assign(outcome=outcome, weight_name=name, **shares))
    return pd.concat(parts[1:] or parts, ignore_index=True)


def summarise_shares(shares: pd.DataFrame, num_samples: int) -> pd.DataFrame:
    """Return mean Sobol shares over routes: a row for each outcome, weight and kind, with a ``verdict`` in words.

    Estimates of one route from few samples scatter about the truth, below 0 too, independently from route to route.
    Their mean is nearer to the truth, and its interval holds both the scatter and how routes differ; of a single route
    it is that of its own samples. A share whose interval reaches 0 is `UNCLEAR`, whatever its value. The verdict is on
    the mean, not on one route: ``own_ci``, the median half-width of one route's interval, may be wider than the share
    where the mean is `CLEAR`.

    A share whose interval reaches beyond `MOST_PERCENT` is `UNRESOLVED`: on some routes the samples hardly
    vary, and shares are divided by their small variance. ``samples_needed`` is then four times the number of samples,
    and at least `FEW_SAMPLES`. That is the next step, not a bound, since the intervals cannot show what the samples
    missed. Other shares, and their upper ends, are cut off at 1, and their ``samples_needed`` is NaN.

    Args:
      shares: from `shares_table`.
      num_samples: N of each route's indices.
    """
    rows = []
    for (outcome, name), part in shares.groupby(["outcome", "weight_name"], sort=False):
        for kind in ("first", "total"):
            known = part[part[kind].notna()]
            share = pairs_of(known).interval(known[kind])
            if len(known) == 1:  # the interval of this route's samples
                value, half = known[[kind, f"{kind}_ci"]].to_numpy()[0]
                share = Interval(value, value - half, value + half)
            rows.append(
                {
                    "outcome": outcome,
                    "weight_name": name,
                    "kind": kind,
                    "routes": len(known),
                    **named("share", share),
                    "own_ci": known[f"{kind}_ci"].median(),
                    "verdict": _verdict(share, len(known)),
                }
            )

    # What lies above 1 stays visible only where it is the reason for the verdict.
    table = pd.DataFrame(rows)
    is_unresolved = table.verdict == UNRESOLVED
    for name in ("share", "share_high"):
        table[name] = table[name].where(is_unresolved, table[name].clip(upper=1.0))
    needed = max(4 * num_samples, FEW_SAMPLES)
    return table.assign(samples_needed=np.where(is_unresolved, needed, np.nan))


def _verdict(share: Interval, num_routes: int) -> str:
    """Return the verdict on a mean share, over the routes on which the outcome varies (see `summarise_shares`)."""
    if not num_routes:
        return CONSTANT
    if not np.isfinite(share.low):
        return TOO_FEW
    if 100 * share.high > MOST_PERCENT:
        return UNRESOLVED
    return CLEAR if share.low > 0 else UNCLEAR


def summarise_changed(changed: pd.DataFrame) -> pd.DataFrame:
    """Return how far routes change on other maps: rows for all routes, each city and each altitude, of each ``change``.

    Parts with fewer than `FEWEST_RUNS` routes are left out.

    All draws of heights count together, and their intervals are of draws and of routes at once. The columns are the
    means of the columns of `jaxurban.studies.weights.routes.OnChangedMaps`.

    Args:
      changed: rows of routes on other maps.
    """
    changed = changed[changed.status.isin(HAS_PATH)].assign(**{ALL: ALL})
    rows = []
    for change, of_change in changed.groupby("change", sort=False):
        for cut in (ALL, "city", "altitude_m"):
            if cut != ALL and of_change[cut].nunique() == 1:
                continue
            for value, part in of_change.groupby(cut, sort=False):
                if cut != ALL and num_routes(part) < FEWEST_RUNS:
                    continue
                head = {"change": change, "cut": cut, "of": _text_of(value)}
                rows.append(head | _changes_of(part))
    return pd.DataFrame(rows)


def _changes_of(part: pd.DataFrame) -> dict[str, float]:
    """Return the columns of a row of `summarise_changed`: the sizes of a part, and its means with their intervals.

    ``draws`` counts the maps of one change; ``groups`` is the number of groups of the bootstrap.
    """
    row = _sizes_of(part)
    clusters = pairs_of(part)
    if part.change.iloc[0] == HEIGHTS:
        clusters = clusters.crossed(Clusters(part.draw, seed=1))
    row |= {"draws": part.draw.nunique(), "groups": clusters.num_groups}
    for statistic in CHANGED_STATISTICS:
        average: Statistic = "share" if statistic in SHARES_OF_ROUTES else "mean"
        row |= named(statistic, clusters.interval(part[statistic], average))
    return row
