"""Settings changed from outside a scenario's file, as the command line gives them: ``gps.mask_deg=10``."""

import tomllib
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any

from jaxurban.errors import InputError


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
