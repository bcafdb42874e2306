"""A validation of a receiver made of known numbers, with which reports, pictures and pages are tried."""

from functools import cache

import numpy as np
import pandas as pd

import jaxurban as ju
from jaxurban.maps.run import scenario_grid
from jaxurban.receivers.validation.agreement import PlaceSky
from jaxurban.receivers.validation.drive import drive_track
from jaxurban.receivers.validation.logs import ReceiverLog
from jaxurban.typing import ReceiverValidation
from tests.receivers.receiver_logs import drive, scenario


@cache
def made() -> ReceiverValidation:
    """Return a validation with a known number in each field, along the first 60 epochs of the drive."""
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
    track = drive_track("a drive", drive(), scenario_grid(scenario()), 30.0)
    places = {"x_m": track.x_m, "y_m": track.y_m, "along_m": track.along_m}
    epochs = drive().assign(**places, num_visible=5.0, num_heard=4.0)
    start = epochs.iloc[300]
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
    left_out = {"E18": "unhealthy"}
    return ReceiverValidation(
        log=ReceiverLog("log.csv", drive(), rows[columns[:4]].assign(epoch=rows.epoch), left_out),
        settings=ju.studies.ReceiverSettings(),
        scenario=scenario().model_dump(mode="json"),
        summary={
            "epochs": len(epochs),
            "epochs_left_out": 3,
            "first_utc": "2020-04-27T16:00:00+00:00",
            "last_utc": "2020-04-27T16:11:32+00:00",
            "length_m": float(track.along_m[-1]),
            "resolution_m": 5.0,
            "rows": 360,
            "judged": 342,
            "unknown": 11,
            "inside": 18,
            "num_satellites": 6,
            "num_blocks": 12,
            "mean_num_visible": 5.04,
            "mean_num_heard": 4.0,
        },
        epochs=epochs,
        rows=rows.assign(state=np.where(rows.is_inside, "unknown", "seen")),
        scores=scores,
        skies=tuple(PlaceSky(name, *place) for name in ("least agreement", "most agreement")),
        strong_dbhz=36.5,
        attribution="a city's surveyors",
    )
