"""Files that are written completely or not at all, by the library and its command lines."""

from __future__ import annotations

import errno
import io
import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidSetting, require_package

PICTURES = (".png", ".svg", ".pdf")
"""Endings of figure files."""

FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))
"""Error numbers of a full disk."""

MORE_SPACE = "free some space"
"""Remedy for a full disk."""

_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the first date of the ZIP format
_ROWS = 4096  # of a piece
_TRIAL = 4096  # bytes: a full disk still takes an empty file
_NOT_IN_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def csv_text(names: Sequence[str], columns: Sequence[npt.NDArray[np.float64]]) -> str:
    """Return a table as the text of a CSV file; every number with the digits that restore it exactly.

    Parameters
    ----------
    names : sequence of str
        Header.
    columns : sequence of ndarray, shape (n,) or (n, k)
        Columns, or groups of columns.
    """
    return "".join(csv_pieces(names, columns))


def csv_pieces(names: Sequence[str], columns: Sequence[npt.NDArray[np.float64]]) -> Iterator[str]:
    """Yield the text of `csv_text` in pieces: a text of millions of rows would fill the memory."""
    yield ",".join(names) + "\n"
    for first in range(0, len(columns[0]), _ROWS):
        rows = np.column_stack([column[first : first + _ROWS] for column in columns])
        line = ",".join(["%r"] * rows.shape[1]) + "\n"
        yield line * len(rows) % tuple(rows.ravel().tolist())  # a fifth faster than the repr of lists


Columns = Mapping[str, npt.NDArray[np.float64]]
"""Signals by name, the time among them."""


def cross_check_texts(
    stem: str, inputs: Columns | None, results: Columns | None, times: tuple[float, float, float]
) -> dict[str, str]:
    """Return the files beside an FMU as the FMI project keeps them, ``_in.csv``, ``_ref.csv`` and ``_ref.opt``.

    Parameters
    ----------
    stem : str
        Beginning of the names of the files.
    inputs, results : mapping of str to ndarray, or None
        Inputs and outputs of the FMU in that run, by the names of its variables, `time` first; None for none. The
        components of a vector, shape (n, k), have one cell with blanks between them.
    times : tuple of float
        Start and end of that run, and its communication step, in s.
    """
    names = ("StartTime", "StopTime", "StepSize", "RelTol", "OutputIntervalLength")
    options = zip(names, (*times, 0.0, times[2]), strict=True)
    tables = {"in": inputs, "ref": results}
    texts = {
        f"{stem}_{kind}.csv": "".join(
            ",".join(row) + "\n" for row in zip(*(_cells(*each) for each in table.items()), strict=True)
        )
        for kind, table in tables.items()
        if table is not None
    }
    return texts | {f"{stem}_ref.opt": "".join(f"{name},{value!r}\n" for name, value in options)}


def _cells(name: str, values: npt.NDArray[np.float64]) -> list[str]:
    """Return the cells of a variable's column, its name first."""
    return [f'"{name}"', *(" ".join(map(repr, row)) for row in values.reshape(len(values), -1).tolist())]


def figure_file(figure: Any, suffix: str) -> bytes:
    """Return a figure of Matplotlib as the content of a file that ends so, the same bytes in every run."""
    stream = io.BytesIO()
    metadata = {".png": "Software", ".svg": "Date", ".pdf": "CreationDate"}[suffix]
    figure.savefig(stream, format=suffix[1:], metadata={metadata: None})
    return stream.getvalue()


def require_picture(file: Path | None) -> None:
    """Raise `InvalidSetting` if a figure cannot be drawn: the ending is not in `PICTURES`, or Matplotlib is missing."""
    if file is None:
        return
    if file.suffix.lower() not in PICTURES:
        raise InvalidSetting(f"cannot draw {file}: the name must end in {', '.join(PICTURES)}")
    require_package("matplotlib")


def require_places(
    results: Mapping[str, Path | None],
    sources: Iterable[Path | None] = (),
    folders: Mapping[str, Path | None] = MappingProxyType({}),
) -> None:
    """Refuse, before the work, results that cannot be written.

    Parameters
    ----------
    results : mapping of str to Path or None
        File of each option; None where it was not given.
    sources : iterable of Path or None
        Files that are read and must not be overwritten.
    folders : mapping of str to Path or None
        Folders that options name, which must not be files of others.

    Raises
    ------
    InvalidSetting
        If two options name one file, or a file is read as well, is a folder, or its folder cannot be written.
    """
    wanted = {option: file for option, file in results.items() if file is not None}
    read = {_place(file) for file in sources if file is not None}
    taken = {_place(folder): option for option, folder in folders.items() if folder is not None}
    for option, file in wanted.items():
        other = taken.setdefault(_place(file), option)
        if other != option:
            raise InvalidSetting(f"{other} and {option} both name {file}")
        if _place(file) in read:
            raise InvalidSetting(f"cannot write {file}: it is read as well")
        _require_file(file)


def _require_file(file: Path) -> None:
    if file == Path("-"):  # other programs take it for the standard output stream
        raise InvalidSetting("cannot write -: name a file; without a file, tables go to the standard output stream")
    folder = _place(file).parent
    try:
        if file.is_dir():
            raise InvalidSetting(f"cannot write {file}: it is a folder; name a file")
        if file.exists() and not file.is_file():
            raise InvalidSetting(f"cannot write {file}: it is no ordinary file")
        if not folder.exists():
            raise InvalidSetting(f"cannot write {file}: there is no folder {file.parent}; make it first")
    except OSError as error:  # a folder without permission to read, a name that is too long
        raise not_written(file, error) from None
    require_writable(folder, file)


