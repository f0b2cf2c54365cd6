"""The registry of the test suite: scenes, models, formulations and methods, and what may be claimed of each.

A scene that stands in `servocore.scenes.REGISTRY`, a formulation and a method need one line here; from then on they
inherit `suite`. A newcomer without its line fails `test_scenes.test_everything_exported_is_registered_here`.
Small systems with known answers, made by hand, follow below.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from present import of_kind, present

import servocore as sc
from servocore.model.system import DERIVED, MAX_REFERENCE_ORDER
from servocore.numerics.compiled_calls import Array
from servocore.references.profiles import polynomial
from servocore.references.rest_to_rest import RestToRest
from servocore.scenes.hanging_load import follow
from servocore.scenes.jets import Jet, components
from servocore.stepping.stepper import Stepper


@dataclass(frozen=True)
class SceneCase:
    """What is known of a scene: its index, that of its projected form, and what its servo constraints fix."""

    index: int
    projected_index: int = 3
    internal_degrees_of_freedom: int = 0
    algebraic: tuple[str, ...] = ()  # fixed by servo constraints and accelerations alone: exact at every step size


@dataclass(frozen=True)
class FormulationCase:
    """A formulation: `projected` ones give algebraic quantities exactly, `reduced` ones have index 1 or 0.

    It shares the lines of its `kind` in `UNSTABLE` and `REFUSED`; where it does better or worse, it names another kind.
    """

    formulation: sc.Formulation
    projected: bool = False
    reduced: bool = False
    of_kind: str = ""

    @property
    def kind(self) -> str:
        return self.of_kind or ("projected" if self.projected else "reduced" if self.reduced else "original")


@dataclass(frozen=True)
class MethodCase:
    """A method with its orders at constant step: Hairer and Wanner II, section VI.1, tables VII.4.1 and VII.4.2.

    `by_index` are the orders of the inputs (the algebraic variables) on forms of index 1, 2 and 3, None where nothing
    damps their errors; `differential` is that of differential variables at index 1. `steps` are grids on which the
    scenes' errors have settled; empty where round-off of the inputs comes before.
    """

    method: sc.Method
    differential: int
    by_index: tuple[int, int | None, int | None]
    steps: tuple[int, ...] = (200, 400, 800)
    first_order_equations: bool = True  # False for a method of mechanics, which needs positions with their velocities
    starts_in_motion: bool = True  # False for a method that promises its orders from rest alone

    @property
    def damped(self) -> bool:
        return self.by_index[2] is not None


SCENES = {
    "rotary_crane": SceneCase(index=5, algebraic=("phi", "s", "l", "tension", "swing")),
    "overhead_crane": SceneCase(index=5, algebraic=("s", "l", "tension", "swing")),
    "gantry_crane": SceneCase(index=5, algebraic=("s_x", "s_y", "l", "tension", "swing")),
    "boom_crane": SceneCase(index=5, algebraic=("phi", "theta", "l", "tension", "swing")),
    "inteco": SceneCase(index=5, algebraic=("s_x", "s_y", "l", "tension", "swing")),
    "cars": SceneCase(index=5, algebraic=("x_1", "x_2")),
    "mass_on_car": SceneCase(index=3, projected_index=2, internal_degrees_of_freedom=2),
    "passive_joint_arm": SceneCase(index=3, projected_index=2, internal_degrees_of_freedom=2),
    "loop_manipulator": SceneCase(index=3, internal_degrees_of_freedom=2),
    "elastic_bar": SceneCase(index=7, projected_index=5, algebraic=("w_1", "w_2")),
    "heavy_rope": SceneCase(index=7, projected_index=5, algebraic=("p1_x", "p1_z", "tension")),
    "quadrotor_with_load": SceneCase(index=7, projected_index=5, algebraic=("p_x", "p_z", "swing", "tension")),
    "driven_crane": SceneCase(index=5, algebraic=("s", "l", "tension", "swing")),
}
FORMULATIONS = (
    FormulationCase(sc.Original()),
    FormulationCase(sc.Projected(), projected=True),
    FormulationCase(sc.Reduced(), reduced=True),
)
METHODS = (
    MethodCase(sc.BackwardEuler(), 1, (1, 1, 1)),
    MethodCase(sc.BDF(2), 2, (2, 2, 2)),
    MethodCase(sc.BDF(3), 3, (3, 3, 3)),
    MethodCase(sc.BDF(4), 4, (4, 4, 4), steps=(100, 200, 400)),
    MethodCase(sc.BDF(5), 5, (5, 5, 5), steps=()),
    MethodCase(sc.BDF(6), 6, (6, 6, 6), steps=()),
    MethodCase(sc.RadauIIA(2), 3, (3, 2, 1)),
    MethodCase(sc.RadauIIA(3), 5, (5, 3, 2), steps=(100, 200, 400)),
    MethodCase(sc.GeneralizedAlpha(), 2, (2, 2, 2), first_order_equations=False),
    MethodCase(sc.Gauss(1), 2, (2, None, None)),
    MethodCase(sc.Gauss(2), 4, (2, None, None)),
    MethodCase(sc.Trapezoidal(), 2, (2, None, None)),
)
BACKWARD_EULER = METHODS[0]

UNSTABLE = {
    ("rotary_crane", "generalized", "original"): "small errors grow from step to step, the faster the smaller the step",
    ("overhead_crane", "generalized", "original"): "as the rotary crane",
    ("gantry_crane", "generalized", "original"): "as the rotary crane",
    ("boom_crane", "generalized", "original"): "as the rotary crane",
    ("driven_crane", "generalized", "original"): "as the rotary crane",
}
"""Scene, model and kind of formulation that no step size saves: kept out of `PROBLEMS` and shown to fail."""
REFUSED = {("passive_joint_arm", "points", "projected"): r"mass matrix is singular on a, b$"}
"""Scene, model and kind of formulation that do not go together, and how the refusal ends."""


@dataclass(frozen=True)
class Problem:
    """One scene, model, formulation and method."""

    scene_name: str
    model: str
    of: FormulationCase
    by: MethodCase

    def __str__(self) -> str:
        return "-".join((self.scene_name, self.model, self.of.formulation.name, self.by.method.name))

    @property
    def scene(self) -> sc.Scene:
        return scene(self.scene_name)

    @property
    def case(self) -> SceneCase:
        return SCENES[self.scene_name]

    @property
    def system(self) -> sc.MechanicalSystem:
        return self.scene.model(self.model)

    @property
    def pointwise(self) -> bool:
        """Whether nothing is left to integrate."""
        return self.of.reduced and not self.case.internal_degrees_of_freedom

    @property
    def order(self) -> int | None:
        """Order with which the inputs converge."""
        index = 1 if self.of.reduced else self.case.projected_index if self.of.projected else 3
        return self.by.by_index[min(index, 3) - 1]

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.system.inputs)

    def stepper(self, step: float) -> Stepper:
        return Stepper(self.scene, self.of.formulation, self.by.method, step, self.model)


CURVE: list[tuple[float | str, float]] = [(0, 12), ("3000 rpm", 11), ("8000 rpm", 9)]
DRIVES = {
    "F": sc.Drive(ratio=25, drum_radius="125 mm", motor_inertia="4 kg cm^2", viscous=2e-4, coulomb=0.02),
    "M_w": sc.Drive(12, 2, None, 3e-4, efficiency=0.85, viscous=3e-4, torque_constant=1.1, torque_speed=CURVE),
}


def driven_crane() -> sc.Scene:
    """The overhead crane with drives, and its closed form: that with reflected inertia, and friction by hand."""
    crane = sc.scenes.overhead_crane()

    def closed_form(reference: Array, p: Mapping[str, float]) -> dict[str, Array]:
        n, wheel = p["M_w.ratio"] * p["M_w.rope_falls"], p["F.ratio"] / p["F.drum_radius"]
        more = {"trolley_mass": wheel**2 * p["F.motor_inertia"], "winch_inertia": n**2 * p["M_w.motor_inertia"]}
        reflected = {name: value + more.get(name, 0.0) for name, value in p.items()}
        answer = present(crane.closed_form)(reference, reflected)
        (trolley,), *_ = follow(reference, reflected, crane.model().outputs)
        s_dot = trolley.derivatives()[1]
        (x, z), (x_dot, z_dot) = np.moveaxis(reference[:, :2], 0, 2)
        l_dot = ((x - answer["s"]) * (x_dot - s_dot) + z * z_dot) / answer["l"]
        answer["F"] += wheel * (p["F.coulomb"] * np.tanh(s_dot / 0.01) + p["F.viscous"] * wheel * s_dot)
        answer["M_w"] += n**2 * p["M_w.viscous"] * l_dot / p["winch_radius"]
        return answer

    return replace(crane.with_drives(**DRIVES), name="driven_crane", closed_form=closed_form)


@cache
def scene(name: str) -> sc.Scene:
    return driven_crane() if name == "driven_crane" else sc.scenes.REGISTRY[name]()


MODELS = tuple((name, model) for name in SCENES for model in scene(name).models)
WRITTEN = tuple(
    (name, model, each) for name, model in MODELS for each in FORMULATIONS if (name, model, each.kind) not in REFUSED
)
"""Scene, model and formulation wherever the formulation exists."""

PROJECTED_MODELS = tuple((name, model) for name, model, each in WRITTEN if each.projected)
FLAT_MODELS = tuple((name, model) for name, model in MODELS if not SCENES[name].internal_degrees_of_freedom)
PROBLEMS = (
    *(
        Problem(name, model, formulation, BACKWARD_EULER)
        for name, model in MODELS
        for formulation in FORMULATIONS
        if (name, model, formulation.kind) not in (UNSTABLE.keys() | REFUSED.keys())
    ),
    *(
        Problem(name, scene(name).default_model, formulation, method)
        for name in SCENES
        for formulation in FORMULATIONS
        if formulation.projected or (formulation.reduced and SCENES[name].internal_degrees_of_freedom)
        for method in METHODS[1:]
        if method.damped and method.steps and SCENES[name].projected_index <= 3
    ),
)
"""Every scene, model and formulation with backward Euler; every method on every scene's smallest model where it counts.

