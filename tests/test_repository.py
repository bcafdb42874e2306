"""The repository's own rules: which tests run, which names sources may use and define, which tables of docs are old."""

import ast
import importlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import defaultdict
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from benchmarks import structure
from jaxurban.maps.citation import PAPER, SOFTWARE

ROOT = Path(__file__).parents[1]
OPTIONS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]


def pytest_arguments(target: str) -> str:
    """Return what a target of the Makefile passes to pytest."""
    recipe = re.search(
        rf"^{target}:[^\n]*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE
    )
    assert recipe
    return recipe[1].replace("\\\n", " ").split("-m pytest", 1)[1].strip()


def test_the_marker_slow_alone_parts_the_tests_that_make_test_runs_from_those_of_make_test_slow():
    assert "-m 'not slow and not gpu'" in OPTIONS["addopts"]
    assert {marker.split(":")[0] for marker in OPTIONS["markers"]} == {"slow", "gpu", "data"}
    assert pytest_arguments("test") == "-n 2 --dist loadfile"
    assert pytest_arguments("test-newest") == "-n 2 --dist loadfile --every $(EVERY); fi"
    assert pytest_arguments("test-slow") == "-n 2 --dist loadfile -m slow"


def test_the_checks_before_a_landing_run_both():
    called = re.findall(r"^make (\S+)$", (ROOT / ".ci/run").read_text(), re.MULTILINE)
    assert {"test", "test-slow"} <= set(called)


def test_no_test_is_where_pytest_does_not_look():
    known = ("tests", "build", "out")
    others = [
        path for path in ROOT.iterdir() if not path.match(".venv*") and path.name not in known
    ]
    assert OPTIONS["testpaths"] == ["tests"]
    assert [
        file for path in others for file in (path, *path.rglob("*")) if file.match("test_*.py")
    ] == []
    names = [
        path
        for path in (ROOT / "tests").rglob("*.py")
        if "\ndef test_" in path.read_text(encoding="utf-8")
    ]
    assert [path.name for path in names if not path.name.startswith("test_")] == []


def test_every_test_that_the_page_on_validation_names_is_there():
    named = re.findall(
        r"`(\S*test_\w+\.py)`", (ROOT / "docs/evidence/validation.md").read_text(encoding="utf-8")
    )
    assert named
    assert [name for name in named if not (ROOT / "tests" / name).is_file()] == []


PRIVATE = {
    "numba.jit(f)._cache = 3": "Private member accessed",
    "import jax\njax._src.core.f()": "Private member accessed",
    "from rasterio._err import CPLE_BaseError": "Private name import",
    "from numba.core import types": "is banned",
    "import numba\nnumba.core.types": "is banned",
}


@pytest.mark.parametrize(("source", "said"), PRIVATE.items())
def test_the_linter_refuses_a_private_name_of_a_library(source, said):
    for folder, is_refused in (
        ("jaxurban", True),
        ("planners", True),
        ("tests", said == "is banned"),
    ):
        command = [sys.executable, "-m", "ruff", "check", "--stdin-filename", f"{folder}/a.py", "-"]
        ended = subprocess.run(
            command, cwd=ROOT, input=source, capture_output=True, text=True, check=False
        )
        assert (said in ended.stdout) is is_refused


def test_no_source_imports_a_private_module_or_names_a_private_attribute_in_quotes():
    """What the linter does not see."""
    pattern = re.compile(r"^import \S*\b_[a-z]|attr\(.*, [\"']_[a-z]", re.MULTILINE)
    assert pattern.search("import jax._src.core as core")
    assert pattern.search("getattr(multiprocessing.current_process(), '_inheriting', False)")
    files = [
        path
        for folder in ("jaxurban", "kernels", "planners")
        for path in (ROOT / folder).rglob("*.py")
    ]
    assert [path.name for path in files if pattern.search(path.read_text(encoding="utf-8"))] == []


def names_defined(source: str) -> set[str]:
    """Return the classes and public functions that a source defines, but not within a class or a function."""
    kinds = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    names = set()
    blocks: list[ast.AST] = [ast.parse(source)]
    while blocks:
        for node in ast.iter_child_nodes(blocks.pop()):
            if not isinstance(node, kinds):
                blocks.append(node)
            elif not node.name.startswith("_"):
                names.add(node.name)
    return names


