"""Random files of cities by ``ju.check`` against what was planted in them.

``python -m benchmarks.random_cities [--cities 1000] [--seed 1] [--processes 2] [--against CHECKOUT]`` writes cities as
OpenStreetMap's XML, GeoJSON, GeoPackage, Shapefile and GeoParquet, in the ways that tools and offices write them, and
flies through, beside, over and away from what stands. It prints tables by format, by style and by edit: flights that
meet something, that are free, false Clean and invented findings, and what OGR confirms of the first cities.
``--against`` also prints the flights of which another checkout says something else. ``tests/cities/generator`` holds
the cities and the judge.
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
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from tqdm import tqdm

from benchmarks.common import table
from tests.cities.generator import verdicts
from tests.cities.generator.trial import NO_FREE, city_of, trial, unseen, write_city

CHUNK = 10  # cities that a process tries at a time
NUM_SEEN = 60  # cities that OGR reads
WIDEST = 150  # letters of a reason


class Row(NamedTuple):
    """A flight of the tables: 1 or 0 in each column of figures."""

    city: int
    format: str
    style: str
    edit: str
    aim: str
    meets: int
    known: int
    free: int
    clean: int
    findings: int
    not_judged: int
    refused: int
    crashed: int
    false_clean: int
    invented: int
    known_not_5: int
    free_not_clean: int
    why: str


def rows_of(numbers: Sequence[int], seed: int, num_flights: int) -> list[Row]:
    """Return the rows of cities' flights."""
    warnings.simplefilter("ignore")
    rows = []
    with tempfile.TemporaryDirectory() as name:
        for number in numbers:
            for each in trial(number, Path(name), seed, num_flights):
                truth, state = each.truth, each.verdict.state
                is_judged = state not in ("refused", "crashed")
                states = ("clean", "findings", "not-judged", "refused", "crashed")
                faults = (
                    int(each.is_false_clean),
                    each.num_invented,
                    int(bool(truth.known) and is_judged and state != "findings"),
                    int(truth.is_free and is_judged and state != "clean"),
                )
                why = "false Clean; " * each.is_false_clean + each.verdict.words
                row = Row(
                    number,
                    each.city.suffix,
                    each.city.style,
                    each.edit,
                    each.flight.aim,
                    int(bool(truth.hits)),
                    int(bool(truth.known)),
                    int(truth.is_free),
                    *(int(state == one) for one in states),
                    *faults,
                    why[:WIDEST] if any(faults) or not is_judged else "",
                )
                rows.append(row)
    return rows


def table_by(rows: pd.DataFrame, *names: str) -> str:
    """Return the sums of the figures by columns, and of all, in Markdown."""
    figures = list(Row._fields[5:-1])
    sums = rows.assign(flights=1).groupby(list(names))[["flights", *figures]].sum().reset_index()
    sums.loc[len(sums)] = [*["all"] * len(names), *sums.iloc[:, len(names) :].sum()]
    return table([name.replace("_", " ") for name in sums], sums.astype(str).to_numpy().tolist())


def unconfirmed(num_cities: int, seed: int) -> list[list[str]]:
    """Return edits that OGR does not read, by style and format, with the number of cities; "all" where it fails."""
    gone = []
    with tempfile.TemporaryDirectory() as name:
        for number in range(num_cities):
            city = city_of(number, seed)
            write_city(city, Path(name), seed)
            is_read, edits = unseen(city, Path(name))
            gone += [(city.style, city.suffix, edit) for edit in (edits if is_read else ["all"])]
    counts = pd.Series(gone, dtype=object).value_counts()
    return [[*key, str(num)] for key, num in counts.items()]


def changes(checkout: Path, num_cities: int, seed: int, num_flights: int) -> list[list[str]]:
    """Return flights of which another checkout says something else: city, edit, before, now, the reason."""
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve())}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cities = [city_of(number, seed, num_flights) for number in range(num_cities)]
        asked = [write_city(city, folder, seed) for city in cities]
        listed = folder / "asked.json"
        listed.write_text(json.dumps(asked))
        ended = subprocess.run(
            [sys.executable, "-P", verdicts.__file__, str(listed)],
            cwd=checkout,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        before = [json.loads(line) for line in ended.stdout.splitlines() if line[:1] == "["]
        now = [verdicts.verdicts_of(*each) for each in asked]
    return [
        [
            str(city.number),
            flight.edit,
            old["state"],
            new.state,
            (new.words or old["words"])[:WIDEST],
        ]
        for city, olds, news in zip(cities, before, now, strict=True)
        for flight, old, new in zip(city.flights, olds, news, strict=True)
        if old["state"] != new.state
    ]


def percent(part: int, whole: int) -> str:
    """Return a share in percent."""
    return f"{100 * part / whole:.1f} %" if whole else "none"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cities", type=int, default=1000)
    parser.add_argument("--flights", type=int, default=4, help="of each city")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--against", type=Path, help="another checkout, asked of the same flights")
    parser.add_argument("--show", type=int, default=40, help="most faults that are listed")
    options = parser.parse_args()
    began_s = time.perf_counter()
    warnings.simplefilter("ignore")
    chunks = [
        range(first, min(first + CHUNK, options.cities))
        for first in range(0, options.cities, CHUNK)
    ]
    work = partial(rows_of, seed=options.seed, num_flights=options.flights)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.processes, mp_context=context) as pool:
        parts = list(
            tqdm(pool.map(work, chunks), total=len(chunks), disable=not sys.stderr.isatty())
        )
    rows = pd.DataFrame([row for part in parts for row in part])
    rows = rows[rows["edit"] != NO_FREE]

    print(table_by(rows, "format"))
    print("\n" + table_by(rows, "style"))
    print("\n" + table_by(rows, "edit"))
    faults = rows[rows["why"] != ""].sort_values(["false_clean", "invented"], ascending=False)
    shown = faults.groupby("edit").head(max(1, options.show // max(1, faults["edit"].nunique())))
    head = ["city", "format", "style", "edit", "aim", "why"]
    print(f"\n{len(faults)} flights with faults or refused, {len(shown)} of them:\n")
    print(table(head, shown[head].astype(str).to_numpy().tolist()))
    num_seen = min(NUM_SEEN, options.cities)
    print(f"\nNot confirmed by OGR, of the first {num_seen} cities:\n")
    print(table(["style", "format", "edit", "cities"], unconfirmed(num_seen, options.seed)))
    if options.against:
        changed = changes(options.against, options.cities, options.seed, options.flights)
        print(f"\n{len(changed)} of {options.cities * options.flights} flights changed:\n")
        print(table(["city", "edit", "before", "now", "what it says"], changed))

    judged = rows[(rows["refused"] == 0) & (rows["crashed"] == 0)]
    sums = judged.sum(numeric_only=True)
    print(f"\nfalse Clean: {sums['false_clean']} of {sums['meets']} flights that meet something")
    free, known = int(sums["free"]), int(sums["known"])
    print(f"Clean: {percent(free - sums['free_not_clean'], free)} of {free} free flights")
    print(
        f"exit 5: {percent(known - sums['known_not_5'], known)} of {known} that meet what is known"
    )
    print(f"seed {options.seed}, {time.perf_counter() - began_s:.0f} s")


if __name__ == "__main__":
    main()
