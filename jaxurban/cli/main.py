"""The command line: the group of commands, and how they end."""

import atexit
import gc
import logging
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import click

from jaxurban.cities.fetch_command import fetch_command
from jaxurban.cli.demo import demo_command
from jaxurban.cli.info import info_command
from jaxurban.cli.maps import maps_command
from jaxurban.cli.plan import plan_command
from jaxurban.cli.view import view_command
from jaxurban.errors import InputError, platform_remedy, reason_of, speaking
from jaxurban.exit_codes import ExitCode
from jaxurban.flights.check_command import check_command
from jaxurban.flights.return_command import return_command
from jaxurban.progress import LOG, interrupted
from jaxurban.receivers.sky_command import sky_command
from jaxurban.receivers.validate_command import validate_command
from jaxurban.studies.compare_command import compare_command
from jaxurban.studies.sensitivity_command import sensitivity_command
from jaxurban.studies.study_command import study_command
from jaxurban.studies.tune_command import tune_command
from jaxurban.terminal.common import logged_on_stderr, print_json
from jaxurban.terminal.options import meant_option

JSON = "--json"
NO_MEMORY = (
    "memory ran out: use a smaller region, a coarser [region] resolution_m, or fewer altitudes"
)


COMMANDS = (
    check_command,
    compare_command,
    demo_command,
    fetch_command,
    info_command,
    maps_command,
    plan_command,
    return_command,
    sensitivity_command,
    sky_command,
    study_command,
    tune_command,
    validate_command,
    view_command,
)


