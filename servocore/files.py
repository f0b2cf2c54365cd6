"""Files that appear complete or not at all; command lines around the library write theirs with it too."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import numpy.typing as npt

from servocore.errors import InvalidSetting

PICTURES = (".png", ".svg", ".pdf")
"""Endings of the files that figures are written to."""

_ROWS = 4096  # of a piece


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
        rows = np.column_stack([each[first : first + _ROWS] for each in columns])
        line = ",".join(["%r"] * rows.shape[1]) + "\n"
        yield line * len(rows) % tuple(rows.ravel().tolist())  # a fifth faster than the repr of lists


def require_picture(file: Path | None) -> None:
    """Raise `InvalidSetting` if a figure is wanted in a file whose ending is not among `PICTURES`."""
    if file is not None and file.suffix.lower() not in PICTURES:
        raise InvalidSetting(f"cannot draw {file}: the name must end in {', '.join(PICTURES)}")


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
        If two options name one file, or a file is read as well, is a folder or has none to be in.
    """
    wanted = {option: file for option, file in results.items() if file is not None}
    read = {file.resolve() for file in sources if file is not None}
    taken: dict[Path, str] = {}
    for option, file in wanted.items():
        other = taken.setdefault(file.resolve(), option)
        if other != option:
            raise InvalidSetting(f"{other} and {option} both name {wanted[other]}")
        if file.resolve() in read:
            raise InvalidSetting(f"cannot write {file}: it is read as well")
        if file.is_dir():
            raise InvalidSetting(f"cannot write {file}: it is a folder")
        if file.exists() and not file.is_file():
            raise InvalidSetting(f"cannot write {file}: it is no ordinary file")
        if not file.parent.is_dir():
            raise InvalidSetting(f"cannot write {file}: there is no folder {file.parent}")


def write_together(contents: Mapping[Path, str | bytes | Iterable[str]]) -> None:
    """Write several files: all are written beside their places first and then renamed.

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

    try:
        with ExitStack() as leftovers:
            waiting = []
            for name, content in contents.items():
                file = name.resolve()  # a symbolic link stays one
                with tempfile.NamedTemporaryFile(
                    prefix=f".{file.name}", suffix=".part", dir=file.parent, delete=False
                ) as stream:
                    part = Path(stream.name)
                    leftovers.callback(part.unlink, missing_ok=True)
                    for piece in (content,) if isinstance(content, str | bytes) else content:
                        stream.write(piece.encode() if isinstance(piece, str) else piece)
                part.chmod(0o644)
                waiting.append((part, file))
            for part, file in waiting:
                part.replace(file)
    except OSError as error:
        names = ", ".join(map(str, contents))
        raise InvalidSetting(f"cannot write {names}: {error.strerror or error}") from error
