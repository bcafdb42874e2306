"""What commands share: option types, what they ask for, progress, messages."""

import json
import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from jaxurban.errors import InputError
from jaxurban.exit_codes import ExitCode
from jaxurban.progress import LOG, Report, reporting

if TYPE_CHECKING:
    import numpy as np

    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.constraints import Constraints
    from jaxurban.paths.ground_risk import OverflownDensity
    from jaxurban.paths.path import PlannedPath
    from jaxurban.report.results import Result

StudyResult = TypeVar("StudyResult", bound="Result")
Settings = dict[str, Any]


class Numbers(click.ParamType):
    """Numbers with commas between them, ``count`` of them where that is given."""

    def __init__(self, name: str, example: str, count: int = 0) -> None:
        self.name, self.example, self.count = name, example, count

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the numbers of ``value``."""
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != (self.count or len(numbers) or 1):
            self.fail(f"{value!r} must be {self.example}", param, ctx)
        return numbers


class NamedPath(click.Path):
    """A path; an empty one, as of a variable that is not set, is not the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path of ``value``."""
        if value == "":
            self.fail(
                "the name is empty: name a file or a folder (. is the current one)", param, ctx
            )
        return super().convert(value, param, ctx)


PATH = NamedPath(path_type=Path)


def together(*parameters: Callable) -> Callable[[Callable], Callable]:
    """Return what adds options to a command, in this order."""

    def add(command: Callable) -> Callable:
        for parameter in reversed(parameters):
            command = parameter(command)
        return command

    return add


def stay_on_cpu() -> None:
    """Let JAX compute on the CPU in a command's own process, before its first use, and in those that it starts."""
    import jax

    os.environ["JAX_PLATFORMS"] = "cpu"
    jax.config.update("jax_platforms", "cpu")


def use_device(name: str | None) -> None:
    """Choose what computes in this process, a command's own, and in those that it starts, and say it in the log.

    Args:
      name: ``"cpu"``, ``"gpu"``, ``"auto"`` for a GPU where JAX finds one, or None for that without a word.

    Raises:
      InputError: no GPU that JAX can use.
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


LONLAT = Numbers("LON,LAT", "longitude,latitude in degrees, as in -74.0,40.7", 2)
DEVICE_CHOICE = partial(
    click.option,
    "--device",
    type=click.Choice(["auto", "cpu", "gpu"]),
    help="Device that computes.  [default: auto, a GPU where JAX finds one]",
)
DEVICE = DEVICE_CHOICE(callback=lambda ctx, param, name: use_device(name), expose_value=False)
RESOLUTION = click.option(
    "--resolution",
    "resolution_m",
    type=float,
    help="Cell size of the maps in metres; needed where DIR holds several.",
)
OBSTACLES = click.option(
    "--obstacles",
    type=click.Choice(["touched", "centre"]),
    help="Cells that no path enters: all that a building touches, or (the paper) those whose centre it "
    "covers; paths may then cut true outlines.  [default: the scenario's, else touched]",
)
CONSTRAINTS = together(  # which `given_constraints` takes
    click.option(
        "--no-fly",
        type=PATH,
        multiple=True,
        help="File of polygons that no path enters (GeoJSON, KML); repeatable.",
    ),
    click.option(
        "--require",
        multiple=True,
        help="Bound that every cell of a path must keep, such as gps>=0.3; repeatable.",
    ),
    click.option(
        "--clearance",
        "clearance_m",
        type=float,
        metavar="METRES",
        help="Least distance from buildings that reach the path's altitude.  [default: the scenario's, else 0]",
    ),
    click.option(
        "--vertical-clearance",
        "vertical_clearance_m",
        type=float,
        metavar="METRES",
        help="Least height over roofs; a path goes around higher ones.  [default: the scenario's, else 3]",
    ),
)
COST_MODEL = click.option(
    "--cost-model",
    type=click.Choice(["cell", "line"]),
    help="Cost model; cell is the paper's.  [default: the scenario's]",
)
PRESET = click.option(
    "--preset",
    type=click.Choice(["paper"]),
    help="Plan as the paper does: cost model cell, obstacles at centres, no clearance, "
    "where neither the scenario nor another option says so.",
)
RULES = together(  # what `given_rules` takes, and which maps
    RESOLUTION,
    PRESET,
    COST_MODEL,
    OBSTACLES,
    click.option(
        "--weights",
        "weights_text",
        default="",
        help="Weights such as gps=1,risk=2; others keep their values.",
    ),
    CONSTRAINTS,
)
ROUTE = together(  # a route over maps, under costs
    click.argument("folder", metavar="DIR", type=PATH),
    click.option(
        "--start", type=LONLAT, required=True, help="Start: longitude,latitude in degrees."
    ),
    click.option("--goal", type=LONLAT, required=True, help="Goal: longitude,latitude in degrees."),
    click.option(
        "--altitude",
        "altitude_m",
        type=float,
        required=True,
        help="Altitude in metres above ground, within the maps' range.",
    ),
    click.option(
        "--time-of-day",
        help="Time of day of the population map, such as night.  [default: the first]",
    ),
    click.option("--time", help="Time of the GPS map, UTC.  [default: the first]"),
    RULES,
    click.option(
        "--snap",
        type=float,
        is_flag=False,
        flag_value="50",
        metavar="[METRES]",
        callback=lambda ctx, param, metres: False if metres is None else metres,
        help="Move a start or goal that is not free to the nearest free cell, by at most 50 m or METRES.",
    ),
)
CORRIDOR = together(  # what `density_beneath` takes
    click.option(
        "--corridor",
        "corridor_m",
        type=float,
        metavar="METRES",
        help="Report the density of people beneath a corridor of this half-width, for a ground risk assessment.",
    ),
    click.option(
        "--contingency",
        "contingency_m",
        type=float,
        metavar="METRES",
        help="With --corridor: the contingency volume beside it.  [default: 0]",
    ),
    click.option(
        "--ground-buffer",
        "ground_buffer_m",
        type=float,
        metavar="METRES",
        help="With --corridor: the ground risk buffer.  [default: the flight's height, 1:1, a hint]",
    ),
    click.option(
        "--density-cell",
        "density_cell_m",
        type=float,
        metavar="METRES",
        help="With --corridor: side of the cells of the mean.  [default: 200; 100 and 500 are printed too]",
    ),
)
OF_CORRIDOR = {
    "contingency_m": "contingency_m",
    "ground_buffer_m": "buffer_m",
    "density_cell_m": "cell_m",
}  # options beside --corridor, as `overflown_density` calls them
WORKERS = together(  # what `given_workers` takes
    click.option(
        "--workers",
        type=click.IntRange(min=1),
        help="Number of processes (Dask).  [default: all cores]",
    ),
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Address of a Dask scheduler whose workers to use, such as tcp://host:8786.",
    ),
)
JSON_FLAG = click.option(
    "--json", "as_json", is_flag=True, help="Print one machine-readable object on stdout."
)


def names_in(text: str) -> tuple[str, ...]:
    """Return the names in ``"gps,risk"``."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def given_constraints(options: Settings) -> "Constraints":
    """Return what the options of `CONSTRAINTS` ask for.

    Raises:
      InputError: a file or a bound that cannot be read, or a clearance that is none.
    """
    from jaxurban.paths.constraints import Constraints
    from jaxurban.settings import CLEARANCES

    return Constraints.read(
        options["no_fly"], options["require"], **{name: options[name] for name in CLEARANCES}
    )


