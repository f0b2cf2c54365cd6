"""Load and run a built FMU in a process of its own: ``python -I check_fmu.py FILE MODEL:FORMULATION ...``.

The process knows nothing of the project; what the FMU lacks is missed here.
"""

from __future__ import annotations

import sys

import numpy as np
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

STEPS = 5
FOREIGN = ("servocore", "crane_fmu", "pythonfmu", "scipy")


def hang(file: str, model: str, formulation: str) -> None:
    """Let the load hang at rest for a few steps."""
    messages: list[str] = []
    try:
        result = simulate_fmu(
            file,
            stop_time=0.1 * STEPS,
            output_interval=0.1,
            start_values={"model": model, "formulation": formulation},
            debug_logging=True,
            logger=lambda _, __, ___, ____, message: messages.append(message.decode()),
        )
    except Exception as error:
        raise AssertionError(f"{model}, {formulation}: {error}: {'; '.join(messages) or 'no message'}") from error
    said = f"{model}, {formulation}: {'; '.join(messages) or 'no message'}"
    assert len(result) == STEPS + 1, f"stopped after {len(result) - 1} of {STEPS} steps: {said}"
    weight, rope = result["tension"] + 10.0 * result["M_w"], result["l"] - 5.0
    worst = max(np.abs(result[name]).max() for name in ("M_b", "F", "phi", "swing"))
    assert max(np.abs(weight).max(), np.abs(rope).max(), worst) < 1e-6, f"a load at rest moves: {said}"


def main(file: str, *routes: str) -> None:
    """Raise AssertionError with a sentence if anything is wrong."""
    problems = validate_fmu(file)
    assert not problems, "; ".join(problems)
    for route in routes:
        hang(file, *route.split(":"))
    foreign = [name for name in FOREIGN if name in sys.modules]
    assert not foreign, f"the FMU imports {', '.join(foreign)} from its host"


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except AssertionError as error:
        sys.exit(str(error))
