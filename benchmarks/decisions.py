"""How often studies decide rightly, wrongly or not at all, where the answer is known.

``python -m benchmarks.decisions [--seeds 200] [--cases 20]`` prints a row per case. Five are made: two weights that are
equal by construction, one that dominates, one layer that is the same everywhere, one route that the border pins, and a
planner that is better by 1 %. The others are random: two to six alternatives, some of them equal on average, with
normal, skewed or mostly equal runs, each alone or at three altitudes. Each seed draws runs of a large population whose
means are the answer. A seed is *wrong* if it puts one alternative before another that is not, or calls two equal that
are not, and *decided* if it finds the smallest difference of the answer (or, where all are equal on all runs, says so).
The stated number of runs is what `runs_needed` says of the smallest difference.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter

import jaxurban as ju
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.statistics.bootstrap import Clusters
from jaxurban.statistics.conclusions import runs_needed
from jaxurban.studies.decided import (
    FEWEST_GROUPS,
    Measure,
    Ranking,
    border_verdict,
    edge_band,
    is_at_edge,
    ranked,
)
from jaxurban.studies.queries import RouteQuery
from jaxurban.studies.route_pool import RoutePool
from tests.made_maps import made_maps

NUM_POPULATION = 6000  # groups
NUM_PILOT, NUM_PILOTS = (
    400,
    5,
)  # groups of a draw from which the spread of differences is known, and such draws
WRONG = 2.0  # factor of a wrong weight
ALTITUDE_M = 60.0


class Kind(Enum):
    """What is decided of two alternatives."""

    BEFORE = "{first} is before {last} by {size} ({n})"


@dataclass(frozen=True)
class Case:
    """A question with a known answer.

    Attributes:
      name: of the case.
      groups: ``[G, R, A]`` values of A alternatives in R runs of each of G groups.
      is_ratio: values are compared by their ratio.
      is_equal: the answer is that all are equal on all runs.
      asked: number of the alternative whose differences to the others are asked for; None: all differences are.
    """

    name: str
    groups: np.ndarray
    is_ratio: bool = False
    is_equal: bool = False
    asked: int | None = None

    @property
    def effects(self) -> np.ndarray:
        """``[A, A]`` the answer: mean of the second less the first, or of the logarithm of their ratio."""
        values = np.log(self.groups) if self.is_ratio else self.groups
        mean = values.mean(axis=(0, 1))
        effect = mean[None, :] - mean[:, None]
        return np.where(np.abs(effect) < 1e-9, 0.0, effect)

    def ranking(self, rng: np.random.Generator, num: int) -> Ranking:
        """Return the ranks of a study of so many groups, drawn from the population."""
        chosen = self.groups[rng.choice(len(self.groups), num, replace=False)]
        num_runs, num_names = chosen.shape[1:]
        values = pd.DataFrame(chosen.reshape(-1, num_names), columns=list("abcdefgh"[:num_names]))
        clusters = Clusters(np.repeat(np.arange(num), num_runs))
        return ranked({"": Measure(values, is_ratio=self.is_ratio)}, clusters)[""]

    def stated_runs(self) -> int:
        """Return how many groups decide the smallest difference, as `runs_needed` says of its true size."""
        if self.is_equal:
            return FEWEST_GROUPS

        # From a large pilot, and again from one of so many, as intervals of few groups are wider.
        return self._runs_after(self._runs_after(NUM_PILOT))

    def _runs_after(self, num_pilot: int) -> int:
        """Return the stated number from the widths of intervals in studies of another number."""
        rng = np.random.default_rng(0)
        rankings = [self.ranking(rng, num_pilot).pairs for _ in range(NUM_PILOTS)]
        return int(np.median([self._runs_of(pairs, num_pilot) for pairs in rankings]))

    def _runs_of(self, pairs: pd.DataFrame, num_pilot: int) -> int:
        """Return the stated number from the widths of intervals in one study."""
        half = (pairs.high - pairs.low) / 2
        if self.is_ratio:
            half = (np.log1p(pairs.high / 100) - np.log1p(pairs.low / 100)) / 2
        needed = [float(FEWEST_GROUPS)]
        for row, half_width in zip(pairs.itertuples(), half, strict=True):
            size = max(
                abs(self._effect(a, b))
                for a in row.first.split(" = ")
                for b in row.second.split(" = ")
            )
            reach = max(half_width * np.sqrt(num_pilot), 1.0001 * size)  # of a single run
            if size and size == self.smallest:
                needed.append(runs_needed(size, size - reach, size + reach, 1))
        return int(min(max(needed), NUM_POPULATION))

    @property
    def smallest(self) -> float:
        """The smallest difference of the answer that is not 0; 0 where there is none."""
        sizes = np.abs(self.effects)
        if self.asked is not None:
            sizes = sizes[self.asked]
        return float(sizes[sizes > 0].min(initial=np.inf)) if (sizes > 0).any() else 0.0

    def _effect(self, first: str, second: str) -> float:
        return float(self.effects["abcdefgh".index(first), "abcdefgh".index(second)])

    def outcome(self, rng: np.random.Generator, num: int) -> tuple[bool, bool]:
        """Return whether a study of so many groups is wrong, and whether it decides the case."""
        ranking = self.ranking(rng, num)
        effects = self.effects
        is_wrong = False
        found = set()
        for names in ranking.equal:
            numbers = ["abcdefgh".index(name) for name in names]
            is_wrong |= bool(np.any(effects[np.ix_(numbers, numbers)]))
        for row in ranking.pairs[ranking.pairs.needed == 0].itertuples():
            for first in row.first.split(" = "):
                for second in row.second.split(" = "):
                    effect = self._effect(first, second)
                    is_wrong |= effect <= 0
                    found.add(abs(effect))
        is_decided = self.smallest in found
        if self.is_equal:
            is_decided = bool(ranking.equal) and not len(ranking.pairs)
        return is_wrong, is_decided


def open_map(layers: dict[str, np.ndarray]) -> MetricMaps:
    """Return maps without obstacles, of metrics m ``[Y, X]``; those that are not named are 1 everywhere."""
    shape = next(iter(layers.values())).shape
    maps = made_maps(*shape, (ALTITUDE_M,))
    for name in ("obstacle", "roof", "roof_touched"):
        maps.ds[name][:] = 0
    for name in ("gps", "lidar", "risk", "population"):
        m = layers.get(name, np.full(shape, 0.0 if name in ("risk", "population") else 1.0))
        maps.ds[name][:] = m.astype(np.float32)
    return maps


def rough(seed: int, sigma: float = 1.5) -> np.ndarray:
    """Return ``[36, 40]`` values from 0 to 1 that vary over a few cells."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=(36, 40)), sigma)
    return (values - values.min()) / np.ptp(values)


