"""What a receiver's validation writes: report.md, all numbers as JSON, tables and figures."""

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.io.read.receiver import TRACKED, ReceiverLog
from jaxurban.io.tables import records_of
from jaxurban.io.workspace import Workspace
from jaxurban.report.figures.degrees import in_degrees
from jaxurban.report.figures.receiver import LABELS, name_of, validation_figures
from jaxurban.report.markdown import bullets, counted, fill, table
from jaxurban.report.save import Output, files_of, save
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.receiver.scores import AUC, COEFFICIENTS, MAIN, SPEARMAN, WITHIN
from jaxurban.studies.receiver.validate import ReceiverValidation

REPORT_FILE, NUMBERS_FILE = "report.md", "validation.json"
HEADS = {WITHIN: "rank correlation within blocks", SPEARMAN: "over the whole track", AUC: "AUC"}
CAPTIONS = {
    "track": "Prediction and receiver along the track",
    "scatter": "Receiver against prediction, a point a piece of track",
    "time_line": "Receiver and prediction over time",
    "control": "Agreement by length of pieces, and at every shift along the track",
}


@typed
def save_validation(
    found: ReceiverValidation, folder: str | Path, overwrite: bool = False, *, degrees: bool = False
) -> list[Path]:
    """Write the report, its numbers (JSON), tables (CSV, Parquet) and figures (PNG); return the files.

    Args:
      found: from `jaxurban.validate`.
      folder: where to; made if it is not there.
      overwrite: replace another validation in it.
      degrees: label the maps of figures by longitude and latitude instead of easting and northing.

    Raises:
      InputError: the folder cannot be written to, or holds another validation or other files.
    """
    asked = {"log": found.log.name, "scenario": found.scenario, "settings": found.settings.to_dict()}
    asked["rows"] = _digest(found.log)
    figures = in_degrees(validation_figures(found), found.background.grid, degrees)
    outputs: dict[str, Output] = {
        REPORT_FILE: validation_markdown(found, list(figures)),
        NUMBERS_FILE: f"{json.dumps(numbers_of(found), indent=2, allow_nan=False)}\n",
        "tables/pieces": found.pieces.assign(utc=found.pieces.utc.map(lambda time: time.isoformat())),
        "tables/scores": found.scores,
        "tables/shifts": found.shifts,
    }
    if found.satellites is not None:
        outputs["tables/satellites"] = found.satellites
    outputs |= {f"figures/{name}.png": draw for name, draw in figures.items()}
    with Workspace.open(Path(folder), "validate", _plain(asked), names=files_of(outputs), overwrite=overwrite):
        return save(folder, outputs)


def _digest(log: ReceiverLog) -> str:
    """Return what tells a log from another of its name."""
    tables = (log.epochs, log.satellites)
    text = "".join(each.to_csv(index=False) for each in tables if each is not None)
    return hashlib.sha256(text.encode()).hexdigest()


def numbers_of(found: ReceiverValidation) -> dict[str, Any]:
    """Return every number of a validation as plain values, None where there is none."""
    return _plain(
        {
            "log": found.log.name,
            "settings": found.settings.to_dict(),
            "scenario": found.scenario,
            "summary": found.summary,
            "scores": records_of(found.scores),
            "shifts": records_of(found.shifts),
            "satellites": None if found.satellites is None else records_of(found.satellites),
            "guesses": list(found.guesses),
            "attribution": found.attribution,
        }
    )


def _plain(value: Any) -> Any:
    """Return a value as JSON holds it: None where it is no number, or infinite."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def validation_markdown(found: ReceiverValidation, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the names of the pictures beside it."""
    at_lengths = found.scores[found.scores.prediction == found.scores.witness.map(MAIN)]
    text = fill(
        "validate",
        found=found,
        settings=found.settings,
        track=_track(found),
        summary=bullets(f"**{_said(row)}**" for row in found.main.to_dict("records")),
        scores=score_table(at_lengths),
        undefined=_undefined(found),
        others=_others(found),
        satellites=_satellites(found),
        how=_how(found),
        guesses="" if not found.guesses else "Guessed:\n\n" + bullets(found.guesses),
        figures="\n\n".join(f"![{CAPTIONS[name]}](figures/{name}.png)" for name in figures),
    )
    return f"{text}\n"


def _undefined(found: ReceiverValidation) -> str:
    """Return why values and intervals are missing."""
    undefined = "No value stands where a coefficient is not defined: nothing varies, or all pieces are of one kind."
    lacks = bool((found.scores[WITHIN].notna() & found.scores[f"{WITHIN}_low"].isna()).any())
    few = f" No interval stands where a track has fewer than {FEWEST_GROUPS} blocks."
    return undefined + few * lacks


