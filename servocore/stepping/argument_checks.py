"""Checks of the arguments of `solve` and its companions, which refuse with a sentence that says what to write."""

from __future__ import annotations

from servocore.errors import InvalidSetting, described, require_real


def require_formulation(value: object) -> None:
    """Raise `InvalidSetting` unless this is a formulation."""
    if not _offers(value, "dae"):
        method = _offers(value, "discretise") or _offers(value, "run")
        hint = "; it is a method: write method=" if method else ""
        raise InvalidSetting(
            f"the formulation must be one such as Reduced(), not {described(value)}{_written(value, hint)}"
        )


def require_method(value: object, *, routes: bool = True) -> None:
    """Raise `InvalidSetting` unless this is a method or, where one may stand, a route."""
    if not _offers(value, "discretise") and not (routes and _offers(value, "run")):
        hint = "; it is a formulation: write formulation=" if _offers(value, "dae") else ""
        raise InvalidSetting(
            f"the method must be one such as RadauIIA(3), not {described(value)}{_written(value, hint)}"
        )


def require_number(value: object, what: str, wanted: str) -> None:
    """Raise `InvalidSetting` unless this is a number."""
    require_real(value, what, wanted, InvalidSetting)


def require_callable(value: object, what: str, wanted: str) -> None:
    """Raise `InvalidSetting` unless this can be called."""
    if not callable(value):
        raise InvalidSetting(f"{what} must be {wanted}, not {described(value)}")


def _offers(value: object, function: str) -> bool:
    return not isinstance(value, type) and callable(getattr(value, function, None))


def _written(value: object, hint: str = "") -> str:
    """Return what to write in the place of a class or of what stands in the wrong place; empty if that is unknown."""
    if isinstance(value, type):
        return f"; an instance is wanted: {value.__name__}(...)"
    return f"{hint}{type(value).__name__}(...)" if hint else ""
