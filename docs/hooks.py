"""What MkDocs takes from the package and the repository when it builds the site: figures, MathML, the reference."""

import re
from pathlib import Path
from typing import Any

import click
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import jaxurban
from jaxurban.cli.main import app

ROOT = Path(__file__).parents[1]
TABLE_LINK = re.compile(r"^\[[^\]]+\]\((?:\.\./)+(figures/\S+\.md)\)$", re.MULTILINE)  # alone on its line
FIGURE_LINK = re.compile(r"\]\(((?:\.\./)*)\.\./figures/")  # as files of the repository see it
LISTING = re.compile(r"^<!-- (commands|public names|modules): ?(.*) -->$", re.MULTILINE)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Return the configuration with a fence for mathematics."""
    fence = {"name": "math", "class": "math", "format": mathml}
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [fence]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Return the site's files with the pictures of figures/, which lies beside docs/."""
    for picture in sorted((ROOT / "figures").rglob("*.png")):
        name = picture.relative_to(ROOT).as_posix()
        files.append(File.generated(config, name, abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with its tables and listings written out, and with links to figures as the site has them."""
    markdown = TABLE_LINK.sub(lambda found: (ROOT / found[1]).read_text(encoding="utf-8"), markdown)
    return LISTING.sub(_listing, FIGURE_LINK.sub(r"](\1figures/", markdown))


def mathml(source: str, *_: Any, **__: Any) -> str:
    """Return LaTeX as MathML, which browsers draw by themselves: no script, no font and no server."""
    return convert(source, display="block")


def _listing(found: re.Match[str]) -> str:
    kind, argument = found.groups()
    if kind == "commands":
        return "\n\n".join(f"## jaxurban {name}\n\n```text\n{_help(name)}\n```" for name in sorted(app.commands))
    if kind == "public names":
        return "\n\n".join(f"::: jaxurban.{name}" for name in dir(jaxurban))
    return "\n\n".join(f"::: {module}" for pattern in argument.split() for module in _modules(pattern))


def _modules(pattern: str) -> list[str]:
    """Return the modules that a pattern such as ``jaxurban/io/*.py`` names, by their full names."""
    files = sorted(path.relative_to(ROOT) for path in ROOT.glob(pattern) if not path.stem.startswith("__"))
    if not files:
        raise FileNotFoundError(f"a listing in docs/reference names {pattern!r}, and no such module is there")
    return [".".join(path.with_suffix("").parts) for path in files]


def _help(name: str) -> str:
    context = click.Context(app.commands[name], info_name=f"jaxurban {name}", max_content_width=100)
    return app.commands[name].get_help(context)
