"""QGIS styles of maps: the colours and ranges of our figures, a file for each variable."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.colors import to_hex

from jaxurban.metrics.custom import held_metrics
from jaxurban.metrics.gps import DOPS, WEIGHTED_DOPS
from jaxurban.metrics.protection import LEVELS, WITHIN_LIMITS

NUM_PLACES = 17  # of a colour map, from low to high
HIGHEST_DOP = 20.0  # where the paper's rating turns poor
CLASSES = {  # of variables that are 0 or 1: name and colour of each
    "obstacle": (("free", "#f4f4ee"), ("obstacle", "#4a4a4a")),
    "has_data": (("no data", "#bdbdbd"), ("data", "#f4f4ee")),
    WITHIN_LIMITS: (("beyond an alert limit", "#d55e00"), ("within both alert limits", "#f4f4ee")),
    "roof_guessed": (("height known, or no roof", "#f4f4ee"), ("height guessed", "#d55e00")),
}


class Scale(NamedTuple):
    """Colours of values: ``values`` ascending, and ``colours`` as ``#rrggbb``, linear in between."""

    values: np.ndarray
    colours: Sequence[str]


def colours_of(colour_map: str) -> list[str]:
    """Return a colour map of Matplotlib at `NUM_PLACES` places."""
    return [to_hex(colour) for colour in matplotlib.colormaps[colour_map](np.linspace(0, 1, NUM_PLACES))]


def scale_of(ds: xr.Dataset, name: str) -> Scale:
    """Return how a variable of maps is coloured; its values are read where the range depends on them."""
    places = np.linspace(0, 1, NUM_PLACES)
    if name in (*DOPS, *WEIGHTED_DOPS):
        return Scale(1 + (HIGHEST_DOP - 1) * places, colours_of("viridis_r"))
    if name in LEVELS:
        limit_m = ds.attrs["horizontal_alert_limit_m" if name == "hpl" else "vertical_alert_limit_m"]
        return Scale(2 * limit_m * places, colours_of("cividis_r"))
    if name == "num_visible":
        return Scale(max(4.0, _ends(ds, name)[1]) * places, colours_of("viridis"))
    if name == "density":
        highest = max(1.0, _ends(ds, name)[1])
        return Scale(highest * 1000 ** (places - 1), colours_of("magma_r"))
    if name in ("roof", "roof_touched"):
        return Scale(max(1.0, _ends(ds, name)[1]) * places**2, colours_of("cividis"))
    if name == "terrain":
        low, high = _ends(ds, name)
        return Scale(low + max(high - low, 1.0) * places, colours_of("cividis"))
    metrics = held_metrics(ds)
    of = name if name in metrics else next((held for held in metrics if name.startswith(f"{held}_")), "")
    if not of:
        return Scale(places, colours_of("cividis"))
    return Scale(places, colours_of(metrics[of].colour_map))


def _ends(ds: xr.Dataset, name: str) -> tuple[float, float]:
    """Return the lowest and the highest value of a variable, 0 where there is none; a layer is read at a time."""
    lows, highs = [], []
    for index in np.ndindex(ds[name].shape[:-2]):
        values = ds[name].variable[index].values
        values = values[np.isfinite(values)]
        if values.size:
            lows.append(float(values.min()))
            highs.append(float(values.max()))
    return min(lows, default=0.0), max(highs, default=0.0)


def style(ds: xr.Dataset, name: str, note: str) -> str:
    """Return the QGIS style (QML) of a variable of maps.

    Args:
      ds: the maps.
      name: of the variable.
      note: a comment in the file.
    """
    if name in CLASSES:
        entries = "".join(
            f'<paletteEntry value="{value}" color="{colour}" alpha="255" label={quoteattr(label)}/>'
            for value, (label, colour) in enumerate(CLASSES[name])
        )
        renderer = f'type="paletted"><rasterTransparency/><colorPalette>{entries}</colorPalette>'
    else:
        values, colours = scale_of(ds, name)
        low, high = float(values[0]), float(values[-1])
        items = "".join(
            f'<item value="{value!r}" color="{colour}" alpha="255" label="{value:.4g}"/>'
            for value, colour in zip(values.tolist(), colours, strict=True)
        )
        renderer = (
            f'type="singlebandpseudocolor" classificationMin="{low!r}" classificationMax="{high!r}">'
            '<rasterTransparency/><rastershader><colorrampshader colorRampType="INTERPOLATED" classificationMode="1" '
            f'clip="0" minimumValue="{low!r}" maximumValue="{high!r}">{items}</colorrampshader></rastershader>'
        )
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        f'<qgis version="3.28.0" styleCategories="Symbology">\n<!-- {note} -->\n<pipe>\n'
        f'<rasterrenderer band="1" opacity="1" alphaBand="-1" nodataColor="" {renderer}</rasterrenderer>\n'
        "</pipe>\n<blendMode>0</blendMode>\n</qgis>\n"
    )
