"""Several fits of weights to one set of routes, judged by routes that none of them saw."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from jaxurban.errors import InputError, at_least, one_of, typed
from jaxurban.metrics.weights import Weights
from jaxurban.studies.bootstrap import counts_within, interval_of
from jaxurban.studies.demonstrations import Demonstration
from jaxurban.studies.queries import RouteQuery, check_alike
from jaxurban.studies.tuning.fenchel_young import LOSSES, trust_of, usual_regret
from jaxurban.studies.tuning.fit_settings import FitSettings
from jaxurban.studies.tuning.weight_fit import DISTRUSTED, WeightFit, fit_weights

SPLIT = 0  # stream of random numbers
MOST_HELD_OUT = 0.9


@dataclass(frozen=True, eq=False)
class FitComparison:
    """Fits of weights to one set of routes. Regrets are shares: 0.001 is a tenth of a percent.

    Attributes:
      fits: by name; the first is the one to use: to all cities, by the first loss.
      table: a row a fit: ``fit``, ``loss``, ``cities``, ``num_fitted``, ``num_bad`` (of these, hardly trusted), each
        weight (``w_distance`` ...), ``cosine`` to the pilot's weights, or without a pilot to the first fit's, of w_j x
        std(phi_j), and between which cosines 95 % of the bootstrap fits lie; ``held_out_regret``, the mean over held-
        out routes that are not bad, its interval (some 90 %, as regrets are skewed) over pairs of ends within these
        cities and ``worst``; ``all_held_out_regret``, bad ones too; ``regret CITY``, the same mean by city; with a
        pilot ``pilot_regret``, by which share planned routes under the fit cost more than the cheapest ones under the
        pilot's weights, over the held-out routes' ends, bad ones too, and its interval.
      routes: a row a demonstration: ``city``, ``name``, ``altitude_m``, ``is_held_out``, ``regret`` and ``trust``
        under the first fit, and ``is_bad``: so far above most that it hardly counts.
      reference: what cosines are to: ``"pilot"`` or the name of the first fit.
      seed: of the split and of the fits.
    """

    fits: Mapping[str, WeightFit]
    table: pd.DataFrame
    routes: pd.DataFrame
    reference: str
    seed: int

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
    pilot: Weights | None = None,
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
      pilot: the weights that the routes are known to be planned under, bad ones aside.
      scale, bootstrap, settings: as in `fit_weights`; further fits than the first keep their searches beside its state
        file, their names in its name.

    Raises:
      InputError: no routes, maps that do not go together, a share or a loss that is none, or too few routes to hold
        some out.
    """
    losses, settings = tuple(dict.fromkeys(losses)), settings or FitSettings()
    at_least("bootstrap", bootstrap)
    one_of("scale", scale, ("simplex", "distance"))
    if pilot is not None:
        pilot.check_some("pilot")
    for each in losses:
        one_of("each of losses", each, LOSSES)
    if not losses:
        raise InputError(f"losses is empty: name at least one of {', '.join(LOSSES)}")
    if not 0 <= hold_out <= MOST_HELD_OUT:
        raise InputError(f"hold_out must be a share from 0 to {MOST_HELD_OUT:g}, got {hold_out}")
    cities = {str(name): list(shown) for name, shown in cities.items() if len(shown)}
    demonstrations = [each for shown in cities.values() for each in shown]
    queries = [shown.query for shown in demonstrations]
    names = check_alike(queries)
    city = np.repeat(list(cities), [len(shown) for shown in cities.values()])
    group = _groups(city, queries)
    is_held_out = split(city, group, hold_out, settings.seed)
    fits: dict[str, tuple[WeightFit, str, list[str]]] = {}
    plans = _plans(list(cities), losses, by_city)
    file = settings.state_file
    kept = [None for _ in plans] if file is None else state_files(Path(file), list(cities), losses, by_city)
    for (name, loss, members), state_file in zip(plans, kept, strict=True):
        fitted = np.flatnonzero(~is_held_out & np.isin(city, members))
        how = replace(settings, state_file=state_file)
        seen = [demonstrations[k] for k in fitted]
        fits[name] = (fit_weights(seen, scale=scale, loss=loss, bootstrap=bootstrap, settings=how), loss, members)
    judge = _Judge(demonstrations, city, group, is_held_out, pilot, [fit for fit, _, _ in fits.values()], settings)
    rows = [
        {
            "fit": name,
            "loss": loss,
            "cities": ", ".join(members),
            "num_fitted": len(fit.trust),
            "num_bad": int((fit.trust < DISTRUSTED).sum()),
            **{f"w_{weight}": value for weight, value in zip(names, fit.vector.tolist(), strict=True)},
            **judge.facts(number),
        }
        for number, (name, (fit, loss, members)) in enumerate(fits.items())
    ]
    first = next(iter(fits))
    return FitComparison(
        fits={name: fit for name, (fit, _, _) in fits.items()},
        table=pd.DataFrame(rows),
        routes=judge.routes(),
        reference=first if pilot is None else "pilot",
        seed=settings.seed,
    )


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


