"""Runs the notebooks of this folder top to bottom, each in a process of its own; the first cell that fails ends it.

``python notebooks/run_all.py [-o FOLDER] [NAME ...]`` runs all, or those whose names begin so. With ``-o`` the
notebooks are kept there as they ran, with their output, to be opened in Jupyter.
"""

import argparse
import sys
import time
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

MOST_S = 480  # a cell; seconds on an idle machine, minutes on a busy one
QUIET = ["--IPKernelApp.log_level=CRITICAL"]  # it tells of its own transport and end


def main() -> int:
    """Execute the notebooks in the order of their names."""
    parser = argparse.ArgumentParser(description="Run the notebooks top to bottom.")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="beginnings of names; left out: all notebooks"
    )
    parser.add_argument("-o", "--out", type=Path, help="keep the executed notebooks in this folder")
    asked = parser.parse_args()
    folder = Path(__file__).parent
    sources = [
        source
        for source in sorted(folder.glob("*.py"))
        if source.name != Path(__file__).name and source.name.startswith(tuple(asked.names) or "")
    ]
    if not sources:
        parser.error(f"no notebook is named {' or '.join(asked.names)}")
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
    first = time.perf_counter()
    for source in sources:
        began = time.perf_counter()
        notebook = jupytext.read(source)
        where = {"metadata": {"path": str(folder)}}
        NotebookClient(notebook, timeout=MOST_S, resources=where, extra_arguments=QUIET).execute()
        print(f"{source.name}: ran in {time.perf_counter() - began:.0f} s", flush=True)
        if asked.out is not None:
            nbformat.write(notebook, asked.out / f"{source.stem}.ipynb")
    print(f"{len(sources)} notebooks ran in {time.perf_counter() - first:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
