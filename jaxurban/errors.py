"""The exceptions of jaxurban, all under one root."""

import difflib
import functools
import inspect
import math
import numbers
import os
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from jaxurban.public import find_public

Choice = TypeVar("Choice")
Public = TypeVar("Public", bound=Callable)
Kind = tuple[str, Callable[[Any], bool]]  # what messages call it, and what tells its values
MOST_SAID = 300  # characters of what a library says that a message passes on


class JaxurbanError(Exception):
    """The root of every exception that jaxurban raises on purpose."""


class InputError(JaxurbanError, ValueError):
    """A wrong argument, file or setting: one sentence that names it and the remedy."""


class RemadeError(InputError):
    """Maps that were opened are not those of their folder any more."""


class StaleElementsWarning(UserWarning):
    """Orbital elements are old at the chosen time: one sentence for the user."""


class GuessWarning(UserWarning):
    """Maps rest on something that their files do not say: one sentence for the user, with the remedy."""


class IgnoredZoneWarning(UserWarning):
    """Something in a file of no-fly zones is not read, or is read more cautiously: one sentence for the user."""


class LeftOutWarning(UserWarning):
    """Something in a file of routes is not read: one sentence for the user."""


class OtherSettingsWarning(UserWarning):
    """Routes are fitted under other settings than they were planned under: one sentence for the user."""


def nearest_name(name: str, valid: Iterable[str], least: float = 0.5) -> str:
    """Return ``" (did you mean 'x'?)"`` for the valid name that begins with ``name`` or is closest to it, or ``""``."""
    names = list(valid)
    begun = [each for each in names if str(name) and each.startswith(str(name))]
    close = difflib.get_close_matches(str(name), begun or names, n=1, cutoff=0.0 if begun else least)
    return f" (did you mean {close[0]!r}?)" if close else ""


def typed(public: Public, makers: Sequence[Callable] = ()) -> Public:
    """Return a function or a class that answers an argument of another kind than its annotation names by InputError.

    Arguments are looked at before anything runs, generously: any real number for a float (NumPy's too), anything with
    items for a sequence, text for a path. Of sequences of our own classes each item is looked at.

    Args:
      public: the function or class.
      makers: functions to which it passes its further keywords on (`taken_by`): what they take by keyword alone, it
        takes too.
    """
    is_class = inspect.isclass(public)
    function = public.__init__ if is_class else public
    signature = inspect.signature(function)
    if makers:
        *own, _ = signature.parameters.values()
        passed = {p.name: p for maker in makers for p in inspect.signature(maker).parameters.values()}
        own += [p for name, p in passed.items() if p.kind is p.KEYWORD_ONLY and name not in signature.parameters]
        signature = signature.replace(parameters=own)
    parameters = signature.parameters.values()
    in_order = [p.name for p in parameters if p.kind is not p.KEYWORD_ONLY]
    the_rest = [p.name for p in parameters if p.kind is p.VAR_POSITIONAL]
    further = next((p.name for p in parameters if p.kind is p.VAR_KEYWORD), None)
    names = {p.name for p in parameters}

    @functools.cache
    def kinds() -> dict[str | None, list[Kind]]:  # at the first call, when every module that annotations name is there
        hints: dict[str, Any] = {}
        for each in (*makers, function):
            hints |= get_type_hints(each, localns=_PublicNames())
        return {name: _kinds(hint) for name, hint in hints.items() if name in names}

    @functools.wraps(function)
    def checked(*args, **kwargs):
        named = zip((*in_order, *the_rest * len(args)), args, strict=False)
        for name, value in (*named, *kwargs.items()):
            allowed = [] if name == further else kinds().get(name if name in names else further, [])
            if allowed and not any(is_one(value) for _, is_one in allowed):
                listed = _either(dict.fromkeys(told for told, _ in allowed))
                unit = next((f" ({unit})" for end, unit in UNITS.items() if name.endswith(end)), "")
                order = f": call {public.__name__}({', '.join(in_order)})" if _is_class_of_ours(type(value)) else ""
                raise InputError(f"{name} must be {listed}{unit}, got {_shown(value)}{order}")
            check_range(name, value)
        try:
            signature.bind(*args, **kwargs)
        except TypeError as error:
            wrong = next((name for name in kwargs if name not in names), "")
            places = [place_of(wrong, each) for each in (function, *makers)]
            meant = nearest_name(wrong, names, 0.8) or next(filter(None, places), nearest_name(wrong, names, 0.6))
            fault = f"there is no argument {wrong!r}{meant}" if wrong else str(error)
            raise InputError(f"{public.__name__}: {fault}") from error
        try:
            return function(*args, **kwargs)
        except (RuntimeError, AssertionError) as error:
            if remedy := platform_remedy(error):
                raise InputError(remedy) from error
            raise

    if is_class:
        public.__init__ = checked  # type: ignore[method-assign]
        return public
    checked.__signature__ = signature  # type: ignore[attr-defined]
    return checked  # type: ignore[return-value]


