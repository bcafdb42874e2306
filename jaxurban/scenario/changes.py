"""Settings changed from outside a scenario's file, as the command line gives them: ``gps.mask_deg=10``."""

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from jaxurban.errors import InputError
from jaxurban.scenario.validation import fields_of, model_in

OPEN = ("layers", "weights")  # sections whose keys are names that a user chooses
MOST_NEAR = 3


def changed(settings: Mapping[str, Any], changes: Iterable[str], model: type) -> dict[str, Any]:
    """Return settings with changes, later ones over earlier ones; the settings given stay as they are.

    Args:
      settings: nested, as TOML reads them.
      changes: ``key=value`` each: a dotted key of the scenario, and a value as TOML writes it.
      model: the scenario's class, which knows the keys.

    Raises:
      InputError: no ``=``, a key that no scenario has (names near ones), or a value that is not TOML.
    """
    result = _copied(settings)
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
        _check(given, model)
        _merge(result, given)
    return result


def keys_of(model: type) -> list[str]:
    """Return every dotted key of a scenario but those of the sections that a user names keys in."""
    found = []
    for section, annotation in fields_of(model).items():
        inner = None if section in OPEN else model_in(annotation)
        found += [section] if inner is None else [f"{section}.{key}" for key in fields_of(inner)]
    return found


def _check(given: Mapping[str, Any], model: type) -> None:
    known = keys_of(model)
    sections = {key.partition(".")[0] for key in known if "." in key}
    for section, value in given.items():
        if section in OPEN:
            continue
        if section in sections and not isinstance(value, Mapping):
            near = next(each for each in known if each.startswith(f"{section}."))
            raise InputError(f"--set: {section!r} is a section of settings: name one of them, as in {near}=...")
        for key in [f"{section}.{name}" for name in value] if isinstance(value, Mapping) else [section]:
            if key not in known:
                raise InputError(f"--set: a scenario has no key {key!r}{_near(key, known)}")


def _near(key: str, known: list[str]) -> str:
    """Return the keys of that name in other sections, then those that are spelt like it."""
    name = key.rpartition(".")[2]
    same = [each for each in known if each.rpartition(".")[2] == name]
    near = [*same, *difflib.get_close_matches(key, known, MOST_NEAR, 0.6)]
    listed = " or ".join(map(repr, list(dict.fromkeys(near))[:MOST_NEAR]))
    return f" (did you mean {listed}?)" if listed else ": docs/reference/scenario.md lists them"


def _copied(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _copied(value) if isinstance(value, Mapping) else value for name, value in settings.items()}


def _merge(into: dict[str, Any], given: Mapping[str, Any]) -> None:
    for name, value in given.items():
        if isinstance(value, Mapping) and isinstance(into.get(name), dict):
            _merge(into[name], value)
        else:
            into[name] = value
