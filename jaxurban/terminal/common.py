"""What commands share: option types, what they ask for, progress, messages."""

import json
import logging
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from jaxurban.checks import check_extra
from jaxurban.errors import InputError, readable
from jaxurban.exit_codes import ExitCode
from jaxurban.io.samples import located
from jaxurban.io.stored import REPORT_FILE, stored_maps
from jaxurban.paths.ceiling import CEILING_M
from jaxurban.paths.suffixes import PICTURES
from jaxurban.progress import LOG, reporting
from jaxurban.settings import CLEARANCES, Planning, Preset
from jaxurban.terminal.options import (
    TYPED,
    Names,
    Number,
    Numbers,
    Values,
    WholeNumber,
    grouped_options,
    options_together,
)

if TYPE_CHECKING:
    import pandas as pd

    from jaxurban.draw.write import Output
    from jaxurban.io.results import Result
    from jaxurban.paths.constraints import Constraints

StudyResult = TypeVar("StudyResult", bound="Result")
Settings = dict[str, Any]
Point = tuple[float, float]  # of LONLAT


class NamedPath(click.Path):
    """A path; an empty one, as of a variable that is not set, is not the current folder.

    It is checked while options are read, so that a wrong one is answered before any library is imported.

    Args:
      check: raises InputError of a path that cannot be used.
    """

    def __init__(self, check: Callable[[Path], object] | None = None) -> None:
        super().__init__(path_type=Path)
        self.check = check

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path in a text.

        Raises:
          BadParameter: an empty text, or what `click.Path` refuses.
          InputError: what the check refuses.
        """
        if value == "":
            self.fail(
                "the name is empty: name a file or a folder (. is the current one)", param, ctx
            )
        path: Any = super().convert(value, param, ctx)
        if self.check is not None:
            self.check(path)
        return path


def check_given(path: Path) -> None:
    """Raise InputError unless a file or a folder is there; a name may be a sample city's."""
    with readable(path, "a file", "give another one"):
        located(path).stat()


def check_over_maps(
    ctx: click.Context, param: click.Parameter, lonlat: Point | None
) -> Point | None:
    """Return a place, if one is given, that lies over the maps in the command's folder, by their metadata alone.

    Of several folders the first one counts. Of several resolutions, or of damaged maps, what opens the maps checks it.

    Raises:
      InputError: the place lies outside.
    """
    folders = ctx.params.get("folders") or (ctx.params["folder"],)
    if not Path(folders[0] or "").is_dir():
        return lonlat  # what opens the maps says it, and nothing heavy is imported before
    from jaxurban.io.glance import glance
    from jaxurban.world.grid import grid_of

    grid = None
    with suppress(AttributeError, LookupError, TypeError, ValueError):  # damaged metadata, or None
        grid = grid_of(glance(folders[0]))
    if grid is not None and lonlat is not None:
        try:
            grid.cell_of_lonlat(*lonlat)
        except InputError as error:
            raise InputError(f"{param.name}: {error}") from error
    return lonlat


def check_route(
    folder: Path,
    altitude_m: float | None,
    time: str | None,
    weights: dict[str, float],
    search: Settings,
) -> None:
    """Refuse what does not go with the maps in a folder before they are opened, as far as `glance` knows them.

    Args:
      folder: of the maps.
      altitude_m: of the route; None: it may climb.
      time: of the GPS map; None: the first.
      weights: by name.
      search: keywords of `PathSearch.of`.

    Raises:
      InputError: an altitude, time or weight that the maps do not hold, or a wrong search.
    """
    from jaxurban.io.glance import glance
    from jaxurban.maps.levels import around, index_of
    from jaxurban.settings import Planning, iso_utc

    maps = glance(folder)
    if maps is None:
        return
    if altitude_m is not None:
        around(altitude_m, maps.altitudes_m)
    if time is not None and "gps" in maps.variables:  # not the statistics of a long series
        index_of("time", iso_utc(time), maps.times)
    if weights:  # that are given: their names bring JAX
        from jaxurban.metrics.custom import held_metrics
        from jaxurban.metrics.weights import weights_on

        maps.metrics = held_metrics(maps)
        weights_on(maps, weights)
    from jaxurban.paths.search import PathSearch

    planning = Planning(**maps.recorded.get("planning", {}))
    PathSearch.of(planning, altitude_m is None, **search)


PATH, GIVEN, MAPS_PATH = NamedPath(), NamedPath(check_given), NamedPath(stored_maps)


