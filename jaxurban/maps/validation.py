"""Settings from outside: kinds of values with their checks, changes (``gps.mask_deg=10``), faults and differences."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, cast, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    GetPydanticSchema,
    PlainSerializer,
    ValidationError,
)

from jaxurban.errors import InputError, check_range, nearest_name
from jaxurban.metrics.weights import Weights
from jaxurban.settings import each

UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
NO_LIST = ("tuple_type", "list_type")
NO_TABLE = ("model_type", "dict_type", "dataclass_type")
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


def sentence_of(error: ValidationError, model: type, settings: Any) -> str:
    """Return the first error of a validation as one sentence that names the setting.

    Args:
      error: what pydantic found.
      model: class that was validated, a pydantic model whose fields may be models or dataclasses.
      settings: that were validated.
    """
    first = error.errors()[0]
    *parents, last = first["loc"] or ("",)
    names = []
    for part in parents:
        model = model_in(fields_of(model).get(str(part))) or model
        if _holds(settings, part):  # the rest are pydantic's names for the types of a union
            settings = settings[part]
            names.append(str(part))
    if first["type"] in UNKNOWN or first["type"] == "missing" or _holds(settings, last):
        names.append(str(last))
    where = ".".join(names)
    if first["type"] in UNKNOWN:
        valid = list(fields_of(model))
        hint = nearest_name(str(last), valid) or f"; the valid ones are {', '.join(valid)}"
        return f"unknown {'key' if parents else 'section'} {where!r}{hint}"
    if first["type"] == "missing":
        return f"{where!r} is required and missing"
    if first["type"] in NO_TABLE:
        return f"{where}: must be a table of settings, got {first['input']!r}"
    if first["type"] in NO_LIST:
        return f"{where}: must be a list in brackets, got {first['input']!r}"
    message = first["msg"].removeprefix("Value error, ")
    given = "" if first["type"] == "value_error" else f", got {first['input']!r}"
    prefix = f"{where}: " if where else ""
    return f"{prefix}{message[0].lower() + message[1:]}{given}"


def check_truths(settings: Any, model: type, where: str = "") -> None:
    """Raise ValueError for true or false where a setting is none, and for numbers beyond all measure."""
    known = fields_of(model)
    for name, value in settings.items() if isinstance(settings, Mapping) else ():
        if isinstance(value, bool) and name in known and known[name] is not bool:
            raise ValueError(f"{where}{name} cannot be {str(value).lower()}: give a number, a text or a list")
        check_range(f"{where}{name}", value)
        if inner := model_in(known.get(name)):
            check_truths(value, inner, f"{where}{name}: ")


def fields_of(model: type) -> dict[str, Any]:
    """Return the annotation of each field of a pydantic model or a dataclass, by name."""
    if issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    return {field.name: field.type for field in fields(cast(Any, model))}


def _holds(settings: Any, part: str | int) -> bool:
    """Return whether settings have such a key, or such a place in a list."""
    if isinstance(part, int):
        return isinstance(settings, Sequence) and not isinstance(settings, str) and part < len(settings)
    return isinstance(settings, Mapping) and part in settings


def model_in(annotation: Any) -> type | None:
    """Return the model or dataclass that an annotation names, on its own or in a list or union; None if none."""
    if isinstance(annotation, type) and (issubclass(annotation, BaseModel) or is_dataclass(annotation)):
        return annotation
    return next(filter(None, map(model_in, get_args(annotation))), None)


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
PositiveInt = Annotated[int, Field(gt=0)]
WeightTable = Annotated[  # weights by name; `Scenario` knows which names there are
    dict[str, Any], AfterValidator(lambda named: Weights(**named).checked()), PlainSerializer(Weights.to_dict)
]
WeightSettings = Annotated[Weights, GetPydanticSchema(lambda _, handler: handler.generate_schema(WeightTable))]


def _all_different(values: tuple) -> tuple:
    if len({f"{value:g}" if isinstance(value, float) else value for value in values}) < len(values):
        raise ValueError("names a value twice (file names carry six digits)")
    return values


Different = AfterValidator(_all_different)
DifferentList = Annotated[tuple[Positive, ...], BeforeValidator(each), Field(min_length=1), Different]
