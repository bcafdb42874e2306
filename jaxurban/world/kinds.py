"""The kinds of what stands: which hide satellites, and which return a lidar's beam.

All of them close cells and count for the distance to obstacles. These are choices: a crown lets signals through, weaker
(Goldhirsh and Vogel 1998, chapter 2, measure 5 to 15 dB at 1.6 GHz), so that ``[gps] plants = "hide"`` gives the other
bound; masts, pylons and wires are thinner than a signal's first Fresnel zone, some 1.5 m wide at 10 m; cranes and
turbines stand with the discs that they sweep, most of which is empty.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from jaxurban.checks import typed
from jaxurban.errors import InputError
from jaxurban.settings import Preset, as_tuple
from jaxurban.world.footprints import BUILDING, UNKNOWN

KindName = Literal[
    "building",
    "chimney",
    "tank",
    "tower",
    "canopy",
    "structure",
    "bridge",
    "mast",
    "pole",
    "pylon",
    "crane",
    "turbine",
    "tree",
    "wood",
    "wire",
    "cableway",
]
ALL_KINDS: tuple[KindName, ...] = get_args(KindName)
PLANTS = "tree", "wood"
WIRES = "wire", "cableway"
OTHERS = "other structures"
MOST_WOOD_M = 45.0  # no wood of unknown height is higher (`jaxurban.cities.kinds` says why)


class Effects(NamedTuple):
    """What a kind does beside closing cells.

    Attributes:
      hides: satellites.
      returns: a lidar's beam.
    """

    hides: bool = True
    returns: bool = True


# What is of unknown extent is taken for solid. The order gives the codes of the maps' ``roof_kind``.
EFFECTS: dict[str, Effects] = {
    **dict.fromkeys((*ALL_KINDS, UNKNOWN), Effects()),
    **dict.fromkeys(("mast", "pole", "pylon", *PLANTS), Effects(hides=False)),
    **dict.fromkeys(("crane", "turbine", *WIRES), Effects(hides=False, returns=False)),
}
CODES = {kind: number for number, kind in enumerate(EFFECTS, 1)}
# By kind: the group in which pictures show it.
GROUPS = {
    **dict.fromkeys(EFFECTS, OTHERS),
    BUILDING: "buildings",
    **dict.fromkeys(PLANTS, "trees"),
    **dict.fromkeys(WIRES, "wires"),
    UNKNOWN: "unknown",
}


@typed
@dataclass(frozen=True)
class Obstacles:
    """What counts of all that stands: a scenario's ``[obstacles]``.

    Attributes:
      kinds: of `ALL_KINDS`; left out, all, or with the preset of the paper buildings alone. What is of
        unknown extent always counts.

    Raises:
      InputError: an unknown kind, or buildings left out.

    Examples:
      >>> ju.Obstacles(kinds=("building", "tree", "wood")).kinds
      ('building', 'tree', 'wood')
    """

    kinds: tuple[KindName, ...] | None = None

    def __post_init__(self) -> None:
        if self.kinds is not None:
            kinds = as_tuple(self.kinds)
            if BUILDING not in kinds:
                raise InputError(f"kinds must hold {BUILDING!r}, got {[*kinds]}: add it")
            object.__setattr__(self, "kinds", kinds)

    def under(self, preset: Preset) -> tuple[KindName, ...]:
        """Return the kinds that count under a preset.

        Args:
          preset: of the settings of planning.

        Returns:
          Names, of `ALL_KINDS`.

        Examples:
          >>> ju.Obstacles().under("paper")
          ('building',)
        """
        if self.kinds is None and preset == "paper":
            return (BUILDING,)
        return self.kinds or ALL_KINDS
