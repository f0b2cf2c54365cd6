"""What command lines of this project share: refusals in one sentence, a progress bar that waits, tables.

Exit codes: 0 when everything asked for was done; 1 when it was done and is of no use, 2 when it was not done, 130 when
Ctrl-C stopped it, each with one sentence on the standard error stream; 141, without one, where nobody reads what is
written any more. Whatever else is raised is a defect and ends
with its traceback.
"""

from __future__ import annotations

import os
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
from servocore.cli.interruption import INTERRUPTED, heeded_interruption, stop_if_asked, was_asked
from servocore.errors import InvalidSetting, ServocoreError, ServocoreWarning, missing_package
from servocore.files import FULL, MORE_SPACE, write_together

OF_NO_USE, REFUSED, UNREAD = 1, 2, 141
"""Exit codes beside 0 and `INTERRUPTED`; the last is what shells report of a program that a closed pipe ends."""

_STAGES_APART = 5.0  # seconds between lines that say what goes on, where no terminal shows a bar

WIDE = 120
"""Columns of text for tables that do not go to a terminal."""


_RENAMED = {"--by": "--via", "--parts": "--clearance-of", "--path": "--write-path"}
"""Options of version 0.2 that have other names now."""

ON_THE_COMMAND_LINE = {
    "plan with clearance_of=('load',)": "plan with --clearance-of load",
    "give plants of your own: plant=dict(name=factory)": "a scene of your own may declare some",
    ", points take a higher rest_order": ": use --from, --to and --duration",
    "waypoints, which waypoints_from_csv reads": "waypoints, which --waypoints reads",
    "the default route, solve without a form and a method,": "the default, without --formulation and --method,",
    "the method StableInversion finds the bounded solution": "without --formulation and --method the bounded solution"
    " is found",
    "StableInversion: forward in time": "feedforward without --formulation and --method: forward in time",
    "leave its horizon to StableInversion, with a smaller tolerance": "StableInversion in Python has a smaller"
    " tolerance",
    "Reduced: the inputs follow": "feedforward without --formulation: the inputs follow",
    "Reduced with a method that integrates": "feedforward --formulation reduced, with a --method that integrates",
    "Reduced() with a method computes": "--formulation reduced with a --method computes",
    "such as Reduced()": "such as --formulation reduced",
    "use the form Reduced()": "use --formulation reduced",
    "in the form Reduced()": "with --formulation reduced",
    "sc.solve steps them": "feedforward steps them",
    "solve with RadauIIA steps them": "feedforward --method radau3 steps them",
    "solve with StableInversion bounds them": "feedforward without --formulation and --method bounds them",
    "resume=True (--resume) does": "--resume does",
}
"""What sentences of the library advise in Python, and what the same is here."""

_WIDEST_HELP = 160
_CODES = (
    "Exit code 0: done. Exit code 1: done, but the result is of no use, as one sentence on the error stream says. Exit"
    " code 2: refused, with one sentence on the error stream and no file. Exit code 130: stopped by Ctrl-C."
)


class CommandLine(click.Group):
    """A group of commands that ends refusals with one plain sentence, which its name opens, and exit code 2.

    Parameters
    ----------
    name : str
        What it is called.
    help : str
        What it is for.
    commands : sequence of click.Command
        In the order of the help.
    former : mapping of str to str, optional
        What to say of commands and options that there once were.
    """

    def __init__(
        self,
        name: str,
        help: str,  # noqa: A002
        commands: Sequence[click.Command],
        former: Mapping[str, str] | None = None,
    ) -> None:
        settings = {"help_option_names": list(HELP_FLAGS), "max_content_width": _WIDEST_HELP}
        super().__init__(
            name, list(commands), help=help, epilog=_CODES, no_args_is_help=False, context_settings=settings
        )
        told = {"package_name": "servocore", "message": "servocore %(version)s", "help": "Print the version and end."}
        click.version_option(None, "--version", "-V", **told)(self)
        verbose = "-v is --verbose, behind a command; the version is told by --version or -V"
        self.former = {"-v": verbose, **(former or {})}

    def main(
        self, args: Sequence[str] | None = None, prog_name: str | None = None, *_: object, **settings: Any
    ) -> NoReturn:
        """Run the command line and end the process; Click's own would tell of errors in its way."""
        if sys.stderr is None:  # closed: print takes no stream for the standard output stream, and tables go there
            sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - open as long as the process
        with self._notes_on_the_error_stream(), heeded_interruption():
            sys.exit(self._code(sys.argv[1:] if args is None else list(args), prog_name or self.name or "", settings))

    def _code(self, words: list[str], name: str, settings: Mapping[str, Any]) -> int:
        """Run a command; return its exit code, and say in one sentence what stopped or refused it."""
        try:
            with self.make_context(name, words, **settings) as ctx:
                self.invoke(ctx)
            if sys.stdout is not None:  # the stream may be closed
                sys.stdout.flush()  # what it cannot take is refused, not left for the interpreter's end
        except Exit as end:
            return end.exit_code
        except BrokenPipeError:  # whoever reads the standard output stream, such as head, wants no more
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what the interpreter still flushes
            return UNREAD
        except KeyboardInterrupt as error:
            sentence, code = str(error) or "stopped", INTERRUPTED
        except Exception as error:
            sentence, code = ("stopped", INTERRUPTED) if was_asked() else (self._refusal(error), REFUSED)
            if not sentence:
                raise
        else:
            return 0
        print(f"{self.name}: {sentence}", file=sys.stderr)
        return code

    def _refusal(self, error: Exception) -> str:
        """Return what is told of an error, empty where it is a defect."""
        if isinstance(error, ModuleNotFoundError):
            error = missing_package(error) or error
        if isinstance(error, OSError):
            sentence = _hindered(error)
        elif isinstance(error, click.UsageError):
            sentence = self._misused(error)
        else:
            sentence = str(error) if isinstance(error, ServocoreError) else ""
        return advised_here(" ".join(sentence.split()))

    def _misused(self, error: click.UsageError) -> str:
        """Return what to say of a command line that Click does not take."""
        message = (error.message or error.format_message()).rstrip(".")
        words = message.replace("'", " ").split()
        if isinstance(error, click.NoSuchOption) and error.option_name in _RENAMED:
            return f"{error.option_name} is {_RENAMED[error.option_name]} since version 0.3"
        for name, now in self.former.items():
            if error.ctx is not None and error.ctx.command is self and name in words:
                return now
        near = [each for each in getattr(error, "possibilities", None) or () if each != "--help"]
        meant = f"; did you mean {' or '.join(near)}" if near else ""
        asked = error.ctx.command_path if error.ctx else self.name
        return f"{message[:1].lower()}{message[1:]}{meant}; see {asked} --help"

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the names of the commands, in their order."""
        return list(self.commands)

    @contextmanager
    def _notes_on_the_error_stream(self) -> Iterator[None]:
        """Print the library's warnings as plain lines; those of others stay as they are."""
        with warnings.catch_warnings():
            others = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
                if issubclass(category, ServocoreWarning):
                    print(f"{self.name}: note: {advised_here(str(message))}", file=sys.stderr)
                else:
                    others(message, category, *place, **more)

            warnings.showwarning = show
            warnings.simplefilter("always", ServocoreWarning)
            yield


