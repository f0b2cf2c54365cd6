"""The 42-coordinate crane: sizes as in the paper, and the same inputs as nine coordinates give."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest
from ranks import has_independent_rows_at_home

import servocore as sc
from servocore import BackwardEuler
from servocore.formulations.projected import Projected
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.scenes.rotary_crane import INPUTS, PARAMETERS, bodies, points, rotary_crane
from servocore.solvers.solve import solve
from servocore.structure.derivative_array import DerivativeArray, derivative_array, second_order_equations
from servocore.structure.inversion import inversion
from servocore.structure.signature import signature

INPUT_NAMES = ("u.M_b", "u.F", "u.M_w")


@cache
def crane() -> MechanicalSystem:
    return bodies()


@cache
def compiled_inversion(model: Callable[[], sc.MechanicalSystem]) -> tuple[DerivativeArray, ca.Function]:
    array = derivative_array(model())
    return array, inversion(array).function


def inverted(model: Callable[[], sc.MechanicalSystem], jets: Array, changed: dict[str, float] | None = None) -> Array:
    """Unknowns of the derivative array, shape (unknowns, N), for jets of shape (N, orders, 3)."""
    array, invert = compiled_inversion(model)
    gamma = np.concatenate([jet[: array.reference_order + 1].T for jet in jets], axis=1)
    p = np.tile(PARAMETERS.values(changed)[:, None], (1, len(jets)))
    y, _, residual = invert.map(len(jets))(gamma, p)
    assert np.asarray(residual).max() < 1e-8
    return np.asarray(y)


def inputs(model: Callable[..., MechanicalSystem], jets: Array, changed: dict[str, float] | None = None) -> Array:
    array, _ = compiled_inversion(model)
    y = inverted(model, jets, changed)
    return y[[array.position(name, 0) for name in INPUT_NAMES]]


def random_jets(count: int = 40, seed: int = 0) -> Array:
    random = np.random.default_rng(seed)
    jets = random.normal(size=(count, 6, 3))
    jets[:, 0] = random.uniform((-6, -6, -8), (6, 6, -1), size=(count, 3))
    return jets


def test_it_has_the_paper_s_42_coordinates_37_constraints_and_five_degrees_of_freedom() -> None:
    assert crane().q.numel() == 42
    assert crane().lam.numel() == 37
    assert crane().degrees_of_freedom == 5


def test_its_constraints_are_independent_and_hold_above_any_load() -> None:
    system = crane()
    residual = ca.Function("g", [system.gamma, system.p], [ca.substitute(system.constraints, system.q, system.guess)])
    gamma = np.zeros(system.gamma.shape)
    for load in random_jets()[:, 0]:
        gamma[:, 0] = load
        np.testing.assert_allclose(residual(gamma, PARAMETERS.values()), 0.0, atol=1e-11)
    assert has_independent_rows_at_home(system)


def test_its_inverse_problem_has_index_five_and_no_degrees_of_freedom() -> None:
    found = signature(second_order_equations(crane()))
    assert found.degrees_of_freedom == 0
    assert found.index == 5


def test_servo_and_input_matrices_are_boolean_up_to_sign() -> None:
    system = crane()
    C, B = np.asarray(ca.DM(system.C)), np.asarray(ca.DM(system.input_matrix))
    names = system.coordinates.names
    assert [names[k] for k in C.argmax(axis=1)] == ["load.x", "load.y", "load.z"]
    assert [names[k] for k in (-B).argmax(axis=1)] == ["phi", "s", "beta"]
    for matrix in (C, -B):
        np.testing.assert_array_equal(np.sort(matrix, axis=1)[:, -1], 1.0)
        assert np.count_nonzero(matrix) == 3


def test_mass_is_constant_and_semidefinite_with_the_three_augmented_coordinates_massless() -> None:
    M = np.asarray(ca.Function("M", [crane().p], [crane().mass])(PARAMETERS.values()))
    eigenvalues = np.linalg.eigvalsh(M)
    assert eigenvalues.min() >= 0.0
    assert np.count_nonzero(eigenvalues == 0.0) == 3
    assert not ca.depends_on(crane().mass, crane().q)


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {
            "bridge_inertia": 60.0,
            "winch_inertia": 3.0,
            "winch_radius": 0.4,
            "trolley_mass": 35.0,
            "load_mass": 20.0,
        },
        {
            "bridge_inertia": 1.0,
            "winch_inertia": 50.0,
        },  # no three real bodies have these, the sums still count
    ],
    ids=["default", "other", "unreal"],
)
def test_its_inputs_are_those_of_nine_coordinates_at_random_instants(changed: dict[str, float]) -> None:
    jets = random_jets()
    found, expected = inputs(crane, jets, changed), inputs(points, jets, changed)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_at_rest_only_the_winch_holds_the_load() -> None:
    jet = np.zeros((1, 6, 3))
    jet[0, 0] = (3.0, -4.0, -2.5)
    p = dict(zip(PARAMETERS.names, PARAMETERS.values(), strict=True))
    weight = p["load_mass"] * p["gravity"]
    np.testing.assert_allclose(inputs(crane, jet)[:, 0], [0.0, 0.0, -weight * p["winch_radius"]], atol=1e-9)


def test_observables_read_angle_distance_length_tension_and_swing_of_the_rope() -> None:
    system, (array, _) = crane(), compiled_inversion(crane)
    jet = np.zeros((1, 6, 3))
    jet[0, 0], jet[0, 2] = (3.0, 4.0, -2.0), (0.6, 0.8, 0.0)  # accelerates outwards along the bridge
    y = inverted(crane, jet)
    names = [f"q.{name}" for name in system.coordinates.names]
    q = y[[array.position(name, 0) for name in names]]
    lam = y[[array.position(f"lam.{k + 1}", 0) for k in range(37)]]
    read = ca.Function("observe", [system.q, system.lam, system.p], list(system.observables.values()))
    values = [float(each) for each in read(q, lam, PARAMETERS.values())]
    found = dict(zip([each.name for each in system.observables], values, strict=True))
    lead = 2.0 / 9.81  # of the trolley before the load: the rope points along acceleration minus gravity
    expected = {
        "phi": np.arctan2(4.0, 3.0),
        "s": 5.0 + lead,
        "l": np.hypot(2.0, lead),
        "tension": 100.0 * np.hypot(9.81, 1.0),
        "swing": np.arctan2(1.0, 9.81),
    }
    assert found == pytest.approx(expected, rel=1e-10)


def test_projected_backward_euler_follows_the_path_with_errors_of_first_order() -> None:
    coarse, fine = worst_input_errors(200), worst_input_errors(400)
    # The drum turns by up to 0.4 rad a step; its directors feel that, so M_w errs more than with `points`.
    assert (coarse < (0.3, 0.01, 0.01)).all()
    np.testing.assert_allclose(coarse / fine, 2.0, atol=0.1)


def worst_input_errors(steps: int) -> Array:
    """Largest errors of the inputs along the default path, relative to their peaks, shape (3,)."""
    scene = rotary_crane()
    solution = solve(scene, Projected(), BackwardEuler(), step=20.0 / steps, model="bodies")
    exact = scene.exact(solution.t)
    names = [each.name for each in INPUTS]
    return np.array([np.abs(solution[name] - exact[name]).max() / np.abs(exact[name]).max() for name in names])