def regrets_of(layers: dict[str, np.ndarray], num: int = 1500) -> np.ndarray:
    """Return ``[num, 1, 3]`` regrets, in percent, of a wrong weight of gps, lidar and risk on random routes."""
    weights = ju.Weights(distance=0.1, gps=1.0, lidar=1.0, population=0.0, risk=1.0)
    cost_map = ju.cost_map(open_map(layers), ALTITUDE_M, weights=weights)
    vector = cost_map.weight_vector
    columns = [cost_map.weight_names.index(name) for name in ("gps", "lidar", "risk")]
    wrong = np.tile(vector, (2 * len(columns), 1))
    for number, column in enumerate(columns):
        wrong[2 * number : 2 * number + 2, column] *= 1 / WRONG, WRONG
    rng = np.random.default_rng(1)
    rows = []
    while len(rows) < num:
        start, goal = (tuple(map(int, rng.integers((36, 40)))) for _ in range(2))
        if np.hypot(start[0] - goal[0], start[1] - goal[1]) < 12:
            continue
        pool = RoutePool([RouteQuery(cost_map, start, goal)])
        cost = float(pool.cheapest(vector[None])[0, 0, 0] @ vector)
        regret = np.maximum(pool.cheapest(wrong)[0, 0] @ vector / cost - 1, 0.0)
        rows.append(100 * regret.reshape(-1, 2).max(axis=1))
    return np.array(rows)[:, None]


def made_cases() -> Iterator[Case]:
    """Yield the made cases but for that of the border."""
    layer = rough(1)
    twins = regrets_of({"gps": layer, "lidar": layer, "risk": np.zeros((36, 40))})
    yield Case("two weights equal by construction", twins[..., :2], is_equal=True)
    faint = {"gps": rough(1), "lidar": 1 - 0.1 * rough(2), "risk": 0.1 * rough(3)}
    yield Case("one weight dominates", -regrets_of(faint), asked=0)
    same = {"gps": rough(1), "lidar": rough(2), "risk": np.zeros((36, 40))}
    constant = regrets_of(same)
    yield Case("one constant layer", -constant[..., [0, 2]])
    rng = np.random.default_rng(5)
    cost = rng.lognormal(4.0, 0.8, (NUM_POPULATION, 1, 1))
    noise = rng.normal(0.0, 0.02, (NUM_POPULATION, 1))
    better = np.concatenate([cost, cost * 1.01 * np.exp(noise - noise.mean())[..., None]], axis=-1)
    yield Case("a planner better by 1 %", better, is_ratio=True)