def test_classes_and_public_functions_are_counted_wherever_a_module_defines_them():
    source = """
class A:
    def method(self): ...

@wraps(print)
def f():
    def inner(): ...

try:
    async def g(): ...
except ImportError:
    def h(): ...

def _private(): ...
variable = lambda: 0
"""
    assert names_defined(source) == {"A", "f", "g", "h"}


def test_the_name_of_a_class_or_public_function_stands_in_one_module():
    """None is excepted: a command, which bears the name of the function that it calls, is named ``NAME_command``."""
    modules = defaultdict(list)
    for folder in ("jaxurban", "kernels", "planners"):
        for path in (ROOT / folder).rglob("*.py"):
            for name in names_defined(path.read_text(encoding="utf-8")):
                modules[name].append(path.relative_to(ROOT).as_posix())
    assert {"Grid", "plan", "Path"} <= modules.keys()
    assert {name: files for name, files in modules.items() if len(files) > 1} == {}


def test_warnings_go_by_the_one_function_that_finds_the_line_of_the_user():
    files = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / "jaxurban").rglob("*.py")}
    assert {
        name for name, path in files.items() if "warnings.warn(" in path.read_text(encoding="utf-8")
    } == {"jaxurban/errors.py"}


PAGES = sorted(page.relative_to(ROOT).as_posix() for page in (ROOT / "docs").rglob("*.md"))
PAST_SCRIPT = re.compile(r"`((?:benchmarks|figures/paper)/\w+\.py)`\s+of commit ([0-9a-f]{7,40})")
SPEC = importlib.util.spec_from_file_location("stale_tables", ROOT / "docs" / "stale_tables.py")
stale_tables = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(stale_tables)


