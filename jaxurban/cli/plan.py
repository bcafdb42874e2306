"""jaxurban plan."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict

import click

from jaxurban.checks import values_given
from jaxurban.cli.common import (
    CORRIDOR,
    COUNT,
    DEVICE,
    FILES,
    FLAG,
    JSON_FLAG,
    METRES,
    NUMBER,
    PATH,
    ROUTE,
    MapsOf,
    RouteOptions,
    Settings,
    check_route,
    print_json,
    write_outputs,
)
from jaxurban.cli.options import DependentOption, command, grouped_options
from jaxurban.errors import InputError
from jaxurban.exit_codes import ExitCode
from jaxurban.paths.export.suffixes import FLOWN, MISSION, check_picture, check_route_file
from jaxurban.progress import LOG

if TYPE_CHECKING:
    from jaxurban.maps.levels import Levels
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.cost_map import CostMap
    from jaxurban.paths.path import PlannedPath
    from jaxurban.paths.route_report import OverflownDensity, RouteReport
    from jaxurban.paths.when import Departures
    from jaxurban.settings import MissionEnd, Objective, OnGround

LEAST_NAME_WIDTH = 20  # characters of the table's first column
NOT_WHEN = (
    "--when takes -o .csv or .parquet, and no --refine, --exposure, --volume, --report, --speed, --power, --swath, "
    "--corridor, --simplify, --end, --fence-roofs, --from-roof or --on-ground"
)
OF_VOLUME = partial(NUMBER, cls=DependentOption, owner="--volume")


def levels_given(
    is_volume: bool,
    min_altitude_m: float | None,
    max_altitude_m: float | None,
    level_step_m: float | None,
    climb_cost: float | None,
    descent_cost: float,
) -> "Levels | None":
    """Return the levels between which a path may climb; None without ``--volume``.

    Args:
      is_volume: whether ``--volume`` is given.
      min_altitude_m, max_altitude_m: the lowest and the highest level; None: those of the maps.
      level_step_m: distance of further levels between the maps' altitudes; None: there are none.
      climb_cost: cost per metre up; None: the distance weight.
      descent_cost: cost per metre down.

    Raises:
      InputError: invalid levels.
    """
    from jaxurban.maps.levels import Levels

    levels = Levels(min_altitude_m, max_altitude_m, level_step_m, climb_cost, descent_cost)
    return levels if is_volume else None


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


class FlightOptions(TypedDict):
    """Keywords of `explain`; None where its own default counts."""

    speed_m_s: float | None
    power_w: float | None
    swath_m: float | None


class RouteFiles(NamedTuple):
    """The files that a route is written to, and how; what is not asked for is None or False.

    Attributes:
      profile: a picture of the route by its length, or of the strip of all times.
      is_when: a route is planned at every time of the maps, and files are its table.
      files: in the format that their names end in.
      simplify_m: how far straight legs may lie from the path.
      end: how a mission ends.
      fence_roofs_m: how far from the route roofs get a fence in a mission.
      from_roof: a mission takes off from the roof at the start.
    """

    profile: Path | None
    is_when: bool
    files: tuple[Path, ...]
    simplify_m: float | None
    end: "MissionEnd | None"
    fence_roofs_m: float | None
    from_roof: bool

    @property
    def suffixes(self) -> set[str]:
        """The ends of the files' names, in lower case."""
        return {file.suffix.lower() for file in self.files}


