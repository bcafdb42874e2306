"""A receiver on the made-up drive that is known: it tracks what the maps see, and some noise."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd

from benchmarks.receiver.counts import CountSettings, CountValidation, counted
from tests.receivers.receiver_logs import drive, scenario

SETTINGS = CountSettings(sky_step_s=240.0, block_m=100.0)
# Most of the time goes into the shifts of each length.
OF_ONE_LENGTH = replace(SETTINGS, other_pieces_m=())


@cache
def seen() -> CountValidation:
    """Return what the maps say along the drive; its witness is of no interest."""
    log = drive().assign(num_tracked=5)
    return counted(scenario(), log, OF_ONE_LENGTH)


@cache
def true_log() -> pd.DataFrame:
    """Return the drive of a receiver that tracks what is in view, one more or less, and errs as HDOP says."""
    rng = np.random.default_rng(6)
    epochs = seen().epochs
    in_view = epochs.num_visible.fillna(0).to_numpy()
    error_m = (
        3.0 * np.minimum(epochs.hdop.fillna(50.0), 50.0) * rng.lognormal(0.0, 0.3, len(epochs))
    )
    return drive().assign(
        num_tracked=np.maximum(in_view + rng.integers(-1, 2, len(epochs)), 0), error_2d_m=error_m
    )


@cache
def found() -> CountValidation:
    return counted(scenario(), true_log(), SETTINGS)
