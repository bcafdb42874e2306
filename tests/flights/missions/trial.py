"""Trials: a random mission by its number, what a check says of it, and the law over that."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from zipfile import ZipFile

import numpy as np

import jaxurban as ju
from jaxurban.maps.run import load_city, run_scenario
from jaxurban.maps.scenario import Scenario
from tests.flights.missions.apps import app_case
from tests.flights.missions.cases import MAKERS, plain
from tests.flights.missions.damage import DAMAGES
from tests.flights.missions.draw import Case, Draw
from tests.flights.missions.judge import Ruling, Truth, ruling, truth_of
from tests.flights.missions.verdicts import Verdict, verdict_of
from tests.flights.missions.worlds import BY_CELLS, THINGS, World, make_worlds, worlds_in

PLAIN, DAMAGED = "plain", "damaged"
# Of each twenty-three missions so many are of a kind. What earlier versions say of plain ones still holds.
KINDS = (
    *("mixed", "lines", PLAIN, DAMAGED, "jump") * 2,
    *("loiter", "loiter", "return", "corner", "open", "skim", DAMAGED, DAMAGED, "return", DAMAGED),
    *("thing",) * 3,
)
APPS = "apps"  # missions of DJI, Litchi, AirData and surveys, which are numbered apart
WORLDS = ("hills", "coarse", "flat", "hills", "gone", "things 1", "things 2 by cells")
WITH_THINGS = tuple(f"{name}{how}" for name in THINGS for how in ("", BY_CELLS))


class Trial(NamedTuple):
    """A mission, what is true of it, what a check said of it, and the law over that."""

    number: int
    case: Case
    truth: Truth
    verdict: Verdict
    ruling: Ruling


def make_maps(folder: Path) -> dict[str, World]:
    """Make the worlds in a folder, their maps as ``jaxurban maps`` makes them, and return them."""

    def run(scenario: Path, maps: Path) -> None:
        run_scenario(Scenario.from_toml(scenario), maps, progress=False)

    return make_worlds(folder, run)


def is_plain(number: int) -> bool:
    """Return whether the mission of a number is a plain one."""
    return KINDS[number % len(KINDS)] == PLAIN


def case_of(worlds: Mapping[str, World], number: int, seed: int = 1, kinds: str = "") -> Case:
    """Return a mission by its number, which with the seed and the kinds alone decides on all of it."""
    rng = np.random.default_rng([seed, number])
    if kinds == APPS:
        return app_case(Draw(worlds[str(rng.choice(WORLDS))], rng), number)
    turn, place = divmod(number, len(KINDS))
    kind = KINDS[place]
    if kind == PLAIN:
        return plain(Draw(worlds["flat"], rng), kind)
    if kind == DAMAGED:
        num_before = turn * KINDS.count(kind) + KINDS[:place].count(kind)
        world = worlds[str(rng.choice(["hills", "flat"]))]
        return DAMAGES[num_before % len(DAMAGES)](Draw(world, rng))
    names = {"corner": ("hills",), "thing": WITH_THINGS}.get(kind, WORLDS)
    world = worlds[str(rng.choice(names))]
    return MAKERS[kind](Draw(world, rng), kind)


def write(case: Case, folder: Path, number: int) -> Path:
    """Return the file of a mission, written in a folder."""
    file = folder / f"mission_{number}{case.suffix}"
    if case.suffix == ".kmz":
        with ZipFile(file, "w") as archive:
            archive.writestr("wpmz/waylines.wpml", case.text)
    else:
        file.write_text(case.text, encoding="utf-8")
    return file


class Court:
    """Tries missions over the worlds in a folder, whose maps are opened once.

    Cities are read once; for ``coarse`` each check reads that of its maps from the files.
    """

    def __init__(self, folder: Path, seed: int = 1, kinds: str = "") -> None:
        self.folder, self.seed, self.kinds = folder, seed, kinds
        self.worlds = worlds_in(folder)
        self.maps = {
            name: ju.open_maps(world.folder, world.resolution_m)
            for name, world in self.worlds.items()
        }
        for maps in self.maps.values():
            maps.ds.load()
        self.sources = {
            name: {"sources": load_city(Scenario.from_toml(world.folder.parent / "scenario.toml"))}
            for name, world in self.worlds.items()
            if world.has_files and name != "coarse"
        }

    def case(self, number: int) -> Case:
        """Return a mission by its number."""
        return case_of(self.worlds, number, self.seed, self.kinds)

    def trial(self, number: int) -> Trial:
        """Return the trial of a mission."""
        case = self.case(number)
        truth = truth_of(case.world, case.flown, *case.clearances_m)
        name = case.world.name
        options = self.sources.get(name, {}) | case.options
        verdict = verdict_of(self.maps[name], write(case, self.folder, number), options)
        return Trial(
            number, case, truth, verdict, ruling(case.world, truth, verdict, case.is_damaged)
        )
