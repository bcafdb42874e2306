"""What of a file's features stands, by `rules.py`: a building, another structure, or nothing and why."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd

from jaxurban.cities.heights import is_given, parse_count, read_column
from jaxurban.cities.kinds import GARAGES, WATERS
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.rules import GIVES, NAMES, RANKS, decide, labels_of
from jaxurban.cities.signs import signs_of
from jaxurban.io.issues import LEFT_OUT, ReadIssue, ReadIssues, num_of

# Of each rule: as what it is counted that nothing stands, None where something does.
COUNTED_AS = np.array([getattr(gives, "counted_as", None) for gives in GIVES], object)
IS_SOMETHING = pd.isna(COUNTED_AS)
LEVELS_BELOW = re.compile(r"(?:\D*(?<!\d)-\d+)+\D*")  # not -1-3, a range


def what_stands(outlines: Outlines, has_decks: bool) -> tuple[Outlines, ReadIssues]:
    """Return those features that stand, ``N``, with what they are beside their tags, and how many do not, by reason.

    What lies below the ground is left out. Water that does not stand is not counted.

    Args:
      outlines: with their tags.
      has_decks: whether areas of bridges that are no buildings are decks.

    Returns:
      Tags more: ``verdict``, ``[N]`` objects, `BUILDING` or the `Kind` of another structure; ``rule``, the name of
      that which decided; ``label``, what the file calls what is unknown; ``kind_limit_m``, the highest bound
      by rules of other kinds, 0 without one; ``is_part``, ``is_deck`` and ``is_outline``, neither of both, ``[N]``
      bool, of buildings.
    """
    signs = signs_of(outlines, has_decks) | {"below": _is_below(outlines)}
    decided, beside, limits_m = decide(outlines, signs)
    is_deck = decided == RANKS["deck of a bridge"]
    more = {
        "verdict": GIVES[decided],
        "rule": NAMES[decided],
        "label": labels_of(outlines, beside),
        "kind_limit_m": limits_m,
        "is_part": signs["part"],
        "is_deck": is_deck,
        "is_outline": ~(signs["part"] | is_deck),
    }
    stands = IS_SOMETHING[decided] & ~signs["below"]
    standing = replace(outlines, tags={**outlines.tags, **more}).take(stands)
    return standing, _left_out(outlines, decided, signs["below"])


def _left_out(outlines: Outlines, decided: np.ndarray, is_below: np.ndarray) -> ReadIssues:
    """Return how many features do not stand, by reason.

    Args:
      outlines: ``N`` features.
      decided: ``[N]`` the rule that decides on each.
      is_below: ``[N]`` bool, which lie below the ground.
    """
    is_something = IS_SOMETHING[decided]
    reason = np.where(is_something & is_below, ReadIssue.UNDERGROUND, COUNTED_AS[decided])
    counted = reason[is_something | ~is_water(outlines)]
    return {each: num_of(counted == each) for each in LEFT_OUT}


def is_water(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether features are water, or a shore of it."""
    return np.logical_or.reduce([outlines.says(key, values) for key, values in WATERS.items()])


def _is_below(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether features lie below the ground: a layer below 0 does not say it, which orders alone.

    Where a height says that something stands there, levels and the kind of a parking say nothing.
    """
    levels = read_column(outlines.column("levels"), parse_count)
    roof_levels = read_column(outlines.column("roof_levels"), parse_count)
    is_without_levels = (levels == 0) & (outlines.texts("levels_below") != "") & ~(roof_levels > 0)
    is_parking = outlines.texts("parking") == ReadIssue.UNDERGROUND
    is_parking &= outlines.says("building", GARAGES) & ~(levels > 0)
    is_on_levels_below = _is_on_levels_below(outlines)
    is_flat = ~is_given(outlines.column("height"))
    is_tube = outlines.says("railway", ["monorail"]) & outlines.says("tunnel", ["yes"])
    is_below = is_flat & (is_on_levels_below | is_without_levels | is_parking | is_tube)
    return is_below | (outlines.texts("location") == ReadIssue.UNDERGROUND)


def _is_on_levels_below(outlines: Outlines) -> np.ndarray:
    """Return ``[N]`` whether all levels on which buildings and parts lie are below the ground."""
    level = outlines.texts("level")
    is_building = (outlines.texts("building") != "") | (outlines.texts("part") != "")
    is_below = (level != "") & is_building
    is_below[is_below] = [LEVELS_BELOW.fullmatch(text) is not None for text in level[is_below]]
    return is_below
