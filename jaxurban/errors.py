"""The exceptions of jaxurban, all under one root."""

import functools
import inspect
import math
import numbers
import os
import re
import types
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from jaxurban.public import alike, find_public, near

Choice = TypeVar("Choice")
Public = TypeVar("Public", bound=Callable)
Kind = tuple[str, Callable[[Any], bool]]  # what messages call it, and whether a value is of it
MOST_SAID = 300  # characters of what a library says that a message passes on


class JaxurbanError(Exception):
    """The root of every exception that jaxurban raises on purpose.

    Examples:
      >>> try:
      ...     ju.plan(maps, start, goal, altitude_m=500)
      ... except ju.JaxurbanError as error:
      ...     print(error)
      there are no maps for altitude 500 m: these maps reach from 20 to 60 m
    """


class InputError(JaxurbanError, ValueError):
    """A wrong argument, file or setting: one sentence that names it and the remedy.

    Examples:
      >>> try:
      ...     ju.Gps(mask_deg=95)
      ... except ju.InputError as error:
      ...     print(error)
      mask_deg must be an angle from 0 to less than 90 degrees, got 95
    """


class RemadeError(InputError):
    """Maps that were opened are not those of their folder any more."""


class StaleElementsWarning(UserWarning):
    """Orbital elements are old at the chosen time: one sentence for the user."""


class GuessWarning(UserWarning):
    """Maps rest on something that their files do not say: one sentence for the user, with the remedy.

    Examples:
      >>> import warnings
      >>> with warnings.catch_warnings(record=True) as guesses:
      ...     warnings.simplefilter("always", ju.GuessWarning)
      ...     shinjuku = ju.sample_city("shinjuku")
      >>> print(guesses[0].message)
      no terrain is given, so the ground is taken as flat: ...
    """


class IgnoredZoneWarning(UserWarning):
    """Something in a file of no-fly zones is not read, or is read more cautiously: one sentence for the user."""


class LeftOutWarning(UserWarning):
    """Something in a file of routes is not read: one sentence for the user."""


class OtherSettingsWarning(UserWarning):
    """Routes are fitted under other settings than they were planned under: one sentence for the user."""


