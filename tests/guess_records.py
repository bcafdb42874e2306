"""Guesses of made maps, and guesses by their names."""

from collections.abc import Iterable

from jaxurban.knowledge import Guess, GuessKind, guesses_to

NOMINAL = Guess(GuessKind.NOMINAL_SKY, facts={"systems": "GPS", "time": "noon"})
FLAT = Guess(GuessKind.FLAT_GROUND)


def heights(share: float, kinds: str = "3 by the default of 10 m") -> Guess:
    """Return the guess on a share of the heights of buildings."""
    return Guess(GuessKind.HEIGHTS, share, 3, facts={"kinds": kinds, "medians": ""})


def attribute(*guesses: Guess) -> dict[str, str]:
    """Return the attribute of maps that holds guesses."""
    return {"guesses": guesses_to(guesses)}


def by_name(guesses: Iterable[Guess]) -> dict[str, str]:
    """Return the sentences of guesses by their names."""
    return {guess.name: guess.sentence for guess in guesses}
