"""The part of a fit's report that compares it with further fits, and judges all by routes that none of them saw."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxurban.io.tables import records_of
from jaxurban.report.markdown import fill, framed, table
from jaxurban.studies.tuning.compared_fits import FitComparison


def is_compared(found: FitComparison) -> bool:
    """Return whether there is more to tell than of one fit to all routes."""
    return len(found.fits) > 1 or bool(found.routes.is_held_out.any())


def fits_section(found: FitComparison) -> str:
    """Return the section on several fits."""
    has_pilot = "pilot_regret" in found.table
    cities = list(dict.fromkeys(found.routes.city)) if found.routes.city.nunique() > 1 else []
    head = ["fit", "routes", "bad", "cosine", "cosine of bootstrap fits", "regret on held-out routes", "worst", *cities]
    head += ["all held-out, bad ones too", *(["dearer to the pilot"] if has_pilot else [])]
    rows = []
    for row in records_of(found.table):
        cells = [row["fit"], f"{row['num_fitted']}", f"{row['num_bad']}", f"{row['cosine']:.5f}", _draws(row)]
        cells += [_interval(row, "held_out_regret"), percent(row["worst"])]
        cells += [percent(row[f"regret {city}"]) for city in cities]
        cells += [percent(row["all_held_out_regret"]), *([_interval(row, "pilot_regret")] if has_pilot else [])]
        rows.append(cells)
    reference = "the pilot's" if found.reference == "pilot" else f"those of the fit {found.reference!r}"
    by_city = found.routes.groupby("city", sort=False).agg(
        routes=("name", "size"), held_out=("is_held_out", "sum"), bad=("is_bad", "sum")
    )
    return fill(
        "fits", fits=table(head, rows), reference=reference, seed=found.seed, routes=framed(by_city.reset_index())
    )


def _draws(row: Mapping[str, Any]) -> str:
    """Return between which cosines 95 % of the bootstrap fits lie, which may leave out the fit's own."""
    low, high = row["cosine_low"], row["cosine_high"]
    return f"{low:.5f} to {high:.5f}" if low is not None else ""


def _interval(row: Mapping[str, Any], name: str) -> str:
    mean, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    return percent(mean) + (f" ({percent(low)} to {percent(high)})" if low is not None else "")


def percent(share: float | None) -> str:
    """Return a share in percent, nothing where it is not known."""
    if share is None or np.isnan(share):
        return ""
    return f"{100 * share:.2g} %" if share >= 1e-6 else "0 %"
