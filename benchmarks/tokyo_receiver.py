"""Maps of Tokyo beside receivers that were driven through it; writes docs/evidence/receiver.md.

Run as ``python -m benchmarks.tokyo_receiver``. First a log with a row a satellite, on the roofs that the package holds
and on all roofs of the district; then three logs of counts.
"""

import argparse
import math
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jaxurban as ju
from benchmarks.common import ROOT
from benchmarks.receiver.counts import (
    ERROR,
    SPEARMAN,
    TRACKED,
    WITHIN,
    CountValidation,
    counted,
    name_of,
    with_interval,
)
from benchmarks.receiver.evidence import Evidence, evidence_of
from jaxurban.draw.write import interval, table
from jaxurban.errors import StaleElementsWarning
from jaxurban.maps.scenario import changed
from jaxurban.receivers.report import ROWS
from jaxurban.receivers.track import NUM_VISIBLE

PAGE, TEMPLATE = (
    ROOT / "docs" / "evidence" / "receiver.md",
    Path(__file__).with_name("tokyo_receiver_page.md"),
)
DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data")).resolve() / "tokyo"
SAMPLE, LOG = "sample:nihonbashi", "sample:nihonbashi/log.csv.gz"
EAST_ROOFS = str(DATA / "tokyo-east-lod2.parquet")
SHINJUKU = {
    "region": {"bounds": [139.684, 35.680, 139.697, 35.698], "resolution_m": 2.0},
    "buildings": {"source": str(DATA / "tokyo-central-lod2.parquet")},
    "gps": {
        "orbits": [str(DATA / f"{name}_2018-12-19.tle") for name in ("gps", "galileo")],
        "mask_deg": 10.0,
    },
}
EAST = {
    "region": {"bounds": [139.757, 35.650, 139.800, 35.690], "resolution_m": 2.0},
    "buildings": {"source": EAST_ROOFS},
    "gps": {
        "orbits": [str(DATA.parent / "gps" / "gps-ops_2024-03-31_omm.csv")],
        "mask_deg": 10.0,
        "max_age_days": 150,
    },
}
TRACKS: dict[str, tuple[dict[str, Any], Path]] = {  # the scenario and the log of each
    "Shinjuku": (SHINJUKU, DATA / "urbannav_shinjuku_1hz.csv"),
    "Tokyo east, run 1": (EAST, DATA / "ppc_tokyo_run1_1hz.csv"),
    "Tokyo east, run 2": (EAST, DATA / "ppc_tokyo_run2_1hz.csv"),
}
SKIES = {"near roofs": SAMPLE, "all roofs": EAST_ROOFS}


def counted_on(track: str) -> CountValidation:
    """Return the validation on the log of a track of counts."""
    settings, log = TRACKS[track]
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", StaleElementsWarning
        )  # the page states how old the elements are
        return counted(ju.Scenario.from_dict(settings), log)


def evidence_on(sky: str) -> Evidence:
    """Return how maps agree with the log of the package, on one choice of roofs."""
    settings = ju.Scenario.from_toml(SAMPLE).model_dump(mode="json")
    scenario = ju.Scenario.from_dict(changed(settings, [f'buildings.source="{SKIES[sky]}"']))
    return evidence_of(scenario, LOG)


def page(skies: Mapping[str, Evidence], tracks: Mapping[str, CountValidation]) -> str:
    """Return the page in Markdown: of satellites on each choice of roofs, and of counts on each track."""
    first = next(iter(tracks.values()))
    return TEMPLATE.read_text(encoding="utf-8").format(
        evidence=next(iter(skies.values())),
        num_displaced=next(iter(skies.values())).displaced.auc.notna().sum(),
        scores=beside(skies, ("rows", "AUC", "within satellites"), scores_of),
        peaks="; ".join(f"with {name}, {peak_of(of)}" for name, of in skies.items()),
        rivals=beside(skies, ("log-loss", "gain"), rivals_of),
        lengths=beside(skies, ("gain",), gains_of),
        tracks=tracks_table(tracks),
        tracked=f"{first.summary[f'mean_{TRACKED}']:.1f}",
        seen=f"{first.summary['mean_num_visible']:.1f}",
        error="; ".join(_of_error(first, name) for name in ("hdop", NUM_VISIBLE)),
        block=f"{first.settings.block_m:g}",
        piece=f"{first.settings.piece_m:g}",
    )


