"""Estimation of derivatives of the load path that are not connected, as CasADi functions with a memory.

Model: near its newest sample the k-th derivative of the path is a polynomial of degree 6 - k plus independent errors
of the samples of equal variance, rounding included. Polynomials are fitted by least squares to the last 7 - k samples
(an interpolation), and to longer windows. A longer window reduces the effect of the errors, but the path differs more
from a polynomial: the longest window is used whose snap agrees, within the errors, with those of all shorter ones
(Lepski's rule). The variance is estimated from residuals of the shortest window that has some. With exact samples the
shortest window is used: the error of derivative j is O(h^(7 - j)), that of snap O(h^3).

A fit is a sum over polynomials that are orthogonal on the samples, from their three-term recurrence: no factorization
is needed, for any times of the samples. Windows of similar length share a function, where some places stay empty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate

import casadi as ca
import numpy as np

import servocore as sc
from crane_fmu.catalogue import DIMENSION, NO_STARTS, ORDERS, Starts

SHORTEST_STEP = 1e-6
"""Shortest step in s whose sample is used: below it second differences are round-off."""

SAMPLES = len(ORDERS) + 2
"""Number of samples for the derivatives of a position; one less for each connected derivative."""

_MORE = (0, 2, 6, 12, 20, 32, 48, 72, 104, 150)  # samples of each window beyond those of an interpolation
_PLACES = (13, 13, 13, 27, 27, 55, 55, 157, 157, 157)  # for samples in the function of each window
_MOST = _MORE[-1] + SAMPLES
_ROWS, _HIGHEST = len(ORDERS), len(ORDERS) - 1
_ROUNDING = 2e-16
_EVEN = 1e-11  # of a step: largest difference of equal spacings
_RISE, _FALL = 1.0 / 4.0, 1.0 / 64.0  # shares of the newest residual in the estimated noise
_ABSURD = 20.0  # m/s4: a larger snap is an error of the samples
_AGREE = 3.5  # standard deviations
_STANDSTILL = 3e-6  # largest first change of the samples at rest, in SI units
_DOUBT = 0.05  # of the peak of M_b: a larger error of the estimates causes a warning
_SLIGHT_TORQUE = 0.002  # of the load's weight times s: least value of the peak
_M_B, _S = 0, 4  # places among the outputs

SIZES = {"times": _MOST, "values": _MOST * DIMENSION, "count": 1, "age": 1, "variance": 1}
"""Layout of the memory: times of the samples in s relative to the newest, the last; the highest connected derivative
at these times, component by component; number of samples; time since the newest; estimated variance of their errors,
negative before the first estimate."""


def estimates_of(crane: sc.Scene, starts: Starts = NO_STARTS) -> sc.SampledEstimates:
    """Return the estimator for a crane's inverse model, with warnings for each highest connected derivative.

    Parameters
    ----------
    crane : Scene
        The crane.
    starts : mapping of str to float or str
        Start values, of ``connected`` among them.
    """
    model = crane.model()
    functions = _first(), _estimate(), _worth(len(model.inputs) + len(model.observables))
    above = [f"derivatives above the load's {name}" for name in ORDERS[:-1]]
    return sc.SampledEstimates(
        functions={each.name(): each for each in functions},
        unknown=tuple(
            f"the load starts in motion: {each} are known after {SAMPLES - order} samples; until then M_b, F and M_w"
            " are not those of the path"
            for order, each in enumerate(above)
        ),
        rough=tuple(
            f"{each} are estimated to %.2g m/s4 of snap only, worth %.2g N.m of M_b, whose peak so far is %.2g N.m:"
            " the samples are too rough, or too far apart; connect further derivatives, or lay a smooth path through"
            " the samples first"
            for each in above
        ),
        start=ORDERS.index(str(starts.get("connected", ORDERS[-1]))),
    )


def _first() -> ca.Function:
    given_path, order = ca.MX.sym("path", _ROWS * DIMENSION), ca.MX.sym("order")
    values = ca.vertcat(ca.MX.zeros(_MOST - 1, DIMENSION), _sampled(given_path, order))
    memory = ca.vertcat(ca.MX.zeros(_MOST), ca.vec(values), 1, 0, -1)
    return ca.Function("first_samples", [given_path, order], [memory])


def _estimate() -> ca.Function:
    sizes = {"memory": sum(SIZES.values()), "path": _ROWS * DIMENSION, "h": 1, "at_end": 1, "order": 1}
    given = [ca.MX.sym(name, size) for name, size in sizes.items()]
    memory, given_path, h, at_end, order = given
    times, values, count, age, variance = ca.vertsplit(memory, [0, *accumulate(SIZES.values())])
    values = ca.reshape(values, _MOST, DIMENSION)
    elapsed, taken = age + ca.if_else(at_end, h, 0), h >= SHORTEST_STEP
    more = _with_sample(times, values, count, _sampled(given_path, order), elapsed, order)
    times, values, count = (ca.if_else(taken, new, old) for new, old in zip(more, (times, values, count), strict=True))
    age = ca.if_else(taken, 0, elapsed) + ca.if_else(at_end, 0, h)
    rows, error, variance, known = _estimated(times, values, count, variance, order)
    # Differences in order between derivatives 1, 2, ... of the path and of the samples.
    apart = ca.MX(ca.DM([[path - sample for sample in range(1, _ROWS)] for path in range(1, _ROWS)]))
    found = ca.vertcat(ca.MX.zeros(1, DIMENSION), (apart == order) @ rows)
    connected = ca.MX(ca.DM([k for k in range(_ROWS) for _ in range(DIMENSION)])) <= order
    path = ca.if_else(connected, given_path, ca.vec(found.T))
    after = ca.vertcat(times, ca.vec(values), count, age, variance)
    return ca.Function("estimate", given, [after, path, error, known])


def _worth(outputs: int) -> ca.Function:
    """Return (error of snap, path, outputs, p, peak so far) -> (peak of M_b, error of M_b, error to warn of)."""
    sizes = {"error": 1, "path": _ROWS * DIMENSION, "outputs": outputs, "p": 6, "peak": 1}
    given = [ca.SX.sym(name, size) for name, size in sizes.items()]
    error, path, found, p, before = given
    s, drop, peak = found[_S], -path[2] / (p[5] + path[8]), ca.fmax(before, ca.fabs(found[_M_B]))
    wrong = (p[0] / s + p[1] * s) * ca.fabs(drop) * error
    least = _DOUBT * ca.fmax(peak, _SLIGHT_TORQUE * p[2] * p[5] * s)
    return ca.Function("worth", given, [ca.vertcat(peak, wrong, least)])


def _only(number: ca.MX | int, numbers: Sequence[int]) -> ca.MX:
    """Return a row with one where `numbers` equal a number, and zero elsewhere."""
    return ca.MX(ca.DM(list(numbers)).T) == number


def _sampled(given_path: ca.MX, order: ca.MX) -> ca.MX:
    """Return the derivative of an order as a row."""
    return _only(order, range(_ROWS)) @ ca.reshape(given_path, DIMENSION, _ROWS).T


def _with_sample(
    times: ca.MX, values: ca.MX, count: ca.MX, row: ca.MX, elapsed: ca.MX, order: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Return samples with a new one, which replaces the newest if it has the same time."""
    newest = values[-1, :]
    small = _STANDSTILL + elapsed ** (_HIGHEST - order)
    rests = ca.logic_and(count == 1, ca.norm_inf(row - newest) <= small)  # a load at rest was at rest before
    past = ca.MX(ca.DM(range(1 - _MOST, 0)))
    after = ca.vertcat(ca.if_else(rests, elapsed * past, times[1:] - elapsed), 0)
    held = [ca.if_else(rests, newest[k], values[1:, k]) for k in range(DIMENSION)]
    again, number = elapsed <= 0, ca.if_else(rests, _MOST, ca.fmin(count + 1, _MOST))
    values = ca.vertcat(ca.if_else(again, values[:-1, :], ca.horzcat(*held)), row)
    return ca.if_else(again, times, after), values, ca.if_else(again, count, number)


