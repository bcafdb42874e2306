"""jaxurban plan."""

from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import click

from jaxurban.errors import InputError
from jaxurban.exit_codes import ExitCode
from jaxurban.paths.suffixes import FLOWN, MISSION, check_picture, check_route_file
from jaxurban.progress import LOG
from jaxurban.settings import Backend, FlownBy, MissionEnd
from jaxurban.terminal.common import (
    DEVICE,
    FILES,
    FLAG,
    JSON_FLAG,
    METRES,
    PATH,
    ROUTE,
    Settings,
    check_route,
    print_json,
    write_outputs,
)
from jaxurban.terminal.options import Values, command, grouped_options

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.cost_map import CostMap
    from jaxurban.paths.path import PlannedPath
    from jaxurban.paths.route_report import RouteReport
    from jaxurban.paths.when import Departures
    from jaxurban.settings import Objective, OnGround

NAME_WIDTH = 16  # characters of the table's first column
NOT_WHEN = (
    "--when takes -o .csv or .parquet, and no --refine, --exposure, --volume, --report, --simplify, "
    "--mission or --on-ground"
)
ASKED = partial(click.option, is_flag=False, flag_value="", metavar="[NAME=VALUE,...]")  # bare too


class SearchOptions(TypedDict):
    """How a path is searched for.

    Attributes:
      planner: such as astar, theta-star or ptp; else the scenario's, else astar.
      heuristic: lower bound of the search, else the planner's own.
      backend: what searches.
      budget_s: seconds of search, else the scenario's, else 10.
      max_samples: of BIT*, after which it ends on any machine alike; without budget_s no seconds count then.
      seed: of sampling planners, else the scenario's, else 0.
    """

    planner: str
    heuristic: str
    backend: Backend
    budget_s: float
    max_samples: int
    seed: int


class Volume(TypedDict):
    """Between which altitudes a path may climb and descend.

    Attributes:
      goal_altitude_m: of the goal, else the start's.
      min_altitude_m: of the lowest level, else the maps' lowest.
      max_altitude_m: of the highest level, else the maps' highest.
      level_step_m: levels so many metres apart too.
      climb_cost: cost per metre up, else the distance weight.
      descent_cost: cost per metre down, else 0.
    """

    goal_altitude_m: float
    min_altitude_m: float
    max_altitude_m: float
    level_step_m: float
    climb_cost: float
    descent_cost: float


class FlightOptions(TypedDict):
    """How a route is flown; what is left out is the vehicle's.

    Attributes:
      speed_m_s: metres per second, for times, else the vehicle's.
      power_w: power in flight in watts, for energy, else the vehicle's.
      swath_m: width in metres of the strip in which people are counted, else 10.
    """

    speed_m_s: float
    power_w: float
    swath_m: float


class MissionFile(TypedDict):
    """What a .plan holds beside the route.

    Attributes:
      end: how the mission ends: land (the default), return or none.
      autopilot: which one it is for: px4 (the default) or ardupilot.
    """

    end: MissionEnd
    autopilot: FlownBy


def exposure_of(
    ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]
) -> dict[str, float]:
    """Return the budget of each layer by name, from texts such as ``"population<=120"``.

    Args:
      ctx, param: of the option, as click gives them; not used.
      texts: one for each layer.

    Raises:
      UsageError: a text of another form, or a second budget of a layer.
    """
    exposure: dict[str, float] = {}
    for text in texts:
        name, _, most = text.partition("<=")
        try:
            exposure[name.strip()] = float(most)
        except ValueError as error:
            raise click.UsageError(
                "--exposure must read NAME<=NUMBER, as in population<=120"
            ) from error
    if len(exposure) < len(texts):
        raise click.UsageError("--exposure names a layer twice: give one budget for it")
    return exposure


class RouteFiles(NamedTuple):
    """The files that a route is written to, and how; what is not asked for is None or False.

    Attributes:
      profile: a picture of the route by its length, or of the strip of all times.
      is_when: a route is planned at every time of the maps, and files are its table.
      files: in the format that their names end in.
      simplify_m: how far straight legs may lie from the path.
      mission: what a mission holds beside the route.
    """

    profile: Path | None
    is_when: bool
    files: tuple[Path, ...]
    simplify_m: float | None
    mission: Settings

    @property
    def suffixes(self) -> set[str]:
        """The ends of the files' names, in lower case."""
        return {file.suffix.lower() for file in self.files}


