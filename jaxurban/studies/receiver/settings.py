"""How a receiver's log is set against maps."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from jaxurban.errors import InputError, positive, typed

MAX_SKY_STEP_S = 300.0  # a satellite moves by half a degree a minute: more would no longer be the log's sky


@typed
@dataclass(frozen=True)
class ReceiverSettings:
    """How a receiver's log is set against maps. None of these is fitted to a log.

    Attributes:
      antenna_height_m: of the receiver's antenna above the ground.
      resolution_m: which of the scenario's resolutions; left out, the first.
      sky_step_s: satellites stand still for so long; each epoch takes the sky nearest to it, half as far off at most.
      piece_m: what is compared are medians over pieces of track so long.
      other_pieces_m: further lengths of pieces for which the same is reported.
      block_m: length of the blocks of track within which ranks are compared, and of which one after the other is left
        out for the interval.

    Raises:
      InputError: a value that is none of these.
    """

    antenna_height_m: float = 2.0
    resolution_m: float | None = None
    sky_step_s: float = 30.0
    piece_m: float = 25.0
    other_pieces_m: Sequence[float] = (10.0, 50.0, 100.0)
    block_m: float = 200.0

    def __post_init__(self) -> None:
        for name in ("antenna_height_m", "piece_m", "block_m", "sky_step_s"):
            positive(name, getattr(self, name), "seconds" if name.endswith("_s") else "metres")
        if self.resolution_m is not None:
            positive("resolution_m", self.resolution_m, "metres")
        for value in self.other_pieces_m:
            positive("each of other_pieces_m", value, "metres")
        if self.sky_step_s > MAX_SKY_STEP_S:
            raise InputError(f"sky_step_s must be at most {MAX_SKY_STEP_S:g} seconds, got {self.sky_step_s:g}")
        if self.block_m < self.piece_m:
            raise InputError(
                f"block_m must be at least piece_m, {self.piece_m:g}, got {self.block_m:g}: make it longer"
            )

    @property
    def pieces_m(self) -> tuple[float, ...]:
        """All lengths of pieces, from short to long."""
        return tuple(sorted({float(self.piece_m), *map(float, self.other_pieces_m)}))

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain, JSON-ready values."""
        return {name: list(value) if isinstance(value, tuple | list) else value for name, value in asdict(self).items()}
