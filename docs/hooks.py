"""What MkDocs takes from the package and the repository when it builds the site: figures, MathML, the reference."""

import inspect
import re
from operator import attrgetter
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
# Of the machine that ran a notebook; bounded, as a search for any length takes hours over a picture's text.
KERNEL_FILE = re.compile(r"/[\w/.-]{0,100}?(?:ipykernel_\d+/\d+\.py:\d+: |(?=my-town-\w))")
STYLE = re.compile(r"<style scoped>.*?</style>\n", re.DOTALL)  # of pandas' tables
COMMANDS = "<!-- commands: all -->"
NAMES_PAGE = "reference/api.md"
NAMES_HEAD = "| for | names |\n|---|---|\n"
NAMES_ROW = re.compile(r"^\| ([^|`]+) \| ((?:`[\w.]+` )+)\|$", re.MULTILINE)  # what for, names
# How much higher than others a search ranks the pages of zones and of options, and a name that begins other names.
BOOST = 3
FIRST_FOUND = "guides/plan.md", "reference/commands.md"
NAME_PAGE = """---
title: {title}
search:
  boost: {boost}
---

::: jaxurban.{name}
    options:
      heading_level: 1

*The example starts from [the names of all examples]({index}#examples), such as `maps`. [All public names]({index}).*
"""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Return the configuration with the version, a fence for mathematics and the pages of public names in its menu."""
    config.site_name += f" {jaxurban.__version__}"
    fence = {"name": "math", "class": "math", "format": mathml}
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [fence]
    (reference,) = (each["Reference"] for each in config.nav if "Reference" in each)
    python = next(each for each in reference if "Python" in each)
    python["Python"] = [{"All names": NAMES_PAGE}]
    for purpose, names in public_names():
        python["Python"].append({purpose: [page_of(name) for name in names]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the site's files with the pictures of figures/, the notebooks as they ran, and a page per public name."""
    all_names = [name for _, names in public_names() for name in names]
    lasts = [name.rpartition(".")[2].lower() for name in all_names]
    for name, last in zip(all_names, lasts, strict=True):
        # A search for "plan" also finds PlannedPath and plan_many: the name itself comes first.
        begins_another = any(other != last and other.startswith(last) for other in lasts)
        is_class = page_of(name).startswith("reference/classes/")
        boost = BOOST if begins_another and not is_class else 1
        title, index = f"ju.{name}", "../api.md"
        page = NAME_PAGE.format(title=title, index=index, name=name, boost=boost)
        files.append(File.generated(config, page_of(name), content=page))
    for picture in sorted((ROOT / "figures").rglob("*.png")):
        name = picture.relative_to(ROOT).as_posix()
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    for source in sorted((ROOT / "notebooks").glob("[0-9]*.py")):
        ran = RAN / f"{source.stem}.ipynb"
        if not ran.exists():
            raise FileNotFoundError(
                f"{ran.relative_to(ROOT)} is not there: make notebooks runs the notebooks"
            )
        notebook = KERNEL_FILE.sub("", ran.read_text(encoding="utf-8"))
        resources = {"output_files_dir": f"{source.stem}_files"}
        page, made = MarkdownExporter().from_notebook_node(
            _without_widgets(nbformat.reads(notebook, 4)), resources
        )
        files.append(
            File.generated(config, f"notebooks/{source.stem}.md", content=_introduced(page, source))
        )
        files.append(File.generated(config, f"notebooks/{source.stem}.ipynb", content=notebook))
        for name, picture in made["outputs"].items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with its tables and listings written out, and with links to figures as the site has them."""
    markdown = TABLE_LINK.sub(lambda found: (ROOT / found[1]).read_text(encoding="utf-8"), markdown)
    if page.file.src_uri in FIRST_FOUND:
        page.meta["search"] = {"boost": BOOST}
    if page.file.src_uri == NAMES_PAGE:
        markdown = NAMES_ROW.sub(_described, markdown.replace(NAMES_HEAD, ""))
    return FIGURE_LINK.sub(r"](\1figures/", markdown.replace(COMMANDS, _commands()))


def public_names() -> list[tuple[str, list[str]]]:
    """Return the public names as the reference groups them: what each group is for, and its names."""
    page = (ROOT / "docs" / NAMES_PAGE).read_text(encoding="utf-8")
    rows = NAMES_ROW.findall(page)
    return [(_capital(purpose), re.findall(r"`(.+?)`", names)) for purpose, names in rows]


def page_of(name: str) -> str:
    """Return the path of the page of a public name. Classes have a folder of their own: `Study` beside `study`."""
    folder = "classes" if inspect.isclass(attrgetter(name)(jaxurban)) else "functions"
    return f"reference/{folder}/{name}.md"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _described(row: re.Match[str]) -> str:
    """Return a section with a line for each name of a row. Its anchors are those that the names had on one page."""
    lines = [f"### {_capital(row[1])}", "", "| name | what it is |", "|---|---|"]
    for name in re.findall(r"`(.+?)`", row[2]):
        docstring = inspect.getdoc(attrgetter(name)(jaxurban)) or ""
        first = " ".join(docstring.split("\n\n")[0].split()).removeprefix("Return ")
        text = _capital(first).replace("``", "`").replace("|", "\\|")
        page = page_of(name).removeprefix("reference/")
        lines.append(f"| [`{name}`]({page}){{ #jaxurban.{name} }} | {text} |")
    return "\n".join([*lines, ""])


def _without_widgets(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a notebook whose widgets, which need a running kernel, are replaced by words."""
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if WIDGET in output.get("data", {}):
                output.data = {"text/plain": "(The viewer: it works in a running notebook.)"}
    return notebook


def _introduced(page: str, source: Path) -> str:
    """Return the page of a notebook with where to get it, and its tables without their styles."""
    page = STYLE.sub("", page).replace("](../docs/", "](../")  # as the site has them
    title, rest = page.lstrip().split("\n", 1)
    note = (
        f"*[Download this notebook with its output]({source.stem}.ipynb){{ download }} and open it in Jupyter, or "
        f"read on. It was made by running `notebooks/{source.name}`.*"
    )
    return f"{title}\n\n{note}\n{rest}"


def mathml(source: str, *_: Any, **__: Any) -> str:
    """Return LaTeX as MathML, which browsers draw by themselves: no script, no font and no server."""
    return convert(source, display="block")


def _commands() -> str:
    return "\n\n".join(
        f"## jaxurban {name}\n\n```text\n{_help(name)}\n```" for name in sorted(app.commands)
    )


def _help(name: str) -> str:
    context = click.Context(app.commands[name], info_name=f"jaxurban {name}", max_content_width=100)
    return app.commands[name].get_help(context)
