"""The rotationless formulation against mechanics done otherwise: twists, energies, complex numbers, closed forms."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from ranks import has_independent_rows_at_home

from servocore.errors import InvalidModel
from servocore.model.quantity import Quantity
from servocore.model.symbols import Parameter, Parameters
from servocore.model.system import MechanicalSystem
from servocore.numerics.compiled_calls import Array
from servocore.problem import without_constraints
from servocore.rotationless import (
    GROUND,
    Assembly,
    Frame,
    PointMass,
    RigidBody,
    angle,
    cylindrical,
    displacement,
    distance,
    fixed,
    on_line,
    on_plane,
    prismatic,
    revolute,
    spherical,
    turned,
)
from servocore.structure.derivative_array import derivative_array, second_order_equations
from servocore.structure.inversion import inversion
from servocore.structure.signature import signature

HOWTO = Path(__file__).parents[1] / "docs" / "howto" / "assemble-a-mechanism.md"
NONE = Parameters()
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
GRAVITY = 9.81
vectors = arrays(float, 3, elements=st.floats(-3.0, 3.0))


def rotation(vector: Sequence[float] | Array) -> Array:
    """Rotation matrix of a rotation vector."""
    size = np.linalg.norm(vector)
    K = cross(np.asarray(vector) / max(size, 1e-300))
    return np.asarray(np.eye(3) + np.sin(size) * K + (1.0 - np.cos(size)) * K @ K)


def cross(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def motion(position: tuple[float, float, float] | Array, R: Array, velocity: Array, w: Array) -> tuple[Array, Array]:
    """Coordinates and velocities of a body, shape (12,) each, of its pose and twist."""
    return np.concatenate([position, R.T.ravel()]), np.concatenate([velocity, (cross(w) @ R).T.ravel()])


def jacobian(constraints: ca.SX, assembly: Assembly, q: Array) -> Array:
    G = ca.Function("G", [assembly.coordinates.q], [constraints, ca.jacobian(constraints, assembly.coordinates.q)])
    residual, matrix = G(q)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    return np.asarray(matrix)


def invert(system: MechanicalSystem, *jets: tuple[float | tuple[float, float, float], ...]) -> Array:
    """Inputs, shape (N, m), for (value, velocity, acceleration) of the servo outputs at N instants."""
    array = derivative_array(system)
    assert array.signature.degrees_of_freedom == 0
    function, found = inversion(array).function, []
    for jet in jets:
        gamma = np.full((len(system.outputs), array.reference_order + 1), 7.0)  # a jerk must not matter
        gamma[:, :3] = jet
        y, _, residual = function(gamma, system.parameters.values())
        assert float(residual) < 1e-8
        found.append([float(y[array.position(f"u.{each.name}", 0)]) for each in system.inputs])
    return np.array(found)


# --- bodies -----------------------------------------------------------------------------------------------------


def test_a_body_has_a_constant_symmetric_mass_matrix_positive_definite_if_it_is_solid() -> None:
    M = np.asarray(ca.DM(RigidBody("b", 2.0, (0.3, 0.4, 0.5), (0.1, -0.2, 0.3)).mass_matrix))
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0


def test_a_thin_rod_has_a_semidefinite_mass_matrix() -> None:
    M = np.asarray(ca.DM(RigidBody("rod", 2.0, (0.0, 0.4, 0.4)).mass_matrix))
    np.testing.assert_allclose(np.linalg.eigvalsh(M)[:6], 0.0, atol=1e-15)
    assert np.linalg.matrix_rank(M) == 6


@given(vectors, vectors, vectors, vectors)
def test_a_free_body_has_the_kinetic_energy_of_its_mass_and_inertia(
    turn: Array, velocity: Array, w: Array, centre: Array
) -> None:
    mass, R = 2.5, rotation(turn)
    moments = np.array([[0.5, 0.1, -0.05], [0.1, 0.7, 0.02], [-0.05, 0.02, 0.6]])
    body = RigidBody("b", mass, moments.tolist(), centre.tolist())
    _, v = motion(np.zeros(3), R, velocity, w)
    energy = v @ np.asarray(ca.DM(body.mass_matrix)) @ v / 2
    of_centre, w_body = velocity + np.cross(w, R @ centre), R.T @ w
    expected = mass * of_centre @ of_centre / 2 + w_body @ moments @ w_body / 2
    assert energy == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_gravity_acts_at_the_centre_of_mass() -> None:
    assembly = Assembly((RigidBody("b", 2.0, (1.0, 1.0, 1.0), (0.0, 0.0, 0.5)),), NONE, (0, 0, -GRAVITY))
    q, _ = motion((0.0, 0.0, 3.0), rotation((np.pi, 0.0, 0.0)), np.zeros(3), np.zeros(3))  # upside down
    potential = ca.Function("V", [assembly.coordinates.q], [assembly.potential])
    assert float(potential(q)) == pytest.approx(2.0 * GRAVITY * 2.5)


# --- joints -----------------------------------------------------------------------------------------------------

JOINTS = {  # the allowed relative translations along and rotations about normal, binormal and axis
    "fixed": (fixed, "", ""),
    "revolute": (revolute, "", "a"),
    "prismatic": (prismatic, "a", ""),
    "cylindrical": (cylindrical, "a", "a"),
    "spherical": (spherical, "", "nba"),
    "on_line": (on_line, "a", "nba"),
    "on_plane": (on_plane, "nb", "nba"),
    "distance": (lambda a, b: distance(a, b, 0.7), "nb", "nba"),
}


@pytest.mark.parametrize("name", JOINTS)
@pytest.mark.parametrize("seed", range(3))
def test_a_joint_has_independent_rows_that_allow_its_motions_and_no_others(name: str, seed: int) -> None:
    joint, slides, turns = JOINTS[name]
    random = np.random.default_rng(seed)
    point_a, axis_a, normal_a, point_b, axis_b, normal_b = random.normal(size=(6, 3))
    solid = (1.0, 1.0, 1.0)
    assembly = Assembly((RigidBody("a", 1.0, solid), RigidBody("b", 1.0, solid)), NONE, (0, 0, 0))
    places = assembly.body("a").at(point_a, axis_a, normal_a), assembly.body("b").at(point_b, axis_b, normal_b)
    constraints = ca.vertcat(assembly.orthonormality, joint(*places))

    # Place b in a by an allowed displacement and rotation, counted in the triad of a.
    T_a, T_b = (triad(axis, normal) for axis, normal in ((axis_a, normal_a), (axis_b, normal_b)))
    shift = np.array([random.normal() if axis in slides else 0.0 for axis in "nba"])
    if name == "distance":
        shift = np.array([0.0, 0.0, 0.7])
    turn = rotation([random.normal() if axis in turns else 0.0 for axis in "nba"])
    x_a, R_a = random.normal(size=3), rotation(random.normal(size=3))
    R_b = R_a @ T_a @ turn @ T_b.T
    at_b = x_a + R_a @ (point_a + T_a @ shift)
    v_a, w_a = random.normal(size=(2, 3))

    def velocity(relative_v: Array, relative_w: Array) -> tuple[Array, Array]:
        w_b = w_a + R_a @ T_a @ relative_w
        v_of_point = v_a + np.cross(w_a, at_b - x_a) + R_a @ T_a @ relative_v
        q_a, dq_a = motion(x_a, R_a, v_a, w_a)
        x_b = at_b - R_b @ point_b
        q_b, dq_b = motion(x_b, R_b, v_of_point - np.cross(w_b, at_b - x_b), w_b)
        return np.concatenate([q_a, q_b]), np.concatenate([dq_a, dq_b])

    q, rigid = velocity(np.zeros(3), np.zeros(3))
    G = jacobian(constraints, assembly, q)
    assert np.linalg.matrix_rank(G) == len(G) == 18 - len(slides) - len(turns)
    np.testing.assert_allclose(G @ rigid, 0.0, atol=1e-12)
    for k, direction in enumerate("nba"):
        e = np.eye(3)[k]
        for twist, allowed in (((e, 0 * e), direction in slides), ((0 * e, e), direction in turns)):
            _, v = velocity(*twist)
            assert (np.abs(G @ v).max() < 1e-12) == allowed, (direction, twist)


def triad(axis: Array, normal: Array) -> Array:
    e = axis / np.linalg.norm(axis)
    n = normal - (normal @ e) * e
    n /= np.linalg.norm(n)
    return np.column_stack([n, np.cross(e, n), e])


def test_joints_are_at_most_quadratic_and_hinges_on_the_ground_are_linear() -> None:
    assembly = Assembly((RigidBody("b", 1.0, (1.0, 1.0, 1.0)),), NONE, (0, 0, 0))
    body, q = assembly.body("b"), assembly.coordinates.q
    for joint, _, _ in JOINTS.values():
        hessian = ca.jacobian(ca.vec(ca.jacobian(joint(GROUND.at(X), body.at(Y)), q)), q)
        assert hessian.is_constant()
    assert ca.jacobian(revolute(GROUND.at(), body.at()), q).is_constant()


@pytest.mark.parametrize("direction", [Z, (1.0, 2.0, -0.5)])
def test_augmented_coordinates_run_at_the_rate_of_what_they_measure(direction: tuple[float, float, float]) -> None:
    assembly = Assembly(
        (RigidBody("b", 1.0, (1.0, 1.0, 1.0)), Quantity("phi", "rad"), Quantity("s", "m")), NONE, (0, 0, 0)
    )
    e = np.array(direction) / np.linalg.norm(direction)
    a, b = GROUND.at(axis=direction), assembly.body("b").at(axis=direction)
    rows = ca.vertcat(angle(a, b, assembly.augmented("phi")), displacement(a, b, assembly.augmented("s")))
    body, velocity = motion(0.8 * e, rotation(7.0 * e), -0.3 * e, 1.7 * e)  # more than a full turn
    G = jacobian(rows, assembly, np.concatenate([body, [7.0, 0.8]]))
    np.testing.assert_allclose(G @ np.concatenate([velocity, [1.7, -0.3]]), 0.0, atol=1e-12)
    assert np.abs(np.diag(G[:, 12:])) == pytest.approx([1.0, 1.0])


def test_axes_may_have_any_length_and_angles_count_from_the_normal() -> None:
    place = GROUND.at((1.0, 2.0, 3.0), axis=(0.0, 0.0, 5.0), normal=(1.0, 1.0, 9.0))
    half = np.sqrt(0.5)
    for found, expected in (
        (place.position, (1.0, 2.0, 3.0)),
        (place.normal, (half, half, 0.0)),
        (place.binormal, (-half, half, 0.0)),
        (place.axis, Z),
    ):
        np.testing.assert_allclose(np.asarray(ca.DM(found)).ravel(), expected, atol=1e-15)


def test_turned_directors_are_those_of_the_rotation_vector() -> None:
    found = np.asarray(ca.DM(turned((2.0, -1.0, 0.5), 0.9)))
    axis = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    np.testing.assert_allclose(found, rotation(0.9 * axis), atol=1e-15)


# --- mechanisms with known answers --------------------------------------------------------------------------------


def one_angle(name: str, body: RigidBody, constraints_of: Callable[[Frame], dict[str, ca.SX]]) -> MechanicalSystem:
    """System of one body on the ground whose angle phi about y is driven and prescribed."""
    assembly = Assembly((body, Quantity("phi", "rad")), NONE, (0, 0, -GRAVITY))
    phi, hinge = assembly.augmented("phi"), (GROUND.at(axis=Y), assembly.body("b").at(axis=Y))
    return assembly.system(
        name,
        constraints={**constraints_of(assembly.body("b")), "phi": angle(*hinge, phi)},
        inputs={Quantity("torque", "N.m"): phi},
        outputs={Quantity("phi", "rad"): phi},
        guess=lambda y: {"b": ((0, 0, 0), turned(Y, y)), "phi": y},
        home=(0.5,),
    )


SUPPORTS = {
    "hinge": lambda b: {"hinge": revolute(GROUND.at(axis=Y), b.at(axis=Y))},
    "fixed and floating bearing": lambda b: {
        "fixed": spherical(GROUND.at(), b.at()),
        "floating": on_line(GROUND.at(axis=Y), b.at((0.0, 0.6, 0.0))),
    },
    "shaft and axial stop": lambda b: {
        "shaft": cylindrical(GROUND.at(axis=Y), b.at(axis=Y)),
        "stop": on_plane(GROUND.at((0.0, 0.6, 0.0), axis=Y), b.at((0.0, 0.6, 0.0))),
    },
}


@pytest.mark.parametrize("support", SUPPORTS)
def test_a_pendulum_needs_the_textbook_torque_however_it_is_supported(support: str) -> None:
    mass, inertia, arm = 3.0, 0.4, 0.8
    body = RigidBody("b", mass, (0.3, inertia, 0.5), (0.0, 0.0, -arm))
    system = one_angle("pendulum", body, SUPPORTS[support])
    assert has_independent_rows_at_home(system)
    jets = [(0.4, 1.5, -2.0), (-2.6, 0.0, 0.7), (9.0, -3.0, 4.0)]
    expected = [(inertia + mass * arm**2) * a + mass * GRAVITY * arm * np.sin(phi) for phi, _, a in jets]
    np.testing.assert_allclose(invert(system, *jets)[:, 0], expected, rtol=1e-11)


def test_a_slider_on_an_incline_needs_inertia_and_weight_along_it() -> None:
    tilt, mass = 0.3, 4.0
    up = (np.cos(tilt), 0.0, np.sin(tilt))
    assembly = Assembly((RigidBody("b", mass, (1.0, 2.0, 2.0)), Quantity("s", "m")), NONE, (0, 0, -GRAVITY))
    rail, s = (GROUND.at(axis=up), assembly.body("b").at(axis=X)), assembly.augmented("s")
    system = assembly.system(
        "slider",
        constraints={"rail": prismatic(*rail), "s": displacement(*rail, s)},
        inputs={Quantity("force", "N"): s},
        outputs={Quantity("s", "m"): s},
        guess=lambda y: {"b": (y * ca.DM(up), turned(Y, -tilt)), "s": y},
    )
    expected = mass * 1.5 + mass * GRAVITY * np.sin(tilt)
    np.testing.assert_allclose(invert(system, (0.7, -2.0, 1.5)), [[expected]], rtol=1e-11)


# --- the closed loop of the how-to page ---------------------------------------------------------------------------


@cache
def howto() -> dict[str, Any]:
    """Run the code of the page."""
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", HOWTO.read_text(), re.DOTALL):
        exec(block, names)
    return names


POINT = (0.5, 0.3, 0.0)  # of the coupler, in body coordinates


class FourBar:
    """The linkage of the page by complex numbers: positions, and derivatives by the crank angle, of all bars."""

    def __init__(self, theta: float) -> None:
        a, b, c, d = (howto()[name] for name in ("CRANK", "COUPLER", "ROCKER", "BASE"))
        rho = np.array([a, b, c])
        tip = a * np.exp(1j * theta)
        to_D = d - tip
        opening = np.arccos((abs(to_D) ** 2 + b**2 - c**2) / (2 * b * abs(to_D)))
        tilt = np.angle(to_D) + opening
        self.angles = np.array([theta, tilt, np.angle(tip + b * np.exp(1j * tilt) - d)])
        e = np.exp(1j * self.angles)
        # Loop: a e1 + b e2 - c e3 = d, differentiated once and twice by the crank angle.
        loop = np.array([1.0, 1.0, -1.0]) * rho * e
        self.w = np.array([1.0, *solve_complex(loop[1:] * 1j, -1j * loop[0])])
        self.w_1 = np.array([0.0, *solve_complex(loop[1:] * 1j, loop @ self.w**2)])
        ends = np.array([0.0, tip, d]), np.array([0.0, 1j * tip, 0.0]), np.array([0.0, -tip, 0.0])
        self.centres = ends[0] + rho / 2 * e
        self.centres_1 = ends[1] + rho / 2 * 1j * self.w * e
        self.centres_2 = ends[2] + rho / 2 * (1j * self.w_1 - self.w**2) * e
        arm = (POINT[0] + 1j * POINT[1]) * e[1]
        self.point = tip + arm
        self.point_1 = 1j * tip + 1j * self.w[1] * arm
        self.point_2 = -tip + (1j * self.w_1[1] - self.w[1] ** 2) * arm
        self.masses = 5.0 * rho
        self.inertias = 5.0 * rho**3 / 12

    def torque(self, speed: float, acceleration: float) -> float:
        """Virtual power for a unit virtual rate of the crank."""
        second = self.centres_1 * acceleration + self.centres_2 * speed**2
        forces = self.masses * (second + 1j * GRAVITY)
        moments = self.inertias * (self.w * acceleration + self.w_1 * speed**2)
        return float((forces * self.centres_1.conj()).real.sum() + moments @ self.w)


def solve_complex(coefficients: Array, right: Array) -> Array:
    """Two real unknowns of one complex equation."""
    matrix = np.array([coefficients.real, coefficients.imag])
    return np.linalg.solve(matrix, [right.real, right.imag])


def test_the_page_gives_the_torque_that_complex_numbers_give() -> None:
    assert howto()["torque"] == pytest.approx(FourBar(1.0).torque(2.0, -3.0), rel=1e-9)


def test_a_four_bar_linkage_of_spatial_bodies_has_one_degree_of_freedom_and_index_three() -> None:
    system = howto()["system"]
    found = signature(second_order_equations(system))
    assert (system.degrees_of_freedom, found.degrees_of_freedom, found.index) == (1, 0, 3)


def four_hinges() -> MechanicalSystem:
    page = howto()
    closing = revolute(page["rocker"].at((page["ROCKER"], 0, 0)), page["coupler"].at((page["COUPLER"], 0, 0)))
    linkage: Assembly = page["linkage"]
    theta = linkage.augmented("theta")
    return linkage.system(
        "four hinges",
        constraints={**page["constraints"], "C": closing},
        inputs={Quantity("torque", "N.m"): theta},
        outputs={Quantity("theta", "rad"): theta},
        guess=page["near"],
    )


def test_four_hinges_in_a_plane_have_one_degree_of_freedom_and_three_redundant_rows() -> None:
    system, p = four_hinges(), howto()["p"].values()
    assert system.degrees_of_freedom == 1
    named = "3 of the 39 holonomic constraints are redundant \\(rank 36\\): C 3, C 4, C 5"
    with pytest.raises(InvalidModel, match=f"four hinges: {named}; solve and analyse leave them out"):
        derivative_array(system)
    kept = without_constraints(system, system.constraint_rank(p).redundant)
    array = derivative_array(kept)
    y, _, residual = inversion(array).function(ca.horzcat(1.0, 2.0, -3.0), p)
    assert float(y[array.position("u.torque", 0)]) == pytest.approx(FourBar(1.0).torque(2.0, -3.0), rel=1e-9)
    assert float(residual) < 1e-12


def test_the_torque_that_drives_a_closed_loop_s_crank_is_that_of_complex_numbers_all_around() -> None:
    jets = [(theta, 2.0 - theta, 4.0 * np.sin(3.0 * theta)) for theta in np.linspace(-6.0, 6.0, 25)]
    expected = [FourBar(theta).torque(*rest) for theta, *rest in jets]
    np.testing.assert_allclose(invert(howto()["system"], *jets)[:, 0], expected, rtol=1e-9, atol=1e-9)


def test_the_torque_that_makes_a_coupler_point_follow_is_that_of_complex_numbers() -> None:
    page = howto()
    system = page["linkage"].system(
        "four-bar linkage by its coupler",
        constraints=page["constraints"],
        inputs={Quantity("torque", "N.m"): page["linkage"].augmented("theta")},
        outputs={Quantity("x", "m"): page["coupler"].point(POINT)[0]},
        guess=lambda y: page["near"](0.9 + 0 * y),
        home=(float(FourBar(0.9).point.real),),
    )
    jets, expected = [], []
    for theta, speed, acceleration in ((0.7, 1.5, -2.0), (1.0, 0.0, 3.0), (1.2, -4.0, 0.5)):
        bars = FourBar(theta)
        prescribed = bars.point_1 * acceleration + bars.point_2 * speed**2
        jets.append((bars.point.real, bars.point_1.real * speed, prescribed.real))
        expected.append(bars.torque(speed, acceleration))
    np.testing.assert_allclose(invert(system, *jets)[:, 0], expected, rtol=1e-9)


# --- what is refused ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "sentence"),
    [
        (
            RigidBody("b", -1.0, (1.0, 1.0, 1.0)),
            "body b: its mass is -1 kg, it must be finite and must not be negative",
        ),
        (PointMass("p", float("nan")), "point p: its mass is nan kg, it must be finite and must not be negative"),
        (RigidBody("b", 1.0, (1.0, np.inf, 1.0)), "body b: its inertia holds inf, which is no finite number"),
        (
            RigidBody("b", 1.0, (1.0,) * 3, (0.0, np.nan, 0.0)),
            "body b: its centre of mass holds nan, which is no finite",
        ),
        (RigidBody("b", 1.0, (1.0, 1.0, 2.5)), "inertias 1, 1 and 2.5 kg m.* violate the triangle inequality"),
        (RigidBody("b", 1.0, (1.0, 1.0, -0.5)), "body b: the inertia tensor has the negative principal value -0.5"),
        (RigidBody("b", 1.0, [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "body b: the inertia tensor is not symmetric"),
        (RigidBody("b", 1.0, (1.0, 1.0)), "body b: inertia needs three principal values or three rows"),
        (RigidBody("b", ca.SX.sym("m"), (1.0, 1.0, 1.0)), "symbols that are no parameters"),
        (RigidBody("b", 1.0, (1.0, 1.0, 1.0), (0.0, 1.0)), "a vector in space has 3 components, not 2"),
    ],
)
def test_impossible_bodies_are_refused_in_a_sentence(part: RigidBody | PointMass, sentence: str) -> None:
    with pytest.raises(InvalidModel, match=sentence):
        Assembly((part,), NONE, (0, 0, 0)).mass  # noqa: B018


def test_inertias_are_judged_at_the_default_parameters() -> None:
    p = Parameters(Parameter("m", 2.0, "kg"), Parameter("J", -1.0, "kg.m2"))
    with pytest.raises(InvalidModel, match="negative principal value -1 kg"):
        Assembly((RigidBody("b", p["m"], (p["J"],) * 3),), p, (0, 0, 0))


def test_directions_that_are_none_are_refused() -> None:
    with pytest.raises(InvalidModel, match=r"the axis .* is no direction in space"):
        GROUND.at(axis=(0.0, 0.0, 0.0))
    with pytest.raises(InvalidModel, match=r"the axis .* is no direction in space"):
        turned((0.0, float("nan"), 1.0), 0.3)
    with pytest.raises(InvalidModel, match=r"the normal .* is parallel to the axis"):
        GROUND.at(axis=(0.0, 0.0, 2.0), normal=(0.0, 0.0, -1.0))


def test_unknown_parts_and_wrong_configurations_are_refused_by_name() -> None:
    body = RigidBody("b", 1.0, (1.0, 1.0, 1.0))
    assembly = Assembly((body, Quantity("phi", "rad")), NONE, (0, 0, 0))
    with pytest.raises(InvalidModel, match="no body is called c; there are b"):
        assembly.body("c")
    with pytest.raises(InvalidModel, match="no body is called phi; there are b"):
        assembly.body("phi")
    with pytest.raises(InvalidModel, match="no point mass is called b; there are none"):
        assembly.point("b")
    with pytest.raises(InvalidModel, match="no augmented coordinate is called s; there are phi"):
        assembly.augmented("s")
    with pytest.raises(InvalidModel, match="a configuration must give b, phi, not b"):
        assembly.configuration({"b": ((0, 0, 0), np.eye(3))})
    with pytest.raises(InvalidModel, match="the configuration of b needs 12 values, not 6"):
        assembly.configuration({"b": ((0, 0, 0), (1, 0, 0)), "phi": 0.0})
    with pytest.raises(InvalidModel, match="parts named twice: b"):
        Assembly((body, body), NONE, (0, 0, 0))
