"""report.md of a comparison of maps, with its table, difference maps and figures."""

from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd

from jaxurban.errors import typed
from jaxurban.io.bands import write_bands
from jaxurban.io.store import short_number
from jaxurban.io.workspace import Workspace
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.report.figures.degrees import in_degrees
from jaxurban.report.figures.map_comparison import comparison_figures, heading_of
from jaxurban.report.markdown import bullets, fill, listed, table
from jaxurban.report.save import Output, files_of, save
from jaxurban.scenario.differences import NOT_SET
from jaxurban.studies.map_comparison.compare import MASKS, SAME, MapComparison, Place, unit_of
from jaxurban.studies.queries import population_norms

REPORT_FILE = "report.md"


@typed
def save_comparison(
    found: MapComparison, folder: str | Path, overwrite: bool = False, *, degrees: bool = False
) -> list[Path]:
    """Write the report, a table (CSV, Parquet), difference maps (GeoTIFF) and figures (PNG); return the files.

    Args:
      found: the comparison.
      folder: where to; made if it is not there.
      overwrite: replace another comparison in it.
      degrees: label the maps of figures by longitude and latitude instead of easting and northing.

    Raises:
      InputError: the folder cannot be written to, or holds another comparison or other files.
    """
    folder = Path(folder)
    key: dict[str, Any] = {"maps": list(found.names), "of": [_identity(maps) for maps in (found.a, found.b)]}
    key |= {"times": dict(found.part.times), "tolerance": found.tolerance}
    key["values"] = crc32(found.table.to_csv().encode())  # maps in memory have no name of their own
    figures = in_degrees(comparison_figures(found), found.grid, degrees)
    outputs: dict[str, Output] = {"tables/layers": found.table}
    outputs |= {f"figures/{name}.png": draw for name, draw in figures.items()}
    outputs[REPORT_FILE] = comparison_markdown(found, list(figures))
    differences = {layer: f"difference/{layer}_{short_number(found.grid.resolution_m)}m.tif" for layer in found.layers}
    names = [*differences.values(), *files_of(outputs)]
    with Workspace.open(folder, "compare", key, names=names, overwrite=overwrite):
        files = [_write_difference(found, layer, folder / name) for layer, name in differences.items()]
        return files + save(folder, outputs)


def _identity(maps: MetricMaps) -> dict[str, str]:
    names = ("run_key", "crs", "resolution_m", "first_row", "first_col")
    return {name: str(maps.ds.attrs.get(name)) for name in names} | {"obstacles": maps.obstacles}


def _write_difference(found: MapComparison, layer: str, file: Path) -> Path:
    bands = {_where(place, "B - A"): found.of(layer, **place._asdict()) for place in found.places(layer)}
    tags = {"layer": layer, "difference": "B - A", "maps_a": found.names[0], "maps_b": found.names[1]}
    if credit := found.a.ds.attrs.get("attribution"):
        tags["attribution"] = credit
    return write_bands(file, found.grid, bands, unit_of(found.a, layer), tags)


def _where(place: Place, otherwise: str, *, has_time: bool = True) -> str:
    altitude = "" if pd.isna(place.altitude_m) else f"{place.altitude_m:g} m"
    times = [time for time in (place.time if has_time else None, place.time_of_day) if not pd.isna(time)]
    return " ".join(filter(None, (altitude, *times))) or otherwise


def comparison_markdown(found: MapComparison, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the layers whose pictures lie beside it."""
    most = found.most_changed.drop(list(MASKS))
    same = [str(layer) for layer, share in most.items() if not share > 0]
    held, cut = found.a.facts, found.part.cut
    text = fill(
        "compare",
        found=found,
        sides=bullets([f"**A**: `{found.names[0]}`", f"**B**: `{found.names[1]}`"]),
        extent=f"Compared are {held['grid']} ({held['CRS']}) at {held['altitudes']}; {cut[0]:,} cells of A and "
        f"{cut[1]:,} of B lie outside the region of the other.",
        settings=_settings(found),
        values=_values(found, most[most > 0].index) or "Not one value differs.",
        unchanged=f"The same in both: {listed(same)}." if same else "",
        left_out=_left_out(found),
        blocked=_blocked(found),
        figures="\n\n".join(f"![{heading_of(found, name)}, B - A](figures/{name}.png)" for name in figures)
        or "Nothing differs, so there is nothing to draw.",
    )
    return f"{text}\n"


def _settings(found: MapComparison) -> str:
    """Return what the maps were made by: settings, times that are not the same, and norms of population."""
    a, b = (population_norms(maps) for maps in (found.a, found.b))
    rows = [(f"`{key}`", *pair) for key, pair in (found.settings or {}).items()]
    rows += [("time of GPS", *pair) for pair in found.part.times.items() if pair[0] != pair[1]]
    if "population" in found.layers:
        norms = [(f"population is divided by, {day}", a[day], b[day]) for day in a if day in b and a[day] != b[day]]
        rows += [(name, f"{of_a:,.0f}", f"{of_b:,.0f}") for name, of_a, of_b in norms]
    shown = [(name, *(NOT_SET if value is None else f"`{value}`" for value in pair)) for name, *pair in rows]
    if found.settings is None:
        said = "Not both sets were made by `jaxurban maps`, so that their settings are not known."
    elif not found.settings:
        said = "No setting differs: what differs comes from the files or from the version that made the maps."
    else:
        said = ""
    return "\n\n".join(filter(None, (said, table(("", "A", "B"), shown, is_aligned=False) if shown else "")))


def _values(found: MapComparison, layers: Any) -> str:
    rows = found.table[found.table.layer.isin(layers)]
    rows = rows[rows.time.isna() | (rows.time == rows.time.dropna().min())]
    head = ("layer", "unit", "where", "cells", "mean", "median", "p05", "p95", "RMS", "changed")
    shown = [
        (
            *(row.layer, row.unit, _where(row, "everywhere", has_time=False), f"{row.cells:,}"),
            *map(_number, (row.mean, row.median, row.p05, row.p95)),
            *(row.rms, f"{row.share_changed:.1%}"),
        )
        for row in _tuples(rows)
    ]
    return table(head, shown) if shown else ""


def _tuples(rows: pd.DataFrame) -> list[Any]:
    return list(rows.itertuples())


def _number(value: float) -> str:
    return "" if not np.isfinite(value) else "0" if abs(value) <= SAME else f"{value:+.3g}"


def _blocked(found: MapComparison) -> str:
    head = (
        "rule",
        "altitude",
        "cells",
        "blocked in B alone (gained)",
        "in A alone (lost)",
        "share of cells that change",
    )
    shown = [
        (
            *(row.layer, f"{row.altitude_m:g} m", f"{row.cells:,}", f"{row.gained:,}", f"{row.lost:,}"),
            f"{row.share_changed:.2%}",
        )
        for row in _tuples(found.table[found.table.layer.isin(MASKS)])
    ]
    return table(head, shown)


def _left_out(found: MapComparison) -> str:
    if not found.part.left_out:
        return ""
    return "Not compared:\n\n" + bullets(f"{name}: {why}" for name, why in found.part.left_out.items())
