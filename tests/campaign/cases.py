"""What a hostile input is, how one is run through the command line, and what may come of it."""

import contextlib
import io
import math
import re
import shutil
import signal
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from jaxurban import progress
from jaxurban.cli import main as cli
from tests.tiled_runs import files_of

MOST_S = 120  # of one command: a hang, if it takes longer
REFUSED, TOLD = (2,), (0, 2, 3, 4)  # exit codes: of what must not pass, and of what may be read one way or another


@dataclass(frozen=True)
class Case:
    """A command that meets something hostile.

    Attributes:
      name: what is wrong.
      arguments: of the command line; ``{out}`` is an empty place for output, ``{in}`` the folder of inputs.
      prepare: writes what the command reads, into the folder of inputs.
      codes: that it may end with.
    """

    name: str
    arguments: tuple[str, ...]
    prepare: Callable[[Path], object] = lambda folder: None
    codes: tuple[int, ...] = REFUSED


class Hang(BaseException):
    """A command took too long."""


@dataclass(frozen=True)
class Verdict:
    """What came of a case: its fault (``""`` for none), and what shows it."""

    name: str
    fault: str
    shown: str = ""


def run_case(case: Case, base: Path) -> Verdict:
    """Return what comes of a case; ``base`` holds the finished maps, which no command may change."""
    before = files_of(base)
    with tempfile.TemporaryDirectory() as scratch:
        inputs, out = Path(scratch, "in"), Path(scratch, "out")
        inputs.mkdir()
        case.prepare(inputs)
        given = files_of(inputs)
        places = {"{out}": str(out), "{in}": str(inputs), "{base}": str(base)}
        arguments = [
            re.sub("|".join(map(re.escape, places)), lambda found: places[found[0]], a) for a in case.arguments
        ]
        code, told = run_here(arguments)
        fault = fault_of(code, told, case.codes)
        if not fault and (files_of(base) != before or files_of(inputs) != given):
            fault = "lost files"
        if not fault and code == REFUSED[0] and (left := list(scraps(Path(scratch)))):
            fault, told = "lost files", f"left behind: {left[0]}"
    if files_of(base) != before:  # for the cases that follow
        shutil.rmtree(base)
        for name, data in before.items():
            (base / name).parent.mkdir(parents=True, exist_ok=True)
            (base / name).write_bytes(data)
    return Verdict(case.name, fault, told)


def run_here(arguments: list[str]) -> tuple[int | str, str]:
    """Return the exit code of a command run in this process (or why it has none), and what it told on stderr."""
    out, err = io.StringIO(), io.StringIO()
    shown, kept = warnings.showwarning, signal.getsignal(signal.SIGINT)
    code: int | str = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), patch.object(progress, "EVERY_S", math.inf):
        signal.signal(signal.SIGALRM, _too_long)
        signal.alarm(MOST_S)
        try:
            cli.main(arguments)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
        except Hang:
            code = "hang"
        except BaseException:
            code, _ = "traceback", traceback.print_exc(file=err)
        finally:
            signal.alarm(0)
            warnings.showwarning = shown
            signal.signal(signal.SIGINT, kept)
    return code, err.getvalue()


def _too_long(*_: object) -> None:
    raise Hang


def fault_of(code: int | str, told: str, codes: tuple[int, ...]) -> str:
    """Return what is wrong with how a command ended: nothing, a traceback, a hang, or a silent wrong exit."""
    if isinstance(code, str):
        return code
    if "Traceback" in told or code not in TOLD:
        return "traceback"
    if code == REFUSED[0]:
        errors = [line for line in told.splitlines() if line.startswith("jaxurban: error: ")]
        return "" if len(errors) == 1 and len(told.splitlines()[-1]) < 1500 else "silent"
    return "" if code in codes else "silent"


def scraps(folder: Path) -> Iterator[Path]:
    """Yield half-written files under a folder."""
    for path in folder.rglob("*"):
        is_work = path.parent.name == "maps.zarr"  # finished tiles, which the same command goes on with
        if (".jaxurban-part" in path.name and not is_work) or path.name == ".jaxurban.lock":
            yield path
