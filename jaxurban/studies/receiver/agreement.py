"""Whether a receiver hears well the satellites that the maps call seen: scores that convince a sceptic.

C/N0 comes from the receiver. Whether a satellite is seen or hidden, and by how many metres, comes from the maps.
**AUC** is the chance that of one seen and one hidden satellite the seen one has the higher C/N0, where ties count by
half. **Within satellites** both are the same satellite at two times, so that it adds nothing if high satellites have
strong signals. Neighbouring rows of a drive are alike, so intervals are of the bootstrap over blocks of the track. The
null are cities displaced by 80 to 450 m. They overlap each other, so they give no p-value; they show what a wrong city
scores.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely

from jaxurban.errors import InputError
from jaxurban.io.city import City
from jaxurban.io.read.rasterise import highest_top_m
from jaxurban.io.read.tracks import LAT, LON, UTC
from jaxurban.knowledge import Caution
from jaxurban.progress import Report
from jaxurban.public import FactsRepr
from jaxurban.satellites.outlines import Hiding
from jaxurban.satellites.rule import FARTHEST_MARGIN_M, is_seen
from jaxurban.satellites.track import Track
from jaxurban.satellites.walk import LEG_CELLS, Ground
from jaxurban.studies.bootstrap import FEWEST_GROUPS, columns_of
from jaxurban.studies.receiver.displaced import (
    AROUND_M,
    FARTHEST_M,
    FEWEST_ROWS,
    SCALES,
    STEP_M,
    Displaced,
)
from jaxurban.studies.receiver.logs import ReceiverLog
from jaxurban.studies.receiver.prediction import EVERYWHERE, ReceiverSettings
from jaxurban.studies.receiver.rivals import MAP, compared_rules, features_of, gain_by_length
from jaxurban.studies.receiver.scores import score_table
from jaxurban.world.grid import Grid
from jaxurban.world.known import Rays

MOST_MOVED = 20_000  # rows that are set against displaced cities and other roofs, of a longer log every n-th epoch
FEWEST_SEEN = 8  # judged rows of a block that may be drawn as a place
FEWEST_CITIES = 50  # displaced ones that could be scored, for a verdict
LOWEST_RAY_DEG = 0.1  # a ray along the horizon never rises
STREET_M, STILL_M = 20.0, 1.0  # each way, for the street's direction; a car that moves less stands


@dataclass(frozen=True, eq=False)
class PlaceSky:
    """The sky over one place of the track, of a `SatelliteAgreement`.

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


