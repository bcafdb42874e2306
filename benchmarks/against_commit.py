"""One checkout against another on the same work, in turn: has a change made anything slower, or any result another?

``python -m benchmarks.against_commit OLD NEW [--pairs 15] [--only NAME]`` runs each workload of `benchmarks.workloads`
as a fresh process of OLD and of NEW in turn, so that the machine's other load hits both alike; what is compiled is
compiled in a process before the first pair. Prints a row for each measured part: both medians, the median of the pairs'
ratios, new over old, and its 95 % interval from a bootstrap over the pairs. Then it compares every result of both
sides, and exits with 1 where one differs. Each side reads maps that it made itself, once, under ``--maps``.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT
from benchmarks.workloads import WORKLOADS
from jaxurban.statistics.bootstrap import Clusters

XLA_CACHE = (
    ROOT / "out" / "compiled"
)  # of all checkouts: JAX finds programs in it by what they compute
WHOLE_COMMANDS = ("studies", "memory", "first", "tokyo", "paper")
FEW_PAIRS = 3  # of these
MOST_SHOWN = 15  # differences of a workload
Pair = tuple[float, float]  # of OLD and NEW


def interval(ratios: np.ndarray, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the median of ratios ``[P]``; NaN with too few of them."""
    return Clusters(np.arange(len(ratios)), seed=seed).interval(ratios, "median")[1:]


def row(name: str, pairs: list[Pair]) -> str:
    """Return a table row of one measured part."""
    old, new = np.array(pairs).T
    low, high = interval(new / old)
    middles = f"{np.median(old):.4g} | {np.median(new):.4g} | {np.median(new / old):.4f}"
    return f"| {name} | {len(pairs)} | {middles} | {low:.4f} to {high:.4f} |"


def difference(old: str, new: str) -> str:
    """Return two values, and by which share they differ where both are numbers."""
    both = f"{old} -> {new}"
    try:
        before, after = float(old), float(new)
    except ValueError:
        return both
    return f"{both} (by {abs(after - before) / max(abs(before), 1e-300):.1e})"


def compare(old: dict[str, str], new: dict[str, str]) -> list[str]:
    """Return a line for each result that differs or that one side lacks."""
    lines = [
        f"{name}: {difference(old[name], new[name])}"
        for name in old
        if name in new and old[name] != new[name]
    ]
    lines += [f"{name}: only in OLD ({old[name]})" for name in old if name not in new]
    return lines + [f"{name}: only in NEW ({new[name]})" for name in new if name not in old]


def run(checkout: Path, maps: Path, name: str, caches: Path) -> dict[str, dict]:
    """Return what a workload took on a checkout's jaxurban, and what came out, in a process of its own.

    What Numba and Python compile is kept in ``caches``, not in the checkout, which stays as it is: Numba does not see a
    change in another file than that of a compiled function, so each state of files has a folder of its own.

    Raises:
      SystemExit: it failed.
    """
    caches.mkdir(parents=True, exist_ok=True)
    # Else every process would compile all libraries to bytecode again: the prefix hides what lies beside them.
    inherited = {
        name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"
    }
    own = {
        "PYTHONPATH": str(checkout.resolve()),
        "PYTHONPYCACHEPREFIX": str(caches / "python"),
        "NUMBA_CACHE_DIR": str(caches / "numba"),
        "JAX_COMPILATION_CACHE_DIR": str(XLA_CACHE),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PLATFORMS": "cpu",
    }
    # -P: names of this folder's files must not hide installed modules.
    command = [
        sys.executable,
        "-P",
        str(ROOT / "benchmarks" / "workloads.py"),
        str(checkout.resolve()),
        str(maps),
        name,
    ]
    done = subprocess.run(
        command, cwd=caches, env=inherited | own, stdout=subprocess.PIPE, text=True
    )
    if done.returncode:
        raise SystemExit(f"failed with code {done.returncode}: {' '.join(command)}")
    return json.loads(done.stdout.splitlines()[-1])


def measure(
    name: str, sides: list[Path], maps: Path, work: Path, num_pairs: int
) -> tuple[list[str], list[str]]:
    """Return the rows of a workload after an untimed run of each of two checkouts, and how their results differ."""
    found: list[list[dict]] = [[], []]
    for number in range(num_pairs + 1):
        # Who comes first changes, so that neither is always the one that finds the machine warm.
        for side in (0, 1) if number % 2 else (1, 0):
            found[side].append(run(sides[side], maps / f"{side}", name, work / f"{side}"))
        print(f"{name}: {number} of {num_pairs} pairs", file=sys.stderr, flush=True)
    took = [[each["took"] for each in runs[1:]] for runs in found]
    parts = [
        part for part in took[0][0] if all(each.get(part) for runs in took for each in runs)
    ]  # of both, and not 0
    rows = [
        row(part, [(old[part], new[part]) for old, new in zip(*took, strict=True)])
        for part in parts
    ]
    return rows, compare(*(runs[-1]["facts"] for runs in found))


def main() -> None:
    """Print the table that the command line asks for, and the differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path, metavar="OLD", help="checkout")
    parser.add_argument("new", type=Path, metavar="NEW", help="checkout")
    parser.add_argument("--pairs", type=int, default=15)
    parser.add_argument(
        "--only",
        action="append",
        choices=WORKLOADS,
        metavar="NAME",
        help=f"of {', '.join(WORKLOADS)}",
    )
    parser.add_argument(
        "--maps", type=Path, default=ROOT / "out" / "workloads", help="kept for further runs"
    )
    asked = parser.parse_args()
    began_s, before, maps = time.perf_counter(), os.getloadavg()[0], asked.maps.resolve()
    work, different = Path(tempfile.mkdtemp(prefix="against-commit-")), False
    try:
        print(
            "| CPU seconds of | pairs | old | new | new / old | 95 % interval |\n|---|---|---|---|---|---|"
        )
        for name in asked.only or WORKLOADS:
            num_pairs = min(asked.pairs, FEW_PAIRS) if name in WHOLE_COMMANDS else asked.pairs
            rows, lines = measure(name, [asked.old, asked.new], maps, work, num_pairs)
            print("\n".join(rows), flush=True)
            if lines:
                different = True
                print(
                    "\n".join([f"{name}: {len(lines)} results differ", *lines[:MOST_SHOWN]]),
                    file=sys.stderr,
                )
    finally:
        shutil.rmtree(work, ignore_errors=True)
    answers = "results differ (above)" if different else "every result is the same"
    print(
        f"\n{time.perf_counter() - began_s:.0f} s; load {before:.1f}, then {os.getloadavg()[0]:.1f}; {answers}"
    )
    sys.exit(different)


if __name__ == "__main__":
    main()
