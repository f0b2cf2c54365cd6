"""Costs as counts: steps, Newton iterations and factorizations on the default crane, which no busy machine can shake.

A bound is what was needed when it was written, and three in a hundred more for other processors' rounding. Who makes a
method cheaper lowers its bounds; who makes it dearer has to say why here.
"""

from __future__ import annotations

import pytest
from processes import python

import servocore as sc
from servocore.solution import Statistics

CRANE = sc.scenes.rotary_crane()
STEPS = 200
SLACK = 1.03

NEEDED: dict[sc.Method, tuple[int, int]] = {
    sc.BackwardEuler(): (569, 5129),
    sc.BDF(1): (569, 5129),
    sc.BDF(2): (479, 4879),
    sc.BDF(3): (433, 4833),
    sc.BDF(4): (405, 4803),
    sc.BDF(5): (394, 4755),
    sc.BDF(6): (322, 4527),
    sc.RadauIIA(1): (569, 5129),
    sc.RadauIIA(2): (564, 10113),
    sc.RadauIIA(3): (460, 14496),
    sc.RadauIIA(4): (400, 18914),
    sc.RadauIIA(5): (394, 22818),
    sc.RadauIIA(6): (260, 26587),
    sc.RadauIIA(7): (231, 30883),
    sc.Trapezoidal(): (569, 5129),
    sc.Gauss(1): (689, 5332),
    sc.Gauss(2): (564, 10140),
    sc.GeneralizedAlpha(): (453, 8453),
}
"""Newton iterations and factorizations of 200 projected steps, smallest model."""

EXACT = {"points": (707, 7818), "generalized": (596, 1596), "bodies": (620, 25155)}
"""The same of 200 instants of exact inversion, by model."""

PROJECTED = {"points": (569, 5129), "generalized": (590, 590), "bodies": (696, 22131)}
"""The same of 200 steps of backward Euler, by model."""

CONTROLLED = {1e-3: (600, 513), 1e-6: (1400, 849)}
"""Steps of all runs, and iterations of the last, that Radau IIA with five stages takes to a tolerance."""


def require_at_most(found: Statistics, needed: tuple[int, int]) -> None:
    assert found.steps == STEPS
    assert 0 < found.newton_iterations <= SLACK * needed[0]
    assert 0 < found.factorizations <= SLACK * needed[1]


@pytest.mark.filterwarnings("ignore::servocore.ServocoreWarning")  # of inputs that an undamped method loses
@pytest.mark.parametrize("method", NEEDED, ids=lambda method: method.name)
def test_a_method_takes_no_more_iterations_and_factorizations_than_it_did(method: sc.Method) -> None:
    solution = sc.solve(CRANE, sc.Projected(), method, step=CRANE.reference.duration / STEPS)
    require_at_most(solution.statistics, NEEDED[method])


def test_every_kind_of_method_is_counted() -> None:
    made = {type(method) for method in NEEDED}
    exported = {getattr(sc, name) for name in sc.__all__ if hasattr(getattr(sc, name), "discretize")}
    assert exported - {sc.Method} == made


@pytest.mark.parametrize("model", CRANE.models)
@pytest.mark.parametrize(
    ("form", "needed"), [(sc.Reduced(), EXACT), (sc.Projected(), PROJECTED)], ids=["exact", "steps"]
)
def test_no_model_takes_more_than_it_did(form: sc.Formulation, needed: dict[str, tuple[int, int]], model: str) -> None:
    step = CRANE.reference.duration / STEPS
    require_at_most(sc.solve(CRANE, form, sc.BackwardEuler(), step=step, model=model).statistics, needed[model])


@pytest.mark.parametrize("method", [sc.BDF(4), sc.RadauIIA(5)], ids=lambda method: method.name)
def test_smaller_steps_need_fewer_iterations_each_because_the_guess_is_extrapolated(
    method: sc.Method,
) -> None:
    per_step = []
    for steps in (200, 400, 800):
        found = sc.solve(CRANE, sc.Projected(), method, step=CRANE.reference.duration / steps).statistics
        per_step.append(found.newton_iterations / found.steps)
    assert per_step[2] < per_step[1] < per_step[0]
    assert per_step[2] < 1.3


@pytest.mark.parametrize("rtol", CONTROLLED)
def test_error_control_takes_no_more_steps_than_it_did(rtol: float) -> None:
    found = sc.solve(CRANE, sc.Projected(), sc.RadauIIA(5), step=sc.Adaptive(rtol=rtol)).statistics
    steps, iterations = CONTROLLED[rtol]
    assert found.steps <= steps
    assert found.newton_iterations <= SLACK * iterations


def test_a_first_solve_compiles_no_search_and_imports_no_package_that_it_does_not_need() -> None:
    script = """
import sys
started = set(sys.modules)
import servocore as sc
import servocore.structure.inversion as inversion
compiled = []
inversion.compile_solver = lambda name, *_: compiled.append(name)
crane = sc.scenes.rotary_crane()
sc.analyse(crane)
sc.solve(crane)
sc.ExactInversion(crane)(3.0)
print(compiled)
print(*sorted({name.split(".")[1] for name in sys.modules if name.count(".") > 1 and name.startswith("servocore.")}))
print([name for name in ("scipy", "pathlib", "servocore.numerics.code_cache") if name in sys.modules.keys() - started])
"""
    done = python("-c", script)
    assert done.returncode == 0, done.stderr
    compiled, packages, more = done.stdout.splitlines()
    assert compiled == "[]"
    assert packages == "checks formulations methods model numerics references scenes solvers stepping structure"
    assert more == "[]"


def test_functions_keep_their_names_whatever_package_is_imported_first() -> None:
    script = "import servocore.cli.studies, servocore.cli.view, servocore as sc; print(sc.effects, sc.view)"
    done = python("-c", script)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("<function") == 2
