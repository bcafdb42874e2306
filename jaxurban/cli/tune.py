"""jaxurban tune."""

import shlex
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from jaxurban.cli.common import (
    CONSTRAINTS,
    DEVICE,
    JSON_FLAG,
    OBSTACLES,
    RESOLUTION,
    names_in,
    print_json,
    stored_cost_model,
    stored_obstacles,
    stored_settings,
    tell,
)


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("routes", metavar="ROUTES", type=click.Path(path_type=Path))
@click.option("-o", "out", type=click.Path(path_type=Path), required=True, help="Output folder.")
@click.option(
    "--also",
    type=(click.Path(path_type=Path), click.Path(path_type=Path)),
    multiple=True,
    metavar="DIR ROUTES",
    help="Further maps and routes, fitted together with the first; repeatable.",
)
@click.option("--wish", "wishes", multiple=True, help="Fit to outcomes, such as mean_gps>=0.8; repeatable.")
@click.option("--metrics", help="Fit only these, as gps,risk; the others get weight 0.  [default: all of the maps]")
@click.option("--altitude", "altitude_m", type=float, help="Of every route.  [default: the routes' altitude_m]")
@click.option("--time-of-day", help="Of the population map.  [default: the routes' own, else the first]")
@click.option("--time", help="Time of the GPS map, UTC.  [default: the routes' own, else the first]")
@RESOLUTION
@click.option(
    "--cost-model", type=click.Choice(["cell", "line"]), help="[default: the routes' own, else the scenario's]"
)
@OBSTACLES
@CONSTRAINTS
@click.option("--scale", type=click.Choice(["simplex", "distance"]), help="Weights sum to 1, or distance weighs 1.")
@click.option("--bootstrap", type=click.IntRange(min=0), help="Fits for the intervals.  [default: 200]")
@click.option("--rounds", "max_rounds", type=click.IntRange(min=1), help="Of searches, at most.")
@click.option("--backend", type=click.Choice(["numba", "jax"]), help="Of A*; jax pays on a GPU.  [default: numba]")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--budget", "budget_s", type=float, help="Seconds; the round under way is finished.")
@click.option("--overwrite", is_flag=True, help="Forget a fit of other routes or settings in the output folder.")
@DEVICE
@JSON_FLAG
def tune(folder: Path, routes: Path, out: Path, **given: Any) -> int:
    """Fit weights to demonstrated ROUTES (GeoJSON lines) over the maps in DIR, or to targets for outcomes."""
    from jaxurban.paths.constraints import Constraints
    from jaxurban.report.run_tuning import RoutesOnMaps, TuneSettings, run_tuning
    from jaxurban.studies.tuning.fit_settings import FitSettings

    def named(*options: str) -> dict[str, Any]:
        return {name: given[name] for name in options if given[name] is not None}

    stored, weights = stored_settings(folder), named("scale", "bootstrap")
    if given["wishes"] and weights:
        raise click.UsageError("--scale and --bootstrap belong to fits without --wish: leave them out")
    on_maps = named("altitude_m", "time", "time_of_day")
    on_maps |= {"default_cost_model": stored_cost_model(stored, None)}
    on_maps |= {"constraints": Constraints.read(given["no_fly"], given["require"])}
    if given["cost_model"] is not None:
        on_maps["cost_model"] = stored_cost_model(stored, given["cost_model"])
    if given["metrics"] is not None:
        on_maps["metrics"] = names_in(given["metrics"])
    settings = TuneSettings(
        resolution_m=given["resolution_m"],
        obstacles=stored_obstacles(stored, given["obstacles"]),
        routes=on_maps,
        targets=given["wishes"],
        weights=weights,
        fit=FitSettings(**named("max_rounds", "seed", "budget_s", "backend")),
    )
    sources = [RoutesOnMaps(folder, routes), *(RoutesOnMaps(*pair) for pair in given["also"])]
    facts = run_tuning(sources, out, settings, overwrite=given["overwrite"], command=_command())
    for warning in facts.get("unidentified", []) + facts.get("warnings", []):
        tell(f"warning: {warning}")
    if "message" in facts:
        tell(facts["message"])
    tell(f"tune finished: read {out / 'report.md'}; the weights are in {out / 'weights.toml'}")
    if given["as_json"]:
        print_json(facts)
    else:
        print(facts["weights_option"])
    return 0


def _command() -> str:
    """Return the command as it was given, for the report."""
    context = click.get_current_context()
    words = ["jaxurban", "tune"]
    for param in context.command.params:
        name = param.name or ""
        if context.get_parameter_source(name) is not ParameterSource.COMMANDLINE or name == "as_json":
            continue
        value = context.params[name]
        for one in value if param.multiple else (value,):
            parts = [str(part) for part in one] if isinstance(one, tuple) else [str(one)]
            is_flag = isinstance(param, click.Option) and param.is_flag
            words += [*param.opts[:1], *([] if is_flag else parts)] if isinstance(param, click.Option) else parts
    return shlex.join(words)
