"""Whether two checkouts compute the same, bit for bit: maps, paths and weight studies, by public names and commands.

``python -m benchmarks.same_results OLD NEW`` prints the differences, or that there are none, and exits with 1 where
there is one. Compared are: every variable of maps of the synthetic city (in memory, in tiles, at finer cells with
bounds and spreads, statistics over time) and of Lower Manhattan (where JAXURBAN_DATA names the data); status, cost,
length, metrics and points of paths by every planner under both cost models, on levels of a volume too; every number of
the tables that ``study`` (BIT* with a fixed number of samples), ``sensitivity`` and ``tune`` write, and of what ``plan
--report --json`` prints. What the clock decides is left out. `benchmarks.public_results` computes one side.
"""

import argparse
import json
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.checkouts import output_of, start
from benchmarks.common import ROOT

PARTS = ("synthetic", "tiled", "studies", "manhattan")
DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT / ".." / "shared" / "data")).resolve()
MOST_SHOWN = 15  # differences of a part
Results = dict[str, dict[str, str]]  # by part and name


def difference(old: str, new: str) -> str:
    """Return two values, and by which share they differ where both are numbers."""
    said = f"{old} -> {new}"
    try:
        before, after = float(old), float(new)
    except ValueError:
        return said
    return f"{said} (by {abs(after - before) / max(abs(before), 1e-300):.1e})"


def compare(old: dict[str, str], new: dict[str, str]) -> list[str]:
    """Return a line for each fact that differs or that one side lacks."""
    lines = [f"{name}: {difference(old[name], new[name])}" for name in old if name in new and old[name] != new[name]]
    lines += [f"{name}: only in OLD ({old[name]})" for name in old if name not in new]
    return lines + [f"{name}: only in NEW ({new[name]})" for name in new if name not in old]


def shown(lines: list[str]) -> list[str]:
    """Return the first differences, and how many names of each kind the others have."""
    if len(lines) <= MOST_SHOWN:
        return lines
    kinds: dict[str, int] = {}
    for line in lines:
        kind = re.sub(r"\d+", "#", line.split(":")[0])
        kinds[kind] = kinds.get(kind, 0) + 1
    most = sorted(kinds.items(), key=lambda item: -item[1])[:MOST_SHOWN]
    return [*lines[:MOST_SHOWN], "... by name:", *(f"  {count} x {kind}" for kind, count in most)]


def results_of(checkouts: list[Path], parts: list[str]) -> list[Results]:
    """Return the results of each checkout, or of the JSON file that stands for one; all are computed at once."""
    os.environ["JAXURBAN_DATA"] = str(DATA)
    work = Path(tempfile.mkdtemp(prefix="same-results-"))
    processes = {
        k: start(checkout, "public_results.py", work / f"{k}" / "files", *parts, caches=work / f"{k}" / "caches")
        for k, checkout in enumerate(checkouts)
        if not checkout.is_file()
    }
    try:
        return [
            json.loads(output_of(processes[k]) if k in processes else checkout.read_text())
            for k, checkout in enumerate(checkouts)
        ]
    finally:
        for process in processes.values():
            process.kill()  # does nothing to one that has ended
            process.wait()
        shutil.rmtree(work, ignore_errors=True)


def main() -> None:
    """Compare what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path, metavar="OLD", help="a checkout, or a file that --keep wrote")
    parser.add_argument("new", type=Path, metavar="NEW")
    parser.add_argument("--only", action="append", choices=PARTS, help="repeatable; default: all")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="write OLD's results to it, for further runs")
    asked = parser.parse_args()
    parts, began_s = asked.only or list(PARTS), time.perf_counter()
    old, new = results_of([asked.old, asked.new], parts)
    if asked.keep:
        asked.keep.write_text(json.dumps(old))
    num_differences = 0
    for part in parts:
        lines = compare(old.get(part, {}), new[part])
        num_differences += len(lines)
        said = f"{len(lines)} differences" if lines else "equal"
        left_out = " (left out: no data)" if part in new[part] else ""
        print(f"{part}: {len(new[part])} facts, {said}{left_out}")
        print("".join(f"  {line}\n" for line in shown(lines)), end="")
    print(f"{time.perf_counter() - began_s:.0f} s", file=sys.stderr)
    sys.exit(1 if num_differences else 0)


if __name__ == "__main__":
    main()
