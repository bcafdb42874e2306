"""Kept outputs of three small scenes: whether maps, routes, a study and a fit are what they were.

``python -m tests.kept_outputs compare`` makes them anew and prints what, the largest difference, what is allowed and
the verdict; it exits with 1 on a difference. ``renew [SCENE]`` writes them as they are now. Everything goes through
scenarios and commands (``scenes.toml``), so that what lies below may change its shape.
"""

import argparse
import contextlib
import io
import json
import re
import shlex
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import tomli_w

import jaxurban as ju
from jaxurban.cli.main import main

HERE = Path(__file__).parent
SCENES = tomllib.loads((HERE / "scenes.toml").read_text(encoding="utf-8"))
OF_A_ROUTE = ("status", "cost", "length_m", "lower_bound", "num_points")
OF_THE_SKY = re.compile(
    "dop|gps|[hv]pl|protection|limits|visible|satellite|availab"
)  # in names of maps and of routes
GDOP_JUDGED = 20.0  # beyond it DOPs mean nothing, and are not compared
FLIPS = (
    1e-3  # share of cells where another processor may see a satellite at the very edge of a roof
)
RENEWING = (
    "Outputs differ from the kept ones. Where that is not meant, it is a fault. Where it is, say its cause and its "
    "size in the commit, and renew: python -m tests.kept_outputs renew SCENE takes what is made now as the truth."
)
Numbers = dict[str, dict[str, Any]]  # by what, then by name: numbers and words


class Row(NamedTuple):
    """A line of the table; ``is_same`` is the verdict."""

    what: str
    difference: str
    allowed: str
    is_same: bool


