"""What the page tells beside the rows: scenes, machine, the paper's own step, the cost beside C."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

import servocore as sc
from benchmarks.chart import own
from benchmarks.chart.c_cost import measure_costs, shares_of_solve
from benchmarks.chart.candidate import OUTPUT_INTERVALS, Problem
from benchmarks.chart.machine import facts as machine_facts
from benchmarks.chart.study import PEERS

STARTING_STEPS = 6.5
"""Steps after which the longest history, of six steps, is past."""


def gather(problems: Sequence[Problem], smoke: bool) -> dict[str, Any]:
    """Measure and list everything; of the first scene, what is told of one scene only."""
    main = problems[0].scene
    models = list(main.models)
    peers = [importlib.import_module(f"benchmarks.peers.{name}") for name in PEERS]
    costs = measure_costs(main, models[:1] if smoke else models, 2 if smoke else 15)
    return {
        "scenes": [scene_facts(each) for each in problems],
        "machine": machine_facts(each.DISTRIBUTION for each in peers),
        "paper": paper_step(main, smoke),
        "costs": [asdict(each) for each in costs],
        "shares": shares_of_solve(main, 2 if smoke else 40),
    }


def scene_facts(problem: Problem) -> dict[str, Any]:
    """Return what kind of problem a scene is."""
    report, path = sc.analyse(problem.scene), problem.scene.reference
    models = {name: len(problem.scene.model(name).coordinates) for name in problem.scene.models}
    return {"name": problem.name, "models": models, "index": report.index, "smoothness": path.smoothness,
            "internal_states": report.internal_degrees_of_freedom, "duration": path.duration}  # fmt: skip


def paper_step(scene: sc.Scene, smoke: bool) -> list[dict[str, Any]]:
    """Return errors of every input at the paper's own step of 0.1 s, of our routes on the smallest model."""
    step = scene.reference.duration / OUTPUT_INTERVALS
    methods = [each for each in own.METHODS if each.orders(3).forces > 0]
    routes: list[tuple[sc.Formulation, sc.Method]] = [(sc.Reduced(), sc.BackwardEuler())]
    routes += [(sc.Projected(), method) for method in (methods[:3] if smoke else methods)]
    found = []
    for formulation, method in routes:
        solution = sc.solve(scene, formulation, method, step=step)
        exact = scene.exact(solution.t)
        late = solution.t > solution.t[0] + STARTING_STEPS * step
        errors = {
            each.name: np.abs(solution[each.name] - exact[each.name]) / np.abs(exact[each.name]).max()
            for each in scene.model().inputs
        }
        found.append({
            "formulation": formulation.name,
            "method": "exact inversion" if formulation == sc.Reduced() else method.name,
            "errors": {name: float(f"{each.max():.2e}") for name, each in errors.items()},
            "late": float(f"{max(each[late].max() for each in errors.values()):.2e}"),
        })  # fmt: skip
    return found
