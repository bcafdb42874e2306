"""Write the tables of kinds into docs/model/kinds.md: what stands by which rule, and what is nothing.

``python -m tests.renew_kinds`` writes them between their marks, from `jaxurban.cities.rules` alone.
"""

import math
import re
from collections.abc import Mapping

from benchmarks.common import ROOT
from jaxurban.cities.kinds import Kind, Nothing
from jaxurban.cities.rules import RULES
from jaxurban.world.footprints import BUILDING, UNKNOWN

PAGE = ROOT / "docs/model/kinds.md"
MARKED = re.compile(r"(<!-- from the rules: (\w+) -->\n\n).*?(\n<!-- -->)", re.DOTALL)
HEADS = {
    "kinds": "| rule | taken for | guess, m | bound, m | source of the bound |\n|---|---|---|---|---|\n",
    "nothing": "| nothing stands by a rule that | rule |\n|---|---|\n",
}


def renewed(page: str, rules: Mapping[str, object] = RULES) -> str:
    """Return a page whose marked tables are those of the rules."""
    return MARKED.sub(lambda found: f"{found[1]}{table(found[2], rules)}\n{found[3]}", page)


def table(name: str, rules: Mapping[str, object] = RULES) -> str:
    """Return the table of kinds, or that of what is nothing; every rule stands in one of them, once.

    Args:
      name: ``"kinds"`` or ``"nothing"``.
      rules: by name, what each gives.
    """
    is_nothing = name == "nothing"
    rows: dict[str, list[str]] = {}
    for rule, gives in rules.items():
        if isinstance(gives, Nothing) == is_nothing:
            rows.setdefault(_cells(gives), []).append(rule)
    pairs = [(cells, _named(of_row)) for cells, of_row in rows.items()]
    lines = [" | ".join(pair if is_nothing else pair[::-1]) for pair in pairs]
    return HEADS[name] + "\n".join(f"| {line} |" for line in lines)


def _cells(gives: object) -> str:
    """Return what a rule gives: a reason, or kind, guess, bound and the source of that."""
    if isinstance(gives, Nothing):
        return gives.reason
    if gives == BUILDING:
        return f"{BUILDING} | [by its size](#unknown-heights) | see below | see below"
    assert isinstance(gives, Kind)
    if gives.name != UNKNOWN and not gives.height_m:
        return f"{gives.name} | its own height; without one nothing stands | its own | "
    guess = "" if gives.name == UNKNOWN else f"{gives.height_m:g}"
    if math.isinf(gives.limit_m):
        return f"{gives.name} | {guess} | none | "
    return f"{gives.name} | {guess} | {gives.limit_m:g} | {gives.source}"


def _named(rules: list[str]) -> str:
    """Return rules of one row: in words, or the values of their keys; keys of equal values stand together."""
    keys: dict[str, list[str]] = {}
    for rule in rules:
        key, _, values = rule.rpartition(": ")
        tag, of, shape = key.partition(" of ")
        keys.setdefault(values, []).append(f"`{tag}`{of}{shape}" if key else "")
    return "; ".join(_listed(values, of_values) for values, of_values in keys.items())


def _listed(values: str, keys: list[str]) -> str:
    """Return values with their keys, ``"`power`: tower"``; a rule in words as it is."""
    if keys == [""]:
        return values
    named = "any other value" if values == "*" else values.replace(" ", ", ")
    return f"{', '.join(keys)}: {named}"


if __name__ == "__main__":
    PAGE.write_text(renewed(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
