"""What no feedback of a Jacobi master can do: the path is told one step late, and nothing is known before.

The load behaves towards its inputs as four integrators in a row do. Crackle, the fifth derivative of the path, jumps by
J just after an instant. Derivatives up to snap show that one step later, what is then computed acts one step after
that, and runs on with the slope of the step before. With everything else known, the smallest largest distance from the
path that any inputs reach from there on is a linear programme.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from present import present
from scipy.optimize import linprog

_STEPS = 40  # more change nothing
_ORDER = 4


def smallest_distance(first: int = 2, most: float | None = None) -> float:
    """Return the smallest largest distance at communication points, in units of J h^5.

    Parameters
    ----------
    first : int
        The step from which on inputs react: 2 for a Jacobi master.
    most : float, optional
        How far inputs may be from those of the path, in units of J h; without it any.
    """
    rows = range(_ORDER)
    over = np.array([[1.0 / factorial(j - i) if j >= i else 0.0 for j in rows] for i in rows])
    level, ramp = (np.array([1.0 / factorial(_ORDER + more - i) for i in rows]) for more in (0, 1))
    free = _STEPS - first
    effect, missed, at_most = np.zeros((_ORDER, free)), np.zeros(_ORDER), []
    for k in range(_STEPS):
        effect, missed = over @ effect, over @ missed - k * level - ramp  # the path's snap is k + tau
        if k >= first:
            effect[:, k - first] += level + ramp
        if k > first:
            effect[:, k - first - 1] -= ramp
        at_most.append((effect[0].copy(), missed[0]))
    signs = (1.0, -1.0)
    left = [np.append(sign * row, -1.0) for row, _ in at_most for sign in signs]
    right = [-sign * off for _, off in at_most for sign in signs]
    path = np.arange(first, _STEPS, dtype=float)
    bounds = [(None, None) if most is None else (w - most, w + most) for w in path]
    found = linprog(
        np.append(np.zeros(free), 1.0), A_ub=np.array(left), b_ub=right,
        A_eq=np.hstack([effect, np.zeros((_ORDER, 1))]), b_eq=-missed, bounds=[*bounds, (0.0, None)],
    )  # fmt: skip
    assert found.success, found.message
    return float(present(found.fun))


if __name__ == "__main__":
    print(f"any inputs: {smallest_distance():.3f} J h^5")
    for most in (20.0, 10.0, 5.0):
        print(f"inputs within {most:g} J h of the path's: {smallest_distance(most=most):.3f} J h^5")
