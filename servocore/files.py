"""Files that appear complete or not at all; command lines around the library write theirs with it too."""

from __future__ import annotations

import errno
import io
import os
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidSetting, require_package

PICTURES = (".png", ".svg", ".pdf")
"""Endings of the files that figures are written to."""

FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))
"""Numbers of the errors of a disk that takes no more."""

MORE_SPACE = "free some space"
"""What helps then."""

_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the first date that archives know
_ROWS = 4096  # of a piece
_TRIAL = 4096  # bytes: a disk that is full takes a file, but nothing in it


def csv_text(names: Sequence[str], columns: Sequence[npt.NDArray[np.float64]]) -> str:
    """Return a table as the text of a CSV file; every number in as many digits as it takes to read back the same one.

    Parameters
    ----------
    names : sequence of str
        What stands above the columns.
    columns : sequence of ndarray, shape (n,) or (n, k)
        Values beside each other.
    """
    return "".join(csv_pieces(names, columns))


def csv_pieces(names: Sequence[str], columns: Sequence[npt.NDArray[np.float64]]) -> Iterator[str]:
    """Give what `csv_text` returns piece by piece: a text of millions of rows would fill the memory."""
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
        What the names of the files begin with.
    inputs, results : mapping of str to ndarray, or None
        What the FMU is given and what a run has to give, by the names of its variables, `time` first; None for nothing.
    times : tuple of float
        Start and end of that run, and its communication step, in s.
    """
    names = ("StartTime", "StopTime", "StepSize", "RelTol", "OutputIntervalLength")
    options = zip(names, (*times, 0.0, times[2]), strict=True)
    tables = {"in": inputs, "ref": results}
    texts = {
        f"{stem}_{kind}.csv": csv_text([f'"{name}"' for name in table], list(table.values()))
        for kind, table in tables.items()
        if table is not None
    }
    return texts | {f"{stem}_ref.opt": "".join(f"{name},{value!r}\n" for name, value in options)}


def require_picture(file: Path | None) -> None:
    """Raise `InvalidSetting` if a figure cannot be drawn: an ending that is not in `PICTURES`, or no Matplotlib."""
    if file is None:
        return
    if file.suffix.lower() not in PICTURES:
        raise InvalidSetting(f"cannot draw {file}: the name must end in {', '.join(PICTURES)}")
    require_package("matplotlib")


def require_places(results: Mapping[str, Path | None], sources: Iterable[Path | None] = ()) -> None:
    """Refuse results that cannot be written: before the work rather than after it.

    Parameters
    ----------
    results : mapping of str to Path or None
        Where each option wants its file; None where it was not given.
    sources : iterable of Path or None
        Files that are read and must survive.

    Raises
    ------
    InvalidSetting
        If two options name one file, or a file is read as well, is a folder, or is in none that can be written into.
    """
    wanted = {option: file for option, file in results.items() if file is not None}
    read = {_place(file) for file in sources if file is not None}
    taken: dict[Path, str] = {}
    for option, file in wanted.items():
        other = taken.setdefault(_place(file), option)
        if other != option:
            raise InvalidSetting(f"{other} and {option} both name {wanted[other]}")
        if _place(file) in read:
            raise InvalidSetting(f"cannot write {file}: it is read as well")
        _require_file(file)


def _require_file(file: Path) -> None:
    if file == Path("-"):  # elsewhere the standard output stream
        raise InvalidSetting("cannot write -: name a file; tables go to the standard output stream where none is named")
    folder = _place(file).parent
    try:
        if file.is_dir():
            raise InvalidSetting(f"cannot write {file}: it is a folder; name a file")
        if file.exists() and not file.is_file():
            raise InvalidSetting(f"cannot write {file}: it is no ordinary file")
        if not folder.exists():
            raise InvalidSetting(f"cannot write {file}: there is no folder {file.parent}; make it first")
    except OSError as error:  # a folder that hides what it holds, a name that is too long
        raise not_written(file, error) from None
    require_writable(folder, file)


def require_writable(folder: Path, wanted: Path) -> None:
    """Refuse a folder in which nothing can be written; one that is still to be made is in one that is there.

    Parameters
    ----------
    folder : Path
        The folder; a file without a name is written there, or around it, and is gone again.
    wanted : Path
        What a refusal says cannot be written.

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
    """Return the refusal for a file or a folder whose writing failed, with what helps.

    Parameters
    ----------
    place : Path
        What was to be written.
    error : OSError
        What came of it.
    """
    remedy = f"{MORE_SPACE}, or name another place" if error.errno in FULL else "name another place"
    return InvalidSetting(f"cannot write {place}: {error.strerror or error}; {remedy}")


def _place(file: Path) -> Path:
    """Return where a file is, symbolic links followed; `Path.resolve` fails where they go in a circle."""
    return Path(os.path.realpath(file))


@contextmanager
def made_folder(folder: Path, wanted: Path) -> Iterator[None]:
    """Make a folder and those around it; what was made and holds nothing at the end is gone again.

    Parameters
    ----------
    folder : Path
        The folder to make; `require_writable` tells before what stands in its way.
    wanted : Path
        What a refusal says cannot be written.

    Yields
    ------
    None
        While the folder is there to be written.

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
    """Write several files or none: all are written beside their places first and then renamed.

    Parameters
    ----------
    contents : mapping of Path to str, bytes or iterable of str
        What goes where, also in pieces; texts are written as UTF-8.

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
    """Rename several files or none, also over others: if one cannot be renamed, those before it are undone.

    Parameters
    ----------
    moves : sequence of tuple of Path
        The file, its new place, and what a refusal says cannot be written.

    Raises
    ------
    InvalidSetting
        If a file cannot be renamed.
    """
    with ExitStack() as leftovers, ExitStack() as undo:
        for k, (part, file, wanted) in enumerate(moves):
            try:
                if k == len(moves) - 1:
                    pass  # nothing behind it can fail: what it replaces need not be kept, and is never missing
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
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(members, key=lambda each: (each != first, each)):
            entry = zipfile.ZipInfo(name, _LONG_AGO)
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, members[name])
    return stream.getvalue()


def xml_document(root: ET.Element) -> bytes:
    """Return a whole XML document, indented."""
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, "unicode")}\n'.encode()