@command()
@ROUTE
@click.option("--planner", type=Values(SearchOptions), default="", help="What searches, and how.")
@FLAG(
    "--refine",
    help="Move the waypoints to lower cost after the search; not under the cost model cell.",
)
@click.option(
    "--on-ground/--ends-in-air",
    default=None,
    help="Whether start and goal must be free down to the ground, so that a mission can take off and land, or at the "
    "altitude alone.  [default: on the ground with --snap and -o FILE.plan]",
)
@click.option(
    "--exposure",
    multiple=True,
    callback=exposure_of,
    metavar="NAME<=NUMBER",
    help="Most of (1 / l0) x integral of the cost of NAME along the path, such as population<=120; repeatable.",
)
@click.option(
    "--objective",
    type=click.Choice(["weighted", "distance"]),
    default="weighted",
    help="What is sought: the least weighted cost, or the shortest path.  [default: weighted]",
)
@ASKED(
    "--volume",
    type=Values(Volume),
    help="Let the path climb and descend; --altitude is the start's.",
)
@ASKED(
    "--report",
    type=Values(FlightOptions),
    help="Report costs, people and clearance, by segment.",
)
@grouped_options(
    "outputs",
    RouteFiles,
    click.option(
        "--profile",
        type=PATH,
        help="Write a picture (.png, .pdf or .svg) of heights, metrics and clearance along the route.",
    ),
    FLAG(
        "--when",
        "is_when",
        help="Plan at every time of the maps; -o takes a table, --profile a strip.",
    ),
    FILES(help="File to write: .geojson, .kml, .gpx or .plan; repeatable."),
    METRES(
        "--simplify",
        "simplify_m",
        help="Keep the fewest straight legs within METRES of the path, clear of closed cells; 0 keeps every turn.  "
        "[default: half a cell in .gpx and .plan, else 0]",
    ),
    click.option(
        "--mission",
        type=Values(MissionFile),
        default="",
        help="What a .plan holds beside the route.",
    ),
)
@DEVICE
@JSON_FLAG
def plan_command(
    folder: Path,
    start: tuple[float, ...],
    goal: tuple[float, ...],
    altitude_m: float,
    volume: Settings | None,
    time: str | None,
    time_of_day: str | None,
    resolution_m: float | None,
    weights: dict[str, float],
    objective: "Objective",
    rules: Settings,
    planner: Settings,
    report: Settings | None,
    outputs: RouteFiles,
    as_json: bool,
    **search: Any,
) -> int:
    """Plan a path over the maps in DIR."""
    # Refuse what cannot be written before a long search. ``search`` holds all further options; they are keywords of the
    # search.
    search |= planner
    with_report = report is not None
    _check_options(outputs, search, with_report or volume is not None)
    search["on_ground"] = _on_ground(outputs, search)
    route_m = altitude_m if volume is None else None
    check_route(folder, route_m, time, weights, search)

    # The maps, and what is chosen of them.
    from jaxurban.maps.saving import open_maps

    maps = open_maps(folder, resolution_m)
    if not outputs.suffixes.isdisjoint(FLOWN):
        constraints = rules["constraints"].for_flight(maps.planning, rules["preset"])
        rules = rules | {"constraints": constraints}
    choice: Settings = {
        "time": time,
        "time_of_day": time_of_day,
        "objective": objective,
        "weights": weights,
        **rules,
    }

    # Imported here: it takes a second or two.
    from jaxurban.maps.levels import Levels
    from jaxurban.paths.explain import explain, with_return_altitude
    from jaxurban.paths.finish import plan_on, simplify
    from jaxurban.paths.plan import cost_map
    from jaxurban.paths.search import PathSearch
    from jaxurban.paths.when import when

    # A route at every time of the maps.
    if outputs.is_when:
        del search["on_ground"]
        departures = when(maps, [(start, goal)], altitude_m=altitude_m, **choice, **search)
        return _write_departures(departures, maps, outputs, as_json)

    # One route. In a volume its ends are longitude, latitude and altitude.
    levels = None
    if volume is not None:
        start = (*start, altitude_m)
        goal = (*goal, volume.pop("goal_altitude_m", altitude_m))
        levels = Levels(**volume)
    path_search = PathSearch.of(maps.planning, levels is not None, **search)
    costs = cost_map(maps, levels or altitude_m, **choice)
    _log_closed(costs)
    planned = plan_on(costs, start, goal, path_search)
    if outputs.simplify_m:
        planned = simplify(planned, costs, outputs.simplify_m)

    # Its report, which the profile needs too, its files, and what is printed.
    explained = None
    if planned.status.has_path and (with_report or outputs.profile is not None):
        explained = explain(planned, costs.maps, **(report or {}))
        explained = with_return_altitude(explained, planned, costs.maps)
    return _write_route(planned, costs, explained, with_report, outputs, as_json)