def stay_on_cpu() -> None:
    """Let JAX compute on the CPU in a command's own process, before its first use, and in those that it starts."""
    import jax

    os.environ["JAX_PLATFORMS"] = "cpu"
    jax.config.update("jax_platforms", "cpu")


def use_device(name: str | None) -> None:
    """Choose the device that computes in this process and in those that it starts, and name it in the log.

    Only a command may call it, in its own process, before JAX's first use.

    Args:
      name: ``"cpu"``; ``"gpu"``; ``"auto"``, a GPU where JAX finds one; or None: as ``"auto"``, but nothing is logged.

    Raises:
      InputError: ``"gpu"`` where JAX can use none.
    """
    if name is None:
        return
    import jax

    if name == "cpu":
        stay_on_cpu()
    if name == "gpu" and jax.default_backend() == "cpu":
        raise InputError(
            "there is no GPU that JAX can use: install jaxurban[cuda13] (or cuda12) and NVIDIA's driver, or leave "
            "--device out"
        )
    LOG.info(f"device: {jax.local_devices()[0].device_kind} ({jax.default_backend()})")


def weights_in(ctx: click.Context, param: click.Parameter, text: str) -> dict[str, float]:
    """Return the weights that a text such as ``"gps=1,risk=2"`` names; errors as of `Weights.named_in`."""
    if not text:
        return {}
    from jaxurban.metrics.weights import Weights  # imported here: it brings JAX

    return Weights.named_in(text)


def constraints_given(
    no_fly: tuple[Path, ...], require: tuple[str, ...], rules: Settings | None = None
) -> "Constraints":
    """Return the constraints that options ask for; what is left out is as the scenario has it.

    Args:
      no_fly: files of zones that no path enters.
      require: bounds such as ``"gps>=0.3"``.
      rules: further arguments of `Constraints.read`.

    Raises:
      InputError: a file or a bound that cannot be read, or an invalid clearance.
    """
    from jaxurban.paths.constraints import Constraints

    return Constraints.read(no_fly, require, **(rules or {}))


def rules_of(
    preset: Preset, no_fly: tuple[Path, ...], require: tuple[str, ...], rules: Settings
) -> Settings:
    """Return under what routes are planned: keywords of `jaxurban.cost_map`.

    Args:
      preset: decides what is left out here and in the scenario.
      no_fly, require: as of `constraints_given`.
      rules: what ``--rules`` gives.
    """
    return {"preset": preset, "constraints": constraints_given(no_fly, require, rules)}


def workers_of(workers: int | None, cluster: str | None) -> int | str | None:
    """Return the number of processes or the address of a scheduler, whichever is given; None without either.

    Raises:
      InputError: both are given, or what several processes need is not installed.
    """
    if workers is not None and cluster is not None:
        raise InputError(
            "give either --workers, for processes of this machine, or --cluster, not both"
        )
    if cluster or (workers or 1) > 1:
        check_extra()
    return workers or cluster


