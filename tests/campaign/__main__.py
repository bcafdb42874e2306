"""Hostile inputs and kills, counted: ``python -m tests.campaign [--kills 60] [--part 1.0]``; 1 if anything failed."""

import argparse
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.campaign.cases import Verdict, run_case
from tests.campaign.files import of_people, of_rasters, of_tables, of_texts
from tests.campaign.kills import JOBS, begin, ended, run_kills
from tests.campaign.kills import Job as _Job
from tests.campaign.places import of_places, run_place
from tests.campaign.settings import of_options, of_settings, write_scenario

FAULTS = ("traceback", "hang", "silent", "lost files", "other results")
GROUPS = {
    "settings": of_settings,
    "options": of_options,
    "junk in files": of_texts,
    "rasters": of_rasters,
    "people": of_people,
    "tables": of_tables,
}


def main() -> int:
    """Run all of it, print a table, and return 1 if any count is not 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=60, help="of all jobs together")
    parser.add_argument("--part", type=float, default=1.0, help="of the hostile inputs, from 0 to 1")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng, began_s = random.Random(given.seed), time.monotonic()
    rows: dict[str, tuple[int, list[Verdict]]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        base = make_base(Path(scratch))
        for number, job in enumerate(JOBS):  # first: this process must have begun nothing when it is forked
            share = given.kills // len(JOBS) + (number < given.kills % len(JOBS))
            if not share:
                continue
            folder = Path(scratch, f"job{number}")
            folder.mkdir()
            verdicts, num_hit = run_kills(job, base, folder, share, rng)
            rows[f"kills: {job.name}"] = num_hit, tell(verdicts)
        places = of_places()
        rows["places"] = len(places), tell([run_place(place, base) for place in places])
        for name, cases in GROUPS.items():
            chosen = [case for case in cases() if rng.random() < given.part]
            rows[name] = len(chosen), tell([run_case(case, base) for case in chosen])
    print(f"\n{'':<26}{'tried':>8}" + "".join(f"{fault:>16}" for fault in FAULTS))
    for name, (tried, verdicts) in rows.items():
        counts = Counter(verdict.fault for verdict in verdicts)
        print(f"{name:<26}{tried:>8}" + "".join(f"{counts[fault]:>16}" for fault in FAULTS))
    num_bad = sum(bool(verdict.fault) for _, verdicts in rows.values() for verdict in verdicts)
    kills = sum(tried for name, (tried, _) in rows.items() if name.startswith("kills"))
    inputs = sum(tried for name, (tried, _) in rows.items() if not name.startswith("kills"))
    print(f"{inputs} hostile inputs and {kills} kills in {time.monotonic() - began_s:.0f} s: {num_bad} faults")
    return int(num_bad > 0)


def make_base(scratch: Path) -> Path:
    """Return a folder of small finished maps, made by another process."""
    base = scratch / "base"
    write_scenario(scratch)

    def work(_: Path, folder: Path) -> None:
        from jaxurban.cli import main as cli

        cli.main(["maps", str(scratch / "scenario.toml"), "-o", str(folder)])

    process = begin(_Job("base", work, dict), base, base, scratch / "log")
    if ended(process, 300) != 0:
        raise SystemExit((scratch / "log").read_text())
    return base


def tell(verdicts: list[Verdict]) -> list[Verdict]:
    """Print the faults among verdicts, and return them all."""
    for verdict in verdicts:
        if verdict.fault:
            print(f"{verdict.fault}: {verdict.name}\n    " + verdict.shown.strip()[-700:].replace("\n", "\n    "))
    sys.stdout.flush()
    return verdicts


if __name__ == "__main__":
    os.environ["JAX_PLATFORMS"] = os.environ.get("JAX_PLATFORMS", "cpu")
    sys.exit(main())
