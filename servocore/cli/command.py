"""Commands from declared options: every option stands once, in a group that is a frozen dataclass.

A command is a function whose arguments are such groups; `Command` reads its options from them. An option may be fixed
for a command, which then does not offer it: so the commands of ``crane-fmu`` are those of ``servocore``.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, field, fields
from typing import Any, get_type_hints

import click
from click.core import augment_usage_errors

from servocore.cli.kinds import PICTURE, Kind, flag_of
from servocore.errors import InvalidSetting
from servocore.files import require_picture, require_places

_NUMBER = re.compile(r"[+-]?(\.?\d|nan|inf)\S*", re.IGNORECASE)  # or what was meant to be one, such as 5m
_OPTION_BEGINS = re.compile(r" (?=--?[a-z])")
HELP_FLAGS = ("-h", "--help")
_EXAMPLE_WIDTH = 76


def option(*flags: str, kind: Kind | None = None, metavar: str = "", help: str = "", default: Any = None) -> Any:  # noqa: A002
    """Declare an option as a field of a group.

    Parameters
    ----------
    *flags : str
        What it is called; none for the argument of a command.
    kind : Kind, optional
        What its value is; without it the option has none and is true where it is given.
    metavar, help : str
        What the help says of it.
    default : object
        A tuple for options that may be repeated; ``...`` where one must be given.
    """
    about = {"flags": flags, "kind": kind, "metavar": metavar, "help": help}
    if default is ...:
        return field(metadata=about)
    return field(default=False if kind is None else default, metadata=about)


class Argument(click.Argument):
    """What a command is given without a flag, with a help of its own."""

    def __init__(self, name: str, about: Mapping[str, Any], **more: Any) -> None:
        super().__init__([name], type=about["kind"], metavar=about["metavar"], **more)
        self.row = (about["metavar"], about["help"])

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:  # noqa: ARG002
        """Return its row in the help."""
        return self.row


class Command(click.Command):
    """A command whose options are the fields of the groups that its function takes.

    Parameters
    ----------
    name : str
        What it is called.
    function : callable
        Its arguments are annotated with groups of options, dataclasses with a ``title``.
    examples : sequence of str
        What may follow the name, for the help.
    fixed : mapping of str to object, optional
        Values of options that the command does not offer, by the names of fields.
    """

    def __init__(
        self,
        name: str,
        function: Callable[..., None],
        examples: Sequence[str] = (),
        fixed: Mapping[str, object] | None = None,
    ) -> None:
        hints = get_type_hints(function)
        self.groups: dict[str, Any] = {each: hints[each] for each in inspect.signature(function).parameters}
        self.fixed, self.examples, self.function = dict(fixed or {}), tuple(examples), function
        self.sections: dict[str, list[click.Parameter]] = {}
        for group in self.groups.values():
            offered = [_parameter(each) for each in fields(group) if each.name not in self.fixed]
            self.sections.setdefault(group.title, []).extend(offered)
        params = [each for section in self.sections.values() for each in section]
        text = inspect.getdoc(function) or ""
        super().__init__(name, callback=self._run, params=params, help=text, short_help=text.partition("\n\n")[0])

    def _run(self, **values: Any) -> None:
        """Call the function with its groups, once the places of all results can be written."""
        places = [(getattr(each.type, "role", ""), flag_of(each), values[str(each.name)]) for each in self.params]
        written = {flag: place for role, flag, place in places if role == "written"}
        require_places(written, [place for role, _, place in places if role == "read"])
        for each in self.params:
            if each.type is PICTURE:
                require_picture(values[str(each.name)])
        self.function(**self.given(values))

    def given(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the groups of its function, filled with values of options and those that are fixed."""
        known = {**values, **self.fixed}
        return {
            name: group(**{each.name: known[each.name] for each in fields(group) if each.name in known})
            for name, group in self.groups.items()
        }

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the words of a command line."""
        with augment_usage_errors(ctx):  # a refusal names the help of the command, not that of the program
            return super().parse_args(ctx, list(self._gathered(args)))

    def _gathered(self, words: list[str]) -> Iterator[str]:
        """Give the words of a command line with those of a value together.

        Raises
        ------
        InvalidSetting
            If an option lacks its value.
        """
        known = {flag: each for each in self.params for flag in each.opts if isinstance(each, click.Option)}
        k = 0
        while k < len(words):
            word = words[k]
            k += 1
            if word == "--":
                yield from words[k - 1 :]
                return
            flag, equals, value = word.partition("=")
            param = known.get(flag)
            if param is None or not isinstance(param.type, Kind):
                yield word
                continue
            name = flag_of(param)
            if not equals:
                if k == len(words) or words[k].partition("=")[0] in {*known, *HELP_FLAGS}:
                    raise InvalidSetting(f"{name} needs a value: write it as in {name} {param.type.example}")
                value = words[k]
                k += 1
            while param.type.role == "numbers" and k < len(words) and _NUMBER.fullmatch(words[k]):
                value = f"{value} {words[k]}"
                k += 1
            yield f"{name}={value}"

    def format_arguments(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write nothing: an argument stands among the options of its group."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, a section for each group."""
        helps = self.get_help_option(ctx)
        sections: dict[str, list[click.Parameter]] = {**self.sections, "Help": [helps] if helps else []}
        for title, params in sections.items():
            rows = [row for each in params if (row := each.get_help_record(ctx))]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples as one may type them: long ones go on behind a backslash."""
        if self.examples:
            with formatter.section("Examples"):
                for example in self.examples:
                    formatter.write(_continued(f"{ctx.command_path} {example}".rstrip(), formatter.width - 3))


def _continued(line: str, width: int) -> str:
    """Return a command line in indented lines that a shell takes as one, broken before options."""
    lines = ["  "]
    for part in _OPTION_BEGINS.split(line):
        if len(lines[-1]) + len(part) > min(width, _EXAMPLE_WIDTH):
            lines += ["     "]
        lines[-1] += f" {part}" if lines[-1].strip() or len(lines) > 1 else part
    return " \\\n".join(lines) + "\n"


def _parameter(declared: Field[Any]) -> click.Parameter:
    """Return the parameter of a field that `option` has declared."""
    about, name, default = declared.metadata, declared.name, declared.default
    given: dict[str, Any] = {"required": True} if default is MISSING else {"default": default}
    if not about["flags"]:
        return Argument(name, about, **{"required": False, **given})
    words = [name, *about["flags"]]
    if about["kind"] is None:
        return click.Option(words, is_flag=True, default=False, help=about["help"])
    again = ""
    if isinstance(default, tuple):
        given, again = {"multiple": True}, " May be repeated."
    return click.Option(words, type=about["kind"], metavar=about["metavar"], help=f"{about['help']}{again}", **given)
