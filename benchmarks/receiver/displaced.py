"""Cities that are wrong on purpose: far displaced for the null, a little or with other roofs for a peak.

Legend: ``R`` rows of a log, an epoch and a satellite each, ``M`` displacements, those of the null first, ``B`` blocks
of the track, ``D`` draws of them, the first one each block once.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.progress import Report
from jaxurban.receivers.rule import is_seen
from jaxurban.receivers.validation.agreement import FEWEST_ROWS
from jaxurban.receivers.validation.scores import aucs, drawn_blocks, levels_of
from jaxurban.receivers.walk import LegSurface
from jaxurban.statistics.bootstrap import FEWEST_GROUPS
from jaxurban.world.known import Rays

NEAREST_M, FARTHEST_M = 80.0, 450.0  # that cities of the null are displaced by
STEP_M, AROUND_M = 2.0, 40.0  # of the field of displacement
SCALES = np.round(np.linspace(0.8, 1.2, 21), 2)  # of all roofs
NUM_DRAWS = 200  # of blocks, for peaks


class Displaced:
    """What rows of a log would be in displaced cities, and under other roofs. Filled leg by leg.

    Attributes:
      moves_m: ``[M, 2]`` east and north of each displaced city.
      num_null: how many of them are of the null.
      is_seen: ``[M, R]`` whether the row is seen there.
      is_out: ``[M, R]`` whether its place is in a building there, or, of the null, its ray unknown.
      of_scale: ``[scales, R]`` whether it is seen under roofs of each of `SCALES`.
    """

    def __init__(self, num_null: int, seed: int, num_rows: int) -> None:
        """Begin with displacements that are still to be filled: those of the null by seed, then those of the field."""
        self.moves_m = np.concatenate([displacements(num_null, seed), near_by()])
        self.num_null = num_null
        self.is_seen = np.zeros((len(self.moves_m), num_rows), bool)
        self.is_out = np.zeros_like(self.is_seen)
        self.of_scale = np.zeros((len(SCALES), num_rows), bool)

    def fill(
        self,
        column: np.ndarray,
        ground: LegSurface,
        rays: Rays,
        known: shapely.Geometry | None,
        rise_m: float,
        report: Report,
    ) -> None:
        """Write to ``is_seen``, ``is_out`` and ``of_scale`` what the rows of a leg are in every displaced city.

        Args:
          column: the column, from 0 to R - 1, of each ray's row.
          ground: of the city in its true place, around the leg.
          rays: from the true places.
          known: where the buildings are known, in their true place; None: rays that leave it count all the same.
          rise_m: from the antenna to the highest roof; a ray that has risen this far may leave the known ground.
          report: of the progress.
        """
        # A city that moves is the same as rays that move the other way.
        for number, (east_m, north_m) in enumerate(self.moves_m):
            report("displaced cities", number, len(self.moves_m))
            moved = rays.moved(-east_m, -north_m)
            self.is_seen[number, column] = is_seen(ground.margins_m(moved))
            self.is_out[number, column] = ground.is_inside(moved)
            if known is not None and number < self.num_null:
                self.is_out[number, column] |= ~moved.stays_within(known, rise_m)
                self.is_out[number, column] |= ground.crosses_gap(moved, rise_m)
        for number, scale in enumerate(SCALES):
            roof_m = np.float32(scale) * ground.roof_m
            self.of_scale[number, column] = is_seen(replace(ground, roof_m=roof_m).margins_m(rays))

    def tables(self, rows: pd.DataFrame, seed: int) -> dict[str, Any]:
        """Return how displaced cities and other roofs score, when all legs are filled in.

        These are ``displaced``, ``field``, ``scales`` and ``peak`` of an `Evidence`.

        A city of the null with fewer than `FEWEST_ROWS` rows has the scores NaN, and with fewer blocks than
        `FEWEST_GROUPS` there is no peak.

        Args:
          rows: R rows of the validation, in the order of the columns.
          seed: of the bootstrap.
        """
        # The rows that count in each displaced city: judged in the true one, and neither inside nor unknown there.
        level = levels_of(rows.cn0_dbhz)
        satellite = rows.satellite.cat.codes.to_numpy()
        is_judged = rows.is_judged.to_numpy()
        block, weights = drawn_blocks(rows.block.where(rows.is_judged).to_numpy(), seed)
        keeps = is_judged & ~self.is_out
        num_rows = keeps.sum(axis=1)

        # The null: a row per far displaced city, with its AUC over all pairs of rows, and within satellites. Only the
        # first draw of blocks counts, which has each block once.
        null = np.full((self.num_null, 2), np.nan)
        for number in np.flatnonzero(num_rows[: self.num_null] >= FEWEST_ROWS):
            keep = keeps[number]
            of_city = self.is_seen[number, keep], level[keep], block[keep], weights[:1]
            null[number] = aucs(*of_city)[0], aucs(*of_city, satellite[keep])[0]

        def drawn(is_seen: np.ndarray, keep: np.ndarray) -> np.ndarray:
            """Return ``[D]`` the AUC of the rows that are kept, under each draw of blocks."""
            return aucs(is_seen[keep], level[keep], block[keep], weights[: 1 + NUM_DRAWS])

        # The AUC under each draw of blocks: [moves, D] of small displacements, and [scales, D] of scaled roofs.
        around = range(self.num_null, len(keeps))
        by_move = np.array([drawn(self.is_seen[number], keeps[number]) for number in around])
        by_scale = np.array([drawn(is_seen, is_judged) for is_seen in self.of_scale])

        # The tables, with the scores of the first draw; the others serve the peaks and their intervals.
        cities = pd.DataFrame(self.moves_m, columns=["east_m", "north_m"])
        cities["rows"] = num_rows
        near = cities[self.num_null :].assign(auc=by_move[:, 0]).reset_index(drop=True)
        scales = {"scale": SCALES, "rows": int(is_judged.sum()), "auc": by_scale[:, 0]}
        if weights.shape[1] < FEWEST_GROUPS:  # values that are all NaN have no peak
            by_move = np.full_like(by_move, np.nan)
            by_scale = np.full_like(by_scale, np.nan)
        best_moves_m = peaks(by_move, near[["east_m", "north_m"]].to_numpy())
        best_scales = peaks(by_scale, SCALES)
        east_m, north_m = best_moves_m[0].tolist()
        low, high = np.quantile(best_scales[1:], [0.025, 0.975]).tolist()
        return {
            "displaced": cities[: self.num_null].assign(auc=null[:, 0], within=null[:, 1]),
            "field": near,
            "scales": pd.DataFrame(scales),
            "peak": {
                "east_m": east_m,
                "north_m": north_m,
                "within_95_m": float(np.quantile(np.hypot(*best_moves_m[1:].T), 0.95)),
                "scale": float(best_scales[0]),
                "scale_low": low,
                "scale_high": high,
            },
        }


def peaks(values: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Return ``[D, ...]`` the candidate with the highest value in each draw; NaN where all values are alike or NaN.

    Args:
      values: ``[F, D]`` of each candidate in each draw.
      candidates: ``[F, ...]`` displacements or scales.
    """
    highest = np.nan_to_num(values, nan=-np.inf)
    has_peak = highest.max(axis=0) > np.nan_to_num(values, nan=np.inf).min(axis=0)
    places = candidates[np.argmax(highest, axis=0)].astype(np.float64)
    places[~has_peak] = np.nan
    return places


def displacements(num: int, seed: int) -> np.ndarray:
    """Return ``[num, 2]`` east and north, metres, drawn evenly from the ring of the null."""
    rng = np.random.default_rng(seed)
    away_m = np.sqrt(rng.uniform(NEAREST_M**2, FARTHEST_M**2, num))
    toward_rad = rng.uniform(0, 2 * np.pi, num)
    return np.column_stack([away_m * np.sin(toward_rad), away_m * np.cos(toward_rad)])


def near_by() -> np.ndarray:
    """Return ``[F, 2]`` the displacements of the field, none first."""
    steps_m = np.arange(-AROUND_M, AROUND_M + STEP_M / 2, STEP_M)
    east_m, north_m = (values.ravel() for values in np.meshgrid(steps_m, steps_m))
    away_m = np.hypot(east_m, north_m)
    order = np.argsort(away_m, kind="stable")
    return np.column_stack([east_m, north_m])[order[away_m[order] <= AROUND_M]]
