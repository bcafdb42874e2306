"""report.md of a comparison of maps, with its table, difference maps and figures."""

from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

from jaxurban.io.geotiff import write_bands
from jaxurban.io.store import short_number
from jaxurban.maps.provenance import NOT_SET
from jaxurban.report.figures.map_comparison import comparison_figures, heading_of
from jaxurban.report.write import Output, bullets, fill, framed, listed, study_outputs, table
from jaxurban.studies.map_comparison import MapComparison, unit_of
from jaxurban.studies.queries import population_norms


def comparison_outputs(found: MapComparison) -> tuple[dict[str, Output], dict[str, Any]]:
    """Return what a comparison writes, by file name, and what it is of."""
    key: dict[str, Any] = {"maps": list(found.names), "of": [maps.identity for maps in (found.a, found.b)]}
    key |= {"times": dict(found.times), "tolerance": found.tolerance}
    key["values"] = crc32(found.table.to_csv().encode())  # maps in memory have no name of their own
    figures = comparison_figures(found)
    size = short_number(found.grid.resolution_m)
    outputs: dict[str, Output] = {
        f"difference/{layer}_{size}m.tif": partial(_write_difference, found, layer) for layer in found.layers
    }
    report = comparison_markdown(found, list(figures))
    return outputs | study_outputs(report, {"layers": found.table}, figures), key


def _write_difference(found: MapComparison, layer: str, file: Path) -> Path:
    bands = {}
    for place in found.places(layer):
        altitude = "" if place.altitude_m is None else f"{place.altitude_m:g} m"
        name = " ".join(filter(None, (altitude, place.time, place.time_of_day))) or "B - A"
        bands[name] = found.of(layer, **place._asdict())
    tags = {"layer": layer, "difference": "B - A", "maps_a": found.names[0], "maps_b": found.names[1]}
    if found.a.attribution:
        tags["attribution"] = found.a.attribution
    return write_bands(file, found.grid, bands, unit_of(found.a, layer), tags)


def comparison_markdown(found: MapComparison, figures: list[str]) -> str:
    """Return the report as Markdown; ``figures`` are the layers whose pictures lie beside it."""
    same = [str(layer) for layer, share in found.most_changed.items() if not share > 0]
    first = found.table.time.isna() | (found.table.time == found.table.time.dropna().min())
    changed = found.table[first & ~found.table.layer.isin(same)].drop(columns="time").astype(object)
    held = found.a.facts
    left_out = bullets(f"{name}: {why}" for name, why in found.left_out.items())
    return fill(
        "compare",
        credits=[found.a.attribution, found.b.attribution],
        found=found,
        extent=f"Compared are {held['grid']} ({held['CRS']}) at {held['altitudes']}.",
        settings=_settings(found),
        values=framed(changed.where(changed.notna(), "")) if len(changed) else "Not one value differs.",
        unchanged=f"The same in both: {listed(same)}." if same else "",
        left_out=f"Not compared:\n\n{left_out}" if left_out else "",
        pictures="\n\n".join(f"![{heading_of(found, name)}, B - A](figures/{name}.png)" for name in figures)
        or "None: a layer is drawn where it differs.",
    )


def _settings(found: MapComparison) -> str:
    """Return what the maps were made by: settings, times that are not the same, and norms of population."""
    a, b = (population_norms(maps) for maps in (found.a, found.b))
    rows = [(f"`{key}`", *pair) for key, pair in (found.settings or {}).items()]
    rows += [("time of GPS", *pair) for pair in found.times.items() if pair[0] != pair[1]]
    norms = [day for day in a if "population" in found.layers and a[day] != b.get(day, a[day])]
    rows += [(f"population is divided by, {day}", f"{a[day]:,.0f}", f"{b[day]:,.0f}") for day in norms]
    shown = [(name, *(NOT_SET if value is None else f"`{value}`" for value in pair)) for name, *pair in rows]
    said = "Not both sets were made by `jaxurban maps`, so that their settings are not known."
    if found.settings is not None:
        said = "" if found.settings else "No setting differs."
    return "\n\n".join(filter(None, (said, table(("", "A", "B"), shown) if shown else "")))
