r"""Cranes with a trolley, as their scenes need them and with more physics: one assembly for all effects together.

          [drive]~~~[carriage]      flexible: the drive's own inertia turns or moves against a spring
                        \  exit     off the trolley's centre, below the rail
                         \
                          \  upper rope: stiff, or a spring of stiffness EA/l; its weight is that of what is paid out
                           o lumps, fixed to the rope's material above the hook, stiff links between them
                           |
                           o hook
                           |  slings, or a rigid body up to its centre of oscillation
                           o load (follows the path)

All masses are points, so M is constant and the equations stay polynomial. Lumps keep the crane flat because they are
fixed to the material: at fractions of the length the load's equation would hold the rate of the rope's length, with a
coefficient that vanishes at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from servocore.errors import InvalidModel
from servocore.model.effects import Effect, parameters_with
from servocore.model.quantity import Quantity
from servocore.model.symbols import Coordinates, Parameters
from servocore.model.system import MechanicalSystem, reference_symbols
from servocore.numerics.expressions import diagonal
from servocore.scenes.crane_carriages import Carriage, Drive, exit_height
from servocore.scenes.hanging_load import ROPE, TENSION, pull, swing_angle, upwards

_SMOOTH_WIND = 0.01  # m/s: below it the drag is linear in the velocity, and differentiable at rest

STRETCHED = Quantity("stretched", "m", "elastic rope between its lumps and the trolley, under its load", positive=True)
ROPE_ABOVE = Quantity("rope_above", "m", "rope between its lumps and the trolley", positive=True)


@dataclass(frozen=True, eq=False)
class Chain:
    """Bodies on the upper rope: points from the load upwards.

    Attributes
    ----------
    names : tuple of str
        Of all but the load.
    masses : tuple of casadi.SX
        In kg, from the load upwards.
    links : tuple of casadi.SX
        Length between each point and the next one, in m.
    heavy : bool
        Whether the upper rope has a weight.
    beside : casadi.SX
        Rope between the hook and the last point, m.
    """

    names: tuple[str, ...]
    masses: tuple[ca.SX, ...]
    links: tuple[ca.SX, ...]
    heavy: bool
    beside: ca.SX


def overhang(outputs: Sequence[Quantity]) -> tuple[Quantity, ...]:
    """Return observables of the horizontal offset of the load from the rope's exit."""
    about = "load from the rope's exit"
    return tuple(Quantity(f"overhang_{quantity.name}", quantity.unit, about) for quantity in outputs[:-1])


def lumps_of(effects: frozenset[str]) -> int:
    """Return how many lumps stand for the rope's mass: 0 for a rope without mass."""
    counts = [
        int(effect.removeprefix("rope mass").strip() or 1) for effect in effects if effect.startswith("rope mass")
    ]
    return max(counts, default=0)


def _chain(effects: frozenset[str], p: Parameters) -> Chain:
    """Return load, hook and lumps with their links."""
    names: list[str] = []
    masses, links = [p["load_mass"]], []
    if "load inertia" in effects:
        a, body = p["body_centre"], p["load_mass"] - p["hook_mass"]
        length = a + p["body_gyration"] ** 2 / a  # the centre of oscillation, Huygens: an equimomental pair of points
        names, links = ["hook"], [length]
        masses = [body * a / length, p["hook_mass"] + body * (1 - a / length)]
    elif "hook" in effects:
        names, links = ["hook"], [p["sling_length"]]
        masses = [p["load_mass"] - p["hook_mass"], p["hook_mass"]]
    count = lumps_of(effects)
    for k in range(count):
        piece = p["rope_piece"] / count
        names.append(f"rope_{k + 1}")
        links.append(piece / 2 if k == 0 else piece)
        masses.append(p["rope_mass"] * piece)
    beside = p["rope_piece"] * (1 - 0.5 / count) if count else ca.SX(0)
    return Chain(tuple(names), tuple(masses), tuple(links), count > 0, beside)


