"""Maps of Tokyo beside receivers that were driven through it on three tracks; writes docs/evidence/receiver.md.

Run as ``python -m benchmarks.receiver``. Maps of each track are those that the defaults give for such a log. Those of
the first are made once more for every change of the model in `CHANGES`; each change is reported with the paired
interval of its difference, good or bad.
"""

import argparse
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import jaxurban as ju
from benchmarks.common import ROOT
from jaxurban.errors import StaleElementsWarning
from jaxurban.io.read.receiver import ERROR, TRACKED
from jaxurban.maps.scenario import changed
from jaxurban.report.receiver import name_of, with_interval
from jaxurban.report.write import table
from jaxurban.studies.bootstrap import Interval
from jaxurban.studies.receiver.prediction import NUM_VISIBLE
from jaxurban.studies.receiver.validate import (
    COEFFICIENTS,
    SPEARMAN,
    WITHIN,
    ReceiverValidation,
    compared,
    paired,
    spearman,
)

PAGE, TEMPLATE = ROOT / "docs" / "evidence" / "receiver.md", Path(__file__).with_name("receiver_page.md")
DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data")).resolve() / "tokyo"
LOG, BUILDINGS = DATA / "urbannav_shinjuku_1hz.csv", DATA / "tokyo-central-lod2.parquet"
GPS, GALILEO = DATA / "gps_2018-12-19.tle", DATA / "galileo_2018-12-19.tle"
SETTINGS = {
    "region": {"bounds": [139.684, 35.680, 139.697, 35.698], "resolution_m": 2.0},
    "buildings": {"source": str(BUILDINGS)},
    "gps": {"orbits": [str(GPS), str(GALILEO)], "mask_deg": 10.0},
}
EAST = {
    "region": {"bounds": [139.757, 35.650, 139.800, 35.690], "resolution_m": 2.0},
    "buildings": {"source": str(DATA / "tokyo-east-lod2.parquet")},
    "gps": {"orbits": [str(DATA.parent / "gps" / "gps-ops_2024-03-31_omm.csv")], "mask_deg": 10.0, "max_age_days": 150},
}
SHINJUKU = "Shinjuku"
TRACKS: dict[str, tuple[dict[str, Any], Path]] = {  # the scenario and the log of each
    SHINJUKU: (SETTINGS, LOG),
    "Tokyo east, run 1": (EAST, DATA / "ppc_tokyo_run1_1hz.csv"),
    "Tokyo east, run 2": (EAST, DATA / "ppc_tokyo_run2_1hz.csv"),
}


@dataclass(frozen=True)
class Change:
    """A change of the model that is a row of the page's table.

    Attributes:
      name: of the row.
      settings: of the scenario that change, as ``jaxurban validate --set`` takes them.
      buildings: makes another file of buildings in a folder; None: the scenario's.
      prediction: which quantity of the maps is set against the receiver.
    """

    name: str
    settings: Sequence[str] = ()
    buildings: Callable[[Path], Path] | None = None
    prediction: str = NUM_VISIBLE


def boxes(folder: Path, which: str) -> Path:
    """Write the buildings with one height each, the ``"highest"`` of its roof planes or their ``"mean"`` by area.

    Roof planes that touch are one building.
    """
    frame = _planes()
    planes, height_m = frame.geometry.to_numpy(), frame["height"].to_numpy(float)
    one, other = shapely.STRtree(planes).query(planes, predicate="intersects")
    touching = coo_matrix((np.ones(len(one), bool), (one, other)), shape=(len(planes),) * 2)
    num, building = connected_components(touching, directed=False)
    if which == "highest":
        of_building = np.zeros(num)
        np.maximum.at(of_building, building, height_m)
    else:
        area = shapely.area(planes)
        of_building = np.bincount(building, area * height_m) / np.bincount(building, area)
    file = folder / f"{which}.parquet"
    frame.assign(height=of_building[building]).to_parquet(file)
    return file


@cache
def _planes() -> gpd.GeoDataFrame:
    return gpd.read_parquet(BUILDINGS)


FIRST = "GPS and Galileo, 2 m cells, roof planes"
CHANGES = (  # a further change of the model is a further line
    Change("GPS alone", (f'gps.orbits="{GPS}"',)),
    Change("Galileo alone", (f'gps.orbits="{GALILEO}"',)),
    Change("1 m cells", ("region.resolution_m=1.0",)),
    Change("5 m cells", ("region.resolution_m=5.0",)),
    Change("5 m cells, supersampled 5 times", ("region.resolution_m=5.0", "region.oversample=5")),
    Change("roofs as boxes, as high as their highest plane", buildings=lambda folder: boxes(folder, "highest")),
    Change("roofs as boxes of their mean height", buildings=lambda folder: boxes(folder, "mean")),
)


