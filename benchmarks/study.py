"""The studies of docs/study.md: the synthetic city at 5 m (200 instances x 4 altitudes) and Lower Manhattan at 5 m.

Run with ``python -m benchmarks.study synthetic|manhattan [-o DIR] [--instances N] [--workers N]``; a killed run goes on
where it stopped. Prints one JSON object: seconds, rows, statuses, and where the report is.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.common import ROOT, machine

DATA = Path(os.environ.get("JAXURBAN_DATA", ROOT.parent / "shared" / "data"))
STUDY = """
[planning]
obstacles = "centre"  # the rule under which docs/study.md was made
[study]
instances = {instances}
planners = ["ptp", "astar-dist", "astar-plus", "bitstar-dist", "bitstar-plus"]
budget_s = 2.0
"""
SYNTHETIC = """
[region]
bounds = [-74.03, 40.68, -73.9107, 40.86]   # 10 x 20 km
resolution_m = 5.0
altitudes_m = [20, 60, 122, 600]
[buildings]
source = "synthetic"
"""
MANHATTAN = """
[region]
bounds = [-74.02, 40.70, -73.98, 40.73]
resolution_m = 5.0
altitudes_m = [20, 60, 122, 600]
[buildings]
source = "{data}/osm/lower-manhattan.osm.pbf"
[gps]
orbits = "{data}/gps/gps-ops_2020-04-27.tle"
times = ["2020-04-27T16:00:00Z"]
[population]
blocks = "{data}/census/tl_2010_36061_tabblock10.shp"
table = "{data}/census/DECENNIALSF12010.P1_nyc_blocks.csv"
districts = "{data}/districts/nyc_community_districts.geojson"
"""
SCENARIOS = {"synthetic": SYNTHETIC, "manhattan": MANHATTAN}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("city", choices=SCENARIOS)
    parser.add_argument("-o", "--out", type=Path, help="default: out/study-CITY")
    parser.add_argument("--instances", type=int, default=200, help="at each altitude")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    out = (asked.out or ROOT / "out" / f"study-{asked.city}").resolve()
    out.mkdir(parents=True, exist_ok=True)
    scenario = out / f"{asked.city}.toml"
    text = SCENARIOS[asked.city] + STUDY.format(instances=asked.instances)
    scenario.write_text(text.replace("{data}", str(DATA.resolve())), encoding="utf-8")
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "jaxurban", "study", str(scenario), "-o", str(out), "--json"]
    command += ["--workers", str(asked.workers), "--benchmark", str(out / "benchmark")]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    told = json.loads(done.stdout) | {"elapsed_s": time.perf_counter() - began_s, "machine": machine()}
    print(json.dumps(told, indent=2))


if __name__ == "__main__":
    main()
