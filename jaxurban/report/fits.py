"""The part of a fit's report that compares it with further fits, and judges all by routes that none of them saw."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxurban.io.tables import records_of
from jaxurban.report.markdown import bullets, counted, fill, listed, table
from jaxurban.studies.tuning.compared_fits import FitComparison

MOST_NAMED = 20  # bad routes named in the report; the table of routes names all


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
    return fill("fits", fits=table(head, rows), reference=reference, sentences=bullets(_sentences(found)))


def _sentences(found: FitComparison) -> Iterator[str]:
    """Yield what the comparison supports."""
    routes, fits = found.routes, found.table
    held_out, bad = int(routes.is_held_out.sum()), routes[routes.is_bad]
    if held_out:
        by_city = [
            f"{int(each.is_held_out.sum())} of {len(each)} in {name}"
            for name, each in routes.groupby("city", sort=False)
        ]
        yield (
            f"{held_out} of {counted(len(routes), 'route')} were held out, drawn with seed {found.seed}: "
            f"{listed(by_city)}; routes between the same places stay together."
        )
    else:
        yield "No route was held out (--hold-out), so that the fits are judged by nothing that they have not seen."
    if len(bad):
        worst = bad.sort_values("regret", ascending=False).to_dict("records")[:MOST_NAMED]
        named = [f"{row['name']} ({row['city']}, {percent(row['regret'])})" for row in worst]
        more = f" and {len(bad) - MOST_NAMED} more" if len(bad) > MOST_NAMED else ""
        yield (
            f"{counted(len(bad), 'route was', 'routes were')} found bad, so much dearer than the cheapest one under "
            f"the first fit that they hardly count: {', '.join(named)}{more}."
        )
    else:
        yield "No route was found bad."
    if not held_out:
        return
    if not (routes.is_held_out & ~routes.is_bad).any():
        yield "Every route that was held out was found bad, so that regrets judge no fit: give more routes."
    rows = records_of(fits)
    for row in rows[1:]:
        if row["cities"] == rows[0]["cities"]:
            here, first = (percent(each["held_out_regret"]) for each in (row, rows[0]))
            if here and first:
                yield f"On held-out routes that are not bad, {row['fit']!r} leaves {here}, {rows[0]['fit']!r} {first}."
    unseen = [
        f"{percent(row[f'regret {city}'])} on {city}"
        for city in dict.fromkeys(routes.city)
        for row in rows
        if row["fit"] == f"without {city}"
    ]
    if unseen:
        yield f"Fitted without a city and judged by its held-out routes, weights leave {listed(unseen)}."


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
