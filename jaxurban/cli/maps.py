"""jaxurban maps."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.errors import InputError
from jaxurban.exit_codes import ExitCode
from jaxurban.progress import LOG, reporting
from jaxurban.terminal.common import (
    CHANGES,
    DEVICE_CHOICE,
    FLAG,
    GIVEN,
    JSON_FLAG,
    NAMES,
    OUTPUT,
    OVERWRITE,
    WORKERS,
    Settings,
    print_json,
    stay_on_cpu,
    use_device,
)
from jaxurban.terminal.options import command

if TYPE_CHECKING:
    from jaxurban.maps.scenario import Scenario


@command()
@click.argument("scenario_files", metavar="SCENARIO...", type=GIVEN, nargs=-1, required=True)
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
    scenario_files: tuple[Path, ...],
    output: Path,
    changes: tuple[str, ...],
    overwrite: bool,
    figures: bool,
    layers: tuple[str, ...],
    memory: str | None,
    workers: int | str | None,
    device: str | None,
    as_json: bool,
) -> ExitCode:
    """Make the metric maps of each SCENARIO.

    SCENARIO is a file in TOML, or a folder of maps, which are made again with what --set changes. The maps are written
    as Zarr and GeoTIFF, those of several scenarios each to a folder of its scenario's name below the output folder.
    """
    from jaxurban.maps.free_memory import parse_bytes

    # Several scenarios have a folder each; of a sample city's name, what follows its colon.
    folders = [output]
    if len(scenario_files) > 1:
        folders = [output / file.stem.rpartition(":")[2] for file in scenario_files]
    by_folder = zip(folders, scenario_files, strict=True)
    alike = [repr(str(file)) for folder, file in by_folder if folders.count(folder) > 1]
    if alike:
        raise InputError(
            f"two scenarios have one name, and so one folder below {str(output)!r} ({', '.join(alike)}): rename one, "
            "or name it once"
        )

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
    memory_bytes = None if memory is None else parse_bytes(memory)

    # None is made where one is wrong.
    scenarios, faults = _read(scenario_files, changes)
    if faults:
        for fault in faults:
            LOG.info(f"error: {fault}")
        if len(scenario_files) > 1:
            LOG.info(f"none of the {len(scenario_files)} scenarios is made: mend the wrong ones")
        if as_json:
            print_json({}, ExitCode.BAD_INPUT, "; ".join(faults))
        return ExitCode.BAD_INPUT
    make = partial(
        _made,
        overwrite=overwrite,
        has_figures=figures,
        layers=layers,
        memory_bytes=memory_bytes,
        workers=workers,
    )

    # Of several scenarios one whose files cannot be used keeps no other from being made.
    entries: list[Settings] = []
    kept: list[Path] = []  # folders whose maps were all there
    jobs = zip(folders, scenario_files, scenarios, strict=True)
    for number, (folder, file, scenario) in enumerate(jobs, start=1):
        if len(folders) > 1:
            LOG.info(f"{folder.name}, {number} of {len(folders)} ({file})")
        if file.is_dir():
            LOG.info(
                f"{str(file)!r} is a folder of maps: they are made with the settings of its run"
            )
        entry: Settings = {"folder": str(folder), "exit_code": ExitCode.DONE, "message": None}
        try:
            record, is_kept = make(scenario, folder)
            entry |= record
            if is_kept:
                kept.append(folder)
        except InputError as error:
            if len(folders) == 1:
                raise
            entry |= {"exit_code": ExitCode.BAD_INPUT, "message": str(error)}
        entries.append(entry)

    # What is printed: each warning once, among several scenarios only of what was made, and how each ended.
    warned: dict[str, list[str]] = {}
    for folder, entry in zip(folders, entries, strict=True):
        if len(folders) > 1 and folder in kept:
            continue
        for warning in entry.get("warnings", ()):
            warned.setdefault(warning, []).append(folder.name)
    for warning, names in warned.items():
        of_which = f" ({', '.join(names)})" if len(entries) > 1 else ""
        LOG.warning(f"warning: {warning}{of_which}")
    for folder, entry in zip(folders, entries, strict=True):
        end = f"maps finished: {folder} (run.json holds their settings and sources)"
        if folder in kept:
            end = f"maps kept as finished: {folder} (run.json holds their settings, sources and warnings)"
        if entry["message"]:
            end = f"error: {folder}: {entry['message']}"
        LOG.info(end)
    code = max(entry["exit_code"] for entry in entries)
    facts = entries[0] if len(entries) == 1 else {"scenarios": entries}
    message = "; ".join(filter(None, (entry["message"] for entry in entries)))
    if as_json:
        print_json(facts, code, message)
    return code


def _read(files: Sequence[Path], changes: tuple[str, ...]) -> tuple[list["Scenario"], list[str]]:
    """Return scenarios, and a sentence on each that is wrong or names a file that is not there."""
    from jaxurban.maps.provenance import check_inputs
    from jaxurban.maps.scenario_files import read_scenario

    scenarios, faults = [], []
    for file in files:
        try:
            scenario = read_scenario(file, changes)
            check_inputs(scenario)
            scenarios.append(scenario)
        except InputError as error:
            fault = str(error)
            is_named = len(files) == 1 or str(file) in fault
            faults.append(fault if is_named else f"{file}: {fault}")
    return scenarios, faults


def _made(
    scenario: "Scenario",
    output: Path,
    *,
    overwrite: bool,
    has_figures: bool,
    layers: tuple[str, ...],
    memory_bytes: int | None,
    workers: int | str | None,
) -> tuple[Settings, bool]:
    """Make the maps of a scenario in a folder, unless they are all there.

    Returns:
      The record of their run, and whether they were all there.

    Raises:
      InputError: as of `jaxurban.maps.run.run_scenario`.
    """
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.provenance import finished

    # Make the maps by libraries that neither finished ones nor a wrong scenario need wait for.
    record = None if has_figures or layers or memory_bytes else finished(scenario, output)
    is_kept = record is not None
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
            if has_figures:
                from jaxurban.plot import save_figures

                report("figures")
                for resolution_m, maps_drawn in made.items():
                    save_figures(maps_drawn, (), output / "figures" / f"{resolution_m:g}m")
    return record, is_kept
