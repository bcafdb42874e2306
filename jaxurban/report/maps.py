"""summary.md: what the maps and paths of a run show, for a reader new to them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxurban.io.attributes import names_in
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.rating import Rating, rating
from jaxurban.paths.path import PlannedPath
from jaxurban.planners.base import Status
from jaxurban.report.figures.files import maps_figures
from jaxurban.report.figures.metrics import AVAILABILITY, LOW
from jaxurban.report.figures.notes import caveats_said, rules_said
from jaxurban.report.figures.protection import protection_texts
from jaxurban.report.markdown import bullets, fill, listed, table

Paths = Mapping[float, Sequence[PlannedPath]]
Facts = Mapping[str, float]

ORIGINS = {  # of heights, by the names that run.json uses
    "height": "a height tag",
    "levels": "their number of levels",
    "default": "the default",
    "raster": "a height raster",
    "generated": "the generator",
}


def summary_markdown(maps: MetricMaps, paths: Paths, run: Mapping[str, Any] | None = None) -> str:
    """Return the summary of one region's maps and paths as Markdown; every number is taken from them.

    Pictures are named as `jaxurban.report.figures.save_figures` names them, in a folder ``figures`` beside the
    summary. Means and shares by altitude are over free cells, at the first time.

    Args:
      maps: from `build_maps` or `open_maps`.
      paths: paths by altitude; may be empty.
      run: what run.json holds; what it lacks is left out.
    """
    facts, run, grid = [_facts(maps, z) for z in maps.altitudes_m], run or {}, maps.grid
    west, south = grid.lonlat_of_xy(grid.x_min_m, grid.y_min_m)
    east, north = grid.lonlat_of_xy(grid.x_max_m, grid.y_max_m)
    roof_m = maps.m("roof")[maps.ds["has_data"].values]
    times = listed(time.replace("T", " ").replace("Z", " UTC") for time in maps.times[:3])
    text = fill(
        "summary",
        width_km=(grid.x_max_m - grid.x_min_m) / 1000,
        height_km=(grid.y_max_m - grid.y_min_m) / 1000,
        west=west,
        south=south,
        east=east,
        north=north,
        grid=grid,
        altitudes=listed(f"{z:g}" for z in maps.altitudes_m),
        roofed=_percent(float((roof_m > 0).mean())),
        highest_m=roof_m.max(),
        buildings=_building_sentence(run),
        num_satellites=len(names_in(maps.ds.attrs, "satellites")),
        times=f"{times} and {len(maps.times) - 3} more epochs." if len(maps.times) > 3 else f"{times}.",
        sources="".join(f"\n- {line}" for line in _source_lines(run)),
        by_altitude=_altitude_table(facts),
        population=_population_section(maps, run),
        what="Metric maps and paths" if any(paths.values()) else "Metric maps",
        paths=_path_section(maps, paths),
        pictures=_pictures(maps, paths),
        cautions="".join(f"\n- {line}" for line in (*caveats_said(maps), *_cautions(run))),
    )
    return f"{text}\n"


def _look_up(run: Mapping[str, Any], *keys: str) -> Any:
    """Return a value of nested dicts, None where a key is missing."""
    value: Any = run
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.1f} %"


def _thousandths(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3f}"


def _facts(maps: MetricMaps, altitude_m: float) -> Facts:
    """Return the means over free cells at an altitude, NaN without a free cell."""
    is_free = maps.is_free(altitude_m, "centre")
    has_data = maps.ds["has_data"].values
    facts = {"altitude_m": altitude_m, "obstacle": 1 - float(is_free[has_data].mean())}

    def mean(values: np.ndarray) -> float:
        return float(values[is_free].mean(dtype=np.float64)) if is_free.any() else float("nan")

    gps, lidar = maps.m("gps", altitude_m), maps.m("lidar", altitude_m)
    facts |= {"gps": mean(gps), "lidar": mean(lidar), "risk": mean(maps.m("risk", altitude_m))}
    facts["gps_preferred"] = mean(maps.prefers_gps(altitude_m))
    gdop = maps.m("gdop", altitude_m) if "gdop" in maps.ds else None  # a long series keeps no DOPs
    facts["good"] = float("nan") if gdop is None else mean(rating(gdop) <= Rating.GOOD)
    facts["undetermined"] = float("nan") if gdop is None else mean(~np.isfinite(gdop))
    spread = gps[is_free], lidar[is_free]
    varies = is_free.any() and all(np.ptp(values) > 0 for values in spread)
    facts["correlation"] = float(np.corrcoef(*spread)[0, 1]) if varies else float("nan")
    return facts


def _source_lines(run: Mapping[str, Any]) -> list[str]:
    lines, sources, seconds = [], _look_up(run, "inputs"), _look_up(run, "elapsed_s")
    if sources:
        named = listed(f"{role} from `{source['path']}`" for role, source in sources.items())
        lines.append(f"**Sources:** {named}.")
    if seconds:
        slowest = max(seconds, key=seconds.get)
        lines.append(
            f"**Time:** {sum(seconds.values()):.1f} s in all, most of it in `{slowest}` ({seconds[slowest]:.1f} s)."
        )
    return lines


def _building_sentence(run: Mapping[str, Any]) -> str:
    number, origins = _look_up(run, "buildings", "in_region"), _look_up(run, "buildings", "height_origin_counts")
    if not number:
        return ""
    counts = [f"{count:,} from {ORIGINS.get(name, name)}" for name, count in (origins or {}).items()]
    return f" {number:,} buildings stand in the region" + (f", heights of {listed(counts)}." if counts else ".")


def _altitude_table(facts: Sequence[Facts]) -> str:
    columns: dict[str, tuple[str, Callable[[float], str]]] = {
        "altitude (m)": ("altitude_m", "{:g}".format),
        "obstacle cells": ("obstacle", _percent),
        "mean m_gps": ("gps", _thousandths),
        "GPS good or better": ("good", _percent),
        "mean m_lidar": ("lidar", _thousandths),
        "GPS better": ("gps_preferred", _percent),
        "mean m_risk": ("risk", _thousandths),
        "too few satellites": ("undetermined", _percent),
        "correlation of m_gps and m_lidar": ("correlation", lambda value: "-" if np.isnan(value) else f"{value:.2f}"),
    }
    return table(columns, [[show(fact[name]) for name, show in columns.values()] for fact in facts])


def _population_section(maps: MetricMaps, run: Mapping[str, Any]) -> str:
    if not maps.times_of_day:
        return ""
    cell_km2 = maps.grid.resolution_m**2 / 1e6
    rows = []
    for item in maps.times_of_day:
        density = maps.m("density", time_of_day=item)
        num_people = np.nansum(density, dtype=np.float64) * cell_km2
        zones = [_look_up(run, "population", item, zone) for zone in ("commercial", "residential", "other")]
        shown = ["-" if count is None else f"{count:,.0f}" for count in zones]
        rows.append([item, f"{num_people:,.0f}", f"{np.nanmax(density):,.0f}", *shown])
    head = ["time of day", "people in the maps", "densest cell (per km²)", "commercial", "residential", "other"]
    words = "The last three columns count whole census blocks that touch the region, by what their district is for."
    return "\n\n".join(("## Population", words, table(head, rows)))


def _path_section(maps: MetricMaps, paths: Paths) -> str:
    planned = [path for z in maps.altitudes_m for path in paths.get(z, ())]
    if not planned:
        return ""
    rows = []
    for path in planned:
        best = min(other.cost for other in paths[path.altitude_m])
        cells = [f"{path.altitude_m:g}", path.settings["time_of_day"] or "-", path.search.planner, path.status.value]
        if path.status.has_path:
            cells += [
                f"{path.cost:,.1f}",
                _percent(path.cost / best - 1 if best > 0 else np.nan),
                f"{path.length_m:,.0f}",
            ]
            cells += [f"{path.metrics[name]:.3f}" for name in maps.metrics]
        else:
            cells += ["-"] * (3 + len(maps.metrics))
        rows.append([*cells, f"{path.search.elapsed_s:.3f}"])
    head = ["altitude (m)", "time of day", "planner", "status", "cost", "above the cheapest", "length (m)"]
    head += [f"mean m_{name}" for name in maps.metrics] + ["search (s)"]
    words = (
        "Means are along the path, by length. The cost is the weighted sum that all planners are judged by "
        f"(it has no unit). Planned under: {rules_said(*(path.settings for path in planned))}."
    )
    model = planned[0].settings["cost_model"]
    if model == "cell" and any(path.search.planner.startswith("bitstar") for path in planned):
        words += (
            " The model counts the maps once a step, and a grid planner's diagonal step is one step of 1.41 cells, "
            "so grid paths look cheaper than straight ones: the model `line` compares planners fairly."
        )
    graphs = dict.fromkeys(path.search.graph for path in planned if path.status is Status.OPTIMAL and path.search.graph)
    if graphs:
        words += (
            f" *{Status.OPTIMAL.value}* says that no path of the planner's own graph is cheaper, here "
            f"{listed(f'the {graph}' for graph in graphs)}: a planner that searches others may find a cheaper one."
        )
    return "\n\n".join(("## Paths", words, table(head, rows)))


def _pictures(maps: MetricMaps, paths: Paths) -> str:
    texts = {
        "heights": "roof heights on a square-root scale, so that houses and towers can both be told apart.",
        "obstacle": "the cells that no path may cross.",
        "gps": "how well satellites fix a position.",
        "gps_rating": "the same as classes of GDOP.",
        "lidar": "how much of a scan returns from buildings: lidar needs walls within its range.",
        "sensor_choice": "which of GPS and lidar serves better.",
        "risk": "the distance to the nearest obstacle, up to the threshold.",
        "population": "people per km² on a logarithmic scale, the same for every time of day.",
    }
    total = (
        f"the sum of the costs of {listed(maps.metrics)}, each weighing 1, from black (best) to white (worst) on one "
        "scale for all altitudes"
    )
    over = "with every planner's path over it; where paths coincide, the later one is drawn narrower"
    epochs = f"the {len(maps.times)} epochs"
    texts |= {"paths": f"{total}, {over}.", "cost": f"{total}."}
    texts |= {f"cost_{name}": f"{total}, by {name}." for name in maps.times_of_day}
    texts["gps_epochs"] = f"GPS quality at each of {epochs}, at the lowest altitude."
    texts[AVAILABILITY] = f"at how many of {epochs} GPS is good enough, as a share."
    texts[LOW] = f"the GPS quality that 5 % of {epochs} stay below."
    texts |= protection_texts(maps)
    drawn = maps_figures(maps, paths)
    return bullets(f"[`{name}.png`](figures/{name}.png): {text}" for name, text in texts.items() if name in drawn)


def _cautions(run: Mapping[str, Any]) -> list[str]:
    lines, shares = [], _look_up(run, "rays_leave_data_share")
    if shares and max(shares.values()) > 0:
        worst = max(shares, key=shares.get)
        lines.append(
            f"At {worst} m, {_percent(shares[worst])} of the cells have a satellite ray that leaves the building "
            "data before it is above every roof; GPS may look better there than it is."
        )
    return lines + [f"Warned during the run: {message}" for message in _look_up(run, "warnings") or ()]
