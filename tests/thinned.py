"""Members of a family of cases: a few stand for it in `make test`, all run in `make nightly`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def thinned(cases: Iterable[Any], kept: Callable[[Any], bool]) -> list[Any]:
    """Return all cases of a parametrization, those that are not kept marked for `make nightly`.

    Parameters
    ----------
    cases : iterable
        Values of one argument, or tuples of several.
    kept : callable
        Takes a case; whether it runs in `make test` too.
    """
    found = list(cases)
    if not any(map(kept, found)):
        raise ValueError("no case is kept")
    # a tuple holds several arguments, a named one is a value
    return [
        pytest.param(*(each if type(each) is tuple else (each,)), marks=() if kept(each) else pytest.mark.nightly)
        for each in found
    ]