# Fits -----------------------------------------------------------------------------------------------------------------


def _estimated(
    times: ca.MX, values: ca.MX, count: ca.MX, variance: ca.MX, order: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    """Return derivatives 1 to 4 of the samples at the newest, the error of snap, variance, whether they are known."""
    fits = {n: _fit(n) for n in sorted(set(_PLACES))}
    tried = {n: _longer(n, fit) for n, fit in fits.items()}
    first, second_fit = fits[_PLACES[0]], fits[_PLACES[1]]
    degree, highest = SAMPLES - 1 - order, _HIGHEST - order
    few, top = count <= degree, _only(highest, range(1, _ROWS))
    short = ca.fmin(degree, count - 1)
    recent = [(times[-n:], values[-n:, :]) for n in _PLACES]  # of each window
    rows, spread, newest, _ = first(*recent[0], short + 1, short)
    absurd = ca.fmax(0, ca.norm_inf(top @ rows) - _ABSURD) / (top @ newest)
    second = count > degree + _MORE[1]
    more_rows, more_spread, _, residual = second_fit(*recent[1], degree + 1 + _MORE[1], degree)
    share = ca.if_else(residual > variance, _RISE, _FALL)  # the variance rises fast and falls slowly
    learnt = ca.if_else(variance < 0, residual, variance + share * (residual - variance))
    variance = ca.if_else(second, ca.fmax(learnt, absurd**2), variance)
    size = ca.sqrt(ca.fmax(variance, 0)) + _ROUNDING * ca.norm_inf(values[-1, :])
    wide, more_wide = top @ spread * size, top @ more_spread * size
    apart = ca.norm_2(top @ more_rows - top @ rows)
    going = ca.logic_and(second, apart <= _AGREE * (wide + more_wide))
    others = len(_MORE) - 2
    found = ca.vertcat(top @ rows, top @ more_rows, ca.MX.zeros(others, DIMENSION))
    spreads = ca.vertcat(wide, more_wide, math.inf * ca.MX.ones(others))
    state = [ca.if_else(going, more_rows, rows), ca.if_else(going, more_wide, wide), found, spreads]
    error = ca.if_else(ca.logic_and(second, ca.logic_not(going)), apart, 0)
    for k in range(2, len(_MORE)):
        going = ca.logic_and(going, count > degree + _MORE[k])
        given = *recent[k], degree + 1 + _MORE[k], degree, top, size, k
        going, *state = tried[_PLACES[k]](going, *state, *given)
    known = ca.logic_or(ca.logic_not(few), count == 1)  # from one sample the load is at rest
    return state[0], ca.if_else(few, 0, error + _AGREE * state[1]), variance, known


def _longer(n: int, fit: ca.Function) -> ca.Function:
    """Return a function that compares a further window; it is fitted only if all shorter ones agree.

    Its arguments are whether they agree, the chosen derivatives, the spread of their snap, snaps and spreads of all
    windows, and the samples; its results are the first of these, with that window.
    """
    sizes = {"chosen": (_HIGHEST, DIMENSION), "wide": (1, 1), "found": (len(_MORE), DIMENSION)}
    sizes |= {"spreads": (len(_MORE), 1), "times": (n, 1), "values": (n, DIMENSION), "count": (1, 1), "degree": (1, 1)}
    sizes |= {"top": (1, _HIGHEST), "size": (1, 1), "place": (1, 1)}
    given = [ca.MX.sym(name, *size) for name, size in sizes.items()]
    chosen, wide, found, spreads, *samples, top, size, place = given
    rows, spread, *_ = fit(*samples)
    snap, spread = top @ rows, top @ spread * size
    apart = [found[:, k] - snap[k] for k in range(DIMENSION)]
    # Spreads of longer windows are infinite.
    far = ca.sqrt(sum(each**2 for each in apart)) > _AGREE * (spreads + spread)
    agrees, here = ca.mmax(far) == 0, _only(place, range(len(_MORE))).T
    after = [agrees, ca.if_else(agrees, rows, chosen), ca.if_else(agrees, spread, wide)]
    after += [ca.horzcat(*(ca.if_else(here, snap[k], found[:, k]) for k in range(DIMENSION)))]
    after += [ca.if_else(here, spread, spreads)]
    fitted = ca.Function(f"fitted_{n}", given, after)
    left = ca.Function(f"left_{n}", given, [ca.MX.zeros(1), chosen, wide, found, spreads])
    return ca.Function.if_else(f"longer_{n}", fitted, left)


def _fit(n: int) -> ca.Function:
    """Return the fit of a polynomial to at most n samples: (times, values, their number, degree) -> results.

    Results are derivatives 1 to 4 of the polynomial at the last time, their standard deviations for errors of unit
    variance, their sensitivities to an error of the newest sample, and the mean variance of the residuals.
    """
    times, values = ca.MX.sym("times", n), ca.MX.sym("values", n, DIMENSION)
    count, degree = ca.MX.sym("count"), ca.MX.sym("degree")
    place = ca.MX(ca.DM(range(1 - n, 1)))  # the newest is 0
    inside = place > -count
    span = ca.if_else(count > 1, ca.mmax(ca.if_else(inside, -times, 0)), 1)
    gaps = ca.fmax(count - 1, 1)
    nodes, even = times / span, place / gaps
    is_even = ca.mmax(ca.if_else(inside, ca.fabs(nodes - even), 0)) * gaps <= _EVEN
    x = ca.if_else(inside, 2 * ca.if_else(is_even, even, nodes) + 1, 0)
    left = ca.horzcat(*(ca.if_else(inside, column - column[-1], 0) for column in ca.horzsplit(values)))
    ends = ca.DM([[0, 1], *[[0, 0]] * _HIGHEST])
    state = [ca.MX.zeros(n), ca.MX(inside), ca.MX(1), ca.MX(ends), left]
    state += [ca.MX.zeros(_ROWS, DIMENSION), ca.MX.zeros(_ROWS), ca.MX.zeros(_ROWS)]
    term = _polynomial(n)
    for j in range(SAMPLES):
        state = list(term(x, degree - j, *state))
    *_, left, found, square, newest = state
    scale = (2 / span) ** ca.MX(ca.DM(range(1, _ROWS)))
    rows = ca.horzcat(*(column * scale for column in ca.horzsplit(found[1:, :])))
    freedom = ca.fmax(count - degree - 1, 1)
    results = [rows, ca.sqrt(square[1:]) * scale, ca.fabs(newest[1:]) * scale, ca.sumsqr(left) / (freedom * DIMENSION)]
    return ca.Function(f"fit_{n}", [times, values, count, degree], results)


def _polynomial(n: int) -> ca.Function:
    """Return one term of a fit: (nodes, number of further degrees, state) -> state for the next term.

    The state: the previous polynomial and this one at the nodes, the squared norm of the previous one, both with
    derivatives at the newest sample, residuals, and sums over all terms: derivatives, squared weights, newest weights.
    """
    sizes: dict[str, tuple[int, ...]] = {"x": (n,), "more": (1,), "before": (n,), "now": (n,), "norm": (1,)}
    sizes |= {"ends": (_ROWS, 2), "left": (n, DIMENSION), "found": (_ROWS, DIMENSION), "square": (_ROWS,)}
    sizes |= {"newest": (_ROWS,)}
    given = [ca.MX.sym(name, *size) for name, size in sizes.items()]
    x, more, before, now, norm_before, ends, left, found, square, newest = given
    end_before, end = ca.horzsplit(ends)
    moved, norm = x * now, ca.dot(now, now)
    share = ca.if_else(more >= 0, 1 / norm, 0)  # beyond the degree norms are zero
    weights = [ca.dot(now, column) * share for column in ca.horzsplit(left)]
    a, b = ca.dot(moved, now) * share, norm / norm_before
    following = ca.if_else(more >= 1, moved - a * now - b * before, 0)
    risen = ca.vertcat(0, ca.DM(range(1, _ROWS)) * end[:-1])  # k-th derivative of x times a polynomial, at 1
    after = [now, following, ca.if_else(more >= 1, norm, 1), ca.horzcat(end, (1 - a) * end + risen - b * end_before)]
    after += [ca.horzcat(*(column - now * by for column, by in zip(ca.horzsplit(left), weights, strict=True)))]
    after += [found + end @ ca.horzcat(*weights), square + end**2 * share, newest + end * end[0] * share]
    return ca.Function(f"polynomial_{n}", given, after)


def amplification(order: int) -> float:
    """Return the largest amplification of errors of equidistant samples in the snap, in units of h^(order-4).

    It is that of the shortest window, which is used while there are few samples or the path allows no longer one.
    """
    count, degree = SAMPLES - order, _HIGHEST - order
    nodes = np.arange(1.0 - count, 1.0)
    weights = math.factorial(degree) * np.linalg.inv(np.vander(nodes, increasing=True))[degree]
    return float(np.abs(weights).sum())
