"""Rewrite the outputs shown in README and docs to what their commands and Python blocks print now.

``python -m tests.renew_outputs [PAGE ...]`` runs the pages (all that show outputs, or those named, such as
``docs/tutorial.md``) as `tests/test_docs.py` does, and replaces each shown line that was not printed with the printed
line that is most like it. Prose stays, and so does the choice of lines: where a page shows some of what is printed,
``...`` included, it still does. The changes are printed, then the sentences of prose that a person has to read: those
that hold a number which is no longer shown, and others with numbers in the sections that changed.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path
from typing import NamedTuple

import pytest

from tests import test_docs
from tests.test_docs import PAGES, Block, blocks_of, is_shown, name_of

ENOUGH_ALIKE = (
    0.5  # share of a line's words, numbers aside, that its successor has in the same order
)
TELLING_DIGITS = 4  # a number of so many is looked for in all pages, others in their own section
NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?<!,)")
FENCED = re.compile(r"^ *```.*?^ *```[ \t]*$", re.MULTILINE | re.DOTALL)
SENTENCE = re.compile(r"\S.*?(?:[.!?:](?=\s+[^a-z\s])|(?=\n\s*\n|\n *[-|#])|\Z)", re.DOTALL)


class Change(NamedTuple):
    """A shown line, by its number on the page, that was not printed; ``new`` is None where nothing was like it."""

    line: int
    old: str
    new: str | None


def numbers_in(text: str) -> set[str]:
    """Return the numbers of a text, without the commas between thousands."""
    return {number.replace(",", "") for number in NUMBER.findall(text)}


def words_of(line: str) -> list[str]:
    """Return the words of a line with each number as a 0, which is how two lines are compared."""
    return [NUMBER.sub("0", word) for word in line.split()]


def successor(shown: str, printed: str) -> str:
    """Return a printed line, cut where the line that it replaces is cut by ``...``."""
    pieces = re.findall(r"\S+\s*", printed)
    old_words = words_of(shown)
    result = ""
    matcher = SequenceMatcher(None, old_words, words_of(printed), autojunk=False)
    for step, old_start, old_stop, new_start, new_stop in matcher.get_opcodes():
        is_left_out = step == "insert" and (old_start == 0 or result.endswith(" ... "))
        if step != "equal" and "..." in old_words[old_start:old_stop]:
            result = f"{result.rstrip()} ... "
        elif not is_left_out:
            result += "".join(pieces[new_start:new_stop])
    result = result.strip()
    return result if is_shown(result, printed) else printed


def changes_of(block: Block, said: str) -> list[Change]:
    """Return what has to change in a block of outputs so that each of its lines stands in what was printed."""
    shown = [line.strip() for line in block.text.splitlines()]
    stale = [line for line in shown if not is_shown(line, said)]
    current = [line for line in shown if line not in stale]
    printed = [line.strip() for line in said.splitlines() if line.strip()]
    unused = [line for line in printed if not any(is_shown(old, line) for old in current)]
    changes = []
    for number, old in enumerate(shown, block.line):
        if old not in stale:
            continue
        best, new = 0.0, None
        for line in unused:
            words = words_of(old)
            matcher = SequenceMatcher(None, words, words_of(line), autojunk=False)
            same = sum(match.size for match in matcher.get_matching_blocks())
            alike = same / len(words) + 1e-3 * matcher.ratio()
            if alike > best:
                best, new = alike, line
        if new is None or best < ENOUGH_ALIKE:
            changes.append(Change(number, old, None))
            continue
        unused.remove(new)
        changes.append(Change(number, old, successor(old, new)))
    return changes


def rewrite(page: Path, changes: list[Change]) -> None:
    """Put the new lines into a page, at the indent of the old ones."""
    lines = page.read_text(encoding="utf-8").splitlines(keepends=True)
    for line, old, new in changes:
        if new is not None:
            lines[line - 1] = lines[line - 1].replace(old, new)
    page.write_text("".join(lines), encoding="utf-8")


def prose_of(page: Path) -> str:
    """Return the text of a page with its fenced blocks left empty, so that lines keep their numbers."""
    text = page.read_text(encoding="utf-8")
    return FENCED.sub(lambda fenced: "\n" * fenced[0].count("\n"), text)


def section_of(prose: str, line: int) -> int:
    """Return how many headings a page has up to a line."""
    return sum(text.startswith("#") for text in prose.splitlines()[:line])


def sentences_of(prose: str) -> Iterator[tuple[int, str]]:
    """Yield the sentences that hold numbers, each after the line on which it begins."""
    for found in SENTENCE.finditer(prose):
        if numbers_in(found[0]):
            yield prose.count("\n", 0, found.start()) + 1, " ".join(found[0].split())


def sentences_to_read(changed: dict[Path, list[Change]]) -> tuple[list[str], list[str]]:
    """Return the sentences of prose that hold a number which went, and others beside what changed.

    Args:
      changed: by page what changed on it, as it was before the page was rewritten or after.
    """
    gone = set()
    for changes in changed.values():
        for _, old, new in changes:
            gone |= numbers_in(old) - numbers_in(new or "")
    telling = {number for number in gone if sum(map(str.isdigit, number)) >= TELLING_DIGITS}
    stale = []
    beside = []
    for page in PAGES:
        prose = prose_of(page)
        sections = {section_of(prose, change.line) for change in changed.get(page, [])}
        for line, text in sentences_of(prose):
            is_beside = section_of(prose, line) in sections
            if numbers_in(text) & (gone if is_beside else telling):
                stale.append(f"{name_of(page)}:{line}: {text}")
            elif is_beside:
                beside.append(f"{name_of(page)}:{line}: {text}")
    return stale, beside


class Renewal:
    """Stands in for the assertion of `tests/test_docs.py` that a block shows what was printed."""

    def __init__(self) -> None:
        """Nothing has changed yet."""
        self.blocks: dict[tuple[Path, int], list[Change]] = {}

    @pytest.fixture(autouse=True)
    def _keeping(self, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(request.module, "assert_shown", self.keep)

    def keep(self, block: Block, said: str, page: Path) -> None:
        """Keep what changes in a block; of one that runs over two maps, README's scenario comes last and counts."""
        self.blocks[page, block.line] = changes_of(block, said)

    def changed(self, pages: list[Path]) -> dict[Path, list[Change]]:
        """Return by page, in the order of its lines, what changes on those of ``pages`` where something does."""
        changes: dict[Path, list[Change]] = {}
        for (page, _), of_block in sorted(self.blocks.items()):
            if of_block and page in pages:
                changes.setdefault(page, []).extend(of_block)
        return changes


