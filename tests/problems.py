"""The registry of the test suite: scenes, models, formulations and methods, and what may be claimed of each.

A scene that stands in `servocore.scenes.REGISTRY`, a formulation and a method need one line here; from then on they
inherit `suite`. A newcomer without its line fails `test_scenes.test_everything_exported_is_registered_here`.
Small systems with known answers, made by hand, follow below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np

import servocore as sc
from servocore.jets import Jet, components
from servocore.stepper import Stepper
from servocore.system import MAX_REFERENCE_ORDER


@dataclass(frozen=True)
class SceneCase:
    """What is known of a scene: grids on which its errors have settled, index, and what a servo constraint fixes."""

    steps: tuple[int, ...]
    index: int
    internal_degrees_of_freedom: int = 0
    algebraic: tuple[str, ...] = ()  # fixed by servo constraints and accelerations alone: exact at every step size


@dataclass(frozen=True)
class FormulationCase:
    """A formulation, and whether algebraic quantities come out exactly (`projected`) or everything (`pointwise`)."""

    formulation: sc.Formulation
    projected: bool = False
    pointwise: bool = False


@dataclass(frozen=True)
class MethodCase:
    """A method with its order on the projected form at constant step."""

    method: sc.Method
    order: int


SCENES = {
    "rotary_crane": SceneCase((400, 800, 1600), index=5, algebraic=("phi", "s", "l", "tension", "swing")),
    "overhead_crane": SceneCase((800, 1600, 3200), index=5, algebraic=("s", "l", "tension", "swing")),
    "gantry_crane": SceneCase((800, 1600, 3200), index=5, algebraic=("s_x", "s_y", "l", "tension", "swing")),
    "cars": SceneCase((400, 800, 1600), index=5, algebraic=("x_1", "x_2")),
}
FORMULATIONS = (
    FormulationCase(sc.Original()),
    FormulationCase(sc.Projected(), projected=True),
    FormulationCase(sc.Reduced(), pointwise=True),
)
METHODS = (MethodCase(sc.BackwardEuler(), order=1),)

UNSTABLE = {
    ("rotary_crane", "generalized", "original"): "small errors grow from step to step, the faster the smaller the step",
    ("overhead_crane", "generalized", "original"): "as the rotary crane",
    ("gantry_crane", "generalized", "original"): "as the rotary crane",
}
"""Scene, model and formulation that no step size saves: kept out of `PROBLEMS` and shown to fail."""


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
    def inputs(self) -> tuple[str, ...]:
        return tuple(each.name for each in self.system.inputs)

    def stepper(self, step: float) -> Stepper:
        return Stepper(self.scene, self.of.formulation, self.by.method, step, self.model)


@cache
def scene(name: str) -> sc.Scene:
    return sc.scenes.REGISTRY[name]()


MODELS = tuple((name, model) for name in SCENES for model in scene(name).models)
PROBLEMS = tuple(
    Problem(name, model, formulation, method)
    for name, model in MODELS
    for formulation in FORMULATIONS
    for method in METHODS
    if (name, model, formulation.formulation.name) not in UNSTABLE
)


def problem(scene_name: str, model: str, formulation: str = "projected", method: str = "backward-euler") -> Problem:
    """Return the registered problem of these names."""
    wanted = "-".join((scene_name, model, formulation, method))
    (found,) = (each for each in PROBLEMS if str(each) == wanted)
    return found


@cache
def solved(what: Problem, steps: int) -> sc.Solution:
    """Solve a problem once, whatever number of tests look at it."""
    step = what.scene.reference.duration / steps
    return sc.solve(what.scene, what.of.formulation, what.by.method, step=step, model=what.model)


@cache
def exact(scene_name: str, steps: int) -> dict[str, np.ndarray]:
    """Closed form on the grid of `solved`."""
    reference = scene(scene_name).reference
    return scene(scene_name).exact(np.linspace(reference.start_time, reference.end_time, steps + 1))


def largest_errors(what: Problem, steps: int, names: tuple[str, ...]) -> np.ndarray:
    """Largest error of each of `names` over the whole run."""
    found, expected = solved(what, steps), exact(what.scene_name, steps)
    return np.array([np.abs(found[name] - expected[name]).max() for name in names])


def jets_near_home(system: sc.MechanicalSystem, perturbations: np.ndarray) -> np.ndarray:
    """Reference jets (..., orders, m) whose position lies about the system's home."""
    jets = np.array(perturbations, dtype=float)
    jets[..., 0, :] += system.home
    return jets


def polynomial_path(coefficients, duration: float = 1.0) -> sc.Reference:
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

    def _derivatives(self, t, order):
        columns = []
        for k in range(order + 1):
            part = np.polynomial.polynomial.polyder(np.array(self.coefficients), k)
            columns.append(np.polynomial.polynomial.polyval(t, part).T)
        return np.stack(columns, axis=1)


# Systems made by hand ------------------------------------------------------------------------------------------------


def as_scene(system: sc.MechanicalSystem, reference: sc.Reference, **settings) -> sc.Scene:
    """Wrap one system as a scene of one model."""
    return sc.Scene(name=system.name, models={"only": lambda: system}, reference=reference, **settings)


def car_chain(masses=(1.0, 2.0), stiffnesses=(50.0,), rest=(0.5,)) -> sc.MechanicalSystem:
    """Cars in a row joined by springs, the first tracked, a force on the last: theory.md section 7."""
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


def car_chain_exact(jets: np.ndarray, masses=(1.0, 2.0), stiffnesses=(50.0,), rest=(0.5,)) -> dict[str, Jet]:
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


def mass_on_car(alpha: float, damping: float) -> sc.MechanicalSystem:
    """Seifried and Blajer 2013: car m1 driven by u, m2 on an incline held by a spring, y = x + s cos(alpha)."""
    coordinates = sc.Coordinates(sc.Quantity("x", "m"), sc.Quantity("s", "m"))
    m1, m2, k = 1.0, 1.0, 5.0
    cos = float(np.cos(alpha))
    s, s_dot = coordinates["s"], coordinates.velocity("s")
    return sc.MechanicalSystem(
        name="mass on car",
        coordinates=coordinates,
        parameters=sc.Parameters(),
        inputs=(sc.Quantity("u", "N"),),
        outputs=(sc.Quantity("y", "m"),),
        mass=ca.SX([[m1 + m2, m2 * cos], [m2 * cos, m2]]),
        output=coordinates["x"] + s * cos,
        input_matrix=ca.sparsify(ca.SX([[-1.0, 0.0]])),
        potential=k / 2 * s**2,
        force=ca.vertcat(0, -damping * s_dot) if damping else ca.SX.zeros(2),
    )


def changed(system: sc.MechanicalSystem, **attributes) -> sc.MechanicalSystem:
    """Return a copy with other attributes; fails as construction does."""
    return replace(system, **attributes)