def taken_by(maker: Callable, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of some keywords that a function takes."""
    return {name: given[name] for name in inspect.signature(maker).parameters if name in given}


def _either(choices: Iterable[str]) -> str:
    *others, last = choices
    return f"{', '.join(others)} or {last}" if others else last


def place_of(name: str, function: Callable, levels: int = 2) -> str:
    """Return ``" (give constraints=Constraints.read(name=...))"`` for an argument of what makes another, or ``""``."""
    makers = []
    for parameter, hint in get_type_hints(function, localns=_PublicNames()).items():
        for kind in (hint, *get_args(hint)):
            with suppress(KeyError):
                if parameter != "return" and find_public(getattr(kind, "__name__", "")):
                    called = re.split(",| or ", MADE_BY.get(kind.__name__, kind.__name__))[0]
                    name_of_class, _, method = called.partition(".")
                    maker = find_public(name_of_class)
                    makers.append((parameter, called, getattr(maker, method) if method else maker))
    for parameter, called, maker in makers:
        if name in inspect.signature(maker).parameters:
            return f" (give {parameter}={called}({name}=...))"
    for parameter, called, maker in makers if levels > 1 else ():
        if place := place_of(name, maker, levels - 1):
            return place.replace("give ", f"give {parameter}={called}(") + ")"
    return ""


def platform_remedy(error: Exception) -> str:
    """Return what to do where an error comes from JAX's start on the platforms that are chosen, else an empty text."""
    chosen = os.environ.get("JAX_PLATFORMS")
    if not chosen:
        return ""
    if "JAX_PLATFORMS" not in str(error):  # as of CUDA without its plugin
        import jax

        with suppress(RuntimeError, AssertionError):
            jax.devices()
            return ""
    return f"JAX does not work under JAX_PLATFORMS={chosen}: unset it, or choose another value"


class _PublicNames(dict):
    """The public names of the package, for hints on what their module imports for type checkers alone."""

    def __missing__(self, name: str) -> Any:
        return find_public(name)


def check_range(name: str, value: Any) -> None:
    """Raise InputError where a number, or one in a list of them, is beyond what any such number can be.

    Without end (``inf``) may be what has no unit of length or angle, such as a budget of seconds; of what is no number
    (NaN) functions tell themselves.
    """
    for number in value if isinstance(value, list | tuple) else (value,):
        if not isinstance(number, numbers.Real):
            continue
        if isinstance(number, numbers.Integral) and abs(int(number)) > MOST_WHOLE:
            raise InputError(f"{name} must be a whole number of at most {MOST_WHOLE}, got {number!r}")
        most = next((most for end, most in MOST_OF.items() if name.endswith(end)), MOST)
        is_endless = most == MOST and isinstance(number, float) and math.isinf(number)
        if abs(float(number)) > most and not is_endless:
            unit = next((f" {unit}" for end, unit in UNITS.items() if name.endswith(end) and end[0] == "_"), "")
            raise InputError(f"{name} must be a finite number, of at most {most:.0e}{unit}, got {number!r}")


def _kinds(hint: Any) -> list[Kind]:
    """Return how messages call each kind that a type hint allows, and what tells its values; none: anything goes."""
    hint = getattr(hint, "array_type", hint)  # of jaxtyping's shapes
    origin = get_origin(hint) or hint
    if origin in (Union, types.UnionType):
        parts = [_kinds(part) for part in get_args(hint)]
        return [kind for part in parts for kind in part] if all(parts) else []
    if origin is Annotated:
        return _kinds(get_args(hint)[0])
    if origin is Literal:  # which of them, the function itself checks
        return list(dict.fromkeys(KINDS[type(choice)] for choice in get_args(hint)))
    if origin in (Sequence, Iterable, tuple, Mapping) and (item := _kind_of_items(hint)):
        return [item]
    if origin in KINDS:
        return [KINDS[origin]]
    return [(_called(origin), lambda value: isinstance(value, origin))] if _is_class_of_ours(origin) else []


def _called(kind: type) -> str:
    name = kind.__name__
    article = "" if name.endswith("s") else "an " if name[0] in "AEIOU" else "a "
    return f"{article}{name}" + (f" (from {MADE_BY[name]})" if name in MADE_BY else "")


def _kind_of_items(hint: Any) -> Kind | None:
    """Return the kind of a sequence of texts, of numbers or of our own classes, or a dict of these; None for others."""
    origin, *given = get_origin(hint), *get_args(hint)
    is_dict = origin is Mapping
    if not given or given[1 + is_dict :] not in ([], [...]):
        return None
    items = given[is_dict]
    if items is str and not is_dict:
        return "a sequence of texts", lambda value: isinstance(value, Iterable)  # one text is often taken for one
    is_of_numbers = items is float and origin in (Sequence, Iterable)  # not a place, which may hold None
    if not (is_of_numbers or _names_ours(items)):
        return None
    kinds = _kinds(items)
    told = "numbers" if is_of_numbers else " or ".join(re.sub("^an? ", "", told) for told, _ in kinds)
    has_items = KINDS[origin][1]

    def is_one(value: Any) -> bool:
        if not has_items(value) or isinstance(value, Iterator):  # which can be read only once
            return has_items(value)
        return all(any(is_one(item) for _, is_one in kinds) for item in (value.values() if is_dict else value))

    return f"{'a dict' if is_dict else 'a sequence'} of {told}", is_one


def _names_ours(hint: Any) -> bool:
    return _is_class_of_ours(hint) or any(map(_names_ours, get_args(hint)))


def _is_class_of_ours(hint: Any) -> bool:
    ours = (__name__.partition(".")[0], "pandas", "xarray", "jax")
    return inspect.isclass(hint) and hint.__module__.partition(".")[0] in ours


def _is_number(value: Any) -> bool:
    is_scalar = isinstance(value, numbers.Real) or getattr(value, "shape", None) == ()
    return is_scalar and not isinstance(value, bool)


KINDS: dict[Any, Kind] = {
    bool: ("True or False", lambda value: type(value).__name__ in ("bool", "bool_")),
    int: ("a whole number", lambda value: isinstance(value, numbers.Integral) and not isinstance(value, bool)),
    float: ("a number", _is_number),
    # A time may be of any kind where a text is asked for.
    str: ("a text", lambda value: isinstance(value, str | datetime) or type(value).__name__ == "datetime64"),
    Path: ("a path", lambda value: isinstance(value, str | os.PathLike)),
    types.NoneType: ("None", lambda value: value is None),
    **dict.fromkeys(
        (Sequence, Iterable, list, tuple),
        ("a sequence", lambda value: isinstance(value, Iterable) and not isinstance(value, str | bytes)),
    ),
    **dict.fromkeys((Mapping, dict), ("a dict", lambda value: isinstance(value, Mapping))),
    Callable: ("a function", callable),
}


def _shown(value: Any) -> str:
    """Return a plain value, or a short list of them, as it is written, and the type of any other."""
    if isinstance(value, list | tuple) and len(value) <= MOST_SHOWN:
        return f"{type(value).__name__} of {', '.join(map(_shown, value)) or 'nothing'}"
    return repr(value) if isinstance(value, str | numbers.Number | None) else type(value).__name__


MOST_WHOLE = 2**63 - 1
MOST = 1e30  # of a number: its square is no overflow, nor it itself in float32
MOST_OF = {"_m": 1e8, "_deg": 1e3}  # the whole way round the Earth is 4e7 m
MOST_SHOWN = 4  # values of a list
UNITS = {  # what messages add, by the end of an argument's name
    **dict.fromkeys(("start", "goal", "lonlat", "reference"), "longitude, latitude in degrees"),
    **dict.fromkeys(("_xy_m",), "easting, northing in metres"),
    **{"bounds": "west, south, east, north in degrees", "_m_s": "metres per second"},
    **{"_m": "metres", "_s": "seconds", "_deg": "degrees", "_w": "watts"},
}
MADE_BY = {  # what no constructor is meant for
    "Constraints": 'Constraints.read, as in Constraints.read(require=["gps>=0.3"])',
    "City": "City.from_files or demo_city",
    "CostMap": "cost_map",
    "Demonstration": "read_demonstrations",
    "MapComparison": "compare",
    "MetricMaps": "build_maps or open_maps",
    "ReceiverValidation": "validate",
    "PlannedPath": "plan or plan_many",
    "RouteQuery": "make_queries",
    "Sensitivity": "sensitivity",
    "SoftCity": "soft_city",
}


def one_of(name: str, value: Choice, choices: Iterable[Choice]) -> Choice:
    """Return a value that must be one of some choices.

    Raises:
      InputError: it is none of them (lists them, and names the nearest one).
    """
    valid = list(choices)
    if value not in valid:
        hint = nearest_name(str(value), [str(choice) for choice in valid])
        raise InputError(f"{name} must be {_either(map(repr, valid))}, got {value!r}{hint}")
    return value


def positive(name: str, value: Any, unit: str = "") -> float:
    """Return a number that must be above 0, as a float.

    Raises:
      InputError: it is 0 or below, not finite, or not a number.
    """
    number = _number(value)
    if not 0 < number < math.inf:
        raise InputError(f"{name} must be a positive number{unit and f' of {unit}'}, got {value!r}")
    return number


def at_least(name: str, value: Any, least: int = 0) -> int:
    """Return a whole number that must not be below another, such as a seed.

    Raises:
      InputError: it is, or is not a whole number.
    """
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not is_whole or int(value) < least:
        raise InputError(f"{name} must be a whole number from {least} up, got {_shown(value)}")
    return int(value)


def finite(name: str, value: Any, unit: str = "") -> float:
    """Return a number (or the one that a text spells) that must be finite, as a float.

    Raises:
      InputError: it is not, or is not a number.
    """
    number = _number(value, bool)
    if not math.isfinite(number):
        raise InputError(f"{name} must be a finite number{unit and f' of {unit}'}, got {value!r}")
    return number


def _number(value: Any, refused: Any = bool | str) -> float:
    """Return a value as a float; NaN where it is none, or of a type that is refused."""
    try:
        return math.nan if isinstance(value, refused) else float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def reason_of(error: BaseException) -> str:
    """Return what an error of the system or of a library says, on one line; only the beginning of what is long."""
    said = getattr(error, "strerror", None) or " ".join(str(error).split())
    return said if len(said) <= MOST_SAID else f"{said[:MOST_SAID]} ..."


def check_file(path: str | os.PathLike[str]) -> None:
    """Raise OSError where a path names a pipe or a device, whose reading may never end; a missing file passes."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError("it is a pipe or a device, not a file")


@contextmanager
def readable(path: str | Path, kind: str, remedy: str, *errors: type[Exception], what: str = "") -> Iterator[None]:
    """Turn errors of the block, which reads a file, into an InputError: what it is, the reason and the remedy.

    Args:
      path: of the file.
      kind: what it cannot be read as.
      remedy: ends the sentence.
      errors: what a damaged file raises, beside OSError, ValueError and RecursionError (brackets in brackets); an
        InputError passes as it is.
      what: the file, for the message; its path, if left out.
    """
    what = what or repr(str(path))
    caught: tuple[type[Exception], ...] = (OSError, ValueError, RecursionError, *errors)
    try:
        check_file(path)
        yield
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{what} does not exist: check the path") from error
    except caught as error:
        raise InputError(f"{what} cannot be read as {kind} ({reason_of(error)}): {remedy}") from error
