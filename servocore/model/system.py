"""`MechanicalSystem`: equation (1) of the paper as data, with its servo output.

    q_dot = v
    M v_dot + (bias of a configuration-dependent M) + grad V + G^T lam + B^T u = force(q, v)
    c(q, t) = Phi(q) - gamma(t) = 0            servo constraints, C = D Phi
    g(q, t) = 0                                holonomic constraints, G = D g

`-B^T u` is the generalized force that the inputs exert. M may be singular (massless coordinates), M and B may
depend on q. The reference gamma and its derivatives are symbols too: a compiled step serves every path. Where f, V or g
depend on the time, it is one more row of gamma, with the derivatives 1, 0, 0, ...
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel, require_kind
from servocore.model.model_validation import clock, require_freedom, require_positions, require_shapes, require_sound
from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates, Parameters, numbers, quantities_of, symbols
from servocore.numerics.compiled_calls import Array
from servocore.numerics.constraint_ranks import ConstraintRank, constraint_rank, last_good_columns
from servocore.numerics.expressions import as_expression, expressions_of, gyroscopic_forces

MAX_REFERENCE_ORDER = 24
"""Highest derivative of the reference for which a system keeps symbols."""

DERIVED = ca.SX()
"""Default of fields that `MechanicalSystem` derives when they are not given."""

_EXPRESSIONS = (
    "mass", "output", "input_matrix", "potential", "force", "constraints", "gyroscopic", "multipliers", "gamma",
    "guess", "u",
)  # fmt: skip


def reference_symbols(components: int) -> ca.SX:
    """Return symbols of a reference and its derivatives, shape (components, `MAX_REFERENCE_ORDER` + 1)."""
    return ca.SX.sym("gamma", components, MAX_REFERENCE_ORDER + 1)


@dataclass(frozen=True, eq=False)
class MechanicalSystem:
    """A mechanical system with holonomic constraints, inputs and a servo output, equation (1).

    Expressions can also be given as a number, a NumPy array or a nested list of numbers and expressions.

    Parameters
    ----------
    name : str
        Name of the system in messages.
    coordinates : Coordinates
        The n coordinates q and velocities v.
    parameters : Parameters
        Constants of the model.
    inputs : tuple of Quantity
        The m inputs u.
    outputs : tuple of Quantity
        The m components of the servo output Phi(q), which the reference prescribes.
    mass : casadi.SX
        M(q, p), shape (n, n), symmetric; may be singular.
    output : casadi.SX
        Phi(q, p), shape (m,).
    input_matrix : casadi.SX
        B(q, p), shape (m, n).
    potential : casadi.SX
        V(q, p), scalar.
    force : casadi.SX
        Applied forces f(q, v, p) on the right-hand side of the momentum equation, shape (n,).
    constraints : casadi.SX
        g(q, p), shape (m_h,).
    gyroscopic : casadi.SX, optional
        Inertia forces quadratic in v, shape (n,); derived from M when not given.
    multipliers : casadi.SX, optional
        Symbols lam, shape (m_h,), if observables use them; made when not given.
    gamma : casadi.SX, optional
        Symbols of the reference and its derivatives, shape (m, `MAX_REFERENCE_ORDER` + 1).
    guess : casadi.SX, optional
        A configuration q near the one that belongs to the reference, an expression of gamma[:, 0] and p.
        Decides between branches (load below or above the girder); zeros when not given.
    home : tuple of float, optional
        A value of the servo output, shape (m,), at which the system is regular; ones when not given. Formulations
        decide there which coordinates they treat as dependent.
    observables : mapping of Quantity to casadi.SX
        Further reported quantities: expressions of q, v, lam, u, p and gamma.
    u : casadi.SX, optional
        Symbols of the inputs, shape (m,), if observables use them; made when not given.
    home_parameters : tuple of float, optional
        Parameter values at which the structure is analysed; the defaults when not given.
    constraint_names : tuple of str, optional
        Names of the rows of `constraints` in messages; g_1, g_2, ... when not given.
    time : casadi.SX, optional
        Symbol of the time in s, if `potential`, `force`, `constraints`, `guess` or observables depend on it. It becomes
        the last row of `gamma`, and home is then the time zero.
    reactions : mapping of Quantity to casadi.Function
        Observables with multipliers that `generalize` eliminated, as functions of (q, v, v_dot, u, force on the
        output, p).

    Attributes
    ----------
    path : casadi.SX
        The rows of gamma without the time, shape (m, `MAX_REFERENCE_ORDER` + 1).
    G : casadi.SX
        Constraint Jacobian D g(q), shape (m_h, n).
    C : casadi.SX
        Servo Jacobian D Phi(q), shape (m, n).
    bias : casadi.SX
        Everything in the momentum equation but M v_dot, G^T lam and B^T u, shape (n,).
    constraint_forces : casadi.SX
        G^T lam + B^T u, shape (n,).

    Raises
    ------
    InvalidModel
        If kinds or sizes do not match, a name stands for two quantities, an expression holds a foreign symbol or a
        number that is not finite, M is not symmetric and positive semidefinite at home, an input or output has no
        effect or follows from others, or there are more inputs than degrees of freedom. Redundant constraints do not
        count: the rank is taken where they hold.
    """

    name: str
    coordinates: Coordinates
    parameters: Parameters
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    mass: ca.SX
    output: ca.SX
    input_matrix: ca.SX
    potential: ca.SX = field(default_factory=lambda: ca.SX(0))
    force: ca.SX = DERIVED
    constraints: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    gyroscopic: ca.SX = DERIVED
    multipliers: ca.SX = DERIVED
    gamma: ca.SX = DERIVED
    guess: ca.SX = DERIVED
    home: tuple[float, ...] = ()
    observables: Mapping[Quantity, ca.SX] = field(default_factory=dict)
    u: ca.SX = DERIVED
    home_parameters: tuple[float, ...] = ()
    constraint_names: tuple[str, ...] = ()
    time: ca.SX = DERIVED
    reactions: Mapping[Quantity, ca.Function] = field(default_factory=dict)
    G: ca.SX = field(init=False, repr=False)
    C: ca.SX = field(init=False, repr=False)
    bias: ca.SX = field(init=False, repr=False)
    constraint_forces: ca.SX = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._take()
        n, m, m_h = len(self.coordinates), len(self.inputs), self.constraints.numel()
        self._fill("force", ca.SX.zeros(n))
        self._fill("multipliers", ca.SX.sym("lam", m_h))
        self._fill("gamma", reference_symbols(m))
        self._fill("guess", ca.SX.zeros(n))
        self._fill("time", ca.SX(0, 1))
        self._set(clock(self.name, self.time, self.gamma, self.home, m))
        self._fill("u", symbols(quantity.name for quantity in self.inputs))
        self._require_shapes(n, m, m_h)
        self._derive()
        require_sound(self)
        if m > n - m_h:  # otherwise there are degrees of freedom enough for any rank
            ranks = self._rank_at_home
            require_freedom(self.name, n, m, m_h, ranks.rank, assembled=ranks.assembled)

    def _take(self) -> None:
        """Check the kinds of the arguments; convert arrays and numbers to expressions, sequences to tuples."""
        require_kind(self.name, str, "the name of a system", "a text", InvalidModel)
        for attribute, kind in (("coordinates", Coordinates), ("parameters", Parameters), ("observables", Mapping)):
            what, wanted = f"{self.name}: {attribute}", f"a {kind.__name__}"
            require_kind(getattr(self, attribute), kind, what, wanted, InvalidModel)
        inputs, outputs = (quantities_of(getattr(self, k), f"{self.name}: {k}") for k in ("inputs", "outputs"))
        if len(inputs) != len(outputs):
            raise InvalidModel(f"{self.name}: {len(inputs)} inputs cannot prescribe {len(outputs)} outputs")
        taken: dict[str, object] = {"inputs": inputs, "outputs": outputs}
        expressions = {
            attribute: getattr(self, attribute) for attribute in _EXPRESSIONS if getattr(self, attribute) is not DERIVED
        }
        taken |= expressions_of(self.name, expressions, len(self.coordinates))
        seen = quantities_of(tuple(self.observables), f"{self.name}: observables")
        taken["observables"] = {
            quantity: as_expression(self.observables[quantity], f"{self.name}: observable {quantity.name}")
            for quantity in seen
        }
        at_home = [quantity.name for quantity in outputs]
        if ca.SX(self.time).numel() == 1 and isinstance(self.home, tuple) and len(self.home) == len(outputs) + 1:
            at_home.append("time")  # the last entry in a system made from another
        taken["home"] = numbers(self.home, at_home, f"{self.name}: home") or (1.0,) * len(outputs)
        values = numbers(self.home_parameters, self.parameters.names, f"{self.name}: home_parameters")
        taken["home_parameters"] = values or tuple(self.parameters.values().tolist())
        self._set(taken)

    def _derive(self) -> None:
        derived = {"G": ca.jacobian(self.constraints, self.q), "C": ca.jacobian(self.output, self.q)}
        derived["bias"] = ca.gradient(self.potential, self.q) - self.force + self.gyroscopic
        derived["constraint_forces"] = ca.mtimes(derived["G"].T, self.lam) + ca.mtimes(self.input_matrix.T, self.u)
        self._set(derived)

    def _set(self, values: Mapping[str, object]) -> None:
        for attribute, value in values.items():
            object.__setattr__(self, attribute, value)

    def _fill(self, attribute: str, default: ca.SX) -> None:
        if getattr(self, attribute) is DERIVED:
            self._set({attribute: default})

    def _require_shapes(self, n: int, m: int, m_h: int) -> None:
        """Check sizes; derive the gyroscopic forces in between."""
        if len(self.constraint_names) not in (0, m_h):
            raise InvalidModel(f"{self.name}: {len(self.constraint_names)} names for {m_h} holonomic constraints")
        shapes = {
            "mass": (n, n), "output": (m, 1), "input_matrix": (m, n), "potential": (1, 1), "force": (n, 1),
            "constraints": (m_h, 1), "multipliers": (m_h, 1), "guess": (n, 1), "u": (m, 1),
            "gamma": (m + self.time.numel(), MAX_REFERENCE_ORDER + 1),
        }  # fmt: skip
        require_shapes(self.name, {attribute: getattr(self, attribute) for attribute in shapes}, shapes)
        self._fill("gyroscopic", gyroscopic_forces(self.mass, self.q, self.v))
        require_shapes(self.name, {"gyroscopic": self.gyroscopic}, {"gyroscopic": (n, 1)})
        rows = self.constraint_names or tuple(f"g_{k + 1}" for k in range(m_h))
        names = [channel.name for channel in self.outputs]
        require_positions(self.name, self.v, (names, self.output), (rows, self.constraints))
        for quantity, expression in self.observables.items():
            if expression.shape != (1, 1):
                raise InvalidModel(f"{self.name}: observable {quantity.name} has shape {expression.shape}, not (1, 1)")

    @property
    def q(self) -> ca.SX:
        """Coordinates, shape (n,)."""
        return self.coordinates.q

    @property
    def v(self) -> ca.SX:
        """Velocities, shape (n,)."""
        return self.coordinates.v

    @property
    def p(self) -> ca.SX:
        """Parameters, shape (n_p,)."""
        return self.parameters.p

    @property
    def lam(self) -> ca.SX:
        """Multipliers of the holonomic constraints, shape (m_h,)."""
        return self.multipliers

    @property
    def degrees_of_freedom(self) -> int:
        """N less the rank of the holonomic constraints, where they hold."""
        return len(self.coordinates) - self._rank_at_home.rank

    @cached_property  # assembling a large mechanism is slow, and not every system needs its rank
    def _rank_at_home(self) -> ConstraintRank:
        return self._constraint_rank(None)

    def constraint_rank(self, p: Array | None = None) -> ConstraintRank:
        """Find how many holonomic constraints are independent, and which are redundant.

        Parameters
        ----------
        p : ndarray, shape (n_p,), optional
            Parameter values in the units of the model; `home_parameters` when not given.

        Returns
        -------
        ConstraintRank
            At configurations that satisfy the constraints near the guess at `home`.
        """
        return self._rank_at_home if p is None or tuple(p) == self.home_parameters else self._constraint_rank(p)

    def _constraint_rank(self, p: Array | None) -> ConstraintRank:
        home, values = self.home_configuration()
        starts, values = ([home], values) if p is None else ([self.home_configuration(p)[0], home], p)
        constraints = ca.substitute(self.constraints, self.time, ca.SX.zeros(self.time.shape))
        return constraint_rank(constraints, self.q, self.p, starts, values, self.coordinates.nominal)

    def listed_constraints(self, rows: Sequence[int]) -> str:
        """Return the names of some rows of the holonomic constraints, for messages.

        Parameters
        ----------
        rows : sequence of int
            Their numbers from zero.

        Returns
        -------
        str
            The names, with commas between them.
        """
        return ", ".join(self.constraint_names[k] if self.constraint_names else f"g_{k + 1}" for k in rows)

    def require_independent_constraints(self) -> None:
        """Refuse holonomic constraints of which some are redundant.

        Raises
        ------
        InvalidModel
            If they are; the message names the rows that follow from others.
        """
        ranks = self._rank_at_home
        if ranks.redundant:
            raise InvalidModel(
                f"{self.name}: {len(ranks.redundant)} of the {ranks.rows} holonomic constraints are redundant (rank"
                f" {ranks.rank}): {self.listed_constraints(ranks.redundant)}; solve and analyse leave them out"
            )

    @property
    def path(self) -> ca.SX:
        """Symbols of the path of the servo output and its derivatives, shape (m, `MAX_REFERENCE_ORDER` + 1)."""
        return self.gamma[: len(self.outputs), :]

    @property
    def gamma_dot(self) -> ca.SX:
        """Rate of gamma[:, :-1]; that of the time is constant."""
        rate = self.gamma[:, 1:]
        if self.time.numel():
            rate[-1, 1:] = 0
        return rate

    @property
    def constraint_rate(self) -> ca.SX:
        """Rate of the holonomic constraints, shape (m_h,)."""
        return ca.mtimes(self.G, self.v) + ca.jtimes(self.constraints, self.gamma[:, 0], self.gamma_dot[:, 0])

    def momentum_balance(self, acceleration: ca.SX) -> ca.SX:
        """Return the left-hand side of equation (1)_2 less its right-hand side.

        Parameters
        ----------
        acceleration : casadi.SX
            v_dot in the units of v per second, shape (n,).

        Returns
        -------
        casadi.SX
            Residual in the units of the forces, shape (n,); zero along a motion.
        """
        return ca.mtimes(self.mass, acceleration) + self.bias + self.constraint_forces

    def home_configuration(self, p: Array | None = None) -> tuple[Array, Array]:
        """Return the guess at `home`.

        Parameters
        ----------
        p : ndarray, shape (n_p,), optional
            Parameter values; `home_parameters` when not given.

        Returns
        -------
        q, p : ndarray
            The configuration, shape (n,), and the parameter values, shape (n_p,), in the units of the model.
        """
        if p is None:
            return self._guess_at_home.copy(), np.array(self.home_parameters, dtype=np.float64)
        gamma = ca.horzcat(ca.DM(list(self.home)), ca.DM(self.gamma.size1(), self.gamma.size2() - 1))
        return np.asarray(self.guess_function(gamma, p)).ravel(), p

    @cached_property  # evaluated at many points where a path is out of reach
    def guess_function(self) -> ca.Function:
        """(gamma, p) -> guess of the configuration."""
        return ca.Function("guess", [self.gamma, self.p], [ca.densify(self.guess)])

    @cached_property  # every part of an analysis starts from it
    def _guess_at_home(self) -> Array:
        return self.home_configuration(np.array(self.home_parameters, dtype=np.float64))[0]

    def dependent_coordinates(self) -> list[int]:
        """Return the coordinates that the servo constraints are solved for.

        Returns
        -------
        list of int
            Numbers of m columns of C whose minor is far from zero.

        Raises
        ------
        InvalidModel
            If C loses rank at home.
        """
        C = np.asarray(ca.Function("C", [self.q, self.p], [self.C])(*self.home_configuration()))
        columns = last_good_columns(C * self.coordinates.nominal)
        if columns is None:
            raise InvalidModel(
                f"{self.name}: the servo outputs are dependent at the home configuration, that of the guess at"
                f" {self.home}; give a home where they are not"
            )
        return columns
