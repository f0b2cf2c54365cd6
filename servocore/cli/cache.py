"""The command ``servocore cache``: machine code that earlier runs have left, and how to be rid of it."""

from __future__ import annotations

from dataclasses import dataclass

from servocore.cli.command import option
from servocore.cli.console import table_console
from servocore.cli.kinds import text
from servocore.errors import InvalidSetting
from servocore.numerics.code_cache import FOLDER, MOST_BYTES, CodeCache

EXAMPLES = ("", "clear")


@dataclass(frozen=True)
class Order:
    """What is to be done with the cache."""

    title = "Cache"

    what: str | None = option(
        kind=text("clear"), metavar="[clear]", help="Clear the cache; without this word it is only described."
    )


def show_cache(order: Order) -> None:
    """Say where compiled machine code is kept and how much there is, or remove it all.

    Whatever is removed is compiled again when it is needed. The folder is the user's own for caches, or the one that
    the environment variable SERVOCORE_CACHE names.
    """
    if order.what not in (None, "clear"):
        raise InvalidSetting(f"servocore cache is followed by clear or by nothing, not by {order.what}")
    kept = CodeCache.of_user()
    refusal = kept.refusal()
    if refusal:
        raise InvalidSetting(f"no machine code is kept: {refusal}; {FOLDER} may name another folder")
    if order.what:
        count, size = kept.clear()
        where = f"removed from {kept.folder}"
    else:
        found = kept.contents()
        count, size = len(found), sum(file.stat().st_size for file in found)
        where = f"of at most {MOST_BYTES / 1e6:.3g} MB in {kept.folder}"
    libraries = "library" if count == 1 else "libraries"
    table_console().print(f"{count} {libraries} of machine code with {size / 1e6:.3g} MB {where}", soft_wrap=True)
