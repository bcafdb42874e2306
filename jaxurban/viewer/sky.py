"""The sky over a place as the page shows it: its figure, and a row for each satellite."""

from html import escape

import pandas as pd

from jaxurban.draw.style import bare
from jaxurban.receivers.along import SkyAt
from jaxurban.receivers.figures import plot_sky, short_name
from jaxurban.viewer.markup import DRAWING, picture, rows, sentences

LISTED = {  # columns of the list, and their headings
    "satellite": "",
    "elevation_deg": "up, °",
    "state": "state",
    "roof_height_m": "roof, m",
    "roof_distance_m": "away, m",
}
WIDE_MM = 69.0  # of the picture, which has the width of the page's controls


def sky_html(sky: SkyAt) -> str:
    """Return the sky at a place and one time as HTML: picture, facts, a line for each satellite, and cautions."""
    facts = {name: sky.facts[name] for name in ("satellites", "HDOP")}
    text = f"Sky over {sky.facts['place']}: {facts['satellites']}"
    with DRAWING:
        image = picture(bare(plot_sky(sky, width=WIDE_MM)), text)
    return (
        f"{image}<table>{rows(facts.items())}</table><pre>{escape(_listed(sky.table))}</pre>"
        f"{sentences((caution.level, caution) for caution in sky.cautions)}"
    )


def _listed(table: pd.DataFrame) -> str:
    """Return a line of text for each satellite, the highest first, below a line of headings (`LISTED`).

    Roof and distance are those of the roof that hides it, if one does; a hidden one without these is behind the ground.

    Args:
      table: a row for each satellite, as `SkyAt.table`.
    """
    table = table.assign(satellite=table["satellite"].map(short_name))
    table = table.sort_values("elevation_deg", ascending=False)[[*LISTED]]
    number = "{:.0f}".format
    return table.to_string(index=False, header=[*LISTED.values()], float_format=number, na_rep="")
