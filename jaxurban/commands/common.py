"""What commands share: option types, stored settings, progress, messages."""

import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from jaxurban.cost import Weights
    from jaxurban.maps import Obstacles
    from jaxurban.planners.base import CostModel

Settings = dict[str, Any]

interrupted = threading.Event()  # set by Ctrl-C: raised inside a callback of JAX it would be lost


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


LONLAT = LonLat()
OBSTACLES = click.option(
    "--obstacles",
    type=click.Choice(["touched", "centre"]),
    help="Cells that no path enters: all that a building touches, or (the paper) only where it covers the centre; "
    "paths then cut true outlines.  [default: the scenario's, else touched]",
)
SNAP_FLAG = click.option(
    "--snap", is_flag=True, help="Move a start or goal inside an obstacle to the nearest free cell, by 50 m at most."
)
SNAP_DISTANCE = click.option(
    "--snap-distance", "snap_distance_m", type=float, metavar="METRES", help="--snap by at most so far instead of 50 m."
)
JSON_FLAG = click.option("--json", "as_json", is_flag=True, help="Print one machine-readable object on stdout.")


def limit_options(command: Callable) -> Callable:
    """Add --no-fly and --require, which `Limits.read` takes, to a command."""
    require = click.option("--require", multiple=True, help="What must hold all along, such as gps>=0.3; repeatable.")
    no_fly = click.option(
        "--no-fly", type=click.Path(path_type=Path), multiple=True, help="Closed polygons (GeoJSON, KML); repeatable."
    )
    return no_fly(require(command))


def take_snap(given: Settings) -> bool | float:
    """Take the options of snapping out of ``given``; return what `jaxurban.plan` takes as ``snap``."""
    is_asked, distance_m = given.pop("snap"), given.pop("snap_distance_m")
    return is_asked if distance_m is None else distance_m


def stored_settings(folder: Path) -> Settings:
    """Return the settings that made the maps in ``folder``, empty where they were saved from Python.

    Raises:
      InputError: the record of the run that made them is damaged or missing, and with it their weights.
    """
    from jaxurban.io.seal import read_json
    from jaxurban.io.store import RUN_FILE, are_of_a_run

    if folder.is_file():
        raise InputError(f"{str(folder)!r} is a file: give the folder that holds the maps")
    remedy = "run the same `jaxurban maps` command again, which writes it anew"
    try:
        return read_json(folder / RUN_FILE)["settings"]
    except FileNotFoundError as error:
        if are_of_a_run(folder):
            raise InputError(
                f"{str(folder / RUN_FILE)!r}, with the settings of the maps, is missing: {remedy}"
            ) from error
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{str(folder / RUN_FILE)!r} cannot be read ({error}): {remedy}") from error


def stored_weights(folder: Path, settings: Settings) -> "Weights":
    """Return the weights that those settings hold, the defaults where they hold none."""
    from jaxurban.cost import Weights

    try:
        return Weights(**settings.get("weights", {}))
    except TypeError as error:
        raise InputError(
            f"{str(folder / 'run.json')!r} names weights that do not exist: make the maps again"
        ) from error


def stored_cost_model(settings: Settings, kind: str | None) -> "CostModel":
    """Return the cost model of those settings' ``[planning]``, of another kind where one is given.

    Raises:
      InputError: a value that is none of a cost model's.
    """
    from jaxurban.planners.base import CostModel

    planning = settings.get("planning", {})
    return CostModel.from_settings(planning if kind is None else {**planning, "cost_model": kind})


def stored_obstacles(settings: Settings, given: "Obstacles | None") -> "Obstacles":
    """Return the rule of obstacles that is given, else that of those settings' ``[planning]``."""
    return given or settings.get("planning", {}).get("obstacles", "touched")


@contextmanager
def stages(title: str) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the stage it is told, as a progress bar on stderr (none where it is no terminal)."""
    from tqdm import tqdm

    with tqdm(desc=title, unit="stage", file=sys.stderr, disable=None) as bar:

        def on_stage(name: str) -> None:
            if interrupted.is_set():
                raise KeyboardInterrupt
            bar.set_postfix_str(name)
            bar.update()

        yield on_stage


@contextmanager
def rounds(title: str) -> Iterator[tuple[Callable[[str], None], Callable[["pd.DataFrame"], None]]]:
    """Yield functions that show the stage, and the learning curve after each round, as a progress bar on stderr."""
    from tqdm import tqdm

    with tqdm(desc=title, unit="round", file=sys.stderr, disable=None) as bar:

        def on_stage(name: str) -> None:
            if interrupted.is_set():
                raise KeyboardInterrupt
            bar.set_postfix_str(name)

        def on_round(curve: "pd.DataFrame") -> None:
            last = curve.iloc[-1]
            on_stage(f"loss {last['loss']:.3g}, {last['num_plans']:.0f} searches")
            bar.update()

        yield on_stage, on_round


def tell(message: str) -> None:
    """Print a message on stderr."""
    print(f"jaxurban: {message}", file=sys.stderr)


def print_json(value: Any) -> None:
    """Print one machine-readable object on stdout."""
    print(json.dumps(value, allow_nan=False))
