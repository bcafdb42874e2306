"""The exceptions of jaxurban, all under one root."""

import csv
import inspect
import os
import re
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import takewhile
from pathlib import Path
from typing import Literal

from jaxurban.spelling import near

PACKAGE = str(Path(__file__).parent)
STANDARD_LIBRARY = str(Path(os.__file__).parent)
MOST_SAID = 300  # characters of what a library says that a message passes on
MOST_OF_END = 1000  # characters of a message at its begin and at its end: a file may hold a text of any length
# What Python itself says of files that are not as they should be, by a part of it, and what messages say instead.
OF_PYTHON = {
    "maximum recursion depth": "brackets lie too deep within brackets",
    "zip() arg": "lists that belong together differ in length",
    "values to unpack": "a list has another length than it should",
    "int_max_str_digits": "a number has too many digits",
}


Door = Literal["python", "scenario"]  # by which a user came in; a command speaks as a scenario does
_DOOR: ContextVar[Door] = ContextVar("door", default="python")
# Sections of a scenario whose values are a class in Python, by their names there where these differ.
SECTIONS = (
    "buildings|terrain|vegetation|obstacles|gps|lidar|population|risk|vehicle|gps_floor|study"
)
MAKERS = {"gps_floor": "metrics.GpsFloor", "study": "studies.Study"}
# ``[section] key``, with `` = value`` or without.
KEY = re.compile(
    rf"""\[({SECTIONS})\] (\w+)(?: = ("[^"]*"|'[^']*'|\[[^]]*\]|\{{[^}}]*\}}|[\w.]+))?"""
)
# In brackets: options before arguments, arguments behind options, and options alone with their bracket.
BEFORE_ARGUMENTS = re.compile(r"(--[\w-]+( \d+)?[,;] )+(?=\w+=\w*[,;)])")
ARGUMENTS = re.compile(r"[,;] \w+=\w*(?=[,;)])")
OPTIONS = re.compile(r" \(--[^()]*\)")


@contextmanager
def speaking(door: Door) -> Iterator[None]:
    """Let messages within the block speak the words of a door; a function may be decorated with it too."""
    token = _DOOR.set(door)
    try:
        yield
    finally:
        _DOOR.reset(token)


def in_words(sentence: str) -> str:
    """Return a sentence in the words of the door that was used; one that is in them comes back as it is.

    Args:
      sentence: names settings as a scenario does, ``[gps] orbits``, and options behind what they stand for, in
        brackets: ``resolution_m (--resolution)``, or with the argument and a value, ``(--snap 8, snap=8)``.

    Returns:
      The sentence; for Python keys are arguments, as ``ju.Gps(orbits=...)``, and there are no options.
    """
    if _DOOR.get() == "scenario":
        return ARGUMENTS.sub("", sentence)
    sentence = KEY.sub(_argument, sentence.replace("[region] ", ""))
    return OPTIONS.sub("", BEFORE_ARGUMENTS.sub("", sentence))


def _argument(found: re.Match) -> str:
    """Return a key of a section as Python's argument."""
    section, key, value = found.groups()
    return f"ju.{MAKERS.get(section, section.capitalize())}({key}={value or '...'})"


class JaxurbanError(Exception):
    """The root of every exception that jaxurban raises on purpose.

    Examples:
      >>> try:
      ...     ju.plan(maps, start, goal, altitude_m=500)
      ... except ju.JaxurbanError as error:
      ...     print(error)
      there are no maps for altitude 500 m: these maps reach from 20 to 60 m (20, 60); to fly there, ...
    """

    def __init__(self, sentence: str = "") -> None:
        super().__init__(in_words(sentence))

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) > 2 * MOST_OF_END:
            return f"{text[:MOST_OF_END]} ... {text[-MOST_OF_END:]}"
        return text


class InputError(JaxurbanError, ValueError):
    """A wrong argument, file or setting: one sentence that names it and the remedy.

    Examples:
      >>> try:
      ...     ju.Gps(mask_deg=95)
      ... except ju.InputError as error:
      ...     print(error)
      mask_deg must be an angle from 0 to less than 90 degrees, got 95
    """

    def _render_traceback_(self) -> list[str]:
        """Return what IPython shows of it: the user's own lines, and the sentence. ``%debug`` still enters all frames.

        Source: `InteractiveShell.showtraceback` of IPython, which asks an exception for it.
        """
        frames = traceback.extract_tb(self.__traceback__)
        of_others = ("IPython", STANDARD_LIBRARY, "<string>")  # the last is that of made methods
        outside = takewhile(lambda each: PACKAGE not in each.filename, frames)
        own = [each for each in outside if not any(part in each.filename for part in of_others)]
        lines = [f"line {each.lineno}: {each.line}" for each in own]
        return [*lines, f"{type(self).__name__}: {self}"]


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


