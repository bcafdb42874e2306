"""The lines below a figure's heading: what was guessed, the sky, the cells, the CRS, and whom to credit."""

from jaxurban.maps.metric_maps import MetricMaps

SYSTEMS = {
    **{"gps": "GPS", "galileo": "Galileo", "glonass": "GLONASS"},
    **{"beidou": "BeiDou", "qzss": "QZSS", "navic": "NavIC"},
}


def frame_note(maps: MetricMaps, time: str | None = None, *, has_sky: bool = True) -> str:
    """Return the lines below a figure's heading: guesses, if there are any; the sky, size of a cell, CRS, credit.

    ``has_sky``: the figure shows something of GPS, at a time or, left out, over all times of a series.
    """
    sky = sky_said(maps, time) if has_sky else ""
    credit = maps.ds.attrs.get("attribution", "")
    guessed = f"Guessed: {', '.join(guesses)}\n" if (guesses := maps.ds.attrs.get("guesses")) else ""
    facts = (sky, f"{maps.grid.resolution_m:g} m cells", maps.grid.crs, credit)
    return guessed + "  ·  ".join(filter(None, facts))


def time_said(time: str) -> str:
    """Return an ISO time in words: date, hour and minute."""
    return f"{time[:10]} {time[11:16]} UTC"


def short_time(time: str) -> str:
    """Return an ISO time for the title of a small panel: month, day, hour and minute; the note has the year."""
    return f"{time[5:10]} {time[11:16]}"


def sky_said(maps: MetricMaps, time: str | None) -> str:
    """Return the time of GPS maps, which one it is of several, the constellations, and the satellites in view.

    In view are as many as the freest cell sees at the highest altitude. Without a time: of all of them, the statistics
    of a long series too.
    """
    systems = " and ".join(SYSTEMS.get(name, name) for name in maps.ds.attrs.get("constellations", ()))
    if maps.default_time is None:
        span = f"{time_said(maps.times[0])} to {time_said(maps.times[-1])}"
        told = f" of {systems}" if systems else ""
        num = len(maps.ds.attrs.get("satellites", ()))
        return f"{len(maps.times)} epochs, {span}, m_gps their median; {num} satellites{told}"
    times = maps.times if time is None else (time,)
    told = systems
    if "num_visible" in maps.ds:
        counts = [int(maps.m("num_visible", max(maps.altitudes_m), time=each).max()) for each in times]
        low, high = min(counts), max(counts)
        told = " ".join(filter(None, (f"{low}" if low == high else f"{low} to {high}", systems, "satellites in view")))
    if len(times) > 1:
        when = f"{len(times)} epochs, {time_said(times[0])} to {time_said(times[-1])}"
    else:
        of_all = f" (epoch {maps.times.index(times[0]) + 1} of {len(maps.times)})" if len(maps.times) > 1 else ""
        when = f"{time_said(times[0])}{of_all}"
    return ", ".join(filter(None, (when, told)))
