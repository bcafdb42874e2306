"""Which satellites of a receiver's log the city hides, and by how many metres, beside how strongly they were heard.

C/N0 comes from the receiver. Whether a satellite is seen or hidden, and by how many metres, comes from the maps.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxurban.errors import InputError
from jaxurban.io.tracks import LAT, LON, UTC
from jaxurban.receivers.outlines import Hiding
from jaxurban.receivers.rule import HIDDEN, SEEN, UNKNOWN, is_seen
from jaxurban.receivers.validation.drive import Drive

FEWEST_ROWS = 100  # of a score
FEWEST_SEEN = 8  # judged rows of a block that may be drawn as a place


@dataclass(frozen=True, eq=False)
class PlaceSky:
    """The sky over one place of the track, of a `ReceiverValidation`.

    Attributes:
      name: which place it is.
      lon_deg, lat_deg: of the place.
      utc: of the epoch.
      horizon_deg: ``[360]`` elevation of the horizon at each degree of azimuth, as of `SkyAt`; NaN where the horizon
        lies beyond what is known.
      satellites: rows of the epoch.
    """

    name: str
    lon_deg: float
    lat_deg: float
    utc: str
    horizon_deg: np.ndarray
    satellites: pd.DataFrame


def judged_rows(drive: Drive) -> pd.DataFrame:
    """Return the rows of a drive with what the city says of each: ``rows`` of a `ReceiverValidation`.

    Raises:
      InputError: fewer than `FEWEST_ROWS` rows that can be judged.
    """
    # Whether each ray stays above known ground until it is above all roofs, and what it meets in the city.
    rows, rays = drive.rows()
    rows["is_known"] = rays.stays_within(drive.known, drive.rise_m)
    rows["margin_m"] = np.nan
    rows["is_inside"] = False
    for of_leg, ground in drive.grounds(rows, rays):
        leg_rays = rays.take(of_leg)
        rows.loc[of_leg, "is_known"] &= ~ground.crosses_gap(leg_rays, drive.rise_m)
        rows.loc[of_leg, "is_inside"] = ground.is_inside(leg_rays)
        rows.loc[of_leg, "margin_m"] = ground.margins_m(leg_rays)

    # Which rows are judged, and which of them the receiver hears well.
    is_open = rows.is_known | (not drive.is_guarded)
    _judge(rows, is_open, drive.log.name, drive.mask_deg)
    rows["is_strong"] = rows.cn0_dbhz >= strong_dbhz(rows.cn0_dbhz[rows.is_judged])
    return rows


def strong_dbhz(judged_dbhz: pd.Series) -> float:
    """Return the C/N0 from which rows are strong: the median of the judged ones.

    Where that is 0, it is the C/N0 of the weakest received one.
    """
    median_dbhz = float(judged_dbhz.median())
    return median_dbhz if median_dbhz > 0 else float(judged_dbhz[judged_dbhz > 0].min())


def _judge(rows: pd.DataFrame, is_open: pd.Series, name: str, mask_deg: float) -> None:
    """Add ``is_seen``, ``is_judged`` and ``state`` to rows: those with an open ray are judged, in no building.

    Rows whose places lie in a building have no margin: it becomes NaN.

    Args:
      rows: all rows, with ``margin_m``, ``is_known`` and ``is_inside``.
      is_open: ``[R]`` whether the ray of each row is known, or counts all the same.
      name: of the log, for the message.
      mask_deg: the rows' least elevation, for the message.

    Raises:
      InputError: fewer than `FEWEST_ROWS` rows are judged, or none of them is received.
    """
    rows["is_seen"] = is_seen(rows.margin_m.to_numpy())
    rows.loc[rows.is_inside, "margin_m"] = np.nan
    rows["is_judged"] = is_open & ~rows.is_inside
    state = np.where(rows.is_seen, SEEN, HIDDEN)
    rows["state"] = np.where(rows.is_known & ~rows.is_inside, state, UNKNOWN)
    judged = rows[rows.is_judged]
    num_received = int((judged.cn0_dbhz > 0).sum())
    if len(judged) >= FEWEST_ROWS and num_received:
        return
    raise InputError(
        f"of the {len(rows):,} rows of the receiver log {name!r} above the mask of {mask_deg:g} degrees "
        f"{len(judged):,} can be judged, of which {num_received:,} are received, and {FEWEST_ROWS} "
        f"are needed: {int((~rows.is_known).sum()):,} rays leave what is known of the city and "
        f"{int(rows.is_inside.sum()):,} begin in a building; give buildings farther around, a longer log, or places by "
        "a reference"
    )


def example_skies(rows: pd.DataFrame, drive: Drive) -> tuple[PlaceSky, ...]:
    """Return the skies in the middle of the blocks of least and of most agreement.

    A block agrees by the share of its judged rows that are seen and strong, or neither. Blocks with few judged rows do
    not count, unless all have few.

    Args:
      rows: of the drive, judged.
      drive: gives the time and place of each epoch, and the horizon.
    """
    hiding = Hiding(drive.city, drive.known)
    antenna_m = drive.settings.antenna_height_m
    judged = rows[rows.is_judged]
    agrees = (judged.is_seen == judged.is_strong).groupby(judged.block).agg(["mean", "size"])
    agrees = agrees[agrees["size"] >= min(FEWEST_SEEN, agrees["size"].max())]
    blocks = {
        "least agreement": agrees["mean"].idxmin(),
        "most agreement": agrees["mean"].idxmax(),
    }
    skies = []
    for name, block in blocks.items():
        # The block's middle epoch that has a judged row, and where it was.
        epochs = np.sort(judged.epoch[judged.block == block].unique())
        epoch = int(epochs[len(epochs) // 2])
        satellites = rows[rows.epoch == epoch].reset_index(drop=True)
        fix = drive.log.epochs.iloc[epoch]
        lonlat = float(fix[LON]), float(fix[LAT])
        horizon_deg = hiding.horizon_deg(drive.grid, lonlat, antenna_m, drive.mask_deg)
        skies.append(PlaceSky(name, *lonlat, fix[UTC].isoformat(), horizon_deg, satellites))
    return tuple(skies)