def random_case(seed: int) -> Case:
    """Return a random case: its alternatives, their distances, and how runs scatter."""
    rng = np.random.default_rng([9, seed])
    num = int(rng.integers(2, 7))
    num_runs = int(rng.choice([1, 3]))
    shape = (NUM_POPULATION, num_runs, num)
    law = rng.choice(["normal", "skewed", "mostly equal"])
    own = rng.normal(size=shape)
    if law == "skewed":
        own = rng.exponential(size=shape) * rng.exponential(size=(NUM_POPULATION, 1, 1))
    if law == "mostly equal":
        own = rng.exponential(size=shape) * (rng.random(shape) < 0.3)
    spread = rng.uniform(0.5, 1.5, num)
    values = spread * own + rng.normal(size=(NUM_POPULATION, num_runs, 1))

    # Means on a ladder with equal steps missing: some alternatives are equal on average, to the last digit.
    steps = rng.choice([0.0, 0.0, 0.3, 0.5, 1.0], num)
    if seed % 5:
        steps[-1] = max(steps[-1], 0.3)
    values = values - values.mean(axis=(0, 1)) + np.cumsum(steps)
    text = f"random {seed}: {num}, {law}, {num_runs} runs a group, steps {steps[1:].tolist()}"
    return Case(text, values)


def border_outcome(seed: int) -> tuple[bool, bool]:
    """Return whether a study is wrong on the border, and whether it finds the one route that the border pins.

    A wall of high cost parts the map in two; only a strip of two cells along the border is cheap, where the wall is
    passed. Of twelve routes one joins both sides, and the others stay on theirs.
    """
    rng = np.random.default_rng(seed)
    quality = 0.9 + 0.1 * rng.random((40, 48))
    quality[:, 20:28] = 0.0
    quality[:2] = 1.0
    maps = open_map({"gps": quality})
    weights = ju.Weights(distance=0.02, gps=1.0, lidar=0.0, population=0.0, risk=0.0)
    cost_map = ju.cost_map(maps, ALTITUDE_M, weights=weights)
    rows = rng.integers(14, 34, (12, 2))
    cols = np.where(rng.random((12, 1)) < 0.5, (5, 15), (32, 43))
    cols[0] = 6, 41
    band = edge_band(maps)
    is_pinned = []
    for (row_a, row_b), (col_a, col_b) in zip(rows.tolist(), cols.tolist(), strict=True):
        query = RouteQuery(cost_map, (row_a, col_a), (row_b, col_b))
        route_m = query.cheapest(cost_map.weight_vector)
        is_pinned.append(is_at_edge(route_m, maps.grid, band))
    verdicts = border_verdict(np.array(is_pinned))
    count = verdicts[0].facts["count"] if verdicts else 0
    return any(is_pinned[1:]), count == 1 and is_pinned[0]


def row(name: str, num: int, num_seeds: int, outcome: Callable[[int], tuple[bool, bool]]) -> str:
    """Return a row of the table: the case, its stated number of runs, and how many seeds are wrong and decided."""
    outcomes = np.array([outcome(seed) for seed in range(num_seeds)])
    wrong, decided = outcomes.sum(axis=0)
    return f"| {name} | {num} | {wrong} of {num_seeds} | {100 * decided / num_seeds:.0f} % |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--cases", type=int, default=20)
    chosen = parser.parse_args()
    print("| case | runs | wrong | decided |\n|---|---|---|---|")
    print(row("one route pinned by the border", 12, chosen.seeds, border_outcome), flush=True)
    for case in [*made_cases(), *map(random_case, range(chosen.cases))]:
        num = case.stated_runs()

        def outcome(seed: int, case: Case = case, num: int = num) -> tuple[bool, bool]:
            return case.outcome(np.random.default_rng([3, seed]), num)

        print(row(case.name, num, chosen.seeds, outcome), flush=True)


if __name__ == "__main__":
    main()
