"""Writing what a job made: reports, tables and pictures under one folder, each file whole or not there at all."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from jaxurban.io.files import whole_file
from jaxurban.io.tables import SUFFIXES, write_table

DPI, NUM_COLOURS = 110, 256
Output = str | pd.DataFrame | Callable[[], Figure]  # a text, a table, or what draws a picture


def files_of(names: Iterable[str]) -> list[str]:
    """Return the names of the files that `save` writes for outputs of these names."""
    return [f"{name}{suffix}" for name in names for suffix in ([""] if Path(name).suffix else reversed(SUFFIXES))]


def save(folder: str | Path, outputs: Mapping[str, Output]) -> list[Path]:
    """Write outputs by their file names under a folder and return the files.

    Args:
      folder: where to; made if it is not there, as are folders in the names.
      outputs: texts; tables, as CSV or Parquet by the name's end, or as both where it has none; functions that draw a
        picture, a PNG.

    Raises:
      InputError: the folder cannot be written to.
    """
    files = []
    for name, output in outputs.items():
        file = Path(folder) / name
        if isinstance(output, pd.DataFrame):
            files += [write_table(output, Path(folder) / each) for each in files_of([name])]
            continue
        with whole_file(file) as scratch:
            if isinstance(output, str):
                scratch.write_text(output, encoding="utf-8")
            else:
                write_png(output(), scratch)
        files.append(file)
    return files


def write_png(figure: Figure, file: Path) -> None:
    """Write a figure as PNG of 256 colours, about a quarter of the size of full colour."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    rare_too, plain = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE  # by median cut, lines and legends lose theirs
    image.quantize(NUM_COLOURS, rare_too, kmeans=1, dither=plain).save(file, format="png", optimize=True)
