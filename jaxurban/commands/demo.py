"""jaxurban demo."""

from pathlib import Path

import click

from jaxurban.commands.common import JSON_FLAG, print_json, stages, tell


@click.command()
@click.option("-o", "folder", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace maps of other settings in the output folder.")
@JSON_FLAG
def demo(folder: Path, overwrite: bool, as_json: bool) -> int:
    """Maps of the embedded city, paths over them, pictures and a summary."""
    from jaxurban.showcase import run_demo

    with stages("demo") as on_stage:
        made = run_demo(folder, on_stage=on_stage, overwrite=overwrite)
    tell(f"demo finished: read {folder / 'summary.md'}, look at {folder / 'figures'}")
    if as_json:
        print_json(made)
    return 0