def _groups(city: np.ndarray, queries: Iterable[RouteQuery]) -> np.ndarray:
    """Return ``[N]`` a number for each route, the same for those of one city that join the same cells."""
    keys = [(name, *query.start, *query.goal) for name, query in zip(city.tolist(), queries, strict=True)]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    return np.array([numbers[key] for key in keys])


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
    others = [re.sub(r"[^0-9a-zA-Z]+", "-", name) for name, _, _ in _plans(cities, losses, by_city)[1:]]
    return [file, *(file.with_stem(f"{file.stem}-{name}") for name in others)]


class _Judge:
    """What fits are worth on ``N`` routes, ``H`` of them held out. ``F`` fits, ``K`` weights."""

    def __init__(
        self,
        demonstrations: Sequence[Demonstration],
        city: np.ndarray,
        group: np.ndarray,
        is_held_out: np.ndarray,
        pilot: Weights | None,
        fits: Sequence[WeightFit],
        settings: FitSettings,
    ) -> None:
        """Search the cheapest routes under every fit's weights, and the pilot's."""
        self.demonstrations, self.fits, self.settings = demonstrations, fits, settings
        self.city, self.group, self.is_held_out = city, group, is_held_out
        queries = [shown.query for shown in demonstrations]
        weights = [fit.vector for fit in fits]
        self.pilot = None if pilot is None else pilot.vector(queries[0].names)
        asked = np.array(weights if self.pilot is None else [*weights, self.pilot])
        searched = replace(settings, state_file=None).pool(queries).cheapest(asked)[0]  # [N, F, K]
        shown = np.array([each.features for each in demonstrations])
        self.spread = shown[~is_held_out].std(axis=0)  # [K]
        self.regret = (shown @ asked.T) / np.einsum("nfk,fk->nf", searched, asked) - 1
        self.usual = usual_regret(self.regret[~is_held_out, 0])
        self.trust = trust_of(self.regret[:, 0], self.usual)
        self.is_bad = self.trust < DISTRUSTED
        if self.pilot is not None:
            cost = searched @ self.pilot
            self.pilot_regret = cost / cost[:, -1:] - 1

    def facts(self, number: int) -> dict[str, float]:
        """Return what a fit is worth, by the columns of the table."""
        reference = self.fits[0].vector if self.pilot is None else self.pilot
        near = [_cosine(each * self.spread, reference * self.spread) for each in self.fits[number].draws]
        low, high = np.quantile(near, [0.025, 0.975]) if near else (np.nan, np.nan)
        cosine = _cosine(self.fits[number].vector * self.spread, reference * self.spread)
        good = self.is_held_out & ~self.is_bad
        facts = {"cosine": cosine, "cosine_low": low, "cosine_high": high}
        facts |= self._mean("held_out_regret", self.regret[:, number], good)
        facts["worst"] = float(self.regret[good, number].max(initial=0.0)) if good.any() else np.nan
        facts["all_held_out_regret"] = _mean_of(self.regret[self.is_held_out, number])
        for city in dict.fromkeys(self.city.tolist()):
            facts[f"regret {city}"] = _mean_of(self.regret[good & (self.city == city), number])
        if self.pilot is not None:
            facts |= self._mean("pilot_regret", self.pilot_regret[:, number], self.is_held_out)
        return facts

    def _mean(self, name: str, values: np.ndarray, chosen: np.ndarray) -> dict[str, float]:
        """Return the mean of the chosen values and its interval over pairs of ends within these cities."""
        group, city = self.group[chosen], self.city[chosen]
        num_groups = len(np.unique(group)) - len(np.unique(city)) + 1
        interval = interval_of(values[chosen], counts_within(group, city, self.settings.seed), num_groups)
        return dict(zip((name, f"{name}_low", f"{name}_high"), interval, strict=True))

    def routes(self) -> pd.DataFrame:
        """Return a row a demonstration, as the first fit sees it."""
        queries = [shown.query for shown in self.demonstrations]
        number = pd.Series(self.city).groupby(self.city).cumcount() + 1  # of a route in its city
        return pd.DataFrame(
            {
                "city": self.city,
                "name": [query.name or f"{k}" for query, k in zip(queries, number, strict=True)],
                "altitude_m": [query.cost_map.altitude_m for query in queries],
                "is_held_out": self.is_held_out,
                "regret": self.regret[:, 0],
                "trust": self.trust,
                "is_bad": self.is_bad,
            }
        )


def _cosine(one: np.ndarray, other: np.ndarray) -> float:
    return float(one @ other / max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-300))


def _mean_of(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else np.nan