LONLAT = Numbers("LON,LAT", "longitude,latitude in degrees, as in -74.0,40.7", 2)
COUNT, POSITIVE_COUNT = WholeNumber(min=0), WholeNumber(min=1)
SHOWN = partial(click.option, show_default=True)  # its default, in the help
NUMBER = partial(click.option, type=Number())
METRES = partial(NUMBER, metavar="METRES")
FLAG = partial(click.option, is_flag=True)
FOLDER = click.argument("folder", metavar="DIR", type=MAPS_PATH, is_eager=True)
SCENARIO = click.argument("scenario_file", metavar="SCENARIO", type=GIVEN)
FILES = partial(click.option, "-o", "files", type=PATH, multiple=True)
OUTPUT = click.option("-o", "output", type=PATH, required=True, help="Output folder.")
OVERWRITE = FLAG("--overwrite", help="Replace what another run wrote to the output folder.")
CHANGES = click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change a setting of SCENARIO, such as gps.mask_deg=10; values as in TOML; repeatable.",
)
SEED = SHOWN("--seed", type=COUNT, default=0, help="Seed of random numbers.")
DEVICE_CHOICE = partial(
    click.option,
    "--device",
    type=click.Choice(["auto", "cpu", "gpu"]),
    help="Device that computes.  [default: auto, a GPU where JAX finds one]",
)
DEVICE = DEVICE_CHOICE(callback=lambda ctx, param, name: use_device(name), expose_value=False)
RESOLUTION = NUMBER(
    "--resolution",
    "resolution_m",
    help="Cell size of the maps in metres; needed where DIR holds several.",
)
CEILING = SHOWN(
    "--ceiling",
    "ceiling_m",
    type=WholeNumber(min=0),
    default=CEILING_M,
    metavar="METRES",
    help="Greatest height of a return, above the ground at home; legs are not held against it.",
)
ZONES = options_together(
    click.option(
        "--no-fly",
        type=GIVEN,
        multiple=True,
        help="File of polygons that no path enters (GeoJSON, KML); repeatable.",
    ),
    click.option(
        "--require",
        multiple=True,
        help="Bound that every cell of a path must keep, such as gps>=0.3, or gps_floor to stay above it; repeatable.",
    ),
)
RULE_VALUES = partial(click.option, "--rules", default="")
KEPT_CLEAR = RULE_VALUES(
    type=Values(Planning, CLEARANCES), help="Distances to keep, else the scenario's."
)
PRESET = click.option(
    "--preset",
    type=click.Choice(["paper"]),
    callback=lambda ctx, param, name: name or "",
    help="Plan as the paper does: cost model cell, obstacles at centres, no clearance, "
    "where neither the scenario nor --rules says so.",
)
WEIGHTS = click.option(
    "--weights",
    default="",
    callback=weights_in,
    help="Weights such as gps=1,risk=2; others keep their values.",
)
RULES = grouped_options(
    "rules",
    rules_of,
    PRESET,
    ZONES,
    RULE_VALUES(
        type=Values(Planning, (*CLEARANCES, "unknown_heights")),
        help="What routes keep, else the scenario's.",
    ),
)
TIME_OF_DAY = click.option(
    "--time-of-day", help="Time of day of the population map, such as night.  [default: the first]"
)
PLACE = partial(click.option, type=LONLAT, required=True, callback=check_over_maps)
SNAP = NUMBER(
    "--snap",
    is_flag=False,
    flag_value="50",
    metavar="[METRES]",
    callback=lambda ctx, param, metres: False if metres is None else metres,
    help="Move a start or goal that is not free to the nearest free cell, by at most 50 m or METRES.",
)
ROUTE = options_together(  # a route over maps
    FOLDER,
    PLACE("--start", help="Start: longitude,latitude in degrees."),
    PLACE("--goal", help="Goal: longitude,latitude in degrees."),
    NUMBER(
        "--altitude",
        "altitude_m",
        required=True,
        help="Altitude in metres above ground, within the maps' range.",
    ),
    TIME_OF_DAY,
    click.option("--time", help="Time of the GPS map, UTC.  [default: the first]"),
    RESOLUTION,
    WEIGHTS,
    RULES,
    SNAP,
)
PROCESSES = click.option(
    "--workers", type=POSITIVE_COUNT, help="Number of processes (Dask).  [default: all cores]"
)
WORKERS = grouped_options(
    "workers",
    workers_of,
    PROCESSES,
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Address of a Dask scheduler whose workers to use, such as tcp://host:8786.",
    ),
)
SOURCES = click.option(
    "--sources",
    type=GIVEN,
    help="Folder where the relative paths of the maps' sources begin.  [default: beside the maps]",
)
JSON_FLAG = FLAG("--json", "as_json", help="Print one machine-readable object on stdout.")


NAMES = partial(click.option, type=Names(), default=())


def all_cores() -> int:
    """Return the number of processes that use this whole machine: one per core.

    Where Dask's scheduler is not installed it is 1, and a line of the log says so.
    """
    from importlib.util import find_spec

    from jaxurban.kernels.engine import num_cores

    if find_spec("distributed") is not None:
        return num_cores()
    LOG.info("working on one core: several need Dask's scheduler, pip install 'jaxurban[cluster]'")
    return 1


class _OnStderr(logging.Handler):
    """Prints what is logged, above a progress bar where one is shown."""

    def emit(self, record: logging.LogRecord) -> None:
        text = f"jaxurban: {record.getMessage()}"
        if "tqdm" in sys.modules:
            sys.modules["tqdm"].tqdm.write(text, file=sys.stderr)
        else:
            print(text, file=sys.stderr)


@contextmanager
def logged_on_stderr() -> Iterator[None]:
    """Show the package's log on stderr within the block; afterwards its level is what it was."""
    handler = _OnStderr()
    level = LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def run_study(
    command: str, output: Path, study: Callable[..., StudyResult], overwrite: bool
) -> StudyResult:
    """Run a study, write its result to a folder, and return the result.

    The folder is checked and held first, so that no study runs whose result could not be written.

    Args:
      command: name of the command that runs.
      output: the folder.
      study: runs the study, and reports its progress to its argument ``progress``.
      overwrite: replace another run of the command in the folder.

    Raises:
      InputError: the folder cannot be written to, is held by another run, or holds other files.
    """
    from jaxurban.io.workspace import Workspace

    with Workspace.held(output, command), reporting(command) as report:
        result = study(progress=report)
        report("report")
        result.save(output, overwrite)

    LOG.info(finished_said(command, output))
    return result


