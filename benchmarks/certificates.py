"""What certificates cost and bound: writes docs/speed-accuracy/certificates.md.

Run `python -m benchmarks.certificates`; with OPENBLAS_NUM_THREADS=1 where other programs run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import servocore as sc
from benchmarks.copies import cranes
from servocore.certificate.certify import Certificate
from servocore.numerics.machine_code import BACKGROUND
from servocore.problem import Problem

PAGE = Path(__file__).parents[1] / "docs" / "speed-accuracy" / "certificates.md"
REPEATS = 30
MASSES, INSTANTS = np.linspace(50.0, 150.0, 21), 20_001

HEAD = """# Certificates: cost and bounds

Processor times of warm calls of `sc.certify` with all statements, the smallest of thirty, machine code compiled; 201
instants. The error bound holds at all instants, as a share of an input's peak. The page is written by
`python -m benchmarks.certificates`; [Certificates](../certificate.md) says what they prove.

| scene | unknowns | intervals | verdict | error bound | time |
|---|---|---|---|---|---|
"""


def row(what: str, unknowns: int, certify: Callable[[], Certificate]) -> str:
    """Return a line of the table: the first calls prepare all walks and compile."""
    for _ in range(3):
        certify()
        BACKGROUND.wait()
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        certificate = certify()
        times.append(time.process_time() - begin)
    bound = max((each.relative for each in certificate.error_bounds.values()), default=float("nan"))
    shown = f"{bound:.0e}" if bound < 1e-3 else "-"  # of a box of parameters: inputs differ from one to another
    return (
        f"| {what} | {unknowns} | {len(certificate.intervals)} | {certificate.verdict} | {shown} |"
        f" {1e3 * min(times):.1f} ms |"
    )


def of_scene(what: str, scene: sc.Scene, model: str | None = None) -> str:
    """Return the line of a scene."""
    return row(what, len(Problem.of(scene, model).array.unknowns), lambda: sc.certify(scene, model=model))


def rows() -> Iterator[str]:
    """Yield the lines: scenes and models, friction, cranes side by side, intervals of parameters."""
    for name, make in sc.scenes.REGISTRY.items():
        scene = make()
        for model in scene.models:
            if Problem.of(scene, model).flat:
                yield of_scene(f"{name}, {model}", scene, model)
    for name in ("rotary_crane", "overhead_crane", "gantry_crane"):
        yield of_scene(f"{name} with friction", sc.scenes.REGISTRY[name]().with_effects("friction"))
    for count in (1, 4, 16):
        yield of_scene(f"{count} gantry cranes", cranes(count)[0])
    crane = sc.scenes.rotary_crane()
    jets = crane.reference.jet(np.linspace(0.0, crane.reference.end_time, INSTANTS), crane.closed_form_order)
    peaks = dict.fromkeys(("F", "M_b"), 0.0)
    for mass in MASSES.tolist():
        assert crane.closed_form is not None
        values = crane.closed_form(jets, {**crane.parameter_values(), "load_mass": mass})
        peaks = {name: max(peak, float(np.abs(values[name]).max())) for name, peak in peaks.items()}
    boxes: list[dict[str, tuple[float, float]]] = [{"load_mass": (50.0, 150.0)}]
    boxes.append({**boxes[0], "trolley_mass": (8.0, 12.0)})
    for share, box in ((1.001, boxes[0]), (0.95, boxes[0]), (1.2, boxes[1])):
        limits = {name: share * peak for name, peak in peaks.items()}
        within = " and ".join(f"{name} in {interval}" for name, interval in box.items())
        what = f"rotary_crane, {within}, limits {share:g} times the largest of 21 masses"
        unknowns = len(Problem.of(crane).array.unknowns)
        yield row(what, unknowns, lambda limits=limits, box=box: sc.certify(crane, limits, box))  # type: ignore[misc]  # bound now


def main() -> None:
    """Write the page."""
    PAGE.write_text(HEAD + "".join(f"{line}\n" for line in rows()), encoding="utf-8")
    print(PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
