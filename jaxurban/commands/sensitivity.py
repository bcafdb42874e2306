"""jaxurban sensitivity."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from jaxurban.commands.common import (
    JSON_FLAG,
    LONLAT,
    OBSTACLES,
    SNAP_DISTANCE,
    SNAP_FLAG,
    limit_options,
    print_json,
    stages,
    stored_cost_model,
    stored_obstacles,
    stored_settings,
    stored_weights,
    take_snap,
    tell,
)
from jaxurban.errors import InputError

NAMED = {"vary": "vary", "triangle": "triangle", "wishes": "pareto"}  # lists of names, and their options


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--start", type=LONLAT, required=True, help="Longitude,latitude in degrees.")
@click.option("--goal", type=LONLAT, required=True, help="Longitude,latitude in degrees.")
@click.option("--altitude", "altitude_m", type=float, required=True, help="Metres above ground; one of the maps'.")
@click.option("--time-of-day", help="Of the population map, such as day or night; the first if left out.")
@click.option("--time", "epoch", help="Epoch of the GPS map, UTC; the first if left out.")
@click.option("--resolution", "resolution_m", type=float, help="Of the maps, metres; needed where DIR holds several.")
@click.option("--cost-model", type=click.Choice(["cell", "line"]), help="cell (the paper) or line.")
@OBSTACLES
@click.option("--weights", "weights_text", default="", help="As gps=1,risk=2; those not named keep their values.")
@limit_options
@SNAP_FLAG
@SNAP_DISTANCE
@click.option(
    "--vary", default="", metavar="NAME,...", help="Weights that vary.  [default: every metric with a weight]"
)
@click.option(
    "--range", "factors_text", default="0.1,10", show_default=True, metavar="LOW,HIGH", help="Times each weight."
)
@click.option("--samples", "num_samples", type=int, default=128, show_default=True, help="For Sobol; a power of two.")
@click.option(
    "--triangle", default="", metavar="A,B,C", help="Three weights to share.  [default: those that cost most]"
)
@click.option("--pareto", default="", metavar="A,B[,C]", help="What to trade.  [default: distance, the two dearest]")
@click.option("--tolerance", type=float, default=1e-3, show_default=True, help="Of triangle and front; 1e-9 is exact.")
@click.option("--buildings", "with_buildings", is_flag=True, help="Also rank buildings by what they cost the route.")
@click.option(
    "--scenario",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="That made the maps, where --buildings needs its folder.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("-o", "output", type=click.Path(path_type=Path), default=Path("out/sensitivity"), show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace another run of sensitivity in the output folder.")
@JSON_FLAG
def sensitivity(
    folder: Path,
    resolution_m: float | None,
    weights_text: str,
    factors_text: str,
    output: Path,
    as_json: bool,
    with_buildings: bool,
    scenario: Path | None,
    no_fly: Sequence[Path],
    require: Sequence[str],
    overwrite: bool,
    **given: Any,
) -> int:
    """Tell what would change the route between two places over the maps in DIR, and what would not."""
    from jaxurban.cost import Weights
    from jaxurban.io.ownfolder import own_folder
    from jaxurban.io.store import check_writable
    from jaxurban.limits import Limits
    from jaxurban.maps import open_maps
    from jaxurban.planning import plan
    from jaxurban.sensitivity_report import add_buildings, ranges, write_sensitivity
    from jaxurban.studies.sensitivity import sensitivity as study

    if scenario is not None and not with_buildings:
        raise click.UsageError("--scenario belongs to --buildings: add that")
    given["snap"] = take_snap(given)
    settings = stored_settings(folder)
    weights = Weights.parse(weights_text, stored_weights(folder, settings))
    given["cost_model"] = stored_cost_model(settings, given["cost_model"])
    given["limits"] = Limits.read(no_fly, require)
    study_only = ("num_samples", "tolerance", "seed")
    how: dict[str, Any] = {name: given.pop(name) for name in study_only}
    how |= {name: _names(given.pop(option)) for name, option in NAMED.items()}
    factors = _factors(factors_text)
    obstacles = stored_obstacles(settings, given.pop("obstacles"))
    maps = open_maps(folder, resolution_m, obstacles=obstacles)
    check_writable(output)
    asked = {"weights": weights, **given}
    first = plan(maps, time=asked["epoch"], **{name: value for name, value in asked.items() if name != "epoch"})
    if not first.status.has_path:
        tell(first.to_dict()["message"])
        if as_json:
            print_json(first.to_dict())
        return first.status.exit_code
    if first.search.note:
        tell(first.search.note)
    of_maps = {
        name: str(maps.ds.attrs.get(name)) for name in ("run_key", "crs", "resolution_m", "first_row", "first_col")
    }
    question = {
        "maps": of_maps,
        "buildings": with_buildings,
        **asked,
        **given["cost_model"].settings,
        "limits": given["limits"].to_dict(),
        "obstacles": obstacles,
        "weights": asdict(weights),
        "range": factors,
        **how,
    }
    with own_folder(output, "sensitivity", question, overwrite=overwrite), stages("sensitivity") as on_stage:
        found = study(
            maps,
            **asked,
            **how,
            factors=factors,
            on_stage=on_stage,
        )
        on_stage("report")
        write_sensitivity(found, output)
        if with_buildings:
            from jaxurban.costly_buildings import write_buildings

            on_stage("buildings")
            add_buildings(output, write_buildings(folder, first, output / "buildings", scenario=scenario))
    tell(f"sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}")
    if as_json:
        tables = {name: table.reset_index().to_dict("records") for name, table in found.tables().items()}
        told = {"route": found.route.to_dict(), "ranges": {name: ranges(found, name) for name in found.vary}}
        print_json(told | {"tables": _plain(tables), "num_plans": found.num_plans, "elapsed_s": found.elapsed_s})
    return 0


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _factors(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--range {text!r} must be two factors, as in 0.1,10") from error
    return low, high


def _plain(value: Any) -> Any:
    """Return tables with None for no number and plain numbers for NumPy's, as JSON takes them."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and value != value else value
