"""The exceptions of jaxurban, all under one root."""

import difflib
from collections.abc import Iterable


class JaxurbanError(Exception):
    """The root of every exception that jaxurban raises on purpose."""


class InputError(JaxurbanError, ValueError):
    """A wrong argument, file or setting: one sentence that names it and the remedy."""


class StaleElementsWarning(UserWarning):
    """Orbital elements are old at the chosen time: one sentence for the user."""


class IgnoredLimitWarning(UserWarning):
    """Something in a file of no-fly zones is not read, or is read more cautiously: one sentence for the user."""


class LeftOutWarning(UserWarning):
    """Something in a file of routes is not read: one sentence for the user."""


class OtherSettingsWarning(UserWarning):
    """Routes are fitted under other settings than they were planned under: one sentence for the user."""


def nearest_name(name: str, valid: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the valid name closest to ``name``, or ``""``."""
    close = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else ""
