"""Writing what a job made: Markdown from templates, tables and pictures under one folder, each file whole."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

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
    written = []
    for name, output in outputs.items():
        file = Path(folder) / name
        if isinstance(output, pd.DataFrame):
            written += [write_table(output, Path(folder) / each) for each in files_of([name])]
            continue
        with whole_file(file) as scratch:
            if isinstance(output, str):
                scratch.write_text(output, encoding="utf-8")
            else:
                write_png(output(), scratch)
        written.append(file)
    return written


def write_png(figure: Figure, file: Path) -> None:
    """Write a figure as PNG of 256 colours, about a quarter of the size of full colour."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    rare_too, plain = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE  # by median cut, lines and legends lose theirs
    image.quantize(NUM_COLOURS, rare_too, kmeans=1, dither=plain).save(file, format="png", optimize=True)


def fill(template: str, **fields: Any) -> str:
    """Return the text of ``jaxurban/report/templates/TEMPLATE.md`` with its fields filled, as `str.format` does.

    Paragraphs whose only field is empty are left out.
    """
    text = (files("jaxurban.report") / "templates" / f"{template}.md").read_text(encoding="utf-8")
    return re.sub(r"\n{3,}", "\n\n", text.strip().format(**fields)).strip()


def table(head: Iterable[str], rows: Iterable[Sequence[Any]], is_aligned: bool = True) -> str:
    """Return a table; cells that are not text as `cell` shows them, columns but the first to the right."""
    names = [str(name) for name in head]
    rule = f"| --- |{' ---: |' * (len(names) - 1)}" if is_aligned else f"|{'---|' * len(names)}"
    lines = [names, *([value if isinstance(value, str) else cell(value) for value in row] for row in rows)]
    first, *others = (f"| {' | '.join(line)} |" for line in lines)
    return "\n".join([first, rule, *others])


def framed(frame: pd.DataFrame) -> str:
    """Return a table of pandas, all columns to the left."""
    return table(frame.columns, frame.itertuples(index=False, name=None), is_aligned=False)


def cell(value: Any) -> str:
    """Return a value of a table: numbers that are not whole with three digits, nothing for no number."""
    if not isinstance(value, float):
        return str(value)
    return "" if not math.isfinite(value) else f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def short(value: float) -> str:
    """Return a number with about three digits, thousands with commas."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def listed(items: Iterable[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    *most, last = items
    return f"{', '.join(most)} and {last}" if most else last


def bullets(lines: Iterable[str]) -> str:
    """Return a list, a line each."""
    return "\n".join(f"- {line}" for line in lines)


def counted(number: int, noun: str, plural: str = "") -> str:
    """Return ``1 instance``, ``2 instances``."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"
