"""Newton's method on a block of equations, compiled.

``fast_newton`` returns no status, and treats NaN as convergence. So each block carries a *clock*, an additional
unknown whose Newton correction is exactly one tick: -r/r' = tick for r = exp(-clock/tick). It counts the
iterations inside compiled loops, and convergence is judged from the count.

Where unknowns are large compared with their nominal values (accelerations of stiff parts), corrections stagnate at
round-off above `NEWTON_TOLERANCE`. After `QUICK_ITERATIONS` an equation counts as solved if its residual is that of
unknowns and givens rounded to some units in the last place.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

NEWTON_TOLERANCE = 1e-9
"""Usual bound of the largest scaled Newton correction; the error is then its square, as convergence is quadratic."""

QUICK_ITERATIONS = 12
"""Newton iterations after which residuals are compared with round-off, which takes twice as long."""

MAX_ITERATIONS = 30
"""Newton iterations at which a block has failed."""

TICK = 1e-20
"""Of a clock: far below every tolerance, so that it never decides when to stop."""

_ROUND_OFF = 64 * np.finfo(np.float64).eps  # relative change of unknowns and givens that explains a residual


def compile_newton(x: ca.SX, p: ca.SX, equations: ca.SX, data: ca.SX, tolerance: float) -> ca.Function:
    """Compile (start, p) -> root of `equations`; the last unknown is the clock, `data` the entries of p with errors."""
    options = {"abstol": 0.0, "abstolStep": tolerance, "error_on_fail": False, "common_options": {"cse": True}}
    problem = {"x": x, "p": p, "g": equations}
    jacobian = ca.Function(
        "sc_jacobian", [x, p], [ca.jacobian(equations, x), equations], ["x", "p"], ["J", "g"], {"cse": True}
    )
    quick = ca.rootfinder("sc_newton", "fast_newton", problem, {
        **options, "max_iter": QUICK_ITERATIONS, "jacobian_function": jacobian,
    })  # fmt: skip
    careful = ca.rootfinder("sc_careful_newton", "fast_newton", problem, {
        **options, "max_iter": MAX_ITERATIONS - QUICK_ITERATIONS,
        "jacobian_function": _beyond_round_off(jacobian, x, p, ca.jacobian(equations, data), data),
    })  # fmt: skip
    start, parameters = ca.MX.sym("start", x.numel()), ca.MX.sym("p", p.numel())
    enough = ca.Function("sc_enough", [start, parameters], [start])
    more = ca.Function("sc_more", [start, parameters], [careful(start, parameters)])
    root = quick(start, parameters)
    root = ca.Function.if_else("sc_rest", more, enough)(root[-1] > (QUICK_ITERATIONS - 0.5) * TICK, root, parameters)
    return ca.Function("sc_root", [start, parameters], [root])


def _beyond_round_off(jacobian: ca.Function, x: ca.SX, p: ca.SX, by_data: ca.SX, data: ca.SX) -> ca.Function:
    """Return `jacobian`, (x, p) -> (J, equations), with zero for residuals at the level of round-off.

    `jacobian` is called, not inlined again, which halves the code of exported models.
    """
    J, equations = ca.SX.sym("J", jacobian.sparsity_out(0)), ca.SX.sym("g", x.numel())
    # Componentwise backward error (Oettli and Prager, 1964).
    floor = ca.mtimes(ca.fabs(J), ca.fabs(x)) + ca.mtimes(ca.fabs(by_data), ca.fabs(data))
    beyond = ca.if_else(ca.fabs(equations) <= _ROUND_OFF * floor, 0.0, equations)
    beyond[-1] = equations[-1]
    judge = ca.Function("sc_judge", [x, p, J, equations], [ca.densify(beyond)], {"cse": True})
    now, given = ca.MX.sym("x", x.numel()), ca.MX.sym("p", p.numel())
    known = jacobian(now, given)
    return ca.Function("sc_beyond", [now, given], [known[0], judge(now, given, *known)], ["x", "p"], ["J", "g"])
