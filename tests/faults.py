"""Small faults, to count how many of them the tests notice: ``python -m tests.faults draw`` and ``run``.

``run`` makes those of ``tests/faults.jsonl`` one by one in a copy of the tree and runs a command there: ``run 3 17 --
python -m pytest -x tests/io``; without numbers all. One is noticed where the command ends with other than 0; kernels
are compiled anew in the copy. ``run --reaching 3`` appends the test files that reach a fault's module within three
imports, nearest first, and says which test noticed it if that test passes without the fault. ``--tests FOLDER`` takes
the tests of another tree. ``draw`` replaces faults whose line is gone by others of their kind and folder (signs,
comparisons, off by one, units), chosen by a seed.
"""

import argparse
import io
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEPT = Path(__file__).with_name("faults.jsonl")
NOT_COPIED = (".git", ".venv*", "out", "build", ".*_cache", ".hypothesis", "*.egg-info")
OPERATORS = {"+": "-", "-": "+", "<": "<=", "<=": "<", ">": "<", ">=": ">", "==": "!="}
ANGLES = {"radians": "degrees", "degrees": "radians", "deg2rad": "rad2deg", "rad2deg": "deg2rad"}
NO_UNITS = (0.0, 0.5, 1.0, 2.0)
NO_FAULT = re.compile(
    r"^(def|class|from|import|raise|assert|@)\b|[\"']|perf_counter|->"
)  # texts and types, mostly
PYTEST = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not gpu"]
LONGEST_S = 2 * 3600.0  # of a command; a fault may go round for ever
PUBLIC = re.compile(r"^from (jaxurban\.[\w.]+) import (\w+) as", re.MULTILINE)  # in a stub
IMPORT = re.compile(r"^ *(?:from ([\w.]+) )?import (\([^)]*\)|.*)", re.MULTILINE)
Fault = dict[str, str]


def changed(word: str) -> tuple[str, str]:
    """Return what is put in the place of a word of Python, and the kind of the fault; no kind where there is none."""
    if word in OPERATORS:
        return OPERATORS[word], "sign" if word in "+-" else "comparison"
    if word.isdecimal():
        return str(int(word) + 1), "off by one"
    if word in ANGLES or (re.fullmatch(r"\d+\.\d+", word) and float(word) not in NO_UNITS):
        return ANGLES.get(word) or f"{1000 * float(word):g}", "unit"
    return word, ""


def faults_of(file: str) -> Iterator[Fault]:
    """Yield every fault that can be made in a file, in a line that it holds once."""
    text = (ROOT / file).read_text(encoding="utf-8")
    lines = [line.strip() for line in text.splitlines()]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        line, (instead, kind) = token.line.strip(), changed(token.string)
        if kind and lines.count(line) == 1 and not NO_FAULT.search(line):
            made = token.line[: token.start[1]] + instead + token.line[token.end[1] :]
            yield {"file": file, "line": line, "instead": made.strip(), "kind": kind}


def with_fault(text: str, fault: Fault) -> str | None:
    """Return the text of a file with a fault made; None where its line is gone, or no longer there once."""
    lines = text.splitlines(keepends=True)
    at = [k for k, line in enumerate(lines) if line.strip() == fault["line"]]
    if len(at) != 1:
        return None
    lines[at[0]] = lines[at[0]].replace(fault["line"], fault["instead"])
    return "".join(lines)


def faulty(fault: Fault) -> str | None:
    """Return the text of a fault's file with the fault; None where its line is gone."""
    return (
        with_fault(file.read_text("utf-8"), fault)
        if (file := ROOT / fault["file"]).exists()
        else None
    )


def kept() -> list[Fault]:
    return [json.loads(line) for line in KEPT.read_text(encoding="utf-8").splitlines()]


def drawn(seed: int) -> list[Fault]:
    """Return the kept faults; where a line is gone, another fault of its kind and folder instead."""
    rng, found = random.Random(seed), kept()
    for k, fault in enumerate(found):
        if faulty(fault) is None:
            folder = ROOT.joinpath(
                *Path(fault["file"]).parts[: 1 + fault["file"].startswith("jaxurban")]
            )
            files = [file.relative_to(ROOT).as_posix() for file in sorted(folder.rglob("*.py"))]
            others = [other for file in files for other in faults_of(file)]
            found[k] = rng.choice([other for other in others if other["kind"] == fault["kind"]])
    return found


def modules(tests: Path) -> dict[str, str]:
    """Return the texts of all modules and tests by their full names."""
    files = {f"tests/{file.relative_to(tests).as_posix()}": file for file in tests.rglob("*.py")}
    for folder in ("jaxurban", "kernels", "planners"):
        inside = "" if folder == "jaxurban" else "jaxurban/"
        files |= {
            inside + file.relative_to(ROOT).as_posix(): file
            for file in (ROOT / folder).rglob("*.py")
        }
    return {name: file.read_text(encoding="utf-8") for name, file in files.items()}


