"""Which sentences of public docstrings tell a unit, a shape, an edge or a source, and stand nowhere in another tree.

A reviewer's list, not a verdict: a sentence counts as kept where a docstring or comment of the other tree holds most
of its words, and all of its numbers and shapes, in any order within two sentences that follow each other.
"""

import ast
import io
import re
import textwrap
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

SAME_SHARE = 0.75  # of a sentence's words that another must hold
UNIT = r"(?:m|km|metres?|degrees?|deg|rad(?:ians)?|s|seconds?|Hz|dB|%|percent|cells?|per km2|MiB|GiB|bytes)"
FACT = re.compile(
    r"``?\[[^\]]*[A-Z1-9][^\]]*\]|"  # a shape
    rf"\d[\d,.]*\s?{UNIT}\b|\bin (?:metres|degrees|radians|seconds|cell sides|km)|\bper (?:metre|km2|step|cell)\b|"
    r"\b[a-z]+_(?:m|s|deg|rad|m_s|w)\b|\bfloat(?:32|64)\b|\bUTC\b|\bISO 8601\b|"
    r"\bnan\b|\binf(?:inite)?\b|\bempty\b|\bedges?\b|\bborders?\b|\boutside\b|\bNone\b|\bno data\b|\bzero\b|\b0\b|"
    r"\bEq\.|\bequation\b|\bet al\b|\b(?:19|20)\d\d\b|\bpaper\b|\bInputError\b|\b(?:south|north|east|west)",
    re.IGNORECASE,
)
EXACT = re.compile(r"\d+(?:[.,]\d+)*|\b[A-Z](?:, [A-Z])+\b")
WORD = re.compile(r"[a-z0-9]+")
STOP = set(
    re.findall(r"\w+", "a an the of is are to in and or it its by with as at that this for on be from which no not")
)
NAMED = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
ENDS = re.compile(r"(?<=;)\s+|(?<=[.:])\s+(?=[A-Z`\"(])|\n\s*\n|\n(?=\s*[\w, ]+: )")


class Sentence(NamedTuple):
    """A sentence, where it stands, its words, and its numbers and shapes."""

    place: str
    text: str
    words: Counter[str]
    exact: frozenset[str]


def sentence_of(place: str, text: str) -> Sentence:
    """Return a sentence whose white space is folded."""
    text = " ".join(text.split())
    words = Counter(stem(word) for word in WORD.findall(text.lower()) if word not in STOP)
    return Sentence(place, text, words, frozenset(EXACT.findall(text)))


def stem(word: str) -> str:
    """Return a word without the endings of plurals and verbs, roughly."""
    return re.sub(r"(?:ing|ed|es|s)$", "", word) if len(word) > 4 else word


def docstrings(file: Path, *, public_only: bool) -> Iterator[tuple[str, str]]:
    """Yield where each docstring of a file stands, and its text."""
    todo: list[tuple[str, ast.AST]] = [(file.stem, ast.parse(file.read_text(encoding="utf-8")))]
    while todo:
        place, node = todo.pop()
        if text := ast.get_docstring(node):
            yield place, text
        named = (child for child in ast.iter_child_nodes(node) if isinstance(child, NAMED))
        todo += [
            (f"{place}.{child.name}", child) for child in named if not (public_only and child.name.startswith("_"))
        ]


def comments(file: Path) -> Iterator[tuple[str, str]]:
    """Yield the comments of a file."""
    for token in tokenize.generate_tokens(io.StringIO(file.read_text(encoding="utf-8")).readline):
        if token.type == tokenize.COMMENT:
            yield file.stem, token.string.lstrip("# ")


def sentences(texts: Iterable[tuple[str, str]]) -> list[list[Sentence]]:
    """Return the sentences of each text."""
    return [
        [sentence_of(place, part) for part in ENDS.split(textwrap.dedent(text)) if part.strip()]
        for place, text in texts
    ]


def with_next(text: Sequence[Sentence]) -> Iterator[Sentence]:
    """Yield each sentence of a text joined with the next one."""
    for k, sentence in enumerate(text):
        yield sentence_of(sentence.place, " ".join(part.text for part in text[k : k + 2]))


def lost_facts(before: Iterable[Path], after: Iterable[Path]) -> list[str]:
    """Return the facts of public docstrings of ``before`` that no docstring or comment of ``after`` tells."""
    kept = [
        joined
        for file in after
        for text in sentences(docstrings(file, public_only=False))
        for joined in with_next(text)
    ]
    kept += [sentence for file in after for text in sentences(comments(file)) for sentence in text]
    by_word: dict[str, list[int]] = defaultdict(list)
    for k, sentence in enumerate(kept):
        for word in sentence.words:
            by_word[word].append(k)

    def is_kept(sentence: Sentence) -> bool:
        shared: Counter[int] = Counter()
        for word, times in sentence.words.items():
            for k in by_word[word]:
                shared[k] += min(times, kept[k].words[word])
        needed = SAME_SHARE * sentence.words.total()
        return any(count >= needed and sentence.exact <= kept[k].exact for k, count in shared.items())

    return [
        f"{sentence.place}: {sentence.text}"
        for file in before
        for text in sentences(docstrings(file, public_only=True))
        for sentence in text
        if FACT.search(sentence.text) and not is_kept(sentence)
    ]
