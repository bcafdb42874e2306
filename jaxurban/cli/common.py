"""What commands share: option types, stored settings, progress, messages."""

import json
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.errors import InputError
from jaxurban.presets import DEFAULTS, with_preset
from jaxurban.progress import LOG

if TYPE_CHECKING:
    from jaxurban.maps.levels import Levels
    from jaxurban.maps.metric_maps import Obstacles
    from jaxurban.metrics.weights import Weights
    from jaxurban.paths.constraints import Constraints
    from jaxurban.paths.cost_map import CostMap
    from jaxurban.planners.cost_model import CostModel

Settings = dict[str, Any]


class LonLat(click.ParamType):
    """``LON,LAT`` in degrees."""

    name = "LON,LAT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return the two numbers of ``value``."""
        if isinstance(value, tuple):
            return value
        try:
            lon, lat = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} must be longitude,latitude in degrees, as in -74.0,40.7", param, ctx)
        return lon, lat


class NamedPath(click.Path):
    """A path; an empty one, as of a variable that is not set, is not the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path of ``value``."""
        if value == "":
            self.fail("the name is empty: name a file or a folder (. is the current one)", param, ctx)
        return super().convert(value, param, ctx)


PATH = NamedPath(path_type=Path)


def together(*parameters: Callable) -> Callable[[Callable], Callable]:
    """Return what adds options to a command, in this order."""

    def add(command: Callable) -> Callable:
        for parameter in reversed(parameters):
            command = parameter(command)
        return command

    return add


def _use_device(ctx: click.Context, param: click.Parameter, value: str | None) -> None:
    """Choose the device before anything computes."""
    if value is not None:
        from jaxurban.maps.device import use_device

        use_device(value)


LONLAT = LonLat()
DEVICE_CHOICE = partial(
    click.option,
    "--device",
    type=click.Choice(["auto", "cpu", "gpu"]),
    help="What computes.  [default: auto, a GPU where JAX finds one]",
)
DEVICE = DEVICE_CHOICE(callback=_use_device, expose_value=False)
RESOLUTION = click.option(
    "--resolution", "resolution_m", type=float, help="Of the maps, metres; needed where DIR holds several."
)
OBSTACLES = click.option(
    "--obstacles",
    type=click.Choice(["touched", "centre"]),
    help="Cells that no path enters: all that a building touches, or (the paper) only where it covers the centre; "
    "paths then cut true outlines.  [default: the scenario's, else touched]",
)
CONSTRAINTS = together(  # which `given_constraints` takes
    click.option("--no-fly", type=PATH, multiple=True, help="Closed polygons (GeoJSON, KML); repeatable."),
    click.option("--require", multiple=True, help="What must hold all along, such as gps>=0.3; repeatable."),
    click.option(
        "--clearance",
        "clearance_m",
        type=float,
        metavar="METRES",
        help="Keep so far from buildings as high as the path.  [default: the scenario's, else 0]",
    ),
    click.option(
        "--vertical-clearance",
        "vertical_clearance_m",
        type=float,
        metavar="METRES",
        help="Keep so high over roofs, or clear of them.  [default: the scenario's, else 3]",
    ),
)
COST_MODEL = click.option(
    "--cost-model", type=click.Choice(["cell", "line"]), help="line, or cell (the paper).  [default: the scenario's]"
)
PRESET = click.option(
    "--preset",
    type=click.Choice(["paper"]),
    help="Plan as the paper does: cost model cell, obstacles at centres, no clearance; other options win over it.",
)
ENDS = [  # of a route, with the altitude: names, type and help of their options
    (("--start",), LONLAT, "Longitude,latitude in degrees."),
    (("--goal",), LONLAT, "Longitude,latitude in degrees."),
    (("--altitude", "altitude_m"), float, "Metres above ground, within the maps' range."),
]
COSTS = together(  # what the cost map of a route depends on, beside its altitude
    click.option("--time-of-day", help="Of the population map, such as day or night; the first if left out."),
    click.option("--time", help="Time of the GPS map, UTC; the first if left out."),
    RESOLUTION,
    PRESET,
    COST_MODEL,
    OBSTACLES,
    click.option("--weights", "weights_text", default="", help="As gps=1,risk=2; those not named keep their values."),
    CONSTRAINTS,
    click.option(
        "--snap",
        is_flag=True,
        help="Move a start or goal inside an obstacle to the nearest free cell, by 50 m at most.",
    ),
    click.option(
        "--snap-distance",
        "snap_distance_m",
        type=float,
        metavar="METRES",
        help="--snap by at most so far instead of 50 m.",
    ),
)
ROUTE = together(  # a route over maps, under costs: what `stored_cost_map` takes, and the ends
    click.argument("folder", metavar="DIR", type=PATH),
    *(click.option(*names, type=kind, required=True, help=told) for names, kind, told in ENDS),
    COSTS,
)
DEGREES = click.option("--degrees", is_flag=True, help="Label the maps of figures by longitude and latitude.")
JSON_FLAG = click.option("--json", "as_json", is_flag=True, help="Print one machine-readable object on stdout.")