def pages_with_outputs() -> list[Path]:
    """Return the pages that show what a block of theirs prints."""
    languages = {page: {block.language for block in blocks_of(page)} for page in PAGES}
    return [page for page in PAGES if "text" in languages[page] and languages[page] & test_docs.RUN]


def tests_of(pages: list[Path]) -> list[str]:
    """Return the tests of `tests/test_docs.py` that run the blocks of pages."""
    names = [f"test_the_blocks_of_a_page_run_in_their_order[{name_of(page)}]" for page in pages]
    if any(page in pages for page, *_ in test_docs.COMMANDS_WITH_OUTPUT):
        names.append(
            "test_readme_and_guides_show_what_is_printed_over_the_maps_of_readmes_scenario"
        )
    return [f"{test_docs.__file__}::{name}" for name in names]


def main() -> int:
    """Run the pages that were asked for, rewrite them, and print what changed and what is left to a person."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = {name_of(page): page for page in pages_with_outputs()}
    parser.add_argument("pages", nargs="*", metavar="PAGE", help=f"of {', '.join(known)}")
    asked = parser.parse_args().pages or [*known]
    if unknown := [name for name in asked if name not in known]:
        parser.error(f"{', '.join(unknown)}: give pages that show outputs: {', '.join(known)}")

    pages = [known[name] for name in asked]
    renewal = Renewal()
    is_imported = (
        "-Wignore::pytest.PytestAssertRewriteWarning"  # this module has imported jaxurban already
    )
    options = ["-m", "slow", "-p", "no:cacheprovider", is_imported]
    failed = pytest.main([*tests_of(pages), *options], [renewal])
    changed = renewal.changed(pages)
    stale, beside = sentences_to_read(changed)
    untested = [
        f"{name_of(page)}:{block.line}"
        for page in pages
        for block in blocks_of(page)
        if block.language == "text" and (page, block.line) not in renewal.blocks
    ]
    for page, changes in changed.items():
        rewrite(page, changes)
        for line, old, new in changes:
            print(f"{name_of(page)}:{line}\n- {old}")
            print(f"+ {new}" if new is not None else "! nothing that was printed is like it")
    num_lines = sum(map(len, changed.values()))
    print(f"{num_lines} lines on {len(changed)} pages were not what is printed now.")
    if stale:
        print(
            "\nMend these sentences, which hold a number that is no longer shown:", *stale, sep="\n"
        )
    if beside:
        print("\nRead these, whose sections changed:", *beside, sep="\n")
    if untested:
        print(f"\nNo block above these prints them: {', '.join(untested)}.")
    if failed:
        print(
            "\nSome pages did not run to their end (above): what stands below there was not renewed."
        )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