def imports(texts: dict[str, str]) -> dict[str, set[str]]:
    """Return the files that each file imports; a public name counts as the module that it comes from."""
    stubs = [stub.read_text() for stub in (ROOT / "jaxurban").rglob("*.pyi")]
    public, found = {name: home for stub in stubs for home, name in PUBLIC.findall(stub)}, {}
    for file, text in texts.items():
        lines = IMPORT.findall(text)
        names = {home for home, _ in lines}
        names |= {
            f"{home}.{name}".lstrip(".")
            for home, line in lines
            for name in re.findall(r"[\w.]+", line)
        }
        if "jaxurban" in names:
            names |= {public[name] for name in re.findall(r"\.(\w+)", text) if name in public}
        found[file] = {f"{name.replace('.', '/')}.py" for name in names} & texts.keys()
    return found


def reaching(file: str, tests: Path, away: int) -> list[str]:
    """Return the test files that reach a file by so many imports or fewer, nearest first, then by folder."""
    imported = imports(modules(tests))
    home = file if file.startswith("jaxurban/") else f"jaxurban/{file}"
    found, last = [home], [home]
    for _ in range(away):
        last = [user for user, used in imported.items() if used & {*last} and user not in found]
        found += sorted(
            last, key=lambda user: (-len({*Path(user).parts} & {*Path(home).parts}), user)
        )
    return [
        user for user in found if user.startswith("tests/") and Path(user).name.startswith("test_")
    ]


def verdict_of(fault: Fault, command: list[str], tests: Path, is_checked: bool) -> str:
    """Make a fault in a copy of the tree, run a command there, and say what came of it.

    Args:
      command: notices the fault by ending with other than 0.
      tests: of which tree.
      is_checked: whether to run again, without the fault, what failed of pytest.
    """
    text = faulty(fault)
    if text is None:
        return "gone"
    is_compiled = fault["file"].startswith(
        ("kernels", "planners")
    )  # caches of Numba do not know what was inlined
    with tempfile.TemporaryDirectory(prefix="fault-") as scratch:
        copy = Path(scratch, "tree")
        ignored = shutil.ignore_patterns(*NOT_COPIED, *(["__pycache__"] if is_compiled else []))
        shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
        if tests != ROOT / "tests":
            shutil.rmtree(copy / "tests")
            shutil.copytree(tests, copy / "tests")
        (copy / ".venv").symlink_to(ROOT / ".venv")
        environment = {
            "JAXURBAN_DATA": str(ROOT.parent / "shared" / "data"),
            "JAX_COMPILATION_CACHE_DIR": str(
                ROOT / ".pytest_cache" / "programs"
            ),  # keeps programs by what they are
            **os.environ,
            "PYTHONPATH": str(copy),
        }

        def run(text: str, words: list[str], cache: str) -> subprocess.CompletedProcess[str]:
            (copy / fault["file"]).write_text(text, encoding="utf-8")
            own = {"NUMBA_CACHE_DIR": f"{scratch}/{cache}"} if is_compiled else {}
            return subprocess.run(
                words,
                cwd=copy,
                env=environment | own,
                capture_output=True,
                text=True,
                timeout=LONGEST_S,
            )

        try:
            ended = run(text, command, "faulty")
        except subprocess.TimeoutExpired:
            return "noticed: it does not end"
        if ended.returncode == 0:
            return "UNNOTICED"
        if not is_checked:
            return "noticed"
        names = re.findall(r"^(?:FAILED|ERROR) (\S+)", ended.stdout, re.MULTILINE)
        again = run(
            (ROOT / fault["file"]).read_text("utf-8"), [*command, "--lf", "--lfnf", "none"], "clean"
        )
        without = (
            "" if again.returncode in (0, 5) else "FAILS ANYWAY: "
        )  # 5: the fault ended pytest itself
        return f"{without or 'noticed: '}{', '.join(names) or ended.stdout[-300:] + ended.stderr[-300:]}"


def main() -> None:
    """Draw faults, or run a command under those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("draw", "run"))
    parser.add_argument("numbers", nargs="*", type=int, help="of faults: lines of the file, from 1")
    parser.add_argument("--seed", type=int, default=28, help="of draw")
    parser.add_argument(
        "--reaching",
        type=int,
        metavar="IMPORTS",
        help="run the tests that are so near to the fault",
    )
    parser.add_argument("--tests", type=Path, default=ROOT / "tests", help="of another tree")
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    asked, command = parser.parse_args(sys.argv[1:cut]), sys.argv[cut + 1 :]
    if asked.what == "draw":
        KEPT.write_text(
            "".join(json.dumps(fault) + "\n" for fault in drawn(asked.seed)), encoding="utf-8"
        )
        return
    if not command and not asked.reaching:
        parser.error("give the command that shall notice the faults after --, or --reaching")
    faults, tests = kept(), asked.tests.resolve()
    for number in asked.numbers or range(1, len(faults) + 1):
        fault = faults[number - 1]
        files = reaching(fault["file"], tests, asked.reaching) if asked.reaching else []
        verdict = verdict_of(fault, [*(command or PYTEST), *files], tests, bool(files))
        print(
            f"{number:2} {fault['kind']:<11} {fault['file']}: {fault['instead']}\n   {verdict}",
            flush=True,
        )


if __name__ == "__main__":
    main()