def _check_options(outputs: RouteFiles, search: Settings, is_of_one_route: bool) -> None:
    """Refuse files and options that do not go together.

    Args:
      outputs: the files, and how they are written.
      search: keywords of the search.
      is_of_one_route: whether a report or a volume is asked for, which ``--when`` has not.

    Raises:
      InputError: a file of a format that holds no path, or a profile that is no picture.
      UsageError: an option of missions without a mission, or ``--when`` with a file that is no table or with an option
        that is of one route alone.
    """
    if outputs.is_when:
        from jaxurban.io.tables import SUFFIXES

        if not outputs.suffixes.issubset(SUFFIXES):
            raise click.UsageError(NOT_WHEN)
    else:
        for file in outputs.files:
            check_route_file(file)
    if outputs.mission and MISSION not in outputs.suffixes:
        raise click.UsageError("--mission is of a mission: add -o FILE.plan")
    if outputs.profile is not None:
        check_picture(outputs.profile)
    of_one_route = [
        search["refine"],
        search["exposure"],
        search["on_ground"],
        outputs.simplify_m,
        outputs.mission,
    ]
    if outputs.is_when and (is_of_one_route or any(of_one_route)):
        raise click.UsageError(NOT_WHEN)


def _on_ground(outputs: RouteFiles, search: Settings) -> "OnGround":
    """Return which ends of a path must be free down to the ground; where it is left open, those of a mission."""
    on_ground = search["on_ground"]
    if on_ground is None:
        on_ground = search["snap"] is not False and MISSION in outputs.suffixes
    return on_ground


def _log_closed(costs: "CostMap") -> None:
    """Log which share of a map at one altitude is closed, if it is much."""
    from jaxurban.paths.closed import closed_note

    if costs.levels is None:
        note = closed_note(costs.maps, costs.constraints, costs.altitude_m, **costs.when)
        if note:
            LOG.info(note)


def _write_route(
    planned: "PlannedPath",
    costs: "CostMap",
    report: "RouteReport | None",
    with_report: bool,
    outputs: RouteFiles,
    as_json: bool,
) -> int:
    """Write the files of a route, print what is known of it, and return the exit code.

    Args:
      planned: the path.
      costs: that it was planned on.
      report: from `explain`, for the profile; None without a path.
      with_report: whether the report is written and printed too.
      outputs: the files.
      as_json: print one JSON object instead of tables.

    Raises:
      InputError: files that were refused; the others are written.
    """
    from jaxurban.flights.export.write import WAYPOINTS

    # Files.
    shown = report if with_report else None
    refused = []
    for file in outputs.files:
        try:
            _write(file, planned, costs, shown, outputs)
        except InputError as error:
            refused.append(f"{file}: {error}")
    if report is not None and outputs.profile is not None:
        from jaxurban.draw.profile import save_profile

        save_profile(planned, costs.maps, outputs.profile, report)
        LOG.info(f"wrote {outputs.profile}")

    # What is printed: one JSON object, or the facts and the report as tables.
    facts = planned.to_dict()
    if planned.status.has_path:
        facts["cautions"] = planned.cautions
        is_simplified = outputs.simplify_m is None and not outputs.suffixes.isdisjoint(WAYPOINTS)
        whose = "the path as planned: " if is_simplified else ""
        for sentence in planned.cautions:
            if sentence.kind != "search":  # those are in the message, which is printed too
                LOG.info(f"{whose}{sentence}")
    if as_json and not refused:
        if report is not None:
            facts["report"] = report.to_dict()
        for name in ("lonlat", "xy_m", "z_m"):
            facts[name] = getattr(planned, name).tolist()
        print_json(facts, planned.status.exit_code)
    elif not as_json:
        print(_path_table(planned))
        if shown is not None:
            print(f"\n{shown.table()}")
    if refused:
        raise InputError("; ".join(refused))
    return planned.status.exit_code


