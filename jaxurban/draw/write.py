"""Writing what a job made: Markdown from templates, tables and pictures under one folder, each file whole."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Formatter
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from jaxurban.io.city import joined_credits
from jaxurban.io.files import whole_file, write_whole
from jaxurban.io.stored import REPORT_FILE
from jaxurban.io.tables import SUFFIXES, write_table
from jaxurban.paths.suffixes import PICTURES
from jaxurban.statistics.conclusions import VERDICTS, Conclusion

DUST = 1e-9  # what a sum of shares or metres leaves by rounding, which is no number
DPI = 300  # of images, which the IEEE asks of colour
NUM_COLOURS = 256  # of a PNG
SAMPLED = 4  # every so many pixels of a side are looked at for these
# A text, a table, or what draws a picture or writes a map.
Output = str | pd.DataFrame | Callable[..., Any]
Outputs = dict[str, Output]  # by file name
Figures = dict[str, Callable[[], Figure]]  # functions that draw pictures, by the pictures' names
Look = dict[str, Any]  # keywords of Matplotlib for the look of what is drawn
# What a text of a file would do in Markdown (patterns), and what it becomes: HTML, columns, code, and links and
# pictures. No HTML begins with "<=" or "< ", which stay as they are, as code shows every letter.
HARMLESS = {r"<(?![= ])": "&lt;", r"\|": "&#124;", "`": "'", r"\]\(": "]&#40;"}


class Markdown(str):
    """A text that is Markdown, in which all texts of files are harmless (`plain`)."""


def plain(text: str) -> Markdown:
    """Return a text on one line, which Markdown shows as it is (`HARMLESS`); Markdown is returned unchanged."""
    if isinstance(text, Markdown):
        return text
    text = " ".join(text.split())
    for mark, harmless in HARMLESS.items():
        text = re.sub(mark, harmless, text)
    return Markdown(text)


def code(value: Any) -> Markdown:
    """Return a value in the letters of code."""
    return Markdown(f"`{plain(str(value))}`")


def paragraphs(*texts: str) -> Markdown:
    """Return texts, each a paragraph, of which those that are no Markdown are harmless."""
    return Markdown("\n\n".join(map(plain, texts)))


class _Harmless(Formatter):
    """What fills templates: texts of fields that are no Markdown are harmless."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return the text of a field."""
        return plain(value if isinstance(value, str) else format(value, format_spec))


def files_of(names: Iterable[str]) -> list[str]:
    """Return the names of the files that `save` writes: of a name without an end, a table, one for each format."""
    return [
        f"{name}{suffix}"
        for name in names
        for suffix in ([""] if Path(name).suffix else reversed(SUFFIXES))
    ]


@dataclass(frozen=True)
class ResultReport:
    """What a result writes: ``tables/NAME``, ``figures/NAME.png``, and last ``report.md``.

    A study's report begins with what it decided (``{lines}``), and all verdicts are a table beside it.

    Attributes:
      template: of ``report.md``, as in `fill`.
      fields: what fills it, as `fill` takes it.
      tables: by name; one whose name has no end is written in each format.
      figures: functions that draw the pictures, by name.
      others: further outputs, by file name.
      key: facts that identify the result; a folder with the result of other facts is not replaced unasked.
      decided: what a study decided.
    """

    template: str
    fields: Mapping[str, Any]
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    figures: Figures = field(default_factory=dict)
    others: Outputs = field(default_factory=dict)
    key: Mapping[str, Any] = field(default_factory=dict)
    decided: Conclusion | None = None

    @property
    def text(self) -> Markdown:
        """The text of ``report.md``."""
        lines = first_lines(self.decided.facts) if self.decided else ""
        return fill(self.template, figures=self.figures, lines=lines, **self.fields)

    @property
    def outputs(self) -> Outputs:
        """What is written, by file name."""
        tables = {f"tables/{name}": table for name, table in self.tables.items()}
        if self.decided:
            tables[VERDICTS] = self.decided.table
        figures = {f"figures/{name}.png": draw for name, draw in self.figures.items()}
        return {**self.others, **tables, **figures, REPORT_FILE: self.text}


def save(folder: str | Path, outputs: Mapping[str, Output]) -> list[Path]:
    """Write outputs by their file names under a folder and return the files.

    Args:
      folder: where to; made if it is not there, as are folders in the names.
      outputs: texts; tables, as CSV or Parquet by the name's end, or as both where it has none; functions that draw a
        picture (`PICTURES`); functions that write the file, a map, that they are given (``.tif``).

    Raises:
      InputError: the folder cannot be written to.
    """
    written = []
    for name, output in outputs.items():
        if isinstance(output, pd.DataFrame):
            written += [write_table(output, Path(folder) / each) for each in files_of([name])]
            continue
        file = Path(folder) / name
        written.append(file)
        if isinstance(output, str):
            write_whole(file, output)
        elif file.suffix.lower() in PICTURES:
            with whole_file(file) as scratch:  # becomes the file once it is whole
                write_picture(output(), scratch, file.suffix.lower())
        else:
            output(file)
    return written


