"""What `Solution.error` is worth: `python benchmarks/error_estimates.py [SCENE ...]`.

Every scene, model, form and method, damped or not, at 25 to 800 steps: the estimated error of every input divided by
the true one, told by the closed form, and whether a warning is given where the truth is above 5 % of the peak and only
there.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import servocore as sc

FORMS: tuple[sc.Formulation, ...] = (sc.Original(), sc.Projected(), sc.Reduced())
METHODS: tuple[sc.Method, ...] = (
    sc.BackwardEuler(), *map(sc.BDF, range(2, 7)), sc.RadauIIA(2), sc.RadauIIA(3), sc.GeneralizedAlpha(), sc.Gauss(1),
    sc.Gauss(2), sc.Trapezoidal(),
)  # fmt: skip
STEPS = (25, 50, 100, 200, 800)
JUDGED = 1e-9  # of the peak: errors that are smaller may be round-off
WARNED = 0.05


@dataclass(frozen=True)
class Judged:
    """One run: true errors relative to the peaks, estimates divided by them (None if unknown), and what was said."""

    name: str
    true: tuple[float, ...]
    ratios: tuple[float | None, ...]
    warned: bool
    branch: str


def judged(
    name: str, scene: sc.Scene, form: sc.Formulation, method: sc.Method, steps: int, model: str
) -> Judged | None:
    """Solve and compare with the closed form; None if the run is refused."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            found = sc.solve(scene, form, method, step=scene.reference.duration / steps, model=model)
        except sc.ServocoreError:
            return None
    exact, error = scene.exact(found.t), found.error
    off = {each: float(np.abs(found[each] - exact[each]).max()) for each in error}
    return Judged(
        f"{name}, {found.route}, {steps} steps",
        tuple(off[each] / float(np.abs(exact[each]).max()) for each in off),
        tuple(None if e is None else e / max(off[each], 1e-300) for each, e in error.items()),
        any("is off by" in str(each.message) for each in heard),
        found.statistics.branch,
    )


def runs(names: list[str]) -> Iterator[Judged]:
    """Solve all of some scenes."""
    for name in names:
        scene = sc.scenes.REGISTRY[name]()
        for model in scene.models:
            flat = sc.Problem.of(scene, model).flat
            for form in FORMS:
                for method in METHODS[:1] if flat and form == sc.Reduced() else METHODS:
                    for steps in STEPS:
                        found = judged(name, scene, form, method, steps, model)
                        if found is not None:
                            yield found


def main() -> None:
    """Print what differs, and the distribution of the ratios."""
    ratios, count, unknown = list[float](), 0, 0
    for each in runs(sys.argv[1:] or list(sc.scenes.REGISTRY)):
        count += 1
        unknown += each.ratios.count(None)
        ratios += [r for r, true in zip(each.ratios, each.true, strict=True) if r is not None and true > JUDGED]
        if each.warned != (max(each.true) > WARNED):
            print(f"{each.name}: {max(each.true):.2g} of the peak off, warned: {each.warned}")
        if not each.branch.startswith("one: ") and max(each.true) < WARNED:
            print(f"{each.name}: {max(each.true):.2g} of the peak off, {each.branch}")
    quantiles = ", ".join(f"{each:.6f}" for each in np.percentile(ratios, (0, 1, 50, 99, 100)))
    print(f"{count} runs, {len(ratios)} inputs, {unknown} unknown; estimate/truth at 0, 1, 50, 99, 100 %: {quantiles}")


if __name__ == "__main__":
    main()
