"""jaxurban maps."""

from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import (
    DEVICE_CHOICE,
    JSON_FLAG,
    PATH,
    WORKERS,
    given_workers,
    names_in,
    print_json,
    stay_on_cpu,
    use_device,
)
from jaxurban.errors import InputError
from jaxurban.progress import LOG, reporting


@click.command()
@click.argument("scenario_file", metavar="SCENARIO", type=PATH)
@click.option("-o", "folder", type=PATH, required=True, help="Output folder.")
@click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change a setting, such as gps.mask_deg=10; values as in TOML; repeatable.",
)
@click.option(
    "--overwrite", is_flag=True, help="Replace maps of other settings in the output folder."
)
@click.option("--figures", is_flag=True, help="Draw the maps too, under DIR/figures.")
@click.option(
    "--layers",
    default="",
    metavar="NAME,...",
    help="Write these maps as GeoTIFF too, such as hdop,num_visible,roof,terrain,density, or all.  "
    "[default: obstacles and the metrics of the cost, which are always written]",
)
@click.option(
    "--memory",
    help="Ceiling on the memory of the whole run, such as 4GiB. [default: half of what is free]",
)
@WORKERS
@DEVICE_CHOICE()
@click.option(
    "--engine",
    type=click.Choice(["auto", "numba", "jax"]),
    help="JAX, or Numba where it has a form; on a CPU both give the same bits.  [default: the scenario's, else auto: "
    "the quicker one]",
)
@JSON_FLAG
def maps(scenario_file: Path, folder: Path, changes: tuple[str, ...], **options: Any) -> int:
    """Make the metric maps of SCENARIO (TOML) as Zarr and GeoTIFF."""
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.memory import parse_bytes
    from jaxurban.maps.run import run_scenario
    from jaxurban.maps.scenario import Scenario

    workers, memory, engine = given_workers(options), options["memory"], options["engine"]
    if options["workers"] and options["device"] == "gpu":
        raise InputError(
            "--workers compute on the CPU: leave them out to compute on one GPU, or start a `dask worker` on each and "
            "name their scheduler by --cluster"
        )
    if options["workers"]:
        stay_on_cpu()
    use_device(options["device"])
    scenario = Scenario.from_toml(
        scenario_file, (*changes, *([f'region.engine = "{engine}"'] if engine else []))
    )
    with reporting("maps") as report:
        run = run_scenario(
            scenario,
            folder,
            report,
            options["overwrite"],
            layers=names_in(options["layers"]),
            workers=workers,
            memory_bytes=None if memory is None else parse_bytes(memory),
        )
        with Workspace.open(folder, "maps --figures", is_shared=True) as pictures:
            drawn, made_by = pictures.settings.copy(), Workspace.settings_of(folder, "maps")
            pictures.settings.update(made_by)
            if pictures.written and drawn != made_by:
                pictures.remove(list(pictures.written))
                LOG.info(
                    "the pictures of the former maps are removed; --figures draws those of these maps"
                )
            if options["figures"]:
                from jaxurban.report.figures import save_figures

                report("figures")
                for resolution_m, made in run.maps.items():
                    save_figures(made, (), folder / "figures" / f"{resolution_m:g}m")
    for warning in run.record["warnings"]:
        LOG.warning(f"warning: {warning}")
    LOG.info(f"maps finished: {folder} (run.json says what went in)")
    if options["as_json"]:
        print_json(run.record)
    return 0
