"""Settings changed from outside a scenario's file, as ``gps.mask_deg=10``, and which of two scenarios differ."""

import tomllib
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any

from jaxurban.errors import InputError

MOST_SAID = 6  # settings in one sentence
NOT_SET = "not set"

Differing = dict[str, tuple[Any, Any]]  # old and new value by dotted key, None for what is not set


def changed(settings: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Return settings with changes, later ones over earlier ones; the settings given stay as they are.

    Args:
      settings: nested, as TOML reads them.
      changes: ``key=value`` each: a dotted key of the scenario, and a value as TOML writes it.

    Raises:
      InputError: no ``=``, or a value that is not TOML.
    """
    result = deepcopy(dict(settings))
    for change in changes:
        key, equals, value = change.partition("=")
        if not equals:
            raise InputError(f"--set {change!r} must be key=value, as in gps.mask_deg=10")
        try:
            given = tomllib.loads(f"{key} = {value}")
        except tomllib.TOMLDecodeError as error:
            raise InputError(
                f"--set {change!r} is not TOML ({error}): write texts in quotes, as in "
                "buildings.source='\"town.osm\"', and lists in brackets, as in region.altitudes_m=[20,60]"
            ) from error
        _merge(result, given)
    return result


def _merge(into: dict[str, Any], given: Mapping[str, Any]) -> None:
    for name, value in given.items():
        if isinstance(value, Mapping) and isinstance(into.get(name), dict):
            _merge(into[name], value)
        else:
            into[name] = value


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