def write_picture(figure: Figure, file: str | Path, suffix: str = "", dpi: float = DPI) -> None:
    """Write a figure: PDF and SVG with text as text, PNG of 256 colours, about a quarter of the size of full colour.

    Args:
      figure: to write.
      file: where to.
      suffix: which of `PICTURES`; left out, the file's.
      dpi: dots an inch of a PNG.
    """
    suffix = suffix or Path(file).suffix.lower()
    if suffix != ".png":
        figure.savefig(file, format=suffix[1:])
        return
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())

    # By coverage, so that rare colours, as of lines and legends, have theirs too: by median cut they would lose them.
    # Then by means, as greys would else have tints; on a part of the pixels, which takes no time.
    part = image.resize([side // SAMPLED for side in image.size], Image.Resampling.NEAREST)
    palette = part.quantize(NUM_COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1)
    few_colours = image.quantize(palette=palette, dither=Image.Dither.NONE)

    # The page, whose colour is that of its corner, stays white.
    colours = np.array(few_colours.getpalette()).reshape(-1, 3)
    colours[np.asarray(few_colours)[0, 0]] = 255
    few_colours.putpalette(colours.ravel().tolist())
    few_colours.save(file, format="png", optimize=True, dpi=(dpi, dpi))


def fill(
    template: str,
    tables: Mapping[str, pd.DataFrame] | None = None,
    figures: Iterable[str] = (),
    credits: Iterable[str] = (),
    guessed: Iterable[str] = (),
    **fields: Any,
) -> Markdown:
    """Return the text of ``jaxurban/TEMPLATE.md`` with its fields filled, as `str.format` does.

    Texts of fields that are no `Markdown` are harmless in it. Paragraphs whose only field is empty are left out.

    Args:
      template: the file in the package, as ``flights/templates/check``.
      tables: what ``{tables[NAME]}`` stands for; a section (from one ## to the next) with a table that is not among
        these, or has no row, is left out.
      figures: names of the pictures that are drawn; the lines of other pictures ``figures/NAME.png`` are left out.
      credits: of the data behind the report; named at its end, each once.
      guessed: what the maps behind it rest on that no file says (`names_of`); said there too.
      fields: all other fields.
    """
    text = (files("jaxurban") / f"{template}.md").read_text(encoding="utf-8")
    texts = {name: framed(table) for name, table in (tables or {}).items() if len(table)}

    # Leave out sections without their tables, and lines of pictures that are not drawn.
    def is_shown(section: str) -> bool:
        """Return whether the report has all tables that a section of the template names."""
        return texts.keys() >= set(re.findall(r"\{tables\[(\w+)\]\}", section))

    text = "\n".join(filter(is_shown, re.split(r"\n(?=## )", text)))
    names = "|".join(map(re.escape, figures)) or "-"  # no picture has the name -
    of_others = rf"^!\[[^\n]*\]\(figures/(?!({names})\.png\))[^\n]*$"
    text = re.sub(of_others, "", text, flags=re.MULTILINE)

    # Fill the fields, close the gaps that empty ones leave, and name the guesses and the credits.
    text = _Harmless().format(text.strip(), tables=texts, **fields)
    text = re.sub(r"\n{3,}", "\n\n", text).strip()
    guesses = "; ".join(dict.fromkeys(filter(None, guessed)))
    ends = {"Guessed in the maps": guesses, "Data": joined_credits(*credits)}
    said = (f"{head}: {plain(each)}" for head, each in ends.items() if each)
    return Markdown("\n\n".join([text, *said]) + "\n")


def table(head: Iterable[str], rows: Iterable[Sequence[Any]]) -> Markdown:
    """Return a table in Markdown; each row has as many values as the head, which `cell` turns into text."""
    names = [plain(str(name)) for name in head]
    lines = [f"| {' | '.join(names)} |", f"|{'---|' * len(names)}"]
    for row in rows:
        cells = [plain(cell(value)) for value in row]
        lines.append(f"| {' | '.join(cells)} |")
    return Markdown("\n".join(lines))


def framed(frame: pd.DataFrame) -> Markdown:
    """Return a table of pandas, a number with its interval (NAME, NAME_low, NAME_high) in one column (`interval`)."""
    names = without_ends(frame)
    rows = ([interval(row, name) for name in names] for row in frame.to_dict("records"))
    return table(names, rows)


def without_ends(frame: pd.DataFrame) -> list[Any]:
    """Return the columns of a table but for the ends of intervals (NAME_low, NAME_high)."""
    intervals = (name for name in frame if f"{name}_low" in frame)
    ends = {f"{name}{end}" for name in intervals for end in ("_low", "_high")}
    return [name for name in frame if name not in ends]


def cell(value: Any) -> str:
    """Return a value of a table: numbers that are not whole with three digits, 0 for dust, nothing for no number."""
    if not isinstance(value, float):
        return value if isinstance(value, str) else str(value)
    if not math.isfinite(value):
        return ""
    if abs(value) < DUST:
        return "0"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def interval(row: Mapping[Any, Any], name: Any, text_of: Callable[[Any], str] = cell) -> str:
    """Return a value of a table's row as text, with its interval where it has one: ``0.42 (0.29 to 0.54)``.

    Args:
      row: values by the names of columns; the ends of the interval are NAME_low and NAME_high, which are missing or NaN
        where there is none.
      name: of the value's column.
      text_of: returns the text of a number.
    """
    text = text_of(row[name])
    low = row.get(f"{name}_low", math.nan)
    if not np.isfinite(low):
        return text
    return f"{text} ({text_of(low)} to {text_of(row[f'{name}_high'])})"


def joined_with_and(items: Iterable[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    *most, last = items
    return f"{', '.join(most)} and {last}" if most else last


def first_lines(lines: Mapping[str, str]) -> Markdown:
    """Return the lines of a study's conclusion (`Conclusion.facts`) as a list; the last of them is a command."""
    *sentences, (head, command) = lines.items()
    texts = [f"**{name.capitalize()}**: {plain(text)}" for name, text in sentences]
    return bullets(map(Markdown, [*texts, f"**{head.capitalize()}**: {code(command)}"]))


def bullets(lines: Iterable[str]) -> Markdown:
    """Return a list, a line each."""
    return Markdown("\n".join(f"- {plain(line)}" for line in lines))
