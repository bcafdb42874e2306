"""report.md of a comparison of maps, with its tables, difference maps and figures."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.io.bands import write_bands
from jaxurban.io.store import short_number
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.report.figures.degrees import in_degrees
from jaxurban.report.figures.map_comparison import EPOCHS, comparison_figures, heading_of
from jaxurban.report.markdown import bullets, cell, fill, listed, table
from jaxurban.report.save import Output, files_of, save
from jaxurban.scenario.differences import NOT_SET
from jaxurban.studies.map_comparison.compare import CLOSED, EVERYWHERE, MASKS, SAME, MapComparison, Place, unit_of
from jaxurban.studies.queries import population_norms

REPORT_FILE = "report.md"
MOST_ROUTES = 15  # in the report
QUANTILES = {"median": 0.5, "90th percentile": 0.9, "most": 1.0}


@typed
def save_comparison(
    found: MapComparison, folder: str | Path, overwrite: bool = False, *, degrees: bool = False
) -> list[Path]:
    """Write the report, tables (CSV, Parquet), difference maps (GeoTIFF) and figures (PNG); return the files.

    Args:
      found: the comparison.
      folder: where to; made if it is not there.
      overwrite: replace another comparison in it.
      degrees: label the maps of figures by longitude and latitude instead of easting and northing.

    Raises:
      InputError: the folder cannot be written to, or holds another comparison or other files.
    """
    folder = Path(folder)
    key = {"maps": list(found.names), "of": [_identity(maps) for maps in (found.a, found.b)]}
    key |= {"times": dict(found.part.times), "tolerance": found.tolerance}
    if found.routes is not None:
        key["routes"] = asdict(found.routes.settings) | {
            "queries": [query.to_dict() for query in found.routes.a.queries]
        }
    outputs: dict[str, Output] = {"tables/layers": found.table}
    if found.routes is not None:
        outputs["tables/routes"] = found.routes.table
    figures = in_degrees(comparison_figures(found), found.grid, degrees)
    outputs |= {f"figures/{name}.png": draw for name, draw in figures.items()}
    outputs[REPORT_FILE] = comparison_markdown(found, list(figures))
    asked, differences = json.loads(json.dumps(key, default=str)), [_difference(found, layer) for layer in found.layers]
    names = [*differences, *files_of(outputs)]
    with Workspace.open(folder, "compare", asked, names=names, overwrite=overwrite):
        files = [
            _write_difference(found, layer, folder / name)
            for layer, name in zip(found.layers, differences, strict=True)
        ]
        return files + save(folder, outputs)


def _identity(maps: MetricMaps) -> dict[str, str]:
    names = ("run_key", "crs", "resolution_m", "first_row", "first_col")
    return {name: str(maps.ds.attrs.get(name)) for name in names} | {"obstacles": maps.obstacles}


def _difference(found: MapComparison, layer: str) -> str:
    return f"difference/{layer}_{short_number(found.grid.resolution_m)}m.tif"


def _write_difference(found: MapComparison, layer: str, file: Path) -> Path:
    bands = {
        _band(place): found.of(layer, place.altitude_m, time=place.time, time_of_day=place.time_of_day)
        for place in found.places(layer)
    }
    tags = {"layer": layer, "difference": "B - A", "maps_a": found.names[0], "maps_b": found.names[1]}
    if credit := found.a.ds.attrs.get("attribution"):
        tags["attribution"] = credit
    return write_bands(file, found.grid, bands, unit_of(found.a, layer), tags)


def _band(place: Place) -> str:
    altitude = None if place.altitude_m is None else f"{place.altitude_m:g} m"
    return " ".join(filter(None, (altitude, place.time, place.time_of_day))) or "B - A"


def comparison_markdown(found: MapComparison, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the names of the pictures beside it."""
    whole = found.table[found.table.stratum == EVERYWHERE]
    most = whole.groupby("layer", sort=False)["share_changed"].max()
    values = [layer for layer in found.layers if layer not in MASKS]
    changed = [layer for layer in values if most[layer] > 0]
    same = [layer for layer in values if not most[layer] > 0]
    text = fill(
        "compare",
        found=found,
        sides=bullets([f"**A**: `{found.names[0]}`", f"**B**: `{found.names[1]}`"]),
        extent=_extent(found),
        settings=_settings(found) + _norms(found),
        summary="" if changed else "Not one value differs.",
        values=_values(whole, changed),
        shown="The table shows the first time alone; " if len(found.part.times) > 1 else "",
        unchanged=f"The same in both: {listed(same)}." if same else "",
        left_out=_left_out(found),
        blocked=_blocked(whole),
        rule="every cell that a roof touches" if found.a.obstacles == "touched" else "the same rule here",
        strata=_strata(found, [layer for layer in changed if layer in found.a.metrics]),
        routes=_routes(found),
        figures="\n\n".join(f"![{_caption(found, name)}](figures/{name}.png)" for name in figures)
        or "Nothing differs, so there is nothing to draw.",
    )
    return f"{text}\n"


def _caption(found: MapComparison, name: str) -> str:
    if name == "routes":
        return "Routes that change"
    layer = name.removesuffix(EPOCHS)
    return f"{heading_of(found, layer)}, B - A" + ("" if layer == name else ", at each epoch")


def _extent(found: MapComparison) -> str:
    held, cut = found.a.facts, found.part.cut
    lines = [f"Compared are {held['grid']} ({held['CRS']}) at {held['altitudes']}"]
    if any(cut):
        lines.append(f"; {cut[0]:,} cells of A and {cut[1]:,} of B lie outside the region of the other")
    lines.append(".")
    other = [f"{a} of A is set beside {b} of B" for a, b in found.part.times.items() if a != b]
    return "".join(lines) + (f" GPS: {listed(other)}." if other else "")


