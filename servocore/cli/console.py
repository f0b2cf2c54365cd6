"""Shared by the command lines of this project: refusals in one sentence, progress of long runs, tables.

Exit codes: 0 completed; 1 completed, but the inputs are off by half of their peak or more; 2 refused or failed; 130
interrupted by Ctrl-C, each of these with one sentence on the standard error stream; 141 standard output was closed
early. Any other exception is a defect and ends with its traceback.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NoReturn

import click
from click.exceptions import Exit
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from servocore.cli.command import HELP_FLAGS
from servocore.cli.interruption import INTERRUPTED, heeded_interruption, stop_if_interrupted, was_interrupted
from servocore.errors import InvalidSetting, ServocoreError, ServocoreWarning, missing_package
from servocore.files import FULL, MORE_SPACE, write_together

OF_NO_USE, REFUSED, UNREAD = 1, 2, 141
"""Exit codes beside 0 and `INTERRUPTED`; shells report the last one for a program that a closed pipe ends."""

_SECONDS_BETWEEN_STAGES = 5.0  # at least, between lines about stages, without a terminal

WIDE = 120
"""Width in columns of tables that do not go to a terminal."""

FORMER = {
    "-v": "-v is --verbose of feedforward; the version is printed by --version or -V",
    "levels": "levels is a benchmark: python -m benchmarks.levels SCENE, in a clone of the project",
    "--by": "--by is --via since version 0.3",
    "--parts": "--parts is --clearance-of since version 0.3",
    "--path": "--path is --write-path since version 0.3",
}
"""Refusals of commands and options of former versions."""

ON_THE_COMMAND_LINE = {
    r"clearance_of=\('load',\)": "--clearance-of load",
    r"give plants of your own: plant=dict\(name=factory\)": "a scene of your own may declare some",
    r"; points take a higher rest_order": ": use --from, --to and --duration",
    r"waypoints_from_csv": "--waypoints",
    r"solve without a form and a method": "without --formulation and --method",
    r"(the method |solve with )?StableInversion": "feedforward without --formulation and --method",
    r"Reduced(\(\))? with a method": "--formulation reduced with a --method",
    r"(the form )?Reduced\(\)|Reduced(?=:)": "--formulation reduced",
    r"sc\.solve": "feedforward",
    r"solve with RadauIIA": "feedforward --method radau3",
    r"resume=True \(--resume\)": "--resume",
}
"""Advice for Python in sentences of the library, as regular expressions, and the same for the command line."""

_WIDEST_HELP = 160
_CODES = (
    "Exit code 0: completed. Exit code 1: completed, but the inputs are off by 50 % of their peak or more; one sentence"
    " on the error stream names the worst. Exit code 2: refused, with one sentence on the error stream and no file."
    " Exit code 130: stopped by Ctrl-C."
)


class ResultOfNoUse(Exception):
    """Results are written, but of no use; the sentence says why, and the process ends with `OF_NO_USE`."""


class CommandLine(click.Group):
    """A group of commands, in the order of the help, that prints refusals as one sentence, and exits with code 2."""

    def __init__(self, name: str, help: str, commands: Sequence[click.Command]) -> None:  # noqa: A002
        settings = {"help_option_names": list(HELP_FLAGS), "max_content_width": _WIDEST_HELP}
        super().__init__(
            name, list(commands), help=help, epilog=_CODES, no_args_is_help=False, context_settings=settings
        )
        version = {"package_name": "servocore", "message": "servocore %(version)s", "help": "Print the version."}
        click.version_option(None, "--version", "-V", **version)(self)

    def main(
        self, args: Sequence[str] | None = None, prog_name: str | None = None, *_: object, **settings: Any
    ) -> NoReturn:
        """Run the command line and end the process; Click's own would print errors in another form."""
        if sys.stderr is None:  # closed: print takes no stream for the standard output stream, and tables go there
            sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - open as long as the process
        with _held_notes() as notes, heeded_interruption():
            words = sys.argv[1:] if args is None else list(args)
            code, sentence = self._outcome(words, prog_name or self.name or "", settings)
        if code == OF_NO_USE:
            notes.clear()  # the sentence suffices
        for line in [*(f"note: {note}" for note in notes), *([sentence] if sentence else [])]:
            print(f"{self.name}: {line}", file=sys.stderr)
        sys.exit(code)

    def _outcome(self, words: list[str], name: str, settings: Mapping[str, Any]) -> tuple[int, str]:
        """Run a command; return its exit code, and the sentence about the failure or interruption, empty without."""
        code, sentence = 0, ""
        try:
            with self.make_context(name, words, **settings) as ctx:
                self.invoke(ctx)
            if sys.stdout is not None:  # the stream may be closed
                sys.stdout.flush()  # an error of the stream is refused here, not at the interpreter's end
        except Exit as end:
            code = end.exit_code
        except BrokenPipeError:  # the reader of standard output, such as head, has closed it
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what the interpreter still flushes
            code = UNREAD
        except KeyboardInterrupt as error:
            code, sentence = INTERRUPTED, str(error) or "stopped"
        except ResultOfNoUse as error:
            code, sentence = OF_NO_USE, str(error)
        except Exception as error:
            code, sentence = (INTERRUPTED, "stopped") if was_interrupted() else (REFUSED, self._refusal(error))
            if not sentence:
                raise
        return code, sentence

    def _refusal(self, error: Exception) -> str:
        """Return the sentence about an error, empty where it is a defect."""
        if isinstance(error, ModuleNotFoundError):
            error = missing_package(error) or error
        if isinstance(error, OSError):
            sentence = _machine_error(error)
        elif isinstance(error, click.UsageError):
            sentence = self._misused(error)
        else:
            sentence = str(error) if isinstance(error, ServocoreError) else ""
        return advised_here(" ".join(sentence.split()))

    def _misused(self, error: click.UsageError) -> str:
        """Return the sentence about a command line that Click does not take."""
        message = (error.message or error.format_message()).rstrip(".")
        words = message.replace("'", " ").split()
        for former, now in FORMER.items():
            if former in words:
                return now
        near = [each for each in getattr(error, "possibilities", None) or () if each != "--help"]
        meant = f"; did you mean {' or '.join(near)}" if near else ""
        command = error.ctx.command_path if error.ctx else self.name
        return f"{message[:1].lower()}{message[1:]}{meant}; see {command} --help"

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of the commands, in their order."""
        return list(self.commands)


@contextmanager
def _held_notes() -> Iterator[list[str]]:
    """Collect the library's warnings as sentences; those of others stay as they are."""
    notes: list[str] = []
    with warnings.catch_warnings(action="always", category=ServocoreWarning):
        others = warnings.showwarning

        def hold(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, ServocoreWarning):
                notes.append(advised_here(str(message)))
            else:
                others(message, category, *place, **more)

        warnings.showwarning = hold
        yield notes


