"""jaxurban compare."""

from pathlib import Path
from typing import Any

import click

from jaxurban.cli.common import DEVICE, JSON_FLAG, OBSTACLES, PATH, RESOLUTION, run_study
from jaxurban.progress import Report


@click.command()
@click.argument("folder_a", metavar="DIR_A", type=PATH)
@click.argument("folder_b", metavar="DIR_B", type=PATH)
@click.option("-o", "output", type=PATH, required=True, help="Output folder.")
@RESOLUTION
@OBSTACLES
@click.option(
    "--tolerance", type=float, default=1e-6, show_default=True, help="Values that differ by no more are the same."
)
@click.option("--overwrite", is_flag=True, help="Replace another comparison in the output folder.")
@DEVICE
@JSON_FLAG
def compare(folder_a: Path, folder_b: Path, output: Path, **given: Any) -> int:
    """Report how the maps in DIR_B differ from those in DIR_A: by layer, altitude and time."""
    from jaxurban.io.tables import records_of
    from jaxurban.paths.rows import MapsFolder
    from jaxurban.studies.map_comparison import MapComparison
    from jaxurban.studies.map_comparison import compare as compare_maps

    sides = [MapsFolder(folder, given["resolution_m"], given["obstacles"]) for folder in (folder_a, folder_b)]

    def study(report: Report) -> MapComparison:
        return compare_maps(*sides, tolerance=given["tolerance"], progress=report)

    def facts(found: MapComparison) -> dict[str, Any]:
        return {"left_out": dict(found.left_out), "settings": found.settings, "layers": records_of(found.table)}

    return run_study("compare", output, study, facts, given)