def _norms(found: MapComparison) -> str:
    """Return that population is divided by other numbers; nothing where it is not."""
    a, b = (population_norms(maps) for maps in (found.a, found.b))
    said = [f"{a[day]:,.0f} and {b[day]:,.0f} at {day}" for day in a if day in b and a[day] != b[day]]
    if not said or "population" not in found.layers:
        return ""
    return (
        f"\n\n**Population is normalised by different numbers, in A and B {listed(said)}**, so that `population` "
        "differs where as many people live too, and so do costs by it; `density` does not. Set `[population] "
        "normalise` to a number to compare people alone."
    )


def _settings(found: MapComparison) -> str:
    if found.settings is None:
        return "Not both sets were made by `jaxurban maps`, so nothing tells which settings differ."
    if not found.settings:
        return "No setting differs: what differs comes from the files or from the version that made the maps."
    rows = [
        (f"`{key}`", *(NOT_SET if value is None else f"`{value}`" for value in pair))
        for key, pair in found.settings.items()
    ]
    return table(("setting", "A", "B"), rows, is_aligned=False)


def _tuples(rows: pd.DataFrame) -> list[Any]:
    return list(rows.itertuples())


def _first_time(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[rows.time.isna() | (rows.time == rows.time.dropna().min())]


def _values(whole: pd.DataFrame, changed: list[str]) -> str:
    rows = _first_time(whole[whole.layer.isin(changed)])
    if rows.empty:
        return ""
    head = ("layer", "unit", "where", "cells", "mean", "median", "p05", "p95", "RMS", "changed")
    return table(
        head,
        [
            (
                row.layer,
                row.unit,
                _where(row.altitude_m, row.time_of_day),
                f"{row.cells:,}",
                *map(_number, (row.mean, row.median, row.p05, row.p95)),
                cell(row.rms),
                f"{row.share_changed:.1%}",
            )
            for row in _tuples(rows)
        ],
    )


def _number(value: float) -> str:
    return "" if not np.isfinite(value) else "0" if abs(value) <= SAME else f"{value:+.3g}"


def _where(altitude_m: Any, time_of_day: Any) -> str:
    altitude = "" if pd.isna(altitude_m) else f"{altitude_m:g} m"
    return ", ".join(filter(None, (altitude, "" if pd.isna(time_of_day) else str(time_of_day)))) or "everywhere"


def _blocked(whole: pd.DataFrame) -> str:
    rows = whole[whole.layer.isin(MASKS)]
    return table(
        ("rule", "altitude", "cells", "blocked in B alone (gained)", "in A alone (lost)", "share of cells that change"),
        [
            (
                row.layer,
                f"{row.altitude_m:g} m",
                f"{row.cells:,}",
                f"{row.gained:,}",
                f"{row.lost:,}",
                f"{row.share_changed:.2%}",
            )
            for row in _tuples(rows)
        ],
    )


def _left_out(found: MapComparison) -> str:
    if not found.part.left_out:
        return ""
    return "Not compared:\n\n" + bullets(f"{name}: {why}" for name, why in found.part.left_out.items())


def _strata(found: MapComparison, metrics: list[str]) -> str:
    """Return how blocked cells and each metric of the cost differ by stratum and altitude."""
    of_strata = found.table[(found.table.stratum != EVERYWHERE) & found.table.layer.isin([CLOSED, *metrics])]
    rows = [
        (
            row.layer,
            row.stratum,
            _where(row.altitude_m, row.time_of_day),
            f"{row.cells:,}",
            _number(row.mean),
            cell(row.rms),
            f"{row.share_changed:.1%}",
        )
        for row in _tuples(_first_time(of_strata))
    ]
    return table(("layer", "stratum", "where", "cells", "mean", "RMS", "changed"), rows)


def _routes(found: MapComparison) -> str:
    if found.routes is None:
        return ""
    both, settings = found.routes.both, found.routes.settings
    changed = both[both.is_changed.astype(bool)].sort_values(["regret", "overlap"], ascending=[False, True])
    head = ("query", "altitude", "from", "to", "cost on A", "cost on B", "A's on B", "regret", "overlap", "blocked")
    rows = [
        (
            f"{row.query}",
            f"{row.altitude_m:g} m",
            f"{row.start_stratum}",
            f"{row.goal_stratum}",
            *(f"{cost:,.1f}" for cost in (row.cost_a, row.cost_b, row.cost_of_a_on_b)),
            f"{row.regret:.2%}" if np.isfinite(row.regret) else f"{row.regret}",
            f"{row.overlap:.0%}",
            f"{row.blocked_m:.0f} m",
        )
        for row in _tuples(changed.head(MOST_ROUTES))
    ]
    return fill(
        "compare_routes",
        sentence=found.routes.sentence,
        quantiles=_regret(both),
        table=table(head, rows) if rows else "",
        weights=", ".join(f"{name} {weight:g}" for name, weight in settings.weights.to_dict().items()),
        model=settings.cost_model,
    )


def _regret(both: pd.DataFrame) -> str:
    """Return how the regret of A's routes is spread, of those that can be flown on B."""
    flown = both.regret[np.isfinite(both.regret)]
    if flown.empty:
        return ""
    at = ", ".join(f"{name} {np.quantile(flown, share):.2%}" for name, share in QUANTILES.items())
    return (
        f"Regret of the {len(flown)} routes of A that can be flown on B: {at}. Mean overlap: {both.overlap.mean():.0%}."
    )
