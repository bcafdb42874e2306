"""jaxurban demo."""

from pathlib import Path

import click

from jaxurban.cli.common import DEVICE, JSON_FLAG, PATH, print_json, tell
from jaxurban.progress import reporting


@click.command()
@click.option("-o", "folder", type=PATH, default=Path("out/demo"), show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace maps of other settings in the output folder.")
@DEVICE
@JSON_FLAG
def demo(folder: Path, overwrite: bool, as_json: bool) -> int:
    """Maps of the synthetic city, paths over them, pictures and a summary."""
    from jaxurban.report.demo import run_demo

    with reporting("demo") as report:
        made = run_demo(folder, report, overwrite)
    tell(f"demo finished: read {folder / 'summary.md'}, look at {folder / 'figures'}")
    if as_json:
        print_json(made)
    return 0
