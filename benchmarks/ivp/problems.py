"""The three problems as they are run here: scenes, starts, and what is known of their ends."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

import servocore as sc
from benchmarks.ivp import REFERENCES

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from outside import fekete, ivp, slider_crank, wheelset

__all__ = ["IvpProblem", "at_the_end", "digits", "fekete", "problems", "wheelset"]


@dataclass(frozen=True, eq=False)
class IvpProblem:
    """A problem of the test set.

    Attributes
    ----------
    name, title : str
        In files, and on the page.
    system : MechanicalSystem
        With an input that stands in for what the test set leaves out, or prescribes.
    own : mapping
        Name of a route -> function of its setting, which returns a solution.
    settings : mapping
        Name of a route -> settings from coarse to fine.
    start : ndarray
        (q, v) at the time zero.
    input : callable or None
        Time -> input; None where it is unknown and its output follows `driven`.
    """

    name: str
    title: str
    system: sc.MechanicalSystem
    own: dict[str, Callable[[float], sc.Solution]]
    settings: dict[str, tuple[float, ...]]
    start: np.ndarray
    end: float
    published: dict[str, float]
    force: float | None
    driven: Callable[[ca.SX], ca.SX] | None = None

    def reference(self) -> dict[str, float]:
        """Values at the end, integrated with 40 digits."""
        found = json.loads(REFERENCES.read_text())[self.name]
        names = list(self.system.coordinates.names)
        names += [f"{each}_dot" for each in names] + [f"lam_{k + 1}" for k in range(self.system.lam.numel())]
        values = [float(each) for each in (*found["q"], *found["v"], *found["lam"])]
        if self.force is None:
            names.append(self.system.inputs[0].name)
        return {name: value for name, value in zip(names, values, strict=True) if value}


def digits(found: dict[str, float], exact: dict[str, float]) -> dict[str, float]:
    """Significant correct digits by name."""
    return {
        name: float(-np.log10(max(abs(found[name] / value - 1.0), 1e-16))) for name, value in exact.items()
        if name in found
    }  # fmt: skip


def at_the_end(solution: sc.Solution) -> dict[str, float]:
    """Return the last row of a solution, by name."""
    return {name: float(solution[name][-1]) for name in solution.names}


def free_motion(name: str, title: str, problem: ivp.InitialValueProblem) -> IvpProblem:
    """Return a problem whose motion is free: for `simulate`."""
    return IvpProblem(
        name, title, problem.scene.model(), {"simulate, rtol": problem.simulated},
        {"simulate, rtol": (1e-6, 1e-8, 1e-10, 1e-12)},
        np.array(list(problem.start.values())), problem.end, problem.published, problem.force,
    )  # fmt: skip


def crank() -> IvpProblem:
    """Return the slider crank, whose crank turns evenly: a servo constraint with eight internal states, for `solve`."""
    scene = slider_crank.slider_crank(nominal=1e-5)

    def by(stages: int) -> Callable[[float], sc.Solution]:
        return lambda steps: sc.solve(
            scene, sc.Reduced(), sc.RadauIIA(stages), step=slider_crank.END / steps, start=slider_crank.SMOOTH_START,
            checks=False,
        )  # fmt: skip

    start = np.array(list(slider_crank.SMOOTH_START.values()))
    q, v, _ = slider_crank.configuration(0.0, start, slider_crank.l_2)
    return IvpProblem(
        "slider_crank", "Slider crank", scene.model(),
        {"solve, RadauIIA(3), steps": by(3), "solve, RadauIIA(5), steps": by(5)},
        {"solve, RadauIIA(3), steps": (1000, 4000), "solve, RadauIIA(5), steps": (1000, 4000)},
        np.concatenate([q, v]), slider_crank.END, slider_crank.PUBLISHED, None, lambda t: slider_crank.OMEGA * t,
    )  # fmt: skip


def problems() -> tuple[IvpProblem, ...]:
    """Return all three."""
    return (
        free_motion("car_axis", "Car axis", ivp.car_axis()),
        free_motion("squeezer", "Andrews' squeezing mechanism", ivp.andrews_squeezer()),
        crank(),
    )
