"""jaxurban maps."""

import traceback
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jaxurban.cli.common import (
    DEVICE_CHOICE,
    JSON_FLAG,
    PATH,
    Settings,
    names_in,
    print_json,
    stay_on_cpu,
    tell,
    tell_warnings,
    use_device,
)
from jaxurban.errors import InputError, at_least
from jaxurban.progress import reporting

if TYPE_CHECKING:
    from jaxurban.maps.scenario import Scenario

EXIT_BUG, EXIT_BAD_INPUT = 1, 2
TAKEN = (".", "geotiff", "maps.zarr", "figures")  # no folder of a scenario beside others


@click.command()
@click.argument("scenario_files", metavar="SCENARIO...", type=PATH, nargs=-1, required=True)
@click.option("-o", "folder", type=PATH, required=True, help="Output folder.")
@click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change a setting, such as gps.mask_deg=10; values as in TOML; repeatable.",
)
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
@click.option("--workers", type=int, help="Work in so many processes (Dask), on the CPU.  [default: a thread a core]")
@click.option("--cluster", metavar="ADDRESS", help="Work on the Dask cluster of a scheduler, such as tcp://host:8786.")
@DEVICE_CHOICE()
@click.option(
    "--engine",
    type=click.Choice(["auto", "numba", "jax"]),
    help="Make the maps by Numba on the host, or by JAX; the same bits on a CPU.  [default: the scenario's, else auto: "
    "Numba on a CPU, JAX on a GPU]",
)
@JSON_FLAG
def maps(
    scenario_files: tuple[Path, ...],
    folder: Path,
    changes: tuple[str, ...],
    engine: str | None,
    as_json: bool,
    **given: Any,
) -> int:
    """Make the metric maps of SCENARIO (TOML) as Zarr and GeoTIFF.

    Of several scenarios each goes to a folder of its own under the output folder, named as its file; one that fails
    does not stop the others, and the exit code is then 2.
    """
    from jaxurban.maps.memory import parse_bytes
    from jaxurban.maps.scenario import Scenario

    changes += () if engine is None else (f'region.engine = "{engine}"',)
    memory = given["memory"]
    how = {"workers": _workers(given), "memory_bytes": None if memory is None else parse_bytes(memory)}
    if len(scenario_files) == 1:
        record = _make(Scenario.from_toml(scenario_files[0], changes), folder, given, **how)
        if as_json:
            print_json(record)
        return 0
    names = _folder_names(scenario_files)
    found: dict[str, Any] = {}
    codes = {0}
    for name, file in zip(names, scenario_files, strict=True):
        tell(f"scenario {file}")
        try:
            found[name] = _make(Scenario.from_toml(file, changes), folder / name, given, **how)
        except Exception as error:
            is_ours = isinstance(error, InputError | MemoryError)
            codes.add(EXIT_BAD_INPUT if is_ours else EXIT_BUG)
            found[name] = {"error": str(error) or type(error).__name__}
            where = "" if found[name]["error"].startswith(str(file)) else f"{file}: "
            tell(f"error: {where}{found[name]['error']}" if is_ours else traceback.format_exc())
    failed = [name for name in names if "error" in found[name]]
    tell(
        f"{len(names) - len(failed)} of {len(names)} scenarios finished"
        + "".join(f"; {name} failed" for name in failed)
    )
    if as_json:
        print_json({"scenarios": found})
    return EXIT_BUG if EXIT_BUG in codes else max(codes)


def _folder_names(scenario_files: Sequence[Path]) -> list[str]:
    """Return a folder's name for each of several scenarios: its file's.

    Raises:
      InputError: two of one name, or one that maps in the output folder would use.
    """
    names = [file.stem for file in scenario_files]
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(
            f"two scenarios are called {twice[0]!r}, and each goes to a folder of its name: rename one of them"
        )
    if taken := [name for name in names if name in TAKEN]:
        raise InputError(f"a folder called {taken[0]!r} is one of the maps' own: rename that scenario")
    return names


def _workers(given: Settings) -> int | str | None:
    """Return the processes or the address of a cluster that the options name, if any, once what computes is settled."""
    workers, cluster, device = given["workers"], given["cluster"], given["device"]
    if workers is not None:
        at_least("--workers", workers, 1)
    if workers is not None and cluster is not None:
        raise InputError("give either --workers, for processes of this machine, or --cluster, not both")
    if workers is not None and device == "gpu":
        raise InputError(
            "--workers compute on the CPU: leave them out to compute on one GPU, or start a `dask worker` on each and "
            "name their scheduler by --cluster"
        )
    if workers is not None:
        stay_on_cpu()
    use_device(device)
    return workers or cluster


def _make(scenario: "Scenario", folder: Path, given: Settings, **how: Any) -> dict[str, Any]:
    """Make the maps of one scenario, draw them as the options have it, and return the record of the run."""
    from jaxurban.io.workspace import Workspace
    from jaxurban.maps.run import run_scenario

    with reporting("maps") as report:
        run = run_scenario(scenario, folder, report, given["overwrite"], layers=names_in(given["layers"]), **how)
        if given["figures"]:
            from jaxurban.report.figures import save_figures

            report("figures")
            with Workspace.open(folder, "maps --figures", is_shared=True):
                for resolution_m, made in run.maps.items():
                    save_figures(made, (), folder / "figures" / f"{resolution_m:g}m")
    tell_warnings(run.record)
    tell(f"maps finished: {folder} (run.json tells what went in)")
    return run.record
