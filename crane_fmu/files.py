"""Files in folders, and folders that are written completely or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import servocore as sc
from servocore.files import made_folder, require_writable, write_together


def put(folder: Path, contents: Mapping[str, str | bytes]) -> None:
    """Write files into a temporary folder; its subfolders are made.

    Parameters
    ----------
    folder : Path
        The folder.
    contents : mapping of str to str or bytes
        Contents by paths in the folder; texts are written as UTF-8.
    """
    for name, content in contents.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def filled_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder whose content is moved into `target` unless an exception is raised.

    Other files in `target` stay, unless a new file has the same name.

    Parameters
    ----------
    target : Path
        The folder to make or to fill.

    Yields
    ------
    Path
        The folder to write into; it is removed afterwards.

    Raises
    ------
    InvalidSetting
        If the folder cannot be made or written.
    """
    require_writable(target, target)
    with tempfile.TemporaryDirectory(prefix="crane_fmu_", ignore_cleanup_errors=True) as name, ExitStack() as made:
        draft = Path(name)
        try:
            yield draft
        except sc.InvalidSetting as error:  # the message names a temporary file
            raise sc.InvalidSetting(str(error).replace(name, str(target))) from error
        files = [each for each in sorted(draft.rglob("*")) if each.is_file()]
        contents = {target / each.relative_to(draft): each.read_bytes() for each in files}
        for folder in dict.fromkeys(each.parent for each in contents):
            made.enter_context(made_folder(folder, target))
        write_together(contents)
