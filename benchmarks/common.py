"""Timing of two sides in turn, the rows of the table, and what the machine is."""

import importlib.metadata
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import psutil

from jaxurban.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    *("jaxurban", "jax", "jaxlib", "numba", "numpy", "scipy"),
    *("embreex", "opencv-python-headless", "edt", "pyastar2d", "scikit-image", "tcod", "sidereon"),
)


@dataclass(frozen=True)
class Timing:
    """Seconds of one side, of each run after the first.

    Attributes:
      wall_s: of each run.
      cpu_s: of each run, all threads and processes of that side together.
      compile_s: CPU seconds of the first run less those of a later one.
    """

    wall_s: list[float]
    cpu_s: list[float]
    compile_s: float = 0.0

    @property
    def median_cpu_s(self) -> float:
        return float(np.median(self.cpu_s))


Side = Callable[[], tuple[float, float]]  # one run: its wall and its CPU seconds


def clocked(work: Callable[[], object]) -> Side:
    """Return a run of ``work`` in this process; arrays of JAX are waited for."""

    def run() -> tuple[float, float]:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        jax.block_until_ready(work())
        return time.perf_counter() - wall_s, time.process_time() - cpu_s

    return run


def in_turn(sides: dict[str, Side], num_runs: int) -> dict[str, Timing]:
    """Return the timing of each side, run in turn so that the machine's other load hits all alike."""
    first = {name: run() for name, run in sides.items()}
    runs: dict[str, list[tuple[float, float]]] = {name: [] for name in sides}
    for _ in range(num_runs):
        for name, run in sides.items():
            runs[name].append(run())
    timings = {}
    for name, pairs in runs.items():
        wall_s, cpu_s = (list(seconds) for seconds in zip(*pairs, strict=True))
        timings[name] = Timing(wall_s, cpu_s, max(0.0, first[name][1] - float(np.median(cpu_s))))
    return timings


@dataclass(frozen=True)
class Row:
    """One line of the table: our rate over a peer's, on the same work in the same run.

    Attributes:
      name: what is computed.
      peer: who else computes it.
      unit: what is counted.
      num_ours, num_peer: units in a run.
      ours, theirs: the raw timings.
      bar: least ratio asked for, None where none is.
      note: what else was found, such as how far the answers agree.
    """

    name: str
    peer: str
    unit: str
    num_ours: float
    num_peer: float
    ours: Timing
    theirs: Timing
    bar: float | None = None
    note: str = ""

    @property
    def per_cpu_s(self) -> tuple[float, float]:
        """Our rate and the peer's, units a CPU second by the medians."""
        return self.num_ours / self.ours.median_cpu_s, self.num_peer / self.theirs.median_cpu_s

    @property
    def ratio(self) -> float:
        return self.per_cpu_s[0] / self.per_cpu_s[1]


def amount(value: float) -> str:
    """Return a number with three digits and a unit prefix, such as ``1.23 G``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}"
    return f"{value:.3g}"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return rows in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows])


def markdown(rows: list[Row]) -> str:
    """Return the table that ``make bench`` prints: rates and ratios are of CPU seconds."""
    head = [
        "computed",
        "peer",
        "unit",
        "ours a CPU second",
        "peer's",
        "ratio",
        "bar",
        "compiling",
        "note",
    ]
    cells = [
        [
            *(r.name, r.peer, r.unit, *map(amount, r.per_cpu_s), f"{r.ratio:.3g}"),
            *("" if r.bar is None else f"{r.bar:g}", f"{r.ours.compile_s:.2f} s", r.note),
        ]
        for r in rows
    ]
    return table(head, cells)


def version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def machine() -> dict[str, object]:
    """Return what the figures were taken on."""
    model = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(
            (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
            model,
        )
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True
    )
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        "device": jax.devices()[0].device_kind,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
        "commit": commit.stdout.strip() or "unknown",
        "load_averages": [round(value, 2) for value in os.getloadavg()],
    }


def exit_code(command: Callable[[], object]) -> int:
    """Run a command and return 0; print the sentence of an InputError, and return 2."""
    try:
        command()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0