@dataclass(frozen=True, eq=False)
class Crane:
    """A crane in all its levels of physics; a factory of models by the names of effects.

    Attributes
    ----------
    name : str
        Name of the crane in messages.
    carriage : Carriage
        What the rope hangs from.
    parameters : Parameters
        Of the crane without effects.
    inputs, outputs : tuple of Quantity
        Those of the carriage's drives and of the winch; coordinates of the load, the last upwards.
    home : tuple of float
        A regular position of the load, m.
    effects : tuple of Effect
        All that can be added or left out.
    """

    name: str
    carriage: Carriage
    parameters: Parameters
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    home: tuple[float, ...]
    effects: tuple[Effect, ...] = ()

    def points(self, reported: Sequence[Quantity] = ()) -> MechanicalSystem:
        """Return the crane without effects; coordinates that are reported too distinguish branches by their signs."""
        return self._assembled(f"{self.name}, points", self.parameters, frozenset(), reported=reported)

    def __call__(self, added: frozenset[str], left_out: frozenset[str]) -> MechanicalSystem:
        """Assemble the model with some effects and without others."""
        known = {effect.name: effect for effect in self.effects}
        chosen = added.union(*(known[effect].includes for effect in added))
        names = chosen | {f"no {effect}" for effect in left_out}
        if sum(label.startswith("rope mass") for label in names) > 1:
            raise InvalidModel(f"{self.name}: choose one number of lumps for the rope mass")
        declared = parameters_with(self.parameters, [effect for effect in self.effects if effect.name in chosen])
        changes = (("with", added), ("without", left_out))
        name = self.name + "".join(f" {how} {', '.join(sorted(which))}" for how, which in changes if which)
        return self._assembled(name, declared, names, overhang(self.outputs))

    def _assembled(
        self,
        name: str,
        p: Parameters,
        effects: frozenset[str],
        hanging: Sequence[Quantity] = (),
        reported: Sequence[Quantity] = (),
    ) -> MechanicalSystem:
        carriage, outputs, dimension, chain = self.carriage, self.outputs, len(self.outputs), _chain(effects, p)
        own = carriage.quantities(effects)
        above = [Quantity(f"{label}_{axis.name}", "m") for label in chain.names for axis in outputs]
        stretched = (STRETCHED,) if "elastic rope" in effects else ()
        c = Coordinates(*own, ROPE, *stretched, *outputs, *above)
        first = len(own) + 1 + len(stretched)
        points = ca.horzsplit(ca.reshape(c.q[first:], dimension, -1))
        rope_mass = p["rope_mass"] * p["rope_piece"] if chain.heavy else 0  # wound up it belongs to the trolley
        frame = carriage.frame(c, p, effects, p["trolley_mass"] - rope_mass)
        winch = ca.SX(0) if "no winch inertia" in effects else p["winch_inertia"] / p["winch_radius"] ** 2
        hung = (mass for mass in chain.masses for _ in outputs)
        total, span = c[ROPE.name], points[-1] - frame.exit
        taut = c[STRETCHED.name] if stretched else total - chain.beside  # its length under the load
        links = [ca.sumsqr(a - b) - link**2 for a, b, link in zip(points, points[1:], chain.links, strict=False)]
        weight = sum(m * p["gravity"] * point[-1] for m, point in zip(chain.masses, points, strict=True))
        constraints = ca.vertcat(frame.constraints, *links, ca.sumsqr(span) - taut**2)
        lam, gamma = ca.SX.sym("lam", constraints.numel()), reference_symbols(dimension)
        drives = (*frame.drives, Drive(ROPE, total, ca.jacobian(total, c.q), "winch_friction"))
        energy = _rope_energy(p, chain, total, taut, points[-1][-1], frame.exit[-1])
        gear = ca.diag(ca.vertcat(*[1] * len(frame.drives), 1 / p["winch_radius"]))
        return MechanicalSystem(
            name=name,
            coordinates=c,
            parameters=p,
            inputs=self.inputs,
            outputs=outputs,
            mass=diagonal((*frame.masses, winch, *[0] * len(stretched), *hung)),
            potential=frame.potential + weight + energy,
            force=_forces(c, p, drives, c.v[first : first + dimension], effects),
            constraints=constraints,
            input_matrix=-ca.mtimes(gear, ca.vertcat(*(drive.row for drive in drives))),
            output=points[0],
            multipliers=lam,
            gamma=gamma,
            guess=_guess(gamma, p, chain, carriage, effects),
            home=self.home,
            observables={
                **_observables(c, drives, 2 * lam[-1] * taut, span, chain, reported),
                **dict(zip(hanging, ca.vertsplit((points[0] - frame.exit)[: len(hanging)]), strict=True)),
            },
        )


