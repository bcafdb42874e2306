"""jaxurban plan."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import (
    CORRIDOR,
    DEVICE,
    JSON_FLAG,
    OF_CORRIDOR,
    PATH,
    ROUTE,
    Settings,
    check_belong,
    density_beneath,
    given_rules,
    option_of,
    print_json,
)
from jaxurban.exit_codes import ExitCode
from jaxurban.progress import LOG

if TYPE_CHECKING:
    from jaxurban.maps.metric_maps import MetricMaps
    from jaxurban.paths.cost_map import CostMap
    from jaxurban.paths.explain import RouteReport
    from jaxurban.paths.ground_risk import OverflownDensity
    from jaxurban.paths.path import PlannedPath
    from jaxurban.paths.when import Departures

LEAST_NAME_WIDTH = 20  # characters of the table's first column
HOW = ("planner", "heuristic", "budget_s", "seed", "snap")
WHICH_MAP = ("objective", "time", "time_of_day")
OF_ONE_ROUTE = (
    "refine",
    "budgets",
    "is_volume",
    "with_report",
    "speed_m_s",
    "power_w",
    "swath_m",
    "corridor_m",
    "simplify_m",
    "end",
    "fence_roofs_m",
)
NOT_WHEN = (
    "--when takes -o .csv or .parquet, and no --refine, --exposure, --volume, --report, --speed, --power, --swath, "
    "--corridor, --simplify, --end or --fence-roofs"
)
LEVEL_OPTIONS = (
    "min_altitude_m",
    "max_altitude_m",
    "level_step_m",
    "climb_cost",
    "descent_cost",
)  # of `Levels`


@click.command()
@ROUTE
@click.option(
    "--planner",
    help="Such as ptp, astar-dist or theta-star.  [default: the scenario's, else astar-plus]",
)
@click.option("--heuristic", help="Lower bound of the search.  [default: the planner's own]")
@click.option(
    "--objective",
    type=click.Choice(["weighted", "distance"]),
    help="[default: the scenario's, else weighted]",
)
@click.option(
    "--budget",
    "budget_s",
    type=float,
    help="Seconds of search.  [default: the scenario's, else 10]",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Seed of sampling planners.  [default: the scenario's, else 0]",
)
@click.option(
    "--refine",
    is_flag=True,
    help="Move the waypoints to lower cost after the search; not under --cost-model cell.",
)
@click.option(
    "--exposure",
    "budgets",
    multiple=True,
    metavar="NAME<=NUMBER",
    help="Most of (1 / l0) x integral of the cost of NAME along the path, such as population<=120; repeatable.",
)
@click.option(
    "--volume",
    "is_volume",
    is_flag=True,
    help="Let the path climb and descend; --altitude is the start's.",
)
@click.option(
    "--goal-altitude",
    "goal_altitude_m",
    type=float,
    help="With --volume, metres.  [default: --altitude]",
)
@click.option(
    "--min-altitude",
    "min_altitude_m",
    type=float,
    help="With --volume, metres.  [default: the lowest]",
)
@click.option(
    "--max-altitude",
    "max_altitude_m",
    type=float,
    help="With --volume, metres.  [default: the highest]",
)
@click.option(
    "--level-step",
    "level_step_m",
    type=float,
    help="With --volume: levels so many metres apart too.",
)
@click.option(
    "--climb-cost",
    type=float,
    help="With --volume: cost per metre up.  [default: the distance weight]",
)
@click.option(
    "--descent-cost", type=float, help="With --volume: cost per metre down.  [default: 0]"
)
@click.option(
    "--report", "with_report", is_flag=True, help="Report costs, people and clearance, by segment."
)
@click.option(
    "--speed",
    "speed_m_s",
    type=float,
    help="Metres per second, for times.  [default: the vehicle's]",
)
@click.option(
    "--power",
    "power_w",
    type=float,
    help="Power in flight in watts, for energy.  [default: the vehicle's]",
)
@click.option(
    "--swath",
    "swath_m",
    type=float,
    help="Width in metres of the strip in which people are counted.  [default: 10]",
)
@CORRIDOR
@click.option(
    "--profile",
    type=PATH,
    help="Write a picture (PNG) of heights, metrics and clearance along the route.",
)
@click.option(
    "--when",
    "is_when",
    is_flag=True,
    help="Plan at every time of the maps; -o takes a table, --profile a strip.",
)
@click.option(
    "-o",
    "files",
    type=PATH,
    multiple=True,
    help="File to write: .geojson, .kml, .gpx or .plan; repeatable.",
)
@click.option(
    "--simplify",
    "simplify_m",
    type=float,
    metavar="METRES",
    help="Keep the fewest straight legs within METRES of the path, clear of closed cells; 0 keeps every turn.  "
    "[default: half a cell in .gpx and .plan, else 0]",
)
@click.option(
    "--end",
    type=click.Choice(["land", "return", "none"]),
    help="How a .plan ends.  [default: land]",
)
@click.option(
    "--fence-roofs",
    "fence_roofs_m",
    type=float,
    metavar="METRES",
    help="Make exclusion fences in a .plan of the roofs within METRES of the route that reach its height less the "
    "vertical clearance.",
)
@DEVICE
@JSON_FLAG
def plan(
    folder: Path, files: Sequence[Path], profile: Path | None, as_json: bool, **options: Any
) -> int:
    """Plan a path over the maps in DIR."""
    from jaxurban.maps.levels import Levels
    from jaxurban.maps.saving import open_maps
    from jaxurban.paths.explain import explain
    from jaxurban.paths.export.write import MISSION, encoder_of
    from jaxurban.paths.path import simplify
    from jaxurban.paths.plan import cost_map
    from jaxurban.paths.search import PathSearch

    flight = {
        name: options[name]
        for name in ("speed_m_s", "power_w", "swath_m")
        if options[name] is not None
    }
    is_volume, has_corridor = options["is_volume"], options["corridor_m"] is not None
    with_report = options["with_report"] or bool(flight) or has_corridor
    check_belong("--volume", is_volume, ("goal_altitude_m", *LEVEL_OPTIONS), options)
    check_belong("--corridor", has_corridor, OF_CORRIDOR, options)
    for file in () if options["is_when"] else files:
        encoder_of(file)
    for name in ("end", "fence_roofs_m"):
        if options[name] is not None and not any(file.suffix.lower() == MISSION for file in files):
            raise click.UsageError(f"{option_of(name)} is of a mission: add -o FILE.plan")
    if profile is not None:
        from jaxurban.report.figures.profile import check_picture, save_profile

        check_picture(profile)
    maps = open_maps(folder, options["resolution_m"], obstacles=options["obstacles"])
    if options["is_when"]:
        return _when(maps, files, profile, as_json, options)
    start, goal, altitude_m = options["start"], options["goal"], options["altitude_m"]
    if is_volume:
        goal_altitude_m = (
            altitude_m if options["goal_altitude_m"] is None else options["goal_altitude_m"]
        )
        start, goal = (*start, altitude_m), (*goal, goal_altitude_m)
        altitude_m = Levels(
            **{name: options[name] for name in LEVEL_OPTIONS if options[name] is not None}
        )
    exposure = _budgets(options["budgets"])
    how = {name: options[name] for name in (*HOW, "refine")}
    search = PathSearch.of(maps, is_volume, exposure=exposure, **how)
    on = {name: options[name] for name in WHICH_MAP}
    shared = cost_map(maps, altitude_m, **on, **given_rules(options))
    planned, maps = shared.planned(start, goal, search), shared.maps
    if options["simplify_m"]:
        planned = simplify(planned, shared, options["simplify_m"])
    is_explained = planned.status.has_path and (with_report or profile is not None)
    density = _density(planned, shared, options) if is_explained and has_corridor else None
    report = explain(planned, maps, **flight, density=density) if is_explained else None
    for file in files:
        _write(file, planned, shared, report if with_report else None, options)
    if report is not None and profile is not None:
        save_profile(planned, maps, profile, report)
        LOG.info(f"wrote {profile}")
    facts = planned.to_dict()
    if planned.status.has_path:
        facts["cautions"] = planned.cautions
        for sentence in facts["cautions"]:
            LOG.info(sentence)
    if as_json:
        explained = {"report": report.to_dict()} if report is not None else {}
        places = {name: getattr(planned, name).tolist() for name in ("lonlat", "xy_m", "z_m")}
        print_json(facts | explained | places, planned.status.exit_code)
    else:
        print(
            "\n\n".join(
                [
                    _path_table(facts),
                    *([report.table()] if report is not None and with_report else []),
                ]
            )
        )
    return planned.status.exit_code


def _density(planned: "PlannedPath", on: "CostMap", options: Settings) -> "OverflownDensity":
    """Return the density of people beneath a path's corridor, and what detours would lower."""
    from jaxurban.paths.detours import density_detours

    density = density_beneath(on.maps, planned, options)
    return replace(density, detours=density_detours(planned, on, density))