def _write_departures(
    departures: "Departures",
    maps: "MetricMaps",
    outputs: RouteFiles,
    as_json: bool,
) -> int:
    """Print and write the table of a route at every time, draw the strip, and return the exit code.

    Args:
      departures: from `jaxurban.when`.
      maps: that they were planned on.
      outputs: files of the table, and of the strip as a picture.
      as_json: print one JSON object instead of the table.
    """
    from jaxurban.draw.when import plot_when
    from jaxurban.io.tables import records_of

    files = filter(None, dict.fromkeys((*outputs.files, outputs.profile)))
    strip = partial(plot_when, departures, maps)
    write_outputs(files, strip, departures.table, departures.cautions)

    # What is printed: without a path at any time the exit code says so.
    facts = {name: fact for name, fact in departures.facts.items() if fact}
    code = ExitCode.DONE
    message = ""
    if departures.best is None:
        code = ExitCode.NO_PATH
        message = facts["times without a path"]
    if as_json:
        all_facts = {
            "best": departures.best,
            "facts": facts,
            "cautions": departures.cautions,
            "table": records_of(departures.table),
        }
        print_json(all_facts, code, message)
    else:
        table = departures.table.filter(regex="^(?!exposure_)")  # all columns but exposures
        table = table.dropna(axis="columns", how="all")  # maps may hold no time of day
        print(table.to_string(index=False, float_format="{:,.4g}".format))
        for name, fact in facts.items():
            print(f"{name}: {fact}")
    return code


def _write(
    file: Path,
    planned: "PlannedPath",
    costs: "CostMap",
    report: "RouteReport | None",
    outputs: RouteFiles,
) -> None:
    """Write a path to a file and log it; without a path only a line of the log says that nothing was written.

    Where ``--simplify`` is left out, files of waypoints get a path that is simplified to half a cell.

    Args:
      file: to write, in the format that its name ends in.
      planned: the path.
      costs: that it was planned on.
      report: from `explain`, for formats that hold its figures.
      outputs: how it is written.
    """
    from jaxurban.flights.export.qgc_plan import mission_note
    from jaxurban.flights.export.write import WAYPOINTS, elevation_note, write_path
    from jaxurban.paths.finish import simplify

    if not planned.status.has_path:
        sentence = f"no path, so {file} was not written"
        if file.exists():
            sentence = f"{sentence} (an older one is still there)"
        LOG.info(sentence)
        return

    # Simplify; the note on that is what the path's own note has become longer by.
    suffix = file.suffix.lower()
    notes = []
    if suffix in WAYPOINTS and outputs.simplify_m is None:
        former = planned
        planned = simplify(former, costs, costs.grid.resolution_m / 2)
        note = planned.search.note.removeprefix(former.search.note).strip()
        notes.append(f"{note} (--simplify 0 keeps every turn)")
        for sentence in planned.cautions:  # which may pass nearer to what stands
            if sentence not in former.cautions:
                LOG.info(f"{file}: {sentence}")

    mission: Settings = {}
    if suffix == MISSION:
        mission = outputs.mission
        notes.append(mission_note(planned, **mission))
    elif suffix in WAYPOINTS:
        notes.append(elevation_note(planned))
    write_path(planned, file, report, **mission)
    LOG.info(f"wrote {file}: {' '.join(notes)}" if notes else f"wrote {file}")


def _path_table(planned: "PlannedPath") -> str:
    """Return the facts of a path, a line each, its costs, exposures and means by layer, and last its message."""
    import pandas as pd

    rows = planned.facts | {"mean metrics": "", "message": ""}  # these follow
    if 0 < planned.search.gap < inf:
        rows["above the best"] = f"at most {planned.search.gap:.2%}"
    lines = [f"{name:<{NAME_WIDTH}}{fact}" for name, fact in rows.items() if fact]
    by_layer = pd.DataFrame(
        {
            "cost": planned.cost_by_layer,
            "exposure": planned.exposure_by_layer,
            "mean m": planned.metrics,
        }
    )
    if planned.status.has_path:
        lines.append(by_layer.to_string(float_format="{:.3f}".format, na_rep=""))
    return "\n".join([*lines, planned.message])
