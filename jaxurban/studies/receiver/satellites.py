"""Satellite by satellite: whether the receiver tracks those in sight, and how strongly it hears them."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from jaxurban.errors import InputError, nearest_name
from jaxurban.io.read.receiver import CN0, SATELLITE, ReceiverLog
from jaxurban.studies.receiver.agreement import auc
from jaxurban.studies.receiver.prediction import Prediction

# What a receiver calls a satellite, where the name in an element file tells it: CelesTrak writes (PRN 13) behind GPS
# satellites and (C19) behind BeiDou's.
IDS = {"G": re.compile(r"\(PRN 0*(\d+)\)"), "C": re.compile(r"\(C0*(\d+)\)")}
MOST_NAMED = 5  # unknown satellites in a message


@dataclass(frozen=True, eq=False)
class TrackedSatellites:
    """Which satellites were tracked. ``N`` epochs, ``S`` satellites of the prediction.

    Attributes:
      is_tracked: ``[N, S]`` bool.
      cn0_dbhz: ``[N, S]`` carrier-to-noise density, NaN where it is not tracked or not told.
    """

    is_tracked: np.ndarray
    cn0_dbhz: np.ndarray

    @classmethod
    def of(cls, log: ReceiverLog, names: Sequence[str], known: Iterable[str]) -> "TrackedSatellites | None":
        """Return what a log tells of the satellites ``names``, None where it names none.

        Args:
          log: of the receiver.
          names: of the satellites that stand above the mask at some time.
          known: all satellites of the orbits; rows of one that is never above the mask are left out.

        Raises:
          InputError: a satellite that the orbits do not hold, or one under two names at one time.
        """
        if log.satellites is None:
            return None
        numbers = _numbers(names)
        given = log.satellites[SATELLITE].map(_plain)
        held = _numbers(list(known))
        if unknown := sorted(set(log.satellites[SATELLITE][~given.isin([*held])])):
            more = f" and {len(unknown) - MOST_NAMED} more" if len(unknown) > MOST_NAMED else ""
            raise InputError(
                f"the receiver log {log.name!r} has satellites that [gps] orbits do not hold: "
                f"{', '.join(map(repr, unknown[:MOST_NAMED]))}{more}{nearest_name(unknown[0], known)}; call them as "
                "the orbits do, add the orbits of their system, or remove their rows"
            )
        of = log.satellites.assign(of=given.map(held))
        if (twice := of.duplicated(["epoch", "of"])).any():
            named = of[SATELLITE][(of[["epoch", "of"]] == of[["epoch", "of"]][twice].iloc[0]).all(axis=1)]
            raise InputError(
                f"the receiver log {log.name!r} has one satellite under two names at one time, "
                f"{' and '.join(map(repr, named))}: keep one"
            )
        is_tracked = np.zeros((len(log.epochs), len(names)), bool)
        cn0_dbhz = np.full(is_tracked.shape, np.nan)
        rows = given.isin([*numbers]).to_numpy()
        at = log.satellites["epoch"].to_numpy()[rows], given[rows].map(numbers).to_numpy(np.int64)
        is_tracked[at] = True
        if CN0 in log.satellites:
            cn0_dbhz[at] = log.satellites[CN0].to_numpy()[rows]
        return cls(is_tracked, cn0_dbhz)


def _plain(name: str) -> str:
    return " ".join(name.upper().split())


def _numbers(names: Sequence[str]) -> dict[str, int]:
    """Return the number of each satellite by its name, and by what receivers call it where the name tells that."""
    found = {_plain(name): s for s, name in enumerate(names)}
    for s, name in enumerate(names):
        for letter, tells in IDS.items():
            if number := tells.search(name.upper()):
                found |= {f"{letter}{int(number[1])}": s, f"{letter}{int(number[1]):02d}": s}
    return found


def table_of(tracked: TrackedSatellites, predicted: Prediction) -> pd.DataFrame:
    """Return a row a satellite: when it is in sight, when it is tracked, and its median C/N0, in sight and hidden."""
    is_known = predicted.is_known
    rows = []
    for s, name in enumerate(predicted.names):
        up = is_known & predicted.is_above[:, s]
        seen, hidden = up & predicted.is_seen[:, s], up & ~predicted.is_seen[:, s]
        row: dict[str, object] = {"satellite": name, "epochs": int(up.sum()), "in_sight": _mean(seen[up])}
        for where, chosen in (("in_sight", seen), ("hidden", hidden)):
            row[f"tracked_{where}"] = _mean(tracked.is_tracked[chosen, s])
            cn0 = tracked.cn0_dbhz[chosen, s]
            row[f"cn0_{where}_dbhz"] = float(np.median(cn0[~np.isnan(cn0)])) if (~np.isnan(cn0)).any() else np.nan
        rows.append(row)
    return pd.DataFrame(rows)


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else np.nan


def satellite_agreements(tracked: TrackedSatellites, predicted: Prediction) -> dict[str, Callable[[np.ndarray], float]]:
    """Return, by witness, the AUC of being in sight, as a function of ``is_seen`` ``[N, S]`` at the known epochs.

    Witnesses: ``satellite``, whether one above the mask is tracked, and ``cn0_dbhz`` of those that are. A satellite
    that is below the mask where the maps' values were moved from counts as hidden.
    """
    up = predicted.is_above[predicted.is_known]
    cn0 = tracked.cn0_dbhz[predicted.is_known]
    witnesses = {SATELLITE: tracked.is_tracked[predicted.is_known], CN0: cn0}
    return {
        witness: _auc_of(values, up & ~np.isnan(values))
        for witness, values in witnesses.items()
        if witness == SATELLITE or not np.isnan(cn0).all()
    }


def _auc_of(values: np.ndarray, is_counted: np.ndarray) -> Callable[[np.ndarray], float]:
    ranks = rankdata(values[is_counted])
    return lambda is_seen: auc(ranks, is_seen[is_counted])
