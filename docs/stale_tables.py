"""Which tables of the docs are older than the code that they measure: listed after each build of the site.

A page names the commit of a table (``commit 54f463f``) and, in a comment after it, the folders whose code decides the
table: ``<!-- measured code: kernels/shadows kernels/lidar -->``. Where a table is kept although that code has changed,
the comment ends in why: ``; kept: its script is in the Git history alone -->``.
"""

import logging
import re
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
MEASURED = re.compile(
    r"commit\s+([0-9a-f]{7,40})\b(?:(?!commit\s+[0-9a-f]{7}).)*?<!-- measured code: ([^;]+?)(?:; kept: (.+?))? -->",
    re.DOTALL,
)


def tables_of(page: str) -> list[tuple[str, list[str], str]]:
    """Return the commit of each table of a page in Markdown, the folders that it measures, and why it is kept."""
    return [(commit, folders.split(), why) for commit, folders, why in MEASURED.findall(page)]


def changes_since(commit: str, folders: list[str], root: Path = ROOT) -> int:
    """Return how many later commits change folders; 0 without git, outside a repository, or if it lacks the commit."""
    command = ["git", "-C", str(root), "rev-list", "--count", f"{commit}..HEAD", "--", *folders]
    try:
        ran = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:
        return 0
    return int(ran.stdout) if ran.returncode == 0 else 0


def stale_tables() -> list[str]:
    """Return a sentence for each table whose code has changed since its commit."""
    return [
        f"{page.relative_to(ROOT)}: the table of commit {commit} is older than {num} commit{'s' * (num != 1)} to "
        f"{', '.join(folders)}: {why or 'measure it again'}"
        for page in sorted((ROOT / "docs").rglob("*.md"))
        for commit, folders, why in tables_of(page.read_text(encoding="utf-8"))
        if (num := changes_since(commit, folders))
    ]


def on_post_build(**_: Any) -> None:
    """List them, as information: a stale table fails no build."""
    for sentence in stale_tables():
        logging.getLogger("mkdocs.hooks").info(sentence)