def _budgets(given: Sequence[str]) -> dict[str, float]:
    """Return the budgets of exposure in ``"population<=120"`` and the like."""
    parts = [[part.strip() for part in text.split("<=")] for text in given]
    try:
        budgets = {name: float(most) for name, most in parts}
    except ValueError as error:
        raise click.UsageError(
            "--exposure must read NAME<=NUMBER, as in population<=120"
        ) from error
    if len(budgets) < len(parts):
        raise click.UsageError("--exposure names a layer twice: give one budget for it")
    return budgets


def _when(
    maps: "MetricMaps",
    files: Sequence[Path],
    profile: Path | None,
    as_json: bool,
    options: Settings,
) -> int:
    """Plan at every time of the maps, print and write the table, draw the strip, and return the exit code."""
    from jaxurban.io.tables import SUFFIXES, records_of
    from jaxurban.paths.when import when
    from jaxurban.report.figures.when import plot_when
    from jaxurban.report.write import Output, save

    if any(options[name] for name in OF_ONE_ROUTE) or any(
        file.suffix.lower() not in SUFFIXES for file in files
    ):
        raise click.UsageError(NOT_WHEN)
    given = {name: options[name] for name in ("altitude_m", *HOW, *WHICH_MAP)}
    ends = options["start"], options["goal"]
    departures = when(maps, [ends], **given, **given_rules(options))
    outputs: dict[Path, Output] = dict.fromkeys(files, departures.table)
    if profile is not None:
        outputs[profile] = lambda: plot_when(departures, maps)
    for file, output in outputs.items():
        save(file.parent, {file.name: output})
        LOG.info(f"wrote {file}")
    for sentence in departures.cautions:
        LOG.info(sentence)
    facts = {name: fact for name, fact in departures.facts.items() if fact}
    code = ExitCode.NO_PATH if departures.best is None else ExitCode.DONE
    message = "" if departures.best is not None else facts["times without a path"]
    if as_json:
        of_all = {"best": departures.best, "facts": facts, "cautions": departures.cautions}
        of_all |= _numbers_of(departures)
        print_json(of_all | {"table": records_of(departures.table)}, code, message)
    else:
        shown = departures.table.filter(regex="^(?!exposure_)")
        print(shown.to_string(index=False, float_format="{:,.4g}".format))
        print("\n".join(f"{name}: {fact}" for name, fact in facts.items()))
    return code


