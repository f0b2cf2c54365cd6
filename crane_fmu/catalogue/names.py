"""Names that the variables of several FMUs have in common; what each FMU has says its model description."""

from __future__ import annotations

ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
"""Names of the load path's derivatives of order 0, 1, ..."""

DIMENSION = 3
"""Components of the load path."""


def components(*vectors: str) -> tuple[str, ...]:
    """Return the names of the components of vectors, one vector after the other.

    Parameters
    ----------
    *vectors : str
        Names without an index.

    Returns
    -------
    tuple of str
        With indices from 1 on.
    """
    return tuple(f"{name}[{k}]" for name in vectors for k in range(1, DIMENSION + 1))


PATH_INPUTS = components(*(f"load.{order}" for order in ORDERS))
"""What the inverse model has to be told of the load path, order by order."""

FEEDBACK_INPUTS = (
    *(f"measured.{name}" for name in ("phi", "s", "l", "phi_dot", "s_dot", "l_dot")),
    *components("measured.position", "measured.velocity"),
)
"""What the feedback has to be told of the crane, in the order in which the law takes it."""
