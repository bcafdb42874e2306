"""How steps are costed, and which the grid allows."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from jaxurban.errors import one_of, positive, typed
from jaxurban.planners.cost import CostKind
from jaxurban.presets import DEFAULTS

Diagonal = Literal["both-free", "always"]


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
    reference_length_m: float = 5.0
    connectivity: Literal[4, 8] = 8
    diagonal: Diagonal = "both-free"

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