def git(folder: Path, *arguments: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    return subprocess.run(
        ["git", *who, *arguments], cwd=folder, check=True, capture_output=True, text=True
    ).stdout


def test_a_table_goes_by_the_last_commit_named_before_its_code():
    page = "commit 1111111 ... at commit\n2222222.\n<!-- measured code: a b/c -->\ncommit 3333333\n| table without |\n"
    assert stale_tables.tables_of(page) == [("2222222", ["a", "b/c"], "")]
    kept = page.replace(" -->", "; kept: no script -->")
    assert stale_tables.tables_of(kept) == [("2222222", ["a", "b/c"], "no script")]


def test_commits_that_change_the_code_make_a_table_stale_and_others_do_not(tmp_path):
    git(tmp_path, "init", "-q")
    commits = []
    for name in ("kernels/a.py", "docs/b.md", "kernels/c.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("1")
        git(tmp_path, "add", "-A")
        git(tmp_path, "commit", "-qm", name)
        commits.append(git(tmp_path, "rev-parse", "--short=7", "HEAD").strip())
    assert [stale_tables.changes_since(commit, ["kernels"], tmp_path) for commit in commits] == [
        1,
        1,
        0,
    ]
    assert stale_tables.changes_since("0000000", ["kernels"], tmp_path) == 0


@pytest.mark.parametrize(
    ("num", "kept", "said"),
    [
        (1, "", "1 commit to kernels, planners: measure it again"),
        (2, "; kept: no script", "2 commits to kernels, planners: no script"),
    ],
)
def test_a_stale_table_is_listed_with_how_many_commits_are_later_and_why_it_is_kept(
    num, kept, said, monkeypatch, tmp_path
):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text(
        f"commit 1111111\n<!-- measured code: kernels planners{kept} -->\n"
    )
    monkeypatch.setattr(stale_tables, "ROOT", tmp_path)
    monkeypatch.setattr(stale_tables, "changes_since", lambda commit, folders: num)
    assert stale_tables.stale_tables() == [
        f"docs/page.md: the table of commit 1111111 is older than {said}"
    ]


def test_without_a_repository_or_without_git_no_table_is_stale(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert stale_tables.changes_since("54f463f", ["kernels"], tmp_path) == 0
    monkeypatch.setenv("PATH", "")
    assert stale_tables.changes_since("54f463f", ["kernels"]) == 0


@pytest.mark.parametrize("page", PAGES)
def test_every_page_names_code_that_exists(page):
    for _, folders, _ in stale_tables.tables_of((ROOT / page).read_text(encoding="utf-8")):
        assert [folder for folder in folders if not (ROOT / folder).exists()] == []


def test_the_history_holds_every_script_that_a_page_names_with_its_commit():
    asked = ["git", "-C", str(ROOT), "rev-parse", "--is-shallow-repository"]
    if subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() != "false":
        pytest.skip("no repository with its whole history")
    named = {
        match
        for page in PAGES
        for match in PAST_SCRIPT.findall((ROOT / page).read_text(encoding="utf-8"))
    }
    assert named
    for script, commit in named:
        git(ROOT, "cat-file", "-e", f"{commit}:{script}")


def test_the_core_reaches_the_wings_by_its_door_alone():
    stub = (ROOT / "jaxurban" / "wings.pyi").read_text(encoding="utf-8")
    homes = re.findall(r"^from jaxurban\.(\w+)\S* import (\w+) as \2$", stub, re.MULTILINE)
    assert len(homes) == len(stub.splitlines())
    assert {wing for wing, _ in homes} == {"cities", "flights"}


def test_the_page_on_developing_counts_the_code_as_it_is():
    counted: dict[str, list[int]] = {}
    parts: dict[str, list[int]] = {}
    for file in structure.files_of(ROOT, structure.SOURCES, ".py"):
        parent = file.relative_to(ROOT).parent.as_posix()
        folder = "/".join(parent.split("/")[:2])
        tokens = structure.code_lines_and_tokens(file.read_text(encoding="utf-8"))[1]
        counted.setdefault(folder, []).append(tokens)
        part = structure.part_of(file.relative_to(ROOT).as_posix())
        parts.setdefault(part, []).append(tokens)
    counted["in all"] = [tokens for folder in counted.values() for tokens in folder]
    counted |= parts
    page = (ROOT / "docs" / "developing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `?([\w/ ]+?)/?`? \| (\d+) \| ([\d,]+) \|$", page, re.MULTILINE)
    assert {folder for folder, _, _ in rows} == set(counted)
    for folder, num_files, written in rows:
        tokens = sum(counted[folder])
        assert int(num_files) == len(counted[folder]), folder
        assert int(written.replace(",", "")) == pytest.approx(tokens, rel=0.02, abs=100), folder


WORKFLOWS = {
    path.name: path.read_text(encoding="utf-8")
    for path in (ROOT / ".github/workflows").glob("*.yml")
}


def test_workflows_call_targets_that_the_makefile_has():
    targets = re.findall(
        r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    called = {
        target for text in WORKFLOWS.values() for target in re.findall(r"\bmake ([a-z-]+)", text)
    }
    tests = {"test", "test-oldest", "test-newest", "test-slow"}
    checks = {"lint", "wheel", "docs", "figures-small", "cuda-compile"}
    assert tests | checks <= called <= set(targets)


def test_workflows_begin_at_the_oldest_python_that_is_allowed():
    floor = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "requires-python"
    ]
    pythons = re.findall(r'"(3\.\d+)"', re.search(r"python: \[(.*)\]", WORKFLOWS["tests.yml"])[1])
    assert floor == f">={pythons[0]}"
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "classifiers"
    ]
    assert pythons == [
        each.rpartition(" ")[2] for each in classifiers if re.search(r":: 3\.\d+$", each)
    ]


def test_whatever_names_the_version_names_that_of_the_package():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "version"
    ]
    for name in ("CITATION.cff", "benchmarks/board.cff"):
        assert f"\nversion: {version}\n" in (ROOT / name).read_text(encoding="utf-8")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    (author,), (paper,) = citation["authors"], citation["references"]
    assert f"{author['name']}: {citation['title']}" == SOFTWARE
    names = ", ".join(f"{each['given-names']} {each['family-names']}" for each in paper["authors"])
    (doi,) = paper["identifiers"]
    assert f"{names}: {paper['title']}, https://doi.org/{doi['value']}" == PAPER
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    sections = [
        section for section in changes.split("\n## ")[1:] if not section.startswith("Unreleased\n")
    ]
    assert sections[0].split()[0] == version
    assert len(sections[0].splitlines()) <= 60


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no repository")
def test_the_owner_stands_in_pyproject_alone():
    listed = git(ROOT, "grep", "-lIE", r"OWNER\b|github\.com/jaxurban|jaxurban\.github").split()
    assert set(listed) <= {
        "pyproject.toml",
        "CONTRIBUTING.md",
        "Makefile",
        "tests/test_repository.py",
    }


LEFT = {
    "pyproject.toml": 'Repository = "https://github.com/OWNER/jaxurban"',
    "CITATION.cff": "url: https://OWNER.github.io/jaxurban",
    "GOVERNANCE.md": "[PLACEHOLDER: names]",
    "CHANGELOG.md": "## 1.0.0 (unreleased)",
    "NEWS.md": "## Unreleased",
}


@pytest.mark.parametrize(("name", "left"), LEFT.items())
def test_a_release_stops_while_something_is_to_be_filled_in(name, left, tmp_path):
    git(tmp_path, "init", "-q")
    (tmp_path / "README.md").write_text("An owner, a placeholder and what is released.\n")

    def ended() -> subprocess.CompletedProcess[str]:
        git(tmp_path, "add", "-A")
        command = ["make", "-s", "-f", ROOT / "Makefile", "placeholders"]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)

    assert (ended().returncode, ended().stdout) == (0, "")
    (tmp_path / name).write_text(f"{left}\n")
    assert (ended().returncode, ended().stdout) == (2, f"{name}:1:{left}\n")


