"""Words of our own that the field's words replace, and how often each is left in a checkout, by folder.

A hit is a line (or a file's name) of a tracked text file that matches a pattern and none of what is allowed; a name in
snake or camel case counts by its parts. What is allowed is either plain English or set by the contract with users.
"""

import re
import subprocess
from collections import Counter
from pathlib import Path
from typing import NamedTuple

FOLDERS = {
    "sources": ("jaxurban", "kernels", "planners"),
    "tests": ("tests",),
    "docs": ("docs", "README.md", "CONTRIBUTING.md"),
    "others": ("benchmarks", "figures", "notebooks"),
}
SUFFIXES = (".py", ".md", ".toml", ".sh", ".html", ".txt")
SKIPPED = ("benchmarks/words.py",)  # this file


class Word(NamedTuple):
    """A word to be replaced.

    Attributes:
      word: as the table of words calls it, with the field's word.
      pattern: a regular expression of its forms; it begins and ends where a part of a name does.
      allowed: a line that matches one of these, in the form ``path:text``, is no hit.
    """

    word: str
    pattern: str
    allowed: tuple[str, ...] = ()


class Hit(NamedTuple):
    """A line with a word; line 0 is the file's name."""

    folder: str
    path: str
    line: int
    text: str


WORDS = (
    Word(
        "wish -> target",
        r"wish(?:es|ed)?",
        (
            r"--wish\b|given\[\"wishes\"\]",  # a command's option
            r"wished|name=\"wish\"",  # columns of outcomes.csv
            r"whoever wishes",
        ),
    ),
    Word(
        "weigh -> cost map",
        r"weigh|weighed map|Weighted(?:Map|Volume)|unit_?maps?",
        (r"(?:weigh|weighs) (?:the|more|less|nothing|little)",),
    ),
    Word(
        "Ground -> cost map",
        r"(?-i:Ground)",
        (
            r"(?:: |[\.\"|#]\s*)Ground ",
            r"heading",
            r"paths[./](?:ground|finish|cost_map|path)\b|tests/paths/test_export",  # the ground under a route
        ),
    ),
    Word(
        "Answer, AnswerBook -> result",
        r"answers?|answered|Answer_?Book",
        (
            r"server|request|https?|webrequest|http",
            r"answers_leave_data_share|satellite answers beyond",  # a key of run.json, and the name of a guess there
        ),
    ),
    Word("paid, charged, PathCharges -> path cost, visit counts", r"paid|unpaid|charge[sd]?|Path_?Charges"),
    Word("faults -> read issues", r"faults?", (r"default", r"\"faults\"", r"faulthandler", r"seg(?:mentation )?fault")),
    Word(
        "arrived, landing, fetchplan ... -> validate, staging, plan",
        r"arrived|landing|fetchplan|webrequest|asker|(?-i:Wanted|Kept)",
        (r"There is no landing",),  # of a drone
    ),
    Word(
        "switches -> breakpoints",
        r"switch(?:es|ed)?",
        (
            r"lax\.switch",
            r"switches\.(?:csv|parquet|png)",
            r"switch_routes",  # files
            r'"switches"',
            r"switched (?:on|off)",
        ),
    ),
    Word(
        "standing -> cells",
        r"standing",
        (r"standing (?:above|water|on|in|at|there)", r"understanding", r"long-?standing"),
    ),
    Word(
        "kinds -> clusters",
        r"kinds",
        (r"(?:cost|both|two|of all|all) kinds", r"kinds of", r"COST_KINDS|pair by pair\. Kinds"),
    ),
    Word("as good -> near-optimal", r"as[ _]good"),
    Word(
        "reading, examples -> demonstrations",
        r"examples?|read_examples|examples_from\w*|studies[./]reading",
        (
            r"[Ff]or example",
            r"examples\.(?:csv|parquet)",
            r"fewer_examples|num_examples|\"examples\"",  # files and a column
        ),
    ),
    Word(
        "limits -> constraints, keep-out zones",
        r"limits?",
        (
            r"(?:time|memory|size|speed|climb|air|axis|rate|wind|file|row|iteration)[ _]limits?",
            r"[xyz]lim|_limit_m|limits? of|no limit|limiting|the limit|within limits",
            r"docs/limits|limits\.md",
            r"(?:kernels|planners)/.*limit",  # the cost from which a segment or edge is of no use
            r"limit_s|upper limits|Limits of their own|and its limits|front_limit|def memory|limit - used|memory\.max",
            r"\|limit\|",  # a field of airspace files
            r"another run's limits",
            r'"limits"',
        ),
    ),
    Word("nearest wall -> clearance", r"nearest[ _]walls?", (r"nearest_wall_m",)),
    Word("stretch, piece -> segment", r"stretch(?:es)?|pieces?", (r"piece of work|one piece",)),
    Word("detail -> supersampling", r"details?|RegionDetail", (r"in detail|details of|[Mm]ore details?|detailed",)),
    Word(
        "oversample -> supersampling",
        r"oversampl\w*",
        (
            r"\[region\]",
            r"oversample\s*[=:]",
            r"oversample(?!d)\b",  # the TOML key, and what carries it
        ),
    ),
    Word(
        "fine -> supersampling",
        r"fine|finer",
        (
            r"how fine|times finer|finer_?(?:maps|ones)|has_finer|Finer maps|finer|[Ff]iner that|fine = step",
            r"/ fine\)|fine grid|fine-|is fine|finer (?:than|map|grid|resolution)",
            r"refine|define|confine",
        ),
    ),
    Word("case_study, showcase -> Monte Carlo benchmark, demo", r"case[ _-]?stud(?:y|ies)|showcase"),
    Word(
        "embedded city, made-up, generated -> synthetic city",
        r"embedded|made[-_ ]up|generated",
        (
            r"HeightOrigin|GENERATED|\"generated\"",  # an origin of heights in run.json
            r"generated (?:by|from|file)",
            r"made up of",
            r"embedded in",
        ),
    ),
    Word(
        "epoch -> time",
        r"epochs?",
        (
            r"GNSS|TLE|OMM|[Oo]rbit|[Ee]lement|almanac|ephemer",
            r"['\"]epochs['\"]|_?epoch_mean|`epochs`",  # an option of [gps], columns
            r"GPS|satellite|middle_epoch|sgp4_epoch|many epochs|more epochs|set \[gps\]|at every epoch\"",
        ),
    ),
    Word(
        "people -> which of three meanings",
        r"people",
        (
            r"people per km|people under|population density",
            r"people_overflown|People overflown|\"people\"|``people``|PEOPLE",  # columns, a target
            r"(?:number of|strip of|how many|their|0|the|of|without|as many|as|Census Bureau counts) people",
            r"(?:which|not|by|lengths and|ask for more|more) people",
            r"people (?:in|at|by|of|cannot|come|that|with|per|are|now|inside|who|do|among)|block_people",
            r"num_people",
            r"jaxurban/(?:metrics/population|world)",  # persons of census blocks
            r"People do not|buildings, people and|people`` |\} people|metrics and people|People per km|_line\(people",
            r"for people|people (?:who|read|use)",
        ),
    ),
    Word(
        "is no, none is -> plain English",
        r"is no|none is|are no",
        (r"(?:is|are) no (?:longer|more|less|fewer)", r"[Tt]here (?:is|are) no"),
    ),
    Word("in words, in earnest -> plain English", r"in[ _]words|in[ _]earnest"),
)


