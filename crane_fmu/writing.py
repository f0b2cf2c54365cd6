"""Files that appear complete or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import servocore as sc


def require_place(file: Path) -> None:
    """Raise `InvalidSetting` if a file of that name cannot be there: before the work rather than after it."""
    if file.is_dir():
        raise sc.InvalidSetting(f"cannot write {file}: it is a folder")
    if file.exists() and not file.is_file():
        raise sc.InvalidSetting(f"cannot write {file}: it is no ordinary file")
    if not file.parent.is_dir():
        raise sc.InvalidSetting(f"cannot write {file}: there is no folder {file.parent}")


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write several files: all are written beside their places first and then renamed.

    Parameters
    ----------
    contents : mapping of Path to bytes
        What goes where.

    Raises
    ------
    InvalidSetting
        If a folder does not exist or cannot be written.
    """
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
                    stream.write(content)
                part.chmod(0o644)
                waiting.append((part, file))
            for part, file in waiting:
                part.replace(file)
    except OSError as error:
        raise sc.InvalidSetting(f"cannot write {', '.join(map(str, contents))}: {_reason(error)}") from error


@contextmanager
def filled_folder(target: Path) -> Iterator[Path]:
    """Offer an empty folder beside `target` whose content becomes that of `target` if all goes well.

    What `target` already holds stays, unless a new file has the same name.

    Parameters
    ----------
    target : Path
        The folder to make or to fill.

    Yields
    ------
    Path
        Where to write; it is gone afterwards.

    Raises
    ------
    InvalidSetting
        If the folder cannot be made or written.
    """
    try:
        if target.exists() and not target.is_dir():
            raise NotADirectoryError(0, "there is a file of that name")
        parent = target.resolve().parent
        made = [each for each in (parent, *parent.parents) if not each.exists()]
        parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{target.name}", suffix=".part", dir=parent))
    except OSError as error:
        raise sc.InvalidSetting(f"cannot make the folder {target}: {_reason(error)}") from error
    try:
        yield draft
        _move(draft, target)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        with suppress(OSError):  # parents that were made and still hold nothing go too
            for each in made:
                each.rmdir()


def _move(draft: Path, target: Path) -> None:
    try:
        for source in (draft, *sorted(draft.rglob("*"))):
            source.chmod(0o755 if source.is_dir() else 0o644)
        if not target.exists():
            draft.rename(target)
            return
        for source in sorted(draft.rglob("*")):
            place = target / source.relative_to(draft)
            if source.is_dir():
                place.mkdir(exist_ok=True)
            else:
                source.replace(place)
    except OSError as error:
        raise sc.InvalidSetting(f"cannot write into the folder {target}: {_reason(error)}") from error


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