def test_the_release_asks_for_that_before_it_builds():
    steps = re.findall(r"run: (.+)", WORKFLOWS["release.yml"])
    assert steps.index("make placeholders") < steps.index("make wheel PYTHON=python")


@pytest.mark.slow
@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no repository")
def test_an_sdist_has_the_same_bytes_wherever_and_whenever_it_is_made(tmp_path):
    files = git(ROOT, "ls-files").splitlines()
    packed = []
    for copy, (umask, changed_s) in {"first": (0o022, 1.5e9), "second": (0o002, 1.6e9)}.items():
        before = os.umask(umask)
        try:
            for name in files:
                file = tmp_path / copy / name
                file.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(ROOT / name, file, follow_symlinks=False)
                os.utime(file, (changed_s, changed_s), follow_symlinks=False)
            build = "from setuptools import build_meta; build_meta.build_sdist('out')"
            env = {**os.environ, "SOURCE_DATE_EPOCH": "1700000000"}
            subprocess.run(
                [sys.executable, "-c", build],
                cwd=tmp_path / copy,
                env=env,
                check=True,
                capture_output=True,
            )
        finally:
            os.umask(before)
        (archive,) = (tmp_path / copy / "out").iterdir()
        packed.append(archive.read_bytes())
    assert packed[0] == packed[1]


CONDA_NAMES = {
    "dask": "dask-core",
    "geopandas": "geopandas-base",
    "matplotlib": "matplotlib-base",
    "osmium": "pyosmium",
}


def test_the_recipe_asks_for_what_pyproject_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (ROOT / "conda-recipe/recipe.yaml").read_text(encoding="utf-8")
    asked = [each.split(">=") for each in project["dependencies"]]
    named = [f"{CONDA_NAMES.get(name, name)} >={floor}" for name, floor in asked]
    lines = recipe.split("  run:\n")[1].split("tests:")[0]
    assert re.findall(r"- (.*)", lines) == [f"python {project['requires-python']}", *named]
    assert f'version: "{project["version"]}"' in recipe


def test_scripts_beside_the_package_import_names_that_it_has():
    """Most pictures of the paper and most benchmarks are not drawn or run before a change lands."""
    missing = []
    for folder in ("benchmarks", "figures", "notebooks", "docs"):
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxurban"):
                    module = importlib.import_module(str(node.module))
                    names = [alias.name for alias in node.names]
                    missing += [
                        (file.name, module.__name__, name)
                        for name in names
                        if not hasattr(module, name)
                        and find_spec(f"{module.__name__}.{name}") is None
                    ]
    assert missing == []