@command()
@ROUTE
@click.option(
    "--planner",
    help="Such as ptp, astar-dist or theta-star.  [default: the scenario's, else astar-plus]",
)
@click.option("--heuristic", help="Lower bound of the search.  [default: the planner's own]")
@click.option(
    "--backend",
    type=click.Choice(["auto", "numba", "jax"]),
    default="auto",
    show_default=True,
    help="What searches.",
)
@NUMBER("--budget", "budget_s", help="Seconds of search.  [default: the scenario's, else 10]")
@click.option(
    "--seed", type=COUNT, help="Seed of sampling planners.  [default: the scenario's, else 0]"
)
@FLAG(
    "--refine",
    help="Move the waypoints to lower cost after the search; not under --cost-model cell.",
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
    help="[default: the scenario's, else weighted]",
)
@grouped_options(
    "levels",
    levels_given,
    FLAG(
        "--volume", "is_volume", help="Let the path climb and descend; --altitude is the start's."
    ),
    OF_VOLUME(
        "--min-altitude", "min_altitude_m", help="With --volume, metres.  [default: the lowest]"
    ),
    OF_VOLUME(
        "--max-altitude", "max_altitude_m", help="With --volume, metres.  [default: the highest]"
    ),
    OF_VOLUME(
        "--level-step", "level_step_m", help="With --volume: levels so many metres apart too."
    ),
    OF_VOLUME(
        "--climb-cost", help="With --volume: cost per metre up.  [default: the distance weight]"
    ),
    OF_VOLUME(
        "--descent-cost", default=0.0, help="With --volume: cost per metre down.  [default: 0]"
    ),
)
@OF_VOLUME(
    "--goal-altitude", "goal_altitude_m", help="With --volume, metres.  [default: --altitude]"
)
@FLAG("--report", "with_report", help="Report costs, people and clearance, by segment.")
@grouped_options(
    "flight",
    FlightOptions,
    NUMBER("--speed", "speed_m_s", help="Metres per second, for times.  [default: the vehicle's]"),
    NUMBER(
        "--power", "power_w", help="Power in flight in watts, for energy.  [default: the vehicle's]"
    ),
    NUMBER(
        "--swath",
        "swath_m",
        help="Width in metres of the strip in which people are counted.  [default: 10]",
    ),
)
@CORRIDOR
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
        "--end",
        type=click.Choice(["land", "return", "none"]),
        help="How a .plan ends.  [default: land]",
    ),
    METRES(
        "--fence-roofs",
        "fence_roofs_m",
        help="Make exclusion fences in a .plan of the roofs within METRES of the route that reach its height less the "
        "vertical clearance.",
    ),
    FLAG(
        "--from-roof",
        help="A .plan takes off from the roof at the start; its altitudes count from it.",
    ),
)
@DEVICE
@JSON_FLAG
def plan_command(
    folder: Path,
    start: tuple[float, ...],
    goal: tuple[float, ...],
    altitude_m: float,
    goal_altitude_m: float | None,
    levels: "Levels | None",
    time: str | None,
    time_of_day: str | None,
    maps_of: MapsOf,
    objective: "Objective | None",
    rules: RouteOptions,
    with_report: bool,
    flight: Settings,
    corridor: "Callable[..., OverflownDensity] | None",
    outputs: RouteFiles,
    as_json: bool,
    **search: Any,
) -> int:
    """Plan a path over the maps in DIR."""
    # Refuse what cannot be written before a long search. ``search`` holds all further options; they are keywords of the
    # search.
    flight = values_given(flight)
    with_report = with_report or bool(flight) or corridor is not None
    _check_options(outputs, search, with_report or levels is not None)
    search["on_ground"] = _on_ground(outputs, search)
    route_m = altitude_m if levels is None else None
    check_route(folder, route_m, time, rules["weights"], search)

    # The maps, and what is chosen of them.
    maps = maps_of(folder).open()
    if not outputs.suffixes.isdisjoint(FLOWN):
        constraints = rules["constraints"].for_flight(maps.planning, rules["preset"])
        rules = rules | {"constraints": constraints}
    choice: Settings = {"time": time, "time_of_day": time_of_day, "objective": objective, **rules}

    # Imported here: it takes a second or two.
    from jaxurban.paths.explain import explain, with_return_altitude
    from jaxurban.paths.finish import simplify
    from jaxurban.paths.plan import cost_map
    from jaxurban.paths.search import PathSearch
    from jaxurban.paths.when import when

    # A route at every time of the maps.
    if outputs.is_when:
        del search["on_ground"]
        departures = when(maps, [(start, goal)], altitude_m=altitude_m, **choice, **search)
        return _write_departures(departures, maps, outputs, as_json)

    # One route. In a volume its ends are longitude, latitude and altitude.
    if levels is not None:
        start = (*start, altitude_m)
        goal = (*goal, altitude_m if goal_altitude_m is None else goal_altitude_m)
    path_search = PathSearch.of(maps.planning, levels is not None, **search)
    costs = cost_map(maps, levels or altitude_m, **choice)
    _log_closed(costs)
    planned = costs.planned(start, goal, path_search)
    if outputs.simplify_m:
        planned = simplify(planned, costs, outputs.simplify_m)

    # Its report, which the profile needs too, its files, and what is printed.
    report = density = None
    if planned.status.has_path and (with_report or outputs.profile is not None):
        if corridor is not None:
            density = corridor(costs.maps, planned, time_of_day=time_of_day)
        report = explain(planned, costs.maps, density=density, **flight)
        report = with_return_altitude(report, planned, costs.maps)
    return _write_route(planned, costs, report, with_report, outputs, as_json)


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
    of_missions = {
        "--end": outputs.end,
        "--fence-roofs": outputs.fence_roofs_m,
        "--from-roof": outputs.from_roof or None,
    }
    for option in values_given(of_missions):
        if MISSION not in outputs.suffixes:
            raise click.UsageError(f"{option} is of a mission: add -o FILE.plan")
    if outputs.profile is not None:
        check_picture(outputs.profile)
    how_written = outputs._replace(profile=None, is_when=False, files=())
    of_one_route = [search["refine"], search["exposure"], search["on_ground"], *how_written]
    if outputs.is_when and (is_of_one_route or any(of_one_route)):
        raise click.UsageError(NOT_WHEN)