@click.group(
    commands=COMMANDS,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(package_name="jaxurban")
def app() -> None:
    """Metric maps for small drones over cities, and paths planned on them."""


def _set_up_libraries() -> None:
    """Set how Python and libraries work under commands; libraries read the environment when they are first imported.

    What the user has set for GDAL and JAX stays.
    """
    # When workers are killed, asyncio would log what Dask makes of it.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)

    # Python looks for cycles of objects seldom, and not at its end: among millions of outlines there are none, and the
    # search would take a tenth of the time of a run.
    gc.set_threshold(10_000, 10, 10)
    atexit.register(gc.freeze)

    # Pictures go to files, whatever is set for windows. GDAL's cache has 64 MiB instead of a twentieth of the memory,
    # and JAX takes the memory of a GPU as it needs it, instead of three quarters at once.
    os.environ["MPLBACKEND"] = "agg"
    os.environ.setdefault("GDAL_CACHEMAX", "64")
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    warnings.showwarning = lambda message, *_, **__: LOG.info(f"warning: {message}")
    signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = _show_unraisable
    with logged_on_stderr(), speaking("scenario"):
        sys.exit(_run(arguments))


def _run(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code.

    Every error that a user can cause ends in one sentence on stderr, and with ``--json`` in one object on stdout.

    Args:
      arguments: the words of the command line after the program's name.

    Raises:
      Exception: a fault of jaxurban, as it came.
    """
    stdout = sys.stdout
    fail = partial(_fail, arguments)
    code = 0
    try:
        _set_up_libraries()
        code = app.main(args=arguments, prog_name="jaxurban", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()  # what cannot be printed is reported now, not at the interpreter's end

    # What the user has given, or asked for.
    except InputError as error:
        code = fail(str(error))
    except click.exceptions.NoArgsIsHelpError as help_text:
        print(help_text.format_message())
        code = 0
    except click.UsageError as error:
        said = error.format_message().rstrip(".")
        if isinstance(error, click.NoSuchOption):
            said = meant_option(error) or f"No such option {error.option_name!r}"
        code = fail(f"{said} (see jaxurban --help)", _option_of(error))
    except click.ClickException as error:
        code = fail(error.format_message())

    # What the machine cannot do.
    except MemoryError:
        code = fail(NO_MEMORY)
    except (BrokenPipeError, SystemExit) as end:
        # The reader of stdout has left, as `head` does. Where click notices it first, click puts an object of its own
        # in the place of stdout and exits; with the former stdout an exit has another cause. What the command has
        # found out by then stays its code.
        if isinstance(end, SystemExit) and sys.stdout is stdout:
            raise
        _drop_stdout()
    except OSError as error:
        if JSON not in arguments:
            _drop_stdout()
        where = ", perhaps what is printed"
        if error.filename:
            where = f" {str(error.filename)!r}"
        code = fail(
            f"the system refuses to read or write{where} ({reason_of(error)}): free "
            "space, or mend that, and run the same command again, which goes on"
        )

    # Ctrl-C, and everything else.
    except (KeyboardInterrupt, click.Abort):
        _end_interrupted(arguments)
    except Exception as error:
        # In the midst of an import, Ctrl-C comes as an error of the import.
        if interrupted.is_set():
            _end_interrupted(arguments)
        remedy = _remedy_in_environment(error)
        if not remedy:
            if JSON in arguments:
                print_json({}, ExitCode.FAULT, f"{type(error).__name__}: {reason_of(error)}")
            raise
        code = fail(remedy)
    return code or 0


def _end_interrupted(arguments: Sequence[str]) -> None:
    """End the process at once: libraries' threads that were writing would only complain of the interpreter's end."""
    sentence = "interrupted; finished files are kept, and the same command resumes"
    LOG.info(sentence)
    if JSON in arguments:
        print_json({}, ExitCode.INTERRUPTED, sentence)
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    os._exit(ExitCode.INTERRUPTED)


def _remedy_in_environment(error: Exception) -> str:
    """Return the remedy for an error of a library that memory or a variable of the environment causes.

    An empty text comes back where neither is the cause.
    """
    message = str(error)
    out_of_memory = ("RESOURCE_EXHAUSTED", "can't start new thread")  # of JAX, and of Python
    if any(words in message for words in out_of_memory):
        return NO_MEMORY
    if "proj.db" in message:
        return "PROJ does not find its database proj.db: unset PROJ_DATA and PROJ_LIB, or point them to its folder"
    for name, value in os.environ.items():
        if name.startswith(("JAX_", "NUMBA_")) and (name in message or name.lower() in message):
            return f"{name.partition('_')[0]} does not work under {name}={value}: unset it, or choose another value"
        if name == "NUMBA_DISABLE_JIT" and value not in ("", "0"):
            return f"jaxurban needs Numba's compiler: unset {name}"
    return platform_remedy(error)


def _drop_stdout() -> None:
    """Send what is still to be printed nowhere: its place is full, or its reader has left."""
    with suppress(OSError, ValueError, AttributeError):  # no stdout at all, or one of a notebook
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _interrupt(*_: object) -> None:
    """Remember Ctrl-C beside raising it: raised inside a callback of JAX it would be lost."""
    interrupted.set()
    raise KeyboardInterrupt


def _show_unraisable(unraisable: Any) -> None:
    """Show what Python could not raise, but not a Ctrl-C that is remembered anyway."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


def _fail(arguments: Sequence[str], sentence: str, option: str = "") -> ExitCode:
    """Report an error of the user, in the log and with ``--json`` on stdout too, and return its exit code.

    Args:
      arguments: the words of the command line.
      sentence: what is wrong, and the remedy.
      option: the option at fault; empty where it is not known.
    """
    LOG.info(f"error: {sentence}")
    if JSON in arguments:
        try:
            print_json({}, ExitCode.BAD_INPUT, sentence, option)
        except (OSError, ValueError):  # stdout may be what failed
            _drop_stdout()
    return ExitCode.BAD_INPUT


def _option_of(error: click.UsageError) -> str:
    """Return the name of the option or argument that was used wrongly, empty where the error is of none."""
    if isinstance(error, click.NoSuchOption | click.BadOptionUsage):
        return error.option_name
    param = getattr(error, "param", None)
    return "" if param is None else _name_of(param)


def _name_of(param: click.Parameter) -> str:
    is_option = isinstance(param, click.Option)
    return max(param.opts, key=len) if is_option else param.human_readable_name