@dataclass(frozen=True, eq=False, repr=False)
class SatelliteAgreement(FactsRepr):
    """How the maps agree with a receiver, satellite by satellite.

    Attributes:
      rows: a row for each epoch and satellite: ``epoch`` (number in the log's epochs), ``satellite``, ``system`` (its
        first letter), ``azimuth_deg`` (from true north), ``elevation_deg``, ``cn0_dbhz`` (0: not received),
        ``margin_m`` (the height of the antenna less that of the edge of the roofs' shadow; at or below 0 a roof hides
        the satellite, and margins of 60 m or more are inf), ``is_seen``, ``is_known`` (the whole ray lies above known
        ground until it is above all roofs), ``is_inside`` (the place lies in a building), ``is_judged`` (the place is
        not inside, and the ray is known unless the settings judge all rays), ``is_strong`` (C/N0 is at least
        ``strong_dbhz``), ``block`` (number of the block along the track).
      scores: a row for each choice of rows, which ``which`` names: ``"all"`` rows that are judged; of these the
        ``"received"`` ones, and those of each system by its letter; ``"unguarded"``, in which rows of unknown rays
        count too. ``rows`` and their ``share`` of all rows; ``auc`` and ``within`` satellites with the ends of their
        95 % intervals (``_low``, ``_high``); ``num_satellites``, how many satellites are seen at one time and hidden
        at another.
      displaced: a row for each displaced city of the null: ``east_m``, ``north_m``, ``rows``, ``auc``, ``within``.
      field: AUC of cities displaced by up to 40 m, in steps of 2 m: ``east_m``, ``north_m``, ``rows``, ``auc``.
      scales: AUC of cities whose roofs are ``scale`` times as high.
      peak: the displacement at which the field is highest (``east_m``, ``north_m``); ``within_95_m``, how far from no
        displacement 95 % of the bootstrap's peaks lie at most; the ``scale`` of roofs with the highest AUC, and its
        interval (``scale_low``, ``scale_high``). All are NaN where no value is the highest, or with fewer than 8
        blocks.
      rivals: log-loss of rules that predict ``is_strong``, one block left out (`jaxurban.studies.receiver.rivals`).
      block_lengths: the gain of margin and elevation in ``rivals``, with its interval, where blocks are once, twice
        and four times as long: ``block_m``, ``num_blocks``, ``gain``, ``gain_low``, ``gain_high``.
      skies: the sky over a place in the block of least agreement, and over one in the block of most agreement.
      strong_dbhz: the median C/N0 of the judged rows; where that is 0, the C/N0 of the weakest received one.
      verdict: what this shows, in one sentence that claims no more than its interval.
      counts: how many rows, judged rows, rows of unknown rays, rows in buildings, satellites, blocks and displaced
        cities there are, and which satellites were left out, with reasons. ``every`` is n where only every n-th epoch
        of a long log is compared with displaced cities, other roofs and rivals.

    Examples:
      >>> import pandas as pd
      >>> log = pd.DataFrame({"utc": pd.date_range("2020-04-27T16:00:00Z", periods=80, freq="s")})
      >>> log = log.assign(lon=np.linspace(-73.973, -73.969, 80), lat=40.7795)
      >>> sky = pd.DataFrame({"satellite": ["G05", "G21"], "azimuth_deg": [20.0, 260.0]})
      >>> log = log.merge(sky.assign(elevation_deg=60.0, cn0_dbhz=[44.0, 25.0]), how="cross")
      >>> few = ju.studies.ReceiverSettings(num_displaced=1)
      >>> of = ju.studies.validate(scenario, log, few, progress=False).satellites
      >>> of.counts["judged"], of.counts["unknown"], of.counts["inside"]
      (122, 15, 23)
      >>> of.rows[["satellite", "margin_m", "is_seen", "is_judged"]].head(1).round(1).to_dict("records")
      [{'satellite': 'G05', 'margin_m': inf, 'is_seen': True, 'is_judged': True}]
      >>> of.verdict.partition(":")[0]
      'The track is too short for a verdict'
    """

    rows: pd.DataFrame
    scores: pd.DataFrame
    displaced: pd.DataFrame
    field: pd.DataFrame
    scales: pd.DataFrame
    peak: dict[str, float]
    rivals: pd.DataFrame
    block_lengths: pd.DataFrame
    skies: tuple[PlaceSky, ...]
    strong_dbhz: float
    verdict: str
    counts: dict[str, Any]

    @property
    def facts(self) -> dict[str, str]:
        """The verdict, and how seen and hidden satellites are separated."""
        judged = f"{self.counts['judged']:,} of {self.counts['rows']:,} rows judged"
        auc = self._interval("auc")
        within = self._interval("within")
        return {"verdict": self.verdict, "AUC": f"{auc}, within satellites {within}, {judged}"}

    def _interval(self, name: str) -> str:
        value, low, high = self.score()[columns_of(name)]
        if np.isnan(value):
            return "not defined"
        text = f"{value:.2f}"
        return text if np.isnan(low) else f"{text} ({low:.2f} to {high:.2f})"

    @property
    def known_cautions(self) -> list[Caution]:
        """Which rows were not judged, and which satellites were left out."""
        # Rows whose rays or places are not judged.
        counts = self.counts
        sentences = []
        if counts["unknown"]:
            judged = "judged as if nothing stood beyond"
            if counts["is_guarded"]:
                judged = "not judged"
            sentences.append(
                f"{counts['unknown']:,} rows are {judged}: their rays leave what is known of the city."
            )
        if counts["inside"]:
            sentences.append(
                f"{counts['inside']:,} rows are not judged: their places lie in buildings."
            )

        # A best fit that may lie beyond the search, and satellites of which the log says too little.
        away_m = np.hypot(self.peak["east_m"], self.peak["north_m"])
        if away_m > AROUND_M - STEP_M or self.peak["scale"] in (SCALES[0], SCALES[-1]):
            sentences.append(
                "The city fits best at the edge of the search (40 m, heights times 0.8 or 1.2): see whether places, "
                "heights and the CRS are right."
            )
        sentences += [
            f"{name} is left out: {reason}." for name, reason in counts["left_out"].items()
        ]
        return [Caution(sentence) for sentence in sentences]

    def score(self, which: str = "all") -> pd.Series:
        """Return the scores of a choice of rows.

        Returns:
          A row of ``scores``.

        Examples:
          >>> import pandas as pd
          >>> log = pd.DataFrame({"utc": pd.date_range("2020-04-27T16:00:00Z", periods=80, freq="s")})
          >>> log = log.assign(lon=np.linspace(-73.973, -73.969, 80), lat=40.7795)
          >>> sky = pd.DataFrame({"satellite": ["G05", "G21"], "azimuth_deg": [20.0, 260.0]})
          >>> log = log.merge(sky.assign(elevation_deg=60.0, cn0_dbhz=[44.0, 25.0]), how="cross")
          >>> few = ju.studies.ReceiverSettings(num_displaced=1)
          >>> of = ju.studies.validate(scenario, log, few, progress=False).satellites
          >>> of.score("G")[["which", "rows"]].to_dict()
          {'which': 'G', 'rows': 122}
        """
        return self.scores[self.scores.which == which].iloc[0]


