"""Times every part against a named peer: prints one table, writes JSON. Run as ``python -m benchmarks.run_all``."""

import argparse
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks import against_embree, dilution, distances, pipeline
from benchmarks.common import ROOT, Growth, Row, load, machine, markdown, write_json
from benchmarks.scenes import load_scene


def main() -> None:
    """Run the benchmarks that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "bench.json")
    parser.add_argument("--runs", type=int, default=5, help="of which medians are taken")
    parser.add_argument("--no-growth", action="store_true", help="leave out the city of 50 million cells")
    options = parser.parse_args()
    report: dict[str, object] = {"machine": machine()}
    loads = [load()]
    rows: list[Row] = []
    growths: list[Growth] = []

    def stage(name: str, work: Callable[[], object]) -> None:
        start_s = time.perf_counter()
        work()
        loads.append(load())
        print(f"{name}: {time.perf_counter() - start_s:.0f} s, load {loads[-1]}", file=sys.stderr)

    scene = load_scene()
    for part in (against_embree, dilution, distances):
        stage(part.__name__, lambda part=part: rows.extend(part.measure(scene, options.runs)))
    stage("pipeline", lambda: rows.extend(pipeline.whole(scene, rows, options.runs)))
    if not options.no_growth:
        stage("growth", lambda: growths.extend(pipeline.growth(scene, min(3, options.runs))))
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    report |= {"scene": scene.name, "load_averages": loads, "peak_memory_gib": round(peak_gib, 2)}
    print(markdown(rows, growths))
    print(f"\n{report}")
    write_json(options.output, report, rows, growths)


if __name__ == "__main__":
    main()
