"""Validation of a system: shapes, symbols, finite numbers, mass matrix, independent inputs and outputs, unique names.

Values are tested at a few points, which costs less than making the expressions: the configuration at home, its
neighbours on two sides, and a point without symmetry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, require_kind
from servocore.model.symbols import named
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import singular_values
from servocore.numerics.step_operations import operations_of

if TYPE_CHECKING:
    from servocore.model.system import MechanicalSystem

_NEIGHBOURHOOD = 0.01  # of the nominal magnitudes
_CANCELS = 1e-14  # of the largest entry of a mass matrix: a diagonal entry below is round-off
_DEPENDENT = 1e-9  # of the largest singular value of rows of length one
_PART = 0.1  # of the largest part in a dependence: rows with smaller parts are not named

_AT_REST = ("mass", "output", "input_matrix", "potential", "constraints")
_MOVING = ("force", "gyroscopic")
_TIMELESS = ("mass", "output", "input_matrix", "gyroscopic")
_TIME = 0.3  # in s, at which expressions of the time are evaluated

_SYMBOLS = ("multipliers", "gamma", "u")
_TIME_COLUMN, _RATE = "time", ".rate"

_NamedRows = tuple[Sequence[str], ca.SX]


def require_sound(system: MechanicalSystem) -> None:
    """Check names, symbols and values of all expressions of a system.

    Raises
    ------
    InvalidModel
        If a name stands for two quantities, an expression holds foreign symbols or numbers that are not finite, or M is
        not symmetric and positive semidefinite.
    """
    _require_names(system)
    groups = (system.q, system.v, system.p, system.lam, system.u, system.gamma)
    of_q, of_v, of_p, _, _, of_gamma = hashed = [_hashes(group) for group in groups]
    anywhere = frozenset[int]().union(*hashed)
    if len(anywhere) < sum(group.numel() for group in groups):
        raise InvalidModel(
            f"{system.name}: a symbol stands for two among coordinates, parameters, multipliers, inputs and reference"
        )
    for field in _TIMELESS:
        if system.time.numel() and ca.depends_on(getattr(system, field), system.time):
            raise InvalidModel(f"{system.name}: {field} must not depend on the time")
    fields = {field: getattr(system, field) for field in (*_AT_REST, *_MOVING)}
    fields |= {f"observable {quantity.name}": expression for quantity, expression in system.observables.items()}
    still = of_q | of_p | _hashes(system.time)
    _require_symbols(system.name, "guess", system.guess, of_gamma | of_p)
    for what, expression in fields.items():
        known = still if what in _AT_REST else still | of_v if what in _MOVING else anywhere
        _require_symbols(system.name, what, expression, known)
    home, p_home = _home(system)
    points, rates = probes(home, system.coordinates.nominal, p_home), np.cos(np.arange(len(home)))
    rest = [np.sin(2.0 + np.arange(symbols.numel())).reshape(symbols.shape) for symbols in groups[3:]]
    rest[-1][len(system.outputs) :, 0] = _TIME
    evaluate = ca.Function("sc_fields", list(groups), list(fields.values()))
    evaluated = [[np.asarray(value) for value in evaluate.call([at, rates, p_at, *rest])] for at, p_at in points]
    _require_finite(system, fields, evaluated)
    masses = [terms[0] for terms in evaluated]
    _require_symmetric(system.name, masses)
    require_mass(system.name, masses[:3], system.coordinates.names)


def _hashes(expression: ca.SX) -> frozenset[int]:
    """Return hashes of the symbols in an expression."""
    return frozenset(symbol.element_hash() for symbol in ca.symvar(expression))


def _require_symbols(whose: str, what: str, expression: ca.SX, known: frozenset[int]) -> None:
    """Raise `InvalidModel` if an expression holds a symbol whose hash is not known."""
    leftover = [symbol.name() for symbol in ca.symvar(expression) if symbol.element_hash() not in known]
    if leftover:
        raise InvalidModel(f"{whose}: {what} holds symbols that it must not use: {leftover}")


def _require_names(system: MechanicalSystem) -> None:
    """Raise `InvalidModel` if two quantities have the same name: the second would not be reported.

    An output or an observable may have the name of the coordinate that it equals.
    """
    seen: dict[str, tuple[str, ca.SX]] = {}
    kinds = {
        "inputs": named(system.inputs, system.u),
        "observables": [(quantity.name, expression) for quantity, expression in system.observables.items()],
        "outputs": named(system.outputs, system.output),
        "coordinates": named(system.coordinates.quantities, system.q),
        "parameters": named(system.parameters.declared, system.p),
    }
    for kind, quantities in kinds.items():
        for name, expression in quantities:
            if name == _TIME_COLUMN or name.endswith(_RATE):
                meant = "the column of the times in tables" if name == _TIME_COLUMN else "the limit of a rate"
                raise InvalidModel(f"{system.name}: one of the {kind} is called {name}, which is {meant}")
            other, same_expression = seen.setdefault(name, (kind, expression))
            if other == kind and same_expression is not expression:
                raise InvalidModel(
                    f"{system.name}: two of the {kind} are called {name}, one of them needs another name"
                )
            if other != kind and not equal_at_a_point(same_expression, expression):
                raise InvalidModel(
                    f"{system.name}: {name} is the name of two quantities, one of the {other} and one of the {kind};"
                    " one of them needs another name"
                )


def equal_at_a_point(one: ca.SX, other: ca.SX) -> bool:
    """Whether two expressions have the same value at a point without symmetry."""
    if ca.is_equal(one, other):
        return True
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(ca.vertcat(one, other)))
    values = ca.Function("sc_both", [symbols], [one, other])(np.sin(1.0 + np.arange(symbols.numel())))
    first, second = (float(value) for value in values)
    return abs(first - second) <= _DEPENDENT * max(abs(first), abs(second))


def _home(system: MechanicalSystem) -> tuple[Array, Array]:
    """Return the configuration and the parameter values at home."""
    configuration, p = system.home_configuration()
    _require_finite(system, {"guess": system.guess}, [[configuration[:, None]]])
    lost = np.flatnonzero(~np.isfinite(configuration))
    if len(lost):
        outputs = ", ".join(quantity.name for quantity in system.outputs)
        raise InvalidModel(
            f"{system.name}: the guess at home = {system.home} has no value for {system.coordinates.names[lost[0]]};"
            f" home must be a value of {outputs} that the system can take"
        )
    return configuration, p


def probes(home: Array, nominal: Sequence[float], p: Array) -> list[tuple[Array, Array]]:
    """Return points (q, p) at which a system is evaluated.

    Parameters
    ----------
    home : ndarray, shape (n,)
        Configuration at home.
    nominal : sequence of float, shape (n,)
        Typical magnitudes of the coordinates.
    p : ndarray
        Parameter values at home.

    Returns
    -------
    list of (ndarray, ndarray)
        At home, next to it on two sides, and a point without symmetry with other parameter values.
    """
    angles = 1.0 + np.arange(len(home))
    aside = _NEIGHBOURHOOD * np.asarray(nominal) * np.sin(angles)
    disturbed = p * (1.03 + 0.01 * np.sin(1.0 + np.arange(len(p)))) + 0.02
    return [(home, p), (home + aside, p), (home - aside, p), (np.sin(angles), disturbed)]


def _require_finite(system: MechanicalSystem, fields: Mapping[str, ca.SX], values: Sequence[Sequence[Array]]) -> None:
    """Raise `InvalidModel` for the first entry that is not finite because of a constant in it."""
    for k, (field, expression) in enumerate(fields.items()):
        finite = np.all([np.isfinite(point[k]) for point in values], axis=0)
        for i, j in np.argwhere(~finite):
            constants = _constants_not_finite(expression[int(i), int(j)])
            if constants:  # else it is undefined at that point only
                entry = _entry(system, field, int(i), int(j))
                raise InvalidModel(f"{system.name}: {entry} holds {constants[0]}, which is no finite number")


def _constants_not_finite(expression: ca.SX) -> list[float]:
    """Return the constants in an expression that are not finite."""
    function = ca.Function("sc_constants", [ca.vertcat(ca.SX(0, 1), *ca.symvar(expression))], [expression])
    return [constant for *_, constant in operations_of(function) if not np.isfinite(constant)]


def _entry(system: MechanicalSystem, field: str, row: int, column: int) -> str:
    """Return the name of an entry of a field in messages."""
    coordinates, constraints = system.coordinates.names, system.constraint_names
    inputs, outputs = ([quantity.name for quantity in listed] for listed in (system.inputs, system.outputs))
    rows: dict[str, Sequence[object]] = {
        "mass": coordinates, "input_matrix": inputs, "output": outputs, "force": coordinates, "gyroscopic": coordinates,
        "guess": coordinates, "constraints": constraints or range(1, system.constraints.numel() + 1),
    }  # fmt: skip
    if field not in rows:
        return field
    return f"{field}[{rows[field][row]}{f', {coordinates[column]}' if field in ('mass', 'input_matrix') else ''}]"


def _require_symmetric(whose: str, masses: Sequence[Array]) -> None:
    for mass in masses:
        difference = np.abs(mass - mass.T).max(initial=0.0)
        if difference > _DEPENDENT * max(1.0, float(np.abs(mass).max(initial=0.0))):
            raise InvalidModel(f"{whose}: the mass matrix is not symmetric (by {difference:.2g})")


def require_mass(whose: str, masses: Sequence[Array], names: Sequence[str], where: str = "at home") -> None:
    """Raise `InvalidModel` unless a mass matrix is positive semidefinite at home, and at one of its neighbours.

    Parameters
    ----------
    whose : str
        Name of the system.
    masses : sequence of ndarray, shape (n, n)
        M at home, then at its neighbours, one of which may be invalid: there, a mass proportional to a coordinate that
        is zero at home is negative.
    names : sequence of str
        Of the coordinates.
    where : str
        Name of the place in messages.
    """
    faults = [_fault(mass, names) for mass in masses if np.isfinite(mass).all()]
    if faults and (faults[0] or all(faults[1:] or [""])):
        raise InvalidModel(f"{whose}: the mass matrix is not positive semidefinite {where}: {faults[0] or faults[-1]}")


def _fault(mass: Array, names: Sequence[str]) -> str:
    """Return why a matrix is not a mass matrix, as a sentence; empty if it is."""
    diagonal, largest = mass.diagonal(), float(np.abs(mass).max(initial=0.0))
    negative = np.flatnonzero(diagonal < -_CANCELS * largest)
    if len(negative):
        return f"that of {names[negative[0]]} is {diagonal[negative[0]]:g}"
    if not largest:
        return ""
    scale = 1.0 / np.sqrt(np.maximum(diagonal, _CANCELS * largest))  # independent of units
    values, vectors = np.linalg.eigh(mass * scale * scale[:, None])
    if values[0] >= -_DEPENDENT:
        return ""
    parts = np.abs(vectors[:, 0])
    listed = ", ".join(names[k] for k in np.flatnonzero(parts > _PART * parts.max())[:4])
    return f"a motion of {listed} has negative kinetic energy (eigenvalue {np.linalg.eigvalsh(mass)[0]:.3g})"


def require_driving(whose: str, rows: Sequence[Array], names: Sequence[str], kind: str) -> None:
    """Raise `InvalidModel`, naming them, if some inputs or outputs have no effect or follow from others.

    Parameters
    ----------
    whose : str
        Name of the system.
    rows : sequence of ndarray, shape (m, n)
        B or C at some points; a defect must occur at all of them.
    names : sequence of str
        Of the rows.
    kind : str
        "input" or "output".
    """
    finite = [row for row in rows if np.isfinite(row).all()]
    if not finite or not names:
        return
    dead = np.flatnonzero(np.all([~matrix.any(axis=1) for matrix in finite], axis=0))
    if len(dead):
        why = "drives no coordinate" if kind == "input" else "depends on no coordinate"
        raise InvalidModel(f"{whose}: structurally singular, the {kind} {names[dead[0]]} {why}")
    if any(not (dependent := _dependent(matrix)) for matrix in finite):
        return
    listed = ", ".join(names[k] for k in dependent)
    why = "drive the same" if kind == "input" else "follow the same coordinates"
    raise InvalidModel(f"{whose}: structurally singular, the {kind}s {listed} {why}: each is implied by the others")


def _dependent(rows: Array) -> list[int]:
    """Return rows that are combinations of one another; none if all are independent."""
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows / np.where(lengths > 0.0, lengths, 1.0)
    values = singular_values(rows)
    if len(values) == len(rows) and values[-1] > _DEPENDENT * values[0]:
        return []
    left, _, _ = np.linalg.svd(rows)
    parts = np.abs(left[:, -1])
    return [int(k) for k in np.flatnonzero(parts > _PART * parts.max())]


def require_shapes(name: str, expressions: Mapping[str, ca.SX], shapes: Mapping[str, tuple[int, int]]) -> None:
    """Refuse fields of another shape, and expressions where symbols belong."""
    for field, expression in expressions.items():
        if expression.shape != shapes[field]:
            raise InvalidModel(f"{name}: {field} has shape {expression.shape}, expected {shapes[field]}")
        if field in _SYMBOLS and not expression.is_valid_input():
            raise InvalidModel(f"{name}: {field} must be symbols of casadi.SX.sym, not expressions")


def require_freedom(name: str, n: int, m: int, rows: int, rank: int, *, assembled: bool) -> None:
    """Refuse more inputs m than n coordinates have degrees of freedom under constraints of this rank."""
    if not assembled:
        raise InvalidModel(
            f"{name}: {m} inputs are too many for {n} coordinates with {rows} holonomic constraints, unless"
            " these are redundant in part; no configuration that satisfies them was found from the guess at home"
        )
    if m > n - rank:
        raise InvalidModel(
            f"{name}: {m} inputs exceed the {n - rank} degrees of freedom"
            f" ({n} coordinates, {rank} independent ones of {rows} holonomic constraints)"
        )


def clock(name: str, time: ca.SX, gamma: ca.SX, home: tuple[float, ...], m: int) -> dict[str, object]:
    """Return gamma with the time as its last row, and home with it as its last entry, where there is a time."""
    fields: dict[str, object] = {}
    if isinstance(time, ca.SX) and not time.numel():
        return fields
    require_kind(time, ca.SX, f"{name}: the time", "a symbol of casadi.SX.sym", InvalidModel)
    if not time.is_symbolic():
        raise InvalidModel(f"{name}: the time must be one symbol, not {time}")
    if gamma.size1() == m:  # a system made from another already has that row
        rates = ca.SX.sym("time", 1, gamma.size2() - 1)
        fields["gamma"] = ca.vertcat(gamma, ca.horzcat(time, rates))
    if len(home) == m:
        fields["home"] = (*home, 0.0)
    return fields


def require_positions(system: str, v: ca.SX, outputs: _NamedRows, constraints: _NamedRows) -> None:
    """Raise `InvalidModel` if outputs or constraints depend on velocities, with an alternative.

    Parameters
    ----------
    system : str
        Name for messages.
    v : casadi.SX
        Velocities.
    outputs, constraints : sequence of names, and casadi.SX
        Names of the rows, and the rows.
    """
    advice = {
        "output": "but a servo constraint prescribes a function of the coordinates alone; where the output is the rate"
        " of such a function, prescribe that function, along the integral of the path",
        "constraint": "and nonholonomic constraints are not solved; give its integral if it has one (rolling along a"
        " line has), or replace it by a force f(q, v) that opposes the forbidden velocity",
    }
    for kind, (names, column) in (("output", outputs), ("constraint", constraints)):
        for name, expression in zip(names, ca.vertsplit(ca.SX(column)), strict=False):
            columns = sorted(set(ca.jacobian_sparsity(expression, v).get_col()))
            velocities = ", ".join(str(v[int(k)]) for k in columns)
            if velocities:
                raise InvalidModel(f"{system}: the {kind} {name} depends on velocities ({velocities}), {advice[kind]}")
