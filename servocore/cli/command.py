"""Commands from declared options: every option stands once, in a group that is a frozen dataclass.

A command is a function whose arguments are such groups; `Command` reads its options from them. An option may be fixed
for a command, which then does not offer it: so the commands of ``crane-fmu`` are those of ``servocore``.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, fields
from typing import Any, get_type_hints

import click
from click.core import augment_usage_errors

from servocore.cli.kinds import PICTURE, Kind, flag_of
from servocore.errors import InvalidSetting
from servocore.files import require_picture, require_places

_NUMBER = re.compile(r"[+-]?(\.?\d|nan|inf)\S*", re.IGNORECASE)  # or a malformed one, such as 5m
_OPTION_BEGINS = re.compile(r" (?=--?[a-z])")
HELP_FLAGS = ("-h", "--help")
_EXAMPLE_WIDTH = 76


def option(*flags: str, kind: Kind | None = None, metavar: str = "", help: str = "", default: Any = None) -> Any:  # noqa: A002
    """Declare an option as a field of a group.

    Parameters
    ----------
    *flags : str
        Its names; none for the argument of a command.
    kind : Kind, optional
        Kind of its value; without it the option is a flag.
    metavar, help : str
        Its row in the help.
    default : object
        A tuple for options that may be repeated; ``...`` for a required one.
    """
    about: dict[str, Any] = {"help": help, "is_flag": True, "default": False}
    if kind is not None:
        about = {"type": kind, "metavar": metavar, "help": help, "required": default is ...}
        about |= {} if default is ... else {"default": default}
    if isinstance(default, tuple) and not flags:
        about["nargs"] = -1
    elif isinstance(default, tuple):
        about |= {"multiple": True, "help": f"{help} May be repeated."}
    declared = {"flags": flags, "kind": kind, "about": about}
    return field(metadata=declared, **{"default": about["default"]} if "default" in about else {})


def given_options(group: Any) -> list[str]:
    """Return the names of a group's options that are given."""
    values = {each.metadata["flags"][0]: getattr(group, each.name) for each in fields(group)}
    return [flag for flag, value in values.items() if value is not None and value is not False]


class Argument(click.Argument):
    """A positional argument with a row in the help."""

    def __init__(self, names: Sequence[str], help: str, **about: Any) -> None:  # noqa: A002
        super().__init__(names, **about)
        self.row = (about["metavar"], help)

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:  # noqa: ARG002
        """Return its row in the help."""
        return self.row


class Command(click.Command):
    """A command whose options are the fields of the groups, dataclasses with a ``title``, that its function takes.

    The help shows the `examples`. Options in `fixed`, values by the names of fields, are not offered.
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
            for each in (each for each in fields(group) if each.name not in self.fixed):
                flags, about = each.metadata["flags"], each.metadata["about"]
                parameter = (click.Option if flags else Argument)([each.name, *flags], **about)
                self.sections.setdefault(group.title, []).append(parameter)
        params = [each for section in self.sections.values() for each in section]
        text = inspect.getdoc(function) or ""
        super().__init__(name, callback=self._run, params=params, help=text, short_help=text.partition("\n\n")[0])

    def _run(self, **values: Any) -> None:
        """Call the function with its groups, after a check that all results can be written."""
        places = [(getattr(each.type, "role", ""), flag_of(each), values[str(each.name)]) for each in self.params]
        files, folders = (
            {flag: place for role, flag, place in places if role == kind} for kind in ("written", "folder")
        )
        read = [place if isinstance(place, tuple) else (place,) for role, _, place in places if role == "read"]
        require_places(files, [place for several in read for place in several], folders)
        for each in self.params:
            if each.type is PICTURE:
                require_picture(values[str(each.name)])
        self.function(**self.given(values))

    def given(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the groups of its function with the values of options and the fixed ones."""
        known = {**values, **self.fixed}
        return {
            name: group(**{each.name: known[each.name] for each in fields(group) if each.name in known})
            for name, group in self.groups.items()
        }

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the words of a command line."""
        with augment_usage_errors(ctx):  # a refusal refers to the help of the command, not of the program
            return super().parse_args(ctx, list(self._gathered(args)))

    def _gathered(self, words: list[str]) -> Iterator[str]:
        """Yield the words of a command line, each option joined with its value; a missing value is refused."""
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
        """Write nothing: arguments are listed among the options of their group."""

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
        """Write the examples, long ones continued after a backslash."""
        if self.examples:
            with formatter.section("Examples"):
                for example in self.examples:
                    formatter.write(_continued(f"{ctx.command_path} {example}".rstrip(), formatter.width - 3))


def _continued(line: str, width: int) -> str:
    """Return a command line in indented lines joined by backslashes, broken before options."""
    lines = ["  "]
    for part in _OPTION_BEGINS.split(line):
        if len(lines[-1]) + len(part) > min(width, _EXAMPLE_WIDTH):
            lines += ["     "]
        lines[-1] += f" {part}" if lines[-1].strip() or len(lines) > 1 else part
    return " \\\n".join(lines) + "\n"
