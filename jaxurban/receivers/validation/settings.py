"""How a receiver's log is set against maps."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from jaxurban.checks import at_least, one_of, positive, typed
from jaxurban.errors import InputError

OF_CITY, EVERYWHERE = "city", "all"  # what `ReceiverSettings.known` may say
SYSTEMS = "GRECJIS"  # GPS, GLONASS, Galileo, BeiDou, QZSS, NavIC, SBAS
# A satellite moves by half a degree a minute: more would no longer be the log's sky.
MAX_SKY_STEP_S = 300.0


@typed
@dataclass(frozen=True)
class ReceiverSettings:
    """How a receiver's log is set against maps. None of these is fitted to a log.

    Attributes:
      antenna_height_m: height of the receiver's antenna above the ground.
      sky_step_s: seconds for which satellites stand still; each epoch takes the sky nearest to it in time.
      block_m: length of the blocks of track that the bootstrap of the scores draws.
      known: where the buildings are known: ``"city"``, what their file covers; a number, this many metres around the
        track; or ``"all"``, which judges rays that leave the data as if nothing stood there.
      systems: letters of the satellite systems that are taken, such as ``"G"`` and ``"E"``; empty, all of the log.
      seed: of the bootstrap.

    Raises:
      InputError: a length or time that is not positive, or a sky that stands still for more than 300 s.

    Examples:
      >>> ju.studies.ReceiverSettings(antenna_height_m=1.5).block_m
      50.0
    """

    antenna_height_m: float = 2.0
    sky_step_s: float = 30.0
    block_m: float = 50.0
    known: str | float = OF_CITY
    systems: Sequence[str] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        """Check all settings."""
        for name in ("antenna_height_m", "block_m", "sky_step_s"):
            positive(name, getattr(self, name))
        if not isinstance(self.known, str):
            positive("known", self.known, "metres")
        else:
            one_of("known", self.known, (OF_CITY, EVERYWHERE))
        at_least("seed", self.seed)
        unknown = [letter for letter in self.systems if letter not in SYSTEMS]
        if unknown:
            raise InputError(
                f"systems must be letters of {', '.join(SYSTEMS)} (as RINEX has them), got {unknown[0]!r}"
            )
        if self.sky_step_s > MAX_SKY_STEP_S:
            raise InputError(
                f"sky_step_s must be at most {MAX_SKY_STEP_S:g} seconds, got {self.sky_step_s:g}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain, JSON-ready values.

        Returns:
          Every attribute by its name.

        Examples:
          >>> settings = ju.studies.ReceiverSettings(systems=("G",)).to_dict()
          >>> settings["systems"], settings["known"]
          (['G'], 'city')
        """
        return {**asdict(self), "systems": list(self.systems)}
