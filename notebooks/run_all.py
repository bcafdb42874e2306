"""Runs every notebook of this folder top to bottom; the first cell that fails ends it."""

import sys
import time
from pathlib import Path

import jupytext
from nbclient import NotebookClient


def main() -> int:
    """Execute the notebooks in the order of their names."""
    folder = Path(__file__).parent
    sources = sorted(path for path in folder.glob("*.py") if path.name != Path(__file__).name)
    for source in sources:
        began = time.perf_counter()
        NotebookClient(jupytext.read(source), timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
        print(f"{source.name}: ran in {time.perf_counter() - began:.0f} s")
    return 0 if sources else 1


if __name__ == "__main__":
    sys.exit(main())
