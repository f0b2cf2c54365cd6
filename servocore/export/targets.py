"""Compilers and platforms: names and folders of the libraries in an FMU, and how they are built."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import struct
import sys
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import cast

from servocore.errors import InvalidSetting, install
from servocore.numerics.code_cache import CodeCache
from servocore.numerics.machine_code import c_compiler, compile_in, compiler_state

Progress = Callable[[str], None]

# No fused and no reordered operations: results are equal to the bit on all platforms.
# The functions of a shared library have no prefix; see model.h.
_OPTIONS = ("-std=c99", "-fPIC", "-fvisibility=hidden", "-ffp-contract=off", "-DCASADI_SYMBOL_EXPORT=", "-w",
            "-DFMI2_OVERRIDE_FUNCTION_PREFIX", "-DFMI3_OVERRIDE_FUNCTION_PREFIX")  # fmt: skip
_FULL, _LIGHT = "-O3", "-O1"
_LINKED = {"so": ("-Wl,--as-needed", "-lm", "-ldl"), "dylib": ("-lm",), "dll": ()}
_LINKED_BY_ZIG = {"dll": ("-Wl,/Brepro",)}  # a hash of the content in place of the date: equal sources give equal bytes
# Compilers write the frames of all functions beside an object; zig does so by an option of clang alone.
_FRAMES = ("-fstack-usage",)
_FRAMES_OF_ZIG = ("-Xclang", "-stack-usage-file", "-Xclang")
_SLICE_ALIGNMENT = 14  # 2^14, the pages of arm64 macOS


@dataclass(frozen=True)
class Target:
    """One platform.

    Attributes
    ----------
    name : str
        Its name in FMI 3.
    fmi2 : str
        Its name in FMI 2; empty where there is none.
    triple : str
        Its name in zig.
    ending : str
        File ending of its shared libraries.
    """

    name: str
    fmi2: str
    triple: str
    ending: str

    def folder(self, fmi: int) -> str:
        """Folder of the library within an FMU."""
        return f"binaries/{self.name if fmi == 3 else self.fmi2}"


TARGETS: Mapping[str, Target] = {
    each.name: each
    for each in (
        Target("x86_64-linux", "linux64", "x86_64-linux-gnu.2.17", "so"),
        Target("aarch64-linux", "", "aarch64-linux-gnu.2.17", "so"),
        Target("x86_64-windows", "win64", "x86_64-windows-gnu", "dll"),
        Target("aarch64-windows", "", "aarch64-windows-gnu", "dll"),
        Target("x86_64-darwin", "darwin64", "x86_64-macos", "dylib"),
        Target("aarch64-darwin", "darwin64", "aarch64-macos", "dylib"),
    )
}
"""All platforms, by their name in FMI 3."""


@dataclass(frozen=True)
class Library:
    """A shared library.

    Attributes
    ----------
    content : bytes
        Its file.
    stack : int or None
        Sum of the frames of all its functions in bytes: an upper bound, since none is recursive, without those of the
        C library that it calls. None where the compiler does not report them.
    """

    content: bytes
    stack: int | None


HOST, NONE = "host", "none"
"""This machine's own platform, and no platform: an FMU with sources only."""


def host() -> str:
    """Return the name of this machine's platform."""
    machine = platform.machine().lower().replace("amd64", "x86_64").replace("arm64", "aarch64")
    system = {"win32": "windows"}.get(sys.platform, sys.platform)
    return f"{machine}-{system}"


def zig() -> list[str] | None:
    """Return the command of the cross compiler, or None if the package ziglang is not installed."""
    return [sys.executable, "-m", "ziglang"] if importlib.util.find_spec("ziglang") is not None else None


def chosen_targets(targets: str | None, fmi: int) -> tuple[str, ...]:
    """Return the names of platforms to build for.

    Parameters
    ----------
    targets : str, optional
        ``all``, ``host``, ``none``, or names with commas between them. When not given: all where the package ziglang is
        installed, else this machine's own.
    fmi : int
        Version of FMI; the second has fewer platforms.

    Raises
    ------
    InvalidSetting
        If a name is unknown, or needs the package ziglang where it is not installed.
    """
    known = [name for name, target in TARGETS.items() if fmi == 3 or target.fmi2]
    if targets is None:
        targets = "all" if zig() else HOST
    if targets == NONE:
        return ()
    labels, groups = [label.strip() for label in targets.split(",")], {"all": known, HOST: [host()]}
    names = [name for label in labels for name in groups.get(label, [label])]
    for name in names:
        if name not in known:
            raise InvalidSetting(f"FMI {fmi} has no platform {name!r}; there are {', '.join(known)}, all and {HOST}")
    foreign = [name for name in names if name != host()]
    if foreign and zig() is None:
        raise InvalidSetting(
            f"building for {', '.join(foreign)} needs the package ziglang: {install('native')}, or use --targets {HOST}"
        )
    return tuple(dict.fromkeys(names))


