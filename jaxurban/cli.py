"""The command line: demo, maps, plan.

Exit codes: 0 a path or a finished job; 2 bad input or usage; 3 no path; 4 budget spent with no path;
130 interrupted.
"""

import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.errors import InputError

if TYPE_CHECKING:
    from jaxurban.cost import Weights

EXIT_BAD_INPUT, EXIT_INTERRUPTED = 2, 130

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


LONLAT = LonLat()
JSON_FLAG = click.option("--json", "as_json", is_flag=True, help="Print one machine-readable object on stdout.")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="jaxurban")
def app() -> None:
    """Metric maps for small drones over cities, and paths planned on them."""


@app.command()
@click.option("-o", "folder", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace maps of other settings in the output folder.")
@JSON_FLAG
def demo(folder: Path, overwrite: bool, as_json: bool) -> int:
    """Maps of the embedded city, paths over them, pictures and a summary."""
    from jaxurban.showcase import run_demo

    with _stages("demo") as on_stage:
        made = run_demo(folder, on_stage=on_stage, overwrite=overwrite)
    _tell(f"demo finished: read {folder / 'summary.md'}, look at {folder / 'figures'}")
    if as_json:
        _print_json(made)
    return 0


@app.command()
@click.argument("scenario_file", metavar="SCENARIO", type=click.Path(path_type=Path))
@click.option("-o", "folder", type=click.Path(path_type=Path), required=True, help="Output folder.")
@click.option("--overwrite", is_flag=True, help="Replace maps of other settings in the output folder.")
@click.option("--figures", is_flag=True, help="Draw the maps too, under DIR/figures.")
@click.option("--memory", help="Ceiling on the memory of the whole run, such as 4GiB. [default: half of what is free]")
@click.option("--workers", type=int, help="Work in so many processes (Dask). [default: a thread a core]")
@click.option("--cluster", metavar="ADDRESS", help="Work on the Dask cluster of a scheduler, such as tcp://host:8786.")
@JSON_FLAG
def maps(
    scenario_file: Path,
    folder: Path,
    overwrite: bool,
    figures: bool,
    memory: str | None,
    workers: int | None,
    cluster: str | None,
    as_json: bool,
) -> int:
    """Make the metric maps of SCENARIO (TOML) as Zarr and GeoTIFF."""
    from jaxurban.memory import parse_bytes
    from jaxurban.pipeline import Resources, run_scenario
    from jaxurban.scenario import Scenario

    scenario = Scenario.from_toml(scenario_file)
    resources = Resources(None if memory is None else parse_bytes(memory), workers, cluster)
    with _stages("maps") as on_stage:
        run = run_scenario(scenario, folder, on_stage, overwrite, resources, tell=_tell)
        if figures:
            from jaxurban.plotting import save_figures

            on_stage("figures")
            for resolution_m, made in run.maps.items():
                save_figures(made, {}, folder / "figures" / f"{resolution_m:g}m")
    for warning in run.record["warnings"]:
        _tell(f"warning: {warning}")
    _tell(f"maps finished: {folder} (run.json tells what went in)")
    if as_json:
        _print_json(run.record)
    return 0


@app.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--start", type=LONLAT, required=True, help="Longitude,latitude in degrees.")
@click.option("--goal", type=LONLAT, required=True, help="Longitude,latitude in degrees.")
@click.option("--altitude", "altitude_m", type=float, required=True, help="Metres above ground; one of the maps'.")
@click.option("--time-of-day", help="Of the population map, such as day or night; the first if left out.")
@click.option("--time", help="Epoch of the GPS map, UTC; the first if left out.")
@click.option("--resolution", "resolution_m", type=float, help="Of the maps, metres; needed where DIR holds several.")
@click.option("--planner", help="ptp, astar-dist, astar-plus ... [default: the scenario's, else astar-plus]")
@click.option("--heuristic", help="Left out: the planner's own.")
@click.option("--objective", type=click.Choice(["weighted", "distance"]), help="What to minimise.")
@click.option("--cost-model", type=click.Choice(["cell", "line"]), help="cell (the paper) or line.")
@click.option("--weights", "weights_text", help="As gps=1,risk=2; those not named keep their values.")
@click.option("--budget", "budget_s", type=float, help="Seconds that the search may take.")
@click.option("--seed", type=click.IntRange(min=0))
@click.option("--snap", is_flag=True, help="Move a start or goal inside an obstacle to the nearest free cell.")
@click.option("--volume", "is_volume", is_flag=True, help="Climb and descend on the way; --altitude is the start's.")
@click.option("--goal-altitude", "goal_altitude_m", type=float, help="With --volume.  [default: --altitude]")
@click.option("--min-altitude", "min_altitude_m", type=float, help="With --volume.  [default: the maps' lowest]")
@click.option("--max-altitude", "max_altitude_m", type=float, help="With --volume.  [default: the maps' highest]")
@click.option("--level-step", "level_step_m", type=float, help="With --volume: fly between the maps' altitudes too.")
@click.option("--climb-cost", type=float, help="With --volume: per metre.  [default: the distance weight]")
@click.option("--descent-cost", type=float, help="With --volume: per metre.  [default: 0]")
@click.option(
    "--no-fly", type=click.Path(path_type=Path), multiple=True, help="Closed polygons (GeoJSON, KML); repeatable."
)
@click.option("--require", multiple=True, help="What must hold all along, such as gps>=0.3; repeatable.")
@click.option("--report", "with_report", is_flag=True, help="Explain the route: costs, people, walls, by segment.")
@click.option("--speed", "speed_m_s", type=float, help="Metres per second, for the report's times.")
@click.option("--power", "power_w", type=float, help="Watts in flight, for the report's energy.")
@click.option("--swath", "swath_m", type=float, default=10.0, show_default=True, help="Of people overflown, metres.")
@click.option("--profile", type=click.Path(path_type=Path), help="Draw what the route meets, as PNG.")
@click.option(
    "-o", "files", type=click.Path(path_type=Path), multiple=True, help=".geojson, .kml or .plan; repeatable."
)
@JSON_FLAG
def plan(
    folder: Path,
    resolution_m: float | None,
    weights_text: str | None,
    files: Sequence[Path],
    no_fly: Sequence[Path],
    require: Sequence[str],
    profile: Path | None,
    **given: Any,
) -> int:
    """Plan a path over the maps in DIR."""
    from jaxurban.cost import Weights
    from jaxurban.io.export import check_export, write_path
    from jaxurban.limits import Limits
    from jaxurban.maps import open_maps
    from jaxurban.planning import plan as plan_path
    from jaxurban.route_report import check_flight, explain
    from jaxurban.volume import plan_volume

    as_json, with_report, is_volume = (given.pop(name) for name in ("as_json", "with_report", "is_volume"))
    asked = {name: given.pop(name) for name in ("speed_m_s", "power_w", "swath_m")}
    _check_volume_options(is_volume, given)
    for file in files:
        check_export(file)
    check_flight(**asked)
    with_report |= asked["speed_m_s"] is not None
    if profile is not None:
        from jaxurban.plotting.files import check_picture, save_profile

        check_picture(profile)
    defaults = _stored_settings(folder)
    planning = defaults.get("planning", {})
    chosen = {name: given[name] if given[name] is not None else planning.get(name) for name in given}
    chosen |= {name: planning[name] for name in ("connectivity", "diagonal", "reference_length_m") if name in planning}
    if is_volume:
        chosen = {name: value for name, value in chosen.items() if name not in ("planner", "seed")}
        chosen["start_altitude_m"] = altitude_m = chosen.pop("altitude_m")
        chosen["goal_altitude_m"] = altitude_m if chosen["goal_altitude_m"] is None else chosen["goal_altitude_m"]
    maps = open_maps(folder, resolution_m)
    planned = (plan_volume if is_volume else plan_path)(
        maps,
        limits=Limits.read(no_fly, require),
        weights=Weights.parse(weights_text or "", _stored_weights(folder, defaults)),
        **{name: value for name, value in chosen.items() if value is not None},
    )
    is_explained = planned.status.has_path and (with_report or profile is not None)
    report = explain(planned, maps, **asked) if is_explained else None
    for file in files:
        if write_path(planned, file, report if with_report else None):
            _tell(f"wrote {file}")
    if report is not None and profile is not None:
        save_profile(planned, maps, profile, report)
        _tell(f"wrote {profile}")
    facts = planned.to_dict()
    if as_json:
        told = {"report": report.to_dict()} if report is not None else {}
        _print_json(facts | told | {name: getattr(planned, name).tolist() for name in ("lonlat", "xy_m", "z_m")})
    else:
        print("\n\n".join([_path_table(facts), *([report.table()] if report is not None and with_report else [])]))
    return planned.status.exit_code


def _check_volume_options(is_volume: bool, given: Settings) -> None:
    """Raise unless the options of --volume come with it, and another planner without it."""
    volume_only = ("goal_altitude_m", "min_altitude_m", "max_altitude_m", "level_step_m", "climb_cost", "descent_cost")
    for name in volume_only if not is_volume else ():
        if given[name] is not None:
            raise click.UsageError(f"--{name.removesuffix('_m').replace('_', '-')} belongs to --volume: add that")
    if is_volume and given["planner"]:
        raise click.UsageError("--volume has a planner of its own, astar-volume: leave --planner out")


def _stored_settings(folder: Path) -> Settings:
    """Return the settings that made the maps in ``folder``, empty where they were saved from Python."""
    if folder.is_file():
        raise InputError(f"{str(folder)!r} is a file: give the folder that holds the maps")
    try:
        return json.loads((folder / "run.json").read_text(encoding="utf-8"))["settings"]
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{str(folder / 'run.json')!r} cannot be read: make the maps again") from error


def _stored_weights(folder: Path, settings: Settings) -> "Weights":
    from jaxurban.cost import Weights

    try:
        return Weights(**settings.get("weights", {}))
    except TypeError as error:
        raise InputError(
            f"{str(folder / 'run.json')!r} names weights that do not exist: make the maps again"
        ) from error


def _path_table(facts: Settings) -> str:
    rows = [("planner", f"{facts['planner']} ({facts['heuristic']}, {facts['backend']})"), ("status", facts["status"])]
    if facts["cost"] is not None:
        rows += [("cost", f"{facts['cost']:.3f}"), ("length", f"{facts['length_m']:.1f} m")]
        rows += [(f"cost of {name}", f"{value:.3f}") for name, value in facts["cost_by_layer"].items()]
        rows += [(f"mean m_{name}", f"{value:.3f}") for name, value in facts["metrics"].items()]
    rows += [("expansions", f"{facts['num_expanded']}"), ("search time", f"{facts['elapsed_s']:.3f} s")]
    return "\n".join([*(f"{name:<20}{value}" for name, value in rows), facts["message"]])


@contextmanager
def _stages(title: str) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the stage it is told, as a progress bar on stderr (none where it is no terminal)."""
    from tqdm import tqdm

    with tqdm(desc=title, unit="stage", file=sys.stderr, disable=None) as bar:

        def on_stage(name: str) -> None:
            if _interrupted.is_set():
                raise KeyboardInterrupt
            bar.set_postfix_str(name)
            bar.update()

        yield on_stage


def _tell(message: str) -> None:
    print(f"jaxurban: {message}", file=sys.stderr)


def _print_json(value: Any) -> None:
    print(json.dumps(value))


def _use_compilation_cache() -> None:
    """Let JAX keep compiled kernels between runs, under the user's cache folder."""
    import jax

    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxurban" / "jax"
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    warnings.showwarning = lambda message, *_, **__: _tell(f"warning: {message}")
    signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = _show_unraisable
    try:
        _use_compilation_cache()
        code = app.main(args=arguments, prog_name="jaxurban", standalone_mode=False)
    except InputError as error:
        code = _fail(str(error))
    except click.exceptions.NoArgsIsHelpError as help_text:
        print(help_text.format_message())
        code = 0
    except click.UsageError as error:
        code = _fail(f"{error.format_message().rstrip('.')} (see jaxurban --help)")
    except click.ClickException as error:
        code = _fail(error.format_message())
    except MemoryError:
        code = _fail("memory ran out: use a smaller region, a coarser [region] resolution_m, or fewer altitudes")
    except BrokenPipeError:  # the reader of stdout left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except (KeyboardInterrupt, click.Abort):
        _tell("interrupted; finished files are kept, and the same command resumes")
        sys.stdout.flush()
        sys.stderr.flush()
        # At once: libraries' threads that were writing would only complain of the interpreter's end.
        os._exit(EXIT_INTERRUPTED)
    sys.exit(code or 0)


_interrupted = threading.Event()


def _interrupt(*_: object) -> None:
    """Remember Ctrl-C beside raising it: raised inside a callback of JAX it would be lost."""
    _interrupted.set()
    raise KeyboardInterrupt


def _show_unraisable(fault: Any) -> None:
    """Show what Python could not raise, but not a Ctrl-C that is remembered anyway."""
    if not issubclass(fault.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(fault)


def _fail(sentence: str) -> int:
    _tell(f"error: {sentence}")
    return EXIT_BAD_INPUT
