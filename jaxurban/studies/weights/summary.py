"""What the rows of a weight study say together: means and medians over routes, cut many ways, each with its interval.

Intervals are 95 % (of mean regrets some 90 %), by bootstrap over pairs of places within their cities, all altitudes of
a pair drawn together: they are of these cities.
"""

from collections.abc import Callable, Iterator
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.paths.rows import HAS_PATH
from jaxurban.statistics.bootstrap import Clusters, Statistic, named
from jaxurban.studies.decided import FEWEST_RUNS, effects
from jaxurban.studies.weights.paid import PAID
from jaxurban.studies.weights.routes import OF_WEIGHT, ROUTE_KEY, TOGETHER

DESCRIBED = ("time", "time_of_day", "start_stratum", "goal_stratum", "range", "distance_m")
ALL = "all"
AT_ONCE = {  # columns of `effects`, of mean regrets
    "size": "regret",
    "low": "regret_low",
    "high": "regret_high",
    "needed": "regret_needed",
}
DIGITS = 9  # of percents; what is less is rounding
CUTS = ("city", "altitude_m", "range")
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
    where the weight is up to ``wrong`` times too small or too large, ``regret_alone`` the mean regret, and
    ``more_length_m`` and the like what a user pays more for such a weight on average (`PAID`).

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
        "regret_alone": (itemgetter("regret"), "mean"),
        **{name: (itemgetter(name), "mean") for name in MORE},
    }


def regrets_of(weights: pd.DataFrame) -> pd.DataFrame:
    """Return the regrets of weights that vary, shares of the cost: a row per route, in order, a column per weight."""
    varied = weights[weights.varies]
    key = [*ROUTE_KEY]
    table = varied.pivot(index=key, columns="weight_name", values="regret")
    return table.reindex(pd.MultiIndex.from_frame(varied[key].drop_duplicates()))


def cuts_of(table: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield the parts of a table of weights: what the table is cut by, the value of the part, and the part.

    First the whole table, then the parts of each cut (`parts_of`); those with fewer than `FEWEST_RUNS` routes are left
    out.
    """
    yield ALL, ALL, table
    yield from (part for part in parts_of(table) if num_routes(part[-1]) >= FEWEST_RUNS)


def parts_of(table: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield the parts of each cut that has two values or more, as `cuts_of`, however small they are."""
    for cut in CUTS:
        if cut in table and table[cut].nunique() > 1:
            for value, part in table.groupby(cut, sort=True):
                yield cut, _text_of(value), part


def small_parts(table: pd.DataFrame) -> list[str]:
    """Return the values of the parts that have too few routes for a row, with their number of routes."""
    sizes = [(value, num_routes(part)) for _, value, part in parts_of(table)]
    return [f"{value} ({num})" for value, num in sizes if num < FEWEST_RUNS]


def num_routes(table: pd.DataFrame) -> int:
    """Return how many routes a table of weights holds, each counted once."""
    return len(table.drop_duplicates([*ROUTE_KEY]))


def _text_of(value: Any) -> str:
    """Return the value of a cut as text; a number is an altitude in metres."""
    return f"{value:g} m" if isinstance(value, float) else str(value)


def pairs_of(table: pd.DataFrame) -> Clusters:
    """Return draws of the rows of a table, of pairs of places within cities."""
    return Clusters(table.instance, table.city)


def summarise(weights: pd.DataFrame, wrong: float) -> pd.DataFrame:
    """Return which weights matter where: a row for each part (``cut``, ``value``) of the routes and each weight.

    Its columns are the sizes of the part and the statistics of `statistics_of`, each with its interval alone, and
    ``regret``, the mean regret, whose intervals hold for all weights of a part at once; ``regret_needed`` pairs of
    places would keep its interval off 0.

    Args:
      weights: from `weights_table`.
      wrong: factor of a wrong weight.
    """
    rows = []
    for cut, value, part in cuts_of(weights):
        regrets = regrets_of(part)
        at_once: Any = effects(regrets, pairs_of(regrets.index.to_frame()), least=0.0)
        at_once = at_once.rename(columns=AT_ONCE)[[*AT_ONCE.values()]]
        at_once = at_once.reindex(part.weight_name.unique())
        for name, of_weight in part.groupby("weight_name", sort=False):
            row = {"cut": cut, "value": value, "weight_name": name, **_sizes_of(of_weight)}
            clusters = pairs_of(of_weight)
            for statistic, (values_of, average) in statistics_of(wrong).items():
                row |= named(statistic, clusters.interval(values_of(of_weight), average))
            rows.append(row | at_once.loc[name].to_dict())
    return pd.DataFrame(rows)


def act_together(routes: pd.DataFrame) -> pd.DataFrame:
    """Return which weights act together: a row per two ``weights``, those first that do most.

    ``size`` is what both cost more, in % of the cost, that are wrong in opposite directions than in the same one; also
    ``low``, ``high``, ``n`` and ``needed``, as of `effects`. Where weights do not act together it is 0, as the effect
    of the one then does not change with the other: it is the interaction of two factors at two levels (Box, Hunter and
    Hunter, Statistics for Experimenters, 2nd edition, chapter 5).

    Args:
      routes: from `routes_of`; where a single weight varies the table is empty.
    """
    values = 100 * routes.filter(like=TOGETHER)
    values.columns = values.columns.str.removeprefix(TOGETHER)
    table = effects(values.round(DIGITS), pairs_of(routes)).rename_axis("weights")
    return table.sort_values("size", key=np.abs, ascending=False).reset_index()


def _sizes_of(part: pd.DataFrame) -> dict[str, float]:
    """Return how many routes, pairs of places and cities a part of a table holds."""
    return {
        "routes": len(part),
        "pairs": part.groupby(["city", "instance"]).ngroups,
        "cities": part.city.nunique(),
    }


def summarise_changed(changed: pd.DataFrame) -> pd.DataFrame:
    """Return how far routes change on other maps: rows for all routes, each city and each altitude, of each ``change``.

    Parts with fewer than `FEWEST_RUNS` routes are left out.

    All draws of heights count together, and their intervals are of draws and of routes at once. The columns are the
    means of the columns of `jaxurban.studies.weights.routes.OnChangedMaps`; ``layers`` are the metrics that change.

    Args:
      changed: rows of routes on other maps.
    """
    changed = changed[changed.status.isin(HAS_PATH)]
    rows = []
    for change, of_change in changed.groupby("change", sort=False):
        layers = dict.fromkeys(",".join(of_change.layers.unique()).split(","))
        for cut, value, part in cuts_of(of_change):
            head = {"change": change, "layers": ",".join(layers), "cut": cut, "of": value}
            rows.append(head | _changes_of(part))
    return pd.DataFrame(rows)


def _changes_of(part: pd.DataFrame) -> dict[str, float]:
    """Return the columns of a row of `summarise_changed`: the sizes of a part, and its means with their intervals.

    ``draws`` counts the maps of one change, on each of which the ``routes`` are planned; ``groups`` is the number of
    groups of the bootstrap.
    """
    row = _sizes_of(part) | {"routes": num_routes(part)}
    clusters = pairs_of(part)
    if part.change.iloc[0] == HEIGHTS:
        clusters = clusters.crossed(Clusters(part.draw, seed=1))
    row |= {"draws": part.draw.nunique(), "groups": clusters.num_groups}
    for statistic in CHANGED_STATISTICS:
        average: Statistic = "share" if statistic in SHARES_OF_ROUTES else "mean"
        row |= named(statistic, clusters.interval(part[statistic], average))
    return row
