"""Several fits of weights to one set of routes, judged by routes that none of them saw."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, at_least, one_of, typed
from jaxurban.studies.bootstrap import Clusters
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import check_alike
from jaxurban.studies.route_pool import FitSettings
from jaxurban.studies.tuning.fenchel_young import LOSSES, trust_of, usual_regret
from jaxurban.studies.tuning.weight_fit import DISTRUSTED, WeightFit, fit_weights

SPLIT = 0  # stream of random numbers
MOST_HELD_OUT = 0.9
ENDS = "", "_low", "_high"  # of an interval's columns


@dataclass(frozen=True, eq=False)
class FitComparison:
    """Fits of weights to one set of ``N`` routes.

    Attributes:
      fits: by name; the first is the one to use: to all cities, by the first loss.
      table: a row a fit: ``fit``, ``loss``, ``cities``, ``num_fitted``, each weight (``w_distance`` ...), and
        ``held_out_regret``, by which share held-out routes that are not bad cost more than the cheapest ones under
        the fit, the mean, with its interval (``_low``, ``_high``; some 90 %, as regrets are skewed) over pairs of ends
        within these cities.
      is_held_out: ``[N]`` bool: the routes that no fit saw.
      is_bad: ``[N]`` bool: under the first fit a route costs so much more than the cheapest one that it hardly counts.
    """

    fits: Mapping[str, WeightFit]
    table: pd.DataFrame
    is_held_out: np.ndarray
    is_bad: np.ndarray

    @property
    def best(self) -> WeightFit:
        """The first fit."""
        return next(iter(self.fits.values()))


@typed
def compare_fits(
    cities: Mapping[str, Sequence[Demonstration]],
    *,
    hold_out: float = 0.25,
    losses: Sequence[str] = ("robust", "plain"),
    by_city: bool = True,
    scale: str = "simplex",
    bootstrap: int = 200,
    settings: FitSettings | None = None,
) -> FitComparison:
    """Return fits by several losses and by city, each judged by routes that were held out of all of them.

    In every city a share of the routes is held out, drawn by the seed; routes between the same cells, at several
    altitudes say, go together. A fit by each loss sees the rest of all cities. By the first loss there is further one
    fit to each city alone, and where there are more than two, one without each: it tells how weights carry over to a
    city that was not seen.

    Args:
      cities: demonstrations by city.
      hold_out: share of the routes of each city, from 0 to 0.9; without any, regrets on held-out routes are not known.
      losses: see `fit_weights`; the first is that of the fits by city.
      by_city: make these fits.
      scale, bootstrap, settings: as in `fit_weights`; further fits than the first keep their searches beside its state
        file, their numbers in its name.

    Raises:
      InputError: no routes, maps that do not go together, a share or a loss that is none, or too few routes to hold
        some out.
    """
    losses, settings = tuple(dict.fromkeys(losses)), settings or FitSettings()
    at_least("bootstrap", bootstrap)
    one_of("scale", scale, ("simplex", "distance"))
    for each in losses:
        one_of("each of losses", each, LOSSES)
    if not losses:
        raise InputError(f"losses is empty: name at least one of {', '.join(LOSSES)}")
    if not 0 <= hold_out <= MOST_HELD_OUT:
        raise InputError(f"hold_out must be a share from 0 to {MOST_HELD_OUT:g}, got {hold_out}")
    of_route = [(str(name), each) for name, shown in cities.items() for each in shown]
    city, demonstrations = np.array([name for name, _ in of_route]), [each for _, each in of_route]
    queries = [shown.query for shown in demonstrations]
    names = check_alike(queries)
    group, _ = pd.factorize(pd.Series([(name, shown.query.start, shown.query.goal) for name, shown in of_route]))
    is_held_out = split(city, group, hold_out, settings.seed)
    fits: dict[str, WeightFit] = {}
    plans, file = _plans(list(dict.fromkeys(city.tolist())), losses, by_city), settings.state_file
    for number, (name, loss, members) in enumerate(plans):
        seen = list(itertools.compress(demonstrations, ~is_held_out & np.isin(city, members)))
        how = replace(settings, state_file=None if file is None else state_file(Path(file), number))
        fits[name] = fit_weights(seen, scale=scale, loss=loss, bootstrap=bootstrap, settings=how)
    vectors = np.array([fit.vector for fit in fits.values()])
    cheapest = replace(settings, state_file=None).pool(queries).cheapest(vectors)[0]  # [N, F, K]
    demo = np.array([shown.features for shown in demonstrations])
    regret = (demo @ vectors.T) / np.einsum("nfk,fk->nf", cheapest, vectors) - 1
    is_bad = trust_of(regret[:, 0], usual_regret(regret[~is_held_out, 0])) < DISTRUSTED
    is_judged = is_held_out & ~is_bad
    clusters = Clusters(group[is_judged], city[is_judged], settings.seed)
    rows = []
    for number, (name, loss, members) in enumerate(plans):
        row = {"fit": name, "loss": loss, "cities": ", ".join(members), "num_fitted": len(fits[name].trust)}
        row |= {f"w_{weight}": value for weight, value in zip(names, vectors[number].tolist(), strict=True)}
        interval = clusters.interval(regret[is_judged, number])
        rows.append(row | {f"held_out_regret{end}": value for end, value in zip(ENDS, interval, strict=True)})
    return FitComparison(fits, pd.DataFrame(rows), is_held_out, is_bad)


def split(city: np.ndarray, group: np.ndarray, share: float, seed: int) -> np.ndarray:
    """Return ``[N]`` bool: the routes that are held out, about a share of the groups of every city.

    Args:
      city: ``[N]`` of each route.
      group: ``[N]`` number of each route's group, whose members stay together.
      share: of the groups of a city, at least one where it is above 0.
      seed: of the draw.

    Raises:
      InputError: a city without a group left to be fitted.
    """
    is_held_out = np.zeros(len(city), bool)
    rng = np.random.default_rng([SPLIT, seed])
    for name in dict.fromkeys(city.tolist()):
        groups = rng.permutation(np.unique(group[city == name]))
        num = max(1, round(share * len(groups))) if share > 0 else 0
        if num >= len(groups):
            raise InputError(
                f"the routes of {name!r} join {len(groups)} pair(s) of ends, too few to hold some out: give more "
                "routes, or a smaller share (--hold-out, hold_out=)"
            )
        is_held_out |= np.isin(group, groups[:num])
    return is_held_out


def _plans(cities: list[str], losses: Sequence[str], by_city: bool) -> list[tuple[str, str, list[str]]]:
    """Return the name, the loss and the cities of each fit."""
    plans = [(loss, loss, cities) for loss in losses]
    if by_city and len(cities) > 1:
        plans += [(f"only {city}", losses[0], [city]) for city in cities]
    if by_city and len(cities) > 2:
        plans += [(f"without {city}", losses[0], [each for each in cities if each != city]) for city in cities]
    return plans


def state_files(file: Path, cities: list[str], losses: Sequence[str], by_city: bool) -> list[Path]:
    """Return where the searches of each fit of `compare_fits` are kept: those of the first in ``file``."""
    return [state_file(file, number) for number in range(len(_plans(cities, losses, by_city)))]


def state_file(file: Path, number: int) -> Path:
    """Return where the searches of one of several fits are kept."""
    return file.with_stem(f"{file.stem}-{number}") if number else file
