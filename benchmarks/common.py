"""Timing of two sides in turn, the rows of the table, and what the machine is."""

import importlib.metadata
import json
import os
import platform
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import jax
import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    *("jaxurban", "jax", "jaxlib", "numba", "numpy", "scipy"),
    *("embreex", "opencv-python-headless", "edt", "pyastar2d", "scikit-image", "tcod"),
)


@dataclass(frozen=True)
class Timing:
    """Seconds of one side: of the first run less a later one (compiling), and of each run after it.

    Attributes:
      wall_s: of each run.
      cpu_s: of each run, all threads and processes of that side together.
    """

    wall_s: list[float]
    cpu_s: list[float]
    compile_s: float = 0.0

    @property
    def median_s(self) -> float:
        return float(np.median(self.wall_s))

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
    first_s = {name: run()[0] for name, run in sides.items()}
    runs: dict[str, list[tuple[float, float]]] = {name: [] for name in sides}
    for _ in range(num_runs):
        for name, run in sides.items():
            runs[name].append(run())
    timings = {}
    for name, pairs in runs.items():
        wall_s, cpu_s = (list(seconds) for seconds in zip(*pairs, strict=True))
        timings[name] = Timing(wall_s, cpu_s, max(0.0, first_s[name] - float(np.median(wall_s))))
    return timings


@dataclass(frozen=True)
class Row:
    """One line of the table: our rate over a peer's, on the same work in the same run.

    Attributes:
      name: what is computed.
      peer: who else computes it.
      unit: what is counted.
      ours_per_s: units per second.
      peer_per_s: the peer's.
      ratio_cpu: the ratio of units per CPU second, which other load on the machine hardly moves.
      bar: least ratio asked for, None where none is.
      ours, peer_runs: the raw timings.
      note: what else was found, such as how far the answers agree.
    """

    name: str
    peer: str
    unit: str
    ours_per_s: float
    peer_per_s: float
    ratio_cpu: float
    bar: float | None
    ours: Timing
    peer_runs: Timing
    note: str = ""

    @property
    def ratio(self) -> float:
        return self.ours_per_s / self.peer_per_s


def row(
    name: str,
    peer: str,
    unit: str,
    ours: tuple[float, Timing],
    theirs: tuple[float, Timing],
    bar: float | None = None,
    note: str = "",
) -> Row:
    """Return a row from ``(units in a run, timing)`` of both sides."""
    ours_per_s, peer_per_s = (units / timing.median_s for units, timing in (ours, theirs))
    ours_per_cpu_s, peer_per_cpu_s = (units / timing.median_cpu_s for units, timing in (ours, theirs))
    ratio_cpu = ours_per_cpu_s / peer_per_cpu_s
    return Row(name, peer, unit, ours_per_s, peer_per_s, ratio_cpu, bar, ours[1], theirs[1], note)


@dataclass(frozen=True)
class Growth:
    """How the time of one metric grows: slope of log seconds on log cells.

    Attributes:
      cells, wall_s, cpu_s: of each size, medians of several runs.
      bar: the greatest slope asked for.
    """

    name: str
    cells: list[int]
    wall_s: list[float]
    cpu_s: list[float]
    bar: float
    slope: float = field(init=False)
    slope_cpu: float = field(init=False)

    def __post_init__(self) -> None:
        for slope, seconds in (("slope", self.wall_s), ("slope_cpu", self.cpu_s)):
            object.__setattr__(self, slope, float(np.polyfit(np.log(self.cells), np.log(seconds), 1)[0]))


def amount(value: float) -> str:
    """Return a number with three digits and a unit prefix, such as ``1.23 G``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor:
            return f"{value / factor:.3g} {prefix}"
    return f"{value:.3g}"


def markdown(rows: list[Row], growths: list[Growth]) -> str:
    """Return the tables that ``make bench`` prints."""
    lines = [
        "| computed | peer | unit | ours a second | peer's a second | ratio | per CPU second | bar | compile | note |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.name} | {r.peer} | {r.unit} | {amount(r.ours_per_s)} | {amount(r.peer_per_s)} | {r.ratio:.3g} "
        f"| {r.ratio_cpu:.3g} | {'' if r.bar is None else f'{r.bar:g}'} | {r.ours.compile_s:.2f} s | {r.note} |"
        for r in rows
    ]
    if growths:
        lines += ["", "| growth of | cells | seconds | slope | slope, CPU seconds | bar |", "|---|---|---|---|---|---|"]
        lines += [
            f"| {g.name} | {', '.join(map(amount, g.cells))} | {', '.join(f'{s:.3g}' for s in g.wall_s)} "
            f"| {g.slope:.2f} | {g.slope_cpu:.2f} | {g.bar:.2f} |"
            for g in growths
        ]
    return "\n".join(lines)


def version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def copy_gb_per_s() -> float:
    """Return how fast one core copies 256 MiB with NumPy, bytes read and written, the best of 7."""
    source = np.ones(2**26, np.float32)
    target = np.empty_like(source)
    np.copyto(target, source)
    best_s = min(clocked(lambda: np.copyto(target, source))()[1] for _ in range(7))
    return 2 * source.nbytes / best_s / 1e9


def machine() -> dict[str, object]:
    """Return what the figures were taken on."""
    model = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        "device": jax.devices()[0].device_kind,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
        "commit": commit.stdout.strip() or "unknown",
        "numpy_copy_gb_per_s": round(copy_gb_per_s(), 1),
    }


def load() -> list[float]:
    """Return the load averages over 1, 5 and 15 minutes."""
    return [round(value, 2) for value in os.getloadavg()]


def write_json(path: Path, report: dict[str, object], rows: list[Row], growths: list[Growth]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    report = report | {"rows": [asdict(r) | {"ratio": r.ratio} for r in rows], "growth": [asdict(g) for g in growths]}
    path.write_text(json.dumps(report, indent=2) + "\n")