class SkippedRouteWarning(UserWarning):
    """Something in a file of routes is not read: one sentence for the user."""


class OtherSettingsWarning(UserWarning):
    """Routes are fitted under other settings than they were planned under: one sentence for the user."""


def warn(sentence: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line of the user that called jaxurban: the first one outside the package.

    Args:
      sentence: the warning.
      category: its class.
    """
    # The number of frames of the package above this one, and so the level at which Python is to warn.
    package = __name__.partition(".")[0]
    frame = inspect.currentframe()
    stacklevel = 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        frame = frame.f_back
        stacklevel += 1
    warnings.warn(in_words(sentence), category, stacklevel=stacklevel)


def platform_remedy(error: BaseException) -> str:
    """Return what to do about an error of JAX's start on the platforms that the user has chosen (``JAX_PLATFORMS``).

    An empty text comes back for any other error: the variable is not set, or JAX starts with it.
    """
    chosen = os.environ.get("JAX_PLATFORMS")
    if not chosen:
        return ""

    # An error need not name the variable, as that of CUDA without its plugin: then JAX is started to see if it works.
    if "JAX_PLATFORMS" not in str(error):
        import jax

        with suppress(RuntimeError, AssertionError):
            jax.devices()
            return ""
    return f"JAX does not work under JAX_PLATFORMS={chosen}: unset it, or choose another value"


def reason_of(error: BaseException) -> str:
    """Return what an error of the system or of a library says, on one line, cut after `MOST_SAID` characters.

    What Python says of its own work becomes what is wrong with the file (`OF_PYTHON`).
    """
    reason = getattr(error, "strerror", None) or " ".join(str(error).split())
    for part, words in OF_PYTHON.items():
        if part in reason:
            return words
    return shortened(reason)


def shortened(text: str) -> str:
    """Return a text of a file or a library for a message, cut after `MOST_SAID` characters."""
    return text if len(text) <= MOST_SAID else f"{text[:MOST_SAID]} ..."


def check_file(path: str | os.PathLike[str]) -> None:
    """Raise OSError where a path names a pipe or a device, whose reading may never end; a missing file passes."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError("it is a pipe or a device, not a file")


def not_there(path: str | Path, what: str = "") -> str:
    """Return that a path does not exist, and which name beside it is nearest.

    Args:
      path: of a file or a folder.
      what: its name in the message; left out, the path.
    """
    path = Path(path)
    if re.match("(https?|ftp|s3):", str(path)):
        return f"{str(path)!r} is an address, not a file: download it first, and give the file"
    hint = ""
    with suppress(OSError):  # a folder that is not there, or that this user may not list
        for name in near(path.name, os.listdir(path.parent)):
            hint = f" (did you mean {str(path.with_name(name))!r}?)"
    return f"{what or repr(str(path))} does not exist{hint}: check the path"


@contextmanager
def readable(
    path: str | Path, kind: str, remedy: str, *errors: type[Exception], what: str = ""
) -> Iterator[None]:
    """Turn errors of the block, which reads a file, into an InputError that names the file, the reason and the remedy.

    Args:
      path: of the file.
      kind: what the file should be read as, for the message.
      remedy: ends the message.
      errors: what a damaged file raises, beside OSError, ValueError, RecursionError and csv.Error.
      what: name of the file in the message; left out, its path.

    Raises:
      InputError: the file is missing, no file, or damaged; one that the block raises passes as it is.
    """
    what = what or repr(str(path))
    caught: tuple[type[Exception], ...] = (OSError, ValueError, RecursionError, csv.Error, *errors)
    try:
        check_file(path)
        yield
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(not_there(path, what)) from error
    except IsADirectoryError as error:
        raise InputError(f"{what} is a folder, not {kind}: name a file") from error
    except caught as error:
        is_empty = os.path.isfile(path) and os.path.getsize(path) == 0
        reason = "it is empty" if is_empty else reason_of(error)
        raise InputError(f"{what} cannot be read as {kind} ({reason}): {remedy}") from error
