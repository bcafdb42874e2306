"""Kills at random moments (SIGKILL): what is lost, and whether the same command afterwards makes what none disturbed.

Every job runs in a process of its own, forked from this one, which has imported everything and begun nothing; with
worker processes the whole group is killed, or one process of it.
"""

import os
import random
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

import jaxurban as ju
from jaxurban.cli import main as cli
from jaxurban.maps.executors import cluster_client
from tests import tiled_runs
from tests.campaign.cases import MOST_S, Verdict
from tests.tiled_runs import files_of

MEASURED = ("elapsed_s", "setup_s", "search")  # columns of tables that no two runs share
ROUNDS = 3  # kills of a job before it is left to end


@dataclass(frozen=True)
class Job:
    """Something that is killed: does its work in a folder, and goes on with it when it is called again."""

    name: str
    work: Callable[[Path, Path], object]
    result: Callable[[Path], dict[str, bytes]]


def tiles(base: Path, folder: Path) -> None:
    """Make maps of many tiles in threads."""
    tiled_runs.make(folder, tiled_runs.city())


def tiles_by_workers(base: Path, folder: Path) -> None:
    """Make them in worker processes."""
    with cluster_client(2) as client:
        tiled_runs.make(folder, tiled_runs.city(), client=client)


def study(base: Path, folder: Path) -> None:
    """Run planners on random instances."""
    how = ju.studies.Study(planners=("astar-plus", "bitstar-plus"), budget_iterations=400)
    ju.studies.study(base, folder, 12, settings=how, progress=False)


def tune(base: Path, folder: Path) -> None:
    """Fit weights to drawn routes."""
    pilot = "gps=1,risk=2,distance=0.5"
    cli.main(
        [
            "tune",
            str(base),
            "--sample",
            "12",
            "--time-of-day",
            "day",
            "--pilot",
            pilot,
            "--bootstrap",
            "20",
            "-o",
            str(folder),
        ]
    )


def plan_many(base: Path, folder: Path) -> None:
    """Plan many queries into a table."""
    folder.mkdir(exist_ok=True)
    maps = ju.open_maps(base)
    free, rng = np.argwhere(maps.is_free(20.0)), np.random.default_rng(0)
    ends = [[maps.grid.lonlat_of_cell(*free[at]) for at in rng.integers(len(free), size=2)] for _ in range(400)]
    pairs = [tuple(tuple(map(float, place)) for place in pair) for pair in ends]
    ju.plan_many(
        maps, pairs, altitude_m=20.0, planner="theta-star", file=folder / "q.parquet", num_threads=1, progress=False
    )


def sensitivity(base: Path, folder: Path) -> None:
    """Vary the weights of several routes."""
    how = ju.studies.SensitivityStudySettings(num_samples=16)
    ju.studies.sensitivity_study(base, folder, 4, settings=how, progress=False)


def as_files(folder: Path) -> dict[str, bytes]:
    """Return every file, byte for byte."""
    return files_of(folder)


def as_tables(folder: Path) -> dict[str, bytes]:
    """Return the values of every table but what was measured, and the fitted weights."""
    found = {}
    for file in sorted(folder.glob("*.parquet")) + sorted(folder.glob("*.csv")):
        table = pd.read_parquet(file) if file.suffix == ".parquet" else pd.read_csv(file)
        kept = table[[column for column in table.columns if column not in MEASURED]]
        found[file.name] = kept.to_csv(index=False).encode()
    weights = folder / "weights.toml"
    return found | ({weights.name: weights.read_bytes()} if weights.exists() else {})


JOBS = (
    Job("maps in tiles", tiles, as_files),
    Job("maps by workers", tiles_by_workers, as_files),
    Job("study", study, as_tables),
    Job("tune", tune, as_tables),
    Job("plan_many", plan_many, as_tables),
    Job("sensitivity study", sensitivity, as_tables),
)


def begin(job: Job, base: Path, folder: Path, log: Path) -> int:
    """Start a job in a process group of its own and return its process."""
    sys.stdout.flush()
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        os.setsid()
        with log.open("w") as told:
            os.dup2(told.fileno(), 1)
            os.dup2(told.fileno(), 2)
            warnings.simplefilter("ignore")
            try:
                job.work(base, folder)
                code = 0
            except SystemExit as ended:
                code = int(ended.code or 0)
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
    finally:
        os._exit(code)


def ended(process: int, within_s: float) -> int | None:
    """Return the exit status of a process (as of `os.waitpid`), None if it still runs when the time is over."""
    last_s = time.monotonic() + within_s
    while True:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return status
        if time.monotonic() >= last_s:
            return None
        time.sleep(0.01)


def kill(process: int) -> None:
    """Kill a process and its workers."""
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)


def run_kills(job: Job, base: Path, scratch: Path, num_kills: int, rng: random.Random) -> tuple[list[Verdict], int]:
    """Return what came of a job that is killed so many times, and how many kills hit it at work."""
    log = scratch / "log"

    def finish(folder: Path) -> tuple[str, float]:
        began_s = time.monotonic()
        process = begin(job, base, folder, log)
        status = ended(process, MOST_S)
        if status is None:
            kill(process)
            return "hang", MOST_S
        return ("" if status == 0 else "traceback"), time.monotonic() - began_s

    whole = scratch / "whole"
    fault, _ = finish(whole)  # compiles what the next ones find
    if fault:
        return [Verdict(f"{job.name}, undisturbed", fault, log.read_text()[-1500:])], 0
    shutil.rmtree(whole)
    _, lasts_s = finish(whole)
    wanted, verdicts, num_hit = job.result(whole), [], 0
    while num_hit < num_kills:
        folder = scratch / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        moments: list[str] = []
        for _ in range(min(ROUNDS, num_kills - num_hit)):
            process, after_s = begin(job, base, folder, log), rng.uniform(0, lasts_s)
            if ended(process, after_s) is not None:
                break  # it was done before
            kill(process)
            num_hit += 1
            moments.append(f"{after_s:.2f} s")
        fault, _ = finish(folder)
        shown = log.read_text()[-1500:] if fault else ""
        if not fault:
            found = job.result(folder)
            if lost := sorted(wanted.keys() - found.keys()):
                fault, shown = "lost files", ", ".join(lost)
            elif others := sorted(name for name in found if found[name] != wanted.get(name)):
                fault, shown = "other results", ", ".join(others)
        verdicts.append(Verdict(f"{job.name}, killed after {', '.join(moments)}", fault, shown))
    return verdicts, num_hit
