"""Calibration: the gammas that bring the people of a region to a known total, by the total's own gradient."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxurban.errors import InputError, nearest_name
from jaxurban.metrics.population import BlockPopulation, PopulationParams, block_people, day_share
from jaxurban.world.city import Blocks
from jaxurban.world.grid import Bounds

ZONINGS = ("commercial", "residential")
SAME = 1e-9  # relative: a total this close is met


@dataclass(frozen=True)
class Calibration:
    """Gammas that give a total of people.

    Attributes:
      target_total: number of people that was given.
      total: people under ``params``; the target where these are found.
      params: the settings with the gammas found; None where both are free, since one total cannot fix two.
      people_per_unit: how many people one more of each gamma brings, by ``"commercial"`` and ``"residential"``.
      solutions: ``[2, 2]`` ends of the line of all gammas >= 0 (commercial, residential) that give the target: with
        the lowest and with the highest gamma_commercial.
    """

    target_total: float
    total: float
    params: PopulationParams | None
    people_per_unit: Mapping[str, float]
    solutions: np.ndarray

    @property
    def is_unique(self) -> bool:
        """Whether the total fixes the gammas."""
        return self.params is not None

    @property
    def sentence(self) -> str:
        """What was found, for people."""
        if self.params is not None:
            return (
                f"{self.total:,.0f} people with gamma_commercial = {self.params.gamma_commercial:.4f} and "
                f"gamma_residential = {self.params.gamma_residential:.4f}."
            )
        (low_c, high_r), (high_c, low_r) = self.solutions
        return (
            f"One total cannot fix two gammas: {self.target_total:,.0f} people come of every pair on the line from "
            f"gamma_commercial = {low_c:.4f} with gamma_residential = {high_r:.4f} to gamma_commercial = {high_c:.4f} "
            f"with gamma_residential = {low_r:.4f}; hold one of them, as in hold={{'residential': 0.5}}."
        )


def calibrate_gamma(
    blocks: Blocks,
    target_total: float,
    hold: Mapping[str, float] | None = None,
    *,
    time_of_day: str = "day",
    params: PopulationParams | None = None,
    bounds_m: Bounds | None = None,
) -> Calibration:
    """Return the gamma with which a region holds a given number of people, by a Newton step on the total's gradient.

    Args:
      blocks: the census blocks.
      target_total: people at that time of day.
      hold: the gammas that are known, ``{"residential": 0.5}`` or ``{"commercial": 3.0}``. With none the total
        leaves a line of solutions, which comes back instead.
      time_of_day: see `jaxurban.metrics.population.day_share`.
      params: other settings (quantity, norm, profiles), kept in what comes back.
      bounds_m: count the blocks that touch this box, whole; left out, all.

    Raises:
      InputError: a target that no gamma >= 0 reaches, a time at which the gammas count nothing, an unknown or a
        negative held gamma, or both held.
    """
    params, held = params or PopulationParams(), dict(hold or {})
    for kind, gamma in held.items():
        if kind not in ZONINGS:
            raise InputError(f"hold names {kind!r}{nearest_name(kind, ZONINGS)}: use commercial or residential")
        if not 0 <= gamma < np.inf:
            raise InputError(f"the held gamma_{kind} must be finite and not negative, got {gamma}")
    if len(held) == len(ZONINGS):
        raise InputError("both gammas are held, so that nothing is left to fit: hold one of them")
    if not 0 <= target_total < np.inf:
        raise InputError(f"target_total must be a number of people, got {target_total}")
    share = day_share(time_of_day, params)
    if share == 0:
        raise InputError(f"gammas change nothing at {time_of_day!r}, when the census count stands: use 'day'")
    with jax.enable_x64(True):
        population = BlockPopulation.of(blocks, bounds_m, np.float64)

        @jax.jit
        def total(gammas):
            return block_people(population.night_count, population.zoning, share, *gammas)[population.in_region].sum()

        gammas = jnp.array([held.get(kind, 1.0) for kind in ZONINGS])
        per_unit = np.asarray(jax.grad(total)(gammas))
        always = float(total(jnp.zeros(2)))  # people that no gamma touches: the share that has not changed to day
        free = [kind for kind in ZONINGS if kind not in held]
        _check_reachable(target_total, always, per_unit, held, free)
        ends = _line(target_total - always, per_unit)
        by_kind = dict(zip(ZONINGS, per_unit.tolist(), strict=True))
        if len(free) == len(ZONINGS):
            return Calibration(float(target_total), float(total(gammas)), None, by_kind, ends)
        place = ZONINGS.index(free[0])
        people_now = float(total(gammas))
        if abs(people_now - target_total) > SAME * target_total:  # the total is linear in the gammas: one step does
            gammas = gammas.at[place].add((target_total - people_now) / per_unit[place])
        found = dict(zip(ZONINGS, gammas.tolist(), strict=True))
        found[free[0]] = max(0.0, found[free[0]])  # a target at the very bound may come out below 0 by rounding
        fitted = replace(params, **{f"gamma_{kind}": gamma for kind, gamma in found.items()})
        return Calibration(float(target_total), float(total(gammas)), fitted, by_kind, ends)


def _check_reachable(
    target: float, always: float, per_unit: np.ndarray, held: Mapping[str, float], free: list[str]
) -> None:
    """Raise InputError where no gamma >= 0 gives the target."""
    at_least = always + sum(held[kind] * per_unit[ZONINGS.index(kind)] for kind in held)
    known = "".join(f" with gamma_{kind} held at {gamma:g}" for kind, gamma in held.items())
    if target < at_least * (1 - SAME):
        needed = [
            (target - at_least) / per_unit[ZONINGS.index(kind)] for kind in free if per_unit[ZONINGS.index(kind)] > 0
        ]
        negative = f" (gamma_{free[0]} would have to be {needed[0]:.3f})" if len(free) == 1 and needed else ""
        raise InputError(
            f"{target:,.0f} people cannot be reached{known}: there are {at_least:,.0f} even with no others{negative}; "
            "hold a smaller gamma, or ask for more people"
        )
    if target > at_least * (1 + SAME) and not any(per_unit[ZONINGS.index(kind)] > 0 for kind in free):
        raise InputError(
            f"{target:,.0f} people cannot be reached{known}: nobody lives in {' or '.join(free)} blocks by the census, "
            f"so gamma_{free[0]} changes nothing and there are {at_least:,.0f}; free the other gamma"
        )


def _line(people: float, per_unit: np.ndarray) -> np.ndarray:
    """Return the ends ``[2, 2]`` of the gammas >= 0 that bring ``people``; inf where a gamma changes nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        most_commercial, most_residential = people / per_unit
    return np.array([[0.0, most_residential], [most_commercial, 0.0]])
