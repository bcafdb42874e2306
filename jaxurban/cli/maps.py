"""jaxurban maps."""

from pathlib import Path
from typing import Any

import click

from jaxurban.errors import InputError
from jaxurban.progress import LOG, reporting
from jaxurban.terminal.common import (
    CHANGES,
    DEVICE_CHOICE,
    FLAG,
    JSON_FLAG,
    NAMES,
    OUTPUT,
    OVERWRITE,
    SCENARIO,
    WORKERS,
    print_json,
    stay_on_cpu,
    use_device,
)
from jaxurban.terminal.options import command


@command()
@SCENARIO
@OUTPUT
@CHANGES
@OVERWRITE
@FLAG("--figures", help="Draw the maps too, under DIR/figures.")
@NAMES(
    "--layers",
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
@JSON_FLAG
def maps_command(
    scenario_file: Path,
    output: Path,
    changes: tuple[str, ...],
    overwrite: bool,
    figures: bool,
    layers: tuple[str, ...],
    memory: str | None,
    workers: int | str | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Make the metric maps of SCENARIO.

    SCENARIO is a file in TOML. The maps are written as Zarr and GeoTIFF.
    """
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.free_memory import parse_bytes
    from jaxurban.maps.provenance import finished
    from jaxurban.maps.scenario import Scenario

    # Processes of this machine compute on the CPU; an address is that of a cluster, which has devices of its own.
    has_processes = isinstance(workers, int)
    if has_processes and device == "gpu":
        raise InputError(
            "--workers compute on the CPU: leave them out to compute on one GPU, or start a `dask worker` on each and "
            "name their scheduler by --cluster"
        )
    if has_processes:
        stay_on_cpu()
    use_device(device)
    scenario = Scenario.from_toml(scenario_file, changes)
    memory_bytes = None if memory is None else parse_bytes(memory)

    # Make the maps, unless they are all there, by libraries that neither these nor a wrong scenario need wait for.
    record = None if figures or layers or memory else finished(scenario, output)
    made: dict[float, Any] = {}  # maps to draw, by resolution
    with reporting("maps") as report:
        if record is None:
            from jaxurban.maps.run import run_scenario

            run = run_scenario(
                scenario,
                output,
                report,
                overwrite,
                layers=layers,
                workers=workers,
                memory_bytes=memory_bytes,
            )
            record, made = run.record, run.maps

        # Pictures of other maps are removed, and pictures of these maps are drawn if they are asked for.
        with Workspace.open(output, "maps --figures", is_shared=True) as pictures:
            settings = Workspace.settings_of(output, "maps")
            are_of_these_maps = pictures.settings == settings
            pictures.settings.update(settings)
            if pictures.written and not are_of_these_maps:
                pictures.remove(list(pictures.written))
                LOG.info(
                    "the pictures of the former maps are removed; --figures draws those of these maps"
                )
            if figures:
                from jaxurban.plot import save_figures

                report("figures")
                for resolution_m, maps_drawn in made.items():
                    save_figures(maps_drawn, (), output / "figures" / f"{resolution_m:g}m")
    for warning in record["warnings"]:
        LOG.warning(f"warning: {warning}")
    LOG.info(f"maps finished: {output} (run.json holds their settings and sources)")
    if as_json:
        print_json(record)
