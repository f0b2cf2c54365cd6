"""Files in folders, and folders that appear filled or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import servocore as sc
from servocore.files import made_folder, not_written, rename_together, require_writable


def put(folder: Path, contents: Mapping[str, str | bytes]) -> None:
    """Write files into a folder that nobody else sees yet; those that it must have within are made.

    Parameters
    ----------
    folder : Path
        Where to.
    contents : mapping of str to str or bytes
        What, by paths in it; texts are written as UTF-8.
    """
    for name, content in contents.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.encode() if isinstance(content, str) else content)


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
    require_writable(target, target)
    parent = Path(os.path.realpath(target)).parent
    with made_folder(parent, target):
        try:
            draft = Path(tempfile.mkdtemp(prefix=f".{target.name}", suffix=".part", dir=parent))
        except OSError as error:
            raise not_written(target, error) from error
        try:
            yield draft
            _move(draft, target)
        except sc.InvalidSetting as error:  # what could not be written has a name that nobody knows
            raise sc.InvalidSetting(str(error).replace(str(draft), str(target))) from error
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def _move(draft: Path, target: Path) -> None:
    try:
        for source in (draft, *sorted(draft.rglob("*"))):
            source.chmod(0o755 if source.is_dir() else 0o644)
        if not target.exists():
            draft.rename(target)
            return
        with ExitStack() as made:
            files = []
            for source in sorted(draft.rglob("*")):
                place = target / source.relative_to(draft)
                if not source.is_dir():
                    files.append((source, place, target))
                elif not place.is_dir():
                    place.mkdir()
                    made.callback(place.rmdir)
            rename_together(files)
            made.pop_all()
    except OSError as error:
        raise not_written(target, error) from error
