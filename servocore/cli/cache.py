"""The command ``servocore cache``: describe or clear the machine code kept by earlier runs."""

from __future__ import annotations

from dataclasses import dataclass

from servocore.cli.command import option
from servocore.cli.console import table_console
from servocore.cli.kinds import choice
from servocore.errors import InvalidSetting
from servocore.numerics.code_cache import FOLDER, MOST_BYTES, CodeCache

EXAMPLES = ("", "clear")


@dataclass(frozen=True)
class Action:
    """Action on the cache."""

    title = "Cache"

    clear: bool = option(
        kind=choice("action", {"clear": True}), metavar="[clear]", default=False,
        help="Clear the cache; without this word it is described.",
    )  # fmt: skip


def show_cache(action: Action) -> None:
    """Print place and size of the compiled machine code, or remove it.

    Removed code is compiled again when it is needed. The folder is the user's cache folder, or the one in the
    environment variable SERVOCORE_CACHE.
    """
    kept = CodeCache.of_user()
    if refusal := kept.refusal():
        raise InvalidSetting(f"no machine code is kept: {refusal}; set {FOLDER} to another folder")
    if action.clear:
        count, size = kept.clear()
        where = f"removed from {kept.folder}"
    else:
        found = kept.contents()
        count, size = len(found), sum(file.stat().st_size for file in found)
        where = f"of at most {MOST_BYTES / 1e6:.3g} MB in {kept.folder}"
    libraries = "library" if count == 1 else "libraries"
    table_console().print(f"{count} {libraries} of machine code with {size / 1e6:.3g} MB {where}", soft_wrap=True)
