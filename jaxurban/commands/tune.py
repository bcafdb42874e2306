"""jaxurban tune."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from jaxurban.commands.common import (
    JSON_FLAG,
    OBSTACLES,
    limit_options,
    print_json,
    rounds,
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
@click.option("--metrics", help="Fit only these, as gps,risk; the others weigh 0.  [default: all of the maps]")
@click.option("--altitude", "altitude_m", type=float, help="Of every route.  [default: the routes' altitude_m]")
@click.option("--time-of-day", help="Of the population map.  [default: the routes' own, else the first]")
@click.option("--time", help="Epoch of the GPS map, UTC.  [default: the routes' own, else the first]")
@click.option("--resolution", "resolution_m", type=float, help="Of the maps, metres; needed where DIR holds several.")
@click.option(
    "--cost-model", type=click.Choice(["cell", "line"]), help="[default: the routes' own, else the scenario's]"
)
@OBSTACLES
@limit_options
@click.option("--scale", type=click.Choice(["simplex", "distance"]), help="Weights sum to 1, or distance weighs 1.")
@click.option("--bootstrap", type=click.IntRange(min=0), help="Fits for the intervals.  [default: 200]")
@click.option("--rounds", "max_rounds", type=click.IntRange(min=1), help="Of searches, at most.")
@click.option("--backend", type=click.Choice(["numba", "jax"]), help="Of A*; jax pays on a GPU.  [default: numba]")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--budget", "budget_s", type=float, help="Seconds; the round under way is finished.")
@click.option("--overwrite", is_flag=True, help="Forget a fit of other routes or settings in the output folder.")
@JSON_FLAG
def tune(
    folder: Path,
    routes: Path,
    out: Path,
    also: Sequence[tuple[Path, Path]],
    wishes: Sequence[str],
    metrics: str | None,
    cost_model: str | None,
    no_fly: Sequence[Path],
    require: Sequence[str],
    scale: str | None,
    bootstrap: int | None,
    overwrite: bool,
    as_json: bool,
    **given: Any,
) -> int:
    """Fit weights to example ROUTES (GeoJSON lines) over the maps in DIR, or to wishes on outcomes."""
    from jaxurban.limits import Limits
    from jaxurban.studies.wishes import Wish
    from jaxurban.tuning import Source, TuneSettings, run_tuning

    if wishes and (scale or bootstrap is not None):
        raise click.UsageError("--scale and --bootstrap belong to fits without --wish: leave them out")
    stored = stored_settings(folder)
    on_maps: dict[str, Any] = {
        "cost_model": None if cost_model is None else stored_cost_model(stored, cost_model),
        "default_cost_model": stored_cost_model(stored, None),
        "limits": Limits.read(no_fly, require),
    }
    if metrics is not None:
        on_maps["metrics"] = [name.strip() for name in metrics.split(",") if name.strip()]
    of_fit = {"scale": scale, "bootstrap": bootstrap} | {
        name: given.pop(name) for name in ("max_rounds", "seed", "budget_s", "backend")
    }
    settings = TuneSettings(
        obstacles=stored_obstacles(stored, given.pop("obstacles")),
        **given,
        maps=on_maps,
        wishes=tuple(Wish.parse(text) for text in wishes),
        fit={name: value for name, value in of_fit.items() if value is not None},
    )
    sources = [Source(folder, routes), *(Source(*pair) for pair in also)]
    with rounds("tune") as (on_stage, on_round):
        facts = run_tuning(
            sources, out, settings, overwrite=overwrite, command=_command(), on_round=on_round, on_stage=on_stage
        )
    for warning in facts.get("unidentified", []) + facts.get("warnings", []):
        tell(f"warning: {warning}")
    if "message" in facts:
        tell(facts["message"])
    tell(f"tune finished: read {out / 'report.md'}; the weights are in {out / 'weights.toml'}")
    if as_json:
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
