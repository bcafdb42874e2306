"""Markdown of reports: templates, tables, lists and numbers."""

import math
import re
from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import Any

import pandas as pd


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