def advised_here(sentence: str) -> str:
    """Return a sentence of the library with its advice for the command line."""
    for python, here in ON_THE_COMMAND_LINE.items():
        sentence = sentence.replace(python, here)
    return sentence


def _hindered(error: OSError) -> str:
    """Return what to tell of an error that lies in the machine, such as a full disk; empty for any other."""
    if error.errno in FULL:
        return f"a disk is full, that of the output or that of TMPDIR: {MORE_SPACE} ({error.strerror})"
    if isinstance(error, FileNotFoundError) and error.filename is None:  # as `os.getcwd` and `tempfile` raise it
        try:
            Path.cwd()
        except FileNotFoundError:
            return "the present folder is gone: change into one that is there"
        return f"{error.strerror}: let TMPDIR name a folder that can be written"
    return ""


@contextmanager
def held_notes() -> Iterator[list[warnings.WarningMessage]]:
    """Hold the warnings inside back and give them on at the end, but for those removed from the list."""
    notes: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always", ServocoreWarning)
            yield notes
    finally:
        for note in notes:
            warnings.warn_explicit(note.message, note.category, note.filename, note.lineno)


def end_as_of_no_use(sentence: str) -> NoReturn:
    """End the present command, whose results are written but of no use, with a sentence that says so."""
    print(f"{click.get_current_context().find_root().command.name}: {sentence}", file=sys.stderr)
    raise Exit(OF_NO_USE)


class PatientProgress(AbstractContextManager["PatientProgress"]):
    """Progress on the error stream, after a second: a bar on a terminal, else a line each tenth, and stages at times.

    Every report heeds a Ctrl-C that a library has swallowed.
    """

    def __init__(self, label: str) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task(label, total=None)
        self._tenth, self._told = 0, 0.0

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` steps are done."""
        tenth = 10 * done // max(total, 1)
        if self._tenth < tenth < 10 and self._slow():
            left = self._elapsed * (total - done) / done
            self._tell(f"{self._progress.tasks[0].description}: {10 * tenth} %, {left:.0f} s left")
        self._tenth = tenth
        self._update(completed=done, total=total)

    def describe(self, label: str) -> None:
        """Change what is said to be going on."""
        if self._slow() and self._elapsed - self._told > _STAGES_APART:
            self._tell(label)
        self._update(description=label)

    @property
    def _elapsed(self) -> float:
        return self._progress.tasks[0].elapsed or 0.0

    def _slow(self) -> bool:
        return self._elapsed > 1.0

    def _tell(self, line: str) -> None:
        if not self._progress.console.is_terminal:
            self._told = self._elapsed
            print(line, file=sys.stderr)

    def _update(self, **changes: Any) -> None:
        stop_if_asked()
        if self._progress.console.is_terminal and self._slow():
            self._progress.start()  # once more does nothing
        self._progress.update(self._task, **changes)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._progress.live.is_started:
            self._progress.stop()
        if kind is None:
            stop_if_asked()


class _PipeConsole(Console):
    """A console that leaves a pipe which nobody reads to `CommandLine`; Rich's own ends the process with 1."""

    def on_broken_pipe(self) -> None:
        """Raise what Rich has caught."""
        raise BrokenPipeError


def table_console() -> Console:
    """Return the console of the standard output stream, wide enough for tables where it is no terminal."""
    console = _PipeConsole()
    if not console.is_terminal:
        console.width = max(console.width, WIDE)
    return console


def deliver(table: Iterable[str], output: Path | None, beside: Mapping[Path, str | bytes], report: object = "") -> None:
    """Write a table where it is wanted, and what goes beside it.

    Parameters
    ----------
    table : iterable of str
        Its pieces, for the file `output`, or for the standard output stream if that is None.
    output : Path or None
        Where the table goes.
    beside : mapping of Path to str or bytes
        Other files, which appear together with it.
    report : object
        Printed where the table went into a file.

    Raises
    ------
    InvalidSetting
        If the stream cannot take it, for example because the disk is full or the stream is closed.
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
        raise  # whoever reads has seen enough
    except OSError as error:
        raise InvalidSetting(f"cannot write to the standard output stream: {error.strerror or error}") from error
