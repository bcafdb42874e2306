"""What pyproject.toml cannot say: the README of a package index, and an sdist whose bytes depend on its files alone.

Links of README.md lead to the repository and tag that pyproject.toml names.
"""

import gzip
import os
import re
import tarfile
import time
import tomllib
from pathlib import Path

from setuptools import setup
from setuptools.command.sdist import sdist

ROOT = Path(__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PICTURE_OR_LINK = re.compile(r"(!?)(\[[^\]]*\])\((?!https?:|#)([^)]+)\)")


def absolute(link: re.Match[str]) -> str:
    """Return a link or picture of README.md as the index needs it."""
    view = "raw" if link[1] else "blob"
    return f"{link[1]}{link[2]}({PROJECT['urls']['Repository']}/{view}/v{PROJECT['version']}/{link[3]})"


class SameBytes(sdist):
    """An sdist that is the same wherever it is made: setuptools keeps times, owners, modes and links of the machine."""

    def make_archive(
        self, base_name: str, format: str, *_: object, base_dir: str, **__: object
    ) -> str:
        """Pack a folder, as of ``SOURCE_DATE_EPOCH``, and return the archive's name."""
        made_s = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))

        def anonymous(item: tarfile.TarInfo) -> tarfile.TarInfo:
            item.mtime, item.uid, item.gid, item.uname, item.gname = made_s, 0, 0, "", ""
            item.mode = 0o755 if item.isdir() or item.mode & 0o100 else 0o644
            return item

        name = f"{base_name}.tar.gz"  # the only format of PEP 625
        with (
            open(name, "wb") as file,
            gzip.GzipFile("", "wb", fileobj=file, mtime=made_s) as packed,
            tarfile.open(fileobj=packed, mode="w", dereference=True) as archive,
        ):
            archive.add(base_dir, filter=anonymous)
        return name


readme = PICTURE_OR_LINK.sub(absolute, (ROOT / "README.md").read_text(encoding="utf-8"))
setup(
    long_description=readme,
    long_description_content_type="text/markdown",
    cmdclass={"sdist": SameBytes},
)
