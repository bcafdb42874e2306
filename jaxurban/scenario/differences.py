"""Which settings of two scenarios differ, by dotted key."""

from collections.abc import Mapping
from typing import Any

MOST_SAID = 6  # settings in one sentence
NOT_SET = "not set"

Differing = dict[str, tuple[Any, Any]]  # old and new value by dotted key, None for what is not set


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return settings by dotted key, as ``region.resolution_m``; lists stay whole, what is None is left out."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{name}.")
        elif value is not None:
            found[f"{prefix}{name}"] = list(value) if isinstance(value, tuple) else value
    return found


def differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> Differing:
    """Return what differs between settings, as JSON holds them: old and new value by dotted key, None: not set."""
    before, after = flat(old), flat(new)
    keys = [*after, *(key for key in before if key not in after)]
    return {key: (before.get(key), after.get(key)) for key in keys if before.get(key) != after.get(key)}


def differences_said(found: Differing) -> str:
    """Return differing settings in words: ``gps.mask_deg was 5.0, now 10.0``; of many the first ones."""
    said = [f"{key} was {_shown(old)}, now {_shown(new)}" for key, (old, new) in found.items()]
    more = [f"and {len(said) - MOST_SAID} more"] if len(said) > MOST_SAID else []
    return "; ".join(said[:MOST_SAID] + more)


def _shown(value: Any) -> str:
    return NOT_SET if value is None else repr(value)
