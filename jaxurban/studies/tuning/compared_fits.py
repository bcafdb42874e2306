"""Several fits of weights to one set of routes, judged by routes that none of them saw."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from jaxurban.checks import at_least, typed
from jaxurban.errors import InputError
from jaxurban.studies.bootstrap import Clusters, Interval, interval_columns, named
from jaxurban.studies.decided import FEWEST_TO_HOLD_OUT, USUAL_SHARE, Conclusion
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import check_alike
from jaxurban.studies.route_pool import FitSettings, pool_of_fit
from jaxurban.studies.tuning.fenchel_young import trust_of, usual_regret
from jaxurban.studies.tuning.weight_fit import (
    DISTRUSTED,
    WeightFit,
    WeightScale,
    fit_conclusion,
    fit_weights,
)

ALL = "all"
SPLIT = 0  # stream of random numbers
MOST_HELD_OUT = 0.9


@dataclass(frozen=True, eq=False)
class FitComparison:
    """Fits of weights to one set of ``N`` routes.

    Attributes:
      fits: by name; the first is ``"all"``, that to all cities.
      table: a row per fit: ``fit``, ``cities``, ``num_fitted``, each weight (``w_distance`` ...), and
        ``held_out_regret``, by which share held-out routes that are not bad cost more than the cheapest ones under
        the fit, the mean, with its interval (``_low``, ``_high``; some 90 %, as regrets are skewed) over pairs of ends
        within these cities.
      num_tested: pairs of ends of the held-out routes that are not bad.
      is_held_out: ``[N]`` bool: the routes that no fit saw.
      is_bad: ``[N]`` bool: under the first fit a route costs so much more than the cheapest one that it hardly counts.

    Examples:
      >>> back = ju.plan(maps, goal, start, altitude_m=60.0)
      >>> cities = {"demo": ju.fit.demonstrations_from_paths([path, back], maps)}
      >>> quick = ju.fit.FitSettings(max_rounds=2)
      >>> compared = ju.fit.compare_fits(cities, hold_out=0.5, bootstrap=0, settings=quick)
      >>> compared.fits["all"].names, compared.is_bad.tolist()
      (('distance', 'gps', 'lidar', 'population', 'risk'), [False, False])
    """

    fits: Mapping[str, WeightFit]
    table: pd.DataFrame
    num_tested: int
    is_held_out: np.ndarray
    is_bad: np.ndarray

    @property
    def decided(self) -> Conclusion:
        """How far routes that no fit saw follow the first one, and which of its weights the routes show."""
        if not self.num_tested:
            return self.fits[ALL].decided
        tested = Interval(*self.table[interval_columns("held_out_regret")].iloc[0])
        return fit_conclusion(self.fits[ALL], tested, self.num_tested)


@typed
def compare_fits(
    cities: Mapping[str, Sequence[Demonstration]],
    *,
    hold_out: float | None = None,
    by_city: bool = True,
    scale: WeightScale = "simplex",
    bootstrap: int = 200,
    settings: FitSettings | None = None,
) -> FitComparison:
    """Return a fit to all cities and, by city, further ones, each judged by routes that were held out of all of them.

    In every city a share of the routes is held out, drawn by the seed; routes between the same cells, at several
    altitudes say, go together. The further fits are one to each city alone and, where there are more than two, one
    without each: it says how weights carry over to a city that was not seen.

    Args:
      cities: demonstrations by city.
      hold_out: share of the routes of each city, from 0 to 0.9; left out, a quarter from 16 routes on, of fewer none.
        Without any, regrets on held-out routes are not known.
      by_city: make the further fits.
      scale, bootstrap, settings: as in `fit_weights`; of the searches, the state file keeps those of the first fit.

    Returns:
      ``table``, a row per fit: its weights, and the mean regret of the held-out routes under them with its interval, as
      shares of the cheapest cost (NaN where no route was held out, or all that were are bad); ``fits`` by the same
      names; and which of the ``N`` routes, in the order of the cities, were held out or are bad.

    Raises:
      InputError: no routes, maps that do not go together, an invalid share, or too few routes to hold some out.

    Examples:
      >>> back = ju.plan(maps, goal, start, altitude_m=60.0)
      >>> cities = {"demo": ju.fit.demonstrations_from_paths([path, back], maps)}
      >>> quick = ju.fit.FitSettings(max_rounds=2)
      >>> compared = ju.fit.compare_fits(cities, hold_out=0.5, bootstrap=0, settings=quick)
      >>> compared.table["fit"].tolist(), compared.is_held_out.tolist()
      (['all'], [True, False])
      >>> compared.table["held_out_regret"].round(2).tolist()
      [0.0]
    """
    # The arguments.
    settings = settings or FitSettings()
    at_least("bootstrap", bootstrap)

    # All N routes, city after city: the city of each, and the number of its pair of ends. Routes between the same ends
    # are held out together.
    demonstrations = list(itertools.chain.from_iterable(cities.values()))
    queries = [each.query for each in demonstrations]
    names = check_alike(queries)
    city = np.repeat([*map(str, cities)], [*map(len, cities.values())])
    ends = [(query.start, query.goal) for query in queries]
    group, _ = pd.factorize(pd.Series(list(zip(city.tolist(), ends, strict=True))))
    is_held_out = split(city, group, hold_out, settings.seed)

    # The fits, by name, to the cities that each is made of: all; each city alone; and, of three or more, all but one.
    in_turn = list(dict.fromkeys(city.tolist()))
    members = {ALL: in_turn}
    if by_city and len(in_turn) > 1:
        members |= {f"only {each}": [each] for each in in_turn}
    if by_city and len(in_turn) > 2:
        members |= {
            f"without {each}": [other for other in in_turn if other != each] for each in in_turn
        }
    without_file = replace(settings, state_file=None)  # of all fits but the first one
    fits = {}
    for name, cities_of_fit in members.items():
        is_fitted = ~is_held_out & np.isin(city, cities_of_fit)
        fits[name] = fit_weights(
            list(itertools.compress(demonstrations, is_fitted)),
            scale=scale,
            bootstrap=bootstrap,
            settings=settings if name == ALL else without_file,
        )

    # [N, F] the regret of every route under each of F fits, against the cheapest route that a search finds. A route is
    # bad if its regret under the first fit is far above the usual one of the routes that were fitted.
    vectors = np.array([fit.vector for fit in fits.values()])
    cheapest = pool_of_fit(without_file, queries).cheapest(vectors)[0]  # [N, F, K]
    demo = np.array([demonstration.features for demonstration in demonstrations])
    regret = (demo @ vectors.T) / np.einsum("nfk,fk->nf", cheapest, vectors) - 1
    is_bad = trust_of(regret[:, 0], usual_regret(regret[~is_held_out, 0])) < DISTRUSTED

    # Each fit is judged by the same routes: held out, and not bad under the first fit.
    is_judged = is_held_out & ~is_bad
    clusters = Clusters(group[is_judged], city[is_judged], settings.seed)
    rows = []
    for number, (name, fit) in enumerate(fits.items()):
        row = {"fit": name, "cities": ", ".join(members[name]), "num_fitted": len(fit.trust)}
        for weight, value in zip(names, fit.vector.tolist(), strict=True):
            row[f"w_{weight}"] = value
        interval = clusters.interval(regret[is_judged, number])
        rows.append(row | named("held_out_regret", interval))
    num_tested = len(np.unique(group[is_judged]))
    return FitComparison(fits, pd.DataFrame(rows), num_tested, is_held_out, is_bad)


def split(city: np.ndarray, group: np.ndarray, share: float | None, seed: int) -> np.ndarray:
    """Return ``[N]`` bool: whether each route is held out.

    In every city about the given share of the groups is held out, at least one unless the share is 0. Without a share
    it is `USUAL_SHARE` where there are `FEWEST_TO_HOLD_OUT` groups and two in every city, else 0.

    Args:
      city: ``[N]`` name of each route's city.
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
                f"the routes of {name!r} join {len(groups)} pair(s) of ends, too few to hold some out: give more "
                "routes, or a smaller share (hold_out)"
            )
        is_held_out |= np.isin(group, groups[:num])
    return is_held_out
