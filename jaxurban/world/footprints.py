"""Outlines of what stands, and where their heights came from."""

from collections import Counter
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
import shapely

from jaxurban.world.grid import Bounds
from jaxurban.world.rows import Rows


class HeightOrigin(IntEnum):
    """Where a building's height came from."""

    HEIGHT = 0  # a height tag or column: measured, or said by who drew it
    LEVELS = 1  # number of levels x level height
    DEFAULT = 2  # neither: the guess of its class or kind, or the default height
    RASTER = 3  # a height raster
    GENERATED = 4  # the synthetic city
    LAYER = 5  # of a bridge's deck: its layer x a clearance
    UNKNOWN = 6  # not even by rule: what stands there is not known, and the height is 0
    BESIDE_PARTS = 7  # of an outline beside its parts: that of its lowest one
    ROUGH = 8  # a rough figure, such as "about 30" or "30-40"
    UNREADABLE = 9  # the default or by levels, where what is given cannot be read or is too high
    ESTIMATED = 10  # a tag or column that a model made, as the file or its user says


GUESSED_BY = {  # the origins of heights that are guesses, as reports say them with the settings of the buildings
    HeightOrigin.LEVELS: "from the number of levels at {level_height_m:g} m each",
    HeightOrigin.DEFAULT: "{default}",
    HeightOrigin.LAYER: "decks of bridges from their layer at {layer_clearance_m:g} m each",
    HeightOrigin.UNKNOWN: "of unknown extent",
    HeightOrigin.BESIDE_PARTS: "of outlines beside their parts, by their lowest part",
    HeightOrigin.ROUGH: "by rough figures such as 30-40",
    HeightOrigin.UNREADABLE: "for want of a readable one",
    HeightOrigin.ESTIMATED: "estimated by a model",
}
KNOWN_BY = dict(  # by origin: how the height of one thing is known, in words
    zip(
        HeightOrigin,
        (
            "a height in its file",
            "its number of levels",
            "a guess",
            "a raster of heights",
            "the synthetic city",
            "the layer of a bridge",
            "not known",
            "its lowest part",
            "a rough figure in its file",
            "a guess, as none in its file can be read",
            "an estimate of a model in its file",
        ),
        strict=True,
    )
)
BUILDING: Literal["building"] = "building"
UNKNOWN = "unknown"  # of a kind that nothing says


@dataclass(frozen=True)
class Footprints(Rows):
    """Outlines of buildings, or of what else stands, as prisms with a flat roof. ``B`` of them.

    Attributes:
      polygons: ``[B]`` object array of valid shapely Polygons or MultiPolygons, in the city's CRS.
      height_m: ``[B]`` float64 roof height above ground, > 0; 0 of kind ``"unknown"``.
      min_height_m: ``[B]`` float64 height of the underside, 0 for most; `City.hanging` says what it means.
      origin: ``[B]`` uint8, a `HeightOrigin` each.
      is_part: ``[B]`` bool, from ``building:part``.
      kind: ``[B]`` objects: ``"building"``, ``"chimney"``, ``"mast"`` ...; ``"unknown"`` where something stands whose
        extent is not known. None: all are buildings.
      limit_m: ``[B]`` float64 height that all but a few roofs of guessed height keep below, inf where nothing says; of
        no meaning where the height is known. None: inf for all.
      label: ``[B]`` objects: what the file calls what is of kind ``"unknown"``, such as ``"attraction=big_wheel"``;
        ``""`` where it says nothing or the kind is known. None: ``""`` for all.
      likely_m: ``[B]`` float64 height that 99 % of what is as large or of its kind keep below, inf where nothing says
        more than ``limit_m``; of no meaning where the height is known. None: inf for all.
      rule: ``[B]`` objects: the name of the rule by which it stands, of the table of its source. None: ``""`` for all.
    """

    polygons: np.ndarray
    height_m: np.ndarray
    min_height_m: np.ndarray
    origin: np.ndarray
    is_part: np.ndarray
    kind: np.ndarray | None = None
    limit_m: np.ndarray | None = None
    label: np.ndarray | None = None
    likely_m: np.ndarray | None = None
    rule: np.ndarray | None = None

    @property
    def named(self) -> np.ndarray:
        """``[B]`` objects: the kind of each, or what the file calls what is unknown."""
        return np.where(self.labels == "", self.kinds, self.labels)

    @property
    def labels(self) -> np.ndarray:
        """``[B]`` objects: ``label``."""
        return np.full(len(self), "", object) if self.label is None else self.label

    @property
    def rules(self) -> np.ndarray:
        """``[B]`` objects: ``rule``."""
        return np.full(len(self), "", object) if self.rule is None else self.rule

    @property
    def kinds(self) -> np.ndarray:
        """``[B]`` objects: the kind of each."""
        return np.full(len(self), BUILDING, object) if self.kind is None else self.kind

    @property
    def is_guessed(self) -> np.ndarray:
        """``[B]`` bool: no height is known, and what `GUESSED_BY` names stands in."""
        return np.isin(self.origin, list(GUESSED_BY))

    def guessed_share(self, bounds_m: Bounds) -> float:
        """Return the share of the buildings in a box whose height is guessed, 0 without a building."""
        is_guessed = self.inside(bounds_m).is_guessed
        return float(is_guessed.mean()) if is_guessed.size else 0.0

    @property
    def upper_m(self) -> np.ndarray:
        """``[B]`` float64 height above ground that nothing there exceeds: ``height_m`` where it is known."""
        limit_m = np.inf if self.limit_m is None else self.limit_m
        return np.where(self.is_guessed, np.maximum(limit_m, self.height_m), self.height_m)

    @property
    def likelies_m(self) -> np.ndarray:
        """``[B]`` float64: ``likely_m``."""
        return np.full(len(self), np.inf) if self.likely_m is None else self.likely_m

    @property
    def likely_upper_m(self) -> np.ndarray:
        """``[B]`` float64 height above ground that is likely not exceeded there: ``height_m`` where it is known."""
        return np.maximum(self.height_m, np.minimum(self.upper_m, self.likelies_m))

    def facts_at(self, place: shapely.Point) -> dict[str, Any]:
        """Return ``[B]`` by the columns of `City.why` what each is, how high, and how far from a place in their CRS."""
        is_unknown = (self.kinds == UNKNOWN) | (self.origin == HeightOrigin.UNKNOWN)
        return {
            "kind": self.named,
            "rule": self.rules,
            "height_m": np.where(is_unknown, np.nan, self.height_m),
            "known_by": [KNOWN_BY[origin] for origin in self.origin],
            "likely_m": self.likely_upper_m,
            "highest_m": self.upper_m,
            "min_height_m": self.min_height_m,
            "distance_m": shapely.distance(self.polygons, place),
        }

    def joined(self, other: "Footprints | None") -> "Footprints":
        """Return these outlines and, after them, others."""
        if other is None or not len(other):
            return self
        names = ["polygons", "height_m", "min_height_m", "origin", "is_part"]
        names += ["kinds", "upper_m", "labels", "likely_upper_m", "rules"]
        columns = (np.concatenate([getattr(self, name), getattr(other, name)]) for name in names)
        return Footprints(*columns)

    def origin_counts(self) -> dict[str, int]:
        """Return the number of buildings by the origin of their height, only origins that occur."""
        counts = Counter(self.origin.tolist())
        return {HeightOrigin(origin).name.lower(): counts[origin] for origin in sorted(counts)}
