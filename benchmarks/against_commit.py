"""CPU seconds of one checkout over another's, on the same work, in turn: has a change made anything slower?

``python -m benchmarks.against_commit OLD NEW [--pairs 15] [--only NAME]`` runs each workload of `benchmarks.workloads`
as a fresh process of OLD and of NEW in turn, so that the machine's other load hits both alike. Only the measured part
counts, warm; what is compiled is compiled in a process before the first pair. Prints a row for each part: both medians,
the median of the pairs' ratios, new over old, and its 95 % interval from a bootstrap over the pairs. Each side reads
maps that it made itself, once, under ``--maps``, as neither need read the other's files.
"""

import argparse
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.checkouts import output_of, start
from benchmarks.common import ROOT, load
from jaxurban.studies.bootstrap import draws_of, interval_of, median_of

NAMES = (
    "build_maps",
    "series",
    "supersampled",
    "terrain",
    "gradient",
    "astar",
    "plan_many",
    "bitstar",
    "tune",
    "memory",
    "first",
)
SCRIPT = "workloads.py"
MEMORY_PAIRS = 3  # it hardly varies
Pair = tuple[float, float]  # of OLD and NEW


def interval(ratios: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the median of ratios ``[P]``; NaN with too few of them."""
    return interval_of(ratios, draws_of(len(ratios), seed), len(ratios), median_of)[1:]


def row(name: str, pairs: list[Pair]) -> str:
    """Return a table row of one measured part."""
    old, new = np.array(pairs).T
    low, high = interval(new / old)
    middles = f"{np.median(old):.4g} | {np.median(new):.4g} | {np.median(new / old):.4f}"
    return f"| {name} | {len(pairs)} | {middles} | {low:.4f} to {high:.4f} |"


def measure(name: str, sides: dict[str, Path], maps: Path, work: Path, num_pairs: int) -> dict[str, list[Pair]]:
    """Return the pairs of each measured part of a workload; complains where the sides answer differently.

    Args:
      name: of the workload.
      sides: the checkouts by ``"old"`` and ``"new"``.
      maps: holds what each side reads.
      work: holds each side's caches.
      num_pairs: after an untimed run of each side.
    """
    found: dict[str, list[dict]] = {side: [] for side in sides}
    for number in range(num_pairs + 1):
        # Who comes first changes, so that neither is always the one that finds the machine warm.
        for side in sorted(sides, reverse=bool(number % 2)):
            printed = output_of(start(sides[side], SCRIPT, maps / side, name, caches=work / side))
            found[side].append(json.loads(printed))
        print(f"{name}: {number} of {num_pairs} pairs", file=sys.stderr, flush=True)
    answers = {side: runs[-1].pop("answer") for side, runs in found.items()}
    if len(set(answers.values())) > 1:
        print(f"{name} answers differently: {answers}", file=sys.stderr)
    parts = found["old"][-1]
    return {
        part: [(old[part], new[part]) for old, new in zip(found["old"][1:], found["new"][1:], strict=True)]
        for part in parts
    }


def main() -> None:
    """Print the table that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path, metavar="OLD", help="checkout")
    parser.add_argument("new", type=Path, metavar="NEW", help="checkout")
    parser.add_argument("--pairs", type=int, default=15)
    parser.add_argument("--only", action="append", choices=NAMES, metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--maps", type=Path, default=ROOT / "out" / "workloads", help="kept for further runs")
    asked = parser.parse_args()
    names, began_s, before = asked.only or NAMES, time.perf_counter(), load()
    maps, work = asked.maps.resolve(), Path(tempfile.mkdtemp(prefix="against-commit-"))
    sides = {"old": asked.old, "new": asked.new}
    try:
        for side, checkout in sides.items():
            output_of(start(checkout, SCRIPT, maps / side, *names, "--prepare", caches=work / side))
        print("| CPU seconds of | pairs | old | new | new / old | 95 % interval |\n|---|---|---|---|---|---|")
        for name in names:
            num_pairs = min(asked.pairs, MEMORY_PAIRS) if name == "memory" else asked.pairs
            parts = measure(name, sides, maps, work, num_pairs)
            print("\n".join(row(part, pairs) for part, pairs in parts.items()), flush=True)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"\n{time.perf_counter() - began_s:.0f} s; load {before} before, {load()} after")


if __name__ == "__main__":
    main()