The full product would cost minutes and say nothing more: methods know the `Dae` only, and promise nothing beyond
index 3.
"""


def problem(scene_name: str, model: str, formulation: str = "projected", method: str = "backward-euler") -> Problem:
    """Return the registered problem of these names."""
    wanted = "-".join((scene_name, model, formulation, method))
    (found,) = (each for each in PROBLEMS if str(each) == wanted)
    return found


def along_its_line(this: sc.Scene, duration: float, profile: sc.Profile = sc.DEGREE9) -> sc.Scene:
    """Return a scene whose path goes between the same points in another time, or by another law."""
    path = of_kind(RestToRest, this.reference)
    return this.with_reference(sc.rest_to_rest(path.start, path.end, duration, profile))


@cache
def smooth_scene(name: str) -> sc.Scene:
    """Return a scene with a path of degree 17 between the same points: C^8, so that no method meets a kink."""
    return along_its_line(scene(name), scene(name).reference.duration, polynomial(17))


@cache
def solved(what: Problem, steps: int, smooth: bool = False) -> sc.Solution:
    """Solve a problem once, whatever number of tests look at it."""
    subject = smooth_scene(what.scene_name) if smooth else what.scene
    step = subject.reference.duration / steps
    return sc.solve(subject, what.of.formulation, what.by.method, step=step, model=what.model)


@cache
def exact(scene_name: str, steps: int, smooth: bool = False) -> dict[str, np.ndarray]:
    """Closed form on the grid of `solved`."""
    subject = smooth_scene(scene_name) if smooth else scene(scene_name)
    reference = subject.reference
    return subject.exact(np.linspace(reference.start_time, reference.end_time, steps + 1))


def largest_errors(what: Problem, steps: int, names: tuple[str, ...], smooth: bool = False) -> np.ndarray:
    """Largest error of each of `names` over the whole run."""
    found, expected = solved(what, steps, smooth), exact(what.scene_name, steps, smooth)
    return np.array([np.abs(found[name] - expected[name]).max() for name in names])


def began(this: sc.Scene, model: str | None) -> tuple[Array, Array]:
    """Return the state (q, v) at rest at the beginning of the path, and the inputs that hold it there."""
    rest, system = sc.solve(this, model=model, step=this.reference.duration / 10), this.model(model)
    q = [rest[name][0] for name in system.coordinates.names]
    return np.array([*q, *[0.0] * len(q)]), np.array([rest[each.name][0] for each in system.inputs])


def shares_of_peaks(this: sc.Scene, solution: sc.Solution, names: Sequence[str]) -> Array:
    """Largest errors, as fractions of the largest exact values."""
    exact = this.exact(solution.t)
    return np.array([np.abs(solution[name] - exact[name]).max() / np.abs(exact[name]).max() for name in names])


def observed_orders(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Return the orders of convergence that errors at steps h and h/2 show."""
    return np.asarray(np.log2(coarse / fine))


