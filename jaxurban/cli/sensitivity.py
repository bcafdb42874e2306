"""jaxurban sensitivity."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    DEVICE,
    JSON_FLAG,
    ROUTE,
    names_in,
    print_json,
    stored_cost_map,
    stored_settings,
    take_snap,
    tell,
)
from jaxurban.errors import InputError
from jaxurban.progress import reporting

NAMED = {"vary": "vary", "triangle": "triangle", "objectives": "pareto"}  # lists of names, and their options


@click.command()
@ROUTE
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
@DEVICE
@JSON_FLAG
def sensitivity(folder: Path, output: Path, as_json: bool, overwrite: bool, **given: Any) -> int:
    """Report what would change the route between two places over the maps in DIR, and what would not."""
    from jaxurban.io.files import check_writable
    from jaxurban.io.folders import own_folder
    from jaxurban.io.tables import records_of
    from jaxurban.report.sensitivity import add_buildings, ranges, write_sensitivity
    from jaxurban.studies.sensitivity.study import SensitivitySettings
    from jaxurban.studies.sensitivity.study import sensitivity as study

    with_buildings, scenario = given["with_buildings"], given["scenario"]
    if scenario is not None and not with_buildings:
        raise click.UsageError("--scenario belongs to --buildings: add that")
    snap = take_snap(given)
    chosen: dict[str, Any] = {name: names_in(given[option]) for name, option in NAMED.items()}
    chosen |= {name: given[name] for name in ("num_samples", "tolerance", "seed")}
    how = SensitivitySettings(factors=_factors(given["factors_text"]), **chosen)
    shared = stored_cost_map(folder, stored_settings(folder), given, given["altitude_m"])
    check_writable(output)
    ends = {"start": given["start"], "goal": given["goal"], "snap": snap}
    first = shared.plan(**ends)
    if not first.status.has_path:
        tell(first.to_dict()["message"])
        if as_json:
            print_json(first.to_dict())
        return first.status.exit_code
    if first.search.note:
        tell(first.search.note)
    of_maps = {
        name: str(shared.maps.ds.attrs.get(name))
        for name in ("run_key", "crs", "resolution_m", "first_row", "first_col")
    }
    query = {name: given[name] for name in ("altitude_m", "time", "time_of_day")} | ends
    key = {"maps": of_maps, "buildings": with_buildings} | query | dict(first.settings) | asdict(how)
    with own_folder(output, "sensitivity", key, overwrite=overwrite), reporting("sensitivity") as report:
        found = study(shared, **ends, settings=how, progress=report)
        report("report")
        write_sensitivity(found, output)
        if with_buildings:
            from jaxurban.report.buildings import write_buildings

            report("buildings")
            add_buildings(output, write_buildings(folder, first, output / "buildings", scenario=scenario))
    tell(f"sensitivity finished: read {output / 'report.md'}, look at {output / 'figures'}")
    if as_json:
        tables = {name: records_of(table.reset_index()) for name, table in found.tables().items()}
        result = {"route": found.route.to_dict(), "ranges": {name: ranges(found, name) for name in found.vary}}
        print_json(result | {"tables": tables, "num_plans": found.num_plans, "elapsed_s": found.elapsed_s})
    return 0


def _factors(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--range {text!r} must be two factors, as in 0.1,10") from error
    return low, high
