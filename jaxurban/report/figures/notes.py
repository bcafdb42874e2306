"""The lines below a figure's heading: what was guessed, the sky, the cells, the CRS, and whom to credit."""

import re
from collections.abc import Mapping
from typing import Any

from jaxurban.io.read.guesses import is_of_sky
from jaxurban.maps.metric_maps import MetricMaps
from jaxurban.metrics.gps import Gps
from jaxurban.metrics.variables import CAVEAT, names_in
from jaxurban.paths.constraints import clearances_said, kept_said
from jaxurban.world.grid import Grid

GAP = "  ·  "  # between two facts of a line
MOST_RULES = 2  # weights, or the like, of the routes of one picture


def frame_note(maps: MetricMaps, time: str | None = None, *, has_sky: bool = True, of: str | None = None) -> str:
    """Return the lines below a figure's heading: caveats and guesses, if any; the sky, cells, CRS, place, credit.

    ``has_sky``: the figure shows something of GPS, at a time or, left out, over all times of a series; guesses of the
    sky and caveats stand only there. ``of``: the map that is shown alone.
    """
    sky = sky_said(maps, time) if has_sky else ""
    caveats = caveats_said(maps, of) if has_sky else []
    guessed = [f"Guessed: {guesses}"] if (guesses := guesses_said(maps, has_sky)) else []
    return "\n".join([*caveats, *guessed, joined(sky, *ground_said(maps))])


def rules_said(*settings: Mapping[str, Any]) -> str:
    """Return what routes were planned under, from their settings: cost model, weights, obstacles and clearances."""
    rules: dict[str, list[str]] = {"cost model": [], "weights": [], "obstacles": []}
    for each in settings:
        weights = ", ".join(f"{name} {weight:g}" for name, weight in each["weights"].items())
        rules["cost model"].append(each["cost_model"])
        rules["weights"].append("the distance alone" if each["objective"] == "distance" else weights)
        clearances = [*clearances_said(each["limits"]), kept_said(each["limits"], each["resolution_m"])]
        rules["obstacles"].append(", ".join(filter(None, [each["obstacles"], *clearances])))
    distinct = {name: list(dict.fromkeys(values)) for name, values in rules.items() if values}
    return joined(
        *(
            f"{name}: {' or '.join(values[:MOST_RULES])}{' ...' * (len(values) > MOST_RULES)}"
            for name, values in distinct.items()
        )
    )


def caveats_said(maps: MetricMaps, of: str | None = None) -> list[str]:
    """Return what a reader must know of a map, or left out of all metrics that these maps hold."""
    names = [maps.variable(name) for name in ((of,) if of else maps.metrics)]
    return list(dict.fromkeys(said for name in names if name in maps.ds and (said := maps.ds[name].attrs.get(CAVEAT))))


def guesses_said(maps: MetricMaps, has_sky: bool) -> str:
    """Return the names of what maps rest on that no file says; those of satellites where the figure shows GPS."""
    return ", ".join(name for name in maps.guesses if has_sky or not is_of_sky(name))


def ground_said(maps: MetricMaps) -> tuple[str, ...]:
    """Return the size of a cell, the CRS, where on Earth the maps lie, and whom to credit."""
    return f"{maps.grid.resolution_m:g} m cells", maps.grid.crs, place_said(maps.grid), maps.attribution


def joined(*facts: str | None) -> str:
    """Return facts as one line, without those that are empty."""
    return GAP.join(filter(None, facts))


def place_said(grid: Grid) -> str:
    """Return where on Earth a grid lies: its centre, to about 100 m."""
    lon, lat = grid.centre_lonlat
    return f"around {abs(lat):.3f}°{'N' if lat >= 0 else 'S'} {abs(lon):.3f}°{'E' if lon >= 0 else 'W'}"


def symbol_of(name: str) -> str:
    """Return m with the name of a metric below it, as Matplotlib writes mathematics."""
    written = name.replace("_", "\\_")  # else what follows would be a subscript of its own
    return f"$m_\\mathrm{{{written}}}$"


def availability_threshold(maps: MetricMaps) -> float:
    """Return the m_gps above which a position counts as available: that of the maps, or what it is if not set."""
    return float(maps.ds.attrs.get("gps_availability_threshold", Gps().availability_threshold))


def meaning_of(maps: MetricMaps, name: str, said: str = "") -> str:
    """Return what a value of one means, with these maps' own numbers; ``said`` where they do not say."""
    attrs, name = maps.ds.attrs, maps.variable(name)
    meaning = str(maps.ds[name].attrs.get("one_means", said) if name in maps.ds else said)
    threshold = f"{availability_threshold(maps):g}" if name.endswith("_availability") else ""
    if f"{name}_threshold_m" in attrs:
        threshold = f"{attrs[f'{name}_threshold_m']:g} m"
    meaning = meaning.replace("the threshold", threshold or "the threshold")
    for limit in re.findall(r"\w+_limit_m", meaning):
        meaning = meaning.replace(limit, f"{attrs[limit]:g} m")
    for norm, unit in (("pop_norm_per_km2", " per km²"), ("pop_norm_per_block", "")):
        if norm in attrs:
            numbers = " and ".join(f"{number:,.0f}" for number in dict.fromkeys(attrs[norm]))
            meaning = meaning.replace(f"({norm})", f"({numbers}{unit})")
    return meaning


def time_said(time: str) -> str:
    """Return an ISO time in words: date, hour and minute."""
    return f"{time[:10]} {time[11:16]} UTC"


def sky_said(maps: MetricMaps, time: str | None) -> str:
    """Return the time of GPS maps, or the first and last of all of them, and the constellations."""
    times = maps.times if time is None or maps.default_time is None else (time,)
    span = f"{len(times)} epochs, {time_said(times[0])} to {time_said(times[-1])}"
    systems = " and ".join(name.upper() for name in names_in(maps.ds.attrs, "constellations"))
    return ", ".join(filter(None, (time_said(times[0]) if len(times) == 1 else span, systems)))