def _numbers_of(departures: "Departures") -> Settings:
    """Return what ``departures.facts`` says in words as numbers."""
    routes, at_each_time = departures.routes, departures.table
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
    on: "CostMap",
    report: "RouteReport | None",
    options: Settings,
) -> None:
    """Write a path to a file, simplified where it is a file of waypoints and --simplify is left out, and say so."""
    from jaxurban.paths.export.qgc_plan import mission_note
    from jaxurban.paths.export.roof_fences import roof_fences
    from jaxurban.paths.export.write import MISSION, WAYPOINTS, elevation_note, write_path
    from jaxurban.paths.path import simplify

    if not planned.status.has_path:
        LOG.info(
            f"no path, so {file} was not written" + " (an older one is still there)" * file.exists()
        )
        return
    suffix, notes, roofs = file.suffix.lower(), [], None
    if suffix in WAYPOINTS:
        if options["simplify_m"] is None:
            plain, planned = planned, simplify(planned, on, on.grid.resolution_m / 2)
            notes = [
                f"{planned.search.note.removeprefix(plain.search.note).strip()} (--simplify 0 keeps every turn)"
            ]
        if suffix == MISSION and options["fence_roofs_m"] is not None:
            roofs = roof_fences(planned, options["fence_roofs_m"])
        notes.append(
            mission_note(planned, options["end"] or "land", roofs)
            if suffix == MISSION
            else elevation_note(planned)
        )
    end = options["end"] if suffix == MISSION else None
    write_path(planned, file, report, end=end, roofs=roofs)
    LOG.info(" ".join([f"wrote {file}" + ":" * bool(notes), *notes]))


def _path_table(facts: Settings) -> str:
    rows = [
        ("planner", f"{facts['planner']} ({facts['heuristic']}, {facts['backend']})"),
        ("status", facts["status"]),
    ]
    if facts["cost"] is not None:
        rows += [("cost", f"{facts['cost']:.3f}")]
        if facts["gap"]:
            of = f" (best of: {facts['graph']})" if facts["graph"] else ""
            rows += [("above the best", f"at most {100 * facts['gap']:.2f} %{of}")]
        rows += [("length", f"{facts['length_m']:.1f} m")]
        moved = [f"{name} {moved_m:.1f} m" for name, moved_m in facts["snap_distance_m"].items()]
        rows += [("moved to cells", ", ".join(moved))]
        rows += [
            (f"cost of {name}", f"{value:.3f}") for name, value in facts["cost_by_layer"].items()
        ]
        rows += [
            (f"exposure to {name}", f"{value:.3f}")
            for name, value in facts["exposure_by_layer"].items()
        ]
        rows += [(f"mean m_{name}", f"{value:.3f}") for name, value in facts["metrics"].items()]
    setup = f", after {facts['setup_s']:.1f} s of compiling" if facts["setup_s"] >= 1 else ""
    rows += [
        ("expansions", f"{facts['num_expanded']}"),
        ("search time", f"{facts['elapsed_s']:.3f} s{setup}"),
    ]
    width = max(LEAST_NAME_WIDTH, *(len(name) + 1 for name, _ in rows))
    return "\n".join([*(f"{name:<{width}}{value}" for name, value in rows), facts["message"]])
