"""Maps of Shinjuku beside a survey receiver that was driven through it; writes docs/validation_receiver.md.

Run as ``python -m benchmarks.receiver``. Maps are made once as they are by default for such a log, and once for every
change of the model in `CHANGES`; each change is told by its paired interval against the first, good or bad.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import geopandas as gpd
import numpy as np
import shapely
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import jaxurban as ju
from benchmarks.common import ROOT
from jaxurban.io.read.receiver import ERROR, TRACKED
from jaxurban.report.figures.receiver import name_of
from jaxurban.report.markdown import table
from jaxurban.report.receiver import score_table, with_interval
from jaxurban.scenario.changes import changed
from jaxurban.studies.receiver.agreement import Scored
from jaxurban.studies.receiver.prediction import NUM_VISIBLE
from jaxurban.studies.receiver.scores import AUC, SPEARMAN
from jaxurban.studies.receiver.validate import ReceiverValidation, paired

PAGE, TEMPLATE = ROOT / "docs" / "validation_receiver.md", Path(__file__).with_name("receiver_page.md")
DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data")).resolve() / "tokyo"
LOG, BUILDINGS = DATA / "urbannav_shinjuku_1hz.csv", DATA / "tokyo-central-lod2.parquet"
GPS, GALILEO = DATA / "gps_2018-12-19.tle", DATA / "galileo_2018-12-19.tle"
SETTINGS = {
    "region": {"bounds": [139.684, 35.680, 139.697, 35.698], "resolution_m": 2.0},
    "buildings": {"source": str(BUILDINGS)},
    "gps": {"orbits": [str(GPS), str(GALILEO)], "mask_deg": 10.0},
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


def validated(change: Change | None = None) -> ReceiverValidation:
    """Return the validation on the Shinjuku log, of the model as it is or with a change."""
    if change is None:
        return ju.validate(ju.Scenario.from_dict(SETTINGS), LOG, progress=False)
    with tempfile.TemporaryDirectory() as folder:
        settings = list(change.settings)
        if change.buildings is not None:
            settings.append(f'buildings.source="{change.buildings(Path(folder))}"')
        scenario = ju.Scenario.from_dict(changed(SETTINGS, settings, ju.Scenario))
        return ju.validate(scenario, LOG, progress=False)


def page(first: ReceiverValidation, others: Sequence[tuple[Change, ReceiverValidation]]) -> str:
    """Return the page in Markdown."""
    of = first.scores[(first.scores.witness == TRACKED)]
    own = of.prediction == NUM_VISIBLE
    (row,) = of[own & (of.piece_m == first.settings.piece_m)].to_dict("records")
    shifts = first.shifts[(first.shifts.witness == TRACKED) & (first.shifts.piece_m == first.settings.piece_m)]
    minutes = (first.log.epochs.utc.iloc[-1] - first.log.epochs.utc.iloc[0]).total_seconds() / 60
    track = f"{first.summary['epochs']:,} seconds on {first.summary['length_m'] / 1000:.1f} km of streets"
    return TEMPLATE.read_text(encoding="utf-8").format(
        track=track,
        main=f"Spearman {with_interval(row, SPEARMAN)} and AUC {with_interval(row, AUC)} over pieces of "
        f"{row['piece_m']:g} m, with the city shifted at most {row['spearman_shifted']:.2f} and "
        f"{row['auc_shifted']:.2f}",
        tracked=f"{first.summary[f'mean_{TRACKED}']:.1f}",
        seen=f"{first.summary['mean_num_visible']:.1f}",
        scores=score_table(of[own]),
        others=score_table(of[~own]),
        error="; ".join(f"Spearman {_of_error(first, name)}" for name in ("hdop", NUM_VISIBLE)),
        shifts=table(
            ("shift", "Spearman", "AUC"),
            [
                (f"{shift.shift_m:+g} m" if shift.shift_m else "none", f"{shift.spearman:.2f}", f"{shift.auc:.2f}")
                for shift in shifts.sort_values("shift_m").itertuples()
            ],
        ),
        changes=changes_table(first, others),
        block=f"{first.settings.block_m:g}",
        at_most=first.settings.at_most_tracked,
        minutes=minutes,
    )


def _of_error(found: ReceiverValidation, prediction: str) -> str:
    """Return what a quantity of the maps scores against the error, and the shifted city."""
    of = found.scores
    is_row = (of.witness == ERROR) & (of.prediction == prediction) & (of.piece_m == found.settings.piece_m)
    (row,) = of[is_row].to_dict("records")
    return f"{with_interval(row, SPEARMAN)} for {name_of(prediction)}, shifted {row['spearman_shifted']:.2f}"


def changes_table(first: ReceiverValidation, others: Sequence[tuple[Change, ReceiverValidation]]) -> str:
    """Return the first model and every change of it, with the paired differences."""
    rows = [(FIRST, *_told(first, NUM_VISIBLE), "", "")]
    for change, found in others:
        differences = (
            paired(first, found, coefficient=each, predictions=(None, change.prediction)) for each in (SPEARMAN, AUC)
        )
        rows.append((change.name, *_told(found, change.prediction), *map(_difference, differences)))
    head = ("maps", "in view", "Spearman", "shifted", "AUC", "Spearman, difference", "AUC, difference")
    return table(head, rows)


def _told(found: ReceiverValidation, prediction: str) -> tuple[str, ...]:
    of = found.scores
    is_row = (of.witness == TRACKED) & (of.prediction == prediction) & (of.piece_m == found.settings.piece_m)
    (row,) = of[is_row].to_dict("records")
    seen = f"{found.summary['mean_num_visible']:.1f}"
    return seen, with_interval(row, SPEARMAN), f"{row['spearman_shifted']:.2f}", with_interval(row, AUC)


def _difference(scored: Scored) -> str:
    return f"{scored.value:+.3f} ({scored.low:+.3f} to {scored.high:+.3f})"


def main() -> None:
    """Make all maps, print the table and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    chosen = parser.parse_args()
    began = time.perf_counter()
    first = validated()
    print(f"{FIRST}: {time.perf_counter() - began:.0f} s", flush=True)
    others = []
    for change in CHANGES:
        others.append((change, validated(change)))
        print(f"{change.name}: {time.perf_counter() - began:.0f} s", flush=True)
    print(changes_table(first, others))
    chosen.output.write_text(page(first, others), encoding="utf-8")


if __name__ == "__main__":
    main()