def matches(pattern: str) -> re.Pattern[str]:
    """Return a pattern that begins and ends where a part of a name in snake case, or a word, does; in any case."""
    return re.compile(rf"(?<![A-Za-z])(?:{pattern})(?![a-z])", re.IGNORECASE)


def tracked_files(checkout: Path) -> dict[str, list[str]]:
    """Return the paths of the tracked text files of each folder, links left out."""
    listed = subprocess.run(["git", "ls-files"], cwd=checkout, capture_output=True, text=True, check=True)
    files: dict[str, list[str]] = {folder: [] for folder in FOLDERS}
    for path in listed.stdout.splitlines():
        is_text = path.endswith(SUFFIXES) and (checkout / path).is_file() and not (checkout / path).is_symlink()
        for folder, tops in FOLDERS.items():
            if is_text and path not in SKIPPED and path.split("/")[0] in tops:
                files[folder].append(path)
    return files


def count_words(checkout: Path) -> dict[str, list[Hit]]:
    """Return the hits of each word in a checkout."""
    lines = [
        Hit(folder, path, number, text)
        for folder, paths in tracked_files(checkout).items()
        for path in paths
        for number, text in enumerate([path, *(checkout / path).read_text(encoding="utf-8").splitlines()])
    ]
    found: dict[str, list[Hit]] = {}
    for word, pattern, allowed in WORDS:
        wanted, left_out = matches(pattern), [re.compile(each) for each in allowed]
        found[word] = [
            hit
            for hit in lines
            if wanted.search(hit.text) and not any(each.search(f"{hit.path}:{hit.text}") for each in left_out)
        ]
    return found


def by_folder(hits: list[Hit]) -> str:
    """Return how many hits each folder holds, such as ``sources 3, docs 1``; nothing where there are none."""
    counts = Counter(hit.folder for hit in hits)
    return ", ".join(f"{folder} {counts[folder]}" for folder in FOLDERS if counts[folder])
