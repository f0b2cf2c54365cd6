r"""Cars in a row, joined by springs: the first is to follow a path, the force acts on the last.

      u          k_2, d_2        k_1, d_1
    ----> [m_3]---/\/\/\---[m_2]---/\/\/\---[m_1]        two cars: [m_2]---/\/\/\---[m_1]
    -------|----------------|----------------|-----> x
          x_3              x_2              x_1 = y

What the scene needs: masses m_1 ... m_n, stiffnesses k_1 ... k_(n-1) and rest lengths d_1 ... d_(n-1) of n degrees of
freedom, one input; model ``points``, whose coordinates are the positions.
Left out: friction and damping (with them the inverse problem has internal dynamics), and the length of the cars. The
scene has no limits: the equations are linear, and hold even where cars would pass through one another.

The balance of car i gives the next car from the ones before,

    x_(i+1) = x_i - d_i + (m_1 x_1'' + ... + m_i x_i'')/k_i,    u = m_1 x_1'' + ... + m_n x_n'',

so that u needs the derivative of order 2 n of the path: index 2 n + 1, no internal dynamics. The scene shows what a
high index costs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial

import casadi as ca

from servocore.errors import InvalidModel
from servocore.model.quantity import Quantity
from servocore.model.scene import Scene
from servocore.model.symbols import Coordinates, Parameter, Parameters
from servocore.model.system import MAX_REFERENCE_ORDER, MechanicalSystem
from servocore.numerics.calls import Array
from servocore.references import rest_to_rest
from servocore.references.profiles import polynomial
from servocore.scenes import jets

INPUT = Quantity("u", "N", "force on the last car, positive forwards")
OUTPUT = Quantity("y", "m", "position of the first car")

MOST_MASSES = MAX_REFERENCE_ORDER // 2
"""A chain of n masses needs the derivative of order 2 n of its path."""


def require_masses(what: str, count: int) -> int:
    """Return the number of masses of a chain, or raise `InvalidModel` if there is no such chain."""
    if not isinstance(count, int) or count < 2:
        raise InvalidModel(f"a chain of {what} has at least 2 of them, not {count}")
    if count > MOST_MASSES:
        raise InvalidModel(
            f"{count} {what} need derivatives of the path up to order {2 * count}, but a model has symbols for"
            f" {MAX_REFERENCE_ORDER} only: at most {MOST_MASSES} {what}"
        )
    return count


def follow_chain(
    first: jets.Jet, masses: Sequence[float], stiffnesses: Sequence[float], rest_lengths: Sequence[float]
) -> tuple[list[jets.Jet], jets.Jet]:
    """Return positions x_1 ... x_n and the force on the last of n masses in a row, for the path of the first.

    Parameters
    ----------
    first : Jet
        x_1 with at least 2 n derivatives.
    masses : sequence of float, length n
        In kg.
    stiffnesses, rest_lengths : sequence of float, length n - 1
        Of the springs, in N/m and m.
    """
    positions, force = [first], masses[0] * first.d().d()
    for mass, stiffness, length in zip(masses[1:], stiffnesses, rest_lengths, strict=True):
        positions.append(positions[-1] - length + force / stiffness)
        force = force + mass * positions[-1].d().d()
    return positions, force


@cache
def parameters(count: int) -> Parameters:
    """Masses, stiffnesses and rest lengths, counted from the first car."""
    springs = range(1, count)
    return Parameters(
        *(Parameter(f"mass_{i}", 1.0, "kg", 1e-3, 1e9, f"m_{i}") for i in range(1, count + 1)),
        *(Parameter(f"stiffness_{i}", 50.0, "N/m", 1e-3, 1e12, f"k_{i}, cars {i} and {i + 1}") for i in springs),
        *(Parameter(f"rest_length_{i}", 0.5, "m", 1e-3, 1e3, f"d_{i}, cars {i} and {i + 1}") for i in springs),
    )


@cache
def points(count: int) -> MechanicalSystem:
    """Return n coordinates x_1 ... x_n without constraints: M constant and diagonal, V quadratic."""
    p = parameters(count)
    coordinates = Coordinates(*(Quantity(f"x_{i}", "m", f"position of car {i}") for i in range(1, count + 1)))
    x = coordinates.q
    gamma = ca.SX.sym("gamma", 1, MAX_REFERENCE_ORDER + 1)
    potential, rest = ca.SX(0), [gamma[0, 0]]
    for i in range(1, count):
        stretch = x[i - 1] - x[i] - p[f"rest_length_{i}"]
        potential += p[f"stiffness_{i}"] * stretch**2 / 2
        rest.append(rest[-1] - p[f"rest_length_{i}"])
    input_matrix = ca.SX(1, count)
    input_matrix[0, count - 1] = -1
    return MechanicalSystem(
        name=f"{count} cars, points",
        coordinates=coordinates,
        parameters=p,
        inputs=(INPUT,),
        outputs=(OUTPUT,),
        mass=ca.sparsify(ca.diag(p.p[:count])),
        potential=potential,
        input_matrix=input_matrix,
        output=x[0],
        gamma=gamma,
        guess=ca.vertcat(*rest),
    )


def closed_form(reference: Array, values: Mapping[str, float], *, count: int) -> dict[str, Array]:
    """Exact force and positions for reference jets (N, orders, 1) of order 2 `count` or higher."""
    (y,) = jets.components(reference)
    springs = range(1, count)
    positions, force = follow_chain(
        y,
        [values[f"mass_{i}"] for i in range(1, count + 1)],
        [values[f"stiffness_{i}"] for i in springs],
        [values[f"rest_length_{i}"] for i in springs],
    )
    found = {f"x_{i}": x.value for i, x in enumerate(positions, 1)}
    return {INPUT.name: force.value, **found, OUTPUT.name: y.value}


def cars(count: int = 2) -> Scene:
    """Return a row of cars with its default manoeuvre: the first moves from 0 m to 1 m in 4 s.

    The path is the polynomial of degree 4 n + 1, the lowest whose derivatives up to 2 n rest at both ends.

    Parameters
    ----------
    count : int
        Number n of cars, 2 to `MOST_MASSES`.

    Raises
    ------
    InvalidModel
        If there are too few cars, or more than a model has derivatives of the path for.
    """
    require_masses("cars", count)
    return Scene(
        name="cars",
        models={"points": partial(points, count)},
        reference=rest_to_rest((0.0,), (1.0,), 4.0, polynomial(4 * count + 1)),
        closed_form=partial(closed_form, count=count),
        closed_form_order=2 * count,
    )
