"""From a tree to equation (1): masses, forces, drives, constraints and servo outputs as expressions.

For an elastic joint with motor theta behind its gear and link q (Spong),

    M(q) q'' + h(q, q') + D q' = K (theta - q) + D_s (theta' - q'),
    B theta'' + K (theta - q) + D_s (theta' - q') = u.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from servocore.errors import InvalidModel
from servocore.importers.coordinates import MOTOR, Layout, rope_hinges
from servocore.importers.drives import chosen_drives, rotors
from servocore.importers.recursion import sparse
from servocore.importers.tree import Closure
from servocore.model.drawing import Part
from servocore.model.quantity import Quantity
from servocore.model.system import MechanicalSystem, reference_symbols
from servocore.numerics.compiled_calls import Array
from servocore.numerics.components import filled

_CLOSED = 1e-12  # m or rad: residual of closed loops at the posture
_MOST_CORRECTIONS = 50
_DEPENDENT = 1e-7  # of the largest singular value of the outputs and constraints at the posture
_ROUND_OFF = 1e-12


class Assembly(Layout):
    """The expressions of a mechanism, and a factory of its model.

    Parameters
    ----------
    tree : Tree
        The mechanism.
    options : Options
        Choices of the user.
    """

    def __call__(self) -> MechanicalSystem:
        """Return the model; raises `InvalidModel` or `InvalidSetting` if the choices do not fit the mechanism."""
        tree = self.tree
        gamma, lam = reference_symbols(len(self.inputs)), ca.SX.sym("lam", len(self.rows))
        gravity = ca.SX(ca.DM(list(tree.gravity if self.options.gravity is None else self.options.gravity)))
        posture = self.posture
        inputs = tuple(drive.quantity for drive in self.inputs)
        outputs = self.output_rows(self.output_names, posture)
        if len(outputs) != len(self.inputs):
            one, other = (", ".join(each.name for each in listed) for listed in (outputs, inputs))
            raise InvalidModel(
                f"{tree.source}: {len(outputs)} outputs ({one}) need as many inputs, not {len(self.inputs)} ({other});"
                " choose others with outputs, inputs, passive or locked"
            )
        output = ca.vertcat(*outputs.values())
        observed = {quantity: value for drive in self.inputs for quantity, value in drive.observed.items()}
        home, spread = self._prediction(output, list(outputs), posture)
        return MechanicalSystem(
            name=tree.name,
            coordinates=self.coordinates,
            parameters=self.parameters,
            inputs=inputs,
            outputs=tuple(outputs),
            mass=self.mass,
            gyroscopic=ca.mtimes(self.reduction.T, self.motion.inertia_forces()),
            potential=self._potential(gravity),
            force=self._damping(),
            input_matrix=-ca.jacobian(ca.vertcat(ca.SX(0, 1), *[drive.power for drive in self.inputs]), self.v),
            output=output,
            constraints=ca.vertcat(ca.SX(0, 1), *self.rows.values()),
            constraint_names=tuple(self.rows),
            multipliers=lam,
            u=ca.vertcat(*[drive.symbol for drive in self.inputs]),
            gamma=gamma,
            guess=posture + ca.mtimes(ca.DM(spread), gamma[:, 0] - ca.DM(home)),
            home=tuple(home),
            observables=self._tensions(lam) | observed | rotors(self, self.inputs),
        )

    def drawing(self, v: Mapping[str, Any]) -> list[Part]:
        """Return the parts for symbols of the reported quantities by name.

        Links are bars between joints, joints pins, frames that follow a path bodies.
        """
        values = ca.vertcat(*[v[name] for name in self.coordinates.names])
        named = [name if name in self.tree.body else name.rpartition(".")[0] for name in self.output_names]
        tips = dict.fromkeys([*self.loads, *(name for name in named if name in self.tree.body)])
        origins = {stage: position for stage, (_, position) in self.motion.world.items()}
        parts: list[tuple[str, tuple[ca.SX, ...], str]] = [("pin", (origins[k],), "") for k in range(len(self.stages))]
        parts += [("bar", (origins[stage.base.stage], origins[k]), "") for k, stage in enumerate(self.stages)]
        parts += [("rope", (origins[self.anchor(body)], self.point(body)), "") for body in self.ropes]
        for name in tips or [self.tree.bodies[-1].name]:
            tip, stage = self.position(name), self.places[name].stage
            parts += [("body", (tip,), name)]
            parts += [("bar", (origins[stage], tip), "")] if stage >= 0 and name not in self.loads else []

        def at(point: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
            x, y, z = ca.vertsplit(ca.densify(ca.substitute(point, self.q, values)))
            return x, y, z

        apart = [part for part in parts if len(part[1]) == 1 or not (part[1][1] - part[1][0]).is_zero()]
        return [Part(kind, tuple(map(at, points)), name) for kind, points, name in apart]

    @property
    def output_names(self) -> list[str]:
        """Names of outputs: as chosen, or the joints that are driven."""
        joints = [drive.joint for drive in self.inputs]
        if not self.options.outputs and not all(joints):
            raise self.tree.fault("outputs must be named, for not all inputs act on joints")
        return list(self.options.outputs) or joints

    @property
    def hint(self) -> str:
        """Options that show flatness which relative coordinates or forces of rotors hide; empty without any."""
        tree = self.tree
        known = {*self.loads, *(body.parent for body in tree.bodies if body.mass or body.joints)}
        lines = [
            f"if {body.name} hangs on a rope, ropes=['{body.name}'] replaces"
            f" {', '.join(joint.name for joint in hinges)} by its length, points=['{body.name}'] makes it a point mass"
            for body in tree.bodies
            if body.mass and body.name not in known and (hinges := rope_hinges(tree, body.name, self.driven))
        ]
        ways = [tree.above(drive.rotor) for drive in self.inputs if drive.rotor]
        for body in {next(body.name for body in way if body.mass) for way in ways}:
            wrench = [f"{body}.{part}" for part in ("force_z", "torque_x", "torque_y", "torque_z")]
            lines.append(f"inputs={wrench} takes the wrench of the rotors of {body}")
        return "; ".join(lines)

    inputs = cached_property(chosen_drives)
    """Inputs."""

    @cached_property
    def mass(self) -> ca.SX:
        """M, shape (n, n)."""
        motion, A = self.motion, self.reduction
        mass = ca.mtimes(ca.mtimes(A.T, motion.mass() + motion.spread("armature", self.options.elastic)), A)
        beside = [(f"{name}{MOTOR}", self.parameters[f"{name}.motor_inertia"]) for name in self.options.elastic]
        beside += [(f"{body}.{axis}", self.load_mass(body)) for body in self.loads for axis in "xyz"]
        for name, inertia in beside:
            k = self.coordinates.index(name)
            mass[k, k] += inertia
        return ca.sparsify(mass)

    def _potential(self, gravity: ca.SX) -> ca.SX:
        """Return V: weight, and springs."""
        potential = self.motion.weight(gravity)
        for stretch, stiffness, _ in self._springs:
            potential += stiffness / 2 * stretch**2
        for body in self.loads:
            potential -= self.load_mass(body) * ca.dot(gravity, self.point(body))
        return potential

    @cached_property
    def _springs(self) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
        """Extension, stiffness and damping of tendons and elastic joints, and of the springs of other joints."""
        sprung = [joint for joint in self.joints if joint.stiffness]
        springs = [(self.motion.q[each.name] - each.rest, ca.SX(each.stiffness), ca.SX(0)) for each in sprung]
        for name, tendon in self.tree.tendons.items():
            if name in self.options.taut or not (tendon.stiffness or tendon.damping):
                continue
            if np.isnan(tendon.rest):
                raise self.tree.fault(f"the tendon {name} has a spring with a slack range, which cannot be represented")
            springs.append((self.length(tendon) - tendon.rest, ca.SX(tendon.stiffness), ca.SX(tendon.damping)))
        for name, elastic in self.options.elastic.items():
            damping = self.parameters[f"{name}.spring_damping"] if elastic.damping else ca.SX(0)
            springs.append((self._twist(name), self.parameters[f"{name}.stiffness"], damping))
        return springs

    def _twist(self, name: str) -> ca.SX:
        """Return the angle of the motor of an elastic joint against the link."""
        return self.coordinates[f"{name}{MOTOR}"] - self.coordinates[name]

    def _damping(self) -> ca.SX:
        """Return the viscous forces, shape (n,), the gradient of half the dissipated power."""
        motion, A = self.motion, self.reduction
        forces = -ca.mtimes(ca.mtimes(A.T, motion.spread("damping")), ca.mtimes(A, self.v))
        for stretch, _, value in self._springs:
            J = ca.jacobian(stretch, self.q)
            forces -= value * ca.mtimes(J.T, ca.mtimes(J, self.v))
        return forces

    # Constraints --------------------------------------------------------------------------------------------------

    @cached_property
    def rows(self) -> dict[str, ca.SX]:
        """Holonomic constraints by name."""
        rows = dict[str, ca.SX]()
        for joint in self.moving:
            if joint.kind == "ball":
                e = ca.vertcat(*[self.motion.q[name] for name in joint.coordinates])
                rows[f"{joint.name} unit quaternion"] = ca.sumsqr(e) - 1
        for body in self.options.points:
            gap = self.point(body) - self.motion.pose(self.centre(body))[1]
            rows |= {f"{body} {axis}": gap[k] for k, axis in enumerate("xyz")}
        for body, hinges in self.ropes.items():
            turned, anchor = self.motion.world[self.anchor(body)]
            way = self.point(body) - anchor
            if len(hinges) == 1 and hinges[0].kind == "hinge":
                rows[f"plane of {body}"] = ca.dot(ca.mtimes(turned, sparse(hinges[0].axis)), way)
            rows[f"rope of {body}"] = ca.sumsqr(way) - self._rope_square(body)
        for name in self.options.taut:
            if not np.isfinite(self.tree.tendons[name].longest):
                raise self.tree.fault(f"taut: the tendon {name} has no upper limit of its length")
            rows[f"tendon {name}"] = self.length(self.tree.tendons[name]) - self.tree.tendons[name].longest
        for closure in self.tree.closures:
            found = self._closed(closure)
            rows |= {f"{closure.name} {k + 1}" if len(found) > 1 else closure.name: row for k, row in enumerate(found)}
        return rows

    def _rope_square(self, body: str) -> ca.SX:
        """Return the square of the length of a rope, which turning about its anchor leaves as it is."""
        return ca.sumsqr(self.motion.seen_from(self.centre(body), self.anchor(body)))

    def _closed(self, closure: Closure) -> list[ca.SX]:
        """Return the rows of a constraint beside the tree."""
        tree = self.tree
        if closure.kind in ("joint", "tendon"):
            tied = [name for name in (closure.first, closure.second) if name]
            of = self.motion.q if closure.kind == "joint" else {k: self.length(tree.tendons[k]) for k in tied}
            moved = of[closure.second] - closure.rest[1] if closure.second else ca.SX(0)
            polynomial = sum((c * moved**k for k, c in enumerate(closure.polynomial)), ca.SX(0))
            return [of[closure.first] - closure.rest[0] - polynomial]
        rows = ca.vertsplit(self.position(closure.first) - self.position(closure.second))
        if closure.kind != "connect":
            first, second = (self.motion.pose(self.place(name))[0] for name in (closure.first, closure.second))
            turned = ca.mtimes(first.T, second)
            rows += ca.vertsplit(ca.inv_skew(turned) if closure.kind == "weld" else turned[:2, 2])
        return rows

    def _tensions(self, lam: ca.SX) -> dict[Quantity, ca.SX]:
        """Return the tension of every rope: the multiplier is the force for each metre of the length."""
        of = dict(zip(self.rows, ca.vertsplit(lam), strict=True))
        lengths = {name: ca.sqrt(self._rope_square(name)) for name in self.ropes}
        pulls = {(name, f"the rope of {name}"): 2 * of[f"rope of {name}"] * lengths[name] for name in lengths}
        pulls |= {(name, name): of[f"tendon {name}"] for name in self.options.taut}
        return {Quantity(f"{k}.tension", "N", f"tension of {what}", tension=True): f for (k, what), f in pulls.items()}

    # The posture, and the configuration near another value of the outputs --------------------------------------------

    @cached_property
    def posture(self) -> Array:
        """A configuration that satisfies all constraints, near the posture, shape (n,)."""
        values = self.start | {f"{name}{MOTOR}": self.start[name] for name in self.options.elastic}
        q = np.array([values.get(name, 0.0) for name in self.coordinates.names])
        for body in self.loads:  # where it is in the file, in the posture
            first = self.coordinates.index(f"{body}.x")
            place = ca.Function("place", [self.q], [self.motion.pose(self.centre(body))[1]])
            q[first : first + 3] = filled(place(q)).ravel()
        g = ca.vertcat(*self.rows.values(), ca.SX(1, 1))  # a row of zeros, for there may be no constraint
        evaluate = ca.Function("posture", [self.q], [g, ca.jacobian(g, self.q)])
        for _ in range(_MOST_CORRECTIONS):
            residual, jacobian = (filled(each) for each in evaluate(q))
            if np.abs(residual).max() < _CLOSED:
                return q
            q = q - np.linalg.lstsq(jacobian, residual.ravel(), rcond=1e-10)[0]
        worst = list(self.rows)[int(np.abs(residual).argmax())]
        why = f"no configuration near the posture satisfies the constraint {worst}"
        raise self.tree.fault(f"{why}; give another posture")

    def _prediction(self, output: ca.SX, names: list[Quantity], q: Array) -> tuple[list[float], Array]:
        """Return the outputs at the posture, and dq/d(outputs) there: the configuration to first order.

        Coordinates that neither outputs nor constraints determine stay where they are; motors move with their links.
        """
        m = output.numel()
        # A row of zeros stands for no constraint: an empty matrix has no norm.
        g = ca.vertcat(ca.SX(1, 1), *self.rows.values(), *[self._twist(name) for name in self.options.elastic])
        evaluate = ca.Function("home", [self.q], [output, ca.jacobian(output, self.q), ca.jacobian(g, self.q)])
        value, C, G = (filled(each) for each in evaluate(q))
        stacked = np.vstack([C, G])
        tied, rank = (np.linalg.matrix_rank(each, _DEPENDENT * np.linalg.norm(each, 2)) for each in (G, stacked))
        if rank < tied + m:
            listed = ", ".join(each.name for each in names)
            there = ", ".join(f"{name} = {x:.3g}" for name, x in list(zip(self.coordinates.names, q, strict=True))[:8])
            what = f"the outputs {listed} are dependent at the posture {there}"
            raise self.tree.fault(f"{what}: give another one with posture")
        spread = np.asarray(np.linalg.pinv(stacked, rcond=_DEPENDENT)[:, :m], float)
        near = np.round(spread)
        return value.ravel().tolist(), np.where(np.abs(spread - near) < _ROUND_OFF, near, spread)