def _track(found: ReceiverValidation) -> str:
    of = found.summary
    told = (
        f"{of['epochs']:,} epochs from {of['first_utc']} to {of['last_utc']} over {of['length_m'] / 1000:.2f} km of "
        f"track; {of['mean_num_visible']:.1f} satellites in view on average, of {of['mean_open_num_visible']:.1f} above"
        " the mask"
    )
    if f"mean_{TRACKED}" in of:
        told += f", {of[f'mean_{TRACKED}']:.1f} tracked"
    out = of["epochs_left_out"]
    return told + (f". Left out: {counted(out, 'epoch')} in a building or without data on the map." if out else ".")


def _said(row: Mapping[Any, Any]) -> str:
    """Return one row of the scores in words."""
    parts = [
        f"{HEADS[name]} {with_interval(row, name)}, 95 % of shifts below {row[f'{name}_shifts_95']:.2f} "
        f"(p {row[f'{name}_p']:.3f})"
        for name in COEFFICIENTS
        if np.isfinite(row[name])
    ]
    what = f"{LABELS[row['witness']]} against {name_of(row['prediction'])}"
    return f"{what[0].upper()}{what[1:]}: {'; '.join(parts) or 'not defined'}"


def with_interval(row: Mapping[Any, Any], coefficient: str) -> str:
    """Return a coefficient with the interval that it has, as ``0.42 (0.29 to 0.54)``; nothing where it is undefined."""
    value, low, high = (row.get(f"{coefficient}{end}", math.nan) for end in ("", "_low", "_high"))
    return _number(value) + (f" ({low:.2f} to {high:.2f})" if np.isfinite(low) else "")


def score_table(scores: pd.DataFrame) -> str:
    """Return rows of scores as a table."""
    rows = []
    for row in scores.to_dict("records"):
        is_each = not np.isfinite(row["piece_m"])
        cells = [
            LABELS[row["witness"]],
            name_of(row["prediction"]),
            "each epoch" if is_each else f"{row['piece_m']:g} m",
            f"{row['num']:,}",
        ]
        for name in COEFFICIENTS:
            cells += [with_interval(row, name), _number(row[f"{name}_shifts_95"]), _number(row[f"{name}_p"], 3)]
        rows.append((*cells, _number(row[f"{SPEARMAN}_open"]), _number(row[f"{AUC}_open"])))
    of_each = [head for name in COEFFICIENTS for head in (HEADS[name], "95 % of shifts below", "p")]
    return table(("receiver", "maps", "pieces of", "number", *of_each, "open sky", "its AUC"), rows)


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def _others(found: ReceiverValidation) -> str:
    """Return what further quantities of the maps score over pieces of the chosen length."""
    is_other = (found.scores.piece_m == found.settings.piece_m) & (
        found.scores.prediction != found.scores.witness.map(MAIN)
    )
    if not is_other.any():
        return ""
    return f"Other quantities of the maps, over pieces of {found.settings.piece_m:g} m:\n\n" + score_table(
        found.scores[is_other]
    )


def _satellites(found: ReceiverValidation) -> str:
    if found.satellites is None:
        return ""
    rows = [
        (
            row["satellite"],
            f"{row['epochs']:,}",
            *(_share(row[name]) for name in ("in_sight", "tracked_in_sight", "tracked_hidden")),
            *(_number(row[f"cn0_{where}_dbhz"]) for where in ("in_sight", "hidden")),
        )
        for row in found.satellites.to_dict("records")
    ]
    head = ("satellite", "epochs", "in sight", "tracked in sight", "tracked hidden", "C/N0 in sight", "C/N0 hidden")
    return "By satellite, over epochs at which it is above the mask; C/N0 are medians, dB-Hz:\n\n" + table(head, rows)


def _share(value: float) -> str:
    return f"{value:.0%}" if np.isfinite(value) else ""


def _how(found: ReceiverValidation) -> str:
    scenario, settings = found.scenario, found.settings
    lines = [
        f"Cells of {found.summary['resolution_m']:g} m, antenna {settings.antenna_height_m:g} m above the ground, "
        f"elevation mask {scenario['gps']['mask_deg']:g} degrees, `oversample` {scenario['region']['oversample']}.",
        f"Orbits: {', '.join(f'`{name}`' for name in scenario['gps']['orbits'])}; {found.summary['num_skies']} "
        f"skies, one each {settings.sky_step_s:g} s.",
        f"Buildings: `{scenario['buildings']['source']}`; terrain: `{scenario['terrain']['source'] or 'flat'}`.",
        f"Intervals: the jackknife over blocks of {settings.block_m:g} m, on Fisher's scale.",
    ]
    if found.attribution:
        lines.append(f"Credit: {found.attribution}.")
    return bullets(lines)
