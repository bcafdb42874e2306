"""An agreement of maps and a receiver made of known numbers, with which reports, pictures and pages are tried."""

from functools import cache

import numpy as np
import pandas as pd

from jaxurban.studies.receiver.agreement import PlaceSky, SatelliteAgreement
from tests.receiver_logs import found


@cache
def made() -> SatelliteAgreement:
    """Return an agreement with a known number in each field, along the first 60 epochs of the drive."""
    rng = np.random.default_rng(7)
    names = ["G01", "G02", "E03", "E04", "C05", "R06"]
    rows = pd.DataFrame({"epoch": np.repeat(np.arange(60), 6), "satellite": names * 60})
    rows["margin_m"] = rng.choice([-80.0, -7.0, -1.0, 1.0, 7.0, np.inf], len(rows))
    rows["cn0_dbhz"] = np.where(rng.random(len(rows)) < 0.3, 0.0, rng.uniform(18, 52, len(rows)))
    rows["azimuth_deg"], rows["elevation_deg"] = (
        rng.uniform(0, 360, len(rows)),
        rng.uniform(10, 85, len(rows)),
    )
    rows = rows.assign(
        is_seen=rows.margin_m > 0,
        is_known=True,
        is_inside=rows.epoch < 3,
        is_strong=rows.cn0_dbhz > 36,
    )
    rows = rows.assign(
        is_judged=~rows.is_inside, system=rows.satellite.str[0], block=rows.epoch // 5
    )
    kinds = ("all", "received", "G", "E", "C", "R", "unguarded")
    low, value, high = np.array([[0.811], [0.842], [0.873]]) + np.arange(len(kinds)) / 1000
    scores = pd.DataFrame(
        {
            "which": kinds,
            "rows": 342,
            "share": 0.957,
            "auc": value,
            "auc_low": low,
            "auc_high": high,
        }
    )
    scores = scores.assign(
        within=value - 0.1, within_low=low - 0.1, within_high=high - 0.1, num_satellites=6
    )
    steps = np.arange(-4.0, 5.0, 2.0)
    field = pd.DataFrame(
        [(x, y, 342, 0.8 - abs(x - 2) / 100 - abs(y) / 100) for x in steps for y in steps]
    )
    displaced = pd.DataFrame(
        {"east_m": 100.0, "north_m": 0.0, "rows": 342, "auc": np.linspace(0.511, 0.622, 9)}
    )
    models = ("constant", "elevation", "street", "seen or hidden", "margin", "margin and elevation")
    rivals = pd.DataFrame({"model": models, "log_loss": 0.6 - np.arange(6) / 100, "gain": 0.0})
    scales = np.round(np.arange(0.8, 1.21, 0.02), 2)
    start = found().epochs.iloc[300]
    columns = [
        "satellite",
        "azimuth_deg",
        "elevation_deg",
        "cn0_dbhz",
        "is_seen",
        "is_judged",
        "is_strong",
    ]
    there = rows[rows.epoch == 30][columns].reset_index(drop=True)
    place = start.lon_deg, start.lat_deg, start.utc.isoformat(), np.linspace(5, 60, 360), there
    return SatelliteAgreement(
        rows=rows,
        scores=scores,
        displaced=displaced.assign(within=displaced.auc - 0.1),
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
        rivals=rivals.assign(gain_low=-0.031, gain_high=0.047),
        block_lengths=pd.DataFrame(
            {"block_m": [50.0, 100.0, 200.0], "num_blocks": [12, 6, 3], "gain": 0.01}
        ).assign(gain_low=[-0.02, -0.03, np.nan], gain_high=[0.04, 0.05, np.nan]),
        skies=tuple(PlaceSky(name, *place) for name in ("least agreement", "most agreement")),
        strong_dbhz=36.5,
        verdict="Maps and receiver agree.",
        counts={
            "rows": 360,
            "judged": 342,
            "is_guarded": True,
            "unknown": 11,
            "inside": 18,
            "num_satellites": 6,
            "num_blocks": 12,
            "num_displaced": 9,
            "num_asked": 9,
            "every": 1,
            "is_median": True,
            "left_out": {"E18": "unhealthy"},
        },
    )
