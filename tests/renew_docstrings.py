"""Rewrite what the examples of public docstrings show to what they print now: ``python -m tests.renew_docstrings``.

Each example runs as `tests/test_docstrings.py` runs it; names of public things after the command choose some. What a
person has to mend is printed: examples that raise, and those whose shown output is cut by ``...`` or too wide now.
"""

import doctest
import inspect
import os
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

from jaxurban.errors import GuessWarning
from tests.test_docstrings import PUBLIC, assumed

FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
WIDEST = 120  # characters of a line


class Recorder(doctest.DocTestRunner):
    """Records the examples that print something else, and says which raise."""

    def __init__(self) -> None:
        """Nothing has run yet."""
        super().__init__(verbose=False, optionflags=FLAGS)
        self.changes: list[tuple[doctest.Example, str]] = []

    def report_failure(self, out: Any, test: Any, example: Any, got: str) -> None:
        """Record an example and what it printed."""
        self.changes.append((example, got))

    def report_unexpected_exception(self, out: Any, test: Any, example: Any, exc_info: Any) -> None:
        """Print an example that raised."""
        print(f"! {test.name}: {example.source.strip()} raises {exc_info[1]!r}", file=sys.stderr)


def renew(name: str) -> None:
    """Run the examples of a public name and rewrite its docstring where they print something else."""
    os.chdir(tempfile.mkdtemp())
    raw = PUBLIC[name].__doc__ or ""
    text = inspect.getdoc(PUBLIC[name]) or ""
    recorder = Recorder()
    parsed = doctest.DocTestParser().get_doctest(text, dict(assumed()), name, None, None)
    recorder.run(parsed, out=lambda _: None)
    lines = raw.split("\n")
    for example, got in reversed(recorder.changes):
        first = example.lineno + example.source.count("\n")
        last = first + example.want.count("\n")
        indent = lines[example.lineno].partition(">>>")[0]
        new = [(indent + line).rstrip() for line in got.splitlines()]
        print(f"{name}:", *lines[first:last], *new, sep="\n")
        if "..." in example.want or max(map(len, new)) > WIDEST:
            print("! mend it by hand")
            continue
        lines[first:last] = new
    if not recorder.changes:
        return
    file = Path(inspect.getsourcefile(inspect.unwrap(PUBLIC[name])) or "")
    source = file.read_text(encoding="utf-8")
    if raw not in source:
        print(f"! {name}: its docstring is not in {file} as it stands")
    file.write_text(source.replace(raw, "\n".join(lines)), encoding="utf-8")


def main() -> None:
    """Renew the docstrings that the command line names, or all."""
    warnings.simplefilter("ignore", GuessWarning)
    for name in sys.argv[1:] or PUBLIC:
        renew(name)


if __name__ == "__main__":
    main()
