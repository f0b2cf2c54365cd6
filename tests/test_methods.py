"""Methods: every one by the inherited suite; what is special about each, by its textbook formula."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from problems import METHODS, problem, scene, solved
from suite import ZERO, MethodSuite, gamma, march, polynomial, small_dae, x, z

import servocore as sc
from servocore.dae import Dae, Equation, Unknown
from servocore.methods.bdf import coefficients
from servocore.methods.collocation import Tableau, tableau


@pytest.mark.parametrize("by", [by for by in METHODS if by.first_order_equations], ids=lambda by: by.method.name)
class TestEveryMethod(MethodSuite):
    pass


def test_backward_euler_multiplies_by_its_amplification_factor() -> None:
    """x_dot = -3 x: every step divides by 1 + 3 h."""
    found = march(sc.BackwardEuler(), small_dae(x, z, -3 * z, z - x, gamma), lambda _: [1.0, 1.0], ZERO, 0.2, 6)
    np.testing.assert_allclose(found[:, 0], 1.6 ** -np.arange(7.0), rtol=1e-14)


def test_backward_euler_takes_H_at_the_new_instant() -> None:  # noqa: N802
    """2 x x_dot = 1 becomes 2 x1 (x1 - x0) = h, equation (31): x1 = (x0 + sqrt(x0^2 + 2 h))/2."""
    dae = small_dae(x, z, ca.SX(1), z - x, gamma, H=2 * x)
    found = march(sc.BackwardEuler(), dae, lambda _: [1.0, 1.0], ZERO, 0.3, 3)[:, 0]
    expected = [1.0]
    for _ in range(3):
        expected.append((expected[-1] + np.sqrt(expected[-1] ** 2 + 0.6)) / 2)
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_backward_euler_uses_the_reference_at_the_new_instant_only() -> None:
    dae = small_dae(x, z, gamma[0], z - x, gamma)
    assert sc.BackwardEuler().discretize(dae).nodes == (1.0,)
    found = march(sc.BackwardEuler(), dae, lambda _: [0.0, 0.0], polynomial([0, 1.0]), 0.5, 2)
    np.testing.assert_allclose(found[:, 0], [0.0, 0.25, 0.75], rtol=1e-14)


@pytest.mark.parametrize("same", [sc.BDF(1), sc.RadauIIA(1)], ids=lambda method: method.name)
def test_the_lowest_order_of_a_family_is_backward_euler(same: sc.Method) -> None:
    """On the crane, to rounding."""
    crane = scene("rotary_crane")
    found = sc.solve(crane, sc.Projected(), same, step=0.4)
    expected = solved(problem("rotary_crane", "points"), 50)
    for name in ("M_b", "F", "M_w", "phi"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-9, atol=1e-9)


def test_bdf_coefficients_are_those_of_the_tables() -> None:
    """Hairer and Wanner I, table III.1.1."""
    assert coefficients(2) == (Fraction(3, 2), Fraction(-2), Fraction(1, 2))
    assert coefficients(3) == (Fraction(11, 6), Fraction(-3), Fraction(3, 2), Fraction(-1, 3))
    assert [each * 60 for each in coefficients(6)] == [147, -360, 450, -400, 225, -72, 10]


def test_collocation_coefficients_are_those_of_the_tables() -> None:
    """Hairer and Wanner II, tables IV.5.1 (Gauss), IV.5.5 and IV.5.6 (Radau IIA)."""
    radau2, radau3, gauss2 = tableau("radau", 2), tableau("radau", 3), tableau("gauss", 2)
    np.testing.assert_allclose(radau2.A, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], rtol=1e-14)
    root = np.sqrt(6.0)
    np.testing.assert_allclose(radau3.c, [(4 - root) / 10, (4 + root) / 10, 1.0], rtol=1e-14)
    np.testing.assert_allclose(radau3.b, [(16 - root) / 36, (16 + root) / 36, 1 / 9], rtol=1e-13)
    root = np.sqrt(3.0)
    np.testing.assert_allclose(gauss2.A, [[1 / 4, 1 / 4 - root / 6], [1 / 4 + root / 6, 1 / 4]], rtol=1e-13)


@pytest.mark.parametrize(
    ("b", "message"), [([0.5, 0.5], r"quadrature condition B\(2\) fails"), ([0.7, 0.25], r"B\(1\) fails")]
)
def test_a_tableau_refuses_to_exist_where_its_order_conditions_fail(b: list[float], message: str) -> None:
    good = tableau("radau", 2)
    with pytest.raises(sc.InvalidSetting, match=message):
        Tableau(good.c, good.A, np.array(b), 3)
    with pytest.raises(sc.InvalidSetting, match=r"stage condition C\(1\) fails"):
        Tableau(good.c, good.A + 1e-6, good.b, 3)


@pytest.mark.parametrize(
    ("family", "number", "said"),
    [
        *((sc.BDF, order, "does not exist or is unstable; use 1 to 6") for order in (0, 7, -1)),
        *((family, stages, "use 1 to 10") for family in (sc.RadauIIA, sc.Gauss) for stages in (0, 11)),
        *((sc.GeneralizedAlpha, rho, "must lie in") for rho in (-0.1, 1.1, float("nan"))),
    ],
)
def test_senseless_orders_stages_and_radii_are_refused(
    family: Callable[[Any], sc.Method], number: float, said: str
) -> None:
    with pytest.raises(sc.InvalidSetting, match=said):
        family(number)


@pytest.mark.parametrize("method", [each.method for each in METHODS if not each.damped], ids=lambda m: m.name)
def test_undamped_methods_never_get_rid_of_the_kink_that_a_path_of_degree_nine_starts_with(method: sc.Method) -> None:
    """Their input errors do not fall with the step, those of a damped method of the same order do."""
    crane = scene("overhead_crane")

    def error(method: sc.Method, steps: int) -> float:
        found = sc.solve(crane, sc.Projected(), method, step=crane.reference.duration / steps)
        return float(np.abs(found["F"] - crane.exact(found.t)["F"]).max())

    assert error(method, 400) > 0.98 * error(method, 100)  # two stages of Gauss make it even larger
    assert error(sc.BDF(2), 400) < 0.3 * error(sc.BDF(2), 100)


def a_dae(index: int) -> sc.Dae:
    names = (("q.a", 0, 2.0), ("q.a", 1, 3.0), ("lam.1", 0, 5.0), ("u.F", 0, 7.0))
    unknowns = ca.SX.sym("w", 4)
    return Dae(
        name="levels", x=unknowns[:2], z=unknowns[2:], H=ca.SX.eye(2), f=unknowns[1:3], h=unknowns[2:],
        gamma=ca.SX.sym("gamma", 1, 4), p=ca.SX(0, 1),
        unknowns=tuple(sc.dae.Unknown(*each) for each in names),
        equations=tuple(Equation(f"row {level}", level) for level in (1, 2, 0, 0)),
        physical={}, index=index,
    )  # fmt: skip


def test_unknowns_and_equations_are_scaled_by_the_power_of_the_step_that_their_level_has() -> None:
    """Positions by 1, velocities by 1/h, multipliers and inputs by 1/h^2, each times its nominal size."""
    found = ca.Function("scales", [h := ca.SX.sym("h")], list(a_dae(3).scales(h)))
    unknowns, equations = (np.asarray(each).ravel() for each in found(0.1))
    np.testing.assert_allclose(unknowns, [2.0, 30.0, 500.0, 700.0])
    np.testing.assert_allclose(equations, [10.0, 100.0, 1.0, 1.0])


def test_nothing_is_scaled_by_the_step_where_nothing_is_divided_by_it() -> None:
    found = ca.Function("scales", [h := ca.SX.sym("h")], list(a_dae(1).scales(h)))
    unknowns, equations = (np.asarray(each).ravel() for each in found(0.1))
    np.testing.assert_allclose(unknowns, [2.0, 3.0, 5.0, 7.0])
    np.testing.assert_allclose(equations, 1.0)


def oscillator(frequency_squared: float) -> sc.Dae:
    """q'' = -w^2 q as a `Dae` of index 1 with the velocity as a pair of the position."""
    x, z, gamma = ca.SX.sym("x", 2), ca.SX.sym("z"), ca.SX.sym("gamma", 1, 4)
    return Dae(
        name="oscillator", x=x, z=z, H=ca.SX.eye(2), f=ca.vertcat(x[1], z), h=z + frequency_squared * x[0],
        gamma=gamma, p=ca.SX(0, 1), unknowns=(Unknown("q.a"), Unknown("q.a", 1), Unknown("u.z")),
        equations=(Equation("velocity", 0), Equation("momentum", 0), Equation("force", 0)), physical={}, index=1,
    )  # fmt: skip


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 1.0])
def test_generalized_alpha_damps_infinite_frequency_by_its_spectral_radius(rho: float) -> None:
    """The slowest mode of a stiff oscillator shrinks by rho a step (up to a polynomial in n)."""
    stiff = oscillator(1e12)
    velocity = march(sc.GeneralizedAlpha(rho), stiff, lambda t: [1.0 + t, 1.0, -1e12], ZERO, 1.0, 48)[:, 1]
    rate = np.abs(velocity[48] / velocity[24]) ** (1 / 24) if abs(velocity[24]) > 1e-10 else 0.0
    assert rate == pytest.approx(rho, abs=0.05)


def test_generalized_alpha_has_second_order_and_keeps_the_energy_only_without_damping() -> None:
    def swing(t: float) -> list[float]:
        return [np.cos(2 * t), -2 * np.sin(2 * t), -4 * np.cos(2 * t)]

    energies = {}
    for rho in (0.5, 1.0):
        errors = []
        for count in (100, 200):
            h = 4.0 / count
            found = march(sc.GeneralizedAlpha(rho), oscillator(4.0), swing, ZERO, h, count)
            errors.append(np.abs(found[:, 0] - np.cos(2 * h * np.arange(count + 1))).max())
            energies[rho] = found[-1, 1] ** 2 / 2 + 2 * found[-1, 0] ** 2
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert abs(energies[1.0] - 2.0) < 1e-9
    assert energies[0.5] < 2.0 - 1e-5


def test_generalized_alpha_refuses_what_is_no_mechanical_system() -> None:
    with pytest.raises(sc.InvalidModel, match="needs positions with their velocities"):
        sc.GeneralizedAlpha().discretize(small_dae(x, z, gamma[0], z - x, gamma))


@pytest.mark.parametrize(
    ("variable", "order", "level"), [("q.s", 0, 0), ("q.s", 1, 1), ("q.s", 2, 2), ("lam.1", 0, 2), ("u.F", 1, 3)]
)
def test_the_level_of_an_unknown_counts_its_derivatives_from_positions(variable: str, order: int, level: int) -> None:
    unknown = Unknown(variable, order)
    assert unknown.level == level
    assert unknown.name == variable + "'" * order


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"h": ca.SX(1, 1)}, "3 equations for 4 unknowns"),
        ({"H": ca.SX.eye(3)}, "H has shape"),
        ({"unknowns": ()}, "not all described"),
        ({"equations": ()}, "not all described"),
    ],
)
def test_a_dae_refuses_sizes_that_do_not_fit(change: dict[str, int], message: str) -> None:
    from dataclasses import replace

    with pytest.raises(sc.InvalidModel, match=f"levels: .*{message}"):
        replace(a_dae(1), **change)  # type: ignore[arg-type]  # wrong on purpose


def test_a_dae_knows_the_highest_derivative_of_the_reference_it_uses() -> None:
    x, z, gamma = ca.SX.sym("x"), ca.SX.sym("z"), ca.SX.sym("gamma", 2, 7)
    assert small_dae(x, z, gamma[1, 4], z - x, gamma).reference_order == 4
    assert small_dae(x, z, z, z - gamma[0, 5] * x, gamma).reference_order == 5
    assert small_dae(x, z, z, z - x, gamma).reference_order == 0
