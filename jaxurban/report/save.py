"""Writing what a job made: reports, tables and pictures under one folder, each file whole or not there at all."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import cKDTree

from jaxurban.io.files import whole_file
from jaxurban.io.tables import SUFFIXES, write_table

DPI, NUM_COLOURS, NUM_ROUNDS = 110, 256, 10
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
    with_palette(np.asarray(canvas.buffer_rgba())[..., :3]).save(file, format="png", optimize=True)


def with_palette(pixels: np.ndarray) -> Image.Image:
    """Return an image of at most 256 colours, chosen by k-means from an octree's.

    Colours weigh less than their pixels (power 0.75), so that lines and legends keep theirs. Tried and dropped:
    the octree alone, which tints greys; median cut, which loses rare colours; dithering, which dots flat areas.

    Args:
      pixels: ``[Y, X, 3]`` uint8.
    """
    packed, index, num_pixels = np.unique(
        pixels.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32), return_inverse=True, return_counts=True
    )
    colours = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=1).astype(float)
    weights = num_pixels**0.75
    octree = Image.fromarray(np.ascontiguousarray(pixels)).quantize(NUM_COLOURS, method=Image.Quantize.FASTOCTREE)
    palette = np.array(octree.getpalette(), float).reshape(-1, 3)
    for _ in range(NUM_ROUNDS):
        nearest = cKDTree(palette).query(colours)[1]
        sums = np.stack([np.bincount(nearest, weights * channel, len(palette)) for channel in colours.T], axis=1)
        share = np.bincount(nearest, weights, len(palette))[:, None]
        palette = np.where(share > 0, sums / np.maximum(share, 1e-9), palette)
    palette = np.round(palette)
    numbers = cKDTree(palette).query(colours)[1].astype(np.uint8)[index]
    image = Image.fromarray(numbers.reshape(pixels.shape[:2]), "P")
    image.putpalette(palette.astype(np.uint8).tobytes())
    return image
