"""Random missions by ``ju.check`` against an independent judge, which looks at points every 20 cm.

``python -m benchmarks.random_missions [--missions 5000] [--seed 1] [--processes 2] [--against CHECKOUT]`` draws
missions of every format, over level ground, hills, coarse cells and lost files, edited and damaged ones too. It prints
tables by format and datum, by kind and by world: contacts by the judge, findings, what is not judged, false Clean and
invented findings. ``--against`` also prints the plain missions of which another checkout says something else.
With ``--kinds apps`` missions are those of DJI, Litchi, AirData and surveys.
``tests/flights/missions`` holds the worlds, the missions and the judge.
"""

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from tqdm import tqdm

from benchmarks.common import table
from tests.flights.missions import verdicts
from tests.flights.missions.trial import APPS, Court, is_plain, make_maps, write
from tests.flights.missions.verdicts import Verdict
from tests.flights.missions.worlds import make_worlds

CHUNK = 20  # missions that a process tries at a time
NUM_PLAIN = 300  # whose verdicts are held against another checkout's
WIDEST = 150  # letters of a reason
RUN = "from jaxurban.cli.main import main; main()"  # the command line of a checkout


class Row(NamedTuple):
    """A mission of the tables: 1 or 0 in each column of figures."""

    number: int
    kind: str
    world: str
    format: str
    datum: str
    contacts: int
    too_near: int
    unknown: int
    findings: int
    not_judged: int
    refused: int
    clean: int
    crashed: int
    false_clean: int
    invented: int
    why: str


@cache
def court_of(folder: Path, seed: int, kinds: str) -> Court:
    """Return the court of this process."""
    warnings.simplefilter("ignore")
    return Court(folder, seed, kinds)


def rows_of(numbers: Sequence[int], folder: Path, seed: int, kinds: str) -> list[Row]:
    """Return the rows of missions."""
    rows = []
    for number in numbers:
        _, case, truth, verdict, ruling = court_of(folder, seed, kinds).trial(number)
        why = [f"false Clean: {ruling.false_clean}"] if ruling.false_clean else []
        why += [f"invented: {finding}" for finding in ruling.invented]
        if verdict.state == "crashed":
            why.append(verdict.words)
        states = ("findings", "not-judged", "refused", "clean", "crashed")
        row = Row(
            number,
            case.kind,
            case.world.name,
            case.suffix,
            case.datum,
            int(truth.has_contact),
            int(truth.is_near),
            int(bool(truth.unknown) or len(truth.cut_m) > 0),
            *(int(verdict.state == state) for state in states),
            int(bool(ruling.false_clean)),
            len(ruling.invented),
            "; ".join(why)[:WIDEST],
        )
        rows.append(row)
    return rows


def table_by(rows: pd.DataFrame, *names: str) -> str:
    """Return the sums of the figures by columns, and of all, in Markdown."""
    figures = list(Row._fields[5:-1])
    sums = rows.assign(missions=1).groupby(list(names))[["missions", *figures]].sum().reset_index()
    sums.loc[len(sums)] = [*["all"] * len(names), *sums.iloc[:, len(names) :].sum()]
    return table([name.replace("_", " ") for name in sums], sums.astype(str).to_numpy().tolist())


def changes(checkout: Path, folder: Path, seed: int) -> list[list[str]]:
    """Return plain missions of which another checkout says something else: number, before, after, the reason.

    The other checkout judges over maps that it made itself, as records of maps differ between versions.
    """
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve())}
    run = partial(
        subprocess.run, cwd=checkout, env=environment, capture_output=True, text=True, check=True
    )

    def run_maps(scenario: Path, maps: Path) -> None:
        run([sys.executable, "-c", RUN, "maps", str(scenario), "-o", str(maps)])

    theirs = make_worlds(folder / "theirs", run_maps)
    court = court_of(folder, seed, "")
    numbers = list(islice(filter(is_plain, range(10**9)), NUM_PLAIN))
    asked, now = [], []
    for number in numbers:
        case = court.case(number)
        file = write(case, folder, number)
        world = theirs[case.world.name]
        asked.append([str(world.folder), world.resolution_m, str(file), case.options])
        now.append(verdicts.verdict_of(court.maps[case.world.name], file, case.options))
    listed = folder / "asked.json"
    listed.write_text(json.dumps(asked))
    ended = run([sys.executable, "-P", verdicts.__file__, str(listed)])
    before = [Verdict(**json.loads(line)) for line in ended.stdout.splitlines() if line[:1] == "{"]
    return [
        [str(number), old.state, new.state, (new.words or old.words)[:WIDEST]]
        for number, old, new in zip(numbers, before, now, strict=True)
        if old.state != new.state
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--missions", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", default="", choices=["", APPS], help="those of apps alone")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--against", type=Path, help="another checkout, asked of plain missions")
    parser.add_argument("--show", type=int, default=40, help="most faults that are listed")
    options = parser.parse_args()
    began_s = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        warnings.simplefilter("ignore")
        make_maps(folder)
        chunks = [
            range(first, min(first + CHUNK, options.missions))
            for first in range(0, options.missions, CHUNK)
        ]
        work = partial(rows_of, folder=folder, seed=options.seed, kinds=options.kinds)
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(options.processes, mp_context=context) as pool:
            parts = list(
                tqdm(pool.map(work, chunks), total=len(chunks), disable=not sys.stderr.isatty())
            )
        rows = pd.DataFrame([row for part in parts for row in part])
        changed = changes(options.against, folder, options.seed) if options.against else []

    print(table_by(rows, "format", "datum"))
    print("\n" + table_by(rows, "kind"))
    print("\n" + table_by(rows, "world"))
    faults = rows[rows["why"] != ""]
    shown = faults.groupby("kind").head(max(1, options.show // max(1, faults["kind"].nunique())))
    head = ["number", "kind", "world", "format", "datum", "why"]
    print(f"\n{len(faults)} missions with faults, {len(shown)} of them:\n")
    print(table(head, shown[head].astype(str).to_numpy().tolist()))
    if options.against:
        print(f"\n{len(changed)} of {NUM_PLAIN} plain missions changed:\n")
        print(table(["number", "before", "now", "what it says"], changed))
    print(f"\nseed {options.seed}, {time.perf_counter() - began_s:.0f} s")


if __name__ == "__main__":
    main()
