"""What a receiver's validation writes: report.md, all numbers as JSON, tables and figures."""

import hashlib
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.io.read.receiver import TRACKED
from jaxurban.maps.levels import listed_m
from jaxurban.report.figures.receiver import LABELS, name_of, plot_scatter
from jaxurban.report.write import Output, bullets, fill, study_outputs, table
from jaxurban.settings import each
from jaxurban.studies.bootstrap import FEWEST_GROUPS
from jaxurban.studies.receiver.validate import COEFFICIENTS, MAIN, SPEARMAN, WITHIN, ReceiverValidation

HEADS = {WITHIN: "rank correlation within blocks", SPEARMAN: "over the whole track"}


def validation_outputs(found: ReceiverValidation) -> tuple[dict[str, Output], dict[str, Any]]:
    """Return what a validation writes, by file name, and what it is of."""
    rows = hashlib.sha256(found.log.epochs.to_csv(index=False).encode()).hexdigest()  # of two logs of one name
    pieces = found.pieces.assign(utc=found.pieces.utc.map(lambda time: time.isoformat()))
    tables = {"pieces": pieces, "scores": found.scores, "shifts": found.shifts}
    key = {"log": found.log.name, "rows": rows, "scenario": found.scenario, "settings": found.settings.to_dict()}
    return study_outputs(validation_markdown(found), tables, {"scatter": partial(plot_scatter, found)}), key


def validation_markdown(found: ReceiverValidation) -> str:
    """Return the report as Markdown."""
    of, settings, scenario = found.summary, found.settings, found.scenario
    masks_deg = each(scenario["gps"]["mask_deg"])
    is_main = found.scores.prediction == found.scores.witness.map(MAIN)
    others = found.scores[~is_main]
    facts = {
        "epochs": f"{of['epochs']:,}, of which {of['epochs_left_out']:,} are left out: in a building or without data",
        "time": f"{of['first_utc']} to {of['last_utc']}",
        "track": f"{of['length_m'] / 1000:.2f} km",
        "satellites in view, mean": _number(of["mean_num_visible"], 1),
        "satellites tracked, mean": _number(of.get(f"mean_{TRACKED}", math.nan), 1),
        "maps": f"cells of {of['resolution_m']:g} m, elevation mask {listed_m(masks_deg)} degrees, "
        f"`oversample` {scenario['region']['oversample']}, antenna {settings.antenna_height_m:g} m above the ground",
        "orbits": f"{', '.join(f'`{name}`' for name in scenario['gps']['orbits'])}; {of['num_skies']} skies, one each "
        f"{settings.sky_step_s:g} s",
        "city": f"buildings `{scenario['buildings']['source']}`, terrain `{scenario['terrain']['source'] or 'flat'}`",
    }
    return fill(
        "validate",
        credits=[found.attribution],
        found=found,
        settings=settings,
        fewest=FEWEST_GROUPS,
        facts=table(("", ""), [(name, fact) for name, fact in facts.items() if fact]),
        scores=score_table(found.scores[is_main]),
        others=score_table(others) if len(others) else "",
        guesses="" if not found.guesses else "Guessed:\n\n" + bullets(found.guesses),
    )


def with_interval(row: Mapping[Any, Any], coefficient: str) -> str:
    """Return a coefficient with the interval that it has, as ``0.42 (0.29 to 0.54)``; nothing where it is undefined."""
    value, low, high = (row.get(f"{coefficient}{end}", math.nan) for end in ("", "_low", "_high"))
    return _number(value) + (f" ({low:.2f} to {high:.2f})" if np.isfinite(low) else "")


def score_table(scores: pd.DataFrame) -> str:
    """Return rows of scores as a table."""
    rows = []
    for row in scores.to_dict("records"):
        cells = [LABELS[row["witness"]], name_of(row["prediction"]), f"{row['piece_m']:g} m", f"{row['num']:,}"]
        for name in COEFFICIENTS:
            cells += [with_interval(row, name), _number(row[f"{name}_shifts_95"]), _number(row[f"{name}_p"], 3)]
        rows.append(cells)
    of_each = [head for name in COEFFICIENTS for head in (HEADS[name], "95 % of shifts below", "p")]
    return table(("receiver", "maps", "pieces of", "number", *of_each), rows)


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""
