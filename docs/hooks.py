"""What MkDocs takes from the package and the repository when it builds the site: figures, MathML, the reference."""

import re
from pathlib import Path
from typing import Any

import click
import nbformat
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

import jaxurban
from jaxurban.cli.main import app

ROOT = Path(__file__).parents[1]
TABLE_LINK = re.compile(
    r"^\[[^\]]+\]\((?:\.\./)+(figures/\S+\.md)\)$", re.MULTILINE
)  # alone on its line
FIGURE_LINK = re.compile(r"\]\(((?:\.\./)*)\.\./figures/")  # as files of the repository see it
RAN = ROOT / "out" / "notebooks"
WIDGET = "application/vnd.jupyter.widget-view+json"
STYLE = re.compile(r"<style scoped>.*?</style>\n", re.DOTALL)  # of pandas' tables
LISTING = re.compile(r"^<!-- (commands|public names): all -->$", re.MULTILINE)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Return the configuration with a fence for mathematics."""
    fence = {"name": "math", "class": "math", "format": mathml}
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [fence]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the site's files with the pictures of figures/, which lies beside docs/, and the notebooks as they ran."""
    for picture in sorted((ROOT / "figures").rglob("*.png")):
        name = picture.relative_to(ROOT).as_posix()
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    for source in sorted((ROOT / "notebooks").glob("[0-9]*.py")):
        ran = RAN / f"{source.stem}.ipynb"
        if not ran.exists():
            raise FileNotFoundError(
                f"{ran.relative_to(ROOT)} is not there: make notebooks runs the notebooks"
            )
        resources = {"output_files_dir": f"{source.stem}_files"}
        page, made = MarkdownExporter().from_notebook_node(
            _without_widgets(nbformat.read(ran, 4)), resources
        )
        files.append(
            File.generated(config, f"notebooks/{source.stem}.md", content=_told(page, source))
        )
        for name, picture in made["outputs"].items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with its tables and listings written out, and with links to figures as the site has them."""
    markdown = TABLE_LINK.sub(lambda found: (ROOT / found[1]).read_text(encoding="utf-8"), markdown)
    return LISTING.sub(_listing, FIGURE_LINK.sub(r"](\1figures/", markdown))


def _without_widgets(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a notebook whose widgets, which need a running kernel, are replaced by words."""
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if WIDGET in output.get("data", {}):
                output.data = {"text/plain": "(The viewer: it works in a running notebook.)"}
    return notebook


def _told(page: str, source: Path) -> str:
    """Return the page of a notebook with where it comes from, and its tables without their styles."""
    page = STYLE.sub("", page).replace("](../docs/", "](../")  # as the site has them
    title, rest = page.lstrip().split("\n", 1)
    made = f"out/notebooks/{source.stem}.ipynb"
    note = f"*Made by running `notebooks/{source.name}`; `make notebooks` leaves it as `{made}`.*"
    return f"{title}\n\n{note}\n{rest}"


def mathml(source: str, *_: Any, **__: Any) -> str:
    """Return LaTeX as MathML, which browsers draw by themselves: no script, no font and no server."""
    return convert(source, display="block")


def _listing(found: re.Match[str]) -> str:
    if found[1] == "commands":
        return "\n\n".join(
            f"## jaxurban {name}\n\n```text\n{_help(name)}\n```" for name in sorted(app.commands)
        )
    return "\n\n".join(f"::: jaxurban.{name}" for name in dir(jaxurban))


def _help(name: str) -> str:
    context = click.Context(app.commands[name], info_name=f"jaxurban {name}", max_content_width=100)
    return app.commands[name].get_help(context)
