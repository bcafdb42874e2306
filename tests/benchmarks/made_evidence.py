"""Evidence on the made-up drive with a row a satellite, and evidence made of known numbers."""

from functools import cache

import numpy as np
import pandas as pd
import pytest

import jaxurban as ju
from benchmarks.receiver import displaced, rivals
from benchmarks.receiver.evidence import Evidence, evidence_of
from tests.made_agreement import made
from tests.receivers.receiver_logs import scenario
from tests.satellite_logs import heard

FALSE_PRAISE = 17  # of 200: with 5 % of chance each, no more in 98 of 100 trials


@cache
def evidence() -> Evidence:
    return evidence_of(scenario(), heard(), num_displaced=120)


def few_displaced(
    log: pd.DataFrame, of: ju.Scenario | None = None, num_displaced: int = 1, **settings
) -> Evidence:
    """Return the evidence of few displaced cities, with a small field."""
    chosen = ju.studies.ReceiverSettings(**settings)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(displaced, "AROUND_M", 4.0)
        return evidence_of(of or scenario(), log, chosen, num_displaced)


def is_praised(
    rows: pd.DataFrame, margin_m: np.ndarray, elevation_rad: np.ndarray, off_rad: np.ndarray
) -> bool:
    """Return whether margins are called better than the rule of the street."""
    rules = rivals.features_of(margin_m, elevation_rad, off_rad)
    chosen = {name: rules[name] for name in (rivals.STREET, rivals.MAP)}
    table = rivals.compared_rules(chosen, rows.is_strong.to_numpy(), rows.block.to_numpy(), seed=0)
    return bool(table.set_index("model").gain_low[rivals.MAP] > 0)


def wrong_margins(rows: pd.DataFrame, rng: np.random.Generator, step_s: float) -> np.ndarray:
    """Return the margins of the rows, shifted in time within satellites, or of satellites that are swapped."""
    table = rows.pivot(index="epoch", columns="satellite", values="margin_m")
    if rng.random() < 0.5:
        shift = int(np.rint(rng.uniform(30.0, 200.0) / step_s))
        moved = table.apply(lambda of: pd.Series(np.roll(of.dropna(), shift), of.dropna().index))
    else:
        order = rng.permutation(table.shape[1])
        while (order == np.arange(len(order))).any():
            order = rng.permutation(table.shape[1])
        moved = pd.DataFrame(table.to_numpy()[:, order], table.index, table.columns)
    at = table.index.get_indexer(rows.epoch), table.columns.get_indexer(rows.satellite)
    return np.where(np.isnan(moved.to_numpy()[at]), 0.0, moved.to_numpy()[at])


@cache
def made_evidence() -> Evidence:
    """Return evidence with a known number in each field."""
    steps = np.arange(-4.0, 5.0, 2.0)
    field = pd.DataFrame(
        [(x, y, 342, 0.8 - abs(x - 2) / 100 - abs(y) / 100) for x in steps for y in steps]
    )
    cities = pd.DataFrame(
        {"east_m": 100.0, "north_m": 0.0, "rows": 342, "auc": np.linspace(0.511, 0.622, 9)}
    )
    models = ("constant", "elevation", "street", "seen or hidden", "margin", "margin and elevation")
    of_rules = pd.DataFrame({"model": models, "log_loss": 0.6 - np.arange(6) / 100, "gain": 0.0})
    scales = np.round(np.arange(0.8, 1.21, 0.02), 2)
    return Evidence(
        of=made(),
        displaced=cities.assign(within=cities.auc - 0.1),
        field=field.set_axis(["east_m", "north_m", "rows", "auc"], axis="columns"),
        scales=pd.DataFrame({"scale": scales, "rows": 342, "auc": 0.8 - abs(scales - 1)}),
        peak={
            "east_m": 2.0,
            "north_m": 0.0,
            "within_95_m": 5.7,
            "scale": 1.0,
            "scale_low": 0.94,
            "scale_high": 1.06,
        },
        rivals=of_rules.assign(gain_low=-0.031, gain_high=0.047),
        block_lengths=pd.DataFrame(
            {"block_m": [50.0, 100.0, 200.0], "num_blocks": [12, 6, 3], "gain": 0.01}
        ).assign(gain_low=[-0.02, -0.03, np.nan], gain_high=[0.04, 0.05, np.nan]),
        num_blocks=12,
        every=1,
        verdict="Maps and receiver agree.",
    )
