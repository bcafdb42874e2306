"""jaxurban maps."""

from pathlib import Path

import click

from jaxurban.cli.common import DEVICE_CHOICE, JSON_FLAG, names_in, print_json, tell, tell_warnings
from jaxurban.progress import reporting


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=click.Path(path_type=Path))
@click.option("-o", "folder", type=click.Path(path_type=Path), required=True, help="Output folder.")
@click.option("--overwrite", is_flag=True, help="Replace maps of other settings in the output folder.")
@click.option("--figures", is_flag=True, help="Draw the maps too, under DIR/figures.")
@click.option(
    "--layers",
    default="",
    metavar="NAME,...",
    help="Write these maps as GeoTIFF too, such as hdop,num_visible,roof,terrain,density; all: every one.  "
    "[default: obstacles and the metrics of the cost, which are written always]",
)
@click.option("--memory", help="Ceiling on the memory of the whole run, such as 4GiB. [default: half of what is free]")
@click.option("--workers", type=int, help="Work in so many processes (Dask); one a GPU. [default: a thread a core]")
@click.option("--cluster", metavar="ADDRESS", help="Work on the Dask cluster of a scheduler, such as tcp://host:8786.")
@DEVICE_CHOICE()
@JSON_FLAG
def maps(
    scenario_file: Path,
    folder: Path,
    overwrite: bool,
    figures: bool,
    layers: str,
    memory: str | None,
    workers: int | None,
    cluster: str | None,
    device: str | None,
    as_json: bool,
) -> int:
    """Make the metric maps of SCENARIO (TOML) as Zarr and GeoTIFF."""
    from jaxurban.maps.executors import Resources
    from jaxurban.maps.memory import parse_bytes
    from jaxurban.scenario.run import run_scenario
    from jaxurban.scenario.settings import Scenario

    scenario = Scenario.from_toml(scenario_file)
    resources = Resources(None if memory is None else parse_bytes(memory), workers, cluster).on_device(device)
    with reporting("maps") as report:
        run = run_scenario(scenario, folder, report, overwrite, resources, names_in(layers))
        if figures:
            from jaxurban.report.figures import save_figures

            report("figures")
            for resolution_m, made in run.maps.items():
                save_figures(made, {}, folder / "figures" / f"{resolution_m:g}m")
    tell_warnings(run.record)
    tell(f"maps finished: {folder} (run.json tells what went in)")
    if as_json:
        print_json(run.record)
    return 0
