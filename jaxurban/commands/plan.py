"""jaxurban plan."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from jaxurban.commands.common import (
    JSON_FLAG,
    LONLAT,
    OBSTACLES,
    SNAP_DISTANCE,
    SNAP_FLAG,
    Settings,
    limit_options,
    print_json,
    stored_cost_model,
    stored_obstacles,
    stored_settings,
    stored_weights,
    take_snap,
    tell,
)


@click.command()
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
@OBSTACLES
@click.option("--weights", "weights_text", help="As gps=1,risk=2; those not named keep their values.")
@click.option("--budget", "budget_s", type=float, help="Seconds that the search may take.")
@click.option("--seed", type=click.IntRange(min=0))
@SNAP_FLAG
@SNAP_DISTANCE
@click.option("--refine", is_flag=True, help="Then move the waypoints downhill; needs --cost-model line.")
@click.option("--volume", "is_volume", is_flag=True, help="Climb and descend on the way; --altitude is the start's.")
@click.option("--goal-altitude", "goal_altitude_m", type=float, help="With --volume.  [default: --altitude]")
@click.option("--min-altitude", "min_altitude_m", type=float, help="With --volume.  [default: the maps' lowest]")
@click.option("--max-altitude", "max_altitude_m", type=float, help="With --volume.  [default: the maps' highest]")
@click.option("--level-step", "level_step_m", type=float, help="With --volume: fly between the maps' altitudes too.")
@click.option("--climb-cost", type=float, help="With --volume: per metre.  [default: the distance weight]")
@click.option("--descent-cost", type=float, help="With --volume: per metre.  [default: 0]")
@limit_options
@click.option("--report", "with_report", is_flag=True, help="Explain the route: costs, people, walls, by segment.")
@click.option("--speed", "speed_m_s", type=float, help="Metres per second, for the report's times.")
@click.option("--power", "power_w", type=float, help="Watts in flight, for the report's energy.")
@click.option("--swath", "swath_m", type=float, help="Of people overflown, metres.  [default: 10]")
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
    from jaxurban.io.export import check_export, height_note, write_path
    from jaxurban.limits import Limits
    from jaxurban.maps import open_maps
    from jaxurban.planning import plan as plan_path
    from jaxurban.route_cautions import cautions
    from jaxurban.route_report import check_flight, explain
    from jaxurban.volume import plan_volume

    as_json, with_report, is_volume = (given.pop(name) for name in ("as_json", "with_report", "is_volume"))
    given["snap"] = take_snap(given)
    asked = {name: given.pop(name) for name in ("speed_m_s", "power_w", "swath_m")}
    if asked["swath_m"] is None:
        del asked["swath_m"]
    elif not (with_report or profile is not None or asked["speed_m_s"] is not None):
        raise click.UsageError("--swath is the report's: add --report")
    _check_volume_options(is_volume, given)
    for file in files:
        check_export(file)
    check_flight(**asked)
    with_report |= asked["speed_m_s"] is not None
    if profile is not None:
        from jaxurban.plotting.files import check_picture, save_profile

        check_picture(profile)
    defaults = stored_settings(folder)
    planning = defaults.get("planning", {})
    chosen = {name: given[name] if given[name] is not None else planning.get(name) for name in given}
    del chosen["obstacles"]
    chosen["cost_model"] = stored_cost_model(defaults, given["cost_model"])
    if is_volume:
        chosen = {name: value for name, value in chosen.items() if name not in ("planner", "seed", "refine")}
        chosen["start_altitude_m"] = altitude_m = chosen.pop("altitude_m")
        chosen["goal_altitude_m"] = altitude_m if chosen["goal_altitude_m"] is None else chosen["goal_altitude_m"]
    obstacles = stored_obstacles(defaults, given["obstacles"])
    maps = open_maps(folder, resolution_m, obstacles=obstacles)
    planned = (plan_volume if is_volume else plan_path)(
        maps,
        limits=Limits.read(no_fly, require),
        weights=Weights.parse(weights_text or "", stored_weights(folder, defaults)),
        **{name: value for name, value in chosen.items() if value is not None},
    )
    is_explained = planned.status.has_path and (with_report or profile is not None)
    report = explain(planned, maps, **asked) if is_explained else None
    for file in files:
        if write_path(planned, file, report if with_report else None):
            tell(f"wrote {file}" + (f": {height_note(planned)}" if file.suffix.lower() == ".plan" else ""))
        else:
            tell(f"no path, so {file} was not written" + (" (an older one is still there)" if file.exists() else ""))
    if report is not None and profile is not None:
        save_profile(planned, maps, profile, report)
        tell(f"wrote {profile}")
    facts = planned.to_dict()
    if planned.status.has_path:
        facts["cautions"] = cautions(planned, maps, None if report is None else report.profile)
        for sentence in facts["cautions"]:
            tell(sentence)
    if as_json:
        told = {"report": report.to_dict()} if report is not None else {}
        print_json(facts | told | {name: getattr(planned, name).tolist() for name in ("lonlat", "xy_m", "z_m")})
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
    if is_volume and given["refine"]:
        raise click.UsageError("--refine moves waypoints at one altitude: leave it or --volume out")


def _path_table(facts: Settings) -> str:
    rows = [("planner", f"{facts['planner']} ({facts['heuristic']}, {facts['backend']})"), ("status", facts["status"])]
    if facts["cost"] is not None:
        rows += [("cost", f"{facts['cost']:.3f}")]
        if facts["gap"]:
            rows += [("above the best", f"at most {100 * facts['gap']:.2f} %")]
        rows += [("length", f"{facts['length_m']:.1f} m")]
        moved = [f"{name} {moved_m:.1f} m" for name, moved_m in facts["snap_distance_m"].items()]
        rows += [("moved to cells", ", ".join(moved))]
        rows += [(f"cost of {name}", f"{value:.3f}") for name, value in facts["cost_by_layer"].items()]
        rows += [(f"mean m_{name}", f"{value:.3f}") for name, value in facts["metrics"].items()]
    rows += [("expansions", f"{facts['num_expanded']}"), ("search time", f"{facts['elapsed_s']:.3f} s")]
    return "\n".join([*(f"{name:<20}{value}" for name, value in rows), facts["message"]])