def advised_here(sentence: str) -> str:
    """Return a sentence of the library with its advice for the command line."""
    for python, here in ON_THE_COMMAND_LINE.items():
        sentence = re.sub(python, here, sentence)
    return sentence


def _machine_error(error: OSError) -> str:
    """Return the sentence about an error of the machine, such as a full disk; empty for any other."""
    if error.errno in FULL:
        return f"a disk is full, that of the output or that of TMPDIR: {MORE_SPACE} ({error.strerror})"
    if isinstance(error, FileNotFoundError) and error.filename is None:  # as `os.getcwd` and `tempfile` raise it
        try:
            Path.cwd()
        except FileNotFoundError:
            return "the current folder no longer exists: change into another"
        return f"{error.strerror}: let TMPDIR name a folder that can be written"
    return ""


class PatientProgress(AbstractContextManager["PatientProgress"]):
    """Progress on the error stream, after a second: a bar on a terminal, else a line each tenth, and some stages.

    Every report raises `KeyboardInterrupt` for a Ctrl-C that a library has swallowed.
    """

    def __init__(self, label: str) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task(label, total=None)
        self._tenth, self._printed = 0, 0.0

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` steps are done."""
        tenth = 10 * done // max(total, 1)
        if self._tenth < tenth < 10 and self._slow():
            remaining = self._elapsed * (total - done) / done
            self._print(f"{self._progress.tasks[0].description}: {10 * tenth} %, {remaining:.0f} s left")
        self._tenth = tenth
        self._update(completed=done, total=total)

    def describe(self, label: str) -> None:
        """Show another stage."""
        if self._slow() and self._elapsed - self._printed > _SECONDS_BETWEEN_STAGES:
            self._print(label)
        self._update(description=label)

    @property
    def _elapsed(self) -> float:
        return self._progress.tasks[0].elapsed or 0.0

    def _slow(self) -> bool:
        return self._elapsed > 1.0

    def _print(self, line: str) -> None:
        if not self._progress.console.is_terminal:
            self._printed = self._elapsed
            print(line, file=sys.stderr)

    def _update(self, **changes: Any) -> None:
        stop_if_interrupted()
        if self._progress.console.is_terminal and self._slow():
            self._progress.start()  # has no effect once started
        self._progress.update(self._task, **changes)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._progress.live.is_started:
            self._progress.stop()
        if kind is None:
            stop_if_interrupted()


class _PipeConsole(Console):
    """A console whose `BrokenPipeError` is handled by `CommandLine`; Rich's own ends the process with 1."""

    def on_broken_pipe(self) -> None:
        """Raise the error that Rich has caught."""
        raise BrokenPipeError


def table_console() -> Console:
    """Return the console of the standard output stream, wide enough for tables where it is no terminal."""
    console = _PipeConsole()
    if not console.is_terminal:
        console.width = max(console.width, WIDE)
    return console


def deliver(table: Iterable[str], output: Path | None, beside: Mapping[Path, str | bytes], report: object = "") -> None:
    """Write a table, in pieces, to the file `output`, or to the standard output stream if that is None.

    The files `beside` appear together with it; the report is printed where the table goes into a file. `InvalidSetting`
    is raised if the stream cannot take the table, for example because the disk is full or the stream is closed.
    """
    write_together(beside if output is None else {**beside, output: table})
    if output is not None:
        print(report, end="\n" if report else "")
        return
    if sys.stdout is None:
        raise InvalidSetting("cannot write to the standard output stream: it is closed; name a file with --output")
    try:
        sys.stdout.writelines(table)
        sys.stdout.flush()
    except BrokenPipeError:
        raise  # the reader has closed the stream: no error
    except OSError as error:
        raise InvalidSetting(f"cannot write to the standard output stream: {error.strerror or error}") from error
