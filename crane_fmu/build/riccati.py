"""Riccati steps: the cost-to-go of a linear model over sampled steps, one by one or 2^k at a time.

The model says how deviations z and the chosen inputs w+ act over a step; see `crane_fmu.build.feedback_law`.
"""

from __future__ import annotations

import casadi as ca

from crane_fmu.build.flatness import DRIVES, LOAD, STATES
from crane_fmu.catalogue import DIMENSION

_SQUARE, _TALL, _SMALL = (STATES, STATES), (STATES, DRIVES), (DRIVES, DRIVES)


def riccati_functions() -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return three functions: the matrices that all Riccati steps of a model share, a step, and the gain of a step.

    With w+ = v - F z, where F would be the gain without a cost-to-go, z = A e + B' w goes on as C z + G v, and a step
    costs a form Q of z and a form R of v: (A, B, B', f, W) -> F, C, C^T, Q, G, R. A step is (cost M of z before v is
    chosen, C, C^T, Q, G, R) -> (M a step earlier, K), v = -K C z, and its gain (M, G, R) -> K. Products of whole
    matrices stay loops, which compilers vectorize.
    """
    A, new, old = ca.SX.sym("A", *_SQUARE), ca.SX.sym("B", *_TALL), ca.SX.sym("B'", *_TALL)
    efforts, weights = ca.SX.sym("f", DRIVES), ca.SX.sym("W", DIMENSION)
    squares = ca.SX(*_SQUARE)
    squares[LOAD, LOAD] = ca.diag(weights**2)
    crossed, acting = squares @ new, A @ new + old
    effort = ca.diag(1 / efforts**2) + new.T @ crossed
    alone = ca.SX(DRIVES, STATES)
    alone[:, LOAD] = ca.ldl_solve(crossed[LOAD, :].T, *ca.ldl(effort))
    goes_on = A - acting @ alone
    results = [ca.densify(each) for each in (alone, goes_on, goes_on.T, squares - crossed @ alone, acting, effort)]
    shared = ca.Function("shared", [A, new, old, efforts, weights], results, {"cse": True})
    cost, *given = (ca.MX.sym(f"g{k}", each.sparsity()) for k, each in enumerate([A, *results[1:]]))
    C, C_T, Q, G, R = given
    choice = _choice()
    left, K = choice(cost, cost @ G, G, R)
    step = ca.Function("riccati", [cost, *given], [ca.mac(C_T, left @ C, Q), K])
    return shared, step, ca.Function("gain", [cost, G, R], [choice(cost, cost @ G, G, R)[1]])


def _choice() -> ca.Function:
    """Return (cost M of z, M G, G, R) -> (the cost with the optimal v, K), v = -K z."""
    cost, reach, acting = ca.SX.sym("M", *_SQUARE), ca.SX.sym("M G", *_TALL), ca.SX.sym("G", *_TALL)
    effort = ca.SX.sym("R", *_SMALL)
    K = ca.ldl_solve(reach.T, *ca.ldl(effort + acting.T @ reach))
    left = ca.triu2symm(ca.triu(cost - reach @ K))  # symmetric, to the last digit
    return ca.Function("choice", [cost, reach, acting, effort], [left, K], {"cse": True})


def riccati_steps(doublings: int) -> ca.Function:
    """Return (C, C^T, Q, G, R) -> M, the cost-to-go 2^doublings steps before an end without cost.

    Any number of steps of one model, as in `riccati_functions`, is M -> Q + C^T M (1 + H M)^-1 C, at first with
    H = G R^-1 G^T, and so are two such numbers one after the other: k doublings are 2^k steps.
    """
    C, H, Q, C_T = (ca.MX.sym(name, *_SQUARE) for name in ("C", "H", "Q", "C_T"))
    G, R = ca.MX.sym("G", *_TALL), ca.MX.sym("R", *_SMALL)
    reached, spread = ca.horzsplit(ca.solve(ca.MX.eye(STATES) + H @ Q, ca.horzcat(C, H), "qr"), STATES)
    doubled = [C @ reached, _symmetric(H + C @ spread @ C.T), _symmetric(Q + C.T @ Q @ reached)]
    doubling = ca.Function("doubling", [C, H, Q], doubled)
    steps = [C, G @ ca.solve(R, G.T, "qr"), Q]
    for _ in range(doublings):
        steps = doubling.call(steps)
    return ca.Function(f"riccati_2_to_{doublings}", [C, C_T, Q, G, R], [steps[-1]])


def _symmetric(matrix: ca.MX) -> ca.MX:
    """Return the symmetric part, which differs from a cost-to-go by round-off only."""
    return (matrix + matrix.T) / 2
