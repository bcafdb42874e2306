"""How the reference reads docstrings of several arguments a line, and keywords that stand in one place (Griffe)."""

import re
from typing import Any

from griffe import Alias, Class, Extension, Function, Module, Object, Parameter, ParameterKind

GROUP = re.compile(r"^( *)(\w+(?:, \w+)+):( .*(?:\n\1 +\S.*)*)$", re.MULTILINE)
UNPACKED = re.compile(r"Unpack\[(\w+)\]")
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


class WriteKeywords(Extension):
    """Writes the keywords of ``**name: Unpack[...]`` out in the signatures of functions, each by itself."""

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        """Write them out in all functions of a package, once all of its classes are known."""
        write_keywords(pkg)


def write_keywords(parent: Module | Class) -> None:
    """Write keywords out in the functions of a module or a class, and of all within."""
    for member in parent.members.values():
        if isinstance(member, Module | Class):
            write_keywords(member)
        if isinstance(member, Function):
            for parameter in [*member.parameters]:
                unpacked = UNPACKED.fullmatch(str(parameter.annotation))
                if unpacked:
                    del member.parameters[parameter.name]
                    _add_keywords(member, member.module[unpacked[1]])


def _add_keywords(function: Function, choice: Object | Alias) -> None:
    """Add the keys of a TypedDict, those that it inherits too, to the parameters of a function."""
    target = choice.final_target if isinstance(choice, Alias) else choice
    for key in target.all_members.values():
        if key.is_attribute:
            keyword = Parameter(
                key.name,
                annotation=key.annotation,
                kind=ParameterKind.keyword_only,
                default="...",
            )
            function.parameters.add(keyword)