def names_in(text: str) -> tuple[str, ...]:
    """Return the names in ``"gps,risk"``."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def numbers_in(option: str, text: str) -> tuple[float, ...]:
    """Return the numbers in ``"0.1,10"``.

    Raises:
      InputError: one is none (names the option).
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"{option} {text!r} must be numbers, as in 20,60") from error


def take_snap(given: Settings) -> bool | float:
    """Take the options of snapping out of ``given``; return what `jaxurban.plan` takes as ``snap``."""
    is_wanted, distance_m = given.pop("snap"), given.pop("snap_distance_m")
    return is_wanted if distance_m is None else distance_m


def stored_settings(folder: Path, preset: str | None = None) -> Settings:
    """Return the settings that made the maps in ``folder``, empty where they were saved from Python.

    Args:
      folder: of the maps.
      preset: whose settings take the place of those in ``[planning]``.

    Raises:
      InputError: the record of the run that made them is damaged or missing, and with it their weights.
    """
    from jaxurban.io.store import settings_of

    if folder.is_file():
        raise InputError(f"{str(folder)!r} is a file: give the folder that holds the maps")
    return {**with_preset(settings_of(folder), preset or "")}


def stored_weights(folder: Path, settings: Settings) -> "Weights":
    """Return the weights that those settings hold, the defaults where they hold none."""
    from jaxurban.metrics.weights import Weights

    try:
        return Weights.of(settings.get("weights")).checked(settings.get("layers", ()))
    except InputError as error:
        raise InputError(
            f"{str(folder / 'run.json')!r} names weights that do not exist ({error}): make the maps again"
        ) from error


def stored_cost_model(settings: Settings, kind: str | None) -> "CostModel":
    """Return the cost model of those settings' ``[planning]``, of another kind where one is given.

    Raises:
      InputError: a value that is none of a cost model's.
    """
    from jaxurban.planners.cost_model import CostModel

    planning = settings.get("planning", {})
    return CostModel.from_settings(planning if kind is None else {**planning, "cost_model": kind})


def stored_obstacles(settings: Settings, given: "Obstacles | None") -> "Obstacles":
    """Return the rule of obstacles that is given, else that of those settings' ``[planning]``."""
    return given or settings.get("planning", {}).get("obstacles", DEFAULTS.obstacles)


def given_constraints(given: Settings, settings: Settings) -> "Constraints":
    """Return what the options of `CONSTRAINTS` ask for; clearances left out, and the vehicle, are those of settings.

    Raises:
      InputError: a file or a bound that cannot be read, or a clearance that is none.
    """
    from jaxurban.paths.constraints import CLEARANCES, Constraints
    from jaxurban.paths.vehicle import Vehicle

    planning = settings.get("planning", {})
    clearances = {name: planning.get(name) if given[name] is None else given[name] for name in CLEARANCES}
    vehicle = Vehicle(**settings.get("vehicle", {}))
    known = {name: value for name, value in clearances.items() if value is not None}
    return Constraints.read(given["no_fly"], given["require"], **known, vehicle=vehicle)


def stored_cost_map(
    folder: Path, stored: Settings, given: Settings, altitude_m: "float | Levels", objective: str = "weighted"
) -> "CostMap":
    """Return the cost map that the options of `ROUTE` ask for; what they leave out is as the maps were made with.

    Args:
      folder: of the maps.
      stored: their settings.
      given: the options.
      altitude_m, objective: as in `jaxurban.cost_map`.
    """
    from jaxurban.maps.metric_maps import open_maps
    from jaxurban.metrics.weights import Weights
    from jaxurban.paths.cost_map import cost_map

    model = stored_cost_model(stored, given["cost_model"])
    return cost_map(
        open_maps(folder, given["resolution_m"], obstacles=stored_obstacles(stored, given["obstacles"])),
        altitude_m,
        weights=Weights.parse(given["weights_text"], stored_weights(folder, stored)),
        objective=objective,
        cost_model=model,
        time=given["time"],
        time_of_day=given["time_of_day"],
        constraints=given_constraints(given, stored),
    )


def tell_warnings(record: Settings) -> None:
    """Print the warnings of a run on stderr, a line each."""
    for warning in record["warnings"]:
        tell(f"warning: {warning}")


def tell(message: str) -> None:
    """Print a message on stderr, through the log."""
    LOG.info(message)


def default_workers() -> int:
    """Return a process a core, or one where Dask's scheduler is not installed, which a warning says."""
    from importlib.util import find_spec

    from jaxurban.maps.executors import num_cores

    if find_spec("distributed") is not None:
        return num_cores()
    tell("working on one core: several need Dask's scheduler, pip install 'jaxurban[cluster]'")
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


def print_json(value: Any) -> None:
    """Print one machine-readable object on stdout."""
    print(json.dumps(value, allow_nan=False))
