"""The sky over a place as the page shows it: a round picture, and a row for each satellite."""

from html import escape
from itertools import cycle

import numpy as np
import pandas as pd

from jaxurban.draw.style import INK, SERIES_COLOURS
from jaxurban.receivers.along import SkyAt
from jaxurban.receivers.figures import EDGE_DEG, ROOFS, short_name
from jaxurban.receivers.rule import HIDDEN, SEEN, UNKNOWN
from jaxurban.viewer.markup import dot, number, rows, sentences

RADIUS, ROUND = 90.0, 360  # of the picture, whose middle is the zenith, a unit a degree; degrees
RIM = 12.0  # around it, for the names of the directions
DIRECTIONS = {"N": 0, "E": 90, "S": 180, "W": 270}


def sky_html(sky: SkyAt) -> str:
    """Return the sky at a place and one time as HTML: picture, key, facts, a line for each satellite, and cautions."""
    dops = sky.dops.iloc[0]

    # A colour for each system of satellites, from the first again where there are more systems than colours.
    systems = dict.fromkeys(sky.table["system"])
    colours = dict(zip(systems, cycle(SERIES_COLOURS), strict=False))

    facts = {
        "Satellites": sky.facts["satellites"],
        "GDOP, HDOP, VDOP": ", ".join(number(dops[name]) for name in ("gdop", "hdop", "vdop")),
    }
    key = " ".join(f"{dot(colours[name])}{escape(name)}" for name in systems)
    if np.isnan(sky.horizon_deg).any():
        key = f"{key} | striped rim: horizon not known"
    return (
        f"{_picture(sky, colours)}<p>{key}</p>"
        f"<table>{rows(facts.items())}</table><pre>{escape(_listed(sky.table))}</pre>"
        f"{sentences((caution.level, caution) for caution in sky.cautions)}"
    )


def _listed(table: pd.DataFrame) -> str:
    """Return a line of text for each satellite, the highest first, below a line of headings.

    A line has the satellite, its elevation, its state, the height of the roof that hides it ("ground" where the ground
    hides it, "" where nothing does or no roof is known), and how far that roof is away.

    Args:
      table: a row for each satellite, as `SkyAt.table`.
    """
    lines = [("", "up", "state", "roof", "away")]
    for _, row in table.sort_values("elevation_deg", ascending=False).iterrows():
        roof_m, away_m = row["roof_height_m"], row["roof_distance_m"]
        roof = away = ""
        if np.isfinite(roof_m):
            roof = f"{roof_m:.0f} m"
        elif row["state"] == HIDDEN:
            roof = "ground"
        if np.isfinite(away_m):
            away = f"{away_m:.0f} m"
        up = f"{row['elevation_deg']:.0f}°"
        lines.append((short_name(row["satellite"]), up, row["state"], roof, away))
    return "\n".join("{:5}{:>4}  {:8}{:>7}{:>8}".format(*line) for line in lines)


def _picture(sky: SkyAt, colours: dict[str, str]) -> str:
    """Return the picture as SVG: north up, buildings around the rim, satellites by system and state.

    Args:
      sky: the sky, with the elevation of its horizon in each whole degree of azimuth, NaN where it is not known.
      colours: a colour of CSS for each system of satellites, by its name.
    """
    # The open sky, white, on a disk of buildings; rings stand at elevations of 60 and 30 degrees and at the border.
    horizon_deg = np.nan_to_num(sky.horizon_deg)
    top = _places(np.arange(ROUND), horizon_deg)
    outline = " ".join(f"{x:.1f},{y:.1f}" for x, y in top)
    parts = [
        f'<circle r="{RADIUS}" fill="{ROOFS}"/>',
        f'<polygon points="{outline}" fill="#fff"/>',
        *(f'<circle r="{ring}" fill="none" stroke="#9a948a"/>' for ring in (30, 60, RADIUS)),
    ]

    # A stripe at the rim for each degree in which the horizon is not known.
    unknown_deg = np.flatnonzero(np.isnan(sky.horizon_deg))
    outer = _places(unknown_deg, np.array(0.0))
    inner = _places(unknown_deg, np.array(EDGE_DEG))
    for (x, y), (x2, y2) in zip(outer, inner, strict=True):
        parts.append(f'<path d="M{x:.1f} {y:.1f}L{x2:.1f} {y2:.1f}" stroke="{INK}"/>')

    # The directions, around the rim.
    for name, azimuth_deg in DIRECTIONS.items():
        x, y = _places(np.array([azimuth_deg]), np.array([-RIM / 2]))[0]
        parts.append(f'<text x="{x:.1f}" y="{y + 3:.1f}" text-anchor="middle">{name}</text>')

    # The satellites: filled where seen, dashed where that is not known.
    places = _places(sky.table["azimuth_deg"].to_numpy(), sky.table["elevation_deg"].to_numpy())
    for (x, y), (_, row) in zip(places, sky.table.iterrows(), strict=True):
        colour = colours[row["system"]]
        fill = colour if row["state"] == SEEN else "#fff"
        dash = ' stroke-dasharray="2"' if row["state"] == UNKNOWN else ""
        title = escape(f"{row['satellite']}, {row['state']}")
        name = escape(short_name(row["satellite"]))
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{fill}" stroke="{colour}" '
            f'stroke-width="1.5"{dash}><title>{title}</title></circle>'
            f'<text x="{x + 5:.1f}" y="{y - 3:.1f}">{name}</text>'
        )

    side = RADIUS + RIM
    box = f"{-side} {-side} {2 * side} {2 * side}"  # around the zenith, which is at 0, 0
    label = f"Sky over {sky.facts['place']}: {sky.facts['satellites']}"
    head = f'class="jv-sky" font-size="8" viewBox="{box}" role="img" aria-label="{escape(label)}"'
    return f"<svg {head}>{''.join(parts)}</svg>"


def _places(azimuth_deg: np.ndarray, elevation_deg: np.ndarray) -> np.ndarray:
    """Return where directions are in the picture: ``[N, 2]`` x to the right and y down, from the zenith.

    Args:
      azimuth_deg: ``[N]`` from north to east.
      elevation_deg: ``[N]``, or one for all; below 0 beyond the rim.
    """
    radius, turn_rad = RADIUS - elevation_deg, np.radians(azimuth_deg)
    return np.stack([radius * np.sin(turn_rad), -radius * np.cos(turn_rad)], axis=-1)
