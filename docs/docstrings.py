"""How the reference reads docstrings of several arguments a line (Griffe)."""

import re
from typing import Any

from griffe import Extension, Object

GROUP = re.compile(r"^( *)(\w+(?:, \w+)+):( .*(?:\n\1 +\S.*)*)$", re.MULTILINE)
SECTION = re.compile(r"^(Args|Attributes):\n((?:[ ]+\S.*\n?|\n(?=[ ]))+)", re.MULTILINE)


class SplitGroups(Extension):
    """Gives each of ``a, b: text`` a line of its own: its name is checked against the signature, its type shown."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Split the docstring of a module, class or function before it is parsed."""
        if obj.docstring is not None:
            obj.docstring.value = split_groups(obj.docstring.value)


def split_groups(text: str) -> str:
    """Return a docstring in which each argument or attribute has the description of its group."""
    return SECTION.sub(lambda section: GROUP.sub(_one_each, section[0]), text)


def _one_each(group: re.Match[str]) -> str:
    indent, names, description = group.groups()
    return "\n".join(f"{indent}{name}:{description}" for name in names.split(", "))
