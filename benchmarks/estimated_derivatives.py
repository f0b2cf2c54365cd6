"""What estimated derivatives are worth with positions alone: `python benchmarks/estimated_derivatives.py`.

Largest errors along the default manoeuvre by the peaks of snap and M_b, and what a step costs. The last column is the
snap of the polynomial through the last seven positions, which no longer window mends.
"""

from __future__ import annotations

import time

import numpy as np

import servocore as sc
from crane_fmu.build.estimates import SAMPLES, estimates_of

CRANE = sc.scenes.rotary_crane()
PATH = CRANE.reference
FUNCTIONS = estimates_of(CRANE).functions
BEGIN, FOLLOW = FUNCTIONS["first_samples"], FUNCTIONS["estimate"]  # interpreted, as nowhere else


def times(kind: str) -> np.ndarray:
    """Return communication points over the manoeuvre."""
    if kind == "vary by 20 %":
        return np.concatenate([[0.0], np.cumsum(0.02 * np.random.default_rng(1).uniform(0.8, 1.2, 990))])
    if kind == "one split in 1 + 9 ms":
        return np.sort(np.append(0.01 * np.arange(2001), 9.001))
    return np.arange(0.0, 20.0 + 1e-9, float(kind))


def along(t: np.ndarray, rounding: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the jets that are estimated, the polynomials' snap, and the microseconds of a step."""
    exact = PATH.jet(t, 4)
    positions = np.round(exact[:, 0] / rounding) * rounding if rounding else exact[:, 0]
    told = np.zeros((len(t), 15))
    told[:, :3] = positions
    memory = BEGIN(told[0], 0)
    jets, through, spent = exact * 0.0, np.zeros((len(t), 3)), 0.0
    jets[:, 0] = positions
    for k in range(1, len(t)):
        begin = time.thread_time()
        memory, found, _, _ = FOLLOW(memory, told[k], t[k] - t[k - 1], 1.0, 0)
        spent += time.thread_time() - begin
        jets[k] = np.array(found).reshape(5, 3)
        if k >= SAMPLES:
            last = slice(k - SAMPLES + 1, k + 1)
            span = t[k] - t[last][0]
            fit = np.polyfit((t[last] - t[k]) / span, positions[last] - positions[k], SAMPLES - 1)
            through[k] = 24.0 * fit[-5] / span**4
    return jets, through, 1e6 * spent / (len(t) - 1)


def main() -> None:
    """Measure and print."""
    print(f"{'steps':>24} {'rounded to':>10} {'snap':>9} {'M_b':>9} {'us/step':>8} {'snap, seven samples':>20}")
    closed_form = CRANE.closed_form
    assert closed_form is not None
    cases = [(step, 0.0) for step in ("0.1", "0.01", "0.001", "vary by 20 %", "one split in 1 + 9 ms")]
    for kind, rounding in [*cases, ("0.01", 1e-6), ("0.01", 1e-5), ("0.01", 1e-4)]:
        t = times(kind)
        t = t[t <= PATH.end_time]
        exact = PATH.jet(t, 4)
        jets, through, spent = along(t, rounding)
        peak = np.abs(exact[:, 4]).max()
        snap, seven = (np.abs(each - exact[:, 4]).max() / peak for each in (jets[:, 4], through))
        wanted, found = (closed_form(each, CRANE.parameter_values())["M_b"] for each in (exact, jets))
        wrong = np.abs(found - wanted).max() / np.abs(wanted).max()
        print(f"{kind:>24} {rounding:10g} {snap:9.2g} {wrong:9.2g} {spent:8.0f} {seven:20.2g}", flush=True)


if __name__ == "__main__":
    main()
