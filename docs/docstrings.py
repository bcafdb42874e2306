"""How the reference reads docstrings of several arguments a line, and functions that are made from others (Griffe)."""

import re
from typing import Any

from griffe import Alias, ExprCall, Extension, Module, Object

GROUP = re.compile(r"^( *)(\w+(?:, \w+)+):( .*(?:\n\1 +\S.*)*)$", re.MULTILINE)
SECTION = re.compile(r"^(Args|Attributes):\n((?:[ ]+\S.*\n?|\n(?=[ ]))+)", re.MULTILINE)


class SplitGroups(Extension):
    """Gives each of ``a, b: text`` a line of its own: its name is checked against the signature, its type shown."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Split the docstring of a module, class or function before it is parsed."""
        if obj.docstring is not None:
            obj.docstring.value = split_groups(obj.docstring.value)


class SavableFunctions(Extension):
    """Shows ``compare = savable(computed.compare, ...)`` as the function that it is made from."""

    def on_module_members(self, *, mod: Module, **_: Any) -> None:
        """Put the function in the place of the attribute once a module is read."""
        for name, member in [*mod.attributes.items()]:
            if isinstance(member.value, ExprCall) and str(member.value.function) == "savable":
                module, _, function = str(member.value.arguments[0]).rpartition(".")
                mod.set_member(name, Alias(name, f"{mod.resolve(module)}.{function}", parent=mod))


def split_groups(text: str) -> str:
    """Return a docstring in which each argument or attribute has the description of its group."""
    return SECTION.sub(lambda section: GROUP.sub(_one_each, section[0]), text)


def _one_each(group: re.Match[str]) -> str:
    indent, names, description = group.groups()
    return "\n".join(f"{indent}{name}:{description}" for name in names.split(", "))