def _rope_energy(p: Parameters, chain: Chain, total: ca.SX, taut: ca.SX, low: ca.SX, top: ca.SX) -> ca.SX:
    """Return weight and stretch of the rope from the last point to the trolley; what is paid out above lumps weighs.

    How long an elastic rope is under its load is a coordinate without mass. The pull is then a multiplier that follows
    from the load; as a small difference of lengths times EA it would lose as many digits as the rope stretches little.
    """
    potential, above = ca.SX(0), total - chain.beside
    if chain.heavy:
        half = p["rope_piece"] - chain.beside  # of the last lump's piece, above it
        middle = (top + low + (top - low) * half / above) / 2
        potential = p["rope_mass"] * p["gravity"] * (above - half) * middle
    if "rope_stiffness" in p.names:
        potential += p["rope_stiffness"] / total / 2 * (taut - above) ** 2
    return potential


def _forces(c: Coordinates, p: Parameters, drives: Sequence[Drive], load_rate: ca.SX, effects: frozenset[str]) -> ca.SX:
    """Return friction in the drives, and drag of the air on the load."""
    force = ca.SX.zeros(len(c))
    if "friction" in effects:
        for drive in drives:
            rate = ca.mtimes(drive.row, c.v)
            dry = p[drive.friction] * (ca.tanh(rate / p["creep"]) + p["viscous_share"] * rate)
            force -= ca.mtimes(drive.row.T, dry)
    if effects & {"air drag", "wind"}:
        against = load_rate - ca.vertcat(p["wind_speed"] if "wind" in effects else 0, *[0] * (load_rate.numel() - 1))
        speed = ca.sqrt(ca.sumsqr(against) + _SMOOTH_WIND**2)
        drag = p["air_density"] / 2 * p["drag_area"] * speed * against
        force -= ca.mtimes(ca.jacobian(load_rate, c.v).T, drag)
    return force


def _observables(
    c: Coordinates,
    drives: Sequence[Drive],
    tension: ca.SX,
    span: ca.SX,
    chain: Chain,
    reported: Sequence[Quantity],
) -> dict[Quantity, ca.SX]:
    own = {drive.measured: drive.position for drive in drives if drive.measured.name not in c.names}
    own |= {each: c[each.name] for each in reported}
    rope_meant = "upper rope" if chain.names else "rope"
    ahead = {2: ", positive where the load is ahead", 3: ""}[span.numel()]
    about = f"angle of the {rope_meant} from the vertical{ahead}"
    swing = Quantity("swing", "rad", about, nonnegative=span.numel() == 3)
    observables = {**own, TENSION: tension, swing: swing_angle(span)}
    return {**observables, ROPE_ABOVE: c[ROPE.name] - chain.beside} if chain.heavy else observables


def _guess(gamma: ca.SX, p: Parameters, chain: Chain, carriage: Carriage, effects: frozenset[str]) -> ca.SX:
    """Return a configuration near the path: from the load upwards along the pull, every point as fast as the load."""
    points, mass, direction = [gamma[:, 0]], sum(chain.masses, ca.SX(0)), upwards(gamma, p)
    for link in chain.links:
        points.append(points[-1] + link * direction)
    height = exit_height(p, effects)
    distance = (height - points[-1][-1]) / direction[-1]
    exit_ = points[-1] + distance * direction
    stretch = 1 + mass * ca.norm_2(pull(gamma, p)) / p["rope_stiffness"] if "elastic rope" in effects else 1
    rope = distance / stretch + chain.beside
    lengths = (rope, distance) if "elastic rope" in effects else (rope,)
    return ca.vertcat(carriage.guess(exit_, p, effects), *lengths, *points)