def beside(
    skies: Mapping[str, Evidence],
    columns: Sequence[str],
    cells_of: Callable[[Evidence], dict[str, list[str]]],
) -> str:
    """Return a table with columns for each sky, and a row for each name that ``cells_of`` gives cells of."""
    heads = [f"{column}, {sky}" for sky in skies for column in columns]
    cells = [cells_of(of) for of in skies.values()]
    return table(
        ["", *heads],
        [[name, *(text for each in cells for text in each[name])] for name in cells[0]],
    )


def score_text(row: Mapping[Any, Any], name: str) -> str:
    """Return a score, gain or loss with its interval, with three digits behind the point; nothing for NaN."""
    return interval(row, name, lambda value: "" if math.isnan(value) else f"{value:z.3f}")


def scores_of(evidence: Evidence) -> dict[str, list[str]]:
    """Return what choices of rows score, and displaced cities."""
    cells = {}
    for row in evidence.of.scores.to_dict("records"):
        num = f"{row['rows']:,} ({100 * row['share']:.0f} %)"
        cells[ROWS[row["which"]]] = [num, score_text(row, "auc"), score_text(row, "within")]
    null = evidence.displaced[["auc", "within"]]
    for name, row in (("median", null.median()), ("most", null.max())):
        cells[f"displaced cities, {name}"] = ["", score_text(row, "auc"), score_text(row, "within")]
    return cells


def peak_of(evidence: Evidence) -> str:
    """Return where the city fits best, and with which heights."""
    peak = evidence.peak
    place = f"{peak['east_m']:g} m east and {peak['north_m']:g} m north"
    near = f"95 % of resampled tracks within {peak['within_95_m']:.0f} m of no displacement"
    return f"{place} ({near}) and {with_interval(peak, 'scale')} times as high"


def rivals_of(evidence: Evidence) -> dict[str, list[str]]:
    """Return the log-loss of each rule, and what it gains on the rule of the street."""
    return {
        row["model"]: [f"{row['log_loss']:.3f}", score_text(row, "gain")]
        for row in evidence.rivals.to_dict("records")
    }


def gains_of(evidence: Evidence) -> dict[str, list[str]]:
    """Return what margin and elevation gain on the rule of the street, by the length of blocks."""
    rows = evidence.block_lengths.to_dict("records")
    return {
        f"{row['num_blocks']} blocks of {row['block_m']:g} m": [score_text(row, "gain")]
        for row in rows
    }


def tracks_table(tracks: Mapping[str, CountValidation]) -> str:
    """Return what the satellites in view score on each track: within blocks, then over the whole track."""
    rows = []
    for name, validation in tracks.items():
        row = _row(validation, TRACKED, NUM_VISIBLE)
        length = f"{validation.summary['length_m'] / 1000:.1f} km"
        rows.append(
            (name, length, row["num"], with_interval(row, WITHIN), with_interval(row, SPEARMAN))
        )
    return table(("track", "length", "pieces", "within blocks", "whole track"), rows)


def _row(validation: CountValidation, witness: str, prediction: str) -> dict[Any, Any]:
    scores = validation.scores
    is_row = (scores.witness == witness) & (scores.prediction == prediction)
    (row,) = scores[is_row & (scores.piece_m == validation.settings.piece_m)].to_dict("records")
    return row


def _of_error(validation: CountValidation, prediction: str) -> str:
    """Return what a quantity of the maps scores against the error."""
    return f"{with_interval(_row(validation, ERROR, prediction), WITHIN)} for {name_of(prediction)}"


def main() -> None:
    """Make all maps, print the tables and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    chosen = parser.parse_args()
    began = time.perf_counter()
    made: dict[str, Any] = {}
    for make, names in ((evidence_on, SKIES), (counted_on, TRACKS)):
        for name in names:
            made[name] = make(name)
            print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)
    text = page({name: made[name] for name in SKIES}, {name: made[name] for name in TRACKS})
    print(text)
    chosen.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