def require_writable(folder: Path, wanted: Path) -> None:
    """Refuse a folder that cannot be written; of one that does not exist the nearest existing parent is tried.

    Parameters
    ----------
    folder : Path
        The folder; a temporary file is written there, or in its parent.
    wanted : Path
        Result named in the refusal.

    Raises
    ------
    InvalidSetting
        If it cannot be made or written into, as below a file, without permission or on a full disk.
    """
    import tempfile  # noqa: PLC0415 - few programs write files

    place = _place(folder)
    try:
        around = next(folder for folder in (place, *place.parents) if folder.exists() or folder.is_symlink())
        if not around.is_dir():
            named = f"{around} is" if around != _place(wanted) else "it is"
            raise InvalidSetting(f"cannot write {wanted}: {named} a file, not a folder; name another place")
        with tempfile.TemporaryFile(dir=around) as trial:
            trial.write(bytes(_TRIAL))
    except OSError as error:
        raise not_written(wanted, error) from None


def not_written(place: Path, error: OSError) -> InvalidSetting:
    """Return the refusal for a file or a folder whose writing failed, with a remedy.

    Parameters
    ----------
    place : Path
        File or folder.
    error : OSError
        The error.
    """
    remedy = f"{MORE_SPACE}, or name another place" if error.errno in FULL else "name another place"
    return InvalidSetting(f"cannot write {place}: {error.strerror or error}; {remedy}")


def _place(file: Path) -> Path:
    """Return the real path of a file; `Path.resolve` fails where symbolic links go in a circle."""
    return Path(os.path.realpath(file))


@contextmanager
def made_folder(folder: Path, wanted: Path) -> Iterator[None]:
    """Make a folder and its parents; those that were made and are empty at the end are removed.

    Parameters
    ----------
    folder : Path
        The folder to make; `require_writable` checks it in advance.
    wanted : Path
        Result named in the refusal.

    Yields
    ------
    None
        While the folder exists.

    Raises
    ------
    InvalidSetting
        If the folder cannot be made.
    """
    place = _place(folder)
    try:
        made = [folder for folder in (place, *place.parents) if not folder.exists()]
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(wanted, error) from error
    try:
        yield
    finally:
        with suppress(OSError):
            for made_folder in made:
                made_folder.rmdir()


def write_together(contents: Mapping[Path, str | bytes | Iterable[str]]) -> None:
    """Write several files or none: all are written under temporary names in their folders, then renamed.

    Parameters
    ----------
    contents : mapping of Path to str, bytes or iterable of str
        Contents by file, also in pieces; texts are written as UTF-8.

    Raises
    ------
    InvalidSetting
        If a folder does not exist or cannot be written.
    """
    import tempfile  # noqa: PLC0415 - few programs write files

    name = Path()
    try:
        with ExitStack() as leftovers:
            waiting = []
            for name, content in contents.items():
                file = _place(name)  # a symbolic link stays one
                with tempfile.NamedTemporaryFile(
                    prefix=f".{file.name}", suffix=".part", dir=file.parent, delete=False
                ) as stream:
                    part = Path(stream.name)
                    leftovers.callback(part.unlink, missing_ok=True)
                    for piece in (content,) if isinstance(content, str | bytes) else content:
                        stream.write(piece.encode() if isinstance(piece, str) else piece)
                part.chmod(0o644)
                waiting.append((part, file, name))
            rename_together(waiting)
    except OSError as error:
        raise not_written(name, error) from error


def rename_together(moves: Sequence[tuple[Path, Path, Path]]) -> None:
    """Rename several files or none, also over others: if one cannot be renamed, the others are restored.

    Parameters
    ----------
    moves : sequence of tuple of Path
        The file, its new path, and the result named in the refusal.

    Raises
    ------
    InvalidSetting
        If a file cannot be renamed.
    """
    with ExitStack() as leftovers, ExitStack() as undo:
        for k, (part, file, wanted) in enumerate(moves):
            try:
                if k == len(moves) - 1:
                    pass  # the last one: no later rename can fail, so the replaced file need not be kept
                elif file.is_symlink() or file.is_file():
                    old = part.with_name(f"{part.name}.old")
                    leftovers.callback(old.unlink, missing_ok=True)
                    undo.callback(_put_back, old, file)
                    file.replace(old)
                elif not file.exists():
                    undo.callback(file.unlink, missing_ok=True)
                part.replace(file)
            except OSError as error:
                raise not_written(wanted, error) from error
        undo.pop_all()


def _put_back(old: Path, file: Path) -> None:
    if os.path.lexists(old):
        old.replace(file)


def zipped(members: Mapping[str, bytes], first: str = "modelDescription.xml") -> bytes:
    """Pack files by path in a fixed order, with fixed dates and rights: equal files give equal bytes."""
    stream = io.BytesIO()
    # Level 5 takes half the time of 6 and makes archives a hundredth larger.
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=5) as archive:
        for name in sorted(members, key=lambda each: (each != first, each)):
            entry = zipfile.ZipInfo(name, _LONG_AGO)
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, members[name])
    return stream.getvalue()


def xml_document(root: ET.Element) -> bytes:
    """Return a whole XML document, indented; raises `InvalidSetting` if a text has a character that XML cannot hold."""
    ET.indent(root)
    text = ET.tostring(root, "unicode")
    if wrong := _NOT_IN_XML.search(text):
        near = text[max(0, wrong.start() - 20) : wrong.end() + 20]
        raise InvalidSetting(
            f"XML files cannot hold the character {wrong[0]!r}, which stands in {near!r}: leave it out"
        )
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