def given_rules(options: Settings) -> Settings:
    """Return what the options of routes' costs ask for, as the functions of Python take it."""
    from jaxurban.metrics.weights import Weights

    return {
        "weights": Weights.named_in(options["weights_text"]),
        "cost_model": options["cost_model"],
        "constraints": given_constraints(options),
        "preset": options["preset"] or "",
    }


def density_beneath(
    maps: "MetricMaps", path: "PlannedPath | np.ndarray", options: Settings
) -> "OverflownDensity":
    """Return the density of people beneath the corridor that the options of `CORRIDOR` ask for."""
    from jaxurban.paths.ground_risk import overflown_density

    lengths_m = {
        argument: options[name]
        for name, argument in OF_CORRIDOR.items()
        if options[name] is not None
    }
    return overflown_density(
        maps,
        path,
        half_width_m=options["corridor_m"],
        time_of_day=options["time_of_day"],
        **lengths_m,
    )


def check_belong(owner: str, has_owner: bool, names: Iterable[str], options: Settings) -> None:
    """Raise UsageError where an option is given without the one that it belongs to."""
    for name in () if has_owner else names:
        if options[name] is not None:
            raise click.UsageError(f"{option_of(name)} belongs to {owner}: add that")


def option_of(name: str) -> str:
    """Return the option that a parameter comes from."""
    return f"--{name.removesuffix('_m').replace('_', '-')}"


def given_workers(options: Settings) -> int | str | None:
    """Return the processes or the address that the options of `WORKERS` name, None where they name neither.

    Raises:
      InputError: both.
    """
    if options["workers"] is not None and options["cluster"] is not None:
        raise InputError(
            "give either --workers, for processes of this machine, or --cluster, not both"
        )
    return options["workers"] or options["cluster"]


def all_cores() -> int:
    """Return how many processes use this machine: one, which a message says, where Dask's scheduler is missing."""
    from importlib.util import find_spec

    from jaxurban.maps.executors import num_cores

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
    """Show the package's log on stderr."""
    handler, level = _OnStderr(), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def run_study(
    command: str, output: Path, study: Callable[[Report], StudyResult], overwrite: bool
) -> StudyResult:
    """Return what a study gives its progress to and finds, written to a folder that is checked before it runs.

    Args:
      command: that runs.
      output: the folder.
      study: runs it.
      overwrite: replace another run of the command in the folder.
    """
    from jaxurban.io.workspace import Workspace
    from jaxurban.report.write import REPORT_FILE

    Workspace.check(output, command)
    with reporting(command) as report:
        result = study(report)
        report("report")
        result.save(output, overwrite)
    figures = output / "figures"
    LOG.info(
        f"{command} finished: read {output / REPORT_FILE}"
        + f", look at {figures}" * figures.is_dir()
    )
    return result


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