def validated(track: str = SHINJUKU, change: Change | None = None) -> ReceiverValidation:
    """Return the validation on the log of a track, of the model as it is or with a change."""
    settings, log = TRACKS[track]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", StaleElementsWarning)  # the page states how old the elements are
        changes = list(change.settings) if change else []
        if change and change.buildings:
            changes.append(f'buildings.source="{change.buildings(Path(folder))}"')
        return ju.studies.validate(ju.Scenario.from_dict(changed(settings, changes)), log, progress=False)


def page(tracks: Mapping[str, ReceiverValidation], others: Sequence[tuple[Change, ReceiverValidation]]) -> str:
    """Return the page in Markdown.

    Args:
      tracks: the validation of each track.
      others: changes of the model, with the validation of the first track under each.
    """
    first = next(iter(tracks.values()))
    return TEMPLATE.read_text(encoding="utf-8").format(
        tracks=tracks_table(tracks),
        tracked=f"{first.summary[f'mean_{TRACKED}']:.1f}",
        seen=f"{first.summary['mean_num_visible']:.1f}",
        error="; ".join(_of_error(first, name) for name in ("hdop", NUM_VISIBLE)),
        changes=changes_table(first, others),
        block=f"{first.settings.block_m:g}",
        piece=f"{first.settings.piece_m:g}",
    )


def tracks_table(tracks: Mapping[str, ReceiverValidation]) -> str:
    """Return what the satellites in view score on each track: within blocks, then over the whole track."""
    rows = []
    for name, validation in tracks.items():
        row = _row(validation, TRACKED, NUM_VISIBLE)
        starts = within_by_start(validation)
        length = f"{validation.summary['length_m'] / 1000:.1f} km"
        of_within = with_interval(row, WITHIN), f"{min(starts):.2f} to {max(starts):.2f}"
        shifts = [f"{row[f'{each}_p']:.3f}" for each in COEFFICIENTS]
        rows.append((name, length, row["num"], *of_within, shifts[0], with_interval(row, SPEARMAN), shifts[1]))
    head = ("track", "length", "pieces", "within blocks", "blocks begun elsewhere", "p", "whole track", "p")
    return table(head, rows)


def within_by_start(validation: ReceiverValidation) -> list[float]:
    """Return the correlation within blocks, the blocks begun at each piece of the first block in turn."""
    settings = validation.settings
    receiver, maps, _ = compared(validation.pieces, TRACKED, NUM_VISIBLE)
    along_m = validation.pieces.piece.to_numpy() * settings.piece_m
    starts_m = np.arange(0.0, settings.block_m, settings.piece_m)
    return [spearman(receiver, maps, (along_m + start_m) // settings.block_m) for start_m in starts_m]


def _row(validation: ReceiverValidation, witness: str, prediction: str) -> dict[Any, Any]:
    scores = validation.scores
    is_row = (scores.witness == witness) & (scores.prediction == prediction)
    (row,) = scores[is_row & (scores.piece_m == validation.settings.piece_m)].to_dict("records")
    return row


def _of_error(validation: ReceiverValidation, prediction: str) -> str:
    """Return what a quantity of the maps scores against the error, and what shifts do."""
    row = _row(validation, ERROR, prediction)
    return f"{with_interval(row, WITHIN)} for {name_of(prediction)}"


def changes_table(first: ReceiverValidation, others: Sequence[tuple[Change, ReceiverValidation]]) -> str:
    """Return the first model and every change of it, with the paired differences."""
    rows = [(FIRST, *_cells(first, NUM_VISIBLE), "")]
    for change, validation in others:
        difference = paired(first, validation, predictions=(None, change.prediction))
        rows.append((change.name, *_cells(validation, change.prediction), _difference(difference)))
    return table(("maps", "in view", "within blocks", "difference within"), rows)


def _cells(validation: ReceiverValidation, prediction: str) -> tuple[str, ...]:
    row = _row(validation, TRACKED, prediction)
    seen = f"{validation.summary['mean_num_visible']:.1f}"
    return seen, with_interval(row, WITHIN)


def _difference(scored: Interval) -> str:
    return f"{scored.value:+.3f} ({scored.low:+.3f} to {scored.high:+.3f})"


def main() -> None:
    """Make all maps, print the table and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    chosen = parser.parse_args()
    began = time.perf_counter()
    tracks = {}
    for name in TRACKS:
        tracks[name] = validated(name)
        print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)
    others = []
    for change in CHANGES:
        others.append((change, validated(change=change)))
        print(f"{change.name}: {time.perf_counter() - began:.0f} s", flush=True)
    print(tracks_table(tracks))
    chosen.output.write_text(page(tracks, others), encoding="utf-8")


if __name__ == "__main__":
    main()
