"""jaxurban on one GPU: is every part right there, and how fast, in one run of at most eight minutes.

``make bench-gpu``, with ``SECTION=`` one section, or ``python -m benchmarks.gpu``: sections copy, occlusion, lidar,
distance, DOPs, pipeline and gradients, each in processes of its own (`benchmarks.gpu_sections`): first JAX's CPU
backend, or Numba where that is the default, then the GPU, then for loops the GPU with XLA's command buffers around
them. What the GPU gives is compared with what the CPU gave. Prints a Markdown table, writes ``out/gpu/gpu.json``; the
exit status is 1 where an answer differs by more than is allowed, or a section broke. Where JAX has no GPU it says so,
runs the CPU's side and leaves the GPU's figures blank.

``--small`` is for trying it: a small city. ``--inputs FOLDER`` keeps the city's rasters, or takes those that a machine
with all readers made before: the sections themselves need JAX, Numba, pyproj and shapely alone.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

from benchmarks.common import ROOT, amount, machine, table
from benchmarks.gpu_inputs import make_inputs

BUDGET_S = 470.0  # of the whole run
LEAST_S = 10.0  # what must be left of it for a section to begin
SECTIONS = {  # and the seconds that each process of a section may take
    "copy": 30.0,
    "occlusion": 60.0,
    "lidar": 60.0,
    "distance": 40.0,
    "dops": 30.0,
    "pipeline": 60.0,
    "gradients": 60.0,
}
NOT_TRIED = {  # on a GPU so far
    "searches": "A* by tiles, 16 to 4,096 queries",
    "soft GPS": "a whole map (17,610 launches)",
    "tuner": "the bootstrap (131,002 launches)",
}
LOOPS = ("copy", "occlusion", "lidar")  # tried with command buffers too
COMMAND_BUFFERS = (
    "--xla_gpu_enable_command_buffer=+WHILE,+CONDITIONAL --xla_gpu_graph_min_graph_size=1"
)
CPU, GPU, GRAPHS = "CPU", "GPU", "GPU, command buffers"
COLUMNS = [
    *("section", "computed", "by", "seconds", "rate", "to the CPU", "first call"),
    *("GPU memory", "differs", "allowed"),
]
Rows = list[dict]


def environment(side: str) -> dict[str, str]:
    """Return the environment of a process that runs a section on one side."""
    env = dict(os.environ, XLA_PYTHON_CLIENT_PREALLOCATE="false")
    if side == CPU:
        env["JAX_PLATFORMS"] = "cpu"
    if side == GRAPHS:
        env["XLA_FLAGS"] = f"{env.get('XLA_FLAGS', '')} {COMMAND_BUFFERS}".strip()
    return env


def gpu_name() -> str | None:
    """Return what JAX calls its GPU, None without one; asked in a process of its own, which then lets go of it."""
    asked = "import jax; print(jax.default_backend(), jax.devices()[0].device_kind, sep='|')"
    command = [sys.executable, "-c", asked]
    said = subprocess.run(
        command, env=environment(GPU), capture_output=True, text=True, check=False
    )
    backend, _, kind = (said.stdout.strip().splitlines() or [""])[-1].partition("|")
    return kind if backend in ("gpu", "cuda", "rocm") else None


def run_section(
    section: str, side: str, inputs: Path, answers: Path, limit_s: float, is_small: bool
) -> Rows:
    """Return the rows of a section on one side; the last one says what broke, if anything did."""
    rows_file = answers / f"{section}-{side}.json"
    command = [
        sys.executable,
        "-m",
        "benchmarks.gpu_sections",
        section,
        side,
        str(inputs),
        str(answers),
    ]
    fault, said = "", ""
    try:
        done = subprocess.run(
            command + ["--small"] * is_small,
            env=environment(side),
            cwd=ROOT,
            timeout=limit_s,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            said = done.stderr.strip() or f"status {done.returncode}"
            fault = said.splitlines()[-1][:200]
    except subprocess.TimeoutExpired:
        fault = f"ran past {limit_s:.0f} s"
    rows: Rows = json.loads(rows_file.read_text()) if rows_file.exists() else []
    if fault:
        print(said or fault, file=sys.stderr)
        rows.append(
            {"section": section, "name": f"broke off: {fault}", "by": side, "is_wrong": True}
        )
    return rows


def check(rows: Rows, answers: Path) -> None:
    """Write into each row how far its answer lies from that of the first row of its name."""
    first: dict[tuple[str, str], dict] = {}
    for row in rows:
        if "answer" not in row:
            continue
        reference = first.setdefault((row["section"], row["name"]), row)
        if reference is row:
            continue
        found, expected = (np.load(answers / of["answer"]) for of in (row, reference))
        row |= difference(found, expected, **row["tolerance"])
        row["cpu_s"] = reference["seconds"]


def difference(
    found: np.ndarray,
    expected: np.ndarray,
    *,
    absolute: float = 0.0,
    relative: float = 0.0,
    of_largest: float = 0.0,
    share: float = 0.0,
) -> dict:
    """Return how far answers lie apart, and whether that is too much.

    Args:
      found, expected: of one shape.
      absolute, relative, of_largest: numbers agree that lie no farther apart than this, than this share of what is
        expected, or than this share of the largest finite one; two equal infinities agree.
      share: of the numbers that may disagree.
    """
    if found.shape != expected.shape:
        return {"differs": f"shape {found.shape} for {expected.shape}", "is_wrong": True}
    found, expected = (np.asarray(values, np.float64) for values in (found, expected))
    is_finite = np.isfinite(expected)
    largest = float(np.abs(expected[is_finite]).max(initial=0.0))
    agrees = np.isclose(
        found, expected, rtol=relative, atol=absolute + of_largest * largest, equal_nan=True
    )
    off = float(1 - agrees.mean()) if agrees.size else 0.0
    both = is_finite & np.isfinite(found)
    most = float(np.abs(found[both] - expected[both]).max(initial=0.0))
    return {"differs": f"{most:.1e} at most; {off:.1e} of them off", "is_wrong": off > share}


def cells_of(row: dict) -> list[str]:
    """Return the cells of a row in the table; those of figures that it lacks are blank."""
    measured = [""] * 4
    if seconds := row.get("seconds"):
        ratio = f"{row['cpu_s'] / seconds:.3g}" if row.get("cpu_s") else ""
        rate = f"{amount(row['units'] / seconds)} {row['unit']}/s"
        measured = [f"{seconds:.3g}", rate, ratio, f"{row['first_s']:.2f} s"]
    peak = "" if row.get("peak_gib") is None else f"{row['peak_gib']:.2f} GiB"
    differs = row.get("differs", "") + (
        " **too much**" if row.get("is_wrong") and "differs" in row else ""
    )
    return [
        row["section"],
        row["name"],
        row["by"],
        *measured,
        peak,
        differs,
        row.get("allowed", ""),
    ]


def blanks(rows: Rows) -> Rows:
    """Return the rows of the CPU's, and after those of each name the GPU's with no figure."""
    shown: Rows = []
    for (section, name), alike in itertools.groupby(
        rows, key=lambda row: (row["section"], row["name"])
    ):
        shown += [*alike, {"section": section, "name": name, "by": GPU}]
    return shown


def main() -> int:
    """Run what the command line asks for; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sections", nargs="*", help=f"of {', '.join(SECTIONS)}; left out: all")
    parser.add_argument(
        "--small", action="store_true", help="a small city, to try the benchmark on any machine"
    )
    parser.add_argument(
        "--inputs", type=Path, help="folder of the city's rasters, made where they are missing"
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "gpu" / "gpu.json")
    options = parser.parse_args()
    if unknown := set(options.sections) - set(SECTIONS):
        parser.error(f"no section {', '.join(unknown)}: choose of {', '.join(SECTIONS)}")
    begin_s = time.perf_counter()
    jax.config.update(
        "jax_platforms", "cpu"
    )  # this process only waits: the GPU is for the sections
    gpu = gpu_name()
    print(f"GPU: {gpu or 'JAX has none here, so the figures of a GPU stay blank'}", file=sys.stderr)
    rows: Rows = []
    with tempfile.TemporaryDirectory() as scratch:
        inputs = (options.inputs or Path(scratch)).resolve()
        make_inputs(inputs, options.small)
        for section in options.sections or SECTIONS:
            for side in (
                CPU,
                *((GPU,) if gpu else ()),
                *((GRAPHS,) if gpu and section in LOOPS else ()),
            ):
                left_s = BUDGET_S - (time.perf_counter() - begin_s)
                if left_s < LEAST_S:
                    rows.append({"section": section, "name": "left out: no time", "by": side})
                    continue
                limit_s = min(SECTIONS[section], left_s)
                rows += run_section(section, side, inputs, Path(scratch), limit_s, options.small)
                print(f"{section}, {side}: {time.perf_counter() - begin_s:.0f} s", file=sys.stderr)
        check(rows, Path(scratch))
    shown = rows if gpu else blanks(rows)
    if not options.sections:
        for section, name in NOT_TRIED.items():
            shown.append({"section": section, "name": name, "by": GPU, "differs": "*not tried*"})
    report = {
        "gpu": gpu,
        "is_small": options.small,
        "seconds": round(time.perf_counter() - begin_s),
        "rows": shown,
    }
    report["machine"] = machine()
    print(f"GPU: {gpu}" if gpu else "**JAX has no GPU here: the figures of a GPU are blank.**")
    print(
        f"\n{table(COLUMNS, list(map(cells_of, shown)))}\n\n{report['machine']}\n{report['seconds']} s in all"
    )
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(report, indent=1) + "\n")
    return int(any(row.get("is_wrong") for row in rows))


if __name__ == "__main__":
    sys.exit(main())
