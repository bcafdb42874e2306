"""Checks of what users pass, where it enters. Messages give the value, what is accepted, and the remedy."""

import functools
import inspect
import math
import numbers
import os
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import (
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    Unpack,
    get_args,
    get_origin,
    get_type_hints,
)

from jaxurban.errors import InputError, platform_remedy
from jaxurban.public import find_public
from jaxurban.spelling import alike, near

Choice = TypeVar("Choice")
Public = TypeVar("Public", bound=Callable)
PACKAGE = __name__.partition(".")[0]
MOST_SHOWN = 4  # values of a list
MOST_ALIKE = 0.9  # of an argument of something else: it must hardly differ
MOST = 2**63 - 1  # of a number: NumPy holds it, and its square is no overflow in float32
MOST_OF = {"_m": 1e8, "_deg": 1e3}  # the whole way round the Earth is 4e7 m
LENGTH = re.compile(r"(\d+(?:\.\d+)?) ?(ft|feet|foot|km|m|met(?:re|er)s?)", re.IGNORECASE)
METRES = {"f": 0.3048, "k": 1000.0, "m": 1.0}  # of a unit of length, by its first letter
UNITS = {  # of arguments, by the end of their names
    "_m_s": "metres per second",
    "_xy_m": "easting, northing in metres",
    "_m": "metres",
    "_s": "seconds",
    "_deg": "degrees",
    "_w": "watts",
    "_cost": "cost per metre",
    "bounds": "west, south, east, north in degrees",
    **dict.fromkeys(("start", "goal", "lonlat", "reference"), "longitude, latitude in degrees"),
}
MADE_BY = {  # what no constructor is meant for
    "Bound": "Constraints.read",
    "Zone": "Constraints.read",
    "Constraints": 'Constraints.read, as in Constraints.read(require=["gps>=0.3"])',
    "City": "City.from_files, sample_city or demo_city",
    "CostMap": "cost_map",
    "Demonstration": "demonstrations",
    "MetricMaps": "build_maps or open_maps",
    "PlannedPath": "plan or plan_many",
    "ReturnAltitude": "return_altitude",
    "RouteQuery": "make_queries",
    "SkyAt": "sky, as in sky(maps, place, 60.0)",
    "SoftCity": "soft_city",
}


class ArgumentKind(NamedTuple):
    """What an argument may be: its name in messages, and whether a value is of it."""

    name: str
    holds: Callable[[Any], bool]


