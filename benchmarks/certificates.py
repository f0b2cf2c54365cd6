"""What certificates of the flat scenes cost and bound: the table of docs/certificate.md.

Run `python -m benchmarks.certificates`.
"""

from __future__ import annotations

import time

import servocore as sc
from servocore.problem import Problem


def row(scene: sc.Scene, model: str) -> str:
    """Return the line of a model, after two calls: the second finds compiled products, and all walks prepared."""
    problem = Problem.of(scene, model)
    for _ in range(3):
        begin = time.process_time()
        certificate = sc.certify(scene, model=model)
        taken = time.process_time() - begin
    bound = max((each.relative for each in certificate.error_bounds.values()), default=float("nan"))
    return (
        f"| {scene.name}, {model} | {len(problem.array.unknowns)} | {len(certificate.intervals)} | {bound:.0e} |"
        f" {1e3 * taken:.0f} ms |"
    )


def main() -> None:
    """Print the table."""
    for make in sc.scenes.REGISTRY.values():
        scene = make()
        for model in scene.models:
            if Problem.of(scene, model).flat:
                print(row(scene, model), flush=True)


if __name__ == "__main__":
    main()
