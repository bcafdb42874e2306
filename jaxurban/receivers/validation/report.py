"""What a receiver's validation writes: report.md, tables, and pictures of the log beside the maps."""

import hashlib

import pandas as pd

from jaxurban.draw.write import ResultReport, bullets, interval, table, without_ends
from jaxurban.io.tracks import CN0, LAT, LON, SATELLITE, UTC
from jaxurban.receivers.report import HEADS, ROWS, satellite_figures
from jaxurban.receivers.validation.logs import EPOCH
from jaxurban.receivers.validation.validate import ReceiverValidation
from jaxurban.statistics.bootstrap import FEWEST_GROUPS

FIRST = [UTC, LON, LAT, SATELLITE, "state", "margin_m", CN0]  # columns of the table of satellites


def validation_report(result: ReceiverValidation) -> ResultReport:
    """Return what a validation writes.

    Among its facts is a hash of the log's rows: two logs may have one name.
    """
    # The rows of the log as one text, of which the key has a hash.
    text = result.log.epochs.to_csv(index=False) + result.log.satellites.to_csv(index=False)

    # Each satellite at its time and place, with times as texts.
    epochs = result.epochs.assign(utc=result.epochs.utc.map(lambda time: time.isoformat()))
    rows = result.rows.join(epochs[[UTC, LON, LAT]], on=EPOCH)
    others = [name for name in rows if name not in FIRST]
    cautions = (f"{caution.level}: {caution}" for caution in result.known_cautions)
    return ResultReport(
        "receivers/templates/validate",
        {
            "tables": {"scores": score_texts(result.scores)},
            "credits": [result.attribution],
            "result": result,
            "fewest": FEWEST_GROUPS,
            "facts": table(("", ""), result.track_facts.items()),
            "cautions": bullets(cautions),
        },
        tables={
            "satellites.parquet": rows[FIRST + others],
            "epochs": epochs,
            "scores": result.scores,
        },
        figures=satellite_figures(result),
        key={
            "log": result.log.name,
            "rows": hashlib.sha256(text.encode()).hexdigest(),
            "scenario": result.scenario,
            "settings": result.settings.to_dict(),
        },
        decided=result.decided,
    )


def score_texts(scores: pd.DataFrame) -> pd.DataFrame:
    """Return scores as the report has them: with three digits, an interval in the column of its value."""
    texts = scores[without_ends(scores)].replace({"which": ROWS})
    rows = scores.to_dict("records")
    for name in ("share", "auc", "within"):
        texts[name] = [interval(row, name) for row in rows]
    return texts.rename(columns=HEADS)