def jets_near_home(system: sc.MechanicalSystem, perturbations: np.ndarray) -> np.ndarray:
    """Reference jets (..., orders, m) whose position lies about the system's home."""
    jets = np.array(perturbations, dtype=float)
    jets[..., 0, :] += system.home
    return jets


def polynomial_path(coefficients: Sequence[Sequence[float]] | Array, duration: float = 1.0) -> sc.Reference:
    """The polynomial sum_k coefficients[k] t^k as a reference, moving at both ends."""
    return Polynomial(
        start_time=0.0,
        end_time=duration,
        dimension=np.shape(coefficients)[1],
        max_order=MAX_REFERENCE_ORDER,
        smoothness=MAX_REFERENCE_ORDER,
        coefficients=tuple(map(tuple, coefficients)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Polynomial(sc.Reference):
    """A polynomial in t, also outside start and end."""

    coefficients: tuple[tuple[float, ...], ...]

    def _derivatives(self, t: Array, order: int) -> Array:
        columns = []
        for k in range(order + 1):
            part = np.polynomial.polynomial.polyder(np.array(self.coefficients), k)
            columns.append(np.polynomial.polynomial.polyval(t, part).T)
        return np.stack(columns, axis=1)


# Systems made by hand ------------------------------------------------------------------------------------------------


def as_scene(system: sc.MechanicalSystem, reference: sc.Reference, **settings: Any) -> sc.Scene:
    """Wrap one system as a scene of one model."""
    return sc.Scene(name=system.name, models={"only": lambda: system}, reference=reference, **settings)


def car_chain(
    masses: list[float] | tuple[float, float] = (1.0, 2.0),
    stiffnesses: list[float] | tuple[float] = (50.0,),
    rest: list[float] | tuple[float] = (0.5,),
) -> sc.MechanicalSystem:
    """Cars in a row joined by springs, the first tracked, a force on the last: docs/scenes.md."""
    n = len(masses)
    x = sc.Coordinates(*(sc.Quantity(f"x{k + 1}", "m") for k in range(n)))
    stretches = [x.q[k] - x.q[k + 1] - rest[k] for k in range(n - 1)]
    return sc.MechanicalSystem(
        name=f"{n} cars",
        coordinates=x,
        parameters=sc.Parameters(),
        inputs=(sc.Quantity("F", "N"),),
        outputs=(sc.Quantity("y", "m"),),
        mass=ca.sparsify(ca.diag(ca.SX(list(masses)))),
        output=x.q[0],
        input_matrix=ca.sparsify(ca.SX([[0.0] * (n - 1) + [-1.0]])),
        potential=sum((k / 2 * e**2 for k, e in zip(stiffnesses, stretches, strict=True)), start=ca.SX(0)),
    )


def car_chain_exact(
    jets: np.ndarray,
    masses: list[float] | tuple[float, float] = (1.0, 2.0),
    stiffnesses: list[float] | tuple[float] = (50.0,),
    rest: list[float] | tuple[float] = (0.5,),
) -> dict[str, Jet]:
    """x_(i+1) = x_i - d_i + (sum_(j<=i) m_j x_j'')/k_i and F = sum m_j x_j'', as jets."""
    (x,) = components(jets)
    found, pull = {"x1": x}, masses[0] * x.d().d()
    for i, (k, d) in enumerate(zip(stiffnesses, rest, strict=True)):
        x = x - d + pull / k
        found[f"x{i + 2}"] = x
        pull = pull + masses[i + 1] * x.d().d()
    return {**found, "F": pull}


def actuated_chain() -> sc.MechanicalSystem:
    """Two masses on springs with inertial coupling, both prescribed, a force on each: as many inputs as coordinates."""
    x = sc.Coordinates(sc.Quantity("x1", "m"), sc.Quantity("x2", "m"))
    parameters = sc.Parameters(sc.Parameter("k", 70.0, "N/m", 0.0), sc.Parameter("c", 3.0, "N.s/m", 0.0))
    k, c = parameters["k"], parameters["c"]
    return sc.MechanicalSystem(
        name="actuated chain",
        coordinates=x,
        parameters=parameters,
        inputs=(sc.Quantity("F1", "N"), sc.Quantity("F2", "N")),
        outputs=(sc.Quantity("y1", "m"), sc.Quantity("y2", "m")),
        mass=ca.SX([[3.0, 0.5], [0.5, 2.0]]),
        output=x.q,
        input_matrix=-ca.SX.eye(2),
        potential=k / 2 * (x.q[0] ** 2 + (x.q[1] - x.q[0]) ** 2),
        force=-c * x.v,
    )


def driven_pendulum() -> sc.MechanicalSystem:
    """A point mass on a rod, driven by a torque, the angle from the downward vertical prescribed."""
    coordinates = sc.Coordinates(sc.Quantity("theta", "rad"))
    parameters = sc.Parameters(
        sc.Parameter("m", 2.0, "kg", 1e-3), sc.Parameter("l", 1.5, "m", 1e-3), sc.Parameter("g", 9.81, "m/s2", 0.0)
    )
    m, length, g = (parameters[name] for name in parameters.names)
    return sc.MechanicalSystem(
        name="pendulum",
        coordinates=coordinates,
        parameters=parameters,
        inputs=(sc.Quantity("torque", "N.m"),),
        outputs=(sc.Quantity("angle", "rad"),),
        mass=m * length**2,
        output=coordinates.q,
        input_matrix=ca.SX(-1),
        potential=-m * g * length * ca.cos(coordinates.q),
    )


def redundant_pendulum(output: str = "x") -> sc.MechanicalSystem:
    """The same pendulum in q = (x, z, theta) with theta massless, the servo constraint on one of them."""
    coordinates = sc.Coordinates(sc.Quantity("x", "m"), sc.Quantity("z", "m"), sc.Quantity("theta", "rad"))
    parameters = driven_pendulum().parameters
    m, length, g = (parameters[name] for name in parameters.names)
    x, z, theta = ca.vertsplit(coordinates.q)
    gamma = ca.SX.sym("gamma", 1, MAX_REFERENCE_ORDER + 1)
    angle = gamma[0, 0] if output == "theta" else gamma[0, 0] / length
    return sc.MechanicalSystem(
        name="redundant pendulum",
        coordinates=coordinates,
        parameters=parameters,
        inputs=(sc.Quantity("torque", "N.m"),),
        outputs=(sc.Quantity("y", "1"),),
        mass=ca.sparsify(ca.diag(ca.vertcat(m, m, 0))),
        output=coordinates[output],
        input_matrix=ca.sparsify(ca.SX([[0.0, 0.0, -1.0]])),
        potential=m * g * z,
        constraints=ca.vertcat(x - length * ca.sin(theta), z + length * ca.cos(theta)),
        gamma=gamma,
        guess=ca.vertcat(length * ca.sin(angle), -length * ca.cos(angle), angle),
        home=(0.4,),
    )


def changed(system: sc.MechanicalSystem, **attributes: Any) -> sc.MechanicalSystem:
    """Return a copy with other attributes; fails as construction does. What follows from M and inputs is made anew."""
    anew = {"gyroscopic": DERIVED, "u": DERIVED} | attributes
    return replace(system, **anew)


@dataclass(frozen=True)
class Rest:
    """A route of somebody's own: no inputs at all, whatever the path does."""

    def run(
        self,
        problem: sc.Problem,
        times: Array,
        progress: Callable[[int, int], None] | None = None,  # noqa: ARG002 - there is nothing to tell
    ) -> sc.Solution:
        values = np.zeros((len(times), len(problem.system.inputs)))
        return sc.Solution(times, problem.system.inputs, values, "rest")
