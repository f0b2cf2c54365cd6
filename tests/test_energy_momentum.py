"""The energy-momentum scheme: what it conserves, at which order it errs, what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import conserved
import numpy as np
import pytest
from problems import scene
from thinned import thinned

import servocore as sc
from servocore.model.potentials import Stored
from servocore.stepping.energy_momentum import conserving_equations

MECHANISMS: dict[Callable[[], conserved.Motion], tuple[tuple[float, ...], tuple[float, int]]] = {
    conserved.free_body: ((0.1, 0.03, 0.01), (0.01, 1000)),
    conserved.heavy_top: ((0.01, 0.002), (0.01, 1000)),
    conserved.crane: ((0.1, 0.01), (0.03, 1000)),
    conserved.braked_crane: ((0.1, 0.01), (0.1, 100)),
    conserved.four_bar: ((0.03, 0.01), (0.03, 1000)),
    conserved.floating_loop: ((0.1, 0.01), (0.1, 1000)),
}
"""Mechanisms and steps in s; with rotations as unknowns, a step and a number of steps."""

MULTIPLIERS, ROTATIONS = sc.EnergyMomentum(), sc.EnergyMomentum(sc.RotationUpdate())
RUNS = [
    *((make, h, n, MULTIPLIERS) for make, (each, _) in MECHANISMS.items() for h in each for n in (1_000, 10_000)),
    *((make, *run, ROTATIONS) for make, (_, run) in MECHANISMS.items()),
]


def named(value: Any) -> str:
    return value.__name__ if callable(value) else str(value)


EACH_MECHANISM = pytest.mark.parametrize("make", MECHANISMS, ids=named)


@pytest.mark.parametrize(("make", "step", "steps", "method"), thinned(RUNS, lambda run: run[2] < 10_000), ids=named)
def test_energy_momentum_and_constraints_stay(
    make: Callable[[], conserved.Motion], step: float, steps: int, method: sc.EnergyMomentum
) -> None:
    motion = make()
    found = motion.run(step, steps, every=10, method=method)
    energy, momentum = motion.drift(found)
    assert energy < 1e-10
    assert momentum < 1e-10
    assert found.statistics.constraint_violation < 1e-12


@EACH_MECHANISM
def test_errors_fall_with_the_square_of_the_step(make: Callable[[], conserved.Motion]) -> None:
    """At 0.2 s, against integration with error control of the equations differentiated twice."""
    motion, count = make(), 25 if make is not conserved.heavy_top else 200
    exact = motion.run(0.2 / count, count, every=count, rtol=1e-12, atol=1e-13)
    names = motion.system.coordinates.names
    errors = []
    for finer in (1, 2, 4):
        found = motion.run(0.2 / count / finer, count * finer, every=count * finer)
        errors.append(max(abs(found[name][-1] - exact[name][-1]) for name in names))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def test_the_energy_changes_by_the_work_of_the_inputs() -> None:
    motion = conserved.crane()
    found = motion.run(0.05, 2000, inputs=lambda t: np.array([20 * np.sin(t), 5 * np.cos(0.7 * t), 3 * np.sin(2 * t)]))
    change = found["energy"] - found["energy"][0]
    assert np.ptp(found["work"]) > 10.0
    assert np.abs(change - found["work"]).max() < 1e-8 * np.abs(found["energy"]).max()


@EACH_MECHANISM
def test_the_condition_of_a_step_does_not_depend_on_its_size(make: Callable[[], conserved.Motion]) -> None:
    motion = make()
    system = motion.system
    equations, _ = conserving_equations(system)
    J = ca.jacobian(equations.residual, equations.unknowns)
    scaled = ca.mtimes([ca.diag(1 / equations.residual_scale), J, ca.diag(equations.unknown_scale)])
    matrix = ca.Function("J", [equations.unknowns, equations.givens], [ca.densify(scaled)])
    names, p = system.coordinates.names, system.parameters.values()
    q = np.array([motion.start[each] for each in names])
    lam, u = np.zeros(system.lam.numel()), np.zeros(len(system.inputs))
    conditions = [
        np.linalg.cond(np.asarray(matrix(np.r_[q, lam], np.r_[q, 0 * q, lam, u, h, p]))) for h in (1e-2, 1e-4, 1e-6)
    ]
    np.testing.assert_allclose(conditions, conditions[0], rtol=0.05)


def test_rates_of_constraints_tell_how_far_off_a_coarse_step_is() -> None:
    """Velocities keep them in the mean of a step only: 100 times off for ten times the step."""
    motion = conserved.free_body()
    coarse, fine = (motion.run(h, round(1 / h)).statistics.constraint_rate_violation for h in (0.1, 0.01))
    assert 50 < coarse / fine < 200


# Rotations as unknowns ------------------------------------------------------------------------------------------------


@EACH_MECHANISM
def test_rotations_as_unknowns_give_the_motion_and_the_forces_that_multipliers_give(
    make: Callable[[], conserved.Motion],
) -> None:
    """Over fifty steps: afterwards some of these motions magnify round-off."""
    motion, (_, (step, _)) = make(), MECHANISMS[make]
    with_multipliers, turned = (motion.run(step, 50, method=each) for each in (MULTIPLIERS, ROTATIONS))
    names = (*motion.system.coordinates.names, "work", "energy")
    for name in names:
        np.testing.assert_allclose(turned[name], with_multipliers[name], rtol=1e-9, atol=1e-9)


def test_the_null_space_has_no_columns_that_become_dependent() -> None:
    """With dependent columns chosen once a four-bar linkage stops at step 1110."""
    motion = conserved.four_bar()
    found = motion.run(0.01, 3000, every=100, method=ROTATIONS)
    assert motion.drift(found)[0] < 1e-10


def test_a_body_whose_directors_nothing_keeps_orthonormal_is_refused_by_name() -> None:
    motion = conserved.free_body()
    loose = replace(
        motion.system,
        constraints=motion.system.constraints[:5],
        multipliers=motion.system.lam[:5],
        constraint_names=motion.system.constraint_names[:5],
    )
    with pytest.raises(sc.InvalidModel, match="the directors of body orthonormal there are 5"):
        simulated(replace(motion.scene, models={"only": lambda: loose}), method=ROTATIONS, start=motion.start)


# Machine code ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("compiler")
def test_machine_code_changes_no_digit() -> None:
    motion = conserved.four_bar()
    interpreted, native = (
        motion.run(0.03, 1000, every=10, method=sc.EnergyMomentum(native=each)) for each in (False, True)
    )
    np.testing.assert_array_equal(native.values, interpreted.values)


def test_instants_that_are_reported_change_no_digit() -> None:
    motion = conserved.four_bar()
    all_steps, some = (motion.run(0.03, 1200, every=each) for each in (1, 7))
    np.testing.assert_array_equal(all_steps.values[::7][:100], some.values[:100])


# Refusals -------------------------------------------------------------------------------------------------------------


def simulated(found: sc.Scene, model: str | None = None, step: float = 0.1, **how: Any) -> sc.Solution:
    return sc.simulate(found, lambda _: np.zeros(3), t=np.array([0.0, 1.0]), model=model, **{
        "method": sc.EnergyMomentum(), "step": step, **how})  # fmt: skip


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ("points", "rotations about the z axis leave these constraints .* only where they vanish.*: g_2, g_3"),
        ("generalized", "its mass depends on the configuration"),
        ("bodies", "at most quadratic, but these are not: phi, beta"),
    ],
)
def test_models_that_the_scheme_cannot_conserve_are_refused_by_name(model: str, said: str) -> None:
    with pytest.raises(sc.InvalidModel, match=said):
        simulated(scene("rotary_crane"), model)


def test_a_potential_that_is_more_than_quadratic_must_be_given_in_summands() -> None:
    base = conserved.crane()
    with pytest.raises(sc.InvalidModel, match="its potential is more than quadratic"):
        simulated(
            replace(base.scene, models={"only": lambda: replace(base.system, potential=ca.SX(base.system.potential))})
        )


@pytest.mark.parametrize("change", [9e-5, 1e-3, 1.0])
def test_the_difference_quotient_of_a_stored_energy_has_twelve_digits_where_values_are_close_too(change: float) -> None:
    found = float(ca.evalf(Stored(ca.exp, ca.SX.sym("x")).slope(ca.SX(-change / 2), ca.SX(change / 2))))
    assert found == pytest.approx(np.sinh(change / 2) / (change / 2), rel=1e-12)


def test_a_step_that_turns_too_far_is_refused_with_the_time() -> None:
    with pytest.raises(sc.IntegrationFailed, match=r"step from t = \d.* s was not solved: something turns or swings"):
        conserved.four_bar().run(0.3, 1000)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"step": 0.3}, "reports whole steps, but t = 1 s is 3.33333 steps of 0.3 s"),
        ({"step": -0.1}, "the step must be positive and finite, not -0.1"),
        ({"step": None}, "the step of the energy-momentum scheme"),
        ({"method": None}, "needs method=EnergyMomentum.*, not None"),
        ({"method": sc.BackwardEuler()}, "needs method=EnergyMomentum"),
    ],
)
def test_steps_and_methods_that_do_not_fit_are_refused(
    how: dict[str, float | sc.BackwardEuler | None], said: str
) -> None:
    with pytest.raises(sc.InvalidSetting, match=said):
        simulated(sc.scenes.rotary_crane(invariant=True), **how)  # type: ignore[arg-type]  # wrong on purpose
