"""QGIS styles of maps: the colours and ranges of our figures, a file for each variable."""

from xml.sax.saxutils import quoteattr

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.colors import to_hex

from jaxurban.metrics.base import Variable
from jaxurban.metrics.custom import held_variables

NUM_PLACES = 17  # of a colour map, from low to high


def ramp_of(ds: xr.Dataset, variable: Variable) -> tuple[np.ndarray, list[str]]:
    """Return ascending values and their colours, ``#rrggbb`` and linear in between; values are read if they decide."""
    scale, places = variable.scale, np.linspace(0, 1, NUM_PLACES)
    low, span = scale.range(ds.attrs, lambda: _ends(ds, variable.name))
    shares = {"linear": places, "sqrt": places**2, "log": 1000 ** (places - 1)}[scale.stretch]
    return low + span * shares, [to_hex(colour) for colour in matplotlib.colormaps[scale.colour_map](places)]


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


def style(ds: xr.Dataset, name: str) -> str:
    """Return the QGIS style (QML) of a variable of maps.

    Args:
      ds: the maps.
      name: of the variable.
    """
    variable = held_variables(ds)[name]
    if variable.classes:
        entries = "".join(
            f'<paletteEntry value="{value}" color="{colour}" alpha="255" label={quoteattr(label)}/>'
            for value, (label, colour) in enumerate(variable.classes)
        )
        renderer = f'type="paletted"><rasterTransparency/><colorPalette>{entries}</colorPalette>'
    else:
        values, colours = ramp_of(ds, variable)
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
        f'<qgis version="3.28.0" styleCategories="Symbology">\n<pipe>\n'
        f'<rasterrenderer band="1" opacity="1" alphaBand="-1" nodataColor="" {renderer}</rasterrenderer>\n'
        "</pipe>\n<blendMode>0</blendMode>\n</qgis>\n"
    )
