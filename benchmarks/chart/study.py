"""What is measured: scenes, the library's routes and the peers' on each, and the study of orders."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import servocore as sc
from benchmarks.chart import own
from benchmarks.chart.candidate import Candidate, Problem
from benchmarks.chart.paths import straight
from benchmarks.chart.record import ORDER_SCENE
from benchmarks.chart.rows import Row
from benchmarks.chart.timing import Timed, measure, one_line

PEERS = (
    "plain_python", "casadi_integrators", "sundials_ida", "scipy_dae", "gekko_dynamic", "pyomo_dae", "exudyn_solver",
)  # fmt: skip
"""Modules of `benchmarks.peers`."""

Say = Callable[[str], None]


def problems() -> list[Problem]:
    """Return the scenes of the study, under their names."""
    scenes = {
        "rotary_crane": sc.scenes.rotary_crane(),
        "overhead_crane": sc.scenes.overhead_crane(),
        "three_cars": sc.scenes.cars(3),
        "mass_on_car": sc.scenes.mass_on_car(),
        "arm": sc.scenes.passive_joint_arm(),
    }
    return [Problem(name, scene) for name, scene in scenes.items()]


def order_problem() -> Problem:
    """Return the rotary crane on the smoother path, on which orders can be seen."""
    crane = sc.scenes.rotary_crane()
    path = straight(crane)
    smooth = sc.rest_to_rest(path.start, path.end, path.duration, sc.DEGREE13)
    return Problem(ORDER_SCENE, crane.with_reference(smooth))


@dataclass(frozen=True)
class Effort:
    """How much is measured: everything, or two settings of each solver on one scene."""

    smoke: bool = False
    peers: Sequence[str] = PEERS
    only: Sequence[str] = ()
    budget: float = 0.25


def carry_out(effort: Effort, say: Say) -> list[Timed]:
    """Measure everything."""
    chosen = [each for each in problems() if not effort.only or each.name in effort.only]
    timed: list[Timed] = []
    for problem in chosen[:1] if effort.smoke else chosen:
        candidates = [*own.closed_form(problem), *own.candidates(problem, effort.smoke)]
        refused: list[Timed] = []
        for peer in effort.peers:
            found = peer_candidates(peer, problem, effort)
            candidates += found if isinstance(found, list) else []
            refused += [found] if isinstance(found, Timed) else []
        timed += [*measure(candidates, say, effort.budget), *refused]
    if not effort.only or ORDER_SCENE in effort.only:
        timed += measure(own.order_candidates(order_problem(), effort.smoke), say, slow=0.0)  # errors are what counts
    return timed


def peer_candidates(module: str, problem: Problem, effort: Effort) -> list[Candidate] | Timed:
    """Return what a peer is to do, or the row that says why it cannot."""
    peer = importlib.import_module(f"benchmarks.peers.{module}")
    try:
        found: list[Candidate] = peer.candidates(problem, effort)
    except Exception as error:  # a peer that is not installed, or does not load, is listed with its message
        return Timed(Row(problem.name, peer.NAME, "", "", "", "", message=one_line(error)))
    return found
