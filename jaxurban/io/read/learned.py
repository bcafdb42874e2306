"""What the heights that a file knows say of those that nobody gave: by class of footprint, and by kind of all else.

Likely is what 99 % of a class keep below: of n known heights the ceil((n + 1) 0.99)-th smallest, as in split conformal
prediction (Vovk et al. 2005, chapter 2). It is of the file itself where that knows enough of them, else of `PACKAGED`.
It holds for one object, not for a route: of 50 unknown ones one exceeds its own with up to 39 %. Known heights are no
fair sample of unknown ones either.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

CLASSES_M2 = 60.0, 200.0, 1000.0  # of footprints, between classes
LARGE = "buildings of 200 to 1,000 m2", "buildings above 1,000 m2"
CLASSES = np.array(("buildings below 60 m2", "buildings of 60 to 200 m2", *LARGE), object)
LIKELY_SHARE = 0.99
LEAST_KNOWN = 299  # so many known heights are 95 % sure of 99 %
# By `benchmarks.learn_heights`. Of buildings it is the highest of what the heights of several cities say, as one unlike
# these may be denser; of trees what all of them say together.
PACKAGED = {
    "buildings below 60 m2": 25.0,
    "buildings of 60 to 200 m2": 40.4,
    "buildings of 200 to 1,000 m2": 145.4,
    "buildings above 1,000 m2": 427.0,
    "tree": 20.0,
}


@dataclass(frozen=True)
class Learned:
    """What is likely of the unknown heights of a class.

    Attributes:
      likely_m: above the ground, what 99 % keep below.
      highest_m: the highest that the file knows, 0 without one.
      num_known: how many known heights of the file say it; 0: the packaged table does.
    """

    likely_m: float
    highest_m: float
    num_known: int


def classes_of(area_m2: np.ndarray) -> np.ndarray:
    """Return the class of buildings, ``[N]`` objects, by the areas of their outlines."""
    return CLASSES[np.searchsorted(CLASSES_M2, area_m2, side="right")]


def likely_of(known_m: np.ndarray) -> float:
    """Return what `LIKELY_SHARE` of a class keep below by its known heights, ``[n]``; the highest where n is small."""
    rank = math.ceil((len(known_m) + 1) * LIKELY_SHARE)
    return float(np.sort(known_m)[min(rank, len(known_m)) - 1])


def learned_from(classes: np.ndarray, known_m: np.ndarray) -> dict[str, Learned]:
    """Return what is learned of each class that occurs and of which enough is known, here or in `PACKAGED`.

    Args:
      classes: ``[N]`` objects.
      known_m: ``[N]`` heights, 0 where the file states none.
    """
    learned = {}
    for name in dict.fromkeys(classes):
        known = known_m[(classes == name) & (known_m > 0)]
        highest_m = float(known.max(initial=0.0))
        if len(known) >= LEAST_KNOWN:
            learned[name] = Learned(likely_of(known), highest_m, len(known))
        elif name in PACKAGED:
            learned[name] = Learned(PACKAGED[name], highest_m, 0)
    return learned


def of_classes(learned: Mapping[str, Learned], classes: np.ndarray, field: str) -> np.ndarray:
    """Return ``[N]`` a field of `Learned` by class, inf where nothing is learned."""
    values = np.full(len(classes), math.inf)
    for name, each in learned.items():
        values[classes == name] = getattr(each, field)
    return values
