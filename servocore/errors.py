"""Errors as sentences: every error of the library derives from `ServocoreError`.

An error names the culprit, the limit it broke and, where there is one, the time. Command lines print the
sentence and exit with code 2; nothing else is caught.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from numbers import Integral
from typing import Any


class ServocoreError(Exception):
    """Base of all errors that users can cause."""


class ServocoreWarning(UserWarning):
    """A warning that a result differs from what its user may expect."""


class InvalidModel(ServocoreError):
    """A mechanical system contradicts itself: sizes, kinds, symmetry, rank, parameter bounds, names used twice."""


class InvalidReference(ServocoreError):
    """A load path cannot be followed or read: not finite, too rough, slack rope, load above the girder."""


class LimitBroken(InvalidReference):
    """A motion exceeds a limit of the scene; another or slower time law on the same path may keep it."""


class InvalidSetting(ServocoreError):
    """A numerical setting makes no sense: a step that is not positive or does not divide the duration."""


class InconsistentStart(ServocoreError):
    """No positions, velocities, multipliers and inputs satisfy the equations at the initial time."""


class IntegrationFailed(ServocoreError):
    """A time step was not solved; the sentence names time, step, the worst equation and likely causes."""


class PlanningFailed(ServocoreError):
    """No time law was found that keeps all limits on a finer grid as well."""


_EXTRAS = {
    "control": "control",
    "distributed": "sweep",
    "fmpy": "fmu",
    "jinja2": "fmu",
    "markdown_it": "fmu",
    "matplotlib": "report",
    "mujoco": "mjcf",
    "pandas": "sweep",
    "pyarrow": "sweep",
    "pythonfmu": "fmu",
    "xarray": "sweep",
    "zarr": "sweep",
}


def missing_package(error: ImportError) -> InvalidSetting | None:
    """Return the refusal for a missing package of an extra; None for any other import."""
    package = (error.name or "").partition(".")[0]
    return _needed(package, _EXTRAS[package]) if package in _EXTRAS else None


def require_package(package: str, extra: str | None = None) -> None:
    """Raise `InvalidSetting` if a package of an extra is missing: before the work that needs it."""
    if find_spec(package) is None:
        raise _needed(package, extra or _EXTRAS[package])


def _needed(package: str, extra: str) -> InvalidSetting:
    return InvalidSetting(f"the package {package} is missing: {install(extra)}")


def install(extra: str) -> str:
    """Return the command that installs an extra: the project is not on the package index."""
    return f"run pip install '.[{extra}]' in a clone of the project"


@contextmanager
def refused_if_missing() -> Iterator[None]:
    """Refuse a missing package that is imported inside, by the name of its extra.

    Raises
    ------
    InvalidSetting
        If it is one of an extra.
    """
    try:
        yield
    except ImportError as error:
        raise missing_package(error) or error from None


def extra(name: str) -> Any:
    """Return a module of a package of an extra; raises as `refused_if_missing` does."""
    with refused_if_missing():
        import_module(name.partition(".")[0])
        return import_module(name)


def described(value: object) -> str:
    """Return a description of an argument of the wrong kind for messages: the text 'a', the class A, a casadi.MX."""
    if isinstance(value, str):
        return f"the text {value!r}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, int | float | complex | None):
        return f"{value!r}"
    kind = type(value)
    name = f"{kind.__module__.partition('.')[0]}.{kind.__name__}" if kind.__module__ != "builtins" else kind.__name__
    name = name.removeprefix("servocore.")
    return f"{'an' if name[0] in 'aeiouAEIO' else 'a'} {name}"


def require_kind(
    value: object, kinds: type | tuple[type, ...], what: str, wanted: str, error: type[ServocoreError]
) -> None:
    """Raise `error`, with the expected and the given value, unless `value` is of one of some kinds."""
    if not isinstance(value, kinds):
        raise error(f"{what} must be {wanted}, not {described(value)}")


def require_count(value: object, least: int, what: str, error: type[ServocoreError]) -> None:
    """Raise `error`, with the given value, unless `value` is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise error(f"{what} must be a whole number of at least {least}, not {described(value)}")


def require_real(value: object, what: str, wanted: str, error: type[ServocoreError]) -> None:
    """Raise `error`, with the expected and the given value, unless `value` is a real number."""
    sized = getattr(value, "ndim", 0) == 0
    if isinstance(value, bool | str | type) or not hasattr(value, "__float__") or not sized:
        raise error(f"{what} must be {wanted}, not {described(value)}")


def require_positive(value: float, what: str, wanted: str, *, or_zero: bool = False) -> None:
    """Raise `InvalidSetting`, with the expected and the given value, unless `value` is positive and finite, or zero."""
    require_real(value, what, wanted, InvalidSetting)
    if not (0.0 < value < float("inf") or (or_zero and value == 0.0)):
        raise InvalidSetting(
            f"{what} must be {'finite and not negative' if or_zero else 'positive and finite'}, not {value:g}"
        )


def require_formulation(value: object) -> None:
    """Raise `InvalidSetting` unless this is a formulation."""
    if not _offers(value, "dae"):
        method = _offers(value, "discretize") or _offers(value, "run")
        hint = "; it is a method: write method=" if method else ""
        raise InvalidSetting(
            f"the formulation must be one such as Reduced(), not {described(value)}{_written(value, hint)}"
        )


def require_method(value: object, *, routes: bool = True) -> None:
    """Raise `InvalidSetting` unless this is a method or, where one may stand, a route."""
    if not _offers(value, "discretize") and not (routes and _offers(value, "run")):
        hint = "; it is a formulation: write formulation=" if _offers(value, "dae") else ""
        raise InvalidSetting(
            f"the method must be one such as RadauIIA(3), not {described(value)}{_written(value, hint)}"
        )


def require_callable(value: object, what: str, wanted: str) -> None:
    """Raise `InvalidSetting` unless this can be called."""
    if not callable(value):
        raise InvalidSetting(f"{what} must be {wanted}, not {described(value)}")


def _offers(value: object, function: str) -> bool:
    return not isinstance(value, type) and callable(getattr(value, function, None))


def _written(value: object, hint: str = "") -> str:
    """Return the right form where a class or the wrong kind of object is given; empty if it is unknown."""
    if isinstance(value, type):
        return f"; an instance is wanted: {value.__name__}(...)"
    return f"{hint}{type(value).__name__}(...)" if hint else ""
