"""Draw the figures: ``python -m figures`` all of them, ``python -m figures gps volume`` those whose names hold a word.

Each is a module with a ``main``, here or in `figures.paper`, and writes its pictures beside itself. With ``--small``
those of the paper are drawn on coarser cells, under out/figures-small.
"""

import argparse
import importlib
import time
from pathlib import Path

HERE = Path(__file__).parent
HELPERS = {"__main__", "common", "example_paths"}


def names() -> list[str]:
    """Return the modules that draw, the paper's first."""
    files = [file for folder in (HERE / "paper", HERE) for file in sorted(folder.glob("*.py"))]
    return [
        ".".join(file.relative_to(HERE.parent).with_suffix("").parts)
        for file in files
        if file.stem not in HELPERS
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m figures", description=__doc__.splitlines()[0])
    parser.add_argument(
        "words", nargs="*", metavar="WORD", help="draw only what has one of these words in its name"
    )
    parser.add_argument(
        "--small",
        action="store_true",
        help="coarser cells for the paper's, to see that all are drawn",
    )
    words = parser.parse_args().words
    chosen = [name for name in names() if not words or any(word in name for word in words)]
    if not chosen:
        parser.error(
            f"no figure has {' or '.join(words)} in its name: choose from {', '.join(names())}"
        )
    for name in chosen:
        began_s = time.perf_counter()
        print(name, flush=True)
        importlib.import_module(name).main()
        print(f"  {time.perf_counter() - began_s:.0f} s", flush=True)


if __name__ == "__main__":
    main()
