"""How steps are costed, and which the grid allows."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np

from jaxurban.errors import one_of, positive, typed
from jaxurban.kernels.compiled import compiled
from jaxurban.settings import DEFAULTS, CostKind, Diagonal

# (row, column) of the eight steps; bit k of a cell's moves stands for step k.
STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))


@typed
@dataclass(frozen=True)
class CostModel:
    """How steps are costed, and which steps the grid allows: one argument, so that none of it is lost on the way.

    Attributes:
      kind: ``"line"``, which does not depend on the resolution, or ``"cell"`` (the paper; see `Problem`).
      reference_length_m: ``l_0`` of the line model.
      connectivity: 4 or 8 neighbours, for grid planners.
      diagonal: ``"both-free"`` allows a diagonal step only where both orthogonal neighbours are free, and no path of
        any planner between two blocked cells that touch at a corner; ``"always"`` allows either.

    Raises:
      InputError: a value that is none of these.
    """

    kind: CostKind = DEFAULTS.cost_model
    reference_length_m: float = DEFAULTS.reference_length_m
    connectivity: Literal[4, 8] = DEFAULTS.connectivity
    diagonal: Diagonal = DEFAULTS.diagonal

    def __post_init__(self) -> None:
        one_of("cost_model", self.kind, get_args(CostKind))
        one_of("connectivity", self.connectivity, (4, 8))
        one_of("diagonal", self.diagonal, get_args(Diagonal))
        length_m = positive("reference_length_m", self.reference_length_m, "metres")
        object.__setattr__(self, "reference_length_m", length_m)

    @classmethod
    def of(cls, given: "CostModel | CostKind | None") -> "CostModel":
        """Return a cost model as it is, the one of a kind that is named, or the default."""
        return given if isinstance(given, CostModel) else cls(given or DEFAULTS.cost_model)

    @classmethod
    @typed
    def from_settings(cls, settings: Mapping[str, Any]) -> "CostModel":
        """Return the model that settings give under the names of `settings`; what they leave out is the default."""
        given = {name: settings.get(name, default) for name, default in cls().settings.items()}
        return cls(given.pop("cost_model"), **given)

    @property
    def passes_corners(self) -> bool:
        """Whether a path may pass between two blocked cells that touch at a corner."""
        return self.diagonal == "always"

    @property
    def settings(self) -> dict[str, Any]:
        """The model under the names of its parts in scenarios and files, ``kind`` as ``cost_model``."""
        parts = asdict(self)
        return {"cost_model": parts.pop("kind"), **parts}

    @property
    def joins_corners(self) -> bool:
        """Whether a step may pass between two blocked cells that touch at a corner."""
        return self.connectivity == 8 and self.diagonal == "always"

    def __str__(self) -> str:
        return (
            f"{self.kind!r} (reference length {self.reference_length_m:g} m, {self.connectivity} neighbours, "
            f"diagonal steps {self.diagonal!r})"
        )


def allowed_moves(is_free: np.ndarray, connectivity: int, needs_both_free: bool) -> np.ndarray:
    """Return ``[Y, X]`` uint8 whose bit k is set where step k of `STEPS` leads from a free cell to a free cell.

    Args:
      is_free: ``[Y, X]`` bool; all outside is taken as not free.
      connectivity: 4 (the first four steps) or 8.
      needs_both_free: a diagonal step also needs both orthogonal neighbours free.
    """
    moves = np.empty(is_free.shape, np.uint8)
    _find_moves(np.pad(is_free, 1).view(np.uint8), 0xFF if connectivity == 8 else 0x0F, needs_both_free, moves)
    return moves


@compiled(nogil=True)
def _find_moves(framed, steps, needs_both_free, moves):
    """Set moves, given cells ``[Y + 2, X + 2]`` of 1 (free) or 0, and the bits of the steps that there are."""
    for row in range(moves.shape[0]):
        # The rows around, as `STEPS` go: bits, not branches, so that the processor takes many cells at once.
        here, north, south = framed[row + 1], framed[row + 2], framed[row]
        for col in range(1, moves.shape[1] + 1):
            up, down, east, west = north[col], south[col], here[col + 1], here[col - 1]
            diagonals = north[col + 1] << 4 | north[col - 1] << 5 | south[col + 1] << 6 | south[col - 1] << 7
            if needs_both_free:
                diagonals &= (up & east) << 4 | (up & west) << 5 | (down & east) << 6 | (down & west) << 7
            moves[row, col - 1] = -here[col] & steps & (diagonals | up | down << 1 | east << 2 | west << 3)