def command(words: list[str]) -> str:
    """Run a command of jaxurban in this process and return what it prints; no path is no failure."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        try:
            main(words)
        except SystemExit as end:
            if end.code not in (None, 0, 3):
                raise RuntimeError(f"jaxurban {shlex.join(words)} ended with {end.code}") from end
    return printed.getvalue()


def write_routes(maps: Any, number: int, altitude_m: float, weights: dict[str, float]) -> None:
    """Plan between free cells drawn at random, under ``plan_many``; write those found, and a table of all."""
    free = np.argwhere(ju.Constraints().is_free(maps, altitude_m))
    at = free[np.random.default_rng(5).integers(len(free), size=(number, 2))]
    x_m, y_m = maps.ds["x"].values[at[..., 1]], maps.ds["y"].values[at[..., 0]]
    queries = {
        "start_x_m": x_m[:, 0],
        "start_y_m": y_m[:, 0],
        "goal_x_m": x_m[:, 1],
        "goal_y_m": y_m[:, 1],
    }
    paths = ju.plan_many(
        maps, pd.DataFrame(queries), altitude_m=altitude_m, weights=ju.Weights(**weights)
    )
    for suffix in ("geojson", "parquet"):
        paths.save(f"routes.{suffix}")


def of_table(file: Path, by: list[str], columns: list[str]) -> dict[str, Any]:
    """Return the columns of a table, row by row; numbers where there are none count as none."""
    table = (
        (pd.read_parquet if file.suffix == ".parquet" else pd.read_csv)(file)
        .set_index(by)[columns]
        .astype(object)
    )
    values = table.where(table.notna(), None).stack(future_stack=True)
    return {" ".join(map(str, (name[-1], *name[:-1]))): value for name, value in values.items()}


def made(name: str, folder: Path) -> tuple[dict[str, np.ndarray], Numbers]:
    """Return the maps of a scene, and all its numbers; files go to ``folder``."""
    scene, numbers = SCENES[name], {}
    shutil.copytree(HERE / "inputs", folder, dirs_exist_ok=True)
    (folder / "scenario.toml").write_text(tomli_w.dumps(scene["scenario"]), encoding="utf-8")
    with contextlib.chdir(folder):
        command(["maps", "scenario.toml", "-o", "MAPS"])
        maps = ju.open_maps("MAPS")
        is_wall = maps.ds["obstacle"].values > 0  # what a map holds in there is no fact
        arrays = {
            str(key): np.where(is_wall, 0, values) if "altitude" in values.dims else values.values
            for key, values in maps.ds.data_vars.items()
            if {"y", "x"} <= {*values.dims}
        }
        arrays["obstacle"] = is_wall
        if "routes" in scene:
            write_routes(maps, **scene["routes"])
        for what, line in scene["commands"].items():
            words = shlex.split(line.format(**scene["ends"]))
            printed = command([*words, *(["--json"] if words[0] == "plan" else [])])
            if words[0] == "plan":
                route = json.loads(printed)
                numbers[what] = {key: route[key] for key in OF_A_ROUTE if key in route} | route[
                    "metrics"
                ]
        for what, table in scene.get("tables", {}).items():
            numbers[what] = of_table(Path(table["file"]), table["by"], table["columns"])
    return arrays, json.loads(json.dumps(numbers))


def judge_maps(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> Iterator[Row]:
    """Yield a row a variable: DOPs and other reals to 1e-5, whole numbers equal; of the sky few cells may flip."""
    for name in sorted(old.keys() | new.keys()):
        if name not in old or name not in new or old[name].shape != new[name].shape:
            yield Row(name, "missing or of another shape" if name in old else "new", "none", False)
            continue
        before, after = old[name].astype(float), new[name].astype(float)
        is_of_sky, is_real = OF_THE_SKY.search(name) is not None, old[name].dtype.kind == "f"
        same = (
            np.isclose(after, before, rtol=1e-5, atol=1e-6, equal_nan=True)
            if is_real
            else after == before
        )
        if (
            is_real
            and is_of_sky
            and all("gdop" in of and of["gdop"].shape == before.shape for of in (old, new))
        ):
            same |= (old["gdop"] > GDOP_JUDGED) & (new["gdop"] > GDOP_JUDGED * (1 - 1e-5))
        most, number = int(FLIPS * before.size) if is_of_sky else 0, int((~same).sum())
        off = ~same & np.isfinite(before) & np.isfinite(after)
        largest = np.abs(after[off] - before[off]).max(initial=0)
        allowed = f"{'1e-5' if is_real else 'equal'} but in {most} cells"
        yield Row(name, f"{largest:.1e} ({number} of {before.size} cells)", allowed, number <= most)


def judge_numbers(old: Numbers, new: Numbers) -> Iterator[Row]:
    """Yield a row for each route and table: numbers to a share of themselves, words equal."""
    for what in sorted(old.keys() | new.keys()):
        before, after = old.get(what, {}), new.get(what, {})
        allowed = (
            1e-6 if what.startswith(("fit", "sensitivity")) or OF_THE_SKY.search(what) else 1e-9
        )
        shares = {
            key: share(before.get(key, ""), after.get(key, ""))
            for key in sorted({**before, **after})
        }
        beyond = [
            key
            for key, value in shares.items()
            if value > (1e-6 if OF_THE_SKY.search(key) else allowed)
        ]
        worst = max(beyond or shares, key=lambda key: shares[key])
        yield Row(what, f"{shares[worst]:.1e} ({worst})", f"{allowed:.0e}", not beyond)


def share(before: Any, after: Any, least: float = 1e-3) -> float:
    """Return the share by which two numbers differ (of ``least`` at least), infinite for words that differ."""
    if all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in (before, after)
    ):
        return abs(after - before) / max(abs(before), least)
    return 0.0 if before == after else np.inf


def kept(name: str) -> tuple[dict[str, np.ndarray], Numbers]:
    """Return what is kept of a scene."""
    with np.load(HERE / f"{name}.npz") as arrays:
        return dict(arrays), json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))


def compared(name: str, folder: Path) -> list[Row]:
    """Return how what is made of a scene in a folder differs from what is kept."""
    arrays, numbers = made(name, folder)
    old_arrays, old_numbers = kept(name)
    return [*judge_maps(old_arrays, arrays), *judge_numbers(old_numbers, numbers)]


def compare_or_renew() -> None:
    """Compare or renew the scenes that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("compare", "renew"))
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)}; left out, all"
    )
    asked = parser.parse_args()
    if unknown := set(asked.scenes) - set(SCENES):
        parser.error(f"unknown scene {unknown.pop()!r}: choose of {', '.join(SCENES)}")
    is_same = True
    for name in asked.scenes or SCENES:
        with tempfile.TemporaryDirectory(prefix="kept-outputs-") as folder:
            if asked.what == "renew":
                arrays, numbers = made(name, Path(folder))
                np.savez_compressed(HERE / f"{name}.npz", **arrays)
                (HERE / f"{name}.json").write_text(
                    json.dumps(numbers, indent=0) + "\n", encoding="utf-8"
                )
                continue
            for row in compared(name, Path(folder)):
                is_same &= row.is_same
                verdict = "same" if row.is_same else "DIFFERENT"
                print(f"{name:<10} {row.what:<28} {row.difference:<44} {row.allowed:<20} {verdict}")
    sys.exit(None if is_same else RENEWING)


if __name__ == "__main__":
    compare_or_renew()