def headings_rad(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the street's direction at each epoch, radians clockwise from grid north.

    It is the direction from the place 20 m behind along the track to the place 20 m ahead; the ends of the track stand
    for places beyond them. While the receiver stands the direction does not change.

    Args:
      x_m, y_m: ``[N]`` easting and northing of each epoch.
    """
    # Anchors are epochs whose places are at least `STILL_M` apart. An epoch has the distance along the track of its
    # last anchor, which does not change while the receiver stands.
    places = np.column_stack([x_m, y_m])
    anchors = [0]
    anchor_of_epoch = np.zeros(len(places), int)
    for number, place in enumerate(places):
        if np.hypot(*(place - places[anchors[-1]])) >= STILL_M:
            anchors.append(number)
        anchor_of_epoch[number] = len(anchors) - 1
    along_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(places[anchors], axis=0).T)))
    epoch_m = along_m[anchor_of_epoch]

    def moved_m(values: np.ndarray) -> np.ndarray:
        """Return ``[N]`` by how much a coordinate ``[N]`` changes from behind each epoch to ahead of it."""
        ahead = np.interp(epoch_m + STREET_M, along_m, values[anchors])
        return ahead - np.interp(epoch_m - STREET_M, along_m, values[anchors])

    return np.arctan2(moved_m(x_m), moved_m(y_m))


def agreement_of(
    log: ReceiverLog,
    track: Track,
    city: City,
    known: shapely.Geometry,
    grid: Grid,
    mask_deg: float,
    settings: ReceiverSettings,
    report: Report,
) -> SatelliteAgreement:
    """Return how a city agrees with the satellites of a log.

    Args:
      log: a row per epoch and satellite, with azimuth and elevation in degrees.
      track: places of the log's epochs.
      city: its buildings and terrain, in the CRS of the grid.
      known: where its buildings are known, in the same CRS.
      grid: gives size and alignment of the cells, which may lie beyond it.
      mask_deg: rows with a lower elevation are left out.
      settings: systems, blocks, antenna height, what counts as known, and the number of displaced cities.
      report: of the progress.

    Raises:
      InputError: fewer than `FEWEST_ROWS` rows that can be judged.
    """
    # The rows of the log, a ray for each, and whether the ray stays above known ground until it is above all roofs.
    rows, rays = _rows_of(log, track, grid, mask_deg, settings)
    rise_m = highest_top_m(city) - settings.antenna_height_m
    rows["is_known"] = rays.stays_within(known, rise_m)

    # [R] bool: of a long log rivals and displaced cities take only the rows of every n-th epoch. Of these displaced
    # cities take only rows with known rays, unless rays count wherever they lead.
    is_guarded = settings.known != EVERYWHERE
    every = max(1, len(rows) // MOST_MOVED)
    is_taken = (rows.epoch % every == 0).to_numpy()
    is_moved = is_taken & (rows.is_known.to_numpy() | (not is_guarded))
    displaced = Displaced(settings.num_displaced, settings.seed, int(is_moved.sum()))

    # How far away from a place a roof, at the largest scale, can still come within the margin of the lowest ray.
    reach_m = (max(rise_m * SCALES[-1], 0.0) + FARTHEST_MARGIN_M) / np.tan(rays.elevation_rad.min())

    # What each ray meets in the city, in displaced ones and under other roofs, where each moved row has a column. It is
    # found leg by leg, since the ground around the whole track may not fit into memory.
    rows["margin_m"] = np.nan
    rows["is_inside"] = False
    guard = known if is_guarded else None
    columns = np.cumsum(is_moved) - 1
    for leg in track.legs(grid, LEG_CELLS):
        of_leg = np.flatnonzero(rows.epoch.isin(leg))
        leg_rays = rays.take(of_leg)
        box = track.box(grid, leg)
        ground = Ground.around(city, box, FARTHEST_M, reach_m, settings.antenna_height_m)
        rows.loc[of_leg, "is_known"] &= ~ground.crosses_gap(leg_rays, rise_m)
        rows.loc[of_leg, "is_inside"] = ground.is_inside(leg_rays)
        rows.loc[of_leg, "margin_m"] = ground.margins_m(leg_rays)
        moved = of_leg[is_moved[of_leg]]
        displaced.fill(columns[moved], ground, rays.take(moved), guard, rise_m, report)

    # Which rows are judged, and which of them the receiver hears well.
    is_open = rows.is_known | (not is_guarded)
    _judge(rows, is_open, log.name, mask_deg)
    strong_dbhz, is_median = _strong_dbhz(rows.cn0_dbhz[rows.is_judged])
    rows["is_strong"] = rows.cn0_dbhz >= strong_dbhz

    # The scores of the city, of displaced ones, and of rivals.
    report("scores")
    scores = score_table(rows, settings.seed)
    of_displaced = displaced.tables(rows[is_moved], settings.seed)
    null = of_displaced["displaced"]
    chosen = rows[is_taken & rows.is_judged]
    rivals, block_lengths = _rivals(chosen, rays, track, settings)
    num_blocks = int(chosen.block.nunique())

    return SatelliteAgreement(
        rows=rows,
        scores=scores,
        **of_displaced,
        rivals=rivals,
        block_lengths=block_lengths,
        skies=_skies(rows, log, Hiding(city, known), grid, settings.antenna_height_m, mask_deg),
        strong_dbhz=strong_dbhz,
        verdict=verdict_of(scores, null, rivals, num_blocks),
        counts={
            "rows": len(rows),
            "judged": int(rows.is_judged.sum()),
            "is_guarded": is_guarded,
            "unknown": int((~rows.is_known).sum()),
            "inside": int((is_open & rows.is_inside).sum()),
            "num_satellites": int(rows.satellite.nunique()),
            "num_blocks": num_blocks,
            "num_displaced": int(null.auc.notna().sum()),
            "num_asked": settings.num_displaced,
            "every": every,
            "is_median": is_median,
            "left_out": dict(log.left_out),
        },
    )


def _rivals(
    rows: pd.DataFrame, rays: Rays, track: Track, settings: ReceiverSettings
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return how well rules predict that know less or more than the margin, such as the street's direction.

    These are ``rivals`` and ``block_lengths`` of a `SatelliteAgreement`.

    Args:
      rows: judged rows of the agreement.
      rays: of all rows, also of others.
      track: gives the street's direction at each epoch.
      settings: length of the blocks, and seed.
    """
    rays = rays.take(rows.index.to_numpy())
    off_street_rad = rays.azimuth_rad - headings_rad(track.x_m, track.y_m)[rows.epoch]
    rules = features_of(rows.margin_m.to_numpy(), rays.elevation_rad, off_street_rad)
    of_rows = rules, rows.is_strong.to_numpy(), rows.block.to_numpy()
    return (
        compared_rules(*of_rows, settings.seed),
        gain_by_length(*of_rows, settings.sky_block_m, settings.seed),
    )


def _strong_dbhz(judged_dbhz: pd.Series) -> tuple[float, bool]:
    """Return the C/N0 from which rows are strong, and whether it is the median of the judged ones.

    Where that is 0, it is the C/N0 of the weakest received one.
    """
    median_dbhz = float(judged_dbhz.median())
    if median_dbhz > 0:
        return median_dbhz, True
    return float(judged_dbhz[judged_dbhz > 0].min()), False


def _judge(rows: pd.DataFrame, is_open: pd.Series, name: str, mask_deg: float) -> None:
    """Add ``is_seen`` and ``is_judged`` to rows: those with an open ray are judged whose place is in no building.

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


def _rows_of(
    log: ReceiverLog, track: Track, grid: Grid, mask_deg: float, settings: ReceiverSettings
) -> tuple[pd.DataFrame, Rays]:
    """Return the rows of a log above the mask, of the systems that are asked for, and the ray of each row.

    The rows have the columns ``system`` and ``block`` besides those of the log, and are numbered from 0.

    Args:
      log: with azimuths from true north and elevations.
      track: the place of each epoch, and its distance along the track.
      grid: rays have azimuths from its north.
      mask_deg: least elevation.
      settings: systems, and length of the blocks.

    Raises:
      InputError: no such row.
    """
    assert log.satellites is not None
    system = log.satellites.satellite.astype(str).str[0]
    is_kept = log.satellites.elevation_deg >= max(mask_deg, LOWEST_RAY_DEG)
    if settings.systems:
        is_kept &= system.isin(list(settings.systems))
    rows = log.satellites[is_kept].assign(system=system[is_kept]).reset_index(drop=True)
    if rows.empty:
        systems = f" of the systems {', '.join(settings.systems)}" if settings.systems else ""
        raise InputError(
            f"the receiver log {log.name!r} has no satellite above the mask of {mask_deg:g} degrees{systems}: lower "
            "[gps] mask_deg, or see whether elevation_deg is in degrees"
        )

    # One turn from true to grid north serves all of the track.
    rows["block"] = (track.along_m[rows.epoch] // settings.sky_block_m).astype(int)
    centre = float(log.epochs[LON].median()), float(log.epochs[LAT].median())
    azimuth_rad = np.radians(rows.azimuth_deg.to_numpy(float)) - grid.convergence_rad(*centre)
    elevation_rad = np.radians(rows.elevation_deg.to_numpy(float))
    return rows, Rays(track.x_m[rows.epoch], track.y_m[rows.epoch], azimuth_rad, elevation_rad)


def _skies(
    rows: pd.DataFrame,
    log: ReceiverLog,
    hiding: Hiding,
    grid: Grid,
    antenna_m: float,
    mask_deg: float,
) -> tuple[PlaceSky, ...]:
    """Return the skies in the middle of the blocks of least and of most agreement.

    A block agrees by the share of its judged rows that are seen and strong, or neither. Blocks with few judged rows do
    not count, unless all have few.

    Args:
      rows: of the agreement.
      log: gives the time and place of each epoch.
      hiding, grid, antenna_m, mask_deg: give the horizon.
    """
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
        fix = log.epochs.iloc[epoch]
        lonlat = float(fix[LON]), float(fix[LAT])
        horizon_deg = hiding.horizon_deg(grid, lonlat, antenna_m, mask_deg)
        skies.append(PlaceSky(name, *lonlat, fix[UTC].isoformat(), horizon_deg, satellites))
    return tuple(skies)


def verdict_of(
    scores: pd.DataFrame, displaced: pd.DataFrame, rivals: pd.DataFrame, num_blocks: int
) -> str:
    """Return what scores and rivals show, in one sentence.

    Praise takes two things: margin and elevation predict better than elevation and the street, and C/N0 separates seen
    from hidden better than in every displaced city, both by their intervals. The first alone does not show that place
    and time are right: satellites that stand still are predicted at any hour.

    Args:
      scores, displaced, rivals: tables of a `SatelliteAgreement`.
      num_blocks: of the track, with judged rows.
    """
    score = scores.set_index("which").loc["all"]
    gain = rivals.set_index("model").loc[MAP]
    most = float(displaced.auc.max())
    where = f"on these {num_blocks} blocks of track"
    if num_blocks < FEWEST_GROUPS:
        return f"The track is too short for a verdict: {where} there is no interval (it takes {FEWEST_GROUPS} blocks)."
    if not np.isfinite([gain.gain_low, score.auc_low]).all():
        return f"There is no verdict: {where} too few rows are hidden, or too few in view, for an interval."

    # First whether the maps predict better, then whether the city's place is the best one.
    gained = f"the gain in log-loss is {gain.gain:.3f} (95 % interval {gain.gain_low:.3f} to {gain.gain_high:.3f})"
    auc = f"an AUC of {score.auc:.2f} ({score.auc_low:.2f} to {score.auc_high:.2f})"
    if not gain.gain_low > 0:
        return (
            f"It is not shown that the maps predict what this receiver hears {where} better than the "
            f"elevation and the street's direction do: {gained}."
        )
    num_cities = int(displaced.auc.notna().sum())
    if num_cities < FEWEST_CITIES:
        return (
            f"There is no verdict: {where} {num_cities} of {len(displaced)} displaced cities could be scored, and it "
            f"takes {FEWEST_CITIES} ({gained})."
        )
    if not score.auc_low > most:
        return (
            f"It is not shown that the city fits this receiver better than displaced ones do {where}: C/N0 separates "
            f"seen from hidden satellites with {auc}, and displaced cities reach {most:.2f}, though the margin to the "
            f"shadow's edge and the elevation predict better than the elevation and the street's direction ({gained}); "
            "check whether times and places are right."
        )
    return (
        f"The margin to the shadow's edge and the elevation predict what this receiver hears {where} better than the "
        f"elevation and the street's direction do: {gained}; C/N0 separates seen from hidden satellites "
        f"with {auc}, and displaced cities reach at most {most:.2f}."
    )