def warn(sentence: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line of the user that called jaxurban: the first one outside the package."""
    frame, stacklevel, package = inspect.currentframe(), 1, __name__.partition(".")[0]
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        frame, stacklevel = frame.f_back, stacklevel + 1
    warnings.warn(sentence, category, stacklevel=stacklevel)


def nearest_name(name: str, valid: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the valid names that one resembles (`near`), ``""`` where it does none."""
    names = near(name, valid)
    return f" (did you mean {_either(map(repr, names))}?)" if names else ""


def typed(public: Public, makers: Sequence[Callable] = ()) -> Public:
    """Return a function or a class that answers an argument of another kind than its annotation names by InputError.

    Arguments are looked at before anything runs, generously: any real number for a float (NumPy's too), anything with
    items for a sequence, text for a path; of lists, tuples and dicts each item is looked at.

    Args:
      public: the function or class.
      makers: functions to which it passes its further keywords on (`taken_by`): what they take by keyword alone, it
        takes too.
    """
    function = public.__init__ if inspect.isclass(public) else public
    signature = inspect.signature(function)
    if makers:
        *own, _ = signature.parameters.values()
        passed = {
            p.name: p for maker in makers for p in inspect.signature(maker).parameters.values()
        }
        own += [
            p
            for name, p in passed.items()
            if p.kind is p.KEYWORD_ONLY and name not in signature.parameters
        ]
        signature = signature.replace(parameters=own)
    parameters = signature.parameters
    in_order = [name for name, p in parameters.items() if p.kind is not p.KEYWORD_ONLY]
    call = f": call {public.__name__}({', '.join(in_order)})"
    further = next((name for name, p in parameters.items() if p.kind is p.VAR_KEYWORD), "")

    @functools.cache
    def kinds() -> dict[
        str, list[Kind]
    ]:  # at the first call, when every module that annotations name is there
        return {name: _kinds(hint) for name, hint in _hints(checked).items()}

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        try:
            values = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            wrong = next((name for name in kwargs if name not in parameters), "")
            fault = (
                f"there is no argument {wrong!r}{_home_of(wrong, checked)}" if wrong else str(error)
            )
            raise InputError(f"{public.__name__}: {fault}") from error
        for name, value in (values.pop(further, {}) | values).items():
            _check_kind(name, value, kinds().get(name if name in parameters else further, []), call)
            check_range(name, value)
        try:
            return function(*args, **kwargs)
        except (RuntimeError, AssertionError) as error:
            if remedy := platform_remedy(error):
                raise InputError(remedy) from error
            raise

    hints = [each.__annotations__ for each in (*makers, function)]
    checked.__annotations__ = {name: hint for each in hints for name, hint in each.items()}
    checked.__signature__ = signature  # type: ignore[attr-defined]
    if public is function:
        return checked  # type: ignore[return-value]
    public.__init__ = checked  # type: ignore[method-assign]
    return public


def taken_by(maker: Callable, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of some keywords that a function takes."""
    return {name: given[name] for name in inspect.signature(maker).parameters if name in given}


class _PublicNames(dict):
    """The public names of the package, for hints on what their module imports for type checkers alone."""

    def __missing__(self, name: str) -> Any:
        return find_public(name)


def _hints(function: Callable) -> dict[str, Any]:
    """Return the type hints of the arguments of a function or a class."""
    function = function.__init__ if inspect.isclass(function) else function
    hints, parameters = (
        get_type_hints(function, localns=_PublicNames()),
        inspect.signature(function).parameters,
    )
    for name, parameter in parameters.items():
        if parameter.kind is parameter.VAR_POSITIONAL:
            hints[name] = Iterable[hints[name]]  # type: ignore[valid-type]
    return {name: hints[name] for name in parameters if name in hints}


def _home_of(name: str, function: Callable) -> str:
    """Return what is meant by an argument that a function does not take: ``" (give gps=Gps(mask_deg=...))"``.

    Beside its own arguments those of what makes them are looked through, and so on, the nearest first; with or without
    their units, and after the name of what is made (``gps_mask``).
    """
    own = [each for each in inspect.signature(function).parameters if each not in ("self", "cls")]
    homes = dict.fromkeys(own, "")
    ways: list[tuple[Callable, str, str]] = [(function, "", "{}")]
    for taker, made, way in ways:  # grows on the way
        for argument, hint in _hints(taker).items():
            bare = re.sub("_(m|s|m_s|deg|w)$", "", argument)
            for each in (argument, bare, f"{made}_{argument}", f"{made}_{bare}"):
                homes.setdefault(
                    each, "" if argument in own and not made else way.format(f"{argument}=...")
                )
            for kind in map(_name_of, (hint, *get_args(hint))):
                with suppress(KeyError):
                    called = MADE_BY.get(kind, kind).split(" or ")[0].split(",")[0]
                    if (maker := find_public(called)) not in (before for before, *_ in ways):
                        ways.append((maker, argument, way.format(f"{argument}={called}({{}})")))
                        homes.setdefault(kind.lower(), way.format(f"{argument}={called}(...)"))
    found = alike(name, own, MOST_ALIKE) or alike(name, homes, MOST_ALIKE) or near(name, own)
    if not found:
        return f"; it takes {', '.join(own)}"
    return f" (give {homes[found[0]]})" if homes[found[0]] else f" (did you mean {found[0]!r}?)"


def platform_remedy(error: BaseException) -> str:
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


def check_range(name: str, value: Any) -> None:
    """Raise InputError where a number, or one in a list of them, is beyond what any such number can be.

    Without end (``inf``) may be what has no unit of length or angle, such as a budget of seconds; of what is no number
    (NaN) functions speak themselves.
    """
    most = _by_end(name, MOST_OF, MOST)
    for number in value if isinstance(value, list | tuple) else (value,):
        is_number = isinstance(number, numbers.Real) and not (
            most == MOST and abs(number) == math.inf
        )
        if is_number and abs(number) > most:
            raise InputError(
                f"{name} must be a finite number of at most {most:.0e}{_unit(name)}, got {number!r}"
            )


def _check_kind(name: str, value: Any, kinds: list[Kind], call: str) -> None:
    if kinds and not any(fits(value) for _, fits in kinds):
        called = list(dict.fromkeys(called for called, _ in kinds))
        hint = nearest_name(
            str(value), [each.strip("'") for each in called if each.startswith("'")]
        )
        order = call if type(value).__module__.startswith(f"{__name__.partition('.')[0]}.") else ""
        unit = _unit(name) if any("number" in each for each in called) else ""
        raise InputError(
            f"{name} must be {_either(called)}{unit}, got {_shown(value)}{hint or order}"
        )


def _kinds(hint: Any) -> list[Kind]:
    """Return the kinds that a type hint allows; none: anything goes."""
    hint = getattr(hint, "array_type", hint)  # of jaxtyping's shapes
    origin, parts = (
        get_origin(hint) or hint,
        [part for part in get_args(hint) if part is not Ellipsis],
    )
    if origin in (Union, types.UnionType):
        kinds = [_kinds(part) for part in parts]
        return [kind for each in kinds for kind in each] if all(kinds) else []
    if origin is Literal:
        return [(repr(choice), functools.partial(_is_choice, choice)) for choice in parts]
    if origin is Any or not inspect.isclass(origin):
        return []
    name = _name_of(origin)
    made_by = f" (from {MADE_BY[name]})" if name in MADE_BY else ""
    called, fits = KINDS.get(
        HOLDERS.get(origin, origin), (name + made_by, lambda value: isinstance(value, origin))
    )
    is_dict = HOLDERS.get(origin) is Mapping
    of = parts[1:] if is_dict else parts
    items = (
        _kinds(of[0])
        if origin in HOLDERS and len({*of}) == 1 and get_origin(of[0]) is not tuple
        else []
    )

    def holds(value: Any) -> bool:
        value = (value,) if isinstance(value, str) else value  # one text is often taken for several
        values = (
            value.values()
            if is_dict and fits(value)
            else value
            if type(value) in (list, tuple, dict)
            else ()
        )
        return fits(value) and all(any(is_one(item) for _, is_one in items) for item in values)

    several = " or ".join(
        re.sub("^a ([a-z ]+?)(?= of |$)", r"\1s", each) for each, _ in items if each != "None"
    )
    return [(f"{called} of {several}", holds) if items else (called, fits)]


def _is_choice(choice: Any, value: Any) -> bool:
    return isinstance(value, str | numbers.Integral) and value == choice


def _name_of(kind: Any) -> str:
    return getattr(kind, "__name__", "").rpartition(".")[2]


def _either(choices: Iterable[str]) -> str:
    *others, last = choices
    return f"{', '.join(others)} or {last}" if others else last


def _shown(value: Any) -> str:
    """Return a plain value, or a short list of them, as it is written, and the type of any other."""
    if isinstance(value, list | tuple) and len(value) <= MOST_SHOWN:
        return f"{type(value).__name__} of {', '.join(map(_shown, value)) or 'nothing'}"
    return repr(value) if isinstance(value, str | numbers.Number | None) else type(value).__name__


def _by_end(name: str, table: Mapping[str, Any], default: Any) -> Any:
    return next((value for end, value in table.items() if name.endswith(end)), default)


def _unit(name: str) -> str:
    unit = _by_end(name, UNITS, "")
    return unit and f" ({unit})"


def _is_number(value: Any) -> bool:
    is_scalar = isinstance(value, numbers.Real) or getattr(value, "shape", None) == ()
    return is_scalar and not isinstance(value, bool)


HOLDERS: dict[Any, Any] = dict.fromkeys((Iterable, Sequence, list, tuple), Iterable) | {
    Mapping: Mapping,
    dict: Mapping,
}
KINDS: dict[Any, Kind] = {
    bool: ("True or False", lambda value: type(value).__name__ in ("bool", "bool_")),
    int: (
        "a whole number",
        lambda value: isinstance(value, numbers.Integral) and not isinstance(value, bool),
    ),
    float: ("a number", _is_number),
    # A time may be of any kind where a text is asked for.
    str: (
        "a text",
        lambda value: isinstance(value, str | datetime) or type(value).__name__ == "datetime64",
    ),
    Path: ("a path", lambda value: isinstance(value, str | os.PathLike)),
    types.NoneType: ("None", lambda value: value is None),
    Iterable: (
        "a sequence",
        lambda value: isinstance(value, Iterable) and not isinstance(value, str | bytes),
    ),
    Mapping: ("a dict", lambda value: isinstance(value, Mapping)),
    Callable: ("a function", callable),
}
MOST_SHOWN = 4  # values of a list
MOST_ALIKE = 0.9  # of an argument of something else: it must hardly differ
MOST = 2**63 - 1  # of a number: NumPy holds it, and its square is no overflow in float32
MOST_OF = {
    "_m": 1e8,
    "_deg": 1e3,
}  # by the end of an argument's name; the whole way round the Earth is 4e7 m
UNITS = {  # likewise
    **dict.fromkeys(("start", "goal", "lonlat", "reference"), "longitude, latitude in degrees"),
    **{"bounds": "west, south, east, north in degrees", "_xy_m": "easting, northing in metres"},
    **{
        "_m_s": "metres per second",
        "_m": "metres",
        "_s": "seconds",
        "_deg": "degrees",
        "_w": "watts",
    },
}
MADE_BY = {  # what no constructor is meant for
    "Bound": "Constraints.read",
    "Zone": "Constraints.read",
    "Constraints": 'Constraints.read, as in Constraints.read(require=["gps>=0.3"])',
    "City": "City.from_files, sample_city or demo_city",
    "CostMap": "cost_map",
    "Demonstration": "read_demonstrations",
    "MetricMaps": "build_maps or open_maps",
    "PlannedPath": "plan or plan_many",
    "RouteQuery": "make_queries",
    "SoftCity": "soft_city",
}


def one_of(name: str, value: Choice, choices: Iterable[Choice]) -> Choice:
    """Return a value that must be one of some choices.

    Raises:
      InputError: it is none of them (lists them, and names the nearest one).
    """
    valid = list(choices)
    if value not in valid:
        hint = nearest_name(str(value), map(str, valid))
        raise InputError(f"{name} must be {_either(map(repr, valid))}, got {value!r}{hint}")
    return value


def finite(
    name: str, value: Any, unit: str = "", *, least: float = -math.inf, called: str = "finite"
) -> float:
    """Return a number (or the one that a text spells) that must be finite, as a float.

    Args:
      name: of the argument.
      value: the number.
      unit: for the message.
      least: what it must be above, and
      called: what such a number is called.

    Raises:
      InputError: it is not, or is not a number.
    """
    number = math.nan
    with suppress(TypeError, ValueError, OverflowError):
        number = math.nan if isinstance(value, bool) else float(value)
    if not least < number < math.inf:
        raise InputError(f"{name} must be a {called} number{unit and f' of {unit}'}, got {value!r}")
    return number


def positive(name: str, value: Any, unit: str = "") -> float:
    """Return a number that must be above 0, as a float (see `finite`)."""
    return finite(name, value, unit, least=0, called="positive")


def at_least(name: str, value: Any, least: int = 0) -> int:
    """Return a whole number that must not be below another, such as a seed.

    Raises:
      InputError: it is, or is not a whole number.
    """
    is_whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not is_whole or int(value) < least:
        raise InputError(f"{name} must be a whole number from {least} up, got {_shown(value)}")
    return int(value)


def reason_of(error: BaseException) -> str:
    """Return what an error of the system or of a library says, on one line; only the beginning of what is long."""
    said = getattr(error, "strerror", None) or " ".join(str(error).split())
    return said if len(said) <= MOST_SAID else f"{said[:MOST_SAID]} ..."


def check_file(path: str | os.PathLike[str]) -> None:
    """Raise OSError where a path names a pipe or a device, whose reading may never end; a missing file passes."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError("it is a pipe or a device, not a file")


@contextmanager
def readable(
    path: str | Path, kind: str, remedy: str, *errors: type[Exception], what: str = ""
) -> Iterator[None]:
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
        raise InputError(
            f"{what} cannot be read as {kind} ({reason_of(error)}): {remedy}"
        ) from error
