"""Load and run a built FMU in a process of its own: ``python -I check_fmu.py FILE RUNS``.

RUNS are start values for one short run each, as JSON. The process imports nothing of the project, so that missing parts
of the FMU cause a failure.
"""

from __future__ import annotations

import json
import sys
import tempfile
from typing import Any

from fmpy import extract, read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

STEPS = 5
FOREIGN = ("servocore", "crane_fmu", "pythonfmu", "scipy")


def run(folder: str, description: Any, settings: dict[str, object]) -> None:
    """Take a few steps of an unpacked FMU with nothing connected."""
    messages: list[str] = []
    settable = (each for each in description.modelVariables if each.causality != "output")
    known = {each.name: each.declaredType for each in settable}
    numbers = {
        name: next(int(item.value) for item in known[name].items if item.name == value) if known[name] else value
        for name, value in settings.items()
        if name in known
    }
    label = ", ".join(map(str, settings.values())) or "defaults"
    try:
        result = simulate_fmu(
            folder,
            model_description=description,
            stop_time=0.1 * STEPS,
            output_interval=0.1,
            start_values=numbers,
            debug_logging=True,
            logger=lambda _, __, ___, ____, message: messages.append(message.decode()),
        )
    except Exception as error:
        raise AssertionError(f"{label}: {error}: {'; '.join(messages) or 'no message'}") from error
    stopped = f"stopped after {len(result) - 1} of {STEPS} steps: {label}: {'; '.join(messages) or 'no message'}"
    assert len(result) == STEPS + 1, stopped


def main(file: str, runs: str) -> None:
    """Raise AssertionError with a sentence if anything is wrong."""
    problems = validate_fmu(file)
    assert not problems, "; ".join(problems)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        extract(file, folder)
        description = read_model_description(folder, validate=False)
        for settings in json.loads(runs):
            run(folder, description, settings)
    foreign = [name for name in FOREIGN if name in sys.modules]
    assert not foreign, f"the FMU imports {', '.join(foreign)} from its host"


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except AssertionError as error:
        sys.exit(str(error))
