"""The index of a form is that of its equations, whatever the formulation says: told by linear algebra at rest.

At rest a form is linear with constant coefficients, E x' + A x = 0, and its differentiation index is the number of
times that rows without derivatives have to be differentiated until E is regular (Luenberger's shuffle algorithm, 1978).
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from problems import FORMULATIONS, REFUSED, changed, scene

import servocore as sc
from servocore.structure.inversion import inversion

SCENES = {
    **{name: scene(name) for name in sc.scenes.REGISTRY},
    "three cars": sc.scenes.cars(3),
    "flat car": scene("mass_on_car").with_parameters(inclination=0.0),
    "flat car without damper": scene("mass_on_car").with_parameters(inclination=0.0, damping=0.0),
    "upright car": scene("mass_on_car").with_parameters(inclination=np.pi / 2),
    "bar of five masses": sc.scenes.elastic_bar(5),
}
CASES = [
    pytest.param(name, model, of.formulation, id=f"{name}-{model}-{of.formulation.name}")
    for name, each in SCENES.items()
    for model in each.models
    for of in FORMULATIONS
    if (name, model, of.kind) not in REFUSED
]


def at_rest(problem: sc.Problem, dae: sc.Dae) -> tuple[np.ndarray, np.ndarray]:
    """Return E and A of a form, linearized where everything rests at the start of the path."""
    system, array = problem.system, problem.array
    gamma = np.zeros(system.gamma.shape)
    gamma[:, 0] = problem.reference.jet(problem.reference.start_time, 0)[0]
    values, _, residual = inversion(array).function(gamma[:, : array.reference_order + 1], problem.p)
    assert float(residual) < 1e-9
    unknowns = np.array([float(values[array.position(each.variable, each.order)]) for each in dae.unknowns])
    x = ca.vertcat(dae.x, dae.z)
    evaluate = ca.Function("form", [x, dae.gamma, dae.p], [dae.H, ca.jacobian(ca.vertcat(dae.f, dae.h), x)])
    H, A = (np.asarray(each) for each in evaluate(unknowns, gamma, problem.p))
    E = np.zeros_like(A)
    E[: H.shape[0], : H.shape[1]] = H
    return E, -A


def differentiations(E: np.ndarray, A: np.ndarray) -> int:
    """Count the sweeps of the shuffle algorithm until E is regular."""
    for count in range(len(E) + 1):
        size = np.abs(np.hstack([E, A])).max(axis=1, keepdims=True)
        E, A = E / size, A / size
        left, values, _ = np.linalg.svd(E)
        rank = int((values > 1e-9 * max(values[0], 1e-9)).sum())
        if rank == len(E):
            return count
        E, A = left.T @ E, left.T @ A
        E[rank:], A[rank:] = A[rank:], 0.0
    raise AssertionError("the pencil is singular")


@pytest.mark.parametrize(("name", "model", "formulation"), CASES)
def test_the_index_of_a_form_is_the_number_of_differentiations_it_needs(
    name: str, model: str, formulation: sc.Formulation
) -> None:
    problem = sc.Problem.of(SCENES[name], model)
    dae = problem.dae(formulation)
    needed = differentiations(*at_rest(problem, dae))
    assert dae.index == (needed if dae.x.numel() else needed - 1)  # a form without differential unknowns counts as zero


def test_an_index_above_three_is_warned_of_with_its_number() -> None:
    with pytest.warns(sc.ServocoreWarning, match="the form has index 5, on which the inputs of radau3 err"):
        sc.solve(scene("cars"), sc.Original(), sc.RadauIIA(3), step=0.2)


def test_a_small_system_of_one_s_own_has_its_index_too() -> None:
    system = changed(scene("mass_on_car").model(), name="a car of one's own")
    assert sc.Problem.of(system).dae(sc.Original()).index == 3
    assert sc.Problem.of(system).dae(sc.Reduced()).index == 1
