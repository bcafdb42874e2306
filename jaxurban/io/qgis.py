"""QGIS styles of maps: the colours and ranges of our figures, a file for each variable."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr

from jaxurban.metrics.custom import held_metrics
from jaxurban.metrics.gps import DOPS, WEIGHTED_DOPS
from jaxurban.metrics.protection import LEVELS, WITHIN_LIMITS

COLOUR_MAPS = {  # of Matplotlib, at 17 places from low to high
    "viridis": "44015448186a472d7b4240863b528b33638d2c728e26828e21918c1fa08828ae803fbc735ec96284d44baddc30d8e219fde725",
    "plasma": "0d08873105974c02a16600a77e03a89511a1aa2395bc3587cc4778da5a6ae66c5cf0804ef89540fdac33fdc527f8df25f0f921",
    "magma": "0000040a08221d114736106b51127c6a1c818326819c2e7fb73779d0416fe75263f56b5cfc8961fea772fec488fde2a3fcfdbf",
    "inferno": "0000040b0724210c4a3d096557106e71196e8a226aa32c61bc3754d24644e45a31f1731df98e09fcac11f9cb35f2ea69fcffa4",
    "cividis": "00224e002e6a1a386f32436d434e6c535a6d61656f6f70737d7c788c88789b9476aba072bcae6ccdbb63dec958f0d846fee838",
}
NUM_PLACES = 17
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


def colours_of(colour_map: str, plain: str = "#333333") -> list[str]:
    """Return a colour map at `NUM_PLACES` places; of one that is not ours, from white to the ``plain`` colour."""
    name = colour_map.removesuffix("_r")
    if name in COLOUR_MAPS:
        packed = COLOUR_MAPS[name]
        colours = [f"#{packed[i : i + 6]}" for i in range(0, 6 * NUM_PLACES, 6)]
    else:
        end = np.array([int(plain[i : i + 2], 16) for i in (1, 3, 5)])
        shades = (np.rint(255 + (end - 255) * share).astype(int) for share in np.linspace(0, 1, NUM_PLACES))
        return ["#{:02x}{:02x}{:02x}".format(*shade) for shade in shades]
    return colours[::-1] if colour_map.endswith("_r") else colours


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
    return Scale(places, colours_of(metrics[of].colour_map, metrics[of].colour))


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
