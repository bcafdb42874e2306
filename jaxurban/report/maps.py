"""summary.md: what the maps and paths of a run show, for a reader new to them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from jaxurban.io.attributes import names_in
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.rating import Rating, rating
from jaxurban.paths.path import PlannedPath
from jaxurban.report.figures.files import maps_figures
from jaxurban.report.figures.notes import caveats_said, rules_said
from jaxurban.report.write import bullets, fill, framed, listed, table

Paths = Mapping[float, Sequence[PlannedPath]]


def summary_markdown(maps: MetricMaps, paths: Paths, run: Mapping[str, Any] | None = None) -> str:
    """Return the summary of one region's maps and paths as Markdown; every number is taken from them.

    Pictures are named as `jaxurban.report.figures.save_figures` names them, in a folder ``figures`` beside the
    summary. Means and shares by altitude are over free cells, at the first time.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: paths by altitude; may be empty.
      run: what run.json holds; what it lacks is left out.
    """
    grid, run = maps.grid, run or {}
    planned = [path for z in maps.altitudes_m for path in paths.get(z, ())]
    roof_m = maps.m("roof")[maps.ds["has_data"].values]
    text = fill(
        "summary",
        what="Metric maps and paths" if planned else "Metric maps",
        width_km=(grid.x_max_m - grid.x_min_m) / 1000,
        height_km=(grid.y_max_m - grid.y_min_m) / 1000,
        southwest=grid.lonlat_of_xy(grid.x_min_m, grid.y_min_m),
        northeast=grid.lonlat_of_xy(grid.x_max_m, grid.y_max_m),
        grid=grid,
        altitudes=listed(f"{z:g}" for z in maps.altitudes_m),
        roofed=float((roof_m > 0).mean()),
        highest_m=roof_m.max(),
        num_satellites=len(names_in(maps.ds.attrs, "satellites")),
        num_times=len(maps.times),
        first_time=maps.times[0],
        record=_record(run),
        by_altitude=framed(pd.DataFrame([_facts(maps, z) for z in maps.altitudes_m])),
        population=_population(maps, run) if maps.times_of_day else "",
        paths=_paths(maps, planned) if planned else "",
        pictures=bullets(f"[{name}](figures/{name}.png)" for name in maps_figures(maps, paths)),
        caveats="".join(f"\n- {line}" for line in caveats_said(maps)),
    )
    return f"{text}\n"


def _record(run: Mapping[str, Any]) -> str:
    """Return what the record of a run says beyond its maps."""
    buildings, shares = run.get("buildings") or {}, run.get("rays_leave_data_share") or {}
    facts = [("buildings in the region", buildings["in_region"])] if buildings else []
    facts += [(f"heights from: {name}", num) for name, num in (buildings.get("height_origin_counts") or {}).items()]
    facts += [(f"source of {role}", f"`{source['path']}`") for role, source in (run.get("inputs") or {}).items()]
    facts += [(f"seconds: {step}", elapsed_s) for step, elapsed_s in (run.get("elapsed_s") or {}).items()]
    facts += [(f"cells at {z} m with a ray that leaves the data", f"{share:.1%}") for z, share in shares.items()]
    facts += [("warned", message) for message in run.get("warnings") or ()]
    return table(("of the run", ""), facts) if facts else ""


def _facts(maps: MetricMaps, altitude_m: float) -> dict[str, float]:
    """Return the means over free cells at an altitude, NaN without a free cell."""
    is_free = maps.is_free(altitude_m, "centre")
    gps, lidar = maps.m("gps", altitude_m), maps.m("lidar", altitude_m)
    shown = {"mean m_gps": gps, "mean m_lidar": lidar, "mean m_risk": maps.m("risk", altitude_m)}
    shown["GPS better"] = maps.prefers_gps(altitude_m)
    if "gdop" in maps.ds:  # a long series keeps no DOPs
        gdop = maps.m("gdop", altitude_m)
        shown |= {"good GPS": rating(gdop) <= Rating.GOOD, "too few satellites": ~np.isfinite(gdop)}
    facts = {"altitude (m)": altitude_m, "obstacle cells": 1 - float(is_free[maps.ds["has_data"].values].mean())}
    for name, values in shown.items():
        facts[name] = float(values[is_free].mean(dtype=np.float64)) if is_free.any() else np.nan
    varies = is_free.any() and all(np.ptp(values[is_free]) > 0 for values in (gps, lidar))
    correlation = float(np.corrcoef(gps[is_free], lidar[is_free])[0, 1]) if varies else np.nan
    return facts | {"correlation of m_gps and m_lidar": correlation}


def _population(maps: MetricMaps, run: Mapping[str, Any]) -> str:
    rows = []
    for item in maps.times_of_day:
        density = maps.m("density", time_of_day=item)
        num_people = np.nansum(density, dtype=np.float64) * maps.grid.resolution_m**2 / 1e6
        row = {"time of day": item, "people in the maps": f"{num_people:,.0f}"}
        row |= {"densest cell (per km²)": f"{np.nanmax(density):,.0f}"}
        rows.append(row | dict((run.get("population") or {}).get(item) or {}))
    words = "Columns of districts, where there are any, count whole census blocks that touch the region."
    return "\n\n".join(("## Population", words, framed(pd.DataFrame(rows))))


def _paths(maps: MetricMaps, planned: Sequence[PlannedPath]) -> str:
    rows = []
    for path in planned:
        best = min(other.cost for other in planned if other.altitude_m == path.altitude_m)
        row = {"altitude (m)": path.altitude_m, "time of day": path.settings["time_of_day"] or "-"}
        row |= {"planner": path.search.planner, "graph": path.search.graph or "-", "status": path.status.value}
        row["search (s)"] = path.search.elapsed_s
        if path.status.has_path:
            row |= {"cost": path.cost, "above the cheapest": path.cost / best - 1 if best > 0 else np.nan}
            row |= {"length (m)": path.length_m, **{f"mean m_{name}": path.metrics[name] for name in maps.metrics}}
        rows.append(row | {"search (s)": path.search.elapsed_s})
    return fill(
        "summary_paths", rules=rules_said(*(path.settings for path in planned)), rows=framed(pd.DataFrame(rows))
    )