def libraries(
    sources: Mapping[str, str],
    files: Sequence[str],
    identifier: str,
    targets: Sequence[str],
    fmi: int,
    progress: Progress = lambda _: None,
    large: Collection[str] = (),
) -> dict[str, Library]:
    """Build the shared libraries of an FMU, with objects that were compiled before from the cache.

    Parameters
    ----------
    sources : mapping of str to str
        All texts by file name.
    files : sequence of str
        The files to compile.
    identifier : str
        Name of the libraries.
    targets : sequence of str
        Platforms. This machine's own alone is built by its own compiler, where there is one, with the options of the
        variable CFLAGS; anything else by zig, whose libraries run on older systems too.
    fmi : int
        Version of FMI.
    progress : callable
        Called with a phrase for every platform.
    large : collection of str
        Files that are compiled with fewer optimizations, since they would take a minute.

    Returns
    -------
    dict of str to Library
        By their path in the FMU.

    Raises
    ------
    InvalidSetting
        If there is no compiler, or it does not compile.
    """
    found, compiled = dict[str, list[Library]](), list[tuple[_Compiler, list[Future[str]]]]()
    cross = zig()
    if tuple(targets) == (host(),):
        with suppress(InvalidSetting):
            cross = None if c_compiler() else cross
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        for name in targets:
            target = TARGETS[name]
            command = [*cross, "cc", "-target", target.triple, "-s"] if cross else c_compiler()
            own = () if cross else tuple(shlex.split(os.environ.get("CFLAGS", "")))
            compiler = _Compiler(Path(folder), target, command, own)
            compiled.append((compiler, [pool.submit(compiler.object_of, file, sources, large) for file in files]))
        for compiler, objects in compiled:
            progress(f"compiling for {compiler.target.name}")
            place = f"{compiler.target.folder(fmi)}/{identifier}.{compiler.target.ending}"
            found.setdefault(place, []).append(compiler.linked([each.result() for each in objects]))
    return {place: parts[0] if len(parts) == 1 else universal(parts) for place, parts in found.items()}


@dataclass(frozen=True)
class _Compiler:
    """The compiler for a platform, with a folder of source files."""

    folder: Path
    target: Target
    command: Sequence[str]
    own: tuple[str, ...]

    @property
    def _is_zig(self) -> bool:
        return "ziglang" in self.command

    def object_of(self, file: str, sources: Mapping[str, str], large: Collection[str]) -> str:
        """Compile a file, and return the name of the object file, beside which lie the frames of its functions."""
        made, level = f"{file}.{self.target.name}.o", _LIGHT if file in large else _FULL
        frames = [*_FRAMES_OF_ZIG, self._frames(made).name] if self._is_zig else _FRAMES
        options = [*_OPTIONS, level, *self.own, "-c", *frames, file, "-o", made]
        self._make([made, self._frames(made).name], options, _texts(file, sources))
        return made

    def _frames(self, made: str) -> Path:
        return (self.folder / made).with_suffix(".su")

    def linked(self, objects: Sequence[str]) -> Library:
        """Join object files to a library."""
        result = f"library.{self.target.ending}"
        digests = [hashlib.sha256((self.folder / each).read_bytes()).hexdigest() for each in objects]
        options = (*_LINKED[self.target.ending], *(_LINKED_BY_ZIG.get(self.target.ending, ()) if self._is_zig else ()))
        self._make([result], ["-shared", *self.own, *objects, "-o", result, *options], digests)
        frames = [self._frames(each).read_text(encoding="utf-8").splitlines() for each in objects]
        rows = [line.split("\t") for lines in frames for line in lines]  # function, bytes, kind
        bounded = all(frames) and all(kind != "dynamic" for *_, kind in rows)
        stack = sum(int(size) for _, size, _ in rows) if bounded else None
        return Library((self.folder / result).read_bytes(), stack)

    def _make(self, results: Sequence[str], options: Sequence[str], inputs: Sequence[str]) -> None:
        """Let the compiler make files, or take what it made of the same inputs before from the cache."""
        version = metadata.version("ziglang") if self._is_zig else ""
        content = (version, *compiler_state(self.command), *self.command, *options, *inputs)
        key, kept = hashlib.sha256(repr(content).encode()).hexdigest()[:40], CodeCache.of_user()
        parts = {f"{k}-{key}": self.folder / name for k, name in enumerate(results)}
        found = {name: kept.find(name) for name in parts}
        if all(found.values()):
            for name, place in found.items():
                parts[name].write_bytes(cast("Path", place).read_bytes())
            return
        compile_in(self.folder, [*self.command, *options], f"the FMU for {self.target.name}")
        for name, place in parts.items():
            place.touch()  # the compiler may report no frames
            kept.store(name, place.read_bytes())


def _texts(file: str, sources: Mapping[str, str]) -> list[str]:
    """Return the text of a file, and all headers if it includes any of ours: a macro may be one of their names."""
    headers = [name for name in sorted(sources) if name.endswith(".h") and '#include "' in sources[file]]
    return [sources[file], *(text for name in headers for text in (name, sources[name]))]


def universal(slices: Sequence[Library]) -> Library:
    """Join Mach-O files of several processors into one, behind a fat header."""
    step = 1 << _SLICE_ALIGNMENT
    header, body, offset = struct.pack(">II", 0xCAFEBABE, len(slices)), b"", step
    for binary in (each.content for each in slices):
        processor, kind = struct.unpack_from("<II", binary, 4)
        header += struct.pack(">IIIII", processor, kind, offset, len(binary), _SLICE_ALIGNMENT)
        padded = binary + bytes(-len(binary) % step)
        body, offset = body + padded, offset + len(padded)
    stack = max((each.stack for each in slices if each.stack is not None), default=None)
    return Library(header + bytes(step - len(header)) + body, stack)
