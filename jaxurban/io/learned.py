"""What the heights that a file knows say of those that nobody gave: by class of footprint, and by kind of all else.

A guess is the median of a class, those by the number of levels among them. Likely is what 99 % of a class keep below:
of n heights that are given the ceil((n + 1) 0.99)-th smallest, as in split conformal prediction (Vovk et al. 2005,
chapter 2). Both are of the file itself where that knows enough, else of `PACKAGED`. They hold for one object, not for a
route: of 50 unknown ones one exceeds its own with up to 39 %. Known heights are no fair sample of unknown ones either.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely

CLASSES_M2 = 60.0, 200.0, 1000.0  # of footprints, between classes
PARTS = "parts of "  # and the class of what they lie in or touch
IN_NONE = "no building"  # the class of what parts lie in that lie in none
LIKELY_SHARE = 0.99
LEAST_FOR_GUESS = 20
LEAST_KNOWN = 299  # so many known heights are 95 % sure of 99 %
# Guess and likely by `benchmarks.learn_heights`. Of buildings these are the median of the medians of several cities,
# and the highest of what each says, as one unlike these may be denser; likely of parts is no less than of what they lie
# in. Of trees it is what all of them say together.
PACKAGED = {
    "buildings below 60 m2": (8.7, 25.0),
    "buildings of 60 to 200 m2": (15.8, 40.4),
    "buildings of 200 to 1,000 m2": (18.0, 145.4),
    "buildings above 1,000 m2": (38.6, 427.0),
    "parts of buildings below 60 m2": (8.7, 25.0),
    "parts of buildings of 60 to 200 m2": (14.1, 83.3),
    "parts of buildings of 200 to 1,000 m2": (30.0, 192.0),
    "parts of buildings above 1,000 m2": (41.0, 427.0),
    "parts of no building": (35.5, 427.0),
    "tree": (7.0, 20.0),
}
CLASSES = np.array([*PACKAGED][:4], object)
# And where few buildings stand: where they cover less than `OPEN_SHARE` of the ground around (`built_shares`).
OPEN_GUESSES_M = dict(zip(CLASSES, (4.2, 6.4, 6.8, 18.9), strict=True))
OPEN_SHARE = 0.2
KEY_STEP = 2.0**26  # more cells than a CRS has in a row
CELL_M = 80.0  # whose 5 x 5 around a building are as large as a disc of 225 m
PART_CLASSES = np.array([*PACKAGED][4:9], object)


@dataclass(frozen=True)
class Learned:
    """What is guessed and likely of the unknown heights of a class, in metres above the ground.

    Attributes:
      guess_m: with what they stand in maps.
      open_guess_m: the same where few buildings stand.
      likely_m: what 99 % keep below; None where nothing says.
      highest_m: the highest that the file knows, 0 without one.
      num_for_guess, num_known: how many heights of the file say the guess, and what is likely; 0: the packaged table
        does.
    """

    guess_m: float
    open_guess_m: float
    likely_m: float | None
    highest_m: float
    num_for_guess: int
    num_known: int

    def __str__(self) -> str:
        known = f"{self.num_for_guess:,} known" if self.num_for_guess else "the packaged table"
        is_same = self.open_guess_m == self.guess_m
        where_open = "" if is_same else f" ({self.open_guess_m:.3g} m where few buildings stand)"
        return f"{self.guess_m:.3g} m of {known}{where_open}"


def classes_of(area_m2: np.ndarray) -> np.ndarray:
    """Return the class of buildings, ``[N]`` objects, by the areas of their outlines."""
    return CLASSES[np.searchsorted(CLASSES_M2, area_m2, side="right")]


def built_shares(polygons: np.ndarray) -> np.ndarray:
    """Return ``[N]`` the share of the ground around each building that buildings cover: of 5 x 5 cells, by centres."""
    place = np.floor(shapely.get_coordinates(shapely.centroid(polygons)) / CELL_M)
    keys = place @ (1, KEY_STEP)
    cells, first, number = np.unique(keys, return_index=True, return_inverse=True)
    built_m2 = np.bincount(number, shapely.area(polygons))
    around = shapely.box(*(place[first] - 2.5).T, *(place[first] + 2.5).T)
    cell, beside = shapely.STRtree(shapely.points(place[first])).query(around)
    around_m2 = np.bincount(cell, built_m2[beside], len(cells))
    return around_m2[number] / (5 * CELL_M) ** 2


def likely_of(known_m: np.ndarray) -> float:
    """Return what `LIKELY_SHARE` of a class keep below by its known heights, ``[n]``; the highest where n is small."""
    rank = math.ceil((len(known_m) + 1) * LIKELY_SHARE)
    return float(np.sort(known_m)[min(rank, len(known_m)) - 1])


def learned_from(
    classes: np.ndarray, given_m: np.ndarray, counted_m: np.ndarray
) -> dict[str, Learned]:
    """Return what is learned of each class that occurs and of which enough is known, here or in `PACKAGED`.

    Args:
      classes: ``[N]`` objects.
      given_m: ``[N]`` heights, 0 where the file gives none.
      counted_m: ``[N]`` the same, with those by the number of levels.
    """
    learned = {}
    number, names = pd.factorize(classes)
    for index, name in enumerate(names):
        is_it = number == index
        given, counted = given_m[is_it], counted_m[is_it]
        given, counted = given[given > 0], counted[counted > 0]
        guess_m, likely_m = PACKAGED.get(name, (None, None))
        num_for_guess = num_known = 0
        if len(counted) >= LEAST_FOR_GUESS:
            guess_m, num_for_guess = float(np.median(counted)), len(counted)
        if len(given) >= LEAST_KNOWN:
            likely_m, num_known = likely_of(given), len(given)
        if guess_m is None:
            continue
        open_m = guess_m if num_for_guess else OPEN_GUESSES_M.get(name, guess_m)
        if likely_m is not None:
            likely_m = max(likely_m, guess_m)
        highest_m = float(given.max(initial=0.0))
        learned[name] = Learned(guess_m, open_m, likely_m, highest_m, num_for_guess, num_known)
    return learned


def of_classes(learned: Mapping[str, Learned], classes: np.ndarray, field: str) -> np.ndarray:
    """Return ``[N]`` a field of `Learned` by class, NaN where nothing is learned."""
    known = {name: getattr(each, field) for name, each in learned.items()}
    return pd.Series(classes, dtype=object).map(known).to_numpy(float)
