"""How options are made: of what settings say of their own fields, as NAME=VALUE, and in groups of `--help`."""

import inspect
import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial, wraps
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import click

from jaxurban.checks import check_metres, finite, one_of, unit_of_argument
from jaxurban.spelling import near

Decorator = Callable[[Callable], Callable]


class Number(click.types.FloatParamType):
    """A number; a length in another unit than metres is answered with its metres."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number in a text.

        Raises:
          BadParameter: a text that is no number.
          InputError: a length with its unit, where metres are meant.
        """
        _check_length(param, value)
        return super().convert(value, param, ctx)


def _check_length(param: click.Parameter | None, value: Any) -> None:
    """Raise InputError, which says the metres, for a length with its unit where an option is of metres."""
    if param is not None:
        is_length = "METRES" in (param.metavar or "") or str(param.name).endswith("_m")
        check_metres(param.opts[0], value, "metres" * is_length)


class WholeNumber(click.IntRange):
    """A whole number in a range; a length in another unit than metres is answered with its metres."""

    name = "whole number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number in a text.

        Raises:
          BadParameter: a text that is no whole number of the range.
          InputError: a length with its unit, where metres are meant.
        """
        _check_length(param, value)
        return super().convert(value, param, ctx)


class NumberRange(click.FloatRange):
    """A number in a range."""

    name = "number"


ONE = {float: Number(), int: WholeNumber(), bool: click.BOOL, str: click.STRING}

TYPED = "words"  # of a click context: those of the command
# Sections of the help for options that several commands have; the others stand before them.
SECTIONS = {
    "Maps": ("resolution_m", "time", "times", "time_of_day", "sources", "changes"),
    "Rules of the route": ("preset", "weights", "rules", "no_fly", "require"),
    "Output": ("output", "files", "overwrite", "as_json"),
    "Machine": ("workers", "cluster", "device", "seed"),
}


class Command(click.Command):
    """A command whose help lists its options by `SECTIONS`, and that can be run again (`terminal.common.again`)."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Return what is left of the words of a command when its own are taken, which are kept as they were typed."""
        ctx.meta[TYPED] = [str(ctx.info_name), *args]
        return super().parse_args(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options into a help text."""
        section_of = {name: title for title, names in SECTIONS.items() for name in names}
        rows: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for param in self.get_params(ctx):
            row = param.get_help_record(ctx)
            if row is not None and isinstance(param, click.Option):
                section = rows[section_of.get(str(param.name), "Options")]
                section.append(row)
                if isinstance(param.type, Values):
                    section += param.type.rows
        for title in ("Options", *SECTIONS):
            if rows[title]:
                with formatter.section(title):
                    formatter.write_dl(rows[title])


command = partial(click.command, cls=Command)


class Numbers(click.ParamType):
    """Numbers with commas between them.

    Args:
      name: of the type, in the help.
      example: ends the sentence on other values: ``'x' must be EXAMPLE``.
      count: how many numbers there must be; 0: any number of them.
    """

    def __init__(self, name: str, example: str, count: int = 0) -> None:
        self.name, self.example, self.count = name, example, count

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the numbers in a text.

        Args:
          value: the text; a default, which is a tuple of numbers already, comes back unchanged.
          param, ctx: of the option, for the error.

        Raises:
          BadParameter: something that is no number, or another count of numbers.
          InputError: a length with its unit, where metres are meant.
        """
        if isinstance(value, tuple):
            return value
        _check_length(param, str(value).split(","))
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if not numbers or len(numbers) != (self.count or len(numbers)):
            self.fail(f"{value!r} must be {self.example}", param, ctx)
        return numbers


class Names(click.ParamType):
    """Names with commas between them; a default, which is a tuple already, comes back unchanged."""

    name = "name,..."

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the names in a text."""
        if isinstance(value, tuple):
            return value
        return tuple(filter(None, map(str.strip, value.split(","))))


class NumberOrText(click.ParamType):
    """A number where a text reads as one, else the text."""

    name = "number or text"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | str:
        """Return the value of a text."""
        try:
            return float(value)
        except ValueError:
            return str(value)


class Values(click.ParamType):
    """``NAME=VALUE,...``: values by their names, which are those of a class's fields; the help lists them below it.

    A value without a name is that of the first one.

    Args:
      settings: a class with annotated fields, each with a line in the docstring.
      names: of the fields; none: all of them.
    """

    name = "NAME=VALUE,..."

    def __init__(self, settings: type, names: Sequence[str] = ()) -> None:
        self.hints = get_type_hints(settings)
        self.texts = texts_of(settings)
        self.names = names or tuple(self.hints)
        self.takes_number = isinstance(type_of(self.hints[self.names[0]]), Number)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Rows of the help below the option's own: each name, and what it means."""
        return [(f"  {name}=", self.texts[name]) for name in self.names]

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> dict[str, Any]:
        """Return the values in a text by their names.

        Args:
          value: the text; an empty one holds none.
          param, ctx: of the option, for the error.

        Raises:
          BadParameter: a name twice, or a value of another kind.
          InputError: a name that is no field, or a number that is not finite.
        """
        said = f"a name in {param.opts[0]}" if param else "a name"
        values: dict[str, Any] = {}
        for part in filter(None, value.split(",")):
            given, equals, text = part.rpartition("=")
            meant = near(text.strip(), self.names) if self.takes_number and not equals else []
            if meant:
                self.fail(f"{meant[0]} has no value: write {meant[0]}=NUMBER", param, ctx)
            name = one_of(said, given.strip() or self.names[0], self.names)
            if name in values:
                self.fail(f"{name} stands twice: give it one value", param, ctx)
            check_metres(name, text.strip())
            number = type_of(self.hints[name]).convert(text.strip(), param, ctx)
            values[name] = finite(name, number) if isinstance(number, float) else number
        return values


def meant_option(error: click.NoSuchOption) -> str:
    """Return the message on an option that there is not, with the one that it means; empty where none is known.

    It may be one of the values of another option, such as ``max_people`` of ``--limits``.
    """
    if error.ctx is None:
        return ""
    name = error.option_name.lstrip("-").replace("-", "_")
    options = {}
    for param in error.ctx.command.params:
        options[param.opts[0].lstrip("-").replace("-", "_")] = param.opts[0]
        if isinstance(param.type, Values):
            options |= {key: f"{param.opts[0]} {key}=..." for key in param.type.names}
    meant = near(name, options)
    return f"No such option {error.option_name!r}: give {options[meant[0]]}" if meant else ""


def type_of(hint: Any) -> Any:
    """Return the click type of a field's hint; of one that is optional, of what it may be beside None.

    Lists of texts are `Names`, other tuples `Numbers`, and what may be of several kinds is a number or a text.
    """
    if get_origin(hint) in (Union, UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not NoneType]
        return type_of(kinds[0]) if len(kinds) == 1 else NumberOrText()
    items = get_args(hint)
    if get_origin(hint) is Literal:
        return click.Choice(items)
    if not items:
        return ONE.get(hint, click.STRING)
    if items[0] is str:
        return Names()
    count = 0 if Ellipsis in items or get_origin(hint) is Sequence else len(items)
    return Numbers("NUMBER,...", "numbers with commas between them", count)


def texts_of(settings: type) -> dict[str, str]:
    """Return what the docstrings of a class and of those that it inherits from say of each attribute, by name."""
    texts: dict[str, str] = {}
    for each in reversed(settings.__mro__):
        _, _, attributes = inspect.cleandoc(each.__doc__ or "").partition("Attributes:\n")
        entries = attributes.partition("\n\n")[0]
        for names, text in re.findall(r"^  (\w[\w, ]*): (.*(?:\n    .*)*)", entries, re.M):
            plain = " ".join(re.sub(r' \(`[\w.]+`\)|``|"', "", text).split())
            texts |= dict.fromkeys(names.split(", "), plain)
    return texts


def options_together(*parameters: Callable) -> Decorator:
    """Return a decorator that adds options and arguments to a command, which lists them in this order."""

    def add(command: Callable) -> Callable:
        for parameter in reversed(parameters):  # as decorators that stand one over the other
            command = parameter(command)
        return command

    return add


def grouped_options(
    argument: str,
    make: Callable[..., Any],
    *options: Callable,
    names: Sequence[str] | None = None,
) -> Decorator:
    """Return a decorator that adds several options to a command, which gets one argument made of their values.

    Args:
      argument: name of the command's argument.
      make: returns its value; it takes the values of the options, by their names in Python.
      options: the options, in the order of the help.
      names: of the options in Python; None: of all annotated arguments of ``make``.
    """
    own = names or [name for name in make.__annotations__ if name != "return"]

    def add(command: Callable) -> Callable:
        @wraps(command)
        def call(**values: Any) -> Any:
            own_values = {name: values.pop(name) for name in own}
            values[argument] = make(**own_values)
            return command(**values)

        return options_together(*options)(call)

    return add


def options_of(settings: Any) -> Decorator:
    """Return a decorator that gives a command an option for each field of a settings class, and an instance of it.

    A field's own name, default, kind and line in the docstring of the class are those of the option: ``num_samples``
    is ``--samples``, ``block_m`` is ``--block METRES``. As the help of a command imports nothing heavy, the module of
    the class must not either.

    Args:
      settings: a dataclass whose fields all have defaults.
    """
    hints, texts = get_type_hints(settings), texts_of(settings)
    chosen = fields(settings)
    options = []
    for item in chosen:
        name = re.sub(r"^(num|has|is)_|_(m|s|m_s|deg|w)$", "", item.name).replace("_", "-")
        text = texts.get(item.name, "")
        is_flag = hints[item.name] is bool
        option = click.option(
            f"--{name}",
            item.name,
            type=None if is_flag else type_of(hints[item.name]),
            is_flag=is_flag,
            default=item.default,
            show_default=not is_flag and item.default not in (None, ()),
            metavar=unit_of_argument(item.name).upper() or None,
            help=f"{text[:1].upper()}{text[1:]}",
        )
        options.append(option)
    names = [item.name for item in chosen]
    return grouped_options("settings", settings, *options, names=names)
