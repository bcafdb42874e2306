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
JSON_FLAG = click.option("--json", "as_json", is_flag=True, help="Print one machine-readable object on stdout.")


def stored_settings(folder: Path) -> Settings:
    """Return the settings that made the maps in ``folder``, empty where they were saved from Python."""
    if folder.is_file():
        raise InputError(f"{str(folder)!r} is a file: give the folder that holds the maps")
    try:
        return json.loads((folder / "run.json").read_text(encoding="utf-8"))["settings"]
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{str(folder / 'run.json')!r} cannot be read: make the maps again") from error


def stored_weights(folder: Path, settings: Settings) -> "Weights":
    """Return the weights that those settings hold, the defaults where they hold none."""
    from jaxurban.cost import Weights

    try:
        return Weights(**settings.get("weights", {}))
    except TypeError as error:
        raise InputError(
            f"{str(folder / 'run.json')!r} names weights that do not exist: make the maps again"
        ) from error


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


def tell_warnings(record: Settings) -> None:
    """Print the warnings of a run on stderr, a line each."""
    for warning in record["warnings"]:
        tell(f"warning: {warning}")


def tell(message: str) -> None:
    """Print a message on stderr."""
    print(f"jaxurban: {message}", file=sys.stderr)


def print_json(value: Any) -> None:
    """Print one machine-readable object on stdout."""
    print(json.dumps(value, allow_nan=False))