def finished_said(command: str, output: Path) -> str:
    """Return where the report of a study is that a command wrote, and its figures, if it has some."""
    sentence = f"{command} finished: read {output / REPORT_FILE}"
    figures = output / "figures"
    if figures.is_dir():
        sentence += f", look at {figures}"
    return sentence


FLAGS = ("--json", "--overwrite")  # of a command that is run again they are left out
VALUE = "[ =](?:[^ ']|'[^']*')+"  # of an option, as a shell reads it


def again(*dropped: str) -> str:
    """Return the command that runs, as it was typed, without ``--json``, ``--overwrite`` and some words.

    Args:
      dropped: options that are left out with their values, as ``"-o"`` or ``"--set study.instances"``; or files and
        folders, however they were typed.
    """
    command, *typed = click.get_current_context().meta[TYPED]
    files = {Path(each) for each in dropped if not each.startswith("-")}
    kept = [each for each in typed if each not in FLAGS and Path(each) not in files]
    line = shlex.join(["jaxurban", command, *kept])
    for option in dropped:
        if option.startswith("-"):
            quoted = re.escape(option).replace(r"\ ", " '") + "=[^']*'"
            line = re.sub(f" (?:{re.escape(option)}{VALUE}|{quoted})(?= |$)", "", line)
    return line


def number_or_file(
    number: click.ParamType, ctx: click.Context, param: click.Parameter, text: str | None
) -> int | Path | None:
    """Return what an option names: a number, also one out of range, or a file that is there."""
    if text is None:
        return None
    kind = number if text.removeprefix("-").isdecimal() else GIVEN
    value: int | Path = kind.convert(text, param, ctx)
    return value


def report_places(output: Path) -> Settings:
    """Return where a report lies, as ``--json`` prints it."""
    return {"folder": str(output), "report": str(output / REPORT_FILE)}


def log_lines(lines: Mapping[str, str]) -> None:
    """Log the lines of a study's conclusion: what is decided, what is not, and what to run next."""
    for name, text in lines.items():
        LOG.info(f"{name}: {text}")


def finite_records(tables: "Mapping[str, pd.DataFrame]") -> Settings:
    """Return the rows of tables as JSON holds them, by the tables' names; infinite values become missing ones."""
    from jaxurban.io.tables import records_of

    return {
        name: records_of(table.replace(float("inf"), float("nan")))
        for name, table in tables.items()
    }


def outcome_of(rows: "pd.DataFrame", no_route: str) -> tuple[dict[Any, int], ExitCode, str]:
    """Return how a study ended: its number of rows by status, the exit code, and why that is not `ExitCode.DONE`.

    Args:
      rows: of the study, with a ``status``.
      no_route: the warning, and the reason, where no row has a route.
    """
    from jaxurban.paths.rows import HAS_PATH

    statuses = rows.status.value_counts().to_dict()
    if rows.status.isin(HAS_PATH).any():
        return statuses, ExitCode.DONE, ""
    LOG.warning(f"warning: {no_route}")
    return statuses, ExitCode.NO_PATH, no_route


def write_outputs(
    files: Iterable[Path], picture: "Output", other: "Output", cautions: Iterable[str]
) -> None:
    """Write the files of a command and log them, and then what to be cautious of.

    Args:
      files: to write.
      picture: what those hold that end in a picture's suffix.
      other: what the others hold.
      cautions: sentences.
    """
    from jaxurban.draw.write import save

    for file in files:
        is_picture = file.suffix.lower() in PICTURES
        save(file.parent, {file.name: picture if is_picture else other})
        LOG.info(f"wrote {file}")
    for sentence in cautions:
        LOG.info(sentence)


def print_json(
    facts: Settings, code: ExitCode = ExitCode.DONE, message: str = "", argument: str = ""
) -> None:
    """Print the one object of ``--json`` on stdout (docs/reference/json.schema.json).

    Args:
      facts: what the command found, by name.
      code: that the command ends with.
      message: why it is not `ExitCode.DONE`; facts may hold a message of their own.
      argument: the option, argument or setting that is at fault, where that is known.
    """
    ended = {"exit_code": code, "message": message or None, "argument": argument or None}
    print(json.dumps(ended | facts, allow_nan=False), flush=True)
