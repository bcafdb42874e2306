"""Tables of the docs that are older than their code: found by git, and no reason for a build to fail."""

import importlib.util
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted(page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md"))
PAST_SCRIPT = re.compile(r"`((?:benchmarks|figures/paper)/\w+\.py)`\s+of commit ([0-9a-f]{7,40})")
SPEC = importlib.util.spec_from_file_location("stale_tables", ROOT / "docs" / "stale_tables.py")
stale_tables = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(stale_tables)


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    return subprocess.run(["git", *who, *arguments], cwd=folder, check=True, capture_output=True, text=True).stdout


def test_a_table_goes_by_the_last_commit_named_before_its_code():
    page = "commit 1111111 ... at commit 2222222.\n<!-- measured code: a b/c -->\ncommit 3333333\n| table without |\n"
    assert stale_tables.tables_of(page) == [("2222222", ["a", "b/c"])]


def test_commits_that_change_the_code_make_a_table_stale_and_others_do_not(tmp_path):
    git(tmp_path, "init", "-q")
    commits = []
    for name in ("kernels/a.py", "docs/b.md", "kernels/c.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1")
        git(tmp_path, "add", "-A")
        git(tmp_path, "commit", "-qm", name)
        commits.append(git(tmp_path, "rev-parse", "--short=7", "HEAD").strip())
    assert [stale_tables.changes_since(commit, ["kernels"], tmp_path) for commit in commits] == [1, 1, 0]
    assert stale_tables.changes_since("0000000", ["kernels"], tmp_path) == 0


@pytest.mark.parametrize(("num", "said"), [(1, "1 commit to kernels, planners"), (2, "2 commits to kernels, planners")])
def test_a_stale_table_is_listed_with_how_many_commits_are_later(num, said, monkeypatch, tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("commit 1111111\n<!-- measured code: kernels planners -->\n")
    monkeypatch.setattr(stale_tables, "ROOT", tmp_path)
    monkeypatch.setattr(stale_tables, "changes_since", lambda commit, folders: num)
    assert stale_tables.stale_tables() == [f"docs/page.md: the table of commit 1111111 is older than {said}"]


def test_without_a_repository_or_without_git_no_table_is_stale(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert stale_tables.changes_since("54f463f", ["kernels"], tmp_path) == 0
    monkeypatch.setenv("PATH", "")
    assert stale_tables.changes_since("54f463f", ["kernels"]) == 0


@pytest.mark.parametrize("page", PAGES)
def test_every_page_names_code_that_exists(page):
    for _, folders in stale_tables.tables_of((ROOT / page).read_text(encoding="utf-8")):
        assert [folder for folder in folders if not (ROOT / folder).exists()] == []


def test_the_history_holds_every_script_that_a_page_names_with_its_commit():
    asked = ["git", "-C", str(ROOT), "rev-parse", "--is-shallow-repository"]
    if subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() != "false":
        pytest.skip("no repository with its whole history")
    named = {match for page in PAGES for match in PAST_SCRIPT.findall((ROOT / page).read_text(encoding="utf-8"))}
    assert named
    for script, commit in named:
        git(ROOT, "cat-file", "-e", f"{commit}:{script}")
