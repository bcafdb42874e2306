"""The exceptions of jaxurban, all under one root."""

import difflib
import functools
import inspect
import math
import numbers
import os
import sysconfig
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

Choice = TypeVar("Choice")
Public = TypeVar("Public", bound=Callable)
HERE = Path(__file__).parent
OUR_HOMES = tuple(  # of our files, two folders of which are links, of Python's and of the libraries'
    map(str, (HERE, (HERE / "kernels").resolve(), (HERE / "planners").resolve(), *sysconfig.get_paths().values()))
)
Kind = tuple[str, Callable[[Any], bool]]  # what messages call it, and what tells its values


class JaxurbanError(Exception):
    """The root of every exception that jaxurban raises on purpose."""


class InputError(JaxurbanError, ValueError):
    """A wrong argument, file or setting: one sentence that names it and the remedy."""


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


def nearest_name(name: str, valid: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the valid name closest to ``name``, or ``""``."""
    close = difflib.get_close_matches(str(name), list(valid), n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else ""


def check_type(name: str, value: Any, kind: type, such_as: str = "") -> None:
    """Raise InputError unless a value is of a type.

    Args:
      name: of the argument.
      value: of it.
      kind: that it must be of.
      such_as: where such a value comes from, for the message.
    """
    if not isinstance(value, kind):
        hint = such_as and f", from {such_as}"
        raise InputError(f"{name} must be a {kind.__name__}{hint}, got {type(value).__name__}")


def typed(public: Public) -> Public:
    """Return a function or a class that answers an argument of another kind than its annotation names by InputError.

    Only the outermost kind counts, and generously: any real number for a float (NumPy's too), anything with items for
    a sequence, text for a path. A class looks before it is made, a function only once it has failed: what works, works.
    """
    is_class = inspect.isclass(public)
    function = public.__init__ if is_class else public
    names = tuple(inspect.signature(function).parameters)

    @functools.cache
    def kinds() -> dict[str, list[Kind]]:  # at the first call, when every module that annotations name is there
        return {name: _kinds(hint) for name, hint in get_type_hints(function).items() if name in names}

    def check(args: Iterable[Any], kwargs: Mapping[str, Any]) -> None:
        for name, value in (*zip(names, args, strict=False), *kwargs.items()):
            allowed = kinds().get(name, [])
            if allowed and not any(is_one(value) for _, is_one in allowed):
                *others, last = dict.fromkeys(told for told, _ in allowed)
                listed = f"{', '.join(others)} or {last}" if others else last
                raise InputError(f"{name} must be {listed}, got {_shown(value)}")

    @functools.wraps(function)
    def checked(*args, **kwargs):
        if is_class:
            check(args, kwargs)
        try:
            return function(*args, **kwargs)
        except InputError:
            raise
        except (TypeError, ValueError, AttributeError) as error:
            if not _is_from_outside(error):
                check(args, kwargs)
            raise

    if is_class:
        public.__init__ = checked  # type: ignore[method-assign]
        return public
    return checked  # type: ignore[return-value]


def _kinds(hint: Any) -> list[Kind]:
    """Return how messages call each kind that a type hint allows, and what tells its values; none: anything goes."""
    origin = get_origin(hint) or hint
    if origin in (Union, types.UnionType):
        parts = [_kinds(part) for part in get_args(hint)]
        return [kind for part in parts for kind in part] if all(parts) else []
    if origin in (Sequence, Iterable) and get_args(hint) == (str,):
        return [("a sequence of texts", lambda value: isinstance(value, Iterable))]  # one text is often taken for one
    if origin in KINDS:
        return [KINDS[origin]]
    ours = inspect.isclass(origin) and origin.__module__.partition(".")[0] in (__name__.partition(".")[0], "pandas")
    return [(origin.__name__, lambda value: isinstance(value, origin))] if ours else []


def _is_from_outside(error: BaseException) -> bool:
    """Return whether an error was raised by a function that a user gave, not by ours or a library's."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    file = "" if trace is None else trace.tb_frame.f_code.co_filename
    is_source = os.path.isabs(file) or file.startswith(("<ipython", "<stdin>", "<string>"))  # not a compiled one's
    return is_source and not file.startswith(OUR_HOMES)


def _is_number(value: Any) -> bool:
    is_scalar = isinstance(value, numbers.Real) or getattr(value, "shape", None) == ()
    return is_scalar and not isinstance(value, bool)


def _has_items(value: Any) -> bool:
    return isinstance(value, Iterable) and not isinstance(value, str | bytes)


def _is_text_path(value: Any) -> bool:
    return isinstance(value, str | os.PathLike)


KINDS: dict[Any, Kind] = {
    bool: ("True or False", lambda value: type(value).__name__ in ("bool", "bool_")),
    int: ("a whole number", lambda value: isinstance(value, numbers.Integral) and not isinstance(value, bool)),
    float: ("a number", _is_number),
    str: ("a text", lambda value: isinstance(value, str)),
    Path: ("a path", _is_text_path),
    types.NoneType: ("None", lambda value: value is None),
    **dict.fromkeys((Sequence, Iterable, list, tuple), ("a sequence", _has_items)),
    **dict.fromkeys((Mapping, dict), ("a dict", lambda value: isinstance(value, Mapping))),
    Callable: ("a function", callable),
}


def _shown(value: Any) -> str:
    """Return a plain value as it is written, and the type of any other."""
    return repr(value) if isinstance(value, str | numbers.Number | None) else type(value).__name__


def one_of(name: str, value: Choice, choices: Iterable[Choice]) -> Choice:
    """Return a value that must be one of some choices.

    Raises:
      InputError: it is none of them (lists them, and names the nearest one).
    """
    valid = list(choices)
    if value not in valid:
        hint = nearest_name(str(value), [str(choice) for choice in valid])
        *others, last = map(repr, valid)
        listed = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{name} must be {listed}, got {value!r}{hint}")
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
    """Return what an error of the system or of a library says, on one line."""
    return getattr(error, "strerror", None) or " ".join(str(error).split())


@contextmanager
def readable(what: str, kind: str, remedy: str, *errors: type[Exception]) -> Iterator[None]:
    """Turn errors of the block, which reads a file, into an InputError: what it is, the reason and the remedy.

    Args:
      what: the file, for the message.
      kind: what it cannot be read as.
      remedy: ends the sentence.
      errors: what a damaged file raises, beside OSError and ValueError; an InputError passes as it is.
    """
    caught: tuple[type[Exception], ...] = (OSError, ValueError, *errors)
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{what} does not exist: check the path") from error
    except caught as error:
        raise InputError(f"{what} cannot be read as {kind} ({reason_of(error)}): {remedy}") from error