def unit_of_argument(name: str) -> str:
    """Return the unit of an argument by the end of its name, ``""`` where none is known."""
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def nearest_name(name: str, valid: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the valid names that one resembles (`near`), ``""`` where it does none."""
    names = near(name, valid)
    return f" (did you mean {_either(map(repr, names))}?)" if names else ""


def one_of(name: str, value: Choice, choices: Iterable[Choice]) -> Choice:
    """Return a value that must be one of some choices.

    Args:
      name: what messages call the value.
      value: as the user gave it.
      choices: what it may be.

    Raises:
      InputError: it is none of them (lists them, and names the nearest one).
    """
    valid = list(choices)
    if value not in valid:
        hint = nearest_name(str(value), map(str, valid))
        raise InputError(f"{name} must be {_either(map(repr, valid))}, got {value!r}{hint}")
    return value


def finite(
    name: str,
    value: Any,
    unit: str | None = None,
    *,
    least: float = -math.inf,
    called: str = "finite",
) -> float:
    """Return a number that must be finite, as a float.

    Args:
      name: of the argument.
      value: the number, or a text that spells it; True and False are no numbers.
      unit: for the message; left out, that of the name (`UNITS`).
      least: the number must be above this one.
      called: the word of the message for numbers above ``least``, such as ``"positive"``.

    Raises:
      InputError: the value is not such a number.
    """
    check_metres(name, value, unit)
    number = math.nan  # which is in no range
    if not isinstance(value, bool):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    if not least < number < math.inf:
        unit = unit_of_argument(name) if unit is None else unit
        of_unit = f" of {unit}" if unit else ""
        raise InputError(f"{name} must be a {called} number{of_unit}, got {value!r}")
    return number


def check_metres(name: str, value: Any, unit: str | None = None) -> None:
    """Raise InputError, which says the metres, for a text such as ``"200 ft"`` in place of a number of metres.

    Args:
      name: of the argument.
      value: of any kind; of a list each value is looked at.
      unit: of the argument; left out, that of the name (`UNITS`).
    """
    unit = unit_of_argument(name) if unit is None else unit
    for text in value if isinstance(value, list | tuple) else (value,):
        length = LENGTH.fullmatch(text.strip()) if isinstance(text, str) else None
        if length and unit == "metres":
            length_m = float(length[1]) * METRES[length[2][0].lower()]
            raise InputError(f"{name} is a number of metres, got {text!r}: write {length_m:g}")


def values_given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that are given, by name: those that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def positive(name: str, value: Any, unit: str | None = None) -> float:
    """Return a number that must be above 0, as a float (see `finite`)."""
    return finite(name, value, unit, least=0, called="positive")


def different_lengths(name: str, values: Iterable[float]) -> tuple[float, ...]:
    """Return lengths in metres as a tuple, once they are checked.

    Args:
      name: of the setting that holds them, for the message.
      values: the lengths.

    Raises:
      InputError: there is none, one is not positive, or two are the same in the name of a file.
    """
    lengths_m = tuple(positive(name, value) for value in values)
    if not lengths_m:
        raise InputError(f"{name} is empty: name at least one length in metres")
    if len({f"{value:g}" for value in lengths_m}) < len(lengths_m):
        raise InputError(
            f"{name} names a value twice (file names carry six digits), got {[*lengths_m]}"
        )
    return lengths_m


def at_least(name: str, value: Any, least: int = 0) -> int:
    """Return a whole number, such as a seed, that must not be below ``least``, as an int.

    Args:
      name: what messages call the number.
      value: as the user gave it.
      least: the smallest number that is accepted.

    Raises:
      InputError: the value is below it, or is no whole number.
    """
    if not _is_whole(value) or int(value) < least:
        raise InputError(f"{name} must be a whole number from {least} up, got {_shown(value)}")
    return int(value)


def check_size(name: str, value: Any) -> None:
    """Raise InputError where a number, or one in a list of them, is larger in size than any sensible one.

    What has no unit of length or angle, such as a budget of seconds, may be infinite. NaN and values that are no
    numbers pass: the functions refuse them themselves.

    Args:
      name: of the argument, whose end is the unit that decides the largest size (`MOST_OF`).
      value: of any kind.
    """
    # The largest size, by the unit that the name ends in; without such a unit a number may be infinite.
    most = next((most for end, most in MOST_OF.items() if name.endswith(end)), MOST)
    values = value if isinstance(value, list | tuple) else (value,)
    for number in values:
        size: Any = abs(number) if isinstance(number, numbers.Real) else 0
        may_be_infinite = most == MOST
        if size > most and not (may_be_infinite and size == math.inf):
            unit = f" ({unit_of_argument(name)})" if unit_of_argument(name) else ""
            raise InputError(
                f"{name} must be a finite number of at most {most:.0e}{unit}, got {number!r}"
            )


def check_extra() -> None:
    """Raise InputError unless what processes and clusters need is installed; nothing is imported."""
    if not all(map(find_spec, ("distributed", "cryptography"))):
        raise InputError(
            "--cluster and --workers need Dask's distributed scheduler and cryptography, which are not installed: "
            "pip install 'jaxurban[cluster]', or leave them out to work in threads"
        )


def typed(public: Public) -> Public:
    """Return a function or a class that raises InputError for an argument of another kind than its annotation names.

    Arguments are looked at before anything runs, generously: any real number for a float (NumPy's too), anything with
    items for a sequence, text for a path; of lists, tuples and dicts each item is looked at. Errors of JAX's start
    become InputError with a remedy too.

    Args:
      public: the function, or the class, whose ``__init__`` is replaced.

    Returns:
      The checked function; or the same class.
    """
    # The function that is called, and the names of its parameters.
    function = public.__init__ if inspect.isclass(public) else public
    signature = inspect.signature(function)
    keywords = _keywords(function)
    if keywords:  # each stands by itself; its default ``...`` says that it may be left out
        *others, choice = signature.parameters.values()
        others += [
            inspect.Parameter(name, choice.KEYWORD_ONLY, default=..., annotation=hint)
            for name, hint in keywords.items()
        ]
        signature = signature.replace(parameters=others)
    parameters = signature.parameters
    in_order = [name for name, p in parameters.items() if p.kind is not p.KEYWORD_ONLY]
    call = f": call {public.__name__}({', '.join(in_order)})"  # ends a message
    # The name of the parameter ``**name`` that takes further keywords, "" where there is none.
    further = next((name for name, p in parameters.items() if p.kind is p.VAR_KEYWORD), "")

    @functools.cache
    def kinds() -> dict[str, list[ArgumentKind]]:
        """Return the kinds of each argument; at the first call, when all modules that hints name are loaded."""
        return {name: _kinds(hint) for name, hint in _hints(checked).items()}

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        """Call the function once its arguments are what its annotations say."""
        try:
            values = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            wrong = next((name for name in kwargs if name not in parameters), "")
            by_name = [name for name in parameters if name not in in_order]
            fault = str(error)
            if wrong:
                fault = f"there is no argument {wrong!r}{_home_of(wrong, checked)}"
            elif by_name and len(args) > len(in_order):
                fault += _place_of(args[len(in_order)], by_name, in_order[-1], kinds())
            elif public.__name__ in MADE_BY:
                fault += f": take {MADE_BY[public.__name__]}"
            raise InputError(f"{public.__name__}: {fault}") from error

        # Each value against the kinds of its argument; a keyword that ``**further`` takes has the kinds of that.
        for name, value in (values.pop(further, {}) | values).items():
            allowed = kinds().get(name if name in parameters else further, [])
            check_metres(name, value)
            _check_kind(name, value, allowed, call)
            check_size(name, value)

        try:
            return function(*args, **kwargs)
        except (RuntimeError, AssertionError) as error:
            remedy = platform_remedy(error)  # "" for an error that is not of JAX's start
            if remedy:
                raise InputError(remedy) from error
            raise

    checked.__signature__ = signature  # type: ignore[attr-defined]
    checked.__annotations__ = function.__annotations__ | keywords
    if public is function:
        return checked  # type: ignore[return-value]
    public.__init__ = checked  # type: ignore[method-assign]
    return public


def _keywords(function: Callable) -> dict[str, Any]:
    """Return the hints of the keywords in a function's ``**name: Unpack[...]``, by name; none where it has no such."""
    for hint in function.__annotations__.values():
        origin: Any = get_origin(hint)
        if origin is Unpack:
            [choice] = get_args(hint)
            return choice.__annotations__
    return {}


class _PublicNames(dict):
    """The public names of the package, for hints that name what their module imports for type checkers alone.

    It finds a name when it is looked up, as importing all of them takes seconds.
    """

    def __missing__(self, name: str) -> Any:
        return find_public(name)


def _hints(function: Callable) -> dict[str, Any]:
    """Return the type hints of the arguments of a function or a class, by name.

    The hint of ``*args`` becomes a sequence of what it names.
    """
    function = function.__init__ if inspect.isclass(function) else function
    # What it returns need not be loaded.
    asked = {
        n: hint for n, hint in getattr(function, "__annotations__", {}).items() if n != "return"
    }
    home = getattr(inspect.unwrap(function), "__globals__", {})
    hints = get_type_hints(types.SimpleNamespace(__annotations__=asked), home, _PublicNames())
    parameters = inspect.signature(function).parameters
    for name, parameter in parameters.items():
        if parameter.kind is parameter.VAR_POSITIONAL:
            hints[name] = Iterable[hints.get(name, Any)]  # type: ignore[misc]
    return {name: hints[name] for name in parameters if name in hints}


def _place_of(
    value: Any, by_name: list[str], last: str, kinds: Mapping[str, list[ArgumentKind]]
) -> str:
    """Return the end of a message on a value too many: the keyword that takes it, else a list of the last argument."""
    for name in by_name:
        if any(kind.holds(value) for kind in kinds.get(name, [])):
            return f": write {name}={_shown(value)}"
    if any(kind.holds([value]) for kind in kinds.get(last, [])):
        return f": give {last} as a list, [..., ...]"
    return f"; by name it takes {', '.join(by_name)}"


def _home_of(name: str, function: Callable) -> str:
    """Return the end of a message on an argument that a function does not take: what is meant, or what it takes.

    Such as ``" (did you mean 'time'?)"``, or ``" (give gps=Gps(mask_deg=...))"`` where it is an argument of what makes
    an argument.

    Args:
      name: the wrong argument.
      function: the function or class that does not take it.
    """
    own = [each for each in inspect.signature(function).parameters if each not in ("self", "cls")]

    # The remedy for each argument: itself where it is the function's own, else the call of a maker with it.
    remedies = {each: each for each in own}
    for argument, hint in _hints(function).items():
        for kind in map(_name_of, (hint, *get_args(hint))):
            maker = re.split(" or |,", MADE_BY.get(kind, kind))[0]  # the first that the text names
            with suppress(KeyError):  # no public name: the kind has no maker
                for inner in _hints(find_public(maker)):
                    remedies.setdefault(inner, f"{argument}={maker}({inner}=...)")

    # An own argument that hardly differs from the name comes first, then one of a maker that hardly differs, and last
    # an own argument that merely resembles it.
    nearest = alike(name, own, MOST_ALIKE) or alike(name, remedies, MOST_ALIKE) or near(name, own)
    if not nearest:
        return f"; it takes {', '.join(own)}"
    remedy = remedies[nearest[0]]
    return f" (did you mean {remedy!r}?)" if remedy in own else f" (give {remedy})"


def _check_kind(name: str, value: Any, kinds: list[ArgumentKind], call: str) -> None:
    """Raise InputError, with the kinds that are accepted and a remedy, unless the value is of one of them.

    Args:
      name: of the argument.
      value: of any kind.
      kinds: that are accepted; none: any.
      call: remedy for an object of this package in the wrong place: how the function is called.
    """
    if not kinds or any(kind.holds(value) for kind in kinds):
        return

    # What is accepted, each kind once, with the unit of numbers.
    names = list(dict.fromkeys(kind.name for kind in kinds))
    accepted = _either(names)
    if unit_of_argument(name) and "number" in accepted:
        accepted = f"{accepted} ({unit_of_argument(name)})"

    # The remedy: a text that resembles a choice, the call for an object of ours, a list for a single number.
    choices = [each.strip("'") for each in names if each.startswith("'")]
    remedy = nearest_name(str(value), choices)
    if not remedy and type(value).__module__.startswith(f"{PACKAGE}."):
        remedy = call
    if _is_number(value) and "a sequence of numbers" in accepted:
        remedy = f": write [{float(value):g}]"
    if isinstance(value, str) and "DataFrame" in names:
        remedy = ": read a file with pandas.read_csv or read_parquet"
    shown = _shown(value)
    of_class = re.search(r"a dict of ([A-Z]\w+)(?! \(from)\b", accepted)
    if of_class and isinstance(value, Mapping):
        key, first = next(iter(value.items()))
        shown = f"a dict of {type(first).__name__}"
        remedy = f": write {{{key!r}: {of_class[1]}(...)}}"
    elif of_class and type(value).__name__ == of_class[1]:
        remedy = f': write {{"name": {of_class[1]}(...)}}'
    elif isinstance(value, Mapping | type) and {name.capitalize(), "None"} == {*names}:
        inner = ", ".join(f"{key}=..." for key in value) if isinstance(value, Mapping) else ""
        remedy = f": write {name.capitalize()}({inner})"
    raise InputError(f"{name} must be {accepted}, got {shown}{remedy}")


def _kinds(hint: Any) -> list[ArgumentKind]:
    """Return the kinds of value that a type hint allows; an empty list: a value of any kind is allowed.

    Args:
      hint: a type hint, with no names left to resolve (`get_type_hints`).
    """
    # Of ``list[int]`` the origin is ``list`` and the part ``int``; a hint of a shape counts as its kind of array.
    hint = getattr(hint, "array_type", hint)
    if hint in KINDS:
        return [KINDS[hint]]
    origin = get_origin(hint) or hint
    parts = [part for part in get_args(hint) if part is not Ellipsis]

    # A union allows what its parts allow, and a literal its choices.
    if origin in (Union, types.UnionType):
        kinds_of_parts = [_kinds(part) for part in parts]
        if not all(kinds_of_parts):  # an empty list: one part allows anything
            return []
        return list(chain.from_iterable(kinds_of_parts))
    if origin is Literal:
        return [
            ArgumentKind(repr(choice), functools.partial(_is_choice, choice)) for choice in parts
        ]
    if origin is Any or not inspect.isclass(origin):
        return []

    # A class: a holder of items, of which keys are not looked at; one with a kind of its own; or any other.
    if origin in HOLDERS:
        holder = HOLDERS[origin]
        hints = parts[1:] if holder is Mapping else parts
        return [_kind_of_items(holder, hints)]
    if origin in KINDS:
        return [KINDS[origin]]
    name = _name_of(origin)
    if name in MADE_BY:
        name = f"{name} (from {MADE_BY[name]})"
    return [ArgumentKind(name, lambda value: isinstance(value, origin))]


def _kind_of_items(holder: Any, hints: list[Any]) -> ArgumentKind:
    """Return the kind of a sequence or a dict with items of some kind.

    Args:
      holder: `Iterable` for any sequence, `Mapping` for a dict.
      hints: of the items; with several different ones, or a hint of a tuple, items are not looked at.
    """
    # Items are looked at only if one hint, not of a tuple, says what all of them are.
    is_plain = len({*hints}) == 1 and get_origin(hints[0]) is not tuple
    items = _kinds(hints[0]) if is_plain else []
    if not items:
        return KINDS[holder]
    names = [item.name for item in items if item.name != "None"]

    # The name in messages, such as "a sequence of numbers": the first noun of each kind becomes its plural.
    plurals = [re.sub("^a ([a-z ]+?)(?= of |$)", r"\1s", name) for name in names]
    name = f"{KINDS[holder].name} of {' or '.join(plurals)}"
    return ArgumentKind(name, functools.partial(_holds, holder, items))


def _holds(holder: Any, items: list[ArgumentKind], value: Any) -> bool:
    """Return whether a value is a sequence or a dict whose items are of some kinds.

    Only items of lists, tuples and dicts are looked at: walking through anything else may use it up.

    Args:
      holder: `Iterable` or `Mapping`.
      items: kinds of the items, each of which must be of one of them.
      value: of any kind.
    """
    value = (value,) if isinstance(value, str) else value  # one text is often taken for several
    if not KINDS[holder].holds(value):
        return False
    values: Any = value.values() if holder is Mapping else value
    if type(value) not in (list, tuple, dict):
        return True
    return all(any(kind.holds(each) for kind in items) for each in values)


def _is_choice(choice: Any, value: Any) -> bool:
    return isinstance(value, str | numbers.Integral) and value == choice


def _is_number(value: Any) -> bool:
    is_scalar = isinstance(value, numbers.Real) or getattr(value, "shape", None) == ()
    return is_scalar and not isinstance(value, bool)


def _is_whole(value: Any) -> bool:
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def _is_text(value: Any) -> bool:
    """Whether a value is a text, or a time of any kind, which may stand for one."""
    return isinstance(value, str | datetime) or type(value).__name__ == "datetime64"


def _name_of(kind: Any) -> str:
    return getattr(kind, "__name__", "").rpartition(".")[2]


def _either(choices: Iterable[str]) -> str:
    *others, last = choices
    return f"{', '.join(others)} or {last}" if others else last


def _shown(value: Any) -> str:
    """Return a plain value, or a short list of them, as it is written, and the type of any other."""
    if isinstance(value, list | tuple) and len(value) <= MOST_SHOWN:
        return f"{type(value).__name__} of {', '.join(map(_shown, value)) or 'nothing'}"
    if isinstance(value, dict) and len(value) <= MOST_SHOWN:
        return f"dict of {', '.join(f'{key!r}: {_shown(each)}' for key, each in value.items()) or 'nothing'}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    return repr(value) if isinstance(value, str | numbers.Number | None) else type(value).__name__


HOLDERS: dict[Any, Any] = {
    **dict.fromkeys((Iterable, Sequence, list, tuple), Iterable),
    **dict.fromkeys((Mapping, dict), Mapping),
}
KINDS: dict[Any, ArgumentKind] = {
    bool: ArgumentKind("True or False", lambda value: type(value).__name__ in ("bool", "bool_")),
    int: ArgumentKind("a whole number", _is_whole),
    float: ArgumentKind("a number", _is_number),
    str: ArgumentKind("a text", _is_text),
    Path: ArgumentKind("a path", lambda value: isinstance(value, str | os.PathLike)),
    types.NoneType: ArgumentKind("None", lambda value: value is None),
    Iterable: ArgumentKind(
        "a sequence",
        lambda value: isinstance(value, Iterable) and not isinstance(value, str | bytes),
    ),
    Mapping: ArgumentKind("a dict", lambda value: isinstance(value, Mapping)),
    Callable: ArgumentKind("a function", callable),
}
