r"""The elastic bar, as a chain of N masses: its free end is to follow a path, the force acts on the other end.

     m [o]=====================================|---> u         bar of length L, stiffness E A, mass rho A a metre
        |---> w_1 = y                          |---> w_N
        X = 0                                X = L

        [m_1]--/\/\--[m_2]--/\/\--  ...  --/\/\--[m_N]--> u    N nodes, N - 1 springs k = E A (N - 1)/L

What the scene needs: L, E A, rho A and the end mass m; model ``points``, whose coordinates are the displacements w_i of
the nodes. An inner node carries the mass of one piece, rho A L/(N - 1), an end node half of that, the first m besides.
Left out: damping, bending, large strain.

The chain is that of the cars: index 2 N + 1, no internal dynamics, closed form by jets. The bar itself obeys the wave
equation, and d'Alembert gives what moves its free end along gamma (`dalembert`), with c = sqrt(E A/(rho A)):

    w(X, t) = (gamma(t + X/c) + gamma(t - X/c))/2 + c m/(2 E A) (gamma'(t + X/c) - gamma'(t - X/c)),
    u(t) = E A/(2 c) (gamma'(t + L/c) - gamma'(t - L/c)) + m/2 (gamma''(t + L/c) + gamma''(t - L/c)).

The force starts L/c before the free end moves and ends L/c after: pre-actuation, the time a wave needs. No chain does
that, for its inputs hold derivatives of the path at one instant. With N they become the Taylor series of gamma(t + L/c)
and gamma(t - L/c). So within the motion, farther than L/c from its start and end, the chain converges to the bar, with
the square of 1/(N - 1). Nearer to them it converges to something else: it continues the path beyond its ends as the
polynomial that it is between them, not as rest. A chain models the bar for paths that are slow compared with L/c.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial

import casadi as ca
import numpy as np

from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem
from servocore.numerics.calls import Array
from servocore.references import Reference, rest_to_rest
from servocore.references.profiles import polynomial
from servocore.scenes import jets
from servocore.scenes.cars import follow_chain, require_masses

PARAMETERS = Parameters(
    Parameter("length", 1.0, "m", 1e-3, 1e6, "L"),
    Parameter("axial_stiffness", 100.0, "N", 1e-3, 1e15, "E A"),
    Parameter("line_mass", 1.0, "kg/m", 1e-3, 1e9, "rho A"),
    Parameter("end_mass", 0.5, "kg", 0.0, 1e9, "m, at the free end"),
)
INPUT = Quantity("u", "N", "force on the driven end, away from the free end")
OUTPUT = Quantity("y", "m", "displacement of the free end")


@cache
def points(count: int) -> MechanicalSystem:
    """Return N coordinates w_1 ... w_N without constraints: M constant and diagonal, V quadratic."""
    p, pieces = PARAMETERS, count - 1
    coordinates = Coordinates(*(Quantity(f"w_{i}", "m", f"displacement of node {i}") for i in range(1, count + 1)))
    w = coordinates.q
    gamma = ca.SX.sym("gamma", 1, MAX_REFERENCE_ORDER + 1)
    piece = p["line_mass"] * p["length"] / pieces
    masses = (p["end_mass"] + piece / 2, *[piece] * (count - 2), piece / 2)
    input_matrix = ca.SX(1, count)
    input_matrix[0, count - 1] = -1
    return MechanicalSystem(
        name=f"elastic bar, {count} points",
        coordinates=coordinates,
        parameters=p,
        inputs=(INPUT,),
        outputs=(OUTPUT,),
        mass=ca.sparsify(ca.diag(ca.vertcat(*masses))),
        potential=p["axial_stiffness"] * pieces / p["length"] * ca.sumsqr(w[1:] - w[:-1]) / 2,
        input_matrix=input_matrix,
        output=w[0],
        gamma=gamma,
        guess=ca.repmat(gamma[0, 0], count, 1),
    )


def closed_form(reference: Array, parameters: Mapping[str, float], *, count: int) -> dict[str, Array]:
    """Exact force and displacements of the chain for reference jets (N, orders, 1) of order 2 `count` or higher."""
    length, axial_stiffness, line_mass, end_mass = (parameters[name] for name in PARAMETERS.names)
    (y,) = jets.components(reference)
    pieces = count - 1
    piece = line_mass * length / pieces
    masses = [end_mass + piece / 2, *[piece] * (count - 2), piece / 2]
    positions, force = follow_chain(y, masses, [axial_stiffness * pieces / length] * pieces, [0.0] * pieces)
    found = {f"w_{i}": w.value for i, w in enumerate(positions, 1)}
    return {INPUT.name: force.value, **found, OUTPUT.name: y.value}


def wave_time(parameters: Mapping[str, float]) -> float:
    """Return L/c, the time in s that a wave needs from one end of the bar to the other."""
    return parameters["length"] * float(np.sqrt(parameters["line_mass"] / parameters["axial_stiffness"]))


def dalembert(
    t: Array, reference: Reference, parameters: Mapping[str, float], section: float | None = None
) -> dict[str, Array]:
    """Exact answer of the continuous bar: what happens at one of its sections when the free end follows the path.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in s, also before the start of the path and after its end.
    reference : Reference
        Path of the free end, with two derivatives, at rest before and after.
    parameters : mapping of str to float
        All four parameters.
    section : float, optional
        X in m, distance from the free end; the driven end, X = L, when not given.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        u, force through the section in N, positive in tension: at the driven end the input; w, its displacement in m.
    """
    length, axial_stiffness, line_mass, end_mass = (parameters[name] for name in PARAMETERS.names)
    speed = np.sqrt(axial_stiffness / line_mass)
    delay = (length if section is None else section) / speed
    early, late = (np.moveaxis(reference.jet(t + shift, 2)[..., 0], -1, 0) for shift in (delay, -delay))
    difference, total = early - late, early + late
    return {
        "u": axial_stiffness / (2 * speed) * difference[1] + end_mass / 2 * total[2],
        "w": total[0] / 2 + speed * end_mass / (2 * axial_stiffness) * difference[1],
    }


def elastic_bar(count: int = 3) -> Scene:
    """Return the bar as a chain with its default manoeuvre: the free end moves from 0 m to 1 m in 2 s.

    The path is the polynomial of degree 4 N + 1, the lowest whose derivatives up to 2 N rest at both ends.

    Parameters
    ----------
    count : int
        Number N of masses, 2 to `servocore.scenes.cars.MOST_MASSES`.

    Raises
    ------
    InvalidModel
        If there are too few masses, or more than a model has derivatives of the path for.
    """
    require_masses("masses", count)
    return Scene(
        name="elastic_bar",
        models={"points": partial(points, count)},
        reference=rest_to_rest((0.0,), (1.0,), 2.0, polynomial(4 * count + 1)),
        closed_form=partial(closed_form, count=count),
        closed_form_order=2 * count,
    )
