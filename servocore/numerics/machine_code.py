"""Machine code: functions as C, compiled by the C compiler of this machine.

CasADi interprets its expressions, at some nanoseconds per operation. Machine code takes a fifth of that, and a
twentieth where it evaluates eight instants at once, but a compilation takes a tenth of a second to some seconds.
Compiled libraries are kept on disk; see `code_cache`.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca

from servocore.errors import InvalidSetting
from servocore.numerics.code_cache import CodeCache

# This module is imported on use only: a program that solves once needs none of these imports.

COMPILERS = ("cc", "gcc", "clang")
AUTOMATIC = "SERVOCORE_MACHINE_CODE"
"""Environment variable: with "off", functions are compiled only where `native=True` is given."""

# No fused and no reordered operations: results must be those of the interpreter. Without errno the results are the
# same, and square roots can be vectorized.
_OPTIONS = ("-O2", "-fPIC", "-shared", "-ffp-contract=off", "-fno-math-errno")
_OF_THIS_PROCESSOR = "-march=native"
_SECONDS = 900.0


def c_compiler() -> list[str]:
    """Return the command of the C compiler: the variable CC, or the first of `COMPILERS` on the path.

    Returns
    -------
    list of str
        Program and arguments.

    Raises
    ------
    InvalidSetting
        If there is none.
    """
    named = shlex.split(os.environ.get("CC", ""))
    for command in (named, *([compiler] for compiler in COMPILERS)):
        if command and shutil.which(command[0]) is not None:
            return command
    raise InvalidSetting(
        f"machine code needs a C compiler: there is none in the variable CC, and none of {', '.join(COMPILERS)} is on"
        f" the path"
    )


@dataclass(frozen=True)
class Build:
    """A library to be compiled.

    Parameters
    ----------
    source : str
        C source.
    of_what : str
        Name in messages.
    vectors : bool
        Whether to use all instructions of this machine's processor.
    """

    source: str
    of_what: str
    vectors: bool = False

    def options(self) -> tuple[str, ...]:
        """Return the options of the compiler."""
        return (*_OPTIONS, _OF_THIS_PROCESSOR) if self.vectors else _OPTIONS

    def key(self, command: list[str]) -> str:
        """Return a hash of all that the machine code depends on."""
        inputs = (self.source, *command, *compiler_state(command), *self.options())
        machine = (platform.system(), platform.machine(), _processor() if self.vectors else "")
        return hashlib.sha256(repr((inputs, machine)).encode()).hexdigest()[:40]


def compiler_state(command: Sequence[str]) -> tuple[object, ...]:
    """Return the file of a compiler, with its size and its time: another compiler makes other code."""
    tool = Path(shutil.which(command[0]) or command[0]).resolve()
    about = tool.stat() if tool.exists() else None
    return str(tool), about and (about.st_size, about.st_mtime_ns)


def _processor() -> str:
    """Return the features of the processor."""
    with suppress(OSError):
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        for line in text.splitlines():
            if line.startswith(("flags", "Features")):
                return line
    return platform.processor()


def library_of(build: Build) -> Path | None:
    """Return the library of a build from the cache, None if it is not there."""
    try:
        key = build.key(c_compiler())
    except InvalidSetting:
        return None
    return CodeCache.of_user().find(key)


@dataclass(eq=False)
class _Processes:
    """Running compilers, which end with this process."""

    running: set[subprocess.Popen[str]] = field(default_factory=set)
    closed: bool = False

    def run(self, command: list[str], folder: Path) -> tuple[int, str]:
        """Run a compiler; return its exit code and its messages."""
        if self.closed:
            return -1, "this process is ending"
        with subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        ) as process:
            self.running.add(process)
            if self.closed:  # since the test above: `close` may have missed this process
                process.kill()
            try:
                message = process.communicate(timeout=_SECONDS)[1]
            except subprocess.TimeoutExpired:
                process.kill()
                return -1, f"not finished after {_SECONDS:g} s"
            finally:
                self.running.discard(process)
            return process.returncode, message

    def close(self) -> None:
        """Kill all compilers, and start no more."""
        self.closed = True
        for build in list(self.running):
            with suppress(OSError):
                build.kill()


_PROCESSES = _Processes()


def built(build: Build) -> Path:
    """Return the library of a build, from the cache or compiled now.

    It is stored in the cache, or in a temporary folder if the cache cannot be used.

    Raises
    ------
    InvalidSetting
        If there is no C compiler, or it does not compile.
    """
    command = c_compiler()
    key, kept = build.key(command), CodeCache.of_user()
    library = kept.find(key)
    if library is not None:
        return library
    with tempfile.TemporaryDirectory(prefix="servocore_") as name:
        folder = Path(name)
        (folder / "program.c").write_text(build.source, encoding="utf-8")
        compile_in(folder, [*command, *build.options(), "program.c", "-o", "program.so", "-lm"], build.of_what)
        contents = (folder / "program.so").read_bytes()
    path = kept.store(key, contents)
    if path is None:
        path = Path(tempfile.mkdtemp(prefix="servocore_")) / "program.so"
        atexit.register(shutil.rmtree, path.parent, ignore_errors=True)
        path.write_bytes(contents)
    return path


def compile_in(folder: Path, command: Sequence[str], of_what: str) -> None:
    """Run a compiler in a folder; no other function of the library starts one.

    Raises
    ------
    InvalidSetting
        If it cannot be run, does not compile or does not end in time; the message has its first error.
    """
    try:
        code, message = _PROCESSES.run(list(command), folder)
    except OSError as error:
        code, message = -1, str(error)
    if code:
        lines = message.strip().splitlines() or ["no message from the compiler"]
        reason = next((line for line in lines if "error" in line), lines[0])
        raise InvalidSetting(f"{command[0]} does not compile {of_what}: {reason}")


class _Background:
    """Compiles libraries one after the other, each in a thread of its own that waits for its turn."""

    def __init__(self) -> None:
        self._turn, self._starting = threading.Lock(), threading.Lock()
        self._threads: dict[Build, threading.Thread] = {}

    def start(self, build: Build) -> bool:
        """Compile a library in the background, once; return whether that starts now. A failure is not reported."""
        with self._starting:
            if build in self._threads or _PROCESSES.closed:
                return False
            thread = threading.Thread(target=self._build, args=(build,), name="servocore machine code", daemon=True)
            self._threads[build] = thread
            thread.start()
            return True

    def pending(self, build: Build) -> bool:
        """Whether a library waits to be compiled, or is being compiled."""
        thread = self._threads.get(build)
        return thread is not None and thread.is_alive()

    def wait(self) -> None:
        """Wait until all libraries are compiled."""
        for thread in list(self._threads.values()):
            thread.join()

    def end(self) -> None:
        """Kill the compiler and end the threads; waiting threads start no more compilers."""
        _PROCESSES.close()
        self.wait()

    def _build(self, build: Build) -> None:
        with self._turn, suppress(InvalidSetting, OSError):
            built(build)


BACKGROUND = _Background()
atexit.register(BACKGROUND.end)


def automatic() -> bool:
    """Whether functions are compiled in the background without `native=True`."""
    return os.environ.get(AUTOMATIC, "").lower() not in {"off", "no", "0"} and not CodeCache.of_user().refusal()


def compiled(function: ca.Function, of_what: str) -> ca.Function:
    """Compile a function to machine code, or take it from the cache.

    Parameters
    ----------
    function : casadi.Function
        Any that can be written as C.
    of_what : str
        Name in messages.

    Raises
    ------
    InvalidSetting
        If there is no C compiler, or it does not compile.
    """
    return loaded(built(build_of({"function": function}, of_what)), "function")


def build_of(functions: Mapping[str, ca.Function], of_what: str) -> Build:
    """Return the build of functions by name."""
    named = [renamed(function, f"sc_native_{name}") for name, function in functions.items()]
    return Build(code_generator("program", named).dump(), of_what)


def loaded(library: Path, name: str) -> ca.Function:
    """Return the function of a name from a library of `build_of`."""
    return ca.external(f"sc_native_{name}", str(library))


def code_generator(name: str, functions: Iterable[ca.Function], **options: bool | str) -> ca.CodeGenerator:
    """Return CasADi's generator of the C source of functions, in files of a name."""
    generator = ca.CodeGenerator(f"{name}.c", options)
    for function in functions:
        generator.add(function)
    return generator


def renamed(function: ca.Function, name: str) -> ca.Function:
    """Return a function of another name with dense results: names differ in a library, and C bounds their length."""
    arguments = [ca.MX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    return ca.Function(name, arguments, [ca.densify(result) for result in function.call(arguments)])
