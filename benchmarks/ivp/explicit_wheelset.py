"""The wheelset as an ordinary differential equation, by SciPy: how exact the published values at its end are.

Contact coordinates and multipliers are solved for at every evaluation, from the contact conditions and from the rates
of the contacts differentiated once; what is left are the 11 differential unknowns. DOP853 at two tight tolerances shows
that the values have converged, LSODA at the tolerances of the published run (1e-9) how far such a run is off.

    python -m benchmarks.ivp.explicit_wheelset
"""

from __future__ import annotations

from typing import Literal

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.ivp.problems import wheelset
from servocore.numerics.compiled_calls import Array, Call

_CONVERGED = 1e-13  # relative change of the algebraic unknowns
_MOST = 12
_LONGEST = 0.01  # s


class Explicit:
    """The right-hand side, with Newton's method for the algebraic unknowns; each solution starts the next one."""

    def __init__(self) -> None:
        dae = wheelset.wheelset()
        x, z, contacts, rates = dae.x, dae.z, dae.h[:4], dae.h[4:]
        x_dot = ca.solve(dae.H, dae.f)
        moved = -ca.solve(ca.jacobian(contacts, z[:4]), ca.mtimes(ca.jacobian(contacts, x), x_dot))
        second = ca.mtimes(ca.jacobian(rates, x), x_dot) + ca.mtimes(ca.jacobian(rates, z[:4]), moved)
        residual = ca.vertcat(contacts, second)
        after = z - ca.solve(ca.jacobian(residual, z), residual)
        self._step = Call(ca.Function("step", [x, z], [after, x_dot], {"cse": True}))
        self.algebraic: Array = wheelset.START[11:].copy()

    def __call__(self, _: float, x: Array) -> Array:
        """Return x'."""
        for _k in range(_MOST):
            after = self._step(x, self.algebraic)[0].ravel().copy()
            change = np.abs(after - self.algebraic) / np.maximum(np.abs(after), 1e-12)
            self.algebraic = after
            if change.max() < _CONVERGED:
                break
        return np.asarray(self._step(x, self.algebraic)[1].ravel().copy())


def at_the_end(method: Literal["DOP853", "LSODA"], rtol: float, atol: Array | float) -> Array:
    """Return the 17 values at the end, shape (17,)."""
    rate, start = Explicit(), wheelset.START[:11]
    found = solve_ivp(
        rate, (0.0, wheelset.DURATION), start, method=method, rtol=rtol, atol=atol, max_step=_LONGEST, t_eval=[10.0]
    )
    rate(wheelset.DURATION, found.y[:, -1])
    return np.concatenate([found.y[:, -1], rate.algebraic])


def main() -> None:
    """Print relative differences from the published values, and of one tolerance from the other."""
    size = np.abs(wheelset.END[:11])
    runs = {
        "DOP853, 1e-11": at_the_end("DOP853", 1e-11, 1e-13 * size),
        "DOP853, 1e-12": at_the_end("DOP853", 1e-12, 1e-14 * size),
        "LSODA, 1e-9": at_the_end("LSODA", 1e-9, 1e-9),
    }
    finest = runs["DOP853, 1e-12"]
    print("value    published", *runs, sep="  ")
    for k, name in enumerate(wheelset.NAMES):
        errors = (each[k] / finest[k] - 1.0 for each in (wheelset.END, *runs.values()))
        print(f"{name:8}", *(f"{each:11.1e}" for each in errors))


if __name__ == "__main__":
    main()
