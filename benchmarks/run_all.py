"""Times every part against a named peer: prints one table, writes JSON. Run as ``python -m benchmarks.run_all``.

``make bench`` runs it. Rates and ratios are of CPU seconds, by medians; what compiling takes stands apart. A part whose
peer is not installed is left out with a sentence.
"""

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from benchmarks.common import ROOT, Row, machine, markdown
from benchmarks.scenes import load_scene

PARTS = {  # and the module and function that measure them
    "embree": ("against_embree", "measure"),
    "dops": ("metric_peers", "dilutions"),
    "distances": ("metric_peers", "distances"),
    "maps": ("metric_peers", "all_maps"),
    "protection": ("protection", "measure"),
    "searches": ("grid_peers", "measure"),
}


def main() -> None:
    """Run the benchmarks that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; left out: all"
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "bench.json")
    parser.add_argument(
        "--runs", type=int, default=5, help="of which medians are taken; ten searches for each"
    )
    options = parser.parse_args()
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"no part {', '.join(unknown)}: choose of {', '.join(PARTS)}")
    before, scene, rows = machine(), load_scene(), list[Row]()
    for name in options.parts or PARTS:
        module, function = PARTS[name]
        begin_s = time.perf_counter()
        try:
            measure: Callable[..., list[Row]] = getattr(
                import_module(f"benchmarks.{module}"), function
            )
        except ModuleNotFoundError as error:
            print(
                f"{name} is left out, as {error.name} is not installed (the bench extra)",
                file=sys.stderr,
            )
            continue
        rows += measure(scene, options.runs, *([rows] if name == "maps" else []))
        print(f"{name}: {time.perf_counter() - begin_s:.0f} s", file=sys.stderr)
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    report = {
        "machine": before,
        "after": machine()["load_averages"],
        "peak_memory_gib": round(peak_gib, 2),
    }
    print(f"{markdown(rows)}\n\n{report}")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    kept = [asdict(row) | {"ratio": row.ratio} for row in rows]
    options.output.write_text(
        json.dumps(report | {"scene": scene.name, "rows": kept}, indent=2) + "\n"
    )


if __name__ == "__main__":
    main()