def _on_ground(outputs: RouteFiles, search: Settings) -> "OnGround":
    """Return which ends of a path must be free down to the ground; where it is left open, those of a mission."""
    on_ground = search["on_ground"]
    if on_ground is None:
        on_ground = search["snap"] is not False and MISSION in outputs.suffixes
    return "goal" if on_ground and outputs.from_roof else on_ground


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
    # Files.
    shown = report if with_report else None
    refused = []
    for file in outputs.files:
        try:
            _write(file, planned, costs, shown, outputs)
        except InputError as error:
            refused.append(f"{file}: {error}")
    if report is not None and outputs.profile is not None:
        from jaxurban.report.figures.profile import save_profile

        save_profile(planned, costs.maps, outputs.profile, report)
        LOG.info(f"wrote {outputs.profile}")

    # What is printed: one JSON object, or the facts and the report as tables.
    facts = planned.to_dict()
    if planned.status.has_path:
        facts["cautions"] = planned.cautions
        for sentence in planned.cautions:
            if sentence.kind != "search":  # those are in the message, which is printed too
                LOG.info(sentence)
    if as_json and not refused:
        if report is not None:
            facts["report"] = report.to_dict()
        for name in ("lonlat", "xy_m", "z_m"):
            facts[name] = getattr(planned, name).tolist()
        print_json(facts, planned.status.exit_code)
    elif not as_json:
        print(_path_table(facts))
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
    from jaxurban.io.tables import records_of
    from jaxurban.report.figures.when import plot_when

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
            **_numbers_of(departures),
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


def _numbers_of(departures: "Departures") -> Settings:
    """Return as numbers what ``departures.facts`` says in words: counts, and where any time has a path also costs.

    Shares are of the best cost: ``worst_above_best_share`` of the dearest time, and ``most_kept_above_share`` of the
    best time's route at the time at which it is worst.
    """
    routes = departures.routes
    at_each_time = departures.table
    has_changed = routes.groupby("query")["num_changed"].any()
    numbers = {
        "num_times": len(at_each_time),
        "num_routes": len(has_changed),
        "num_routes_changed": int(has_changed.sum()),
        "num_without_path": int(routes["cost"].isna().sum()),
    }
    if departures.best is None:
        return numbers
    return numbers | {
        "best_cost": float(at_each_time["cost"].min()),
        "worst_above_best_share": float(at_each_time["above_best"].max()),
        "most_kept_above_share": float(at_each_time["kept_above"].max()),
    }


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
    from jaxurban.paths.export.qgc_plan import mission_note
    from jaxurban.paths.export.roof_fences import roof_fences
    from jaxurban.paths.export.write import WAYPOINTS, elevation_note, write_path
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

    # A mission has an end and maybe fences.
    end = roofs = None
    if suffix == MISSION:
        end = outputs.end
        if outputs.fence_roofs_m is not None:
            roofs = roof_fences(planned, outputs.fence_roofs_m)
        notes.append(mission_note(planned, end or "land", roofs, outputs.from_roof))
    elif suffix in WAYPOINTS:
        notes.append(elevation_note(planned))
    from_roof = suffix == MISSION and outputs.from_roof
    write_path(planned, file, report, end=end, roofs=roofs, from_roof=from_roof)
    LOG.info(f"wrote {file}: {' '.join(notes)}" if notes else f"wrote {file}")


def _path_table(facts: Settings) -> str:
    """Return what is known of a path as lines of a name and a value, and last its message.

    Args:
      facts: of the path, as `PlannedPath.to_dict` has them; without a cost there is no path.
    """
    rows = {
        "planner": f"{facts['planner']} ({facts['heuristic']}, {facts['backend']})",
        "status": facts["status"],
    }
    if facts["cost"] is not None:
        rows["cost"] = f"{facts['cost']:.3f}"
        if facts["gap"]:
            rows["above the best"] = f"at most {100 * facts['gap']:.2f} %"
            if facts["graph"]:
                rows["above the best"] += f" (best of: {facts['graph']})"
        rows["length"] = f"{facts['length_m']:.1f} m"

        # How far the start and the goal were moved to free cells, and a row for each layer and metric.
        moves = [f"{name} {moved_m:.1f} m" for name, moved_m in facts["snap_distance_m"].items()]
        rows["moved to cells"] = ", ".join(moves)
        by_label = {
            "cost of ": facts["cost_by_layer"],
            "exposure to ": facts["exposure_by_layer"],
            "mean m_": facts["metrics"],
        }
        for label, values in by_label.items():
            rows |= {f"{label}{name}": f"{value:.3f}" for name, value in values.items()}
    rows["expansions"] = f"{facts['num_expanded']}"
    rows["search time"] = f"{facts['elapsed_s']:.3f} s"
    if facts["setup_s"] >= 1:
        rows["search time"] += f", after {facts['setup_s']:.1f} s of compiling"

    # Values begin in one column, a space behind the longest name.
    width = max(LEAST_NAME_WIDTH, *(len(name) + 1 for name in rows))
    return "\n".join(
        [*(f"{name:<{width}}{value}" for name, value in rows.items()), facts["message"]]
    )
