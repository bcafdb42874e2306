"""Gives a package index README.md with links that work there: to the repository and tag that pyproject.toml names."""

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PICTURE_OR_LINK = re.compile(r"(!?)(\[[^\]]*\])\((?!https?:|#)([^)]+)\)")


def absolute(link: re.Match[str]) -> str:
    """Return a link or picture of README.md as the index needs it."""
    view = "raw" if link[1] else "blob"
    return f"{link[1]}{link[2]}({PROJECT['urls']['Repository']}/{view}/v{PROJECT['version']}/{link[3]})"


readme = PICTURE_OR_LINK.sub(absolute, (ROOT / "README.md").read_text(encoding="utf-8"))
setup(long_description=readme, long_description_content_type="text/markdown")
